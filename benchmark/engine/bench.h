// SPDX-License-Identifier: Apache-2.0
// Role: `vshift bench`: speed and accuracy of the mask engine and its peers, in one run, as one JSON.
// Parts: accuracy.cpp (what is right), sources.cpp (what depth's source asks for), costs.cpp (what it takes),
// torch_peer.cpp and blender_peer.cpp (peers in Python).
#pragma once
#include <filesystem>
#include <functional>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "benchmark/engine/methods.h"
#include "benchmark/engine/timing.h"

namespace vshift::bench {

using nlohmann::ordered_json;

struct Options {
    bool quick = false;  ///< small pictures, few cases: shows that it works, its figures mean little
    uint32_t seed = 1;
    std::string peer_code;  ///< TrajectoryCrafter's models/utils.py, to be run beside; or empty
    int width = 0;  ///< 0: 1600, or 400 when quick; the height is 9/16 of it
    int picture_width() const { return width ? width : quick ? 400 : 1600; }
};

struct Hooks {
    /// Done and total in seconds as foreseen; may throw to end the run.
    std::function<void(size_t done, size_t total, const std::string& what)> show;
    /// Runs benchmark/peers/torch_splat.py on a folder's job.json. Empty: done; else why not.
    std::function<std::string(const std::filesystem::path& folder)> run_torch;
    /// Runs benchmark/peers/ray_cast.py in Blender, in the same way.
    std::function<std::string(const std::filesystem::path& folder)> run_blender;
    std::filesystem::path scratch;  ///< an existing folder for what is exchanged with them
};

/// Throws Error, and whatever `show` throws. `differences` becomes a picture of where sweep and Embree differ.
ordered_json run_bench(const Options& options, const Hooks& hooks, ColorImage& differences);
/// One scalar a line: section, method, camera, shift, threads, quantity, value.
std::string bench_csv(const ordered_json& bench);

// ---------------------------------------------------------------- parts

/// Steps with the seconds that they are thought to take, so that the time left can be told.
class Plan {
public:
    void add(double seconds, std::string what, std::function<void()> work) {
        steps_.push_back({seconds, std::move(what), std::move(work)});
    }
    /// What every step took: {what, foreseen_s, wall_s, cpu_s}.
    ordered_json run(const Hooks& hooks);

private:
    struct Step {
        double seconds;
        std::string what;
        std::function<void()> work;
    };
    std::vector<Step> steps_;
};

/// What the parts share. Sections of `out` are appended to by name.
struct Bench {
    Options options;
    Hooks hooks;
    analytic::StreetScene street;
    std::vector<World> world;  ///< [0] at the picture's size, [1] for brute force
    std::vector<Case> cases;   ///< truth only: no depth of V
    std::vector<int> threads;  ///< {1, 2}, or {1} on one core
    std::string no_torch = "not asked", no_blender = "not asked";
    ColorImage differences;
    ordered_json out;

    const World& full() const { return world[0]; }
    double scale() const { return double(full().rig[0].intrinsics.width) / 1600; }  ///< of a picture's width
};

/// Scores of classes against a case's truth (accuracy.cpp).
ordered_json score_classes(const Case& c, const Grid<uint8_t>& classes, bool certifies);
/// Pixels changed between two masks over the mean size of the two: 0 steady, 2 nothing in common.
double flicker(const Grid<uint8_t>& a, const Grid<uint8_t>& b);
ordered_json row_head(const std::string& method, const Case& c);

void plan_accuracy(Bench& bench, Plan& plan);
void plan_rig(Bench& bench, Plan& plan);
void plan_timing(Bench& bench, Plan& plan);
void plan_costs(Bench& bench, Plan& plan);
void plan_sources(Bench& bench, Plan& plan);
void plan_torch(Bench& bench, Plan& plan);
void plan_ray_cast(Bench& bench, Plan& plan);
/// Times of the peer in Python, for one round of `plan_timing`: per case and thread count what it took, and
/// how much of it was the splat, the rest being its depth test.
struct TorchTime {
    std::string method;
    size_t index;  ///< into the cases
    int threads;
    Elapsed took;
    double splat_ms;
};
std::vector<TorchTime> time_torch(Bench& bench, const std::vector<Case>& cases);
void summarise(Bench& bench);

}  // namespace vshift::bench
