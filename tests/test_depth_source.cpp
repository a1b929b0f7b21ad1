// SPDX-License-Identifier: Apache-2.0
// What a depth map's source says about its errors: tears, bias and snapped silhouettes that follow from it.
#include <cmath>
#include <limits>

#include "embree_core/depth_source.h"
#include "embree_core/sweep.h"
#include "tests/catch.h"
#include "tests/minimal_support.h"

using namespace vshift;
using namespace vshift::minimal;

namespace {

constexpr double clear_m = 2.0;

/// To 11 binary digits.
float to_half(float value) {
    int exponent = 0;
    const float mantissa = std::frexp(value, &exponent);
    return std::ldexp(std::round(mantissa * 2048), exponent - 11);
}

/// Depth as `source` would store it. Monocular depth has its 1/z blurred over 5x5 pixels.
DepthMap stored_as(DepthSource source, const DepthMap& exact) {
    DepthMap out = exact;
    float nearest_m = std::numeric_limits<float>::infinity();
    for (const float z : exact.data)
        if (is_measured(z)) nearest_m = std::min(nearest_m, z);
    for (float& z : out.data) {
        if (!is_measured(z)) continue;
        if (source == DepthSource::half) z = to_half(z);
        if (source == DepthSource::mm16) z = std::round(z * 1000) / 1000;
        if (source == DepthSource::disparity8) {
            const float step = std::round(nearest_m / z * 255);
            z = step > 0 ? nearest_m * 255 / step : std::numeric_limits<float>::infinity();
        }
    }
    if (source != DepthSource::mono) return out;
    constexpr float share[5] = {0.06f, 0.24f, 0.4f, 0.24f, 0.06f};
    for (int y = 0; y < out.height; ++y)
        for (int x = 0; x < out.width; ++x) {
            float sum = 0;
            for (int dy = -2; dy <= 2; ++dy)
                for (int dx = -2; dx <= 2; ++dx) {
                    const float z =
                        exact.at(std::clamp(x + dx, 0, out.width - 1), std::clamp(y + dy, 0, out.height - 1));
                    sum += share[dx + 2] * share[dy + 2] / z;
                }
            out.at(x, y) = sum > 0 ? 1 / sum : std::numeric_limits<float>::infinity();
        }
    return out;
}

size_t differing_depths(const DepthMap& a, const DepthMap& b) {
    size_t n = 0;
    for (size_t i = 0; i < a.size(); ++i) n += a.data[i] != b.data[i];
    return n;
}

struct Asked {
    RecordedMasks swept, cast;
};

/// Asked of depth as `stored` has it, by the rules of `stated`.
Asked ask(const View& r, const View& v, const DepthMap& exact, DepthSource stored, DepthSource stated) {
    DepthMap depth = stored_as(stored, exact);
    if (stated == DepthSource::mono) depth = snap_edges(depth);
    const DepthRules rules = depth_rules(stated, depth);
    const SweepCamera camera{r.intrinsics, v.intrinsics, compose(inverse(r.world_from_cam), v.world_from_cam), clear_m,
                             rules};
    Asked out;
    Grid<uint8_t> classes;
    Sweeper().classes(camera, depth, classes);
    out.swept = masks_of(classes);
    LiftedRig rig;
    LiftedMesh mesh = lift_towards(r.intrinsics, r.world_from_cam, depth, v.world_from_cam.translation_m, 0, rules);
    rig.views.push_back(build_view("R", r.world_from_cam, std::move(mesh)));
    out.cast = mask(rig, as_shifted(v), clear_m);
    return out;
}
Asked ask(const MinimalScene& s, DepthSource stored, DepthSource stated) {
    const View r = s.recorded(s.own);
    return ask(r, s.shifted(s.shift, s.own), render(s.world, r).depth, stored, stated);
}

}  // namespace

TEST_CASE("a wall stored coarsely hides nothing from itself once its source is stated", "[source]") {
    // A wall 3 m to the left, seen from 5 cm beside it: neighbouring pixels stay a sixtieth of a pixel apart.
    const Intrinsics k{320, 240, 320, 320, 400, 120};
    DepthMap wall(320, 240);
    for (int y = 0; y < 240; ++y)
        for (int x = 0; x < 320; ++x) wall.at(x, y) = float(3 * k.fx / (k.cx - (x + 0.5)));
    const View r{k, {}};
    Pose beside;
    beside.translation_m = {-2.95, 0, 0};
    for (const DepthSource source : {DepthSource::half, DepthSource::mm16, DepthSource::disparity8}) {
        INFO(depth_source_words()[size_t(source)]);
        const Asked stated = ask(r, {k, beside}, wall, source, source);
        CHECK(count(stated.swept.occluded) == 0);
        CHECK(count(stated.cast.occluded) == 0);
        CHECK(count(stated.cast.unknown) == 0);
        CHECK(count(stated.swept.unknown) == 0);
        // Taken for exact, its steps do hide it: the rule is needed.
        const Asked taken_for_exact = ask(r, {k, beside}, wall, source, DepthSource::exact);
        CHECK(count(taken_for_exact.swept.occluded) > 100);
        CHECK(count(taken_for_exact.cast.occluded) > 100);
    }
}

TEST_CASE("the box keeps its patch and strip whatever the depth is stored as", "[source]") {
    const MinimalScene s = make_scene("box");
    const Asked exact = ask(s, DepthSource::exact, DepthSource::exact);
    REQUIRE(count(exact.swept.occluded) == 1600);
    for (const DepthSource source :
         {DepthSource::half, DepthSource::mm16, DepthSource::disparity8, DepthSource::mono}) {
        INFO(depth_source_words()[size_t(source)]);
        const Asked got = ask(s, source, source);
        CHECK(f1(got.swept.occluded, exact.swept.occluded) > 0.97);
        CHECK(f1(got.cast.occluded, exact.cast.occluded) > 0.97);
    }
    // The blur taken for a surface hides itself.
    CHECK(f1(ask(s, DepthSource::mono, DepthSource::exact).swept.occluded, exact.swept.occluded) < 0.95);
}

TEST_CASE("snapping sharpens a blurred step and leaves planes and sharp steps alone", "[source]") {
    DepthMap step(40, 30, 10.0f);
    for (int y = 0; y < 30; ++y)
        for (int x = 0; x < 20; ++x) step.at(x, y) = 4.0f;
    CHECK(differing_depths(snap_edges(step), step) == 0);
    const DepthMap blurred = stored_as(DepthSource::mono, step), snapped = snap_edges(blurred);
    float worst = 0, worst_blurred = 0;
    for (size_t i = 0; i < step.size(); ++i) {
        if (const int y = int(i) / 40; y < 4 || y >= 26) continue;
        worst = std::max(worst, std::fabs(1 / snapped.data[i] - 1 / step.data[i]));
        worst_blurred = std::max(worst_blurred, std::fabs(1 / blurred.data[i] - 1 / step.data[i]));
    }
    CHECK(worst < 0.07f * (1 / 4.0f - 1 / 10.0f));
    CHECK(worst_blurred > 0.25f * (1 / 4.0f - 1 / 10.0f));

    const MinimalScene road = make_scene("grazing_road", {640, 480});
    const DepthMap plane = render(road.world, road.recorded(0)).depth;
    CHECK(differing_depths(snap_edges(plane), plane) == 0);

    DepthMap holes = step;
    holes.at(19, 5) = std::numeric_limits<float>::quiet_NaN();
    holes.at(3, 3) = std::numeric_limits<float>::infinity();
    const DepthMap kept = snap_edges(holes);
    CHECK(std::isnan(kept.at(19, 5)));
    CHECK(std::isinf(kept.at(3, 3)));
}
