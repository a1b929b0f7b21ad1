// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <limits>

#include "embree_core/sweep_kernels.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "embree_core/sweep_walk_kernels.cpp"
#include <hwy/cache_control.h>
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "embree_core/sweep_rules-inl.h"

HWY_BEFORE_NAMESPACE();
namespace vshift::sweep {
namespace HWY_NAMESPACE {

constexpr uint32_t every_line = (1u << Bundle::lines) - 1;

/// A pass along sixteen lines. Sample u of the bundle lies at major first + step * (u - zero).
class Walk {
public:
    Walk(const BundleWalk& w, Bundle& s) : w_(w), s_(s) {}

    HWY_INLINE void run() {
        for (size_t u = zero - 3; u < zero; ++u) sample(u);
        uint32_t inside = sample(zero), inside_next = sample(zero + 1);
        uint32_t torn = torn_behind(zero - 2), torn_next = torn_behind(zero - 1);
        take_key(zero - 1);
        go_on();
        uint32_t begun = s_.known;
        for (size_t u = zero; u < zero + size_t(w_.count); ++u) {
            const uint32_t inside_far = sample(u + 2);
            const uint32_t torn_beyond = torn;
            torn = torn_next, torn_next = torn_behind(u);
            take_key(u);
            const uint32_t crosses = crossing(u);
            const uint32_t joined = ~torn & ~crosses & begun & inside;
            if (joined != every_line || !all_rise(u)) {
                Answers answers = compare(u, joined);
                if (const uint32_t rest = inside & ~answers.known) {
                    const uint32_t decided = w_.decide(
                        w_.self, {u, major_of(u), float(position_of(u)), torn_next, torn, torn_beyond, crosses, begun},
                        rest);
                    answers.occluded |= decided & every_line, answers.unknown |= decided >> Bundle::lines;
                }
                if (answers.occluded | answers.unknown) w_.put(w_.self, major_of(u), answers.occluded, answers.unknown);
            }
            begun = inside, inside = inside_next, inside_next = inside_far;
        }
        s_.known = begun;
    }

private:
    static constexpr size_t zero = Bundle::kept;  // so that the samples before the first have numbers, too
    const BundleWalk& w_;
    Bundle& s_;
    static constexpr F f{};
    static constexpr I d{};
    const bool no_error_ = w_.rule.error.none();

    struct Answers {
        uint32_t known = 0, occluded = 0, unknown = 0;
    };

    static HWY_INLINE size_t lanes() { return hn::Lanes(F()); }
    int major_of(size_t u) const { return w_.first + w_.step * (int(u) - int(zero)); }
    int position_of(size_t u) const { return w_.step < 0 ? major_of(u) : w_.majors - 1 - major_of(u); }
    float* q(size_t u) const { return s_.q[u % Bundle::kept]; }
    HWY_INLINE auto mask_of(uint32_t bits) const {
        const uint8_t bytes[8] = {uint8_t(bits), uint8_t(bits >> 8)};
        return hn::LoadMaskBits(d, bytes);
    }

    /// What will be read some steps on.
    HWY_INLINE void prefetch(int major) const {
        if (major < w_.begin || major >= w_.end) return;
        const int there = int(w_.origin[major] + w_.number * w_.spacing[major]);
        const float* p = w_.image + ptrdiff_t(major) * w_.stride + std::clamp(there, 0, w_.minors);
        hwy::Prefetch(p);
        hwy::Prefetch(p + block);
    }

    /// Where sample u of each line lies: past the middle of the `floor`-th pixel from `Bundle::row`, and how far, 0
    /// to 1.
    HWY_INLINE void across(size_t u, size_t g, V& floor, V& share) const {
        const size_t at_u = u % Bundle::kept;
        const V lane = hn::ConvertTo(f, hn::Iota(d, int32_t(g)));
        const V v = hn::Add(hn::Set(f, s_.past_row[at_u]), hn::Mul(lane, hn::Set(f, s_.step[at_u])));
        floor = hn::Floor(v);
        share = hn::Sub(v, floor);
    }
    /// Of whole numbers from 0 to 2^23, in two operations.
    static HWY_INLINE hn::Vec<I> whole(V number) {
        const V shift = hn::Set(f, 8388608.0f);
        return hn::Sub(hn::BitCast(d, hn::Add(number, shift)), hn::BitCast(d, shift));
    }
    /// The pixel that it lies in, and how far, 0 to 1.
    HWY_INLINE void pixel(size_t u, size_t g, hn::Vec<I>& row, V& within) const {
        V floor;
        across(u, g, floor, within);
        const V half = hn::Set(f, 0.5f);
        const auto in_next = hn::Ge(within, half);
        row = hn::Add(whole(floor), hn::Set(d, s_.row[u % Bundle::kept]));
        row = hn::Add(row, hn::IfThenElseZero(hn::RebindMask(d, in_next), hn::Set(d, 1)));
        within = hn::IfThenElse(in_next, hn::Sub(within, half), hn::Add(within, half));
    }

    /// Samples the height field. Returns which lines are within the image there.
    HWY_INLINE uint32_t sample(size_t u) {
        const int major = major_of(u);
        const size_t at_u = u % Bundle::kept;
        s_.torn_across[at_u] = 0;
        const V nan = hn::Set(f, std::numeric_limits<float>::quiet_NaN());
        if (major < w_.begin || major >= w_.end) {
            for (size_t g = 0; g < block; g += lanes()) hn::StoreU(nan, f, q(u) + g);
            s_.row[at_u] = 0, s_.past_row[at_u] = s_.step[at_u] = 0;
            return 0;
        }
        prefetch(major + 8 * w_.step);
        const double spacing = w_.spacing[major];
        // Far outside it does not matter where.
        const double at = std::clamp(w_.origin[major] + w_.number * spacing - 0.5, -1e6, 1e6);
        const int base = int(std::floor(at));
        s_.row[at_u] = base, s_.past_row[at_u] = float(at - base), s_.step[at_u] = float(w_.unit * spacing);
        const float* row = w_.image + ptrdiff_t(major) * w_.stride;
        const bool within = base >= 0 && base + int(block) < w_.minors;  // as no two lines are a pixel apart
        uint32_t inside = within ? every_line : 0;
        for (size_t g = 0; g < block; g += lanes()) {
            V floor, share;
            across(u, g, floor, share);
            // The pixels on either side are neighbours in memory: one load has those of all lines.
            const int32_t first = base + int32_t(s_.past_row[at_u] + float(g) * s_.step[at_u]);
            const int32_t left = within ? first : std::clamp(first, -1, w_.minors - 1);
            auto index = hn::Add(whole(floor), hn::Set(d, base - left));
            if (!within) index = hn::Min(hn::Max(index, hn::Zero(d)), hn::Set(d, int32_t(lanes()) - 1));
            const auto pick = hn::IndicesFromVec(f, index);
            const V a = hn::TableLookupLanes(hn::LoadU(f, row + left), pick);
            const V b = hn::TableLookupLanes(hn::LoadU(f, row + left + 1), pick);
            const auto torn = hn::RebindMask(f, hn::Eq(hn::And(hn::BitCast(d, a), hn::Set(d, 1)), hn::Set(d, 1)));
            // Midway between two surfaces the nearer one counts, so that a mirrored image gives the mirrored line.
            const V off_middle = hn::Sub(share, hn::Set(f, 0.5f)), from_border = hn::Abs(off_middle);
            const auto in_upper = hn::Lt(off_middle, hn::Zero(f));
            const V own = hn::IfThenElse(hn::Lt(from_border, hn::Set(f, between_pixels)), hn::Max(a, b),
                                         hn::IfThenElse(in_upper, a, b));
            const V between = hn::Add(hn::Mul(share, hn::Sub(b, a)), a);
            V value = hn::IfThenElse(torn, own, between);
            if (!within) {
                // A line along the border counts.
                const V place = hn::Add(hn::Add(floor, hn::Set(f, float(base))), share);
                const auto in = hn::And(hn::Ge(place, hn::Set(f, -0.5f - between_pixels)),
                                        hn::Le(place, hn::Set(f, float(w_.minors) - 0.5f + between_pixels)));
                value = hn::IfThenElse(in, value, nan);
                inside |= bits_of(f, in) << g;
            }
            hn::StoreU(value, f, q(u) + g);
            // At a pixel's centre both its neighbours are as near.
            const auto perhaps = hn::Or(torn, hn::Gt(from_border, hn::Set(f, 0.5f - between_pixels)));
            if (!hn::AllFalse(f, perhaps)) s_.torn_across[at_u] |= bits_of(f, perhaps) << g;
        }
        return inside;
    }

    /// Lines whose samples u and u + 1 are torn apart.
    HWY_INLINE uint32_t torn_behind(size_t u) const {
        uint32_t bits = 0;
        for (size_t g = 0; g < block; g += lanes()) {
            const auto torn = torn_between(hn::LoadU(f, q(u + 2) + g), hn::LoadU(f, q(u + 1) + g),
                                           hn::LoadU(f, q(u) + g), hn::LoadU(f, q(u - 1) + g), w_.rule.tear);
            if (!hn::AllFalse(f, torn)) bits |= bits_of(f, torn) << g;
        }
        return bits;
    }

    /// Lines that cross between samples u and u - 1 into another row of pixels where the two rows are torn apart.
    HWY_INLINE uint32_t crossing(size_t u) const {
        const size_t here = u % Bundle::kept, ahead = (u - 1) % Bundle::kept;
        const uint32_t torn_here = s_.torn_across[here], torn_ahead = s_.torn_across[ahead];
        if (!(torn_here | torn_ahead)) return 0;
        uint32_t crosses = 0, at_own = 0;  // in the column of the sample that is nearer to the border of the rows
        for (size_t g = 0; g < block; g += lanes()) {
            hn::Vec<I> own, next;
            V within_own, within_next;
            pixel(u, g, own, within_own);
            pixel(u - 1, g, next, within_next);
            const V sum = hn::Add(within_own, within_next);
            const V one = hn::Set(f, 1.0f);
            const auto grows = hn::RebindMask(f, hn::Gt(next, own));
            const auto nearer = hn::IfThenElse(grows, hn::Sub(one, sum), hn::Sub(sum, one));
            crosses |= bits_of(d, hn::Ne(own, next)) << g;
            at_own |= bits_of(f, hn::Lt(nearer, hn::Zero(f))) << g;
        }
        return crosses & ((at_own & torn_here) | (~at_own & torn_ahead));
    }

    HWY_INLINE void take_key(size_t u) {
        const int32_t position = position_of(u);
        const V gain = hn::Set(f, std::fabs(w_.rule.gain0 + w_.rule.gain_step * float(position)));
        const V centre_z = hn::Set(f, w_.rule.centre_z);
        const auto place = hn::Set(d, position << 13);
        for (size_t g = 0; g < block; g += lanes()) {
            const V at = hn::LoadU(f, q(u) + g);
            const auto key = w_.rule.centre_z == 0 ? key_vector<true>(at, gain, centre_z, place)
                                                   : key_vector<false>(at, gain, centre_z, place);
            hn::StoreU(key, d, s_.key[u % 2] + g);
        }
    }

    /// A line that goes on from another one's horizon knows the surface that it comes from, too.
    HWY_INLINE void go_on() {
        for (size_t g = 0; g < block; g += lanes()) {
            const auto key = hn::LoadU(d, s_.key[(zero - 1) % 2] + g), highest = hn::LoadU(d, s_.highest + g);
            const V at = hn::LoadU(f, q(zero - 1) + g);
            const auto valid = hn::RebindMask(d, hn::Eq(at, at));
            hn::StoreU(hn::IfThenElse(valid, hn::Max(highest, key), highest), d, s_.highest + g);
        }
    }

    /// Whether all lines, none of which is torn here, rise from their highest key: V sees them, and nothing else is
    /// new.
    HWY_INLINE bool all_rise(size_t u) {
        const int32_t *key_at = s_.key[u % 2], *start_at = s_.key[(u - 1) % 2];
        for (size_t g = 0; g < block; g += lanes()) {
            const auto key = hn::LoadU(d, key_at + g), start = hn::LoadU(d, start_at + g);
            const auto highest = hn::LoadU(d, s_.highest + g);
            if (!hn::AllTrue(d, hn::And(hn::Eq(start, highest), hn::Gt(key, start)))) return false;
        }
        for (size_t g = 0; g < block; g += lanes()) hn::StoreU(hn::LoadU(d, key_at + g), d, s_.highest + g);
        return true;
    }

    /// What `Horizon::pass` answers for those of the joined lines of which comparisons tell.
    HWY_INLINE Answers compare(size_t u, uint32_t joined) {
        const int32_t *key_at = s_.key[u % 2], *start_at = s_.key[(u - 1) % 2];
        Answers answers;
        for (size_t g = 0; g < block; g += lanes()) {
            const auto key = hn::LoadU(d, key_at + g), start = hn::LoadU(d, start_at + g);
            const auto highest = hn::LoadU(d, s_.highest + g), below_gap = hn::LoadU(d, s_.below_gap + g);
            const auto gap_low = hn::LoadU(d, s_.gap_low + g), gap_high = hn::LoadU(d, s_.gap_high + g);
            const auto rises = hn::Gt(key, start), above = hn::Gt(key, highest), below = hn::Lt(key, highest);
            const auto over_gaps = hn::Gt(hn::Min(key, start), gap_high);
            const auto seen = hn::Or(hn::And(rises, hn::Eq(start, highest)), hn::And(over_gaps, above));
            // A hidden surface that rises towards the highest gap, or in it from its lower end.
            const auto apart =
                hn::And(hn::Gt(start, below_gap), hn::And(hn::Lt(start, gap_low), hn::Lt(key, gap_high)));
            const auto to_gap = hn::And(hn::And(rises, below), apart);
            const auto hidden = hn::Or(to_gap, hn::And(over_gaps, below));
            const auto in_gap = hn::AndNot(hn::Lt(key, gap_low), to_gap);
            const uint32_t here = joined >> g, occluded = no_error_ ? bits_of(d, hidden) & here : 0;
            const uint32_t visible = bits_of(d, seen) & here, unknown = occluded & bits_of(d, in_gap);
            hn::StoreU(hn::IfThenElse(mask_of(visible), key, highest), d, s_.highest + g);
            hn::StoreU(hn::IfThenElse(mask_of(unknown), hn::Add(key, hn::Set(d, 1)), gap_low), d, s_.gap_low + g);
            answers.known |= (visible | occluded) << g;
            answers.occluded |= (occluded & ~unknown) << g;
            answers.unknown |= unknown << g;
        }
        return answers;
    }
};

void walk_lines(const BundleWalk& walk, Bundle& bundle) {
    Walk(walk, bundle).run();
}

}  // namespace HWY_NAMESPACE
}  // namespace vshift::sweep
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace vshift::sweep {

HWY_EXPORT(walk_lines);

void walk(const BundleWalk& walk, Bundle& bundle) {
    HWY_DYNAMIC_DISPATCH(walk_lines)(walk, bundle);
}

}  // namespace vshift::sweep
#endif
