// SPDX-License-Identifier: Apache-2.0
#include "inpaint/street_pairs.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>

#include "embree_core/condition.h"
#include "embree_core/fill.h"
#include "embree_core/srgb.h"
#include "embree_core/sweep.h"

namespace vshift::inpaint {
namespace {

constexpr int color_samples = 2;  // a side of a pixel
constexpr float outside_weight = 0.1f;
constexpr double most_shift_m = 4;

/// The part of the planes at (x0, y0), mirrored if asked: `width` and `height` are at most theirs.
PairPlanes part_of(const PairPlanes& p, int x0, int y0, int width, int height, bool mirrored) {
    PairPlanes out;
    out.width = width;
    out.height = height;
    for (auto plane : {&PairPlanes::target, &PairPlanes::fill, &PairPlanes::hole, &PairPlanes::neighbor,
                       &PairPlanes::inverse_depth, &PairPlanes::weight, &PairPlanes::texture}) {
        const size_t whole = size_t(p.width) * size_t(p.height), channels = (p.*plane).size() / whole;
        (out.*plane).reserve(channels * size_t(width) * size_t(height));
        for (size_t c = 0; c < channels; ++c)
            for (int y = y0; y < y0 + height; ++y) {
                const float* row = (p.*plane).data() + c * whole + size_t(y) * size_t(p.width) + x0;
                for (int x = 0; x < width; ++x) (out.*plane).push_back(row[mirrored ? width - 1 - x : x]);
            }
    }
    return out;
}

size_t lost_pixels(const Grid<uint8_t>& classes, Mask& hole) {
    hole = Mask(classes.width, classes.height);
    size_t count = 0;
    for (size_t i = 0; i < classes.size(); ++i) count += hole.data[i] = (classes.data[i] & (occluded_bit | outside_bit)) != 0;
    return count;
}

/// In the frame of the ego: its pose does not matter.
ShiftedCamera shifted_camera(const RecordedViews::View& view, const Shift& shift) {
    return {view.camera.intrinsics, shifted_ego_from_cam(view.camera.ego_from_cam, shift)};
}

/// The rig that a view belongs to, as the seam takes it.
struct RigSurfaces {
    std::vector<SurfaceView> surfaces;
    std::vector<SeamCamera> cameras;

    RigSurfaces(const RecordedViews& recorded, size_t view, const glm::dvec3& towards_m) {
        const size_t first = view - view % recorded.rig_size;
        for (size_t i = first; i < first + recorded.rig_size; ++i) {
            const auto& [color, depth, camera, lane_m] = recorded.views[i];
            surfaces.push_back(surface_view(camera.intrinsics, camera.ego_from_cam, depth, towards_m));
        }
        for (size_t i = 0; i < surfaces.size(); ++i)
            cameras.push_back({recorded.views[first + i].camera.name, &surfaces[i], &recorded.views[first + i].color, nullptr,
                               glm::vec3(1), nullptr});
    }
};

Sampler sampler_of(const SurfaceView& surface, const ColorImage& color, const ShiftedCamera& v) {
    return Sampler(SurfaceField{surface.inverse_depth, surface.tears}, color,
                   projective_map(surface.intrinsics, surface.world_from_cam, v.intrinsics, v.world_from_cam));
}

struct Sources {
    Mask hole, neighbor;
};
Sources sources_of(const Seam& seam, int own) {
    Sources s{Mask(seam.color.width, seam.color.height), Mask(seam.color.width, seam.color.height)};
    for (size_t i = 0; i < seam.source.size(); ++i) {
        s.hole.data[i] = seam.source.data[i] < 0;
        s.neighbor.data[i] = seam.source.data[i] >= 0 && seam.source.data[i] != own;
    }
    return s;
}

/// The recorded view warped there and back; what does not come back is lost as well. False: V sees nothing of it.
bool warp_there_and_back(const RecordedViews::View& view, const ShiftedCamera& v, ColorImage& color, Mask& lost) {
    const SurfaceView surface =
        surface_view(view.camera.intrinsics, view.camera.ego_from_cam, view.depth, v.world_from_cam.translation_m);
    Reprojection shown;
    if (!reproject(surface, v, nullptr, shown)) return false;
    warp_twice(surface, v, warp(shown, sampler_of(surface, view.color, v), EdgeBand::drop), shown, same_surface_share, color,
               lost);
    return true;
}

/// In R: what V loses is the hole, or the neighbours' pixels.
PairPlanes recorded_pair(const RecordedViews& recorded, size_t chosen, const Shift& shift, Arm arm) {
    thread_local Sweeper sweeper;
    const RecordedViews::View& view = recorded.views[chosen];
    const ShiftedCamera v = shifted_camera(view, shift);
    SweepCamera camera;
    camera.recorded = camera.shifted = view.camera.intrinsics;
    camera.recorded_from_shifted = compose(inverse(view.camera.ego_from_cam), v.world_from_cam);
    Grid<uint8_t> classes;
    sweeper.classes(camera, view.depth, classes);
    Mask lost;
    if (lost_pixels(classes, lost) == lost.size()) return {};
    ColorImage color = view.color;
    if ((arm == Arm::double_warp || arm == Arm::there_and_back) && !warp_there_and_back(view, v, color, lost)) return {};
    PairPlanes pair;
    if (!has_neighbors(arm)) {
        pair = planes_of(color, view.depth, lost, &view.color);
    } else {
        const int own = int(chosen % recorded.rig_size);
        RigSurfaces rig(recorded, chosen, view.camera.ego_from_cam.translation_m);
        rig.cameras[size_t(own)].image = &color;
        const Seam seam = seam_recorded(rig.cameras, own, lost, {});
        const Sources from = sources_of(seam, own);
        pair = planes_of(seam.color, view.depth, from.hole, &view.color, &from.neighbor);
    }
    pair.weight.resize(classes.size());
    for (size_t i = 0; i < classes.size(); ++i) {
        const bool occluded = (classes.data[i] & (occluded_bit | outside_bit)) == occluded_bit;
        pair.weight[i] = occluded ? 1.0f : classes.data[i] & outside_bit ? outside_weight : 0.0f;
    }
    return pair;
}

/// In V: the own camera's points, and all cameras' as the target, which is not known where none of them fell.
PairPlanes splatted_pair(const RecordedViews& recorded, size_t chosen, const Shift& shift) {
    const int own = int(chosen % recorded.rig_size);
    const RecordedViews::View& view = recorded.views[chosen];
    const ShiftedCamera v = shifted_camera(view, shift);
    const RigSurfaces rig(recorded, chosen, v.world_from_cam.translation_m);
    const Seam target = splatted_seam(rig.cameras, own, v);
    Reprojection shown;
    if (!reproject(rig.surfaces[size_t(own)], v, nullptr, shown)) return {};
    const ShiftedHoles seen = holes({{view.camera.intrinsics, view.camera.ego_from_cam, &shown}}, 0, v);
    Mask hole(target.color.width, target.color.height);
    size_t holes = 0;
    for (size_t i = 0; i < hole.size(); ++i) holes += hole.data[i] = target.source.data[i] != own;
    if (holes == hole.size()) return {};
    PairPlanes pair = planes_of(target.color, seen.depth, hole, &target.color);
    pair.weight.resize(hole.size());
    for (size_t i = 0; i < hole.size(); ++i)
        pair.weight[i] = target.source.data[i] < 0 || !hole.data[i] ? 0.0f : seen.outside.data[i] ? outside_weight : 1.0f;
    return pair;
}

}  // namespace

vshift_inpaint_views PairPlanes::views() const {
    return {1,           height,          width,       fill.data(), hole.data(), neighbor.data(), inverse_depth.data(),
            target.empty() ? nullptr : target.data(),
            weight.empty() ? nullptr : weight.data(),
            texture.empty() ? nullptr : texture.data(),
            seen.empty() ? nullptr : seen.data()};
}

std::vector<float> display_planes(const ColorImage& image) {
    const size_t n = image.size();
    std::vector<float> planes(3 * n);
    tbb::parallel_for(tbb::blocked_range<size_t>(0, n), [&](const auto& some) {
        for (size_t i = some.begin(); i < some.end(); ++i)
            for (int c = 0; c < 3; ++c) planes[size_t(c) * n + i] = float(srgb_from_linear(double(image.data[i][c])));
    });
    return planes;
}

PairPlanes planes_of(const ColorImage& color, const DepthMap& own_depth, const Mask& hole, const ColorImage* target,
                     const Mask* neighbor) {
    DepthMap depth = own_depth;
    for (size_t i = 0; neighbor && i < depth.size(); ++i)
        if (neighbor->data[i]) depth.data[i] = std::numeric_limits<float>::quiet_NaN();
    PairPlanes p;
    p.width = color.width;
    p.height = color.height;
    p.fill = display_planes(fill_background({color, hole, depth}));
    if (target) p.target = display_planes(*target);
    const size_t n = color.size();
    p.hole.resize(n);
    p.neighbor.assign(n, 0);
    p.inverse_depth.resize(n);
    for (size_t i = 0; i < n; ++i) {
        p.hole[i] = hole.data[i] ? 1 : 0;
        if (neighbor) p.neighbor[i] = neighbor->data[i] ? 1 : 0;
        p.inverse_depth[i] = !hole.data[i] && is_measured(depth.data[i]) ? 1 / depth.data[i] : 0;
    }
    return p;
}

const std::vector<std::string>& arm_names() {
    static const std::vector<std::string> names{"extrapolation", "virtual_shift", "seam", "double_warp", "there_and_back"};
    return names;
}

RecordedViews record_frame(const analytic::StreetScene& street, int frame, int width, double lane_m) {
    RecordedViews out;
    for (analytic::RigCamera& camera : analytic::six_camera_rig(width, width * 9 / 16)) {
        camera.ego_from_cam.translation_m.y += lane_m;
        const TrueCamera at = analytic::recorded_camera(camera, frame);
        out.views.push_back({analytic::street_color(street, at, color_samples), cast_camera(street.scene, at).depth, camera, lane_m});
    }
    out.rig_size = out.views.size();
    return out;
}

RecordedViews record_streets(const std::vector<uint32_t>& seeds, int frames, int width, double lanes_m,
                             const std::function<void(size_t, size_t)>& show) {
    RecordedViews out;
    for (const uint32_t seed : seeds) {
        const analytic::StreetScene street = analytic::build_street(seed);
        for (int f = 0; f < frames; ++f) {
            show(out.views.size(), seeds.size() * size_t(frames) * out.rig_size);
            analytic::Stream random(seed, uint32_t(f) + 41);
            RecordedViews rig = record_frame(street, frames == 1 ? 0 : f * (analytic::most_frames - 1) / (frames - 1), width,
                                             random.within(-lanes_m, lanes_m));
            out.rig_size = rig.rig_size;
            std::move(rig.views.begin(), rig.views.end(), std::back_inserter(out.views));
        }
    }
    return out;
}

PairPlanes training_pair(const RecordedViews& recorded, uint64_t seed, uint64_t number, int crop_px, Arm arm) {
    analytic::Stream random(uint32_t(seed * 7919 + number), uint32_t(number >> 20) + 17);
    for (;;) {
        const size_t chosen = size_t(random.whole(0, int(recorded.views.size()) - 1));
        Shift shift;
        shift.translation_m = {random.within(-1, 1), random.within(0.5, most_shift_m) * (random.chance(0.5) ? 1 : -1), 0};
        if (std::abs(recorded.views[chosen].lane_m + shift.translation_m.y) > most_shift_m) shift.translation_m.y *= -1;
        PairPlanes pair = arm == Arm::extrapolation ? splatted_pair(recorded, chosen, shift)
                                                    : recorded_pair(recorded, chosen, shift, arm);
        if (std::find(pair.weight.begin(), pair.weight.end(), 1.0f) == pair.weight.end()) continue;
        return crop_px == 0 ? pair : cropped_pair(pair, crop_px, random);
    }
}

PairPlanes cropped_pair(const PairPlanes& pair, int crop_px, analytic::Stream& random) {
    std::vector<size_t> centers;  // what weighs most
    for (size_t i = 0; i < pair.weight.size(); ++i)
        if (pair.weight[i] == 1) centers.push_back(i);
    // Around an occluded pixel, not always in the middle.
    const size_t at = centers[size_t(random.whole(0, int(centers.size()) - 1))];
    const int width = std::min(crop_px, pair.width), height = std::min(crop_px, pair.height);
    const int x = int(at % size_t(pair.width)) - random.whole(0, width - 1);
    const int y = int(at / size_t(pair.width)) - random.whole(0, height - 1);
    return part_of(pair, std::clamp(x, 0, pair.width - width), std::clamp(y, 0, pair.height - height), width, height,
                   random.chance(0.5));
}

TrueShiftedView true_shifted_view(const analytic::StreetScene& street, const RecordedViews& recorded, size_t own, int frame,
                                  const Shift& shift, bool with_seam) {
    const RecordedViews::View& view = recorded.views[own];
    const ShiftedCamera v = shifted_camera(view, shift);
    const RigSurfaces rig(recorded, own, v.world_from_cam.translation_m);
    const SurfaceView& surface = rig.surfaces[own];
    Reprojection shown;
    const bool any = reproject(surface, v, nullptr, shown);
    const ShiftedHoles seen = holes({{surface.intrinsics, surface.world_from_cam, any ? &shown : nullptr}}, 0, v);
    TrueShiftedView out{warp(seen, {sampler_of(surface, view.color, v)}, EdgeBand::drop), seen.depth,
                        analytic::street_color(street, analytic::shifted_camera(view.camera, frame, shift), color_samples),
                        seen.disoccluded, seen.outside, {}, {}};
    out.planes = planes_of(out.warped.color, seen.depth, out.warped.missing, &out.truth);
    if (!with_seam) return out;
    const ShiftedSeam seam = seam_shifted(rig.cameras, int(own), v, {});
    const Sources from = sources_of(seam.seam, int(own));
    out.seam_planes = planes_of(seam.seam.color, seen.depth, from.hole, &out.truth, &from.neighbor);
    return out;
}

}  // namespace vshift::inpaint
