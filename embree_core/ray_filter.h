// SPDX-License-Identifier: Apache-2.0
// Role: which pixels of a lifted camera a ray has to decide, and which cells of its mesh such rays can meet. Stage:
// mask.
//
// The picture is cut into tiles. In (u, v, 1/z) the segment from a point to V is straight, and V sees all of it at one
// place; so a picture of V's, with R's orientation, bins the tiles by where V sees them. A point is seen for sure when
// what lies between it and V near its own place rises less steeply than the segment does, and nothing at its place in
// V's picture stands nearer than that reaches. What is left is asked by rays; they meet only what is seen at the same
// place and stands nearer than the farthest point that asks there.
#pragma once
#include <algorithm>
#include <array>
#include <glm/glm.hpp>
#include <utility>

#include "embree_core/camera.h"
#include "embree_core/depth_source.h"
#include "embree_core/types.h"

namespace vshift {

/// Rays may miss V's centre by this much, in pixels of the recorded pixel (mask.cpp).
inline constexpr float largest_miss_px = 0.0017f;

class RayFilter {
public:
    /// The surface of lift.h over 1/z `w`, from which the traced mesh may be off by `slack` and by `slack_share` (above
    /// 0) of it.
    struct Surface {
        const Intrinsics& intrinsics;
        const Grid<float>& w;
        const Grid<uint8_t>& tears;
        float wall_top;
        float slack, slack_share;
        const InverseDepthError& error;
    };
    /// `centre_m`: V's centre in the recorded camera.
    RayFilter(const Surface& surface, const glm::dvec3& centre_m);

    /// Whether a ray has to tell what hides the pixel's point (the sky's too) from V; else V sees it, past no wall.
    bool asks(int x, int y) const { return asks_.at(x >> width_shift, y >> height_shift_); }
    /// As many pixels of a row, from a multiple of it on, are answered alike.
    static constexpr int cells = 4;
    /// Whether such a ray may meet the surface in any of the cells whose first corners are pixels (x0, y0) to (x1, y1),
    /// the last one included; the border's are at -1.
    bool meets_any(int x0, int y0, int x1, int y1) const {
        x1 = std::min(std::max(x1, 0) >> width_shift, meets_.width - 1);
        y1 = std::min(std::max(y1, 0) >> height_shift_, meets_.height - 1);
        for (int y = std::max(y0, 0) >> height_shift_; y <= y1; ++y)
            for (int x = std::max(x0, 0) >> width_shift; x <= x1; ++x)
                if (meets_.at(x, y)) return true;
        return false;
    }

private:
    static constexpr int width_shift = 2;
    static_assert(1 << width_shift == cells);
    int height_shift_ = 0;
    Grid<uint8_t> asks_, meets_;
};

/// Calls `ask(columns, count)` for the pixels of row `y` that ask (`filter` null: all) and are `wanted(x)`, `size` at
/// most at a time.
template <int size, class Wanted, class Ask>
void ask_in_packets(const RayFilter* filter, int width, int y, Wanted&& wanted, Ask&& ask) {
    std::array<int, size> columns;
    int count = 0;
    for (int x = 0; x < width; ++x) {
        if (filter && !filter->asks(x, y)) {
            x |= RayFilter::cells - 1;  // the last that is answered alike
            continue;
        }
        if (!wanted(x)) continue;
        columns[size_t(count++)] = x;
        if (count == size) ask(columns.data(), std::exchange(count, 0));
    }
    if (count) ask(columns.data(), count);
}

}  // namespace vshift
