// SPDX-License-Identifier: Apache-2.0
// What depth's source asks for: each source's own rules beside those for exact depth; the certificate with edges; and
// what sampling once a pixel costs whoever looks at it.
#include <cmath>
#include <limits>

#include "benchmark/engine/bench.h"
#include "embree_core/depth_source.h"

namespace vshift::bench {
namespace {

Grid<uint8_t> swept(const Job& job, const DepthMap& depth, const DepthRules& rules) {
    const SweepCamera camera{job.recorded.intrinsics, job.shifted.intrinsics,
                             compose(inverse(job.recorded.world_from_cam), job.shifted.world_from_cam), job.clear_m,
                             rules};
    Grid<uint8_t> classes;
    Sweeper().classes(camera, depth, classes);
    return classes;
}

// Finer depth maps than this take too long.
constexpr int max_sampled_width = 8192;

/// Rounded to the 11 binary digits of a 16-bit float.
float to_half(float value) {
    int exponent = 0;
    const float mantissa = std::frexp(value, &exponent);
    return std::ldexp(std::round(mantissa * 2048), exponent - 11);
}

/// Exact depth as `source` would hand it over.
DepthMap handed_over(DepthSource source, const DepthMap& exact, uint32_t draw) {
    if (source == DepthSource::mono) return mono_like(exact, draw);
    DepthMap out = exact;
    float nearest_m = std::numeric_limits<float>::infinity();
    for (const float z : exact.data)
        if (is_measured(z)) nearest_m = std::min(nearest_m, z);
    for (float& z : out.data) {
        if (!is_measured(z)) continue;
        if (source == DepthSource::half) z = to_half(z);
        if (source == DepthSource::mm16) z = std::round(z * 1000) / 1000;
        if (source == DepthSource::disparity8) {
            const float steps = std::round(nearest_m / z * 255);
            z = steps > 0 ? nearest_m * 255 / steps : std::numeric_limits<float>::infinity();
        }
    }
    return out;
}

/// As a request with this `depth_source` would have it.
Grid<uint8_t> answered(const Job& job, DepthSource stated, const DepthMap& depth) {
    const DepthRules rules = depth_rules(stated, depth);
    return swept(job, stated == DepthSource::mono ? snap_edges(depth) : depth, rules);
}

ordered_json with_method(ordered_json row, const Case& c, const Grid<uint8_t>& classes) {
    const ordered_json scores = score_classes(c, classes, false);
    for (const char* truth : {"shell", "scene"}) row[truth] = scores[truth];
    return row;
}

void run_sources(Bench& bench, int own, const Shift& shift) {
    const Case c = make_case(bench.full(), own, shift);
    const Job job = job_of(c);
    const DepthMap& exact = c.world->depth[size_t(own)];
    for (size_t s = 0; s < depth_source_words().size(); ++s) {
        const auto source = DepthSource(s);
        const DepthMap depth = handed_over(source, exact, 1);
        for (const DepthSource stated : {DepthSource::exact, source}) {
            if (stated == source && source == DepthSource::exact) break;
            const Grid<uint8_t> classes = answered(job, stated, depth);
            ordered_json row = row_head("sweep", c);
            row["source"] = depth_source_words()[s];
            row["stated"] = depth_source_words()[size_t(stated)];
            row = with_method(std::move(row), c, classes);
            if (source == DepthSource::mono)
                row["flicker"] = flicker(classes, answered(job, stated, handed_over(source, exact, 2)));
            // What the rule costs where it is not needed.
            row["on_exact_depth"] = with_method({}, c, answered(job, stated, exact));
            bench.out["sources"].push_back(std::move(row));
        }
    }
}

/// The same pixels answered from depth that is sampled `finer` times as densely along both axes.
void run_sampling(Bench& bench, int own, const Shift& shift) {
    const Case c = make_case(bench.full(), own, shift);
    const World& world = bench.full();
    for (const int finer : {1, 3, 5}) {  // odd: a fine pixel's centre is the coarse one's
        const Intrinsics& k = world.rig[size_t(own)].intrinsics;
        if (k.width * finer > max_sampled_width) continue;
        const auto rig = analytic::six_camera_rig(k.width * finer, k.height * finer);
        Job job = job_of(c);
        job.recorded = analytic::recorded_camera(rig[size_t(own)], World::frame);
        job.shifted = analytic::shifted_camera(rig[size_t(own)], World::frame, shift);
        const DepthMap depth = cast_camera(world.street->scene, job.recorded).depth;
        const Grid<uint8_t> fine = swept(job, depth, {});
        Grid<uint8_t> classes(k.width, k.height);
        for (int y = 0; y < k.height; ++y)
            for (int x = 0; x < k.width; ++x) classes.at(x, y) = fine.at(x * finer + finer / 2, y * finer + finer / 2);
        ordered_json row = row_head("sweep", c);
        row["samples_per_px"] = finer * finer;
        bench.out["sampling"].push_back(with_method(std::move(row), c, classes));
    }
}

/// The certificate with pixels at an edge left out.
void run_edges(Bench& bench, int own, const Shift& shift) {
    const Case c = make_case(bench.full(), own, shift);
    const Job job = job_of(c);
    const SweepCamera camera{job.recorded.intrinsics, job.shifted.intrinsics,
                             compose(inverse(job.recorded.world_from_cam), job.shifted.world_from_cam), job.clear_m};
    Sweeper sweeper;
    Grid<uint8_t> classes;
    sweeper.classes(camera, *job.depth, classes);
    const Mask edges = sweeper.edges(camera, *job.depth, classes);
    uint64_t edge_px = 0;
    for (size_t i = 0; i < classes.size(); ++i)
        if (edges.data[i]) ++edge_px, classes.data[i] = uint8_t((classes.data[i] & ~occluded_bit) | unknown_bit);
    ordered_json row = row_head("sweep certify=1", c);
    row["certificate"] = score_classes(c, classes, true)["certificate"];
    row["edge_share"] = double(edge_px) / double(classes.size());
    bench.out["edges"].push_back(std::move(row));
}

}  // namespace

void plan_sources(Bench& bench, Plan& plan) {
    for (const char* section : {"sources", "sampling", "edges"}) bench.out[section] = ordered_json::array();
    const double area = bench.scale() * bench.scale();
    const int cameras = bench.options.quick ? 1 : 3;
    for (int own = 0; own < cameras; ++own)
        for (const Shift& shift : {moved(0, 2), moved(0, -4), moved(2, 0)}) {
            plan.add(0.05 + 3 * area, "edges", [&bench, own, shift] { run_edges(bench, own, shift); });
            if (shift.translation_m.y < 0) continue;
            plan.add(0.05 + 7 * area, "depth sources", [&bench, own, shift] { run_sources(bench, own, shift); });
            if (own < 2)
                plan.add(0.05 + 12 * area, "sampling", [&bench, own, shift] { run_sampling(bench, own, shift); });
        }
}

}  // namespace vshift::bench
