// SPDX-License-Identifier: Apache-2.0
// vshift score: a whole set against its truth, or one image against another.
#include <cmath>
#include <cstdio>
#include <memory>

#include "embree_core/benchmark_set.h"
#include "embree_core/cli/progress.h"
#include "embree_core/cli/verbs.h"
#include "embree_core/image_file.h"
#include "embree_core/score_images.h"

namespace vshift::cli {
namespace {

namespace fs = std::filesystem;
using nlohmann::ordered_json;

struct Options {
    std::string recipe, got, truth, region, output, csv;
    double min_f1 = -1;
};

/// The smallest F1 of the `lost` rows against the shell, and what it belongs to.
void hold_threshold(const ordered_json& scores, double min_f1) {
    if (min_f1 < 0) return;
    const auto judge = [&](const std::string& what, double f1) {
        if (f1 < min_f1)
            throw Error(ExitCode::below_threshold, what + ": f1: got " + ordered_json(f1).dump() +
                                                       ", expected at least " + ordered_json(min_f1).dump());
    };
    if (scores.contains("channels")) {
        for (const auto& [name, row] : scores["channels"].items()) judge(name, row["f1"]);
        return;
    }
    for (const auto& row : scores["masks"])
        if (row["class"] == "lost" && row["against"] == "shell")
            judge(row["method"].get<std::string>() + " " + row["shift"].get<std::string>() + ": " +
                      row["camera"].get<std::string>(),
                  row["f1"]);
}

void run(const Options& options) {
    const bool pair = !options.got.empty() || !options.truth.empty();
    if (pair == !options.recipe.empty() || (pair && (options.got.empty() || options.truth.empty())))
        throw Error(ExitCode::bad_input,
                    "usage: got neither a set nor a pair of images, expected RECIPE, or --got IMAGE --truth IMAGE");
    if (!pair && !options.region.empty())
        throw Error(ExitCode::bad_input, "usage: --region: got a set, expected it with --got IMAGE --truth IMAGE");
    if (std::isnan(options.min_f1))
        throw Error(ExitCode::bad_input, "usage: --min-f1: got nan, expected a number from 0 to 1");
    if (pair) {
        const ordered_json scores = score_pair(options.got, options.truth, options.region);
        write_text(options.output.empty() ? "-" : options.output,
                   scores.dump(1, ' ', false, ordered_json::error_handler_t::replace) +
                       "\n");  // a file's name need not be UTF-8
        hold_threshold(scores, options.min_f1);
        return;
    }
    const Recipe recipe = load_recipe(options.recipe);
    const fs::path folder = recipe.folder();
    Manifest manifest(folder);
    Progress progress("score");
    const ordered_json scores = score_set(recipe, manifest, [&](size_t done, size_t total, const std::string& what) {
        stop_if_interrupted();
        progress.show(done, total, what);
    });
    progress.finish();
    fs::path json = options.output, csv = options.csv;
    const bool in_set = json.empty();
    if (in_set) {
        json = folder / "scores" / "scores.json";
        if (csv.empty()) csv = folder / "scores" / "scores.csv";
        make_folders(json.parent_path());
    }
    write_text(json.string(), scores.dump(1) + "\n");
    if (!csv.empty()) write_text(csv.string(), scores_csv(scores));
    const bool images = in_set && scores.contains("images");
    if (images) write_text((folder / "scores" / "images.csv").string(), image_scores_csv(scores["images"]));
    if (in_set) {
        manifest.record_done("scores/scores.json", "scores", 0);
        if (images) manifest.record_done("scores/images.csv", "scores", 0);
        if (options.csv.empty()) manifest.record_done("scores/scores.csv", "scores", 0);
    }
    hold_threshold(scores, options.min_f1);
}

}  // namespace

void add_score_verb(CLI::App& app) {
    CLI::App* sub =
        app.add_subcommand("score", "Masks, holes, warps and fills of a set against its truth, or one image against another");
    auto options = std::make_shared<Options>();
    sub->add_option("recipe", options->recipe, "set.vshift of a benchmark set");
    sub->add_option("--got", options->got, "one image to judge");
    sub->add_option("--truth", options->truth, "the image to judge it by");
    sub->add_option("--region", options->region, "of a pair: only where this image's first channel is above 0.5");
    sub->add_option("-o,--output", options->output,
                    "JSON; default: scores/scores.json in the set, or standard output for a pair");
    sub->add_option("--csv", options->csv, "CSV of the mask and hole rows");
    sub->add_option("--min-f1", options->min_f1,
                    "exit 2 when a pair's channel, or a set's lost mask against the shell, stays below this F1")
        ->check(CLI::Range(0.0, 1.0));
    sub->callback([options] { run(*options); });
}

}  // namespace vshift::cli
