// SPDX-License-Identifier: Apache-2.0
#include "embree_core/ray_filter.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <limits>

namespace vshift {
namespace {

// Slopes up to this share of the segments' count as less steep.
constexpr double surely = 0.9;
// Nearer to V's plane than this share of R's depth, boxes mean nothing.
constexpr double least_clear = 0.05;

struct Range {
    double low = std::numeric_limits<double>::infinity(), high = -low;
    void add(double v) { low = std::min(low, v), high = std::max(high, v); }
};
struct Box {
    Range u, v;
};

/// Cells (x, y) with x0 <= x < x1, y0 <= y < y1, and the half pixel beyond them.
struct Tile {
    float low = 0, high = 0;  ///< 1/z of its surfaces and walls
    bool smooth = false;
};

/// R's pixels as V sees them with R's orientation: (u - centre.x w, v - centre.y w) / (1 - centre.z w).
struct Projection {
    glm::dvec3 centre;  ///< of V, as R's homogeneous pixel times its depth

    double clear(double w) const { return 1 - centre.z * w; }
    Box box(double u0, double u1, double v0, double v1, double low, double high) const {
        Box out;
        // Both are monotonous in w and in the pixel.
        for (const double w : {low, high}) {
            for (const double u : {u0, u1}) out.u.add((u - centre.x * w) / clear(w));
            for (const double v : {v0, v1}) out.v.add((v - centre.y * w) / clear(w));
        }
        return out;
    }
};

/// The largest product of a value in each range.
double largest_product(double a0, double a1, double b0, double b1) {
    return std::max(std::max(a0 * b0, a0 * b1), std::max(a1 * b0, a1 * b1));
}

Tile read_tile(const LiftedMesh& mesh, const Projection& to, int x0, int x1, int y0, int y1) {
    const Grid<float>& w = mesh.inverse_depth;
    float low = std::numeric_limits<float>::infinity(), high = 0, step_low_x = 0, step_high_x = 0, step_low_y = 0,
          step_high_y = 0;
    bool whole = true, sky = false, invalid = false;
    const int last_x = std::min(x1, w.width - 1), last_y = std::min(y1, w.height - 1);
    for (int y = y0; y <= last_y; ++y) {
        const float* row = &w.data[size_t(y) * size_t(w.width)];
        const float* below = y < last_y ? row + w.width : row;
        const uint8_t* tears = &mesh.tears.data[size_t(y) * size_t(w.width)];
        for (int x = x0; x <= last_x; ++x) {
            const float own = row[x];
            const uint8_t torn = uint8_t(tears[x] & ((x < last_x ? 1 : 0) | (y < last_y ? 2 : 0)));
            whole &= torn == 0;
            invalid |= !(own >= 0);
            sky |= own == 0;
            low = std::min(low, own), high = std::max(high, own);
            const float right = x < last_x && !(torn & 1) ? row[x + 1] - own : 0;
            const float down = !(torn & 2) ? below[x] - own : 0;
            step_low_x = std::min(step_low_x, right), step_high_x = std::max(step_high_x, right);
            step_low_y = std::min(step_low_y, down), step_high_y = std::max(step_high_y, down);
        }
    }
    Tile tile;
    if (invalid) {
        tile.high = mesh.wall_top;
        return tile;
    }
    tile.low = low, tile.high = high;
    if (high == 0) {
        tile.smooth = true;
        return tile;
    }
    const double clear = std::min(to.clear(low), to.clear(high));
    const auto way = [](double centre, double centre_z, double at) { return centre - centre_z * at; };
    const double rise = largest_product(way(to.centre.x, to.centre.z, x0), way(to.centre.x, to.centre.z, x1 + 1),
                                        step_low_x, step_high_x) +
                        largest_product(way(to.centre.y, to.centre.z, y0), way(to.centre.y, to.centre.z, y1 + 1),
                                        step_low_y, step_high_y);
    tile.smooth = whole && !sky && clear > least_clear && rise < surely * clear;
    // Surfaces go on by half a pixel beyond a tear or the border (surface_field.h).
    const float beyond = std::max(step_high_x, -step_low_x) + std::max(step_high_y, -step_low_y);
    tile.low = std::max(low - beyond, 0.5f * low), tile.high = std::min(high + beyond, 2.0f * high);
    return tile;
}

}  // namespace

RayFilter::RayFilter(const LiftedMesh& mesh, const glm::dvec3& centre_m) {
    const Intrinsics& k = mesh.intrinsics;
    const Projection to{
        {k.fx * centre_m.x + k.cx * centre_m.z, k.fy * centre_m.y + k.cy * centre_m.z, centre_m.z}};
    // Where segments keep to the rows, low tiles keep the rows apart.
    const bool in_rows = std::fabs(k.fy * centre_m.y) + k.height * std::fabs(centre_m.z) < 0.01 * k.fx * std::fabs(centre_m.x);
    tile_height_ = in_rows ? 2 : 4;
    const int columns = (k.width + tile_width - 1) / tile_width, rows = (k.height + tile_height_ - 1) / tile_height_;
    clear_ = Grid<uint8_t>(columns, rows, 0);
    if (!mesh.error.none()) return;  // rays then start off the surface

    Grid<Tile> tiles(columns, rows);
    tbb::parallel_for(0, rows, [&](int ty) {
        for (int tx = 0; tx < columns; ++tx)
            tiles.at(tx, ty) = read_tile(mesh, to, tx * tile_width, (tx + 1) * tile_width, ty * tile_height_,
                                         (ty + 1) * tile_height_);
    });

    // Bins of V's picture, of a tile's size; what lies beyond them counts as in the outermost.
    Grid<float> nearest(3 * columns, 2 * rows, 0.0f);
    const auto bins = [&](const Box& box) {
        const auto bin = [](double at, double size, int before, int count) {
            return int(std::clamp(std::floor(at / size) + before, 0.0, double(count - 1)));
        };
        const double height = tile_height_;
        return std::array<int, 4>{bin(box.u.low, tile_width, columns, nearest.width),
                                  bin(box.u.high, tile_width, columns, nearest.width),
                                  bin(box.v.low, height, rows / 2, nearest.height),
                                  bin(box.v.high, height, rows / 2, nearest.height)};
    };
    const auto box_of = [&](int tx, int ty) {
        const Tile& tile = tiles.at(tx, ty);
        const double x0 = tx * tile_width, y0 = ty * tile_height_;
        return to.box(x0, x0 + tile_width + 1, y0, y0 + tile_height_ + 1, tile.low, tile.high);
    };
    for (int ty = 0; ty < rows; ++ty)
        for (int tx = 0; tx < columns; ++tx) {
            const Tile& tile = tiles.at(tx, ty);
            if (tile.high == 0) continue;
            std::array<int, 4> at{0, nearest.width - 1, 0, nearest.height - 1};
            if (std::min(to.clear(tile.low), to.clear(tile.high)) > least_clear) at = bins(box_of(tx, ty));
            for (int y = at[2]; y <= at[3]; ++y)
                for (int x = at[0]; x <= at[1]; ++x) nearest.at(x, y) = std::max(nearest.at(x, y), tile.high);
        }

    const auto smooth = [&](int tx, int ty) {
        return tx < 0 || ty < 0 || tx >= columns || ty >= rows || tiles.at(tx, ty).smooth;
    };
    tbb::parallel_for(0, rows, [&](int ty) {
        for (int tx = 0; tx < columns; ++tx) {
            bool all = true;
            for (int dy = -1; dy <= 1; ++dy)
                for (int dx = -1; dx <= 1; ++dx) all = all && smooth(tx + dx, ty + dy);
            if (!all) continue;
            const Box box = box_of(tx, ty);
            // With 1/z a point of the same place in V's picture moves over R's picture by this many pixels.
            const double along = std::max(std::fabs(to.centre.x - to.centre.z * box.u.low),
                                          std::fabs(to.centre.x - to.centre.z * box.u.high));
            const double across = std::max(std::fabs(to.centre.y - to.centre.z * box.v.low),
                                           std::fabs(to.centre.y - to.centre.z * box.v.high));
            // One pixel less than a tile: from its own pixels' border to the neighbours' far one.
            const double reach = surely * std::min((tile_width - 1) / along, (tile_height_ - 1) / across);
            const double allowed = tiles.at(tx, ty).low + reach;
            const auto at = bins(box);
            bool clear = true;
            for (int y = at[2]; y <= at[3]; ++y)
                for (int x = at[0]; x <= at[1]; ++x) clear = clear && nearest.at(x, y) <= allowed;
            clear_.at(tx, ty) = clear;
        }
    });
}

}  // namespace vshift
