// SPDX-License-Identifier: Apache-2.0
#include "embree_core/ray_filter_kernels.h"

#include <algorithm>
#include <array>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "embree_core/ray_filter_kernels.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace vshift::filtering {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using F = hn::CappedTag<float, 16>;
using I = hn::RebindToSigned<F>;

// What a float's rounding moves a place in V's picture by, and to spare.
constexpr float place_px = 0.02f;

/// Bounds per column of a row of tiles, each with room for a tile before and some more behind.
enum Column {
    low,
    high,
    x_low,
    x_high,
    y_low,
    y_high,
    torn_x_low,
    torn_x_high,
    torn_y_low,
    torn_y_high,
    torn,
    columns
};
constexpr size_t before = 16, behind = 64;

/// The rows that bound a row of tiles: one more on each side where there is one.
struct Rows {
    std::array<const float*, 5> w{};
    std::array<const uint8_t*, 5> tears{};
    int count = 0;
    int first_own = 0, last_own = 0;  ///< among them: the pixels' own, the last one's lower neighbour included
};

template <class D>
HWY_INLINE hn::Vec<D> smaller(hn::Vec<D> a, hn::Vec<D> b) {
    return hn::IfThenElse(hn::Lt(a, b), a, b);  // b where a is NaN
}
template <class D>
HWY_INLINE hn::Vec<D> larger(hn::Vec<D> a, hn::Vec<D> b) {
    return hn::IfThenElse(hn::Gt(a, b), a, b);
}

/// Columns `i` and on of the pixels' own bounds and the steps between rows. Pixels without a measurement make `high`
/// infinite.
template <class D>
HWY_INLINE void bound_columns(D d, const Rows& rows, bool only_rows, size_t i, float* const* out) {
    using V = hn::Vec<D>;
    const hn::RebindToSigned<D> di;
    const hn::Rebind<uint8_t, D> bytes;
    const V zero = hn::Zero(d), most = hn::Set(d, infinity), least = hn::Set(d, -infinity);
    V lowest = most, highest = zero, y_lowest = zero, y_highest = zero, torn_lowest = most, torn_highest = least;
    V above = zero;
    auto any = hn::Zero(di);
    for (int r = 0; r < rows.count; ++r) {
        const V own = hn::LoadU(d, rows.w[size_t(r)] + i);
        any = hn::Or(any, hn::PromoteTo(di, hn::LoadU(bytes, rows.tears[size_t(r)] + i)));
        if (r >= rows.first_own && r <= rows.last_own) {
            lowest = smaller<D>(own, lowest);
            highest = larger<D>(own, highest);
            highest = hn::IfThenElse(hn::Ge(own, zero), highest, most);
        }
        if (r > 0) {
            const V step = hn::Sub(own, above);
            const auto is_torn = hn::RebindMask(
                d, hn::Ne(hn::And(hn::PromoteTo(di, hn::LoadU(bytes, rows.tears[size_t(r) - 1] + i)), hn::Set(di, 2)),
                          hn::Zero(di)));
            const V whole = hn::IfThenZeroElse(is_torn, step);
            y_lowest = smaller<D>(whole, y_lowest), y_highest = larger<D>(whole, y_highest);
            if (!only_rows && r > rows.first_own && r <= rows.last_own) {
                torn_lowest = smaller<D>(hn::IfThenElse(is_torn, step, most), torn_lowest);
                torn_highest = larger<D>(hn::IfThenElse(is_torn, step, least), torn_highest);
            }
        }
        above = own;
    }
    hn::StoreU(lowest, d, out[low] + i), hn::StoreU(highest, d, out[high] + i);
    hn::StoreU(y_lowest, d, out[y_low] + i), hn::StoreU(y_highest, d, out[y_high] + i);
    hn::StoreU(torn_lowest, d, out[torn_y_low] + i), hn::StoreU(torn_highest, d, out[torn_y_high] + i);
    hn::StoreU(hn::ConvertTo(d, any), d, out[torn] + i);
}

/// Steps from columns `i` and on to their right neighbours.
template <class D>
HWY_INLINE void bound_steps(D d, const Rows& rows, bool only_rows, size_t i, float* const* out) {
    using V = hn::Vec<D>;
    const hn::RebindToSigned<D> di;
    const hn::Rebind<uint8_t, D> bytes;
    const V zero = hn::Zero(d), most = hn::Set(d, infinity), least = hn::Set(d, -infinity);
    V lowest = zero, highest = zero, torn_lowest = most, torn_highest = least;
    for (int r = only_rows ? rows.first_own : 0; r < (only_rows ? rows.first_own + 1 : rows.count); ++r) {
        const float* w = rows.w[size_t(r)] + i;
        const V step = hn::Sub(hn::LoadU(d, w + 1), hn::LoadU(d, w));
        const auto is_torn = hn::RebindMask(
            d, hn::Ne(hn::And(hn::PromoteTo(di, hn::LoadU(bytes, rows.tears[size_t(r)] + i)), hn::Set(di, 1)),
                      hn::Zero(di)));
        const V whole = hn::IfThenZeroElse(is_torn, step);
        lowest = smaller<D>(whole, lowest), highest = larger<D>(whole, highest);
        if (r >= rows.first_own && r <= rows.last_own) {
            torn_lowest = smaller<D>(hn::IfThenElse(is_torn, step, most), torn_lowest);
            torn_highest = larger<D>(hn::IfThenElse(is_torn, step, least), torn_highest);
        }
    }
    hn::StoreU(lowest, d, out[x_low] + i), hn::StoreU(highest, d, out[x_high] + i);
    hn::StoreU(torn_lowest, d, out[torn_x_low] + i), hn::StoreU(torn_highest, d, out[torn_x_high] + i);
}

/// values[i] becomes the least (largest) of values[i] to values[i + 7].
template <bool largest>
void over_tiles(float* values, size_t n) {
    const F d;
    const size_t lanes = hn::Lanes(d);
    // One pass: what is read ahead has not been written yet.
    for (size_t i = 0; i < n; i += lanes) {
        auto v = hn::LoadU(d, values + i);
        for (size_t k = 1; k < size_t(tile_width); ++k) {
            const auto next = hn::LoadU(d, values + i + k);
            v = largest ? hn::Max(v, next) : hn::Min(v, next);
        }
        hn::StoreU(v, d, values + i);
    }
}

/// Bins from `least` to `most`.
struct Places {
    hn::Vec<F> least, most;
};

void tiles(const Setting& s, const float* w, const uint8_t* tears, int tile_row, std::vector<float>& room,
           TileRow& out) {
    const F d;
    const I di;
    using V = hn::Vec<F>;
    const size_t lanes = hn::Lanes(d), n = size_t(s.width);
    const bool only_rows = s.tile_height == 1;
    Rows rows;
    const int y0 = tile_row * s.tile_height, y1 = std::min(y0 + (only_rows ? 0 : s.tile_height), s.height - 1);
    for (int y = std::max(0, y0 - 1); y <= std::min(y1 + 1, s.height - 1); ++y) {
        if (y == y0) rows.first_own = rows.count;
        if (y == y1) rows.last_own = rows.count;
        rows.w[size_t(rows.count)] = w + size_t(y) * n, rows.tears[size_t(rows.count++)] = tears + size_t(y) * n;
    }

    const size_t pitch = before + n + behind;
    room.resize(columns * pitch);
    float* at[columns];
    for (size_t c = 0; c < columns; ++c) {
        at[c] = room.data() + c * pitch + before;
        const float neutral = c == low || c == torn_x_low || c == torn_y_low ? infinity
                              : c == torn_x_high || c == torn_y_high         ? -infinity
                                                                             : 0;
        std::fill(at[c] - before, at[c], neutral);
        std::fill(at[c] + (n - 1), at[c] + n + behind, neutral);
    }
    if (n > lanes) {
        for (size_t i = 0; i < n; i += lanes) bound_columns(d, rows, only_rows, std::min(i, n - lanes), at);
        for (size_t i = 0; i + 1 < n; i += lanes) bound_steps(d, rows, only_rows, std::min(i, n - 1 - lanes), at);
    } else {
        const hn::CappedTag<float, 1> one;
        for (size_t i = 0; i < n; ++i) bound_columns(one, rows, only_rows, i, at);
        for (size_t i = 0; i + 1 < n; ++i) bound_steps(one, rows, only_rows, i, at);
    }
    for (size_t c = 0; c < columns; ++c) {
        if (only_rows && (c == torn_y_low || c == torn_y_high)) continue;
        const bool largest =
            c == torn || c == high || c == x_high || c == y_high || c == torn_x_high || c == torn_y_high;
        // From one column before on: steps towards the first one count, too.
        (largest ? &over_tiles<true> : &over_tiles<false>)(at[c] - 1, n + 16);
    }

    const auto set = [&](float value) { return hn::Set(d, value); };
    const V zero = hn::Zero(d), one = set(1), half = set(0.5f), two = set(2);
    const V centre_x = set(s.u.centre), centre_z = set(s.centre_z), most = set(infinity);
    const float way_top = s.v.centre - s.centre_z * float(y0), way_bottom = s.v.centre - s.centre_z * float(y1 + 1);
    const auto steepest = [](V way0, V way1, V lowest, V highest) {
        return hn::Max(hn::Max(hn::Mul(way0, lowest), hn::Mul(way0, highest)),
                       hn::Max(hn::Mul(way1, lowest), hn::Mul(way1, highest)));
    };
    /// Walls fall away on the way to V, whatever half a pixel of slope makes of them.
    const auto fall = [&](V way0, V way1, V lowest, V highest, V least_step) {
        const auto ahead = hn::And(hn::Gt(way0, zero), hn::Gt(way1, zero)),
                   back = hn::And(hn::Lt(way0, zero), hn::Lt(way1, zero));
        return hn::And(hn::Or(back, hn::Gt(hn::Neg(highest), least_step)), hn::Or(ahead, hn::Gt(lowest, least_step)));
    };
    const size_t tiles = out.low.size();
    const auto last_inner = hn::Set(di, int32_t(tiles) - 1);
    const bool y_border = y0 == 0 || y1 + 1 >= s.height;
    for (size_t first = 0; first < tiles; first += lanes) {
        const auto index =
            hn::Min(hn::Add(hn::Iota(di, 0), hn::Set(di, int32_t(first))), hn::Set(di, int32_t(tiles) - 1));
        const auto x = hn::Mul(index, hn::Set(di, tile_width));
        const auto get = [&](Column c, int shift) { return hn::GatherIndex(d, at[c] + shift, x); };
        const V lowest_any = hn::Min(get(low, 0), get(low, 1)), highest = hn::Max(get(high, 0), get(high, 1));
        const auto bad = hn::Eq(highest, most), empty = hn::Eq(highest, zero);
        const V lowest = hn::IfThenElse(hn::Eq(lowest_any, most), zero, lowest_any);
        const V slack = hn::Min(set(s.slack), hn::Mul(set(s.slack_share), highest));
        const V more = hn::Mul(set(4), slack);
        const V xl = hn::Sub(hn::Min(get(x_low, -1), get(x_low, 1)), more),
                xh = hn::Add(hn::Max(get(x_high, -1), get(x_high, 1)), more);
        const V yl = hn::Sub(hn::Min(hn::Min(get(y_low, -1), get(y_low, 1)), get(y_low, 2)), more),
                yh = hn::Add(hn::Max(hn::Max(get(y_high, -1), get(y_high, 1)), get(y_high, 2)), more);
        const V x_step = hn::Max(xh, hn::Neg(xl)), y_step = hn::Max(yh, hn::Neg(yl)), step = hn::Add(x_step, y_step);

        // At tears and at the image's border surfaces go on by half a pixel.
        const auto whole = hn::And(hn::Eq(hn::Max(hn::Max(get(torn, -1), get(torn, 1)), get(torn, 2)), zero),
                                   hn::RebindMask(d, hn::And(hn::Gt(index, hn::Zero(di)), hn::Lt(index, last_inner))));
        const auto at_tear = [&](V v) { return y_border ? v : hn::IfThenZeroElse(whole, v); };

        const V u0 = hn::ConvertTo(d, x), u1 = hn::Min(hn::Add(u0, set(tile_width + 1)), set(float(n)));
        const V way_left = hn::Sub(centre_x, hn::Mul(centre_z, u0)),
                way_right = hn::Sub(centre_x, hn::Mul(centre_z, u1));
        V rise;
        auto falls = fall(way_left, way_right, get(torn_x_low, 0), get(torn_x_high, 0), only_rows ? x_step : step);
        if (only_rows) {
            rise = steepest(way_left, way_right, xl, xh);
        } else {
            // Where two slopes meet in a torn cell, one changes by the spread of the other.
            const V x_spread = at_tear(hn::Mul(half, hn::Sub(yh, yl))),
                    y_spread = at_tear(hn::Mul(half, hn::Sub(xh, xl)));
            rise = hn::Add(steepest(way_left, way_right, hn::Sub(xl, x_spread), hn::Add(xh, x_spread)),
                           steepest(set(way_top), set(way_bottom), hn::Sub(yl, y_spread), hn::Add(yh, y_spread)));
            const V torn_lowest = hn::Min(get(torn_y_low, 0), get(torn_y_low, 1)),
                    torn_highest = hn::Max(get(torn_y_high, 0), get(torn_y_high, 1));
            falls = hn::And(falls, fall(set(way_top), set(way_bottom), torn_lowest, torn_highest, step));
        }
        const auto clear_at = [&](V at) { return hn::Sub(one, hn::Mul(centre_z, at)); };
        const V clear = hn::Min(clear_at(lowest), clear_at(highest));
        const auto gentle =
            hn::And(hn::And(falls, hn::Lt(highest, most)),
                    hn::And(hn::Gt(clear, set(least_clear)), hn::Lt(rise, hn::Mul(set(surely), clear))));

        const V beyond = at_tear(hn::Mul(half, step));
        const V reach_low = hn::Max(zero, hn::Sub(hn::Max(hn::Mul(half, lowest), hn::Sub(lowest, beyond)), slack));
        V reach_high = hn::Add(hn::Min(hn::Mul(two, highest), hn::Add(highest, beyond)), slack);
        reach_high = hn::IfThenElse(bad, set(s.wall_top), hn::IfThenZeroElse(empty, reach_high));
        const V own_low = hn::Max(zero, hn::Sub(lowest, slack)),
                own_high = hn::IfThenElse(bad, set(s.wall_top), hn::IfThenZeroElse(empty, hn::Add(highest, slack)));

        struct Places {
            V x0, x1, y0, y1;
            hn::Mask<F> anywhere;
        };
        const auto places = [&](V lo, V hi, V left, V right, float top, float bottom) {
            const V k0 = clear_at(lo), k1 = clear_at(hi);
            const auto anywhere = hn::Le(hn::Min(k0, k1), set(least_clear));
            const V per0 = hn::Div(one, k0), per1 = hn::Div(one, k1);
            const auto seen = [&](V u, float centre, V w, V per) {
                return hn::Mul(hn::Sub(u, hn::Mul(set(centre), w)), per);
            };
            const V margin = hn::Add(set(place_px), hn::Mul(set(s.miss_px), hi));
            const auto bin = [&](V q, float per_px, const Axis& axis) {
                const V at = hn::Add(hn::Floor(hn::Mul(q, set(per_px))), set(float(axis.before)));
                return hn::Min(hn::Max(at, zero), set(float(axis.bins - 1)));
            };
            const auto least = [&](V u, float c) {
                return hn::Sub(hn::Min(seen(u, c, lo, per0), seen(u, c, hi, per1)), margin);
            };
            const auto largest = [&](V u, float c) {
                return hn::Add(hn::Max(seen(u, c, lo, per0), seen(u, c, hi, per1)), margin);
            };
            Places p{bin(least(left, s.u.centre), 1.0f / tile_width, s.u),
                     bin(largest(right, s.u.centre), 1.0f / tile_width, s.u), set(float(tile_row)),
                     set(float(tile_row)), anywhere};
            if (!only_rows) {
                const float per_px = 1.0f / float(s.tile_height);
                p.y0 = bin(least(set(top), s.v.centre), per_px, s.v),
                p.y1 = bin(largest(set(bottom), s.v.centre), per_px, s.v);
            }
            p.x0 = hn::IfThenZeroElse(anywhere, p.x0), p.x1 = hn::IfThenElse(anywhere, set(float(s.u.bins - 1)), p.x1);
            return p;
        };
        const V left = hn::IfThenZeroElse(hn::Eq(u0, zero), hn::Add(u0, half));
        const float top = y0 == 0 ? 0 : float(y0) + 0.5f;
        const Places of_pixels = places(own_low, own_high, hn::Add(u0, half), hn::Add(u0, set(tile_width - 0.5f)),
                                        float(y0) + 0.5f, float(y0 + s.tile_height) - 0.5f);
        const Places of_surface =
            places(reach_low, reach_high, left, hn::Min(hn::Add(u0, set(tile_width + 0.5f)), set(float(n))), top,
                   std::min(float(y0 + s.tile_height) + 0.5f, float(s.height)));

        // One by one from here: the last vector may hold fewer tiles.
        HWY_ALIGN float lows[16], highs[16], places_of[8][16];
        HWY_ALIGN int32_t flags[16];
        hn::StoreU(own_low, d, lows), hn::StoreU(reach_high, d, highs);
        const V* const all[8] = {&of_pixels.x0,  &of_pixels.x1,  &of_pixels.y0,  &of_pixels.y1,
                                 &of_surface.x0, &of_surface.x1, &of_surface.y0, &of_surface.y1};
        for (size_t k = 0; k < 8; ++k) hn::StoreU(*all[k], d, places_of[k]);
        const auto bit = [&](const hn::Mask<F>& mask, int32_t value) {
            return hn::IfThenElseZero(hn::RebindMask(di, mask), hn::Set(di, value));
        };
        hn::StoreU(hn::Or(bit(gentle, 4), hn::Or(bit(of_pixels.anywhere, 1), bit(of_surface.anywhere, 2))), di, flags);
        for (size_t k = 0; k < std::min(lanes, tiles - first); ++k) {
            const size_t t = first + k;
            const auto bins = [&](size_t of) {
                return Bins{int16_t(places_of[of][k]), int16_t(places_of[of + 1][k]), int16_t(places_of[of + 2][k]),
                            int16_t(places_of[of + 3][k])};
            };
            out.low[t] = lows[k], out.high[t] = highs[k];
            out.pixels[t] = bins(0), out.surface[t] = bins(4);
            out.gentle[t] = uint8_t(flags[k] >> 2), out.anywhere[t] = uint8_t(flags[k] & 3);
        }
    }
}

Extent extent(const float* w, size_t n) {
    const F d;
    const size_t lanes = hn::Lanes(d);
    const auto zero = hn::Zero(d);
    auto least = hn::Set(d, infinity), largest = zero;
    auto valid = hn::Eq(zero, zero);
    size_t i = 0;
    for (; i + lanes <= n; i += lanes) {
        const auto v = hn::LoadU(d, w + i);
        least = hn::IfThenElse(hn::And(hn::Gt(v, zero), hn::Lt(v, least)), v, least);
        largest = larger<F>(v, largest);
        valid = hn::And(valid, hn::Ge(v, zero));
    }
    Extent out{hn::GetLane(hn::MinOfLanes(d, least)), hn::GetLane(hn::MaxOfLanes(d, largest)), !hn::AllTrue(d, valid)};
    for (; i < n; ++i) {
        if (w[i] > 0) out.least = std::min(out.least, w[i]), out.largest = std::max(out.largest, w[i]);
        out.invalid |= !(w[i] >= 0);
    }
    return out;
}

const Kernels table = {&extent, &tiles};
const Kernels* get() {
    return &table;
}

}  // namespace HWY_NAMESPACE
}  // namespace vshift::filtering
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace vshift::filtering {

HWY_EXPORT(get);

const Kernels& kernels() {
    static const Kernels* const chosen = HWY_DYNAMIC_DISPATCH(get)();
    return *chosen;
}

}  // namespace vshift::filtering
#endif
