// SPDX-License-Identifier: Apache-2.0
#include "embree_core/height_field.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "embree_core/lift_kernels.h"
#include "embree_core/ray_filter.h"

namespace vshift {

using namespace heights;

namespace {

// Rays often run along the border of a tile's box; in packets Embree misses such boxes.
constexpr float margin_px = 0.01f;
// Embree leaves out what lies farther off than some 1.8e18: walls beside unmeasured pixels may.
constexpr float farthest_px = 1e18f;

/// 1/z at a quarter's corners, by corner of the cell (surface_field.h): its own pixel, half the edges from there, the
/// cell's centre.
void write_quarters(const SplitCell& cell, const std::array<float, 4>& own, float wall_top, float* out) {
    for (int c = 0; c < 4; ++c) {
        float* quarter = out + 4 * (2 * corner_dy[c] + corner_dx[c]);
        if (cell.state[size_t(c)] != Pixel::solid) {
            const float flat = cell.state[size_t(c)] == Pixel::sky       ? 0
                               : cell.state[size_t(c)] == Pixel::invalid ? wall_top
                                                                         : std::numeric_limits<float>::quiet_NaN();
            std::fill_n(quarter, 4, flat);
            continue;
        }
        const bool next_is_x = c % 2 == 0;
        const float next = cell.towards_next[size_t(c)], last = cell.towards_last[size_t(c)];
        const int x = corner_dx[c], y = corner_dy[c];
        quarter[2 * y + x] = own[size_t(c)];
        quarter[2 * y + 1 - x] = next_is_x ? next : last;
        quarter[2 * (1 - y) + x] = next_is_x ? last : next;
        quarter[2 * (1 - y) + 1 - x] = cell.centre[size_t(cell.part[size_t(c)])];
    }
}

}  // namespace

/// Adds the tile of cells from (x, y) on, if it holds anything. `kinds`: of each of its rows of cells, which are whole.
void HeightField::Row::add(const SurfaceField& field, float wall_top, const uint8_t* const* kinds, int x, int y) {
    const int width = field.w.width, height = field.w.height;
    Tile tile{x, y, std::numeric_limits<float>::infinity(), 0, nullptr, nullptr};
    const auto cover = [&](float value) {
        if (std::isnan(value)) return;
        tile.low = std::min(tile.low, value), tile.high = std::max(tile.high, value);
    };
    const auto is_whole = [&](int cx, int cy) {
        return cx >= 0 && cy >= 0 && cx + 1 < width && cy + 1 < height && kinds[cy - y][cx];
    };
    bool all_whole = true;
    for (int cy = y; cy < y + tile_cells; ++cy)
        for (int cx = x; cx < x + tile_cells; ++cx) all_whole = all_whole && is_whole(cx, cy);
    if (all_whole) {
        for (int py = y; py <= y + tile_cells; ++py)
            for (int px = x; px <= x + tile_cells; ++px) cover(field.w.at(px, py));
        tile.w = &field.w.at(x, y);
        made.push_back({tile, 0, 0});
        return;
    }
    const size_t first = values.size(), first_code = codes.size();
    codes.resize(first_code + tile_cells * tile_cells);
    bool solid = false;
    int32_t flats[2] = {0, 0};  // the codes of cells that hold nothing, once there are such
    for (int cy = y; cy < y + tile_cells; ++cy)
        for (int cx = x; cx < x + tile_cells; ++cx) {
            int32_t& code = codes[first_code + size_t((cy - y) * tile_cells + cx - x)];
            if (is_whole(cx, cy)) {
                code = int32_t(2 * (values.size() - first));
                solid = true;
                const float *upper = &field.w.at(cx, cy), *lower = upper + width;
                for (const float value : {upper[0], upper[1], lower[0], lower[1]}) {
                    values.push_back(value);
                    cover(value);
                }
                continue;
            }
            bool sky = false, invalid = false, any = false;
            std::array<float, 4> own{};
            for (int c = 0; c < 4; ++c) {
                const int px = cx + corner_dx[c], py = cy + corner_dy[c];
                const Pixel state = field.state(px, py);
                sky |= state == Pixel::sky, invalid |= state == Pixel::invalid, any |= state == Pixel::solid;
                if (state == Pixel::solid) own[size_t(c)] = field.w.at(px, py);
            }
            const bool flat = !any && !(sky && invalid);
            if (flat && flats[invalid]) {
                code = flats[invalid];
                continue;
            }
            code = int32_t(2 * (values.size() - first) + 1);
            values.resize(values.size() + 16);
            float* const written = &values[values.size() - 16];
            if (flat) {
                flats[invalid] = code;
                std::fill_n(written, 16, invalid ? wall_top : 0);
            } else {
                solid = true;
                write_quarters(split_cell(field, cx, cy), own, wall_top, written);
            }
            std::for_each_n(written, 16, cover);
        }
    if (solid) {
        made.push_back({tile, first_code, first});
    } else {
        values.resize(first);
        codes.resize(first_code);
    }
}

HeightField::HeightField(const SurfaceField& field, float wall_top, const RayFilter* filter, float px_per_inverse_depth)
    : surface_{field.w.width, wall_top}, px_per_inverse_depth_(px_per_inverse_depth) {
    const int width = field.w.width, height = field.w.height;
    const int columns = width / tile_cells + 1;
    rows_.resize(size_t(height / tile_cells + 1));
    tbb::parallel_for(size_t(0), rows_.size(), [&](size_t row) {
        const int y = int(row) * tile_cells - 1;
        std::vector<uint8_t> kinds;
        std::array<const uint8_t*, tile_cells> of{};
        for (int column = 0; column < columns; ++column) {
            const int x = column * tile_cells - 1;
            if (filter && !filter->meets_any(x, y, x + tile_cells - 1, y + tile_cells - 1)) continue;
            if (kinds.empty()) {
                kinds.resize(size_t(width) * tile_cells);
                for (int i = 0; i < tile_cells; ++i) {
                    of[size_t(i)] = &kinds[size_t(i) * size_t(width)];
                    if (y + i < 0 || y + i + 1 >= height || width < 2) continue;
                    lifting::kernels().whole(&field.w.at(0, y + i), &field.w.at(0, y + i + 1),
                                             &field.tears.at(0, y + i), &field.tears.at(0, y + i + 1),
                                             size_t(width) - 1, &kinds[size_t(i) * size_t(width)]);
                }
            }
            rows_[row].add(field, wall_top, of.data(), x, y);
        }
    });
    for (Row& row : rows_) {
        for (Row::Made& made : row.made) {
            if (!made.tile.w)
                made.tile.w = &row.values[made.first_value], made.tile.codes = &row.codes[made.first_code];
            highest_ = std::max(highest_, made.tile.high);
            tiles_.push_back(made.tile);
        }
        row.made = {};
    }
    std::vector<TracedBoxes::Box> boxes;
    boxes.reserve(tiles_.size());
    for (const Tile& tile : tiles_) {
        const glm::vec3 first(tile.x, tile.y, tile.low * px_per_inverse_depth_);
        const glm::vec3 last(tile.x + tile_cells, tile.y + tile_cells,
                             std::min(tile.high * px_per_inverse_depth_, farthest_px));
        boxes.push_back({first - margin_px, last + margin_px});
    }
    boxes_ = TracedBoxes(boxes);
}

Met HeightField::meet(Rays& rays, uint32_t asked) const {
    RayPacket packet;
    static_assert(RayPacket::size == packet_rays);
    for (int i = 0; i < packet_rays; ++i) {
        // Above everything.
        if (rays.dw[i] > 0) rays.end[i] = std::min(rays.end[i], 1.001f * (highest_ - rays.w[i]) / rays.dw[i]);
        packet.set(i, {rays.x[i], rays.y[i], rays.w[i] * px_per_inverse_depth_},
                   {rays.dx[i], rays.dy[i], rays.dw[i] * px_per_inverse_depth_}, 0, rays.end[i]);
    }
    Met met;
    const auto& kernel = kernels();
    boxes_.visit(packet, asked, [&](uint32_t tile, uint32_t lanes) {
        const Met here = kernel.march(surface_, tiles_[tile], rays, lanes);
        met.kept |= here.kept, met.torn |= here.torn;
        return here.kept;
    });
    return met;
}

size_t HeightField::bytes() const {
    size_t all = boxes_.bytes() + tiles_.size() * sizeof(Tile);
    for (const Row& row : rows_) all += row.codes.size() * sizeof(int32_t) + row.values.size() * sizeof(float);
    return all;
}

}  // namespace vshift
