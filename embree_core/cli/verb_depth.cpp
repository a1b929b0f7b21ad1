// SPDX-License-Identifier: Apache-2.0
// vshift depth: depth maps of every camera and frame from pictures alone, and a recipe that names them.
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <memory>

#include <nlohmann/json.hpp>

#include "embree_core/answer.h"
#include "embree_core/benchmark_set.h"
#include "embree_core/cli/progress.h"
#include "embree_core/cli/run_program.h"
#include "embree_core/cli/verbs.h"
#include "embree_core/image_file.h"
#include "inpaint/depth_estimator.h"

namespace vshift::cli {
namespace {

namespace fs = std::filesystem;
using nlohmann::ordered_json;

struct Options {
    std::string recipe, output, model;
    bool trust = false;
};

/// The recipe's text with every camera's depth replaced.
std::string with_depth(const Recipe& recipe, const std::string& folder) {
    auto json = ordered_json::parse(read_whole_file(recipe.file, size_t(64) << 20));
    for (ordered_json& camera : json["cameras"]) {
        for (const char* key : {"depth_channel", "depth_scale_m"}) camera.erase(key);
        camera["depth"] = folder + "/%04d/" + camera["name"].get<std::string>() + ".exr";
        camera["depth_source"] = depth_source_words()[size_t(DepthSource::mono)];
    }
    json.erase("depth_source");
    return json.dump(2) + "\n";
}

void run(const Options& o) {
    const Recipe recipe = load_recipe(o.recipe);
    const fs::path output = o.output;
    std::error_code error;
    if (output.extension() != ".vshift" || fs::weakly_canonical(fs::absolute(output).parent_path(), error) !=
                                               fs::weakly_canonical(fs::absolute(recipe.folder()), error))
        throw Error(ExitCode::bad_input, "usage: -o: got " + o.output + ", expected a .vshift file in the recipe's folder, " +
                                             recipe.folder().string() + " (it names the same pictures)");
    if (fs::equivalent(output, recipe.file, error))
        throw Error(ExitCode::bad_input, "usage: -o: got the recipe itself, expected another file");
    const std::string model = o.model.empty() ? source_program("depth", "inpaint/models/depth_streets.safetensors") : o.model;
    std::unique_ptr<Manifest> manifest;
    if (fs::symlink_status(recipe.folder() / "manifest.json").type() != fs::file_type::not_found)
        manifest = std::make_unique<Manifest>(recipe.folder());

    const inpaint::DepthEstimator estimator(model, o.trust);
    const std::string folder = output.stem().string();
    FrameFiles files(recipe);
    Progress progress("depth");
    const size_t total = recipe.frames.size() * recipe.cameras.size();
    size_t done = 0, made = 0;
    for (const FrameSpec& frame : recipe.frames)
        for (const CameraSpec& camera : recipe.cameras) {
            stop_if_interrupted();
            progress.show(done++, total, camera.name);
            const fs::path item = item_path(folder, frame.index, camera.name);
            std::string from;
            if (manifest) {
                std::vector<fs::path> inputs{model};
                if (!camera.image.empty()) inputs.push_back(recipe.path(camera.image, frame.index));
                from = manifest->made_from("depth", inputs);
                if (manifest->is_done(item.string(), from)) continue;
            }
            const auto start = std::chrono::steady_clock::now();
            const DepthMap depth =
                estimator.depth(files.color(camera.name, frame.index), camera.intrinsics, camera.ego_from_cam);
            Channels image;
            image.width = depth.width, image.height = depth.height;
            image.add("Z", depth.data);
            image.metadata = {{"vshift.out", "depth"}, {"vshift.depth_model", fs::path(model).filename().string()}};
            make_folders((recipe.folder() / item).parent_path());
            write_image(recipe.folder() / item, image);
            ++made;
            if (manifest)
                manifest->record_done(item.string(), "depth",
                                      std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count(), from);
        }
    progress.finish();
    write_whole_file(output, with_depth(recipe, folder));
    std::printf("%s: %zu depth maps in %s, %zu of them new\n", o.output.c_str(), total, (recipe.folder() / folder).c_str(), made);
}

}  // namespace

void add_depth_verb(CLI::App& app) {
    CLI::App* sub = app.add_subcommand("depth", "Depth maps from pictures alone, and a recipe that names them");
    auto o = std::make_shared<Options>();
    sub->add_option("recipe", o->recipe, "the .vshift recipe; its cameras need no depth")->required();
    sub->add_option("-o,--output", o->output, "the new recipe, in the same folder; NAME.vshift has its maps in NAME/")->required();
    sub->add_option("--depth-model", o->model,
                    "a .safetensors file of vshift train --kind depth (none: the one that comes along), or TorchScript");
    sub->add_flag("--trust-model", o->trust, "load TorchScript, a program of its author: colors [1,3,H,W] to z in metres");
    sub->callback([o] {
        wait_without_spinning();
        run(*o);
    });
}

}  // namespace vshift::cli
