// SPDX-License-Identifier: Apache-2.0
// Role: models against truth in the disocclusions of true shifted views of analytic streets. Stage: inpaint, score.
#pragma once
#include <cstdint>
#include <functional>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

namespace vshift::inpaint {

struct JudgeOptions {
    std::vector<std::string> model_files;  ///< the first is the one in question
    std::vector<uint32_t> seeds;           ///< streets that no training saw
    std::vector<double> shifts_m{-4, -2, -1, 1, 2, 4};  ///< to the left
    int width = 256;
    int frame = 20;
    std::vector<int> steps{1};  ///< of flow models
    uint64_t noise_seed = 1;
};

/// {"views": one row per street, camera, shift and way to fill, with sums over its disoccluded pixels;
///  "ways": a row per shift size (0: all of them) and way: a classical fill, or a model's name (and steps, of flow). PSNR
///  over display values in the disocclusions, its gain over the best classical fill, PSNR in what is outside the recorded
///  frame, gradient energy as a share of the truth's, texture distance (texture.h), and CPU ms of a view: mean and least}.
/// Models that were trained with neighbours see them; "seam+background" is such a view with the rest filled as "background" does.
/// Intervals are 95 %, by bootstrap over streets (gain: over the best fill of each draw).
nlohmann::ordered_json judge_streets(const JudgeOptions& options, const std::function<void(size_t, size_t)>& show);

/// "ways" as lines for a terminal.
std::string judge_table(const nlohmann::ordered_json& result);

}  // namespace vshift::inpaint
