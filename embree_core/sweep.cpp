// SPDX-License-Identifier: Apache-2.0
#include "embree_core/sweep.h"

#include <tbb/blocked_range.h>
#include <tbb/enumerable_thread_specific.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "embree_core/sweep_fan.h"

namespace vshift {

using namespace sweep;

struct Sweeper::Buffers {
    std::vector<Fan> fans;
    MarkedImage marked[2];  ///< for lines along x, and along y
};

Sweeper::Sweeper() : buffers_(std::make_unique<Buffers>()) {}
Sweeper::~Sweeper() = default;

namespace {

// Lines that leave their row by less than this over the whole image are taken as rows.
constexpr double row_aligned_px = 0.05;

/// The pixel centres' least a x + b y + c.
double least_over(const glm::dvec3& linear, const Intrinsics& k) {
    const auto least = [](double slope, int count) { return std::min(0.5 * slope, (count - 0.5) * slope); };
    return least(linear.x, k.width) + least(linear.y, k.height) + linear.z;
}

/// Of pixel centres, to be taken at whole numbers.
Linear at_pixels(const glm::dvec3& linear) {
    return {float(linear.x), float(linear.y), float(linear.z + 0.5 * (linear.x + linear.y))};
}

PixelRule pixel_rule(const SweepCamera& camera) {
    const Intrinsics &r = camera.recorded, &s = camera.shifted;
    const Pose shifted_from_recorded = inverse(camera.recorded_from_shifted);
    const glm::dvec3 c = camera.recorded_from_shifted.translation_m;
    PixelRule rule{};
    for (int i = 0; i < 3; ++i) rule.centre[i] = float(c[i]);
    rule.ray_x0 = float((0.5 - r.cx) / r.fx), rule.ray_dx = float(1 / r.fx);
    rule.ray_y0 = float((0.5 - r.cy) / r.fy), rule.ray_dy = float(1 / r.fy);
    rule.clear_m = float(camera.clear_m);
    const glm::dmat3 to_ray(glm::dvec3(1 / r.fx, 0, 0), glm::dvec3(0, 1 / r.fy, 0),
                            glm::dvec3(-r.cx / r.fx, -r.cy / r.fy, 1));
    // Sides of a frustum as normals that point inwards; what lies within all four is in front, too.
    const auto sides = [](const Intrinsics& k) {
        const glm::dvec3 u(k.fx, 0, k.cx), v(0, k.fy, k.cy), ahead(0, 0, 1);
        return std::array<glm::dvec3, 4>{u, double(k.width) * ahead - u, v, double(k.height) * ahead - v};
    };
    int side = 0;
    for (const glm::dvec3& inwards : sides(s)) {
        const bool strict = side++ % 2 == 1;
        const glm::dvec3 at = inwards * shifted_from_recorded.rotation * to_ray;
        const double move = glm::dot(inwards, shifted_from_recorded.translation_m);
        const double least = least_over(at, r);
        if (move >= 0 && (strict ? least > 0 : least >= 0)) continue;
        rule.outside[rule.outside_count++] = {at_pixels(at), float(move), strict};
    }
    for (const glm::dvec3& inwards : sides(r)) {
        const double away = -glm::dot(inwards, c);
        if (away > 0) rule.unseen[rule.unseen_count++] = at_pixels(inwards * to_ray * (camera.clear_m / away));
    }
    return rule;
}

/// The way to V of a pixel on the line coordinate `at` of an axis, up to a positive factor.
double way(const Axis& axis, double at, double centre_z) {
    return axis.focal * axis.centre_m - (at - axis.middle) * centre_z;
}

// Sixteen lines then span no more than sixteen pixels, which `walk` relies on.
constexpr double least_lines_per_px = 1.1;

/// Whether epipolar lines keep to the rows, at the image's corners too.
bool is_row_aligned(const Axis& x, const Axis& y, double centre_z) {
    const double across = std::max(std::fabs(way(y, 0, centre_z)), std::fabs(way(y, y.size, centre_z)));
    const double left = way(x, 0, centre_z), right = way(x, x.size, centre_z);
    return (left > 0) == (right > 0) && across * x.size <= row_aligned_px * std::min(std::fabs(left), std::fabs(right));
}

bool follows_rows(const SweepCamera& camera) {
    const Intrinsics& k = camera.recorded;
    const glm::dvec3 c = camera.recorded_from_shifted.translation_m;
    return c == glm::dvec3(0.0) || is_row_aligned({k.fx, k.cx, c.x, k.width}, {k.fy, k.cy, c.y, k.height}, c.z);
}

}  // namespace

void Sweeper::classes(const SweepCamera& camera, const DepthMap& depth, Grid<uint8_t>& out) {
    const Intrinsics& k = camera.recorded;
    check_size(k, depth);
    if (out.width != k.width || out.height != k.height) out = Grid<uint8_t>(k.width, k.height);
    const glm::dvec3 c = camera.recorded_from_shifted.translation_m;
    const double baseline = glm::length(c);
    const Axis x{k.fx, k.cx, c.x, k.width}, y{k.fy, k.cy, c.y, k.height};
    const PixelRule rule = pixel_rule(camera);
    const size_t width = size_t(k.width);

    if (follows_rows(camera)) {
        const int heading = way(x, 0.5 * x.size, c.z) >= 0 ? 1 : -1;
        const LineRule row_rule = line_rule(x, camera, heading > 0 ? 0 : k.width - 1, heading);
        tbb::enumerable_thread_specific<Row> rooms([&] { return Row(width); });
        tbb::parallel_for(tbb::blocked_range<int>(0, k.height, 8), [&](const tbb::blocked_range<int>& range) {
            Row& room = rooms.local();
            for (int row = range.begin(); row < range.end(); ++row) {
                const glm::dvec3 first = ray(k, {heading > 0 ? 0.5 : k.width - 0.5, row + 0.5});
                const Rays rays{first, {heading / k.fx, 0, 0}, c, camera.clear_m};
                const float* z = &depth.data[size_t(row) * width];
                (heading > 0 ? kernels().inverse : kernels().inverse_reversed)(z, width, room.q());
                RowSweep(row_rule, rays, room, width).run();
                kernels().pixels(rule, z, row, width, room.classes.data(), heading < 0, &out.data[size_t(row) * width]);
            }
        });
        return;
    }

    Buffers& b = *buffers_;
    plan(x, y, c.z, std::max(camera.lines_per_px, least_lines_per_px), b.fans);
    std::fill(out.data.begin(), out.data.end(), uint8_t(0));
    for (const Fan& fan : b.fans) b.marked[fan.transposed].make_room(fan);
    tbb::parallel_for(size_t(0), b.fans.size(), [&](size_t i) {
        Fan& fan = b.fans[i];
        MarkedImage& marked = b.marked[fan.transposed];
        marked.fill(fan, depth, tear_rule(camera.rules, (fan.transposed ? k.fx : k.fy) * baseline));
        sweep_fan(camera, marked, fan, out);
    });
    tbb::parallel_for(tbb::blocked_range<int>(0, k.height, 8), [&](const tbb::blocked_range<int>& range) {
        for (int row = range.begin(); row < range.end(); ++row) {
            uint8_t* target = &out.data[size_t(row) * width];
            kernels().pixels(rule, &depth.data[size_t(row) * width], row, width, target, false, target);
        }
    });
}

Mask Sweeper::edges(const SweepCamera& camera, const DepthMap& depth, const Grid<uint8_t>& classes) {
    constexpr uint8_t asked = occluded_bit | unknown_bit;
    SweepCamera bound = camera;
    bound.rules.tear_px *= 0.5;
    bound.rules.tear_break = bound.rules.crease_break = 0.1;
    Grid<uint8_t> shortest, longest;
    bound.reach_px = 0;
    this->classes(bound, depth, shortest);
    bound.reach_px = 1;
    this->classes(bound, depth, longest);
    const int width = classes.width, height = classes.height;
    // The lines of other shifts pass up to half a pixel beside a pixel's centre, over what lies there.
    const int beside = follows_rows(camera) ? 0 : 1;
    Mask out(width, height, 0);
    tbb::parallel_for(0, height, [&](int y) {
        const int top = std::max(0, y - beside), bottom = std::min(height - 1, y + beside);
        for (int x = 0; x < width; ++x) {
            const uint8_t own = classes.at(x, y) & asked;
            uint8_t differs = 0;
            for (int v = top; v <= bottom; ++v)
                for (int u = std::max(0, x - beside); u <= std::min(width - 1, x + beside); ++u)
                    differs |= uint8_t(
                        ((classes.at(u, v) ^ own) | (shortest.at(u, v) ^ own) | (longest.at(u, v) ^ own)) & asked);
            out.at(x, y) = differs != 0;
        }
    });
    return out;
}

PointBits::PointBits(const SweepCamera& camera) : rule_(std::make_unique<PixelRule>(pixel_rule(camera))) {}
PointBits::~PointBits() = default;

void PointBits::add(const DepthMap& depth, int row, uint8_t* classes) const {
    const size_t width = size_t(depth.width);
    kernels().pixels(*rule_, &depth.data[size_t(row) * width], row, width, classes, false, classes);
}

}  // namespace vshift
