// SPDX-License-Identifier: Apache-2.0
// Conditions, degradations and the arms of the ablation in closed form (painted_support.h).
#include "tests/catch.h"
#include "tests/painted_support.h"

using namespace vshift;
using namespace vshift::minimal;
using namespace vshift::painted;

TEST_CASE("shares of a condition add up to 1 at any stride", "[condition]") {
    Seam seam{ColorImage(50, 37, glm::vec3(0.25f)), Grid<int16_t>(50, 37, 0)};
    for (int y = 0; y < 37; ++y)
        for (int x = 0; x < 50; ++x) seam.source.at(x, y) = int16_t((x * 7 + y * 3) % 5 < 3 ? 0 : x % 2 ? 2 : -1);
    for (const int stride : {1, 2, 8, 16, 64}) {
        const Condition c = condition_of(seam, 0, stride);
        CHECK(c.color.width == (50 + stride - 1) / stride);
        double own = 0;
        for (int y = 0; y < c.own.height; ++y)
            for (int x = 0; x < c.own.width; ++x) {
                CHECK(c.own.at(x, y) + c.neighbor.at(x, y) + c.hole.at(x, y) == Approx(1).margin(1e-6));
                CHECK(c.color.at(x, y).y == Approx(0.25).margin(1e-6));
                own += double(c.own.at(x, y)) * std::min(stride, 50 - x * stride) * std::min(stride, 37 - y * stride);
            }
        CHECK(own == Approx(std::count(seam.source.data.begin(), seam.source.data.end(), 0)).margin(1e-3));
    }
}

TEST_CASE("errors have the size that was asked for", "[degrade]") {
    const Degradations none;
    Grid<float> w(320, 200);
    for (int y = 0; y < 200; ++y)
        for (int x = 0; x < 320; ++x) w.at(x, y) = y < 20 ? 0.0f : x < 160 ? 0.1f : 0.02f + 1e-4f * float(y);
    w.at(5, 50) = std::numeric_limits<float>::quiet_NaN();
    const Grid<float> same = degraded_inverse_depth(none, "A", w);
    CHECK(!std::memcmp(same.data.data(), w.data.data(), w.size() * 4));
    CHECK(degraded_gain(none, "A") == glm::vec3(1));
    const Pose pose{glm::dmat3(1), {1, 2, 3}};
    CHECK(degraded_pose(none, "A", pose).translation_m == pose.translation_m);

    bool both_signs[2] = {false, false};
    for (int seed = 0; seed < 16; ++seed) {
        Degradations d;
        d.seed = seed;
        d.exposure_stops = 0.5, d.white_balance_stops = 0.2, d.pose_m = 0.05, d.pose_deg = 0.3;
        const glm::vec3 gain = degraded_gain(d, "A");
        CHECK(std::fabs(std::log2(gain.y)) == Approx(0.5).margin(1e-5));
        CHECK(std::fabs(std::log2(gain.x / gain.z)) == Approx(0.2).margin(1e-5));
        both_signs[gain.y > 1] = true;
        const Pose bent = degraded_pose(d, "A", pose);
        CHECK(glm::length(bent.translation_m - pose.translation_m) == Approx(0.05));
        const glm::dmat3& r = bent.rotation;
        CHECK(std::acos((r[0][0] + r[1][1] + r[2][2] - 1) / 2) * degrees_per_radian == Approx(0.3).margin(1e-6));

        Degradations depth;
        depth.seed = seed;
        depth.depth_field = 0.04;
        const Grid<float> field = degraded_inverse_depth(depth, "A", w);
        double squares = 0;
        size_t n = 0;
        for (size_t i = 0; i < w.size(); ++i) {
            if (!(w.data[i] > 0)) {
                CHECK(!(field.data[i] > 0));
                continue;
            }
            squares += std::pow(std::log(double(w.data[i]) / double(field.data[i])), 2);
            ++n;
        }
        CHECK(std::sqrt(squares / double(n)) == Approx(0.04).epsilon(0.1));  // 10 % of the image is sky
        depth = {};
        depth.seed = seed;
        depth.depth_scale = 0.1;
        const Grid<float> scaled = degraded_inverse_depth(depth, "A", w);
        CHECK(std::fabs(std::log(scaled.at(3, 30) / w.at(3, 30))) == Approx(0.1).margin(1e-4));
        depth = {};
        depth.seed = seed;
        depth.depth_bias_m = 0.7;
        const Grid<float> biased = degraded_inverse_depth(depth, "A", w);
        CHECK(std::fabs(1 / biased.at(3, 30) - 1 / w.at(3, 30)) == Approx(0.7).margin(1e-3));
        CHECK(degraded_delay_s(d, "A") == 0);
        d.time_s = 0.02;
        CHECK(std::fabs(degraded_delay_s(d, "A")) == Approx(0.02));
    }
    CHECK((both_signs[0] && both_signs[1]));
    CHECK(degraded_gain({0.5, 0.2}, "A") == degraded_gain({0.5, 0.2}, "A"));
    // A step blurred by sigma: 16 % and 84 % of it lie two sigma apart.
    Degradations blur;
    blur.depth_blur_px = 3;
    Grid<float> step(200, 8);
    for (int y = 0; y < 8; ++y)
        for (int x = 0; x < 200; ++x) step.at(x, y) = x < 100 ? 0.1f : 0.2f;
    const Grid<float> soft = degraded_inverse_depth(blur, "A", step);
    int between = 0;
    for (int x = 0; x < 200; ++x) between += soft.at(x, 4) > 0.1159f && soft.at(x, 4) < 0.1841f;
    CHECK(std::abs(between - 6) <= 1);
}

TEST_CASE("a displaced neighbour is displaced by as much as it was told", "[degrade]") {
    // A neighbour that stands right beside is moved sideways by 0.1 m: on the wall that is 320 * 0.1 / 10 = 3.2 px.
    const World world = {upright(wall_m, 0, 0, endless, endless)};
    const View own = camera_at({0, 0, 0}), left = camera_at({0, 1.5, 0});
    const Shot shot = shoot(world, left, affine_paint);
    const SurfaceView surface =
        surface_view(left.intrinsics, left.world_from_cam, shot.depth, own.world_from_cam.translation_m);
    const dvec3 from(0, 0, 0), along = own.world_from_cam.direction(ray(own.intrinsics, {60.5, 100.5}));
    BentView bent{left.intrinsics, left.world_from_cam, surface.inverse_depth};
    const glm::vec2 exact = bent_source_px(bent, from, along, wall_m);
    const auto want = project(left.intrinsics, inverse(left.world_from_cam).point(from + along * wall_m));
    CHECK(glm::length(exact - glm::vec2(*want)) < 1e-3f);
    bent.world_from_cam.translation_m.y += 0.1;
    CHECK(bent_source_px(bent, from, along, wall_m).x - exact.x == Approx(3.2).margin(1e-3));
    // Depth too large by 10 %: the wall seems to stand at 11 m, so the ray meets it elsewhere.
    bent = {left.intrinsics, left.world_from_cam, surface.inverse_depth};
    for (float& w : bent.inverse_depth.data) w /= 1.1f;
    CHECK(bent_source_px(bent, from, along, wall_m).x - exact.x ==
          Approx(320 * 1.5 * (1 / 11.0 - 1 / 10.0)).margin(1e-2));
    // The seam's colours follow, its sources do not.
    Rig rig({shoot(world, own, affine_paint), shot}, own.world_from_cam.translation_m);
    const Mask lost(320, 240, 1);
    const Seam before = seam_recorded(rig.cameras, 0, lost, {});
    rig.cameras[1].bent = &bent;
    const Seam after = seam_recorded(rig.cameras, 0, lost, {});
    CHECK(before.source.data == after.source.data);
    CHECK(!same_bytes(before.color, after.color));
}

TEST_CASE("arms of the ablation", "[condition]") {
    const World world = card_before_wall();
    const View own = camera_at({0, 0, 0}), left = camera_at({0, 1.5, 0});
    const ShiftedCamera v = moved_camera({own, {}, {}, {}}, {0, 1, 0});
    const Rig rig({shoot(world, own, affine_paint), shoot(world, left, affine_paint)}, v.world_from_cam.translation_m);
    const ShiftedSeam shifted = seam_shifted(rig.cameras, 0, v, {});
    const Shot truth = shoot(world, {v.intrinsics, v.world_from_cam}, affine_paint);

    // Word by word: the recorded colours stand at the same coordinates, under V's holes.
    const Seam literal = literal_seam(rig.shots[0].color, shifted, 0);
    CHECK(literal.source.data == shifted.seam.source.data);
    for (size_t i = 0; i < literal.source.size(); ++i)
        if (literal.source.data[i] == 0) REQUIRE(literal.color.data[i] == rig.shots[0].color.data[i]);

    // R -> V -> R: affine paint survives, and little more is lost.
    const Warped warped = warp(shifted.own, sampler_of(rig, 0, v), EdgeBand::drop);
    ColorImage twice = rig.shots[0].color;
    Mask lost(320, 240, 0);
    warp_twice(rig.surfaces[0], v, warped, shifted.own, same_surface_share, twice, lost);
    double worst = 0;
    for (size_t i = 0; i < lost.size(); ++i)
        if (!lost.data[i]) worst = std::max(worst, worst_difference(twice.data[i], rig.shots[0].color.data[i]));
    CHECK(worst < 2e-3);
    const size_t out_of_frame = 32 * 240, behind_card = 40 * 40;
    CHECK(count(lost) >= out_of_frame + behind_card);
    CHECK(count(lost) < out_of_frame + behind_card + 400);

    // Points on the nearest pixel: right but for the rounding, half a pixel of paint.
    const Seam splat = splatted_seam(rig.cameras, 0, v);
    size_t own_px = 0, wrong = 0;
    for (size_t i = 0; i < splat.source.size(); ++i) {
        if (splat.source.data[i] != 0) continue;
        ++own_px;
        wrong += worst_difference(splat.color.data[i], truth.color.data[i]) > 2e-3;
    }
    CHECK(own_px > 60000);
    CHECK(wrong < 300);
}
