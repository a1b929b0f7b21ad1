// SPDX-License-Identifier: Apache-2.0
// Role: what the shifted view lacks (method.md section 3), and the warp of what it has.
// Stages: holes, warp. Rays have z = 1, so a ray's t is planar depth.
#pragma once
#include "embree_core/view.h"

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

/// With several views a pixel is seen when any of them saw it; the own camera is preferred.
ShiftedHoles holes(const LiftedRig& rig, const ShiftedCamera& shifted);

/// The shifted view's colours: bilinear samples of the source images, never mixed across a tear;
/// holes are black. `images[k]` belongs to `rig.views[k]`.
ColorImage warp(const LiftedRig& rig, const ShiftedHoles& seen, const std::vector<ColorImage>& images);

}  // namespace vshift
