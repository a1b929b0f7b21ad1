// SPDX-License-Identifier: Apache-2.0
// Role: inside lift: the tears and 1/z of one depth map, and the rules by which surfaces end at a tear.
#pragma once
#include <algorithm>
#include <array>

#include "embree_core/types.h"

namespace vshift {

// Corners of a cell, in the order of the ring round it: (0,0), (1,0), (1,1), (0,1).
inline constexpr int corner_dx[4] = {0, 1, 1, 0};
inline constexpr int corner_dy[4] = {0, 0, 1, 1};
// The cell beyond the edge from a corner to the next one.
inline constexpr int beyond_dx[4] = {0, 1, 0, -1};
inline constexpr int beyond_dy[4] = {-1, 0, 1, 0};

enum class Pixel { missing, invalid, sky, solid };

struct SurfaceField {
    const Grid<float>& w;
    const Grid<uint8_t>& tears;

    Pixel state(int x, int y) const {
        if (x < 0 || y < 0 || x >= w.width || y >= w.height) return Pixel::missing;
        const float value = w.at(x, y);
        return value > 0 ? Pixel::solid : value == 0 ? Pixel::sky : Pixel::invalid;
    }
    /// `inner` here and below: every pixel that is asked for lies in the image.
    template <bool inner = false>
    bool solid(int x, int y) const {
        return inner ? w.at(x, y) > 0 : state(x, y) == Pixel::solid;
    }

    /// Whether two 4-neighbours lie on one observed surface.
    template <bool inner = false>
    bool joined(int x0, int y0, int x1, int y1) const {
        if (!solid<inner>(x0, y0) || !solid<inner>(x1, y1)) return false;
        const uint8_t bit = y0 == y1 ? 1 : 2;
        return !(tears.at(std::min(x0, x1), std::min(y0, y1)) & bit);
    }

    /// Whether all four corners of cell (x, y), which lies within the image, are joined round its ring.
    bool whole(int x, int y) const {
        const size_t at = size_t(y) * size_t(w.width) + size_t(x), below = at + size_t(w.width);
        return w.data[at] > 0 && w.data[at + 1] > 0 && w.data[below] > 0 && w.data[below + 1] > 0 &&
               !(tears.data[at] & 3) && !(tears.data[at + 1] & 2) && !(tears.data[below] & 1);
    }

    /// Whether cell (x, y) lies within the image and all its corners are sky: it holds nothing.
    bool empty(int x, int y) const {
        if (x < 0 || y < 0 || x + 1 >= w.width || y + 1 >= w.height) return false;
        const size_t at = size_t(y) * size_t(w.width) + size_t(x), below = at + size_t(w.width);
        return w.data[at] == 0 && w.data[at + 1] == 0 && w.data[below] == 0 && w.data[below + 1] == 0;
    }

    /// 1/z of solid pixel (x, y)'s surface half a pixel towards its neighbour at (dx, dy): between
    /// the two where they are joined, extrapolated from the far side of the pixel where not.
    template <bool inner = false>
    float half_edge(int x, int y, int dx, int dy) const {
        if (joined<inner>(x, y, x + dx, y + dy)) return 0.5f * (w.at(x, y) + w.at(x + dx, y + dy));
        return torn_edge<inner>(x, y, dx, dy);
    }
    /// The same where they are not joined.
    template <bool inner = false>
    float torn_edge(int x, int y, int dx, int dy) const {
        const float own = w.at(x, y);
        if (!joined<inner>(x, y, x - dx, y - dy)) return own;
        const float extended = own + 0.5f * (own - w.at(x - dx, y - dy));
        return std::clamp(extended, 0.5f * own, 2.0f * own);
    }
};

/// One cell with its corners' parts: which corners share a surface, and 1/z where each part reaches
/// the cell's centre.
struct SplitCell {
    std::array<Pixel, 4> state;
    std::array<int, 4> part;            ///< number of the part (its lowest corner), -1 where the corner is not solid
    std::array<float, 4> centre;        ///< 1/z of a part at the centre, by part number
    std::array<float, 4> towards_next;  ///< 1/z at the half edge to the next corner in the ring, own side
    std::array<float, 4> towards_last;  ///< likewise to the corner before
    std::array<bool, 4> joined_next;
};

SplitCell split_cell(const SurfaceField& field, int x, int y);

}  // namespace vshift
