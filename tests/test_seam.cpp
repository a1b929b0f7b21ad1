// SPDX-License-Identifier: Apache-2.0
// Warp, seam, condition and degradations in closed form: a painted card before a painted wall, seen by two or three
// cameras. Paint is affine on a wall, so bilinear sampling must give it back.
#include <tbb/global_control.h>

#include <cstring>
#include <functional>

#include "embree_core/condition.h"
#include "tests/catch.h"
#include "tests/minimal_support.h"

using namespace vshift;
using namespace vshift::minimal;

namespace {

using glm::dvec3;
using Paint = std::function<glm::vec3(int primitive, const dvec3& p)>;

/// Level, looking ahead: image x is ego -y, image y is ego -z.
View camera_at(const dvec3& at_m, int width = 320, int height = 240) {
    View v;
    v.intrinsics = {width, height, double(width), double(width), width / 2.0, height / 2.0};
    v.world_from_cam.rotation = glm::dmat3(dvec3(0, -1, 0), dvec3(0, 0, -1), dvec3(1, 0, 0));
    v.world_from_cam.translation_m = at_m;
    return v;
}

Primitive upright(double x_m, double y_m, double z_m, double half_y_m, double half_z_m) {
    Primitive p;
    p.world_from_local.rotation = glm::dmat3(dvec3(0, -1, 0), dvec3(0, 0, -1), dvec3(1, 0, 0));
    p.world_from_local.translation_m = {x_m, y_m, z_m};
    p.half_m = {half_y_m, half_z_m, 0};
    return p;
}

constexpr double wall_m = 10, card_m = 4, endless = 1e3;
constexpr int wall = 0, card = 1;

/// The wall fills the view; the card is 40x40 px at 4 m, up to its half pixel.
World card_before_wall() {
    return {upright(wall_m, 0, 0, endless, endless), upright(card_m, 0, 0, 20.0 / 320 * card_m, 20.0 / 320 * card_m)};
}

glm::vec3 affine_paint(int primitive, const dvec3& p) {
    if (primitive == card) return {0.9, 0.1 + 0.02 * p.y, 0.1};
    return {0.2 + 0.01 * p.y, 0.5 + 0.03 * p.z, 0.4 + 0.01 * p.y - 0.02 * p.z};
}

/// A camera with its exact depth and painted picture.
struct Shot {
    View view;
    DepthMap depth;
    Grid<int32_t> primitive;
    ColorImage color;
};

Shot shoot(const World& world, const View& view, const Paint& paint) {
    const Picture picture = render(world, view);
    Shot shot{view, picture.depth, picture.primitive, ColorImage(view.intrinsics.width, view.intrinsics.height)};
    for (int y = 0; y < shot.color.height; ++y)
        for (int x = 0; x < shot.color.width; ++x) {
            const int which = shot.primitive.at(x, y);
            if (which < 0) continue;
            const dvec3 d = ray(view.intrinsics, {x + 0.5, y + 0.5}) * double(shot.depth.at(x, y));
            shot.color.at(x, y) = paint(which, view.world_from_cam.point(d));
        }
    return shot;
}

/// Shots as a rig seen from one centre; keeps what the seam points to.
struct Rig {
    std::vector<Shot> shots;
    std::vector<SurfaceView> surfaces;
    std::vector<SeamCamera> cameras;

    Rig(std::vector<Shot> of, const dvec3& seen_from_m) : shots(std::move(of)) {
        for (const Shot& s : shots)
            surfaces.push_back(surface_view(s.view.intrinsics, s.view.world_from_cam, s.depth, seen_from_m));
        for (size_t i = 0; i < shots.size(); ++i) {
            cameras.emplace_back();
            cameras[i].name = "CAM_" + std::to_string(i);
            cameras[i].surface = &surfaces[i];
            cameras[i].image = &shots[i].color;
        }
    }
    Rig(const Rig&) = delete;
};

double worst_difference(const glm::vec3& a, const glm::vec3& b) {
    const glm::vec3 d = glm::abs(a - b);
    return double(std::max({d.x, d.y, d.z}));
}

bool same_bytes(const ColorImage& a, const ColorImage& b) {
    return a.width == b.width && a.height == b.height && !std::memcmp(a.data.data(), b.data.data(), a.size() * 12);
}

ShiftedCamera moved_camera(const Shot& own, const dvec3& by_m) {
    ShiftedCamera v{own.view.intrinsics, own.view.world_from_cam};
    v.world_from_cam.translation_m += by_m;
    return v;
}

Mask holes_of(const Reprojection& r) {
    Mask m(r.sight.width, r.sight.height, 0);
    for (size_t i = 0; i < m.size(); ++i) m.data[i] = !is_seen(r.sight.data[i]);
    return m;
}

/// Whether a pixel's answer differs from a neighbour's, or it lies at the image's border.
bool at_border(const Mask& m, int x, int y) {
    for (int dy = -1; dy <= 1; ++dy)
        for (int dx = -1; dx <= 1; ++dx) {
            const int px = x + dx, py = y + dy;
            if (px < 0 || py < 0 || px >= m.width || py >= m.height || m.at(px, py) != m.at(x, y)) return true;
        }
    return false;
}

Sampler sampler_of(const Rig& rig, size_t i, const ShiftedCamera& v) {
    const SurfaceView& s = rig.surfaces[i];
    return {{s.inverse_depth, s.tears},
            rig.shots[i].color,
            projective_map(s.intrinsics, s.world_from_cam, v.intrinsics, v.world_from_cam)};
}

}  // namespace

TEST_CASE("the rasteriser sees what Embree casts", "[raster]") {
    const Shift shifts[] = {moved(0, 0), moved(0, 1), moved(0, -1.37), moved(1.5, 0), moved(-2, 0.5, 0.3),
                            moved(0.4, -2, 0.2, 0.2)};
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
                    place_differs +=
                        glm::length(drawn.source_px.data[i] - cast_by_rays.source_px.data[i]) > 1.0f / 64;
                }
                INFO(name << " camera " << camera << " shift " << by.translation_m.x << "," << by.translation_m.y
                          << "," << by.translation_m.z << ": " << seen_differs << " px differ in being seen, "
                          << depth_differs << " in depth, " << place_differs << " in place");
                if (std::getenv("VSHIFT_TEST_PRINT"))
                    std::printf("raster %s %d %g,%g,%g: %zu seen, %zu depth, %zu place\n", name.c_str(), camera,
                                by.translation_m.x, by.translation_m.y, by.translation_m.z, seen_differs,
                                depth_differs, place_differs);
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
        REQUIRE(reproject(surface_view(r.intrinsics, r.world_from_cam, render(s.world, r).depth,
                                       v.world_from_cam.translation_m),
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
            shots.push_back(shoot(s.world, s.recorded(i), [](int, const dvec3& p) {
                return glm::vec3(glm::fract(p * 1.37));
            }));
        const View own = s.recorded(s.own);
        const Rig rig(std::move(shots), own.world_from_cam.translation_m);
        const ShiftedCamera v = as_shifted(own);
        const ShiftedSeam got = seam_shifted(rig.cameras, s.own, v, {});
        INFO(name);
        CHECK(same_bytes(got.seam.color, rig.shots[size_t(s.own)].color));
        CHECK(std::all_of(got.seam.source.data.begin(), got.seam.source.data.end(),
                          [&](int i) { return i == s.own; }));
        const Seam recorded = seam_recorded(rig.cameras, s.own, Mask(own.intrinsics.width, own.intrinsics.height, 0), {});
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
            INFO("moved by " << by.x << "," << by.y << "," << by.z << ": " << colored << " px, " << dropped << " dropped");
            CHECK(worst < 1e-3);
            CHECK(colored > 40000);
            CHECK((edge == EdgeBand::drop || dropped == 0));
            CHECK(dropped < 200);  // at most half a pixel round a card of 40x40
        }
    }
}

TEST_CASE("a mixed picture: only pixels whose own sample is mixed show the card's color", "[warp]") {
    // Every wall pixel beside the card is half card, as an antialiased picture has it. Where the edge band is dropped
    // no warped wall pixel is more than half card; a plain bilinear sample across the edge would be.
    const World world = card_before_wall();
    const View own = camera_at({0, 0, 0});
    const Paint plain = [](int which, const dvec3&) { return which == card ? glm::vec3(1) : glm::vec3(0); };
    Shot shot = shoot(world, own, plain);
    const ColorImage sharp = shot.color;
    for (int y = 1; y + 1 < 240; ++y)
        for (int x = 1; x + 1 < 320; ++x)
            if (shot.primitive.at(x, y) == wall &&
                (shot.primitive.at(x - 1, y) == card || shot.primitive.at(x + 1, y) == card))
                shot.color.at(x, y) = glm::vec3(0.5f);
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

TEST_CASE("the seam fills exactly what a neighbour saw", "[seam]") {
    const World world = card_before_wall();
    const View own = camera_at({0, 0, 0}), left = camera_at({0, 1.5, 0}), right = camera_at({0, -1.5, 0});
    for (const double y_m : {1.0, -1.0, 0.4}) {
        const ShiftedCamera v = moved_camera({own, {}, {}, {}}, {0, y_m, 0});
        const View shifted{v.intrinsics, v.world_from_cam};
        const Rig rig({shoot(world, left, affine_paint), shoot(world, own, affine_paint),
                       shoot(world, right, affine_paint)},
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

TEST_CASE("nothing is pasted behind what the rig saw", "[seam]") {
    // The neighbour fired before a board came: it shows the wall where the own camera later saw the board. A second
    // card nearer by opens a hole in V right before that board, wider than what it hid of it.
    const Primitive board = upright(7, 0, 0, 1.2, 1.2);
    World before = card_before_wall(), now = before;
    now.push_back(board);
    const View own = camera_at({0, 0, 0}), left = camera_at({0, 2.5, 0});
    const ShiftedCamera v = moved_camera({own, {}, {}, {}}, {0, 2, 0});
    const Rig with({shoot(now, own, affine_paint), shoot(before, left, affine_paint)},
                   v.world_from_cam.translation_m);
    const Rig without({shoot(before, own, affine_paint), shoot(before, left, affine_paint)},
                      v.world_from_cam.translation_m);
    const ShiftedSeam got = seam_shifted(with.cameras, 0, v, {}), other = seam_shifted(without.cameras, 0, v, {});
    size_t hidden_holes = 0, pasted = 0, pasted_without = 0;
    for (size_t i = 0; i < got.own.sight.size(); ++i) {
        const bool board_behind_wall = got.own.sight.data[i] == Sight::behind_wall &&
                                       std::fabs(got.own.inverse_depth.data[i] - 1.0f / 7) < 1e-3f;
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
            wrong += got.seam.source.at(x, y) != 1 ||
                     worst_difference(got.seam.color.at(x, y), {0.1f, 0.2f, 0.9f}) > 1e-5;
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
            if (!some.holds(x))
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
    const Rig later({shoot(card_before_wall(), own, paint), shoot(gone, left, paint)},
                    v.world_from_cam.translation_m);
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
    const Rig rig({shoot(world, own, affine_paint), shoot(world, left, affine_paint),
                   shoot(world, right, affine_paint)},
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
    CHECK(bent_source_px(bent, from, along, wall_m).x - exact.x == Approx(320 * 1.5 * (1 / 11.0 - 1 / 10.0)).margin(1e-2));
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

TEST_CASE("one thread or two, the same bytes", "[raster][seam]") {
    const MinimalScene s = make_scene("random");
    const View v = s.shifted(moved(0.5, -2, 0.1), s.own);
    std::vector<ShiftedSeam> results;
    for (const size_t threads : {1, 2}) {
        const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, threads);
        std::vector<Shot> shots;
        for (int i = 0; i < int(s.rig.size()); ++i)
            shots.push_back(shoot(s.world, s.recorded(i), [](int, const dvec3& p) { return glm::vec3(glm::fract(p)); }));
        const Rig rig(std::move(shots), v.world_from_cam.translation_m);
        results.push_back(seam_shifted(rig.cameras, s.own, as_shifted(v), {}));
    }
    CHECK(same_bytes(results[0].seam.color, results[1].seam.color));
    CHECK(results[0].seam.source.data == results[1].seam.source.data);
    CHECK(results[0].own.inverse_depth.data == results[1].own.inverse_depth.data);
}
