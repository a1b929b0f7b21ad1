// SPDX-License-Identifier: Apache-2.0
// Role: what mask, holes and warp share: one recorded camera with its lifted geometry, and the rig of
// them that answers a request.
#pragma once
#include <string>
#include <vector>

#include "embree_core/lift.h"
#include "embree_core/trace.h"

namespace vshift {

/// The torn walls of one depth map, ready to trace; the mesh must stay alive. Lines are origin + t direction in the
/// camera's frame; they are carried over to projective coordinates, where walls live (lift.h).
class TracedWalls {
public:
    explicit TracedWalls(const LiftedMesh& mesh);
    /// Does the line pass a wall between t = begin and end?
    bool passed(const glm::dvec3& origin, const glm::dvec3& direction, double begin, double end) const;
    /// Adds the line's stretch to a packet for `passed`. False where it passes no wall for sure.
    bool add(const glm::dvec3& origin, const glm::dvec3& direction, double begin, double end, int i,
             RayPacket& packet) const;
    uint32_t passed(const RayPacket& packet, uint32_t asked) const { return scene_.occluded(packet, asked); }
    /// Appends every such t.
    void crossings(const glm::dvec3& origin, const glm::dvec3& direction, double begin, double end,
                   std::vector<double>& t) const;
    size_t bytes() const { return scene_.bytes(); }

private:
    TracedScene scene_;
    double nearest_z_m_;  ///< no wall stands nearer
};

/// A recorded camera, lifted and ready to trace, in its own frame.
struct LiftedView {
    std::string name;
    Pose world_from_cam;
    LiftedMesh mesh;
    TracedScene kept;
    TracedWalls torn;
};

/// The depth map as a mesh, torn and collapsed as its source and V's distance ask. `shifted_centre_m`: V's
/// centre in the world.
LiftedMesh lift_towards(const Intrinsics& intrinsics, const Pose& world_from_cam, const DepthMap& depth,
                        const glm::dvec3& shifted_centre_m, double tolerance_px = 0, const DepthRules& rules = {});

/// The mesh, ready to trace.
LiftedView build_view(const std::string& name, const Pose& world_from_cam, LiftedMesh mesh);

/// Both in one.
LiftedView lift_view(const std::string& name, const Intrinsics& intrinsics, const Pose& world_from_cam,
                     const DepthMap& depth, const glm::dvec3& shifted_centre_m, double tolerance_px = 0);

/// What the ray tracer holds for a view beside its mesh.
size_t bvh_bytes(const LiftedView& view);

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
