// SPDX-License-Identifier: Apache-2.0
// vshift inpaint: the shifted view with its holes filled, one view or every frame, camera and shift of a set.
#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <limits>
#include <memory>
#include <optional>
#include <sstream>

#include "embree_core/answer.h"
#include "embree_core/benchmark_set.h"
#include "embree_core/cli/progress.h"
#include "embree_core/cli/request_options.h"
#include "embree_core/cli/run_program.h"
#include "embree_core/cli/verbs.h"
#include "embree_core/fill.h"
#include "embree_core/stopwatch.h"
#include "embree_core/words.h"
#include "inpaint/network_fill.h"
#include "inpaint/network_library.h"

namespace vshift::cli {
namespace {

namespace fs = std::filesystem;
using nlohmann::ordered_json;

constexpr const char* network_method = "network";

struct Options {
    std::string recipe, output, out_dir, json, model;
    std::vector<std::string> methods = {"background"};
    RequestPairs request;
    int euler_steps = 1;
    bool seam = false, all_frames = false, all_shifts = false;

    bool network() const { return std::count(methods.begin(), methods.end(), network_method) > 0; }
};

void check_method(const std::string& name) {
    auto names = fill_method_names();
    names.push_back(network_method);
    if (!std::count(names.begin(), names.end(), name))
        throw Error(ExitCode::bad_input, "usage: --method: got '" + name +
                                             "', expected background, pushpull, telea, ns or "
                                             "network (nearest: " +
                                             nearest_word(name, names) + ")");
}

/// The seam as a warp: what it has no color for is a hole.
Channels warp_of_seam(const Recipe& recipe, Request request, FrameFiles& files) {
    request.out = "seam";
    request.from = Source::self;
    Answer seam = answer(recipe, request, files);
    Channels out;
    out.width = seam.image.width, out.height = seam.image.height;
    out.metadata = seam.image.metadata;
    for (const char* name : {"R", "G", "B"}) out.add(name, seam.image.plane(name));
    out.add("Z", std::move(seam.seam_z));
    std::istringstream names(seam.image.metadata.at("vshift.sources"));
    int own = 0;
    for (std::string name; names >> name && name != request.camera;) ++own;
    std::vector<float> hole = seam.image.plane("source"), neighbor = hole;
    for (float& source : hole) source = source < 0;
    for (float& source : neighbor) source = source >= 0 && source != float(own);
    out.add("hole", std::move(hole));
    out.add("neighbor", std::move(neighbor));
    return out;
}

/// A warp taken apart into what a fill needs.
struct Warped {
    ColorImage color;
    Mask hole;
    std::optional<Mask> neighbor;  ///< of a seam
    DepthMap depth;

    explicit Warped(const Channels& warp)
        : color(warp.color()), hole(warp.width, warp.height), depth(warp.width, warp.height) {
        const auto& holes = warp.plane("hole");
        for (size_t i = 0; i < hole.size(); ++i) hole.data[i] = holes[i] > 0.5f;
        depth.data = warp.plane("Z");
        if (!warp.has("neighbor")) return;
        const auto& neighbors = warp.plane("neighbor");
        neighbor.emplace(warp.width, warp.height);
        for (size_t i = 0; i < color.size(); ++i) neighbor->data[i] = neighbors[i] > 0.5f;
    }
};

Channels filled_image(const Channels& warp, const ColorImage& color, const std::string& method) {
    Channels out;
    out.width = warp.width;
    out.height = warp.height;
    out.metadata = warp.metadata;
    out.metadata["vshift.out"] = "inpaint";
    out.metadata["vshift.fill"] = method;
    out.add_color(color);
    out.add("hole", warp.plane("hole"));
    return out;
}

/// Where a folder of results lies in the set, empty when outside.
fs::path folder_in_set(const fs::path& folder, const fs::path& set_dir) {
    std::error_code error;
    const fs::path relative = fs::relative(fs::absolute(folder), fs::absolute(set_dir), error);
    return !error && !relative.empty() && *relative.begin() != ".." && relative != "." ? relative : fs::path();
}

class Run {
public:
    explicit Run(const Options& options) : options_(options), recipe_(load_recipe(options.recipe)), files_(recipe_) {
        auto pairs = options.request;
        pairs.emplace_back("out", "warp");
        base_ = resolve_request(recipe_, pairs);
        // A sample that mixes both sides of an edge is nearer to the truth than what a fill puts there (measured.md). A
        // seam drops it where a neighbour has a better one.
        if (!options.seam) base_.edge = "keep";
        for (const std::string& method : options.methods) {
            check_method(method);
            if (std::count(options.methods.begin(), options.methods.end(), method) > 1)
                throw Error(ExitCode::bad_input, "usage: --method: got " + method + " twice, expected it once");
        }
        if (options.network() == options.model.empty())
            throw Error(ExitCode::bad_input,
                        options.network()
                            ? "usage: --model: got none, expected the network's file (of vshift train)"
                            : "usage: --model: got " + options.model + " without --method network, expected both");
        many_ = !options.out_dir.empty();
        if (many_ == !options.output.empty())
            throw Error(ExitCode::bad_input, "usage: got " + std::string(many_ ? "both" : "neither") +
                                                 " of -o and --out-dir, expected one of them");
        cameras_ = requested_cameras(recipe_, base_);
        if (!many_ && (cameras_.size() > 1 || options.all_frames || options.all_shifts || options.methods.size() > 1))
            throw Error(ExitCode::bad_input,
                        "usage: got more than one view or method, expected --out-dir DIR for them (or --camera NAME)");
        if (fs::symlink_status(recipe_.folder() / "manifest.json").type() != fs::file_type::not_found)
            manifest_ = std::make_unique<Manifest>(recipe_.folder());
        if (options.all_shifts && !manifest_)
            throw Error(ExitCode::io_failed, (recipe_.folder() / "manifest.json").string() +
                                                 ": file: got none, expected the set's list of shifts");
        if (many_ && manifest_) in_set_ = folder_in_set(options.out_dir, recipe_.folder());
        if (!in_set_.empty()) remove_stale_temporaries(recipe_.folder());
        if (options.network()) {
            network_ = std::make_unique<inpaint::NetworkFill>(options.model, options.euler_steps);
            inpaint::warn_of_slow_blas(inpaint::all_threads());
        }
    }

    void all() {
        std::vector<NamedShift> shifts{{shift_name(base_.shift), base_.shift}};
        if (options_.all_shifts) shifts = manifest_->shifts();
        std::vector<int> frames{base_.frame};
        if (options_.all_frames) {
            frames.clear();
            for (const FrameSpec& f : recipe_.frames) frames.push_back(f.index);
        }
        const bool streams = network_ && network_->looks_back();
        std::vector<std::string> alone = options_.methods;  // what takes views one by one
        if (streams) std::erase(alone, network_method);
        total_ = frames.size() * shifts.size() * cameras_.size() * (size_t(!alone.empty()) + size_t(streams));
        for (const int frame : frames)
            for (const NamedShift& shift : shifts)
                for (const std::string& camera : cameras_)
                    if (const auto view = view_of(frame, shift, camera); !alone.empty()) {
                        tick(camera + " " + shift.name);
                        if (view) one(*view, alone);
                    }
        for (const NamedShift& shift : shifts)  // one stream at a time: what it remembers is large
            for (const std::string& camera : cameras_)
                if (streams) stream(frames, shift, camera);
        progress_.finish();
        if (many_)
            for (const std::string& method : options_.methods) write_times(method);
        if (!options_.json.empty()) write_text(options_.json, rows_.dump(1) + "\n");
    }

private:
    std::string arm(const std::string& method) const {
        return (options_.seam ? "seam-" : base_.from == Source::rig ? "rig-" : "self-") + method;
    }

    struct View {
        Request request;
        std::string shift;
        fs::path item;
    };
    /// None where the set has refused it.
    std::optional<View> view_of(int frame, const NamedShift& shift, const std::string& camera) const {
        View view{base_, shift.name, item_path(shift.name, frame, camera)};
        view.request.camera = camera;
        view.request.frame = frame;
        view.request.shift = shift.shift;
        if (manifest_ && options_.all_shifts) {
            const std::string item = (fs::path("shifts") / view.item).string();
            if (manifest_->is_refused(item)) return std::nullopt;
            view.request.shift = manifest_->shift_of(item, shift.shift);
        }
        return view;
    }

    void tick(const std::string& what) {
        stop_if_interrupted();
        progress_.show(done_++, total_, what);
    }

    /// What a fill in the set is made from, as the manifest records it. Empty outside of a set.
    std::string made_from(Request request, const std::string& method) const {
        if (in_set_.empty()) return "";
        if (options_.seam) request.out = "seam";
        std::vector<fs::path> files = input_files(recipe_, request);
        std::string text = canonical_text(request) + "&fill=" + method;
        if (method == network_method) {
            files.push_back(options_.model);
            text += "&euler_steps=" + std::to_string(options_.euler_steps);
        }
        return manifest_->made_from(text, files);
    }

    bool is_done(const View& view, const std::string& method, const std::string& from) const {
        return !in_set_.empty() && manifest_->is_done((in_set_ / arm(method) / view.item).string(), from);
    }

    /// A view's warp, on its way to be filled.
    struct Begun {
        Channels warp;
        Warped warped;
        Elapsed took;
        HoledView holed() const { return {warped.color, warped.hole, warped.depth}; }
        inpaint::NetworkView to_network() const { return {holed(), warped.neighbor ? &*warped.neighbor : nullptr}; }
    };
    Begun begun(const View& view) {
        const Stopwatch watch;
        Channels warp =
            options_.seam ? warp_of_seam(recipe_, view.request, files_) : answer(recipe_, view.request, files_).image;
        const Elapsed took = watch.read();
        Warped warped(warp);
        return {std::move(warp), std::move(warped), took};
    }

    void one(const View& view, const std::vector<std::string>& methods) {
        std::vector<std::string> left;
        for (const std::string& method : methods)
            if (!is_done(view, method, made_from(view.request, method))) left.push_back(method);
        if (left.empty()) return;
        const Begun b = begun(view);
        for (const std::string& method : left) {
            const Stopwatch watch;
            const ColorImage color = method == network_method ? network_->next({b.to_network()})[0]
                                                              : fill(b.holed(), fill_method(method, "usage: --method"));
            store(view, b, color, method, watch.read(), made_from(view.request, method));
        }
    }

    /// The frames of one camera and shift by a model that looks back. Where an earlier run was cut, what is left
    /// depends on frames that are there: those are filled again, to be remembered, and not written.
    void stream(const std::vector<int>& frames, const NamedShift& shift, const std::string& camera) {
        struct Frame {
            View view;
            std::string from;
            bool done;
        };
        std::vector<Frame> all;
        for (const int frame : frames)
            if (auto view = view_of(frame, shift, camera)) all.push_back({std::move(*view), "", false});
        const auto end_of = [&](size_t at) {
            return std::min(all.size(), at + (at == 0 ? 1 : size_t(network_->piece())));
        };
        size_t needed = 0;  // so many, from the first
        std::string past;
        for (size_t at = 0, end; at < all.size(); at = end) {
            end = end_of(at);
            // A piece's frames are made together, after all before them.
            for (size_t i = at; i < end; ++i) past += all[i].from = made_from(all[i].view.request, network_method);
            past = sha256_of(past);
            for (size_t i = at; i < end; ++i) {
                if (!in_set_.empty()) all[i].from += " after=" + past.substr(0, 16);
                all[i].done = is_done(all[i].view, network_method, all[i].from);
                if (!all[i].done) needed = end;
            }
        }
        network_->begin();
        for (size_t at = 0, end; at < needed; at = end) {
            end = end_of(at);
            std::vector<Begun> piece;
            std::vector<inpaint::NetworkView> holed;
            for (size_t i = at; i < end; ++i) {
                tick(camera + " " + shift.name);
                piece.push_back(begun(all[i].view));
            }
            for (const Begun& b : piece) holed.push_back(b.to_network());
            const Stopwatch watch;
            const std::vector<ColorImage> colors = network_->next(holed);
            Elapsed took = watch.read();
            took.wall_ms /= double(end - at), took.cpu_ms /= double(end - at);
            for (size_t i = at; i < end; ++i)
                if (!all[i].done) store(all[i].view, piece[i - at], colors[i - at], network_method, took, all[i].from);
        }
        done_ += frames.size() - needed;
    }

    void store(const View& view, const Begun& b, const ColorImage& color, const std::string& method,
               const Elapsed& took, const std::string& from) {
        const fs::path file = many_ ? fs::path(options_.out_dir) / arm(method) / view.item : fs::path(options_.output);
        if (many_) make_folders(file.parent_path());
        write_image(file, filled_image(b.warp, color, method),
                    {file.extension() == ".png" ? SampleType::uint16 : SampleType::float32});
        rows_.push_back({{"arm", arm(method)},
                         {"out", "inpaint"},
                         {"shift", view.shift},
                         {"frame", view.request.frame},
                         {"camera", view.request.camera},
                         {"width", color.width},
                         {"height", color.height},
                         {"hole_px", std::count_if(b.warped.hole.data.begin(), b.warped.hole.data.end(),
                                                   [](uint8_t h) { return h != 0; })},
                         {"warp_ms", b.took.wall_ms},
                         {"warp_cpu_ms", b.took.cpu_ms},
                         {"fill_ms", took.wall_ms},
                         {"fill_cpu_ms", took.cpu_ms}});
        if (!in_set_.empty())
            manifest_->record_done((in_set_ / arm(method) / view.item).string(), "fill",
                                   (b.took.wall_ms + took.wall_ms) / 1000, from);
    }

    /// run.json beside an arm's results: its rows, and those of an earlier run whose files are still there.
    void write_times(const std::string& method) {
        const fs::path folder = fs::path(options_.out_dir) / arm(method), file = folder / "run.json";
        ordered_json all = ordered_json::array(), earlier;
        std::error_code error;
        if (fs::exists(file, error))
            earlier = ordered_json::parse(read_whole_file(file, size_t(256) << 20), nullptr, false);
        const auto same = [](const ordered_json& a, const ordered_json& b) {
            for (const char* key : {"shift", "frame", "camera"})
                if (a.value(key, ordered_json()) != b.value(key, ordered_json())) return false;
            return true;
        };
        if (earlier.is_array())
            for (const auto& row : earlier)
                if (row.is_object() && std::none_of(rows_.begin(), rows_.end(), [&](const ordered_json& mine) {
                        return mine["arm"] == arm(method) && same(mine, row);
                    }))
                    all.push_back(row);
        for (const auto& row : rows_)
            if (row["arm"] == arm(method)) all.push_back(row);
        if (all.empty()) return;
        write_whole_file(file, all.dump(1) + "\n");
        if (!in_set_.empty()) manifest_->record_done((in_set_ / arm(method) / "run.json").string(), "times", 0);
    }

    const Options& options_;
    Recipe recipe_;
    FrameFiles files_;
    Request base_;
    std::vector<std::string> cameras_;
    std::unique_ptr<Manifest> manifest_;
    fs::path in_set_;
    std::unique_ptr<inpaint::NetworkFill> network_;
    bool many_ = false;
    Progress progress_{"inpaint"};
    size_t done_ = 0, total_ = 0;
    ordered_json rows_ = ordered_json::array();
};

}  // namespace

void add_inpaint_verb(CLI::App& app) {
    CLI::App* sub = app.add_subcommand("inpaint", "Shifted view with its holes filled");
    auto options = std::make_shared<Options>();
    sub->add_option("recipe", options->recipe, "the .vshift recipe")->required();
    sub->add_option("--method", options->methods,
                    "background (from the surface behind), pushpull (OpenImageIO), telea, ns (OpenCV), network (a "
                    "trained model); several with --out-dir")
        ->delimiter(',')
        ->capture_default_str();
    sub->add_option("--model", options->model, "of --method network: a .safetensors file of vshift train");
    sub->add_option("--euler-steps", options->euler_steps, "of --method network, where the model is a flow")
        ->capture_default_str()
        ->check(CLI::Range(1, 1000));
    add_view_keys(*sub, options->request,
                  "self or rig: whose pictures fill what the own camera lacks, before the fill");
    sub->add_flag("--seam", options->seam, "the seam's colors (vshift seam) instead of the warp's, before the fill");
    sub->add_option("-o,--output", options->output, "one image: .exr, .png, .pfm or .npy");
    sub->add_option("--out-dir", options->out_dir, "many images: DIR/ARM/SHIFT/FFFF/CAMERA.exr");
    sub->add_flag("--all-frames", options->all_frames, "every frame of the recipe");
    sub->add_flag("--all-shifts", options->all_shifts, "every shift of the set's manifest");
    sub->add_option("--json", options->json, "times as JSON; - is standard output");
    sub->callback([options] {
        if (options->network()) wait_without_spinning();
        Run(*options).all();
    });
}

}  // namespace vshift::cli
