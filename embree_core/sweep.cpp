// SPDX-License-Identifier: Apache-2.0
#include "embree_core/sweep.h"

#include <tbb/blocked_range.h>
#include <tbb/enumerable_thread_specific.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>

#include "embree_core/sweep_kernels.h"

namespace vshift {
namespace {

using sweep::kernels;
using sweep::LineRule;

constexpr size_t block = 16;
constexpr float nan_f = std::numeric_limits<float>::quiet_NaN();
// Lines that leave their row by less than this over the whole image are taken as rows.
constexpr double row_aligned_px = 0.05;

/// Ranges of keys that only torn walls cover, apart and in order.
class Gaps {
public:
    bool empty() const { return ranges_.empty(); }
    void clear() { ranges_.clear(); }
    int32_t highest() const { return ranges_.back().high; }
    bool holds(int32_t key) const {
        for (size_t i = ranges_.size(); i-- > 0;)
            if (key >= ranges_[i].low) return key <= ranges_[i].high;
        return false;
    }
    /// A range above all others.
    void push(int32_t low, int32_t high) { ranges_.push_back({low, high}); }
    /// Takes away what [low, high] covers.
    void cover(int32_t low, int32_t high) {
        size_t end = ranges_.size();
        while (end > 0 && ranges_[end - 1].low > high) --end;
        if (end == 0 || ranges_[end - 1].high < low) return;
        const Range last = ranges_[end - 1];
        size_t begin = end - 1;
        while (begin > 0 && ranges_[begin - 1].high >= low) --begin;
        const Range first = ranges_[begin];
        if (first.low < low) ranges_[begin++].high = low - 1;
        if (last.high > high) {
            if (begin == end)
                ranges_.insert(ranges_.begin() + long(end), {high + 1, last.high});
            else
                ranges_[--end] = {high + 1, last.high};
        }
        if (begin < end) ranges_.erase(ranges_.begin() + long(begin), ranges_.begin() + long(end));
    }

private:
    struct Range {
        int32_t low, high;
    };
    std::vector<Range> ranges_;
};

/// The buffers of one line, with room for vectors that overhang.
struct Line {
    std::vector<float> q_room;
    std::vector<int32_t> key;
    std::vector<uint16_t> torn;
    std::vector<uint8_t> rising, classes;

    explicit Line(size_t longest)
        : q_room(longest + 2 * sweep::padding, nan_f),
          key(longest + 2 * sweep::padding),
          torn(longest / block + 2),
          rising(longest / block + 2),
          classes(longest + 2 * sweep::padding) {}
    float* q() { return q_room.data() + sweep::padding; }
};

void copy_reversed(const uint8_t* from, size_t n, uint8_t* to) {
    size_t i = 0;
    for (; i + 8 <= n; i += 8) {
        uint64_t eight;
        std::memcpy(&eight, from + n - i - 8, 8);
        eight = __builtin_bswap64(eight);
        std::memcpy(to + i, &eight, 8);
    }
    for (; i < n; ++i) to[i] = from[n - 1 - i];
}

/// What a pass knows at one place of a line: the highest key ahead and what only walls cover.
struct Horizon {
    int32_t highest = 0;
    Gaps gaps;
    bool known = false;
};

/// The recorded rays along a line, and the ball round V that is taken as free.
struct Rays {
    glm::dvec3 first, step;  ///< of sample 0, and from one sample to the next; z = 1
    glm::dvec3 centre_m;
    double clear_m;

    /// How far a wall reaches over a sample without a measurement, where anything may stand but in the ball: 1/z on
    /// the far side of the ball, 0 for all the way to the camera.
    double free_from(double position) const {
        const glm::dvec3 r = first + position * step;
        const double rr = glm::dot(r, r), rc = glm::dot(r, centre_m);
        const double inside = rc * rc - rr * (glm::dot(centre_m, centre_m) - clear_m * clear_m);
        const double z = inside >= 0 ? (rc + std::sqrt(inside)) / rr : 0;
        return z > 0 ? 1 / z : 0;
    }
};

/// A pass over the n samples of a line, from V's end back.
class LineSweep {
public:
    LineSweep(const LineRule& rule, const Rays& rays, Line& line, size_t n, Horizon& horizon)
        : rule_(rule), rays_(rays), line_(line), q_(line.q()), n_(n), highest_(horizon.highest), gaps_(horizon.gaps) {
        std::fill_n(q_ + n, sweep::padding, nan_f);
        kernels().keys(rule, q_, n, line.key.data(), line.torn.data(), line.rising.data());
    }

    /// Samples end - 1 down to begin; the horizon is that before sample end - 1.
    void run(size_t begin, size_t end) {
        const int32_t* key = line_.key.data();
        uint8_t* out = line_.classes.data();
        while (end > begin) {
            const size_t b = (end - 1) / block;
            const size_t from = std::max(b * block, begin);
            if (line_.rising[b] && end - from == block && highest_ == key[end]) {
                std::fill_n(out + from, block, uint8_t(0));
                highest_ = key[from];
                end = from;
                continue;
            }
            const uint32_t torn = line_.torn[b];
            for (size_t i = end; i-- > from;) {
                int32_t start;  // of the surface that ends at sample i
                if (i + 1 == n_)
                    start = begin_at_border(i);
                else if (torn >> (i - b * block) & 1)
                    start = pass_tear(i);
                else
                    start = key[i + 1];
                out[i] = invalid(i) ? uint8_t(unknown_bit) : ask(start, key[i]);
            }
            end = from;
        }
    }

    /// Goes on from the horizon of another line, which came as far as sample `end`.
    void go_on(size_t end) {
        if (!invalid(end) && line_.key[end] > highest_) highest_ = line_.key[end];
    }

private:
    const LineRule& rule_;
    const Rays& rays_;
    Line& line_;
    float* q_;
    size_t n_;
    int32_t& highest_;
    Gaps& gaps_;

    bool solid(size_t i) const { return q_[i] > 1e-20f; }
    bool invalid(size_t i) const { return !(q_[i] >= 0); }
    bool joined(size_t i) const { return !(line_.torn[i / block] >> (i % block) & 1) && solid(i) && solid(i + 1); }

    /// The class of a sample with `key`, at the end of a surface that came from `start`.
    uint8_t ask(int32_t start, int32_t key) {
        uint8_t answer = 0;
        if (key > highest_) {
            if (!gaps_.empty() && start <= gaps_.highest()) gaps_.cover(start, highest_);
            highest_ = key;
        } else if (start >= key) {
            answer = occluded_bit;  // faces away
            if (!gaps_.empty()) gaps_.cover(key, start);
        } else if (gaps_.empty()) {
            answer = occluded_bit;
        } else {
            answer = gaps_.holds(key) ? unknown_bit : occluded_bit;
            gaps_.cover(start, key);
        }
        return answer;
    }

    /// 1/z where sample i's own surface ends, half a sample towards i + way across a tear (as lift.h has it).
    int32_t half_edge_key(size_t i, int way) const {
        const float own = q_[i];
        float q = own;
        if (way > 0 ? i > 0 && joined(i - 1) : i + 1 < n_ && joined(i)) {
            const float other = q_[way > 0 ? i - 1 : i + 1];
            q = std::clamp(own + 0.5f * (own - other), 0.5f * own, 2.0f * own);
        }
        return sweep::key_of(rule_, float(i) + 0.5f * float(way), q);
    }

    /// The top of a wall beside a sample without a measurement.
    int32_t top_key(float position) const {
        const double q = rays_.free_from(double(position));
        return q > 0 ? sweep::key_of(rule_, position, float(q)) : sweep::top_key;
    }

    /// The last sample's surface ends at the border, without a wall: what passes below it came there through one.
    int32_t begin_at_border(size_t i) {
        const int32_t start = solid(i)     ? half_edge_key(i, +1)
                              : invalid(i) ? top_key(float(i) + 0.5f)
                                           : sweep::key_of(rule_, float(i) + 0.5f, 0);
        gaps_.clear();
        gaps_.push(std::numeric_limits<int32_t>::min() / 2, start);
        highest_ = start;
        return start;
    }

    /// From sample i + 1 over its surface's end and the wall to where sample i's surface begins.
    int32_t pass_tear(size_t i) {
        const float middle = float(i) + 0.5f;
        int32_t far;
        if (solid(i + 1)) {
            far = half_edge_key(i + 1, -1);
            ask(line_.key[i + 1], far);
        } else {
            far = invalid(i + 1) ? top_key(middle) : sweep::key_of(rule_, middle, 0);
        }
        const int32_t near = invalid(i) ? top_key(middle) : sweep::key_of(rule_, middle, 0);
        const int32_t start = solid(i) ? half_edge_key(i, +1) : near;
        const int32_t top = std::max(start, far);
        if (top > highest_) {
            gaps_.push(highest_ + 1, top);
            highest_ = top;
        }
        return start;
    }
};

// Near the epipole only every 2^level-th line goes on, and no more than this.
constexpr int highest_level = 5;
constexpr int lines_per_block = 1 << highest_level;

/// Lines of one fan: those that run along one image axis more than along the other, on one side of the epipole.
/// They are numbered outwards from the epipole at the far border, so that a mirrored image has the mirrored lines.
struct Fan {
    bool transposed = false;  ///< the major axis is y
    int heading = 1;          ///< +1: towards V the major coordinate grows
    int majors = 0, minors = 0;
    int first_line = 0, lines = 0;  ///< multiples of lines_per_block
    int major_begin = 0, major_end = 0;
    double far_major = 0, far_minor = 0;  ///< line j passes far_minor + j / density at the far border
    double density = 1;                   ///< lines per pixel at the far border
    enum class Epipole { none, far, near } epipole = Epipole::none;
    double epipole_major = 0, epipole_minor = 0;
    double slope = 0;  ///< of lines that do not meet
    // A pixel's line is by_major * by_minor with a near epipole, else density * minor + by_major * by_minor.
    std::vector<float> by_major, by_minor;
    std::vector<int32_t> level;    ///< per major: every 2^level-th line is there
    std::vector<uint8_t> classes;  ///< lines x majors

    struct Straight {
        double at_zero, slope;  ///< minor = at_zero + slope * major, both in pixels as in the image
    };
    Straight line(int number) const {
        const double at_far = far_minor + number / density;
        const double s = epipole == Epipole::none ? slope : (at_far - epipole_minor) / (far_major - epipole_major);
        return {at_far - s * far_major, s};
    }
};

}  // namespace

namespace sweep {

int32_t key_of(const LineRule& rule, float position, float q) {
    const float clear = 1.0f - rule.centre_z * q;
    const float disparity = std::fabs(rule.gain0 + rule.gain_step * position) * q / clear;
    const float size = std::min(std::fabs(disparity) * key_scale, largest_disparity_px * key_scale);
    const int32_t place = rule.place0 * int32_t(key_scale) + int32_t(position * key_scale);  // whole: halves of a pixel
    const int32_t whole = int32_t(size + 0.5f);
    return (clear > 0 ? whole : (1 << 30) - whole) - place;
}

}  // namespace sweep

struct Sweeper::Buffers {
    std::vector<float> inverse, marked, transposed, x_table;
    std::vector<Fan> fans;
};

Sweeper::Sweeper() : buffers_(std::make_unique<Buffers>()) {}
Sweeper::~Sweeper() = default;

namespace {

sweep::PixelRule pixel_rule(const SweepCamera& camera) {
    const Intrinsics &r = camera.recorded, &s = camera.shifted;
    const Pose shifted_from_recorded = inverse(camera.recorded_from_shifted);
    const glm::dmat3 to_pixel(glm::dvec3(s.fx, 0, 0), glm::dvec3(0, s.fy, 0), glm::dvec3(s.cx, s.cy, 1));
    const glm::dmat3 to_ray(glm::dvec3(1 / r.fx, 0, 0), glm::dvec3(0, 1 / r.fy, 0),
                            glm::dvec3(-r.cx / r.fx, -r.cy / r.fy, 1));
    const glm::dmat3 turn = to_pixel * shifted_from_recorded.rotation * to_ray;
    const glm::dvec3 move = to_pixel * shifted_from_recorded.translation_m;
    sweep::PixelRule rule;
    for (int row = 0; row < 3; ++row) {
        for (int column = 0; column < 3; ++column) rule.to_shifted[row][column] = float(turn[column][row]);
        rule.to_shifted[row][3] = float(move[row]);
        rule.centre[row] = float(camera.recorded_from_shifted.translation_m[row]);
    }
    rule.ray_x0 = float((0.5 - r.cx) / r.fx), rule.ray_dx = float(1 / r.fx);
    rule.ray_y0 = float((0.5 - r.cy) / r.fy), rule.ray_dy = float(1 / r.fy);
    rule.fx = float(r.fx), rule.fy = float(r.fy), rule.cx = float(r.cx), rule.cy = float(r.cy);
    rule.width = float(r.width), rule.height = float(r.height);
    rule.shifted_width = float(s.width), rule.shifted_height = float(s.height);
    rule.clear_m = float(camera.clear_m);
    return rule;
}

/// One image axis of the camera as the lines see it.
struct Axis {
    double focal, middle, centre_m;  ///< of R along this axis: focal length, principal point, V's centre
    int size;
};

/// The way to V of a pixel on the line coordinate `at` of an axis, up to a positive factor.
double way(const Axis& axis, double at, double centre_z) {
    return axis.focal * axis.centre_m - (at - axis.middle) * centre_z;
}

/// Whether epipolar lines keep to the rows, at the image's corners too.
bool is_row_aligned(const Axis& x, const Axis& y, double centre_z) {
    const double across = std::max(std::fabs(way(y, 0, centre_z)), std::fabs(way(y, y.size, centre_z)));
    const double left = way(x, 0, centre_z), right = way(x, x.size, centre_z);
    return (left > 0) == (right > 0) && across * x.size <= row_aligned_px * std::min(std::fabs(left), std::fabs(right));
}

LineRule line_rule(const Axis& major, double centre_z, double baseline, int first, int heading) {
    const LiftOptions options;
    LineRule rule;
    rule.place0 = 0;
    rule.gain0 = float((first + 0.5 - major.middle) * centre_z - major.focal * major.centre_m);
    rule.gain_step = float(heading * centre_z);
    rule.centre_z = float(centre_z);
    rule.tear_scale = float(major.focal * baseline);
    rule.tear_px = float(options.tear_px), rule.tear_break = float(options.tear_break);
    return rule;
}

/// Whole blocks of lines that hold [low, high].
void number_lines(Fan& fan, double low, double high) {
    fan.first_line = (int(std::floor(low / lines_per_block)) - 1) * lines_per_block;
    fan.lines = (int(std::ceil(high / lines_per_block)) + 1) * lines_per_block - fan.first_line;
}

// With the epipole nearer than this, lines are numbered from it; farther off that would take more digits than a
// float has, and no line is left out anyway.
constexpr double near_epipole_px = 65536;

/// The fans of lines that cover the image; their buffers are reused.
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
        }
    }
    fans.resize(count);
}

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
    const auto there = [&](int m) { return fan.level[size_t(m)] <= own_level; };
    bool cut = false;
    if (epipole_first)
        while (begin < end && !there(begin)) ++begin, cut = true;
    else
        while (begin < end && !there(end - 1)) --end, cut = true;
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
    LineRule rule = line_rule(major, c.z, glm::length(c), first, fan.heading);
    const auto ray_at = [&](double m) {
        const double n = line.at_zero + line.slope * m;
        return ray(k, fan.transposed ? glm::dvec2(n, m) : glm::dvec2(m, n));
    };
    const Rays rays{ray_at(first + 0.5), ray_at(first + 0.5 + fan.heading) - ray_at(first + 0.5), c, camera.clear_m};
    rule.place0 = fan.heading > 0 ? first : fan.majors - 1 - first;
    kernels().sample(image, fan.majors, fan.minors, first, fan.heading, n, float(line.at_zero + 0.5 * line.slope),
                     float(line.slope), room.line.q());
    Horizon& horizon = room.horizon;
    if (from) horizon = *from;
    LineSweep pass(rule, rays, room.line, n, horizon);
    size_t at = n;
    if (from) pass.go_on(--at);
    if (inwards)
        for (int level = own_level; level-- > 0;) {
            // The place where lines of `level` begin: leave the horizon there for them.
            size_t stop = at;
            while (stop > 0 && fan.level[size_t(first + fan.heading * int(stop - 1))] > level) --stop;
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

void sweep_fan(const SweepCamera& camera, const float* image, Fan& fan) {
    static const std::array<int, lines_per_block> order = block_order();
    fan.classes.resize(size_t(fan.lines) * size_t(fan.majors) + sweep::padding);
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

/// Each pixel of a run takes the answer of its nearest line.
void take_run(const Fan& fan, int x_begin, int x_end, int y, const float* x_table, uint8_t* out) {
    if (x_begin >= x_end) return;
    sweep::Take rule{fan.classes.data(), fan.majors, fan.first_line, nullptr, 0, 0, nullptr, 0, 0, 0};
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

void transpose(const float* in, int width, int height, float* out) {
    constexpr int tile = 32;
    tbb::parallel_for(tbb::blocked_range<int>(0, (width + tile - 1) / tile), [&](const tbb::blocked_range<int>& range) {
        for (int x0 = range.begin() * tile; x0 < std::min(width, range.end() * tile); x0 += tile)
            for (int y0 = 0; y0 < height; y0 += tile)
                for (int x = x0; x < std::min(x0 + tile, width); ++x)
                    for (int y = y0; y < std::min(y0 + tile, height); ++y)
                        out[size_t(x) * size_t(height) + size_t(y)] = in[size_t(y) * size_t(width) + size_t(x)];
    });
}

/// Each value marked in its lowest bit where it is torn from the next row's.
void mark(const float* in, int width, int height, double focal, double baseline, float* out) {
    const LiftOptions options;
    tbb::parallel_for(tbb::blocked_range<int>(0, height, 16), [&](const tbb::blocked_range<int>& range) {
        for (int y = range.begin(); y < range.end(); ++y) {
            const float* rows[4];
            for (int k = 0; k < 4; ++k) {
                const int row = y - 1 + k;
                rows[k] = row < 0 || row >= height ? nullptr : in + size_t(row) * size_t(width);
            }
            kernels().mark_rows(rows, size_t(width), float(focal * baseline), float(options.tear_px),
                                float(options.tear_break), out + size_t(y) * size_t(width));
        }
    });
}

}  // namespace

void Sweeper::classes(const SweepCamera& camera, const DepthMap& depth, Grid<uint8_t>& out) {
    const Intrinsics& k = camera.recorded;
    if (depth.width != k.width || depth.height != k.height || k.width < 1 || k.height < 1)
        throw Error(ExitCode::bad_input, "depth: size: got " + std::to_string(depth.width) + "x" +
                                             std::to_string(depth.height) + ", expected " + std::to_string(k.width) +
                                             "x" + std::to_string(k.height));
    if (out.width != k.width || out.height != k.height) out = Grid<uint8_t>(k.width, k.height);
    const glm::dvec3 c = camera.recorded_from_shifted.translation_m;
    const double baseline = glm::length(c);
    const Axis x{k.fx, k.cx, c.x, k.width}, y{k.fy, k.cy, c.y, k.height};
    const sweep::PixelRule rule = pixel_rule(camera);
    const size_t width = size_t(k.width);

    if (baseline == 0 || is_row_aligned(x, y, c.z)) {
        const int heading = way(x, 0.5 * x.size, c.z) >= 0 ? 1 : -1;
        const LineRule row_rule = line_rule(x, c.z, baseline, heading > 0 ? 0 : k.width - 1, heading);
        tbb::enumerable_thread_specific<Line> rooms([&] { return Line(width); });
        tbb::parallel_for(tbb::blocked_range<int>(0, k.height, 8), [&](const tbb::blocked_range<int>& range) {
            Line& room = rooms.local();
            for (int row = range.begin(); row < range.end(); ++row) {
                const glm::dvec3 first = ray(k, {heading > 0 ? 0.5 : k.width - 0.5, row + 0.5});
                const Rays rays{first, {heading / k.fx, 0, 0}, c, camera.clear_m};
                const float* z = &depth.data[size_t(row) * width];
                (heading > 0 ? kernels().inverse : kernels().inverse_reversed)(z, width, room.q());
                Horizon horizon;
                LineSweep(row_rule, rays, room, width, horizon).run(0, width);
                uint8_t* target = &out.data[size_t(row) * width];
                if (heading > 0)
                    std::copy_n(room.classes.data(), width, target);
                else
                    copy_reversed(room.classes.data(), width, target);
                kernels().pixels(rule, z, row, width, target);
            }
        });
        return;
    }

    Buffers& b = *buffers_;
    plan(x, y, c.z, camera.lines_per_px, b.fans);
    b.x_table.resize(width);
    for (size_t i = 0; i < width; ++i) b.x_table[i] = float(i);
    const size_t room = depth.size() + sweep::padding;
    b.inverse.resize(room), b.marked.resize(room);
    tbb::parallel_for(tbb::blocked_range<int>(0, k.height, 16), [&](const tbb::blocked_range<int>& range) {
        const size_t first = size_t(range.begin()) * width, count = size_t(range.end() - range.begin()) * width;
        kernels().inverse(&depth.data[first], count, &b.inverse[first]);
    });
    for (const bool transposed : {false, true}) {
        const bool needed =
            std::any_of(b.fans.begin(), b.fans.end(), [&](const Fan& f) { return f.transposed == transposed; });
        if (!needed) continue;
        if (transposed) {
            b.transposed.resize(room);
            transpose(b.inverse.data(), k.width, k.height, b.transposed.data());
        }
        mark(transposed ? b.transposed.data() : b.inverse.data(), transposed ? k.height : k.width,
             transposed ? k.width : k.height, transposed ? k.fx : k.fy, baseline, b.marked.data());
        for (Fan& fan : b.fans)
            if (fan.transposed == transposed) sweep_fan(camera, b.marked.data(), fan);
    }
    tbb::parallel_for(tbb::blocked_range<int>(0, k.height, 8), [&](const tbb::blocked_range<int>& range) {
        for (int row = range.begin(); row < range.end(); ++row) {
            uint8_t* target = &out.data[size_t(row) * width];
            if (b.fans.size() == 1 && b.fans[0].epipole == Fan::Epipole::none) {
                take_run(b.fans[0], 0, k.width, row, b.x_table.data(), target);
            } else {
                // |x - epipole| >= |y - epipole|: the lines along x.
                const double ex = k.fx * c.x / c.z + k.cx, ey = k.fy * c.y / c.z + k.cy;
                const double dy = std::fabs(row + 0.5 - ey);
                const int left = int(std::clamp(std::floor(ex - dy - 0.5) + 1, 0.0, double(k.width)));
                const int right = int(std::clamp(std::ceil(ex + dy - 0.5), double(left), double(k.width)));
                for (const Fan& fan : b.fans) {
                    const bool after = fan.transposed ? row + 0.5 > ey : true;
                    if (!fan.transposed) {
                        const bool on_right = fan.far_major > ex;
                        take_run(fan, on_right ? right : 0, on_right ? k.width : left, row, b.x_table.data(), target);
                    } else if (after == (fan.far_major > ey)) {
                        take_run(fan, left, right, row, b.x_table.data(), target);
                    }
                }
            }
            kernels().pixels(rule, &depth.data[size_t(row) * width], row, width, target);
        }
    });
}

RecordedMasks masks_of(const Grid<uint8_t>& classes) {
    RecordedMasks out;
    for (Mask* m : {&out.lost, &out.occluded, &out.outside, &out.unknown, &out.unseen})
        *m = Mask(classes.width, classes.height, 0);
    for (size_t i = 0; i < classes.size(); ++i) {
        const uint8_t c = classes.data[i];
        out.occluded.data[i] = c & occluded_bit ? 1 : 0;
        out.outside.data[i] = c & outside_bit ? 1 : 0;
        out.unknown.data[i] = c & unknown_bit ? 1 : 0;
        out.unseen.data[i] = c & unseen_bit ? 1 : 0;
        out.lost.data[i] = c & (occluded_bit | outside_bit) ? 1 : 0;
    }
    return out;
}

}  // namespace vshift
