// SPDX-License-Identifier: Apache-2.0
#include "inpaint/ray_mixer.h"

namespace vshift::inpaint {
namespace {

constexpr int64_t hidden = 32;        // of the layer that looks at one ray
constexpr double fill_first = 3;      // the fill's score at the beginning, where rays have 0
constexpr double added_share = 0.25;  // of the color that is added
constexpr double never = -1e4;

Tensor layer(const Weights& w, const std::string& name, const Tensor& x) {
    return at::linear(x, get(w, name + ".weight"), get(w, name + ".bias"));
}

}  // namespace

RayMixerConfig parse_ray_mixer_config(const nlohmann::json& json, const std::string& where) {
    RayMixerConfig c;
    if (!json.is_object()) throw Error(ExitCode::bad_input, where + ": got " + json.type_name() + ", expected an object");
    for (const auto& [key, value] : json.items()) {
        int64_t* to = key == "ray_dim" ? &c.ray_dim : key == "dim" ? &c.dim : key == "layers" ? &c.layers : nullptr;
        const int64_t most = key == "layers" ? 16 : 1024;
        if (!to || !value.is_number_integer() || value.get<int64_t>() < 1 || value.get<int64_t>() > most)
            throw Error(ExitCode::bad_input, where + ": " + key + ": got " + value.dump().substr(0, 40) +
                                                 ", expected ray_dim or dim (1 to 1024) or layers (1 to 16)");
        *to = value.get<int64_t>();
    }
    return c;
}

nlohmann::ordered_json json_of(const RayMixerConfig& c) {
    return {{"ray_dim", c.ray_dim}, {"dim", c.dim}, {"layers", c.layers}};
}

Layout ray_mixer_layout(const RayMixerConfig& c) {
    Layout l;
    const auto linear = [&](const std::string& name, int64_t in, int64_t out) {
        l[name + ".weight"] = {out, in};
        l[name + ".bias"] = {out};
    };
    linear("ray.0", ray_numbers, hidden);
    linear("ray.1", hidden, c.ray_dim);
    for (int64_t i = 0; i < c.layers; ++i)
        linear("body." + std::to_string(i), i == 0 ? ray_count * c.ray_dim + own_numbers : c.dim, c.dim);
    linear("out", c.dim, 1 + ray_count + 3);
    return l;
}

bool ray_mixer_begins_at_zero(const std::string& name) {
    return name == "out.weight";
}

Tensor ray_mixer_forward(const RayMixerConfig& c, const Weights& w, const Tensor& seen) {
    const int64_t n = seen.size(0);
    const Tensor rays = seen.narrow(1, 0, ray_count * ray_numbers).reshape({n, ray_count, ray_numbers});
    const Tensor own = seen.narrow(1, ray_count * ray_numbers, own_numbers);
    const Tensor each = at::silu(layer(w, "ray.1", at::silu(layer(w, "ray.0", rays))));
    Tensor x = at::cat({each.flatten(1), own}, 1);
    for (int64_t i = 0; i < c.layers; ++i) x = at::silu(layer(w, "body." + std::to_string(i), x));
    const Tensor y = layer(w, "out", x);
    const Tensor ends = rays.select(2, ray_numbers - 1) <= 0;  // met nothing
    const Tensor scores = at::cat({y.narrow(1, 0, 1) + fill_first, y.narrow(1, 1, ray_count).masked_fill(ends, never)}, 1);
    const Tensor colors = (at::cat({own.narrow(1, 0, 3).unsqueeze(1), rays.narrow(2, 3, 3)}, 1) + 1) / 2;
    const Tensor mixed = (at::softmax(scores, 1).unsqueeze(2) * colors).sum(1);
    return mixed + added_share * y.narrow(1, 1 + ray_count, 3);
}

}  // namespace vshift::inpaint
