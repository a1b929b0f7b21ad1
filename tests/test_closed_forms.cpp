// SPDX-License-Identifier: Apache-2.0
// The product's masks against closed forms (method.md section 6). Scenes are analytic, depth is exact.
#include "tests/catch.h"
#include "tests/minimal_support.h"

using namespace vshift;
using namespace vshift::minimal;

namespace {

using Rects = std::vector<RectPx>;

bool same(const Rects& a, const Rects& b) {
    return a.size() == b.size() && std::equal(a.begin(), a.end(), b.begin(), [](auto& l, auto& r) {
               return l.x0 == r.x0 && l.y0 == r.y0 && l.x1 == r.x1 && l.y1 == r.y1;
           });
}

const Mask& expected(const MinimalScene& s, const std::string& out, const std::string& channel) {
    for (const ClosedForm& c : s.closed_forms)
        if (c.out == out && c.channel == channel) return c.expected;
    throw Error(ExitCode::our_bug, s.name + " has no closed form for " + out + " " + channel);
}

/// Torn walls whose both sides are surfaces: not those against the sky.
/// Tears between two measured pixels; `level`: only where both lie equally high.
size_t tears_between_surfaces(const LiftedMesh& mesh, bool level = false) {
    size_t n = 0;
    const Grid<float>& w = mesh.inverse_depth;
    for (int y = 0; y < w.height; ++y)
        for (int x = 0; x < w.width; ++x) {
            const size_t at = size_t(y) * size_t(w.width) + size_t(x);
            const auto torn = [&](uint8_t bit, size_t next) {
                return (mesh.tears.data[at] & bit) && w.data[at] > 0 && w.data[next] > 0 &&
                       !(level && std::fabs(mesh.vertices[at].y - mesh.vertices[next].y) > 1e-3f);
            };
            n += torn(1, at + 1);
            n += torn(2, at + size_t(w.width));
        }
    return n;
}

}  // namespace

TEST_CASE("the box: 40x40 px of the wall, and a strip of 32 px", "[closed]") {
    const MinimalScene s = make_scene("box");
    const RecordedMasks m = masks_of(s, s.shift);
    CHECK(same(rectangles(m.occluded), {{168, 100, 208, 140}}));
    CHECK(same(rectangles(m.outside), {{288, 0, 320, 240}}));
    CHECK(same(rectangles(m.unknown), {{160, 100, 168, 140}}));
    CHECK(count(m.lost) == 40 * 40 + 32 * 240);

    const Case c = lift_scene(s, s.shift);
    const ShiftedHoles h = holes(c.rig, as_shifted(c.v));
    CHECK(same(rectangles(h.disoccluded), {{152, 100, 200, 140}}));  // f b (1/4 - 1/10) = 48 px wide
    CHECK(same(rectangles(h.outside), {{0, 0, 32, 240}}));
    CHECK(differing(h.hole, either(h.disoccluded, h.outside)) == 0);
}

TEST_CASE("every closed form of every scene, to the pixel", "[closed]") {
    for (const std::string& name : scene_names()) {
        const MinimalScene s = make_scene(name);
        const Case c = lift_scene(s, s.shift);
        const RecordedMasks m = mask(c.rig, as_shifted(c.v), clear_m);
        const ShiftedHoles h = holes(c.rig, as_shifted(c.v));
        const Grid<uint8_t> truth = truth_recorded(s.world, {s.recorded(s.own)}, 0, c.v);
        const Mask undecided = undecided_by_sampling(s.world, s.recorded(s.own), c.v, 1.0);
        for (const ClosedForm& form : s.closed_forms) {
            INFO(name << " " << form.out << " " << form.channel << ": " << form.rule << ", expected "
                      << count(form.expected) << " px");
            const Mask& got = form.out == "holes" ? h.hole : channel_of(m, form.channel);
            if (form.out == "holes" || form.channel != "occluded") {
                CHECK(differing(got, form.expected) == 0);
            } else if (name == "step_kerb") {  // its edges run aslant through the pixels
                if (form.out == "mask") {
                    CHECK(differing(got, form.expected) < 200);
                    CHECK(beyond(got, either(form.expected, undecided)) == 0);
                    CHECK(beyond(form.expected, either(got, undecided)) <= 2);
                }
            } else {
                CHECK(differing(got, form.expected) == 0);
            }
            // The analytic truth, which the other tests lean on, must say the same.
            if (form.channel == "occluded" && form.out == "truth")
                CHECK(differing(flagged(truth, VSHIFT_TRUTH_OCCLUDED), form.expected) == 0);
            if (form.channel == "occluded" && form.out == "mask")
                CHECK(differing(flagged(truth, VSHIFT_TRUTH_SHELL_SELF), form.expected) == 0);
            if (form.channel == "outside") CHECK(differing(flagged(truth, VSHIFT_TRUTH_OUTSIDE), form.expected) == 0);
        }
    }
}

TEST_CASE("the closed forms themselves, in numbers", "[closed]") {
    const auto rects = [](const char* scene, const char* channel) {
        const MinimalScene s = make_scene(scene);
        return rectangles(expected(s, "mask", channel));
    };
    CHECK(same(rects("two_planes", "occluded"), {{120, 0, 168, 240}}));
    CHECK(same(rects("two_planes", "outside"), {{288, 0, 320, 240}}));
    CHECK(rects("two_planes", "unknown").empty());
    CHECK(same(rects("pole", "occluded"), {{92, 0, 93, 240}, {162, 0, 164, 240}, {232, 0, 235, 240}}));
    CHECK(same(rects("pole", "unknown"), {{61, 0, 92, 240}, {132, 0, 162, 240}, {203, 0, 232, 240}}));
    // Slats of 8 px every 16 px, strip 20 px: each gap is half occluded, half unknown.
    CHECK(rects("fence", "occluded").size() == 12);
    CHECK(count(expected(make_scene("fence"), "mask", "occluded")) == (11 * 4 + 8) * 240);
    // Kerb of 0.3 m at y = 2.05 m, V at y = 3 m and 1.5 m up: the road is hidden from
    // 2.05 - 0.95 * 0.3 / 1.2 = 1.8125 m on.
    CHECK(make_scene("step_kerb").closed_forms[0].rule.find("1.8125") != std::string::npos);
    CHECK(count(expected(make_scene("step_kerb"), "mask", "occluded")) > 500);
}

TEST_CASE("two planes: the hidden strip is f b (1/d0 - 1/d1) wide at any shift and phase", "[closed]") {
    const Size size{320, 24};
    double worst_px = 0;
    for (double strip = 3; strip <= 96; strip += strip < 12 ? 1 : 12)
        for (double fraction : {0.0, 0.25, 0.4, 0.75})
            for (double phase : {0.0, 0.13, 0.37, 0.62, 0.88})
                for (int side : {1, -1}) {
                    const double d0 = 4, d1 = 10, wide = strip + fraction;
                    const double b = side * wide / (320 * (1 / d0 - 1 / d1));
                    const RectPx plane =
                        side > 0 ? RectPx{-1e6, -1e6, 120 + phase, 1e6} : RectPx{200 + phase, -1e6, 1e6, 1e6};
                    const MinimalScene s = cards_before_wall("planes", size, {plane}, d0, d1, b);
                    const RecordedMasks m = masks_of(s, s.shift);
                    const double got = double(count(m.occluded)) / size.height;
                    INFO("strip " << wide << " px, side " << side << ", phase " << phase);
                    CHECK(std::fabs(got - wide) <= 0.5 + 1e-9);
                    if (fraction == 0) CHECK(got == wide);
                    CHECK(rectangles(m.occluded).size() == 1);
                    CHECK(count(m.unknown) == 0);
                    worst_px = std::max(worst_px, std::fabs(got - wide));
                }
    CHECK(worst_px > 0.2);  // the phases do matter: this test is not vacuous
}

TEST_CASE("zero shift: nothing lost, nothing unknown, no hole", "[closed]") {
    for (const std::string& name : scene_names())
        for (bool whole_rig : {false, true}) {
            const MinimalScene s = make_scene(name);
            if (whole_rig && s.rig.size() == 1) continue;
            INFO(name << (whole_rig ? ", rig" : ", self"));
            // Torn as for a large shift as well: walls must not be met either.
            Case c = lift_scene(s, moved(0, 0), whole_rig);
            for (int torn_as_shifted = 0; torn_as_shifted < 2; ++torn_as_shifted) {
                if (torn_as_shifted) c.rig = lift_scene(s, s.shift, whole_rig).rig;
                const RecordedMasks m = mask(c.rig, as_shifted(c.v), clear_m);
                CHECK(count(m.lost) == 0);
                CHECK(count(m.unknown) == 0);
                CHECK(count(m.unseen) == 0);
                const ShiftedHoles h = holes(c.rig, as_shifted(c.v));
                CHECK(count(h.hole) == 0);
            }
        }
}

TEST_CASE("a slanted road is not torn up to the horizon", "[closed]") {
    for (const char* name : {"grazing_road", "grazing_road_kerb"})
        for (const Shift& by : {moved(0, 1), moved(0, -4), moved(4, 0), moved(3, 2)}) {
            const MinimalScene s = make_scene(name, {640, 480});
            const Case c = lift_scene(s, by);
            INFO(name << " ahead " << by.translation_m.x << " left " << by.translation_m.y);
            // Where the kerb's face is thinner than a pixel the road and the pavement are torn apart, rightly.
            CHECK(tears_between_surfaces(c.rig.views[0].mesh, true) == 0);
            if (name == std::string("grazing_road")) CHECK(tears_between_surfaces(c.rig.views[0].mesh) == 0);
            const RecordedMasks m = mask(c.rig, as_shifted(c.v), clear_m);
            if (by.translation_m.y > -3) {  // farther right it stands behind the kerb's edge
                CHECK(count(m.occluded) == 0);
                CHECK(count(m.unknown) == 0);
            }
        }
    // A step that is a step is torn.
    CHECK(tears_between_surfaces(lift_scene(make_scene("box"), moved(0, 1)).rig.views[0].mesh) == 4 * 40);
}

TEST_CASE("scale: twice the depth and twice the shift give the same mask", "[closed]") {
    for (const std::string& name : scene_names()) {
        const MinimalScene s = make_scene(name);
        const View r = s.recorded(s.own), v = s.shifted(s.shift, s.own);
        const DepthMap depth = render(s.world, r).depth;
        const auto run = [&](float scale) {
            DepthMap scaled = depth;
            for (float& z : scaled.data) z *= scale;
            View r2 = r, v2 = v;
            r2.world_from_cam.translation_m *= double(scale);
            v2.world_from_cam.translation_m *= double(scale);
            LiftedRig rig;
            rig.views.push_back(
                lift_view("R", r2.intrinsics, r2.world_from_cam, scaled, v2.world_from_cam.translation_m));
            return mask(rig, as_shifted(v2), clear_m * double(scale));
        };
        const RecordedMasks one = run(1), two = run(2), eighth = run(0.125f);
        INFO(name);
        for (const RecordedMasks* other : {&two, &eighth}) {
            CHECK(differing(one.occluded, other->occluded) == 0);
            CHECK(differing(one.outside, other->outside) == 0);
            CHECK(differing(one.unknown, other->unknown) == 0);
            CHECK(differing(one.unseen, other->unseen) == 0);
        }
    }
}

TEST_CASE("the mirrored image with the opposite shift gives the mirrored mask", "[closed]") {
    for (const std::string& name : scene_names()) {
        const MinimalScene s = make_scene(name);
        // Not the default shift, which puts points onto the image's border exactly: a border pixel
        // belongs to one side only.
        const glm::dvec3 by = s.shift.translation_m * 1.01237;
        const View r = s.recorded(s.own), v = s.shifted(moved(by.x, by.y), s.own);
        const DepthMap depth = render(s.world, r).depth;
        DepthMap flipped = depth;
        for (int y = 0; y < depth.height; ++y)
            for (int x = 0; x < depth.width; ++x) flipped.at(x, y) = depth.at(depth.width - 1 - x, y);
        // In R's own frame, so that the mirror is the sign of x and nothing else.
        const Pose v_in_r = compose(inverse(r.world_from_cam), v.world_from_cam);
        const auto run = [&](const DepthMap& z, double sign) {
            View at{r.intrinsics, v_in_r};
            at.world_from_cam.translation_m.x *= sign;
            LiftedRig rig;
            rig.views.push_back(lift_view("R", r.intrinsics, Pose{}, z, at.world_from_cam.translation_m));
            return mask(rig, as_shifted(at), clear_m);
        };
        const RecordedMasks a = run(depth, 1), b = run(flipped, -1);
        INFO(name);
        // Quads are split along one diagonal whichever way the image is turned: exact but for those.
        const size_t split = differing(mirrored(a.occluded), b.occluded) + differing(mirrored(a.unknown), b.unknown);
        INFO(split << " px differ");
        const bool upright = name != "step_kerb" && name != "round_pole" && name != "rig_box" && name != "random";
        CHECK(split <= (upright ? 0 : 8));
        CHECK(differing(mirrored(a.unseen), b.unseen) == 0);
        CHECK(differing(mirrored(a.outside), b.outside) == 0);
        CHECK(count(a.lost) + count(a.unseen) > 0);
    }
}

TEST_CASE("yaw about the camera's centre changes only what is outside", "[closed]") {
    for (const char* name : {"box", "fence", "round_pole", "step_kerb", "random"}) {
        const MinimalScene s = make_scene(name);  // its camera stands on the ego's vertical axis
        Shift turned = s.shift;
        turned.yaw_rad = 0.2;
        const RecordedMasks a = masks_of(s, s.shift), b = masks_of(s, turned);
        INFO(name);
        CHECK(differing(a.occluded, b.occluded) == 0);
        CHECK(differing(a.unknown, b.unknown) == 0);
        CHECK(differing(a.unseen, b.unseen) == 0);
        CHECK(differing(a.outside, b.outside) > 1000);
        const Grid<uint8_t> truth = truth_recorded(s.world, {s.recorded(s.own)}, 0, s.shifted(turned, s.own));
        CHECK(differing(flagged(truth, VSHIFT_TRUTH_OUTSIDE), b.outside) == 0);
        // Turning on the spot hides nothing.
        const RecordedMasks spot = masks_of(s, moved(0, 0, 0, 0.2));
        CHECK(count(spot.occluded) + count(spot.unknown) + count(spot.unseen) == 0);
        CHECK(count(spot.outside) > 1000);
    }
}

TEST_CASE("unseen: where the segment leaves the frustum far from V", "[closed]") {
    for (const char* name : {"box", "two_planes", "grazing_road"})
        for (const Shift& by : {moved(0, 1), moved(0, -4), moved(-1, 2), moved(2, -3)}) {
            const MinimalScene s = make_scene(name);
            const RecordedMasks m = masks_of(s, by);
            const Mask exact = exact_unseen(s.world, {s.recorded(0)}, 0, s.shifted(by, 0), clear_m);
            const Picture picture = render(s.world, s.recorded(0));
            size_t wrong = 0, asked = 0;
            for (size_t i = 0; i < exact.size(); ++i) {
                if (m.occluded.data[i] || m.unknown.data[i] || picture.primitive.data[i] < 0) continue;
                ++asked;
                wrong += m.unseen.data[i] != exact.data[i];
            }
            INFO(name << " ahead " << by.translation_m.x << " left " << by.translation_m.y << ", " << count(exact)
                      << " unseen of " << asked);
            CHECK(wrong == 0);
        }
}

TEST_CASE("poles of 1 px are found", "[closed]") {
    const MinimalScene s = make_scene("round_pole");
    for (const Shift& by : {moved(0, 1), moved(0, -1), moved(1, 1.5)}) {
        const RecordedMasks m = masks_of(s, by);
        const View v = s.shifted(by, 0);
        const Mask truth = flagged(truth_recorded(s.world, {s.recorded(0)}, 0, v), VSHIFT_TRUTH_OCCLUDED);
        INFO("ahead " << by.translation_m.x << " left " << by.translation_m.y << ": " << count(truth)
                      << " px hidden, found " << count(m.occluded) << ", F1 " << f1(m.occluded, truth));
        CHECK(f1(m.occluded, truth) > 0.85);
        CHECK(count(m.occluded) > count(truth) * 8 / 10);
    }
}

TEST_CASE("invalid depth is unknown, and so is what lies behind it", "[closed]") {
    const MinimalScene s = make_scene("box");
    const View r = s.recorded(0), v = s.shifted(s.shift, 0);
    const DepthMap depth = render(s.world, r).depth;
    const RecordedMasks clean = mask(lift_scene(s, s.shift).rig, as_shifted(v), 0);
    const RectPx patch{60, 110, 70, 120};  // left of the box, on the wall
    for (float bad : {std::numeric_limits<float>::quiet_NaN(), 0.0f, -3.0f, -std::numeric_limits<float>::infinity()}) {
        DepthMap broken = depth;
        for (int y = 110; y < 120; ++y)
            for (int x = 60; x < 70; ++x) broken.at(x, y) = bad;
        LiftedRig rig;
        rig.views.push_back(lift_view("R", r.intrinsics, r.world_from_cam, broken, v.world_from_cam.translation_m));
        CHECK(rig.views[0].mesh.invalid_px == 100);
        const RecordedMasks m = mask(rig, as_shifted(v), 0);  // no clear ball: every crossing counts
        INFO("bad value " << bad);
        size_t wrong = 0;
        for (int y = 0; y < 240; ++y)
            for (int x = 0; x < 320; ++x) {
                // V is to the left: every segment that starts right of the patch crosses its columns.
                const bool behind = y >= 110 && y < 120 && x >= 60;
                const bool in_patch = patch.holds(x + 0.5, y + 0.5);
                const bool occluded = !in_patch && clean.occluded.at(x, y);
                const bool unknown = (behind || clean.unknown.at(x, y)) && !occluded;
                wrong += m.occluded.at(x, y) != occluded || m.unknown.at(x, y) != unknown;
                if (!in_patch) wrong += m.outside.at(x, y) != clean.outside.at(x, y);
            }
        CHECK(wrong == 0);
        const ShiftedHoles h = holes(rig, as_shifted(v));
        for (int y = 112; y < 118; ++y)
            for (int x = 94; x < 100; ++x) CHECK(h.hole.at(x, y) == 1);  // moved by 32 px
    }
}

TEST_CASE("sky is handled by direction", "[closed]") {
    const MinimalScene s = make_scene("box");
    const View r = s.recorded(0), v = s.shifted(s.shift, 0);
    DepthMap depth = render(s.world, r).depth;
    for (float& z : depth.data)
        if (z > 9) z = std::numeric_limits<float>::infinity();  // the box alone in the sky
    LiftedRig rig;
    rig.views.push_back(lift_view("R", r.intrinsics, r.world_from_cam, depth, v.world_from_cam.translation_m));
    const RecordedMasks m = mask(rig, as_shifted(v), clear_m);
    // The box moves by f b / 4 = 80 px against the sky; the sky is never out of frame.
    CHECK(same(rectangles(m.occluded), {{200, 100, 240, 140}}));
    CHECK(same(rectangles(m.unknown), {{160, 100, 200, 140}}));
    CHECK(count(m.outside) == 0);
    const ShiftedHoles h = holes(rig, as_shifted(v));
    CHECK(same(rectangles(h.hole), {{120, 100, 200, 140}}));
    DepthMap all_sky(320, 240, std::numeric_limits<float>::infinity());
    LiftedRig empty;
    empty.views.push_back(lift_view("R", r.intrinsics, r.world_from_cam, all_sky, v.world_from_cam.translation_m));
    const RecordedMasks nothing_there = mask(empty, as_shifted(v), clear_m);
    CHECK(count(nothing_there.lost) + count(nothing_there.unknown) == 0);
}

TEST_CASE("depths that are nothing or everything do not break a mask", "[closed]") {
    const MinimalScene s = make_scene("box", {64, 48});
    const View r = s.recorded(0), v = s.shifted(s.shift, 0);
    const float nan = std::numeric_limits<float>::quiet_NaN();
    for (float value : {nan, 0.0f, -1.0f, 1e-30f, 1e-6f, 1e6f, 3e38f}) {
        LiftedRig rig;
        rig.views.push_back(
            lift_view("R", r.intrinsics, r.world_from_cam, DepthMap(64, 48, value), v.world_from_cam.translation_m));
        const RecordedMasks m = mask(rig, as_shifted(v), clear_m);
        INFO("depth " << value);
        if (!(value > 0)) CHECK(count(m.unknown) == 64 * 48);
        if (!(value > 0)) CHECK(count(m.lost) == 0);
        if (value == 1e6f) CHECK(count(m.lost) + count(m.unknown) == 0);
        holes(rig, as_shifted(v));
    }
}

TEST_CASE("the shifted camera stands where the convention says", "[closed]") {
    for (const std::string& name : scene_names()) {
        const MinimalScene s = make_scene(name);
        for (const Shift& by : {s.shift, moved(0.3, -0.7, 0.1, 0.4), moved(0, 0, 0, -2)})
            for (int i = 0; i < int(s.rig.size()); ++i) {
                const Pose got = compose(s.frames.back(), shifted_ego_from_cam(s.rig[size_t(i)].ego_from_cam, by));
                const Pose want = s.shifted(by, i, int(s.frames.size()) - 1).world_from_cam;
                CHECK(glm::distance(got.translation_m, want.translation_m) < 1e-12);
                for (int axis = 0; axis < 3; ++axis)
                    CHECK(glm::distance(got.rotation[axis], want.rotation[axis]) < 1e-12);
            }
    }
}
