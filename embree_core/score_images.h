// SPDX-License-Identifier: Apache-2.0
// Role: the filled views of a set against its true shifted renders: per region, over time, across cameras. Stage:
// score.
#pragma once
#include <functional>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "embree_core/benchmark_set.h"

namespace vshift {

/// Arms with results in the set: the folders of fills/, by name.
std::vector<std::string> fill_arms(const Manifest& manifest);

/// Every arm's results. `items` are rows per view and region; `summary`, `temporal` and `overlap` pool them by pixel
/// count, with 95 % intervals by bootstrap over frames (docs/set_layout.md). `progress(done, total, what)` is called
/// between batches.
struct ImageScores {
    nlohmann::ordered_json items, summary, temporal, overlap, times;
};
ImageScores score_images(const Recipe& recipe, const Manifest& manifest,
                         const std::function<void(size_t, size_t, const std::string&)>& progress);

/// `items` as CSV.
std::string image_scores_csv(const nlohmann::ordered_json& items);

/// PSNR, SSIM, MS-SSIM, FLIP and gradient scores as the fields of a row; what is not finite is null.
nlohmann::ordered_json image_score_fields(uint64_t pixels, double psnr_db, double ssim, double ms_ssim, double flip,
                                          double gradient_error, double sharpness);

}  // namespace vshift
