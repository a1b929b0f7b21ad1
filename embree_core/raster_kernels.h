// SPDX-License-Identifier: Apache-2.0
// Role: the rasteriser's vectorised loops, chosen for the machine when the program runs (Highway). No fused
// operations, so every machine gives the same bytes.
#pragma once
#include <cstddef>
#include <cstdint>

namespace vshift::raster {

constexpr size_t most_cells = 64, padding = 16;

/// Of V's pixels a cell may cover so many columns and rows and still be drawn by the kernel. Three across: a shift to
/// the side shears the road.
constexpr int most_across = 3, most_down = 2, slots = most_across * most_down;

/// Corners of a row of cells: 1/z and tears (lift.h) in R; in V the pixel (centres at whole numbers), 1/Z, and 1/Z'
/// (-1: behind V).
struct Row {
    float w[most_cells + padding] = {};
    uint8_t tears[most_cells + padding] = {};
    float x[most_cells + padding] = {}, y[most_cells + padding] = {}, q[most_cells + padding] = {},
                         r[most_cells + padding] = {};
};

/// The projective map of (u, v, 1, 1/z) with pixel centres at whole numbers.
struct Map {
    float x[4], y[4], z[4];
};

/// What became of each cell of a row.
enum Kind : int32_t { nothing = 0, drawn = 1, wide = 2, split = 3 };
struct Cells {
    int32_t kind[most_cells + padding];
    int32_t x[most_cells + padding], y[most_cells + padding];  ///< drawn: the first of its pixels
    int32_t hits[most_cells + padding];    ///< bit dx + most_across dy: pixel (x + dx, y + dy) is covered
    float q[slots][most_cells + padding];  ///< 1/Z there, and the place on R's image
    float u[slots][most_cells + padding], v[slots][most_cells + padding];
};

/// Laid over the place of a back face until its pixel is settled: farther left than any image.
constexpr float back_mark = 65536;
// A wall stands before a surface when it is nearer by more than rounding.
constexpr float wall_margin = 1 + 1e-5f;

/// What a drawn pixel shows, in the numbers of `Sight`.
enum Shown : uint8_t { no_surface = 0, front = 2, back = 3, walled = 4 };

/// Pixels of V that may be written: [0, width) x [y0, y1).
struct Window {
    float width, y0, y1;
};

struct Kernels {
    /// Corners (u0 + i, v) for i < n: from w and tears to all else.
    void (*transform)(const Map& map, float u0, float v, size_t n, Row& row);
    /// Cells between two rows of corners; the first one's upper left corner is pixel (u0, v0) of R.
    void (*cells)(const Row& above, const Row& below, float u0, float v0, const Window& window, size_t n, Cells& out);
    /// A run of drawn pixels: 1/Z of the nearest surface and of the nearest wall. `floor` (null: 0) as in `reproject`:
    /// where q did not rise above it, q becomes 0 and the pixel shows nothing. `open`: 1 where no surface stands, but
    /// sky may. Marks are taken off the places, (x, y) each.
    void (*settle)(const float* floor, const float* wall, size_t n, float* q, float* source_px, uint8_t* shown,
                   uint8_t* open);
};

const Kernels& kernels();

}  // namespace vshift::raster
