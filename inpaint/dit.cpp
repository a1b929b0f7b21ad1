// SPDX-License-Identifier: Apache-2.0
#include "inpaint/dit.h"

#include <cmath>
#include <limits>

namespace vshift::inpaint {
namespace {

Tensor linear(const Weights& w, const std::string& name, const Tensor& x) {
    return at::linear(x, get(w, name + ".weight"), get(w, name + ".bias"));
}

Tensor rms_norm(const Tensor& x, const Tensor& weight, double eps) {
    return x * at::rsqrt(x.pow(2).mean(-1, true) + eps) * weight;
}

Tensor layer_norm(const Tensor& x, double eps, const Tensor& weight = {}, const Tensor& bias = {}) {
    return at::layer_norm(x, {x.size(-1)}, weight, bias, eps);
}

/// Angles of the rotary embedding, [F * h * w, width / 2]: shares of time, rows and columns.
Tensor rotary_angles(int64_t width, int64_t first_frame, int64_t f, int64_t h, int64_t w, at::Device device) {
    const auto options = at::TensorOptions().dtype(at::kDouble).device(device);
    const auto axis = [&](int64_t from, int64_t n, int64_t dim) {
        const Tensor rate = at::pow(10000.0, at::arange(0, dim, 2, options) / double(-dim));
        return at::arange(from, from + n, options).unsqueeze(-1) * rate;
    };
    const int64_t side = 2 * (width / 6), time = width - 2 * side;
    const Tensor a = axis(first_frame, f, time).view({f, 1, 1, time / 2}).expand({f, h, w, time / 2});
    const Tensor b = axis(0, h, side).view({1, h, 1, side / 2}).expand({f, h, w, side / 2});
    const Tensor c = axis(0, w, side).view({1, 1, w, side / 2}).expand({f, h, w, side / 2});
    return at::cat({a, b, c}, -1).reshape({f * h * w, width / 2});
}

/// Turns neighbouring pairs; x is [B, heads, L, width].
Tensor rotate(const Tensor& x, const Tensor& cos, const Tensor& sin) {
    const auto sizes = x.sizes().vec();
    const Tensor pairs = x.reshape({sizes[0], sizes[1], sizes[2], sizes[3] / 2, 2});
    const Tensor a = pairs.select(-1, 0), b = pairs.select(-1, 1);
    return at::stack({a * cos - b * sin, a * sin + b * cos}, -1).reshape(sizes);
}

/// `bias` is added to the scores: [queries, keys], or undefined.
Tensor attend(const Tensor& q, const Tensor& k, const Tensor& v, const Tensor& bias = {}) {
#if TORCH_VERSION_MAJOR >= 2
    if (!q.device().is_cpu())
        return at::scaled_dot_product_attention(q, k, v, bias.defined() ? std::optional<Tensor>(bias) : std::nullopt);
#endif
    const double scale = 1 / std::sqrt(double(q.size(-1)));
    const Tensor kt = (k * scale).transpose(-2, -1);
    const auto mixed = [&](const Tensor& part, int64_t first) {
        Tensor scores = at::matmul(part, kt);
        if (bias.defined()) scores = scores + bias.narrow(0, first, part.size(2));
        return at::matmul(at::softmax(scores, -1), v);
    };
    // Rows of the score matrix do not depend on each other: without derivatives a few at a time will do.
    constexpr int64_t rows = 1024;
    if (q.requires_grad() || q.size(2) <= rows) return mixed(q, 0);
    std::vector<Tensor> parts;
    for (int64_t i = 0; i < q.size(2); i += rows) parts.push_back(mixed(q.narrow(2, i, std::min(rows, q.size(2) - i)), i));
    return at::cat(parts, 2);
}

struct Grid3 {
    int64_t frames, rows, columns;
    int64_t per_frame() const { return rows * columns; }
};

Tensor split_heads(const Tensor& x, int64_t heads) {
    return x.view({x.size(0), x.size(1), heads, x.size(2) / heads}).transpose(1, 2);
}
Tensor join_heads(const Tensor& x) {
    return x.transpose(1, 2).reshape({x.size(0), x.size(2), x.size(1) * x.size(3)});
}

class Pass {
public:
    Pass(const Dit& dit, const DitOptions& options, const Grid3& grid, at::Device device)
        : dit_(dit), w_(dit.weights), c_(dit.config), options_(options), grid_(grid) {
        const int64_t before = options.cache ? options.cache->frames_before : 0;
        const Tensor angles = rotary_angles(c_.dim / c_.heads, before, grid.frames, grid.rows, grid.columns, device);
        cos_ = at::cos(angles).to(at::kFloat);
        sin_ = at::sin(angles).to(at::kFloat);
        if (c_.reach > 0) bias_ = far_tokens(device);
        if (options.cache && options.cache->keys.empty()) {
            options.cache->keys.resize(size_t(c_.layers));
            options.cache->values.resize(size_t(c_.layers));
        }
    }

    /// e: [B, 1 or L, 6, dim].
    Tensor block(int64_t layer, const Tensor& x, const Tensor& e, const Tensor& text) {
        const std::string name = "blocks." + std::to_string(layer) + ".";
        const std::vector<Tensor> m = (get(w_, name + "modulation").unsqueeze(0) + e).unbind(2);
        Tensor y = x + self_attention(layer, name + "self_attn", layer_norm(x, c_.eps) * (1 + m[1]) + m[0]) * m[2];
        if (c_.text_dim) {
            const Tensor n = layer_norm(y, c_.eps, get(w_, name + "norm3.weight"), get(w_, name + "norm3.bias"));
            y = y + cross_attention(name + "cross_attn", n, text);
        }
        const Tensor h = at::gelu(linear(w_, name + "ffn.0", layer_norm(y, c_.eps) * (1 + m[4]) + m[3]), "tanh");
        return y + linear(w_, name + "ffn.2", h) * m[5];
    }

private:
    Tensor normed(const std::string& attention, const char* part, const Tensor& x) {
        return rms_norm(linear(w_, attention + "." + part, x), get(w_, attention + ".norm_" + part + ".weight"), c_.eps);
    }

    Tensor self_attention(int64_t layer, const std::string& name, const Tensor& x) {
        const Tensor q = rotate(split_heads(normed(name, "q", x), c_.heads), cos_, sin_);
        Tensor k = rotate(split_heads(normed(name, "k", x), c_.heads), cos_, sin_);
        Tensor v = split_heads(linear(w_, name + ".v", x), c_.heads);
        const int64_t n = grid_.per_frame();
        const auto bias = [&](int64_t queries, int64_t keys) { return bias_.defined() ? bias_.repeat({queries, keys}) : bias_; };
        if (options_.window == 0)
            return linear(w_, name + ".o", join_heads(attend(q, k, v, bias(grid_.frames, grid_.frames))));

        int64_t past = 0;  // frames that come before this call's in k and v
        DitCache* cache = options_.cache;
        if (cache && cache->keys[size_t(layer)].defined()) {
            const Tensor& old = cache->keys[size_t(layer)];
            past = old.size(2) / n;
            k = at::cat({old, k}, 2);
            v = at::cat({cache->values[size_t(layer)], v}, 2);
        }
        std::vector<Tensor> parts;
        for (int64_t f = 0; f < grid_.frames; ++f) {
            const int64_t end = past + f + 1, begin = std::max<int64_t>(0, end - options_.window);
            parts.push_back(attend(q.narrow(2, f * n, n), k.narrow(2, begin * n, (end - begin) * n),
                                   v.narrow(2, begin * n, (end - begin) * n), bias(1, end - begin)));
        }
        if (cache && options_.commit) {
            const int64_t total = past + grid_.frames, keep = std::min(options_.window - 1, total);
            cache->keys[size_t(layer)] = k.narrow(2, (total - keep) * n, keep * n).clone();
            cache->values[size_t(layer)] = v.narrow(2, (total - keep) * n, keep * n).clone();
        }
        return linear(w_, name + ".o", join_heads(at::cat(parts, 2)));
    }

    /// -inf where one of a frame's tokens is out of another's reach, else 0: [tokens, tokens].
    Tensor far_tokens(at::Device device) const {
        const auto options = at::TensorOptions().dtype(at::kFloat).device(device);
        const auto far = [&](int64_t n) {
            const Tensor i = at::arange(n, options);
            return (i.unsqueeze(1) - i.unsqueeze(0)).abs() >= double(c_.reach);
        };
        const int64_t h = grid_.rows, w = grid_.columns;
        const Tensor either = at::logical_or(far(h).view({h, 1, h, 1}), far(w).view({1, w, 1, w})).reshape({h * w, h * w});
        return at::zeros({h * w, h * w}, options).masked_fill(either, -std::numeric_limits<double>::infinity());
    }

    Tensor cross_attention(const std::string& name, const Tensor& x, const Tensor& text) {
        const Tensor q = split_heads(normed(name, "q", x), c_.heads);
        const Tensor k = split_heads(normed(name, "k", text), c_.heads);
        const Tensor v = split_heads(linear(w_, name + ".v", text), c_.heads);
        return linear(w_, name + ".o", join_heads(attend(q, k, v)));
    }

    const Dit& dit_;
    const Weights& w_;
    const DitConfig& c_;
    const DitOptions& options_;
    Grid3 grid_;
    Tensor cos_, sin_;
    Tensor bias_;  ///< of one frame's tokens on each other; undefined: none
};

void require(bool holds, const std::string& field, const std::string& got, const std::string& expected) {
    if (!holds) throw Error(ExitCode::bad_input, "DiT: " + field + ": got " + got + ", expected " + expected);
}

}  // namespace

Tensor time_sinusoids(const Tensor& t, int64_t dim) {
    const int64_t half = dim / 2;
    const auto options = at::TensorOptions().dtype(at::kDouble).device(t.device());
    const Tensor rate = at::pow(10000.0, at::arange(half, options) / double(-half));
    const Tensor angle = t.to(at::kDouble).unsqueeze(-1) * rate;
    return at::cat({at::cos(angle), at::sin(angle)}, -1).to(at::kFloat);
}

Tensor dit_forward(const Dit& dit, const Tensor& x, const Tensor& t, const Tensor& text, const DitOptions& options) {
    const DitConfig& c = dit.config;
    const Weights& w = dit.weights;
    const Shape size(x.sizes().begin(), x.sizes().end());
    require(x.dim() == 5 && x.size(1) == c.in_channels && x.size(3) % c.patch[1] == 0 && x.size(4) % c.patch[2] == 0,
            "input", text_of(size),
            "[B, " + std::to_string(c.in_channels) + ", F, multiples of " + std::to_string(c.patch[1]) + " and " +
                std::to_string(c.patch[2]) + "]");
    require(!options.cache || options.window > 0, "cache", "no window", "one");
    const int64_t B = x.size(0), F = x.size(2);
    const Grid3 grid{F, x.size(3) / c.patch[1], x.size(4) / c.patch[2]};
    const int64_t tokens = F * grid.per_frame();

    // Tokens: a patch's values in the order (channel, row, column), as the weights have them.
    const Tensor patches = x.reshape({B, c.in_channels, F, grid.rows, c.patch[1], grid.columns, c.patch[2]})
                               .permute({0, 2, 3, 5, 1, 4, 6})
                               .reshape({B, tokens, c.in_channels * c.patch[1] * c.patch[2]});
    Tensor h = at::linear(patches, get(w, "patch_embedding.weight").reshape({c.dim, -1}), get(w, "patch_embedding.bias"));

    require(t.dim() == 2 && t.size(0) == B && (t.size(1) == 1 || t.size(1) == F || t.size(1) == tokens), "time",
            text_of(Shape(t.sizes().begin(), t.sizes().end())), "[B, 1], [B, F] or [B, tokens]");
    Tensor e = linear(w, "time_embedding.2", at::silu(linear(w, "time_embedding.0", time_sinusoids(t, c.freq_dim))));
    Tensor e0 = linear(w, "time_projection.1", at::silu(e)).view({B, t.size(1), 6, c.dim});
    if (t.size(1) == F && F > 1) {
        e = e.repeat_interleave(grid.per_frame(), 1);
        e0 = e0.repeat_interleave(grid.per_frame(), 1);
    }

    Tensor words;
    if (c.text_dim) {
        require(text.defined() && text.dim() == 3 && text.size(0) == B && text.size(1) <= c.text_len &&
                    text.size(2) == c.text_dim,
                "text", text.defined() ? text_of(Shape(text.sizes().begin(), text.sizes().end())) : "none",
                "[B, up to " + std::to_string(c.text_len) + ", " + std::to_string(c.text_dim) + "]");
        // Padded before the layers, and not masked: Wan2.2 was trained so.
        words = at::constant_pad_nd(text, {0, 0, 0, c.text_len - text.size(1)});
        words = linear(w, "text_embedding.2", at::gelu(linear(w, "text_embedding.0", words), "tanh"));
    }

    Pass pass(dit, options, grid, x.device());
    for (int64_t layer = 0; layer < c.layers; ++layer) h = pass.block(layer, h, e0, words);
    if (options.cache && options.commit) options.cache->frames_before += F;

    const std::vector<Tensor> m = (get(w, "head.modulation").unsqueeze(0) + e.unsqueeze(2)).unbind(2);
    const Tensor y = linear(w, "head.head", layer_norm(h, c.eps) * (1 + m[1]) + m[0]);
    // A token's values come back in the order (row, column, channel).
    return y.view({B, F, grid.rows, grid.columns, c.patch[1], c.patch[2], c.out_channels})
        .permute({0, 6, 1, 2, 4, 3, 5})
        .reshape({B, c.out_channels, F, x.size(3), x.size(4)});
}

}  // namespace vshift::inpaint
