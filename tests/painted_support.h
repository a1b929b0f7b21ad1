// SPDX-License-Identifier: Apache-2.0
// A painted card before a painted wall, seen by two or three cameras: what tests of warp, seam and condition share.
// Paint is affine on a wall, so bilinear sampling must give it back.
#pragma once
#include <cstring>
#include <functional>

#include "embree_core/condition.h"
#include "tests/minimal_support.h"

namespace vshift::painted {

using glm::dvec3;
using minimal::Primitive, minimal::View, minimal::World;
using Paint = std::function<glm::vec3(int primitive, const dvec3& p)>;

/// Level, looking ahead: image x is ego -y, image y is ego -z.
inline View camera_at(const dvec3& at_m, int width = 320, int height = 240) {
    View v;
    v.intrinsics = {width, height, double(width), double(width), width / 2.0, height / 2.0};
    v.world_from_cam.rotation = glm::dmat3(dvec3(0, -1, 0), dvec3(0, 0, -1), dvec3(1, 0, 0));
    v.world_from_cam.translation_m = at_m;
    return v;
}

inline Primitive upright(double x_m, double y_m, double z_m, double half_y_m, double half_z_m) {
    Primitive p;
    p.world_from_local.rotation = glm::dmat3(dvec3(0, -1, 0), dvec3(0, 0, -1), dvec3(1, 0, 0));
    p.world_from_local.translation_m = {x_m, y_m, z_m};
    p.half_m = {half_y_m, half_z_m, 0};
    return p;
}

inline constexpr double wall_m = 10, card_m = 4, endless = 1e3;
inline constexpr int wall = 0, card = 1;

/// The wall fills the view; the card is 40x40 px at 4 m, up to its half pixel.
inline World card_before_wall() {
    return {upright(wall_m, 0, 0, endless, endless), upright(card_m, 0, 0, 20.0 / 320 * card_m, 20.0 / 320 * card_m)};
}

inline glm::vec3 affine_paint(int primitive, const dvec3& p) {
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

inline Shot shoot(const World& world, const View& view, const Paint& paint) {
    const minimal::Picture picture = render(world, view);
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

inline double worst_difference(const glm::vec3& a, const glm::vec3& b) {
    const glm::vec3 d = glm::abs(a - b);
    return double(std::max({d.x, d.y, d.z}));
}

inline bool same_bytes(const ColorImage& a, const ColorImage& b) {
    return a.width == b.width && a.height == b.height && !std::memcmp(a.data.data(), b.data.data(), a.size() * 12);
}

inline ShiftedCamera moved_camera(const Shot& own, const dvec3& by_m) {
    ShiftedCamera v{own.view.intrinsics, own.view.world_from_cam};
    v.world_from_cam.translation_m += by_m;
    return v;
}

/// The wall's pixels beside the card's upright edges as a camera mixes them there, whatever lies on either side.
inline void mix_beside_card(Shot& shot) {
    for (int y = 1; y + 1 < shot.color.height; ++y)
        for (int x = 1; x + 1 < shot.color.width; ++x)
            if (shot.primitive.at(x, y) == wall &&
                (shot.primitive.at(x - 1, y) == card || shot.primitive.at(x + 1, y) == card))
                shot.color.at(x, y) = glm::vec3(0.5f);
}

inline Mask holes_of(const Reprojection& r) {
    Mask m(r.sight.width, r.sight.height, 0);
    for (size_t i = 0; i < m.size(); ++i) m.data[i] = !is_seen(r.sight.data[i]);
    return m;
}

/// Whether a pixel's answer differs from a neighbour's, or it lies at the image's border.
inline bool at_border(const Mask& m, int x, int y) {
    for (int dy = -1; dy <= 1; ++dy)
        for (int dx = -1; dx <= 1; ++dx) {
            const int px = x + dx, py = y + dy;
            if (px < 0 || py < 0 || px >= m.width || py >= m.height || m.at(px, py) != m.at(x, y)) return true;
        }
    return false;
}

inline Sampler sampler_of(const Rig& rig, size_t i, const ShiftedCamera& v) {
    const SurfaceView& s = rig.surfaces[i];
    return {{s.inverse_depth, s.tears},
            rig.shots[i].color,
            projective_map(s.intrinsics, s.world_from_cam, v.intrinsics, v.world_from_cam)};
}

}  // namespace vshift::painted
