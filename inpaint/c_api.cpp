// SPDX-License-Identifier: Apache-2.0
#include "inpaint/c_api.h"

#include <chrono>
#include <cstring>
#include <thread>

#include "embree_core/image_file.h"
#include "embree_core/version.h"
#include "inpaint/api_support.h"

using namespace vshift;
using namespace vshift::inpaint;

struct vshift_inpaint_model {
    Model model;
    std::string config;
};
struct vshift_inpaint_stream {
    const Model* model;
    int32_t steps;
    uint64_t seed;
    Stream state;
};

namespace {

Tensor copied(const float* data, int64_t channels, const vshift_inpaint_views& v, const char* what) {
    require(data, what);
    Tensor t = at::empty({1, channels, v.frames, v.height, v.width}, at::kFloat);
    std::memcpy(t.data_ptr(), data, size_t(t.numel()) * sizeof(float));
    return t;
}

Views views_of(const vshift_inpaint_views& v, bool training) {
    if (v.frames < 1 || v.height < 1 || v.width < 1)
        throw Error(ExitCode::bad_input, "views: size: got none, expected at least one pixel");
    return {copied(v.fill, 3, v, "views: fill"), copied(v.hole, 1, v, "views: hole"),
            copied(v.neighbor, 1, v, "views: neighbor"), copied(v.inverse_depth, 1, v, "views: inverse_depth"),
            training ? copied(v.target, 3, v, "views: target") : Tensor(),
            training && v.weight ? copied(v.weight, 1, v, "views: weight") : Tensor(),
            training && v.texture ? copied(v.texture, 3, v, "views: texture") : Tensor(),
            training && v.seen ? copied(v.seen, seen_numbers, v, "views: seen") : Tensor()};
}

}  // namespace

namespace vshift::inpaint {

std::string& last_error() {
    thread_local std::string line;
    return line;
}

void require(bool given, const char* what) {
    if (!given) throw Error(ExitCode::our_bug, std::string(what) + ": got NULL, expected one");
}

at::Device device_of(const std::string& name) {
    if (name == "cpu") return at::kCPU;
    if (name != "cuda") throw Error(ExitCode::bad_input, "device: got '" + name + "', expected cpu or cuda");
    if (!at::hasCUDA())
        throw Error(ExitCode::bad_input, "device: got cuda, expected cpu: LibTorch " TORCH_VERSION " finds no CUDA here");
    return at::kCUDA;
}

TrainRequest parse_train_request(const char* text) {
    const auto json = nlohmann::json::parse(text, nullptr, false);
    TrainRequest r;
    if (!json.is_object()) throw Error(ExitCode::bad_input, "train: options: got no JSON object, expected one");
    for (const auto& [key, value] : json.items()) {
        const auto refuse = [&, &key = key, &value = value](const std::string& expected) {
            throw Error(ExitCode::bad_input, "train: " + key + ": got " + value.dump().substr(0, 80) + ", expected " + expected);
        };
        const auto whole = [&, &value = value](int64_t least, int64_t most) {
            if (!value.is_number_integer() || value.get<int64_t>() < least || value.get<int64_t>() > most)
                refuse("a whole number from " + std::to_string(least) + " to " + std::to_string(most));
            return value.get<int64_t>();
        };
        const auto number = [&, &value = value](double most) {
            if (!value.is_number() || !(value.get<double>() >= 0 && value.get<double>() <= most))
                refuse("a number from 0 to " + std::to_string(most));
            return value.get<double>();
        };
        const auto word = [&, &value = value] {
            if (!value.is_string()) refuse("a string");
            return value.get<std::string>();
        };
        if (key == "model") r.model = value.dump();
        else if (key == "steps") r.train.steps = whole(1, 100000000);
        else if (key == "batch") r.train.batch = whole(1, 4096);
        else if (key == "accumulate") r.train.accumulate = whole(1, 4096);
        else if (key == "seed") r.train.seed = uint64_t(whole(0, INT64_MAX));
        else if (key == "learning_rate") r.train.learning_rate = number(1);
        else if (key == "weight_decay") r.train.weight_decay = number(1);
        else if (key == "ema") r.train.ema = number(1);
        else if (key == "checkpoint_every") r.train.checkpoint_every = whole(0, 100000000);
        else if (key == "checkpoint_file") r.train.checkpoint_file = word();
        else if (key == "model_file") r.model_file = word();
        else if (key == "curve_file") r.curve_file = word();
        else if (key == "autoencoder_file") r.autoencoder_file = word();
        else if (key == "regression_file") r.regression_file = word();
        else if (key == "start_file") r.start_file = word();
        else if (key == "dit_file") r.dit_file = word();
        else if (key == "license") r.license = word();
        else if (key == "record") r.record = value.dump();
        else if (key == "device") r.train.device = device_of(word());
        else if (key == "precision") {
            const std::string name = word();
            if (name != "float32" && name != "bf16") refuse("float32 or bf16");
            r.train.bf16 = name == "bf16";
        }
        else refuse("a known option");
    }
    return r;
}

std::map<std::string, std::string> training_metadata(const TrainRequest& r, const TrainState& state, const nlohmann::ordered_json& more) {
    nlohmann::ordered_json record = r.record.empty() ? nlohmann::ordered_json::object() : nlohmann::ordered_json::parse(r.record);
    record["steps"] = state.step;
    record["batch"] = r.train.batch * r.train.accumulate;
    record["learning_rate"] = r.train.learning_rate;
    record["seed"] = r.train.seed;
    record["last_loss"] = state.curve.back()[1];
    record["made_with"] = vshift_inpaint_version();
    if (!r.train.device.is_cpu()) record["device"] = r.train.device.str();
    if (r.train.bf16) record["precision"] = "bf16";
    if (!more.is_null()) record.update(more);
    std::map<std::string, std::string> metadata{{"training", record.dump()}};
    if (!r.license.empty()) metadata["license"] = r.license;
    return metadata;
}

}  // namespace vshift::inpaint

const char* vshift_inpaint_version(void) {
    static const std::string text = std::string("vshift ") + version_string + ", LibTorch " + TORCH_VERSION;
    return text.c_str();
}

const char* vshift_inpaint_last_error(void) {
    return last_error().c_str();
}

int vshift_inpaint_set_threads(int threads) {
    return guarded([&] {
        const int wanted = threads > 0 ? threads : std::max(1, int(std::thread::hardware_concurrency()));
        if (at::get_num_threads() != wanted) at::set_num_threads(wanted);  // see load() in network_library.cpp
    });
}

int vshift_inpaint_has_device(const char* device) {
    return guarded([&] {
        require(device, "device");
        device_of(device);
    });
}

int vshift_inpaint_linear_speed(double* gflop_per_s) {
    return guarded([&] {
        require(gflop_per_s, "gflop_per_s");
        at::NoGradGuard no_grad;
        const Tensor x = at::ones({1024, 512}), w = at::ones({512, 512}), b = at::zeros({512});
        double best_s = 1e9;
        for (int i = 0; i < 6 && (i < 2 || best_s < 0.1); ++i) {  // the first warms up
            const auto start = std::chrono::steady_clock::now();
            const Tensor y = at::linear(x, w, b);
            best_s = std::min(best_s, std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
        }
        *gflop_per_s = 2.0 * 1024 * 512 * 512 / best_s / 1e9;
    });
}

int vshift_inpaint_train(const char* options_json, vshift_inpaint_sample sample, vshift_inpaint_progress progress,
                         void* user) {
    return guarded([&] {
        require(options_json && sample, "train");
        const TrainRequest r = parse_train_request(options_json);
        const ModelConfig config = parse_model_config(r.model, "train: model");
        Model model = !r.autoencoder_file.empty() ? initial_model(config, r.train.seed, r.autoencoder_file)
                      : !r.start_file.empty()     ? initial_model_with_start(config, r.train.seed, r.start_file)
                                                  : initial_model(config, r.train.seed);
        if (!r.regression_file.empty()) begin_with_regression(model, r.regression_file);
        if (!r.dit_file.empty()) begin_with_dit(model, r.dit_file, r.train.seed);
        const uint64_t frozen = hash_of(model.vae.weights) ^ hash_of(model.rays);
        bool stopped = false;
        TrainHooks hooks;
        hooks.views = [&](uint64_t number) {
            vshift_inpaint_views v{};
            if (sample(user, number, &v) != 0)
                throw Error(ExitCode::bad_input, "train: sample " + std::to_string(number) + ": got none, expected one");
            return views_of(v, true);
        };
        hooks.after_step = [&](int64_t step, double loss) {
            stopped = progress && progress(user, step, r.train.steps, loss) != 0;
            return !stopped;
        };
        const TrainState state = train(model, r.train, hooks);
        if (!r.curve_file.empty()) write_whole_file(r.curve_file, curve_csv(state));
        if (stopped) throw interrupted_error();
        if ((hash_of(model.vae.weights) ^ hash_of(model.rays)) != frozen)
            throw Error(ExitCode::our_bug, "train: autoencoder or rays: got other weights, expected them frozen");
        nlohmann::ordered_json record;
        if (model.config.kind == Kind::autoencoder) {
            std::vector<Views> checks;
            for (uint64_t i = 0; i < 24; ++i) checks.push_back(hooks.views(VSHIFT_INPAINT_CHECKS + i));
            const Reconstruction back = reconstruction_of(model, state.average, checks);
            model.config.vae.mean = back.mean;
            model.config.vae.std = back.std;
            record["reconstruction_db"] = back.psnr_db;
        }
        model.metadata.merge(training_metadata(r, state, record));
        if (!r.model_file.empty()) save_model(r.model_file, model, state.average);
    });
}

int vshift_inpaint_model_open(const char* file, vshift_inpaint_model** out) {
    return guarded([&] {
        require(file && out, "model");
        auto model = std::make_unique<vshift_inpaint_model>();
        model->model = load_model(file);
        if (model->model.config.kind == Kind::autoencoder)
            throw Error(ExitCode::bad_input, std::string(file) + ": kind: got autoencoder, expected a model that fills");
        model->config = json_of(model->model.config);
        *out = model.release();
    });
}

void vshift_inpaint_model_free(vshift_inpaint_model* model) {
    delete model;
}

int32_t vshift_inpaint_model_piece(const vshift_inpaint_model* model) {
    return model ? int32_t(piece_frames(model->model.config)) : 1;
}

const char* vshift_inpaint_model_config(const vshift_inpaint_model* model) {
    return model ? model->config.c_str() : "";
}

int vshift_inpaint_texture(const vshift_inpaint_model* model, const vshift_inpaint_views* views, float* color, float* texture) {
    return guarded([&] {
        require(model && views && color && texture, "texture");
        if (model->model.config.kind != Kind::pixel_rays)
            throw Error(ExitCode::bad_input, "start: config: got " + model->config.substr(0, 40) + "..., expected a pixel_rays");
        const Views made = started(model->model, views_of(*views, false));
        std::memcpy(color, made.fill.contiguous().data_ptr(), size_t(made.fill.numel()) * sizeof(float));
        std::memcpy(texture, made.texture.contiguous().data_ptr(), size_t(made.texture.numel()) * sizeof(float));
    });
}

int vshift_inpaint_stream_open(const vshift_inpaint_model* model, int32_t steps, uint64_t seed,
                               vshift_inpaint_stream** out) {
    return guarded([&] {
        require(model && out, "stream");
        if (steps < 1 || steps > 1000)
            throw Error(ExitCode::bad_input, "steps: got " + std::to_string(steps) + ", expected 1 to 1000");
        *out = new vshift_inpaint_stream{&model->model, steps, seed, {}};
    });
}

void vshift_inpaint_stream_free(vshift_inpaint_stream* stream) {
    delete stream;
}

int vshift_inpaint_stream_next(vshift_inpaint_stream* stream, const vshift_inpaint_views* views, float* color) {
    return guarded([&] {
        require(stream && views && color, "stream");
        const Tensor out = inpaint::inpaint(*stream->model, views_of(*views, false), stream->steps, stream->seed, stream->state)
                               .contiguous();
        std::memcpy(color, out.data_ptr(), size_t(out.numel()) * sizeof(float));
    });
}
