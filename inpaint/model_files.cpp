// SPDX-License-Identifier: Apache-2.0
// Role: where models come from and go to: configurations, beginnings, files.
#include <array>

#include "inpaint/model.h"

namespace vshift::inpaint {
namespace {

constexpr std::array<const char*, 5> kind_names{"pixel_unet", "pixel_dit", "latent_dit", "autoencoder", "pixel_rays"};

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

}  // namespace vshift::inpaint
