// SPDX-License-Identifier: Apache-2.0
#include "embree_core/raster_kernels.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "embree_core/raster_kernels.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace vshift::raster {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// Runs end within the rows' padding, whatever the machine's width.
using F = hn::CappedTag<float, 16>;
using I = hn::RebindToSigned<F>;
using U8 = hn::Rebind<uint8_t, F>;
using V = hn::Vec<F>;
using M = hn::Mask<F>;

constexpr float nearest_share = 1e-5f;  // as in raster.cpp

HWY_INLINE V dot(const float* m, V u, V rest, V w) {
    const F f;
    return hn::Add(hn::Mul(hn::Set(f, m[0]), u), hn::Add(rest, hn::Mul(hn::Set(f, m[3]), w)));
}

void transform(const Map& map, float u0, float v, size_t n, Row& out) {
    const F f;
    const size_t lanes = hn::Lanes(f);
    const V bx = hn::Set(f, map.x[1] * v + map.x[2]), by = hn::Set(f, map.y[1] * v + map.y[2]),
            bz = hn::Set(f, map.z[1] * v + map.z[2]);
    const V one = hn::Set(f, 1.0f), behind = hn::Set(f, -1.0f), least = hn::Set(f, nearest_share);
    for (size_t i = 0; i < n; i += lanes) {
        const V wi = hn::LoadU(f, out.w + i);
        const V u = hn::Add(hn::Iota(f, float(i)), hn::Set(f, u0));
        const V hz = dot(map.z, u, bz, wi);
        const V r = hn::IfThenElse(hn::Gt(hz, least), hn::Div(one, hz), behind);
        hn::StoreU(hn::Mul(dot(map.x, u, bx, wi), r), f, out.x + i);
        hn::StoreU(hn::Mul(dot(map.y, u, by, wi), r), f, out.y + i);
        hn::StoreU(hn::Mul(wi, r), f, out.q + i);
        hn::StoreU(r, f, out.r + i);
    }
}

struct Quad {
    V x[4], y[4];  ///< corners in the order of the ring
};

/// Whether a pixel exactly on the edge belongs to the triangle on its inner side.
HWY_INLINE M owns(const Quad& c, int p, int q) {
    const F f;
    const V zero = hn::Zero(f);
    const V dx = hn::Sub(c.x[q], c.x[p]), dy = hn::Sub(c.y[q], c.y[p]);
    return hn::Or(hn::Lt(dy, zero), hn::And(hn::Eq(dy, zero), hn::Gt(dx, zero)));
}
HWY_INLINE M inside(V e, M owned) {
    const V zero = hn::Zero(F());
    return hn::Or(hn::Gt(e, zero), hn::And(hn::Eq(e, zero), owned));
}
HWY_INLINE V cross(V ax, V ay, V bx, V by) {
    return hn::Sub(hn::Mul(ax, by), hn::Mul(ay, bx));
}
HWY_INLINE V area(const Quad& c, int p, int q, int s) {
    return cross(hn::Sub(c.x[q], c.x[p]), hn::Sub(c.y[q], c.y[p]), hn::Sub(c.x[s], c.x[p]), hn::Sub(c.y[s], c.y[p]));
}
HWY_INLINE V least_of(const V (&v)[4]) {
    return hn::Min(hn::Min(v[0], v[1]), hn::Min(v[2], v[3]));
}
HWY_INLINE V most_of(const V (&v)[4]) {
    return hn::Max(hn::Max(v[0], v[1]), hn::Max(v[2], v[3]));
}

void cells(const Row& above, const Row& below, float u0, float v0, const Window& window, size_t n, Cells& out) {
    const F f;
    const I d;
    const U8 bytes;
    const size_t lanes = hn::Lanes(f);
    const V zero = hn::Zero(f), one = hn::Set(f, 1.0f);
    for (size_t i = 0; i < n; i += lanes) {
        const auto tears = [&](const uint8_t* p, int bits) {
            return hn::And(hn::PromoteTo(d, hn::LoadU(bytes, p + i)), hn::Set(d, bits));
        };
        const V w[4] = {hn::LoadU(f, above.w + i), hn::LoadU(f, above.w + i + 1), hn::LoadU(f, below.w + i + 1),
                        hn::LoadU(f, below.w + i)};
        const auto torn = hn::Or(tears(above.tears, 3), hn::Or(tears(above.tears + 1, 2), tears(below.tears, 1)));
        M solid = hn::Gt(w[0], zero), sky = hn::Eq(w[0], zero), blank = hn::Ne(w[0], w[0]);
        for (int c = 1; c < 4; ++c) {
            solid = hn::And(solid, hn::Gt(w[c], zero));
            sky = hn::And(sky, hn::Eq(w[c], zero));
            blank = hn::And(blank, hn::Ne(w[c], w[c]));
        }
        const M whole = hn::And(solid, hn::RebindMask(f, hn::Eq(torn, hn::Zero(d))));
        const M empty = hn::Or(sky, blank);

        const Quad c = {{hn::LoadU(f, above.x + i), hn::LoadU(f, above.x + i + 1), hn::LoadU(f, below.x + i + 1),
                         hn::LoadU(f, below.x + i)},
                        {hn::LoadU(f, above.y + i), hn::LoadU(f, above.y + i + 1), hn::LoadU(f, below.y + i + 1),
                         hn::LoadU(f, below.y + i)}};
        const V r[4] = {hn::LoadU(f, above.r + i), hn::LoadU(f, above.r + i + 1), hn::LoadU(f, below.r + i + 1),
                        hn::LoadU(f, below.r + i)};
        const V q[4] = {hn::LoadU(f, above.q + i), hn::LoadU(f, above.q + i + 1), hn::LoadU(f, below.q + i + 1),
                        hn::LoadU(f, below.q + i)};
        const M front = hn::Gt(least_of(r), zero);
        // Pixels whose centres may lie inside; at the far sides the edge rule gives them to the next triangle.
        const V x0 = hn::Ceil(hn::Max(least_of(c.x), zero)),
                x1 = hn::Ceil(hn::Min(most_of(c.x), hn::Set(f, window.width))),
                y0 = hn::Ceil(hn::Max(least_of(c.y), hn::Set(f, window.y0))),
                y1 = hn::Ceil(hn::Min(most_of(c.y), hn::Set(f, window.y1)));
        const V across = hn::Sub(x1, x0), down = hn::Sub(y1, y0);
        const M reached = hn::And(hn::And(whole, front), hn::And(hn::Gt(across, zero), hn::Gt(down, zero)));
        const M plain =
            hn::And(hn::And(hn::Le(across, hn::Set(f, float(most_across))), hn::Le(down, hn::Set(f, float(most_down)))),
                    hn::And(hn::Gt(area(c, 0, 1, 3), zero), hn::Gt(area(c, 2, 3, 1), zero)));
        const auto drawn_cell = hn::RebindMask(d, hn::And(reached, plain));
        auto kind = hn::IfThenElse(hn::RebindMask(d, hn::Or(whole, empty)), hn::Zero(d), hn::Set(d, int32_t(split)));
        kind = hn::IfThenElse(hn::RebindMask(d, reached), hn::Set(d, int32_t(wide)), kind);
        kind = hn::IfThenElse(drawn_cell, hn::Set(d, int32_t(drawn)), kind);
        hn::StoreU(kind, d, out.kind + i);
        if (hn::AllFalse(d, drawn_cell)) {
            hn::StoreU(hn::Zero(d), d, out.hits + i);
            continue;
        }
        hn::StoreU(hn::ConvertTo(d, hn::IfThenElseZero(reached, x0)), d, out.x + i);
        hn::StoreU(hn::ConvertTo(d, hn::IfThenElseZero(reached, y0)), d, out.y + i);

        const M owns13 = owns(c, 1, 3), owns01 = owns(c, 0, 1), owns30 = owns(c, 3, 0), owns23 = owns(c, 2, 3),
                owns12 = owns(c, 1, 2);
        const V u = hn::Add(hn::Iota(f, float(i)), hn::Set(f, u0)), v = hn::Set(f, v0);
        auto hits = hn::Zero(d);
        for (int k = 0; k < slots; ++k) {
            const V dx = hn::Set(f, float(k % most_across)), dy = hn::Set(f, float(k / most_across));
            const M there = hn::And(hn::RebindMask(f, drawn_cell), hn::And(hn::Lt(dx, across), hn::Lt(dy, down)));
            if (hn::AllFalse(f, there)) continue;
            const V px = hn::Add(x0, dx), py = hn::Add(y0, dy);
            V ex[4], ey[4];
            for (int j = 0; j < 4; ++j) ex[j] = hn::Sub(c.x[j], px), ey[j] = hn::Sub(c.y[j], py);
            const auto edge = [&](int a, int b) { return cross(ex[a], ey[a], ex[b], ey[b]); };
            const V diagonal = edge(1, 3);
            const M upper = inside(diagonal, owns13);
            const V e01 = edge(0, 1), e30 = edge(3, 0), e23 = edge(2, 3), e12 = edge(1, 2);
            const M covered = hn::Or(hn::And(upper, hn::And(inside(e01, owns01), inside(e30, owns30))),
                                     hn::AndNot(upper, hn::And(inside(e23, owns23), inside(e12, owns12))));
            // Triangle (o, p, s): the corner at the right angle, the one beside it along u, the one along v.
            const V to_o = hn::Abs(diagonal), to_s = hn::IfThenElse(upper, e01, e23),
                    to_p = hn::IfThenElse(upper, e30, e12);
            const V sum = hn::Add(hn::Add(to_o, to_p), to_s);
            const V ro = hn::Mul(to_o, hn::IfThenElse(upper, r[0], r[2])),
                    rp = hn::Mul(to_p, hn::IfThenElse(upper, r[1], r[3])),
                    rs = hn::Mul(to_s, hn::IfThenElse(upper, r[3], r[1]));
            const V all = hn::Add(hn::Add(ro, rp), rs);
            const V share = hn::Div(one, hn::Mul(sum, all));
            const V height = hn::Add(hn::Add(hn::Mul(to_o, hn::IfThenElse(upper, q[0], q[2])),
                                             hn::Mul(to_p, hn::IfThenElse(upper, q[1], q[3]))),
                                     hn::Mul(to_s, hn::IfThenElse(upper, q[3], q[1])));
            const V fu = hn::Mul(hn::Mul(rp, sum), share), fv = hn::Mul(hn::Mul(rs, sum), share);
            const M hit = hn::And(there, hn::And(covered, hn::Gt(sum, zero)));
            hits = hn::Or(hits, hn::IfThenElseZero(hn::RebindMask(d, hit), hn::Set(d, 1 << k)));
            hn::StoreU(hn::Mul(hn::Mul(height, all), share), f, out.q[k] + i);
            const V half = hn::Set(f, 0.5f);  // centres are at 0.5 from here on
            hn::StoreU(hn::Add(hn::Add(u, hn::IfThenElse(upper, fu, hn::Sub(one, fu))), half), f, out.u[k] + i);
            hn::StoreU(hn::Add(hn::Add(v, hn::IfThenElse(upper, fv, hn::Sub(one, fv))), half), f, out.v[k] + i);
        }
        hn::StoreU(hits, d, out.hits + i);
    }
}

void settle(const float* floor, const float* wall, size_t n, float* q, float* source_px, uint8_t* out, uint8_t* open) {
    const F f;
    const I d;
    const U8 bytes;
    const size_t lanes = hn::Lanes(f);
    const V zero = hn::Zero(f), margin = hn::Set(f, wall_margin), marked = hn::Set(f, 0.25f - 0.5f * back_mark);
    size_t i = 0;
    for (; i + lanes <= n; i += lanes) {
        const V drawn = hn::LoadU(f, q + i);
        const V bottom = floor ? hn::LoadU(f, floor + i) : zero;
        const M asked = hn::Or(hn::Le(bottom, zero), hn::Ne(drawn, bottom));
        if (hn::AllFalse(f, asked)) {
            hn::StoreU(zero, f, q + i);
            hn::StoreU(hn::Zero(bytes), bytes, out + i);
            hn::StoreU(hn::Zero(bytes), bytes, open + i);
            continue;
        }
        V x, y;
        hn::LoadInterleaved2(f, source_px + 2 * i, x, y);
        const M surface = hn::Gt(drawn, zero), behind = hn::Gt(hn::LoadU(f, wall + i), hn::Mul(drawn, margin));
        const M from_back = hn::And(asked, hn::And(surface, hn::Lt(x, marked)));
        if (!hn::AllFalse(f, from_back))
            hn::StoreInterleaved2(hn::IfThenElse(from_back, hn::Add(x, hn::Set(f, back_mark)), x), y, f,
                                  source_px + 2 * i);
        const auto bits = [&](M m, int value) { return hn::IfThenElseZero(hn::RebindMask(d, m), hn::Set(d, value)); };
        const auto plain = hn::Add(bits(surface, front), bits(from_back, back - front));
        const auto shown = hn::IfThenElse(hn::RebindMask(d, behind), hn::Set(d, int32_t(walled)), plain);
        hn::StoreU(hn::DemoteTo(bytes, hn::IfThenElseZero(hn::RebindMask(d, asked), shown)), bytes, out + i);
        hn::StoreU(hn::DemoteTo(bytes, bits(hn::AndNot(surface, asked), 1)), bytes, open + i);
        if (floor) hn::StoreU(hn::IfThenElseZero(asked, drawn), f, q + i);
    }
    for (; i < n; ++i) {
        const float bottom = floor ? floor[i] : 0;
        open[i] = 0, out[i] = no_surface;
        if (bottom > 0 && q[i] == bottom) {
            q[i] = 0;
            continue;
        }
        const bool from_back = q[i] > 0 && source_px[2 * i] < 0.25f - 0.5f * back_mark;
        if (from_back) source_px[2 * i] += back_mark;
        open[i] = !(q[i] > 0);
        out[i] = wall[i] > q[i] * wall_margin ? walled : q[i] > 0 ? (from_back ? back : front) : no_surface;
    }
}

const Kernels table = {&transform, &cells, &settle};
const Kernels* get() {
    return &table;
}

}  // namespace HWY_NAMESPACE
}  // namespace vshift::raster
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace vshift::raster {

HWY_EXPORT(get);

const Kernels& kernels() {
    static const Kernels* const chosen = HWY_DYNAMIC_DISPATCH(get)();
    return *chosen;
}

}  // namespace vshift::raster
#endif
