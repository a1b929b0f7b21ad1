// SPDX-License-Identifier: Apache-2.0
#include "embree_core/answer_views.h"

#include <cmath>
#include <glm/gtc/quaternion.hpp>
#include <memory>

#include "embree_core/holes.h"
#include "embree_core/sweep.h"

namespace vshift {

void note_centre(const Views& views, const Grid<float>& w, const Grid<uint8_t>& tears, Answer& out) {
    const glm::dvec3 centre = inverse(views.world_from_own).point(views.shifted.world_from_cam.translation_m);
    if (const auto u = project(views.own.intrinsics, centre); u && centre.z > 1e-6)
        out.centre_hidden = 1.0 / centre.z < double(surface_inverse_depth(w, tears, *u));
}

namespace {

bool is_recorded(const Request& request) {
    return chosen_view(request) == "recorded";
}

/// The cameras' geometry, rasterised or lifted, in the order of `cameras`.
struct Rig {
    std::vector<const CameraSpec*> cameras;
    int own = 0;
    std::vector<SurfaceView>& surfaces;
    LiftedRig lifted{};  ///< with method=embree
};

/// `target_centre_m`: the centre of the camera that the surfaces are seen from, which decides their tears.
Rig read_rig(const Recipe& recipe, const Views& views, const Request& request, FrameFiles& files,
             const glm::dvec3& target_centre_m, Answer& out) {
    Rig rig{cameras_used(recipe, request), 0, files.room().surfaces};
    rig.surfaces.resize(rig.cameras.size());
    for (size_t i = 0; i < rig.cameras.size(); ++i) {
        const CameraSpec* camera = rig.cameras[i];
        auto start = Clock::now();
        const DepthMap& depth = files.depth(request, camera->name);
        if (has_colors(request)) files.color(camera->name, request.frame);
        out.times.read_ms += ms_since(start);
        start = Clock::now();
        if (camera->name == views.own.name) rig.own = int(i);
        // The own camera is torn for V in both views: its tears bound what the shift can show.
        const glm::dvec3 centre_m =
            camera->name == views.own.name ? views.shifted.world_from_cam.translation_m : target_centre_m;
        surface_view(camera->intrinsics, recipe.world_from_cam(camera->name, request.frame), depth, centre_m,
                     files.depth_rules(request, camera->name), rig.surfaces[i]);
        out.times.lift_ms += ms_since(start);
    }
    const SurfaceView& own = rig.surfaces[size_t(rig.own)];
    out.invalid_px = own.invalid_px;
    out.sky_px = own.sky_px;
    note_centre(views, own.inverse_depth, own.tears, out);
    if (chosen_method(request) == "embree" && !is_recorded(request))
        rig.lifted = lifted_rig(recipe, views, request, files, out);
    return rig;
}

Sampler sampler_of(const SurfaceView& view, const ColorImage& image, const ShiftedCamera& shifted) {
    return {{view.inverse_depth, view.tears},
            image,
            projective_map(view.intrinsics, view.world_from_cam, shifted.intrinsics, shifted.world_from_cam)};
}

void holes_answer(const Recipe& recipe, const Views& views, const Request& request, FrameFiles& files, Answer& out) {
    const Rig rig = read_rig(recipe, views, request, files, views.shifted.world_from_cam.translation_m, out);
    const auto start = Clock::now();
    std::vector<Reprojection>& shown = files.room().shown;
    shown.resize(rig.surfaces.size());
    std::vector<RigView> rig_views;
    for (size_t i = 0; i < shown.size(); ++i) {
        bool any = true;
        if (rig.lifted.views.empty())
            any = reproject(rig.surfaces[i], views.shifted, nullptr, shown[i]);
        else
            cast(rig.lifted.views[i], views.shifted, shown[i]);
        rig_views.push_back({rig.surfaces[i].intrinsics, rig.surfaces[i].world_from_cam, any ? &shown[i] : nullptr});
    }
    ShiftedHoles h = holes(rig_views, rig.own, views.shifted);
    Channels& image = out.image;
    if (request.out == "holes") {
        image.add("hole", plane_of(h.hole));
        image.add("disoccluded", plane_of(h.disoccluded));
        image.add("outside", plane_of(h.outside));
    } else {
        const EdgeBand edge = request.edge == "drop" ? EdgeBand::drop : EdgeBand::keep;
        std::vector<Sampler> samplers;
        for (size_t k = 0; k < rig.surfaces.size(); ++k)
            samplers.push_back(
                sampler_of(rig.surfaces[k], files.color(rig.cameras[k]->name, request.frame), views.shifted));
        const Warped warped = warp(h, samplers, edge);
        image.add_color(warped.color);
        h.hole = warped.missing;
        image.add("Z", h.depth.data);
        image.add("hole", plane_of(h.hole));
    }
    out.times.cast_ms = ms_since(start);
}

/// The ego's pose `delay_s` after a frame, at the speed between that frame and its neighbour in time.
Pose delayed_ego(const Recipe& recipe, const std::string& camera, int frame, double delay_s) {
    const auto time_of = [&](const FrameSpec& f) {
        const auto own = f.cameras.find(camera);
        return own == f.cameras.end() ? f.timestamp_s : own->second.timestamp_s;
    };
    const FrameSpec& now = recipe.frame(frame);
    const FrameSpec* other = nullptr;
    for (const FrameSpec& f : recipe.frames) {
        const double gap = std::fabs(time_of(f) - time_of(now));
        if (gap > 0 && (!other || gap < std::fabs(time_of(*other) - time_of(now)))) other = &f;
    }
    if (!other)
        throw Error(ExitCode::bad_input, recipe.file.string() +
                                             ": noise_time_s: got a recipe with one moment in time, "
                                             "expected two frames to know the ego's speed");
    const double share = delay_s / (time_of(*other) - time_of(now));
    const Pose a = recipe.world_from_ego(camera, frame), b = recipe.world_from_ego(camera, other->index);
    const glm::dquat turn = glm::quat_cast(glm::transpose(a.rotation) * b.rotation);
    const double angle = glm::angle(turn);
    const glm::dmat3 part =
        angle > 1e-12 && angle < 6.28 ? glm::mat3_cast(glm::angleAxis(angle * share, glm::axis(turn))) : glm::dmat3(1);
    return {a.rotation * part, a.translation_m + share * (b.translation_m - a.translation_m)};
}

void seam_answer(const Recipe& recipe, const Views& views, const Request& request, FrameFiles& files, Answer& out) {
    const bool recorded = is_recorded(request), condition = request.out == "condition";
    const std::string arm = condition ? request.arm : "virtual_shift";
    // Neighbours are looked up in R for a recorded view, seen from V otherwise.
    const bool in_recorded = recorded && arm != "literal";
    const Rig rig =
        read_rig(recipe, views, request, files,
                 in_recorded ? views.world_from_own.translation_m : views.shifted.world_from_cam.translation_m, out);
    auto start = Clock::now();
    SeamOptions options;
    options.depth_tolerance = request.depth_tolerance;
    options.edge = request.edge == "drop" ? EdgeBand::drop : EdgeBand::keep;
    options.depth = !condition;
    std::vector<SeamCamera> cameras(rig.cameras.size());
    std::vector<std::unique_ptr<BentView>> bent(rig.cameras.size());
    std::vector<ColorImage> exposed(rig.cameras.size());
    for (size_t i = 0; i < cameras.size(); ++i) {
        const CameraSpec& spec = *rig.cameras[i];
        SeamCamera& camera = cameras[i];
        camera.name = spec.name;
        camera.surface = &rig.surfaces[i];
        camera.image = &files.color(spec.name, request.frame);
        if (!rig.lifted.views.empty()) camera.lifted = &rig.lifted.views[i];
        if (int(i) == rig.own) continue;
        camera.gain = degraded_gain(request.noise, spec.name);
        if (request.noise.bends_geometry()) {
            Pose pose = rig.surfaces[i].world_from_cam;
            if (request.noise.time_s > 0)
                pose =
                    compose(delayed_ego(recipe, spec.name, request.frame, degraded_delay_s(request.noise, spec.name)),
                            spec.ego_from_cam);
            bent[i] = std::make_unique<BentView>(
                BentView{spec.intrinsics, degraded_pose(request.noise, spec.name, pose),
                         degraded_inverse_depth(request.noise, spec.name, rig.surfaces[i].inverse_depth)});
            camera.bent = bent[i].get();
        }
    }
    if (request.match != "none")
        for (size_t i = 0; i < cameras.size(); ++i)
            if (int(i) != rig.own)
                cameras[i].gain *= fitted_gain(cameras[size_t(rig.own)], cameras[i], request.depth_tolerance,
                                               request.match == "color");

    ShiftedSeam& shifted = files.room().seam;
    Seam& seam = shifted.seam;
    if (arm == "splat") {
        seam = splatted_seam(cameras, rig.own, views.shifted);
    } else if (arm == "literal") {
        seam_shifted(cameras, rig.own, views.shifted, options, shifted);
        seam = literal_seam(*cameras[size_t(rig.own)].image, shifted, rig.own);
    } else if (!recorded) {
        seam_shifted(cameras, rig.own, views.shifted, options, shifted);
        if (options.depth) {
            out.seam_z = shifted.inverse_depth.data;
            for (float& w : out.seam_z) w = 1 / w;
        }
    } else {
        const SurfaceView& surface = rig.surfaces[size_t(rig.own)];
        const SweepCamera camera{views.own.intrinsics, views.shifted.intrinsics,
                                 compose(inverse(views.world_from_own), views.shifted.world_from_cam), request.clear_m,
                                 files.depth_rules(request, views.own.name)};
        Sweeper sweeper;
        Grid<uint8_t> classes;
        sweeper.classes(camera, files.depth(request, views.own.name), classes);
        Mask lost(classes.width, classes.height);
        for (size_t i = 0; i < lost.size(); ++i) lost.data[i] = (classes.data[i] & (occluded_bit | outside_bit)) != 0;
        if (arm == "double_warp") {
            Reprojection shown;
            if (!reproject(surface, views.shifted, nullptr, shown)) {
                shown.sight = Grid<Sight>(lost.width, lost.height, Sight::none);
                shown.inverse_depth = Grid<float>(lost.width, lost.height, 0);
                shown.source_px = Grid<glm::vec2>(lost.width, lost.height, glm::vec2(0));
            }
            const Sampler sampler = sampler_of(surface, *cameras[size_t(rig.own)].image, views.shifted);
            ColorImage& twice = exposed[size_t(rig.own)];
            twice = *cameras[size_t(rig.own)].image;
            warp_twice(surface, views.shifted, warp(shown, sampler, options.edge), shown, options.depth_tolerance,
                       twice, lost);
            cameras[size_t(rig.own)].image = &twice;
        }
        seam = seam_recorded(cameras, rig.own, lost, options);
    }
    Channels& image = out.image;
    if (condition) {
        Condition& c = files.room().condition;
        condition_of(seam, rig.own, request.stride, c);
        image.add_color(c.color);
        image.add("own", c.own.data);
        image.add("neighbor", c.neighbor.data);
        image.add("hole", c.hole.data);
        image.metadata["vshift.arm"] = arm;
        image.metadata["vshift.stride"] = std::to_string(request.stride);
    } else {
        image.add_color(seam.color);
        image.add("source", {seam.source.data.begin(), seam.source.data.end()});
    }
    image.metadata["vshift.view"] = chosen_view(request);
    image.metadata["vshift.match"] = request.match;
    std::string names;
    for (const CameraSpec* camera : rig.cameras) names += (names.empty() ? "" : " ") + camera->name;
    image.metadata["vshift.sources"] = names;
    out.times.cast_ms = ms_since(start);
}

}  // namespace

LiftedRig lifted_rig(const Recipe& recipe, const Views& views, const Request& request, FrameFiles& files, Answer& out) {
    LiftedRig rig;
    for (const CameraSpec* camera : cameras_used(recipe, request)) {
        auto start = Clock::now();
        const DepthMap& depth = files.depth(request, camera->name);
        out.times.read_ms += ms_since(start);
        start = Clock::now();
        if (camera->name == views.own.name) rig.own = int(rig.views.size());
        const Pose world_from_cam = recipe.world_from_cam(camera->name, request.frame);
        LiftedMesh mesh =
            lift_towards(camera->intrinsics, world_from_cam, depth, views.shifted.world_from_cam.translation_m,
                         request.tolerance_px, files.depth_rules(request, camera->name));
        out.times.lift_ms += ms_since(start);
        start = Clock::now();
        rig.views.push_back(build_view(camera->name, world_from_cam, std::move(mesh)));
        out.times.build_ms += ms_since(start);
        const LiftedView& view = rig.views.back();
        out.kept_quads += view.mesh.kept.size();
        out.torn_quads += view.mesh.torn.size();
        out.triangles += view.mesh.kept_triangles + 2 * view.mesh.torn.size();
        out.bvh_bytes += bvh_bytes(view);
    }
    const LiftedMesh& own = rig.views[size_t(rig.own)].mesh;
    out.invalid_px = own.invalid_px;
    out.sky_px = own.sky_px;
    note_centre(views, own.inverse_depth, own.tears, out);
    return rig;
}

void view_answer(const Recipe& recipe, const Views& views, const Request& request, FrameFiles& files, Answer& out) {
    if (request.out == "seam" || request.out == "condition")
        seam_answer(recipe, views, request, files, out);
    else
        holes_answer(recipe, views, request, files, out);
}

}  // namespace vshift
