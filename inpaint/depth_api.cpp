// SPDX-License-Identifier: Apache-2.0
#include "inpaint/depth_api.h"

#include <cstring>
#include <limits>

#include "embree_core/image_file.h"
#include "inpaint/api_support.h"
#include "inpaint/depth_net.h"
#include "inpaint/depth_script.h"

using namespace vshift;
using namespace vshift::inpaint;

struct vshift_depth_model {
    DepthModel own;
    std::unique_ptr<DepthScript> script;  ///< or a user's
};

namespace {

Tensor plane(const float* data, int64_t channels, const vshift_depth_view& v, const char* what) {
    require(data, what);
    Tensor t = at::empty({1, channels, v.height, v.width}, at::kFloat);
    std::memcpy(t.data_ptr(), data, size_t(t.numel()) * sizeof(float));
    return t;
}

void check_size(const vshift_depth_view& v) {
    if (v.height < 1 || v.width < 1) throw Error(ExitCode::bad_input, "depth: size: got none, expected at least one pixel");
}

DepthCamera camera_of(const vshift_depth_view& v) {
    DepthCamera c{v.fx, v.fy, v.cx, v.cy, {}, v.height_m};
    std::copy(v.ego_from_cam, v.ego_from_cam + 9, c.ego_from_cam);
    return c;
}

}  // namespace

int vshift_depth_train(const char* options_json, vshift_depth_sample sample, vshift_inpaint_progress progress, void* user) {
    return guarded([&] {
        require(options_json && sample, "train");
        const TrainRequest r = parse_train_request(options_json);
        auto json = nlohmann::json::parse(r.model);
        if (json.is_object()) json["kind"] = "depth";
        DepthModel model = initial_depth_model(parse_depth_config(json.dump(), "train"), r.train.seed);
        const auto loss = [&](const Weights& weights, int64_t step, int64_t pass) {
            std::vector<Tensor> seen, truth;
            for (int64_t i = 0; i < r.train.batch; ++i) {
                const uint64_t number = uint64_t((step * r.train.accumulate + pass) * r.train.batch + i);
                vshift_depth_view v{};
                if (sample(user, number, &v) != 0)
                    throw Error(ExitCode::bad_input, "train: sample " + std::to_string(number) + ": got none, expected one");
                check_size(v);
                // What the network cannot halve as often as it does is left out.
                const int64_t side = unet_side(model.config.unet), h = v.height - v.height % side, w = v.width - v.width % side;
                if (h == 0 || w == 0)
                    throw Error(ExitCode::bad_input, "train: width: got pictures of " + std::to_string(v.width) + "x" + std::to_string(v.height) +
                                                         ", expected at least " + std::to_string(side) + " pixels a side");
                const auto part = [&](const Tensor& t) { return t.narrow(2, 0, h).narrow(3, 0, w); };
                seen.push_back(part(depth_input(plane(v.color, 3, v, "color"), depth_rays(camera_of(v), v.height, v.width))));
                truth.push_back(part(plane(v.inverse_depth, 1, v, "inverse_depth")));
            }
            const at::Device device = weights.begin()->second.device();
            const DepthGuess guess = [&] {
                const Autocast casts(r.train);
                return depth_forward(model.config, weights, at::cat(seen, 0).to(device));
            }();
            return depth_loss({guess.log_inverse.to(at::kFloat), guess.sky.to(at::kFloat)}, at::cat(truth, 0).to(device));
        };
        bool stopped = false;
        const TrainState state = train(json_of(model.config), model.weights, r.train, loss, [&](int64_t step, double value) {
            stopped = progress && progress(user, step, r.train.steps, value) != 0;
            return !stopped;
        });
        if (!r.curve_file.empty()) write_whole_file(r.curve_file, curve_csv(state));
        if (stopped) throw interrupted_error();
        model.metadata = training_metadata(r, state);
        if (!r.model_file.empty()) save_depth_model(r.model_file, model, state.average);
    });
}

int vshift_depth_model_open(const char* file, int32_t trust, vshift_depth_model** out) {
    return guarded([&] {
        require(file && out, "model");
        auto model = std::make_unique<vshift_depth_model>();
        if (is_script(file)) {
            if (!trust)
                throw Error(ExitCode::bad_input, std::string(file) +
                                                     ": format: got a zip archive (TorchScript), expected safetensors, or "
                                                     "--trust-model (it runs code of its author)");
            model->script = std::make_unique<DepthScript>(file);
        } else {
            model->own = load_depth_model(file);
        }
        *out = model.release();
    });
}

void vshift_depth_model_free(vshift_depth_model* model) {
    delete model;
}

int vshift_depth_of(const vshift_depth_model* model, const vshift_depth_view* view, float* z) {
    return guarded([&] {
        require(model && view && z, "depth");
        check_size(*view);
        const Tensor color = plane(view->color, 3, *view, "color");
        const Tensor depth = model->script ? model->script->depth_of(color) : depth_of(model->own, color, camera_of(*view));
        std::memcpy(z, depth.data_ptr(), size_t(depth.numel()) * sizeof(float));
    });
}
