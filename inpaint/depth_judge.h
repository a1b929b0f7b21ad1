// SPDX-License-Identifier: Apache-2.0
// Role: a depth estimator against the truth of analytic streets: its depth, its edges, and the masks that follow from it.
// Stage: score. No Torch here.
#pragma once
#include <cstdint>
#include <functional>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

namespace vshift::inpaint {

struct DepthJudgeOptions {
    std::string model_file;
    bool trust = false;
    std::vector<uint32_t> seeds;  ///< streets that no training saw
    std::vector<double> shifts_m{-4, -2, -1, 1, 2, 4};  ///< to the left
    int width = 400;
    int frame = 20;
};

/// {"depth": over all pixels whose true depth is at most 80 m, estimates beyond that (sky too) taken as 80 m: abs_rel
///   (mean |z' - z| / z), delta1 (share within a factor of 1.25), scale (median over views of the median of z' / z) and
///   its spread (5 %, 95 %), abs_rel after each view's scale is taken out; sky_f1; edges (1/z steps by more than 20 % to
///   the right or lower neighbour, the nearer within 50 m): precision, recall, F1 within 1.5 px, and the median distance
///   of a true edge from the nearest found one in px;
///  "masks": per shift size and source of depth (exact, or mono: the estimator): precision, recall, F1 of `occluded`
///   against the scene inside V's picture, pooled, with a 95 % interval by bootstrap over streets}.
nlohmann::ordered_json judge_depth(const DepthJudgeOptions& options, const std::function<void(size_t, size_t)>& show);

/// "depth" and "masks" as lines for a terminal.
std::string depth_table(const nlohmann::ordered_json& result);

}  // namespace vshift::inpaint
