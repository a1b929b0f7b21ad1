// SPDX-License-Identifier: Apache-2.0
// vshift bench: speed and accuracy of the mask engine and its peers (benchmark/engine), and their charts
// (benchmark/charts, Python with matplotlib).
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <memory>

#include "benchmark/engine/bench.h"
#include "embree_core/cli/progress.h"
#include "embree_core/cli/run_program.h"
#include "embree_core/cli/verbs.h"
#include "embree_core/image_file.h"

namespace vshift::cli {
namespace {

namespace fs = std::filesystem;

struct Options {
    bench::Options bench;
    std::string output = "out/bench";
};

/// Removed with all that is in it.
struct Scratch {
    fs::path folder;
    explicit Scratch(const fs::path& beside) : folder(beside / ".exchange") { make_folders(folder); }
    ~Scratch() {
        std::error_code ignored;
        fs::remove_all(folder, ignored);
    }
};

std::string run_torch(const fs::path& folder) {
    const ProgramRun run = run_program({python_program(), source_program("bench", "benchmark/peers/torch_splat.py"), folder.string()},
                                       {"PYTHONDONTWRITEBYTECODE=1"}, ".", 180);
    return run.code == 0 ? "" : run.code == 77 ? "no torch here" : run.told();
}

std::string run_blender(const fs::path& folder) {
    const std::string blender = program_on_path("blender");
    if (blender.empty()) return "no blender here";
    const ProgramRun run = run_program({blender, "-b", "--factory-startup", "--python-exit-code", "3", "-P",
                                        source_program("bench", "benchmark/peers/ray_cast.py"), "--", folder.string()},
                                       {"PYTHONDONTWRITEBYTECODE=1"}, ".", 120);
    return run.code == 0 ? "" : run.told();
}

void run(const Options& options) {
    const fs::path folder = options.output;
    make_folders(folder);
    const Scratch scratch(folder);
    Progress progress("bench");
    bench::Hooks hooks;
    hooks.scratch = scratch.folder;
    hooks.run_torch = run_torch;
    hooks.run_blender = run_blender;
    hooks.show = [&](size_t done, size_t total, const std::string& what) {
        stop_if_interrupted();
        progress.show(done, total, what);
    };
    ColorImage differences;
    const bench::ordered_json result = bench::run_bench(options.bench, hooks, differences);
    progress.finish();
    Channels picture;
    picture.width = differences.width, picture.height = differences.height;
    picture.add_color(differences);
    write_image(folder / "differences.png", picture, {SampleType::uint8});
    write_whole_file(folder / "bench.json", result.dump(1) + "\n");
    write_whole_file(folder / "bench.csv", bench::bench_csv(result));
    const ProgramRun charts =
        run_program({python_program(), source_program("bench", "benchmark/charts/speed_accuracy.py"), (folder / "bench.json").string()},
                    {"PYTHONDONTWRITEBYTECODE=1"}, ".", 120);
    if (charts.code != 0)
        throw Error(ExitCode::io_failed, "bench: charts: got " + charts.told() + ", expected them drawn");
    std::printf("%s\n", charts.output.c_str());
}

}  // namespace

void add_bench_verb(CLI::App& app) {
    CLI::App* sub = app.add_subcommand("bench", "Speed and accuracy of the masks on analytic streets, with charts");
    auto options = std::make_shared<Options>();
    sub->add_option("-o,--output", options->output, "folder for bench.json, bench.csv and charts")
        ->capture_default_str();
    sub->add_flag("--quick", options->bench.quick, "small and few: shows that it works");
    sub->add_option("--seed", options->bench.seed, "of the street")->capture_default_str();
    sub->add_option("--width", options->bench.width, "of the pictures; default 1600, or 400 with --quick");
    sub->add_option("--peer-code", options->bench.peer_code,
                    "TrajectoryCrafter's models/utils.py: its own warp is measured beside")
        ->check(CLI::ExistingFile);
    sub->callback([options] { run(*options); });
}

}  // namespace vshift::cli
