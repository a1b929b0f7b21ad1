// SPDX-License-Identifier: Apache-2.0
#include "inpaint/depth_net.h"

#include <cmath>
#include <limits>

namespace vshift::inpaint {
namespace {

constexpr double nearest_m = 0.5, farthest_m = 200;
// Above the horizon, and far along the road, the correction starts from a house front's distance.
constexpr double upright_m = 40;
constexpr double slope_weight = 1, sky_weight = 0.2;
constexpr double edge_step = 0.1, edge_weight = 4;  // of log z: where the truth breaks, a slope counts so much more

[[noreturn]] void refuse(const std::string& what, const std::string& got, const std::string& expected) {
    throw Error(ExitCode::bad_input, what + ": got " + got + ", expected " + expected);
}

}  // namespace

DepthConfig parse_depth_config(const std::string& text, const std::string& file) {
    const auto json = nlohmann::json::parse(text, nullptr, false);
    DepthConfig c;
    if (!json.is_object()) refuse(file + ": config", "no JSON object", "one");
    for (const auto& [key, value] : json.items()) {
        const std::string field = file + ": config." + key;
        if (key == "kind") {
            if (value != "depth") refuse(field, value.dump().substr(0, 40), "\"depth\" (vshift train --kind depth makes such a model)");
        } else if (key == "width") {
            if (!value.is_number_integer() || value.get<int64_t>() < 32 || value.get<int64_t>() > 4096)
                refuse(field, value.dump().substr(0, 40), "a whole number from 32 to 4096");
            c.width = value;
        } else if (key == "unet") {
            c.unet = parse_unet_config(value, field);
        } else {
            refuse(field, "an unknown field", "none");
        }
    }
    if (!json.contains("kind")) refuse(file + ": config.kind", "none", "\"depth\"");
    c.unet.in_channels = 7;
    c.unet.out_channels = 2;
    return c;
}

std::string json_of(const DepthConfig& c) {
    return nlohmann::ordered_json{{"kind", "depth"}, {"width", c.width}, {"unet", json_of(c.unet)}}.dump();
}

DepthModel initial_depth_model(const DepthConfig& config, uint64_t seed) {
    return {config, initial_weights(unet_layout(config.unet), seed, unet_begins_at_zero), {}};
}

DepthModel load_depth_model(const std::filesystem::path& path) {
    const TensorFiles files(path);
    DepthModel m;
    m.config = parse_depth_config(trained_config(files, "vshift train --kind depth"), files.file());
    m.metadata = files.metadata();
    m.weights = std::move(trained_weights(files, {{"network.", unet_layout(m.config.unet)}}).at("network."));
    return m;
}

void save_depth_model(const std::filesystem::path& file, const DepthModel& model, const Weights& weights) {
    write_trained(file, {{"network.", &weights}}, model.metadata, json_of(model.config));
}

Tensor depth_rays(const DepthCamera& c, int64_t height, int64_t width) {
    Tensor rays = at::empty({1, 4, height, width}, at::kFloat);
    float* out = rays.data_ptr<float>();
    const int64_t n = height * width;
    const double* r = c.ego_from_cam;
    for (int64_t y = 0; y < height; ++y)
        for (int64_t x = 0; x < width; ++x) {
            const double u = (double(x) + 0.5 - c.cx) / c.fx, v = (double(y) + 0.5 - c.cy) / c.fy;
            const double length = std::sqrt(u * u + v * v + 1);
            const int64_t i = y * width + x;
            double down = 0;
            for (int64_t axis = 0; axis < 3; ++axis) {
                const double d = r[3 * axis] * u + r[3 * axis + 1] * v + r[3 * axis + 2];
                out[axis * n + i] = float(d / length);
                down = -d;
            }
            // The ray has z = 1 in the camera: it meets the ground at depth height / down.
            out[3 * n + i] = float(std::clamp(down / std::max(c.height_m, 0.05), -1 / nearest_m, 1 / nearest_m));
        }
    return rays;
}

Tensor depth_input(const Tensor& color, const Tensor& rays) {
    return at::cat({color * 2 - 1, rays}, 1);
}

DepthGuess depth_forward(const DepthConfig& c, const Weights& weights, const Tensor& seen) {
    const Tensor t = at::zeros({seen.size(0)}, seen.options());
    const Tensor y = unet_forward(c.unet, weights, seen.unsqueeze(2), t).squeeze(2);
    const Tensor start = seen.narrow(1, 6, 1).clamp_min(1 / upright_m).log();
    return {(start + y.narrow(1, 0, 1)).clamp(-std::log(2 * farthest_m), -std::log(nearest_m / 2)), y.narrow(1, 1, 1)};
}

Tensor depth_loss(const DepthGuess& guess, const Tensor& inverse_depth) {
    const Tensor solid = (inverse_depth > 0).to(inverse_depth.scalar_type());
    const Tensor truth = inverse_depth.clamp_min(1 / farthest_m).log();
    const Tensor error = (guess.log_inverse - truth) * solid;
    const Tensor pixels = solid.sum({1, 2, 3}).clamp_min(1);
    const Tensor mean = error.sum({1, 2, 3}) / pixels;
    Tensor loss = ((error * error).sum({1, 2, 3}) / pixels - 0.5 * mean * mean + 1e-6).sqrt();
    for (const int64_t apart : {1, 2, 4})
        for (const int64_t axis : {2, 3}) {
            const int64_t left = error.size(axis) - apart;
            const Tensor both = solid.narrow(axis, 0, left) * solid.narrow(axis, apart, left);
            const auto step = [&](const Tensor& x) { return (x.narrow(axis, apart, left) - x.narrow(axis, 0, left)).abs(); };
            const Tensor slope = step(error) * both * (1 + edge_weight * (step(truth) > edge_step));
            loss = loss + slope_weight / 6 * slope.sum({1, 2, 3}) / both.sum({1, 2, 3}).clamp_min(1);
        }
    const Tensor sky = at::softplus(guess.sky) - guess.sky * (1 - solid);
    return (loss + sky_weight * sky.mean({1, 2, 3})).mean();
}

Tensor depth_of(const DepthModel& model, const Tensor& color, const DepthCamera& camera) {
    at::NoGradGuard no_grad;
    const int64_t H = color.size(2), W = color.size(3), side = unet_side(model.config.unet);
    const double shrink = std::min(1.0, double(model.config.width) / double(W));
    const int64_t h = std::max<int64_t>(1, std::llround(double(H) * shrink)), w = std::max<int64_t>(1, std::llround(double(W) * shrink));
    DepthCamera small = camera;
    const double along = double(w) / double(W), down = double(h) / double(H);
    small.fx *= along, small.cx *= along, small.fy *= down, small.cy *= down;
    Tensor seen = shrink < 1 ? at::adaptive_avg_pool2d(color, {h, w}) : color;
    const int64_t right = (side - w % side) % side, below = (side - h % side) % side;
    seen = depth_input(at::replication_pad2d(seen, {0, right, 0, below}), depth_rays(small, h + below, w + right));
    const DepthGuess guess = depth_forward(model.config, model.weights, seen);
    const auto whole = [&](const Tensor& t) {
        const Tensor part = t.narrow(2, 0, h).narrow(3, 0, w);
        return shrink < 1 ? at::upsample_bilinear2d(part, {H, W}, false) : part;
    };
    const Tensor z = 1 / whole(guess.log_inverse.exp()), sky = whole(guess.sky);
    return at::where(sky > 0, at::full_like(z, std::numeric_limits<float>::infinity()), z).squeeze(0).squeeze(0).contiguous();
}

}  // namespace vshift::inpaint
