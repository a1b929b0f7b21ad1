// SPDX-License-Identifier: Apache-2.0
#include "inpaint/vae.h"

#include <cmath>

namespace vshift::inpaint {
namespace {

// Inside, videos are [B, T, C, H, W]: frames of a batch are one batch of images.

Tensor merged(const Tensor& x) {
    return x.flatten(0, 1);
}
Tensor unmerged(const Tensor& x, int64_t batch) {
    const auto s = x.sizes();
    return x.view({batch, s[0] / batch, s[1], s[2], s[3]});
}

/// x over the norm of its channels, times sqrt(C) and gamma.
Tensor rms_norm(const Tensor& x, const Tensor& gamma) {
    const Tensor norm = at::linalg_vector_norm(x, 2, {2}, true).clamp_min(1e-12);
    return x / norm * (gamma.view({1, 1, -1, 1, 1}) * std::sqrt(double(x.size(2))));
}

/// As views and a mean: groups of (channel, frame, row, column) become one channel.
Tensor average_down(const Tensor& x, int64_t out, int64_t ft, int64_t fs) {
    const int64_t pad = (ft - x.size(1) % ft) % ft;
    const Tensor p = pad ? at::constant_pad_nd(x, {0, 0, 0, 0, 0, 0, pad, 0}) : x;
    const int64_t B = p.size(0), T = p.size(1) / ft, C = p.size(2), H = p.size(3) / fs, W = p.size(4) / fs;
    return p.reshape({B, T, ft, C, H, fs, W, fs})
        .permute({0, 1, 3, 2, 5, 7, 4, 6})
        .reshape({B, T, out, C * ft * fs * fs / out, H, W})
        .mean(3);
}

/// The reverse by repetition; the first piece has no frames before its first.
Tensor duplicate_up(const Tensor& x, int64_t out, int64_t ft, int64_t fs, bool first) {
    const int64_t B = x.size(0), T = x.size(1), H = x.size(3), W = x.size(4);
    const Tensor y = x.repeat_interleave(out * ft * fs * fs / x.size(2), 2)
                         .view({B, T, out, ft, fs, fs, H, W})
                         .permute({0, 1, 3, 2, 6, 4, 7, 5})
                         .reshape({B, T * ft, out, H * fs, W * fs});
    return first ? y.narrow(1, ft - 1, y.size(1) - (ft - 1)) : y;
}

class Pass {
public:
    Pass(const Vae& vae, VaeState& state) : w_(vae.weights), c_(vae.config), state_(state), first_(!state.begun) {
        state.begun = true;
    }

    Tensor encode(const Tensor& video) {
        Tensor x = causal("encoder.conv1", video);
        const size_t levels = c_.dim_mult.size();
        for (size_t i = 0; i < levels; ++i) {
            const bool last = i + 1 == levels, time = !last && c_.temporal_down[i];
            const std::string level = "encoder.downsamples." + std::to_string(i) + ".downsamples.";
            const Tensor shortcut = average_down(x, c_.dim * c_.dim_mult[i], time ? 2 : 1, last ? 1 : 2);
            for (int64_t k = 0; k < c_.res_blocks; ++k) x = residual(level + std::to_string(k), x);
            if (!last) x = down(level + std::to_string(c_.res_blocks), x, time);
            x = x + shortcut;
        }
        x = middle("encoder", x);
        return causal("encoder.head.2", at::silu(rms_norm(x, get(w_, "encoder.head.0.gamma"))));
    }

    Tensor decode(const Tensor& latents) {
        Tensor x = middle("decoder", causal("decoder.conv1", latents));
        const size_t levels = c_.dim_mult.size();
        for (size_t i = 0; i < levels; ++i) {
            const bool last = i + 1 == levels, time = !last && c_.temporal_down[levels - 2 - i];
            const std::string level = "decoder.upsamples." + std::to_string(i) + ".upsamples.";
            Tensor y = x;
            for (int64_t k = 0; k <= c_.res_blocks; ++k) y = residual(level + std::to_string(k), y);
            if (!last) {
                const int64_t out = c_.dec_dim * c_.dim_mult[levels - 1 - i];
                y = up(level + std::to_string(c_.res_blocks + 1), y, time) +
                    duplicate_up(x, out, time ? 2 : 1, 2, first_);
            }
            x = y;
        }
        return causal("decoder.head.2", at::silu(rms_norm(x, get(w_, "decoder.head.0.gamma"))));
    }

    /// A convolution over one frame, 1x1.
    Tensor pointwise(const std::string& name, const Tensor& x) {
        const Tensor& weight = get(w_, name + ".weight");
        return unmerged(at::conv2d(merged(x), weight.view({weight.size(0), weight.size(1), 1, 1}), get(w_, name + ".bias")),
                        x.size(0));
    }

private:
    /// What came before x: `frames` frames from the last piece, or zeros. Keeps x's last for the next.
    Tensor with_past(const std::string& name, const Tensor& x, int64_t frames) {
        Tensor& past = state_.past[name];
        if (!past.defined()) {
            auto size = x.sizes().vec();
            size[1] = frames;
            past = at::zeros(size, x.options());
        }
        const Tensor all = at::cat({past, x}, 1);
        past = all.narrow(1, all.size(1) - frames, frames).clone();
        return all;
    }

    /// A 3-frame convolution that sees the past only, as a sum over time of convolutions of frames: Torch 1.13 is
    /// forty times slower at conv3d.
    Tensor causal(const std::string& name, const Tensor& x) {
        const Tensor& weight = get(w_, name + ".weight");
        const int64_t frames = x.size(1), side = weight.size(3);
        const bool begins = !state_.past[name].defined();
        const Tensor all = with_past(name, x, 2);
        Tensor sum;
        for (int64_t dt = 2; dt >= 0; --dt) {
            if (begins && dt + frames <= 2) continue;  // nothing but zeros
            const Tensor y = at::conv2d(merged(all.narrow(1, dt, frames)), weight.select(2, dt),
                                        dt == 2 ? get(w_, name + ".bias") : Tensor(), 1, side / 2);
            sum = sum.defined() ? sum + y : y;
        }
        return unmerged(sum, x.size(0));
    }

    Tensor residual(const std::string& name, const Tensor& x) {
        Tensor y = causal(name + ".residual.2", at::silu(rms_norm(x, get(w_, name + ".residual.0.gamma"))));
        y = causal(name + ".residual.6", at::silu(rms_norm(y, get(w_, name + ".residual.3.gamma"))));
        return y + (w_.count(name + ".shortcut.weight") ? pointwise(name + ".shortcut", x) : x);
    }

    /// Every frame's pixels attend to each other, one head.
    Tensor middle(const std::string& side, const Tensor& input) {
        Tensor x = residual(side + ".middle.0", input);
        const std::string name = side + ".middle.1";
        const Tensor n = pointwise(name + ".to_qkv", rms_norm(x, get(w_, name + ".norm.gamma")));
        const std::vector<Tensor> qkv = merged(n).flatten(2).transpose(1, 2).chunk(3, 2);
        const Tensor scores = at::matmul(qkv[0] / std::sqrt(double(x.size(2))), qkv[1].transpose(1, 2));
        const Tensor y = at::matmul(at::softmax(scores, -1), qkv[2]).transpose(1, 2).reshape(x.sizes());
        x = x + pointwise(name + ".proj", y);
        return residual(side + ".middle.2", x);
    }

    Tensor down(const std::string& name, const Tensor& input, bool time) {
        const Tensor padded = at::constant_pad_nd(merged(input), {0, 1, 0, 1});
        const Tensor x = unmerged(
            at::conv2d(padded, get(w_, name + ".resample.1.weight"), get(w_, name + ".resample.1.bias"), 2), input.size(0));
        if (!time) return x;
        // The video's first frame stands alone; then every second frame, of the three up to it.
        const std::string conv = name + ".time_conv";
        const Tensor all = first_ ? x : at::cat({state_.past.at(conv), x}, 1);
        state_.past[conv] = x.narrow(1, x.size(1) - 1, 1).clone();
        const int64_t out = (all.size(1) - 1) / 2;
        std::vector<Tensor> parts;
        if (first_) parts.push_back(x.narrow(1, 0, 1));
        if (out > 0) {
            Tensor sum;
            for (int64_t dt = 0; dt < 3; ++dt) {
                const Tensor y = at::conv2d(merged(all.slice(1, dt, dt + 2 * out - 1, 2)),
                                            get(w_, conv + ".weight").select(2, dt),
                                            dt == 0 ? get(w_, conv + ".bias") : Tensor());
                sum = dt ? sum + y : y;
            }
            parts.push_back(unmerged(sum, x.size(0)));
        }
        return at::cat(parts, 1);
    }

    Tensor up(const std::string& name, const Tensor& input, bool time) {
        Tensor x = input;
        if (time) {  // two frames of each, but of the video's first one; that one is not seen by the next either
            std::vector<Tensor> parts;
            if (first_) parts.push_back(x.narrow(1, 0, 1));
            const Tensor rest = first_ ? x.narrow(1, 1, x.size(1) - 1) : x;
            if (first_) {
                auto size = x.sizes().vec();
                size[1] = 2;
                state_.past[name + ".time_conv"] = at::zeros(size, x.options());
            }
            if (rest.size(1) > 0) {
                const Tensor y = causal(name + ".time_conv", rest);
                parts.push_back(y.reshape({y.size(0), y.size(1) * 2, y.size(2) / 2, y.size(3), y.size(4)}));
            }
            x = at::cat(parts, 1);
        }
        const int64_t H = x.size(3), W = x.size(4);
        const Tensor wide = merged(x).unsqueeze(3).unsqueeze(5).expand({-1, -1, H, 2, W, 2}).reshape(
            {x.size(0) * x.size(1), x.size(2), 2 * H, 2 * W});
        return unmerged(
            at::conv2d(wide, get(w_, name + ".resample.1.weight"), get(w_, name + ".resample.1.bias"), 1, 1), x.size(0));
    }

    const Weights& w_;
    const VaeConfig& c_;
    VaeState& state_;
    const bool first_;
};

/// Means and standard deviations of the latents as [1, z, 1, 1, 1].
Tensor per_channel(const std::vector<float>& values, float otherwise, const VaeConfig& c, const Tensor& like) {
    Tensor t = at::full({c.z_dim}, otherwise, at::kFloat);
    for (size_t i = 0; i < values.size(); ++i) t[int64_t(i)] = values[i];
    return t.view({1, -1, 1, 1, 1}).to(like.device());
}

void require(bool holds, const std::string& field, const Tensor& got, const std::string& expected) {
    if (!holds)
        throw Error(ExitCode::bad_input, "VAE: " + field + ": got " +
                                             text_of(Shape(got.sizes().begin(), got.sizes().end())) + ", expected " +
                                             expected);
}

}  // namespace

int64_t vae_side(const VaeConfig& config) {
    return int64_t(1) << config.dim_mult.size();
}
int64_t vae_frames(const VaeConfig& config) {
    int64_t frames = 1;
    for (const bool halved : config.temporal_down) frames *= halved ? 2 : 1;
    return frames;
}

Tensor vae_moments(const Vae& vae, const Tensor& video, VaeState& state) {
    const VaeConfig& c = vae.config;
    const int64_t side = vae_side(c), frames = vae_frames(c), first = state.begun ? 0 : 1;
    require(video.dim() == 5 && video.size(1) == 3 && video.size(2) >= 1 && (video.size(2) - first) % frames == 0 &&
                video.size(3) % side == 0 && video.size(4) % side == 0,
            "video", video,
            "[B, 3, " + std::to_string(first) + " + " + std::to_string(frames) + " k, multiples of " +
                std::to_string(side) + "]");
    const int64_t B = video.size(0), T = video.size(2), H = video.size(3) / 2, W = video.size(4) / 2;
    const Tensor x = video.view({B, 3, T, H, 2, W, 2}).permute({0, 2, 1, 6, 4, 3, 5}).reshape({B, T, 12, H, W});
    Pass pass(vae, state);
    return pass.pointwise("conv1", pass.encode(x)).transpose(1, 2);
}

Tensor vae_encode(const Vae& vae, const Tensor& video, VaeState& state) {
    const VaeConfig& c = vae.config;
    const Tensor means = vae_moments(vae, video, state).narrow(1, 0, c.z_dim);
    return ((means - per_channel(c.mean, 0, c, means)) / per_channel(c.std, 1, c, means)).contiguous();
}

Tensor vae_decode_raw(const Vae& vae, const Tensor& latents, VaeState& state) {
    const VaeConfig& c = vae.config;
    require(latents.dim() == 5 && latents.size(1) == c.z_dim && latents.size(2) >= 1, "latents", latents,
            "[B, " + std::to_string(c.z_dim) + ", T, H, W]");
    Pass pass(vae, state);
    const Tensor x = pass.decode(pass.pointwise("conv2", latents.transpose(1, 2)));
    const int64_t B = x.size(0), T = x.size(1), H = x.size(3), W = x.size(4);
    return x.view({B, T, 3, 2, 2, H, W}).permute({0, 2, 1, 5, 4, 6, 3}).reshape({B, 3, T, 2 * H, 2 * W});
}

Tensor vae_decode(const Vae& vae, const Tensor& latents, VaeState& state) {
    const VaeConfig& c = vae.config;
    return vae_decode_raw(vae, latents * per_channel(c.std, 1, c, latents) + per_channel(c.mean, 0, c, latents), state);
}

Weights initial_vae(const VaeConfig& config, uint64_t seed) {
    // What the blocks add begins at 0.
    Weights w = initial_weights(vae_layout(config), seed, [](const std::string& name) {
        return name.find(".residual.6.") != std::string::npos || name.find(".middle.1.proj.") != std::string::npos;
    });
    for (auto& [name, t] : w)
        if (t.dim() == 5 && t.size(2) == 3) {
            t.narrow(2, 0, 2).zero_();
            t.mul_(std::sqrt(3.0));  // a third of the inputs is left
        }
    return w;
}

}  // namespace vshift::inpaint
