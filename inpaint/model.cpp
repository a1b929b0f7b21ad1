// SPDX-License-Identifier: Apache-2.0
#include "inpaint/model.h"

#include <ATen/CPUGeneratorImpl.h>

#include <algorithm>
#include <array>
#include <cmath>

namespace vshift::inpaint {
namespace {

constexpr std::array<const char*, 4> kind_names{"pixel_unet", "pixel_dit", "latent_dit", "pixel_rays"};
constexpr double near_m = 8;  // 1/z is seen in eighths of a metre
constexpr size_t rays_at_once = 768;

bool in_pixels(const ModelConfig& c) {
    return c.kind != Kind::latent_dit;
}

/// What follows from the rest: channels in and out.
void set_channels(ModelConfig& c) {
    const int64_t out = in_pixels(c) ? 3 : c.vae.z_dim;
    const int64_t in = 2 * out + (c.masks ? 2 : 0) + (c.depth ? 1 : 0);
    c.unet.in_channels = c.dit.in_channels = in;
    c.unet.out_channels = c.dit.out_channels = out;
}

Layout network_layout(const ModelConfig& c) {
    if (c.kind == Kind::pixel_rays) return ray_mixer_layout(c.rays);
    return c.kind == Kind::pixel_unet ? unet_layout(c.unet) : dit_layout(c.dit);
}

[[noreturn]] void refuse(const std::string& where, const std::string& got, const std::string& expected) {
    throw Error(ExitCode::bad_input, where + ": got " + got + ", expected " + expected);
}

uint64_t mixed(uint64_t seed, uint64_t number) {
    uint64_t z = seed * 0x9e3779b97f4a7c15ull + number + 0x632be59bd9b4e019ull;
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ull;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebull;
    return z ^ (z >> 31);
}

/// Per frame or per latent: the mean over blocks of pixels, and over the frames of a latent.
Tensor shares(const Tensor& x, int64_t side, int64_t frames, bool first) {
    const Tensor pooled = at::avg_pool3d(x, {1, side, side});
    std::vector<Tensor> latents;
    for (int64_t at = 0; at < x.size(2);) {
        const int64_t n = first && at == 0 ? 1 : frames;
        latents.push_back(pooled.narrow(2, at, n).mean(2, true));
        at += n;
    }
    return at::cat(latents, 2);
}

}  // namespace

ModelConfig parse_model_config(const std::string& text, const std::string& file) {
    const auto json = nlohmann::json::parse(text, nullptr, false);
    const std::string where = file + ": config";
    if (!json.is_object()) refuse(where, "no JSON object", "one");
    ModelConfig c;
    for (const auto& [key, value] : json.items()) {
        const std::string field = where + ": " + key;
        const auto number = [&](double least, double most) {
            if (!value.is_number() || !(value.get<double>() >= least && value.get<double>() <= most))
                refuse(field, value.dump().substr(0, 40), "a number from " + std::to_string(least) + " to " + std::to_string(most));
            return value.get<double>();
        };
        const auto truth = [&] {
            if (!value.is_boolean()) refuse(field, value.dump().substr(0, 40), "true or false");
            return value.get<bool>();
        };
        if (key == "kind") {
            const auto at = std::find_if(kind_names.begin(), kind_names.end(), [&](const char* n) { return value == n; });
            if (at == kind_names.end()) refuse(field, value.dump().substr(0, 40), "pixel_unet, pixel_dit, latent_dit or pixel_rays");
            c.kind = Kind(at - kind_names.begin());
        } else if (key == "flow") c.flow = truth();
        else if (key == "masks") c.masks = truth();
        else if (key == "depth") c.depth = truth();
        else if (key == "window") c.window = int64_t(number(0, 1024));
        else if (key == "time_shift") c.time_shift = number(0.1, 100);
        else if (key == "residual_scale") c.residual_scale = number(0.01, 100);
        else if (key == "unet") c.unet = parse_unet_config(value, field);
        else if (key == "rays") c.rays = parse_ray_mixer_config(value, field);
        else if (key == "dit") c.dit = parse_dit_config(value, field);
        else if (key == "vae") c.vae = parse_vae_config(value, field);
        else refuse(field, "an unknown field", "none");
    }
    if (c.kind == Kind::pixel_rays && (c.flow || !c.masks || !c.depth))
        refuse(where + ": kind", "pixel_rays with flow or without masks or depth", "regression from all of them");
    set_channels(c);
    return c;
}

std::string json_of(const ModelConfig& c) {
    nlohmann::ordered_json j = {{"kind", kind_names[size_t(c.kind)]},
                                {"flow", c.flow},
                                {"masks", c.masks},
                                {"depth", c.depth},
                                {"window", c.window},
                                {"time_shift", c.time_shift},
                                {"residual_scale", c.residual_scale}};
    if (c.kind == Kind::pixel_unet)
        j["unet"] = json_of(c.unet);
    else if (c.kind == Kind::pixel_rays)
        j["rays"] = json_of(c.rays);
    else
        j["dit"] = json_of(c.dit);
    if (!in_pixels(c)) j["vae"] = json_of(c.vae);
    return j.dump();
}

Model initial_model(const ModelConfig& config, uint64_t seed) {
    Model m;
    m.config = config;
    set_channels(m.config);
    m.weights = config.kind == Kind::pixel_rays ? initial_weights(ray_mixer_layout(config.rays), seed, ray_mixer_begins_at_zero)
                : config.kind == Kind::pixel_unet ? initial_weights(unet_layout(m.config.unet), seed, unet_begins_at_zero)
                                                : initial_dit(m.config.dit, seed);
    if (!in_pixels(config)) {
        m.vae.config = config.vae;
        m.vae.weights = initial_weights(vae_layout(config.vae), seed + 1, [](const std::string&) { return false; });
    }
    return m;
}

Model load_model(const std::filesystem::path& path) {
    const TensorFiles files(path);
    const auto config = files.metadata().find("config");
    if (config == files.metadata().end())
        refuse(files.file() + ": config", "none in the metadata", "a model of vshift train");
    Model m;
    m.config = parse_model_config(config->second, files.file());
    m.metadata = files.metadata();
    const auto take = [&](const std::string& prefix, const Layout& layout, Weights& to) {
        for (const auto& [name, shape] : layout) {
            const StoredTensor* t = files.find(prefix + name);
            if (!t) refuse(files.file() + ": " + prefix + name, "none", "a tensor of shape " + text_of(shape));
            if (t->shape != shape) refuse(files.file() + ": " + t->name, "shape " + text_of(t->shape), text_of(shape));
            if (t->type < ElementType::f16) refuse(files.file() + ": " + t->name, name_of(t->type), "a float type");
            to[name] = tensor_of(*t);
        }
    };
    take("network.", network_layout(m.config), m.weights);
    if (!in_pixels(m.config)) {
        m.vae.config = m.config.vae;
        take("vae.", vae_layout(m.config.vae), m.vae.weights);
    }
    if (files.tensors().size() != m.weights.size() + m.vae.weights.size())
        refuse(files.file() + ": tensors", std::to_string(files.tensors().size()),
               std::to_string(m.weights.size() + m.vae.weights.size()) + " of the config");
    return m;
}

void save_model(const std::filesystem::path& file, const Model& model, const Weights& weights) {
    std::vector<Tensor> kept;
    std::vector<StoredTensor> stored;
    const auto add = [&](const std::string& prefix, const Weights& from) {
        for (const auto& [name, t] : from) {
            kept.push_back(t.detach().cpu().contiguous());
            stored.push_back(stored_of(prefix + name, kept.back()));
        }
    };
    add("network.", weights);
    add("vae.", model.vae.weights);
    auto metadata = model.metadata;
    metadata["config"] = json_of(model.config);
    write_tensor_file(file, stored, metadata);
}

int64_t model_side(const ModelConfig& c) {
    if (c.kind == Kind::pixel_rays) return 1;
    if (c.kind == Kind::pixel_unet) return unet_side(c.unet);
    const int64_t patch = std::max(c.dit.patch[1], c.dit.patch[2]);
    return in_pixels(c) ? patch : patch * vae_side(c.vae);
}

Views padded(const ModelConfig& config, const Views& views) {
    const int64_t side = model_side(config), down = (side - views.fill.size(3) % side) % side,
                  right = (side - views.fill.size(4) % side) % side;
    if (down == 0 && right == 0) return views;
    Views v = views;
    for (Tensor* x : {&v.fill, &v.target, &v.inverse_depth})
        if (x->defined()) *x = at::replication_pad3d(*x, {0, right, 0, down, 0, 0});
    for (Tensor* x : {&v.hole, &v.neighbor, &v.weight})
        if (x->defined()) *x = at::constant_pad_nd(*x, {0, right, 0, down});
    return v;
}

Example prepare(const Model& model, const Views& v, VaeState* target_state, VaeState* condition_state) {
    const ModelConfig& c = model.config;
    Example e;
    std::vector<Tensor> seen;
    Tensor hole = v.hole, neighbor = v.neighbor, near = (v.inverse_depth * near_m).clamp(0, 2) - 1;
    e.may_change = at::maximum(hole, neighbor);
    e.weight = v.weight.defined() ? v.weight : e.may_change;
    if (c.kind == Kind::pixel_rays) {
        if (!v.seen.defined()) refuse("train: sample: seen", "none", "what the rays of pixel_rays meet");
        e.z0 = (v.target - v.fill) * c.residual_scale * e.may_change;
        e.condition = v.seen;
        return e;
    }
    if (in_pixels(c)) {
        if (v.target.defined()) e.z0 = (v.target - v.fill) * c.residual_scale * e.may_change;
        seen.push_back(v.fill * 2 - 1);
    } else {
        at::NoGradGuard frozen;
        VaeState own_target, own_condition;
        VaeState& condition = condition_state ? *condition_state : own_condition;
        const bool first = !condition.begun;
        if (v.target.defined()) e.z0 = vae_encode(model.vae, v.target * 2 - 1, target_state ? *target_state : own_target);
        seen.push_back(vae_encode(model.vae, v.fill * 2 - 1, condition));
        const int64_t side = vae_side(c.vae), frames = vae_frames(c.vae);
        for (Tensor* x : {&hole, &neighbor, &near, &e.may_change, &e.weight}) *x = shares(*x, side, frames, first);
    }
    if (c.masks) {
        seen.push_back(hole);
        seen.push_back(neighbor);
    }
    if (c.depth) seen.push_back(near);
    e.condition = at::cat(seen, 1);
    return e;
}

Tensor velocity(const Model& model, const Weights& weights, const Tensor& z, const Tensor& t, const Tensor& condition,
                const DitOptions& options) {
    if (model.config.kind == Kind::pixel_rays) {
        const auto s = z.sizes();
        const Tensor seen = condition.movedim(1, -1).flatten(0, -2);
        const Tensor fill = (seen.narrow(1, ray_count * ray_numbers, 3) + 1) / 2;
        const Tensor change = (ray_mixer_forward(model.config.rays, weights, seen) - fill) * model.config.residual_scale;
        return -change.reshape({s[0], s[2], s[3], s[4], 3}).movedim(-1, 1);
    }
    const Tensor x = at::cat({z, condition}, 1);
    if (model.config.kind == Kind::pixel_unet) return unet_forward(model.config.unet, weights, x, t * 1000);
    return dit_forward({model.config.dit, weights}, x, (t * 1000).unsqueeze(1), {}, options);
}

Tensor loss_of(const Model& model, const Weights& weights, const Example& e, const Tensor& noise, const Tensor& time) {
    const ModelConfig& c = model.config;
    const Tensor t = c.flow ? time : at::ones({e.z0.size(0)}, e.z0.options());
    Tensor z1 = c.flow ? noise : at::zeros_like(e.z0);
    if (in_pixels(c)) z1 = z1 * e.may_change;  // what is known is not noise
    DitOptions options;
    options.window = c.window;
    const Tensor z = flow_point(e.z0, z1, t.view({-1, 1, 1, 1, 1}));
    const Tensor error = (velocity(model, weights, z, t, e.condition, options) - flow_velocity(e.z0, z1)).pow(2).mean(1, true);
    // Every sample counts the same, however much of it may change: so small batches add up to the large one.
    const Tensor sums = (error * e.weight).sum({1, 2, 3, 4}) / e.weight.sum({1, 2, 3, 4}).clamp_min(1e-6);
    return sums.mean();
}

Tensor noise(at::IntArrayRef sizes, uint64_t seed, uint64_t number) {
    return at::randn(sizes, at::detail::createCPUGenerator(mixed(seed, number)), at::TensorOptions().dtype(at::kFloat));
}

/// Kind pixel_rays, on the CPU: a list of hole pixels.
Tensor inpaint_by_rays(const Model& model, const Views& v) {
    const int64_t B = v.fill.size(0), F = v.fill.size(2), H = v.fill.size(3), W = v.fill.size(4);
    const Tensor hole = v.hole.cpu().contiguous(), near = v.inverse_depth.cpu().contiguous();
    Tensor made = v.fill.cpu().clone();
    for (int64_t b = 0; b < B; ++b)
        for (int64_t f = 0; f < F; ++f) {
            const Tensor fill = v.fill.cpu().select(0, b).select(1, f).contiguous();
            const RayPlanes planes{int(W), int(H), fill.data_ptr<float>(), hole.select(0, b).select(1, f).data_ptr<float>(),
                                   near.select(0, b).select(1, f).data_ptr<float>()};
            std::vector<int32_t> chosen;
            for (int32_t i = 0; i < H * W; ++i)
                if (planes.hole[i] > 0) chosen.push_back(i);
            const RayNumbers seen = ray_numbers_of(planes, chosen);
            Tensor frame = made.select(0, b).select(1, f);  // a view
            // In pieces that a cache holds.
            for (size_t at = 0; at < chosen.size(); at += rays_at_once) {
                const auto n = int64_t(std::min(rays_at_once, chosen.size() - at));
                const auto of = [&](const std::vector<float>& numbers, int64_t each) {
                    return at::from_blob(const_cast<float*>(numbers.data()) + int64_t(at) * each, {n, each}, at::kFloat);
                };
                const Tensor colors = ray_mixer_forward(model.config.rays, model.weights,
                                                        at::cat({of(seen.rays, ray_count * ray_numbers), of(seen.own, own_numbers)}, 1));
                const auto color = colors.accessor<float, 2>();
                auto out = frame.accessor<float, 3>();
                for (int64_t i = 0; i < n; ++i)
                    for (int64_t c = 0; c < 3; ++c) {
                        const int32_t pixel = chosen[at + size_t(i)];
                        out[c][pixel / W][pixel % W] = std::clamp(color[i][c], 0.0f, 1.0f);
                    }
            }
        }
    return made.to(v.fill.device());
}

Tensor inpaint(const Model& model, const Views& input, int steps, uint64_t seed, Stream& stream) {
    at::NoGradGuard no_grad;
    if (model.config.kind == Kind::pixel_rays) return inpaint_by_rays(model, input);
    const ModelConfig& c = model.config;
    const int64_t H = input.fill.size(3), W = input.fill.size(4);
    Views v = padded(c, input);
    v.target = Tensor();
    const Example e = prepare(model, v, nullptr, &stream.condition);
    const int64_t frames = e.condition.size(2);
    const std::vector<double> times = flow_times(c.flow ? steps : 1, c.time_shift);
    if (c.window > 0) stream.caches.resize(times.size() - 1);
    // A frame's noise is its own, whatever piece it comes in.
    std::vector<Tensor> parts;
    for (int64_t f = 0; f < frames; ++f) {
        const auto s = e.condition.sizes();
        const at::DimVector size{s[0], in_pixels(c) ? 3 : c.vae.z_dim, 1, s[3], s[4]};
        parts.push_back(c.flow ? noise(size, seed, uint64_t(stream.frames + f)) : at::zeros(size));
    }
    Tensor z1 = at::cat(parts, 2).to(e.condition.device());
    if (in_pixels(c)) z1 = z1 * e.may_change;
    const Tensor z0 = euler(z1, times, [&](const Tensor& z, double t, int step) {
        DitOptions options;
        options.window = c.window;
        if (c.window > 0) options.cache = &stream.caches[size_t(step)];
        return velocity(model, model.weights, z, at::full({z.size(0)}, t, z.options()), e.condition, options);
    });
    stream.frames += frames;

    const Tensor made = in_pixels(c) ? v.fill + z0 / c.residual_scale : (vae_decode(model.vae, z0, stream.output) + 1) / 2;
    const Tensor cropped = made.narrow(3, 0, H).narrow(4, 0, W).clamp(0, 1);
    return at::where(at::maximum(input.hole, input.neighbor) > 0, cropped, input.fill);
}

}  // namespace vshift::inpaint
