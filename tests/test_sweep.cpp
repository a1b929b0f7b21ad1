// SPDX-License-Identifier: Apache-2.0
// Masks of one camera without a mesh, by the sweep and by rays against the height field: the same closed forms as the
// ray caster, the ray caster itself, and threads.
#include <tbb/global_control.h>

#include "embree_core/sweep.h"
#include "tests/catch.h"
#include "tests/minimal_support.h"

using namespace vshift;
using namespace vshift::minimal;

namespace {

RecordedMasks swept(const View& r, const View& v, const DepthMap& depth, double clear = clear_m) {
    Sweeper sweeper;
    Grid<uint8_t> classes;
    sweeper.classes({r.intrinsics, v.intrinsics, compose(inverse(r.world_from_cam), v.world_from_cam), clear}, depth,
                    classes);
    return masks_of(classes);
}

struct Engine {
    const char* name;
    RecordedMasks (*masks)(const View& r, const View& v, const DepthMap& depth, double clear);
    /// Rays miss V's centre by a trifle to one side, which decides where they graze an edge, and whole cells are cut
    /// along one diagonal: mirrored masks may differ by so many pixels, and are compared where no edge is grazed.
    size_t mirror_px;

    RecordedMasks operator()(const View& r, const View& v, const DepthMap& depth, double clear = clear_m) const {
        return masks(r, v, depth, clear);
    }
    RecordedMasks operator()(const MinimalScene& s, const Shift& shift) const {
        const View r = s.recorded(s.own);
        return masks(r, s.shifted(shift, s.own), render(s.world, r).depth, clear_m);
    }
};
RecordedMasks in_tiles(const View& r, const View& v, const DepthMap& depth, double clear) {
    return by_field(r, v, depth, clear);
}
const Engine engines[] = {{"sweep", swept, 0}, {"tiles", in_tiles, 8}};

bool same(const std::vector<RectPx>& a, const std::vector<RectPx>& b) {
    return a.size() == b.size() && std::equal(a.begin(), a.end(), b.begin(), [](auto& l, auto& r) {
               return l.x0 == r.x0 && l.y0 == r.y0 && l.x1 == r.x1 && l.y1 == r.y1;
           });
}

/// Pixels that differ, without those whose place in V's picture is its border to a float's digits.
size_t outside_beyond_rounding(const MinimalScene& s, const Shift& by, const Mask& a, const Mask& b) {
    const View r = s.recorded(s.own), v = s.shifted(by, s.own);
    const DepthMap depth = render(s.world, r).depth;
    const Pose v_from_r = compose(inverse(v.world_from_cam), r.world_from_cam);
    const Intrinsics& k = v.intrinsics;
    size_t n = 0;
    for (int y = 0; y < a.height; ++y)
        for (int x = 0; x < a.width; ++x) {
            if (a.at(x, y) == b.at(x, y)) continue;
            const auto u = project(k, v_from_r.point(ray(r.intrinsics, {x + 0.5, y + 0.5}) * double(depth.at(x, y))));
            n += !u || std::min({std::fabs(u->x), std::fabs(u->x - k.width), std::fabs(u->y),
                                 std::fabs(u->y - k.height)}) > 1e-4;
        }
    return n;
}

}  // namespace

TEST_CASE("sweep and tiles: the box", "[sweep][field]") {
    const Engine& engine = engines[GENERATE(0, 1)];
    INFO(engine.name);
    const MinimalScene s = make_scene("box");
    const RecordedMasks m = engine(s, s.shift);
    CHECK(same(rectangles(m.occluded), {{168, 100, 208, 140}}));
    CHECK(same(rectangles(m.outside), {{288, 0, 320, 240}}));
    CHECK(same(rectangles(m.unknown), {{160, 100, 168, 140}}));
    CHECK(count(m.lost) == 40 * 40 + 32 * 240);
}

TEST_CASE("sweep and tiles: every closed form of every scene", "[sweep][field]") {
    const Engine& engine = engines[GENERATE(0, 1)];
    INFO(engine.name);
    for (const std::string& name : scene_names()) {
        const MinimalScene s = make_scene(name);
        const RecordedMasks m = engine(s, s.shift);
        for (const ClosedForm& form : s.closed_forms) {
            if (form.out != "mask") continue;
            INFO(name << " " << form.channel << ": " << form.rule << ", expected " << count(form.expected) << " px");
            const size_t wrong = differing(channel_of(m, form.channel), form.expected);
            INFO(wrong << " px differ");
            CHECK(wrong <= (name == "step_kerb" && form.channel == "occluded" ? 200 : 0));
        }
    }
}

TEST_CASE("sweep and tiles: strips at any width and phase, along rows and down columns", "[sweep][field]") {
    const Engine& engine = engines[GENERATE(0, 1)];
    INFO(engine.name);
    for (const bool upright : {true, false})
        for (double strip : {3.0, 4.25, 7.4, 12.75, 24.0, 60.4, 96.0})
            for (double phase : {0.0, 0.13, 0.37, 0.62, 0.88})
                for (int side : {1, -1}) {
                    const double b = side * strip / (320 * (1 / 4.0 - 1 / 10.0));
                    const int wide = upright ? 320 : 24, high = upright ? 24 : 320;
                    // A near half plane before a wall, made by hand so that it can stand either way.
                    DepthMap depth(wide, high, 10.0f);
                    for (int y = 0; y < high; ++y)
                        for (int x = 0; x < wide; ++x) {
                            const double u = (upright ? x : y) + 0.5;
                            if (side > 0 ? u < 120 + phase : u > 200 + phase) depth.at(x, y) = 4.0f;
                        }
                    View r{{wide, high, 320, 320, wide * 0.5, high * 0.5}, Pose{}}, v = r;
                    (upright ? v.world_from_cam.translation_m.x : v.world_from_cam.translation_m.y) = -b;
                    const RecordedMasks m = engine(r, v, depth);
                    const double got = double(count(m.occluded)) / 24;
                    INFO((upright ? "rows" : "columns")
                         << " strip " << strip << " side " << side << " phase " << phase);
                    CHECK(std::fabs(got - strip) <= 0.5 + 1e-9);
                    CHECK(count(m.unknown) == 0);
                    CHECK(rectangles(m.occluded).size() == 1);
                }
}

TEST_CASE("sweep and tiles: zero shift, turning on the spot, yaw", "[sweep][field]") {
    const Engine& engine = engines[GENERATE(0, 1)];
    INFO(engine.name);
    for (const std::string& name : scene_names()) {
        const MinimalScene s = make_scene(name);
        INFO(name);
        const RecordedMasks m = engine(s, moved(0, 0));
        CHECK(count(m.lost) + count(m.unknown) + count(m.unseen) == 0);
    }
    for (const char* name : {"box", "fence", "round_pole", "step_kerb", "random"}) {
        const MinimalScene s = make_scene(name);  // its camera stands on the ego's vertical axis
        INFO(name);
        const RecordedMasks spot = engine(s, moved(0, 0, 0, 0.2));
        CHECK(count(spot.occluded) + count(spot.unknown) + count(spot.unseen) == 0);
        CHECK(count(spot.outside) > 1000);
        for (const Shift& by : {s.shift, moved(1, 0.4)}) {
            Shift turned = by;
            turned.yaw_rad = 0.2;
            const RecordedMasks a = engine(s, by), b = engine(s, turned);
            CHECK(differing(a.occluded, b.occluded) + differing(a.unknown, b.unknown) + differing(a.unseen, b.unseen) ==
                  0);
            CHECK(differing(a.outside, b.outside) > 1000);
        }
    }
}

TEST_CASE("sweep and tiles: scale and mirror to the bit", "[sweep][field]") {
    const Engine& engine = engines[GENERATE(0, 1)];
    INFO(engine.name);
    for (const std::string& name : scene_names())
        for (const Shift& by : {moved(0, 1.01237), moved(1.3, 0), moved(0.4, 0.9, 0.2), moved(-1, -0.6)}) {
            const MinimalScene s = make_scene(name);
            const View r = s.recorded(s.own), v = s.shifted(by, s.own);
            const Pose v_in_r = compose(inverse(r.world_from_cam), v.world_from_cam);
            const DepthMap depth = render(s.world, r).depth;
            INFO(name << " ahead " << by.translation_m.x << " left " << by.translation_m.y);
            const auto run = [&](const DepthMap& z, double scale, double sign) {
                View at{r.intrinsics, v_in_r};
                at.world_from_cam.translation_m *= scale;
                at.world_from_cam.translation_m.x *= sign;
                return engine({r.intrinsics, Pose{}}, at, z, clear_m * scale);
            };
            const RecordedMasks one = run(depth, 1, 1);
            for (const float scale : {2.0f, 0.125f}) {
                DepthMap scaled = depth;
                for (float& z : scaled.data) z *= scale;
                CHECK(differing(one, run(scaled, double(scale), 1)) == 0);
            }
            if (engine.mirror_px && by.translation_m.x != 0) continue;
            DepthMap flipped = depth;
            for (int y = 0; y < depth.height; ++y)
                for (int x = 0; x < depth.width; ++x) flipped.at(x, y) = depth.at(depth.width - 1 - x, y);
            const RecordedMasks other = run(flipped, 1, -1);
            CHECK(differing(mirrored(one.occluded), other.occluded) <= engine.mirror_px);
            CHECK(differing(mirrored(one.unknown), other.unknown) <= engine.mirror_px);
            CHECK(differing(mirrored(one.unseen), other.unseen) == 0);
        }
}

TEST_CASE("sweep against rays", "[sweep]") {
    size_t pooled_both = 0, pooled_sum = 0;
    for (const std::string& name : scene_names())
        for (const Shift& by :
             {moved(0, 1), moved(0, -2), moved(1, 0), moved(-1.5, 0), moved(0.5, 1, 0.2), moved(2, -1)}) {
            const MinimalScene s = make_scene(name, {640, 480});
            const bool rows = by.translation_m.x == 0 && by.translation_m.z == 0;
            const Case c = lift_scene(s, by);
            const RecordedMasks rays = mask(c.rig, as_shifted(c.v), clear_m), m = engines[0](s, by);
            const size_t n = differing(m, rays);
            INFO(name << " ahead " << by.translation_m.x << " left " << by.translation_m.y << ": " << n
                      << " px differ, F1 " << f1(m.occluded, rays.occluded) << ", unknown F1 "
                      << f1(m.unknown, rays.unknown) << " of " << count(rays.occluded) << " and "
                      << count(rays.unknown));
            if (rows) CHECK(double(n) <= 0.0003 * 640 * 480);
            // Points on a frame's border to a float's digits fall on either side.
            CHECK(outside_beyond_rounding(s, by, m.outside, rays.outside) == 0);
            CHECK(differing(m.unseen, rays.unseen) <= 30);
            // Lines that are not the rows pass a pixel within a third of a pixel: the edges of poles 1 to 3 px wide
            // move by that.
            if (count(rays.occluded) > 1000) CHECK(f1(m.occluded, rays.occluded) >= 0.97);
            if (rows) continue;
            for (size_t i = 0; i < m.lost.size(); ++i) pooled_both += m.occluded.data[i] && rays.occluded.data[i];
            pooled_sum += count(m.occluded) + count(rays.occluded);
        }
    INFO("pooled F1 " << 2.0 * double(pooled_both) / double(pooled_sum));
    CHECK(2.0 * double(pooled_both) / double(pooled_sum) >= 0.99);
}

TEST_CASE("sweep and tiles: a slanted near wall that covers a far one has no pinhole", "[sweep][field]") {
    const Engine& engine = engines[GENERATE(0, 1)];
    INFO(engine.name);
    // The near wall fills the image's right half, seen aslant; behind it, as V sees it, lies the far one.
    const View r{{320, 240, 320, 320, 160, 120}, Pose{}};
    DepthMap depth(320, 240, 40.0f);
    for (int y = 0; y < 240; ++y)
        for (int x = 160; x < 320; ++x) depth.at(x, y) = float(1 / (0.12 + 0.00021 * (x - 160) + 0.00017 * (y - 120)));
    for (const glm::dvec3& by :
         {glm::dvec3(3, 0, 0), glm::dvec3(3, 0.4, 0), glm::dvec3(3, -0.2, 0.6), glm::dvec3(2.5, 0.1, -0.8)}) {
        View v = r;
        v.world_from_cam.translation_m = by;
        const RecordedMasks m = engine(r, v, depth);
        INFO("V at " << by.x << " " << by.y << " " << by.z);
        CHECK(count(m.occluded) > 1000);
        // What is hidden of the far wall is one piece: no visible pixel has hidden ones on both sides.
        size_t pinholes = 0;
        for (int y = 20; y < 220; ++y)
            for (int x = 1; x < 159; ++x) {
                const auto hidden = [&](int i) { return m.occluded.at(i, y) || m.unknown.at(i, y); };
                pinholes += !hidden(x) && hidden(x - 1) && hidden(x + 1);
            }
        CHECK(pinholes == 0);
    }
}

TEST_CASE("sweep and tiles: no epipolar line slips through a stair of pixels that meet at their corners",
          "[sweep][field]") {
    const Engine& engine = engines[GENERATE(0, 1)];
    INFO(engine.name);
    // Before a wall stand near pixels along a diagonal; V looks across it.
    const int size = 120;
    const double near = 4, far = 10;
    DepthMap depth(size, size, float(far));
    for (int i = 0; i < size; ++i) depth.at(i, i) = float(near);
    const View r{{size, size, 120, 120, size * 0.5, size * 0.5}, Pose{}};
    for (const glm::dvec3& by : {glm::dvec3(1.1, -0.85, 0), glm::dvec3(-1.1, 0.85, 0), glm::dvec3(0.7, -1.2, 0.3),
                                 glm::dvec3(-0.8, 1, -0.2), glm::dvec3(1, -1, 0)}) {
        View v = r;
        v.world_from_cam.translation_m = by;
        const RecordedMasks m = engine(r, v, depth);
        INFO("V at " << by.x << " " << by.y << " " << by.z);
        // V sees a point of the stair at the same place as the wall's points up to that at the way's end.
        size_t asked = 0, slipped = 0;
        for (double at = 35; at < 85; at += 0.25) {
            const glm::dvec3 point = ray(r.intrinsics, {at, at}) * near;
            const std::optional<glm::dvec2> behind =
                project(r.intrinsics, by + (point - by) * ((far - by.z) / (near - by.z)));
            REQUIRE(behind);
            const glm::dvec2 way = *behind - glm::dvec2(at);
            for (double share = 0.1; share < 0.9; share += 0.02) {
                const glm::ivec2 pixel(glm::floor(glm::dvec2(at) + share * way));
                if (std::abs(pixel.x - pixel.y) < 2) continue;
                ++asked;
                slipped += !m.occluded.at(pixel.x, pixel.y) && !m.unknown.at(pixel.x, pixel.y);
            }
        }
        INFO(slipped << " of " << asked);
        CHECK(asked > 1000);
        CHECK(slipped == 0);
    }
}

TEST_CASE("sweep and tiles: poles of 1 px, invalid depth, sky, nothing", "[sweep][field]") {
    const Engine& engine = engines[GENERATE(0, 1)];
    INFO(engine.name);
    const MinimalScene poles = make_scene("round_pole");
    for (const Shift& by : {moved(0, 1), moved(0, -1), moved(1, 1.5)}) {
        const RecordedMasks m = engine(poles, by);
        const Mask truth =
            flagged(truth_recorded(poles.world, {poles.recorded(0)}, 0, poles.shifted(by, 0)), VSHIFT_TRUTH_OCCLUDED);
        INFO("ahead " << by.translation_m.x << " left " << by.translation_m.y << " F1 " << f1(m.occluded, truth));
        CHECK(f1(m.occluded, truth) > 0.85);
    }
    const MinimalScene s = make_scene("box");
    const View r = s.recorded(0), v = s.shifted(s.shift, 0);
    const DepthMap depth = render(s.world, r).depth;
    const float nan = std::numeric_limits<float>::quiet_NaN();
    for (const float bad : {nan, 0.0f, -3.0f}) {
        DepthMap broken = depth;
        for (int y = 110; y < 120; ++y)
            for (int x = 60; x < 70; ++x) broken.at(x, y) = bad;
        const Case c = lift_scene(s, s.shift);
        LiftedRig rig;
        rig.views.push_back(lift_view("R", r.intrinsics, r.world_from_cam, broken, v.world_from_cam.translation_m));
        CHECK(differing(engine(r, v, broken), mask(rig, as_shifted(v), clear_m)) == 0);
    }
    DepthMap in_the_sky = depth;
    for (float& z : in_the_sky.data)
        if (z > 9) z = std::numeric_limits<float>::infinity();
    const RecordedMasks m = engine(r, v, in_the_sky);
    CHECK(same(rectangles(m.occluded), {{200, 100, 240, 140}}));
    CHECK(same(rectangles(m.unknown), {{160, 100, 200, 140}}));
    for (const float value : {nan, 0.0f, -1.0f, 1e-30f, 1e-6f, 1e6f, 3e38f})
        for (const Shift& by : {s.shift, moved(1, 0), moved(-1, 0.3, 0.1)}) {
            const RecordedMasks all = engine(r, s.shifted(by, 0), DepthMap(320, 240, value));
            INFO("depth " << value);
            if (!(value > 0)) CHECK(count(all.unknown) == 320 * 240);
            if (value >= 1e6f) CHECK(count(all.occluded) + count(all.unknown) == 0);
        }
}

TEST_CASE("sweep and tiles: odd sizes, far and near epipoles, one thread and two", "[sweep][field]") {
    const Engine& engine = engines[GENERATE(0, 1)];
    INFO(engine.name);
    uint32_t state = 7;
    const auto random = [&] {
        state = state * 1664525u + 1013904223u;
        return double(state >> 8) / double(1 << 24);
    };
    for (const glm::ivec2 size :
         {glm::ivec2(1, 1), glm::ivec2(2, 7), glm::ivec2(17, 3), glm::ivec2(33, 65), glm::ivec2(401, 223)}) {
        const View r{{size.x, size.y, 200, 210, size.x * 0.47, size.y * 0.52}, Pose{}};
        DepthMap depth(size.x, size.y);
        for (float& z : depth.data) {
            z = float(3 + 30 * random());
            if (random() < 0.05) z = std::numeric_limits<float>::infinity();
            if (random() < 0.02) z = 0;
        }
        for (const glm::dvec3& by :
             {glm::dvec3(1, 0, 0), glm::dvec3(0, 1, 0), glm::dvec3(0, 0, 1), glm::dvec3(0.2, 0.1, -2),
              glm::dvec3(1, 0.001, 1e-7), glm::dvec3(0.3, 1, 0.01), glm::dvec3(-1, -1, 0), glm::dvec3(0, 0, 20)}) {
            View v = r;
            v.world_from_cam.translation_m = by;
            std::vector<RecordedMasks> results;
            for (const size_t threads : {1, 2}) {
                const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, threads);
                results.push_back(engine(r, v, depth));
            }
            INFO(size.x << "x" << size.y << " V at " << by.x << " " << by.y << " " << by.z);
            CHECK(differing(results[0], results[1]) == 0);
            size_t both = 0;
            for (size_t i = 0; i < depth.size(); ++i) {
                both += results[0].occluded.data[i] && results[0].unknown.data[i];
                if (!is_measured(depth.data[i]) && !is_sky(depth.data[i])) CHECK(results[0].unknown.data[i] == 1);
            }
            CHECK(both == 0);
        }
    }
}
