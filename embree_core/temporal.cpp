// SPDX-License-Identifier: Apache-2.0
#include "embree_core/temporal.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>

#include "embree_core/lift.h"

namespace vshift {
namespace {

constexpr double same_share = 0.01;  // of 1/z
constexpr double same_disparity_px = 0.5;

/// Whether the four pixels round an image position lie on one surface, or are all sky.
bool on_one_surface(const LiftedMesh& mesh, glm::dvec2 u) {
    const int width = mesh.tears.width, height = mesh.tears.height;
    const int x = std::clamp(int(std::floor(u.x - 0.5)), 0, std::max(0, width - 2));
    const int y = std::clamp(int(std::floor(u.y - 0.5)), 0, std::max(0, height - 2));
    const int x1 = std::min(x + 1, width - 1), y1 = std::min(y + 1, height - 1);
    if ((mesh.tears.at(x, y) & 3) || (mesh.tears.at(x1, y) & 2) || (mesh.tears.at(x, y1) & 1)) return false;
    const float first = mesh.inverse_depth.at(x, y);
    for (const float i :
         {first, mesh.inverse_depth.at(x1, y), mesh.inverse_depth.at(x, y1), mesh.inverse_depth.at(x1, y1)})
        if (!(i >= 0) || (i > 0) != (first > 0)) return false;
    return true;
}

}  // namespace

Correspondence correspond(const PosedDepth& from, const PosedDepth& to) {
    const Intrinsics& k = from.intrinsics;
    if (from.depth.width != k.width || from.depth.height != k.height)
        throw Error(ExitCode::bad_input, "correspond: depth size: got another, expected the camera's");
    const Pose to_from_from = compose(inverse(to.world_from_cam), from.world_from_cam);
    const double baseline_m = glm::length(to_from_from.translation_m);
    const LiftedMesh mesh = lift(to.intrinsics, to.depth, {.baseline_m = std::max(baseline_m, 1e-3)});
    Correspondence out{Grid<glm::vec2>(k.width, k.height, glm::vec2(0)), Mask(k.width, k.height)};
    tbb::parallel_for(0, k.height, [&](int y) {
        for (int x = 0; x < k.width; ++x) {
            const float z = from.depth.at(x, y);
            const bool sky = is_sky(z);
            if (!sky && !is_measured(z)) continue;
            const glm::dvec3 r = ray(k, {x + 0.5, y + 0.5});
            const glm::dvec3 p = sky ? to_from_from.direction(r) : to_from_from.point(r * double(z));
            const auto u = project(to.intrinsics, p);
            if (!u || p.z <= 1e-6 || !in_image(to.intrinsics, *u) || !on_one_surface(mesh, *u)) continue;
            const double there = double(surface_inverse_depth(mesh, *u)), here = sky ? 0 : 1 / p.z;
            const double apart = std::abs(there - here);
            const bool same = sky ? there == 0
                                  : there > 0 && (apart <= same_share * here ||
                                                  apart * to.intrinsics.fx * baseline_m <= same_disparity_px);
            if (!same) continue;
            out.place_px.at(x, y) = glm::vec2(*u);
            out.matched.at(x, y) = 1;
        }
    });
    return out;
}

glm::vec3 sample(const ColorImage& image, glm::vec2 u) {
    const float gx = std::clamp(u.x - 0.5f, 0.0f, float(image.width - 1));
    const float gy = std::clamp(u.y - 0.5f, 0.0f, float(image.height - 1));
    const int x = std::min(int(gx), std::max(0, image.width - 2)), y = std::min(int(gy), std::max(0, image.height - 2));
    const int x1 = std::min(x + 1, image.width - 1), y1 = std::min(y + 1, image.height - 1);
    const float fx = gx - float(x), fy = gy - float(y);
    return (image.at(x, y) * (1 - fx) + image.at(x1, y) * fx) * (1 - fy) +
           (image.at(x, y1) * (1 - fx) + image.at(x1, y1) * fx) * fy;
}

ConsistencyScore score_consistency(const Correspondence& match, const ColorImage& got_from, const ColorImage& got_to,
                                   const ColorImage& truth_from, const ColorImage& truth_to, const Mask* region) {
    ConsistencyScore score;
    const auto size = [](const glm::vec3& d) {
        return (std::abs(double(d.r)) + std::abs(double(d.g)) + std::abs(double(d.b))) / 3;
    };
    for (size_t i = 0; i < match.matched.size(); ++i) {
        if (!match.matched.data[i] || (region && !region->data[i])) continue;
        const glm::vec2 u = match.place_px.data[i];
        const glm::vec3 got = got_from.data[i] - sample(got_to, u), truth = truth_from.data[i] - sample(truth_to, u);
        ++score.pixels;
        score.difference += size(got);
        score.truth_difference += size(truth);
        score.flicker += size(got - truth);
    }
    return score;
}

}  // namespace vshift
