// SPDX-License-Identifier: Apache-2.0
#include <tbb/parallel_for.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>

#include "embree_core/lift_kernels.h"
#include "embree_core/raster_map.h"
#include "embree_core/surface_field.h"

// Signs of edge functions must be exact opposites for the two triangles at an edge: built without fused operations.

namespace vshift {
namespace {

using raster::Bounds;
using raster::ceiling;
using raster::Corner;
using raster::FloatMap;
using raster::nearest_share;
using raster::Range;
using raster::reach_of;

// Cells are taken in tiles, pixels of V in bands of rows. A band belongs to one task, and tiles come in order: the
// result does not depend on who did what.
constexpr int tile_columns = raster::most_cells, tile_rows = 16, band_rows = 64, block = 16;
// Walls that meet leave no gap.
constexpr float wall_reach_px = 1.0f / 512;
static_assert(uint8_t(Sight::none) == raster::no_surface && uint8_t(Sight::seen) == raster::front &&
              uint8_t(Sight::back_face) == raster::back && uint8_t(Sight::behind_wall) == raster::walled);

/// Whether a pixel exactly on the edge a -> b belongs to the triangle on its inner side.
bool owns_edge(float dx, float dy) {
    return dy < 0 || (dy == 0 && dx > 0);
}

/// The floor's least value in every block of pixels.
struct Blocks {
    int columns = 0, rows = 0;
    std::vector<float> least;

    explicit Blocks(const Grid<float>& floor)
        : columns((floor.width + block - 1) / block),
          rows((floor.height + block - 1) / block),
          least(size_t(columns) * size_t(rows), std::numeric_limits<float>::infinity()) {
        tbb::parallel_for(0, rows, [&](int by) {
            const int y0 = by * block, y1 = std::min(y0 + block, floor.height);
            for (int bx = 0; bx < columns; ++bx) {
                const int n = std::min(block, floor.width - bx * block);
                float lows[block];
                std::fill_n(lows, block, std::numeric_limits<float>::infinity());
                for (int y = y0; y < y1; ++y) {
                    const float* row = &floor.at(bx * block, y);
                    if (n == block)
                        for (int i = 0; i < block; ++i) lows[i] = row[i] < lows[i] ? row[i] : lows[i];
                    else
                        for (int i = 0; i < n; ++i) lows[i] = row[i] < lows[i] ? row[i] : lows[i];
                }
                least[size_t(by) * size_t(columns) + size_t(bx)] = *std::min_element(lows, lows + block);
            }
        });
    }
    /// Whether a surface whose 1/Z stays below `highest` could rise above the floor.
    bool any(const Range& r, float highest) const {
        for (int y = r.y0 / block; y * block < r.y1; ++y)
            for (int x = r.x0 / block; x * block < r.x1; ++x)
                if (least[size_t(y) * size_t(columns) + size_t(x)] < highest) return true;
        return false;
    }
};

struct Tile {
    int x = 0, y = 0;
    Bounds w;
    Range reach;      ///< pixels of V that it can touch
    float highest_q;  ///< in V
};

/// One band of V's rows.
class Band {
public:
    Band(const SurfaceView& view, const FloatMap& map, const Grid<float>* floor, Reprojection& out, int y0, int y1)
        : field_{view.inverse_depth, view.tears},
          view_(view),
          map_(map),
          floor_(floor),
          out_(out),
          width_(out.sight.width),
          y0_(y0),
          y1_(y1) {
        for (int y = y0; y < y1; ++y) {
            const size_t begin = size_t(y) * size_t(width_) + size_t(out.x0), n = size_t(out.x1 - out.x0);
            if (floor)
                std::copy_n(&floor->data[begin], n, &out.inverse_depth.data[begin]);
            else
                std::fill_n(&out.inverse_depth.data[begin], n, 0.0f);
            std::fill_n(&out.wall[begin], n, 0.0f);
        }
    }

    void draw(const Tile& tile) {
        const int last_x = std::min(tile.x + tile_columns, field_.w.width),
                  last_y = std::min(tile.y + tile_rows, field_.w.height);
        // Cells with all four corners in the image.
        const int x0 = std::max(tile.x, 0), x1 = std::min(last_x, field_.w.width - 1);
        const raster::Window window{float(width_), float(y0_), float(y1_)};
        const raster::Kernels& kernels = raster::kernels();
        raster::Row* above = &rows_[0];
        raster::Row* below = &rows_[1];
        int have = -2;  // the row of pixels in `below`
        for (int y = tile.y; y < last_y; ++y) {
            const Range reach =
                reach_of(map_, float(tile.x), float(last_x), float(y), float(y + 1), tile.w, width_, y1_);
            if (reach.empty() || reach.y1 <= y0_) continue;
            if (y < 0 || y + 1 >= field_.w.height) {
                for (int x = tile.x; x < last_x; ++x) draw_split(x, y);
                continue;
            }
            if (have == y)
                std::swap(above, below);
            else
                load(x0, x1, y, *above);
            load(x0, x1, y + 1, *below);
            have = y + 1;
            if (tile.x < x0) draw_split(tile.x, y);
            if (x1 < last_x) draw_split(x1, y);
            if (x0 >= x1) continue;
            kernels.cells(*above, *below, float(x0), float(y), window, size_t(x1 - x0), cells_);
            put_cells(x0, y, x1 - x0, *above, *below);
        }
    }

    /// Sky where nothing stands, and what walls hide.
    void finish(const ProjectiveMap& sky_map, const Intrinsics& recorded) {
        const size_t n = size_t(out_.x1 - out_.x0);
        std::vector<uint8_t> open(n);
        const double right = recorded.width, bottom = recorded.height;
        for (int y = y0_; y < y1_; ++y) {
            const size_t first = size_t(y) * size_t(width_) + size_t(out_.x0);
            raster::kernels().settle(floor_ ? &floor_->data[first] : nullptr, &out_.wall[first], n,
                                     &out_.inverse_depth.data[first], &out_.source_px.data[first].x,
                                     reinterpret_cast<uint8_t*>(&out_.sight.data[first]), open.data());
            if (view_.sky_px == 0) continue;
            const glm::dvec3 row = sky_map.turn[1] * (y + 0.5) + sky_map.turn[2];
            for (size_t i = 0; i < n; ++i) {
                if (uint64_t eight; i + 8 <= n) {
                    std::memcpy(&eight, &open[i], 8);
                    if (eight == 0) {
                        i += 7;
                        continue;
                    }
                }
                if (!open[i]) continue;
                const glm::dvec3 h = sky_map.turn[0] * (out_.x0 + int(i) + 0.5) + row;
                if (!(h.z > 1e-9)) continue;
                const double share = 1 / h.z, u = h.x * share, v = h.y * share;
                if (!(u >= 0 && u < right && v >= 0 && v < bottom) || field_.w.at(int(u), int(v)) != 0) continue;
                out_.source_px.data[first + i] = glm::vec2(float(u), float(v));
                if (Sight& sight = out_.sight.data[first + i]; sight == Sight::none) sight = Sight::sky;
            }
        }
    }

private:
    SurfaceField field_;
    const SurfaceView& view_;
    const FloatMap& map_;
    const Grid<float>* floor_;
    Reprojection& out_;
    int width_, y0_, y1_;

    raster::Row rows_[2];
    raster::Cells cells_;

    void load(int x0, int x1, int y, raster::Row& row) const {
        const size_t at = size_t(y) * size_t(field_.w.width) + size_t(x0), n = size_t(x1 - x0 + 1);
        std::copy_n(&field_.w.data[at], n, row.w);
        std::copy_n(&field_.tears.data[at], n, row.tears);
        raster::kernels().transform(map_, float(x0), float(y), n, row);
    }

    /// What the kernel found, under the z-test; cells that it leaves to us.
    void put_cells(int x0, int y, int n, const raster::Row& above, const raster::Row& below) {
        float* const depth = out_.inverse_depth.data.data();
        glm::vec2* const source = out_.source_px.data.data();
        const size_t width = size_t(width_);
        for (int i = 0; i < n; ++i) {
            const int kind = cells_.kind[i];
            if (kind == raster::nothing) continue;
            if (kind == raster::split) {
                draw_split(x0 + i, y);
                continue;
            }
            if (kind == raster::wide) {
                draw_wide(x0 + i, y, above, below, i);
                continue;
            }
            const size_t first = size_t(cells_.y[i]) * width + size_t(cells_.x[i]);
            for (unsigned hits = unsigned(cells_.hits[i]); hits; hits &= hits - 1) {
                const int k = std::countr_zero(hits);
                const size_t at = first + (k < raster::most_across ? size_t(k) : size_t(k - raster::most_across) + width);
                const float q = cells_.q[k][i];
                if (!(q > depth[at])) continue;
                depth[at] = q;
                source[at] = {cells_.u[k][i], cells_.v[k][i]};
            }
        }
    }

    /// Pixels whose centres may lie inside; at the far sides the edge rule gives them to the next triangle.
    Range candidates(float x0, float x1, float y0, float y1) const {
        const float left = 0, right = float(width_), top = float(y0_), bottom = float(y1_);
        return {ceiling(std::clamp(x0, left, right)), ceiling(std::clamp(x1, left, right)),
                ceiling(std::clamp(y0, top, bottom)), ceiling(std::clamp(y1, top, bottom))};
    }

    /// A cell that covers more pixels than the kernel takes, or is seen from behind.
    void draw_wide(int cx, int cy, const raster::Row& a, const raster::Row& b, int i) {
        const auto corner = [&](const raster::Row& row, int c) {
            const int at = i + corner_dx[c];
            return Corner{row.x[at],
                          row.y[at],
                          row.q[at],
                          row.r[at],
                          float(cx) + float(corner_dx[c]),
                          float(cy) + float(corner_dy[c])};
        };
        const Corner c[4] = {corner(a, 0), corner(a, 1), corner(b, 2), corner(b, 3)};
        triangle(c[0], c[1], c[3]);
        triangle(c[2], c[3], c[1]);
    }

    void triangle(Corner a, Corner b, Corner c) {
        if (!(a.r > 0 && b.r > 0 && c.r > 0)) return;
        float area = (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
        if (area == 0 || !std::isfinite(area)) return;
        const float back = area > 0 ? 0.0f : raster::back_mark;
        if (area < 0) std::swap(b, c);
        const Range box = candidates(std::min(a.x, std::min(b.x, c.x)), std::max(a.x, std::max(b.x, c.x)),
                                     std::min(a.y, std::min(b.y, c.y)), std::max(a.y, std::max(b.y, c.y)));
        for (int y = box.y0; y < box.y1; ++y)
            for (int x = box.x0; x < box.x1; ++x) {
                const float px = float(x), py = float(y);
                const auto edge = [&](const Corner& p, const Corner& q) {
                    return (p.x - px) * (q.y - py) - (p.y - py) * (q.x - px);
                };
                const auto inside = [&](float e, const Corner& p, const Corner& q) {
                    return e > 0 || (e == 0 && owns_edge(q.x - p.x, q.y - p.y));
                };
                const float ea = edge(b, c), eb = edge(c, a), ec = edge(a, b);
                if (!inside(ea, b, c) || !inside(eb, c, a) || !inside(ec, a, b)) continue;
                const float sum = ea + eb + ec;
                if (!(sum > 0)) continue;
                const float q = (ea * a.q + eb * b.q + ec * c.q) / sum;
                if (!(q > out_.inverse_depth.at(x, y))) continue;
                const float ra = ea * a.r, rb = eb * b.r, rc = ec * c.r, share = 1 / (ra + rb + rc);
                out_.inverse_depth.at(x, y) = q;
                out_.source_px.at(x, y) = {(ra * a.u + rb * b.u + rc * c.u) * share + 0.5f - back,
                                           (ra * a.v + rb * b.v + rc * c.v) * share + 0.5f};
            }
    }

    void draw_split(int cx, int cy) {
        const SplitCell cell = split_cell(field_, cx, cy);
        const float mu = float(cx) + 0.5f, mv = float(cy) + 0.5f;
        // Where each corner's surface meets the edges to its neighbours in the ring (what is joined meets at one point)
        // and the cell's centre.
        Corner to_next[4], to_last[4], centres[4];
        for (int c = 0; c < 4; ++c) {
            const int n = (c + 1) % 4;
            const float u = float(cx) + 0.5f * float(corner_dx[c] + corner_dx[n]);
            const float v = float(cy) + 0.5f * float(corner_dy[c] + corner_dy[n]);
            if (cell.part[c] >= 0) to_next[c] = map_.corner(u, v, cell.towards_next[c]);
            if (cell.joined_next[c])
                to_last[n] = to_next[c];
            else if (cell.part[n] >= 0)
                to_last[n] = map_.corner(u, v, cell.towards_last[n]);
            if (cell.part[c] == c) centres[c] = map_.corner(mu, mv, cell.centre[c]);
        }
        for (int c = 0; c < 4; ++c) {
            if (cell.part[c] < 0) continue;
            const int x = cx + corner_dx[c], y = cy + corner_dy[c];
            const Corner own = map_.corner(float(x), float(y), field_.w.at(x, y));
            const Corner &centre = centres[cell.part[c]], &first = to_next[c], &last = to_last[c];
            if (candidates(std::min(std::min(own.x, centre.x), std::min(first.x, last.x)),
                           std::max(std::max(own.x, centre.x), std::max(first.x, last.x)),
                           std::min(std::min(own.y, centre.y), std::min(first.y, last.y)),
                           std::max(std::max(own.y, centre.y), std::max(first.y, last.y)))
                    .empty())
                continue;
            triangle(own, first, last);
            triangle(centre, last, first);
        }
        for (int c = 0; c < 4; ++c) {
            const int n = (c + 1) % 4;
            if (cell.state[c] == Pixel::missing || cell.state[n] == Pixel::missing || cell.joined_next[c]) continue;
            const auto heights = [&](int corner, bool to_next) -> std::array<float, 2> {
                switch (cell.state[corner]) {
                    case Pixel::solid:
                        return {to_next ? cell.towards_next[corner] : cell.towards_last[corner],
                                cell.centre[cell.part[corner]]};
                    case Pixel::sky:
                        return {0, 0};
                    default:
                        return {view_.wall_top, view_.wall_top};
                }
            };
            const auto from = heights(c, true), to = heights(n, false);
            if (from == to) continue;
            const float u = float(cx) + 0.5f * float(corner_dx[c] + corner_dx[n]);
            const float v = float(cy) + 0.5f * float(corner_dy[c] + corner_dy[n]);
            wall(u, v, mu, mv, from, to);
        }
    }

    struct WallPoint {
        glm::vec3 h;
        float w;
    };
    void wall(float u0, float v0, float u1, float v1, std::array<float, 2> from, std::array<float, 2> to) {
        WallPoint points[8] = {{map_.at(u0, v0, from[0]), from[0]},
                               {map_.at(u1, v1, from[1]), from[1]},
                               {map_.at(u1, v1, to[1]), to[1]},
                               {map_.at(u0, v0, to[0]), to[0]}};
        int count = 4;
        bool behind = false;
        for (int i = 0; i < 4; ++i) behind |= !(points[i].h.z > nearest_share);
        if (behind) {
            WallPoint kept[8];
            int n = 0;
            for (int i = 0; i < 4; ++i) {
                const WallPoint &a = points[i], &b = points[(i + 1) % 4];
                const float da = a.h.z - nearest_share, db = b.h.z - nearest_share;
                if (da > 0) kept[n++] = a;
                if ((da > 0) != (db > 0)) {
                    const float t = da / (da - db);
                    kept[n] = {a.h + t * (b.h - a.h), a.w + t * (b.w - a.w)};
                    kept[n].h.z = std::max(kept[n].h.z, 0.5f * nearest_share);
                    ++n;
                }
            }
            if (n < 3) return;
            std::copy(kept, kept + n, points);
            count = n;
        }
        float x[8], y[8], q[8];
        float top = std::numeric_limits<float>::infinity(), bottom = -top;
        for (int i = 0; i < count; ++i) {
            const float r = 1 / points[i].h.z;
            x[i] = points[i].h.x * r, y[i] = points[i].h.y * r, q[i] = points[i].w * r;
            top = std::min(top, y[i]), bottom = std::max(bottom, y[i]);
        }
        const int first = int(std::ceil(std::clamp(top - wall_reach_px, float(y0_), float(y1_))));
        const int last = int(std::floor(std::clamp(bottom + wall_reach_px, float(y0_ - 1), float(y1_ - 1))));
        for (int row = first; row <= last; ++row) {
            const float level = std::clamp(float(row), top, bottom);
            float left = std::numeric_limits<float>::infinity(), right = -left, q_left = 0, q_right = 0;
            const auto take = [&](float at, float value) {
                if (at < left) left = at, q_left = value;
                if (at > right) right = at, q_right = value;
            };
            for (int i = 0; i < count; ++i) {
                const int n = i + 1 == count ? 0 : i + 1;
                if ((y[i] < level && y[n] < level) || (y[i] > level && y[n] > level)) continue;
                if (y[i] == y[n]) {
                    take(x[i], q[i]);
                    take(x[n], q[n]);
                } else {
                    const float t = (level - y[i]) / (y[n] - y[i]);
                    take(x[i] + t * (x[n] - x[i]), q[i] + t * (q[n] - q[i]));
                }
            }
            if (!(left <= right)) continue;
            const int x0 = int(std::ceil(std::clamp(left - wall_reach_px, 0.0f, float(width_))));
            const int x1 = int(std::floor(std::clamp(right + wall_reach_px, -1.0f, float(width_ - 1))));
            const float slope = right > left ? (q_right - q_left) / (right - left) : 0;
            float* to_wall = &out_.wall[size_t(row) * size_t(width_)];
            for (int px = x0; px <= x1; ++px) {
                const float at = std::clamp(float(px), left, right);
                to_wall[px] = std::max(to_wall[px], q_left + slope * (at - left));
            }
        }
    }
};

/// Bounds of 1/z on and between a tile's surfaces; low > high: nothing there.
Bounds bounds_of(const SurfaceView& view, int tile_x, int tile_y) {
    const Grid<float>& w = view.inverse_depth;
    const int x0 = std::max(tile_x, 0), x1 = std::min(tile_x + tile_columns, w.width - 1);
    const int y0 = std::max(tile_y, 0), y1 = std::min(tile_y + tile_rows, w.height - 1);
    const size_t first = size_t(y0) * size_t(w.width) + size_t(x0);
    const lifting::BoxBounds box = lifting::kernels().bounds(&w.data[first], &view.tears.data[first], size_t(w.width),
                                                             size_t(x1 - x0 + 1), size_t(y1 - y0 + 1));
    // The image's border is a tear too.
    const bool torn = box.torn || tile_x < 0 || tile_y < 0 || tile_x + tile_columns >= w.width ||
                      tile_y + tile_rows >= w.height;
    if (box.high == 0 && !box.invalid) return {};  // sky
    Bounds out{box.low, box.high};
    if (torn || box.invalid) out.low *= 0.5f, out.high *= 2;  // half a pixel beyond a tear (SurfaceField::half_edge)
    if (box.invalid) out.high = view.wall_top;
    return out;
}

}  // namespace

bool reproject(const SurfaceView& view, const ShiftedCamera& shifted, const Grid<float>* floor, Reprojection& out) {
    const Intrinsics& target = shifted.intrinsics;
    const int width = target.width, height = target.height;
    const ProjectiveMap exact =
        projective_map(view.intrinsics, view.world_from_cam, target, shifted.world_from_cam);
    const ProjectiveMap back = projective_map(target, shifted.world_from_cam, view.intrinsics, view.world_from_cam);
    const FloatMap map(exact);
    const int columns = (view.intrinsics.width + tile_columns) / tile_columns,
              rows = (view.intrinsics.height + tile_rows) / tile_rows;
    std::vector<Tile> tiles(size_t(columns) * size_t(rows));
    tbb::parallel_for(0, rows, [&](int ty) {
        for (int tx = 0; tx < columns; ++tx) {
            Tile& tile = tiles[size_t(ty) * size_t(columns) + size_t(tx)];
            tile.x = tx * tile_columns - 1, tile.y = ty * tile_rows - 1;
            tile.w = bounds_of(view, tile.x, tile.y);
            if (tile.w.low <= tile.w.high)
                tile.reach = reach_of(map, float(tile.x), float(std::min(tile.x + tile_columns, view.intrinsics.width)),
                                      float(tile.y), float(std::min(tile.y + tile_rows, view.intrinsics.height)),
                                      tile.w, width, height, &tile.highest_q);
        }
    });
    if (floor) {
        const Blocks blocks(*floor);
        std::erase_if(tiles, [&](const Tile& t) { return t.reach.empty() || !blocks.any(t.reach, t.highest_q); });
    } else {
        std::erase_if(tiles, [](const Tile& t) { return t.reach.empty(); });
    }
    int x0 = floor ? width : 0, x1 = floor ? 0 : width;
    for (const Tile& t : tiles) x0 = std::min(x0, t.reach.x0), x1 = std::max(x1, t.reach.x1);
    if (floor && view.sky_px > 0) {  // sky: where both images meet, which are convex: probes every few pixels will do
        constexpr int step = 8;
        for (int y = 0; y < height + step; y += step)
            for (int x = 0; x < width + step; x += step) {
                const glm::dvec3 h = back.at(std::min(x, width), std::min(y, height), 0);
                if (!(h.z > 0) || !in_image(view.intrinsics, {h.x / h.z, h.y / h.z})) continue;
                x0 = std::min(x0, std::max(x - 2 * step, 0)), x1 = std::max(x1, std::min(x + 2 * step, width));
            }
    }
    if (x0 >= x1) {
        out.x0 = out.x1 = 0;
        return false;
    }
    if (out.sight.width != width || out.sight.height != height) {
        out.sight = Grid<Sight>(width, height, Sight::none);
        out.inverse_depth = Grid<float>(width, height, 0);
        out.source_px = Grid<glm::vec2>(width, height, glm::vec2(0));
    }
    if (out.wall.size() != out.sight.size()) {
        out.wall.resize(out.sight.size());
    }
    out.x0 = x0, out.x1 = x1;
    const int bands = (height + band_rows - 1) / band_rows;
    tbb::parallel_for(0, bands, [&](int b) {
        const int y0 = b * band_rows, y1 = std::min(y0 + band_rows, height);
        Band band(view, map, floor, out, y0, y1);
        for (const Tile& tile : tiles)
            if (tile.reach.y0 < y1 && tile.reach.y1 > y0) band.draw(tile);
        band.finish(back, view.intrinsics);
    });
    return true;
}

}  // namespace vshift
