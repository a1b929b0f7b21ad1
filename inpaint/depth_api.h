/* SPDX-License-Identifier: Apache-2.0
 * Role: depth from pictures in libvshift_inpaint.so, beside c_api.h and by its rules. Stage: before lift.
 */
#ifndef VSHIFT_INPAINT_DEPTH_API_H
#define VSHIFT_INPAINT_DEPTH_API_H
#include "inpaint/c_api.h"

#ifdef __cplusplus
extern "C" {
#endif

/* One picture and its camera. The ground is the ego's plane z = 0. */
typedef struct {
    int32_t height, width;
    const float* color;         /* 3 planes of display values (sRGB) in 0..1 */
    double fx, fy, cx, cy;      /* pixels, centres at +0.5 */
    double ego_from_cam[9];     /* rotation, row by row */
    double height_m;            /* of the camera above the ground */
    const float* inverse_depth; /* training: 1/m, 0 in the sky; else NULL */
} vshift_depth_view;

/* As vshift_inpaint_train, with options {"width", "unet": {...}} under "model". */
typedef int (*vshift_depth_sample)(void* user, uint64_t number, vshift_depth_view* out);
VSHIFT_INPAINT_API int vshift_depth_train(const char* options_json, vshift_depth_sample sample,
                                          vshift_inpaint_progress progress, void* user);

/* A model of ours (.safetensors), or, where `trust` is not 0, any TorchScript module, which is a program of its author:
 * forward takes colors [1, 3, H, W] and gives planar z in metres, [1, 1, H, W] or fewer leading ones. */
typedef struct vshift_depth_model vshift_depth_model;
VSHIFT_INPAINT_API int vshift_depth_model_open(const char* file, int32_t trust, vshift_depth_model** out);
VSHIFT_INPAINT_API void vshift_depth_model_free(vshift_depth_model* model);
/* z: one plane; +inf in the sky, NaN where a module gave no depth above 0. */
VSHIFT_INPAINT_API int vshift_depth_of(const vshift_depth_model* model, const vshift_depth_view* view, float* z);

#ifdef __cplusplus
}
#endif
#endif
