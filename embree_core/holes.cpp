// SPDX-License-Identifier: Apache-2.0
#include "embree_core/holes.h"

#include <tbb/parallel_for.h>

#include <cmath>
#include <limits>

namespace vshift {
namespace {

// A neighbour's surface replaces the own camera's only when it stands nearer by more than this share:
// two depth maps of one surface differ by their sampling.
constexpr double nearer_share = 0.02;

// A ray that meets a vertex to the bit can slip between its triangles, even in a robust scene. A ray
// that found nothing is cast again this far beside, in pixels of V; rays that hit stay exact.
constexpr double retry_px = 1.0 / 1024;

enum class Outcome { seen, behind_edge, not_covered };

/// What one recorded view says of one ray of V.
struct Look {
    Outcome outcome = Outcome::not_covered;
    float depth = std::numeric_limits<float>::infinity();  ///< planar z in V
    glm::vec2 source_px{0};
};

/// `origin`, `direction` in the view's frame; direction has z = 1 in V, so t is planar depth there.
Look look(const LiftedView& view, const glm::dvec3& origin, const glm::dvec3& direction) {
    Look result;
    const glm::vec3 o(origin), d(direction);
    const float endless = std::numeric_limits<float>::infinity();
    const Hit kept = view.kept.intersect(o, d, 0, endless);
    if (view.torn.passed(origin, direction, 0, kept ? double(kept.t) : std::numeric_limits<double>::infinity())) {
        result.outcome = Outcome::behind_edge;
        return result;
    }
    if (!kept) {
        // Nothing in the way: sky, if this view saw sky in that direction.
        const auto u = project(view.mesh.intrinsics, direction);
        if (u && surface_inverse_depth(view.mesh, *u) == 0) {
            result.outcome = Outcome::seen;
            result.source_px = glm::vec2(*u);
        }
        return result;
    }
    // Seen from the front when V and the recorded camera (the origin) are on the same side. A hit on
    // the collapsed half of a triangle, at its corner, has no normal: its other half is as good.
    const glm::dvec3 normal(kept.normal), p = origin + double(kept.t) * direction;
    if (glm::dot(normal, p) * glm::dot(normal, direction) < 0) return result;
    const auto u = project(view.mesh.intrinsics, p);
    if (!u) return result;
    result.outcome = Outcome::seen;
    result.depth = kept.t;
    result.source_px = glm::vec2(*u);
    return result;
}

}  // namespace

ShiftedHoles holes(const LiftedRig& rig, const ShiftedCamera& shifted) {
    const int width = shifted.intrinsics.width, height = shifted.intrinsics.height;
    ShiftedHoles out;
    for (Mask* m : {&out.hole, &out.disoccluded, &out.outside}) *m = Mask(width, height, 0);
    out.source = Grid<int16_t>(width, height, -1);
    out.source_px = Grid<glm::vec2>(width, height, glm::vec2(0));
    out.depth = DepthMap(width, height, std::numeric_limits<float>::infinity());

    std::vector<Pose> view_from_shifted;
    for (const LiftedView& view : rig.views)
        view_from_shifted.push_back(compose(inverse(view.world_from_cam), shifted.world_from_cam));
    const auto look_from = [&](size_t i, glm::dvec2 u) {
        const Pose& pose = view_from_shifted[i];
        Look found = look(rig.views[i], pose.translation_m, pose.direction(ray(shifted.intrinsics, u)));
        if (found.outcome != Outcome::seen) {
            const Look again = look(rig.views[i], pose.translation_m,
                                    pose.direction(ray(shifted.intrinsics, u + glm::dvec2(retry_px, 0.6 * retry_px))));
            if (again.outcome == Outcome::seen) found = again;
        }
        return found;
    };

    const auto pixel = [&](int x, int y) {
        const glm::dvec2 u(x + 0.5, y + 0.5);
        const glm::dvec3 d = ray(shifted.intrinsics, u);
        const size_t own = size_t(rig.own);
        const Look first = look_from(own, u);
        Look best = first;
        int source = first.outcome == Outcome::seen ? rig.own : -1;
        for (size_t i = 0; i < rig.views.size(); ++i) {
            if (i == own) continue;
            const Look other = look_from(i, u);
            if (other.outcome != Outcome::seen) continue;
            if (source >= 0 && !(double(other.depth) < double(best.depth) * (1 - nearer_share))) continue;
            // Where the own camera looked along the ray and saw past that place, it knows better.
            if (source == rig.own) {
                const glm::dvec3 p = view_from_shifted[own].point(d * double(other.depth));
                if (in_frustum(rig.views[own].mesh.intrinsics, p)) continue;
            }
            best = other;
            source = int(i);
        }
        out.source.at(x, y) = int16_t(source);
        if (source < 0) {
            out.hole.at(x, y) = 1;
            (first.outcome == Outcome::behind_edge ? out.disoccluded : out.outside).at(x, y) = 1;
            return;
        }
        out.source_px.at(x, y) = best.source_px;
        out.depth.at(x, y) = best.depth;
    };
    tbb::parallel_for(0, height, [&](int y) {
        for (int x = 0; x < width; ++x) pixel(x, y);
    });
    return out;
}

ColorImage warp(const LiftedRig& rig, const ShiftedHoles& seen, const std::vector<ColorImage>& images) {
    ColorImage out(seen.hole.width, seen.hole.height, glm::vec3(0));
    const auto sample = [&](const LiftedMesh& mesh, const ColorImage& image, glm::vec2 u) {
        const float gx = u.x - 0.5f, gy = u.y - 0.5f;
        const int x0 = int(std::floor(gx)), y0 = int(std::floor(gy));
        const float fx = gx - float(x0), fy = gy - float(y0);
        // The pixel that the point belongs to, and its neighbours that no tear parts from it.
        const int sx = fx < 0.5f ? 0 : 1, sy = fy < 0.5f ? 0 : 1;
        const int px = std::clamp(x0 + sx, 0, image.width - 1), py = std::clamp(y0 + sy, 0, image.height - 1);
        const auto joined = [&](int xa, int ya, int xb, int yb) {
            const uint8_t bit = ya == yb ? 1 : 2;
            return !(mesh.tears.at(std::min(xa, xb), std::min(ya, yb)) & bit) &&
                   (mesh.inverse_depth.at(xa, ya) >= 0) == (mesh.inverse_depth.at(xb, yb) >= 0);
        };
        glm::vec3 sum(0);
        float weights = 0;
        for (int j = 0; j < 2; ++j)
            for (int i = 0; i < 2; ++i) {
                const int x = x0 + i, y = y0 + j;
                if (x < 0 || y < 0 || x >= image.width || y >= image.height) continue;
                if (x != px && !joined(x, py, px, py)) continue;
                if (y != py && !joined(px, y, px, py)) continue;
                if (x != px && y != py && (!joined(x, y, px, y) || !joined(x, y, x, py))) continue;
                const float weight = (i ? fx : 1 - fx) * (j ? fy : 1 - fy);
                sum += weight * image.at(x, y);
                weights += weight;
            }
        return weights > 0 ? sum / weights : image.at(px, py);
    };
    tbb::parallel_for(0, out.height, [&](int y) {
        for (int x = 0; x < out.width; ++x) {
            const int source = seen.source.at(x, y);
            if (source < 0) continue;
            out.at(x, y) = sample(rig.views[size_t(source)].mesh, images.at(size_t(source)), seen.source_px.at(x, y));
        }
    });
    return out;
}

}  // namespace vshift
