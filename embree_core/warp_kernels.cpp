// SPDX-License-Identifier: Apache-2.0
#include "embree_core/warp_kernels.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "embree_core/warp_kernels.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace vshift::sampling {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// Runs end within the padding, whatever the machine's width.
using F = hn::CappedTag<float, 16>;
using I = hn::RebindToSigned<F>;
using V = hn::Vec<F>;
using VI = hn::Vec<I>;
using M = hn::Mask<F>;

/// The pixel that a position along one axis belongs to, and how far it is from its centre.
HWY_INLINE VI along(V position, int32_t size, V& offset) {
    const F f;
    const V zero = hn::Zero(f), last = hn::Set(f, float(size) - 0.5f);
    const V low = hn::IfThenElse(hn::Gt(position, zero), position, zero);  // also of NaN
    const VI pixel = hn::ConvertTo(I(), hn::IfThenElse(hn::Lt(low, last), low, last));
    offset = hn::Sub(position, hn::Add(hn::ConvertTo(f, pixel), hn::Set(f, 0.5f)));
    offset = hn::IfThenElse(hn::Lt(hn::Abs(offset), hn::Set(f, snap_px)), zero, offset);
    return pixel;
}

void plan(const Surface& s, const float* source_px, float x0, float y, size_t n, Plan& out) {
    const F f;
    const I d;
    const size_t lanes = hn::Lanes(f);
    const V zero = hn::Zero(f), one = hn::Set(f, 1.0f), shifted_y = hn::Set(f, y);
    const VI width = hn::Set(d, s.width);
    for (size_t i = 0; i < n; i += lanes) {
        V u, v, dx, dy;
        hn::LoadInterleaved2(f, source_px + 2 * i, u, v);
        const VI px = along(u, s.width, dx), py = along(v, s.height, dy);
        const M back = hn::Lt(dx, zero), up = hn::Lt(dy, zero);
        const VI left = hn::Sub(px, hn::IfThenElseZero(hn::RebindMask(d, back), hn::Set(d, 1)));
        const VI top = hn::Sub(py, hn::IfThenElseZero(hn::RebindMask(d, up), hn::Set(d, 1)));
        // With a pixel to spare on every side, so that all reads lie within the image.
        const auto inner = hn::And(hn::And(hn::Gt(left, hn::Zero(d)), hn::Lt(left, hn::Set(d, s.width - 3))),
                                   hn::And(hn::Gt(top, hn::Zero(d)), hn::Lt(top, hn::Set(d, s.height - 3))));
        if (hn::AllFalse(d, inner)) {
            hn::StoreU(hn::Zero(d), d, out.kind + i);
            continue;
        }
        const VI at = hn::IfThenElse(inner, hn::Add(hn::Mul(top, width), left), hn::Add(width, hn::Set(d, 1)));
        const VI below = hn::Add(at, width);
        const V w00 = hn::GatherIndex(f, s.w, at), w10 = hn::GatherIndex(f, s.w + 1, at),
                w01 = hn::GatherIndex(f, s.w, below), w11 = hn::GatherIndex(f, s.w + 1, below);
        // Tears round the ring of the four, as SurfaceField::whole: where there are none the place is no edge either.
        const auto tears = [&](VI index, int32_t bits) {
            return hn::And(hn::GatherOffset(d, reinterpret_cast<const int32_t*>(s.tears), index), hn::Set(d, bits));
        };
        const VI torn = hn::Or(tears(at, 0x0203), tears(below, 0x0001));
        const M whole = hn::And(hn::And(hn::Gt(w00, zero), hn::Gt(w10, zero)),
                                hn::And(hn::And(hn::Gt(w01, zero), hn::Gt(w11, zero)),
                                        hn::RebindMask(f, hn::And(inner, hn::Eq(torn, hn::Zero(d))))));
        // How far V's pixel reaches on R: the inverse of d(V)/d(R) on the surface.
        const V own = hn::IfThenElse(up, hn::IfThenElse(back, w11, w01), hn::IfThenElse(back, w10, w00));
        const V wx = hn::IfThenElse(up, hn::Sub(w11, w01), hn::Sub(w10, w00));
        const V wy = hn::IfThenElse(back, hn::Sub(w11, w10), hn::Sub(w01, w00));
        const auto scaled = [&](const float* m, int k, V by) {
            return hn::Add(hn::Set(f, m[k]), hn::Mul(hn::Set(f, m[3]), by));
        };
        const V hz =
            hn::Add(hn::Mul(hn::Set(f, s.z[0]), u), hn::Add(hn::Mul(hn::Set(f, s.z[1]), v), scaled(s.z, 2, own)));
        const V zu = scaled(s.z, 0, wx), zv = scaled(s.z, 1, wy);
        const V shifted_x = hn::Add(hn::Iota(f, float(i)), hn::Set(f, x0));
        const V xu = hn::Sub(scaled(s.x, 0, wx), hn::Mul(shifted_x, zu)),
                xv = hn::Sub(scaled(s.x, 1, wy), hn::Mul(shifted_x, zv));
        const V yu = hn::Sub(scaled(s.y, 0, wx), hn::Mul(shifted_y, zu)),
                yv = hn::Sub(scaled(s.y, 1, wy), hn::Mul(shifted_y, zv));
        const V area = hn::Abs(hn::Sub(hn::Mul(xu, yv), hn::Mul(xv, yu))), scale = hn::Abs(hz);
        V across = hn::Mul(scale, hn::Add(hn::Abs(yv), hn::Abs(xv))),
          down = hn::Mul(scale, hn::Add(hn::Abs(yu), hn::Abs(xu)));
        const auto too_wide = [&] {
            return hn::Gt(hn::IfThenElse(hn::Lt(across, down), down, across), hn::Mul(hn::Set(f, plain_width_px), area));
        };
        M small = hn::And(whole, too_wide());
        if (!hn::AllFalse(f, small)) {  // but for shears, as the sampler's steps
            const V ax = yv, ay = hn::Neg(yu), bx = hn::Neg(xv), by = xu;
            const V aa = hn::Add(hn::Mul(ax, ax), hn::Mul(ay, ay)), bb = hn::Add(hn::Mul(bx, bx), hn::Mul(by, by)),
                    ab = hn::Add(hn::Mul(ax, bx), hn::Mul(ay, by));
            const M shorter = hn::Lt(aa, bb);
            const V times = hn::Round(hn::Div(ab, hn::IfThenElse(shorter, aa, bb)));
            const V lx = hn::IfThenElse(shorter, bx, ax), ly = hn::IfThenElse(shorter, by, ay),
                    sx = hn::IfThenElse(shorter, ax, bx), sy = hn::IfThenElse(shorter, ay, by);
            across = hn::Mul(scale, hn::Add(hn::Abs(hn::Sub(lx, hn::Mul(times, sx))), hn::Abs(sx)));
            down = hn::Mul(scale, hn::Add(hn::Abs(hn::Sub(ly, hn::Mul(times, sy))), hn::Abs(sy)));
            small = hn::And(small, too_wide());
        }
        hn::StoreU(hn::IfThenElseZero(
                       hn::RebindMask(d, whole),
                       hn::IfThenElse(hn::RebindMask(d, small), hn::Set(d, int32_t(tent)), hn::Set(d, int32_t(plain)))),
                   d, out.kind + i);
        hn::StoreU(at, d, out.at + i);
        hn::StoreU(hn::IfThenElse(back, hn::Add(dx, one), dx), f, out.fx + i);
        hn::StoreU(hn::IfThenElse(up, hn::Add(dy, one), dy), f, out.fy + i);
        if (hn::AllFalse(f, small)) continue;
        hn::StoreU(hn::Div(across, area), f, out.across + i);
        hn::StoreU(hn::Div(down, area), f, out.down + i);
    }
}

#if HWY_TARGET == HWY_SCALAR
void colors(const Surface&, const float*, size_t n, Plan& plan, float* rgb) {
    for (size_t i = 0; i < n; ++i) plan.kind[i] = other;
    for (size_t i = 0; i < 3 * n; ++i) rgb[i] = 0;
}
#else

using F4 = hn::FixedTag<float, 4>;
using V4 = hn::Vec<F4>;

/// The offset of a position from the pixel centre that it belongs to, as `along`.
inline float place(float position, int32_t size, int32_t& pixel) {
    const float last = float(size) - 0.5f, low = position > 0 ? position : 0.0f;
    pixel = int32_t(low < last ? low : last);
    const float offset = position - (float(pixel) + 0.5f);
    return (offset < 0 ? -offset : offset) < snap_px ? 0.0f : offset;
}
inline float limited(float half) {
    return half < 1 ? 1.0f : half > widest_px ? widest_px : half;
}

/// The sampler's tent (warp.cpp) over boxes that lie on one surface; false for others, and beside the image's end.
HWY_INLINE bool tent_color(const Surface& s, const float* source_px, float across_px, float down_px, V4& color) {
    const F4 f;
    const hn::RebindToSigned<F4> d;
    int32_t px, py;
    const float dx = place(source_px[0], s.width, px), dy = place(source_px[1], s.height, py);
    const float gx = float(px) + dx, gy = float(py) + dy, half_x = limited(across_px), half_y = limited(down_px);
    // Pixels are not negative, so truncation is floor.
    const float left = gx - half_x + 1, top = gy - half_y + 1;
    const int32_t x0 = int32_t(left > 0 ? left : 0), x1 = int32_t(gx + half_x);
    const int32_t y0 = int32_t(top > 0 ? top : 0), y1 = int32_t(gy + half_y);
    constexpr int32_t most = 2 * int32_t(widest_px) + 4;
    if (x0 + most >= s.width || y1 + 1 >= s.height) return false;
    const float step_x = 1 / half_x, step_y = 1 / half_y;
    const V4 zero = hn::Zero(f), one = hn::Set(f, 1.0f);
    // Four columns at a time; what lies beyond the box counts nothing and is not looked at.
    V4 weights[most / 4];
    const int32_t groups = (x1 - x0) / 4 + 1;
    float total_x = 0, total_y = 0;
    auto sound = hn::Eq(zero, zero);
    for (int32_t g = 0; g < groups; ++g) {
        const int32_t x = x0 + 4 * g;
        const auto inside = hn::RebindMask(f, hn::Lt(hn::Iota(d, x), hn::Set(d, x1 + 1)));
        const V4 away = hn::Abs(hn::Sub(hn::ConvertTo(f, hn::Iota(d, x)), hn::Set(f, gx)));
        const V4 weight = hn::Max(hn::Sub(one, hn::Mul(away, hn::Set(f, step_x))), zero);
        weights[g] = hn::IfThenElseZero(inside, weight);
        HWY_ALIGN float lanes[4];
        hn::Store(weights[g], f, lanes);
        total_x = (((total_x + lanes[0]) + lanes[1]) + lanes[2]) + lanes[3];
        const int32_t left_over = x1 - x;
        const uint32_t bytes = left_over >= 3 ? ~0u : (1u << (8 * (left_over + 1))) - 1;
        uint32_t torn = 0;
        for (int32_t y = y0; y <= y1; ++y) {
            const size_t at = size_t(y) * size_t(s.width) + size_t(x);
            uint32_t tears;
            __builtin_memcpy(&tears, s.tears + at, 4);
            torn |= tears;
            sound = hn::And(sound, hn::Or(hn::Gt(hn::LoadU(f, s.w + at), zero), hn::Not(inside)));
        }
        if (torn & bytes) return false;
    }
    if (!hn::AllTrue(f, sound)) return false;
    V4 whole = zero;
    for (int32_t y = y0; y <= y1; ++y) {
        const float away = float(y) - gy, weight = 1 - (away < 0 ? -away : away) * step_y;
        const float down = weight > 0 ? weight : 0.0f;
        total_y += down;
        const float* pixel = s.rgb + 3 * (size_t(y) * size_t(s.width) + size_t(x0));
        V4 row = zero;
        int32_t g = 0;
        for (; 4 * g + 3 <= x1 - x0; ++g, pixel += 12) {
            row = hn::Add(row, hn::Mul(hn::Broadcast<0>(weights[g]), hn::LoadU(f, pixel)));
            row = hn::Add(row, hn::Mul(hn::Broadcast<1>(weights[g]), hn::LoadU(f, pixel + 3)));
            row = hn::Add(row, hn::Mul(hn::Broadcast<2>(weights[g]), hn::LoadU(f, pixel + 6)));
            row = hn::Add(row, hn::Mul(hn::Broadcast<3>(weights[g]), hn::LoadU(f, pixel + 9)));
        }
        if (const int32_t rest = x1 - x0 + 1 - 4 * g; rest > 0) {
            row = hn::Add(row, hn::Mul(hn::Broadcast<0>(weights[g]), hn::LoadU(f, pixel)));
            if (rest > 1) row = hn::Add(row, hn::Mul(hn::Broadcast<1>(weights[g]), hn::LoadU(f, pixel + 3)));
            if (rest > 2) row = hn::Add(row, hn::Mul(hn::Broadcast<2>(weights[g]), hn::LoadU(f, pixel + 6)));
        }
        whole = hn::Add(whole, hn::Mul(hn::Set(f, down), row));
    }
    color = hn::Mul(whole, hn::Set(f, 1 / (total_x * total_y)));
    return true;
}

void colors(const Surface& s, const float* source_px, size_t n, Plan& plan, float* rgb) {
    const F4 f;
    for (size_t i = 0; i < n; ++i) {
        V4 color = hn::Zero(f);
        if (plan.kind[i] == plain) {
            const float *upper = s.rgb + 3 * size_t(plan.at[i]), *lower = upper + 3 * size_t(s.width);
            const V4 fx = hn::Set(f, plan.fx[i]), fy = hn::Set(f, plan.fy[i]);
            const auto between = [&](const float* pixel) {
                const V4 left = hn::LoadU(f, pixel);
                return hn::Add(left, hn::Mul(fx, hn::Sub(hn::LoadU(f, pixel + 3), left)));
            };
            const V4 above = between(upper);
            color = hn::Add(above, hn::Mul(fy, hn::Sub(between(lower), above)));
        } else if (plan.kind[i] == tent && !tent_color(s, source_px + 2 * i, plan.across[i], plan.down[i], color)) {
            plan.kind[i] = other;
        }
        hn::StoreU(color, f, rgb + 3 * i);  // the fourth lane is the next pixel's, or the padding
    }
}

#endif  // vectors of four

const Kernels table = {&plan, &colors};
const Kernels* get() {
    return &table;
}

}  // namespace HWY_NAMESPACE
}  // namespace vshift::sampling
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace vshift::sampling {

HWY_EXPORT(get);

const Kernels& kernels() {
    static const Kernels* const chosen = HWY_DYNAMIC_DISPATCH(get)();
    return *chosen;
}

}  // namespace vshift::sampling
#endif
