// SPDX-License-Identifier: Apache-2.0
// Role: what mask, holes and warp share: one recorded camera with its lifted geometry, and the rig of
// them that answers a request.
#pragma once
#include <string>
#include <vector>

#include "embree_core/lift.h"
#include "embree_core/trace.h"

namespace vshift {

/// A recorded camera, lifted and ready to trace. Traced scenes are in the camera's own frame.
struct LiftedView {
    std::string name;
    Pose world_from_cam;
    LiftedMesh mesh;
    TracedScene kept;
    TracedScene torn;
};

/// `shifted_centre_m`: V's centre in the world; sets the baseline of the tear rule.
LiftedView lift_view(const std::string& name, const Intrinsics& intrinsics, const Pose& world_from_cam,
                     const DepthMap& depth, const glm::dvec3& shifted_centre_m);

/// The cameras whose geometry answers a request: `views[own]` is the recorded camera R itself.
struct LiftedRig {
    std::vector<LiftedView> views;
    int own = 0;
};

/// V: the shifted camera.
struct ShiftedCamera {
    Intrinsics intrinsics;
    Pose world_from_cam;
};

}  // namespace vshift
