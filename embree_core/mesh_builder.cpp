// SPDX-License-Identifier: Apache-2.0
#include "embree_core/mesh_builder.h"

#include <tbb/parallel_for.h>

#include <bit>
#include <cmath>

#include "embree_core/lift_kernels.h"

namespace vshift {
namespace {

// Rows of cells that one task writes. The mesh is put together band by band, so it does not depend on
// who wrote which.
constexpr int band_rows = 16;
// Marks a vertex that is counted from its band's first one.
constexpr uint32_t band_vertex = 0x80000000u;

enum Way { right_way = 0, down_way = 1, left_way = 2, up_way = 3 };
constexpr int way_dx[4] = {1, 0, -1, 0};
constexpr int way_dy[4] = {0, 1, 0, -1};

/// What one band adds to the mesh.
struct Band {
    std::vector<LiftedVertex> vertices, wall_vertices;
    std::vector<LiftedQuad> kept;
    uint64_t triangles = 0;
    size_t first_vertex = 0, first_wall_vertex = 0, first_kept = 0;
};

class Builder {
public:
    Builder(LiftedMesh& mesh, const CellPlan& plan)
        : mesh_(mesh),
          plan_(plan),
          field_{mesh.inverse_depth, mesh.tears},
          k_(mesh.intrinsics),
          width_(mesh.inverse_depth.width),
          height_(mesh.inverse_depth.height) {
        for (int x = 0; x <= 2 * width_; ++x) ray_x_.push_back(ray(k_, {0.5 * x, 0}).x);
        for (int y = 0; y <= 2 * height_; ++y) ray_y_.push_back(ray(k_, {0, 0.5 * y}).y);
        for (int x = 0; x < width_; ++x) pixel_ray_x_.push_back(ray_x_[size_t(2 * x + 1)]);
    }

    void run() {
        number_half_edges();
        std::vector<Band> bands(size_t(height_ + 1 + band_rows - 1) / band_rows);
        tbb::parallel_for(size_t(0), bands.size(), [&](size_t b) {
            const int begin = int(b) * band_rows - 1, end = std::min(begin + band_rows, height_);
            for (int y = begin; y < end; ++y) emit_row(bands[b], y);
        });
        put_together(bands);
    }

private:
    LiftedMesh& mesh_;
    const CellPlan& plan_;
    SurfaceField field_;
    const Intrinsics& k_;
    int width_, height_;
    std::vector<double> ray_x_, ray_y_, pixel_ray_x_;  ///< x and y of rays with z = 1: every half pixel, every pixel
    Grid<uint8_t> owned_;                              ///< bit per way: the pixel owns the vertex half a pixel that way
    /// Index of a pixel's first own half-edge vertex, where it has one, from its row's first one on.
    std::vector<uint32_t, Uninitialized<uint32_t>> first_owned_;
    std::vector<uint32_t> first_of_row_;

    bool collapses() const { return plan_.bound > 0; }
    bool split(int x, int y) const {
        return x < -1 || y < -1 || x >= width_ || y >= height_ || plan_.kind(x, y) == split_kind;
    }
    bool whole(int x, int y) const {
        return x >= 0 && y >= 0 && x < width_ && y < height_ && plan_.kind(x, y) == whole_kind;
    }
    uint32_t pixel(int x, int y) const { return uint32_t(y) * uint32_t(width_) + uint32_t(x); }

    /// Rays through image position (x / 2, y / 2).
    LiftedVertex vertex_at(int x, int y, double z) const {
        return {float(ray_x_[size_t(x)] * z), float(ray_y_[size_t(y)] * z), float(z), 0};
    }
    static uint32_t add_vertex(Band& band, const LiftedVertex& vertex) {
        band.vertices.push_back(vertex);
        return band_vertex | uint32_t(band.vertices.size() - 1);
    }
    static void add_quad(Band& band, const LiftedQuad& quad) {
        band.kept.push_back(quad);
        band.triangles += quad[2] == quad[3] ? 1 : 2;
    }

    // ------------------------------------------------------------ half edges
    // The vertex half a pixel from (x, y) towards a neighbour, on (x, y)'s own surface. Where the two are
    // joined both mean the same one; the left or upper pixel owns it.

    /// Which half-edge vertices pixel (x, y) owns. On a joined edge there is one where a split cell
    /// touches it; on a torn edge always: both cells there are split or merged.
    uint8_t owned_ways(int x, int y) const {
        uint8_t ways = 0;
        for (int way = 0; way < 4; ++way) {
            if (!field_.joined(x, y, x + way_dx[way], y + way_dy[way]))
                ways |= uint8_t(1 << way);
            else if (way == right_way && (split(x, y - 1) || split(x, y)))
                ways |= 1 << right_way;
            else if (way == down_way && (split(x - 1, y) || split(x, y)))
                ways |= 1 << down_way;
        }
        return ways;
    }

    void number_half_edges() {
        owned_ = Grid<uint8_t>(width_, height_, 0);
        first_owned_.resize(owned_.size());
        first_of_row_.assign(size_t(height_) + 1, 0);
        tbb::parallel_for(0, height_, [&](int y) {
            uint32_t count = 0;
            const uint8_t *above = &plan_.kinds.at(0, y), *below = &plan_.kinds.at(0, y + 1);
            const float* w = &field_.w.at(0, y);
            for (int x = 0; x < width_; ++x) {
                const bool all_whole = (above[x] & above[x + 1] & below[x] & below[x + 1]) == whole_kind;
                if (all_whole || !(w[x] > 0)) continue;
                const uint8_t ways = owned_ways(x, y);
                owned_.at(x, y) = ways;
                first_owned_[pixel(x, y)] = count;
                count += uint32_t(std::popcount(ways));
            }
            first_of_row_[size_t(y) + 1] = count;
        });
        first_of_row_[0] = uint32_t(owned_.size());
        for (size_t y = 0; y < size_t(height_); ++y) first_of_row_[y + 1] += first_of_row_[y];
    }

    void write_row(int y) {
        const double ray_y = ray_y_[size_t(2 * y + 1)];
        const uint32_t first = pixel(0, y);
        lifting::kernels().points(&mesh_.depth.data[first], pixel_ray_x_.data(), ray_y, size_t(width_),
                                  &mesh_.vertices[first].x);
        if (first_of_row_[size_t(y)] == first_of_row_[size_t(y) + 1]) return;
        for (int x = 0; x < width_; ++x)
            for (int way = 0; owned_.at(x, y) >> way; ++way) {
                if (!(owned_.at(x, y) >> way & 1)) continue;
                const int dx = way_dx[way], dy = way_dy[way];
                mesh_.vertices[half_edge(x, y, dx, dy)] =
                    vertex_at(2 * x + 1 + dx, 2 * y + 1 + dy, 1.0 / field_.half_edge(x, y, dx, dy));
            }
    }

    uint32_t half_edge(int x, int y, int dx, int dy) const {
        int way = dx > 0 ? right_way : dy > 0 ? down_way : dx < 0 ? left_way : up_way;
        if (way >= left_way && field_.joined(x, y, x + dx, y + dy)) {
            x += dx, y += dy;
            way -= 2;
        }
        const unsigned before = owned_.at(x, y) & ((1u << way) - 1);
        return first_of_row_[size_t(y)] + first_owned_[pixel(x, y)] + uint32_t(std::popcount(before));
    }

    // ------------------------------------------------------------ cells

    void emit_row(Band& band, int y) {
        for (int x = -1; x < width_; ++x) {
            if (!whole(x, y)) {
                if (!field_.empty(x, y)) emit_torn(band, x, y);
                continue;
            }
            const int level = collapses() ? plan_.level(x, y) : 0;
            if (level == 0) {
                emit_whole(band, x, y);
                continue;
            }
            const int inside = (1 << level) - 1;
            if (!(x & inside) && !(y & inside)) emit_block(band, level, x >> level, y >> level);
            x |= inside;  // its last column
        }
    }

    void emit_block(Band& band, int level, int block_x, int block_y) {
        const int x0 = block_x << level, y0 = block_y << level, n = 1 << level;
        const BlockBorder border = block_border(plan_, level, block_x, block_y);
        const BlockFan fan = block_fan(border);
        if (fan != BlockFan::centre) {
            std::array<uint32_t, 8> ring{};
            const BlockRing points = block_ring(border);
            for (size_t i = 0; i < size_t(points.count); ++i) ring[i] = pixel(x0 + points.at[i].x, y0 + points.at[i].y);
            if (fan == BlockFan::quad)
                add_quad(band, {ring[0], ring[1], ring[2], ring[3]});
            else
                add_fan(band, ring[0], &ring[1], size_t(points.count) - 1);
            return;
        }
        std::array<uint32_t, (8 << most_levels) + 1> ring{};
        size_t count = 0;
        for (int side = 0; side < 4; ++side)
            for (int i = 0; i < border.counts[size_t(side)]; ++i) {
                const int stop = border.stops[size_t(side)][size_t(i)];
                const glm::ivec2 at = BlockBorder::place(side, n, stop / 2, 0);
                const glm::ivec2 step = BlockBorder::place(side, n, 1, 0) - BlockBorder::place(side, n, 0, 0);
                ring[count++] =
                    stop % 2 == 0 ? pixel(x0 + at.x, y0 + at.y) : half_edge(x0 + at.x, y0 + at.y, step.x, step.y);
            }
        ring[count++] = ring[0];
        add_fan(band, pixel(x0 + n / 2, y0 + n / 2), ring.data(), count);
    }

    /// Triangles (apex, ring[i], ring[i + 1]), two to a quad: quads are split along corners 1 and 3.
    static void add_fan(Band& band, uint32_t apex, const uint32_t* ring, size_t count) {
        for (size_t i = 0; i + 1 < count; i += 2)
            if (i + 2 < count)
                add_quad(band, {ring[i], ring[i + 1], ring[i + 2], apex});
            else
                add_quad(band, {apex, ring[i], ring[i + 1], ring[i + 1]});
    }

    /// A whole cell that stands for itself. Beside a split cell it is a fan that shares the split cell's
    /// half-edge vertices.
    void emit_whole(Band& band, int x, int y) {
        std::array<uint32_t, 9> ring;
        size_t count = 0;
        float sum[2] = {0, 0};
        bool inside = true;
        for (int c = 0; c < 4; ++c) {
            const int n = (c + 1) % 4;
            const int x0 = x + corner_dx[c], y0 = y + corner_dy[c];
            ring[count++] = pixel(x0, y0);
            sum[c / 2] += field_.w.at(x0, y0);
            if (whole(x + beyond_dx[c], y + beyond_dy[c])) continue;
            inside = false;
            if (split(x + beyond_dx[c], y + beyond_dy[c]))
                ring[count++] = half_edge(x0, y0, corner_dx[n] - corner_dx[c], corner_dy[n] - corner_dy[c]);
        }
        if (inside || (count == 4 && twist(x, y) <= 4 * plan_.bound)) {
            add_quad(band, {ring[0], ring[1], ring[2], ring[3]});
            return;
        }
        const uint32_t centre = add_vertex(band, vertex_at(2 * x + 2, 2 * y + 2, 4.0 / double(sum[0] + sum[1])));
        if (collapses()) {
            ring[count] = ring[0];
            add_fan(band, centre, ring.data(), count + 1);
        } else {
            for (size_t i = 0; i < count; ++i) {
                const uint32_t next = ring[(i + 1) % count];
                add_quad(band, {centre, ring[i], next, next});
            }
        }
    }
    /// Four times what a fan's centre stands above or below a quad's diagonal, in 1/z.
    float twist(int x, int y) const {
        const Grid<float>& w = field_.w;
        return std::fabs((w.at(x, y) - w.at(x + 1, y)) + (w.at(x + 1, y + 1) - w.at(x, y + 1)));
    }

    /// A cell that a tear crosses.
    void emit_torn(Band& band, int x, int y) {
        const SplitCell cell = split_cell(field_, x, y);
        std::array<uint32_t, 4> centre{};
        const bool quarters = plan_.kind(x, y) == split_kind;
        for (int c = 0; c < 4; ++c)
            if (cell.part[c] == c) {
                if (!quarters && emit_merged(band, x, y, cell, c)) continue;
                centre[size_t(c)] = add_vertex(band, vertex_at(2 * x + 2, 2 * y + 2, 1.0 / cell.centre[c]));
                if (!quarters) emit_merged_fan(band, x, y, cell, c, centre[size_t(c)]);
            }
        for (int c = 0; c < 4 && quarters; ++c)
            if (cell.part[c] >= 0) emit_quarter(band, x, y, c, centre[size_t(cell.part[c])]);
        for (int c = 0; c < 4; ++c) {
            const int n = (c + 1) % 4;
            if (cell.state[c] == Pixel::missing || cell.state[n] == Pixel::missing || cell.joined_next[c]) continue;
            emit_wall(band, x, y, cell, c, n);
        }
    }

    uint32_t half_edge_of(int x, int y, int corner, int towards) const {
        return half_edge(x + corner_dx[corner], y + corner_dy[corner], corner_dx[towards] - corner_dx[corner],
                         corner_dy[towards] - corner_dy[corner]);
    }
    void emit_quarter(Band& band, int x, int y, int c, uint32_t centre) const {
        add_quad(band, {pixel(x + corner_dx[c], y + corner_dy[c]), half_edge_of(x, y, c, (c + 1) % 4), centre,
                        half_edge_of(x, y, c, (c + 3) % 4)});
    }

    /// A merged part's border from one torn edge round to the other, without the cell's centre.
    size_t part_border(int x, int y, const SplitCell& cell, int part, std::array<uint32_t, 9>& border) const {
        int c = part;  // the corner after a torn edge
        while (cell.part[c] != part || cell.joined_next[size_t(c + 3) % 4]) c = (c + 1) % 4;
        size_t count = 0;
        border[count++] = half_edge_of(x, y, c, (c + 3) % 4);
        for (;; c = (c + 1) % 4) {
            border[count++] = pixel(x + corner_dx[c], y + corner_dy[c]);
            const bool on = cell.joined_next[size_t(c)];
            if (!on || split(x + beyond_dx[c], y + beyond_dy[c])) border[count++] = half_edge_of(x, y, c, (c + 1) % 4);
            if (!on) return count;
        }
    }
    /// Two joined corners: one quad to the torn side, on which the cell's centre lies.
    bool emit_merged(Band& band, int x, int y, const SplitCell& cell, int part) const {
        std::array<uint32_t, 9> border;
        if (std::count(cell.part.begin(), cell.part.end(), part) != 2) return false;
        if (part_border(x, y, cell, part, border) != 4) return false;
        add_quad(band, {border[0], border[1], border[2], border[3]});
        return true;
    }
    void emit_merged_fan(Band& band, int x, int y, const SplitCell& cell, int part, uint32_t centre) const {
        if (std::count(cell.part.begin(), cell.part.end(), part) == 1) return emit_quarter(band, x, y, part, centre);
        std::array<uint32_t, 9> border;
        const size_t count = part_border(x, y, cell, part, border);
        add_fan(band, centre, border.data(), count);
    }

    /// The wall on the line from the middle of the edge between two corners to the cell's centre, from
    /// one side's 1/z to the other's. It stands in the plane of the recorded rays.
    void emit_wall(Band& band, int x, int y, const SplitCell& cell, int a, int b) const {
        const int mx = 2 * x + 1 + corner_dx[a] + corner_dx[b], my = 2 * y + 1 + corner_dy[a] + corner_dy[b];
        const auto heights = [&](int c, bool to_next) -> std::array<float, 2> {
            switch (cell.state[c]) {
                case Pixel::solid:
                    return {to_next ? cell.towards_next[c] : cell.towards_last[c], cell.centre[cell.part[c]]};
                case Pixel::sky:
                    return {0, 0};
                default:
                    return {mesh_.wall_top, mesh_.wall_top};  // nothing is known along this pixel's ray
            }
        };
        const auto from = heights(a, true), to = heights(b, false);
        if (from == to) return;
        const auto add = [&](int u, int v, float w) {
            band.wall_vertices.push_back({float(ray_x_[size_t(u)]), float(ray_y_[size_t(v)]), w, 0});
        };
        add(mx, my, from[0]);
        add(2 * x + 2, 2 * y + 2, from[1]);
        add(2 * x + 2, 2 * y + 2, to[1]);
        add(mx, my, to[0]);
    }

    void put_together(std::vector<Band>& bands) {
        size_t vertices = first_of_row_.back(), wall_vertices = 0, kept = 0;
        for (Band& band : bands) {
            band.first_vertex = vertices, band.first_wall_vertex = wall_vertices, band.first_kept = kept;
            vertices += band.vertices.size();
            wall_vertices += band.wall_vertices.size();
            kept += band.kept.size();
            mesh_.kept_triangles += band.triangles;
        }
        mesh_.vertices.resize(vertices);
        mesh_.wall_vertices.resize(wall_vertices);
        mesh_.torn.resize(wall_vertices / 4);
        mesh_.kept.resize(kept);
        tbb::parallel_for(0, height_, [&](int y) { write_row(y); });
        tbb::parallel_for(size_t(0), bands.size(), [&](size_t b) {
            const Band& band = bands[b];
            std::copy(band.vertices.begin(), band.vertices.end(), mesh_.vertices.begin() + long(band.first_vertex));
            std::copy(band.wall_vertices.begin(), band.wall_vertices.end(),
                      mesh_.wall_vertices.begin() + long(band.first_wall_vertex));
            for (size_t i = 0; i < band.wall_vertices.size(); i += 4) {
                const uint32_t first = uint32_t(band.first_wall_vertex + i);
                mesh_.torn[first / 4] = {first, first + 1, first + 2, first + 3};
            }
            for (size_t i = 0; i < band.kept.size(); ++i)
                for (size_t c = 0; c < 4; ++c) {
                    const uint32_t at = band.kept[i][c];
                    mesh_.kept[band.first_kept + i][c] =
                        at & band_vertex ? uint32_t(band.first_vertex) + (at & ~band_vertex) : at;
                }
        });
    }
};

}  // namespace

void build_mesh(LiftedMesh& mesh, const CellPlan& plan) {
    Builder(mesh, plan).run();
}

}  // namespace vshift
