// SPDX-License-Identifier: Apache-2.0
// Colour of the analytic street: a function of the surface point alone.
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "scenes/analytic/analytic_street.h"
#include "scenes/analytic/street_mesh.h"

namespace vshift::analytic {
namespace {

using glm::dvec3;
using glm::vec3;

const vec3 to_sun = glm::normalize(vec3(-0.45f, 0.50f, 0.80f));

double cell_value(int64_t x, int64_t y, int64_t z) {
    uint64_t h =
        uint64_t(x) * 0x9E3779B97F4A7C15ull ^ uint64_t(y) * 0xC2B2AE3D27D4EB4Full ^ uint64_t(z) * 0x165667B19E3779F9ull;
    h = (h ^ (h >> 29)) * 0xBF58476D1CE4E5B9ull;
    return double((h ^ (h >> 32)) & 0xffffff) / double(0xffffff);
}

/// Smooth noise, -1 ... 1, with cells of 1.
double noise(const dvec3& p) {
    const dvec3 cell = glm::floor(p), f = p - cell, s = f * f * (3.0 - 2.0 * f);
    double sum = 0;
    for (int i = 0; i < 8; ++i) {
        const int64_t dx = i & 1, dy = (i >> 1) & 1, dz = i >> 2;
        sum += (dx ? s.x : 1 - s.x) * (dy ? s.y : 1 - s.y) * (dz ? s.z : 1 - s.z) *
               cell_value(int64_t(cell.x) + dx, int64_t(cell.y) + dy, int64_t(cell.z) + dz);
    }
    return 2 * sum - 1;
}

/// 1 within `half` of a multiple of `period`.
bool on_line(double v, double period, double half) {
    return std::abs(v - period * std::round(v / period)) < half;
}

vec3 ground_albedo(const dvec3& p, const vec3& base) {
    const double y = std::abs(p.y);
    if (p.z > kerb_z / 2 || y > kerb_y - 0.01) {
        if (y < kerb_y + 0.165) return on_line(p.x, 1.0, 0.008) ? base * 0.6f : base;
        const bool joint = on_line(p.x, 0.6, 0.008) || on_line(p.y, 0.6, 0.008);
        const double stone = cell_value(int64_t(std::floor(p.x / 0.6 + 0.5)), int64_t(std::floor(p.y / 0.6 + 0.5)), 7);
        return base * float((joint ? 0.65 : 1.0) * (0.9 + 0.2 * stone));
    }
    const vec3 paint(0.6f, 0.6f, 0.57f);
    if (std::abs(y - 5.25) < 0.06) return paint;
    if (std::abs(y - 1.75) < 0.06 && p.x - 9 * std::floor(p.x / 9) < 3) return paint;
    return base * float(1 + 0.18 * noise(dvec3(p.x * 0.4, p.y * 0.8, 0)) + 0.12 * noise(p * 23.0));
}

vec3 patterned(Kind kind, const dvec3& p, const vec3& base) {
    switch (kind) {
        case Kind::ground:
            return ground_albedo(p, base);
        case Kind::building:
            return base * float(1 + 0.07 * noise(p * 0.7) + 0.05 * noise(p * 6.0));
        case Kind::foliage:
            return base * float(1 + 0.45 * noise(p * 9.0) + 0.25 * noise(p * 31.0));
        case Kind::slat:
            return base * float(1 + 0.1 * noise(dvec3(p.x * 20, p.y * 20, p.z * 3)));
        default:
            return base * float(1 + 0.04 * noise(p * 5.0));
    }
}

vec3 sky_color(const dvec3& direction) {
    const double up = glm::clamp(glm::normalize(direction).z, 0.0, 1.0);
    return glm::mix(vec3(0.72f, 0.80f, 0.90f), vec3(0.24f, 0.42f, 0.75f), float(std::sqrt(up)));
}

vec3 lit(const StreetScene& street, const dvec3& point, const Hit& hit, const dvec3& direction) {
    vec3 n = glm::normalize(hit.normal);
    if (glm::dot(n, vec3(direction)) > 0) n = -n;
    const vec3 albedo = patterned(Kind(street.street.kind[hit.primitive]), point, street.street.albedo[hit.primitive]);
    float sun = std::max(0.0f, glm::dot(n, to_sun));
    const dvec3 o = point + dvec3(n) * 2e-3;
    if (sun > 0 && street.scene.traced.occluded(vec3(o), to_sun, 0, 1e4f)) sun = 0;
    const vec3 sky = vec3(0.36f, 0.42f, 0.52f) * (0.62f + 0.38f * n.z) + vec3(0.05f, 0.045f, 0.04f) * (1 - n.z);
    const float tone = 1 + 0.10f * n.x - 0.05f * n.y;  // tells faces in the shade apart
    return glm::clamp(albedo * (sun * vec3(1.45f, 1.35f, 1.15f) + tone * sky), 0.0f, 1.0f);
}

}  // namespace

glm::vec3 ray_color(const StreetScene& street, const dvec3& origin, const dvec3& direction) {
    const dvec3 o = origin - street.scene.origin_m;
    const Hit hit = street.scene.traced.intersect(vec3(o), vec3(direction), 0, std::numeric_limits<float>::infinity());
    return hit ? lit(street, o + double(hit.t) * direction, hit, direction) : sky_color(direction);
}

ColorImage street_color(const StreetScene& street, const TrueCamera& camera, int side) {
    const Intrinsics& k = camera.intrinsics;
    ColorImage out(k.width, k.height, vec3(0));
    tbb::parallel_for(0, k.height, [&](int y) {
        for (int x = 0; x < k.width; ++x) {
            vec3 sum(0);
            for (int s = 0; s < side * side; ++s) {
                const glm::dvec2 at(x + (s % side + 0.5) / side, y + (s / side + 0.5) / side);
                const dvec3 d = camera.world_from_cam.rotation * ray(k, at);
                sum += ray_color(street, camera.world_from_cam.translation_m, d);
            }
            out.at(x, y) = sum / float(side * side);
        }
    });
    return out;
}

}  // namespace vshift::analytic
