// SPDX-License-Identifier: Apache-2.0
#include "inpaint/depth_pairs.h"

#include <algorithm>
#include <cmath>

#include "embree_core/srgb.h"
#include "inpaint/street_pairs.h"
#include "scenes/analytic/street_mesh.h"

namespace vshift::inpaint {
namespace {

constexpr int color_samples = 2;  // a side of a pixel

glm::dmat3 turned(const glm::dvec3& axis, double radians) {
    return glm::mat3_cast(glm::angleAxis(radians, axis));
}

analytic::RigCamera moved(analytic::RigCamera camera, analytic::Stream& random) {
    Pose& pose = camera.ego_from_cam;
    pose.translation_m.y += random.within(-2, 2);
    pose.translation_m.z += random.within(-0.4, 0.4);
    for (const glm::dvec3& axis : {glm::dvec3(1, 0, 0), glm::dvec3(0, 1, 0), glm::dvec3(0, 0, 1)})
        pose.rotation = pose.rotation * turned(axis, random.within(-3, 3) * radians_per_degree);
    const double zoom = std::exp(random.within(std::log(0.8), std::log(1.25)));
    camera.intrinsics.fx *= zoom;
    camera.intrinsics.fy *= zoom;
    return camera;
}

}  // namespace

vshift_depth_view DepthPlanes::view() const {
    vshift_depth_view v{};
    v.height = height, v.width = width;
    v.color = color.data();
    v.fx = intrinsics.fx, v.fy = intrinsics.fy, v.cx = intrinsics.cx, v.cy = intrinsics.cy;
    for (int row = 0; row < 3; ++row)
        for (int column = 0; column < 3; ++column) v.ego_from_cam[3 * row + column] = ego_from_cam[column][row];
    v.height_m = height_m;
    v.inverse_depth = inverse_depth.empty() ? nullptr : inverse_depth.data();
    return v;
}

DepthPlanes depth_planes(const ColorImage& color, const Intrinsics& intrinsics, const Pose& ego_from_cam) {
    return {color.width, color.height, intrinsics, ego_from_cam.rotation, ego_from_cam.translation_m.z, display_planes(color), {}};
}

std::vector<DepthPlanes> record_depth_views(const std::vector<uint32_t>& seeds, int frames, int width,
                                            const std::function<void(size_t, size_t)>& show) {
    std::vector<DepthPlanes> out;
    const auto rig = analytic::six_camera_rig(width, width * 9 / 16);
    for (const uint32_t seed : seeds) {
        const analytic::StreetScene street = analytic::build_street(seed);
        analytic::Stream random(seed, 4211);
        for (int f = 0; f < frames; ++f) {
            const int frame = random.whole(0, analytic::most_frames - 1);
            for (const analytic::RigCamera& of_rig : rig) {
                show(out.size(), seeds.size() * size_t(frames) * rig.size());
                const analytic::RigCamera camera = moved(of_rig, random);
                const TrueCamera at = analytic::recorded_camera(camera, frame);
                out.push_back(depth_planes(analytic::street_color(street, at, color_samples), camera.intrinsics, camera.ego_from_cam));
                for (const float z : cast_camera(street.scene, at).depth.data)
                    out.back().inverse_depth.push_back(is_measured(z) ? 1 / z : 0);
            }
        }
    }
    return out;
}

DepthPlanes depth_sample(const std::vector<DepthPlanes>& views, uint64_t seed, uint64_t number, int crop_px) {
    analytic::Stream random(uint32_t(seed * 7919 + number), uint32_t(number >> 20) + 23);
    const DepthPlanes& whole = views[size_t(random.whole(0, int(views.size()) - 1))];
    DepthPlanes part = whole;
    part.width = crop_px ? std::min(crop_px, whole.width) : whole.width;
    part.height = crop_px ? std::min(crop_px, whole.height) : whole.height;
    const int x0 = random.whole(0, whole.width - part.width), y0 = random.whole(0, whole.height - part.height);
    part.intrinsics.cx -= x0;
    part.intrinsics.cy -= y0;
    const bool mirrored = random.chance(0.5);
    if (mirrored) {  // a street mirrored about x-z, seen by the mirrored camera
        part.intrinsics.cx = part.width - part.intrinsics.cx;
        const glm::dmat3 left_right(-1, 0, 0, 0, 1, 0, 0, 0, 1), over_street(1, 0, 0, 0, -1, 0, 0, 0, 1);
        part.ego_from_cam = over_street * whole.ego_from_cam * left_right;
    }
    const auto cut = [&](const std::vector<float>& plane, size_t channels) {
        std::vector<float> out;
        out.reserve(channels * size_t(part.width) * size_t(part.height));
        for (size_t c = 0; c < channels; ++c)
            for (int y = 0; y < part.height; ++y) {
                const float* row = plane.data() + (c * size_t(whole.height) + size_t(y0 + y)) * size_t(whole.width) + x0;
                for (int x = 0; x < part.width; ++x) out.push_back(row[mirrored ? part.width - 1 - x : x]);
            }
        return out;
    };
    part.color = cut(whole.color, 3);
    part.inverse_depth = cut(whole.inverse_depth, 1);
    const size_t n = size_t(part.width) * size_t(part.height);
    const double stops = random.within(-0.5, 0.5), warmth = random.within(-0.15, 0.15);
    for (size_t c = 0; c < 3; ++c) {
        // Display values follow light to the power of 1/2.4, near enough for a change of exposure.
        const float gain = float(std::exp2((stops + (double(1) - double(c)) * warmth) / 2.4));
        for (size_t i = 0; i < n; ++i) part.color[c * n + i] = std::min(1.0f, part.color[c * n + i] * gain);
    }
    return part;
}

}  // namespace vshift::inpaint
