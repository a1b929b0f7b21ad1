// SPDX-License-Identifier: Apache-2.0
#include "embree_core/holes.h"

#include <tbb/parallel_for.h>

#include <limits>

namespace vshift {

ShiftedHoles holes(const std::vector<RigView>& rig, int own_index, const ShiftedCamera& shifted) {
    const int width = shifted.intrinsics.width, height = shifted.intrinsics.height;
    ShiftedHoles out;
    for (Mask* m : {&out.hole, &out.disoccluded, &out.outside}) *m = Mask(width, height, 0);
    out.source = Grid<int16_t>(width, height, -1);
    out.source_px = Grid<glm::vec2>(width, height, glm::vec2(0));
    out.depth = DepthMap(width, height, std::numeric_limits<float>::infinity());
    const size_t own = size_t(own_index);
    const Pose own_from_shifted = compose(inverse(rig[own].world_from_cam), shifted.world_from_cam);

    const auto pixel = [&](int x, int y) {
        const size_t at = size_t(y) * size_t(width) + size_t(x);
        const auto seen_by = [&](size_t i) { return rig[i].shown && is_seen(rig[i].shown->sight.data[at]); };
        const auto depth_in = [&](size_t i) { return 1 / double(rig[i].shown->inverse_depth.data[at]); };
        int source = seen_by(own) ? own_index : -1;
        double depth = source >= 0 ? depth_in(own) : 0;
        for (size_t i = 0; i < rig.size(); ++i) {
            if (i == own || !seen_by(i)) continue;
            const double other = depth_in(i);
            if (source >= 0 && !(other < depth * (1 - same_surface_share))) continue;
            // Where the own camera looked along the ray and saw past that place, it knows better.
            if (source == own_index) {
                const glm::dvec3 p = own_from_shifted.point(ray(shifted.intrinsics, {x + 0.5, y + 0.5}) * other);
                if (in_frustum(rig[own].intrinsics, p)) continue;
            }
            depth = other;
            source = int(i);
        }
        out.source.data[at] = int16_t(source);
        if (source < 0) {
            const bool behind_edge = rig[own].shown && rig[own].shown->sight.data[at] == Sight::behind_wall;
            out.hole.data[at] = 1;
            (behind_edge ? out.disoccluded : out.outside).data[at] = 1;
            return;
        }
        out.source_px.data[at] = rig[size_t(source)].shown->source_px.data[at];
        out.depth.data[at] = float(depth);
    };
    tbb::parallel_for(0, height, [&](int y) {
        for (int x = 0; x < width; ++x) pixel(x, y);
    });
    return out;
}

ShiftedHoles holes(const LiftedRig& rig, const ShiftedCamera& shifted) {
    std::vector<Reprojection> shown(rig.views.size());
    std::vector<RigView> views;
    for (size_t i = 0; i < shown.size(); ++i) {
        cast(rig.views[i], shifted, shown[i]);
        views.push_back({rig.views[i].mesh.intrinsics, rig.views[i].world_from_cam, &shown[i]});
    }
    return holes(views, rig.own, shifted);
}

}  // namespace vshift
