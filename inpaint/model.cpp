// SPDX-License-Identifier: Apache-2.0
#include "inpaint/model.h"

#include <ATen/CPUGeneratorImpl.h>
#include <time.h>

#include <algorithm>
#include <array>
#include <cmath>

namespace vshift::inpaint {
namespace {

constexpr std::array<const char*, 5> kind_names{"pixel_unet", "pixel_dit", "latent_dit", "autoencoder", "pixel_rays"};
constexpr double spread_weight = 1e-4;  // of the latents' distance from the normal distribution, beside the squared error
constexpr double least_time = 1e-3;  // of models that give z0
constexpr double near_m = 8;  // 1/z is seen in eighths of a metre
constexpr int64_t texture_reach_px = 8;  // the truth's texture is what deviates from the mean so far around: 17, as rays see

bool in_pixels(const ModelConfig& c) {
    return c.kind != Kind::latent_dit && c.kind != Kind::autoencoder;
}

/// What follows from the rest: channels in and out.
void set_channels(ModelConfig& c) {
    const int64_t out = in_pixels(c) ? 3 : c.vae.z_dim;
    const int64_t in = 2 * out + (c.masks ? 2 : 0) + (c.depth ? 1 : 0);
    c.unet.in_channels = c.dit.in_channels = in;
    c.unet.out_channels = c.dit.out_channels = out;
}

Layout network_layout(const ModelConfig& c) {
    if (c.kind == Kind::autoencoder) return vae_layout(c.vae);
    if (c.kind == Kind::pixel_rays) return ray_mixer_layout(c.rays);
    return c.kind == Kind::pixel_unet ? unet_layout(c.unet) : dit_layout(c.dit);
}

const char* trained_prefix(const ModelConfig& c) {
    return c.kind == Kind::autoencoder ? "vae." : "network.";
}

[[noreturn]] void refuse(const std::string& where, const std::string& got, const std::string& expected) {
    throw Error(ExitCode::bad_input, where + ": got " + got + ", expected " + expected);
}

StartConfig parse_start(const nlohmann::json& json, const std::string& where) {
    StartConfig s;
    if (!json.is_object()) refuse(where, json.dump().substr(0, 40), "an object");
    for (const auto& [key, value] : json.items()) {
        double* to = key == "noise" ? &s.noise : key == "coupling" ? &s.coupling : key == "gain" ? &s.gain : nullptr;
        if (!to || !value.is_number() || !(value.get<double>() >= 0 && value.get<double>() < (key == "gain" ? 4 : 1)))
            refuse(where + ": " + key, value.dump().substr(0, 40), "noise or coupling, from 0 to below 1, or gain, to below 4");
        *to = value.get<double>();
    }
    return s;
}

double cpu_s() {
    timespec t{};
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return double(t.tv_sec) + 1e-9 * double(t.tv_nsec);
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
            if (at == kind_names.end())
                refuse(field, value.dump().substr(0, 40), "pixel_unet, pixel_dit, latent_dit, autoencoder or pixel_rays");
            c.kind = Kind(at - kind_names.begin());
        } else if (key == "flow") c.flow = truth();
        else if (key == "masks") c.masks = truth();
        else if (key == "depth") c.depth = truth();
        else if (key == "neighbors") c.neighbors = truth();
        else if (key == "window") c.window = int64_t(number(0, 1024));
        else if (key == "time_shift") c.time_shift = number(0.1, 100);
        else if (key == "early_time") c.early_time = number(0.001, 1);
        else if (key == "gives_data") c.gives_data = truth();
        else if (key == "residual_scale") c.residual_scale = number(0.01, 100);
        else if (key == "unet") c.unet = parse_unet_config(value, field);
        else if (key == "start") {
            c.has_start = true;
            c.start = parse_start(value, field);
        } else if (key == "rays") c.rays = parse_ray_mixer_config(value, field);
        else if (key == "dit") c.dit = parse_dit_config(value, field);
        else if (key == "vae") c.vae = parse_vae_config(value, field);
        else refuse(field, "an unknown field", "none");
    }
    if (c.kind == Kind::pixel_rays && (c.flow || !c.masks || !c.depth))
        refuse(where + ": kind", "pixel_rays with flow or without masks or depth", "regression from all of them");
    if (c.has_start && (!c.flow || c.neighbors || (c.kind != Kind::pixel_unet && c.kind != Kind::pixel_dit)))
        refuse(where + ": start", "one for latents, regression or neighbours", "one for a flow of pixel_unet or pixel_dit");
    set_channels(c);
    return c;
}

std::string json_of(const ModelConfig& c) {
    nlohmann::ordered_json j = {{"kind", kind_names[size_t(c.kind)]},
                                {"flow", c.flow},
                                {"masks", c.masks},
                                {"depth", c.depth},
                                {"neighbors", c.neighbors},
                                {"window", c.window},
                                {"time_shift", c.time_shift},
                                {"gives_data", c.gives_data},
                                {"early_time", c.early_time},
                                {"residual_scale", c.residual_scale}};
    if (c.kind == Kind::pixel_unet)
        j["unet"] = json_of(c.unet);
    else if (c.kind == Kind::pixel_rays)
        j["rays"] = json_of(c.rays);
    else if (c.kind != Kind::autoencoder)
        j["dit"] = json_of(c.dit);
    if (!in_pixels(c)) j["vae"] = json_of(c.vae);
    if (c.has_start) {
        j["start"] = {{"noise", c.start.noise}, {"coupling", c.start.coupling}, {"gain", c.start.gain}};
        j["rays"] = json_of(c.rays);
    }
    return j.dump();
}

Model initial_model(const ModelConfig& config, uint64_t seed) {
    Model m;
    m.config = config;
    set_channels(m.config);
    if (!in_pixels(config)) m.vae.config = config.vae;
    switch (config.kind) {
        case Kind::autoencoder:
            m.weights = initial_vae(config.vae, seed);
            break;
        case Kind::pixel_rays:
            m.weights = initial_weights(ray_mixer_layout(config.rays), seed, ray_mixer_begins_at_zero);
            break;
        case Kind::pixel_unet:
            m.weights = initial_weights(unet_layout(m.config.unet), seed, unet_begins_at_zero);
            break;
        default:
            m.weights = initial_dit(m.config.dit, seed);
    }
    if (config.kind == Kind::latent_dit) m.vae.weights = initial_vae(config.vae, seed + 1);
    if (config.has_start) m.rays = initial_weights(ray_mixer_layout(config.rays), seed + 1, ray_mixer_begins_at_zero);
    return m;
}

Model initial_model_with_start(const ModelConfig& config, uint64_t seed, const std::filesystem::path& file) {
    const Model rays = load_model(file);
    if (!config.has_start || rays.config.kind != Kind::pixel_rays || ray_mixer_layout(config.rays) != ray_mixer_layout(rays.config.rays))
        refuse(file.string() + ": config", json_of(rays.config), "a pixel_rays of the size of the rays in " + json_of(config));
    Model m = initial_model(config, seed);
    m.rays = rays.weights;
    const auto record = rays.metadata.find("training");
    if (record != rays.metadata.end()) m.metadata["start_training"] = record->second;
    return m;
}

Model initial_model(const ModelConfig& config, uint64_t seed, const std::filesystem::path& file) {
    if (const TensorFiles files(file); !files.metadata().contains("config")) {
        const auto numbers = size_t(config.vae.z_dim);
        if (config.vae.mean.size() != numbers || config.vae.std.size() != numbers)
            refuse(files.file() + ": config: vae: mean, std", std::to_string(config.vae.mean.size()) + " and " + std::to_string(config.vae.std.size()),
                   "what this autoencoder's latents have, " + std::to_string(numbers) + " numbers each");
        Model m = initial_model(config, seed);
        m.vae.weights = load_weights(files, vae_layout(config.vae), Network::vae);
        return m;
    }
    const Model trained = load_model(file);
    if (trained.config.kind != Kind::autoencoder || config.kind != Kind::latent_dit)
        refuse(file.string() + ": kind", kind_names[size_t(trained.config.kind)], "an autoencoder, for a latent_dit");
    ModelConfig with = config;
    with.vae = trained.config.vae;
    Model m = initial_model(with, seed);
    m.vae.weights = trained.weights;
    const auto record = trained.metadata.find("training");
    if (record != trained.metadata.end()) m.metadata["autoencoder_training"] = record->second;
    return m;
}

void begin_with_regression(Model& model, const std::filesystem::path& file) {
    const Model from = load_model(file);
    if (model.config.kind != Kind::pixel_unet || from.config.kind != Kind::pixel_unet || from.config.flow ||
        unet_layout(model.config.unet) != unet_layout(from.config.unet))
        refuse(file.string() + ": config", json_of(from.config), "a regression by the same network as " + json_of(model.config));
    model.weights = from.weights;
    // Its z1 was 0, so that what it has for z is chance; and v = -z0.
    model.weights.at("in.weight").narrow(1, 0, 4 * model.config.unet.out_channels).zero_();
    if (model.config.gives_data && !from.config.gives_data)
        for (const char* name : {"out.weight", "out.bias"}) model.weights.at(name).neg_();
}

void begin_with_dit(Model& model, const std::filesystem::path& file, uint64_t seed) {
    const DitConfig& own = model.config.dit;
    const TensorFiles files(file);
    if (model.config.kind != Kind::latent_dit || own.text_dim != 0)
        refuse(files.file() + ": config", json_of(model.config), "a latent_dit with text_dim 0");
    DitConfig theirs = own;
    const auto inputs_of = [&](const char* name, int64_t& to) {
        if (const StoredTensor* t = files.find(name); t && t->shape.size() > 1) to = t->shape[1];
    };
    inputs_of("patch_embedding.weight", theirs.in_channels);
    inputs_of("text_embedding.0.weight", theirs.text_dim);
    inputs_of("condition_embedder.text_embedder.linear_1.weight", theirs.text_dim);  // Diffusers' name
    if (theirs.in_channels > own.in_channels)
        refuse(files.file() + ": patch_embedding.weight", std::to_string(theirs.in_channels) + " channels",
               "at most the model's " + std::to_string(own.in_channels));
    model.weights = load_weights(files, dit_layout(theirs), Network::dit);
    widen_input(model.weights, theirs, own.in_channels, seed);
    const Layout kept = dit_layout(own);
    std::erase_if(model.weights, [&](const auto& weight) { return !kept.contains(weight.first); });
}

Model load_model(const std::filesystem::path& path) {
    const TensorFiles files(path);
    Model m;
    m.config = parse_model_config(trained_config(files, "vshift train"), files.file());
    m.metadata = files.metadata();
    Groups groups{{trained_prefix(m.config), network_layout(m.config)}};
    if (m.config.kind == Kind::latent_dit) groups["vae."] = vae_layout(m.config.vae);
    if (m.config.has_start) groups["start."] = ray_mixer_layout(m.config.rays);
    auto weights = trained_weights(files, groups);
    m.weights = std::move(weights.at(trained_prefix(m.config)));
    if (!in_pixels(m.config)) m.vae.config = m.config.vae;
    if (m.config.kind == Kind::latent_dit) m.vae.weights = std::move(weights.at("vae."));
    if (m.config.has_start) m.rays = std::move(weights.at("start."));
    return m;
}

void save_model(const std::filesystem::path& file, const Model& model, const Weights& weights) {
    std::map<std::string, const Weights*> groups{{trained_prefix(model.config), &weights}};
    if (model.config.kind == Kind::latent_dit) groups["vae."] = &model.vae.weights;
    if (model.config.has_start) groups["start."] = &model.rays;
    write_trained(file, groups, model.metadata, json_of(model.config));
}

int64_t model_side(const ModelConfig& c) {
    if (c.kind == Kind::pixel_rays) return 1;
    if (c.kind == Kind::pixel_unet) return unet_side(c.unet);
    if (c.kind == Kind::autoencoder) return vae_side(c.vae);
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
    for (Tensor* x : {&v.hole, &v.neighbor, &v.weight, &v.texture})
        if (x->defined()) *x = at::constant_pad_nd(*x, {0, right, 0, down});
    return v;
}

Example prepare(const Model& model, const Views& v, VaeState* target_state, VaeState* condition_state) {
    const ModelConfig& c = model.config;
    Example e;
    if (c.kind == Kind::autoencoder) {
        e.z0 = v.target * 2 - 1;
        e.condition = e.may_change = e.weight = at::ones_like(v.hole);
        return e;
    }
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
        if (c.has_start) {
            if (!v.texture.defined()) refuse("views: texture", "none", "that of the model's start");
            e.texture = v.texture * c.residual_scale * e.may_change;
        }
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
    const ModelConfig& c = model.config;
    if (c.kind == Kind::pixel_rays) {
        const auto s = z.sizes();
        const Tensor seen = condition.movedim(1, -1).flatten(0, -2);
        const Tensor fill = (seen.narrow(1, ray_count * ray_numbers, 3) + 1) / 2;
        const Tensor change = (ray_mixer_forward(c.rays, weights, seen) - fill) * c.residual_scale;
        return -change.reshape({s[0], s[2], s[3], s[4], 3}).movedim(-1, 1);
    }
    const Tensor x = at::cat({z, condition}, 1);
    const Tensor made = c.kind == Kind::pixel_unet ? unet_forward(c.unet, weights, x, t * 1000)
                                                   : dit_forward({c.dit, weights}, x, (t * 1000).unsqueeze(1), {}, options);
    if (!c.gives_data) return made;
    const Tensor z0 = in_pixels(c) ? made : made + condition.narrow(1, 0, c.vae.z_dim);
    return (z - z0) / t.clamp_min(least_time).view({-1, 1, 1, 1, 1});
}

namespace {

/// Where nothing may change: 0 in pixels (the fill), the condition's latent in latents. In pixels by share, as z0 is.
Tensor held(const ModelConfig& c, const Example& e, const Tensor& z) {
    if (in_pixels(c)) return z * e.may_change;
    return at::where(e.may_change > 0, z, e.condition.narrow(1, 0, c.vae.z_dim));
}

/// What deviates from its mean nearby, over what may change: [B, 3, F, H, W].
Tensor texture_of(const Tensor& z0, const Tensor& may_change) {
    const int64_t r = texture_reach_px;
    const auto around = [&](const Tensor& x) { return at::avg_pool3d(x, {1, 2 * r + 1, 2 * r + 1}, {1, 1, 1}, {0, r, r}); };
    return (z0 - around(z0 * may_change) / around(may_change).clamp_min(1e-6)) * may_change;
}

/// Squared error of what comes back from latents moved by their own spread, and how far they are from normal ones.
Tensor autoencoder_loss(const ModelConfig& c, const Weights& weights, const Example& e, const Tensor& noise) {
    VaeState encoding, decoding;
    const std::vector<Tensor> moments = vae_moments({c.vae, weights}, e.z0, encoding).to(at::kFloat).chunk(2, 1);
    const Tensor &mean = moments[0], spread = moments[1].clamp(-30, 20);
    const Tensor back = vae_decode_raw({c.vae, weights}, mean + (spread / 2).exp() * noise, decoding);
    const Tensor from_normal = (mean.pow(2) + spread.exp() - 1 - spread).mean() / 2;
    return (back - e.z0).pow(2).mean() + spread_weight * from_normal;
}

}  // namespace

Tensor beginning(const ModelConfig& c, const Example& e, const Tensor& noise, const Tensor& z0) {
    if (!c.has_start) return held(c, e, noise);
    Tensor texture = e.texture;
    if (z0.defined() && c.start.coupling > 0)
        texture = c.start.coupling * texture_of(z0, e.may_change) + std::sqrt(1 - c.start.coupling * c.start.coupling) * texture;
    const double strength = c.rays.detail * (z0.defined() ? 1 : c.start.gain);
    return held(c, e, strength * texture + c.start.noise * c.residual_scale * noise);
}

std::vector<int64_t> noise_sizes(const Model& model, const Example& e) {
    std::vector<int64_t> sizes = e.z0.sizes().vec();
    sizes[0] = 1;
    if (model.config.kind != Kind::autoencoder) return sizes;
    const int64_t side = vae_side(model.config.vae), frames = vae_frames(model.config.vae);
    return {1, model.config.vae.z_dim, 1 + (sizes[2] - 1) / frames, sizes[3] / side, sizes[4] / side};
}

Reconstruction reconstruction_of(const Model& model, const Weights& weights, const std::vector<Views>& views) {
    at::NoGradGuard no_grad;
    Reconstruction r;
    std::vector<Tensor> latents;
    double error = 0, count = 0;
    for (const Views& v : views) {
        const Tensor target = padded(model.config, v).target * 2 - 1;
        VaeState encoding, decoding;
        const Tensor mean = vae_moments({model.config.vae, weights}, target, encoding).narrow(1, 0, model.config.vae.z_dim);
        const Tensor back = vae_decode_raw({model.config.vae, weights}, mean, decoding).clamp(-1, 1);
        error += ((back - target) / 2).pow(2).sum().item<double>();
        count += double(target.numel());
        latents.push_back(mean.transpose(0, 1).flatten(1));
    }
    r.psnr_db = -10 * std::log10(error / count);
    const Tensor all = at::cat(latents, 1);
    for (int64_t z = 0; z < all.size(0); ++z) {
        r.mean.push_back(all[z].mean().item<float>());
        r.std.push_back(std::max(all[z].std().item<float>(), 1e-3f));
    }
    return r;
}

Tensor loss_of(const Model& model, const Weights& weights, const Example& e, const Tensor& noise, const Tensor& time) {
    const ModelConfig& c = model.config;
    if (c.kind == Kind::autoencoder) return autoencoder_loss(c, weights, e, noise);
    const Tensor t = c.flow ? time : at::ones({e.z0.size(0)}, e.z0.options());
    const Tensor z0 = held(c, e, e.z0), z1 = c.flow ? beginning(c, e, noise, z0) : held(c, e, at::zeros_like(e.z0));
    DitOptions options;
    options.window = c.window;
    const Tensor z = flow_point(z0, z1, t.view({-1, 1, 1, 1, 1}));
    Tensor error = (velocity(model, weights, z, t, e.condition, options) - flow_velocity(z0, z1)).pow(2).mean(1, true);
    if (c.gives_data) error = error * (t / c.early_time).clamp_max(1).pow(2).view({-1, 1, 1, 1, 1});
    // Every sample counts the same, however much of it may change: so small batches add up to the large one.
    const Tensor sums = (error * e.weight).sum({1, 2, 3, 4}) / e.weight.sum({1, 2, 3, 4}).clamp_min(1e-6);
    return sums.mean();
}

Tensor noise(at::IntArrayRef sizes, uint64_t seed, uint64_t number) {
    return at::randn(sizes, at::detail::createCPUGenerator(mixed(seed, number)), at::TensorOptions().dtype(at::kFloat));
}

int64_t piece_frames(const ModelConfig& config) {
    return in_pixels(config) ? 1 : vae_frames(config.vae);
}

/// On the CPU, frame by frame: `work(planes, color, texture)`, the color's holes filled as they are and no texture.
template <class Work>
std::pair<Tensor, Tensor> by_rays(const Views& v, const Work& work) {
    const int64_t B = v.fill.size(0), F = v.fill.size(2), H = v.fill.size(3), W = v.fill.size(4);
    // Planes of a frame beside each other.
    const auto frames = [](const Tensor& t) { return t.cpu().transpose(1, 2).contiguous(); };
    const Tensor fill = frames(v.fill), hole = frames(v.hole), near = frames(v.inverse_depth), made = fill.clone(),
                 texture = at::zeros_like(made);
    for (int64_t b = 0; b < B; ++b)
        for (int64_t f = 0; f < F; ++f) {
            const auto plane = [&](const Tensor& t) { return t[b][f].data_ptr<float>(); };
            work(RayPlanes{int(W), int(H), plane(fill), plane(hole), plane(near)}, plane(made), plane(texture));
        }
    return {made.transpose(1, 2).to(v.fill.device()), texture.transpose(1, 2).to(v.fill.device())};
}

Views started(const Model& model, const Views& v) {
    const Weights& weights = model.config.has_start ? model.rays : model.weights;
    Views out = v;
    std::tie(out.fill, out.texture) = by_rays(v, [&](const RayPlanes& planes, float* color, float* texture) {
        ray_mixer_texture(model.config.rays, weights, planes, color, texture);
    });
    return out;
}

Tensor inpaint(const Model& model, const Views& input, int steps, uint64_t seed, Stream& stream) {
    at::NoGradGuard no_grad;
    if (model.config.kind == Kind::pixel_rays)
        return by_rays(input, [&](const RayPlanes& planes, float* color, float*) {
                   ray_mixer_fill(model.config.rays, model.weights, planes, color);
               }).first;
    const ModelConfig& c = model.config;
    const int64_t H = input.fill.size(3), W = input.fill.size(4);
    double since = cpu_s();
    Views v = padded(c, c.has_start ? started(model, input) : input);
    v.target = Tensor();
    const auto spent = [&](double& on) { on += cpu_s() - since, since = cpu_s(); };
    const Example e = prepare(model, v, nullptr, &stream.condition);
    spent(stream.cpu_s.encode);
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
    const Tensor z1 = beginning(c, e, at::cat(parts, 2).to(e.condition.device()));
    const Tensor open = (e.may_change > 0).to(z1.scalar_type());
    const Tensor z0 = euler(z1, times, [&](const Tensor& z, double t, int step) {
        DitOptions options;
        options.window = c.window;
        if (c.window > 0) options.cache = &stream.caches[size_t(step)];
        return open * velocity(model, model.weights, z, at::full({z.size(0)}, t, z.options()), e.condition, options);
    });
    stream.frames += frames;
    spent(stream.cpu_s.network);

    const Tensor made = in_pixels(c) ? v.fill + z0 / c.residual_scale : (vae_decode(model.vae, z0, stream.output) + 1) / 2;
    spent(stream.cpu_s.decode);
    const Tensor cropped = made.narrow(3, 0, H).narrow(4, 0, W).clamp(0, 1);
    return at::where(at::maximum(input.hole, input.neighbor) > 0, cropped, input.fill);
}

}  // namespace vshift::inpaint
