// SPDX-License-Identifier: Apache-2.0
#include "embree_core/lift.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "embree_core/lift_kernels.h"
#include "embree_core/mesh_builder.h"

namespace vshift {
namespace {

/// Torn: the step of 1/z is visible at this baseline, and no plane on either side explains it.
bool torn_between(float before, float a, float b, float after, double px_per_inverse_depth, const DepthRules& rules) {
    const float step = std::fabs(b - a);
    if (!(px_per_inverse_depth * step > rules.tear_px)) return false;
    const float left = (before - a) + (b - a), right = (a - b) + (after - b);  // NaN where there is no such pixel
    float smallest = std::numeric_limits<float>::infinity();
    if (!std::isnan(left)) smallest = std::min(smallest, std::fabs(left));
    if (!std::isnan(right)) smallest = std::min(smallest, std::fabs(right));
    const double share = left * right > 0 ? rules.crease_break : rules.tear_break;
    return smallest >= float(share) * step + 4 * rules.error.at(std::max(a, b));
}

/// Pixels that are no vertices of the collapsed mesh any more move onto it.
void snap_pixels(LiftedMesh& mesh, const CellPlan& plan) {
    if (plan.collapsed.empty()) return;
    const Intrinsics& k = mesh.intrinsics;
    std::vector<double> ray_x, ray_y;
    for (int x = 0; x < k.width; ++x) ray_x.push_back(ray(k, {x + 0.5, 0}).x);
    for (int y = 0; y < k.height; ++y) ray_y.push_back(ray(k, {0, y + 0.5}).y);
    tbb::parallel_for(0, plan.collapsed[0].height, [&](int pair) {
        // A block belongs to its first pair of rows.
        for (int level = 1; level <= int(plan.collapsed.size()); ++level) {
            if (pair & ((1 << (level - 1)) - 1)) break;
            const int y = pair >> (level - 1);
            if (y >= plan.collapsed[size_t(level) - 1].height) break;
            for (int x = 0; x < plan.collapsed[size_t(level) - 1].width; ++x) {
                if (!plan.is_collapsed(level, x, y)) continue;
                if (level < int(plan.collapsed.size()) && plan.is_collapsed(level + 1, x >> 1, y >> 1)) continue;
                snap_block(mesh.inverse_depth, plan, level, x, y, [&](int px, int py) {
                    const size_t at = size_t(py) * size_t(k.width) + size_t(px);
                    const double z = 1 / double(mesh.inverse_depth.data[at]);
                    mesh.vertices[at] = {float(ray_x[size_t(px)] * z), float(ray_y[size_t(py)] * z), float(z), 0};
                });
            }
        }
    });
}

/// The least step of 1/z that shows: `torn_between`'s first test, the same for every float.
float least_step(double px_per_inverse_depth, double tear_px) {
    const float infinite = std::numeric_limits<float>::infinity();
    const auto shows = [&](float step) { return px_per_inverse_depth * double(step) > tear_px; };
    if (!(px_per_inverse_depth > 0)) return infinite;
    float step = float(tear_px / px_per_inverse_depth);
    while (step > 0 && shows(step)) step = std::nextafter(step, 0.0f);
    while (step < infinite && !shows(step)) step = std::nextafter(step, infinite);
    return step;
}

}  // namespace

void find_tears(const Intrinsics& intrinsics, const Grid<float>& w, const LiftOptions& options, Grid<uint8_t>& tears) {
    const float nan = std::numeric_limits<float>::quiet_NaN();
    if (tears.width != w.width || tears.height != w.height) tears = Grid<uint8_t>(w.width, w.height, 0);
    const double fx_b = intrinsics.fx * options.baseline_m, fy_b = intrinsics.fy * options.baseline_m;
    const DepthRules& rules = options.rules;
    const auto rule = [&](double scale) {
        return lifting::TearRule{least_step(scale, rules.tear_px),
                                 float(rules.tear_break),
                                 float(rules.crease_break),
                                 rules.error.constant,
                                 rules.error.relative,
                                 rules.error.squared};
    };
    const lifting::TearRule across = rule(fx_b), down = rule(fy_b);
    const std::vector<float> beyond(size_t(w.width), nan);
    tbb::parallel_for(0, w.height, [&](int y) {
        const auto value = [&](int x, int row) {
            return x < 0 || row < 0 || x >= w.width || row >= w.height ? nan : w.at(x, row);
        };
        const auto row_at = [&](int row) {
            return row < 0 || row >= w.height ? beyond.data() : &w.data[size_t(row) * size_t(w.width)];
        };
        const float* own = row_at(y);
        uint8_t* row = &tears.data[size_t(y) * size_t(w.width)];
        const auto one = [&](int x) {
            const float a = own[x];
            const auto torn = [&](float b, float before, float after, double scale) {
                if (std::isnan(b)) return false;  // no such pixel, or no measurement: never joined anyway
                if ((a > 0) != (b > 0)) return true;
                return torn_between(before, a, b, after, scale, rules);
            };
            uint8_t bits = 0;
            if (torn(value(x + 1, y), value(x - 1, y), value(x + 2, y), fx_b)) bits |= 1;
            if (torn(value(x, y + 1), value(x, y - 1), value(x, y + 2), fy_b)) bits |= 2;
            row[x] = bits;
        };
        // The kernel looks one pixel back and two ahead.
        const size_t inner =
            w.width > 3 ? lifting::kernels().tears(row_at(y - 1) + 1, own + 1, row_at(y + 1) + 1, row_at(y + 2) + 1,
                                                   size_t(w.width) - 3, across, down, row + 1)
                        : 0;
        one(0);
        for (int x = 1 + int(inner); x < w.width; ++x) one(x);
    });
}

namespace {

template <bool inner>
SplitCell split(const SurfaceField& f, int cx, int cy) {
    SplitCell cell{};
    for (int c = 0; c < 4; ++c) {
        const int x = cx + corner_dx[c], y = cy + corner_dy[c];
        cell.state[c] = f.state(x, y);
        cell.part[c] = cell.state[c] == Pixel::solid ? c : -1;
    }
    for (int c = 0; c < 4; ++c) {
        const int n = (c + 1) % 4;
        const int x0 = cx + corner_dx[c], y0 = cy + corner_dy[c];
        const int x1 = cx + corner_dx[n], y1 = cy + corner_dy[n];
        cell.joined_next[c] = f.joined<inner>(x0, y0, x1, y1);
        if (cell.joined_next[c]) {
            cell.towards_next[c] = cell.towards_last[n] = 0.5f * (f.w.at(x0, y0) + f.w.at(x1, y1));
            continue;
        }
        if (cell.state[c] == Pixel::solid) cell.towards_next[c] = f.torn_edge<inner>(x0, y0, x1 - x0, y1 - y0);
        if (cell.state[n] == Pixel::solid) cell.towards_last[n] = f.torn_edge<inner>(x1, y1, x0 - x1, y0 - y1);
    }
    for (int pass = 0; pass < 3; ++pass)  // round three joined edges at most
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

}  // namespace

SplitCell split_cell(const SurfaceField& f, int cx, int cy) {
    const bool inner = cx > 0 && cy > 0 && cx + 2 < f.w.width && cy + 2 < f.w.height;
    return inner ? split<true>(f, cx, cy) : split<false>(f, cx, cy);
}

void check_size(const Intrinsics& intrinsics, const DepthMap& depth) {
    if (depth.width == intrinsics.width && depth.height == intrinsics.height && depth.width > 0 && depth.height > 0)
        return;
    throw Error(ExitCode::bad_input, "depth: size: got " + std::to_string(depth.width) + "x" +
                                         std::to_string(depth.height) + ", expected " +
                                         std::to_string(intrinsics.width) + "x" + std::to_string(intrinsics.height));
}

LiftedMesh lift(const Intrinsics& intrinsics, const DepthMap& depth, const LiftOptions& options) {
    check_size(intrinsics, depth);
    LiftedMesh mesh;
    mesh.error = options.rules.error;
    mesh.intrinsics = intrinsics;
    mesh.depth = depth;
    mesh.inverse_depth = Grid<float>(depth.width, depth.height);
    const lifting::RowCounts counts = lifting::inverse_of(depth, mesh.inverse_depth);
    mesh.invalid_px = counts.invalid, mesh.sky_px = counts.sky;
    find_tears(intrinsics, mesh.inverse_depth, options, mesh.tears);
    mesh.wall_top = wall_top_of_nearest / counts.nearest_m;
    const double px_per_inverse_depth = std::max(intrinsics.fx, intrinsics.fy) * options.baseline_m;
    const float bound =
        options.tolerance_px > 0 ? float(std::min(options.tolerance_px / px_per_inverse_depth, 1e30)) : 0;
    mesh.bound = bound;
    const CellPlan plan = plan_cells({mesh.inverse_depth, mesh.tears}, bound);
    build_mesh(mesh, plan);
    snap_pixels(mesh, plan);
    return mesh;
}

float surface_inverse_depth(const LiftedMesh& mesh, glm::dvec2 u_px) {
    return surface_inverse_depth(mesh.inverse_depth, mesh.tears, u_px);
}

float surface_inverse_depth(const Grid<float>& w, const Grid<uint8_t>& tears, glm::dvec2 u_px) {
    const float nan = std::numeric_limits<float>::quiet_NaN();
    if (!(u_px.x >= 0 && u_px.x < w.width && u_px.y >= 0 && u_px.y < w.height)) return nan;
    const SurfaceField field{w, tears};
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
    if (cx >= 0 && cy >= 0 && cx + 1 < field.w.width && cy + 1 < field.w.height && field.whole(cx, cy)) {
        const float w00 = field.w.at(cx, cy), w10 = field.w.at(cx + 1, cy);
        const float w01 = field.w.at(cx, cy + 1), w11 = field.w.at(cx + 1, cy + 1);
        return fx + fy < 1 ? w00 + fx * (w10 - w00) + fy * (w01 - w00)
                           : w11 + (1 - fx) * (w01 - w11) + (1 - fy) * (w10 - w11);
    }
    const SplitCell cell = split_cell(field, cx, cy);
    // Bilinear over the owner's quarter: its centre, two half edges, the cell's centre.
    const float ax = 2 * std::fabs(fx - float(corner_dx[owner])), ay = 2 * std::fabs(fy - float(corner_dy[owner]));
    const float own = field.w.at(px, py);
    const bool next_is_x = owner == 0 || owner == 2;
    const float along_x = next_is_x ? cell.towards_next[owner] : cell.towards_last[owner];
    const float along_y = next_is_x ? cell.towards_last[owner] : cell.towards_next[owner];
    return (1 - ay) * ((1 - ax) * own + ax * along_x) + ay * ((1 - ax) * along_y + ax * cell.centre[cell.part[owner]]);
}

}  // namespace vshift
