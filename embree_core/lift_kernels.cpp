// SPDX-License-Identifier: Apache-2.0
#include "embree_core/lift_kernels.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <vector>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "embree_core/lift_kernels.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace vshift::lifting {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using F = hn::CappedTag<float, 16>;
using I = hn::RebindToSigned<F>;
using U8 = hn::Rebind<uint8_t, F>;
using V = hn::Vec<F>;
using M = hn::Mask<F>;

constexpr float sky_m = 1e12f, nearest_m = 1e-12f;  // as in types.h

RowCounts inverse(const float* z, size_t n, float* w) {
    const F f;
    const size_t lanes = hn::Lanes(f);
    const V nan = hn::Set(f, std::numeric_limits<float>::quiet_NaN()), one = hn::Set(f, 1.0f), zero = hn::Zero(f);
    const V sky_at = hn::Set(f, sky_m), valid_from = hn::Set(f, nearest_m);
    RowCounts out;
    V nearest = hn::Set(f, out.nearest_m);
    size_t i = 0;
    for (; i + lanes <= n; i += lanes) {
        const V zi = hn::LoadU(f, z + i);
        const M sky = hn::Gt(zi, sky_at), measured = hn::Gt(zi, valid_from);
        hn::StoreU(hn::IfThenElse(sky, zero, hn::IfThenElse(measured, hn::Div(one, zi), nan)), f, w + i);
        if (!hn::AllTrue(f, measured)) out.invalid += uint32_t(lanes - hn::CountTrue(f, measured));
        if (!hn::AllFalse(f, sky)) out.sky += uint32_t(hn::CountTrue(f, sky));
        nearest = hn::IfThenElse(hn::And(measured, hn::Lt(zi, nearest)), zi, nearest);
    }
    out.nearest_m = hn::GetLane(hn::MinOfLanes(f, nearest));
    for (; i < n; ++i) {
        const bool sky = z[i] > sky_m, valid = z[i] > nearest_m && !sky;
        out.sky += sky, out.invalid += !sky && !valid;
        w[i] = sky ? 0.0f : valid ? 1.0f / z[i] : std::numeric_limits<float>::quiet_NaN();
        if (valid && z[i] < out.nearest_m) out.nearest_m = z[i];
    }
    return out;
}

/// lift.cpp's `torn_between`, and what is torn whatever the steps.
HWY_INLINE M torn(V before, V a, V b, V after, const TearRule& rule) {
    const F f;
    const V zero = hn::Zero(f), most = hn::Set(f, std::numeric_limits<float>::infinity());
    const V step = hn::Abs(hn::Sub(b, a));
    const M large = hn::Ge(step, hn::Set(f, rule.least_step));
    const M ends = hn::And(hn::Xor(hn::Gt(a, zero), hn::Gt(b, zero)), hn::Eq(b, b));
    if (hn::AllFalse(f, large)) return ends;
    const V left = hn::Add(hn::Sub(before, a), hn::Sub(b, a)), right = hn::Add(hn::Sub(a, b), hn::Sub(after, b));
    const auto size = [&](V v) { return hn::IfThenElse(hn::Eq(v, v), hn::Abs(v), most); };
    const V smallest = hn::Min(size(left), size(right));
    const V share =
        hn::IfThenElse(hn::Gt(hn::Mul(left, right), zero), hn::Set(f, rule.crease_break), hn::Set(f, rule.tear_break));
    const V nearer = hn::IfThenElse(hn::Lt(a, b), b, a);
    const V error =
        hn::Add(hn::Set(f, rule.constant),
                hn::Mul(nearer, hn::Add(hn::Set(f, rule.relative), hn::Mul(nearer, hn::Set(f, rule.squared)))));
    const V bound = hn::Add(hn::Mul(share, step), hn::Mul(hn::Set(f, 4.0f), error));
    return hn::Or(ends, hn::And(large, hn::Ge(smallest, bound)));
}

size_t tears(const float* above, const float* w, const float* below, const float* below2, size_t n,
             const TearRule& across, const TearRule& down, uint8_t* out) {
    const F f;
    const I d;
    const U8 bytes;
    const size_t lanes = hn::Lanes(f);
    if (n < lanes) return 0;
    for (size_t at = 0; at < n; at += lanes) {
        const size_t i = at + lanes <= n ? at : n - lanes;  // the last ones overlap those before
        const V a = hn::LoadU(f, w + i), under = hn::LoadU(f, below + i);
        const M right = torn(hn::LoadU(f, w + i - 1), a, hn::LoadU(f, w + i + 1), hn::LoadU(f, w + i + 2), across);
        const M lower = torn(hn::LoadU(f, above + i), a, under, hn::LoadU(f, below2 + i), down);
        const auto bits = hn::Or(hn::IfThenElseZero(hn::RebindMask(d, right), hn::Set(d, 1)),
                                 hn::IfThenElseZero(hn::RebindMask(d, lower), hn::Set(d, 2)));
        hn::StoreU(hn::DemoteTo(bytes, bits), bytes, out + i);
    }
    return n;
}

BoxBounds bounds(const float* w, const uint8_t* tears, size_t stride, size_t columns, size_t rows) {
    const F f;
    const I d;
    const U8 bytes;
    const size_t lanes = hn::Lanes(f);
    BoxBounds out;
    if (columns < lanes) {
        for (size_t y = 0; y < rows; ++y)
            for (size_t x = 0; x < columns; ++x) {
                const float value = w[y * stride + x];
                out.low = value < out.low ? value : out.low, out.high = value > out.high ? value : out.high;
                out.invalid |= value != value, out.torn |= tears[y * stride + x] != 0;
            }
        return out;
    }
    V low = hn::Set(f, out.low), high = hn::Zero(f);
    M invalid = hn::Ne(low, low);
    auto any_tear = hn::Zero(d);
    for (size_t y = 0; y < rows; ++y, w += stride, tears += stride)
        for (size_t at = 0; at < columns; at += lanes) {
            const size_t i = at + lanes <= columns ? at : columns - lanes;
            const V value = hn::LoadU(f, w + i);
            low = hn::IfThenElse(hn::Lt(value, low), value, low);
            high = hn::IfThenElse(hn::Gt(value, high), value, high);
            invalid = hn::Or(invalid, hn::Ne(value, value));
            any_tear = hn::Or(any_tear, hn::PromoteTo(d, hn::LoadU(bytes, tears + i)));
        }
    out.low = hn::GetLane(hn::MinOfLanes(f, low)), out.high = hn::GetLane(hn::MaxOfLanes(f, high));
    out.invalid = !hn::AllFalse(f, invalid), out.torn = !hn::AllTrue(d, hn::Eq(any_tear, hn::Zero(d)));
    return out;
}

void whole(const float* w, const float* below, const uint8_t* tears, const uint8_t* tears_below, size_t n,
           uint8_t* kinds) {
    const F f;
    const I d;
    const U8 bytes;
    const size_t lanes = hn::Lanes(f);
    const V zero = hn::Zero(f);
    const auto one = [&](size_t i) {
        const bool joined = w[i] > 0 && w[i + 1] > 0 && below[i] > 0 && below[i + 1] > 0 && !(tears[i] & 3) &&
                            !(tears[i + 1] & 2) && !(tears_below[i] & 1);
        kinds[i] = joined ? 2 : 0;
    };
    if (n < lanes) {
        for (size_t i = 0; i < n; ++i) one(i);
        return;
    }
    for (size_t at = 0; at < n; at += lanes) {
        const size_t i = at + lanes <= n ? at : n - lanes;
        const auto positive = [&](const float* row) { return hn::Gt(hn::LoadU(f, row), zero); };
        const M solid = hn::And(hn::And(positive(w + i), positive(w + i + 1)),
                                hn::And(positive(below + i), positive(below + i + 1)));
        const auto bits = [&](const uint8_t* row, int32_t of) {
            return hn::And(hn::PromoteTo(d, hn::LoadU(bytes, row)), hn::Set(d, of));
        };
        const auto torn = hn::Or(bits(tears + i, 3), hn::Or(bits(tears + i + 1, 2), bits(tears_below + i, 1)));
        const auto joined = hn::And(hn::RebindMask(d, solid), hn::Eq(torn, hn::Zero(d)));
        hn::StoreU(hn::DemoteTo(bytes, hn::IfThenElseZero(joined, hn::Set(d, 2))), bytes, kinds + i);
    }
}

void points(const float* z, const double* ray_x, double ray_y, size_t n, float* out) {
    const hn::CappedTag<double, 8> wide;
    const hn::Rebind<float, decltype(wide)> f;
    const size_t lanes = hn::Lanes(wide);
    const auto y = hn::Set(wide, ray_y);
    const auto zero = hn::Zero(f);
    size_t i = 0;
    for (; i + lanes <= n; i += lanes) {
        const auto zi = hn::LoadU(f, z + i);
        const auto measured = hn::And(hn::Gt(zi, hn::Set(f, nearest_m)), hn::Le(zi, hn::Set(f, sky_m)));
        const auto depth = hn::IfThenElseZero(measured, zi);
        const auto deep = hn::PromoteTo(wide, depth);
        hn::StoreInterleaved4(hn::DemoteTo(f, hn::Mul(hn::LoadU(wide, ray_x + i), deep)),
                              hn::DemoteTo(f, hn::Mul(y, deep)), depth, zero, f, out + 4 * i);
    }
    for (; i < n; ++i) {
        const float depth = z[i] > nearest_m && z[i] <= sky_m ? z[i] : 0;
        out[4 * i] = float(ray_x[i] * double(depth)), out[4 * i + 1] = float(ray_y * double(depth));
        out[4 * i + 2] = depth, out[4 * i + 3] = 0;
    }
}

const Kernels table = {&inverse, &tears, &whole, &points, &bounds};
const Kernels* get() {
    return &table;
}

}  // namespace HWY_NAMESPACE
}  // namespace vshift::lifting
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace vshift::lifting {

HWY_EXPORT(get);

const Kernels& kernels() {
    static const Kernels* const chosen = HWY_DYNAMIC_DISPATCH(get)();
    return *chosen;
}

RowCounts inverse_of(const DepthMap& depth, Grid<float>& w) {
    std::vector<RowCounts> rows(static_cast<size_t>(depth.height));
    tbb::parallel_for(0, depth.height, [&](int y) {
        const size_t first = size_t(y) * size_t(depth.width);
        rows[size_t(y)] = kernels().inverse(&depth.data[first], size_t(depth.width), &w.data[first]);
    });
    RowCounts all;
    for (const RowCounts& row : rows) {
        all.invalid += row.invalid, all.sky += row.sky;
        all.nearest_m = std::min(all.nearest_m, row.nearest_m);
    }
    return all;
}

}  // namespace vshift::lifting
#endif
