// SPDX-License-Identifier: Apache-2.0
#include "inpaint/model.h"

#include <ATen/CPUGeneratorImpl.h>
#include <time.h>

#include <algorithm>
#include <cmath>

namespace vshift::inpaint {
namespace {

constexpr double spread_weight = 1e-4;  // of the latents' distance from the normal distribution, beside the squared error
constexpr double least_time = 1e-3;  // of models that give z0
constexpr double near_m = 8;  // 1/z is seen in eighths of a metre
constexpr int64_t texture_reach_px = 8;  // the truth's texture is what deviates from the mean so far around: 17, as rays see

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
        if (!v.seen.defined())
            throw Error(ExitCode::bad_input, "train: sample: seen: got none, expected what the rays of pixel_rays meet");
        e.z0 = (v.target - v.fill) * c.residual_scale * e.may_change;
        e.condition = v.seen;
        return e;
    }
    if (in_pixels(c)) {
        if (v.target.defined()) e.z0 = (v.target - v.fill) * c.residual_scale * e.may_change;
        if (c.has_start) {
            if (!v.texture.defined())
                throw Error(ExitCode::bad_input, "views: texture: got none, expected that of the model's start");
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
