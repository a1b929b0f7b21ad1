// SPDX-License-Identifier: Apache-2.0
#include "embree_core/sweep_fan.h"

#include <tbb/blocked_range.h>
#include <tbb/enumerable_thread_specific.h>
#include <tbb/parallel_for.h>

#include <array>

namespace vshift::sweep {
namespace {

/// Whole blocks of lines that hold [low, high].
void number_lines(Fan& fan, double low, double high) {
    fan.first_line = (int(std::floor(low / lines_per_block)) - 1) * lines_per_block;
    fan.lines = (int(std::ceil(high / lines_per_block)) + 1) * lines_per_block - fan.first_line;
}

// With the epipole nearer than this, lines are numbered from it; farther off that would take more digits than a
// float has, and no line is left out anyway.
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
    rule.place0 = 0;
    rule.gain0 = float((first + 0.5 - major.middle) * centre_z - major.focal * major.centre_m);
    rule.gain_step = float(heading * centre_z);
    rule.centre_z = float(centre_z);
    rule.tear = tear_rule(camera.rules, major.focal * glm::length(centre_m));
    rule.error = camera.rules.error;
    rule.reach = camera.reach_px;
    return rule;
}

void plan(const Axis& x, const Axis& y, double centre_z, double density, std::vector<Fan>& fans) {
    size_t count = 0;
    const auto next = [&](bool transposed, const Axis& major, const Axis& minor) -> Fan& {
        if (count == fans.size()) fans.emplace_back();
        Fan& fan = fans[count++];
        fan.transposed = transposed;
        fan.majors = major.size, fan.minors = minor.size;
        fan.major_begin = 0, fan.major_end = major.size;
        fan.density = density;
        fan.epipole = Fan::Epipole::none;
        fan.epipole_major = fan.epipole_minor = fan.slope = 0;
        fan.by_major.assign(size_t(major.size), 0.0f);
        fan.by_minor.assign(size_t(minor.size), 0.0f);
        fan.level.assign(size_t(major.size), 0);
        fan.innermost.fill(0);  // no epipole, no levels: nothing is cut
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
            fan.far_major = major.size - 0.5, fan.far_minor = 0.5;
            fan.slope = along != 0 ? across / along : 0;
            const double turn = fan.slope * (major.size - 1);
            number_lines(fan, density * (std::min(0.0, turn) - 1), density * (std::max(0.0, turn) + minor.size + 1));
            for (int m = 0; m < major.size; ++m)
                fan.by_major[size_t(m)] = float(density * fan.slope * (major.size - 1 - m));
            for (float& f : fan.by_minor) f = 1;
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
            fan.epipole_major = e_major, fan.epipole_minor = e_minor, fan.far_major = far;
            const bool near = std::max(std::fabs(e_major), std::fabs(e_minor)) < near_epipole_px;
            fan.epipole = near ? Fan::Epipole::near : Fan::Epipole::far;
            fan.far_minor = near ? e_minor : 0.5;
            const double origin = e_minor - fan.far_minor;
            number_lines(fan, density * (low + origin - 2), density * (high + origin + 2));
            for (int n = 0; n < minor.size; ++n) fan.by_minor[size_t(n)] = float(n + 0.5 - e_minor);
            for (int m = begin; m < end; ++m) {
                const double from_epipole = (m + 0.5 - e_major) * side;
                if (near) {
                    const double widening = from_epipole > 0 ? reach / from_epipole : 1e6;
                    fan.by_major[size_t(m)] = float(density * widening);
                    fan.level[size_t(m)] = int32_t(std::min<double>(highest_level, std::floor(std::log2(widening))));
                } else {
                    fan.by_major[size_t(m)] = float(density * (far - (m + 0.5)) / (m + 0.5 - e_major));
                }
            }
            for (int level = 0; level <= highest_level; ++level) {
                int m = side > 0 ? begin : end - 1;
                while (m >= begin && m < end && fan.level[size_t(m)] > level) m += side;
                fan.innermost[size_t(level)] = m;
            }
        }
    }
    fans.resize(count);
}

namespace {

/// The buffers of one thread.
struct FanRoom {
    Line line;
    // Horizons that a block's lines leave for those that begin farther out, by number within the block and level.
    std::array<std::array<Horizon, highest_level>, lines_per_block> left;
    Horizon horizon;
    explicit FanRoom(int majors) : line(size_t(majors)) {}
};

/// The order of a block's lines: those that others go on from come first.
std::array<int, lines_per_block> block_order() {
    std::array<int, lines_per_block> order{};
    size_t count = 0;
    order[count++] = 0;
    for (int step = lines_per_block / 2; step >= 1; step /= 2)
        for (int at = step; at < lines_per_block; at += 2 * step) order[count++] = at;
    return order;
}

void sweep_fan_line(const SweepCamera& camera, const float* image, Fan& fan, FanRoom& room, int number, int in_block,
                    bool write) {
    int own_level = highest_level;
    if (in_block != 0)
        for (own_level = 0; !(in_block >> own_level & 1);) ++own_level;
    for (Horizon& h : room.left[size_t(in_block)]) h.known = false;
    const Fan::Straight line = fan.line(number);
    // Where the line lies within the image: minor in [0, minors].
    int begin = fan.major_begin, end = fan.major_end;
    if (std::fabs(line.slope) > 1e-12) {
        double from = (0 - line.at_zero) / line.slope, to = (fan.minors - line.at_zero) / line.slope;
        if (from > to) std::swap(from, to);
        constexpr double rounding = 1e-6;  // a line through a corner counts from either side
        begin = int(std::max(double(begin), std::ceil(from - 0.5 - rounding)));
        end = int(std::min(double(end), std::floor(to - 0.5 + rounding) + 1));
    } else if (line.at_zero < 0 || line.at_zero > fan.minors) {
        return;
    }
    if (begin >= end) return;
    // Towards the epipole the line stops where only lines of a higher level go on: levels fall outwards.
    const bool epipole_first = fan.far_major > fan.epipole_major;
    const int innermost = fan.innermost[size_t(own_level)];
    const bool cut = epipole_first ? innermost > begin : innermost < end - 1;
    if (cut) (epipole_first ? begin : end) = epipole_first ? innermost : innermost + 1;
    if (begin >= end) return;
    const int own_begin = begin, own_end = end;
    // The way to V leads to the epipole: this line goes on from another one's horizon, with one sample more for the
    // surface between.
    const bool inwards = (fan.heading > 0) != epipole_first;
    Horizon* from = nullptr;
    if (cut && inwards) {
        Horizon& h = room.left[size_t(in_block ^ (1 << own_level))][size_t(own_level)];
        if (h.known) {
            from = &h;
            (epipole_first ? begin : end) += epipole_first ? -1 : 1;
        }
    }
    const size_t n = size_t(end - begin);
    const int first = fan.heading > 0 ? begin : end - 1;
    const Intrinsics& k = camera.recorded;
    const glm::dvec3& c = camera.recorded_from_shifted.translation_m;
    const Axis major = fan.transposed ? Axis{k.fy, k.cy, c.y, k.height} : Axis{k.fx, k.cx, c.x, k.width};
    LineRule rule = line_rule(major, camera, first, fan.heading);
    const auto ray_at = [&](double m) {
        const double n = line.at_zero + line.slope * m;
        return ray(k, fan.transposed ? glm::dvec2(n, m) : glm::dvec2(m, n));
    };
    const Rays rays{ray_at(first + 0.5), ray_at(first + 0.5 + fan.heading) - ray_at(first + 0.5), c, camera.clear_m};
    rule.place0 = fan.heading > 0 ? first : fan.majors - 1 - first;
    const RowCrossings crossings{
        image, fan.majors, fan.minors, first, fan.heading, float(line.at_zero + 0.5 * line.slope), float(line.slope)};
    kernels().sample(image, fan.majors, fan.minors, first, fan.heading, n, crossings.v0, crossings.slope,
                     room.line.q());
    Horizon& horizon = room.horizon;
    if (from) horizon = *from;
    LineSweep pass(rule, rays, crossings, room.line, n, horizon);
    size_t at = n;
    if (from) pass.go_on(--at);
    if (inwards)
        for (int level = own_level; level-- > 0;) {
            // The place where lines of `level` begin: leave the horizon there for them.
            const int lower = fan.heading * (fan.innermost[size_t(level)] - first) + 1;
            const size_t stop = size_t(std::clamp(lower, 0, int(at)));
            if (stop == 0 || stop == n) continue;
            pass.run(stop, at);
            at = stop;
            Horizon& left = room.left[size_t(in_block)][size_t(level)];
            left = horizon;
            left.known = true;
        }
    pass.run(0, at);
    if (!write) return;
    uint8_t* out = fan.classes.data() + size_t(number - fan.first_line) * size_t(fan.majors);
    const uint8_t* classes = room.line.classes.data();
    if (fan.heading > 0)
        std::copy(classes + (own_begin - begin), classes + (own_end - begin), out + own_begin);
    else
        copy_reversed(classes + (end - own_end), size_t(own_end - own_begin), out + own_begin);
}

}  // namespace

void sweep_fan(const SweepCamera& camera, const float* image, Fan& fan) {
    static const std::array<int, lines_per_block> order = block_order();
    fan.classes.resize(size_t(fan.lines) * size_t(fan.majors) + padding);
    tbb::enumerable_thread_specific<FanRoom> rooms([&] { return FanRoom(fan.majors); });
    const int first_block = fan.first_line / lines_per_block;
    tbb::parallel_for(
        tbb::blocked_range<int>(0, fan.lines / lines_per_block, 1), [&](const tbb::blocked_range<int>& range) {
            FanRoom& room = rooms.local();
            for (int b = first_block + range.begin(); b < first_block + range.end(); ++b)
                for (const int in_block : order) {
                    // Blocks begin at the epipole's side: below it they are mirrored, and line 0 belongs above.
                    const int number = b >= 0 ? b * lines_per_block + in_block : (b + 1) * lines_per_block - in_block;
                    sweep_fan_line(camera, image, fan, room, number, in_block, number != 0 || b >= 0);
                }
        });
}

void take_run(const Fan& fan, int x_begin, int x_end, int y, const float* x_table, uint8_t* out) {
    if (x_begin >= x_end) return;
    Take rule{fan.classes.data(), fan.majors, fan.first_line, nullptr, 0, 0, nullptr, 0, 0, 0};
    const float density = float(fan.density);
    if (!fan.transposed) {
        rule.a = fan.by_major.data() + x_begin;
        rule.b = fan.by_minor[size_t(y)];
        rule.c = fan.epipole == Fan::Epipole::near ? 0.0f : density * float(y);
        rule.levels = fan.level.data() + x_begin;
        rule.place = x_begin, rule.place_step = 1;
    } else {
        const float spread = fan.by_major[size_t(y)];
        rule.level = fan.level[size_t(y)];
        rule.place = y, rule.place_step = 0;
        switch (fan.epipole) {
            case Fan::Epipole::near:
                rule.a = fan.by_minor.data() + x_begin, rule.b = spread, rule.c = 0;
                break;
            case Fan::Epipole::far:
                rule.a = x_table + x_begin, rule.b = density + spread;
                rule.c = float((0.5 - fan.epipole_minor) * double(spread));
                break;
            case Fan::Epipole::none:
                rule.a = x_table + x_begin, rule.b = density, rule.c = spread;
                break;
        }
    }
    kernels().take(rule, size_t(x_end - x_begin), out + x_begin);
}

}  // namespace vshift::sweep
