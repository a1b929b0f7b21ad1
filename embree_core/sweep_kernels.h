// SPDX-License-Identifier: Apache-2.0
// Role: the vectorised loops of the sweep, chosen for the machine when the program runs (Highway).
#pragma once
#include <cstddef>
#include <cstdint>

#include "embree_core/depth_source.h"

namespace vshift::sweep {

/// Samples of 1/z are stored with this many floats (NaN) free before the first and after the last.
inline constexpr size_t padding = 64;
/// Keys are in 1 / key_scale pixels; nothing is nearer than this disparity.
inline constexpr float key_scale = 8192, largest_disparity_px = 65536;
/// The key of what reaches to the camera's centre.
inline constexpr int32_t top_key = (1 << 30) + (1 << 20);

/// When neighbouring samples are torn apart: DepthRules, for one image axis.
struct TearRule {
    float px_per_q;  ///< focal length times baseline
    float tear_px, tear_break, crease_break;
    float constant, relative, squared;  ///< four errors of 1/z
};

/// One epipolar line, sample 0 first on the way to V.
struct LineRule {
    int32_t place0;          ///< sample i stands at place0 + i on the way to V
    float gain0, gain_step;  ///< |disparity| of sample i is |gain0 + gain_step i| q / (1 - centre_z q)
    float centre_z;          ///< V's centre along R's axis, metres
    TearRule tear;
    InverseDepthError error;
    float reach;  ///< of a surface past its last sample, 0 to 1
};

/// a x + b y + c over the pixels of an image.
struct Linear {
    float a, b, c;
};

/// How a pixel's own point lies to V: for `outside` and `unseen`. A frustum's sides that no pixel can leave are left out.
struct PixelRule {
    /// A side of V's frustum: the pixel's point lies beyond it where z * at + move < 0 (`strict`: where it is 0 too); the
    /// sky, where at < 0.
    struct Outside {
        Linear at;
        float move;
        bool strict;
    };
    /// A side of R's frustum, beyond which V lies: what the segment enters the ball round V by is beyond it too where V
    /// is farther off than clear_m + z * at (the sky: than at, with a ray of z = 1).
    Outside outside[4];
    Linear unseen[4];
    int outside_count = 0, unseen_count = 0;
    float ray_x0, ray_y0, ray_dx, ray_dy;  ///< recorded ray of pixel (x, y), z = 1
    float centre[3];
    float clear_m;
};

/// How a run of pixels finds its lines.
struct Take {
    const uint8_t* classes;
    int32_t stride, first_line;
    const float* a;
    float b, c;
    const int32_t* levels;  ///< per pixel, or null: `level` for all
    int32_t level;
    int32_t place, place_step;
};

struct Kernels {
    /// q = 1/z of a row: 0 sky, NaN no measurement.
    void (*inverse)(const float* z, size_t n, float* q);
    void (*inverse_reversed)(const float* z, size_t n, float* q);
    /// keys of samples 0..n-1; bit i of `torn` (16 to an element): samples i and i + 1 are not joined; bit i of `rising`:
    /// they are, and the key of i is the greater.
    void (*keys)(const LineRule& rule, const float* q, size_t n, int32_t* key, uint16_t* torn, uint16_t* rising);
    /// outside, unseen and unknown (no measurement) bits of a row of pixels, laid over `classes` (`reversed`: that run
    /// from the last pixel to the first). `out` may be `classes`, unless they are reversed.
    void (*pixels)(const PixelRule& rule, const float* z, int y, size_t n, const uint8_t* classes, bool reversed,
                   uint8_t* out);
    /// q of a row with its lowest bit set where the pixel is torn from the one below (rows are y-1, y, y+1, y+2; null
    /// beyond the image).
    void (*mark_rows)(const float* const rows[4], size_t n, const TearRule& tear, float* q);
    /// Samples along a line: at position p (whole, step +-1) across `v0 + slope * p`, between rows of `image`.
    void (*sample)(const float* image, int stride, int rows, int first, int step, size_t n, float v0, float slope,
                   float* q);
    /// out[i] = classes[(line - first_line) * stride + place], the line nearest to a[i] * b + c among every 2^level-th;
    /// lines and places grow with i or stand still: see Take.
    void (*take)(const struct Take& rule, size_t n, uint8_t* out);
};

const Kernels& kernels();

}  // namespace vshift::sweep
