// SPDX-License-Identifier: Apache-2.0
#include "embree_core/lift.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <limits>

namespace vshift {
namespace {

// Corners of a cell, in the order of the ring round it: (0,0), (1,0), (1,1), (0,1).
constexpr int corner_dx[4] = {0, 1, 1, 0};
constexpr int corner_dy[4] = {0, 0, 1, 1};

constexpr uint32_t none = 0xffffffffu;

enum class Pixel { missing, invalid, sky, solid };

/// The tears and 1/z of one depth map, and the rules by which surfaces end at a tear.
struct Field {
    const Grid<float>& w;
    const Grid<uint8_t>& tears;

    Pixel state(int x, int y) const {
        if (x < 0 || y < 0 || x >= w.width || y >= w.height) return Pixel::missing;
        const float value = w.at(x, y);
        return value > 0 ? Pixel::solid : value == 0 ? Pixel::sky : Pixel::invalid;
    }
    bool solid(int x, int y) const { return state(x, y) == Pixel::solid; }

    /// Whether two 4-neighbours lie on one observed surface.
    bool joined(int x0, int y0, int x1, int y1) const {
        if (!solid(x0, y0) || !solid(x1, y1)) return false;
        const uint8_t bit = y0 == y1 ? 1 : 2;
        return !(tears.at(std::min(x0, x1), std::min(y0, y1)) & bit);
    }

    /// 1/z of solid pixel (x, y)'s surface half a pixel towards its neighbour at (dx, dy): between
    /// the two where they are joined, extrapolated from the far side of the pixel where not.
    float half_edge(int x, int y, int dx, int dy) const {
        const float own = w.at(x, y);
        if (joined(x, y, x + dx, y + dy)) return 0.5f * (own + w.at(x + dx, y + dy));
        if (!joined(x, y, x - dx, y - dy)) return own;
        const float extended = own + 0.5f * (own - w.at(x - dx, y - dy));
        return std::clamp(extended, 0.5f * own, 2.0f * own);
    }
};

/// One cell with its corners' parts: which corners share a surface, and 1/z where each part reaches
/// the cell's centre.
struct SplitCell {
    std::array<Pixel, 4> state;
    std::array<int, 4> part;            ///< number of the part, -1 where the corner is not solid
    std::array<float, 4> centre;        ///< 1/z of a part at the centre, by part number
    std::array<float, 4> towards_next;  ///< 1/z at the half edge to the next corner in the ring, own side
    std::array<float, 4> towards_last;  ///< likewise to the corner before
    std::array<bool, 4> joined_next;
};

SplitCell split_cell(const Field& f, int cx, int cy) {
    SplitCell cell;
    for (int c = 0; c < 4; ++c) {
        const int x = cx + corner_dx[c], y = cy + corner_dy[c];
        cell.state[c] = f.state(x, y);
        cell.part[c] = cell.state[c] == Pixel::solid ? c : -1;
    }
    for (int c = 0; c < 4; ++c) {
        const int n = (c + 1) % 4;
        const int x0 = cx + corner_dx[c], y0 = cy + corner_dy[c];
        const int x1 = cx + corner_dx[n], y1 = cy + corner_dy[n];
        cell.joined_next[c] = f.joined(x0, y0, x1, y1);
        if (cell.state[c] == Pixel::solid) cell.towards_next[c] = f.half_edge(x0, y0, x1 - x0, y1 - y0);
        if (cell.state[n] == Pixel::solid) cell.towards_last[n] = f.half_edge(x1, y1, x0 - x1, y0 - y1);
    }
    for (int pass = 0; pass < 2; ++pass)
        for (int c = 0; c < 4; ++c)
            if (const int n = (c + 1) % 4; cell.joined_next[c])
                cell.part[c] = cell.part[n] = std::min(cell.part[c], cell.part[n]);
    // Each corner's plane gives an estimate at the centre; a part takes their mean. Sums go row by
    // row, so that a mirrored image gives the mirrored value to the bit.
    constexpr int row_order[4] = {0, 1, 3, 2};
    for (int p = 0; p < 4; ++p) {
        float rows[2] = {0, 0};
        int members = 0;
        float smallest = std::numeric_limits<float>::infinity(), largest = 0;
        for (int i = 0; i < 4; ++i) {
            const int c = row_order[i];
            if (cell.part[c] != p) continue;
            const float own = f.w.at(cx + corner_dx[c], cy + corner_dy[c]);
            rows[i / 2] += (cell.towards_next[c] + cell.towards_last[c]) - own;
            smallest = std::min(smallest, own);
            largest = std::max(largest, own);
            ++members;
        }
        if (members) cell.centre[p] = std::clamp((rows[0] + rows[1]) / float(members), 0.5f * smallest, 2.0f * largest);
    }
    return cell;
}

/// Torn: the step of 1/z is visible at this baseline, and no plane on either side explains it.
bool torn_between(float before, float a, float b, float after, double px_per_inverse_depth,
                  const LiftOptions& options) {
    const float step = std::fabs(b - a);
    if (!(px_per_inverse_depth * step > options.tear_px)) return false;
    float smallest = std::numeric_limits<float>::infinity();
    if (!std::isnan(before)) smallest = std::min(smallest, std::fabs((before - a) + (b - a)));
    if (!std::isnan(after)) smallest = std::min(smallest, std::fabs((a - b) + (after - b)));
    return smallest >= float(options.tear_break) * step;
}

void find_tears(LiftedMesh& mesh, const LiftOptions& options) {
    const Grid<float>& w = mesh.inverse_depth;
    const float nan = std::numeric_limits<float>::quiet_NaN();
    const auto value = [&](int x, int y) { return x < 0 || y < 0 || x >= w.width || y >= w.height ? nan : w.at(x, y); };
    mesh.tears = Grid<uint8_t>(w.width, w.height, 0);
    const double fx_b = mesh.intrinsics.fx * options.baseline_m, fy_b = mesh.intrinsics.fy * options.baseline_m;
    tbb::parallel_for(0, w.height, [&](int y) {
        for (int x = 0; x < w.width; ++x) {
            const float a = w.at(x, y), right = value(x + 1, y), below = value(x, y + 1);
            const auto torn = [&](float b, float before, float after, double scale) {
                if (std::isnan(b)) return false;  // no such pixel, or no measurement: never joined anyway
                if ((a > 0) != (b > 0)) return true;
                return torn_between(before, a, b, after, scale, options);
            };
            uint8_t bits = 0;
            if (torn(right, value(x - 1, y), value(x + 2, y), fx_b)) bits |= 1;
            if (torn(below, value(x, y - 1), value(x, y + 2), fy_b)) bits |= 2;
            mesh.tears.at(x, y) = bits;
        }
    });
}

/// Emits vertices and quads; half-edge vertices are shared between the cells on both sides.
class Builder {
public:
    explicit Builder(LiftedMesh& mesh)
        : mesh_(mesh),
          field_{mesh.inverse_depth, mesh.tears},
          k_(mesh.intrinsics),
          half_edges_(size_t(4) * mesh.inverse_depth.size(), none) {}

    void run() {
        const int width = mesh_.inverse_depth.width, height = mesh_.inverse_depth.height;
        whole_ = Grid<uint8_t>(width + 1, height + 1, 0);
        tbb::parallel_for(0, height - 1, [&](int y) {
            for (int x = 0; x + 1 < width; ++x)
                whole_.at(x + 1, y + 1) = field_.joined(x, y, x + 1, y) && field_.joined(x, y + 1, x + 1, y + 1) &&
                                          field_.joined(x, y, x, y + 1) && field_.joined(x + 1, y, x + 1, y + 1);
        });
        mesh_.kept.reserve(mesh_.inverse_depth.size() + mesh_.inverse_depth.size() / 8);
        for (int y = -1; y < height; ++y)
            for (int x = -1; x < width; ++x) {
                if (!whole(x, y))
                    emit_split(x, y);
                else if (whole(x, y - 1) && whole(x + 1, y) && whole(x, y + 1) && whole(x - 1, y))
                    mesh_.kept.push_back({pixel(x, y), pixel(x + 1, y), pixel(x + 1, y + 1), pixel(x, y + 1)});
                else
                    emit_fan(x, y);
            }
    }

private:
    LiftedMesh& mesh_;
    Field field_;
    const Intrinsics& k_;
    std::vector<uint32_t> half_edges_;  ///< 4 per pixel: right, down, left, up
    Grid<uint8_t> whole_;

    bool whole(int x, int y) const {
        return x >= -1 && y >= -1 && x < whole_.width - 1 && y < whole_.height - 1 && whole_.at(x + 1, y + 1);
    }
    uint32_t pixel(int x, int y) const { return uint32_t(y) * uint32_t(mesh_.inverse_depth.width) + uint32_t(x); }

    uint32_t add_vertex(double u, double v, double z) {
        const glm::dvec3 p = ray(k_, {u, v}) * z;
        mesh_.vertices.push_back({float(p.x), float(p.y), float(p.z), 0});
        return uint32_t(mesh_.vertices.size() - 1);
    }

    /// The vertex half a pixel from (x, y) towards a neighbour, on (x, y)'s own surface.
    uint32_t half_edge(int x, int y, int dx, int dy) {
        const int way = dx > 0 ? 0 : dy > 0 ? 1 : dx < 0 ? 2 : 3;
        uint32_t& slot = half_edges_[size_t(4) * pixel(x, y) + size_t(way)];
        if (slot != none) return slot;
        slot = add_vertex(x + 0.5 + 0.5 * dx, y + 0.5 + 0.5 * dy, 1.0 / field_.half_edge(x, y, dx, dy));
        if (field_.joined(x, y, x + dx, y + dy))  // the neighbour reaches the same point
            half_edges_[size_t(4) * pixel(x + dx, y + dy) + size_t((way + 2) % 4)] = slot;
        return slot;
    }

    /// A whole cell beside a split one: a fan that shares the split cell's half-edge vertices.
    void emit_fan(int x, int y) {
        constexpr int beyond_x[4] = {0, 1, 0, -1}, beyond_y[4] = {-1, 0, 1, 0};
        std::array<uint32_t, 8> ring;
        size_t count = 0;
        float sum[2] = {0, 0};
        for (int c = 0; c < 4; ++c) {
            const int n = (c + 1) % 4;
            const int x0 = x + corner_dx[c], y0 = y + corner_dy[c];
            ring[count++] = pixel(x0, y0);
            sum[c / 2] += field_.w.at(x0, y0);
            if (!whole(x + beyond_x[c], y + beyond_y[c]))
                ring[count++] = half_edge(x0, y0, corner_dx[n] - corner_dx[c], corner_dy[n] - corner_dy[c]);
        }
        const uint32_t centre = add_vertex(x + 1.0, y + 1.0, 4.0 / double(sum[0] + sum[1]));
        for (size_t i = 0; i < count; ++i) {
            const uint32_t next = ring[(i + 1) % count];
            mesh_.kept.push_back({centre, ring[i], next, next});
        }
    }

    void emit_split(int x, int y) {
        const SplitCell cell = split_cell(field_, x, y);
        std::array<uint32_t, 4> centre{none, none, none, none};
        for (int c = 0; c < 4; ++c)
            if (cell.part[c] == c) centre[c] = add_vertex(x + 1.0, y + 1.0, 1.0 / cell.centre[c]);
        const auto step = [](int from, int to) {
            return glm::ivec2(corner_dx[to] - corner_dx[from], corner_dy[to] - corner_dy[from]);
        };
        for (int c = 0; c < 4; ++c) {
            if (cell.part[c] < 0) continue;
            const int px = x + corner_dx[c], py = y + corner_dy[c];
            const glm::ivec2 next = step(c, (c + 1) % 4), last = step(c, (c + 3) % 4);
            mesh_.kept.push_back({pixel(px, py), half_edge(px, py, next.x, next.y), centre[cell.part[c]],
                                  half_edge(px, py, last.x, last.y)});
        }
        for (int c = 0; c < 4; ++c) {
            const int n = (c + 1) % 4;
            if (cell.state[c] == Pixel::missing || cell.state[n] == Pixel::missing || cell.joined_next[c]) continue;
            emit_wall(x, y, cell, c, n);
        }
    }

    /// The wall on the line from the middle of the edge between two corners to the cell's centre, from
    /// one side's 1/z to the other's. It stands in the plane of the recorded rays.
    void emit_wall(int x, int y, const SplitCell& cell, int a, int b) {
        const double mx = x + 0.5 + 0.5 * (corner_dx[a] + corner_dx[b]),
                     my = y + 0.5 + 0.5 * (corner_dy[a] + corner_dy[b]);
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
        const auto add = [&](double u, double v, float w) {
            mesh_.wall_vertices.push_back({float((u - k_.cx) / k_.fx), float((v - k_.cy) / k_.fy), w, 0});
            return uint32_t(mesh_.wall_vertices.size() - 1);
        };
        const uint32_t a_mid = add(mx, my, from[0]), a_centre = add(x + 1.0, y + 1.0, from[1]);
        mesh_.torn.push_back({a_mid, a_centre, add(x + 1.0, y + 1.0, to[1]), add(mx, my, to[0])});
    }
};

}  // namespace

LiftedMesh lift(const Intrinsics& intrinsics, const DepthMap& depth, const LiftOptions& options) {
    if (depth.width != intrinsics.width || depth.height != intrinsics.height || depth.width < 1 || depth.height < 1)
        throw Error(ExitCode::bad_input,
                    "depth: size: got " + std::to_string(depth.width) + "x" + std::to_string(depth.height) +
                        ", expected " + std::to_string(intrinsics.width) + "x" + std::to_string(intrinsics.height));
    LiftedMesh mesh;
    mesh.intrinsics = intrinsics;
    mesh.inverse_depth = Grid<float>(depth.width, depth.height);
    mesh.vertices.resize(depth.size());
    float nearest_m = 1e12f;
    for (int y = 0; y < depth.height; ++y) {
        for (int x = 0; x < depth.width; ++x) {
            const float z = depth.at(x, y);
            const bool sky = is_sky(z);
            const bool valid = is_measured(z);
            mesh.sky_px += sky;
            mesh.invalid_px += !sky && !valid;
            mesh.inverse_depth.at(x, y) = sky ? 0.0f : valid ? 1.0f / z : std::numeric_limits<float>::quiet_NaN();
            LiftedVertex& vertex = mesh.vertices[size_t(y) * size_t(depth.width) + size_t(x)];
            if (!valid) {
                vertex = {0, 0, 0, 0};  // never referenced
                continue;
            }
            nearest_m = std::min(nearest_m, z);
            const glm::dvec3 p = ray(intrinsics, {x + 0.5, y + 0.5}) * double(z);
            vertex = {float(p.x), float(p.y), float(p.z), 0};
        }
    }
    find_tears(mesh, options);
    // Walls beside a pixel without a measurement end this near to the camera: a power of two, so that
    // the mesh of a scaled scene is the scaled mesh to the bit.
    mesh.wall_top = 1024.0f / nearest_m;
    Builder(mesh).run();
    return mesh;
}

float surface_inverse_depth(const LiftedMesh& mesh, glm::dvec2 u_px) {
    const float nan = std::numeric_limits<float>::quiet_NaN();
    if (!in_image(mesh.intrinsics, u_px)) return nan;
    const Field field{mesh.inverse_depth, mesh.tears};
    const int cx = int(std::floor(u_px.x - 0.5)), cy = int(std::floor(u_px.y - 0.5));
    const float fx = float(u_px.x - 0.5 - cx), fy = float(u_px.y - 0.5 - cy);
    const int owner = fy < 0.5f ? (fx < 0.5f ? 0 : 1) : (fx < 0.5f ? 3 : 2);
    const int px = cx + corner_dx[owner], py = cy + corner_dy[owner];
    switch (field.state(px, py)) {
        case Pixel::missing:
        case Pixel::invalid:
            return nan;
        case Pixel::sky:
            return 0;
        case Pixel::solid:
            break;
    }
    const SplitCell cell = split_cell(field, cx, cy);
    if (cell.joined_next[0] && cell.joined_next[1] && cell.joined_next[2] && cell.joined_next[3]) {
        const float w00 = field.w.at(cx, cy), w10 = field.w.at(cx + 1, cy);
        const float w01 = field.w.at(cx, cy + 1), w11 = field.w.at(cx + 1, cy + 1);
        return fx + fy < 1 ? w00 + fx * (w10 - w00) + fy * (w01 - w00)
                           : w11 + (1 - fx) * (w01 - w11) + (1 - fy) * (w10 - w11);
    }
    // Bilinear over the owner's quarter: its centre, two half edges, the cell's centre.
    const float ax = 2 * std::fabs(fx - float(corner_dx[owner])), ay = 2 * std::fabs(fy - float(corner_dy[owner]));
    const float own = field.w.at(px, py);
    const bool next_is_x = owner == 0 || owner == 2;
    const float along_x = next_is_x ? cell.towards_next[owner] : cell.towards_last[owner];
    const float along_y = next_is_x ? cell.towards_last[owner] : cell.towards_next[owner];
    return (1 - ay) * ((1 - ax) * own + ax * along_x) + ay * ((1 - ax) * along_y + ax * cell.centre[cell.part[owner]]);
}

}  // namespace vshift
