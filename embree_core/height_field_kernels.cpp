// SPDX-License-Identifier: Apache-2.0
#include "embree_core/height_field_kernels.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "embree_core/height_field_kernels.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include <limits>

HWY_BEFORE_NAMESPACE();
namespace vshift::heights {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using F = hn::CappedTag<float, packet_rays>;
using I = hn::RebindToSigned<F>;
using V = hn::Vec<F>;
using M = hn::Mask<F>;

// A ray is below the surface from this share of 1/z on: the rounding of three floats.
constexpr float below_share = 1 - 1e-6f;

HWY_INLINE V at(V from, V s, V rate) {
    return hn::Add(from, hn::Mul(s, rate));
}
HWY_INLINE V between(V a, V b, V share) {
    return hn::Add(a, hn::Mul(share, hn::Sub(b, a)));
}
HWY_INLINE V unit(V v) {
    const F d;
    return hn::Min(hn::Max(v, hn::Zero(d)), hn::Set(d, 1.0f));
}
HWY_INLINE uint32_t bits_of(M mask) {
    const F d;
    uint8_t bytes[8] = {};
    hn::StoreMaskBits(d, mask, bytes);
    return bytes[0];
}

/// A square with 1/z at its corners, cut into two triangles along the diagonal from `c` to `b`.
struct Patch {
    V a, b, c, d;  ///< at (0,0), (1,0), (0,1), (1,1)
    HWY_INLINE V height(V x, V y) const {
        const F f;
        const V one = hn::Set(f, 1.0f);
        const V first = hn::Add(a, hn::Add(hn::Mul(x, hn::Sub(b, a)), hn::Mul(y, hn::Sub(c, a))));
        const V second =
            hn::Add(d, hn::Add(hn::Mul(hn::Sub(one, x), hn::Sub(c, d)), hn::Mul(hn::Sub(one, y), hn::Sub(b, d))));
        return hn::IfThenElse(hn::Lt(hn::Add(x, y), one), first, second);
    }
};

/// Four values from each index on.
HWY_INLINE void patches(const float* from, hn::Vec<I> index, V& v0, V& v1, V& v2, V& v3) {
    const F d;
#if HWY_HAVE_SCALABLE || HWY_TARGET == HWY_SCALAR
    v0 = hn::GatherIndex(d, from, index), v1 = hn::GatherIndex(d, from + 1, index);
    v2 = hn::GatherIndex(d, from + 2, index), v3 = hn::GatherIndex(d, from + 3, index);
#else
    // A load for each lane and a transposition: half the time of four gathers.
    const I di;
    alignas(32) int32_t at[packet_rays];
    hn::StoreU(index, di, at);
    const hn::FixedTag<float, 4> four;
#if HWY_MAX_BYTES >= 32
    const auto rows = [&](size_t lane) {
        return hn::Combine(d, hn::LoadU(four, from + at[lane + 4]), hn::LoadU(four, from + at[lane]));
    };
#else
    const auto rows = [&](size_t lane) { return hn::LoadU(four, from + at[lane]); };
#endif
    const V a = rows(0), b = rows(1), c = rows(2), e = rows(3);
    const hn::RepartitionToWide<F> pairs;
    const auto join = [&](V first, V second, bool upper) {
        const auto x = hn::BitCast(pairs, first), y = hn::BitCast(pairs, second);
        return hn::BitCast(d, upper ? hn::InterleaveUpper(pairs, x, y) : hn::InterleaveLower(pairs, x, y));
    };
    const V ab = hn::InterleaveLower(d, a, b), ce = hn::InterleaveLower(d, c, e);
    const V ab_upper = hn::InterleaveUpper(d, a, b), ce_upper = hn::InterleaveUpper(d, c, e);
    v0 = join(ab, ce, false), v1 = join(ab, ce, true);
    v2 = join(ab_upper, ce_upper, false), v3 = join(ab_upper, ce_upper, true);
#endif
}

/// `coded`: the tile has codes.
template <bool coded>
HWY_INLINE Met march_lanes(const Surface& surface, const Tile& tile, const Rays& rays, size_t first, uint32_t asked) {
    const F d;
    const I di;
    const auto set = [&](float value) { return hn::Set(d, value); };
    const V zero = hn::Zero(d), one = set(1), half = set(0.5f);
    const M none = hn::Lt(one, zero);
    const auto ray = [&](const float* values) { return hn::LoadU(d, values + first); };
    const V x0 = ray(rays.x), y0 = ray(rays.y), w0 = ray(rays.w), dx = ray(rays.dx), dy = ray(rays.dy),
            dw = ray(rays.dw), end = ray(rays.end), wall_end = ray(rays.wall_end);
    const M forth_x = hn::Ge(dx, zero), forth_y = hn::Ge(dy, zero);
    const auto per = [&](V rate) { return hn::Div(one, hn::IfThenElse(hn::Eq(rate, zero), set(1e-20f), rate)); };
    const V per_dx = per(dx), per_dy = per(dy);
    const V left = set(float(tile.x)), right = set(float(tile.x + tile_cells)), top = set(float(tile.y)),
            bottom = set(float(tile.y + tile_cells));
    const auto when = [&](V place, V from, V per_rate) { return hn::Mul(hn::Sub(place, from), per_rate); };
    V s = hn::Max(zero, hn::Max(when(hn::IfThenElse(forth_x, left, right), x0, per_dx),
                                when(hn::IfThenElse(forth_y, top, bottom), y0, per_dy)));
    V stop = hn::Min(end, hn::Min(when(hn::IfThenElse(forth_x, right, left), x0, per_dx),
                                  when(hn::IfThenElse(forth_y, bottom, top), y0, per_dy)));
    // Above all that is in the tile.
    stop = hn::IfThenElse(hn::Gt(dw, zero), hn::Min(stop, hn::Div(hn::Sub(set(tile.high), w0), dw)), stop);
    const uint8_t asked_bytes[8] = {uint8_t(asked)};
    M active = hn::And(hn::LoadMaskBits(d, asked_bytes), hn::Lt(s, stop));
    Met met;
    if (hn::AllFalse(d, active)) return met;

    const V last_x = hn::Sub(right, one), last_y = hn::Sub(bottom, one);
    const V step_x = hn::IfThenElse(forth_x, one, set(-1)), step_y = hn::IfThenElse(forth_y, one, set(-1));
    // Where a way on enters a patch and where it leaves it; the half of a cell that it enters.
    const V near_x = hn::IfThenZeroElse(forth_x, one), near_y = hn::IfThenZeroElse(forth_y, one);
    const V far_x = hn::Sub(one, near_x), far_y = hn::Sub(one, near_y);
    const V near_half_x = hn::Mul(half, near_x), near_half_y = hn::Mul(half, near_y);
    const auto later_half = [&](V place, V cell) {
        return hn::IfThenElseZero(hn::Ge(hn::Sub(place, cell), half), half);
    };
    V place_x = at(x0, s, dx), place_y = at(y0, s, dy), segment = at(w0, s, dw);
    V cell_x = hn::Min(hn::Max(hn::Floor(place_x), left), last_x);
    V cell_y = hn::Min(hn::Max(hn::Floor(place_y), top), last_y);
    V quarter_x = zero, quarter_y = zero;
    if (coded) quarter_x = later_half(place_x, cell_x), quarter_y = later_half(place_y, cell_y);
    bool entered = true;
    M inner = none, below = none, known = none, came_by_x = none, kept = none, torn = none;
    for (;;) {
        // The patch: a whole cell or a quarter of a split one.
        const V column = hn::Sub(cell_x, left), row = hn::Sub(cell_y, top);
        V size = one, per_size = one, px = cell_x, py = cell_y;
        V h00, h10, h01, h11;
        M split = none, turned = none;
        if constexpr (coded) {
            const auto code = hn::GatherIndex(di, tile.codes,
                                              hn::ConvertTo(di, hn::Add(hn::Mul(row, set(float(tile_cells))), column)));
            const auto odd = hn::Ne(hn::And(code, hn::Set(di, 1)), hn::Zero(di));
            split = hn::RebindMask(d, odd);
            const auto quarter = hn::ConvertTo(di, hn::Add(hn::Mul(quarter_y, set(16)), hn::Mul(quarter_x, set(8))));
            patches(tile.w, hn::Add(hn::ShiftRight<1>(code), hn::IfThenElseZero(odd, quarter)), h00, h10, h01, h11);
            size = hn::IfThenElse(split, half, one), per_size = hn::IfThenElse(split, set(2), one);
            px = hn::Add(cell_x, hn::IfThenElseZero(split, quarter_x));
            py = hn::Add(cell_y, hn::IfThenElseZero(split, quarter_y));
            // The ray tracer's halves of a quad: cut along the corners after and before a quarter's own pixel.
            turned = hn::And(split, hn::Ne(quarter_x, quarter_y));
        } else {
            const auto index =
                hn::Add(hn::Mul(hn::ConvertTo(di, row), hn::Set(di, surface.stride)), hn::ConvertTo(di, column));
            const float* const lower = tile.w + surface.stride;
            h00 = hn::GatherIndex(d, tile.w, index), h10 = hn::GatherIndex(d, tile.w + 1, index);
            h01 = hn::GatherIndex(d, lower, index), h11 = hn::GatherIndex(d, lower + 1, index);
        }
        const M solid = coded ? hn::And(hn::Gt(h00, zero), hn::Lt(h00, set(surface.wall_top))) : hn::Eq(one, one);
        const Patch patch = coded ? Patch{hn::IfThenElse(turned, h10, h00), hn::IfThenElse(turned, h00, h10),
                                          hn::IfThenElse(turned, h11, h01), hn::IfThenElse(turned, h01, h11)}
                                  : Patch{h00, h10, h01, h11};
        const auto along = [&](V x) { return coded ? hn::IfThenElse(turned, hn::Sub(one, x), x) : x; };
        const auto within_patch = [&](V place, V corner) { return unit(hn::Mul(hn::Sub(place, corner), per_size)); };

        const V in_x = within_patch(place_x, px), in_y = within_patch(place_y, py);
        const M now_known = hn::Eq(h00, h00);
        if (entered) {
            const M is_below = hn::Lt(segment, hn::Mul(patch.height(along(in_x), in_y), set(below_share)));
            below = hn::And(is_below, hn::Gt(s, zero));
            entered = false;
        } else if (coded && !hn::AllFalse(d, inner)) {
            const V by_x = between(hn::IfThenElse(forth_x, h00, h10), hn::IfThenElse(forth_x, h01, h11), in_y);
            const V by_y = between(hn::IfThenElse(forth_y, h00, h01), hn::IfThenElse(forth_y, h10, h11), in_x);
            const V height = hn::IfThenElse(came_by_x, by_x, by_y);
            const M is_below = hn::Lt(segment, hn::Mul(height, set(below_share)));
            const M passes = hn::And(hn::And(inner, hn::Le(s, wall_end)), hn::And(known, now_known));
            torn = hn::Or(torn, hn::And(hn::And(active, passes), hn::Xor(is_below, below)));
            below = hn::Or(hn::AndNot(inner, below), hn::And(inner, is_below));
        }
        known = now_known;

        const V sx = when(hn::Add(px, hn::Mul(far_x, size)), x0, per_dx);
        const V sy = when(hn::Add(py, hn::Mul(far_y, size)), y0, per_dy);
        const V leaves = hn::Min(sx, sy);
        const M ends = hn::Le(end, leaves), by_x = hn::AndNot(ends, hn::Le(sx, sy)),
                by_y = hn::AndNot(ends, hn::Gt(sx, sy));
        const V s_out = hn::Max(s, hn::Min(leaves, end));
        place_x = at(x0, s_out, dx), place_y = at(y0, s_out, dy), segment = at(w0, s_out, dw);
        const V out_x = hn::IfThenElse(by_x, far_x, within_patch(place_x, px));
        const V out_y = hn::IfThenElse(by_y, far_y, within_patch(place_y, py));
        const V from = hn::IfThenElse(by_x, hn::IfThenElse(forth_x, h10, h00), hn::IfThenElse(forth_y, h01, h00));
        const V to = hn::IfThenElse(by_x, hn::IfThenElse(forth_x, h11, h01), hn::IfThenElse(forth_y, h11, h10));
        V height = between(from, to, hn::IfThenElse(by_x, out_y, out_x));
        if (!hn::AllFalse(d, hn::And(active, ends)))
            height = hn::IfThenElse(ends, patch.height(along(out_x), out_y), height);
        const M below_out = hn::Lt(segment, hn::Mul(height, set(below_share)));
        M crosses = hn::Xor(below_out, below);
        const V turned_in = along(in_x), turned_out = along(out_x);
        const V side_in = hn::Sub(hn::Add(turned_in, in_y), one), side_out = hn::Sub(hn::Add(turned_out, out_y), one);
        const M cut = hn::Lt(hn::Mul(side_in, side_out), zero);
        if (!hn::AllFalse(d, hn::And(hn::And(active, solid), hn::AndNot(crosses, cut)))) {
            const V share = hn::Div(side_in, hn::IfThenElse(cut, hn::Sub(side_in, side_out), one));
            const V on_cut = between(patch.c, patch.b, between(turned_in, turned_out, share));
            const M below_cut = hn::Lt(at(w0, between(s, s_out, share), dw), hn::Mul(on_cut, set(below_share)));
            crosses = hn::Or(crosses, hn::And(cut, hn::Xor(below_cut, below)));
        }
        const M meets = hn::And(hn::And(active, solid), crosses);
        kept = hn::Or(kept, meets);
        below = coded ? hn::Or(hn::And(solid, below_out), hn::AndNot(solid, below)) : below_out;

        // On to the next patch: the other half of a split cell, else the next cell.
        M over_x = by_x, over_y = by_y;
        if constexpr (coded) {
            const M inner_x = hn::And(hn::And(split, by_x), hn::Eq(quarter_x, near_half_x));
            const M inner_y = hn::And(hn::And(split, by_y), hn::Eq(quarter_y, near_half_y));
            over_x = hn::AndNot(inner_x, by_x), over_y = hn::AndNot(inner_y, by_y);
            inner = hn::Or(inner_x, inner_y), came_by_x = by_x;
            quarter_x = hn::IfThenElse(inner_x, hn::Sub(half, quarter_x), quarter_x);
            quarter_y = hn::IfThenElse(inner_y, hn::Sub(half, quarter_y), quarter_y);
        }
        const V next_x = hn::Add(cell_x, hn::IfThenElseZero(over_x, step_x));
        const V next_y = hn::Add(cell_y, hn::IfThenElseZero(over_y, step_y));
        if constexpr (coded) {
            quarter_x =
                hn::IfThenElse(over_x, near_half_x, hn::IfThenElse(inner, quarter_x, later_half(place_x, next_x)));
            quarter_y =
                hn::IfThenElse(over_y, near_half_y, hn::IfThenElse(inner, quarter_y, later_half(place_y, next_y)));
        }
        s = s_out;
        const M within = hn::And(hn::And(hn::Ge(next_x, left), hn::Le(next_x, last_x)),
                                 hn::And(hn::Ge(next_y, top), hn::Le(next_y, last_y)));
        active = hn::AndNot(hn::Or(meets, ends), hn::And(active, hn::And(within, hn::Lt(s_out, stop))));
        if (hn::AllFalse(d, active)) break;
        cell_x = hn::IfThenElse(within, next_x, cell_x), cell_y = hn::IfThenElse(within, next_y, cell_y);
    }
    met.kept = bits_of(kept), met.torn = bits_of(torn);
    return met;
}

Met march(const Surface& surface, const Tile& tile, const Rays& rays, uint32_t asked) {
    const F d;
    const size_t lanes = hn::Lanes(d);
    Met all;
    for (size_t first = 0; first < size_t(packet_rays); first += lanes) {
        const uint32_t own = asked >> first & ((1u << lanes) - 1);
        if (!own) continue;
        const Met met = (tile.codes ? &march_lanes<true> : &march_lanes<false>)(surface, tile, rays, first, own);
        all.kept |= met.kept << first, all.torn |= met.torn << first;
    }
    return all;
}

const Kernels table = {&march};
const Kernels* get() {
    return &table;
}

}  // namespace HWY_NAMESPACE
}  // namespace vshift::heights
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace vshift::heights {

HWY_EXPORT(get);

const Kernels& kernels() {
    static const Kernels* const chosen = HWY_DYNAMIC_DISPATCH(get)();
    return *chosen;
}

}  // namespace vshift::heights
#endif
