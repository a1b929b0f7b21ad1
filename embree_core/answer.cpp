// SPDX-License-Identifier: Apache-2.0
#include "embree_core/answer.h"

#include <charconv>
#include <chrono>
#include <cmath>

#include "embree_core/answer_views.h"
#include "embree_core/field_mask.h"
#include "embree_core/mask.h"
#include "embree_core/sweep.h"
#include "embree_core/version.h"

namespace vshift {
namespace {

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

}  // namespace

bool has_colors(const Request& request) {
    return request.out == "warp" || request.out == "seam" || request.out == "condition";
}

std::vector<const CameraSpec*> cameras_used(const Recipe& recipe, const Request& request) {
    if (request.from == Source::self && request.out != "seam" && request.out != "condition")
        return {&recipe.camera(request.camera)};
    std::vector<const CameraSpec*> cameras;
    for (const CameraSpec& camera : recipe.cameras) cameras.push_back(&camera);
    return cameras;
}

std::vector<std::filesystem::path> input_files(const Recipe& recipe, const Request& request) {
    std::vector<std::filesystem::path> files;
    for (const CameraSpec* camera : cameras_used(recipe, request)) {
        if (!camera->depth.empty()) files.push_back(recipe.path(camera->depth, request.frame));
        if (has_colors(request) && !camera->image.empty()) files.push_back(recipe.path(camera->image, request.frame));
    }
    return files;
}

FrameFiles::FrameFiles(const Recipe& recipe) : recipe_(recipe), room_(std::make_unique<ViewRoom>()) {}
FrameFiles::~FrameFiles() = default;

void FrameFiles::keep_frame(int frame) {
    if (frame == frame_) return;
    depths_.clear();
    snapped_.clear();
    colors_.clear();
    frame_ = frame;
}

const DepthMap& FrameFiles::depth(const Request& request, const std::string& camera) {
    keep_frame(request.frame);
    if (!depths_.contains(camera)) {
        const CameraSpec& spec = recipe_.camera(camera);
        if (spec.depth.empty())
            throw Error(ExitCode::bad_input,
                        recipe_.file.string() + ": " + camera +
                            ": depth: got nothing, expected a depth map (vshift depth makes one from pictures)");
        depths_[camera] = read_depth(recipe_.path(spec.depth, request.frame), spec.depth_channel, spec.depth_scale_m,
                                     spec.intrinsics.width, spec.intrinsics.height, &stored_[camera]);
    }
    if (depth_source(request, camera) != DepthSource::mono) return depths_[camera];
    if (!snapped_.contains(camera)) snapped_[camera] = snap_edges(depths_[camera]);
    return snapped_[camera];
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
    const DepthMap& depth = files.depth(request, views.own.name);
    out.times.read_ms = ms_since(start);
    start = Clock::now();
    for (const float z : depth.data) {
        out.sky_px += is_sky(z);
        out.invalid_px += !is_sky(z) && !is_measured(z);
    }
    const SweepCamera camera{k, views.shifted.intrinsics,
                             compose(inverse(views.world_from_own), views.shifted.world_from_cam), request.clear_m,
                             files.depth_rules(request, views.own.name)};
    Sweeper sweeper;
    Grid<uint8_t> classes;
    sweeper.classes(camera, depth, classes);
    add_mask(masks_of(classes), out.image);
    if (request.certify) out.image.add("edge", plane_of(sweeper.edges(camera, depth, classes)));
    out.times.cast_ms = ms_since(start);
    const glm::dvec3 centre = camera.recorded_from_shifted.translation_m;
    if (const auto u = project(k, centre); u && centre.z > 1e-6 && in_image(k, *u)) {
        const float z = depth.at(int(u->x), int(u->y));
        out.centre_hidden = is_measured(z) && centre.z > double(z);
    }
}

/// A mask from the own depth map by rays against its height field.
void field_answer(const Views& views, const Request& request, FrameFiles& files, Answer& out) {
    auto start = Clock::now();
    const DepthMap& depth = files.depth(request, views.own.name);
    out.times.read_ms = ms_since(start);
    start = Clock::now();
    const DepthRules rules = files.depth_rules(request, views.own.name);
    const glm::dvec3& centre_m = views.shifted.world_from_cam.translation_m;
    SurfaceView surface = surface_view(views.own.intrinsics, views.world_from_own, depth, centre_m, rules);
    out.times.lift_ms = ms_since(start);
    start = Clock::now();
    const FieldView view = field_view(std::move(surface), rules.error, centre_m);
    out.times.build_ms = ms_since(start);
    out.invalid_px = view.surface.invalid_px, out.sky_px = view.surface.sky_px;
    out.tiles = view.field.tiles(), out.bvh_bytes = view.field.bytes();
    note_centre(views, view.surface.inverse_depth, view.surface.tears, out);
    start = Clock::now();
    add_mask(mask(view, depth, views.shifted, request.clear_m), out.image);
    out.times.cast_ms = ms_since(start);
}

/// A mask, from lifted meshes by casting rays.
void cast_answer(const Recipe& recipe, const Views& views, const Request& request, FrameFiles& files, Answer& out) {
    const LiftedRig rig = lifted_rig(recipe, views, request, files, out);
    const auto start = Clock::now();
    add_mask(mask(rig, views.shifted, request.clear_m), out.image);
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
    const int stride = request.out == "condition" ? request.stride : 1;
    out.image.width = (own.intrinsics.width + stride - 1) / stride;
    out.image.height = (own.intrinsics.height + stride - 1) / stride;
    const std::string method = chosen_method(request);
    if (method == "sweep")
        sweep_answer(views, request, files, out);
    else if (request.out == "mask" && request.from == Source::self && request.tolerance_px > 0)
        field_answer(views, request, files, out);
    else if (request.out == "mask")
        cast_answer(recipe, views, request, files, out);
    else
        view_answer(recipe, views, request, files, out);

    const glm::dvec3 s = request.shift.translation_m;
    const Intrinsics& full = own.intrinsics;
    const Intrinsics k{out.image.width,  out.image.height, full.fx / stride,
                       full.fy / stride, full.cx / stride, full.cy / stride};
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
    const Pose seen_from = chosen_view(request) == "recorded" ? views.world_from_own : views.shifted.world_from_cam;
    meta["vshift.worldToCamera"] = matrix_text(inverse(seen_from));
    meta["vshift.invalid_px"] = std::to_string(out.invalid_px);
    meta["vshift.sky_px"] = std::to_string(out.sky_px);
    meta["vshift.centre_hidden"] = out.centre_hidden ? "1" : "0";
    return out;
}

}  // namespace vshift
