// SPDX-License-Identifier: Apache-2.0
#include "embree_core/mask.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <utility>

#include "embree_core/sweep.h"

namespace vshift {
namespace {

// How far the sampling of one camera may misplace a surface that another one sees, in its pixels.
constexpr double footprint_px = 2.0;
// The sky is looked at as far as this.
constexpr double sky_reach_m = 1e6;

/// The part [begin, end] of origin + t direction (world frame) whose freedom is asked for.
struct Stretch {
    glm::dvec3 origin, direction;
    double begin, end;
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

/// A pixel's point and the way from there to V. Lines start at the mesh's own vertices to the bit.
struct Question {
    glm::dvec3 p;
    bool sky;
    Stretch stretch;  ///< in the own camera's frame: finite points look towards V, the sky is looked at from V
    Interval whole;
    double slack;  ///< misplacement of a surface by its sampling, in units of t
};

class OwnView {
public:
    OwnView(const LiftedView& view, const glm::dvec3& centre, double clear_m)
        : view_(view), mesh_(view.mesh), centre_(centre), clear_m_(clear_m) {}

    bool measured(int x, int y) const { return !std::isnan(mesh_.inverse_depth.at(x, y)); }

    Question question(int x, int y) const {
        const Intrinsics& k = mesh_.intrinsics;
        const float w = mesh_.inverse_depth.at(x, y);
        Question q;
        q.sky = w == 0;
        if (q.sky) {
            q.p = ray(k, {x + 0.5, y + 0.5});
            const glm::dvec3 d = glm::normalize(q.p + glm::dvec3(miss_px.x / k.fx, miss_px.y / k.fy, 0));
            q.stretch = {centre_, d, clear_m_, sky_reach_m};
            q.whole = {0, sky_reach_m};
            q.slack = 1e-3;
            return q;
        }
        const LiftedVertex& vertex = mesh_.vertices[size_t(y) * size_t(k.width) + size_t(x)];
        q.p = {vertex.x, vertex.y, vertex.z};
        if (!mesh_.error.none()) q.p *= double(w / (w + 2 * mesh_.error.at(w)));  // see DepthRules
        const glm::dvec3 aim = centre_ + glm::dvec3(miss_px.x / k.fx, miss_px.y / k.fy, 0) * q.p.z;
        const double distance = glm::length(aim - q.p);
        const double end = distance > 0 ? std::min(1 - clear_m_ / distance, 1 - ray_offset) : 0;
        q.stretch = {q.p, aim - q.p, ray_offset, end};
        q.whole = {ray_offset, 1 - ray_offset};
        q.slack = distance > 0 ? std::max(ray_offset, footprint_px * q.p.z / k.fx / distance) : 1;
        return q;
    }

    /// Adds to `classes`, a row of them, what this camera alone can say about `count` of its pixels, a packet's at
    /// most: any wall that a segment passes hides something.
    void ask(const int* columns, int count, int y, uint8_t* classes) const {
        std::array<Question, RayPacket::size> questions;
        RayPacket packet;
        uint32_t asked = 0;
        for (int i = 0; i < count; ++i) {
            if (!measured(columns[i], y)) continue;
            const Question& q = questions[size_t(i)] = question(columns[i], y);
            packet.set(i, glm::vec3(q.stretch.origin), glm::vec3(q.stretch.direction), float(q.whole.begin),
                       float(q.whole.end));
            asked |= 1u << i;
        }
        uint32_t occluded = view_.kept.occluded(packet, asked), walled = 0;
        for (int i = 0; i < count; ++i) {
            if (!((asked & ~occluded) >> i & 1)) continue;
            const Question& q = questions[size_t(i)];
            if (!q.sky && faces_away(mesh_, columns[i], y, q.p, centre_))
                occluded |= 1u << i;
            else if (view_.torn.add(q.stretch.origin, q.stretch.direction, q.stretch.begin, q.stretch.end, i, packet))
                walled |= 1u << i;
        }
        walled = view_.torn.passed(packet, walled);
        for (int i = 0; i < count; ++i)
            classes[columns[i]] |=
                uint8_t((occluded >> i & 1 ? occluded_bit : 0) | (walled >> i & 1 ? unknown_bit : 0));
    }

private:
    const LiftedView& view_;
    const LiftedMesh& mesh_;
    const glm::dvec3 centre_;
    const double clear_m_;
};

}  // namespace

RecordedMasks mask(const LiftedRig& rig, const ShiftedCamera& shifted, double clear_m, Casting casting) {
    const LiftedView& own = rig.views.at(size_t(rig.own));
    const Intrinsics& k = own.mesh.intrinsics;
    const Pose own_from_shifted = compose(inverse(own.world_from_cam), shifted.world_from_cam);
    const glm::dvec3 centre = own_from_shifted.translation_m;
    const bool still = glm::length(centre) < 1e-9;  // V sees what R saw
    std::unique_ptr<const RayFilter> filter;
    if (casting == Casting::where_needed && !still)
        filter = std::make_unique<const RayFilter>(own.mesh.surface(), centre);

    const OwnView view(own, centre, clear_m);
    const PointBits point_bits({k, shifted.intrinsics, own_from_shifted, clear_m});
    Grid<uint8_t> classes(k.width, k.height, 0);
    tbb::parallel_for(0, k.height, [&](int y) {
        uint8_t* row = &classes.at(0, y);
        const auto every = [](int) { return true; };
        const auto ask = [&](const int* columns, int count) { view.ask(columns, count, y, row); };
        if (!still) ask_in_packets<RayPacket::size>(filter.get(), k.width, y, every, ask);
        point_bits.add(own.mesh.depth, y, row);
        for (int x = 0; x < k.width && rig.views.size() > 1; ++x) {
            const uint8_t before = row[x];
            const bool uncertain = before & unknown_bit || (!(before & occluded_bit) && before & unseen_bit);
            if (!uncertain || !view.measured(x, y)) continue;
            const Question q = view.question(x, y);
            Stretch in_world = q.stretch;
            in_world.origin = own.world_from_cam.point(q.stretch.origin);
            in_world.direction = own.world_from_cam.direction(q.stretch.direction);
            const Finding finding =
                ask_rig(rig, ViewedLine(own, q.stretch.origin, q.stretch.direction), in_world, q.slack);
            row[x] = uint8_t((before & outside_bit) |
                             (finding.answer == Answer::occluded  ? occluded_bit
                              : finding.answer == Answer::unknown ? unknown_bit
                                                                  : 0) |
                             (finding.unseen ? unseen_bit : 0));
        }
    });
    return masks_of(classes);
}

RecordedMasks masks_of(const Grid<uint8_t>& classes) {
    RecordedMasks out;
    for (Mask* m : {&out.lost, &out.occluded, &out.outside, &out.unknown, &out.unseen})
        *m = Mask(classes.width, classes.height, 0);
    const auto tell = [&](Mask& m, uint8_t bits) {
        std::transform(classes.data.begin(), classes.data.end(), m.data.begin(),
                       [bits](uint8_t c) { return uint8_t((c & bits) != 0); });
    };
    tell(out.occluded, occluded_bit);
    tell(out.outside, outside_bit);
    tell(out.unknown, unknown_bit);
    tell(out.unseen, unseen_bit);
    tell(out.lost, occluded_bit | outside_bit);
    return out;
}

}  // namespace vshift
