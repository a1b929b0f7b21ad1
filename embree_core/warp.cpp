// SPDX-License-Identifier: Apache-2.0
#include "embree_core/warp.h"

#include <tbb/parallel_for.h>

#include <cmath>

namespace vshift {
namespace {

// Within this of a pixel's centre the pixel itself is meant: rounding leaves no trace in an image that does not move.
constexpr float snap_px = 1.0f / 1024;
// V's pixel on the recorded image: up to the first width plain bilinear, never wider than the second.
constexpr float plain_width_px = 1.1f, widest_px = 8;

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

glm::vec3 Sampler::at(glm::vec2 source_px, glm::vec2 shifted_px) const {
    return at(place(source_px), source_px, shifted_px);
}

bool Sampler::sample(glm::vec2 source_px, glm::vec2 shifted_px, EdgeBand edge, glm::vec3& color) const {
    const Place there = place(source_px);
    if (edge == EdgeBand::drop && is_edge(there)) return false;
    color = at(there, source_px, shifted_px);
    return true;
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

inline glm::vec3 Sampler::at(const Place& at, glm::vec2 source_px, glm::vec2 shifted_px) const {
    const int width = image_.width;
    const int x0 = at.dx < 0 ? at.px - 1 : at.px, y0 = at.dy < 0 ? at.py - 1 : at.py;
    const size_t index = size_t(at.py) * size_t(width) + size_t(at.px);
    const float* w = &field_.w.data[index];
    const float own = *w;
    const bool whole = x0 >= 0 && y0 >= 0 && x0 + 1 < width && y0 + 1 < image_.height && field_.whole(x0, y0);
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
        const float across = scale * (std::fabs(yv) + std::fabs(xv)), down = scale * (std::fabs(yu) + std::fabs(xu));
        if (std::max(across, down) > plain_width_px * area) return wide(at, glm::vec2(across, down) / area);
    }
    if (!whole) return torn(at);
    const float fx = at.dx < 0 ? at.dx + 1 : at.dx, fy = at.dy < 0 ? at.dy + 1 : at.dy;
    const glm::vec3* row = &image_.data[size_t(y0) * size_t(width) + size_t(x0)];
    const glm::vec3 upper = row[0] + fx * (row[1] - row[0]);
    const glm::vec3 lower = row[width] + fx * (row[width + 1] - row[width]);
    return upper + fy * (lower - upper);
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
            const float weight = (i ? std::fabs(at.dx) : 1 - std::fabs(at.dx)) *
                                 (j ? std::fabs(at.dy) : 1 - std::fabs(at.dy));
            if (!(weight > 0)) continue;
            if (i && !joined(x, at.py, at.px, at.py)) continue;
            if (j && !joined(at.px, y, at.px, at.py)) continue;
            if (i && j && (!joined(x, y, at.px, y) || !joined(x, y, x, at.py))) continue;
            sum += weight * image_.at(x, y);
            weights += weight;
        }
    return sum / weights;
}

/// A tent of half width max(1, reach) over what hangs together with the place's pixel: up and down its column, then to
/// both sides, as far as no tear parts them.
glm::vec3 Sampler::wide(const Place& at, glm::vec2 reach) const {
    const int px = at.px, py = at.py;
    const glm::vec2 g(float(px) + at.dx, float(py) + at.dy);
    const glm::vec2 half(std::clamp(reach.x, 1.0f, widest_px), std::clamp(reach.y, 1.0f, widest_px));
    glm::vec3 sum(0);
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

namespace {

/// `source(i)` gives the sampler of pixel i, or null.
template <class Source>
void warp_from(int width, int height, const Grid<glm::vec2>& source_px, EdgeBand edge, const Source& source,
               ColorImage& color, Mask& missing) {
    if (color.width != width || color.height != height) color = ColorImage(width, height);
    if (missing.width != width || missing.height != height) missing = Mask(width, height);
    tbb::parallel_for(0, height, [&](int y) {
        const size_t first = size_t(y) * size_t(width);
        for (int x = 0; x < width; ++x) {
            const size_t at = first + size_t(x);
            const Sampler* sampler = source(at);
            glm::vec3 found(0);
            const bool sampled =
                sampler &&
                sampler->sample(source_px.data[at], glm::vec2(float(x) + 0.5f, float(y) + 0.5f), edge, found);
            color.data[at] = found;
            missing.data[at] = !sampled;
        }
    });
}

}  // namespace

void warp(const Reprojection& shown, const Sampler& sampler, EdgeBand edge, ColorImage& color, Mask& missing) {
    warp_from(
        shown.sight.width, shown.sight.height, shown.source_px, edge,
        [&](size_t at) { return is_seen(shown.sight.data[at]) ? &sampler : nullptr; }, color, missing);
}

Warped warp(const Reprojection& shown, const Sampler& sampler, EdgeBand edge) {
    Warped out;
    warp(shown, sampler, edge, out.color, out.missing);
    return out;
}

Warped warp(const ShiftedHoles& seen, const std::vector<Sampler>& samplers, EdgeBand edge) {
    Warped out;
    warp_from(
        seen.hole.width, seen.hole.height, seen.source_px, edge,
        [&](size_t at) { return seen.source.data[at] >= 0 ? &samplers.at(size_t(seen.source.data[at])) : nullptr; },
        out.color, out.missing);
    return out;
}

}  // namespace vshift
