// SPDX-License-Identifier: Apache-2.0
#include "benchmark/engine/cases.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>

namespace vshift::bench {
namespace {

/// Separable Gaussian; the border's weights are renormalised.
void blur(Grid<float>& image, double sigma_px) {
    const int reach = int(std::ceil(3 * sigma_px));
    std::vector<float> weight(size_t(reach) + 1);
    for (int i = 0; i <= reach; ++i) weight[size_t(i)] = float(std::exp(-0.5 * i * i / (sigma_px * sigma_px)));
    Grid<float> rows(image.width, image.height);
    const auto pass = [&](const Grid<float>& from, Grid<float>& to, bool along_rows) {
        const int along = along_rows ? from.width : from.height;
        tbb::parallel_for(0, from.height, [&](int y) {
            for (int x = 0; x < from.width; ++x) {
                const int at = along_rows ? x : y;
                float sum = 0, weights = 0;
                for (int i = std::max(-reach, -at); i <= std::min(reach, along - 1 - at); ++i) {
                    const float w = weight[size_t(std::abs(i))];
                    sum += w * (along_rows ? from.at(x + i, y) : from.at(x, y + i));
                    weights += w;
                }
                to.at(x, y) = sum / weights;
            }
        });
    };
    pass(image, rows, true);
    pass(rows, image, false);
}

}  // namespace

World::World(const analytic::StreetScene& of, int width, int cameras)
    : street(&of), rig(analytic::six_camera_rig(width, width * 9 / 16)) {
    for (int i = 0; i < cameras; ++i) {
        CameraHits hits = cast_camera(of.scene, recorded(i));
        kind.push_back(analytic::kinds_of(of.street, hits));
        depth.push_back(std::move(hits.depth));
    }
}

std::string Case::shift_text() const {
    char text[64];
    std::snprintf(text, sizeof text, "%g,%g,%g", shift.translation_m.x, shift.translation_m.y, shift.translation_m.z);
    return text;
}

Case make_question(const World& world, int own, const Shift& shift) {
    Case out;
    out.world = &world;
    out.own = own;
    out.shift = shift;
    return out;
}

Case make_case(const World& world, int own, const Shift& shift) {
    Case out = make_question(world, own, shift);
    out.truth = analytic::street_truth(*world.street, world.rig, own, World::frame, shift).truth_flags;
    out.shifted_depth = cast_camera(world.street->scene, world.shifted(own, shift)).depth;
    return out;
}

Shift moved(double x_m, double y_m) {
    Shift shift;
    shift.translation_m = {x_m, y_m, 0};
    return shift;
}

std::vector<Shift> bench_shifts(bool quick) {
    std::vector<Shift> all{moved(0, 2), moved(0, -2), moved(2, 0), moved(0, 0)};
    if (!quick)
        for (double y : {1.0, -1.0, 4.0, -4.0}) all.push_back(moved(0, y));
    return all;
}

DepthMap mono_like(const DepthMap& exact, uint32_t draw) {
    Grid<float> inverse(exact.width, exact.height), noise(exact.width, exact.height);
    for (size_t i = 0; i < exact.size(); ++i) inverse.data[i] = is_sky(exact.data[i]) ? 0.0f : 1.0f / exact.data[i];
    blur(inverse, 1);
    std::mt19937 engine(7919 * draw + 1);
    std::normal_distribution<float> normal;
    for (float& n : noise.data) n = normal(engine);
    blur(noise, 16);
    double squares = 0;
    for (float n : noise.data) squares += double(n) * n;
    const float scale = float(0.02 / std::sqrt(squares / double(noise.size())));
    DepthMap out(exact.width, exact.height);
    for (size_t i = 0; i < out.size(); ++i)
        out.data[i] = inverse.data[i] > 0 ? std::exp(scale * noise.data[i]) / inverse.data[i]
                                          : std::numeric_limits<float>::infinity();
    return out;
}

}  // namespace vshift::bench
