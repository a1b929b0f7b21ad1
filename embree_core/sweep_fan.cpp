// SPDX-License-Identifier: Apache-2.0
#include "embree_core/sweep_fan.h"

#include <tbb/blocked_range.h>
#include <tbb/enumerable_thread_specific.h>
#include <tbb/parallel_for.h>

namespace vshift::sweep {
namespace {

// With the epipole nearer than this, lines are numbered from it; farther off that would take more digits than a
// whole number has, and no line is left out anyway.
constexpr double near_epipole_px = 65536;

}  // namespace

TearRule tear_rule(const DepthRules& rules, double px_per_q) {
    return {float(px_per_q),          float(rules.tear_px),     float(rules.tear_break), float(rules.crease_break),
            4 * rules.error.constant, 4 * rules.error.relative, 4 * rules.error.squared};
}

LineRule line_rule(const Axis& major, const SweepCamera& camera, int first, int heading) {
    const glm::dvec3& centre_m = camera.recorded_from_shifted.translation_m;
    const double centre_z = centre_m.z;
    LineRule rule;
    rule.gain0 = float((first + 0.5 - major.middle) * centre_z - major.focal * major.centre_m);
    rule.gain_step = float(heading * centre_z);
    rule.centre_z = float(centre_z);
    rule.tear = tear_rule(camera.rules, major.focal * glm::length(centre_m));
    rule.error = camera.rules.error;
    rule.reach = camera.reach_px;
    return rule;
}

std::pair<int, int> Fan::read(int major) const {
    // Bundles may begin and end a little farther out, and marks look two elements on.
    constexpr double margin = Bundle::lines + 4;
    const double across = reach(major) + margin;
    return {int(std::clamp(std::floor(epipole_minor - across), 0.0, double(minors))),
            int(std::clamp(std::ceil(epipole_minor + across), 0.0, double(minors)))};
}

void plan(const Axis& x, const Axis& y, double centre_z, double density, std::vector<Fan>& fans) {
    size_t count = 0;
    const auto next = [&](bool transposed, const Axis& major, const Axis& minor) -> Fan& {
        if (count == fans.size()) fans.emplace_back();
        Fan& fan = fans[count++];
        fan.transposed = transposed;
        fan.majors = major.size, fan.minors = minor.size;
        fan.origin.assign(size_t(major.size), 0.0);
        fan.spacing.assign(size_t(major.size), 1 / density);
        fan.level.assign(size_t(major.size), 0);
        return fan;
    };
    const double dx = x.focal * x.centre_m, dy = y.focal * y.centre_m;
    // With the epipole this far away no line of the image turns by a hundredth of a pixel.
    const double size = std::max(x.size, y.size);
    const bool parallel = std::max(std::fabs(dx), std::fabs(dy)) > 100 * size * size * std::fabs(centre_z);
    for (const bool transposed : {false, true}) {
        const Axis &major = transposed ? y : x, &minor = transposed ? x : y;
        const double along = transposed ? dy : dx, across = transposed ? dx : dy;
        if (parallel) {
            if (transposed ? std::fabs(along) <= std::fabs(across) : std::fabs(along) < std::fabs(across)) continue;
            Fan& fan = next(transposed, major, minor);
            fan.heading = along >= 0 ? 1 : -1;
            fan.major_begin = 0, fan.major_end = major.size;
            fan.epipole_major = std::numeric_limits<double>::infinity(), fan.epipole_minor = 0;
            const double slope = along != 0 ? across / along : 0;
            for (int m = 0; m < major.size; ++m) fan.origin[size_t(m)] = 0.5 + slope * (m + 1 - major.size);
            const double turn = slope * (major.size - 1);
            fan.first_line = int(std::floor(density * (std::min(0.0, turn) - 1)));
            fan.last_line = int(std::ceil(density * (std::max(0.0, turn) + minor.size + 1)));
            continue;
        }
        const double e_major = along / centre_z + major.middle, e_minor = across / centre_z + minor.middle;
        for (const int side : {-1, 1}) {
            const double far = side > 0 ? major.size - 0.5 : 0.5;
            const double reach = (far - e_major) * side;
            if (reach <= 0) continue;
            const int begin = side > 0 ? std::max(0, int(std::floor(e_major + 0.5))) : 0;
            const int end = side > 0 ? major.size : std::min(major.size, int(std::ceil(e_major - 0.5)));
            if (begin >= end) continue;
            const double nearest = std::max(1e-3, ((side > 0 ? begin : end - 1) + 0.5 - e_major) * side);
            // Where the image's borders, seen from the epipole, fall on the far border.
            double low = std::numeric_limits<double>::infinity(), high = -low;
            for (const double edge : {0.0, double(minor.size)})
                for (const double r : {nearest / reach, 1.0}) {
                    const double at = (edge - e_minor) / r;
                    low = std::min(low, at), high = std::max(high, at);
                }
            low = std::max(low, -reach), high = std::min(high, reach);
            if (low >= high) continue;
            Fan& fan = next(transposed, major, minor);
            fan.heading = centre_z > 0 ? -side : side;
            fan.major_begin = begin, fan.major_end = end;
            fan.epipole_major = e_major, fan.epipole_minor = e_minor;
            const bool near = std::max(std::fabs(e_major), std::fabs(e_minor)) < near_epipole_px;
            const double far_minor = near ? e_minor : 0.5;  // of line 0 at the far border
            const double origin = e_minor - far_minor;
            fan.first_line = int(std::floor(density * (low + origin - 2)));
            fan.last_line = int(std::ceil(density * (high + origin + 2)));
            for (int m = begin; m < end; ++m) {
                const double share = std::max((m + 0.5 - e_major) * side / reach, 1e-6);
                fan.origin[size_t(m)] = e_minor - origin * share;
                fan.spacing[size_t(m)] = share / density;
                if (near) fan.level[size_t(m)] = int(std::min<double>(highest_level, std::floor(std::log2(1 / share))));
            }
        }
    }
    fans.resize(count);
}

void MarkedImage::make_room(const Fan& fan) {
    stride_ = fan.minors + 2 * row_room;
    if (const size_t needed = size_t(fan.majors) * size_t(stride_); room_.size() < needed) room_.resize(needed);
}

void MarkedImage::fill(const Fan& fan, const DepthMap& depth, const TearRule& tear) {
    const size_t width = size_t(depth.width);
    // Some rows at a time, first without marks.
    constexpr int band = 16;
    tbb::enumerable_thread_specific<std::vector<float>> rooms(
        [&] { return std::vector<float>(size_t(band) * size_t(stride_)); });
    const int begin = fan.major_begin, count = fan.major_end - fan.major_begin;
    tbb::parallel_for(0, (count + band - 1) / band, [&](int at) {
        const int first = begin + at * band, last = std::min(first + band, fan.major_end);
        float* room = rooms.local().data() + row_room;
        const std::pair<int, int> a = fan.read(first), b = fan.read(last - 1);
        const int from = std::min(a.first, b.first), to = std::max(a.second, b.second);
        if (from >= to) return;
        if (!fan.transposed)
            kernels().inverse_columns(depth.data.data(), width, size_t(first), size_t(last - first), size_t(from),
                                      size_t(to), room, size_t(stride_));
        for (int row = first; row < last; ++row) {
            float* q = room + ptrdiff_t(row - first) * stride_;
            float* marked = room_.data() + row_room + ptrdiff_t(row) * stride_;
            if (fan.transposed)
                kernels().inverse(&depth.data[size_t(row) * width + size_t(from)], size_t(to - from), q + from);
            for (const int beside : {from - 2, from - 1, to, to + 1})
                q[beside] = std::numeric_limits<float>::quiet_NaN();
            kernels().mark_row(q + from, size_t(to - from), tear, marked + from);
            // What lies past the image is as its border.
            if (from == 0) marked[-1] = marked[0];
            if (to == fan.minors) marked[to] = marked[to - 1];
        }
    });
}

}  // namespace vshift::sweep
