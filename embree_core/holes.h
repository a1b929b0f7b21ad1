// SPDX-License-Identifier: Apache-2.0
// Role: what the shifted view lacks (method.md section 3). Stage: holes.
#pragma once
#include "embree_core/reproject.h"

namespace vshift {

/// Per pixel of V, 0 or 1. A hole is `disoccluded` (behind an observed edge) or `outside` (outside
/// what the recorded frusta cover).
struct ShiftedHoles {
    Mask hole, disoccluded, outside;
    /// Which view of the rig was hit (-1: a hole), and where in its image; depth in V, +inf for sky.
    Grid<int16_t> source;
    Grid<glm::vec2> source_px;
    DepthMap depth;
};

/// A recorded camera of the rig and what it shows at V's pixels.
struct RigView {
    Intrinsics intrinsics;
    Pose world_from_cam;
    const Reprojection* shown = nullptr;  ///< null: nothing
};

/// With several views a pixel is seen when any of them saw it; the own camera is preferred.
ShiftedHoles holes(const std::vector<RigView>& rig, int own, const ShiftedCamera& shifted);

/// The same from lifted views, by casting rays.
ShiftedHoles holes(const LiftedRig& rig, const ShiftedCamera& shifted);

}  // namespace vshift
