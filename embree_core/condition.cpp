// SPDX-License-Identifier: Apache-2.0
#include "embree_core/condition.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>

namespace vshift {

void condition_of(Seam& seam, int own, int stride, Condition& out) {
    const int full_width = seam.color.width, full_height = seam.color.height;
    const int width = (full_width + stride - 1) / stride, height = (full_height + stride - 1) / stride;
    for (Grid<float>* share : {&out.own, &out.neighbor, &out.hole})
        if (share->width != width || share->height != height) *share = Grid<float>(width, height);
    if (stride == 1) {
        std::swap(out.color, seam.color);
        tbb::parallel_for(0, height, [&](int y) {
            const size_t begin = size_t(y) * size_t(width), end = begin + size_t(width);
            for (size_t i = begin; i < end; ++i) {
                const int source = seam.source.data[i];
                out.own.data[i] = source == own;
                out.neighbor.data[i] = source >= 0 && source != own;
                out.hole.data[i] = source < 0;
            }
        });
        return;
    }
    if (out.color.width != width || out.color.height != height) out.color = ColorImage(width, height);
    tbb::parallel_for(0, height, [&](int by) {
        for (int bx = 0; bx < width; ++bx) {
            const int x1 = std::min((bx + 1) * stride, full_width), y1 = std::min((by + 1) * stride, full_height);
            glm::dvec3 color(0);
            int own_px = 0, hole_px = 0, count = 0;
            for (int y = by * stride; y < y1; ++y)
                for (int x = bx * stride; x < x1; ++x, ++count) {
                    color += glm::dvec3(seam.color.at(x, y));
                    own_px += seam.source.at(x, y) == own;
                    hole_px += seam.source.at(x, y) < 0;
                }
            out.color.at(bx, by) = glm::vec3(color / double(count));
            out.own.at(bx, by) = float(own_px) / float(count);
            out.neighbor.at(bx, by) = float(count - own_px - hole_px) / float(count);
            out.hole.at(bx, by) = float(hole_px) / float(count);
        }
    });
}

void warp_twice(const SurfaceView& own, const ShiftedCamera& shifted, const Warped& warped, const Reprojection& shown,
                double depth_tolerance, ColorImage& color, Mask& lost) {
    const Intrinsics& v = shifted.intrinsics;
    const ProjectiveMap map = projective_map(own.intrinsics, own.world_from_cam, v, shifted.world_from_cam);
    tbb::parallel_for(0, color.height, [&](int y) {
        for (int x = 0; x < color.width; ++x) {
            const size_t at = size_t(y) * size_t(color.width) + size_t(x);
            const float w = own.inverse_depth.data[at];
            if (lost.data[at] || !(w >= 0)) continue;
            const glm::dvec3 h = map.at(x + 0.5, y + 0.5, double(w));
            glm::vec3 sum(0);
            float weights = 0;
            if (h.z > 0) {
                const double gx = h.x / h.z - 0.5, gy = h.y / h.z - 0.5, q = double(w) / h.z;
                const double x0 = std::floor(gx), y0 = std::floor(gy);
                for (int j = 0; j < 2; ++j)
                    for (int i = 0; i < 2; ++i) {
                        const double px = x0 + i, py = y0 + j;
                        const float weight = float((1 - std::fabs(px - gx)) * (1 - std::fabs(py - gy)));
                        if (!(px >= 0 && px < v.width && py >= 0 && py < v.height) || !(weight > 1e-3f)) continue;
                        const size_t there = size_t(py) * size_t(v.width) + size_t(px);
                        if (warped.missing.data[there]) continue;
                        if (std::fabs(double(shown.inverse_depth.data[there]) - q) > depth_tolerance * q) continue;
                        sum += weight * warped.color.data[there];
                        weights += weight;
                    }
            }
            if (weights > 0)
                color.data[at] = sum / weights;
            else
                lost.data[at] = 1;
        }
    });
}

Seam literal_seam(const ColorImage& recorded, const ShiftedSeam& shifted, int own) {
    Seam out = shifted.seam;
    for (size_t i = 0; i < out.source.size(); ++i)
        if (out.source.data[i] == own) out.color.data[i] = recorded.data[i];
    return out;
}

Seam splatted_seam(const std::vector<SeamCamera>& rig, int own, const ShiftedCamera& shifted) {
    const Intrinsics& k = shifted.intrinsics;
    Seam out{ColorImage(k.width, k.height, glm::vec3(0)), Grid<int16_t>(k.width, k.height, -1)};
    std::vector<float> nearest(out.color.size());
    for (size_t turn = 0; turn < rig.size(); ++turn) {  // the own camera first
        const size_t index = turn == 0 ? size_t(own) : turn <= size_t(own) ? turn - 1 : turn;
        const SeamCamera& camera = rig[index];
        const SurfaceView& view = *camera.surface;
        const ProjectiveMap map = projective_map(view.intrinsics, view.world_from_cam, k, shifted.world_from_cam);
        for (int y = 0; y < view.intrinsics.height; ++y)
            for (int x = 0; x < view.intrinsics.width; ++x) {
                const float w = view.inverse_depth.at(x, y);
                if (!(w >= 0)) continue;
                const glm::dvec3 h = map.at(x + 0.5, y + 0.5, double(w));
                if (!(h.z > 1e-9)) continue;
                const glm::dvec2 u(h.x / h.z, h.y / h.z);
                if (!in_image(k, u)) continue;
                const size_t at = size_t(u.y) * size_t(k.width) + size_t(u.x);
                const float q = float(double(w) / h.z);
                const int there = out.source.data[at];
                if (there >= 0 && (there == own) != (int(index) == own)) continue;  // neighbours fill holes only
                if (there >= 0 && !(q > nearest[at])) continue;
                nearest[at] = q;
                out.source.data[at] = int16_t(index);
                out.color.data[at] = camera.gain * camera.image->at(x, y);
            }
    }
    return out;
}

}  // namespace vshift
