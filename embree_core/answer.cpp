// SPDX-License-Identifier: Apache-2.0
#include "embree_core/answer.h"

#include <charconv>
#include <chrono>
#include <cmath>

#include "embree_core/holes.h"
#include "embree_core/mask.h"
#include "embree_core/sweep.h"
#include "embree_core/version.h"

namespace vshift {
namespace {

using Clock = std::chrono::steady_clock;

double ms_since(Clock::time_point start) {
    return std::chrono::duration<double, std::milli>(Clock::now() - start).count();
}

std::vector<float> plane_of(const Mask& mask) {
    return {mask.data.begin(), mask.data.end()};
}

std::string number(double value) {
    char text[32];
    return {text, std::to_chars(text, text + sizeof text, value, std::chars_format::general, 9).ptr};
}

/// Row-major numbers of a 4x4 camera_from_world, separated by spaces.
std::string matrix_text(const Pose& pose) {
    std::string text;
    for (int row = 0; row < 4; ++row)
        for (int column = 0; column < 4; ++column) {
            const double value = row == 3      ? column == 3
                                 : column == 3 ? pose.translation_m[row]
                                               : pose.rotation[column][row];
            text += (text.empty() ? "" : " ") + number(value);
        }
    return text;
}

bool has_colors(const Request& request) {
    return request.out == "warp";
}

/// Whose geometry answers the request.
std::vector<const CameraSpec*> lifted_cameras(const Recipe& recipe, const Request& request) {
    if (request.from == Source::self) return {&recipe.camera(request.camera)};
    std::vector<const CameraSpec*> cameras;
    for (const CameraSpec& camera : recipe.cameras) cameras.push_back(&camera);
    return cameras;
}

}  // namespace

std::vector<std::filesystem::path> input_files(const Recipe& recipe, const Request& request) {
    std::vector<std::filesystem::path> files;
    for (const CameraSpec* camera : lifted_cameras(recipe, request)) {
        files.push_back(recipe.path(camera->depth, request.frame));
        if (has_colors(request) && !camera->image.empty()) files.push_back(recipe.path(camera->image, request.frame));
    }
    return files;
}

void FrameFiles::keep_frame(int frame) {
    if (frame == frame_) return;
    depths_.clear();
    colors_.clear();
    frame_ = frame;
}

const DepthMap& FrameFiles::depth(const std::string& camera, int frame) {
    keep_frame(frame);
    if (const auto found = depths_.find(camera); found != depths_.end()) return found->second;
    const CameraSpec& spec = recipe_.camera(camera);
    return depths_[camera] = read_depth(recipe_.path(spec.depth, frame), spec.depth_channel, spec.depth_scale_m,
                                        spec.intrinsics.width, spec.intrinsics.height, &stored_[camera]);
}

DepthSource FrameFiles::depth_source(const Request& request, const std::string& camera) const {
    if (request.depth_source) return *request.depth_source;
    if (const auto stated = recipe_.camera(camera).depth_source) return *stated;
    switch (stored_.at(camera)) {
        case SampleType::float16:
            return DepthSource::half;
        case SampleType::uint16:
            return DepthSource::mm16;
        default:
            return DepthSource::exact;
    }
}

DepthRules FrameFiles::depth_rules(const Request& request, const std::string& camera) const {
    const bool in_steps = stored_.at(camera) == SampleType::uint16;
    return vshift::depth_rules(depth_source(request, camera), depths_.at(camera),
                               in_steps ? recipe_.camera(camera).depth_scale_m : 0.001);
}

const ColorImage& FrameFiles::color(const std::string& camera, int frame) {
    keep_frame(frame);
    if (const auto found = colors_.find(camera); found != colors_.end()) return found->second;
    const CameraSpec& spec = recipe_.camera(camera);
    if (spec.image.empty())
        throw Error(ExitCode::bad_input,
                    recipe_.file.string() + ": " + camera + ": image: got nothing, expected a picture to warp");
    return colors_[camera] = read_color(recipe_.path(spec.image, frame), spec.intrinsics.width, spec.intrinsics.height);
}

namespace {

/// The own camera and V, in the world.
struct Views {
    const CameraSpec& own;
    Pose world_from_own;
    ShiftedCamera shifted;
};

void add_mask(const RecordedMasks& m, Channels& image) {
    image.add("lost", plane_of(m.lost));
    image.add("occluded", plane_of(m.occluded));
    image.add("outside", plane_of(m.outside));
    image.add("unknown", plane_of(m.unknown));
    image.add("unseen", plane_of(m.unseen));
}

/// A mask from the own depth map by sweeping.
void sweep_answer(const Views& views, const Request& request, FrameFiles& files, Answer& out) {
    const Intrinsics& k = views.own.intrinsics;
    auto start = Clock::now();
    const DepthMap& depth = files.depth(views.own.name, request.frame);
    out.times.read_ms = ms_since(start);
    start = Clock::now();
    for (const float z : depth.data) {
        out.sky_px += is_sky(z);
        out.invalid_px += !is_sky(z) && !is_measured(z);
    }
    const SweepCamera camera{k, views.shifted.intrinsics,
                             compose(inverse(views.world_from_own), views.shifted.world_from_cam), request.clear_m,
                             files.depth_rules(request, views.own.name)};
    const double px_per_inverse_depth = k.fx * glm::length(camera.recorded_from_shifted.translation_m);
    Sweeper sweeper;
    Grid<uint8_t> classes;
    sweeper.classes(camera, camera.rules.snap ? snap_edges(depth, px_per_inverse_depth) : depth, classes);
    add_mask(masks_of(classes), out.image);
    out.times.cast_ms = ms_since(start);
    const glm::dvec3 centre = camera.recorded_from_shifted.translation_m;
    if (const auto u = project(k, centre); u && centre.z > 1e-6 && in_image(k, *u)) {
        const float z = depth.at(int(u->x), int(u->y));
        out.centre_hidden = is_measured(z) && centre.z > double(z);
    }
}

/// Any answer, from lifted meshes by casting rays.
void cast_answer(const Recipe& recipe, const Views& views, const Request& request, FrameFiles& files, Answer& out) {
    const CameraSpec& own = views.own;
    const ShiftedCamera& shifted = views.shifted;
    LiftedRig rig;
    std::vector<ColorImage> images;
    const bool colors = has_colors(request);
    for (const CameraSpec* lifted : lifted_cameras(recipe, request)) {
        const CameraSpec& camera = *lifted;
        auto start = Clock::now();
        const DepthMap& depth = files.depth(camera.name, request.frame);
        if (colors) images.push_back(files.color(camera.name, request.frame));
        out.times.read_ms += ms_since(start);
        start = Clock::now();
        if (camera.name == own.name) rig.own = int(rig.views.size());
        const Pose world_from_cam = recipe.world_from_cam(camera.name, request.frame);
        LiftedMesh mesh = lift_towards(camera.intrinsics, world_from_cam, depth, shifted.world_from_cam.translation_m,
                                       request.tolerance_px, files.depth_rules(request, camera.name));
        out.times.lift_ms += ms_since(start);
        start = Clock::now();
        rig.views.push_back(build_view(camera.name, world_from_cam, std::move(mesh)));
        out.times.build_ms += ms_since(start);
        out.kept_quads += rig.views.back().mesh.kept.size();
        out.torn_quads += rig.views.back().mesh.torn.size();
        out.triangles += rig.views.back().mesh.kept_triangles + 2 * rig.views.back().mesh.torn.size();
        out.bvh_bytes += bvh_bytes(rig.views.back());
    }
    const LiftedView& own_view = rig.views[size_t(rig.own)];
    out.invalid_px = own_view.mesh.invalid_px;
    out.sky_px = own_view.mesh.sky_px;
    const glm::dvec3 centre_own = inverse(own_view.world_from_cam).point(shifted.world_from_cam.translation_m);
    if (const auto u = project(own.intrinsics, centre_own); u && centre_own.z > 1e-6)
        out.centre_hidden = 1.0 / centre_own.z < double(surface_inverse_depth(own_view.mesh, *u));

    const auto start = Clock::now();
    Channels& image = out.image;
    if (request.out == "mask") {
        add_mask(mask(rig, shifted, request.clear_m), image);
    } else {
        const ShiftedHoles h = holes(rig, shifted);
        if (request.out == "holes") {
            image.add("hole", plane_of(h.hole));
            image.add("disoccluded", plane_of(h.disoccluded));
            image.add("outside", plane_of(h.outside));
        } else {
            const ColorImage warped = warp(rig, h, images);
            for (int c = 0; c < 3; ++c) {
                std::vector<float> plane(warped.size());
                for (size_t i = 0; i < plane.size(); ++i) plane[i] = warped.data[i][c];
                image.add(std::string(1, "RGB"[c]), std::move(plane));
            }
            image.add("Z", h.depth.data);
            image.add("hole", plane_of(h.hole));
        }
    }
    out.times.cast_ms = ms_since(start);
}

}  // namespace

Answer answer(const Recipe& recipe, const Request& request, FrameFiles& files) {
    const CameraSpec& own = recipe.camera(request.camera);
    const Views views{own,
                      recipe.world_from_cam(own.name, request.frame),
                      {own.intrinsics, compose(recipe.world_from_ego(own.name, request.frame),
                                               shifted_ego_from_cam(own.ego_from_cam, request.shift))}};
    Answer out;
    out.image.width = own.intrinsics.width;
    out.image.height = own.intrinsics.height;
    const std::string method = chosen_method(request);
    if (method == "sweep")
        sweep_answer(views, request, files, out);
    else
        cast_answer(recipe, views, request, files, out);

    const glm::dvec3 s = request.shift.translation_m;
    const Intrinsics& k = own.intrinsics;
    auto& meta = out.image.metadata;
    meta["vshift.version"] = version_string;
    meta["vshift.out"] = request.out;
    meta["vshift.camera"] = own.name;
    meta["vshift.frame"] = std::to_string(request.frame);
    meta["vshift.shift_m"] = number(s.x) + " " + number(s.y) + " " + number(s.z);
    meta["vshift.yaw_deg"] = number(request.shift.yaw_rad * degrees_per_radian);
    meta["vshift.from"] = request.from == Source::rig ? "rig" : "self";
    meta["vshift.method"] = method;
    if (request.tolerance_px > 0) meta["vshift.tolerance_px"] = number(request.tolerance_px);
    meta["vshift.clear_m"] = number(request.clear_m);
    meta["vshift.depth_source"] = depth_source_words()[size_t(files.depth_source(request, own.name))];
    meta["vshift.intrinsic"] =
        number(k.fx) + " 0 " + number(k.cx) + " 0 " + number(k.fy) + " " + number(k.cy) + " 0 0 1";
    const Pose seen_from = request.out == "mask" ? views.world_from_own : views.shifted.world_from_cam;
    meta["vshift.worldToCamera"] = matrix_text(inverse(seen_from));
    meta["vshift.invalid_px"] = std::to_string(out.invalid_px);
    meta["vshift.sky_px"] = std::to_string(out.sky_px);
    meta["vshift.centre_hidden"] = out.centre_hidden ? "1" : "0";
    return out;
}

}  // namespace vshift
