// SPDX-License-Identifier: Apache-2.0
#include "embree_core/ray_filter.h"

#include <tbb/enumerable_thread_specific.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <numeric>

#include "embree_core/ray_filter_kernels.h"

namespace vshift {

using namespace filtering;

namespace {

// No ray may leave its row by this much where the rows stand for themselves: surfaces end half a pixel off.
constexpr float most_off_row_px = 0.4f;

/// Bins of V's picture with an extreme of 1/z in each; `anywhere` is what lies in no bin for sure.
struct Picture {
    Grid<float> bins;
    float anywhere;

    template <class Visit>
    void visit(const Bins& at, Visit&& visit) {
        for (int y = at.y0; y <= at.y1; ++y) {
            float* row = &bins.at(0, y);
            for (int x = at.x0; x <= at.x1; ++x) visit(row[x]);
        }
    }
};

/// Columns (rows) of tiles by the order in which the way to V leads to them, and which neighbours it leads on to.
struct Order {
    std::vector<int> order;
    std::vector<uint8_t> ahead, back;  ///< may lead to the next, to the one before
    Order(int count, int size, double centre, double centre_z, bool stands_still) : order(size_t(count)) {
        ahead.assign(size_t(count), 0), back.assign(size_t(count), 0);
        std::iota(order.begin(), order.end(), 0);
        const auto way = [&](int i) { return centre - centre_z * double(i) * size; };
        const bool to_right = way(0) + way(count) > 0;
        const bool one_way = stands_still || (way(0) > 0) == (way(count) > 0);
        if (one_way) {
            if (to_right) std::reverse(order.begin(), order.end());
        } else {
            // Ahead of V the way leads to the epipole, which it starts from behind it.
            const double towards = centre_z > 0 ? 1 : -1;
            std::stable_sort(order.begin(), order.end(), [&](int a, int b) {
                return towards * std::fabs(way(a) + way(a + 1)) < towards * std::fabs(way(b) + way(b + 1));
            });
        }
        for (int i = 0; i < count && !stands_still; ++i) {
            const double first = way(i), last = way(i + 1);
            // In the tile of the epipole the way stays there or leaves on either side.
            const bool here = (first > 0) != (last > 0) || first == 0 || last == 0;
            ahead[size_t(i)] = here ? centre_z <= 0 : first > 0;
            back[size_t(i)] = here ? centre_z <= 0 : first < 0;
        }
    }
};

/// How many tiles on, in columns and in rows, the way to V is gentle, the own one included.
Grid<uint16_t> gentle_reach(const std::vector<TileRow>& tiles, const Order& across, const Order& down) {
    constexpr uint16_t most = 0x7fff;
    const int columns = int(across.order.size()), rows = int(tiles.size());
    Grid<uint16_t> reach(columns, rows, 0);
    for (const int y : down.order)
        for (const int x : across.order) {
            if (!tiles[size_t(y)].gentle[size_t(x)]) continue;
            uint16_t least = most;
            const int x0 = across.back[size_t(x)] && x > 0 ? -1 : 0,
                      x1 = across.ahead[size_t(x)] && x + 1 < columns ? 1 : 0;
            const int y0 = down.back[size_t(y)] && y > 0 ? -1 : 0, y1 = down.ahead[size_t(y)] && y + 1 < rows ? 1 : 0;
            for (int dy = y0; dy <= y1; ++dy)
                for (int dx = x0; dx <= x1; ++dx)
                    if (dx || dy) least = std::min(least, reach.at(x + dx, y + dy));
            reach.at(x, y) = uint16_t(std::min<int>(most, least + 1));
        }
    return reach;
}

}  // namespace

RayFilter::RayFilter(const Surface& surface, const glm::dvec3& centre_m) : centre_m_(centre_m) {
    static_assert(1 << width_shift == tile_width);
    const Intrinsics& k = surface.intrinsics;
    const Grid<float>& w = surface.w;
    const double centre_x = k.fx * centre_m.x + k.cx * centre_m.z, centre_y = k.fy * centre_m.y + k.cy * centre_m.z;
    const Extent extent = kernels().extent(w.data.data(), w.size());
    const float miss_px = extent.largest > 0 ? largest_miss_px / extent.least : 0;

    // Where every ray keeps to its row of pixels, rows stand for themselves.
    const auto way = [&](double centre, double at) { return centre - centre_m.z * at; };
    const double left = way(centre_x, 0), right = way(centre_x, k.width);
    const double off = std::max(std::fabs(way(centre_y, 0)), std::fabs(way(centre_y, k.height))) * k.width /
                       std::min(std::fabs(left), std::fabs(right));
    const bool only_rows =
        (left > 0) == (right > 0) && !extent.invalid && off + miss_px * extent.largest < most_off_row_px;
    height_shift_ = only_rows ? 0 : 1;
    const int tile_height = 1 << height_shift_;
    const int columns = (k.width + tile_width - 1) / tile_width, rows = (k.height + tile_height - 1) / tile_height;
    asks_ = Grid<uint8_t>(columns, rows, 1), meets_ = Grid<uint8_t>(columns, rows, 1);
    if (!surface.error.none()) return;  // rays then start off the surface

    const Setting setting{{float(centre_x), columns, 3 * columns},
                          {float(centre_y), only_rows ? 0 : rows / 2, only_rows ? rows : 2 * rows},
                          float(centre_m.z),
                          surface.slack,
                          surface.wall_top,
                          miss_px,
                          k.width,
                          k.height,
                          tile_height};
    std::vector<TileRow> tiles(static_cast<size_t>(rows));
    tbb::enumerable_thread_specific<std::vector<float>> rooms;
    tbb::parallel_for(0, rows, [&](int y) {
        TileRow& row = tiles[size_t(y)];
        const size_t count = size_t(columns);
        row.low.resize(count), row.high.resize(count), row.pixels.resize(count), row.surface.resize(count);
        row.gentle.resize(count), row.anywhere.resize(count);
        kernels().tiles(setting, w.data.data(), surface.tears.data.data(), y, rooms.local(), row);
    });
    const Order across(columns, tile_width, centre_x, centre_m.z, false);
    const Order down(rows, tile_height, centre_y, centre_m.z, only_rows);
    const Grid<uint16_t> reach = gentle_reach(tiles, across, down);

    // Rows that stand for themselves share no bin.
    const auto each_row = [&](auto&& body) {
        if (only_rows)
            tbb::parallel_for(0, rows, body);
        else
            for (int y = 0; y < rows; ++y) body(y);
    };
    Picture nearest{Grid<float>(setting.u.bins, setting.v.bins, 0.0f), 0};
    each_row([&](int y) {
        const TileRow& row = tiles[size_t(y)];
        for (size_t x = 0; x < size_t(columns); ++x) {
            const float high = row.high[x];
            if (row.anywhere[x] & 2 && !only_rows)
                nearest.anywhere = std::max(nearest.anywhere, high);
            else if (high > 0)
                nearest.visit(row.surface[x], [&](float& bin) { bin = std::max(bin, high); });
        }
    });

    Picture farthest{Grid<float>(setting.u.bins, setting.v.bins, infinity), infinity};
    each_row([&](int y) {
        const TileRow& row = tiles[size_t(y)];
        const auto steepest = [&](double centre, int at, int size) {
            return std::max(std::fabs(way(centre, at * size)), std::fabs(way(centre, (at + 1) * size)));
        };
        const double down_px = only_rows ? 0 : steepest(centre_y, y, tile_height);
        for (int x = 0; x < columns; ++x) {
            const size_t at = size_t(x);
            if (const int tiles_on = reach.at(x, y) - 1; tiles_on > 0 && !(row.anywhere[at] & 1)) {
                // With 1/z the segment moves by `way` over R's picture, per 1 - centre_z w; as far as all is gentle
                // nothing that it meets is nearer than this.
                const double across_px = steepest(centre_x, x, tile_width);
                const double clear =
                    std::max(0.0, 1 - std::max(centre_m.z * double(row.low[at]), centre_m.z * double(row.high[at])));
                const double on = std::min(across_px > 0 ? tiles_on * tile_width / across_px : 1e30,
                                           down_px > 0 ? tiles_on * tile_height / down_px : 1e30);
                const float allowed = float(double(row.low[at]) + double(surely) * clear * on);
                bool clear_there = nearest.anywhere <= allowed;
                nearest.visit(row.pixels[at], [&](float& bin) { clear_there = clear_there && bin <= allowed; });
                asks_.at(x, y) = !clear_there;
            }
            if (!asks_.at(x, y)) continue;
            if (row.anywhere[at] & 1 && !only_rows)
                farthest.anywhere = std::min(farthest.anywhere, row.low[at]);
            else
                farthest.visit(row.pixels[at], [&](float& bin) { bin = std::min(bin, row.low[at]); });
        }
    });

    tbb::parallel_for(0, rows, [&](int y) {
        const TileRow& row = tiles[size_t(y)];
        for (int x = 0; x < columns; ++x) {
            const size_t at = size_t(x);
            const float high = row.high[at];
            bool met = farthest.anywhere <= high || (row.anywhere[at] & 2 && !only_rows);
            if (!met) farthest.visit(row.surface[at], [&](float& bin) { met = met || bin <= high; });
            meets_.at(x, y) = high > 0 && met;
        }
    });
    if (!only_rows) return;
    // Rays along a row run between the cells above it and those below.
    for (int y = 0; y + 1 < rows; ++y)
        for (int x = 0; x < columns; ++x) meets_.at(x, y) |= meets_.at(x, y + 1);
}

}  // namespace vshift
