// SPDX-License-Identifier: Apache-2.0
#include "embree_core/seam.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <list>

namespace vshift {
namespace {

SurfaceField field_of(const SurfaceView& view) {
    return {view.inverse_depth, view.tears};
}

/// A neighbour, ready for one target camera.
struct Neighbor {
    const SeamCamera* camera;
    int index;
    Sampler sampler;
    glm::dvec3 centre_m;  ///< world
    double axis_cosine;   ///< between its optical axis and the target's
    Pose cam_from_world;
    Reprojection* shown;

    glm::vec3 color(glm::vec2 source_px, glm::vec2 target_px, const glm::dvec3& from, const glm::dvec3& along,
                    double t) const {
        if (camera->bent) source_px = bent_source_px(*camera->bent, from, along, t);
        return camera->gain * sampler.at(source_px, target_px);
    }
};

std::list<Neighbor> neighbors_of(const std::vector<SeamCamera>& rig, int own, const Intrinsics& target,
                                   const Pose& world_from_target) {
    std::list<Neighbor> out;
    const glm::dvec3 axis = world_from_target.direction({0, 0, 1});
    for (size_t i = 0; i < rig.size(); ++i) {
        if (int(i) == own) continue;
        const SurfaceView& view = *rig[i].surface;
        const ProjectiveMap map = projective_map(view.intrinsics, view.world_from_cam, target, world_from_target);
        out.push_back({&rig[i], int(i), Sampler(field_of(view), *rig[i].image, map), view.world_from_cam.translation_m,
                       glm::dot(axis, view.world_from_cam.direction({0, 0, 1})), inverse(view.world_from_cam),
                       nullptr});
    }
    // Ties in viewing direction, and the sky, go to the camera that looks most nearly the same way.
    out.sort([](const Neighbor& a, const Neighbor& b) { return a.axis_cosine > b.axis_cosine; });
    return out;
}

/// How nearly the neighbour looks at point p as the target does, which looks along `along`.
double direction_cosine(const Neighbor& n, const glm::dvec3& p, const glm::dvec3& along) {
    const glm::dvec3 d = p - n.centre_m;
    return glm::dot(d, along) / std::sqrt(glm::dot(d, d) * glm::dot(along, along));
}

/// The neighbour whose colour is taken: of those that show the surface unmixed, or else of all, the one that looks most
/// nearly the same way.
struct Choice {
    const Neighbor* of = nullptr;
    bool mixed = true;
    glm::vec2 source_px{0};
    double cosine = -2, t = 0;

    void offer(const Neighbor& n, glm::vec2 at_px, EdgeBand edge, double its_cosine, double its_t) {
        if (!mixed && !(its_cosine > cosine)) return;
        const bool its_mixed = edge == EdgeBand::drop && n.sampler.is_edge(at_px);
        if (its_mixed == mixed ? its_cosine > cosine : mixed) *this = {&n, its_mixed, at_px, its_cosine, its_t};
    }
};

/// Where the neighbour saw the point t along a ray of the target (infinite: the sky), if it did.
std::optional<glm::vec2> seen_at(const Neighbor& n, const glm::dvec3& from, const glm::dvec3& along, double t,
                                 double tolerance) {
    const bool sky = !std::isfinite(t);
    const SurfaceView& view = *n.camera->surface;
    const glm::dvec3 p = sky ? n.cam_from_world.direction(along) : n.cam_from_world.point(from + t * along);
    const auto u = project(view.intrinsics, p);
    if (!u || !in_image(view.intrinsics, *u)) return std::nullopt;
    const double w = double(surface_inverse_depth(view.inverse_depth, view.tears, *u));
    const bool same = sky ? w == 0 : std::fabs(w * p.z - 1) <= tolerance;
    return same ? std::optional(glm::vec2(*u)) : std::nullopt;
}

/// 1/Z in V above which a neighbour's surface is news to the own camera: 0 where that gave no colour; else where the
/// pixel's ray has left its frame towards V, and nearer than what it saw there. In its pixels and w = 1/Z of V the
/// planes of its frustum are a(x, y) + m w >= 0.
void find_floor(const SurfaceView& own, const ShiftedCamera& shifted, const Reprojection& shown, const Mask& missing,
                double tolerance, Grid<float>& out) {
    const Intrinsics &k = own.intrinsics, &target = shifted.intrinsics;
    if (out.width != target.width || out.height != target.height) out = Grid<float>(target.width, target.height);
    const ProjectiveMap map = projective_map(target, shifted.world_from_cam, k, own.world_from_cam);
    struct Plane {
        double m;
        glm::dvec3 a;
    };
    const auto plane = [&](double x, double y, double z) {
        const glm::dvec3 of(x, y, z);
        return Plane{glm::dot(of, map.move), of * map.turn};
    };
    std::vector<Plane> planes{plane(1, 0, 0), plane(-1, 0, k.width), plane(0, 1, 0), plane(0, -1, k.height)};
    std::erase_if(planes, [](const Plane& p) { return !(p.m < 0); });
    constexpr float never = std::numeric_limits<float>::infinity(), least = std::numeric_limits<float>::min();
    const float nearer = float(1 / (1 - tolerance));
    tbb::parallel_for(0, target.height, [&](int y) {
        const size_t first = size_t(y) * size_t(target.width);
        float* const row = &out.data[first];
        std::fill_n(row, target.width, never);
        for (const Plane& p : planes) {
            const float step = float(-p.a.x / p.m), start = float(-(p.a.x * 0.5 + p.a.y * (y + 0.5) + p.a.z) / p.m);
            for (int x = 0; x < target.width; ++x) row[x] = std::min(row[x], start + step * float(x));
        }
        for (int x = 0; x < target.width; ++x) {
            const float here = std::max({row[x], shown.inverse_depth.data[first + size_t(x)] * nearer, least});
            row[x] = missing.data[first + size_t(x)] ? 0.0f : here;
        }
    });
}

}  // namespace

void seam_shifted(const std::vector<SeamCamera>& rig, int own_index, const ShiftedCamera& shifted,
                  const SeamOptions& options, ShiftedSeam& out) {
    const SeamCamera& own = rig.at(size_t(own_index));
    const Intrinsics& k = shifted.intrinsics;
    const auto show = [&](const SeamCamera& camera, const Grid<float>* floor, Reprojection& shown) {
        if (!camera.lifted) return reproject(*camera.surface, shifted, floor, shown);
        cast(*camera.lifted, shifted, shown);
        return true;
    };
    show(own, nullptr, out.own);
    const Sampler own_sampler(
        field_of(*own.surface), *own.image,
        projective_map(own.surface->intrinsics, own.surface->world_from_cam, k, shifted.world_from_cam));
    warp(out.own, own_sampler, options.edge, out.seam.color, out.missing);
    find_floor(*own.surface, shifted, out.own, out.missing, options.depth_tolerance, out.floor);
    if (out.seam.source.size() != out.missing.size() || out.seam.source.width != k.width)
        out.seam.source = Grid<int16_t>(k.width, k.height);

    std::list<Neighbor> neighbors = neighbors_of(rig, own_index, k, shifted.world_from_cam);
    out.neighbors.resize(neighbors.size());
    size_t place = 0;
    std::erase_if(neighbors, [&](Neighbor& n) {
        n.shown = &out.neighbors[place++];
        return !show(*n.camera, &out.floor, *n.shown);
    });
    const glm::dvec3 centre = shifted.world_from_cam.translation_m;
    const Pose& world_from_v = shifted.world_from_cam;
    std::vector<glm::dvec3> along_x(size_t(k.width));  // a ray is the sum of its column's part and its row's
    for (int x = 0; x < k.width; ++x)
        along_x[size_t(x)] = world_from_v.direction({(x + 0.5 - k.cx) / k.fx, 0, 0});
    if (out.asked.size() != out.missing.size()) out.asked.resize(out.missing.size());
    if (options.depth && (out.inverse_depth.width != k.width || out.inverse_depth.height != k.height))
        out.inverse_depth = Grid<float>(k.width, k.height);
    tbb::parallel_for(0, k.height, [&](int y) {
        const size_t first = size_t(y) * size_t(k.width);
        uint8_t* const asked = &out.asked[first];
        const glm::dvec3 row_along = world_from_v.direction({0, (y + 0.5 - k.cy) / k.fy, 1});
        std::copy_n(&out.missing.data[first], k.width, asked);
        for (const Neighbor& n : neighbors) {
            const float *q = &n.shown->inverse_depth.data[first], *floor = &out.floor.data[first];
            for (int x = n.shown->x0; x < n.shown->x1; ++x) asked[x] |= q[x] > floor[x];
        }
        std::fill_n(&out.seam.source.data[first], k.width, int16_t(own_index));
        if (options.depth)
            std::copy_n(&out.own.inverse_depth.data[first], k.width, &out.inverse_depth.data[first]);
        for (int x = 0; x < k.width; ++x) {
            if (uint64_t eight; x + 8 <= k.width) {
                std::memcpy(&eight, asked + x, 8);
                if (eight == 0) {
                    x += 7;
                    continue;
                }
            }
            if (!asked[x]) continue;
            const size_t at = first + size_t(x);
            float front = out.missing.data[at] ? out.own.inverse_depth.data[at] : out.floor.data[at];
            for (const Neighbor& n : neighbors)
                if (n.shown->holds(x)) front = std::max(front, n.shown->inverse_depth.data[at]);
            const float least = front * float(1 - options.depth_tolerance);
            const glm::vec2 px(x + 0.5f, y + 0.5f);
            const glm::dvec3 along = along_x[size_t(x)] + row_along;
            Choice best;
            for (const Neighbor& n : neighbors) {
                if (!n.shown->holds(x) || !is_seen(n.shown->sight.data[at])) continue;
                const float q = n.shown->inverse_depth.data[at];
                if (q < std::max(least, out.floor.data[at])) continue;
                const double t = 1 / double(q);
                const double cosine = q > 0 ? direction_cosine(n, centre + t * along, along) : 1;
                best.offer(n, n.shown->source_px.data[at], options.edge, cosine, t);
            }
            const float own_q = out.own.inverse_depth.data[at];
            const bool own_mixed =
                best.mixed && out.missing.data[at] && is_seen(out.own.sight.data[at]) && own_q >= least;
            float shown_q = own_q;
            if (own_mixed) {
                out.seam.color.data[at] = own_sampler.at(out.own.source_px.data[at], px);
            } else if (best.of) {
                shown_q = best.of->shown->inverse_depth.data[at];
                out.seam.source.data[at] = int16_t(best.of->index);
                out.seam.color.data[at] = best.of->color(best.source_px, px, centre, along, best.t);
            } else {
                shown_q = std::numeric_limits<float>::quiet_NaN();
                out.seam.source.data[at] = -1;
                out.seam.color.data[at] = glm::vec3(0);
            }
            if (options.depth) out.inverse_depth.data[at] = shown_q;
        }
    });
}

Seam seam_recorded(const std::vector<SeamCamera>& rig, int own_index, const Mask& lost, const SeamOptions& options) {
    const SeamCamera& own = rig.at(size_t(own_index));
    const Intrinsics& k = own.surface->intrinsics;
    const Pose& world_from_own = own.surface->world_from_cam;
    Seam out{*own.image, Grid<int16_t>(k.width, k.height, int16_t(own_index))};
    const std::list<Neighbor> neighbors = neighbors_of(rig, own_index, k, world_from_own);
    const glm::dvec3 centre = world_from_own.translation_m;
    tbb::parallel_for(0, k.height, [&](int y) {
        for (int x = 0; x < k.width; ++x) {
            const size_t at = size_t(y) * size_t(k.width) + size_t(x);
            if (!lost.data[at]) continue;
            out.color.data[at] = glm::vec3(0);
            out.source.data[at] = -1;
            const float w = own.surface->inverse_depth.data[at];
            if (!(w >= 0)) continue;
            const glm::dvec3 along = world_from_own.direction(ray(k, {x + 0.5, y + 0.5}));
            const double t = 1 / double(w);
            Choice best;
            for (const Neighbor& n : neighbors) {
                const double cosine = w > 0 ? direction_cosine(n, centre + t * along, along) : 1;
                if (!best.mixed && !(cosine > best.cosine)) continue;
                if (const auto u = seen_at(n, centre, along, t, options.depth_tolerance))
                    best.offer(n, *u, options.edge, cosine, t);
            }
            if (!best.of) continue;
            out.source.data[at] = int16_t(best.of->index);
            out.color.data[at] = best.of->color(best.source_px, {x + 0.5f, y + 0.5f}, centre, along, t);
        }
    });
    return out;
}

glm::vec3 fitted_gain(const SeamCamera& own, const SeamCamera& neighbor, double depth_tolerance, bool per_channel) {
    constexpr int step = 4;
    constexpr size_t fewest = 64;
    constexpr float darkest = 0.004f, brightest = 0.98f;  // of linear light: noise below, clipped above
    const Intrinsics& k = own.surface->intrinsics;
    const Pose& world_from_own = own.surface->world_from_cam;
    const std::vector<SeamCamera> pair{own, neighbor};
    const std::list<Neighbor> found = neighbors_of(pair, 0, k, world_from_own);
    const Neighbor& n = found.front();
    std::vector<std::vector<glm::vec3>> rows(size_t((k.height + step - 1) / step));
    tbb::parallel_for(size_t(0), rows.size(), [&](size_t r) {
        const int y = int(r) * step;
        for (int x = 0; x < k.width; x += step) {
            const float w = own.surface->inverse_depth.at(x, y);
            if (!(w >= 0)) continue;
            const glm::dvec3 along = world_from_own.direction(ray(k, {x + 0.5, y + 0.5}));
            const auto u = seen_at(n, world_from_own.translation_m, along, 1 / double(w), depth_tolerance);
            if (!u) continue;
            const glm::vec3 a = own.image->at(x, y), b = neighbor.gain * n.sampler.at(*u, {x + 0.5f, y + 0.5f});
            const auto good = [&](const glm::vec3& c) {
                return std::min({c.x, c.y, c.z}) > darkest && std::max({c.x, c.y, c.z}) < brightest;
            };
            if (good(a) && good(b)) rows[r].push_back(glm::log2(a) - glm::log2(b));
        }
    });
    std::vector<glm::vec3> all;
    for (const auto& row : rows) all.insert(all.end(), row.begin(), row.end());
    if (all.size() < fewest) return glm::vec3(1);
    const auto median = [&](const auto& value) {
        std::vector<float> v;
        for (const glm::vec3& a : all) v.push_back(value(a));
        std::nth_element(v.begin(), v.begin() + long(v.size() / 2), v.end());
        return std::exp2(v[v.size() / 2]);
    };
    if (!per_channel) return glm::vec3(median([](const glm::vec3& a) { return (a.x + a.y + a.z) / 3; }));
    return {median([](const glm::vec3& a) { return a.x; }), median([](const glm::vec3& a) { return a.y; }),
            median([](const glm::vec3& a) { return a.z; })};
}

}  // namespace vshift
