// SPDX-License-Identifier: Apache-2.0
#include "embree_core/warp.h"

#include <tbb/parallel_for.h>

#include <cmath>
#include <cstring>

#include "embree_core/warp_kernels.h"

namespace vshift {
namespace {

using sampling::plain_width_px, sampling::snap_px, sampling::widest_px;

/// A pixel and the first channel of the next one, as a vector: not of an image's last pixel.
inline glm::vec4 four(const glm::vec3* pixel) {
    glm::vec4 out;
    std::memcpy(&out, pixel, sizeof out);
    return out;
}

}  // namespace

Sampler::Sampler(const SurfaceField& field, const ColorImage& image, const ProjectiveMap& m)
    : field_(field), image_(image) {
    const auto row = [&](int i, float* out) {
        out[0] = float(m.turn[0][i]), out[1] = float(m.turn[1][i]), out[2] = float(m.turn[2][i]);
        out[3] = float(m.move[i]);
    };
    row(0, x_), row(1, y_), row(2, z_);
}

inline Sampler::Place Sampler::place(glm::vec2 source_px) const {
    const auto along = [](float position, int size, int& pixel, float& offset) {
        pixel = int(std::clamp(position, 0.0f, float(size) - 0.5f));
        offset = position - (float(pixel) + 0.5f);
        if (std::fabs(offset) < snap_px) offset = 0;
    };
    Place at;
    along(source_px.x, image_.width, at.px, at.dx);
    along(source_px.y, image_.height, at.py, at.dy);
    return at;
}

bool Sampler::is_edge(glm::vec2 source_px) const {
    return is_edge(place(source_px));
}

inline bool Sampler::is_edge(const Place& at) const {
    const size_t index = size_t(at.py) * size_t(image_.width) + size_t(at.px);
    const uint8_t* tears = &field_.tears.data[index];
    if (!(tears[0] | (at.px > 0 ? tears[-1] & 1 : 0) | (at.py > 0 ? tears[-long(image_.width)] & 2 : 0))) return false;
    const float own = field_.w.data[index];
    const auto mixed = [&](int x, int y) {
        if (field_.state(x, y) != Pixel::solid || field_.w.at(x, y) <= own) return false;
        return field_.state(at.px, at.py) == Pixel::sky || !field_.joined(at.px, at.py, x, y);
    };
    return (at.dx != 0 && mixed(at.px + (at.dx > 0 ? 1 : -1), at.py)) ||
           (at.dy != 0 && mixed(at.px, at.py + (at.dy > 0 ? 1 : -1)));
}

[[gnu::always_inline]] inline glm::vec3 Sampler::at(const Place& at, glm::vec2 source_px, glm::vec2 shifted_px) const {
    const int width = image_.width;
    const int x0 = at.dx < 0 ? at.px - 1 : at.px, y0 = at.dy < 0 ? at.py - 1 : at.py;
    const size_t index = size_t(at.py) * size_t(width) + size_t(at.px);
    const float* w = &field_.w.data[index];
    const float own = *w;
    const bool whole = x0 >= 0 && y0 >= 0 && x0 + 1 < width && y0 + 1 < image_.height &&
                       (x0 + 2 < width || y0 + 2 < image_.height) && field_.whole(x0, y0);
    // How far V's pixel reaches on R: the inverse of d(V)/d(R) on the surface.
    if (own > 0) {
        float wx = 0, wy = 0;
        if (whole) {
            wx = at.dx < 0 ? own - w[-1] : w[1] - own;
            wy = at.dy < 0 ? own - w[-long(width)] : w[width] - own;
        } else {
            const int px = at.px, py = at.py;
            if (field_.joined(px, py, px + 1, py))
                wx = w[1] - own;
            else if (field_.joined(px, py, px - 1, py))
                wx = own - w[-1];
            if (field_.joined(px, py, px, py + 1))
                wy = w[width] - own;
            else if (field_.joined(px, py, px, py - 1))
                wy = own - w[-long(width)];
        }
        const float hz = z_[0] * source_px.x + (z_[1] * source_px.y + (z_[2] + z_[3] * own));
        const float zu = z_[0] + z_[3] * wx, zv = z_[1] + z_[3] * wy;
        const float xu = x_[0] + x_[3] * wx - shifted_px.x * zu, xv = x_[1] + x_[3] * wy - shifted_px.x * zv;
        const float yu = y_[0] + y_[3] * wx - shifted_px.y * zu, yv = y_[1] + y_[3] * wy - shifted_px.y * zv;
        const float area = std::fabs(xu * yv - xv * yu), scale = std::fabs(hz);
        float across = scale * (std::fabs(yv) + std::fabs(xv)), down = scale * (std::fabs(yu) + std::fabs(xu));
        if (std::max(across, down) > plain_width_px * area) {
            // Not a shear, which samples as densely as before: V's steps on R (times area / scale), the longer one less
            // the nearest multiple of the shorter.
            glm::vec2 a(yv, -yu), b(-xv, xu);
            const float aa = a.x * a.x + a.y * a.y, bb = b.x * b.x + b.y * b.y, ab = a.x * b.x + a.y * b.y;
            const float times = std::nearbyint(ab / std::min(aa, bb));
            (aa < bb ? b : a) -= times * (aa < bb ? a : b);
            across = scale * (std::fabs(a.x) + std::fabs(b.x)), down = scale * (std::fabs(a.y) + std::fabs(b.y));
            if (std::max(across, down) > plain_width_px * area) return wide(at, glm::vec2(across, down) / area);
        }
    }
    if (!whole) return torn(at);
    const float fx = at.dx < 0 ? at.dx + 1 : at.dx, fy = at.dy < 0 ? at.dy + 1 : at.dy;
    const glm::vec3* row = &image_.data[size_t(y0) * size_t(width) + size_t(x0)];
    const glm::vec4 upper = four(row) + fx * (four(row + 1) - four(row));
    const glm::vec4 lower = four(row + width) + fx * (four(row + width + 1) - four(row + width));
    return glm::vec3(upper + fy * (lower - upper));
}

glm::vec3 Sampler::at(glm::vec2 source_px, glm::vec2 shifted_px) const {
    return at(place(source_px), source_px, shifted_px);
}

inline bool Sampler::sample(glm::vec2 source_px, glm::vec2 shifted_px, EdgeBand edge, glm::vec3& color) const {
    const Place there = place(source_px);
    if (edge == EdgeBand::drop && is_edge(there)) return false;
    color = at(there, source_px, shifted_px);
    return true;
}

/// Bilinear among the four pixels round the place, as far as they hang together with its own.
glm::vec3 Sampler::torn(const Place& at) const {
    const auto joined = [&](int xa, int ya, int xb, int yb) {
        const uint8_t bit = ya == yb ? 1 : 2;
        return !(field_.tears.at(std::min(xa, xb), std::min(ya, yb)) & bit) &&
               (field_.w.at(xa, ya) >= 0) == (field_.w.at(xb, yb) >= 0);
    };
    glm::vec3 sum(0);
    float weights = 0;
    for (int j = 0; j < 2; ++j)
        for (int i = 0; i < 2; ++i) {
            const int x = at.px + (i ? (at.dx < 0 ? -1 : 1) : 0), y = at.py + (j ? (at.dy < 0 ? -1 : 1) : 0);
            if (x < 0 || y < 0 || x >= image_.width || y >= image_.height) continue;
            const float weight =
                (i ? std::fabs(at.dx) : 1 - std::fabs(at.dx)) * (j ? std::fabs(at.dy) : 1 - std::fabs(at.dy));
            if (!(weight > 0)) continue;
            if (i && !joined(x, at.py, at.px, at.py)) continue;
            if (j && !joined(at.px, y, at.px, at.py)) continue;
            if (i && j && (!joined(x, y, at.px, y) || !joined(x, y, x, at.py))) continue;
            sum += weight * image_.at(x, y);
            weights += weight;
        }
    return sum / weights;
}

/// Whether all pixels of a box lie in the image, before its last pixel, and on one surface, without a tear.
inline bool Sampler::is_one_surface(int x0, int x1, int y0, int y1) const {
    if (x1 >= image_.width || y1 >= image_.height || (x1 + 1 == image_.width && y1 + 1 == image_.height)) return false;
    bool one = true;
    for (int y = y0; y <= y1; ++y) {
        const size_t row = size_t(y) * size_t(image_.width);
        for (int x = x0; x <= x1; ++x)
            one &= !field_.tears.data[row + size_t(x)] & (field_.w.data[row + size_t(x)] > 0);
    }
    return one;
}

/// A tent of half width max(1, reach) over what hangs together with the place's pixel: up and down its column, then to
/// both sides, as far as no tear parts them.
glm::vec3 Sampler::wide(const Place& at, glm::vec2 reach) const {
    const int px = at.px, py = at.py;
    const glm::vec2 g(float(px) + at.dx, float(py) + at.dy);
    const glm::vec2 half(std::clamp(reach.x, 1.0f, widest_px), std::clamp(reach.y, 1.0f, widest_px));
    glm::vec3 sum(0);
    // Most often nothing is torn as far as it reaches (px and py are not negative, so truncation is floor).
    const int x0 = int(std::max(g.x - half.x + 1, 0.0f)), x1 = int(g.x + half.x);
    const int y0 = int(std::max(g.y - half.y + 1, 0.0f)), y1 = int(g.y + half.y);
    if (is_one_surface(x0, x1, y0, y1)) {
        constexpr int most = 2 * int(widest_px) + 2;
        glm::vec4 whole(0);
        float across[most];
        float total_x = 0, total_y = 0;
        const float step_x = 1 / half.x, step_y = 1 / half.y;
        for (int x = x0; x <= x1; ++x) {
            across[x - x0] = std::max(1 - std::fabs(float(x) - g.x) * step_x, 0.0f);
            total_x += across[x - x0];
        }
        for (int y = y0; y <= y1; ++y) {
            const float down = std::max(1 - std::fabs(float(y) - g.y) * step_y, 0.0f);
            total_y += down;
            const glm::vec3* pixel = &image_.data[size_t(y) * size_t(image_.width) + size_t(x0)];
            glm::vec4 row(0);
            for (int i = 0; i <= x1 - x0; ++i) row += across[i] * four(pixel + i);
            whole += down * row;
        }
        return glm::vec3(whole * (1 / (total_x * total_y)));
    }
    float weights = 0;
    const auto row = [&](int y) {
        const float wy = 1 - std::fabs(float(y) - g.y) / half.y;
        if (!(wy > 0)) return false;
        glm::vec3 row_sum(0);
        float row_weights = 0;
        const auto take = [&](int x) {
            const float wx = 1 - std::fabs(float(x) - g.x) / half.x;
            if (!(wx > 0)) return false;
            row_sum += wx * image_.at(x, y);
            row_weights += wx;
            return true;
        };
        take(px);
        for (int x = px; field_.joined(x, y, x + 1, y) && take(x + 1); ++x) continue;
        for (int x = px; field_.joined(x, y, x - 1, y) && take(x - 1); --x) continue;
        sum += wy * row_sum;
        weights += wy * row_weights;
        return true;
    };
    row(py);
    for (int y = py; field_.joined(px, y, px, y + 1) && row(y + 1); ++y) continue;
    for (int y = py; field_.joined(px, y, px, y - 1) && row(y - 1); --y) continue;
    return weights > 0 ? sum / weights : image_.at(px, py);
}

void Sampler::run(const glm::vec2* source_px, glm::vec2 shifted_px, size_t n, const Sight* sight, EdgeBand edge,
                  glm::vec3* color, uint8_t* missing) const {
    static_assert(sizeof(glm::vec3) == 3 * sizeof(float) && sizeof(glm::vec2) == 2 * sizeof(float));
    const sampling::Surface surface{
        field_.w.data.data(), field_.tears.data.data(), &image_.data[0].x, image_.width, image_.height, x_, y_, z_};
    sampling::Plan plan;
    glm::vec2 padded[sampling::most_pixels + sampling::padding];
    float rgb[3 * sampling::most_pixels + 1];
    for (size_t first = 0; first < n; first += sampling::most_pixels) {
        const size_t count = std::min(n - first, sampling::most_pixels);
        const glm::vec2* from = source_px + first;
        const glm::vec2 at_px(shifted_px.x + float(first), shifted_px.y);
        if (count < sampling::most_pixels) {
            std::fill(std::copy_n(from, count, padded), std::end(padded), glm::vec2(0));
            from = padded;
        }
        sampling::kernels().plan(surface, &from[0].x, at_px.x, at_px.y, count, plan);
        for (size_t i = 0; i < count; ++i) plan.kind[i] = is_seen(sight[first + i]) ? plan.kind[i] : sampling::other;
        // One number more than their own is written: the next pixel's, whose turn comes, or none of ours.
        const bool last = first + count == n;
        sampling::kernels().colors(surface, &from[0].x, count, plan, last ? rgb : &color[first].x);
        if (last) std::memcpy(color + first, rgb, count * sizeof(glm::vec3));
        for (size_t i = 0; i < count; ++i) {
            bool none = false;
            if (plan.kind[i] == sampling::other)
                none = !is_seen(sight[first + i]) ||
                       !sample(from[i], {at_px.x + float(i), at_px.y}, edge, color[first + i]);
            missing[first + i] = none;
        }
    }
}

namespace {

void fit(int width, int height, ColorImage& color, Mask& missing) {
    if (color.width != width || color.height != height) color = ColorImage(width, height);
    if (missing.width != width || missing.height != height) missing = Mask(width, height);
}

}  // namespace

void warp_row(const Reprojection& shown, const Sampler& sampler, EdgeBand edge, int y, ColorImage& color,
              Mask& missing) {
    const size_t width = size_t(shown.sight.width), first = size_t(y) * width;
    sampler.run(&shown.source_px.data[first], {0.5f, float(y) + 0.5f}, width, &shown.sight.data[first], edge,
                &color.data[first], &missing.data[first]);
}

void warp(const Reprojection& shown, const Sampler& sampler, EdgeBand edge, ColorImage& color, Mask& missing) {
    fit(shown.sight.width, shown.sight.height, color, missing);
    tbb::parallel_for(0, shown.sight.height, [&](int y) { warp_row(shown, sampler, edge, y, color, missing); });
}

Warped warp(const Reprojection& shown, const Sampler& sampler, EdgeBand edge) {
    Warped out;
    warp(shown, sampler, edge, out.color, out.missing);
    return out;
}

Warped warp(const ShiftedHoles& seen, const std::vector<Sampler>& samplers, EdgeBand edge) {
    Warped out;
    fit(seen.hole.width, seen.hole.height, out.color, out.missing);
    tbb::parallel_for(0, seen.hole.height, [&](int y) {
        for (int x = 0; x < seen.hole.width; ++x) {
            const size_t at = size_t(y) * size_t(seen.hole.width) + size_t(x);
            const int source = seen.source.data[at];
            out.missing.data[at] =
                source < 0 || !samplers.at(size_t(source))
                                   .sample(seen.source_px.data[at], {x + 0.5f, y + 0.5f}, edge, out.color.data[at]);
        }
    });
    return out;
}

}  // namespace vshift
