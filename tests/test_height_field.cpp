// SPDX-License-Identifier: Apache-2.0
// Masks by rays against the height field of one depth map: against the mesh, from closed forms, and where rays are
// spared.
#include <tbb/global_control.h>

#include "embree_core/field_mask.h"
#include "embree_core/ray_filter.h"
#include "tests/catch.h"
#include "tests/minimal_support.h"
#include "tests/subjects.h"

using namespace vshift;
using namespace vshift::minimal;

namespace {

RecordedMasks by_field(const Intrinsics& k, const DepthMap& depth, const glm::dvec3& centre_m,
                       Casting casting = Casting::where_needed, const DepthRules& rules = {}) {
    return minimal::by_field({k, Pose{}}, {k, Pose{glm::dmat3(1.0), centre_m}}, depth, clear_m, casting, rules);
}

RecordedMasks by_mesh(const Intrinsics& k, const DepthMap& depth, const glm::dvec3& centre_m,
                      const DepthRules& rules = {}) {
    LiftedRig rig;
    rig.views.push_back(build_view("own", Pose{}, lift_towards(k, Pose{}, depth, centre_m, 0, rules)));
    return mask(rig, {k, Pose{glm::dmat3(1.0), centre_m}}, clear_m, Casting::everywhere);
}

/// A noisy wall with boxes, sky and holes before it, up to 60 x 50 pixels, and where V stands: anywhere within metres,
/// often on a row or close by.
struct RandomScene {
    Intrinsics k;
    DepthMap depth;
    glm::dvec3 centre_m;

    explicit RandomScene(unsigned seed) {
        std::mt19937 random(seed);
        const auto between = [&](double a, double b) { return a + (b - a) * double(random()) / 4294967296.0; };
        k.width = int(between(1, 60)), k.height = int(between(1, 50));
        k.fx = between(20, 300), k.fy = between(20, 300);
        k.cx = between(0, k.width), k.cy = between(0, k.height);
        depth = DepthMap(k.width, k.height);
        const double base = between(1, 30), noise = std::pow(10, between(-6, -1));
        for (float& z : depth.data) z = float(base * (1 + noise * between(-1, 1)));
        for (int boxes = int(between(0, 8)); boxes > 0; --boxes) {
            const int x0 = int(between(0, k.width)), y0 = int(between(0, k.height)), x1 = x0 + int(between(1, 30)),
                      y1 = y0 + int(between(1, 30)), what = int(between(0, 8));
            const double z = between(0.5, 60), slope_x = between(-.1, .1), slope_y = between(-.1, .1);
            for (int y = y0; y < std::min(y1, k.height); ++y)
                for (int x = x0; x < std::min(x1, k.width); ++x)
                    depth.at(x, y) = what == 5 ? std::numeric_limits<float>::infinity()
                                     : what == 6
                                         ? std::numeric_limits<float>::quiet_NaN()
                                         : float(std::max(0.1, z * (1 + slope_x * (x - x0) + slope_y * (y - y0))));
        }
        centre_m = {between(-4, 4), between(-1, 1), between(-3, 3)};
        if (random() % 3 == 0) centre_m = {centre_m.x, 0, 0};
        if (random() % 4 == 0) centre_m *= std::pow(10, between(-2, 0));
    }
};

}  // namespace

TEST_CASE("rays against the height field and against the mesh agree", "[field]") {
    size_t differ = 0, all = 0;
    for (const Subject& s : subjects())
        for (const glm::dvec3& centre :
             {s.v_centre, glm::dvec3(0.7, 0, 0), glm::dvec3(0.3, -0.2, 0.4), glm::dvec3(-0.1, 0.3, -0.5)}) {
            const size_t here = differing(by_field(s.k, s.depth, centre), by_mesh(s.k, s.depth, centre));
            INFO(s.name << " from " << centre.x << " " << centre.y << " " << centre.z);
            CHECK(here * 2000 <= s.depth.size());
            differ += here, all += s.depth.size();
        }
    for (unsigned seed = 1; seed <= 300; ++seed) {
        const RandomScene s(seed);
        differ += differing(by_field(s.k, s.depth, s.centre_m), by_mesh(s.k, s.depth, s.centre_m));
        all += s.depth.size();
    }
    INFO(differ << " of " << all << " pixels");
    CHECK(differ * 5000 < all);
}

TEST_CASE("so they do whatever depth comes from: rays start as far above the surface as it errs", "[field]") {
    for (const Subject& s : {of_disparity("walls", 320, 240, walls_px), of_disparity("hills", 331, 203, hills_px)})
        for (const DepthSource source :
             {DepthSource::half, DepthSource::mm16, DepthSource::disparity8, DepthSource::mono}) {
            const DepthRules rules = depth_rules(source, s.depth, 0.001);
            const RecordedMasks field = by_field(s.k, s.depth, s.v_centre, Casting::where_needed, rules),
                                mesh = by_mesh(s.k, s.depth, s.v_centre, rules);
            INFO(s.name << ", source " << int(source));
            CHECK(differing(field, mesh) * 10000 <= s.depth.size());
            if (source != DepthSource::mono) CHECK(!rules.error.none());
        }
}

TEST_CASE("tiles that rays can meet say what the whole height field says, on one thread and two", "[field]") {
    const auto check = [](const Intrinsics& k, const DepthMap& depth, const glm::dvec3& centre) {
        const RecordedMasks all = by_field(k, depth, centre, Casting::everywhere);
        for (const size_t threads : {1, 2}) {
            const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, threads);
            CHECK(differing(by_field(k, depth, centre), all) == 0);
        }
    };
    for (const Subject& s : subjects())
        for (const glm::dvec3& centre :
             {s.v_centre, glm::dvec3(0.7, 0, 0), glm::dvec3(0.3, -0.2, 0.4), glm::dvec3(-0.1, 0.3, -0.5)}) {
            INFO(s.name << " from " << centre.x << " " << centre.y << " " << centre.z);
            check(s.k, s.depth, centre);
        }
    for (unsigned seed = 1; seed <= 300; ++seed) {
        INFO("seed " << seed);
        const RandomScene s(seed);
        check(s.k, s.depth, s.centre_m);
    }
}

TEST_CASE("only tiles that rays can meet are kept", "[field]") {
    const Subject s = of_disparity("walls", 320, 240, walls_px);
    const auto tiles = [&](Casting casting) {
        return field_view(surface_view(s.k, Pose{}, s.depth, s.v_centre), {}, s.v_centre, casting).field.tiles();
    };
    CHECK(tiles(Casting::everywhere) == size_t(320 / heights::tile_cells + 1) * (240 / heights::tile_cells + 1));
    CHECK(tiles(Casting::where_needed) * 4 < tiles(Casting::everywhere));
}

TEST_CASE("rays along the border of tiles meet what is in them", "[field]") {
    // A slanted wall whose steps hide a pixel or two beside them; rays keep to their rows, down to a float's digits.
    DepthMap depth(240, 900);
    for (int y = 0; y < depth.height; ++y)
        for (int x = 0; x < depth.width; ++x) {
            const int strip = (x + y) / 60;
            depth.at(x, y) = float(1 / (0.11 - 0.000143 * x - 0.00026 * strip));
        }
    const Intrinsics k{240, 900, 1266.4, 1266.4, 120, 450};
    const glm::dvec3 centre(-2, 0, 0);
    const RecordedMasks m = by_field(k, depth, centre);
    CHECK(count(m.occluded) > 1000);
    CHECK(differing(m, by_mesh(k, depth, centre)) == 0);
}

TEST_CASE("a narrow picture's rays are asked where the surface rises down it", "[filter]") {
    // Rays leave their row by a third of a pixel over its two pixels, and 1/z rises by up to .5 from row to row.
    Subject s = of_disparity("narrow", 2, 18, [](double, double) { return 20.0; });
    s.k.fx = 176.2, s.k.fy = 114.2, s.k.cx = 1.85, s.k.cy = 5.14;
    for (int y = 3; y < 18; ++y) s.depth.at(1, y) = float(3.45 - 0.2075 * (y - 3));
    const glm::dvec3 centre(-1.1, 0.26, 0.38);
    const RecordedMasks all = by_mesh(s.k, s.depth, centre), few = by_field(s.k, s.depth, centre);
    CHECK(count(all.occluded) >= 8);
    CHECK(differing(few, all) == 0);
}

TEST_CASE("rays where they are needed say what rays everywhere say", "[filter]") {
    size_t asked = 0, spared = 0;
    for (const std::string& name : scene_names())
        for (const Shift& by : {moved(0, 1), moved(0, -2), moved(1, 0), moved(-1.5, 0), moved(0.5, 1, 0.2),
                                moved(2, -1), moved(0, 0.05), moved(0, 0, 0.5), moved(0, 0)}) {
            const MinimalScene s = make_scene(name, {320, 240});
            const Case c = lift_scene(s, by);
            const RecordedMasks few = mask(c.rig, as_shifted(c.v), clear_m),
                                all = mask(c.rig, as_shifted(c.v), clear_m, Casting::everywhere);
            INFO(name << " ahead " << by.translation_m.x << " left " << by.translation_m.y << " up "
                      << by.translation_m.z);
            CHECK(differing(few.occluded, all.occluded) + differing(few.unknown, all.unknown) +
                      differing(few.unseen, all.unseen) + differing(few.outside, all.outside) ==
                  0);
            const LiftedView& own = c.rig.views[size_t(c.rig.own)];
            const RayFilter filter(own.mesh.surface(),
                                   inverse(own.world_from_cam).point(c.v.world_from_cam.translation_m));
            for (int y = 0; y < few.lost.height; ++y)
                for (int x = 0; x < few.lost.width; ++x) ++(filter.asks(x, y) ? asked : spared);
        }
    INFO(spared << " spared, " << asked << " asked");
    CHECK(spared > asked);
}

TEST_CASE("a height field made ready for one place answers no other", "[field]") {
    const Subject s = of_disparity("walls", 160, 120, walls_px);
    const FieldView view = field_view(surface_view(s.k, Pose{}, s.depth, s.v_centre), {}, s.v_centre);
    CHECK_THROWS_AS(mask(view, s.depth, {s.k, Pose{glm::dmat3(1.0), glm::dvec3(1, 0, 0)}}, clear_m), Error);
}
