// SPDX-License-Identifier: Apache-2.0
// Role: the same questions asked of the true mesh (method.md section 5): scene truth and shell truth.
// The C ABI (c_api.h) is this file's outside; flags and classes have the values given there.
#pragma once
#include "embree_core/camera.h"
#include "embree_core/trace.h"
#include "embree_core/types.h"

namespace vshift {

struct TrueCamera {
    Intrinsics intrinsics;
    Pose world_from_cam;
};

/// The true mesh, stored relative to `origin_m` so that floats keep their precision.
struct TrueScene {
    glm::dvec3 origin_m{0.0};
    TracedScene traced;
};

struct CameraHits {
    DepthMap depth;          ///< planar z, +inf: nothing hit
    Grid<int32_t> triangle;  ///< -1: nothing hit
    Grid<glm::vec3> normal;  ///< unit, world frame, turned towards the camera
};
CameraHits cast_camera(const TrueScene& scene, const TrueCamera& camera);

/// Truth of the own camera's pixels against V: VSHIFT_TRUTH_* flags.
Grid<uint8_t> truth_recorded(const TrueScene& scene, const std::vector<TrueCamera>& rig, int own,
                             const TrueCamera& shifted);

struct ShiftedTruth {
    Grid<uint8_t> klass;  ///< VSHIFT_SEEN_BY_OWN ...
    Grid<int8_t> source;  ///< index into the rig, -1 nobody
    DepthMap depth;
};
ShiftedTruth truth_shifted(const TrueScene& scene, const std::vector<TrueCamera>& rig, int own,
                           const TrueCamera& shifted);

}  // namespace vshift
