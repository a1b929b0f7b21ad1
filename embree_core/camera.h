// SPDX-License-Identifier: Apache-2.0
// Role: the pinhole camera: project, ray, shift.
// Frames: ego x forward, y left, z up; camera x right, y down, z forward (OpenCV).
// `a_from_b` names the transform that takes b to a. Metres and radians. Pixel centres at +0.5.
#pragma once
#include <glm/glm.hpp>
#include <glm/gtc/quaternion.hpp>
#include <optional>

namespace vshift {

/// For the places where a user gives or reads degrees.
inline constexpr double radians_per_degree = 3.14159265358979323846 / 180;
inline constexpr double degrees_per_radian = 180 / 3.14159265358979323846;

/// Pinhole intrinsics without skew, in pixels; the image is [0, width) x [0, height).
struct Intrinsics {
    int width = 0;
    int height = 0;
    double fx = 0, fy = 0, cx = 0, cy = 0;
};

/// A rigid transform: x_a = rotation * x_b + translation_m.
struct Pose {
    glm::dmat3 rotation{1.0};
    glm::dvec3 translation_m{0.0};

    glm::dvec3 point(const glm::dvec3& p) const { return rotation * p + translation_m; }
    glm::dvec3 direction(const glm::dvec3& d) const { return rotation * d; }
};

Pose compose(const Pose& a_from_b, const Pose& b_from_c);
Pose inverse(const Pose& a_from_b);

/// The camera's ray through image position `u_px`, in camera coordinates, scaled to z = 1,
/// so that a ray parameter t is planar depth.
glm::dvec3 ray(const Intrinsics& k, glm::dvec2 u_px);

/// Image position of a point or direction in camera coordinates. Null when z <= 0. The result may
/// lie outside the image: see `in_image`.
std::optional<glm::dvec2> project(const Intrinsics& k, const glm::dvec3& p_cam);

bool in_image(const Intrinsics& k, glm::dvec2 u_px);

/// Whether a point in camera coordinates lies in the viewing frustum, its boundary and apex included.
bool in_frustum(const Intrinsics& k, const glm::dvec3& p_cam);

/// The part [t0, t1] of the segment a + t (b - a), t in [0, 1], inside the frustum, or null.
std::optional<glm::dvec2> clip_to_frustum(const Intrinsics& k, const glm::dvec3& a_cam, const glm::dvec3& b_cam);

/// The ego's own motion: a translation in ego metres, then a turn by yaw about the ego's z axis
/// (method.md section 1). The whole rig moves as one rigid body.
struct Shift {
    glm::dvec3 translation_m{0.0};
    double yaw_rad = 0;
};

/// Pose of the shifted ego in the recorded ego's frame.
Pose recorded_ego_from_shifted_ego(const Shift& shift);

/// Where camera V (the recorded camera after the shift) stands, in the frame of the recorded ego.
Pose shifted_ego_from_cam(const Pose& ego_from_cam, const Shift& shift);

}  // namespace vshift
