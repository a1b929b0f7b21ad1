// SPDX-License-Identifier: Apache-2.0
#include "inpaint/street_pairs.h"

#include <algorithm>
#include <cmath>

#include "embree_core/condition.h"
#include "embree_core/fill.h"
#include "embree_core/srgb.h"
#include "embree_core/sweep.h"
#include "scenes/analytic/street_mesh.h"

namespace vshift::inpaint {
namespace {

constexpr int color_samples = 2;  // a side of a pixel
constexpr float outside_weight = 0.1f;

/// The part of the planes at (x0, y0), mirrored if asked: `width` and `height` are at most theirs.
PairPlanes part_of(const PairPlanes& p, int x0, int y0, int width, int height, bool mirrored) {
    PairPlanes out;
    out.width = width;
    out.height = height;
    for (auto plane : {&PairPlanes::target, &PairPlanes::fill, &PairPlanes::hole, &PairPlanes::neighbor,
                       &PairPlanes::inverse_depth, &PairPlanes::weight}) {
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

/// The recorded view warped there and back; what does not come back is lost as well. False: V sees nothing of it.
bool warp_there_and_back(const RecordedViews::View& view, const Shift& shift, ColorImage& color, Mask& lost) {
    const Pose own = view.camera.ego_from_cam;
    const ShiftedCamera v{view.camera.intrinsics, shifted_ego_from_cam(own, shift)};
    const SurfaceView surface = surface_view(view.camera.intrinsics, own, view.depth, v.world_from_cam.translation_m);
    Reprojection shown;
    if (!reproject(surface, v, nullptr, shown)) return false;
    const Sampler sampler(SurfaceField{surface.inverse_depth, surface.tears}, view.color,
                          projective_map(surface.intrinsics, own, v.intrinsics, v.world_from_cam));
    color = view.color;
    warp_twice(surface, v, warp(shown, sampler, EdgeBand::drop), shown, same_surface_share, color, lost);
    return true;
}

}  // namespace

vshift_inpaint_views PairPlanes::views() const {
    return {1,           height,          width,       fill.data(), hole.data(), neighbor.data(), inverse_depth.data(),
            target.empty() ? nullptr : target.data(),
            weight.empty() ? nullptr : weight.data(),
            seen.empty() ? nullptr : seen.data()};
}

std::vector<float> display_planes(const ColorImage& image) {
    const size_t n = image.size();
    std::vector<float> planes(3 * n);
    for (size_t i = 0; i < n; ++i)
        for (int c = 0; c < 3; ++c) planes[size_t(c) * n + i] = float(srgb_from_linear(double(image.data[i][c])));
    return planes;
}

PairPlanes planes_of(const ColorImage& color, const DepthMap& depth, const Mask& hole, const ColorImage* target) {
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
        p.inverse_depth[i] = !hole.data[i] && is_measured(depth.data[i]) ? 1 / depth.data[i] : 0;
    }
    return p;
}

RecordedViews record_streets(const std::vector<uint32_t>& seeds, int frames, int width,
                             const std::function<void(size_t, size_t)>& show) {
    RecordedViews out;
    const auto rig = analytic::six_camera_rig(width, width * 9 / 16);
    const size_t total = seeds.size() * size_t(frames) * rig.size();
    for (const uint32_t seed : seeds) {
        const analytic::StreetScene street = analytic::build_street(seed);
        for (int f = 0; f < frames; ++f) {
            const int frame = frames == 1 ? 0 : f * (analytic::most_frames - 1) / (frames - 1);
            for (const analytic::RigCamera& camera : rig) {
                show(out.views.size(), total);
                const TrueCamera at = analytic::recorded_camera(camera, frame);
                out.views.push_back({analytic::street_color(street, at, color_samples), cast_camera(street.scene, at).depth, camera});
            }
        }
    }
    return out;
}

PairPlanes training_pair(const RecordedViews& recorded, uint64_t seed, uint64_t number, int crop_px, bool twice) {
    thread_local Sweeper sweeper;
    analytic::Stream random(uint32_t(seed * 7919 + number), uint32_t(number >> 20) + 17);
    for (;;) {
        const auto& view = recorded.views[size_t(random.whole(0, int(recorded.views.size()) - 1))];
        Shift shift;
        shift.translation_m = {random.within(-1, 1), random.within(0.5, 4) * (random.chance(0.5) ? 1 : -1), 0};
        SweepCamera camera;
        camera.recorded = camera.shifted = view.camera.intrinsics;
        camera.recorded_from_shifted =
            compose(inverse(view.camera.ego_from_cam), shifted_ego_from_cam(view.camera.ego_from_cam, shift));
        Grid<uint8_t> classes;
        sweeper.classes(camera, view.depth, classes);
        Mask hole;
        if (lost_pixels(classes, hole) == hole.size()) continue;
        ColorImage back;
        if (twice && !warp_there_and_back(view, shift, back, hole)) continue;
        PairPlanes pair = planes_of(twice ? back : view.color, view.depth, hole, &view.color);
        pair.weight.resize(classes.size());
        std::vector<size_t> occluded_pixels;
        for (size_t i = 0; i < classes.size(); ++i) {
            const bool occluded = (classes.data[i] & (occluded_bit | outside_bit)) == occluded_bit;
            pair.weight[i] = occluded ? 1.0f : classes.data[i] & outside_bit ? outside_weight : 0.0f;
            if (occluded) occluded_pixels.push_back(i);
        }
        if (occluded_pixels.empty()) continue;
        if (crop_px == 0) return pair;
        // Around an occluded pixel, not always in the middle.
        const size_t at = occluded_pixels[size_t(random.whole(0, int(occluded_pixels.size()) - 1))];
        const int width = std::min(crop_px, pair.width), height = std::min(crop_px, pair.height);
        const int x = int(at % size_t(pair.width)) - random.whole(0, width - 1);
        const int y = int(at / size_t(pair.width)) - random.whole(0, height - 1);
        return part_of(pair, std::clamp(x, 0, pair.width - width), std::clamp(y, 0, pair.height - height), width, height,
                       random.chance(0.5));
    }
}

TrueShiftedView true_shifted_view(const analytic::StreetScene& street, const std::vector<analytic::RigCamera>& rig, int own,
                                  int frame, const Shift& shift) {
    const analytic::RigCamera& camera = rig[size_t(own)];
    const TrueCamera from = analytic::recorded_camera(camera, frame), to = analytic::shifted_camera(camera, frame, shift);
    const ColorImage recorded = analytic::street_color(street, from, color_samples);
    const ColorImage truth = analytic::street_color(street, to, color_samples);
    const ShiftedCamera v{camera.intrinsics, to.world_from_cam};
    const SurfaceView surface = surface_view(camera.intrinsics, from.world_from_cam, cast_camera(street.scene, from).depth,
                                             to.world_from_cam.translation_m);
    Reprojection shown;
    const bool any = reproject(surface, v, nullptr, shown);
    const ShiftedHoles seen = holes({{surface.intrinsics, surface.world_from_cam, any ? &shown : nullptr}}, 0, v);
    const Sampler sampler(SurfaceField{surface.inverse_depth, surface.tears}, recorded,
                          projective_map(surface.intrinsics, surface.world_from_cam, v.intrinsics, v.world_from_cam));
    Warped warped = warp(seen, {sampler}, EdgeBand::drop);
    PairPlanes planes = planes_of(warped.color, seen.depth, warped.missing, &truth);
    return {std::move(warped), seen.depth, std::move(planes), seen.disoccluded};
}

}  // namespace vshift::inpaint
