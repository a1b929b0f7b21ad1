// SPDX-License-Identifier: Apache-2.0
#include "embree_core/mask.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <optional>

#include "embree_core/ray_filter.h"

namespace vshift {
namespace {

// Rays start and end this share of the segment away from its ends. Any value from 1e-6 to 1e-3 gives
// the same masks; 0 finds the surface itself.
constexpr double ray_offset = 1e-4;
// A ray that meets a vertex to the bit can slip between its triangles, even in a robust scene, and a
// shift along the rows would send every ray from vertex to vertex. So V's centre is missed by this much
// in pixels of the recorded pixel, along both image axes.
constexpr glm::dvec2 miss_px{0.001, largest_miss_px};
// How far the sampling of one camera may misplace a surface that another one sees, in its pixels.
constexpr double footprint_px = 2.0;
// The sky is looked at as far as this.
constexpr double sky_reach_m = 1e6;

/// The part [begin, end] of origin + t direction (world frame) whose freedom is asked for.
struct Stretch {
    glm::dvec3 origin, direction;
    double begin, end;
    glm::dvec3 shifted_end;  ///< where it stops before V, or starts behind it (own camera's frame)
};

struct Interval {
    double begin, end;
};

/// `gaps` minus `cover`: what of them is not covered.
std::vector<Interval> subtract(const std::vector<Interval>& gaps, const Interval& cover) {
    std::vector<Interval> left;
    for (const Interval& gap : gaps) {
        if (cover.end <= gap.begin || cover.begin >= gap.end) {
            left.push_back(gap);
            continue;
        }
        if (gap.begin < cover.begin) left.push_back({gap.begin, cover.begin});
        if (cover.end < gap.end) left.push_back({cover.end, gap.end});
    }
    return left;
}

/// One view with the stretch's line in its own frame.
struct ViewedLine {
    const LiftedView* view;
    glm::dvec3 origin, direction;

    ViewedLine(const LiftedView& v, const glm::dvec3& o_cam, const glm::dvec3& d_cam)
        : view(&v), origin(o_cam), direction(d_cam) {}
    ViewedLine(const LiftedView& v, const Stretch& world) : view(&v) {
        const Pose cam_from_world = inverse(v.world_from_cam);
        origin = cam_from_world.point(world.origin);
        direction = cam_from_world.direction(world.direction);
    }
    glm::dvec3 at(double t) const { return origin + t * direction; }

    /// The part of `within` inside this view's frustum.
    std::optional<Interval> inside(const Interval& within) const {
        const auto t = clip_to_frustum(view->mesh.intrinsics, at(within.begin), at(within.end));
        if (!t) return std::nullopt;
        const double length = within.end - within.begin;
        return Interval{within.begin + t->x * length, within.begin + t->y * length};
    }
    bool meets_surface(const Interval& range) const {
        return view->kept.occluded(glm::vec3(origin), glm::vec3(direction), float(range.begin), float(range.end));
    }
    /// Whether this view saw past the point at t.
    bool saw_past(double t) const {
        const glm::dvec3 p = at(t);
        const auto u = project(view->mesh.intrinsics, p);
        return u && 1.0 / p.z > double(surface_inverse_depth(view->mesh, *u));
    }
    /// Parts of `range` (inside the frustum) that this view saw past: between two crossings of its
    /// surfaces and walls the answer is the same, so one point decides for each part.
    void free_parts(const Interval& range, std::vector<Interval>& out) const {
        std::vector<double> cuts{range.begin, range.end};
        view->kept.crossings(glm::vec3(origin), glm::vec3(direction), range.begin, range.end,
                             [&](double t) { cuts.push_back(t); });
        view->torn.crossings(origin, direction, range.begin, range.end, cuts);
        std::sort(cuts.begin(), cuts.end());
        for (size_t i = 0; i + 1 < cuts.size(); ++i)
            if (cuts[i] < cuts[i + 1] && saw_past(0.5 * (cuts[i] + cuts[i + 1]))) out.push_back({cuts[i], cuts[i + 1]});
    }
};

/// Whether the surface round solid pixel (x, y) hides the camera centre `c` (own frame): the segment to it from `p`,
/// the pixel's point, starts below the surface. Both are straight in (u, v, 1/z) over a quarter pixel, so their
/// heights there are compared; at a crease the side that the segment leaves over decides.
bool faces_away(const LiftedMesh& mesh, int x, int y, const glm::dvec3& p, const glm::dvec3& c) {
    const glm::dvec3 d = c - p;
    const double per_z2 = 1.0 / (p.z * p.z);
    const glm::dvec2 px_rate =
        glm::dvec2(mesh.intrinsics.fx * (d.x * p.z - p.x * d.z), mesh.intrinsics.fy * (d.y * p.z - p.y * d.z)) * per_z2;
    const double rate = glm::length(px_rate);
    constexpr double step_px = 0.25;
    // A segment that stays within a hundredth of a pixel (V on this pixel's ray) leaves along the ray.
    if (!(rate > 0) || rate * p.z < 0.01 * std::fabs(d.z)) return d.z > 0;
    const double height = 1 / p.z;
    const double segment = height - d.z * per_z2 / rate * step_px;
    const double surface = surface_inverse_depth(mesh, glm::dvec2(x + 0.5, y + 0.5) + px_rate * (step_px / rate));
    return segment < surface - 1e-6 * height;  // 1e-6: the rounding of three floats
}

enum class Answer { visible, occluded, unknown };
struct Finding {
    Answer answer = Answer::visible;
    bool unseen = false;
};

/// What one camera alone can say about its own pixel's segment: any wall it passes hides something.
Answer ask_own(const ViewedLine& line, const Stretch& stretch, const Interval& whole) {
    if (line.meets_surface(whole)) return Answer::occluded;
    const bool passed = line.view->torn.passed(line.origin, line.direction, stretch.begin, stretch.end);
    return passed ? Answer::unknown : Answer::visible;
}

/// What the whole rig can say where the own camera alone is not certain (method.md: carving).
/// `slack` is a camera's misplacement of surfaces in units of t.
Finding ask_rig(const LiftedRig& rig, const ViewedLine& own, const Stretch& stretch, double slack) {
    Finding finding;
    const Interval asked{stretch.begin, stretch.end};
    if (!(asked.begin < asked.end)) return finding;
    std::vector<Interval> gaps{asked}, parts;
    std::vector<std::pair<ViewedLine, Interval>> looking;
    for (size_t i = 0; i < rig.views.size(); ++i) {
        const ViewedLine line = int(i) == rig.own ? own : ViewedLine(rig.views[i], stretch);
        if (const auto range = line.inside(asked)) looking.emplace_back(line, *range);
    }
    for (const auto& [line, range] : looking) {
        parts.clear();
        line.free_parts(range, parts);
        for (const Interval& part : parts) gaps = subtract(gaps, part);
        if (gaps.empty()) return finding;
    }
    std::erase_if(gaps, [&](const Interval& gap) { return gap.end - gap.begin <= slack; });
    for (const Interval& gap : gaps) {
        std::vector<Interval> unlooked{gap};
        for (const auto& [line, range] : looking) {
            const Interval reach{std::max({gap.begin - slack, range.begin, asked.begin}),
                                 std::min({gap.end + slack, range.end, asked.end})};
            if (line.meets_surface(reach)) {
                finding.answer = Answer::occluded;
                return finding;
            }
            unlooked = subtract(unlooked, range);
        }
        double outside_all = 0;
        for (const Interval& part : unlooked) outside_all += part.end - part.begin;
        if (outside_all > slack) finding.unseen = true;
        if (gap.end - gap.begin - outside_all > slack) finding.answer = Answer::unknown;
    }
    return finding;
}

}  // namespace

RecordedMasks mask(const LiftedRig& rig, const ShiftedCamera& shifted, double clear_m, Casting casting) {
    const LiftedView& own = rig.views.at(size_t(rig.own));
    const Intrinsics& k = own.mesh.intrinsics;
    const Pose shifted_from_world = inverse(shifted.world_from_cam);
    const Pose shifted_from_own = compose(shifted_from_world, own.world_from_cam);
    const glm::dvec3 centre_world = shifted.world_from_cam.translation_m;
    const glm::dvec3 centre_own = inverse(own.world_from_cam).point(centre_world);
    const bool still = glm::length(centre_own) < 1e-9;  // V sees what R saw
    std::optional<RayFilter> filter;
    if (casting == Casting::where_needed && !still) filter.emplace(own.mesh.surface(), centre_own);

    RecordedMasks out;
    for (Mask* m : {&out.lost, &out.occluded, &out.outside, &out.unknown, &out.unseen}) *m = Mask(k.width, k.height, 0);

    const auto pixel = [&](int x, int y) {
        const float w = own.mesh.inverse_depth.at(x, y);
        if (std::isnan(w)) {
            out.unknown.at(x, y) = 1;
            return;
        }
        const bool sky = w == 0;
        const LiftedVertex& vertex = own.mesh.vertices[size_t(y) * size_t(k.width) + size_t(x)];
        glm::dvec3 p = sky ? ray(k, {x + 0.5, y + 0.5}) : glm::dvec3(vertex.x, vertex.y, vertex.z);

        const glm::dvec3 p_shifted = sky ? shifted_from_own.direction(p) : shifted_from_own.point(p);
        const auto u_shifted = project(shifted.intrinsics, p_shifted);
        const bool outside = !u_shifted || !in_image(shifted.intrinsics, *u_shifted);

        if (!sky && !own.mesh.error.none()) p *= double(w / (w + 2 * own.mesh.error.at(w)));  // see DepthRules
        // In the own camera's frame: finite points look towards V, the sky is looked at from V.
        Stretch stretch;
        Interval whole;
        double slack;  // misplacement of a surface by its sampling, in units of t
        if (sky) {
            const glm::dvec3 d = glm::normalize(p + glm::dvec3(miss_px.x / k.fx, miss_px.y / k.fy, 0));
            stretch = {centre_own, d, clear_m, sky_reach_m, centre_own + clear_m * glm::normalize(p)};
            whole = {0, sky_reach_m};
            slack = 1e-3;
        } else {
            const glm::dvec3 aim = centre_own + glm::dvec3(miss_px.x / k.fx, miss_px.y / k.fy, 0) * p.z;
            const double distance = glm::length(aim - p);
            const double end = distance > 0 ? std::min(1 - clear_m / distance, 1 - ray_offset) : 0;
            stretch = {p, aim - p, ray_offset, end, p + end * (centre_own - p)};
            whole = {ray_offset, 1 - ray_offset};
            slack = distance > 0 ? std::max(ray_offset, footprint_px * p.z / k.fx / distance) : 1;
        }
        // The line starts at the mesh's own vertex to the bit.
        const ViewedLine line(own, stretch.origin, stretch.direction);
        Finding finding;
        if (!still && !(filter && !filter->asks(x, y))) {
            finding.answer = ask_own(line, stretch, whole);
            if (!sky && faces_away(own.mesh, x, y, p, centre_own)) finding.answer = Answer::occluded;
        }
        // The frustum is convex and holds the other end, so the whole stretch is in it if this end is.
        finding.unseen = !still && stretch.begin < stretch.end && !in_frustum(k, stretch.shifted_end);
        const bool uncertain =
            finding.answer == Answer::unknown || (finding.answer == Answer::visible && finding.unseen);
        if (uncertain && rig.views.size() > 1) {
            Stretch in_world = stretch;
            in_world.origin = own.world_from_cam.point(stretch.origin);
            in_world.direction = own.world_from_cam.direction(stretch.direction);
            finding = ask_rig(rig, line, in_world, slack);
        }
        out.occluded.at(x, y) = finding.answer == Answer::occluded;
        out.unknown.at(x, y) = finding.answer == Answer::unknown;
        out.unseen.at(x, y) = finding.unseen;
        out.outside.at(x, y) = outside;
        out.lost.at(x, y) = outside || finding.answer == Answer::occluded;
    };
    tbb::parallel_for(0, k.height, [&](int y) {
        for (int x = 0; x < k.width; ++x) pixel(x, y);
    });
    return out;
}

}  // namespace vshift
