// SPDX-License-Identifier: Apache-2.0
#include "scenes/trouble/trouble.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <random>

#include "embree_core/fill.h"
#include "embree_core/holes.h"
#include "embree_core/words.h"
#include "embree_core/score.h"
#include "embree_core/warp.h"
#include "scenes/analytic/street_mesh.h"

namespace vshift::trouble {
namespace {

using analytic::AnalyticStreet;
using analytic::Kind;
using analytic::MeshBuilder;
using analytic::RigCamera;
using analytic::StreetScene;
using glm::dvec3;
using glm::vec3;

constexpr int samples = 3;  // per pixel and side
constexpr uint32_t street_seed = 3;
constexpr float endless = std::numeric_limits<float>::infinity();

/// An upright pane across the street, its face towards -x.
struct Pane {
    double x, y0, y1, z0, z1;
    bool mirror;
};

/// The faulty thing is every triangle of `thing` from `first_fault` on, or the pane.
struct World {
    StreetScene street;
    uint32_t first_fault = std::numeric_limits<uint32_t>::max();
    std::optional<Pane> pane;
    std::optional<dvec3> photographed_from;  ///< the pane bears a picture taken from there
};

struct Sample {
    vec3 color{0};
    float t = endless;
    bool fault = false;
};

/// What a pane shows on a line of sight: what is behind it and a reflection, or the reflection alone.
vec3 pane_color(const World& world, const dvec3& point, const dvec3& direction) {
    const dvec3 reflected(-direction.x, direction.y, direction.z);
    const vec3 mirrored = ray_color(world.street, point + 1e-4 * reflected, reflected);
    if (world.pane->mirror) return 0.9f * mirrored;
    return 0.85f * ray_color(world.street, point + 1e-4 * direction, direction) + 0.15f * mirrored;
}

Sample look(const World& world, const dvec3& origin, const dvec3& direction) {
    Sample out;
    const Hit hit = world.street.scene.traced.intersect(vec3(origin), vec3(direction), 0, endless);
    if (hit) out.t = hit.t, out.fault = world.street.street.thing[hit.primitive] >= world.first_fault;
    if (world.pane && direction.x > 0) {
        const Pane& p = *world.pane;
        const double t = (p.x - origin.x) / direction.x;
        const dvec3 at = origin + t * direction;
        if (t > 0 && t < double(out.t) && at.y > p.y0 && at.y < p.y1 && at.z > p.z0 && at.z < p.z1)
            return {pane_color(world, at, world.photographed_from ? at - *world.photographed_from : direction),
                    float(t), true};
    }
    out.color = ray_color(world.street, origin, direction);
    return out;
}

/// `roof_line`: the fault is a pixel whose samples are part sky. `unmixed`: such a pixel's color is the mean of the
/// samples on the side, sky or not, of its centre alone, which is the side that its depth tells of.
View render_view(const World& world, const Intrinsics& k, const Pose& world_from_cam, bool roof_line, bool unmixed) {
    View out{ColorImage(k.width, k.height), DepthMap(k.width, k.height), Mask(k.width, k.height)};
    tbb::parallel_for(0, k.height, [&](int y) {
        for (int x = 0; x < k.width; ++x) {
            vec3 solid(0), open(0);
            int fault = 0, sky = 0;
            for (int s = 0; s < samples * samples; ++s) {
                const glm::dvec2 at(x + (s % samples + 0.5) / samples, y + (s / samples + 0.5) / samples);
                const dvec3 d = world_from_cam.rotation * ray(k, at);
                const Sample seen = look(world, world_from_cam.translation_m, d);
                if (s == samples * samples / 2) out.depth.at(x, y) = seen.t;
                (seen.t == endless ? open : solid) += seen.color;
                fault += seen.fault, sky += seen.t == endless;
            }
            const int all = samples * samples;
            if (!unmixed)
                out.color.at(x, y) = (solid + open) / float(all);
            else
                out.color.at(x, y) = is_sky(out.depth.at(x, y)) ? open / float(sky) : solid / float(all - sky);
            out.touched.at(x, y) = roof_line ? sky > 0 && sky < all : fault > 0;
        }
    });
    return out;
}

/// A crown of loose leaves, each 5 cm long, or the ball that they fill.
void add_crown(MeshBuilder& mesh, const dvec3& at, double radius_m, bool loose) {
    mesh.begin({});
    const vec3 green(0.10f, 0.22f, 0.05f);
    mesh.prism(Kind::pole, {at.x, at.y, -0.1}, {at.x, at.y, at.z}, 0.08, vec3(0.12f, 0.08f, 0.05f));
    if (!loose) return mesh.sphere(Kind::foliage, at, radius_m, green, 0.01);
    std::mt19937 engine(7);
    const auto random = [&] { return engine() / 4294967296.0; };
    for (int leaf = 0; leaf < 3500; ++leaf) {
        dvec3 p, a, b;
        do p = 2.0 * dvec3(random(), random(), random()) - 1.0;
        while (glm::dot(p, p) > 1);
        a = glm::normalize(dvec3(random(), random(), random()) - 0.5);
        b = glm::normalize(glm::cross(a, dvec3(random(), random(), random()) - 0.5));
        const dvec3 c = at + radius_m * p;
        mesh.quad(Kind::foliage, c - 0.025 * a, c + 0.018 * b, c + 0.025 * a, c - 0.018 * b,
                  green * float(0.6 + 0.8 * random()));
    }
}

void add_wires(MeshBuilder& mesh) {
    mesh.begin({});
    const vec3 black(0.03f);
    for (const double x : {7.0, 9.0, 12.0, 16.0, 22.0})  // 8 mm, over the street and along it
        mesh.prism(Kind::pole, {x, -12.3, 4.2 + 0.1 * x}, {x, 12.3, 4.0 + 0.1 * x}, 0.004, black, 6);
    for (const double y : {-3.0, 0.5, 4.0}) mesh.prism(Kind::pole, {3, y, 4.6}, {60, y, 5.2}, 0.004, black, 6);
    for (const double y : {-5.0, 5.0})
        for (double z = 0.5; z < 1.3; z += 0.25)  // a fence of strands
            mesh.prism(Kind::pole, {5, y, z}, {20, y, z}, 0.003, black, 6);
}

void add_car(MeshBuilder& mesh, double ahead_m) {
    mesh.begin({dvec3(ahead_m, 6.2, 0)});
    mesh.glazed_box({-2.1, -0.85, 0.25}, {2.1, 0.85, 0.95}, vec3(0.5f, 0.05f, 0.04f), vec3(0.35f, 0.03f, 0.03f), 3);
    mesh.glazed_box({-1.2, -0.75, 0.93}, {1.0, 0.75, 1.5}, vec3(0.5f, 0.05f, 0.04f), vec3(0.03f), 2);
}

/// `late`: as the camera that fires later sees it.
World make_world(const Scene& scene, bool fault, bool late, const dvec3& own_centre) {
    World world;
    MeshBuilder mesh(world.street.street);
    add_ground(mesh);
    add_buildings(mesh, street_seed);
    world.first_fault = world.street.street.things;
    if (scene.name == "foliage") add_crown(mesh, {9, 2.5, 3.2}, 1.3, fault);
    if (scene.name == "wires" && fault) add_wires(mesh);
    if (scene.name == "moving_car") add_car(mesh, 9.0 + (late && fault ? 0.75 : 0));  // 15 m/s, 50 ms
    if (scene.name == "glass" || scene.name == "mirror") {
        world.pane = Pane{8, -1.5, 3.0, 0.3, 3.0, scene.name == "mirror"};
        if (!fault) world.photographed_from = own_centre;
    }
    world.street.scene.traced = TracedScene(world.street.street.vertices, world.street.street.triangles);
    return world;
}

Mask grown(const Mask& mask) {
    Mask out(mask.width, mask.height);
    for (int y = 0; y < mask.height; ++y)
        for (int x = 0; x < mask.width; ++x)
            for (int j = std::max(0, y - 1); j <= std::min(mask.height - 1, y + 1); ++j)
                for (int i = std::max(0, x - 1); i <= std::min(mask.width - 1, x + 1); ++i)
                    out.at(x, y) |= mask.at(i, j);
    return out;
}

struct Result {
    ColorImage color;
    ShiftedHoles seen;
};

Result warp_and_fill(const Views& views, const Shift& shift, bool rig) {
    const size_t cameras = rig ? views.rig.size() : 1;
    const ShiftedCamera v{views.rig[0].intrinsics, analytic::shifted_camera(views.rig[0], 0, shift).world_from_cam};
    std::vector<SurfaceView> surfaces;
    std::vector<Reprojection> shown(cameras);
    std::vector<RigView> rig_views;
    std::vector<Sampler> samplers;
    for (size_t c = 0; c < cameras; ++c) {
        const TrueCamera camera = analytic::recorded_camera(views.rig[c], 0);
        surfaces.push_back(surface_view(camera.intrinsics, camera.world_from_cam, views.recorded[c].depth,
                                        v.world_from_cam.translation_m));
    }
    for (size_t c = 0; c < cameras; ++c) {
        const SurfaceView& s = surfaces[c];
        const bool any = reproject(s, v, nullptr, shown[c]);
        rig_views.push_back({s.intrinsics, s.world_from_cam, any ? &shown[c] : nullptr});
        samplers.emplace_back(SurfaceField{s.inverse_depth, s.tears}, views.recorded[c].color,
                              projective_map(s.intrinsics, s.world_from_cam, v.intrinsics, v.world_from_cam));
    }
    Result out{{}, holes(rig_views, 0, v)};
    const Warped warped = warp(out.seen, samplers, EdgeBand::drop);
    out.color = fill_background({warped.color, warped.missing, out.seen.depth});
    return out;
}

}  // namespace

const std::vector<Scene>& scenes() {
    static const std::vector<Scene> all = {
        {"glass", "a pane whose depth is recorded while its color is what stands behind it, and a reflection",
         "the recorded picture pasted on the pane"},
        {"mirror", "a mirror: its own depth, the color of what it reflects", "the recorded picture pasted on the pane"},
        {"foliage", "a crown of 3500 loose leaves of 5 cm", "a solid ball in the crown's place"},
        {"wires", "wires of 6 and 8 mm, far below a pixel", "no wires"},
        {"moving_car", "a car at 15 m/s; the neighbour camera fires 50 ms after the own", "the car parked", true},
        {"roof_line", "anti-aliased color over depth that is sky or roof",
         "colors of roof and sky apart, each with its own depth"}};
    return all;
}

const Scene& scene(const std::string& name) {
    std::vector<std::string> names;
    for (const Scene& s : scenes()) {
        if (s.name == name) return s;
        names.push_back(s.name);
    }
    throw Error(ExitCode::bad_input,
                "scene: got '" + name +
                    "', expected one of glass, mirror, foliage, wires, moving_car, roof_line (nearest: " +
                    nearest_word(name, names) + ")");
}

Views render(const Scene& scene, bool fault, const Shift& shift, int width) {
    if (width < 64 || width > 4096)
        throw Error(ExitCode::bad_input, "width: got " + std::to_string(width) + ", expected 64 to 4096");
    Views out;
    const std::vector<RigCamera> six = analytic::six_camera_rig(width, std::max(36, width * 9 / 16));
    out.rig = {six[0], six[1]};  // CAM_FRONT, CAM_FRONT_LEFT
    const bool roof = scene.name == "roof_line", unmixed = roof && !fault;
    const dvec3 own = analytic::recorded_camera(out.rig[0], 0).world_from_cam.translation_m;
    const World world = make_world(scene, fault, false, own);
    for (const RigCamera& camera : out.rig) {
        const TrueCamera c = analytic::recorded_camera(camera, 0);
        const bool late = scene.name == "moving_car" && &camera != &out.rig[0];
        out.recorded.push_back(
            late ? render_view(make_world(scene, fault, true, own), c.intrinsics, c.world_from_cam, roof, unmixed)
                 : render_view(world, c.intrinsics, c.world_from_cam, roof, unmixed));
        if (!scene.rig) break;
    }
    if (!scene.rig) out.rig.resize(1);
    const TrueCamera v = analytic::shifted_camera(out.rig[0], 0, shift);
    out.shifted = render_view(world, v.intrinsics, v.world_from_cam, roof, false);
    return out;
}

Outcome run(const Scene& scene, const Shift& shift, int width) {
    const Views faulty = render(scene, true, shift, width), clean = render(scene, false, shift, width);
    const Result got = warp_and_fill(faulty, shift, scene.rig), control = warp_and_fill(clean, shift, scene.rig);
    Outcome out;
    out.recorded = faulty.recorded[0].color;
    out.truth = faulty.shifted.color;
    out.result = got.color;
    out.control = control.color;
    Mask shown = faulty.shifted.touched, elsewhere(shown.width, shown.height);
    for (size_t i = 0; i < shown.size(); ++i) {
        const int source = got.seen.source.data[i];
        if (source < 0) continue;
        const Mask& touched = faulty.recorded[size_t(source)].touched;
        const glm::vec2 u = got.seen.source_px.data[i];
        shown.data[i] |=
            touched.at(std::clamp(int(u.x), 0, touched.width - 1), std::clamp(int(u.y), 0, touched.height - 1));
    }
    out.affected = grown(shown);
    for (size_t i = 0; i < shown.size(); ++i) {
        out.affected_px += out.affected.data[i];
        elsewhere.data[i] = !out.affected.data[i] && got.seen.source.data[i] >= 0;
    }
    out.affected_share = double(out.affected_px) / double(shown.size());
    const ColorImage truth = srgb_from_linear(out.truth), result = srgb_from_linear(out.result);
    out.psnr_db = psnr_db(result, truth, &out.affected);
    out.elsewhere_psnr_db = psnr_db(result, truth, &elsewhere);
    out.control_psnr_db = psnr_db(srgb_from_linear(out.control), srgb_from_linear(clean.shifted.color), &out.affected);
    return out;
}

}  // namespace vshift::trouble
