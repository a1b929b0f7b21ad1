// SPDX-License-Identifier: Apache-2.0
#include "embree_core/view.h"

#include <algorithm>
#include <optional>

namespace vshift {
namespace {

// Stands for the far end of an endless line: what lies beyond is at 1/z = 0 to all of a float's digits.
constexpr double endless_t = 1e9;

/// A stretch of a line in projective coordinates; lambda in [0, 1] runs straight from `from` to `to`.
struct ProjectiveStretch {
    glm::dvec3 from, to;  ///< (x/z, y/z, 1/z)
    double begin, end;    ///< t at both ends

    double t(double lambda) const {
        const double w0 = from.z * (1 - lambda), w1 = to.z * lambda;
        return (begin * w0 + end * w1) / (w0 + w1);
    }
};

/// Null where no part of the line lies beyond `nearest_z_m`.
std::optional<ProjectiveStretch> carry_over(const glm::dvec3& origin, const glm::dvec3& direction, double begin,
                                            double end, double nearest_z_m) {
    end = std::min(end, endless_t);
    const double at_nearest = (nearest_z_m - origin.z) / direction.z;
    if (direction.z > 0) begin = std::max(begin, at_nearest);
    if (direction.z < 0) end = std::min(end, at_nearest);
    if (!(begin < end) || (direction.z == 0 && origin.z < nearest_z_m)) return std::nullopt;
    const auto projective = [](const glm::dvec3& p) { return glm::dvec3(p.x / p.z, p.y / p.z, 1 / p.z); };
    return ProjectiveStretch{projective(origin + begin * direction), projective(origin + end * direction), begin, end};
}

}  // namespace

TracedWalls::TracedWalls(const LiftedMesh& mesh)
    : scene_(mesh.wall_vertices, mesh.torn), nearest_z_m_(1.0 / double(mesh.wall_top)) {}

bool TracedWalls::passed(const glm::dvec3& origin, const glm::dvec3& direction, double begin, double end) const {
    const auto stretch = carry_over(origin, direction, begin, end, nearest_z_m_);
    return stretch && scene_.occluded(glm::vec3(stretch->from), glm::vec3(stretch->to - stretch->from), 0, 1);
}

bool TracedWalls::add(const glm::dvec3& origin, const glm::dvec3& direction, double begin, double end, int i,
                      RayPacket& packet) const {
    const auto stretch = carry_over(origin, direction, begin, end, nearest_z_m_);
    if (stretch) packet.set(i, glm::vec3(stretch->from), glm::vec3(stretch->to - stretch->from), 0, 1);
    return stretch.has_value();
}

void TracedWalls::crossings(const glm::dvec3& origin, const glm::dvec3& direction, double begin, double end,
                            std::vector<double>& t) const {
    const auto stretch = carry_over(origin, direction, begin, end, nearest_z_m_);
    if (!stretch) return;
    scene_.crossings(glm::vec3(stretch->from), glm::vec3(stretch->to - stretch->from), 0, 1,
                     [&](double lambda) { t.push_back(stretch->t(lambda)); });
}

LiftedMesh lift_towards(const Intrinsics& intrinsics, const Pose& world_from_cam, const DepthMap& depth,
                        const glm::dvec3& shifted_centre_m, double tolerance_px, const DepthRules& rules) {
    LiftOptions options;
    options.tolerance_px = tolerance_px;
    options.baseline_m = glm::length(shifted_centre_m - world_from_cam.translation_m);
    options.rules = rules;
    return lift(intrinsics, depth, options);
}

LiftedView build_view(const std::string& name, const Pose& world_from_cam, LiftedMesh mesh) {
    TracedScene kept(mesh.vertices, mesh.kept);
    TracedWalls torn(mesh);
    return {name, world_from_cam, std::move(mesh), std::move(kept), std::move(torn)};
}

LiftedView lift_view(const std::string& name, const Intrinsics& intrinsics, const Pose& world_from_cam,
                     const DepthMap& depth, const glm::dvec3& shifted_centre_m, double tolerance_px) {
    return build_view(name, world_from_cam,
                      lift_towards(intrinsics, world_from_cam, depth, shifted_centre_m, tolerance_px));
}

size_t bvh_bytes(const LiftedView& view) {
    return view.kept.bytes() + view.torn.bytes();
}

}  // namespace vshift
