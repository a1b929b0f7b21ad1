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

#include "embree_core/sweep_rules-inl.h"

HWY_BEFORE_NAMESPACE();
namespace vshift::sweep {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

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

const Kernels table = {&inverse, &inverse_reversed, &keys, &pixels, &inverse_columns, &mark_row};
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
