// SPDX-License-Identifier: Apache-2.0
#include "embree_core/field_mask.h"

#include <tbb/parallel_for.h>

#include <cmath>
#include <utility>

#include "embree_core/sweep.h"

namespace vshift {

using heights::Rays;

namespace {

constexpr float endless = 1e30f;

/// Lines from pixels' points to V in (pixels, 1/z): at t of the segment s is t w / ((1 - t) + t w c.z), and the rate
/// of place is V's homogeneous pixel less c.z times the pixel.
class Lines {
public:
    Lines(const FieldView& view, double clear_m)
        : view_(view), k_(view.surface.intrinsics), clear_m_(clear_m), per_fx_(1 / k_.fx), per_fy_(1 / k_.fy) {
        const glm::dvec3& c = view.centre_m;
        centre_x_ = k_.fx * c.x + (k_.cx - 0.5) * c.z, centre_y_ = k_.fy * c.y + (k_.cy - 0.5) * c.z;
    }

    /// Pixel (x, y), which is measured or sky.
    void set(size_t i, int x, int y, Rays& rays) const {
        const glm::dvec3& c = view_.centre_m;
        const float measured = view_.surface.inverse_depth.at(x, y);
        if (measured == 0) return set_sky(i, x, y, rays);
        const double w = double(measured) + 2 * double(view_.error.at(measured)), z = 1 / w;
        rays.x[i] = float(x), rays.y[i] = float(y), rays.w[i] = float(w);
        rays.dx[i] = float(centre_x_ + miss_px.x * z - c.z * x),
        rays.dy[i] = float(centre_y_ + miss_px.y * z - c.z * y);
        rays.dw[i] = float(1 - c.z * w);
        const auto s = [&](double t) {
            const double left = (1 - t) + t * w * c.z;
            return left > 0 ? float(std::min(t * w / left, double(endless))) : endless;
        };
        rays.end[i] = s(1 - ray_offset);
        const double distance = glm::length(c - direction(x, y) * z);
        rays.wall_end[i] = distance > clear_m_ ? s(std::min(1 - clear_m_ / distance, 1 - ray_offset)) : -1;
    }

private:
    /// From so far beside the pixel as rays miss V's centre.
    void set_sky(size_t i, int x, int y, Rays& rays) const {
        const glm::dvec3& c = view_.centre_m;
        const double px = x + miss_px.x, py = y + miss_px.y;
        rays.x[i] = float(px), rays.y[i] = float(py), rays.w[i] = 0;
        rays.dx[i] = float(centre_x_ - c.z * px), rays.dy[i] = float(centre_y_ - c.z * py), rays.dw[i] = 1;
        const double clear_z = c.z + clear_m_ / glm::length(direction(px, py));
        rays.end[i] = c.z > 0 ? float(1 / c.z) : endless;
        rays.wall_end[i] = clear_z > 0 ? float(1 / clear_z) : endless;
    }
    glm::dvec3 direction(double x, double y) const {
        return {(x + 0.5 - k_.cx) * per_fx_, (y + 0.5 - k_.cy) * per_fy_, 1};
    }

    const FieldView& view_;
    const Intrinsics& k_;
    const double clear_m_;
    const double per_fx_, per_fy_;
    double centre_x_, centre_y_;  ///< V's homogeneous pixel, whole numbers at pixels' centres
};

}  // namespace

FieldView field_view(SurfaceView surface, const InverseDepthError& error, const glm::dvec3& shifted_centre_m,
                     Casting casting) {
    FieldView view{std::move(surface), error, {}, nullptr, {}};
    const SurfaceView& s = view.surface;
    view.centre_m = inverse(s.world_from_cam).point(shifted_centre_m);
    if (casting == Casting::where_needed)
        view.filter = std::make_unique<const RayFilter>(
            RayFilter::Surface{s.intrinsics, s.inverse_depth, s.tears, s.wall_top, 0, 1, error}, view.centre_m);
    view.field = HeightField({s.inverse_depth, s.tears}, s.wall_top, view.filter.get(),
                             float(std::max(s.intrinsics.fx, s.intrinsics.fy) * glm::length(view.centre_m)));
    return view;
}

RecordedMasks mask(const FieldView& view, const DepthMap& depth, const ShiftedCamera& shifted, double clear_m) {
    const Intrinsics& k = view.surface.intrinsics;
    const Pose own_from_shifted = compose(inverse(view.surface.world_from_cam), shifted.world_from_cam);
    const glm::dvec3& centre = view.centre_m;
    if (glm::length(own_from_shifted.translation_m - centre) > 1e-6)
        throw Error(ExitCode::our_bug, "mask: got a surface made ready for another place, expected V's");
    const bool still = glm::length(centre) < 1e-9;  // V sees what R saw
    const Lines lines(view, clear_m);
    const PointBits point_bits({k, shifted.intrinsics, own_from_shifted, clear_m});
    Grid<uint8_t> classes(k.width, k.height, 0);
    tbb::parallel_for(0, k.height, [&](int y) {
        uint8_t* row = &classes.at(0, y);
        const float* w = &view.surface.inverse_depth.at(0, y);
        Rays rays;
        const auto measured = [&](int x) { return !std::isnan(w[x]); };
        const auto ask = [&](const int* columns, int count) {
            for (int i = 0; i < count; ++i) lines.set(size_t(i), columns[i], y, rays);
            const heights::Met met = view.field.meet(rays, (1u << count) - 1);
            for (int i = 0; i < count; ++i)
                row[columns[i]] |= uint8_t(met.kept >> i & 1 ? occluded_bit : met.torn >> i & 1 ? unknown_bit : 0);
        };
        if (!still) ask_in_packets<heights::packet_rays>(view.filter.get(), k.width, y, measured, ask);
        point_bits.add(depth, y, row);
    });
    return masks_of(classes);
}

}  // namespace vshift
