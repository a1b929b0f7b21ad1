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
// Nor by this much for each pixel along it: slopes down the picture would count.
constexpr double most_off_row_share = 0.0005;

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
    /// Of each the first and the last of itself and the neighbours that the way leads on to (`from_there`: that lead to
    /// it).
    std::vector<std::pair<int, int>> next(bool from_there) const {
        const int count = int(order.size());
        std::vector<std::pair<int, int>> all;
        for (int i = 0; i < count; ++i) {
            const bool before = i > 0 && (from_there ? ahead[size_t(i) - 1] : back[size_t(i)]);
            const bool after = i + 1 < count && (from_there ? back[size_t(i) + 1] : ahead[size_t(i)]);
            all.emplace_back(before ? i - 1 : i, after ? i + 1 : i);
        }
        return all;
    }
};

/// How many tiles on (back: on the ways that lead there), in columns and in rows, the way to V is gentle, the own one
/// included.
Grid<uint16_t> gentle_reach(const std::vector<TileRow>& tiles, const Order& across, const Order& down, bool back) {
    constexpr uint16_t most = 0x7fff;
    const int columns = int(across.order.size()), rows = int(tiles.size());
    Grid<uint16_t> reach(columns, rows, 0);
    std::vector<int> order = across.order;
    if (back) std::reverse(order.begin(), order.end());
    const auto beside = across.next(back), along = down.next(back);
    std::vector<uint16_t> other_rows(size_t(columns), most);
    for (int i = 0; i < rows; ++i) {
        const int y = down.order[size_t(back ? rows - 1 - i : i)];
        const auto [y0, y1] = along[size_t(y)];
        std::fill(other_rows.begin(), other_rows.end(), most);
        for (int other = y0; other <= y1; ++other)
            for (int x = 0; x < columns && other != y; ++x)
                other_rows[size_t(x)] = std::min(other_rows[size_t(x)], reach.at(x, other));
        uint16_t* const row = &reach.at(0, y);
        const uint8_t* const gentle = tiles[size_t(y)].gentle.data();
        for (const int x : order) {
            if (!gentle[x]) continue;
            const auto [x0, x1] = beside[size_t(x)];
            uint16_t least = other_rows[size_t(x)];
            if (x0 < x) least = std::min({least, row[x0], other_rows[size_t(x0)]});
            if (x1 > x) least = std::min({least, row[x1], other_rows[size_t(x1)]});
            row[x] = std::min<uint16_t>(most, uint16_t(least + 1));
        }
    }
    return reach;
}

/// What V may see in a great many bins counts as anywhere where there is much of it: depth maps full of unmeasured
/// pixels, whose walls reach far.
void limit_bins(std::vector<TileRow>& tiles) {
    constexpr int64_t many = 64, most = 1 << 24;
    const auto count = [](const Bins& b) { return int64_t(b.x1 - b.x0 + 1) * (b.y1 - b.y0 + 1); };
    int64_t all = 0;
    const auto each = [&](auto&& visit) {
        for (TileRow& row : tiles)
            for (size_t x = 0; x < row.low.size(); ++x) {
                visit(row.pixels[x], row.anywhere[x], 1);
                visit(row.surface[x], row.anywhere[x], 2);
            }
    };
    each([&](const Bins& bins, uint8_t& anywhere, int bit) {
        if (!(anywhere & bit) && count(bins) > many) all += count(bins);
    });
    if (all <= most) return;
    each([&](const Bins& bins, uint8_t& anywhere, int bit) {
        if (count(bins) > many) anywhere |= uint8_t(bit);
    });
}

/// How far the way to V stays among tiles along one axis, at least, for each unit of 1/z: tiles of `size` pixels.
std::vector<float> stays(int count, int size, double centre, double centre_z, bool stands_still) {
    std::vector<float> all;
    for (int i = 0; i < count; ++i) {
        const auto way = [&](int at) { return std::fabs(centre - centre_z * double(at) * size); };
        const double steepest = stands_still ? 0 : std::max(way(i), way(i + 1));
        all.push_back(steepest > 0 ? float(std::min(size / steepest, 1e30)) : 1e30f);
    }
    return all;
}

}  // namespace

RayFilter::RayFilter(const Surface& surface, const glm::dvec3& centre_m) {
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
    const bool only_rows = (left > 0) == (right > 0) && !extent.invalid && off < most_off_row_share * k.width &&
                           off + miss_px * extent.largest < most_off_row_px;
    height_shift_ = only_rows ? 0 : 1;
    const int tile_height = 1 << height_shift_;
    const int columns = (k.width + tile_width - 1) / tile_width, rows = (k.height + tile_height - 1) / tile_height;
    asks_ = Grid<uint8_t>(columns, rows, 1), meets_ = Grid<uint8_t>(columns, rows, 1);
    if (!surface.error.none()) return;  // rays then start off the surface

    const Setting setting{{float(centre_x), columns, 3 * columns},
                          {float(centre_y), only_rows ? 0 : rows / 2, only_rows ? rows : 2 * rows},
                          float(centre_m.z),
                          surface.slack,
                          surface.slack_share,
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
    if (!only_rows) limit_bins(tiles);
    const Order across(columns, tile_width, centre_x, centre_m.z, false);
    const Order down(rows, tile_height, centre_y, centre_m.z, only_rows);
    const Grid<uint16_t> reach = gentle_reach(tiles, across, down, false);
    const Grid<uint16_t> reach_back = gentle_reach(tiles, across, down, true);
    const std::vector<float> stays_across = stays(columns, tile_width, centre_x, centre_m.z, false),
                             stays_down = stays(rows, tile_height, centre_y, centre_m.z, only_rows);
    // By how much 1/z of the segments that pass tile (x, y) changes at least over so many tiles: with 1/z they move by
    // `way` over R's picture, per 1 - centre_z w.
    const auto rise = [&](size_t x, size_t y, int tiles_on) {
        const TileRow& row = tiles[y];
        const float clear = std::max(0.0f, 1 - std::max(setting.centre_z * row.low[x], setting.centre_z * row.high[x]));
        return surely * clear * float(tiles_on) * std::min(stays_across[x], stays_down[y]);
    };

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
        for (int x = 0; x < columns; ++x) {
            const size_t at = size_t(x);
            if (const int tiles_on = reach.at(x, y) - 1; tiles_on > 0 && !(row.anywhere[at] & 1)) {
                // As far as all is gentle nothing that the segment meets is nearer than this.
                const float allowed = row.low[at] + rise(at, size_t(y), tiles_on);
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
            // What begins on the gentle way to here passes above; what begins before it must have begun as far below.
            const int tiles_back = std::max(0, reach_back.at(x, y) - 1);
            const float high = row.high[at] - rise(at, size_t(y), tiles_back);
            bool met = farthest.anywhere <= high || (row.anywhere[at] & 2 && !only_rows);
            if (!met) farthest.visit(row.surface[at], [&](float& bin) { met = met || bin <= high; });
            meets_.at(x, y) = row.high[at] > 0 && met;
        }
    });
    if (!only_rows) return;
    // Rays along a row run between the cells above it and those below.
    for (int y = 0; y + 1 < rows; ++y)
        for (int x = 0; x < columns; ++x) meets_.at(x, y) |= meets_.at(x, y + 1);
}

}  // namespace vshift
