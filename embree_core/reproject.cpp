// SPDX-License-Identifier: Apache-2.0
#include "embree_core/reproject.h"

#include <algorithm>

#include "embree_core/lift_kernels.h"

namespace vshift {

ProjectiveMap projective_map(const Intrinsics& from, const Pose& world_from_from, const Intrinsics& to,
                             const Pose& world_from_to) {
    const Pose to_from_from = compose(inverse(world_from_to), world_from_from);
    const glm::dmat3 pixel(glm::dvec3(to.fx, 0, 0), glm::dvec3(0, to.fy, 0), glm::dvec3(to.cx, to.cy, 1));
    const glm::dmat3 ray(glm::dvec3(1 / from.fx, 0, 0), glm::dvec3(0, 1 / from.fy, 0),
                         glm::dvec3(-from.cx / from.fx, -from.cy / from.fy, 1));
    return {pixel * to_from_from.rotation * ray, pixel * to_from_from.translation_m};
}

void Reprojection::fit(const Intrinsics& shifted) {
    const int width = shifted.width, height = shifted.height;
    if (sight.width != width || sight.height != height) {
        sight = Grid<Sight>(width, height, Sight::none);
        inverse_depth = Grid<float>(width, height, 0);
        source_px = Grid<glm::vec2>(width, height, glm::vec2(0));
    }
    columns.assign(size_t((height + band_rows - 1) / band_rows), {});
}

SurfaceView surface_view(const Intrinsics& intrinsics, const Pose& world_from_cam, const DepthMap& depth,
                         const glm::dvec3& shifted_centre_m, const DepthRules& rules) {
    SurfaceView view;
    surface_view(intrinsics, world_from_cam, depth, shifted_centre_m, rules, view);
    return view;
}

void surface_view(const Intrinsics& intrinsics, const Pose& world_from_cam, const DepthMap& depth,
                  const glm::dvec3& shifted_centre_m, const DepthRules& rules, SurfaceView& view) {
    check_size(intrinsics, depth);
    view.intrinsics = intrinsics, view.world_from_cam = world_from_cam;
    if (view.inverse_depth.width != depth.width || view.inverse_depth.height != depth.height)
        view.inverse_depth = Grid<float>(depth.width, depth.height);
    const lifting::RowCounts counts = lifting::inverse_of(depth, view.inverse_depth);
    view.invalid_px = counts.invalid, view.sky_px = counts.sky;
    view.wall_top = wall_top_of_nearest / counts.nearest_m;
    LiftOptions options;
    options.baseline_m = glm::length(shifted_centre_m - world_from_cam.translation_m);
    options.rules = rules;
    find_tears(intrinsics, view.inverse_depth, options, view.tears);
}

}  // namespace vshift
