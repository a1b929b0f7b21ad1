// SPDX-License-Identifier: Apache-2.0
// Role: the sampler's vectorised look at a run of V's pixels, chosen for the machine when the program runs (Highway).
// No fused operations: the same bytes as the sampler's own steps for one pixel (warp.cpp), on every machine.
#pragma once
#include <cstddef>
#include <cstdint>

namespace vshift::sampling {

constexpr size_t most_pixels = 64, padding = 16;

// Within this of a pixel's centre the pixel itself is meant: rounding leaves no trace in an image that does not move.
constexpr float snap_px = 1.0f / 1024;
// V's pixel on the recorded image: up to the first width plain bilinear, never wider than the second.
constexpr float plain_width_px = 1.5f, widest_px = 8;

/// A recorded camera's surface (lift.h) and picture, and the rows of the map from (u, v, 1, 1/z) to V's homogeneous
/// pixel.
struct Surface {
    const float* w;
    const uint8_t* tears;
    const float* rgb;  ///< three to a pixel
    int32_t width, height;
    const float *x, *y, *z;
};

/// How a pixel's colour is had: bilinear among four pixels of one surface; a tent of half widths `across` and `down`
/// over one surface; neither.
enum Kind : int32_t { other = 0, plain = 1, tent = 2 };
struct Plan {
    int32_t kind[most_pixels + padding];
    int32_t at[most_pixels + padding];                           ///< index of the upper left of the four
    float fx[most_pixels + padding], fy[most_pixels + padding];  ///< plain: shares of the right and the lower ones
    float across[most_pixels + padding], down[most_pixels + padding];
};

struct Kernels {
    /// `source_px`: n image positions of R, (x, y) each, with `padding` more behind them; V shows the first at (x0, y).
    void (*plan)(const Surface& surface, const float* source_px, float x0, float y, size_t n, Plan& out);
    /// Colours of the pixels that the plan calls plain or tent, black for the others, into 3 n + 1 floats. Where a tent
    /// reaches over a tear the plan then says `other`.
    void (*colors)(const Surface& surface, const float* source_px, size_t n, Plan& plan, float* rgb);
};

const Kernels& kernels();

}  // namespace vshift::sampling
