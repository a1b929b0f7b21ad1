// SPDX-License-Identifier: Apache-2.0
// Role: the methods that `vshift bench` compares, behind one call: a recorded depth map and a shift in,
// classes per pixel out. Ours, and peers in our own short rendering of what others publish.
#pragma once
#include <functional>
#include <string>
#include <vector>

#include "benchmark/engine/cases.h"
#include "embree_core/mask.h"
#include "embree_core/sweep.h"

namespace vshift::bench {

struct Job {
    TrueCamera recorded, shifted;
    const DepthMap* depth = nullptr;
    const DepthMap* shifted_depth = nullptr;  ///< true depth of V, or null
    double clear_m = 2.0;
};
Job job_of(const Case& c);
/// The same question of another depth map.
Job job_of(const Case& c, const DepthMap& depth);

/// What a method leaves. Either `classes` or `masks`, whichever it makes; `classes_of` joins them.
struct Result {
    Grid<uint8_t> classes;  ///< ClassBits
    RecordedMasks masks;
    double lift_ms = -1, build_ms = -1, cast_ms = -1;  ///< -1: not apart
    uint64_t triangles = 0, tiles = 0, bvh_bytes = 0;
};
/// Not part of what is timed.
void join_classes(Result& result);

struct Method {
    std::string name, label;
    std::string group;       ///< "ours", "peer" or "bound"
    std::string note;        ///< what the label cannot say
    bool certifies = false;  ///< says `unknown` and `unseen`
    bool noisy = false;      ///< also run on noisy depth
    std::function<void(const Job&, Result&)> run;
};

std::vector<Method> our_methods();
std::vector<Method> peer_methods();  ///< peers.cpp
/// Reads the depth, writes a byte per pixel: what no method can beat.
Method copy_loop();
/// Every triangle for every ray; only for tiny images. `reference_width` is what it is run at.
Method brute_force();
inline constexpr int brute_force_width = 80;

}  // namespace vshift::bench
