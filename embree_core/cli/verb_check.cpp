// SPDX-License-Identifier: Apache-2.0
// vshift check: a recipe and the files it names, or a whole set by its hashes; --plugin: an installed plugin.
#include <cstdio>
#include <memory>

#include "embree_core/answer.h"
#include "embree_core/benchmark_set.h"
#include "embree_core/cli/plugin_check.h"
#include "embree_core/cli/progress.h"
#include "embree_core/cli/verbs.h"
#include "embree_core/trace.h"

namespace vshift::cli {
namespace {

namespace fs = std::filesystem;

void run(const std::string& recipe_file) {
    if (!tracer_self_test())
        throw Error(ExitCode::our_bug, "embree: self test: got a miss on a known quad, expected a hit");
    const Recipe recipe = load_recipe(recipe_file);
    FrameFiles files(recipe);
    Progress progress("check");
    const size_t total = recipe.frames.size() * recipe.cameras.size();
    size_t done = 0;
    uint64_t invalid = 0, sky = 0, pixels = 0;
    for (const FrameSpec& frame : recipe.frames)
        for (const CameraSpec& camera : recipe.cameras) {
            stop_if_interrupted();
            progress.show(done++, total, camera.name);
            Request as_stored;
            as_stored.frame = frame.index;
            as_stored.depth_source = DepthSource::exact;
            if (!camera.depth.empty()) {
                const DepthMap& depth = files.depth(as_stored, camera.name);
                for (float z : depth.data) {
                    sky += is_sky(z);
                    invalid += !is_sky(z) && !is_measured(z);
                }
                pixels += depth.size();
            }
            if (!camera.image.empty()) files.color(camera.name, frame.index);
        }
    progress.finish();
    std::printf("%s: %zu cameras, %zu frames, %llu depth pixels: %llu sky, %llu without a measurement\n",
                recipe_file.c_str(), recipe.cameras.size(), recipe.frames.size(), (unsigned long long)pixels,
                (unsigned long long)sky, (unsigned long long)invalid);

    const fs::path folder = recipe.folder();
    if (fs::symlink_status(folder / "manifest.json").type() == fs::file_type::not_found) return;
    const SetCheck set = check_set(Manifest(folder), [&](size_t position, size_t count, const std::string& name) {
        stop_if_interrupted();
        progress.show(position, count, name);
    });
    progress.finish();
    std::printf("%s: %llu done, %llu planned, %llu refused, %zu faults\n", (folder / "manifest.json").c_str(),
                (unsigned long long)set.done, (unsigned long long)set.planned, (unsigned long long)set.refused,
                set.faults.size());
    for (size_t i = 1; i < set.faults.size() && i < 20; ++i)
        std::fprintf(stderr, "vshift: %s\n", set.faults[i].c_str());
    if (!set.faults.empty()) throw Error(ExitCode::bad_input, set.faults[0]);
}

}  // namespace

void add_check_verb(CLI::App& app) {
    CLI::App* sub = app.add_subcommand(
        "check", "Validates a recipe and every file it names, a set's files by their sha256; or an installed plugin");
    auto recipe = std::make_shared<std::string>();
    auto plugin = std::make_shared<std::string>();
    const CLI::Option* named = sub->add_option("recipe", *recipe, "the .vshift recipe");
    const CLI::Option* wanted =
        sub->add_option(
               "--plugin", *plugin,
               "instead: what keeps oiiotool from using the plugin, step by step with what to do; default: the "
               "one on OIIO_LIBRARY_PATH, else the one in ../lib beside this program")
            ->type_name("[FOLDER_OR_FILE]")
            ->expected(0, 1);
    sub->callback([=] {
        if ((named->count() > 0) == (wanted->count() > 0))
            throw Error(ExitCode::bad_input, "usage: check: got " +
                                                 std::string(named->count() > 0 ? "both" : "neither") +
                                                 " of a recipe and --plugin, expected one of them");
        if (wanted->count() > 0)
            check_plugin(*plugin);
        else
            run(*recipe);
    });
}

}  // namespace vshift::cli
