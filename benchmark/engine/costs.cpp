// SPDX-License-Identifier: Apache-2.0
// What it takes: time per method, interleaved so that a disturbance falls on all; against resolution, number
// of cameras and shift; and a long run in a steady state.
#include <tbb/global_control.h>

#include <cmath>
#include <map>
#include <memory>
#include <numeric>
#include <tuple>

#include "benchmark/engine/bench.h"

namespace vshift::bench {
namespace {

// Below this a run is repeated within its round, after one that only warms the caches.
constexpr double quick_run_ms = 80;
constexpr int quick_runs = 3;

tbb::global_control limited_to(int threads) {
    return {tbb::global_control::max_allowed_parallelism, size_t(threads)};
}

struct Times {
    std::vector<Elapsed> whole;
    std::vector<double> lift_ms, build_ms, cast_ms, splat_ms;
    uint64_t triangles = 0, tiles = 0, bvh_bytes = 0;
};

void add_stages(const Result& result, Times& times) {
    if (result.lift_ms < 0) return;
    times.lift_ms.push_back(result.lift_ms), times.build_ms.push_back(result.build_ms);
    times.cast_ms.push_back(result.cast_ms);
    times.triangles = result.triangles, times.tiles = result.tiles, times.bvh_bytes = result.bvh_bytes;
}

/// One round of one method: a run, or several short ones.
void measure(const Method& method, const Job& job, Result& room, Times& times) {
    const Stopwatch first;
    method.run(job, room);
    const Elapsed once = first.read();
    if (once.wall_ms > quick_run_ms) {
        times.whole.push_back(once);
        add_stages(room, times);
        return;
    }
    for (int i = 0; i < quick_runs; ++i) {
        const Stopwatch watch;
        method.run(job, room);
        times.whole.push_back(watch.read());
        add_stages(room, times);
    }
}

/// What `plan_timing` fills round by round.
struct Table {
    std::vector<Method> methods;
    Method brute = brute_force();
    std::vector<Case> cases, tiny_cases;
    std::map<std::tuple<std::string, size_t, int>, Times> times;
    std::map<std::string, Result> room;  ///< per method: buffers stay warm
};

void round_of(Bench& bench, Table& table) {
    for (size_t c = 0; c < table.cases.size(); ++c)
        for (const Method& method : table.methods)
            for (const int threads : bench.threads) {
                const auto limit = limited_to(threads);
                measure(method, job_of(table.cases[c]), table.room[method.name],
                        table.times[{method.name, c, threads}]);
            }
    for (size_t c = 0; c < table.tiny_cases.size(); ++c)
        for (const int threads : bench.threads) {
            const auto limit = limited_to(threads);
            Result result;
            const Stopwatch watch;
            table.brute.run(job_of(table.tiny_cases[c]), result);
            Elapsed took = watch.read();
            const double more = std::pow(
                double(table.cases[c].world->depth[0].size()) / double(table.tiny_cases[c].world->depth[0].size()), 2);
            took.wall_ms *= more, took.cpu_ms *= more;
            table.times[{table.brute.name, c, threads}].whole.push_back(took);
        }
}

ordered_json timing_row(const std::string& method, const Case& c, int threads, const Times& times) {
    ordered_json row = row_head(method, c);
    row["threads"] = threads;
    row.update(spread_of(times.whole));
    if (!times.lift_ms.empty())
        row["stages_wall_ms"] = {{"lift", quantile(times.lift_ms, 0.5)},
                                 {"build", quantile(times.build_ms, 0.5)},
                                 {"cast", quantile(times.cast_ms, 0.5)}};
    if (times.triangles) row["triangles"] = times.triangles, row["bvh_bytes"] = times.bvh_bytes;
    if (times.tiles) row["tiles"] = times.tiles, row["bvh_bytes"] = times.bvh_bytes;
    if (!times.splat_ms.empty()) row["splat_wall_ms"] = quantile(times.splat_ms, 0.5);
    if (method == "brute_force") row["extrapolated_from_width"] = brute_force_width;
    return row;
}

const Method& named(const std::vector<Method>& all, const std::string& name) {
    for (const Method& m : all)
        if (m.name == name) return m;
    throw Error(ExitCode::our_bug, "bench: method: got " + name + ", expected a known one");
}

/// A row of a cost section: one method on one question, a few times.
void cost_row(Bench& bench, const std::string& section, const Method& method, const Case& c, int threads, int rounds,
              ordered_json extra) {
    const auto limit = limited_to(threads);
    Times times;
    Result room;
    for (int i = 0; i < rounds; ++i) measure(method, job_of(c), room, times);
    ordered_json row = timing_row(method.name, c, threads, times);
    row.update(extra);
    bench.out[section].push_back(std::move(row));
}

void plan_resolution(Bench& bench, Plan& plan) {
    const int full = bench.options.picture_width();
    std::vector<int> widths{400, 800, 1600, 3200};
    if (bench.options.quick) widths = {full / 2, full};
    for (const int width : widths) {
        const double area = width * width / 1600.0 / 1600.0;
        plan.add(0.1 + 3 * area, "resolution: " + std::to_string(width), [&bench, width] {
            const World world(bench.street, width, 2);
            std::vector<Method> methods = our_methods();
            methods.push_back(copy_loop());
            for (int own = 0; own < 2; ++own)
                for (const char* name : {"copy", "sweep", "embree_tiles", "embree"}) {
                    if (own > 0 && std::string(name) != "sweep") continue;
                    cost_row(bench, "resolution", named(methods, name), make_question(world, own, moved(0, 2)), 1,
                             width > 1600 ? 1 : 3, {{"width", width}, {"pixels", world.depth[0].size()}});
                    bench.hooks.show(0, 0, "");
                }
        });
    }
}

void plan_shifts(Bench& bench, Plan& plan) {
    const double area = bench.scale() * bench.scale();
    std::vector<Shift> shifts;
    for (const double y : {0.25, 0.5, 1.0, 2.0, 4.0})
        if (!bench.options.quick || y == 0.5 || y == 4) shifts.push_back(moved(0, y));
    for (const double x : {0.5, 2.0})
        if (!bench.options.quick || x == 2) shifts.push_back(moved(x, 0));
    for (const Shift& shift : shifts)
        plan.add(0.02 + 1.7 * area, "against the shift", [&bench, shift] {
            const std::vector<Method> methods = our_methods();
            for (int own = 0; own < 2; ++own)
                for (const char* name : {"sweep", "embree_tiles"})
                    cost_row(bench, "shifts", named(methods, name), make_question(bench.full(), own, shift), 1, 2,
                             {{"metres", glm::length(shift.translation_m)},
                              {"along", shift.translation_m.x != 0 ? "forward" : "sideways"}});
        });
}

void plan_cameras(Bench& bench, Plan& plan) {
    const double area = bench.scale() * bench.scale();
    for (int count = 1; count <= 6; ++count)
        plan.add(0.02 + 1.7 * area * count, "against the number of cameras", [&bench, count] {
            const std::vector<Method> methods = our_methods();
            for (const char* name : {"sweep", "embree_tiles"})
                for (const int threads : bench.threads) {
                    const auto limit = limited_to(threads);
                    const Method& method = named(methods, name);
                    Result room;
                    std::vector<Elapsed> samples;
                    const int rounds = std::string(name) == "sweep" ? 6 : 2;
                    for (int i = 0; i < rounds; ++i) {
                        const Stopwatch watch;
                        for (int own = 0; own < count; ++own)
                            method.run(job_of(make_question(bench.full(), own, moved(0, 2))), room);
                        if (i > 0) samples.push_back(watch.read());
                    }
                    ordered_json row{{"method", name}, {"shift", "0,2,0"}, {"threads", threads}, {"cameras", count}};
                    row.update(spread_of(samples));
                    bench.out["cameras"].push_back(std::move(row));
                }
        });
}

/// The whole rig, frame after frame, every frame with another shift; one camera after the other.
void plan_steady(Bench& bench, Plan& plan) {
    const int frames = bench.options.quick ? 20 : 200;
    const double area = bench.scale() * bench.scale();
    bench.out["steady"] = ordered_json::object();
    plan.add(0.05 + frames * 0.06 * area, "steady state", [&bench, frames] {
        const std::vector<Method> methods = our_methods();
        const Method& sweep = named(methods, "sweep");
        const std::vector<Shift> shifts{moved(0, 2),  moved(0, -1), moved(2, 0),    moved(0, 4),
                                        moved(0, -4), moved(1, 1),  moved(0, 0.25), moved(0.5, -2)};
        const auto limit = limited_to(bench.threads.back());
        Result room;
        std::vector<double> ms;
        uint64_t before = 0;
        const int warm = 8;
        std::vector<Elapsed> samples;
        for (int f = -warm; f < frames; ++f) {
            if (f == 0) before = resident_bytes();
            bench.hooks.show(0, 0, "");
            const Stopwatch watch;
            for (int own = 0; own < 6; ++own)
                sweep.run(job_of(make_question(bench.full(), own, shifts[size_t(f + warm) % shifts.size()])), room);
            if (f >= 0) samples.push_back(watch.read());
        }
        std::vector<double> wall, cpu;
        for (const Elapsed& s : samples) wall.push_back(s.wall_ms), cpu.push_back(s.cpu_ms);
        bench.out["steady"] = {{"method", "sweep"},
                               {"frames", frames},
                               {"cameras", 6},
                               {"threads", bench.threads.back()},
                               {"wall_ms_p50", quantile(wall, 0.5)},
                               {"wall_ms_p99", quantile(wall, 0.99)},
                               {"wall_ms_most", quantile(wall, 1)},
                               {"cpu_ms_p50", quantile(cpu, 0.5)},
                               {"frames_per_second", 1e3 / quantile(wall, 0.5)},
                               {"resident_before_bytes", before},
                               {"resident_after_bytes", resident_bytes()}};
    });
}

}  // namespace

void plan_timing(Bench& bench, Plan& plan) {
    auto table = std::make_shared<Table>();
    bench.out["timing"] = ordered_json::array();
    const double area = bench.scale() * bench.scale();
    plan.add(0.1 + 3 * area, "timing: truth", [&bench, table] {
        table->methods = our_methods();
        for (Method& peer : peer_methods()) table->methods.push_back(std::move(peer));
        table->methods.insert(table->methods.begin(), copy_loop());
        for (const auto& [own, shift] : {std::pair{0, moved(0, 2)}, std::pair{1, moved(0, 2)}}) {
            table->cases.push_back(make_case(bench.full(), own, shift));
            table->tiny_cases.push_back(make_case(bench.world[1], own, shift));
        }
        if (!bench.options.quick) table->cases.push_back(make_case(bench.full(), 0, moved(2, 0)));
    });
    const int rounds = bench.options.quick ? 2 : 5;
    for (int i = 0; i < rounds; ++i) {
        const std::string what = "timing: round " + std::to_string(i + 1) + " of " + std::to_string(rounds);
        plan.add(0.5 + 12 * area, what, [&bench, table] { round_of(bench, *table); });
        if (i % 2 == 0)
            plan.add(2 + 6 * area, what + ", PyTorch", [&bench, table] {
                for (const TorchTime& t : time_torch(bench, table->cases)) {
                    Times& times = table->times[{t.method, t.index, t.threads}];
                    times.whole.push_back(t.took);
                    times.splat_ms.push_back(t.splat_ms);
                }
            });
    }
    plan.add(0.01, "timing: rows", [&bench, table] {
        for (const auto& [key, times] : table->times) {
            const auto& [name, c, threads] = key;
            bench.out["timing"].push_back(timing_row(name, table->cases[c], threads, times));
        }
    });
}

void plan_costs(Bench& bench, Plan& plan) {
    for (const char* section : {"resolution", "cameras", "shifts"}) bench.out[section] = ordered_json::array();
    plan_steady(bench, plan);
    plan_cameras(bench, plan);
    plan_shifts(bench, plan);
    plan_resolution(bench, plan);
}

}  // namespace vshift::bench
