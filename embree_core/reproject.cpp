// SPDX-License-Identifier: Apache-2.0
#include "embree_core/reproject.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <limits>

namespace vshift {

ProjectiveMap projective_map(const Intrinsics& from, const Pose& world_from_from, const Intrinsics& to,
                             const Pose& world_from_to) {
    const Pose to_from_from = compose(inverse(world_from_to), world_from_from);
    const glm::dmat3 pixel(glm::dvec3(to.fx, 0, 0), glm::dvec3(0, to.fy, 0), glm::dvec3(to.cx, to.cy, 1));
    const glm::dmat3 ray(glm::dvec3(1 / from.fx, 0, 0), glm::dvec3(0, 1 / from.fy, 0),
                         glm::dvec3(-from.cx / from.fx, -from.cy / from.fy, 1));
    return {pixel * to_from_from.rotation * ray, pixel * to_from_from.translation_m};
}

SurfaceView surface_view(const Intrinsics& intrinsics, const Pose& world_from_cam, const DepthMap& depth,
                         const glm::dvec3& shifted_centre_m) {
    SurfaceView view;
    surface_view(intrinsics, world_from_cam, depth, shifted_centre_m, view);
    return view;
}

void surface_view(const Intrinsics& intrinsics, const Pose& world_from_cam, const DepthMap& depth,
                  const glm::dvec3& shifted_centre_m, SurfaceView& view) {
    if (depth.width != intrinsics.width || depth.height != intrinsics.height || depth.width < 1 || depth.height < 1)
        throw Error(ExitCode::bad_input,
                    "depth: size: got " + std::to_string(depth.width) + "x" + std::to_string(depth.height) +
                        ", expected " + std::to_string(intrinsics.width) + "x" + std::to_string(intrinsics.height));
    view.intrinsics = intrinsics, view.world_from_cam = world_from_cam;
    view.invalid_px = view.sky_px = 0;
    if (view.inverse_depth.width != depth.width || view.inverse_depth.height != depth.height)
        view.inverse_depth = Grid<float>(depth.width, depth.height);
    struct Row {
        uint32_t invalid = 0, sky = 0;
        float nearest_m = 1e12f;
    };
    std::vector<Row> rows(static_cast<size_t>(depth.height));
    tbb::parallel_for(0, depth.height, [&](int y) {
        const float* z = &depth.data[size_t(y) * size_t(depth.width)];
        float* w = &view.inverse_depth.data[size_t(y) * size_t(depth.width)];
        Row row;
        for (int x = 0; x < depth.width; ++x) {
            const bool sky = is_sky(z[x]), valid = is_measured(z[x]);
            row.sky += sky;
            row.invalid += !sky & !valid;
            row.nearest_m = valid && z[x] < row.nearest_m ? z[x] : row.nearest_m;
            w[x] = sky ? 0.0f : valid ? 1.0f / z[x] : std::numeric_limits<float>::quiet_NaN();
        }
        rows[size_t(y)] = row;
    });
    float nearest_m = 1e12f;
    for (const Row& row : rows) {
        view.invalid_px += row.invalid;
        view.sky_px += row.sky;
        nearest_m = std::min(nearest_m, row.nearest_m);
    }
    view.wall_top = wall_top_of_nearest / nearest_m;
    LiftOptions options;
    options.baseline_m = glm::length(shifted_centre_m - world_from_cam.translation_m);
    find_tears(intrinsics, view.inverse_depth, options, view.tears);
}

}  // namespace vshift
