// SPDX-License-Identifier: Apache-2.0
#include "embree_core/truth.h"

#include <tbb/parallel_for.h>

#include <cmath>
#include <limits>

#include "embree_core/c_api.h"

namespace vshift {
namespace {

// A ray leaves a surface from this far above it (at 1 m and per metre of distance): above the rounding
// of float coordinates, below anything modelled.
constexpr double lift_off_m = 5e-5;
constexpr double lift_off_per_m = 5e-6;
constexpr int most_crossings = 512;
constexpr float endless = std::numeric_limits<float>::infinity();

/// A point on the true surface as a camera sees it; relative to the scene's origin.
struct SurfacePoint {
    glm::dvec3 position{0};
    glm::dvec3 normal{0};  ///< unit, towards the camera
    int32_t triangle = -1;
    double depth = 0;  ///< planar z in the camera
    double distance_m = 0;
};

/// A camera relative to the scene's origin.
struct Eye {
    Intrinsics k;
    glm::dmat3 rotation;      ///< scene_from_cam
    glm::dmat3 cam_rotation;  ///< cam_from_scene
    glm::dvec3 centre;

    Eye(const TrueScene& scene, const TrueCamera& camera)
        : k(camera.intrinsics),
          rotation(camera.world_from_cam.rotation),
          cam_rotation(glm::transpose(rotation)),
          centre(camera.world_from_cam.translation_m - scene.origin_m) {}

    glm::dvec3 ray_through(int x, int y) const { return rotation * ray(k, {x + 0.5, y + 0.5}); }
    bool frames(const glm::dvec3& cam_coordinates) const {
        const auto u = project(k, cam_coordinates);
        return u && in_image(k, *u);
    }
    bool frames_point(const glm::dvec3& p) const { return frames(cam_rotation * (p - centre)); }
    bool frames_direction(const glm::dvec3& d) const { return frames(cam_rotation * d); }
};

SurfacePoint surface_point(const glm::dvec3& origin, const glm::dvec3& direction, const Hit& hit) {
    SurfacePoint s;
    s.position = origin + double(hit.t) * direction;
    s.normal = glm::normalize(glm::dvec3(hit.normal));
    if (glm::dot(s.normal, direction) > 0) s.normal = -s.normal;
    s.triangle = int32_t(hit.primitive);
    s.depth = double(hit.t);
    s.distance_m = double(hit.t) * glm::length(direction);
    return s;
}

/// What a camera's pixel sees; triangle -1: the sky.
SurfacePoint seen_at(const TrueScene& scene, const Eye& eye, int x, int y) {
    const glm::dvec3 d = eye.ray_through(x, y);
    const Hit hit = scene.traced.intersect(glm::vec3(eye.centre), glm::vec3(d), 0, endless);
    return hit ? surface_point(eye.centre, d, hit) : SurfacePoint{};
}

glm::dvec3 lifted_off(const SurfacePoint& s) {
    return s.position + s.normal * (lift_off_m + lift_off_per_m * (s.distance_m + glm::length(s.position)));
}

/// Whether the surface point is visible from an eye: in front, framed if asked, nothing between.
bool faces(const SurfacePoint& s, const glm::dvec3& centre) {
    return glm::dot(s.normal, centre - s.position) > 0;
}
bool clear_between(const TrueScene& scene, const SurfacePoint& s, const glm::dvec3& centre) {
    const glm::dvec3 o = lifted_off(s);
    return !scene.traced.occluded(glm::vec3(o), glm::vec3(centre - o), 0, 1.0f - 1e-6f);
}
bool saw(const TrueScene& scene, const Eye& eye, const SurfacePoint& s) {
    return eye.frames_point(s.position) && faces(s, eye.centre) && clear_between(scene, s, eye.centre);
}
bool saw_sky(const TrueScene& scene, const Eye& eye, const glm::dvec3& d) {
    return eye.frames_direction(d) && !scene.traced.occluded(glm::vec3(eye.centre), glm::vec3(d), 0, endless);
}

/// Walks every surface on origin + t direction, 0 <= t <= end, and asks whether the own camera saw one
/// of them, or any camera of the rig did.
uint8_t shell_flags(const TrueScene& scene, const std::vector<Eye>& rig, int own, const glm::dvec3& origin,
                    const glm::dvec3& direction, float end) {
    uint8_t flags = 0;
    float from = 0;
    for (int i = 0; i < most_crossings; ++i) {
        const Hit hit = scene.traced.intersect(glm::vec3(origin), glm::vec3(direction), from, end);
        if (!hit) break;
        SurfacePoint s = surface_point(origin, direction, hit);
        const auto seen_by = [&](const Eye& eye) {
            SurfacePoint turned = s;  // a sheet is seen from whichever side the camera is on
            if (!faces(turned, eye.centre)) turned.normal = -turned.normal;
            turned.distance_m = glm::length(s.position - eye.centre);
            return eye.frames_point(s.position) && clear_between(scene, turned, eye.centre);
        };
        if (seen_by(rig[size_t(own)])) return flags | VSHIFT_TRUTH_SHELL_SELF | VSHIFT_TRUTH_SHELL_RIG;
        if (!(flags & VSHIFT_TRUTH_SHELL_RIG))
            for (size_t k = 0; k < rig.size(); ++k)
                if (int(k) != own && seen_by(rig[k])) {
                    flags |= VSHIFT_TRUTH_SHELL_RIG;
                    break;
                }
        from = std::nextafter(std::max(hit.t, 1e-7f) * (1 + 2e-6f), endless);
    }
    return flags;
}

std::vector<Eye> eyes(const TrueScene& scene, const std::vector<TrueCamera>& rig) {
    std::vector<Eye> out;
    for (const TrueCamera& camera : rig) out.emplace_back(scene, camera);
    return out;
}

}  // namespace

CameraHits cast_camera(const TrueScene& scene, const TrueCamera& camera) {
    const Eye eye(scene, camera);
    CameraHits out{DepthMap(eye.k.width, eye.k.height, endless), Grid<int32_t>(eye.k.width, eye.k.height, -1),
                   Grid<glm::vec3>(eye.k.width, eye.k.height, glm::vec3(0))};
    tbb::parallel_for(0, eye.k.height, [&](int y) {
        for (int x = 0; x < eye.k.width; ++x) {
            const SurfacePoint s = seen_at(scene, eye, x, y);
            if (s.triangle < 0) continue;
            out.depth.at(x, y) = float(s.depth);
            out.triangle.at(x, y) = s.triangle;
            out.normal.at(x, y) = glm::vec3(s.normal);
        }
    });
    return out;
}

Grid<uint8_t> truth_recorded(const TrueScene& scene, const std::vector<TrueCamera>& rig, int own,
                             const TrueCamera& shifted) {
    const std::vector<Eye> recorded = eyes(scene, rig);
    const Eye& eye = recorded.at(size_t(own));
    const Eye v(scene, shifted);
    Grid<uint8_t> out(eye.k.width, eye.k.height, 0);
    tbb::parallel_for(0, eye.k.height, [&](int y) {
        for (int x = 0; x < eye.k.width; ++x) {
            uint8_t flags = 0;
            const SurfacePoint s = seen_at(scene, eye, x, y);
            if (s.triangle < 0) {
                const glm::dvec3 d = glm::normalize(eye.ray_through(x, y));
                flags |= VSHIFT_TRUTH_SKY;
                if (!v.frames_direction(d)) flags |= VSHIFT_TRUTH_OUTSIDE;
                if (scene.traced.occluded(glm::vec3(v.centre), glm::vec3(d), 0, endless))
                    flags |= VSHIFT_TRUTH_OCCLUDED | shell_flags(scene, recorded, own, v.centre, d, endless);
            } else {
                if (!v.frames_point(s.position)) flags |= VSHIFT_TRUTH_OUTSIDE;
                if (!faces(s, v.centre)) {
                    flags |= VSHIFT_TRUTH_OCCLUDED | VSHIFT_TRUTH_FACES_AWAY | VSHIFT_TRUTH_SHELL_SELF |
                             VSHIFT_TRUTH_SHELL_RIG;
                } else if (!clear_between(scene, s, v.centre)) {
                    const glm::dvec3 o = lifted_off(s);
                    flags |= VSHIFT_TRUTH_OCCLUDED | shell_flags(scene, recorded, own, o, v.centre - o, 1.0f - 1e-6f);
                }
            }
            out.at(x, y) = flags;
        }
    });
    return out;
}

ShiftedTruth truth_shifted(const TrueScene& scene, const std::vector<TrueCamera>& rig, int own,
                           const TrueCamera& shifted) {
    const std::vector<Eye> recorded = eyes(scene, rig);
    const Eye v(scene, shifted);
    ShiftedTruth out{Grid<uint8_t>(v.k.width, v.k.height, 0), Grid<int8_t>(v.k.width, v.k.height, -1),
                     DepthMap(v.k.width, v.k.height, endless)};
    tbb::parallel_for(0, v.k.height, [&](int y) {
        for (int x = 0; x < v.k.width; ++x) {
            const SurfacePoint s = seen_at(scene, v, x, y);
            const glm::dvec3 d = glm::normalize(v.ray_through(x, y));
            const bool sky = s.triangle < 0;
            const auto seen_by = [&](const Eye& eye) { return sky ? saw_sky(scene, eye, d) : saw(scene, eye, s); };
            const auto framed_by = [&](const Eye& eye) {
                return sky ? eye.frames_direction(d) : eye.frames_point(s.position);
            };
            if (!sky) out.depth.at(x, y) = float(s.depth);
            const Eye& self = recorded[size_t(own)];
            if (seen_by(self)) {
                out.klass.at(x, y) = VSHIFT_SEEN_BY_OWN;
                out.source.at(x, y) = int8_t(own);
                continue;
            }
            const bool framed = framed_by(self);
            // The neighbour that looked at the place in the direction nearest to V's.
            int source = -1;
            double nearest = -2;
            for (size_t k = 0; k < recorded.size(); ++k) {
                if (int(k) == own || !seen_by(recorded[k])) continue;
                const double cosine = sky ? glm::dot(d, recorded[k].rotation * glm::dvec3(0, 0, 1))
                                          : glm::dot(d, glm::normalize(s.position - recorded[k].centre));
                if (cosine > nearest) {
                    nearest = cosine;
                    source = int(k);
                }
            }
            out.source.at(x, y) = int8_t(source);
            out.klass.at(x, y) = source >= 0 ? (framed ? VSHIFT_NEIGHBOUR_OCCLUDED : VSHIFT_NEIGHBOUR_OUTSIDE)
                                             : (framed ? VSHIFT_NOBODY_OCCLUDED : VSHIFT_NOBODY_OUTSIDE);
        }
    });
    return out;
}

}  // namespace vshift
