// SPDX-License-Identifier: Apache-2.0
#include "embree_core/camera.h"

#include <array>
#include <cmath>

namespace vshift {

Pose compose(const Pose& a_from_b, const Pose& b_from_c) {
    return {a_from_b.rotation * b_from_c.rotation, a_from_b.point(b_from_c.translation_m)};
}

Pose inverse(const Pose& a_from_b) {
    const glm::dmat3 r = glm::transpose(a_from_b.rotation);
    return {r, -(r * a_from_b.translation_m)};
}

glm::dvec3 ray(const Intrinsics& k, glm::dvec2 u_px) {
    return {(u_px.x - k.cx) / k.fx, (u_px.y - k.cy) / k.fy, 1.0};
}

std::optional<glm::dvec2> project(const Intrinsics& k, const glm::dvec3& p_cam) {
    if (!(p_cam.z > 0)) return std::nullopt;
    return glm::dvec2{k.fx * p_cam.x / p_cam.z + k.cx, k.fy * p_cam.y / p_cam.z + k.cy};
}

bool in_image(const Intrinsics& k, glm::dvec2 u_px) {
    return u_px.x >= 0 && u_px.x < k.width && u_px.y >= 0 && u_px.y < k.height;
}

namespace {
/// Signed distances (unscaled) to the frustum's four sides and the plane z = 0; inside when all >= 0.
std::array<double, 5> frustum_sides(const Intrinsics& k, const glm::dvec3& p) {
    return {k.fx * p.x + k.cx * p.z, (k.width - k.cx) * p.z - k.fx * p.x, k.fy * p.y + k.cy * p.z,
            (k.height - k.cy) * p.z - k.fy * p.y, p.z};
}
}  // namespace

bool in_frustum(const Intrinsics& k, const glm::dvec3& p_cam) {
    for (double side : frustum_sides(k, p_cam))
        if (!(side >= 0)) return false;
    return true;
}

std::optional<glm::dvec2> clip_to_frustum(const Intrinsics& k, const glm::dvec3& a_cam, const glm::dvec3& b_cam) {
    const auto at_a = frustum_sides(k, a_cam);
    const auto at_b = frustum_sides(k, b_cam);
    double t0 = 0, t1 = 1;
    for (size_t i = 0; i < at_a.size(); ++i) {
        const double da = at_a[i], db = at_b[i];
        if (da < 0 && db < 0) return std::nullopt;
        if (da < 0) t0 = std::max(t0, da / (da - db));
        if (db < 0) t1 = std::min(t1, da / (da - db));
    }
    if (!(t0 < t1)) return std::nullopt;
    return glm::dvec2{t0, t1};
}

Pose recorded_ego_from_shifted_ego(const Shift& shift) {
    const double c = std::cos(shift.yaw_rad), s = std::sin(shift.yaw_rad);
    // Columns: a positive yaw turns the ego's x axis towards its y axis (to the left).
    return {glm::dmat3(glm::dvec3{c, s, 0}, glm::dvec3{-s, c, 0}, glm::dvec3{0, 0, 1}), shift.translation_m};
}

Pose shifted_ego_from_cam(const Pose& ego_from_cam, const Shift& shift) {
    return compose(recorded_ego_from_shifted_ego(shift), ego_from_cam);
}

}  // namespace vshift
