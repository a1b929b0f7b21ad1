// SPDX-License-Identifier: Apache-2.0
// Role: exact answers about a minimal scene: pictures, and truth by analytic segments (method.md 5).
// Every primitive is convex, so a segment that leaves a primitive on its outer side never meets it
// again: the primitive itself is left out of the search and no offset is needed.
#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

#include "embree_core/c_api.h"
#include "scenes/minimal/minimal.h"

namespace vshift::minimal {
namespace {

using glm::dvec2;
using glm::dvec3;
constexpr double infinity = std::numeric_limits<double>::infinity();

dvec3 to_local(const Pose& world_from_local, const dvec3& p) {
    return glm::transpose(world_from_local.rotation) * (p - world_from_local.translation_m);
}

dvec3 ray_through(const View& view, double x_px, double y_px) {
    const Intrinsics& k = view.intrinsics;
    return view.world_from_cam.rotation * dvec3((x_px - k.cx) / k.fx, (y_px - k.cy) / k.fy, 1.0);
}

/// Whether a point (w = 1) or direction (w = 0) falls into the image.
bool in_frame(const View& view, const dvec3& p, double w) {
    const Intrinsics& k = view.intrinsics;
    const dvec3 c = glm::transpose(view.world_from_cam.rotation) * (p - w * view.world_from_cam.translation_m);
    if (c.z <= 0) return false;
    const double u = k.fx * c.x / c.z + k.cx, v = k.fy * c.y / c.z + k.cy;
    return u >= 0 && u < k.width && v >= 0 && v < k.height;
}

/// The part of a line inside a convex body, with the normals where it enters and leaves.
struct Span {
    double t0 = -infinity, t1 = infinity;
    dvec3 n0{0.0}, n1{0.0};

    void slab(double o, double d, double half, const dvec3& axis) {
        if (d == 0) {
            if (std::abs(o) > half) t1 = -infinity;
            return;
        }
        const double a = (-half - o) / d, b = (half - o) / d;
        if (std::min(a, b) > t0) t0 = std::min(a, b), n0 = d > 0 ? -axis : axis;
        if (std::max(a, b) < t1) t1 = std::max(a, b), n1 = d > 0 ? axis : -axis;
    }
    void tube(const dvec3& o, const dvec3& d, double radius) {
        const double a = d.x * d.x + d.y * d.y, b = o.x * d.x + o.y * d.y;
        const double c = o.x * o.x + o.y * o.y - radius * radius, q = b * b - a * c;
        if (a == 0 || q < 0) {
            if (c > 0) t1 = -infinity;
            return;
        }
        const double root = std::sqrt(q), near = (-b - root) / a, far = (-b + root) / a;
        const auto normal = [&](double t) { return dvec3(o.x + t * d.x, o.y + t * d.y, 0.0) / radius; };
        if (near > t0) t0 = near, n0 = normal(near);
        if (far < t1) t1 = far, n1 = normal(far);
    }
};

/// Surfaces of one primitive on the line: at most two.
int meet(const Primitive& p, const dvec3& origin, const dvec3& direction, SurfaceHit out[2]) {
    const dvec3 o = to_local(p.world_from_local, origin);
    const dvec3 d = glm::transpose(p.world_from_local.rotation) * direction;
    if (p.shape == Shape::rectangle) {
        if (d.z == 0) return 0;
        const double t = -o.z / d.z;
        if (std::abs(o.x + t * d.x) > p.half_m.x || std::abs(o.y + t * d.y) > p.half_m.y) return 0;
        out[0].t = t;
        out[0].normal = p.world_from_local.rotation * dvec3(0, 0, o.z > 0 ? 1 : -1);
        return 1;
    }
    Span s;
    s.slab(o.z, d.z, p.half_m.z, {0, 0, 1});
    if (p.shape == Shape::box) {
        s.slab(o.x, d.x, p.half_m.x, {1, 0, 0});
        s.slab(o.y, d.y, p.half_m.y, {0, 1, 0});
    } else {
        s.tube(o, d, p.half_m.x);
    }
    if (!(s.t0 < s.t1)) return 0;
    out[0].t = s.t0, out[0].normal = p.world_from_local.rotation * s.n0;
    out[1].t = s.t1, out[1].normal = p.world_from_local.rotation * s.n1;
    return 2;
}

/// Whether anything but primitive `self` stands on origin + t direction, 0 < t < t_max.
bool blocked(const World& world, const dvec3& origin, const dvec3& direction, double t_max, int self) {
    SurfaceHit hits[2];
    for (int i = 0; i < int(world.size()); ++i) {
        if (i == self) continue;
        for (int n = meet(world[size_t(i)], origin, direction, hits); n-- > 0;)
            if (hits[n].t > 0 && hits[n].t < t_max) return true;
    }
    return false;
}

/// Whether the surface of `primitive` at p, with outward normal n, turns its seen side to `eye`.
bool faces(const World& world, int primitive, const dvec3& n, const dvec3& p, const dvec3& eye) {
    return world[size_t(primitive)].shape == Shape::rectangle || glm::dot(n, eye - p) > 0;
}

bool sees(const World& world, const View& view, const dvec3& p, int primitive, const dvec3& n) {
    const dvec3& eye = view.world_from_cam.translation_m;
    return in_frame(view, p, 1) && faces(world, primitive, n, p, eye) && !blocked(world, p, eye - p, 1, primitive);
}

bool sees_sky(const World& world, const View& view, const dvec3& direction) {
    return in_frame(view, direction, 0) && !blocked(world, view.world_from_cam.translation_m, direction, infinity, -1);
}

/// Colour of a surface point: a function of the point alone, smooth, faint far away.
dvec3 color_at(const Primitive& p, const dvec3& point) {
    const dvec3 q = to_local(p.world_from_local, point);
    const double fade = 1 / (1 + glm::dot(point, point) / 900);
    const double checker = std::sin(5.0 * q.x + 0.4) * std::sin(5.0 * q.y + 1.1);
    const dvec3 waves(std::sin(1.3 * q.x + 0.7 * q.z), std::sin(1.7 * q.y - 0.5 * q.z),
                      std::sin(0.9 * (q.x + q.y) + q.z));
    return glm::clamp(p.color * (1.0 + fade * (0.3 * checker + 0.25 * waves)), 0.0, 1.0);
}

dvec3 sky_color(const dvec3& direction) {
    const double up = glm::normalize(direction).z;
    return glm::mix(dvec3(0.75, 0.82, 0.9), dvec3(0.25, 0.45, 0.8), glm::clamp(up, 0.0, 1.0));
}

/// Whether the side of a surface that R saw (normal towards R) is turned away from `eye`.
bool turned_away(const dvec3& normal, const dvec3& p, const dvec3& eye) {
    return glm::dot(normal, eye - p) <= 0;
}

}  // namespace

SurfaceHit cast(const World& world, const dvec3& origin, const dvec3& direction) {
    SurfaceHit best;
    best.t = infinity;
    SurfaceHit hits[2];
    for (int i = 0; i < int(world.size()); ++i)
        for (int n = meet(world[size_t(i)], origin, direction, hits); n-- > 0;)
            if (hits[n].t > 0 && hits[n].t < best.t) best = hits[n], best.primitive = i;
    return best;
}

std::vector<SurfaceHit> cast_all(const World& world, const dvec3& origin, const dvec3& direction, double t_max) {
    std::vector<SurfaceHit> all;
    SurfaceHit hits[2];
    for (int i = 0; i < int(world.size()); ++i)
        for (int n = meet(world[size_t(i)], origin, direction, hits); n-- > 0;)
            if (hits[n].t > 0 && hits[n].t < t_max) {
                all.push_back(hits[n]);
                all.back().primitive = i;
            }
    return all;
}

Picture render(const World& world, const View& view) {
    const int w = view.intrinsics.width, h = view.intrinsics.height;
    Picture out{ColorImage(w, h), DepthMap(w, h), Grid<int32_t>(w, h, -1)};
    const dvec3& eye = view.world_from_cam.translation_m;
    for (int y = 0; y < h; ++y)
        for (int x = 0; x < w; ++x) {
            const dvec3 d = ray_through(view, x + 0.5, y + 0.5);
            const SurfaceHit hit = cast(world, eye, d);
            out.depth.at(x, y) = float(hit.t);  // the ray has z = 1: t is planar depth
            out.primitive.at(x, y) = hit.primitive;
            out.color.at(x, y) =
                glm::vec3(hit ? color_at(world[size_t(hit.primitive)], eye + hit.t * d) : sky_color(d));
        }
    return out;
}

Grid<uint8_t> truth_recorded(const World& world, const std::vector<View>& rig, int own, const View& shifted) {
    const View& r = rig[size_t(own)];
    const dvec3& eye = r.world_from_cam.translation_m;
    const dvec3& v = shifted.world_from_cam.translation_m;
    Grid<uint8_t> flags(r.intrinsics.width, r.intrinsics.height, 0);
    for (int y = 0; y < flags.height; ++y)
        for (int x = 0; x < flags.width; ++x) {
            const dvec3 d = ray_through(r, x + 0.5, y + 0.5);
            const SurfaceHit hit = cast(world, eye, d);
            const dvec3 p = eye + hit.t * d;
            unsigned f = 0;
            if (!in_frame(shifted, hit ? p : d, hit ? 1 : 0)) f |= VSHIFT_TRUTH_OUTSIDE;
            if (!hit) f |= VSHIFT_TRUTH_SKY;
            if (hit && turned_away(hit.normal, p, v)) {
                f |= VSHIFT_TRUTH_OCCLUDED | VSHIFT_TRUTH_FACES_AWAY | VSHIFT_TRUTH_SHELL_SELF | VSHIFT_TRUTH_SHELL_RIG;
            } else {
                const dvec3 from = hit ? p : v, along = hit ? v - p : d;
                for (const SurfaceHit& x_hit : cast_all(world, from, along, hit ? 1 : infinity)) {
                    if (x_hit.primitive == hit.primitive) continue;
                    f |= VSHIFT_TRUTH_OCCLUDED;
                    const dvec3 q = from + x_hit.t * along;
                    if (sees(world, r, q, x_hit.primitive, x_hit.normal))
                        f |= VSHIFT_TRUTH_SHELL_SELF | VSHIFT_TRUTH_SHELL_RIG;
                    for (size_t i = 0; i < rig.size() && !(f & VSHIFT_TRUTH_SHELL_RIG); ++i)
                        if (sees(world, rig[i], q, x_hit.primitive, x_hit.normal)) f |= VSHIFT_TRUTH_SHELL_RIG;
                }
            }
            flags.at(x, y) = uint8_t(f);
        }
    return flags;
}

Grid<uint8_t> truth_shifted(const World& world, const std::vector<View>& rig, int own, const View& shifted) {
    const View& r = rig[size_t(own)];
    const dvec3& v = shifted.world_from_cam.translation_m;
    Grid<uint8_t> classes(shifted.intrinsics.width, shifted.intrinsics.height, 0);
    for (int y = 0; y < classes.height; ++y)
        for (int x = 0; x < classes.width; ++x) {
            const dvec3 d = ray_through(shifted, x + 0.5, y + 0.5);
            const SurfaceHit hit = cast(world, v, d);
            const dvec3 p = v + hit.t * d;
            const auto seen_by = [&](const View& view) {
                return hit ? sees(world, view, p, hit.primitive, hit.normal) : sees_sky(world, view, d);
            };
            if (seen_by(r)) continue;
            const bool framed = in_frame(r, hit ? p : d, hit ? 1 : 0);
            const bool somebody = std::any_of(rig.begin(), rig.end(), seen_by);
            classes.at(x, y) = somebody ? (framed ? VSHIFT_NEIGHBOUR_OCCLUDED : VSHIFT_NEIGHBOUR_OUTSIDE)
                                        : (framed ? VSHIFT_NOBODY_OCCLUDED : VSHIFT_NOBODY_OUTSIDE);
        }
    return classes;
}

Mask undecided_by_sampling(const World& world, const View& r, const View& shifted, double radius_px) {
    const int w = r.intrinsics.width, h = r.intrinsics.height;
    const Grid<uint8_t> flags = truth_recorded(world, {r}, 0, shifted);
    const dvec3& eye = r.world_from_cam.translation_m;
    const dvec3& v = shifted.world_from_cam.translation_m;
    const dvec3 v_cam = to_local(r.world_from_cam, v);
    Mask out(w, h, 0);
    for (int y = 0; y < h; ++y)
        for (int x = 0; x < w; ++x) {
            const auto occluded = [&](int i, int j) { return (flags.at(i, j) & VSHIFT_TRUTH_OCCLUDED) != 0; };
            const bool here = occluded(x, y);
            const dvec3 d = ray_through(r, x + 0.5, y + 0.5);
            const SurfaceHit hit = cast(world, eye, d);
            bool open = false;
            for (int k = 0; k < 9 && !open; ++k) {
                const int dx = k % 3 - 1, dy = k / 3 - 1;
                const int i = x + dx, j = y + dy;
                if (i >= 0 && i < w && j >= 0 && j < h && occluded(i, j) != here) open = true;
                if (open || (flags.at(x, y) & VSHIFT_TRUTH_FACES_AWAY)) continue;
                // Moving R's image against the segment shears space: x += z * (radius / f).
                const dvec3 shear(dx * radius_px / r.intrinsics.fx, dy * radius_px / r.intrinsics.fy, 0);
                const dvec3 v2 = r.world_from_cam.point(v_cam + v_cam.z * shear);
                if (hit) {
                    const dvec3 p2 = eye + hit.t * (d + r.world_from_cam.direction(shear));
                    open = blocked(world, p2, v2 - p2, 1, hit.primitive) != here;
                } else {
                    open = blocked(world, v2, d + r.world_from_cam.direction(shear), infinity, -1) != here;
                }
            }
            out.at(x, y) = open;
        }
    return out;
}

Mask exact_unseen(const World& world, const std::vector<View>& rig, int own, const View& shifted, double clear_m) {
    const View& r = rig[size_t(own)];
    const dvec3& eye = r.world_from_cam.translation_m;
    const dvec3& v = shifted.world_from_cam.translation_m;
    Mask out(r.intrinsics.width, r.intrinsics.height, 0);
    for (int y = 0; y < out.height; ++y)
        for (int x = 0; x < out.width; ++x) {
            const dvec3 d = ray_through(r, x + 0.5, y + 0.5);
            const SurfaceHit hit = cast(world, eye, d);
            if (!hit) continue;
            const dvec3 p = eye + hit.t * d;
            const double end = 1 - clear_m / glm::distance(p, v);
            std::vector<dvec2> seen;
            for (const View& view : rig) {
                const Intrinsics& k = view.intrinsics;
                const dvec3 a = to_local(view.world_from_cam, p), b = to_local(view.world_from_cam, v);
                const dvec3 sides[5] = {{0, 0, 1},
                                        {k.fx, 0, k.cx},
                                        {-k.fx, 0, k.width - k.cx},
                                        {0, k.fy, k.cy},
                                        {0, -k.fy, k.height - k.cy}};
                double t0 = 0, t1 = 1;
                for (const dvec3& n : sides) {
                    const double fa = glm::dot(n, a), fb = glm::dot(n, b);
                    if (fa < 0 && fb < 0) t1 = -1;
                    if (fa < 0 && fb >= 0) t0 = std::max(t0, fa / (fa - fb));
                    if (fa >= 0 && fb < 0) t1 = std::min(t1, fa / (fa - fb));
                }
                if (t0 < t1) seen.push_back({t0, t1});
            }
            std::sort(seen.begin(), seen.end(), [](const dvec2& l, const dvec2& rr) { return l.x < rr.x; });
            double reached = 0;
            for (const dvec2& s : seen)
                if (s.x <= reached + 1e-9) reached = std::max(reached, s.y);
            out.at(x, y) = reached < end - 1e-9;
        }
    return out;
}

}  // namespace vshift::minimal
