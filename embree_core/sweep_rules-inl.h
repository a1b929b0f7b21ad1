// SPDX-License-Identifier: Apache-2.0
// Role: what the sweep's vectorised loops share: tears between samples and their keys. Included once for each machine
// that Highway compiles for.
#if defined(VSHIFT_SWEEP_RULES_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef VSHIFT_SWEEP_RULES_INL_H
#undef VSHIFT_SWEEP_RULES_INL_H
#else
#define VSHIFT_SWEEP_RULES_INL_H
#endif

#include <hwy/highway.h>

#include "embree_core/sweep_kernels.h"

HWY_BEFORE_NAMESPACE();
namespace vshift::sweep {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// Sixteen samples at a time whatever the machine's width, so that every machine takes the same steps.
constexpr size_t block = 16;
using F = hn::CappedTag<float, block>;
using I = hn::RebindToSigned<F>;
using V = hn::Vec<F>;

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

}  // namespace HWY_NAMESPACE
}  // namespace vshift::sweep
HWY_AFTER_NAMESPACE();

#endif
