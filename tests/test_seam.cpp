// SPDX-License-Identifier: Apache-2.0
// Seams in closed form (painted_support.h).
#include <tbb/global_control.h>

#include "tests/catch.h"
#include "tests/painted_support.h"

using namespace vshift;
using namespace vshift::minimal;
using namespace vshift::painted;

TEST_CASE("the seam fills exactly what a neighbour saw", "[seam]") {
    const World world = card_before_wall();
    const View own = camera_at({0, 0, 0}), left = camera_at({0, 1.5, 0}), right = camera_at({0, -1.5, 0});
    for (const double y_m : {1.0, -1.0, 0.4}) {
        const ShiftedCamera v = moved_camera({own, {}, {}, {}}, {0, y_m, 0});
        const View shifted{v.intrinsics, v.world_from_cam};
        const Rig rig(
            {shoot(world, left, affine_paint), shoot(world, own, affine_paint), shoot(world, right, affine_paint)},
            v.world_from_cam.translation_m);
        const ShiftedSeam got = seam_shifted(rig.cameras, 1, v, {});
        const Shot truth = shoot(world, shifted, affine_paint);
        const Grid<uint8_t> klass = truth_shifted(world, {left, own, right}, 1, shifted);
        size_t filled = 0, not_filled = 0, wrongly = 0, farther_one = 0;
        double worst = 0;
        for (int y = 0; y < 240; ++y)
            for (int x = 0; x < 320; ++x) {
                const int source = got.seam.source.at(x, y);
                const uint8_t c = klass.at(x, y);
                const bool by_neighbor = c == VSHIFT_NEIGHBOUR_OCCLUDED || c == VSHIFT_NEIGHBOUR_OUTSIDE;
                const bool is_filled = source == 0 || source == 2;
                filled += is_filled;
                not_filled += by_neighbor && !is_filled;
                wrongly += is_filled && c >= VSHIFT_NOBODY_OCCLUDED;
                if (!is_filled) continue;
                worst = std::max(worst, worst_difference(got.seam.color.at(x, y), truth.color.at(x, y)));
                // Both sides saw it: the one on V's side looks more nearly the same way.
                const dvec3 p = v.world_from_cam.point(ray(v.intrinsics, {x + 0.5, y + 0.5}) * wall_m);
                const auto sees = [&](int i) {
                    const auto u = project(own.intrinsics, inverse(rig.surfaces[size_t(i)].world_from_cam).point(p));
                    return u && in_image(own.intrinsics, *u) &&
                           rig.shots[size_t(i)].primitive.at(int(u->x), int(u->y)) == wall;
                };
                farther_one += source == (y_m > 0 ? 2 : 0) && sees(y_m > 0 ? 0 : 2);
            }
        INFO("shift " << y_m << ": " << filled << " filled, " << not_filled << " missed, " << wrongly
                      << " that nobody saw, " << farther_one << " from the farther camera, worst color " << worst);
        CHECK(filled > 2000);
        CHECK(not_filled <= 240);  // edge bands: half a pixel round the card and at the frame
        CHECK(wrongly <= 40);
        CHECK(farther_one <= 80);
        CHECK(worst < 1e-3);
    }
}

TEST_CASE("a mixed sample gives way to a clean one, and stands where there is none", "[seam]") {
    // The own picture is half card in every wall pixel beside the card; the neighbour's is not.
    const World world = card_before_wall();
    const View own = camera_at({0, 0, 0}), left = camera_at({0, 1.5, 0});
    const Paint plain = [](int which, const dvec3&) { return which == card ? glm::vec3(1) : glm::vec3(0.25f); };
    Shot mixed = shoot(world, own, plain);
    mix_beside_card(mixed);
    const ShiftedCamera v = moved_camera(mixed, {0, 0.3, 0});
    const Rig alone({mixed}, v.world_from_cam.translation_m);
    const Rig both({mixed, shoot(world, left, plain)}, v.world_from_cam.translation_m);
    Reprojection shown;
    REQUIRE(reproject(alone.surfaces[0], v, nullptr, shown));
    const Warped dropped = warp(shown, sampler_of(alone, 0, v), EdgeBand::drop);
    const Warped kept = warp(shown, sampler_of(alone, 0, v), EdgeBand::keep);
    SeamOptions options;
    options.depth = true;
    const ShiftedSeam one = seam_shifted(alone.cameras, 0, v, options), two = seam_shifted(both.cameras, 0, v, options);
    size_t edges = 0, stands = 0, gave_way = 0, wrong = 0, depth_off = 0, nothing = 0;
    for (size_t i = 0; i < kept.color.size(); ++i) {
        const double expected = shown.inverse_depth.data[i] > 0.15f ? 1 / card_m : 1 / wall_m;
        if (two.seam.source.data[i] < 0) {
            ++nothing;
            depth_off += !std::isnan(two.inverse_depth.data[i]);
        } else {
            const bool from_wall = two.seam.color.data[i].x < 0.9f;
            depth_off += std::fabs(double(two.inverse_depth.data[i]) - (from_wall ? 1 / wall_m : expected)) > 1e-4;
        }
        if (kept.missing.data[i] || !dropped.missing.data[i]) continue;
        ++edges;
        stands += one.seam.source.data[i] == 0 && one.seam.color.data[i] == kept.color.data[i];
        gave_way += two.seam.source.data[i] == 1;
        wrong += two.seam.source.data[i] == 1 && two.seam.color.data[i] != glm::vec3(0.25f);
    }
    INFO(edges << " edge px, " << gave_way << " gave way, " << nothing << " px that nobody saw");
    CHECK(edges >= 30);
    CHECK(stands == edges);
    CHECK(gave_way == edges);
    CHECK(wrong == 0);
    CHECK(depth_off == 0);
}

TEST_CASE("nothing is pasted behind what the rig saw", "[seam]") {
    // The neighbour fired before a board came: it shows the wall where the own camera later saw the board. A second
    // card nearer by opens a hole in V right before that board, wider than what it hid of it.
    const Primitive board = upright(7, 0, 0, 1.2, 1.2);
    World before = card_before_wall(), now = before;
    now.push_back(board);
    const View own = camera_at({0, 0, 0}), left = camera_at({0, 2.5, 0});
    const ShiftedCamera v = moved_camera({own, {}, {}, {}}, {0, 2, 0});
    const Rig with({shoot(now, own, affine_paint), shoot(before, left, affine_paint)}, v.world_from_cam.translation_m);
    const Rig without({shoot(before, own, affine_paint), shoot(before, left, affine_paint)},
                      v.world_from_cam.translation_m);
    const ShiftedSeam got = seam_shifted(with.cameras, 0, v, {}), other = seam_shifted(without.cameras, 0, v, {});
    size_t hidden_holes = 0, pasted = 0, pasted_without = 0;
    for (size_t i = 0; i < got.own.sight.size(); ++i) {
        const bool board_behind_wall =
            got.own.sight.data[i] == Sight::behind_wall && std::fabs(got.own.inverse_depth.data[i] - 1.0f / 7) < 1e-3f;
        if (!board_behind_wall) continue;
        ++hidden_holes;
        pasted += got.seam.source.data[i] == 1;
        pasted_without += other.seam.source.data[i] == 1;
    }
    INFO(hidden_holes << " holes before the board, " << pasted << " pasted, " << pasted_without << " without it");
    CHECK(hidden_holes > 300);
    CHECK(pasted == 0);
    CHECK(pasted_without > 100);
}

TEST_CASE("what stands outside the own frame hides what the own camera saw", "[seam]") {
    // A board 2 m before V, beside the own camera's frame: that saw the wall behind it, and the neighbour the board.
    constexpr double board_m = 2;
    World with_board = card_before_wall();
    with_board.push_back(upright(board_m, 2, 0, 0.3, 0.3));
    const View own = camera_at({0, 0, 0}), left = camera_at({0, 2.4, 0});
    const ShiftedCamera v = moved_camera({own, {}, {}, {}}, {0, 2, 0});
    const Paint paint = [](int primitive, const dvec3& p) {
        return primitive == 2 ? glm::vec3(0.1f, 0.2f, 0.9f) : affine_paint(primitive, p);
    };
    const auto on_board = [&](const ShiftedCamera& camera, double depth_m, double centre_y_m, int x, int y) {
        const dvec3 p = camera.world_from_cam.point(ray(camera.intrinsics, {x + 0.5, y + 0.5}) * depth_m);
        return std::fabs(p.y - centre_y_m) < 0.29 && std::fabs(p.z) < 0.29;  // a pixel within its border
    };
    const Rig rig({shoot(with_board, own, paint), shoot(with_board, left, paint)}, v.world_from_cam.translation_m);
    const ShiftedSeam got = seam_shifted(rig.cameras, 0, v, {});
    size_t board = 0, own_behind = 0, wrong = 0;
    for (int y = 0; y < 240; ++y)
        for (int x = 0; x < 320; ++x) {
            if (!on_board(v, board_m, 2, x, y)) continue;
            ++board;
            own_behind += !got.missing.at(x, y);
            wrong +=
                got.seam.source.at(x, y) != 1 || worst_difference(got.seam.color.at(x, y), {0.1f, 0.2f, 0.9f}) > 1e-5;
        }
    INFO(board << " pixels of the board, the own camera saw " << own_behind << " behind it, " << wrong << " wrong");
    CHECK(board > 5000);
    CHECK(own_behind > 5000);
    CHECK(wrong == 0);

    // Above the floor nothing is lost, and nothing else is told.
    Reprojection full;
    REQUIRE(reproject(rig.surfaces[1], v, nullptr, full));
    const Reprojection& some = got.neighbors[0];
    size_t above = 0, differ = 0;
    for (int y = 0; y < 240; ++y)
        for (int x = 0; x < 320; ++x) {
            const size_t at = size_t(y) * 320 + size_t(x);
            const float floor = got.floor.data[at], q = full.inverse_depth.data[at];
            const bool asked = q > floor || (floor == 0 && full.sight.data[at] != Sight::none);
            above += asked && floor > 0;
            if (!some.holds(x, y))
                differ += asked;
            else if (asked)
                differ += some.inverse_depth.data[at] != q || some.sight.data[at] != full.sight.data[at] ||
                          some.source_px.data[at] != full.source_px.data[at];
            else if (floor > 0)
                differ += some.inverse_depth.data[at] != 0 || some.sight.data[at] != Sight::none;
        }
    CHECK(above > 5000);
    CHECK(differ == 0);

    // A board that only the neighbour saw, gone when the own camera looked at that place: the own camera is believed.
    World gone = card_before_wall();
    gone.push_back(upright(5, 1.7, 0, 0.3, 0.3));
    const Rig later({shoot(card_before_wall(), own, paint), shoot(gone, left, paint)}, v.world_from_cam.translation_m);
    const ShiftedSeam now = seam_shifted(later.cameras, 0, v, {});
    size_t believed = 0, other = 0;
    for (int y = 0; y < 240; ++y)
        for (int x = 0; x < 320; ++x)
            if (on_board(v, 5, 1.7, x, y) && !now.missing.at(x, y)) {
                ++believed;
                other += now.seam.source.at(x, y) != 0;
            }
    CHECK(believed > 500);
    CHECK(other == 0);
}

TEST_CASE("training pairs: a neighbour's pixels in M are what was recorded", "[seam]") {
    const World world = card_before_wall();
    const View own = camera_at({0, 0, 0}), left = camera_at({0, 1.5, 0}), right = camera_at({0, -1.5, 0});
    const Rig rig(
        {shoot(world, own, affine_paint), shoot(world, left, affine_paint), shoot(world, right, affine_paint)},
        own.world_from_cam.translation_m);
    const ColorImage& recorded = rig.shots[0].color;
    Mask lost(320, 240, 0);  // a strip at the frame and one across the card
    for (int y = 0; y < 240; ++y)
        for (int x = 0; x < 320; ++x) lost.at(x, y) = x < 32 || (x > 120 && x < 200);
    const Seam got = seam_recorded(rig.cameras, 0, lost, {});
    size_t filled = 0, empty = 0, outside_m = 0;
    double worst = 0;
    for (size_t i = 0; i < lost.size(); ++i) {
        if (!lost.data[i]) {
            outside_m += got.source.data[i] != 0 || got.color.data[i] != recorded.data[i];
            continue;
        }
        if (got.source.data[i] < 0) {
            ++empty;
            continue;
        }
        ++filled;
        worst = std::max(worst, worst_difference(got.color.data[i], recorded.data[i]));
    }
    CHECK(outside_m == 0);
    CHECK(filled > 25000);
    CHECK(worst < 1e-3);
    // The strip at the left border: 1.5 m at 10 m are 48 px, so only the left camera has it, the right one has not.
    for (int y = 0; y < 240; y += 13)
        for (int x = 1; x < 31; x += 3) CHECK(got.source.at(x, y) == 1);
}

TEST_CASE("each camera is where it was when it fired", "[seam]") {
    // The left camera fired 0.1 s later: the ego had moved 1 m ahead. With its own pose the paint fits, with the
    // frame's pose it is off.
    const World world = card_before_wall();
    const View own = camera_at({0, 0, 0});
    const Shot late = shoot(world, camera_at({1, 1.5, 0}), affine_paint);
    Shot misplaced = late;
    misplaced.view = camera_at({0, 1.5, 0});
    const ShiftedCamera v = moved_camera({own, {}, {}, {}}, {0, 1, 0});
    const Shot truth = shoot(world, {v.intrinsics, v.world_from_cam}, affine_paint);
    const auto worst = [&](const Shot& neighbor) {
        const Rig rig({shoot(world, own, affine_paint), neighbor}, v.world_from_cam.translation_m);
        const Seam got = seam_shifted(rig.cameras, 0, v, {1, EdgeBand::drop}).seam;
        double most = 0;
        size_t filled = 0;
        for (size_t i = 0; i < got.source.size(); ++i)
            if (got.source.data[i] == 1) {
                ++filled;
                most = std::max(most, worst_difference(got.color.data[i], truth.color.data[i]));
            }
        CHECK(filled > 2000);
        return most;
    };
    CHECK(worst(late) < 1e-3);
    CHECK(worst(misplaced) > 5e-3);
}

TEST_CASE("exposure match finds a known gain", "[seam]") {
    const World world = card_before_wall();
    const View own = camera_at({0, 0, 0}), left = camera_at({0, 1.5, 0});
    Shot darker = shoot(world, left, affine_paint);
    const glm::vec3 gain(0.5f, 0.7f, 0.6f);
    for (glm::vec3& c : darker.color.data) c *= gain;
    const Rig rig({shoot(world, own, affine_paint), darker}, own.world_from_cam.translation_m);
    const glm::vec3 found = fitted_gain(rig.cameras[0], rig.cameras[1], same_surface_share, true);
    for (int c = 0; c < 3; ++c) CHECK(found[c] * gain[c] == Approx(1).margin(1e-3));
    const glm::vec3 one = fitted_gain(rig.cameras[0], rig.cameras[1], same_surface_share, false);
    CHECK(one.x == Approx(std::pow(0.5 * 0.7 * 0.6, -1.0 / 3)).margin(2e-3));
    CHECK((one.x == one.y && one.y == one.z));
    const Rig apart({shoot(world, own, affine_paint), shoot(world, camera_at({0, 60, 0}), affine_paint)},
                    own.world_from_cam.translation_m);
    CHECK(fitted_gain(apart.cameras[0], apart.cameras[1], same_surface_share, true) == glm::vec3(1));
}

TEST_CASE("one thread or two, the same bytes", "[raster][seam]") {
    const MinimalScene s = make_scene("random");
    const View v = s.shifted(moved(0.5, -2, 0.1), s.own);
    std::vector<ShiftedSeam> results;
    for (const size_t threads : {1, 2}) {
        const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, threads);
        std::vector<Shot> shots;
        for (int i = 0; i < int(s.rig.size()); ++i)
            shots.push_back(
                shoot(s.world, s.recorded(i), [](int, const dvec3& p) { return glm::vec3(glm::fract(p)); }));
        const Rig rig(std::move(shots), v.world_from_cam.translation_m);
        results.push_back(seam_shifted(rig.cameras, s.own, as_shifted(v), {}));
    }
    CHECK(same_bytes(results[0].seam.color, results[1].seam.color));
    CHECK(results[0].seam.source.data == results[1].seam.source.data);
    CHECK(results[0].own.inverse_depth.data == results[1].own.inverse_depth.data);
}
