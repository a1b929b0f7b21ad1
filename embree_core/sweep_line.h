// SPDX-License-Identifier: Apache-2.0
// Role: a pass along an epipolar line, from V's end back: what it knows at a place, how it goes on from one sample to
// the next (`Horizon`), and the pass over a row of pixels (`RowSweep`). sweep.h says why one pass is enough.
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
    const int32_t place = int32_t(position * key_scale);  // whole: halves of a pixel
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

    struct Range {
        int32_t low, high;
    };
    /// The n-th gap from above; where there is none, of the least number.
    Range from_above(size_t n) const {
        constexpr int32_t least = std::numeric_limits<int32_t>::min();
        return n < ranges_.size() ? ranges_[ranges_.size() - 1 - n] : Range{least, least};
    }
    /// The highest gap, if there is one, now begins at `low`.
    void raise_highest(int32_t low) {
        if (!empty()) ranges_.back().low = low;
    }

private:
    std::vector<Range> ranges_;
};

/// How far a wall reaches over a sample without a measurement, where anything may stand but in the ball round V: 1/z on
/// the far side of the ball, 0 for all the way to the camera. `ray` is the sample's, z = 1.
inline double free_from(const glm::dvec3& ray, const glm::dvec3& centre_m, double clear_m) {
    const double rr = glm::dot(ray, ray), rc = glm::dot(ray, centre_m);
    const double inside = rc * rc - rr * (glm::dot(centre_m, centre_m) - clear_m * clear_m);
    const double z = inside >= 0 ? (rc + std::sqrt(inside)) / rr : 0;
    return z > 0 ? 1 / z : 0;
}

inline bool is_solid(float q) {
    return q > least_solid;
}
inline bool is_invalid(float q) {
    return !(q >= 0);
}

/// Sample i of a line and those beside it; V lies ahead.
struct Around {
    float behind, here, ahead, beyond;    ///< 1/z of samples i - 1 to i + 2, NaN past the line's ends
    bool torn_behind, torn, torn_beyond;  ///< samples i - 1, i and i + 1 from the next one
    int32_t key, key_ahead;               ///< of samples i and i + 1
    bool is_last = false;                 ///< no sample lies ahead
    /// How far from sample i to i + 1 its surface reaches if they are torn apart, and from where on that of sample i +
    /// 1 does. Apart, there are two tears, whatever `torn` says, and between them a surface with 1/z `between`.
    float tear = 0.5f, tear_ahead = 0.5f;
    float between = 0;
};

/// What a pass knows at one place of a line: the highest key ahead and what only walls cover.
struct Horizon {
    int32_t highest = 0;
    Gaps gaps;

    /// The class of sample i, at `position` on the line, which is passed. `free_from(position)` is that of its ray.
    template <class FreeFrom>
    uint8_t pass(const LineRule& rule, float position, const Around& at, const FreeFrom& free_from) {
        int32_t start;  // of the surface that ends at the sample
        if (at.is_last)
            start = begin_at_border(rule, position, at, free_from);
        else if (at.torn || at.tear != at.tear_ahead)
            start = pass_tear(rule, position, at, free_from);
        else
            start = at.key_ahead;
        const int32_t hides = std::max(highest, start);
        const uint8_t answer = is_invalid(at.here) ? uint8_t(unknown_bit) : ask(start, at.key);
        return answer == occluded_bit && allowed_key(rule, position, at) >= hides ? uint8_t(0) : answer;
    }

private:
    /// The key that the sample may have for all that its error and that of what hides it allow.
    static int32_t allowed_key(const LineRule& rule, float position, const Around& at) {
        if (rule.error.none() || !is_solid(at.here)) return at.key;
        return std::max(at.key, key_of(rule, position, at.here + 2 * rule.error.at(at.here)));
    }

    /// The class of a sample with `key`, at the end of a surface that came from `start`.
    uint8_t ask(int32_t start, int32_t key) {
        uint8_t answer = 0;
        if (key > highest) {
            if (!gaps.empty() && start <= gaps.highest()) gaps.cover(start, highest);
            highest = key;
        } else if (start >= key) {
            answer = occluded_bit;  // faces away
            if (!gaps.empty()) gaps.cover(key, start);
        } else if (gaps.empty()) {
            answer = occluded_bit;
        } else {
            answer = gaps.holds(key) ? unknown_bit : occluded_bit;
            gaps.cover(start, key);
        }
        return answer;
    }

    /// Where a surface ends that goes on `reach` samples past `own`, the sample at `position`, `way` along the line.
    /// `joined` is the sample before it, or null where there is none.
    static int32_t edge_key(const LineRule& rule, float position, float own, const float* joined, float way,
                            float reach) {
        const float q = joined ? std::clamp(own + reach * (own - *joined), 0.5f * own, 2.0f * own) : own;
        return key_of(rule, position + reach * way, q);
    }
    /// Of the sample's own surface, towards V.
    static int32_t near_edge(const LineRule& rule, float position, const Around& at, float reach) {
        const bool joined = !at.torn_behind && is_solid(at.behind);
        return edge_key(rule, position, at.here, joined ? &at.behind : nullptr, 1, reach);
    }
    /// Of the surface ahead, away from V.
    static int32_t far_edge(const LineRule& rule, float position, const Around& at, float reach) {
        const bool joined = !at.torn_beyond && is_solid(at.beyond);
        return edge_key(rule, position + 1, at.ahead, joined ? &at.beyond : nullptr, -1, reach);
    }

    /// The top of a wall beside a sample without a measurement.
    template <class FreeFrom>
    static int32_t wall_top(const LineRule& rule, float position, const FreeFrom& free_from) {
        const double q = free_from(double(position));
        return q > 0 ? key_of(rule, position, float(q)) : top_key;
    }

    /// The last sample's surface ends at the border, without a wall: what passes below it came there through one.
    template <class FreeFrom>
    int32_t begin_at_border(const LineRule& rule, float position, const Around& at, const FreeFrom& free_from) {
        const int32_t start = is_solid(at.here)     ? near_edge(rule, position, at, rule.reach)
                              : is_invalid(at.here) ? wall_top(rule, position + 0.5f, free_from)
                                                    : key_of(rule, position + 0.5f, 0);
        gaps.clear();
        gaps.push(std::numeric_limits<int32_t>::min() / 2, start);
        highest = start;
        return start;
    }

    void raise_wall(int32_t top) {
        if (top <= highest) return;
        gaps.push(highest + 1, top);
        highest = top;
    }

    /// From sample i + 1 over its surface's end and the wall to where sample i's surface begins.
    template <class FreeFrom>
    int32_t pass_tear(const LineRule& rule, float position, const Around& at, const FreeFrom& free_from) {
        const bool halves = rule.reach == 0.5f;  // as in lift.h, both sides reach to the tear
        const float share = halves ? at.tear : 0.5f, share_ahead = halves ? at.tear_ahead : 0.5f;
        const float middle = position + share, middle_ahead = position + share_ahead;
        int32_t far;
        if (is_solid(at.ahead)) {
            far = far_edge(rule, position, at, halves ? 1 - share_ahead : rule.reach);
            ask(at.key_ahead, far);
        } else {
            far = is_invalid(at.ahead) ? wall_top(rule, middle_ahead, free_from) : key_of(rule, middle_ahead, 0);
        }
        if (share != share_ahead) {
            const int32_t begin = key_of(rule, middle_ahead, at.between);
            raise_wall(std::max(far, begin));
            far = key_of(rule, middle, at.between);
            ask(begin, far);
        }
        int32_t start;
        if (is_solid(at.here))  // with no reach it begins at the sample, and does not face away
            start = rule.reach == 0 ? at.key - 1 : near_edge(rule, position, at, halves ? share : rule.reach);
        else
            start = is_invalid(at.here) ? wall_top(rule, middle, free_from) : key_of(rule, middle, 0);
        raise_wall(std::max(start, far));
        return start;
    }
};

/// The buffers of one row, with room for vectors that overhang.
struct Row {
    static constexpr size_t word = 4;  ///< elements of `rising_room` before the first, read but never set
    std::vector<float> q_room;
    std::vector<int32_t> key;
    std::vector<uint16_t> torn, rising_room;
    std::vector<uint8_t> classes;

    explicit Row(size_t longest)
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

/// The recorded rays along a row: of sample 0, and from one sample to the next; z = 1.
struct Rays {
    glm::dvec3 first, step;
    glm::dvec3 centre_m;
    double clear_m;
    double free_from(double position) const { return sweep::free_from(first + position * step, centre_m, clear_m); }
};

/// A pass over the n samples of a row, from V's end back.
class RowSweep {
public:
    RowSweep(const LineRule& rule, const Rays& rays, Row& row, size_t n)
        : rule_(rule), rays_(rays), row_(row), q_(row.q()), n_(n) {
        std::fill_n(q_ + n, padding, std::numeric_limits<float>::quiet_NaN());
        kernels().keys(rule, q_, n, row.key.data(), row.torn.data(), row.rising());
    }

    void run() {
        const int32_t* key = row_.key.data();
        uint8_t* out = row_.classes.data();
        std::memset(out, 0, n_);
        const auto free_from = [this](double position) { return rays_.free_from(position); };
        for (size_t end = n_; end > 0;) {
            if (horizon_.highest == key[end]) {
                // V sees the surface that reaches sample `end`: as long as it goes on rising, V sees it.
                const size_t from = end;
                end = row_.rises_from(0, end);
                if (end < from) {
                    horizon_.highest = key[end];
                    continue;
                }
            }
            if (no_error_ && !torn(end - 1) && key[end - 1] < horizon_.highest) {
                pass_hidden(end);
                continue;
            }
            const size_t i = --end;
            const Around around{q_[ptrdiff_t(i) - 1], q_[i],  q_[i + 1],  q_[i + 2],  i == 0 || torn(i - 1), torn(i),
                                torn(i + 1),          key[i], key[i + 1], i + 1 == n_};
            out[i] = horizon_.pass(rule_, float(i), around, free_from);
        }
    }

private:
    const LineRule& rule_;
    const Rays& rays_;
    Row& row_;
    float* q_;
    size_t n_;
    Horizon horizon_;

    const bool no_error_ = rule_.error.none();

    bool torn(size_t i) const { return row_.torn[i / block] >> (i % block) & 1; }

    /// A surface that runs on below the horizon from sample `end`, as long as it rises or falls: what `Horizon::pass`
    /// answers for its samples one by one.
    void pass_hidden(size_t& end) {
        const int32_t* key = row_.key.data();
        uint8_t* out = row_.classes.data();
        Gaps& gaps = horizon_.gaps;
        const int32_t start = key[end], highest = horizon_.highest;
        const auto goes_on = [&] { return end > 0 && !torn(end - 1) && key[end - 1] < highest; };
        if (key[end - 1] <= start) {
            while (goes_on() && key[end - 1] <= key[end]) out[--end] = occluded_bit;  // faces away
            gaps.cover(key[end], start);
            return;
        }
        const size_t stop = row_.rises_from(0, end);
        size_t gap = gaps.lowest_from(key[end - 1]);
        while (end > stop && key[end - 1] < highest) {
            // Keys up to the next gap's end, or within a gap.
            const Gaps::Stretch stretch = gaps.stretch(gap, key[end - 1]);
            const int32_t below = std::min(stretch.end, highest);
            const uint8_t answer = stretch.gap ? unknown_bit : occluded_bit;
            while (end > stop && key[end - 1] < below) out[--end] = answer;
        }
        gaps.cover(start, key[end]);
    }
};

}  // namespace vshift::sweep
