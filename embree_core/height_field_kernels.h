// SPDX-License-Identifier: Apache-2.0
// Role: the vectorised march of a packet of rays over one tile of a height field, chosen for the machine when the
// program runs (Highway). No fused operations, so every machine gives the same bytes.
#pragma once
#include <cstdint>

namespace vshift::heights {

inline constexpr int tile_cells = 4;   ///< along each side of a tile
inline constexpr int packet_rays = 8;  ///< as many as RayPacket holds

/// Square of cells whose first corner is pixel (x, y); the image's border cells begin at -1.
///
/// Where all its cells are whole, `w` is the field at (x, y). Else `codes` tells of each cell, row-major, where its
/// patches are: 1/z at the corners (0,0), (1,0), (0,1), (1,1) from w[code / 2] on, of the whole cell or, where the code
/// is odd, of each of its quarters, row-major. A quarter without a surface is flat: sky 0, no measurement wall_top,
/// outside the image NaN.
struct Tile {
    int32_t x, y;
    float low, high;  ///< of 1/z, walls included
    const float* w;
    const int32_t* codes;  ///< or null
};

/// Of all tiles.
struct Surface {
    int32_t stride;  ///< of the field
    float wall_top;
};

/// Straight lines in pixels (whole numbers at pixels' centres) and 1/z: (x, y, w) + s (dx, dy, dw), s from 0 to `end`.
struct Rays {
    alignas(32) float x[packet_rays]{}, y[packet_rays]{}, w[packet_rays]{}, dx[packet_rays]{}, dy[packet_rays]{},
        dw[packet_rays]{}, end[packet_rays]{};
    alignas(32) float wall_end[packet_rays]{};  ///< walls count as far as this
};

/// Bits of rays.
struct Met {
    uint32_t kept = 0, torn = 0;
};

struct Kernels {
    /// Which of the rays in `asked` pass a kept surface, and which a wall before that, over this tile. A ray begins on
    /// the surface or above it (nearer to the camera); one that then runs below meets what it began on.
    Met (*march)(const Surface& surface, const Tile& tile, const Rays& rays, uint32_t asked);
};

const Kernels& kernels();

}  // namespace vshift::heights
