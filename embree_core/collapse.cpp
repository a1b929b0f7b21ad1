// SPDX-License-Identifier: Apache-2.0
#include "embree_core/collapse.h"

#include <tbb/parallel_for.h>

#include <cmath>
#include <limits>

#include "embree_core/lift.h"
#include "embree_core/lift_kernels.h"

namespace vshift {
namespace {

/// Whether the parts of a split cell are planes to the bound: any triangles over their points will do.
bool parts_are_flat(const SurfaceField& field, int x, int y, float bound) {
    const SplitCell cell = split_cell(field, x, y);
    for (int p = 0; p < 4; ++p) {
        if (cell.part[p] != p) continue;
        const float own = field.w.at(x + corner_dx[p], y + corner_dy[p]);
        float slope_x = 0, slope_y = 0;
        int members = 0;
        const auto sides = [&](int c) {  // half edges along x and y
            const bool next_is_x = c % 2 == 0;
            return next_is_x ? std::array<float, 2>{cell.towards_next[c], cell.towards_last[c]}
                             : std::array<float, 2>{cell.towards_last[c], cell.towards_next[c]};
        };
        for (int c = p; c < 4; ++c) {
            if (cell.part[c] != p) continue;
            const float value = field.w.at(x + corner_dx[c], y + corner_dy[c]);
            const auto [along_x, along_y] = sides(c);
            slope_x += (along_x - value) * (corner_dx[c] ? -2.0f : 2.0f);
            slope_y += (along_y - value) * (corner_dy[c] ? -2.0f : 2.0f);
            ++members;
        }
        if (members == 1) continue;  // its quarter is drawn as ever
        slope_x /= float(members), slope_y /= float(members);
        float low = std::numeric_limits<float>::infinity(), high = -low;
        const auto add = [&](float value, float dx, float dy) {
            const float off = (value - own) - slope_x * dx - slope_y * dy;
            low = std::min(low, off), high = std::max(high, off);
        };
        for (int c = p; c < 4; ++c) {
            if (cell.part[c] != p) continue;
            const float dx = float(corner_dx[c]), dy = float(corner_dy[c]);
            const auto [along_x, along_y] = sides(c);
            add(field.w.at(x + corner_dx[c], y + corner_dy[c]), dx, dy);
            add(along_x, 0.5f, dy);
            add(along_y, dx, 0.5f);
        }
        add(cell.centre[p], 0.5f, 0.5f);
        if (!(high - low <= std::min(bound, largest_share * own))) return false;
    }
    return true;
}

/// Whether 1/z over a block's pixels, its border included, lies between two parallel planes that are the
/// bound apart. Every surface over them does then too, whatever its triangles.
template <int level>
bool is_flat(const Grid<float>& w, int block_x, int block_y, float bound) {
    constexpr int n = 1 << level;
    const size_t stride = size_t(w.width);
    const float* corner = &w.data[size_t(block_y << level) * stride + size_t(block_x << level)];
    const float own = corner[0];
    const float right = corner[n] - own, below = corner[n * stride] - own, across = corner[n * stride + n] - own;
    const float slope_x = (right + (across - below)) * (0.5f / n), slope_y = (below + (across - right)) * (0.5f / n);
    const float lowest = own + std::min(std::min(right, below), std::min(across, 0.0f));
    bound = std::min(bound, largest_share * lowest);
    const float middle = (corner[(n / 2) * stride + n / 2] - own) - slope_x * (n / 2) - slope_y * (n / 2);
    if (!(std::fabs(middle) <= bound)) return false;
    std::array<float, n + 1> low, high;
    low.fill(0), high.fill(0);  // the first corner's
    for (int y = 0; y <= n; ++y) {
        const float* row = corner + size_t(y) * stride;
        const float base = slope_y * float(y);
        for (int x = 0; x <= n; ++x) {
            const float off = (row[x] - own) - base - slope_x * float(x);
            low[size_t(x)] = off < low[size_t(x)] ? off : low[size_t(x)];
            high[size_t(x)] = off > high[size_t(x)] ? off : high[size_t(x)];
        }
    }
    float lowest_off = 0, highest_off = 0;
    for (int x = 0; x <= n; ++x) {
        lowest_off = std::min(lowest_off, low[size_t(x)]);
        highest_off = std::max(highest_off, high[size_t(x)]);
    }
    return highest_off - lowest_off <= bound;
}

template <int level>
void collapse_level(const SurfaceField& field, CellPlan& plan) {
    Grid<uint8_t> blocks((field.w.width - 1) >> level, (field.w.height - 1) >> level, 0);
    const auto child = [&](int x, int y) {
        if constexpr (level == 1) return plan.kind(x, y) == whole_kind;
        return level > 1 && plan.is_collapsed(level - 1, x, y);
    };
    tbb::parallel_for(0, blocks.height, [&](int by) {
        for (int bx = 0; bx < blocks.width; ++bx) {
            const int x = 2 * bx, y = 2 * by;
            if (!child(x, y) || !child(x + 1, y) || !child(x, y + 1) || !child(x + 1, y + 1)) continue;
            blocks.at(bx, by) = is_flat<level>(field.w, bx, by, plan.bound);
        }
    });
    plan.collapsed.push_back(std::move(blocks));
    if constexpr (level < most_levels) collapse_level<level + 1>(field, plan);
}

}  // namespace

CellPlan plan_cells(const SurfaceField& field, float bound) {
    CellPlan plan;
    plan.bound = bound;
    const Grid<float>& w = field.w;
    const int width = w.width, height = w.height;
    plan.kinds = Grid<uint8_t>(width + 1, height + 1, split_kind);
    static_assert(whole_kind == 2 && split_kind == 0);
    tbb::parallel_for(-1, height, [&](int y) {
        if (y >= 0 && y + 1 < height && width > 1) {
            const size_t row = size_t(y) * size_t(width), below = row + size_t(width);
            lifting::kernels().whole(&w.data[row], &w.data[below], &field.tears.data[row], &field.tears.data[below],
                                     size_t(width) - 1, &plan.kinds.at(1, y + 1));
        }
        if (!(bound > 0)) return;
        for (int x = -1; x < width; ++x) {
            uint8_t& kind = plan.kinds.at(x + 1, y + 1);
            if (kind == split_kind && !field.empty(x, y) && parts_are_flat(field, x, y, bound)) kind = merged_kind;
        }
    });
    if (bound > 0) collapse_level<1>(field, plan);
    return plan;
}

BlockBorder block_border(const CellPlan& plan, int level, int block_x, int block_y) {
    const int n = 1 << level, x0 = block_x << level, y0 = block_y << level;
    BlockBorder border;
    border.cells = n;
    for (int side = 0; side < 4; ++side) {
        int& count = border.counts[size_t(side)];
        auto& stops = border.stops[size_t(side)];
        for (int along = 0; along < n;) {
            // The cell beyond the border there.
            const int x = side == 0 ? x0 + along : side == 1 ? x0 + n : side == 2 ? x0 + n - 1 - along : x0 - 1;
            const int y = side == 0 ? y0 - 1 : side == 1 ? y0 + along : side == 2 ? y0 + n : y0 + n - 1 - along;
            stops[size_t(count++)] = int16_t(2 * along);
            const CellKind kind = CellKind(plan.kind(x, y));
            if (kind == split_kind) stops[size_t(count++)] = int16_t(2 * along + 1);
            along += kind == whole_kind ? std::min(n, 1 << plan.level(x, y)) : 1;
        }
    }
    return border;
}

BlockFan block_fan(const BlockBorder& border) {
    const int most = *std::max_element(border.counts.begin(), border.counts.end());
    return border.count() == 4                  ? BlockFan::quad
           : most <= 2 && border.cells % 2 == 0 ? BlockFan::side
                                                : BlockFan::centre;
}

BlockRing block_ring(const BlockBorder& border) {
    BlockRing ring;
    int first_middle = 0;
    for (int side = 0; side < 4; ++side)
        for (int i = 0; i < border.counts[size_t(side)]; ++i) {
            const int stop = border.stops[size_t(side)][size_t(i)];
            if (i > 0 && first_middle == 0) first_middle = ring.count;
            ring.at[size_t(ring.count++)] = BlockBorder::place(side, border.cells, stop / 2, 0);
        }
    // A fan's apex between two corners, so that no triangle is flat: all other points lie on other sides.
    std::rotate(ring.at.begin(), ring.at.begin() + first_middle, ring.at.begin() + ring.count);
    return ring;
}

}  // namespace vshift
