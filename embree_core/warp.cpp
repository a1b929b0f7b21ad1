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

float snapped(float g) {
    const float whole = std::floor(g + 0.5f);
    return std::fabs(g - whole) < snap_px ? whole : g;
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

bool Sampler::is_edge(glm::vec2 source_px) const {
    const float gx = source_px.x - 0.5f, gy = source_px.y - 0.5f;
    const int px = std::clamp(int(std::floor(source_px.x)), 0, image_.width - 1),
              py = std::clamp(int(std::floor(source_px.y)), 0, image_.height - 1);
    const float dx = gx - float(px), dy = gy - float(py);
    const float own = field_.w.at(px, py);
    const auto mixed = [&](int x, int y) {
        if (field_.state(x, y) != Pixel::solid || field_.w.at(x, y) <= own) return false;
        return field_.state(px, py) == Pixel::sky || !field_.joined(px, py, x, y);
    };
    return (std::fabs(dx) > snap_px && mixed(px + (dx > 0 ? 1 : -1), py)) ||
           (std::fabs(dy) > snap_px && mixed(px, py + (dy > 0 ? 1 : -1)));
}

glm::vec3 Sampler::at(glm::vec2 source_px) const {
    const glm::vec2 g(snapped(source_px.x - 0.5f), snapped(source_px.y - 0.5f));
    const int width = image_.width, height = image_.height;
    const int x0 = int(std::floor(g.x)), y0 = int(std::floor(g.y));
    const float fx = g.x - float(x0), fy = g.y - float(y0);
    // The pixel that the point belongs to.
    const int px = std::clamp(x0 + (fx < 0.5f ? 0 : 1), 0, width - 1),
              py = std::clamp(y0 + (fy < 0.5f ? 0 : 1), 0, height - 1);
    const float own = field_.w.at(px, py);
    const auto joined = [&](int xa, int ya, int xb, int yb) {
        const uint8_t bit = ya == yb ? 1 : 2;
        return !(field_.tears.at(std::min(xa, xb), std::min(ya, yb)) & bit) &&
               (field_.w.at(xa, ya) >= 0) == (field_.w.at(xb, yb) >= 0);
    };
    const bool inner = x0 >= 0 && y0 >= 0 && x0 + 1 < width && y0 + 1 < height;
    const bool whole = inner && field_.whole(x0, y0);
    // How far V's pixel reaches on R: the inverse of d(V)/d(R) on the surface.
    if (own > 0) {
        float wx = 0, wy = 0;
        if (whole) {
            wx = field_.w.at(x0 + 1, py) - field_.w.at(x0, py);
            wy = field_.w.at(px, y0 + 1) - field_.w.at(px, y0);
        } else {
            if (field_.joined(px, py, px + 1, py))
                wx = field_.w.at(px + 1, py) - own;
            else if (field_.joined(px, py, px - 1, py))
                wx = own - field_.w.at(px - 1, py);
            if (field_.joined(px, py, px, py + 1))
                wy = field_.w.at(px, py + 1) - own;
            else if (field_.joined(px, py, px, py - 1))
                wy = own - field_.w.at(px, py - 1);
        }
        const float u = source_px.x, v = source_px.y;
        const auto dot = [&](const float* m) { return m[0] * u + (m[1] * v + (m[2] + m[3] * own)); };
        const float hz = dot(z_), r = 1 / hz, X = dot(x_) * r, Y = dot(y_) * r;
        const float zu = z_[0] + z_[3] * wx, zv = z_[1] + z_[3] * wy;
        const float xu = x_[0] + x_[3] * wx - X * zu, xv = x_[1] + x_[3] * wy - X * zv;
        const float yu = y_[0] + y_[3] * wx - Y * zu, yv = y_[1] + y_[3] * wy - Y * zv;
        const float scale = std::fabs(hz / (xu * yv - xv * yu));
        const glm::vec2 reach(scale * (std::fabs(yv) + std::fabs(xv)), scale * (std::fabs(yu) + std::fabs(xu)));
        if (reach.x > plain_width_px || reach.y > plain_width_px) return wide(px, py, g, reach);
    }
    if (whole) {
        const glm::vec3* row = &image_.data[size_t(y0) * size_t(width) + size_t(x0)];
        const glm::vec3 upper = row[0] + fx * (row[1] - row[0]);
        const glm::vec3 lower = row[width] + fx * (row[width + 1] - row[width]);
        return upper + fy * (lower - upper);
    }
    glm::vec3 sum(0);
    float weights = 0;
    for (int j = 0; j < 2; ++j)
        for (int i = 0; i < 2; ++i) {
            const int x = x0 + i, y = y0 + j;
            if (x < 0 || y < 0 || x >= width || y >= height) continue;
            const float weight = (i ? fx : 1 - fx) * (j ? fy : 1 - fy);
            if (!(weight > 0)) continue;
            if (x != px && !joined(x, py, px, py)) continue;
            if (y != py && !joined(px, y, px, py)) continue;
            if (x != px && y != py && (!joined(x, y, px, y) || !joined(x, y, x, py))) continue;
            sum += weight * image_.at(x, y);
            weights += weight;
        }
    return weights > 0 ? sum / weights : image_.at(px, py);
}

/// A tent of half width max(1, reach) over what hangs together with pixel (px, py): up and down its column, then to
/// both sides, as far as no tear parts them.
glm::vec3 Sampler::wide(int px, int py, glm::vec2 g, glm::vec2 reach) const {
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
Warped warp_from(int width, int height, const Grid<glm::vec2>& source_px, EdgeBand edge, const Source& source) {
    Warped out{ColorImage(width, height, glm::vec3(0)), Mask(width, height, 1)};
    tbb::parallel_for(0, height, [&](int y) {
        for (int x = 0; x < width; ++x) {
            const size_t at = size_t(y) * size_t(width) + size_t(x);
            const Sampler* sampler = source(at);
            if (!sampler || (edge == EdgeBand::drop && sampler->is_edge(source_px.data[at]))) continue;
            out.color.data[at] = sampler->at(source_px.data[at]);
            out.missing.data[at] = 0;
        }
    });
    return out;
}

}  // namespace

Warped warp(const Reprojection& shown, const Sampler& sampler, EdgeBand edge) {
    return warp_from(shown.sight.width, shown.sight.height, shown.source_px, edge,
                     [&](size_t at) { return is_seen(shown.sight.data[at]) ? &sampler : nullptr; });
}

Warped warp(const ShiftedHoles& seen, const std::vector<Sampler>& samplers, EdgeBand edge) {
    return warp_from(seen.hole.width, seen.hole.height, seen.source_px, edge, [&](size_t at) {
        return seen.source.data[at] >= 0 ? &samplers.at(size_t(seen.source.data[at])) : nullptr;
    });
}

}  // namespace vshift
