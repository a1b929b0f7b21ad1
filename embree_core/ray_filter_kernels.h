// SPDX-License-Identifier: Apache-2.0
// Role: inside ray_filter: bounds of 1/z tile by tile, and where V sees them; chosen for the machine when the program
// runs (Highway).
#pragma once
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

namespace vshift::filtering {

inline constexpr int tile_width = 4;
/// Slopes up to this share of the segments' count as less steep.
inline constexpr float surely = 0.9f;
inline constexpr float infinity = std::numeric_limits<float>::infinity();
/// Nearer to V's plane than this share of R's depth, places in V's picture mean nothing.
inline constexpr float least_clear = 0.05f;

/// One axis of the way to V: a surface point at pixel u, 1/z = w, is seen by V at (u - centre w) / (1 - centre_z w), in
/// R's orientation; on the way to V u moves by centre - centre_z u.
struct Axis {
    float centre;
    int before, bins;  ///< V's picture is cut into bins of a tile's size, `before` of them ahead of pixel 0
};

/// What all rows of tiles share.
struct Setting {
    Axis u, v;
    float centre_z;
    float slack;        ///< how far the traced surface may be off in 1/z
    float slack_share;  ///< and as a share of it
    float wall_top;     ///< 1/z that walls beside unmeasured pixels reach
    float miss_px;      ///< by this many pixels, times 1/z, rays miss V's centre
    int width, height;  ///< of the image
    int tile_height;    ///< 1: epipolar lines are the rows, and every row stands for itself
};

/// Bins of V's picture, the last ones included.
struct Bins {
    int16_t x0, x1, y0, y1;
};

/// One row of tiles: the cells between its pixels and those right of and below them, with what surfaces and walls reach
/// beyond a tear.
struct TileRow {
    std::vector<float> low;     ///< least 1/z of the pixels
    std::vector<float> high;    ///< largest 1/z of the surfaces and walls; 0: nothing there
    std::vector<Bins> pixels;   ///< where V sees the pixels' points
    std::vector<Bins> surface;  ///< where it sees the surfaces and walls
    /// Whole, or torn so that walls fall away on the way to V, and rising less steeply than the segments to V.
    std::vector<uint8_t> gentle;
    std::vector<uint8_t> anywhere;  ///< bit 0: `pixels` means nothing, bit 1: `surface`
};

/// Least positive and largest 1/z.
struct Extent {
    float least, largest;
    bool invalid;
};

struct Kernels {
    Extent (*extent)(const float* w, size_t n);
    /// `w` and `tears` of the whole image; `room` is scratch.
    void (*tiles)(const Setting& setting, const float* w, const uint8_t* tears, int tile_row, std::vector<float>& room,
                  TileRow& out);
};

const Kernels& kernels();

}  // namespace vshift::filtering
