// SPDX-License-Identifier: Apache-2.0
// Role: a model against truth in the disocclusions of true shifted views of analytic streets. Stage: inpaint, score.
#pragma once
#include <cstdint>
#include <functional>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

namespace vshift::inpaint {

struct JudgeOptions {
    std::string model_file;
    std::vector<uint32_t> seeds;  ///< streets that no training saw
    std::vector<double> shifts_m{-4, -2, -1, 1, 2, 4};  ///< to the left
    int width = 256;
    int frame = 20;
    std::vector<int> steps{1};  ///< of flow models
    uint64_t noise_seed = 1;
};

/// {"views": one row per street, camera, shift and number of steps, with sums over its disoccluded pixels;
///  "pooled": per shift size and number of steps: PSNR over display values of every classical fill and of the network, its
///  gain over the best of them with a 95 % interval (bootstrap over streets, the best fill of each draw), the gradient
///  energy of the background fill and of the network as a share of the truth's, and ms per view}.
nlohmann::ordered_json judge_streets(const JudgeOptions& options, const std::function<void(size_t, size_t)>& show);

/// "pooled" as lines for a terminal.
std::string judge_table(const nlohmann::ordered_json& result);

}  // namespace vshift::inpaint
