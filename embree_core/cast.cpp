// SPDX-License-Identifier: Apache-2.0
#include <tbb/parallel_for.h>

#include <algorithm>
#include <limits>

#include "embree_core/reproject.h"

namespace vshift {
namespace {

// A ray that meets a vertex to the bit can slip between its triangles, even in a robust scene. A ray
// that found nothing is cast again this far beside, in pixels of V; rays that hit stay exact.
constexpr double retry_px = 1.0 / 1024;

/// What one recorded view shows on one ray of V.
struct Look {
    Sight sight = Sight::none;
    float inverse_depth = 0;
    glm::vec2 source_px{0};
};

/// `origin`, `direction` in the view's frame; direction has z = 1 in V, so t is planar depth there.
Look look(const LiftedView& view, const glm::dvec3& origin, const glm::dvec3& direction) {
    Look result;
    const glm::vec3 o(origin), d(direction);
    const double endless = std::numeric_limits<double>::infinity();
    const Hit kept = view.kept.intersect(o, d, 0, float(endless));
    const bool wall = view.torn.passed(origin, direction, 0, kept ? double(kept.t) : endless);
    if (wall) result.sight = Sight::behind_wall;
    if (!kept) {
        // Nothing in the way: sky, if this view saw sky in that direction.
        const auto u = project(view.mesh.intrinsics, direction);
        if (u && surface_inverse_depth(view.mesh, *u) == 0) {
            if (!wall) result.sight = Sight::sky;
            result.source_px = glm::vec2(*u);
        }
        return result;
    }
    result.inverse_depth = 1 / kept.t;
    // Seen from the front when V and the recorded camera (the origin) are on the same side. A hit on
    // the collapsed half of a triangle, at its corner, has no normal: its other half is as good.
    const glm::dvec3 normal(kept.normal), p = origin + double(kept.t) * direction;
    const bool back = glm::dot(normal, p) * glm::dot(normal, direction) < 0;
    const auto u = project(view.mesh.intrinsics, p);
    if (u) result.source_px = glm::vec2(*u);
    if (!wall) result.sight = back || !u ? Sight::back_face : Sight::seen;
    return result;
}

}  // namespace

void cast(const LiftedView& view, const ShiftedCamera& shifted, Reprojection& out) {
    const int width = shifted.intrinsics.width, height = shifted.intrinsics.height;
    out.fit(shifted.intrinsics);
    std::fill(out.columns.begin(), out.columns.end(), Reprojection::Columns{0, width});
    std::fill(out.sight.data.begin(), out.sight.data.end(), Sight::none);
    std::fill(out.inverse_depth.data.begin(), out.inverse_depth.data.end(), 0.0f);
    const Pose view_from_shifted = compose(inverse(view.world_from_cam), shifted.world_from_cam);
    const auto look_at = [&](glm::dvec2 u) {
        return look(view, view_from_shifted.translation_m, view_from_shifted.direction(ray(shifted.intrinsics, u)));
    };
    tbb::parallel_for(0, height, [&](int y) {
        for (int x = 0; x < width; ++x) {
            const glm::dvec2 u(x + 0.5, y + 0.5);
            Look found = look_at(u);
            if (!is_seen(found.sight)) {
                const Look again = look_at(u + glm::dvec2(retry_px, 0.6 * retry_px));
                if (is_seen(again.sight)) found = again;
            }
            out.sight.at(x, y) = found.sight;
            out.inverse_depth.at(x, y) = found.inverse_depth;
            out.source_px.at(x, y) = found.source_px;
        }
    });
}

}  // namespace vshift
