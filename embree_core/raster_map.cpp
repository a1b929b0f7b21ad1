// SPDX-License-Identifier: Apache-2.0
#include "embree_core/raster_map.h"

namespace vshift::raster {

Range reach_in_front(const FloatMap& map, float u0, float u1, float v0, float v1, Bounds w, int width, int height,
                     float* highest_q) {
    // Where the kernels' floats may land: numerators and denominators off by so much. The plane that cuts lies where a
    // denominator may still come out as in front.
    constexpr double rounding = 5e-7;
    const auto error = [&](const float* m) {
        const double u = std::max(std::fabs(double(u0)), std::fabs(double(u1))),
                     v = std::max(std::fabs(double(v0)), std::fabs(double(v1)));
        return rounding * (std::fabs(double(m[0])) * u + std::fabs(double(m[1])) * v + std::fabs(double(m[2])) +
                           std::fabs(double(m[3])) * double(w.high));
    };
    const glm::dvec3 off(error(map.x), error(map.y), error(map.z));
    const double nearest = double(nearest_share) - off.z;
    if (highest_q) *highest_q = std::numeric_limits<float>::infinity();
    if (!(off.z < 0.25 * double(nearest_share))) return {0, width, 0, height};

    struct Vertex {
        glm::dvec3 h;
        double w;
    };
    Vertex corners[8];
    for (int i = 0; i < 8; ++i) {
        const double u = double(i & 1 ? u1 : u0), v = double(i & 2 ? v1 : v0), at = double(i & 4 ? w.high : w.low);
        const auto dot = [&](const float* m) {
            return double(m[0]) * u + double(m[1]) * v + double(m[2]) + double(m[3]) * at;
        };
        corners[i] = {{dot(map.x), dot(map.y), dot(map.z)}, at};
    }
    double left = std::numeric_limits<double>::infinity(), right = -left, top = left, bottom = -left, highest = 0;
    const auto take = [&](const Vertex& vertex) {
        for (const double z : {vertex.h.z - off.z, vertex.h.z + off.z}) {
            left = std::min(left, (vertex.h.x - off.x) / z), right = std::max(right, (vertex.h.x + off.x) / z);
            top = std::min(top, (vertex.h.y - off.y) / z), bottom = std::max(bottom, (vertex.h.y + off.y) / z);
            highest = std::max(highest, vertex.w / z);
        }
    };
    for (int i = 0; i < 8; ++i) {
        const Vertex& a = corners[i];
        if (a.h.z >= nearest) take(a);
        for (int bit = 1; bit < 8; bit *= 2) {  // each edge from its lower corner
            if (i & bit) continue;
            const Vertex& b = corners[i | bit];
            if ((a.h.z >= nearest) == (b.h.z >= nearest)) continue;
            const double t = (nearest - a.h.z) / (b.h.z - a.h.z);
            take({{a.h.x + t * (b.h.x - a.h.x), a.h.y + t * (b.h.y - a.h.y), nearest}, a.w + t * (b.w - a.w)});
        }
    }
    if (!(left <= right)) return {};
    if (highest_q) *highest_q = float(highest * (1 + 1e-4));
    const auto whole = [](double value, int limit) { return int(std::clamp(value, 0.0, double(limit))); };
    const double slack = double(reach_slack_px);
    return {whole(std::ceil(left - slack), width), whole(std::floor(right + slack) + 1, width),
            whole(std::ceil(top - slack), height), whole(std::floor(bottom + slack) + 1, height)};
}

}  // namespace vshift::raster
