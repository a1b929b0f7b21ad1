// SPDX-License-Identifier: Apache-2.0
// The certificate made strict: what is neither unknown, unseen nor at an edge (sweep.h) is right.
#include <cstdio>
#include <cstdlib>

#include "embree_core/c_api.h"
#include "embree_core/sweep.h"
#include "scenes/analytic/analytic_street.h"
#include "tests/catch.h"
#include "tests/minimal_support.h"

using namespace vshift;
using namespace vshift::minimal;

namespace {

struct Certified {
    size_t certain = 0, wrong = 0, wrong_without = 0, certain_without = 0, edge = 0, all = 0;
    void add(const Grid<uint8_t>& classes, const Mask& edges, const Grid<uint8_t>& truth) {
        all += classes.size();
        for (size_t i = 0; i < classes.size(); ++i) {
            const uint8_t c = classes.data[i];
            edge += edges.data[i];
            const bool occluded = c & occluded_bit;
            if (!occluded && (c & (unknown_bit | unseen_bit))) continue;
            const bool wrong_here = occluded != bool(truth.data[i] & VSHIFT_TRUTH_OCCLUDED);
            ++certain_without, wrong_without += wrong_here;
            if (edges.data[i]) continue;
            ++certain, wrong += wrong_here;
        }
    }
};

/// V seen from R.
SweepCamera between(const Intrinsics& k, const Pose& world_from_r, const Pose& world_from_v) {
    return {k, k, compose(inverse(world_from_r), world_from_v), clear_m};
}

}  // namespace

TEST_CASE("edges: with them the certificate holds on every closed form", "[edges]") {
    Certified pooled;
    for (const std::string& name : scene_names())
        for (uint32_t seed = 1; seed <= (name == "random" ? 10u : 1u); ++seed) {
            const MinimalScene s = make_scene(name, name == "random" ? Size{160, 120} : Size{320, 240}, seed);
            for (const Shift& by : {s.shift, moved(0, -1), moved(1, 0.7)}) {
                INFO(name << " " << seed << " ahead " << by.translation_m.x << " left " << by.translation_m.y);
                const View r = s.recorded(s.own), v = s.shifted(by, s.own);
                const DepthMap depth = render(s.world, r).depth;
                const SweepCamera camera = between(r.intrinsics, r.world_from_cam, v.world_from_cam);
                Sweeper sweeper;
                Grid<uint8_t> classes;
                sweeper.classes(camera, depth, classes);
                pooled.add(classes, sweeper.edges(camera, depth, classes), truth_recorded(s.world, {r}, 0, v));
            }
        }
    INFO(pooled.wrong << " of " << pooled.certain << " wrong; without edges " << pooled.wrong_without << " of "
                      << pooled.certain_without);
    CHECK(pooled.wrong * 10000 <= pooled.certain);
    CHECK(pooled.certain * 10 >= pooled.certain_without * 8);  // and most of what was certain stays so
    CHECK(pooled.wrong_without * 10000 > pooled.certain_without);
}

TEST_CASE("edges: the certificate holds on an analytic street", "[edges]") {
    const analytic::StreetScene street = analytic::build_street(3);
    const auto rig = analytic::six_camera_rig(1600, 900);
    Certified pooled;
    for (const int own : {0, 1})
        for (const Shift& by : {moved(0, 2), moved(2, 0)}) {
            const analytic::StreetTruth truth = analytic::street_truth(street, rig, own, 4, by);
            const SweepCamera camera =
                between(rig[size_t(own)].intrinsics, analytic::recorded_camera(rig[size_t(own)], 4).world_from_cam,
                        analytic::shifted_camera(rig[size_t(own)], 4, by).world_from_cam);
            Sweeper sweeper;
            Grid<uint8_t> classes;
            sweeper.classes(camera, truth.depth, classes);
            pooled.add(classes, sweeper.edges(camera, truth.depth, classes), truth.truth_flags);
        }
    if (std::getenv("VSHIFT_TEST_PRINT"))
        std::printf("edges: %zu of %zu certain wrong (%zu of %zu without), %zu of %zu at an edge\n", pooled.wrong,
                    pooled.certain, pooled.wrong_without, pooled.certain_without, pooled.edge, pooled.all);
    CHECK(pooled.wrong * 10000 <= pooled.certain);
    CHECK(pooled.wrong_without * 1000 > pooled.certain_without);
    CHECK(pooled.edge * 12 <= pooled.all);
}

TEST_CASE("edges: none without a shift, none within one plane", "[edges]") {
    const MinimalScene s = make_scene("grazing_road", {640, 480});
    const View r = s.recorded(0);
    const DepthMap depth = render(s.world, r).depth;
    for (const Shift& by : {moved(0, 0), moved(0, 2)}) {
        const SweepCamera camera = between(r.intrinsics, r.world_from_cam, s.shifted(by, 0).world_from_cam);
        Sweeper sweeper;
        Grid<uint8_t> classes;
        sweeper.classes(camera, depth, classes);
        const Mask edges = sweeper.edges(camera, depth, classes);
        Mask within = edges;  // the picture's own border is an edge too
        for (int y = 0; y < edges.height; ++y) within.at(0, y) = within.at(edges.width - 1, y) = 0;
        CHECK(count(within) == 0);
    }
}
