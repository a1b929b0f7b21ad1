// SPDX-License-Identifier: Apache-2.0
#include "embree_core/raster.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>
#include <optional>

#include "embree_core/lift_kernels.h"
#include "embree_core/surface_field.h"

// Signs of edge functions must be exact opposites for the two triangles at an edge: built without fused operations.

namespace vshift {
namespace {

using raster::Bounds;
using raster::ceiling;
using raster::Corner;
using raster::Corners;
using raster::FloatMap;
using raster::floored;
using raster::nearest_share;
using raster::Range;
using raster::reach_of;
using raster::Tile;

// Cells are taken in tiles, pixels of V in bands of rows. A band belongs to one task, and tiles come in order: the
// result does not depend on who did what.
constexpr int tile_columns = raster::most_cells, tile_rows = 16, band_rows = Reprojection::band_rows, block = 16;
static_assert(band_rows % block == 0);
// Walls that meet leave no gap.
constexpr float wall_reach_px = 1.0f / 512;
static_assert(uint8_t(Sight::none) == raster::no_surface && uint8_t(Sight::seen) == raster::front &&
              uint8_t(Sight::back_face) == raster::back && uint8_t(Sight::behind_wall) == raster::walled);

/// Whether a pixel exactly on the edge a -> b belongs to the triangle on its inner side.
bool owns_edge(float dx, float dy) {
    return dy < 0 || (dy == 0 && dx > 0);
}

/// The floor's least value in every block of a band's pixels.
struct Blocks {
    int columns, first, rows;
    std::vector<float> least;

    Blocks(const Grid<float>& floor, int y0, int y1)
        : columns((floor.width + block - 1) / block),
          first(y0 / block),
          rows((y1 - y0 + block - 1) / block),
          least(size_t(columns) * size_t(rows), std::numeric_limits<float>::infinity()) {
        for (int y = y0; y < y1; ++y)
            for (int bx = 0; bx < columns; ++bx) {
                const float* row = &floor.at(bx * block, y);
                const int n = std::min(block, floor.width - bx * block);
                float low = row[0];
                for (int i = 1; i < n; ++i) low = row[i] < low ? row[i] : low;
                float& of = least[size_t(y / block - first) * size_t(columns) + size_t(bx)];
                of = std::min(of, low);
            }
    }
    /// Whether a surface whose 1/Z stays below `highest` could rise above the floor.
    bool any(const Range& r, float highest) const {
        for (int y = std::max(r.y0 / block, first); y < first + rows && y * block < r.y1; ++y)
            for (int x = r.x0 / block; x * block < r.x1; ++x)
                if (least[size_t(y - first) * size_t(columns) + size_t(x)] < highest) return true;
        return false;
    }
};

/// One band of V's rows.
class Band {
public:
    /// `blocks`: of the floor; null where there is none.
    Band(const SurfaceView& view, const FloatMap& map, const Grid<float>* floor, const Blocks* blocks,
         Reprojection::Columns columns, int y0, int y1, Reprojection& out)
        : field_{view.inverse_depth, view.tears},
          view_(view),
          map_(map),
          floor_(floor),
          blocks_(blocks),
          columns_(columns),
          out_(out),
          width_(out.sight.width),
          y0_(y0),
          y1_(y1),
          wall_(size_t(width_) * size_t(y1 - y0)) {
        for (int y = y0; y < y1; ++y) {
            const size_t begin = size_t(y) * size_t(width_) + size_t(columns.x0), n = size_t(columns.x1 - columns.x0);
            if (floor)
                std::copy_n(&floor->data[begin], n, &out.inverse_depth.data[begin]);
            else
                std::fill_n(&out.inverse_depth.data[begin], n, 0.0f);
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
            float highest_q;
            const Range reach =
                reach_of(map_, float(tile.x), float(last_x), float(y), float(y + 1), tile.w, width_, y1_, &highest_q);
            if (reach.empty() || reach.y1 <= y0_ || (blocks_ && !blocks_->any(reach, highest_q))) continue;
            if (y < 0 || y + 1 >= field_.w.height) {
                for (int x = tile.x; x < last_x; ++x) draw_border(x, y);
                continue;
            }
            if (have == y)
                std::swap(above, below);
            else
                load(x0, x1, y, *above);
            load(x0, x1, y + 1, *below);
            have = y + 1;
            if (tile.x < x0) draw_border(tile.x, y);
            if (x1 < last_x) draw_border(x1, y);
            if (x0 >= x1) continue;
            kernels.cells(*above, *below, float(x0), float(y), window, size_t(x1 - x0), cells_);
            put_cells(x0, y, x1 - x0, *above, *below);
        }
    }

    /// Sky where nothing stands, and what walls hide.
    void finish(const ProjectiveMap& sky_map, const Intrinsics& recorded) {
        const size_t n = size_t(columns_.x1 - columns_.x0);
        std::vector<uint8_t> open(n);
        const double right = recorded.width, bottom = recorded.height;
        for (int y = y0_; y < y1_; ++y) {
            const size_t first = size_t(y) * size_t(width_) + size_t(columns_.x0);
            raster::kernels().settle(floor_ ? &floor_->data[first] : nullptr, walls(y) + columns_.x0, n,
                                     &out_.inverse_depth.data[first], &out_.source_px.data[first].x,
                                     reinterpret_cast<uint8_t*>(&out_.sight.data[first]), open.data());
            if (view_.sky_px == 0) continue;
            const glm::dvec3 along = sky_map.turn[0], row = sky_map.turn[1] * (y + 0.5) + sky_map.turn[2];
            alignas(64) double u[raster::most_cells], v[raster::most_cells];
            for (size_t x0 = 0; x0 < n; x0 += raster::most_cells) {
                const size_t count = std::min(raster::most_cells, n - x0);
                if (std::find(&open[x0], &open[x0] + count, uint8_t(1)) == &open[x0] + count) continue;
                for (size_t i = 0; i < count; ++i) {
                    const double px = columns_.x0 + int(x0 + i) + 0.5, z = along.z * px + row.z, share = 1 / z;
                    // Behind V: beyond any image.
                    u[i] = z > 1e-9 ? (along.x * px + row.x) * share : -1;
                    v[i] = (along.y * px + row.y) * share;
                }
                for (size_t i = 0; i < count; ++i) {
                    if (!open[x0 + i]) continue;
                    if (!(u[i] >= 0 && u[i] < right && v[i] >= 0 && v[i] < bottom)) continue;
                    if (field_.w.at(int(u[i]), int(v[i])) != 0) continue;
                    out_.source_px.data[first + x0 + i] = glm::vec2(float(u[i]), float(v[i]));
                    if (Sight& sight = out_.sight.data[first + x0 + i]; sight == Sight::none) sight = Sight::sky;
                }
            }
        }
    }

private:
    SurfaceField field_;
    const SurfaceView& view_;
    const FloatMap& map_;
    const Grid<float>* floor_;
    const Blocks* blocks_;
    Reprojection::Columns columns_;
    Reprojection& out_;
    int width_, y0_, y1_;
    std::vector<float> wall_;  ///< 1/Z of the nearest wall, of the band's rows

    raster::Row rows_[2];
    raster::Cells cells_;

    float* walls(int y) { return &wall_[size_t(y - y0_) * size_t(width_)]; }

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
                draw_split(x0 + i, y, [&](int c) {
                    return own_corner(corner_dy[c] ? below : above, i + corner_dx[c], x0 + i + corner_dx[c],
                                      y + corner_dy[c]);
                });
                continue;
            }
            if (kind == raster::wide) {
                draw_wide(x0 + i, y, above, below, i);
                continue;
            }
            const size_t first = size_t(cells_.y[i]) * width + size_t(cells_.x[i]);
            for (unsigned hits = unsigned(cells_.hits[i]); hits; hits &= hits - 1) {
                const int k = std::countr_zero(hits);
                const size_t at =
                    first + (k < raster::most_across ? size_t(k) : size_t(k - raster::most_across) + width);
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

    static Corner own_corner(const raster::Row& row, int at, int x, int y) {
        return {row.x[at], row.y[at], row.q[at], row.r[at], float(x), float(y)};
    }

    /// A cell that covers more pixels than the kernel takes, or is seen from behind.
    void draw_wide(int cx, int cy, const raster::Row& a, const raster::Row& b, int i) {
        const auto corner = [&](const raster::Row& row, int c) {
            return own_corner(row, i + corner_dx[c], cx + corner_dx[c], cy + corner_dy[c]);
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

    /// A cell that reaches beyond the image.
    void draw_border(int cx, int cy) {
        draw_split(cx, cy, [&](int c) {
            const int x = cx + corner_dx[c], y = cy + corner_dy[c];
            return map_.corner(float(x), float(y), field_.w.at(x, y));
        });
    }

    /// `own_at(c)`: a solid corner in V.
    template <class OwnAt>
    void draw_split(int cx, int cy, const OwnAt& own_at) {
        const SplitCell cell = split_cell(field_, cx, cy);
        // Where each corner's surface meets the edges to its neighbours in the ring (what is joined meets at one point)
        // and the cell's centre; what is not solid is not looked at.
        using Four = Corners::Four;
        const float x = float(cx), y = float(cy), mu = x + 0.5f, mv = y + 0.5f;
        const Four u = {mu, x + 1, mu, x}, v = {y, mv, y + 1, mv}, u_of_centre = {mu, mu, mu, mu},
                   v_of_centre = {mv, mv, mv, mv};
        const auto four = [](const std::array<float, 4>& a, int first) {
            return Four{a[size_t(first)], a[size_t(first + 1) % 4], a[size_t(first + 2) % 4], a[size_t(first + 3) % 4]};
        };
        const Corners to_next(map_, u, v, four(cell.towards_next, 0)), before(map_, u, v, four(cell.towards_last, 1)),
            centres(map_, u_of_centre, v_of_centre, four(cell.centre, 0));
        const auto to_last = [&](int c) {
            const int edge = (c + 3) % 4;
            return cell.joined_next[edge] ? to_next[edge] : before[edge];
        };
        for (int c = 0; c < 4; ++c) {
            if (cell.part[c] < 0) continue;
            const Corner own = own_at(c);
            const Corner centre = centres[cell.part[c]], first = to_next[c], last = to_last(c);
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
            // A wall between what either side reaches at the edge's middle and at the centre.
            struct Ends {
                Corner middle, centre;
                float middle_w, centre_w;
            };
            const auto ends = [&](int corner, const Corner& reached, float reached_w) -> Ends {
                if (cell.state[corner] == Pixel::solid)
                    return {reached, centres[cell.part[corner]], reached_w, cell.centre[cell.part[corner]]};
                const float w = cell.state[corner] == Pixel::sky ? 0 : view_.wall_top;
                return {map_.corner(u[c], v[c], w), map_.corner(mu, mv, w), w, w};
            };
            const Ends from = ends(c, to_next[c], cell.towards_next[c]), to = ends(n, to_last(n), cell.towards_last[n]);
            if (from.middle_w == to.middle_w && from.centre_w == to.centre_w) continue;
            const Corner ring[4] = {from.middle, from.centre, to.centre, to.middle};
            const float w[4] = {from.middle_w, from.centre_w, to.centre_w, to.middle_w};
            wall(ring, w);
        }
    }

    /// Of four corners round it; w: their 1/z.
    void wall(const Corner (&ring)[4], const float (&w)[4]) {
        if (ring[0].r > 0 && ring[1].r > 0 && ring[2].r > 0 && ring[3].r > 0) return draw_wall(ring, 4);
        struct Point {
            glm::vec3 h;
            float w;
        };
        Corner kept[8];
        int n = 0;
        const auto point = [&](int i) { return Point{map_.at(ring[i].u, ring[i].v, w[i]), w[i]}; };
        const auto keep = [&](const Point& p) {
            const float r = 1 / p.h.z;
            kept[n++] = {p.h.x * r, p.h.y * r, p.w * r, r, 0, 0};
        };
        for (int i = 0; i < 4; ++i) {
            const Point a = point(i), b = point((i + 1) % 4);
            const float da = a.h.z - nearest_share, db = b.h.z - nearest_share;
            if (da > 0) keep(a);
            if ((da > 0) == (db > 0)) continue;
            const float t = da / (da - db);
            Point cut{a.h + t * (b.h - a.h), a.w + t * (b.w - a.w)};
            cut.h.z = std::max(cut.h.z, 0.5f * nearest_share);
            keep(cut);
        }
        if (n >= 3) draw_wall(kept, n);
    }

    void draw_wall(const Corner* points, int count) {
        float top = std::numeric_limits<float>::infinity(), bottom = -top;
        for (int i = 0; i < count; ++i) top = std::min(top, points[i].y), bottom = std::max(bottom, points[i].y);
        const int first = ceiling(std::clamp(top - wall_reach_px, float(y0_), float(y1_)));
        const int last = floored(std::clamp(bottom + wall_reach_px, float(y0_ - 1), float(y1_ - 1)));
        for (int row = first; row <= last; ++row) {
            const float level = std::clamp(float(row), top, bottom);
            float left = std::numeric_limits<float>::infinity(), right = -left, q_left = 0, q_right = 0;
            const auto take = [&](float at, float value) {
                if (at < left) left = at, q_left = value;
                if (at > right) right = at, q_right = value;
            };
            for (int i = 0; i < count; ++i) {
                const Corner &a = points[i], &b = points[i + 1 == count ? 0 : i + 1];
                if ((a.y < level && b.y < level) || (a.y > level && b.y > level)) continue;
                if (a.y == b.y) {
                    take(a.x, a.q);
                    take(b.x, b.q);
                } else {
                    const float t = (level - a.y) / (b.y - a.y);
                    take(a.x + t * (b.x - a.x), a.q + t * (b.q - a.q));
                }
            }
            if (!(left <= right)) continue;
            const int x0 = ceiling(std::clamp(left - wall_reach_px, 0.0f, float(width_)));
            const int x1 = floored(std::clamp(right + wall_reach_px, -1.0f, float(width_ - 1)));
            const float slope = right > left ? (q_right - q_left) / (right - left) : 0;
            float* to_wall = walls(row);
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
    const bool torn =
        box.torn || tile_x < 0 || tile_y < 0 || tile_x + tile_columns >= w.width || tile_y + tile_rows >= w.height;
    if (box.high == 0 && !box.invalid) return {};  // sky
    Bounds out{box.low, box.high};
    if (torn || box.invalid) out.low *= 0.5f, out.high *= 2;  // half a pixel beyond a tear (SurfaceField::half_edge)
    if (box.invalid) out.high = view.wall_top;
    return out;
}

}  // namespace

Raster::Raster(const SurfaceView& view, const ShiftedCamera& shifted)
    : view_(view),
      from_shifted_(projective_map(shifted.intrinsics, shifted.world_from_cam, view.intrinsics, view.world_from_cam)),
      map_(projective_map(view.intrinsics, view.world_from_cam, shifted.intrinsics, shifted.world_from_cam)),
      width_(shifted.intrinsics.width),
      height_(shifted.intrinsics.height) {
    const Intrinsics& k = view.intrinsics;
    const int columns = (k.width + tile_columns) / tile_columns, rows = (k.height + tile_rows) / tile_rows;
    tiles_.resize(size_t(columns) * size_t(rows));
    tbb::parallel_for(0, rows, [&](int ty) {
        for (int tx = 0; tx < columns; ++tx) {
            Tile& tile = tiles_[size_t(ty) * size_t(columns) + size_t(tx)];
            tile.x = tx * tile_columns - 1, tile.y = ty * tile_rows - 1;
            tile.w = bounds_of(view, tile.x, tile.y);
            if (tile.w.low <= tile.w.high)
                tile.reach =
                    reach_of(map_, float(tile.x), float(std::min(tile.x + tile_columns, k.width)), float(tile.y),
                             float(std::min(tile.y + tile_rows, k.height)), tile.w, width_, height_, &tile.highest_q);
        }
    });
    std::erase_if(tiles_, [](const Tile& t) { return t.reach.empty(); });
}

void Raster::band(int number, const Grid<float>* floor, Reprojection& out) const {
    const int y0 = number * band_rows, y1 = std::min(y0 + band_rows, height_);
    std::optional<Blocks> blocks;
    Reprojection::Columns columns{0, width_};
    std::vector<const Tile*> wanted;
    if (floor) blocks.emplace(*floor, y0, y1), columns = {width_, 0};
    for (const Tile& tile : tiles_) {
        if (tile.reach.y0 >= y1 || tile.reach.y1 <= y0) continue;
        if (blocks && !blocks->any(tile.reach, tile.highest_q)) continue;
        wanted.push_back(&tile);
        columns.x0 = std::min(columns.x0, tile.reach.x0), columns.x1 = std::max(columns.x1, tile.reach.x1);
    }
    if (floor && view_.sky_px > 0) {  // sky: where both images meet, which are convex: probes every few pixels will do
        constexpr int step = 8;
        for (int y = std::max(y0 - step, 0); y < y1 + step; y += step)
            for (int x = 0; x < width_ + step; x += step) {
                const glm::dvec3 h = from_shifted_.at(std::min(x, width_), std::min(y, height_), 0);
                if (!(h.z > 0) || !in_image(view_.intrinsics, {h.x / h.z, h.y / h.z})) continue;
                columns.x0 = std::min(columns.x0, std::max(x - 2 * step, 0));
                columns.x1 = std::max(columns.x1, std::min(x + 2 * step, width_));
            }
    }
    if (columns.x0 >= columns.x1) columns = {};
    out.columns[size_t(number)] = columns;
    if (columns.x0 == columns.x1) return;
    Band band(view_, map_, floor, blocks ? &*blocks : nullptr, columns, y0, y1, out);
    for (const Tile* tile : wanted) band.draw(*tile);
    band.finish(from_shifted_, view_.intrinsics);
}

bool reproject(const SurfaceView& view, const ShiftedCamera& shifted, const Grid<float>* floor, Reprojection& out) {
    const Raster raster(view, shifted);
    out.fit(shifted.intrinsics);
    each_band(out, [&](int band) { raster.band(band, floor, out); });
    return std::any_of(out.columns.begin(), out.columns.end(), [](const auto& c) { return c.x0 < c.x1; });
}

}  // namespace vshift
