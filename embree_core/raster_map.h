// SPDX-License-Identifier: Apache-2.0
// Role: inside the rasteriser: the map from (u, v, 1/z) of R to V's pixels in floats, and what a box can reach.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

#include "embree_core/raster_kernels.h"
#include "embree_core/reproject.h"

namespace vshift::raster {

// Z' = Z / z below this is behind V or too near to its plane.
inline constexpr float nearest_share = 1e-5f;

struct Corner {
    float x, y;  ///< pixel of V, centres at whole numbers
    float q;     ///< 1/Z
    float r;     ///< 1/Z'; negative: behind V
    float u, v;  ///< pixel of R, centres at whole numbers
};

/// std::ceil of what an int holds, without a call.
inline int ceiling(float value) {
    const int whole = int(value);
    return whole + (float(whole) < value);
}

/// std::floor likewise.
inline int floored(float value) {
    const int whole = int(value);
    return whole - (float(whole) > value);
}

constexpr float reach_slack_px = 0.01f;  // walls' reach, rounding

struct Range {
    int x0 = 0, x1 = 0, y0 = 0, y1 = 0;  ///< half open
    bool empty() const { return x0 >= x1 || y0 >= y1; }
};

/// The pixel map with centres at whole numbers on both sides, as floats.
struct FloatMap : raster::Map {
    explicit FloatMap(const ProjectiveMap& m) {
        const auto row = [&](int i, double centre, float* out) {
            const auto value = [&](const glm::dvec3& column) { return column[i] - centre * column[2]; };
            out[0] = float(value(m.turn[0]));
            out[1] = float(value(m.turn[1]));
            out[2] = float(value(m.turn[2]) + 0.5 * (value(m.turn[0]) + value(m.turn[1])));
            out[3] = float(value(m.move));
        };
        row(0, 0.5, x);
        row(1, 0.5, y);
        row(2, 0, z);
    }
    /// In the same steps as the kernels: shared corners are the same to the bit.
    glm::vec3 at(float u, float v, float w) const {
        const auto dot = [&](const float* m) { return m[0] * u + ((m[1] * v + m[2]) + m[3] * w); };
        return {dot(x), dot(y), dot(z)};
    }
    Corner corner(float u, float v, float w) const {
        const glm::vec3 h = at(u, v, w);
        const float r = h.z > nearest_share ? 1 / h.z : -1.0f;
        return {h.x * r, h.y * r, w * r, r, u, v};
    }
};

/// Four corners at once, each as `FloatMap::corner` gives it.
class Corners {
public:
    using Four = float __attribute__((vector_size(16)));
    Corners(const FloatMap& m, Four u, Four v, Four w) {
        const auto dot = [&](const float* row) { return row[0] * u + ((row[1] * v + row[2]) + row[3] * w); };
        const Four hz = dot(m.z), behind = {-1, -1, -1, -1}, share = hz > nearest_share ? 1 / hz : behind;
        const Four of[6] = {dot(m.x) * share, dot(m.y) * share, w * share, share, u, v};
        static_assert(sizeof of == sizeof values_);
        std::memcpy(values_, of, sizeof of);
    }
    Corner operator[](int i) const {
        return {values_[0][i], values_[1][i], values_[2][i], values_[3][i], values_[4][i], values_[5][i]};
    }

private:
    alignas(16) float values_[6][4];
};

/// Bounds of 1/z.
struct Bounds {
    float low = std::numeric_limits<float>::infinity(), high = 0;
};

/// Cells of R that are drawn together.
struct Tile {
    int x = 0, y = 0;
    Bounds w;
    Range reach;          ///< pixels of V that it can touch
    float highest_q = 0;  ///< in V
};

/// `reach_of` where corners lie behind V: the part in front, cut off where the kernels do.
Range reach_in_front(const FloatMap& map, float u0, float u1, float v0, float v1, Bounds w, int width, int height,
                     float* highest_q);

/// What a box of R can reach in V: the map is fractional linear, so its bounds over a box of (u, v, w) are at the
/// corners. `highest_q`: bound of 1/Z there.
inline Range reach_of(const FloatMap& map, float u0, float u1, float v0, float v1, Bounds w, int width, int height,
                      float* highest_q = nullptr) {
    float left = std::numeric_limits<float>::infinity(), right = -left, top = left, bottom = -left;
    float highest = 0;
    int behind = 0;
    for (int i = 0; i < 8; ++i) {
        const glm::vec3 h = map.at(i & 1 ? u1 : u0, i & 2 ? v1 : v0, i & 4 ? w.high : w.low);
        if (!(h.z > nearest_share)) {
            ++behind;
            continue;
        }
        left = std::min(left, h.x / h.z), right = std::max(right, h.x / h.z);
        top = std::min(top, h.y / h.z), bottom = std::max(bottom, h.y / h.z);
        highest = std::max(highest, (i & 4 ? w.high : w.low) / h.z);
    }
    if (behind == 8) return {};
    if (behind) return reach_in_front(map, u0, u1, v0, v1, w, width, height, highest_q);
    if (highest_q) *highest_q = highest * (1 + 1e-4f);
    const auto whole = [](float value, int limit) { return int(std::clamp(value, 0.0f, float(limit))); };
    return {whole(std::ceil(left - reach_slack_px), width), whole(std::floor(right + reach_slack_px) + 1, width),
            whole(std::ceil(top - reach_slack_px), height), whole(std::floor(bottom + reach_slack_px) + 1, height)};
}

}  // namespace vshift::raster
