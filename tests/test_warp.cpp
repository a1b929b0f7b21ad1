// SPDX-License-Identifier: Apache-2.0
// The rasteriser against rays, and warps in closed form (painted_support.h).
#include <glm/gtc/quaternion.hpp>
#include <random>

#include "embree_core/raster_map.h"
#include "tests/catch.h"
#include "tests/painted_support.h"

using namespace vshift;
using namespace vshift::minimal;
using namespace vshift::painted;

TEST_CASE("the rasteriser sees what Embree casts", "[raster]") {
    const Shift shifts[] = {moved(0, 0),   moved(0, 1),         moved(0, -1.37),
                            moved(1.5, 0), moved(-2, 0.5, 0.3), moved(0.4, -2, 0.2, 0.2)};
    for (const std::string& name : scene_names())
        for (const Shift& by : shifts)
            for (int camera = 0; camera < 3; ++camera) {
                const MinimalScene s = make_scene(name);
                if (camera >= int(s.rig.size())) break;
                const View r = s.recorded(camera), v = s.shifted(by, s.own);
                const DepthMap depth = render(s.world, r).depth;
                const glm::dvec3 centre = v.world_from_cam.translation_m;
                Reprojection drawn, cast_by_rays;
                if (!reproject(surface_view(r.intrinsics, r.world_from_cam, depth, centre), as_shifted(v), nullptr,
                               drawn))
                    drawn.sight = Grid<Sight>(v.intrinsics.width, v.intrinsics.height, Sight::none);
                cast(lift_view("", r.intrinsics, r.world_from_cam, depth, centre), as_shifted(v), cast_by_rays);
                size_t seen_differs = 0, depth_differs = 0, place_differs = 0, off_borders = 0;
                const Mask holes_by_rays = holes_of(cast_by_rays);
                for (size_t i = 0; i < drawn.sight.size(); ++i) {
                    const bool a = is_seen(drawn.sight.data[i]), b = is_seen(cast_by_rays.sight.data[i]);
                    seen_differs += a != b;
                    off_borders += a != b && !at_border(holes_by_rays, int(i % 320), int(i / 320));
                    if (!a || !b) continue;
                    const float q = drawn.inverse_depth.data[i], p = cast_by_rays.inverse_depth.data[i];
                    depth_differs += !(std::fabs(q - p) <= 1e-3f * p);
                    place_differs += glm::length(drawn.source_px.data[i] - cast_by_rays.source_px.data[i]) > 1.0f / 64;
                }
                INFO(name << " camera " << camera << " shift " << by.translation_m.x << "," << by.translation_m.y << ","
                          << by.translation_m.z << ": " << seen_differs << " px differ in being seen, " << depth_differs
                          << " in depth, " << place_differs << " in place");
                if (std::getenv("VSHIFT_TEST_PRINT"))
                    std::printf("raster %s %d %g,%g,%g: %zu seen, %zu depth, %zu place\n", name.c_str(), camera,
                                by.translation_m.x, by.translation_m.y, by.translation_m.z, seen_differs, depth_differs,
                                place_differs);
                // Edges that fall on pixel centres, as these scenes like to have them, may go either way.
                CHECK(off_borders == 0);
                CHECK(seen_differs * 250 <= drawn.sight.size());
                CHECK(depth_differs * 1000 <= drawn.sight.size());
                CHECK(place_differs * 500 <= drawn.sight.size());
            }
}

TEST_CASE("holes of two planes: a strip f b (1/near - 1/far) wide", "[raster]") {
    for (const double left_m : {1.0, -1.0, 0.5, -2.0}) {
        const MinimalScene s = cards_before_wall("cards", {}, {{100, 60, 180, 160}}, 4, 10, left_m);
        const View r = s.recorded(0), v = s.shifted(s.shift, 0);
        Reprojection shown;
        REQUIRE(reproject(
            surface_view(r.intrinsics, r.world_from_cam, render(s.world, r).depth, v.world_from_cam.translation_m),
            as_shifted(v), nullptr, shown));
        const Mask hole = holes_of(shown);
        const int strip = int(std::lround(320 * std::fabs(left_m) * (1.0 / 4 - 1.0 / 10)));
        const int border = int(std::lround(320 * std::fabs(left_m) / 10));
        int in_row = 0, above = 0;
        for (int x = 0; x < 320; ++x) in_row += hole.at(x, 100), above += hole.at(x, 20);
        CHECK(above == border);
        CHECK(in_row == border + strip);  // wider than the card: its hidden space is no surface
    }
}

TEST_CASE("no shift gives the recorded picture to the bit", "[warp][seam]") {
    for (const std::string& name : scene_names()) {
        const MinimalScene s = make_scene(name);
        std::vector<Shot> shots;
        for (int i = 0; i < int(s.rig.size()); ++i)
            shots.push_back(
                shoot(s.world, s.recorded(i), [](int, const dvec3& p) { return glm::vec3(glm::fract(p * 1.37)); }));
        const View own = s.recorded(s.own);
        const Rig rig(std::move(shots), own.world_from_cam.translation_m);
        const ShiftedCamera v = as_shifted(own);
        const ShiftedSeam got = seam_shifted(rig.cameras, s.own, v, {});
        INFO(name);
        CHECK(same_bytes(got.seam.color, rig.shots[size_t(s.own)].color));
        CHECK(std::all_of(got.seam.source.data.begin(), got.seam.source.data.end(), [&](int i) { return i == s.own; }));
        const Seam recorded =
            seam_recorded(rig.cameras, s.own, Mask(own.intrinsics.width, own.intrinsics.height, 0), {});
        CHECK(same_bytes(recorded.color, rig.shots[size_t(s.own)].color));
    }
}

TEST_CASE("affine paint comes back, and the card leaves no trace on the wall", "[warp]") {
    const World world = card_before_wall();
    for (const dvec3 by : {dvec3(0, 1, 0), dvec3(0, -0.73, 0), dvec3(0, 0.31, 0.27), dvec3(1.1, 0.2, 0)}) {
        const View own = camera_at({0, 0, 0});
        const ShiftedCamera v = moved_camera({own, {}, {}, {}}, by);
        const Rig rig({shoot(world, own, affine_paint)}, v.world_from_cam.translation_m);
        Reprojection shown;
        REQUIRE(reproject(rig.surfaces[0], v, nullptr, shown));
        const Shot truth = shoot(world, {v.intrinsics, v.world_from_cam}, affine_paint);
        for (const EdgeBand edge : {EdgeBand::drop, EdgeBand::keep}) {
            const Warped got = warp(shown, sampler_of(rig, 0, v), edge);
            double worst = 0;
            size_t colored = 0, dropped = 0;
            for (size_t i = 0; i < got.color.size(); ++i) {
                dropped += got.missing.data[i] && is_seen(shown.sight.data[i]);
                if (got.missing.data[i]) continue;
                ++colored;
                const bool is_card = shown.inverse_depth.data[i] > 0.15f;
                if (is_card != (truth.primitive.data[i] == card)) continue;  // the last half pixel of a silhouette
                worst = std::max(worst, worst_difference(got.color.data[i], truth.color.data[i]));
            }
            INFO("moved by " << by.x << "," << by.y << "," << by.z << ": " << colored << " px, " << dropped
                             << " dropped");
            CHECK(worst < 1e-3);
            CHECK(colored > 40000);
            CHECK((edge == EdgeBand::drop || dropped == 0));
            CHECK(dropped < 200);  // at most half a pixel round a card of 40x40
        }
    }
}

TEST_CASE("a road seen from the side is sheared, not blurred", "[warp]") {
    // Ground h below both cameras, V beside R by h: row j of the ground moves by a whole number of pixels, j + 1/2 - cy
    // times f b / (f h) = 1. So V's pixels are R's, though their footprints on R are more than two pixels wide.
    constexpr double h_m = 1.5;
    Primitive ground;
    ground.world_from_local.rotation = glm::dmat3(1);
    ground.world_from_local.translation_m = {0, 0, -h_m};
    ground.half_m = {endless, endless, 0};
    const View own = camera_at({0, 0, 0}, 320, 241);  // the horizon runs through pixel centres
    std::mt19937 random(5);
    Shot shot = shoot({ground}, own, [&](int, const dvec3&) { return glm::vec3(float(random() % 1000) / 1000); });
    const ShiftedCamera v = moved_camera(shot, {0, h_m, 0});
    const Rig rig({shot}, v.world_from_cam.translation_m);
    Reprojection shown;
    REQUIRE(reproject(rig.surfaces[0], v, nullptr, shown));
    const Warped got = warp(shown, sampler_of(rig, 0, v), EdgeBand::keep);
    size_t compared = 0;
    double worst = 0;
    for (int y = 123; y < 240; ++y)
        for (int x = 0; x < 320; ++x) {
            const int from = x - (y - 120);
            if (from < 1 || from > 318) continue;
            REQUIRE(!got.missing.at(x, y));
            ++compared;
            worst = std::max(worst, worst_difference(got.color.at(x, y), shot.color.at(from, y)));
        }
    CHECK(compared > 20000);
    CHECK(worst < 1e-5);
}

TEST_CASE("what a box reaches, also where it stands on both sides of V's plane", "[raster]") {
    // Random cameras and boxes of (u, v, 1/z); whatever the kernels' floats take as in front of V lies in the reach.
    std::mt19937 random(11);
    const auto between = [&](double low, double high) {
        return std::uniform_real_distribution<double>(low, high)(random);
    };
    const Intrinsics k = camera_at({0, 0, 0}).intrinsics;
    size_t cut = 0, narrower = 0, inside = 0, outside = 0;
    for (int round = 0; round < 4000; ++round) {
        Pose v_from_r;
        v_from_r.rotation = glm::mat3_cast(
            glm::angleAxis(between(-3.1, 3.1), glm::normalize(dvec3(between(-0.3, 0.3), 1, between(-0.3, 0.3)))));
        v_from_r.translation_m = {between(-4, 4), between(-1, 1), between(-4, 4)};
        const raster::FloatMap map(projective_map(k, v_from_r, k, {}));
        const float u0 = float(int(between(-1, 300))), u1 = u0 + 64, v0 = float(int(between(-1, 220))), v1 = v0 + 16;
        raster::Bounds w;
        w.low = float(between(0, 0.5)), w.high = w.low + float(between(0, 1));
        float highest_q = 0;
        const raster::Range reach = raster::reach_of(map, u0, u1, v0, v1, w, 320, 240, &highest_q);
        size_t behind = 0, front = 0;
        for (int i = 0; i < 400; ++i) {
            const auto at = [&](float a, float b) { return std::min(b, a + float(between(0, 1.0)) * (b - a)); };
            const bool corner = i < 8;
            const raster::Corner c =
                map.corner(corner ? (i & 1 ? u1 : u0) : at(u0, u1), corner ? (i & 2 ? v1 : v0) : at(v0, v1),
                           corner ? (i & 4 ? w.high : w.low) : at(w.low, w.high));
            if (!(c.r > 0)) {
                ++behind;
                continue;
            }
            ++front;
            // A pixel whose centre it covers, or would with half a pixel more.
            const double x = double(c.x), y = double(c.y);
            if (!(x >= 0 && x <= 319 && y >= 0 && y <= 239)) continue;
            const bool held =
                x >= reach.x0 - 1 && x <= reach.x1 && y >= reach.y0 - 1 && y <= reach.y1 && c.q <= highest_q;
            held ? ++inside : ++outside;
        }
        if (!behind || !front) continue;
        ++cut;
        narrower += reach.x0 > 0 || reach.x1 < 320 || reach.y0 > 0 || reach.y1 < 240;
    }
    INFO(cut << " boxes on both sides, " << narrower << " of them narrower than the image; " << inside
             << " points inside");
    CHECK(outside == 0);
    CHECK(inside > 20000);
    CHECK(cut > 500);
    CHECK(narrower > cut / 4);
}

TEST_CASE("a mixed picture: only pixels whose own sample is mixed show the card's color", "[warp]") {
    // Every wall pixel beside the card is half card, as an antialiased picture has it. Where the edge band is dropped
    // no warped wall pixel is more than half card; a plain bilinear sample across the edge would be.
    const World world = card_before_wall();
    const View own = camera_at({0, 0, 0});
    const Paint plain = [](int which, const dvec3&) { return which == card ? glm::vec3(1) : glm::vec3(0); };
    Shot shot = shoot(world, own, plain);
    const ColorImage sharp = shot.color;
    mix_beside_card(shot);
    const ShiftedCamera v = moved_camera(shot, {0, 0.3, 0});
    const Rig rig({shot}, v.world_from_cam.translation_m);
    Reprojection shown;
    REQUIRE(reproject(rig.surfaces[0], v, nullptr, shown));
    const auto reddest_wall = [&](EdgeBand edge) {
        const Warped got = warp(shown, sampler_of(rig, 0, v), edge);
        float most = 0;
        for (size_t i = 0; i < got.color.size(); ++i)
            if (!got.missing.data[i] && shown.inverse_depth.data[i] < 0.15f) most = std::max(most, got.color.data[i].x);
        return most;
    };
    CHECK(reddest_wall(EdgeBand::keep) == Approx(0.5).margin(1e-4));
    CHECK(reddest_wall(EdgeBand::drop) < 0.5f);
}

TEST_CASE("a fine checkerboard seen from farther away is gray", "[warp]") {
    const World world = {upright(wall_m, 0, 0, endless, endless)};
    const double px_m = wall_m / 320;
    const Paint checker = [&](int, const dvec3& p) {
        return glm::vec3(float((int(std::floor(p.y / px_m)) + int(std::floor(p.z / px_m))) & 1));
    };
    const View own = camera_at({0, 0, 0});
    const ShiftedCamera v = moved_camera({own, {}, {}, {}}, {-wall_m, 0, 0});  // twice as far: half as large
    const Rig rig({shoot(world, own, checker)}, v.world_from_cam.translation_m);
    Reprojection shown;
    REQUIRE(reproject(rig.surfaces[0], v, nullptr, shown));
    const Warped got = warp(shown, sampler_of(rig, 0, v), EdgeBand::drop);
    double worst = 0;
    for (int y = 64; y < 176; ++y)
        for (int x = 84; x < 236; ++x) worst = std::max(worst, std::fabs(double(got.color.at(x, y).x) - 0.5));
    CHECK(worst < 0.02);
}

TEST_CASE("vector loops give what single samples give, to the bit", "[warp]") {
    // Farther away and beside: plain samples, tents, edges and holes.
    for (const Shift& by : {moved(0, 1), moved(-3, 0.2), moved(1, -2, 0.1, 0.1)})
        for (const std::string name : {"random", "fence", "pole"}) {
            const MinimalScene s = make_scene(name, {}, 3);
            const View r = s.recorded(s.own), to = s.shifted(by, s.own);
            const ShiftedCamera v = as_shifted(to);
            const Paint noise = [](int which, const dvec3& p) {
                return glm::vec3(glm::fract(p * 12.9898) + 0.1 * double(which));
            };
            const Rig rig({shoot(s.world, r, noise)}, v.world_from_cam.translation_m);
            Reprojection shown;
            if (!reproject(rig.surfaces[0], v, nullptr, shown)) continue;
            const Sampler sampler = sampler_of(rig, 0, v);
            for (const EdgeBand edge : {EdgeBand::drop, EdgeBand::keep}) {
                const Warped got = warp(shown, sampler, edge);
                size_t differs = 0, colored = 0;
                for (int y = 0; y < got.color.height; ++y)
                    for (int x = 0; x < got.color.width; ++x) {
                        const size_t at = size_t(y) * size_t(got.color.width) + size_t(x);
                        glm::vec3 color(0);
                        const bool has = is_seen(shown.sight.data[at]) &&
                                         sampler.sample(shown.source_px.data[at], {x + 0.5f, y + 0.5f}, edge, color);
                        colored += has;
                        differs += has == bool(got.missing.data[at]) || color != got.color.data[at];
                    }
                INFO(name << ": " << colored << " px");
                CHECK(differs == 0);
                CHECK(colored > 1000);
            }
        }
}

TEST_CASE("tears do not depend on how many pixels a loop takes at once", "[raster][lift]") {
    // In strips of six columns no vector loop runs.
    constexpr int strip = 6;
    for (const std::string name : {"random", "fence", "grazing_road_kerb"}) {
        const MinimalScene s = make_scene(name);
        const View r = s.recorded(s.own);
        DepthMap depth = render(s.world, r).depth;
        for (size_t i = 7; i < depth.size(); i += 101) depth.data[i] = i % 3 ? -1.0f : INFINITY;  // no measurement, sky
        const dvec3 centre = r.world_from_cam.point({1.5, 0.1, 0.2});
        for (const DepthSource source : {DepthSource::exact, DepthSource::mm16, DepthSource::mono}) {
            const DepthRules rules = depth_rules(source, depth);
            const SurfaceView all = surface_view(r.intrinsics, r.world_from_cam, depth, centre, rules);
            size_t differs = 0, torn = 0;
            for (int x0 = 0; x0 + strip <= depth.width; ++x0) {
                Intrinsics k = r.intrinsics;
                k.width = strip, k.cx -= x0;
                DepthMap part(strip, depth.height);
                for (int y = 0; y < depth.height; ++y)
                    for (int x = 0; x < strip; ++x) part.at(x, y) = depth.at(x0 + x, y);
                const SurfaceView cut = surface_view(k, r.world_from_cam, part, centre, rules);
                for (int y = 0; y < depth.height; ++y) {  // of a column whose neighbours lie in the strip
                    differs += cut.tears.at(2, y) != all.tears.at(x0 + 2, y);
                    torn += cut.tears.at(2, y) != 0;
                }
            }
            INFO(name << ": " << torn << " torn");
            CHECK(differs == 0);
            CHECK(torn > 100);
        }
    }
}
