// SPDX-License-Identifier: Apache-2.0
// Depth maps with every kind of cell, and a place to ask from.
#pragma once
#include <cmath>
#include <limits>
#include <random>

#include "tests/minimal_support.h"

namespace vshift::minimal {

/// A recorded camera at the origin that looks along z, and a depth map under it.
struct Subject {
    std::string name;
    Intrinsics k;
    DepthMap depth;
    glm::dvec3 v_centre;

    double px_per_inverse_depth() const { return std::max(k.fx, k.fy) * glm::length(v_centre); }
    LiftedView lifted(double tolerance_px) const { return lift_view(name, k, Pose{}, depth, v_centre, tolerance_px); }
    RecordedMasks masks(double tolerance_px) const {
        LiftedRig rig;
        rig.views.push_back(lifted(tolerance_px));
        return mask(rig, {k, Pose{glm::dmat3(1.0), v_centre}}, clear_m);
    }
};

inline Subject of_disparity(const std::string& name, int width, int height,
                            double (*disparity_px)(double x, double y)) {
    Subject s{name, {}, DepthMap(width, height), {-1, 0, 0}};
    s.k.width = width, s.k.height = height;
    s.k.fx = s.k.fy = 320, s.k.cx = 0.5 * width, s.k.cy = 0.5 * height;
    for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x)
            s.depth.at(x, y) = float(s.px_per_inverse_depth() / disparity_px(x + 0.5, y + 0.5));
    return s;
}

// A slanted near wall with a ripple of a fifth of a pixel up to x = 150, before a far wall.
inline double ripple_px(double x, double y) {
    return 0.2 * std::sin(x / 7) * std::sin(y / 5);
}
inline double near_wall_px(double x, double y) {
    return 60 + 0.11 * x + 0.07 * y;
}
inline double walls_px(double x, double y) {
    return x < 150 ? near_wall_px(x, y) + ripple_px(x, y) : 20;
}
inline double hills_px(double x, double y) {
    return 40 + 9 * std::sin(x / 41) * std::cos(y / 29) + 3 * std::sin(x / 11 + y / 17);
}
inline double plane_px(double x, double y) {
    return 30 + 0.03 * x + 0.05 * y;
}

inline std::vector<Subject> subjects() {
    std::vector<Subject> all{of_disparity("walls", 320, 240, walls_px), of_disparity("hills", 331, 203, hills_px),
                             of_disparity("plane", 257, 129, plane_px)};
    for (const std::string& name : scene_names()) {
        const MinimalScene scene = make_scene(name);
        const View r = scene.recorded(scene.own), v = scene.shifted(scene.shift, scene.own);
        all.push_back({name, r.intrinsics, render(scene.world, r).depth,
                       inverse(r.world_from_cam).point(v.world_from_cam.translation_m)});
    }
    // Holes in the depth, sky, and single pixels that stand out.
    Subject broken = of_disparity("broken", 200, 150, hills_px);
    std::mt19937 random(3);
    for (int i = 0; i < 60; ++i) {
        const int x = int(random() % 190), y = int(random() % 140), size = 1 + int(random() % 9);
        const float values[] = {0, std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity(), 3};
        for (int j = 0; j < size * size; ++j) broken.depth.at(x + j % size, y + j / size) = values[i % 4];
    }
    all.push_back(broken);
    return all;
}

}  // namespace vshift::minimal
