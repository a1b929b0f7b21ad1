// SPDX-License-Identifier: Apache-2.0
// Role: one pass along one epipolar line: which of its samples V sees (sweep.h says why one pass is enough).
#pragma once
#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <glm/glm.hpp>
#include <limits>
#include <vector>

#include "embree_core/sweep.h"
#include "embree_core/sweep_kernels.h"

namespace vshift::sweep {

inline constexpr size_t block = 16;

inline int32_t key_of(const LineRule& rule, float position, float q) {
    const float clear = 1.0f - rule.centre_z * q;
    const float beside = std::fabs(rule.gain0 + rule.gain_step * position) * q;
    const float disparity = rule.centre_z == 0 ? beside : beside / clear;
    const float size = std::min(std::fabs(disparity) * key_scale, largest_disparity_px * key_scale);
    const int32_t place = rule.place0 * int32_t(key_scale) + int32_t(position * key_scale);  // whole: halves of a pixel
    const int32_t whole = int32_t(size + 0.5f);
    return (clear > 0 ? whole : (1 << 30) - whole) - place;
}

/// Ranges of keys that only torn walls cover, apart and in order.
class Gaps {
public:
    bool empty() const { return ranges_.empty(); }
    void clear() { ranges_.clear(); }
    int32_t highest() const { return ranges_.back().high; }
    bool holds(int32_t key) const { return holds(lowest_from(key), key); }
    /// The number of the lowest gap that reaches `key` or higher.
    size_t lowest_from(int32_t key) const {
        size_t i = ranges_.size();
        while (i > 0 && ranges_[i - 1].high >= key) --i;
        return i;
    }
    bool holds(size_t i, int32_t key) const { return i < ranges_.size() && ranges_[i].low <= key; }
    /// The gap, or the way between two, that `key` lies in, and the first key after it. `i` is moved on from the number
    /// of a lower key's gap.
    struct Stretch {
        bool gap;
        int32_t end;
    };
    Stretch stretch(size_t& i, int32_t key) const {
        while (i < ranges_.size() && ranges_[i].high < key) ++i;
        if (i == ranges_.size()) return {false, std::numeric_limits<int32_t>::max()};
        return ranges_[i].low <= key ? Stretch{true, ranges_[i].high + 1} : Stretch{false, ranges_[i].low};
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
    static constexpr size_t word = 4;  ///< elements of `rising_room` before the first, read but never set
    std::vector<float> q_room;
    std::vector<int32_t> key;
    std::vector<uint16_t> torn, rising_room;
    std::vector<uint8_t> classes;

    explicit Line(size_t longest)
        : q_room(longest + 2 * padding, std::numeric_limits<float>::quiet_NaN()),
          key(longest + 2 * padding),
          torn(longest / block + 2),
          rising_room(longest / block + 2 + word),
          classes(longest + 2 * padding) {}
    float* q() { return q_room.data() + padding; }
    uint16_t* rising() { return rising_room.data() + word; }

    /// The first of the samples before `end`, down to `begin`, that rise without a tear from it on; `end` if none does.
    size_t rises_from(size_t begin, size_t end) const {
        const uint8_t* bits = reinterpret_cast<const uint8_t*>(rising_room.data() + word);
        while (end > begin) {
            uint64_t last;  // the bits of samples up to end - 1 and `beyond` more
            std::memcpy(&last, bits + ptrdiff_t((end - 1) / 8) - 7, 8);
            const size_t beyond = 7 - (end - 1) % 8;
            const size_t run = size_t(std::countl_zero(~(last << beyond)));
            end -= std::min(run, end - begin);
            if (run < 64 - beyond) break;
        }
        return end;
    }
};

inline void copy_reversed(const uint8_t* from, size_t n, uint8_t* to) {
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

/// Where a line crosses from one row of pixels to the next, which tears between rows hang on.
struct RowCrossings {
    const float* image = nullptr;  ///< as `Kernels::sample` reads it; null: the line keeps to a row
    int stride = 0, rows = 0;
    int first = 0, step = 1;  ///< column of sample 0, and to the next one
    float v0 = 0, slope = 0;  ///< the line is at v0 + slope * column, row r from r to r + 1

    /// How far from sample i to i + 1, which are torn apart, the tear lies: midway between their columns, or where the
    /// line crosses into another row if the pixels there are torn.
    float place(size_t i) const {
        constexpr float middle = 0.5f;
        if (!image) return middle;
        const int column = first + step * int(i);
        const float at = slope * float(column) + v0, rise = slope * float(step);
        const int lower = int(at + 0.5f * rise + 0.5f);  // the border of rows that it is nearest to on its way
        const float share = (float(lower) - at) / rise;
        // At a sample itself the line crosses a border for either side of it or for none.
        if (!(share > 1.0f / 256 && share < 255.0f / 256) || lower < 1 || lower >= rows) return middle;
        const float* pixel = image + ptrdiff_t(lower - 1) * stride + column + (share < middle ? 0 : step);
        if (!(std::bit_cast<uint32_t>(*pixel) & 1)) return middle;
        constexpr float digits = 256;  // few enough for whole keys
        return float(int(share * digits + 0.5f)) / digits;
    }
};

/// A pass over the n samples of a line, from V's end back.
class LineSweep {
public:
    LineSweep(const LineRule& rule, const Rays& rays, const RowCrossings& crossings, Line& line, size_t n,
              Horizon& horizon)
        : rule_(rule),
          rays_(rays),
          crossings_(crossings),
          line_(line),
          q_(line.q()),
          n_(n),
          highest_(horizon.highest),
          gaps_(horizon.gaps) {
        std::fill_n(q_ + n, padding, std::numeric_limits<float>::quiet_NaN());
        kernels().keys(rule, q_, n, line.key.data(), line.torn.data(), line.rising());
    }

    /// Samples end - 1 down to begin; the horizon is that before sample end - 1.
    void run(size_t begin, size_t end) {
        const int32_t* key = line_.key.data();
        uint8_t* out = line_.classes.data();
        std::memset(out + begin, 0, end - begin);
        while (end > begin) {
            if (highest_ == key[end]) {
                // V sees the surface that reaches sample `end`: as long as it goes on rising, V sees it.
                const size_t from = end;
                end = line_.rises_from(begin, end);
                if (end < from) {
                    highest_ = key[end];
                    continue;
                }
            }
            if (no_error_ && !torn(end - 1) && key[end - 1] < highest_) {
                pass_hidden(begin, end);
                continue;
            }
            const size_t i = --end;
            int32_t start;  // of the surface that ends at sample i
            if (i + 1 == n_)
                start = begin_at_border(i);
            else if (torn(i))
                start = pass_tear(i);
            else
                start = key[i + 1];
            const int32_t hides = std::max(highest_, start);
            uint8_t answer = invalid(i) ? uint8_t(unknown_bit) : ask(start, key[i]);
            if (answer == occluded_bit && allowed_key(i) >= hides) answer = 0;
            out[i] = answer;
        }
    }

    /// Goes on from the horizon of another line, which came as far as sample `end`.
    void go_on(size_t end) {
        if (!invalid(end) && line_.key[end] > highest_) highest_ = line_.key[end];
    }

private:
    const LineRule& rule_;
    const Rays& rays_;
    const RowCrossings& crossings_;
    Line& line_;
    float* q_;
    size_t n_;
    int32_t& highest_;
    Gaps& gaps_;

    const bool no_error_ = rule_.error.none();

    bool solid(size_t i) const { return q_[i] > 1e-20f; }
    bool invalid(size_t i) const { return !(q_[i] >= 0); }
    bool torn(size_t i) const { return line_.torn[i / block] >> (i % block) & 1; }
    bool joined(size_t i) const { return !torn(i) && solid(i) && solid(i + 1); }

    /// The key that sample i may have for all that its error and that of what hides it allow.
    int32_t allowed_key(size_t i) const {
        if (no_error_ || !solid(i)) return line_.key[i];
        return std::max(line_.key[i], key_of(rule_, float(i), q_[i] + 2 * rule_.error.at(q_[i])));
    }

    /// A surface that runs on below the horizon from sample `end`, as long as it rises or falls: what `ask` answers for
    /// its samples one by one.
    void pass_hidden(size_t begin, size_t& end) {
        const int32_t* key = line_.key.data();
        uint8_t* out = line_.classes.data();
        const int32_t start = key[end];
        const auto goes_on = [&] { return end > begin && !torn(end - 1) && key[end - 1] < highest_; };
        if (key[end - 1] <= start) {
            while (goes_on() && key[end - 1] <= key[end]) out[--end] = occluded_bit;  // faces away
            gaps_.cover(key[end], start);
            return;
        }
        const size_t stop = line_.rises_from(begin, end);
        size_t gap = gaps_.lowest_from(key[end - 1]);
        while (end > stop && key[end - 1] < highest_) {
            // Keys up to the next gap's end, or within a gap.
            const Gaps::Stretch stretch = gaps_.stretch(gap, key[end - 1]);
            const int32_t below = std::min(stretch.end, highest_);
            const uint8_t answer = stretch.gap ? unknown_bit : occluded_bit;
            while (end > stop && key[end - 1] < below) out[--end] = answer;
        }
        gaps_.cover(start, key[end]);
    }

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

    /// Where sample i's own surface ends, `reach` samples towards i + way across a tear.
    int32_t edge_key(size_t i, int way, float reach) const {
        const float own = q_[i];
        float q = own;
        if (way > 0 ? i > 0 && joined(i - 1) : i + 1 < n_ && joined(i)) {
            const float other = q_[way > 0 ? i - 1 : i + 1];
            q = std::clamp(own + reach * (own - other), 0.5f * own, 2.0f * own);
        }
        return key_of(rule_, float(i) + reach * float(way), q);
    }

    /// The top of a wall beside a sample without a measurement.
    int32_t top_key(float position) const {
        const double q = rays_.free_from(double(position));
        return q > 0 ? key_of(rule_, position, float(q)) : sweep::top_key;
    }

    /// The last sample's surface ends at the border, without a wall: what passes below it came there through one.
    int32_t begin_at_border(size_t i) {
        const int32_t start = solid(i)     ? edge_key(i, +1, rule_.reach)
                              : invalid(i) ? top_key(float(i) + 0.5f)
                                           : key_of(rule_, float(i) + 0.5f, 0);
        gaps_.clear();
        gaps_.push(std::numeric_limits<int32_t>::min() / 2, start);
        highest_ = start;
        return start;
    }

    /// From sample i + 1 over its surface's end and the wall to where sample i's surface begins.
    int32_t pass_tear(size_t i) {
        const bool halves = rule_.reach == 0.5f;  // as in lift.h, both sides reach to the tear
        const float share = halves ? crossings_.place(i) : 0.5f, middle = float(i) + share;
        int32_t far;
        if (solid(i + 1)) {
            far = edge_key(i + 1, -1, halves ? 1 - share : rule_.reach);
            ask(line_.key[i + 1], far);
        } else {
            far = invalid(i + 1) ? top_key(middle) : key_of(rule_, middle, 0);
        }
        const int32_t near = invalid(i) ? top_key(middle) : key_of(rule_, middle, 0);
        int32_t start = solid(i) ? edge_key(i, +1, halves ? share : rule_.reach) : near;
        if (rule_.reach == 0 && solid(i)) start = line_.key[i] - 1;  // begins at the sample, and does not face away
        const int32_t top = std::max(start, far);
        if (top > highest_) {
            gaps_.push(highest_ + 1, top);
            highest_ = top;
        }
        return start;
    }
};

}  // namespace vshift::sweep
