// SPDX-License-Identifier: Apache-2.0
#include "embree_core/view.h"

namespace vshift {

LiftedView lift_view(const std::string& name, const Intrinsics& intrinsics, const Pose& world_from_cam,
                     const DepthMap& depth, const glm::dvec3& shifted_centre_m) {
    LiftOptions options;
    options.baseline_m = glm::length(shifted_centre_m - world_from_cam.translation_m);
    LiftedMesh mesh = lift(intrinsics, depth, options);
    TracedScene kept(mesh.vertices, mesh.kept), torn(mesh.vertices, mesh.torn);
    return {name, world_from_cam, std::move(mesh), std::move(kept), std::move(torn)};
}

}  // namespace vshift
