/* SPDX-License-Identifier: Apache-2.0
 * Role: the C ABI of libvshift_inpaint.so, the one library that links Torch. Stage: inpaint (paper III-E). It is
 * loaded when the network is asked for (network_library.h) and never else.
 *
 * Pictures are planar floats [channel][frame][row][column], row 0 on top; colors are display values (sRGB) in 0..1.
 * Every function returns 0, or an exit code of docs/conventions.md; vshift_inpaint_last_error() then gives one line
 * (per thread). Null out-pointers are errors of the caller (6).
 */
#ifndef VSHIFT_INPAINT_C_API_H
#define VSHIFT_INPAINT_C_API_H
#include <stdint.h>

#if defined(__GNUC__)
#define VSHIFT_INPAINT_API __attribute__((visibility("default")))
#else
#define VSHIFT_INPAINT_API
#endif

#ifdef __cplusplus
extern "C" {
#endif

/* "vshift X.Y.Z, LibTorch A.B.C" */
VSHIFT_INPAINT_API const char* vshift_inpaint_version(void);
VSHIFT_INPAINT_API const char* vshift_inpaint_last_error(void);
/* Torch's own threads; 0: as many as there are cores. Other numbers of threads round differently. */
VSHIFT_INPAINT_API int vshift_inpaint_set_threads(int threads);
/* 0 for "cpu", and for "cuda" where this LibTorch finds one; else 3. */
VSHIFT_INPAINT_API int vshift_inpaint_has_device(const char* device);
/* What a linear layer of 512 x 512 reaches here. Debian's plain BLAS gives 2, libopenblas0-openmp a hundred. */
VSHIFT_INPAINT_API int vshift_inpaint_linear_speed(double* gflop_per_s);

typedef struct {
    int32_t frames, height, width;
    const float* fill;          /* 3 planes: the condition, its holes filled classically */
    const float* hole;          /* 1: share that nobody saw */
    const float* neighbor;      /* 1: share pasted from a neighbour */
    const float* inverse_depth; /* 1: 1/m, 0 in holes and sky */
    const float* target;        /* 3: training only, else NULL */
    const float* weight;        /* 1: how much an error counts in training; NULL: hole or neighbor */
    const float* texture;       /* 3: training of a flow with a start, whose rays' colors are then the fill; else NULL */
    const float* seen;          /* 213: training of kind pixel_rays, what the rays of every pixel meet (rays.h); else NULL */
} vshift_inpaint_views;

/* Training. `sample` gives what it always gives for that number; its memory must last until its next call. All samples
 * are of one size. `progress` comes after every step; what it returns other than 0 stops (130), with a checkpoint.
 * `options_json`: {"model": {...}, "steps", "batch", "accumulate", "learning_rate", "weight_decay", "ema", "seed",
 * "checkpoint_every", "checkpoint_file", "model_file", "curve_file", "license", "autoencoder_file", "regression_file", "start_file",
 * "device" ("cpu", "cuda"), "precision" ("float32", "bf16"), "record": {...}}.
 * Samples from VSHIFT_INPAINT_CHECKS on are of views that are not trained on: an autoencoder is measured on them. */
#define VSHIFT_INPAINT_CHECKS (UINT64_C(1) << 40)
typedef int (*vshift_inpaint_sample)(void* user, uint64_t number, vshift_inpaint_views* out);
typedef int (*vshift_inpaint_progress)(void* user, int64_t step, int64_t steps, double loss);
VSHIFT_INPAINT_API int vshift_inpaint_train(const char* options_json, vshift_inpaint_sample sample,
                                            vshift_inpaint_progress progress, void* user);

/* A model is immutable and may serve many streams; a stream serves one thread and its frames in order. */
typedef struct vshift_inpaint_model vshift_inpaint_model;
typedef struct vshift_inpaint_stream vshift_inpaint_stream;
VSHIFT_INPAINT_API int vshift_inpaint_model_open(const char* file, vshift_inpaint_model** out);
VSHIFT_INPAINT_API void vshift_inpaint_model_free(vshift_inpaint_model* model);
/* Of a pixel_rays: the holes' colors and the texture beside them, 3 planes each (ray_mixer.h). */
VSHIFT_INPAINT_API int vshift_inpaint_texture(const vshift_inpaint_model* model, const vshift_inpaint_views* views, float* color,
                                              float* texture);
/* A stream's first piece is one frame; the frames of later ones are a multiple of this: 1, or as many as a latent holds. */
VSHIFT_INPAINT_API int32_t vshift_inpaint_model_piece(const vshift_inpaint_model* model);
/* Lives as long as the model. */
VSHIFT_INPAINT_API const char* vshift_inpaint_model_config(const vshift_inpaint_model* model);
VSHIFT_INPAINT_API int vshift_inpaint_stream_open(const vshift_inpaint_model* model, int32_t steps, uint64_t seed,
                                                  vshift_inpaint_stream** out);
VSHIFT_INPAINT_API void vshift_inpaint_stream_free(vshift_inpaint_stream* stream);
/* color: 3 planes. Pixels with neither hole nor neighbor come back as `fill` has them, bit for bit. */
VSHIFT_INPAINT_API int vshift_inpaint_stream_next(vshift_inpaint_stream* stream, const vshift_inpaint_views* views,
                                                  float* color);

#ifdef __cplusplus
}
#endif
#endif
