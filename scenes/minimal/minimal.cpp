// SPDX-License-Identifier: Apache-2.0
// Role: the named minimal scenes, with their closed forms. All are laid out for 320x240 pixels and
// f = 320 px, and scale with the image's width.
#include "scenes/minimal/minimal.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <random>

namespace vshift::minimal {
namespace {

using glm::dvec3;
constexpr double far_m = 1e6;
constexpr double eye_height_m = 1.5;
const double pi = std::acos(-1.0);

/// ego_from_cam of a level camera that looks along `yaw_deg` (0 ahead, 90 left).
Camera level_camera(const std::string& name, Size size, double focal_px, const dvec3& at_m, double yaw_deg) {
    const double a = yaw_deg * pi / 180, c = yaw_deg == 0 ? 1 : std::cos(a), s = yaw_deg == 0 ? 0 : std::sin(a);
    Camera out;
    out.name = name;
    out.intrinsics = {size.width, size.height, focal_px, focal_px, size.width / 2.0, size.height / 2.0};
    out.ego_from_cam.rotation = glm::dmat3(dvec3(s, -c, 0), dvec3(0, 0, -1), dvec3(c, s, 0));
    out.ego_from_cam.translation_m = at_m;
    return out;
}

Camera front_camera(Size size) {
    return level_camera("CAM_FRONT", size, size.width, {0, 0, eye_height_m}, 0);
}

glm::dmat3 yawed(double yaw_rad) {
    const double c = std::cos(yaw_rad), s = std::sin(yaw_rad);
    return glm::dmat3(dvec3(c, s, 0), dvec3(-s, c, 0), dvec3(0, 0, 1));
}

Primitive ground(const dvec3& color = {0.35, 0.35, 0.36}) {
    Primitive p;
    p.half_m = dvec3(INFINITY, INFINITY, 0);
    p.color = color;
    return p;
}

Primitive box(const dvec3& centre, const dvec3& half, double yaw_rad, const dvec3& color) {
    return {Shape::box, {yawed(yaw_rad), centre}, half, color};
}

Primitive cylinder(const dvec3& centre, double radius, double half_height, const dvec3& color) {
    return {Shape::cylinder, {glm::dmat3(1.0), centre}, dvec3(radius, radius, half_height), color};
}

/// A rectangle that faces the camera and covers `r` of its image at planar depth `depth_m`.
Primitive card(const Camera& camera, const RectPx& r, double depth_m, const dvec3& color) {
    const Intrinsics& k = camera.intrinsics;
    const double x0 = std::max(r.x0, -1e6), x1 = std::min(r.x1, 1e6);
    const double y0 = std::max(r.y0, -1e6), y1 = std::min(r.y1, 1e6);
    Primitive p;
    p.world_from_local.rotation = camera.ego_from_cam.rotation;
    p.world_from_local.translation_m =
        camera.ego_from_cam.point(dvec3(((x0 + x1) / 2 - k.cx) / k.fx, ((y0 + y1) / 2 - k.cy) / k.fy, 1.0) * depth_m);
    p.half_m = dvec3((x1 - x0) / 2 / k.fx, (y1 - y0) / 2 / k.fy, 0) * depth_m;
    p.color = color;
    return p;
}

Mask fill(Size size, const std::function<bool(double, double)>& set) {
    Mask m(size.width, size.height, 0);
    for (int y = 0; y < m.height; ++y)
        for (int x = 0; x < m.width; ++x) m.at(x, y) = set(x + 0.5, y + 0.5);
    return m;
}

Mask nothing(Size size) {
    return Mask(size.width, size.height, 0);
}

MinimalScene on_road(const std::string& name, Size size, const std::string& about) {
    MinimalScene s;
    s.name = name;
    s.about = about;
    s.rig = {front_camera(size)};
    s.frames = {Pose{}};
    s.shift.translation_m = {0, 1, 0};
    s.world = {ground()};
    return s;
}

MinimalScene grazing_road(Size size) {
    MinimalScene s = on_road("grazing_road", size, "a road plane to the horizon under the sky");
    const double f = size.width, cy = size.height / 2.0, w = size.width;
    s.closed_forms = {
        {"mask", "occluded", "none", nothing(size)},
        {"mask", "unknown", "none", nothing(size)},
        {"mask", "outside", "road: u + (v - cy) shift / height >= width", fill(size, [=](double u, double v) {
             const double inverse_z = (v - cy) / f / eye_height_m;
             return inverse_z > 0 && u + f * inverse_z >= w;
         })}};
    return s;
}

/// A kerb of `rise` metres along y = `edge`, pavement beyond it, seen from over the road.
struct Kerb {
    double edge, rise;
    enum Part { road, face, pavement, sky };
    /// What the ray to the right by `r` and down by `s` (per metre ahead) meets, and at what depth.
    Part meet(double r, double s, double& z) const {
        const double side = edge > 0 ? 1 : -1, out = -r * side;  // growth of |y| per metre
        const double reach = std::abs(edge);
        if (s <= 0) return z = INFINITY, sky;
        z = eye_height_m / s;
        if (out * z <= reach) return road;
        z = reach / out;
        if (eye_height_m - s * z <= rise) return face;
        z = (eye_height_m - rise) / s;
        return pavement;
    }
};

MinimalScene road_with_kerb(const std::string& name, Size size, const std::string& about, Kerb kerb, double left_m) {
    MinimalScene s = on_road(name, size, about);
    const double side = kerb.edge > 0 ? 1 : -1;
    s.world.push_back(box({0, kerb.edge + side * far_m, kerb.rise - 5}, {far_m, far_m, 5}, 0, {0.55, 0.52, 0.48}));
    s.shift.translation_m = {0, left_m, 0};
    const double f = size.width, cx = size.width / 2.0, cy = size.height / 2.0, w = size.width;
    // Seen from V beyond the edge the face turns away, and the edge hides the road up to the line
    // from V over it.
    const bool beyond = left_m * side > kerb.edge * side;
    const double shadow = kerb.edge - (left_m - kerb.edge) * kerb.rise / (eye_height_m - kerb.rise);
    const auto hidden = [=](double u, double v) {
        double z = 0;
        const Kerb::Part part = kerb.meet((u - cx) / f, (v - cy) / f, z);
        return beyond && (part == Kerb::face || (part == Kerb::road && -(u - cx) / f * z * side > shadow * side));
    };
    // What one camera knows: the kerb hides the road where the segment meets it inside R's frame.
    const auto hidden_in_frame = [=](double u, double v) {
        double z = 0;
        const Kerb::Part part = kerb.meet((u - cx) / f, (v - cy) / f, z);
        const double y = -(u - cx) / f * z, kerb_z = z * (left_m - kerb.edge) / (left_m - y);
        const double kerb_u = cx - f * kerb.edge / kerb_z;
        return hidden(u, v) && (part == Kerb::face || (kerb_u >= 0 && kerb_u < w));
    };
    const std::string rule =
        beyond ? "the kerb's face, and the road between y = " + std::to_string(shadow) + " m and the kerb" : "none";
    s.closed_forms = {{"truth", "occluded", rule, fill(size, hidden)},
                      {"mask", "occluded", rule + ", where the kerb is in frame", fill(size, hidden_in_frame)},
                      {"mask", "unknown", "none", nothing(size)},
                      {"mask", "outside", "u + f shift / Z outside [0, width)", fill(size, [=](double u, double v) {
                           double z = 0;
                           kerb.meet((u - cx) / f, (v - cy) / f, z);
                           return u + f * left_m / z >= w || u + f * left_m / z < 0;
                       })}};
    return s;
}

MinimalScene round_pole(Size size) {
    MinimalScene s = on_road("round_pole", size, "round poles of about 1, 2 and 5 px before a wall");
    s.world.push_back(card(s.rig[0], {-1e6, -1e6, 1e6, 1e6}, 20, {0.6, 0.5, 0.4}));
    const double px = 8.0 / 320;  // metres per pixel (at 320 px) at 8 m
    s.world.push_back(cylinder({8, 1.5, 5}, 0.5 * px, 6, {0.2, 0.5, 0.3}));
    s.world.push_back(cylinder({8, -0.3, 5}, 1.0 * px, 6, {0.5, 0.3, 0.2}));
    s.world.push_back(cylinder({8, -2, 5}, 2.5 * px, 6, {0.2, 0.3, 0.6}));
    return s;
}

MinimalScene rig_box(Size size) {
    MinimalScene s = on_road("rig_box", size, "six cameras around a car, a box and poles beside it");
    const double f = size.width / 2.0;  // 90 degrees: each direction is seen by two
    s.rig = {level_camera("CAM_FRONT", size, f, {1.0, 0.0, 1.5}, 0),
             level_camera("CAM_FRONT_LEFT", size, f, {0.8, 1.0, 1.5}, 45),
             level_camera("CAM_FRONT_RIGHT", size, f, {0.8, -1.0, 1.5}, -45),
             level_camera("CAM_BACK", size, f, {-1.0, 0.0, 1.5}, 180),
             level_camera("CAM_BACK_LEFT", size, f, {-0.8, 1.0, 1.5}, 135),
             level_camera("CAM_BACK_RIGHT", size, f, {-0.8, -1.0, 1.5}, -135)};
    s.frames = {Pose{}, Pose{glm::dmat3(1.0), {0.5, 0, 0}}};
    s.world.push_back(box({6.5, 4.2, 0.8}, {1.5, 0.8, 0.8}, 0.1, {0.7, 0.25, 0.2}));
    s.world.push_back(box({9.0, -4.0, 1.2}, {1.0, 1.0, 1.2}, 0.4, {0.2, 0.45, 0.7}));
    s.world.push_back(box({-5.0, 4.0, 1.0}, {1.5, 0.8, 1.0}, -0.2, {0.3, 0.6, 0.3}));
    s.world.push_back(cylinder({5.0, 1.2, 2.0}, 0.08, 2.0, {0.6, 0.6, 0.2}));
    s.world.push_back(cylinder({7.0, -1.5, 2.0}, 0.06, 2.0, {0.5, 0.5, 0.5}));
    s.world.push_back(box({20, 0, 4}, {1, 40, 4}, 0, {0.6, 0.5, 0.45}));
    s.world.push_back(box({0, 14, 3}, {60, 1, 3}, 0, {0.5, 0.55, 0.5}));
    return s;
}

MinimalScene random_boxes(Size size, uint32_t seed) {
    MinimalScene s = on_road("random", size, "boxes and poles at random, three cameras side by side");
    s.rig.push_back(level_camera("CAM_LEFT", size, size.width, {0, 1.2, eye_height_m}, 0));
    s.rig.push_back(level_camera("CAM_RIGHT", size, size.width, {0, -1.2, eye_height_m}, 0));
    std::mt19937 engine(seed);  // its numbers are the same everywhere; distributions' are not
    const auto within = [&](double a, double b) { return a + (b - a) * (engine() / 4294967296.0); };
    s.world.push_back(card(s.rig[0], {-1e6, -1e6, 1e6, 1e6}, within(18, 40), {0.6, 0.5, 0.4}));
    for (int i = 0; i < 6; ++i) {
        const double x = within(5, 15);
        const dvec3 half(within(0.2, 1.2), within(0.2, 1.2), within(0.3, 1.5));
        s.world.push_back(box({x, within(-0.45, 0.45) * x, within(0.3, 1.5)}, half, within(-1.5, 1.5),
                              {within(0.2, 0.7), within(0.2, 0.7), within(0.2, 0.7)}));
    }
    for (int i = 0; i < 2; ++i) {
        const double x = within(5, 12);
        s.world.push_back(cylinder({x, within(-0.4, 0.4) * x, 2}, within(0.05, 0.15), 2, {0.3, 0.3, 0.3}));
    }
    const double shifts[4][2] = {{0, 1}, {0, -0.5}, {1, 1}, {0.5, -2}};  // ahead, left
    const double* by = shifts[seed % 4];
    s.shift.translation_m = {by[0], by[1], 0};
    return s;
}

struct Named {
    const char* name;
    std::function<MinimalScene(Size, uint32_t)> make;
};

/// Every scene, once: `--list`, `all` and the tests go through this table.
const std::vector<Named>& table() {
    static const std::vector<Named> scenes = {
        {"two_planes",
         [](Size z, uint32_t) {
             const double s = z.width / 320.0;
             return cards_before_wall("two_planes", z, {{-1e6, -1e6, 120 * s, 1e6}}, 4, 10, 1);
         }},
        {"box",
         [](Size z, uint32_t) {
             const double s = z.width / 320.0, cy = z.height / 2.0;
             return cards_before_wall("box", z, {{120 * s, cy - 20 * s, 160 * s, cy + 20 * s}}, 4, 10, 1);
         }},
        {"pole",
         [](Size z, uint32_t) {
             const double s = z.width / 320.0;
             std::vector<RectPx> poles;
             for (const auto& [x, w] : {std::pair{60, 1}, {130, 2}, {200, 3}})
                 poles.push_back({x * s, -1e6, (x + w) * s, 1e6});
             return cards_before_wall("pole", z, poles, 5, 10, 1);
         }},
        {"fence",
         [](Size z, uint32_t) {
             const double s = z.width / 320.0;
             std::vector<RectPx> slats;
             for (int x = 64; x < 256; x += 16) slats.push_back({x * s, -1e6, (x + 8) * s, 1e6});
             return cards_before_wall("fence", z, slats, 5, 10, 0.625);
         }},
        {"grazing_road", [](Size z, uint32_t) { return grazing_road(z); }},
        {"grazing_road_kerb",
         [](Size z, uint32_t) {
             return road_with_kerb("grazing_road_kerb", z, "a road to the horizon with a kerb beside it", {-3, 0.15},
                                   1);
         }},
        {"step_kerb",
         [](Size z, uint32_t) {
             return road_with_kerb("step_kerb", z, "the camera moves over a pavement whose edge hides the road",
                                   {2.05, 0.3}, 3);
         }},
        {"round_pole", [](Size z, uint32_t) { return round_pole(z); }},
        {"rig_box", [](Size z, uint32_t) { return rig_box(z); }},
        {"random", random_boxes},
    };
    return scenes;
}

size_t edit_distance(const std::string& a, const std::string& b) {
    std::vector<size_t> row(b.size() + 1);
    for (size_t j = 0; j <= b.size(); ++j) row[j] = j;
    for (size_t i = 1; i <= a.size(); ++i) {
        size_t diagonal = row[0];
        row[0] = i;
        for (size_t j = 1; j <= b.size(); ++j) {
            const size_t change = diagonal + (a[i - 1] != b[j - 1]);
            diagonal = row[j];
            row[j] = std::min({row[j] + 1, row[j - 1] + 1, change});
        }
    }
    return row.back();
}

}  // namespace

View MinimalScene::recorded(int camera, int frame) const {
    return shifted(Shift{}, camera, frame);
}

View MinimalScene::shifted(const Shift& by, int camera, int frame) const {
    const Camera& c = rig[size_t(camera)];
    const Pose& world_from_ego = frames[size_t(frame)];
    const glm::dmat3 turn = by.yaw_rad == 0 ? glm::dmat3(1.0) : yawed(by.yaw_rad);
    const dvec3 in_ego = by.translation_m + turn * c.ego_from_cam.translation_m;
    return {c.intrinsics, {world_from_ego.rotation * turn * c.ego_from_cam.rotation, world_from_ego.point(in_ego)}};
}

std::vector<View> MinimalScene::views(int frame) const {
    std::vector<View> all;
    for (int i = 0; i < int(rig.size()); ++i) all.push_back(recorded(i, frame));
    return all;
}

std::vector<std::string> scene_names() {
    std::vector<std::string> names;
    for (const Named& n : table()) names.push_back(n.name);
    return names;
}

MinimalScene make_scene(const std::string& name, Size size, uint32_t seed) {
    const Named* nearest = &table().front();
    for (const Named& n : table()) {
        if (n.name == name) return n.make(size, seed);
        if (edit_distance(name, n.name) < edit_distance(name, nearest->name)) nearest = &n;
    }
    throw Error(ExitCode::bad_input,
                "scene: got '" + name + "', expected one of --list, such as '" + nearest->name + "'");
}

MinimalScene cards_before_wall(const std::string& name, Size size, const std::vector<RectPx>& cards, double card_m,
                               double wall_m, double left_m) {
    MinimalScene s;
    s.name = name;
    s.about = "cards that face the camera before a wall";
    s.rig = {front_camera(size)};
    s.frames = {Pose{}};
    s.shift.translation_m = {0, left_m, 0};
    s.world.push_back(card(s.rig[0], {-1e6, -1e6, 1e6, 1e6}, wall_m, {0.6, 0.5, 0.4}));
    for (const RectPx& r : cards) s.world.push_back(card(s.rig[0], r, card_m, {0.25, 0.45, 0.6}));

    const double near_px = size.width * left_m / card_m, far_px = size.width * left_m / wall_m;
    const double strip_px = near_px - far_px, width = size.width;
    const auto on_card = [=](double u, double v) {
        return std::any_of(cards.begin(), cards.end(), [&](const RectPx& r) { return r.holds(u, v); });
    };
    const auto past_edge = [=](double u, double v) {  // the segment from a wall pixel dips behind a card
        return std::any_of(cards.begin(), cards.end(), [&](const RectPx& r) {
            if (v < r.y0 || v >= r.y1) return false;
            return left_m > 0 ? r.x1 <= u && u - strip_px < r.x1 : r.x0 > u && u - strip_px >= r.x0;
        });
    };
    const auto inside = [=](double u) { return u >= 0 && u < width; };
    const auto add = [&](const char* out, const char* channel, const char* rule, auto&& set) {
        s.closed_forms.push_back({out, channel, rule, fill(size, set)});
    };
    add("mask", "occluded", "wall pixels u with u - D on a card, D = f shift (1/card - 1/wall)",
        [=](double u, double v) { return !on_card(u, v) && on_card(u - strip_px, v); });
    add("mask", "unknown", "wall pixels that are not occluded, with a card's edge in (u - D, u]",
        [=](double u, double v) { return !on_card(u, v) && !on_card(u - strip_px, v) && past_edge(u, v); });
    add("mask", "outside", "u + f shift / Z outside [0, width)",
        [=](double u, double v) { return !inside(u + (on_card(u, v) ? near_px : far_px)); });
    add("holes", "hole", "the recorded view of it is out of frame, hidden or unknown", [=](double x, double v) {
        if (on_card(x - near_px, v)) return !inside(x - near_px);
        const double u = x - far_px;
        return !inside(u) || on_card(u, v) || past_edge(u, v);
    });
    return s;
}

std::vector<RectPx> rectangles(const Mask& mask) {
    std::vector<RectPx> done, open;
    for (int y = 0; y < mask.height; ++y) {
        std::vector<RectPx> next;
        for (int x = 0; x < mask.width; ++x) {
            if (!mask.at(x, y)) continue;
            const int x0 = x;
            while (x < mask.width && mask.at(x, y)) ++x;
            RectPx r{double(x0), double(y), double(x), y + 1.0};
            const auto above =
                std::find_if(open.begin(), open.end(), [&](const RectPx& o) { return o.x0 == r.x0 && o.x1 == r.x1; });
            if (above != open.end()) {
                r.y0 = above->y0;
                open.erase(above);
            }
            next.push_back(r);
        }
        done.insert(done.end(), open.begin(), open.end());
        open = next;
    }
    done.insert(done.end(), open.begin(), open.end());
    return done;
}

}  // namespace vshift::minimal
