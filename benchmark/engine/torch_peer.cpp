// SPDX-License-Identifier: Apache-2.0
// The peer in Python (benchmark/peers/torch_splat.py): depth maps out, its masks and times back.
#include <cmath>
#include <set>

#include "benchmark/engine/bench.h"
#include "embree_core/image_file.h"

namespace vshift::bench {
namespace {

namespace fs = std::filesystem;

ordered_json matrix(const glm::dmat3& m) {
    ordered_json rows = ordered_json::array();
    for (int r = 0; r < 3; ++r) rows.push_back({m[0][r], m[1][r], m[2][r]});
    return rows;
}

/// A question as the script reads it: V's pixels are k_v (r (k_r^-1 (x, y, 1) z) + t).
ordered_json question(const Case& c, const std::string& depth, const std::string& out,
                      const std::vector<int>& threads) {
    const Job job = job_of(c);
    const auto intrinsics = [](const Intrinsics& k) { return ordered_json{k.fx, k.fy, k.cx, k.cy}; };
    const Pose v_from_r = compose(inverse(job.shifted.world_from_cam), job.recorded.world_from_cam);
    const glm::dvec3& t = v_from_r.translation_m;
    return {{"depth", depth},
            {"out", out},
            {"threads", threads},
            {"k_recorded", intrinsics(job.recorded.intrinsics)},
            {"k_shifted", intrinsics(job.shifted.intrinsics)},
            {"rotation", matrix(v_from_r.rotation)},
            {"translation_m", {t.x, t.y, t.z}}};
}

void write_depth(const fs::path& file, const DepthMap& depth) {
    Channels image{depth.width, depth.height, {}, {}, {}, {}};
    image.add("Z", depth.data);
    write_image(file, image);
}

Grid<uint8_t> read_classes(const fs::path& file) {
    const Channels image = read_image(file);
    Grid<uint8_t> out(image.width, image.height);
    for (size_t i = 0; i < out.size(); ++i) out.data[i] = image.planes[0][i] > 0 ? occluded_bit : 0;
    return out;
}

/// Runs the script on the jobs; null when it cannot be run, and `bench.no_torch` says why.
ordered_json run_jobs(Bench& bench, const ordered_json& jobs) {
    const fs::path folder = bench.hooks.scratch;
    write_whole_file(folder / "job.json", ordered_json{{"jobs", jobs}, {"peer_code", bench.options.peer_code}}.dump(1));
    bench.no_torch = bench.hooks.run_torch ? bench.hooks.run_torch(folder) : "not asked for";
    if (!bench.no_torch.empty()) return nullptr;
    return ordered_json::parse(read_whole_file(folder / "result.json", size_t(1) << 24));
}

std::vector<std::string> torch_methods(const Options& options) {
    std::vector<std::string> names{"torch_splat"};
    if (!options.peer_code.empty()) names.push_back("trajectorycrafter");
    return names;
}

}  // namespace

std::vector<TorchTime> time_torch(Bench& bench, const std::vector<Case>& cases) {
    ordered_json jobs = ordered_json::array();
    for (const Case& c : cases) {
        const std::string depth = c.camera() + ".npy";
        if (!fs::exists(bench.hooks.scratch / depth))
            write_depth(bench.hooks.scratch / depth, c.world->depth[size_t(c.own)]);
        jobs.push_back(question(c, depth, "", bench.threads));
    }
    const ordered_json results = run_jobs(bench, jobs);
    std::vector<TorchTime> times;
    if (results.is_null()) return times;
    for (const ordered_json& r : results["times"])
        times.push_back({r["method"], r["job"].get<size_t>(), r["threads"].get<int>(),
                         Elapsed{r["wall_ms"].get<double>(), r["cpu_ms"].get<double>()}, r["splat_ms"].get<double>()});
    return times;
}

void plan_torch(Bench& bench, Plan& plan) {
    const double area = bench.scale() * bench.scale();
    // One call per camera: a call is short enough to be given up, and the time left stays true.
    const int cameras = bench.options.quick ? 1 : 6;
    for (int own = 0; own < cameras; ++own)
        plan.add(2 + 11 * area, "accuracy: PyTorch", [&bench, own] {
            if (!bench.no_torch.empty()) return;
            const fs::path& folder = bench.hooks.scratch;
            std::vector<const Case*> asked;
            for (const Case& c : bench.cases)
                if (c.own == own) asked.push_back(&c);
            const DepthMap& depth = bench.full().depth[size_t(own)];
            write_depth(folder / "clean.npy", depth);
            ordered_json jobs = ordered_json::array();
            for (size_t i = 0; i < asked.size(); ++i)
                jobs.push_back(question(*asked[i], "clean.npy", std::to_string(i) + ".npy", {bench.threads.back()}));
            const bool noisy = own < 3;
            if (noisy)
                for (const uint32_t draw : {1u, 2u}) {
                    const std::string name = "noisy_" + std::to_string(draw) + ".npy";
                    write_depth(folder / name, mono_like(depth, draw));
                    Case c = make_question(bench.full(), own, moved(0, 2));
                    jobs.push_back(question(c, name, "mask_" + name, {bench.threads.back()}));
                }
            if (run_jobs(bench, jobs).is_null()) return;
            for (const std::string& method : torch_methods(bench.options)) {
                for (size_t i = 0; i < asked.size(); ++i) {
                    ordered_json row = row_head(method, *asked[i]);
                    const fs::path file = folder / (method + "_" + std::to_string(i) + ".npy");
                    row.update(score_classes(*asked[i], read_classes(file), false));
                    bench.out["accuracy"].push_back(std::move(row));
                }
                if (!noisy) continue;
                ordered_json row = row_head(method, make_question(bench.full(), own, moved(0, 2)));
                row["flicker"] = flicker(read_classes(folder / (method + "_mask_noisy_1.npy")),
                                         read_classes(folder / (method + "_mask_noisy_2.npy")));
                bench.out["noise"].push_back(std::move(row));
            }
        });
}

}  // namespace vshift::bench
