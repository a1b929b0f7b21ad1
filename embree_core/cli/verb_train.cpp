// SPDX-License-Identifier: Apache-2.0
// vshift train: a model for vshift inpaint from virtual shifts of recorded street views, or one for vshift depth from their
// true depth, judged on other streets.
#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <memory>

#include "embree_core/cli/progress.h"
#include "embree_core/cli/run_program.h"
#include "embree_core/cli/verbs.h"
#include "embree_core/image_file.h"
#include "embree_core/words.h"
#include "inpaint/depth_judge.h"
#include "inpaint/depth_pairs.h"
#include "inpaint/judge_streets.h"
#include "inpaint/network_library.h"
#include "inpaint/pixel_pool.h"
#include "inpaint/start_pairs.h"
#include "inpaint/street_pairs.h"

namespace vshift::cli {
namespace {

namespace fs = std::filesystem;
using nlohmann::ordered_json;

constexpr const char* depth_kind = "depth";

struct Options {
    std::string output, streets = "1-12", judge, kind = "pixel_unet", config, autoencoder, regression, start, dit, arm = "virtual_shift", device = "cpu",
                precision = "float32";
    std::vector<std::string> judge_also;
    int frames = 2, width = 256, crop = 0, pairs = 1500, steps = 1000, batch = 8, accumulate = 1, threads = 0, checkpoint_every = 100;
    std::vector<int> euler_steps{1};
    int64_t seed = 1;
    double learning_rate = 1e-4, ema = 0.999, lanes_m = 0;
    bool flow = false, no_masks = false, no_depth = false, judge_only = false;
};

/// "1-4,9" as 1, 2, 3, 4, 9.
std::vector<uint32_t> street_seeds(const std::string& text, const char* option) {
    std::vector<uint32_t> seeds;
    size_t at = 0;
    const auto refuse = [&] {
        throw Error(ExitCode::bad_input, std::string("usage: ") + option + ": got " + text + ", expected seeds such as 1-4,9");
    };
    const auto number = [&] {
        size_t end = at;
        while (end < text.size() && text[end] >= '0' && text[end] <= '9') ++end;
        if (end == at || end - at > 6) refuse();
        const uint32_t n = uint32_t(std::stoul(text.substr(at, end - at)));
        at = end;
        return n;
    };
    for (;;) {
        const uint32_t first = number();
        uint32_t last = first;
        if (at < text.size() && text[at] == '-') {
            ++at;
            last = number();
        }
        if (last < first || last - first > 10000) refuse();
        for (uint32_t s = first; s <= last; ++s) seeds.push_back(s);
        if (at == text.size()) return seeds;
        if (text[at++] != ',') refuse();
    }
}

inpaint::Arm arm_of(const std::string& name) {
    const auto& names = inpaint::arm_names();
    const auto at = std::find(names.begin(), names.end(), name);
    if (at == names.end())
        throw Error(ExitCode::bad_input, "usage: --arm: got '" + name + "', expected one of extrapolation, virtual_shift, seam, "
                                             "double_warp, there_and_back (nearest: " + nearest_word(name, names) + ")");
    return inpaint::Arm(at - names.begin());
}

/// Fields of --config over those of `model`.
ordered_json with_given(ordered_json model, const Options& o) {
    if (o.config.empty()) return model;
    const auto given = ordered_json::parse(read_whole_file(o.config, 1 << 20), nullptr, false);
    if (!given.is_object()) throw Error(ExitCode::bad_input, o.config + ": config: got no JSON object, expected one");
    model.update(given);
    return model;
}

ordered_json depth_config(const Options& o) {
    return with_given({{"width", o.width}}, o);
}

ordered_json model_config(const Options& o) {
    ordered_json model = {{"kind", o.kind}, {"flow", o.flow}, {"masks", !o.no_masks}, {"depth", !o.no_depth},
                          {"neighbors", inpaint::has_neighbors(arm_of(o.arm))}};
    model["gives_data"] = o.flow && o.dit.empty();  // Wan2.2's output is the velocity
    if (o.kind == "pixel_dit")  // 2.8 million parameters
        model["dit"] = {{"dim", 192}, {"ffn_dim", 640}, {"layers", 6}, {"heads", 4}, {"freq_dim", 64}, {"text_dim", 0},
                        {"patch", {1, 8, 8}}, {"reach", 9}};
    if (o.kind == "autoencoder")  // 4 x 4 pixels to a latent, frame by frame
        model["vae"] = {{"dim", 24}, {"dec_dim", 24}, {"z_dim", 8}, {"dim_mult", {2, 2}}, {"res_blocks", 1}, {"temporal_down", {false}}};
    if (o.kind == "latent_dit")
        model["dit"] = {{"dim", 160}, {"ffn_dim", 480}, {"layers", 5}, {"heads", 4}, {"freq_dim", 64}, {"text_dim", 0},
                        {"patch", {1, 2, 2}}, {"reach", 9}};
    if (!o.start.empty()) {
        model["start"] = {{"noise", 0.02}, {"coupling", 0.7}, {"gain", 1.45}};
        model["rays"] = {{"detail", 1.1}};
        model["early_time"] = 0.5;
    }
    return with_given(std::move(model), o);
}

constexpr int pixels_of_a_sample = 512;  // of kind pixel_rays

/// What the library calls back: pairs of views to inpaint, or pictures with their depth.
struct Run {
    std::function<inpaint::PairPlanes(uint64_t)> draw_pair;
    std::function<inpaint::DepthPlanes(uint64_t)> draw_depth;
    Progress progress;
    inpaint::PairPlanes pair;
    inpaint::DepthPlanes depth;
    std::string error;

    template <class Sample, class Planes>
    int drawn(const std::function<Planes(uint64_t)>& draw, uint64_t number, Planes& kept, Sample (Planes::*as)() const, Sample* out) {
        try {
            kept = draw(number);
        } catch (const std::exception& e) {
            error = e.what();
            return 1;
        }
        *out = (kept.*as)();
        return 0;
    }
    static int sample(void* user, uint64_t number, vshift_inpaint_views* out) {
        Run& run = *static_cast<Run*>(user);
        return run.drawn(run.draw_pair, number, run.pair, &inpaint::PairPlanes::views, out);
    }
    static int depth_sample(void* user, uint64_t number, vshift_depth_view* out) {
        Run& run = *static_cast<Run*>(user);
        return run.drawn(run.draw_depth, number, run.depth, &inpaint::DepthPlanes::view, out);
    }
    static int after_step(void* user, int64_t step, int64_t steps, double loss) {
        char text[48];
        std::snprintf(text, sizeof text, "loss %.4f", loss);
        static_cast<Run*>(user)->progress.show(size_t(step), size_t(steps), text);
        try {
            stop_if_interrupted();
        } catch (const Error&) {
            return 1;
        }
        return 0;
    }
};

void draw_curve(const std::string& csv) {
    const ProgramRun chart = run_program({python_program(), source_program("train", "benchmark/charts/training_curve.py"), csv},
                                         {"PYTHONDONTWRITEBYTECODE=1"}, ".", 120);
    if (chart.code != 0) throw Error(ExitCode::io_failed, "train: curve: got " + chart.told() + ", expected it drawn");
}

void train(const Options& o, const std::vector<uint32_t>& seeds, const std::vector<uint32_t>& others) {
    const inpaint::NetworkLibrary& library = inpaint::network_library();
    const auto start = std::chrono::steady_clock::now();
    const bool depth = o.kind == depth_kind;
    Progress drawing("streets");
    const auto show = [&](size_t done, size_t total) {
        stop_if_interrupted();
        drawing.show(done, total, std::to_string(o.width) + " px");
    };
    inpaint::RecordedViews recorded, checks;
    std::vector<inpaint::DepthPlanes> depth_views;
    if (depth)
        depth_views = inpaint::record_depth_views(seeds, o.frames, o.width, show);
    else
        recorded = inpaint::record_streets(seeds, o.frames, o.width, o.lanes_m, show);
    if (o.kind == "autoencoder") checks = inpaint::record_streets(others, 1, o.width, 0, show);
    const size_t views = depth ? depth_views.size() : recorded.views.size();
    drawing.finish();
    inpaint::PixelPool pool;
    if (o.kind == "pixel_rays") {
        Progress picking("pairs");
        pool = inpaint::pixel_pool(recorded, uint64_t(o.seed), size_t(o.pairs), [&](size_t done, size_t total) {
            stop_if_interrupted();
            picking.show(done, total, "training pairs");
        });
        picking.finish();
    }
    std::unique_ptr<inpaint::StartPairs> begun;
    if (!o.start.empty())
        begun = std::make_unique<inpaint::StartPairs>(recorded, o.start, uint64_t(o.seed), o.crop, arm_of(o.arm));
    const double drawn_s = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    const std::string stem = fs::path(o.output).replace_extension().string();
    const ordered_json options = {
        {"model", depth ? depth_config(o) : model_config(o)}, {"steps", o.steps}, {"batch", o.batch}, {"accumulate", o.accumulate},
        {"learning_rate", o.learning_rate}, {"ema", o.ema}, {"seed", o.seed}, {"checkpoint_every", o.checkpoint_every},
        {"checkpoint_file", stem + ".checkpoint.safetensors"}, {"curve_file", stem + ".curve.csv"}, {"model_file", o.output},
        {"autoencoder_file", o.autoencoder}, {"regression_file", o.regression}, {"start_file", o.start}, {"dit_file", o.dit},
        {"device", o.device}, {"precision", o.precision}, {"license", "Apache-2.0"},
        {"record", {{"data", depth ? "analytic streets, pictures and their true depth" : "analytic streets, virtual shifts of 0.5 to 4 m of recorded views"},
                    {"arm", depth ? "" : o.arm}, {"begins_with", fs::path(o.dit.empty() ? o.regression : o.dit).filename().string()}, {"streets", o.streets},
                    {"frames", o.frames}, {"lanes_m", o.lanes_m}, {"width", o.width}, {"crop", o.crop}, {"pairs", pool.size() ? o.pairs : 0}, {"pixels", pool.size()}, {"views", views}}}};
    const auto seed = uint64_t(o.seed);
    const inpaint::Arm arm = arm_of(o.arm);
    Run run{[&](uint64_t number) {
                if (pool.size()) return inpaint::pixel_sample(pool, seed, number, pixels_of_a_sample);
                if (begun) return begun->sample(number);
                return inpaint::training_pair(number < VSHIFT_INPAINT_CHECKS ? recorded : checks, seed, number, o.crop, arm);
            },
            [&](uint64_t number) { return inpaint::depth_sample(depth_views, seed, number, o.crop); },
            Progress("train"), {}, {}, {}};
    const int code = depth ? library.depth_train(options.dump().c_str(), Run::depth_sample, Run::after_step, &run)
                           : library.train(options.dump().c_str(), Run::sample, Run::after_step, &run);
    run.progress.finish();
    if (!run.error.empty()) throw Error(ExitCode::bad_input, "train: " + run.error);
    inpaint::check(code);
    std::error_code ignored;
    fs::remove(stem + ".checkpoint.safetensors", ignored);
    draw_curve(stem + ".curve.csv");
    std::printf("%s: %zu views drawn in %.0f s, trained in %.0f s; curve in %s.curve.png\n", o.output.c_str(), views,
                drawn_s, std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count() - drawn_s, stem.c_str());
}

/// Judges under a progress bar; the result lies beside the model, and its table is printed.
template <class Judge, class Table>
void judge(const Options& o, const char* what, const Judge& judged, const Table& table) {
    Progress progress("judge");
    const ordered_json result = judged([&](size_t done, size_t total) {
        stop_if_interrupted();
        progress.show(done, total, what);
    });
    progress.finish();
    write_whole_file(fs::path(o.output).replace_extension(".judge.json"), result.dump(1) + "\n");
    std::fputs(table(result).c_str(), stdout);
}

void run(const Options& o) {
    const auto seeds = street_seeds(o.streets, "--streets");
    arm_of(o.arm);
    std::vector<uint32_t> others;
    if (!o.judge.empty()) others = street_seeds(o.judge, "--judge");
    for (const uint32_t s : others)
        if (std::find(seeds.begin(), seeds.end(), s) != seeds.end() && !o.judge_only)
            throw Error(ExitCode::bad_input, "usage: --judge: got street " + std::to_string(s) + ", which is trained on, expected others");
    if ((o.kind == "latent_dit") != !o.autoencoder.empty() && !o.judge_only)
        throw Error(ExitCode::bad_input, "usage: --autoencoder: got " + std::string(o.autoencoder.empty() ? "none" : o.autoencoder) +
                                             " for " + o.kind + ", expected one for latent_dit alone");
    if (!o.dit.empty() && o.kind != "latent_dit")
        throw Error(ExitCode::bad_input, "usage: --dit: got " + o.dit + " for " + o.kind + ", expected it for latent_dit alone");
    if (o.kind == "autoencoder" && others.empty())
        throw Error(ExitCode::bad_input, "usage: --judge: got none, expected streets to measure the autoencoder on");
    const int threads = o.threads > 0 ? o.threads : inpaint::all_threads();
    inpaint::check(inpaint::network_library().set_threads(threads));
    if (o.precision != "float32" && o.precision != "bf16")
        throw Error(ExitCode::bad_input, "usage: --precision: got '" + o.precision + "', expected float32 or bf16");
    inpaint::check(inpaint::network_library().has_device(o.device.c_str()));
    inpaint::warn_of_slow_blas(threads);
    if (!o.judge_only) train(o, seeds, others);
    if (others.empty() || o.kind == "autoencoder") return;
    if (o.kind == depth_kind) {
        inpaint::DepthJudgeOptions options;
        options.model_file = o.output;
        options.seeds = others;
        options.width = o.width;
        judge(o, "views", [&](const auto& show) { return inpaint::judge_depth(options, show); }, inpaint::depth_table);
    } else {
        inpaint::JudgeOptions options;
        options.seeds = others;
        options.model_files = {o.output};
        options.model_files.insert(options.model_files.end(), o.judge_also.begin(), o.judge_also.end());
        options.width = o.width;
        options.steps = o.euler_steps;
        judge(o, "true shifted views", [&](const auto& show) { return inpaint::judge_streets(options, show); },
              inpaint::judge_table);
    }
}

}  // namespace

void add_train_verb(CLI::App& app) {
    CLI::App* sub = app.add_subcommand("train", "Trains an inpainting model on virtual shifts of analytic streets");
    auto o = std::make_shared<Options>();
    sub->add_option("-o,--output", o->output, "the model, .safetensors; the curve and checkpoints lie beside it")->required();
    sub->add_option("--streets", o->streets, "seeds to train on, such as 1-12")->capture_default_str();
    sub->add_option("--judge", o->judge, "seeds of other streets: the model against truth in true shifted views");
    sub->add_option("--judge-also", o->judge_also, "further models, judged on the same views")->delimiter(',');
    sub->add_flag("--judge-only", o->judge_only, "the model is there: no training");
    sub->add_option("--frames", o->frames, "of each street")->capture_default_str()->check(CLI::Range(1, 81));
    sub->add_option("--lanes-m", o->lanes_m, "recorded drives keep up to so far to either side of the street's middle")
        ->capture_default_str()
        ->check(CLI::Range(0.0, 4.0));
    sub->add_option("--width", o->width, "of the pictures, px")->capture_default_str()->check(CLI::Range(64, 1600));
    sub->add_option("--crop", o->crop, "side of the squares that are trained on, px; 0: whole views")->check(CLI::Range(0, 1600));
    sub->add_option("--kind", o->kind,
                    "pixel_rays, pixel_unet, pixel_dit, autoencoder or latent_dit; depth: an estimator of depth from one "
                    "picture, for vshift depth")
        ->capture_default_str();
    sub->add_option("--pairs", o->pairs, "that pixel_rays draws its pixels from")->capture_default_str()->check(CLI::Range(1, 1000000));
    sub->add_option("--autoencoder", o->autoencoder,
                    "a trained one, for latent_dit: frozen, and part of the model; or Wan2.2's, with its sizes, mean and std in --config");
    sub->add_option("--dit", o->dit,
                    "Wan2.2's or Diffusers' weights (.safetensors, or the index), for a latent_dit of their sizes in --config: where its "
                    "training begins, without their text conditioning");
    sub->add_option("--begin-with", o->regression, "a regression by the same pixel_unet: where a flow's training begins");
    sub->add_option("--start", o->start, "a trained pixel_rays, for a flow in pixels: it begins with what that gives; part of the model");
    sub->add_option("--config", o->config, "JSON file with further fields of the model's config");
    sub->add_flag("--flow", o->flow, "flow matching; else one-step regression");
    sub->add_option("--arm", o->arm, "what pairs are made of: virtual_shift, seam, double_warp, there_and_back or extrapolation")->capture_default_str();
    sub->add_flag("--no-masks", o->no_masks, "ablation: the network sees no mask channels");
    sub->add_flag("--no-depth", o->no_depth, "ablation: nor inverse depth");
    sub->add_option("--euler-steps", o->euler_steps, "of flow, when judged: 1,2,4,8")->delimiter(',');
    sub->add_option("--steps", o->steps, "of training")->capture_default_str();
    sub->add_option("--batch", o->batch, "samples to a pass")->capture_default_str();
    sub->add_option("--accumulate", o->accumulate, "passes to a step")->capture_default_str();
    sub->add_option("--learning-rate", o->learning_rate, "falls to 0 as a cosine")->capture_default_str();
    sub->add_option("--ema", o->ema, "moving average of the weights that are saved")->capture_default_str();
    sub->add_option("--seed", o->seed, "of weights, samples and noise")->capture_default_str();
    sub->add_option("--checkpoint-every", o->checkpoint_every, "steps")->capture_default_str();
    sub->add_option("--device", o->device, "of training: cpu, or cuda where LibTorch finds one")->capture_default_str();
    sub->add_option("--precision", o->precision,
                    "of matrix products and convolutions in training: float32 or bf16; weights, loss and optimizer are float32")
        ->capture_default_str();
    sub->add_option("--threads", o->threads, "of Torch; 0: OMP_NUM_THREADS, or all cores")->capture_default_str();
    sub->callback([o] {
        wait_without_spinning();
        run(*o);
    });
}

}  // namespace vshift::cli
