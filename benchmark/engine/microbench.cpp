// SPDX-License-Identifier: Apache-2.0
// Micro-benchmarks of lift, build, cast, sweep, warp and seam on an analytic street at 1600x900, per frame and in rays
// (one per pixel) per second of wall time. Built only where Google Benchmark is found:
//     ninja vshift_microbench && bin/vshift_microbench --benchmark_min_time=1
#include <benchmark/benchmark.h>
#include <tbb/global_control.h>

#include "benchmark/engine/methods.h"
#include "embree_core/condition.h"
#include "embree_core/field_mask.h"

namespace vshift::bench {
namespace {

const World& world() {
    static const analytic::StreetScene street = analytic::build_street(1);
    static const World made(street, 1600, 3);
    return made;
}

constexpr int64_t front = 0, side = 1;

/// Camera and threads are the last two arguments of every benchmark.
struct Setting {
    Case question;
    Job job;
    tbb::global_control limit;
    Setting(int64_t camera, int64_t threads)
        : question(make_question(world(), int(camera), moved(0, 2))),
          job(job_of(question)),
          limit(tbb::global_control::max_allowed_parallelism, size_t(threads)) {}
};

void count_rays(benchmark::State& state, const Job& job) {
    state.counters["rays/s"] =
        benchmark::Counter(double(job.depth->size()), benchmark::Counter::kIsIterationInvariantRate);
}

LiftedMesh lifted(const Job& job, double tolerance_px) {
    return lift_towards(job.recorded.intrinsics, job.recorded.world_from_cam, *job.depth,
                        job.shifted.world_from_cam.translation_m, tolerance_px);
}

void lift(benchmark::State& state) {
    const double tolerance_px = double(state.range(0)) / 100;
    const Setting at(state.range(1), state.range(2));
    uint64_t triangles = 0;
    for (auto _ : state) {
        const LiftedMesh mesh = lifted(at.job, tolerance_px);
        triangles = mesh.kept_triangles + 2 * mesh.torn.size();
    }
    state.counters["triangles"] = double(triangles);
    count_rays(state, at.job);
}

void build(benchmark::State& state) {
    const double tolerance_px = double(state.range(0)) / 100;
    const Setting at(state.range(1), state.range(2));
    const LiftedMesh mesh = lifted(at.job, tolerance_px);
    size_t bytes = 0;
    for (auto _ : state) {
        state.PauseTiming();
        LiftedMesh copy = mesh;
        state.ResumeTiming();
        const LiftedView view = build_view("own", at.job.recorded.world_from_cam, std::move(copy));
        bytes = bvh_bytes(view);
    }
    state.counters["bvh_MB"] = double(bytes) / 1e6;
}

void cast(benchmark::State& state) {
    const double tolerance_px = double(state.range(0)) / 100;
    const Setting at(state.range(1), state.range(2));
    LiftedRig rig;
    rig.views.push_back(build_view("own", at.job.recorded.world_from_cam, lifted(at.job, tolerance_px)));
    for (auto _ : state) {
        const RecordedMasks masks =
            mask(rig, {at.job.shifted.intrinsics, at.job.shifted.world_from_cam}, at.job.clear_m);
        benchmark::DoNotOptimize(masks.lost.data.data());
    }
    count_rays(state, at.job);
}

/// The height field's tiles, ready for a mask's rays.
FieldView tiles(const Job& job) {
    const glm::dvec3& centre_m = job.shifted.world_from_cam.translation_m;
    return field_view(surface_view(job.recorded.intrinsics, job.recorded.world_from_cam, *job.depth, centre_m), {},
                      centre_m);
}
void build_tiles(benchmark::State& state) {
    const Setting at(state.range(0), state.range(1));
    size_t bytes = 0, count = 0;
    for (auto _ : state) {
        const FieldView view = tiles(at.job);
        bytes = view.field.bytes(), count = view.field.tiles();
    }
    state.counters["bvh_MB"] = double(bytes) / 1e6;
    state.counters["tiles"] = double(count);
    count_rays(state, at.job);
}
void cast_tiles(benchmark::State& state) {
    const Setting at(state.range(0), state.range(1));
    const FieldView view = tiles(at.job);
    for (auto _ : state) {
        const RecordedMasks masks =
            mask(view, *at.job.depth, {at.job.shifted.intrinsics, at.job.shifted.world_from_cam}, at.job.clear_m);
        benchmark::DoNotOptimize(masks.lost.data.data());
    }
    count_rays(state, at.job);
}

void one_method(benchmark::State& state, const Method& method) {
    const Setting at(state.range(0), state.range(1));
    Result room;
    for (auto _ : state) {
        method.run(at.job, room);
        benchmark::DoNotOptimize(room.classes.data.data());
    }
    count_rays(state, at.job);
}
void sweep(benchmark::State& state) {
    one_method(state, our_methods()[0]);
}
void copy(benchmark::State& state) {
    one_method(state, copy_loop());
}

/// Warp, seam and condition of one camera from itself and its two neighbours; colours are made up, their cost is not.
struct SeamSetting {
    std::array<int, 3> cameras{0, 1, 2};
    ShiftedCamera v;
    std::array<ColorImage, 3> colors;
    std::array<SurfaceView, 3> surfaces;
    std::vector<SeamCamera> rig{3};
    ShiftedSeam seam;

    explicit SeamSetting(const Job& job) : v{job.shifted.intrinsics, job.shifted.world_from_cam} {
        for (size_t i = 0; i < 3; ++i) {
            const DepthMap& depth = world().depth[size_t(cameras[i])];
            colors[i] = ColorImage(depth.width, depth.height);
            for (size_t p = 0; p < depth.size(); ++p) colors[i].data[p] = glm::vec3(float(p % 251) / 251);
            rig[i].surface = &surfaces[i];
            rig[i].image = &colors[i];
        }
    }
    void lift() {
        for (size_t i = 0; i < 3; ++i) {
            const TrueCamera camera = world().recorded(cameras[i]);
            surface_view(camera.intrinsics, camera.world_from_cam, world().depth[size_t(cameras[i])],
                         v.world_from_cam.translation_m, DepthRules{}, surfaces[i]);
        }
    }
};
void warp_alone(benchmark::State& state) {
    const Setting at(front, state.range(1));
    SeamSetting room(at.job);
    room.lift();
    const SurfaceView& own = room.surfaces[0];
    const Sampler sampler({own.inverse_depth, own.tears}, room.colors[0],
                          projective_map(own.intrinsics, own.world_from_cam, room.v.intrinsics, room.v.world_from_cam));
    for (auto _ : state) {
        reproject(own, room.v, nullptr, room.seam.own);
        warp(room.seam.own, sampler, EdgeBand::drop, room.seam.seam.color, room.seam.missing);
    }
    count_rays(state, at.job);
}
void warp_seam_condition(benchmark::State& state) {
    const Setting at(front, state.range(1));
    SeamSetting room(at.job);
    Condition made;
    for (auto _ : state) {
        room.lift();
        seam_shifted(room.rig, 0, room.v, {}, room.seam);
        condition_of(room.seam.seam, 0, 1, made);
        benchmark::DoNotOptimize(made.own.data.data());
    }
    count_rays(state, at.job);
}

void meshes(benchmark::internal::Benchmark* b) {
    b->ArgNames({"tolerance_px/100", "side", "threads"})
        ->Unit(benchmark::kMillisecond)
        ->UseRealTime()
        ->MeasureProcessCPUTime();
    for (const int64_t tolerance : {0, 2, 10})
        for (const int64_t camera : {front, side})
            for (const int64_t threads : {1, 2}) b->Args({tolerance, camera, threads});
}
void pictures(benchmark::internal::Benchmark* b) {
    b->ArgNames({"side", "threads"})->Unit(benchmark::kMillisecond)->UseRealTime();
    for (const int64_t camera : {front, side})
        for (const int64_t threads : {1, 2}) b->Args({camera, threads});
}

BENCHMARK(copy)->Apply(pictures);
BENCHMARK(sweep)->Apply(pictures);
BENCHMARK(build_tiles)->Apply(pictures);
BENCHMARK(cast_tiles)->Apply(pictures);
void front_pictures(benchmark::internal::Benchmark* b) {
    b->ArgNames({"side", "threads"})->Unit(benchmark::kMillisecond)->UseRealTime()->MeasureProcessCPUTime();
    for (const int64_t threads : {1, 2}) b->Args({front, threads});
}
BENCHMARK(warp_alone)->Apply(front_pictures);
BENCHMARK(warp_seam_condition)->Apply(front_pictures);
BENCHMARK(lift)->Apply(meshes);
BENCHMARK(build)->Apply(meshes);
BENCHMARK(cast)->Apply(meshes);

}  // namespace
}  // namespace vshift::bench

BENCHMARK_MAIN();
