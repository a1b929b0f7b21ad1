// SPDX-License-Identifier: Apache-2.0
// vshift report: hands over to benchmark/report (Python: matplotlib and Jinja2 draw the page).
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <memory>

#include "embree_core/cli/verbs.h"
#include "embree_core/recipe.h"

namespace vshift::cli {
namespace {

namespace fs = std::filesystem;

struct Options {
    std::string recipe, output, strip;
};

/// The report's program: in the source tree that this was built from, or beside an installed vshift.
fs::path report_program() {
    const fs::path within = fs::path("benchmark") / "report" / "make_report.py";
    std::error_code error;
    const fs::path self = fs::read_symlink("/proc/self/exe", error);
    for (const fs::path& root : {self.parent_path() / ".." / "share" / "vshift", fs::path(VSHIFT_SOURCE_DIR)})
        if (fs::exists(root / within)) return root / within;
    throw Error(ExitCode::io_failed,
                "report: program: got none beside " + self.string() + ", expected " + within.string());
}

void run(const Options& options) {
    const Recipe recipe = load_recipe(options.recipe);
    const fs::path folder = recipe.folder();
    const char* chosen = std::getenv("VSHIFT_PYTHON");
    std::vector<std::string> words = {chosen && *chosen ? chosen : VSHIFT_PYTHON, report_program().string(),
                                      folder.string()};
    if (!options.output.empty()) words.insert(words.end(), {"-o", options.output});
    if (!options.strip.empty()) words.insert(words.end(), {"--strip", options.strip});
    std::vector<char*> argv;
    for (std::string& word : words) argv.push_back(word.data());
    argv.push_back(nullptr);
    execv(argv[0], argv.data());
    throw Error(ExitCode::io_failed,
                "report: python: got " + std::string(std::strerror(errno)) + ", expected to start " + words[0]);
}

}  // namespace

void add_report_verb(CLI::App& app) {
    CLI::App* sub = app.add_subcommand("report", "One HTML page of a scored set; opens offline");
    auto options = std::make_shared<Options>();
    sub->add_option("recipe", options->recipe, "set.vshift of a scored set")->required();
    sub->add_option("-o,--output", options->output, "default: report.html in the set");
    sub->add_option("--strip", options->strip, "also a PNG strip of the front camera");
    sub->callback([options] { run(*options); });
}

}  // namespace vshift::cli
