// SPDX-License-Identifier: Apache-2.0
#include "benchmark/engine/methods.h"

#include <cstdio>
#include <memory>

#include "benchmark/engine/timing.h"
#include "embree_core/field_mask.h"

namespace vshift::bench {
namespace {

Method sweep() {
    Method m{"sweep", "sweep", "ours", "along rows or epipolar lines, vectorised, no mesh", true, true, {}};
    auto sweeper = std::make_shared<Sweeper>();
    m.run = [sweeper](const Job& job, Result& out) {
        const SweepCamera camera{job.recorded.intrinsics, job.shifted.intrinsics,
                                 compose(inverse(job.recorded.world_from_cam), job.shifted.world_from_cam),
                                 job.clear_m};
        sweeper->classes(camera, *job.depth, out.classes);
    };
    return m;
}

Method embree_tiles() {
    Method m{"embree_tiles",
             "Embree, adaptive: tiles",
             "ours",
             "rays against the height field, in the tiles that they can meet; no mesh",
             true,
             true,
             {}};
    m.run = [](const Job& job, Result& out) {
        const glm::dvec3& centre_m = job.shifted.world_from_cam.translation_m;
        const Stopwatch lifting;
        SurfaceView surface = surface_view(job.recorded.intrinsics, job.recorded.world_from_cam, *job.depth, centre_m);
        out.lift_ms = lifting.read().wall_ms;
        const Stopwatch building;
        const FieldView view = field_view(std::move(surface), {}, centre_m);
        out.build_ms = building.read().wall_ms;
        out.tiles = view.field.tiles(), out.bvh_bytes = view.field.bytes();
        const Stopwatch casting;
        out.masks = mask(view, *job.depth, {job.shifted.intrinsics, job.shifted.world_from_cam}, job.clear_m);
        out.cast_ms = casting.read().wall_ms;
    };
    return m;
}

Method embree(const std::string& name, const std::string& label, const std::string& note, double tolerance_px) {
    Method m{name, label, "ours", note, true, true, {}};
    m.run = [tolerance_px](const Job& job, Result& out) {
        const Stopwatch lifting;
        LiftedMesh mesh = lift_towards(job.recorded.intrinsics, job.recorded.world_from_cam, *job.depth,
                                       job.shifted.world_from_cam.translation_m, tolerance_px);
        out.lift_ms = lifting.read().wall_ms;
        out.triangles = mesh.kept_triangles + 2 * mesh.torn.size();
        const Stopwatch building;
        LiftedRig rig;
        rig.views.push_back(build_view("own", job.recorded.world_from_cam, std::move(mesh)));
        out.build_ms = building.read().wall_ms;
        out.bvh_bytes = bvh_bytes(rig.views[0]);
        const Stopwatch casting;
        out.masks = mask(rig, {job.shifted.intrinsics, job.shifted.world_from_cam}, job.clear_m);
        out.cast_ms = casting.read().wall_ms;
    };
    return m;
}

}  // namespace

Job job_of(const Case& c) {
    return job_of(c, c.world->depth[size_t(c.own)]);
}

Job job_of(const Case& c, const DepthMap& depth) {
    return {c.world->recorded(c.own), c.world->shifted(c.own, c.shift), &depth,
            c.shifted_depth.size() ? &c.shifted_depth : nullptr};
}

void join_classes(Result& result) {
    const RecordedMasks& m = result.masks;
    if (m.lost.size() == 0) return;
    result.classes = Grid<uint8_t>(m.lost.width, m.lost.height, 0);
    for (size_t i = 0; i < m.lost.size(); ++i)
        result.classes.data[i] =
            uint8_t((m.occluded.data[i] ? occluded_bit : 0) | (m.outside.data[i] ? outside_bit : 0) |
                    (m.unknown.data[i] ? unknown_bit : 0) | (m.unseen.data[i] ? unseen_bit : 0));
}

std::vector<Method> our_methods() {
    return {sweep(), embree_tiles(),
            embree("embree_0.1", "Embree, mesh collapsed to 0.1 px", "flat areas collapsed within 0.1 px", 0.1),
            embree("embree_0.02", "Embree, mesh collapsed to 0.02 px", "flat areas collapsed within 0.02 px", 0.02),
            embree("embree", "Embree, full resolution", "one quad per pixel", 0)};
}

}  // namespace vshift::bench
