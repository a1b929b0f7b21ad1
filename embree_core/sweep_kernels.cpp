// SPDX-License-Identifier: Apache-2.0
#include "embree_core/sweep_kernels.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "embree_core/sweep_kernels.cpp"
#include <hwy/foreach_target.h>
#include <hwy/cache_control.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace vshift::sweep {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// Sixteen samples at a time whatever the machine's width, so that every machine takes the same steps.
constexpr size_t block = 16;
using F = hn::CappedTag<float, block>;
using I = hn::RebindToSigned<F>;
using V = hn::Vec<F>;

template <class D>
HWY_INLINE hn::Vec<D> inverse_of(D f, hn::Vec<D> z) {
    const auto q = hn::Div(hn::Set(f, 1.0f), z);
    const auto nan = hn::Set(f, std::numeric_limits<float>::quiet_NaN());
    const auto sky = hn::Gt(z, hn::Set(f, 1e12f));
    const auto measured = hn::Gt(z, hn::Set(f, 1e-12f));  // false for NaN
    return hn::IfThenElse(sky, hn::Zero(f), hn::IfThenElse(measured, q, nan));
}

float inverse_of(float z) {
    return z > 1e12f ? 0.0f : z > 1e-12f ? 1.0f / z : std::numeric_limits<float>::quiet_NaN();
}

void inverse(const float* z, size_t n, float* q) {
    const F f;
    const size_t lanes = hn::Lanes(f);
    size_t i = 0;
    for (; i + lanes <= n; i += lanes) hn::StoreU(inverse_of(f, hn::LoadU(f, z + i)), f, q + i);
    for (; i < n; ++i) q[i] = inverse_of(z[i]);
}

void inverse_reversed(const float* z, size_t n, float* q) {
    const F f;
    const size_t lanes = hn::Lanes(f);
    size_t i = 0;
    for (; i + lanes <= n; i += lanes)
        hn::StoreU(hn::Reverse(f, inverse_of(f, hn::LoadU(f, z + n - i - lanes))), f, q + i);
    for (; i < n; ++i) q[i] = inverse_of(z[n - 1 - i]);
}

void inverse_columns(const float* z, size_t width, size_t x, size_t count, size_t y0, size_t y1, float* q,
                     size_t stride) {
    size_t y = y0;
#if HWY_TARGET != HWY_SCALAR
    const hn::FixedTag<float, 4> f;
    if (count == block)
        for (; y + 4 <= y1; y += 4)
            for (size_t k = 0; k < block; k += 4) {
                const float* from = z + y * width + x + k;
                const auto row = [&](size_t r) { return inverse_of(f, hn::LoadU(f, from + r * width)); };
                const auto r0 = row(0), r1 = row(1), r2 = row(2), r3 = row(3);
                const auto even = hn::InterleaveLower(f, r0, r2), odd = hn::InterleaveLower(f, r1, r3);
                const auto even_high = hn::InterleaveUpper(f, r0, r2), odd_high = hn::InterleaveUpper(f, r1, r3);
                float* to = q + k * stride + y;
                hn::StoreU(hn::InterleaveLower(f, even, odd), f, to);
                hn::StoreU(hn::InterleaveUpper(f, even, odd), f, to + stride);
                hn::StoreU(hn::InterleaveLower(f, even_high, odd_high), f, to + 2 * stride);
                hn::StoreU(hn::InterleaveUpper(f, even_high, odd_high), f, to + 3 * stride);
            }
#endif
    for (; y < y1; ++y)
        for (size_t k = 0; k < count; ++k) q[k * stride + y] = inverse_of(z[y * width + x + k]);
}

/// Whether samples a and b are torn apart, by the rule of depth_source.h.
HWY_INLINE hn::Mask<F> torn_between(V before, V a, V b, V after, const TearRule& rule) {
    const F f;
    const auto set = [&](float value) { return hn::Set(f, value); };
    const V solid = hn::Set(f, least_solid);
    const V change = hn::Sub(b, a);
    const V step = hn::Abs(change);
    const auto seen = hn::Gt(hn::Mul(set(rule.px_per_q), step), set(rule.tear_px));
    const auto both = hn::And(hn::Gt(a, solid), hn::Gt(b, solid));
    const auto neither = hn::And(hn::Le(a, solid), hn::Le(b, solid));  // sky beside sky; false for NaN
    const auto whole = hn::Or(neither, hn::AndNot(seen, both));
    if (hn::AllTrue(f, whole)) return hn::Not(whole);
    const V infinity = hn::Set(f, std::numeric_limits<float>::infinity());
    const V left_break = hn::Add(hn::Sub(before, a), change), right_break = hn::Sub(hn::Sub(after, b), change);
    const V left = hn::Abs(left_break), right = hn::Abs(right_break);
    const V share = hn::IfThenElse(hn::Gt(hn::Mul(left_break, right_break), hn::Zero(f)), set(rule.crease_break),
                                   set(rule.tear_break));
    const V left_known = hn::IfThenElse(hn::Eq(left, left), left, infinity);
    const V right_known = hn::IfThenElse(hn::Eq(right, right), right, infinity);
    const V q = hn::Max(a, b);
    const V errors = hn::MulAdd(q, hn::MulAdd(q, set(rule.squared), set(rule.relative)), set(rule.constant));
    const auto breaks = hn::Ge(hn::Min(left_known, right_known), hn::MulAdd(share, step, errors));
    return hn::Not(hn::Or(whole, hn::AndNot(breaks, both)));
}

/// A bit per lane, sixteen lanes at most.
template <class D, class M>
HWY_INLINE uint32_t bits_of(D tag, M mask) {
    uint8_t bits[8] = {};
    hn::StoreMaskBits(tag, mask, bits);
    return uint32_t(bits[0] | bits[1] << 8);
}

/// |gain| q / (1 - cz q) in key units, minus the sample's own place. `beside`: cz is 0.
template <bool beside>
HWY_INLINE hn::Vec<I> key_vector(V q, V gain, V centre_z, hn::Vec<I> place) {
    const F f;
    const I d;
    const V scale = hn::Set(f, key_scale), largest = hn::Set(f, largest_disparity_px * key_scale);
    const auto known = hn::RebindMask(d, hn::Eq(q, q));
    const auto key_of_disparity = [&](V disparity) {
        return hn::ConvertTo(d, hn::Min(hn::Mul(disparity, scale), largest));
    };
    if constexpr (beside)
        return hn::IfThenElse(known, hn::Sub(key_of_disparity(hn::Mul(gain, q)), place), hn::Set(d, top_key));
    const V clear = hn::Sub(hn::Set(f, 1.0f), hn::Mul(centre_z, q));
    const V disparity = hn::Div(hn::Mul(gain, q), clear);
    // Nearer than V's own plane: beyond every key, in the order of the slope towards V. |w| is the distance from the
    // epipole that V would see, behind it.
    const auto behind = hn::Sub(hn::Set(d, 1 << 30), key_of_disparity(hn::Abs(disparity)));
    const auto is_front = hn::RebindMask(d, hn::Gt(clear, hn::Zero(f)));
    const auto key = hn::Sub(hn::IfThenElse(is_front, key_of_disparity(disparity), behind), place);
    return hn::IfThenElse(known, key, hn::Set(d, top_key));
}

template <bool beside>
HWY_INLINE void key_row(const LineRule& rule, const float* q, size_t padded, int32_t* key) {
    const F f;
    const I d;
    const size_t lanes = hn::Lanes(f);
    const V centre_z = hn::Set(f, rule.centre_z), gain_step = hn::Set(f, rule.gain_step),
            gain0 = hn::Set(f, rule.gain0);
    for (size_t i = 0; i < padded; i += lanes) {
        const auto index = hn::Add(hn::Iota(d, 0), hn::Set(d, int32_t(i)));
        const V gain = hn::Abs(hn::MulAdd(gain_step, hn::ConvertTo(f, index), gain0));
        const auto place = hn::ShiftLeft<13>(index);
        hn::StoreU(key_vector<beside>(hn::LoadU(f, q + i), gain, centre_z, place), d, key + i);
    }
}

void keys(const LineRule& rule, const float* q, size_t n, int32_t* key, uint16_t* torn, uint16_t* rising) {
    const F f;
    const I d;
    const size_t lanes = hn::Lanes(f);
    const size_t blocks = (n + block - 1) / block;
    (rule.centre_z == 0 ? &key_row<true> : &key_row<false>)(rule, q, blocks * block, key);
    key[blocks * block] = 0;
    for (size_t b = 0; b < blocks; ++b) {
        uint32_t torn_bits = 0, rising_bits = 0;
        for (size_t part = 0; part < block; part += lanes) {
            const size_t i = b * block + part;
            const auto mask = torn_between(hn::LoadU(f, q + i - 1), hn::LoadU(f, q + i), hn::LoadU(f, q + i + 1),
                                           hn::LoadU(f, q + i + 2), rule.tear);
            torn_bits |= bits_of(f, mask) << part;
            rising_bits |= bits_of(d, hn::Gt(hn::LoadU(d, key + i), hn::LoadU(d, key + i + 1))) << part;
        }
        if (const size_t first = b * block; first + block >= n) rising_bits &= (1u << (n - 1 - first)) - 1;
        torn[b] = uint16_t(torn_bits);
        rising[b] = uint16_t(rising_bits & ~torn_bits);
    }
}

void pixels(const PixelRule& r, const float* z, int y, size_t n, const uint8_t* classes, bool reversed, uint8_t* out) {
    const F f;
    const I d;
    const size_t lanes = hn::Lanes(f);
    const auto set = [&](float value) { return hn::Set(f, value); };
    const V zero = hn::Zero(f), one = set(1);
    const V clear = set(r.clear_m), largest = set(1e12f), least = set(1e-12f);
    const V cx = set(r.centre[0]), cy = set(r.centre[1]), cz = set(r.centre[2]);
    const V ry = set(r.ray_y0 + r.ray_dy * float(y)), ray_dx = set(r.ray_dx), ray_x0 = set(r.ray_x0);
    const auto in_row = [&](const Linear& linear) { return linear.b * float(y) + linear.c; };
    float outside_at[4] = {}, unseen_at[4] = {};
    for (int k = 0; k < r.outside_count; ++k) outside_at[k] = in_row(r.outside[k].at);
    for (int k = 0; k < r.unseen_count; ++k) unseen_at[k] = in_row(r.unseen[k]);
    float z_last[block];
    uint8_t bytes_now[block] = {};
    for (size_t i = 0; i < n; i += lanes) {
        const bool whole = i + lanes <= n;
        const float* source = z + i;
        if (!whole) {
            for (size_t k = 0; k < lanes; ++k) z_last[k] = i + k < n ? z[i + k] : 1.0f;
            source = z_last;
        }
        const V depth = hn::LoadU(f, source);
        const auto sky = hn::Gt(depth, largest);
        // Points are homogeneous: (x, y, 1) z, and the sky's is the direction alone.
        const V z_or_one = hn::IfThenElse(sky, one, depth);
        const V x = hn::ConvertTo(f, hn::Add(hn::Iota(d, 0), hn::Set(d, int32_t(i))));
        auto bits = hn::Zero(d);
        for (int k = 0; k < r.outside_count; ++k) {
            const PixelRule::Outside& side = r.outside[k];
            const V at = hn::MulAdd(x, set(side.at.a), set(outside_at[k]));
            const V within = hn::MulAdd(z_or_one, at, hn::IfThenZeroElse(sky, set(side.move)));
            const auto beyond = side.strict ? hn::Le(within, zero) : hn::Lt(within, zero);
            bits = hn::Or(bits, hn::IfThenElseZero(hn::RebindMask(d, beyond), hn::Set(d, 2)));
        }
        if (r.unseen_count) {
            // The segment from the point enters the ball round V that is taken as free at V + clear_m / length d; the
            // sky is looked at from V, in its direction.
            const V rx = hn::MulAdd(x, ray_dx, ray_x0);
            const V dx = hn::IfThenElse(sky, rx, hn::MulSub(rx, depth, cx)),
                    dy = hn::IfThenElse(sky, ry, hn::MulSub(ry, depth, cy)),
                    dz = hn::IfThenElse(sky, one, hn::Sub(depth, cz));
            const V length2 = hn::MulAdd(dx, dx, hn::MulAdd(dy, dy, hn::Mul(dz, dz)));
            V nearest = hn::MulAdd(x, set(r.unseen[0].a), set(unseen_at[0]));
            for (int k = 1; k < r.unseen_count; ++k)
                nearest = hn::Min(nearest, hn::MulAdd(x, set(r.unseen[k].a), set(unseen_at[k])));
            const V far = hn::MulAdd(z_or_one, nearest, hn::IfThenZeroElse(sky, clear));
            const auto unseen = hn::Gt(length2, hn::Mul(far, far));
            bits = hn::Or(bits, hn::IfThenElseZero(hn::RebindMask(d, unseen), hn::Set(d, 8)));
        }
        const auto known = hn::RebindMask(d, hn::Gt(depth, least));
        const hn::Rebind<uint8_t, F> bytes;
        const uint8_t* from = classes + (reversed ? n - lanes - i : i);
        if (!whole) {
            for (size_t k = 0; k < n - i; ++k) bytes_now[k] = classes[reversed ? n - 1 - i - k : i + k];
            from = bytes_now;
        }
        auto before = hn::PromoteTo(d, hn::LoadU(bytes, from));
        if (reversed && whole) before = hn::Reverse(d, before);
        const auto all = hn::IfThenElse(known, hn::Or(before, bits), hn::Set(d, 4));
        hn::StoreU(hn::DemoteTo(bytes, all), bytes, whole ? out + i : bytes_now);
        if (!whole) std::memcpy(out + i, bytes_now, n - i);
    }
}

void mark_row(const float* q, size_t n, const TearRule& tear, float* marked) {
    const F f;
    const I d;
    for (size_t i = 0; i < n; i += hn::Lanes(f)) {
        const V a = hn::LoadU(f, q + i);
        const auto torn =
            torn_between(hn::LoadU(f, q + i - 1), a, hn::LoadU(f, q + i + 1), hn::LoadU(f, q + i + 2), tear);
        const auto mark = hn::IfThenElseZero(hn::RebindMask(d, torn), hn::Set(d, 1));
        const auto bits = hn::Or(hn::AndNot(hn::Set(d, 1), hn::BitCast(d, a)), mark);
        hn::StoreU(hn::BitCast(f, bits), f, marked + i);
    }
}

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

    /// Samples the height field. Returns which lines are within the image there.
    HWY_INLINE uint32_t sample(size_t u) {
        const int major = major_of(u);
        int32_t* pixel = s_.pixel[u % Bundle::kept];
        float* in_pixel = s_.within[u % Bundle::kept];
        uint32_t& torn_across = s_.torn_across[u % Bundle::kept];
        torn_across = 0;
        const V nan = hn::Set(f, std::numeric_limits<float>::quiet_NaN());
        if (major < w_.begin || major >= w_.end) {
            for (size_t g = 0; g < block; g += lanes()) {
                hn::StoreU(nan, f, q(u) + g);
                hn::StoreU(hn::Zero(f), f, in_pixel + g);
                hn::StoreU(hn::Zero(d), d, pixel + g);
            }
            return 0;
        }
        prefetch(major + 8 * w_.step);
        const double spacing = w_.spacing[major];
        // Far outside it does not matter where.
        const double at = std::clamp(w_.origin[major] + w_.number * spacing - 0.5, -1e6, 1e6);
        const int base = int(std::floor(at));
        const V share0 = hn::Set(f, float(at - base)), step = hn::Set(f, float(w_.unit * spacing));
        const float* row = w_.image + ptrdiff_t(major) * w_.stride;
        const bool within = base >= 0 && base + int(block) < w_.minors;  // as no two lines are a pixel apart
        uint32_t inside = within ? every_line : 0;
        for (size_t g = 0; g < block; g += lanes()) {
            const V lane = hn::ConvertTo(f, hn::Iota(d, int32_t(g)));
            const V v = hn::Add(share0, hn::Mul(lane, step));
            const V floor = hn::Floor(v), share = hn::Sub(v, floor);
            // The pixels on either side are neighbours in memory: one load has those of all lines.
            const auto upper = hn::Add(hn::ConvertTo(d, floor), hn::Set(d, base));
            const int32_t left = std::clamp(hn::GetLane(upper), -1, w_.minors - 1);
            const auto index =
                hn::Min(hn::Max(hn::Sub(upper, hn::Set(d, left)), hn::Zero(d)), hn::Set(d, int32_t(lanes()) - 1));
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
                const V place = hn::Add(hn::ConvertTo(f, upper), share);
                const auto in = hn::And(hn::Ge(place, hn::Set(f, -0.5f - between_pixels)),
                                        hn::Le(place, hn::Set(f, float(w_.minors) - 0.5f + between_pixels)));
                value = hn::IfThenElse(in, value, nan);
                inside |= bits_of(f, in) << g;
            }
            hn::StoreU(value, f, q(u) + g);
            const auto half = hn::Set(f, 0.5f);
            hn::StoreU(hn::IfThenElse(in_upper, hn::Add(share, half), off_middle), f, in_pixel + g);
            const auto one = hn::IfThenZeroElse(hn::RebindMask(d, in_upper), hn::Set(d, 1));
            hn::StoreU(hn::Add(upper, one), d, pixel + g);
            // At a pixel's centre both its neighbours are as near.
            const auto perhaps = hn::Or(torn, hn::Gt(from_border, hn::Set(f, 0.5f - between_pixels)));
            if (!hn::AllFalse(f, perhaps)) torn_across |= bits_of(f, perhaps) << g;
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
            const auto own = hn::LoadU(d, s_.pixel[here] + g), next = hn::LoadU(d, s_.pixel[ahead] + g);
            const V sum = hn::Add(hn::LoadU(f, s_.within[here] + g), hn::LoadU(f, s_.within[ahead] + g));
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

void walk(const BundleWalk& w, Bundle& s) {
    Walk(w, s).run();
}

const Kernels table = {&inverse, &inverse_reversed, &keys, &pixels, &inverse_columns, &mark_row, &walk};
const Kernels* get() {
    return &table;
}

}  // namespace HWY_NAMESPACE
}  // namespace vshift::sweep
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace vshift::sweep {

HWY_EXPORT(get);

const Kernels& kernels() {
    static const Kernels* const chosen = HWY_DYNAMIC_DISPATCH(get)();
    return *chosen;
}

}  // namespace vshift::sweep
#endif
