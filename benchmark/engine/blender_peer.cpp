// SPDX-License-Identifier: Apache-2.0
// Blender's scene.ray_cast (benchmark/peers/ray_cast.py): the true mesh and rays out, hits and times back.
#include "benchmark/engine/bench.h"
#include "embree_core/image_file.h"

namespace vshift::bench {
namespace {

namespace fs = std::filesystem;

constexpr double ray_offset = 1e-4;  // of a segment, at both ends
constexpr float sky_reach_m = 1e5f;

template <class T>
void write_raw(const fs::path& file, const std::vector<T>& values) {
    write_whole_file(file, std::string(reinterpret_cast<const char*>(values.data()), values.size() * sizeof(T)));
}

/// Per pixel: origin, unit direction, length. From the point to V; from V towards the sky.
std::vector<float> rays_of(const Case& c) {
    const TrueCamera recorded = c.world->recorded(c.own);
    const glm::dvec3 v = c.world->shifted(c.own, c.shift).world_from_cam.translation_m;
    const DepthMap& depth = c.world->depth[size_t(c.own)];
    std::vector<float> out;
    for (int y = 0; y < depth.height; ++y)
        for (int x = 0; x < depth.width; ++x) {
            const glm::dvec3 r = ray(recorded.intrinsics, {x + 0.5, y + 0.5});
            glm::dvec3 origin = v, direction = recorded.world_from_cam.direction(glm::normalize(r));
            double length = sky_reach_m;
            if (!is_sky(depth.at(x, y))) {
                const glm::dvec3 p = recorded.world_from_cam.point(r * double(depth.at(x, y)));
                length = glm::length(v - p);
                direction = (v - p) / length;
                origin = p + ray_offset * length * direction;
                length *= 1 - 2 * ray_offset;
            }
            for (int i = 0; i < 3; ++i) out.push_back(float(origin[i]));
            for (int i = 0; i < 3; ++i) out.push_back(float(direction[i]));
            out.push_back(float(length));
        }
    return out;
}

void run(Bench& bench) {
    const fs::path& folder = bench.hooks.scratch;
    std::vector<float> vertices;
    for (const LiftedVertex& at : bench.street.street.vertices) vertices.insert(vertices.end(), {at.x, at.y, at.z});
    write_raw(folder / "vertices.bin", vertices);
    write_raw(folder / "triangles.bin", bench.street.street.triangles);
    std::vector<Case> cases;
    ordered_json jobs = ordered_json::array();
    for (const int own : {0, 1}) {
        cases.push_back(make_case(bench.world[1], own, moved(0, 2)));
        const std::string rays = "rays_" + std::to_string(own) + ".bin";
        write_raw(folder / rays, rays_of(cases.back()));
        jobs.push_back({{"rays", rays}});
    }
    write_whole_file(folder / "job.json", ordered_json{{"jobs", jobs}}.dump(1));
    bench.no_blender = bench.hooks.run_blender ? bench.hooks.run_blender(folder) : "not asked for";
    if (!bench.no_blender.empty()) return;
    const ordered_json times = ordered_json::parse(read_whole_file(folder / "result.json", size_t(1) << 24))["times"];
    for (size_t i = 0; i < cases.size(); ++i) {
        const Case& c = cases[i];
        const DepthMap& tiny = c.world->depth[size_t(c.own)];
        const std::string hits = read_whole_file(folder / ("hits_" + std::to_string(i) + ".bin"), tiny.size());
        Grid<uint8_t> classes(tiny.width, tiny.height);
        for (size_t p = 0; p < classes.size(); ++p) classes.data[p] = hits.at(p) ? occluded_bit : 0;
        ordered_json row = row_head("ray_cast", c);
        row.update(score_classes(c, classes, false));
        bench.out["accuracy"].push_back(std::move(row));
        const double more = double(bench.full().depth[size_t(c.own)].size()) / double(tiny.size());
        ordered_json time = row_head("ray_cast", c);
        time["threads"] = 1;
        time.update(spread_of({Elapsed{times[i]["wall_ms"].get<double>() * more, times[i]["cpu_ms"].get<double>() * more}}));
        time["extrapolated_from_width"] = brute_force_width;
        bench.out["timing"].push_back(std::move(time));
    }
}

}  // namespace

void plan_ray_cast(Bench& bench, Plan& plan) {
    plan.add(8, "scene.ray_cast", [&bench] { run(bench); });
}

}  // namespace vshift::bench
