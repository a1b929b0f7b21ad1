// SPDX-License-Identifier: Apache-2.0
#include "embree_core/sweep_kernels.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "embree_core/sweep_kernels.cpp"
#include <hwy/foreach_target.h>
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

// What is nearer than 1 / solid_q is a surface; a sky pixel's q is 0 or, with its mark, a denormal.
constexpr float solid_q = 1e-20f;

HWY_INLINE V inverse_of(V z) {
    const F f;
    const V q = hn::Div(hn::Set(f, 1.0f), z);
    const V nan = hn::Set(f, std::numeric_limits<float>::quiet_NaN());
    const auto sky = hn::Gt(z, hn::Set(f, 1e12f));
    const auto measured = hn::Gt(z, hn::Set(f, 1e-12f));  // false for NaN
    return hn::IfThenElse(sky, hn::Zero(f), hn::IfThenElse(measured, q, nan));
}

/// Runs `body(i)` for whole vectors; the last one overlaps the one before (rows are padded where n is small).
template <class Body>
HWY_INLINE void for_vectors(size_t n, const Body& body) {
    const size_t lanes = hn::Lanes(F());
    for (size_t i = 0; i < n; i += lanes) body(i);
}

void inverse(const float* z, size_t n, float* q) {
    const F f;
    const size_t lanes = hn::Lanes(f);
    size_t i = 0;
    for (; i + lanes <= n; i += lanes) hn::StoreU(inverse_of(hn::LoadU(f, z + i)), f, q + i);
    for (; i < n; ++i)
        q[i] = z[i] > 1e12f ? 0.0f : z[i] > 1e-12f ? 1.0f / z[i] : std::numeric_limits<float>::quiet_NaN();
}

void inverse_reversed(const float* z, size_t n, float* q) {
    const F f;
    const size_t lanes = hn::Lanes(f);
    size_t i = 0;
    for (; i + lanes <= n; i += lanes)
        hn::StoreU(hn::Reverse(f, inverse_of(hn::LoadU(f, z + n - i - lanes))), f, q + i);
    for (; i < n; ++i) {
        const float d = z[n - 1 - i];
        q[i] = d > 1e12f ? 0.0f : d > 1e-12f ? 1.0f / d : std::numeric_limits<float>::quiet_NaN();
    }
}

// A line that crosses no more rows than this within a vector is read row by row, others by gathering.
constexpr int32_t most_crossed = 16;

/// Whether samples a and b are torn apart, by the rule of depth_source.h.
HWY_INLINE hn::Mask<F> torn_between(V before, V a, V b, V after, const TearRule& rule) {
    const F f;
    const auto set = [&](float value) { return hn::Set(f, value); };
    const V solid = hn::Set(f, solid_q);
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
        const auto place = hn::ShiftLeft<13>(hn::Add(index, hn::Set(d, rule.place0)));
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
        const auto bits_of = [&](const auto& tag, const auto& mask) {
            uint8_t bits[8] = {};
            hn::StoreMaskBits(tag, mask, bits);
            return uint32_t(bits[0] | bits[1] << 8);
        };
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

void mark_rows(const float* const rows[4], size_t n, const TearRule& tear, float* q) {
    const F f;
    const I d;
    const V nan = hn::Set(f, std::numeric_limits<float>::quiet_NaN());
    for_vectors(n, [&](size_t i) {
        const V a = hn::LoadU(f, rows[1] + i);
        const auto row = [&](int k) { return rows[k] ? hn::LoadU(f, rows[k] + i) : nan; };
        const auto torn = torn_between(row(0), a, row(2), row(3), tear);
        const auto mark = hn::IfThenElseZero(hn::RebindMask(d, torn), hn::Set(d, 1));
        const auto bits = hn::Or(hn::AndNot(hn::Set(d, 1), hn::BitCast(d, a)), mark);
        hn::StoreU(hn::BitCast(f, bits), f, q + i);
    });
}

void sample(const float* image, int stride, int rows, int first, int step, size_t n, float v0, float slope, float* q) {
    const F f;
    const I d;
    const size_t lanes = hn::Lanes(f);
    const int32_t left = step > 0 ? first : first - int32_t(n) + 1;
    const auto one = [&](size_t i, bool whole) {
        // From the left, whichever way V is: columns left + i and on.
        const auto index = hn::Min(hn::Add(hn::Iota(d, 0), hn::Set(d, int32_t(i))), hn::Set(d, int32_t(n) - 1));
        const auto column = hn::Add(hn::Set(d, left), index);
        const V v = hn::Sub(hn::MulAdd(hn::Set(f, slope), hn::ConvertTo(f, column), hn::Set(f, v0)), hn::Set(f, 0.5f));
        const V floor = hn::Floor(v), share = hn::Sub(v, floor);
        const auto row = hn::ConvertTo(d, floor);
        V a, b;  // the rows above and below the line
        const int32_t row_at_left = hn::GetLane(row),
                      row_at_right = whole ? hn::ExtractLane(row, lanes - 1) : row_at_left;
        const int32_t top = std::min(row_at_left, row_at_right), crossed = std::max(row_at_left, row_at_right) - top;
        if (whole && crossed <= most_crossed) {
            const float* at = image + left + ptrdiff_t(i);
            const auto row_of = [&](int32_t r) {
                return hn::LoadU(f, at + ptrdiff_t(std::clamp(r, 0, rows - 1)) * stride);
            };
            a = row_of(top), b = row_of(top + 1);
            V upper = b;
            for (int32_t k = 1; k <= crossed; ++k) {
                const V lower = row_of(top + k + 1);
                const auto here = hn::RebindMask(f, hn::Eq(row, hn::Set(d, top + k)));
                a = hn::IfThenElse(here, upper, a), b = hn::IfThenElse(here, lower, b);
                upper = lower;
            }
        } else {
            const auto last_row = hn::Set(d, rows - 1), zero = hn::Zero(d), pitch = hn::Set(d, stride);
            const auto upper = hn::Min(hn::Max(row, zero), last_row),
                       lower = hn::Min(hn::Max(hn::Add(row, hn::Set(d, 1)), zero), last_row);
            a = hn::GatherIndex(f, image, hn::Add(hn::Mul(upper, pitch), column));
            b = hn::GatherIndex(f, image, hn::Add(hn::Mul(lower, pitch), column));
        }
        const auto torn = hn::RebindMask(f, hn::Eq(hn::And(hn::BitCast(d, a), hn::Set(d, 1)), hn::Set(d, 1)));
        // Midway between two surfaces the nearer one counts, so that a mirrored image gives the mirrored line.
        const V off_middle = hn::Sub(share, hn::Set(f, 0.5f));
        const V own = hn::IfThenElse(hn::Lt(hn::Abs(off_middle), hn::Set(f, 1e-3f)), hn::Max(a, b),
                                     hn::IfThenElse(hn::Lt(off_middle, hn::Zero(f)), a, b));
        const V between = hn::MulAdd(share, hn::Sub(b, a), a);
        return hn::IfThenElse(torn, own, between);
    };
    if (n < lanes) {
        float room[block];
        hn::StoreU(one(0, false), f, room);
        for (size_t i = 0; i < n; ++i) q[step > 0 ? i : n - 1 - i] = room[i];
        return;
    }
    for (size_t i = 0; i < n; i += lanes) {
        const size_t at = std::min(i, n - lanes);  // the last vector overlaps the one before
        if (step > 0)
            hn::StoreU(one(at, true), f, q + at);
        else
            hn::StoreU(hn::Reverse(f, one(at, true)), f, q + (n - lanes - at));
    }
}

void take(const Take& rule, size_t n, uint8_t* out) {
    const F f;
    const I d;
    const size_t lanes = hn::Lanes(f);
    for (size_t i = 0; i < n; i += lanes) {
        const bool whole = i + lanes <= n;
        float a_room[block];
        int32_t level_room[block];
        const float* a = rule.a + i;
        const int32_t* level = rule.levels ? rule.levels + i : nullptr;
        if (!whole) {
            for (size_t k = 0; k < lanes; ++k) a_room[k] = a[std::min(k, n - i - 1)];
            a = a_room;
            if (level) {
                for (size_t k = 0; k < lanes; ++k) level_room[k] = level[std::min(k, n - i - 1)];
                level = level_room;
            }
        }
        const auto shift = level ? hn::LoadU(d, level) : hn::Set(d, rule.level);
        // 2^-level, exactly.
        const V unit = hn::BitCast(f, hn::ShiftLeft<23>(hn::Sub(hn::Set(d, 127), shift)));
        const V exact = hn::Mul(hn::MulAdd(hn::LoadU(f, a), hn::Set(f, rule.b), hn::Set(f, rule.c)), unit);
        const auto line = hn::Shl(hn::ConvertTo(d, hn::Round(exact)), shift);
        const auto index = hn::Min(hn::Add(hn::Iota(d, 0), hn::Set(d, int32_t(i))), hn::Set(d, int32_t(n) - 1));
        const auto place = hn::Add(hn::Set(d, rule.place), hn::Mul(index, hn::Set(d, rule.place_step)));
        const auto offset =
            hn::Add(hn::Mul(hn::Sub(line, hn::Set(d, rule.first_line)), hn::Set(d, rule.stride)), place);
        if (whole && rule.place_step == 1 && hn::AllTrue(d, hn::Eq(line, hn::Set(d, hn::GetLane(line))))) {
            std::memcpy(out + i, rule.classes + hn::GetLane(offset), lanes);
            continue;
        }
        // One by one: a gather of bytes takes twice as long.
        int32_t offsets[block];
        hn::StoreU(offset, d, offsets);
        for (size_t k = 0; k < std::min(lanes, n - i); ++k) out[i + k] = rule.classes[offsets[k]];
    }
}

const Kernels table = {&inverse, &inverse_reversed, &keys, &pixels, &mark_rows, &sample, &take};
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
