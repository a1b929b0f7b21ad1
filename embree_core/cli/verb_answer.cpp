// SPDX-License-Identifier: Apache-2.0
// vshift mask | holes | warp | seam | condition: one view, or every frame, camera and shift of a set.
#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <memory>

#include "embree_core/answer.h"
#include "embree_core/benchmark_set.h"
#include "embree_core/cli/progress.h"
#include "embree_core/cli/request_options.h"
#include "embree_core/cli/verbs.h"

namespace vshift::cli {
namespace {

namespace fs = std::filesystem;
using nlohmann::ordered_json;

struct Options {
    std::string recipe, output, out_dir, json, csv;
    RequestPairs request;
    std::vector<std::string> channels;
    bool all_frames = false, all_shifts = false;
};

ordered_json row_of(const Request& request, const std::string& shift, const Answer& a) {
    ordered_json row = {{"method", request.from == Source::rig ? "rig" : "self"},
                        {"out", request.out},
                        {"engine", chosen_method(request)},
                        {"shift", shift},
                        {"frame", request.frame},
                        {"camera", request.camera},
                        {"width", a.image.width},
                        {"height", a.image.height},
                        {"read_ms", a.times.read_ms},
                        {"lift_ms", a.times.lift_ms},
                        {"build_ms", a.times.build_ms},
                        {"cast_ms", a.times.cast_ms},
                        {"invalid_px", a.invalid_px},
                        {"sky_px", a.sky_px},
                        {"kept_quads", a.kept_quads},
                        {"torn_quads", a.torn_quads},
                        {"triangles", a.triangles},
                        {"tiles", a.tiles},
                        {"bvh_bytes", a.bvh_bytes},
                        {"centre_hidden", a.centre_hidden}};
    for (size_t c = 0; c < a.image.names.size(); ++c) {
        const std::string& name = a.image.names[c];
        if (name == "R" || name == "G" || name == "B" || name == "Z") continue;
        uint64_t set = 0;
        // Of `source`: pixels that nobody saw.
        for (float v : a.image.planes[c]) set += name == "source" ? v < 0 : v > 0.5f;
        row[name == "source" ? "hole_px" : name + "_px"] = set;
    }
    return row;
}

std::string csv_of(const ordered_json& rows) {
    std::string text;
    for (const auto& row : rows) {
        std::string head, line;
        for (const auto& [key, value] : row.items()) {
            head += (head.empty() ? "" : ",") + key;
            line += (line.empty() ? "" : ",") + (value.is_string() ? value.get<std::string>() : value.dump());
        }
        if (text.empty()) text = head + "\n";
        text += line + "\n";
    }
    return text;
}

/// Text files come last: a folder that is not there is found out before the work.
void require_folder(const std::string& file) {
    std::error_code error;
    const fs::path folder = fs::path(file).parent_path();
    if (file != "-" && !folder.empty() && !fs::is_directory(folder, error))
        throw Error(ExitCode::io_failed,
                    file + ": writing: got " + (error ? error.message() : "no folder") + ", expected a folder for it");
}

/// 16 bits for PNG, which holds no floats; masks are 0 and 65535 there.
std::vector<SampleType> types_of(const fs::path& file) {
    const std::string ending = file.extension().string();
    return {ending == ".png" || ending == ".PNG" ? SampleType::uint16 : SampleType::float32};
}

Channels chosen(const Channels& image, const std::vector<std::string>& names) {
    if (names.empty()) return image;
    Channels out;
    out.width = image.width;
    out.height = image.height;
    out.metadata = image.metadata;
    for (const std::string& name : names) {
        if (out.has(name))
            throw Error(ExitCode::bad_input, "usage: --channels: got " + name + " twice, expected it once");
        out.add(name, image.plane(name));
    }
    return out;
}

void run(const std::string& verb, const Options& options) {
    const Recipe recipe = load_recipe(options.recipe);
    auto pairs = options.request;
    pairs.emplace_back("out", verb);
    const Request base = resolve_request(recipe, pairs);
    const bool many = !options.out_dir.empty();
    if (many == !options.output.empty())
        throw Error(ExitCode::bad_input, "usage: got " + std::string(many ? "both" : "neither") +
                                             " of -o and --out-dir, expected one of them");
    const auto cameras = requested_cameras(recipe, base);
    if (!many && (cameras.size() > 1 || options.all_frames || options.all_shifts))
        throw Error(
            ExitCode::bad_input,
            "usage: got " + std::to_string(cameras.size()) +
                " cameras, all frames or all shifts, expected --out-dir DIR for more than one view (or --camera NAME)");

    require_folder(options.json);
    require_folder(options.csv);

    std::unique_ptr<Manifest> manifest;
    const fs::path set_dir = recipe.folder();
    if (fs::symlink_status(set_dir / "manifest.json").type() != fs::file_type::not_found)
        manifest = std::make_unique<Manifest>(set_dir);
    std::vector<NamedShift> shifts{{shift_name(base.shift), base.shift}};
    if (options.all_shifts) {
        if (!manifest)
            throw Error(ExitCode::io_failed,
                        (set_dir / "manifest.json").string() + ": file: got none, expected the set's list of shifts");
        shifts = manifest->shifts();
    }
    std::vector<int> frames{base.frame};
    if (options.all_frames) {
        frames.clear();
        for (const FrameSpec& f : recipe.frames) frames.push_back(f.index);
    }

    // Results that lie in the set are its items: recorded as they come, and not made twice.
    fs::path item_folder;
    if (many && manifest) {
        std::error_code error;
        const fs::path relative = fs::relative(fs::absolute(options.out_dir), fs::absolute(set_dir),
                                               error);  // absolute: a folder yet to be made has no canonical form
        if (!error && !relative.empty() && *relative.begin() != ".." && relative != ".") item_folder = relative;
    }
    ordered_json rows = ordered_json::array();
    const fs::path run_file = fs::path(options.out_dir) / "run.json";
    ordered_json earlier = ordered_json::array();
    std::error_code run_error;
    if (!item_folder.empty() && fs::exists(run_file, run_error))
        earlier = ordered_json::parse(read_whole_file(run_file, size_t(256) << 20), nullptr, false);
    if (!earlier.is_array()) earlier = ordered_json::array();

    if (!item_folder.empty()) remove_stale_temporaries(set_dir);

    FrameFiles files(recipe);
    Progress progress(verb);
    const size_t total = frames.size() * cameras.size() * shifts.size();
    size_t done = 0;
    bool warned = false;
    for (const int frame : frames)
        for (const NamedShift& shift : shifts)
            for (const std::string& camera : cameras) {
                stop_if_interrupted();
                progress.show(done++, total, camera + " " + shift.name);
                Request request = base;
                request.camera = camera;
                request.frame = frame;
                request.shift = shift.shift;
                const fs::path item = item_path(shift.name, frame, camera);
                if (manifest && options.all_shifts) {
                    const std::string view = (fs::path("shifts") / item).string();
                    if (manifest->is_refused(view)) continue;
                    request.shift = manifest->shift_of(view, shift.shift);
                }
                std::string made_from;
                if (!item_folder.empty()) {
                    std::string asked = canonical_text(request);
                    for (const std::string& channel : options.channels) asked += "&channel=" + channel;
                    made_from = manifest->made_from(asked, input_files(recipe, request));
                }
                if (!item_folder.empty() && manifest->is_done((item_folder / item).string(), made_from)) {
                    for (const auto& row : earlier)
                        if (row.is_object() && row.value("camera", ordered_json()) == camera &&
                            row.value("frame", ordered_json()) == frame &&
                            row.value("shift", ordered_json()) == shift.name)
                            rows.push_back(row);
                    continue;
                }
                const Answer a = answer(recipe, request, files);
                if (a.centre_hidden && !warned) {
                    warned = true;
                    progress.finish();
                    std::fprintf(stderr,
                                 "vshift: warning: %s: %s: shift: the shifted camera stands behind what %s saw, in "
                                 "hidden space or in something\n",
                                 options.recipe.c_str(), camera.c_str(), camera.c_str());
                }
                const fs::path file = many ? fs::path(options.out_dir) / item : fs::path(options.output);
                if (many) make_folders(file.parent_path());
                write_image(file, chosen(a.image, options.channels), types_of(file));
                rows.push_back(row_of(request, shift.name, a));
                if (!item_folder.empty())
                    manifest->record_done(
                        (item_folder / item).string(), verb,
                        (a.times.read_ms + a.times.lift_ms + a.times.build_ms + a.times.cast_ms) / 1000, made_from);
            }
    progress.finish();
    if (!item_folder.empty()) {
        write_whole_file(run_file, rows.dump(1) + "\n");
        manifest->record_done((item_folder / "run.json").string(), "times", 0);
    }
    if (!options.json.empty()) write_text(options.json, rows.dump(1) + "\n");
    if (!options.csv.empty()) write_text(options.csv, csv_of(rows));
}

}  // namespace

void add_answer_verbs(CLI::App& app) {
    const std::pair<const char*, const char*> verbs[] = {
        {"mask", "Recorded view: lost, occluded, outside, unknown, unseen"},
        {"holes", "Shifted view: hole, disoccluded, outside"},
        {"warp", "Shifted view: colours and depth of what the recording saw"},
        {"seam", "Shifted or recorded view: what the own camera lacks, from the neighbours that saw it"},
        {"condition", "The network's input: colours and the shares of own, neighbour and hole"}};
    for (const auto& [name, description] : verbs) {
        CLI::App* sub = app.add_subcommand(name, description);
        auto options = std::make_shared<Options>();
        sub->add_option("recipe", options->recipe, "the .vshift recipe")->required();
        const auto request_key = [&](const char* flags, const std::string& key, const char* help) {
            add_request_key(*sub, options->request, flags, key, help);
        };
        add_view_keys(*sub, options->request, "self or rig: whose depth maps are used");
        request_key("--view", "view", "recorded or shifted");
        request_key("--method", "method", "auto, sweep (masks from the own depth map), raster (views) or embree");
        request_key("--clear_m,--clear-m", "clear_m", "radius round the shifted camera that is taken as free");
        request_key("--depth_source,--depth-source", "depth_source",
                    "auto, exact, half, mm16, disparity8 or mono: what errors depth has");
        const std::string verb = name;
        if (verb == "mask")
            request_key("--certify", "certify", "1: channel `edge`, where a silhouette's sampling decides");
        const bool seam = verb == "seam" || verb == "condition";
        if (seam || verb == "warp")
            request_key("--edge", "edge", "drop or keep: the far side's last half pixel at an edge, which mixes both");
        if (verb == "condition") {
            request_key("--arm", "arm",
                        "virtual_shift, or an ablation: double_warp, literal (recorded), splat (shifted)");
            request_key("--stride", "stride", "means over blocks of so many pixels, 1 to 256");
        }
        if (seam) {
            request_key("--match", "match", "none, exposure (a gain per neighbour) or color (a gain per channel)");
            request_key("--depth_tolerance,--depth-tolerance", "depth_tolerance",
                        "share by which two depths of one surface may differ, 0 to 1");
            const std::pair<const char*, const char*> noises[] = {
                {"exposure", "stops on a neighbour's colours"},
                {"white_balance", "stops of red against blue"},
                {"pose_m", "metres that a neighbour stands wrong"},
                {"pose_deg", "degrees that it is turned wrong"},
                {"time_s", "seconds that it fired wrong"},
                {"depth_scale", "log factor on its depth"},
                {"depth_bias_m", "metres on its depth"},
                {"depth_blur_px", "sigma of a blur of its 1/z"},
                {"depth_field", "rms of a smooth random log factor on its depth"},
                {"seed", "which signs and directions are drawn"}};
            for (const auto& [size, help] : noises) {
                const std::string key = std::string("noise_") + size;
                std::string dashed = key;
                std::replace(dashed.begin(), dashed.end(), '_', '-');
                request_key(("--" + key + ",--" + dashed).c_str(), key, help);
            }
        }
        sub->add_option("-o,--output", options->output, "one image: .exr, .png, .pfm or .npy");
        sub->add_option("--out-dir", options->out_dir, "many images: DIR/SHIFT/FFFF/CAMERA.exr");
        sub->add_option("--channels", options->channels, "only these channels")->delimiter(',');
        sub->add_flag("--all-frames", options->all_frames, "every frame of the recipe");
        sub->add_flag("--all-shifts", options->all_shifts, "every shift of the set's manifest");
        sub->add_option("--json", options->json, "counts and times as JSON; - is standard output");
        sub->add_option("--csv", options->csv, "the same as CSV");
        sub->callback([options, verb] { run(verb, *options); });
    }
}

}  // namespace vshift::cli
