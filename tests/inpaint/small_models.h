// SPDX-License-Identifier: Apache-2.0
// Role: small models and samples for the tests of training and streams.
#pragma once
#include <unistd.h>

#include "inpaint/train.h"
#include "tests/catch.h"

namespace vshift::inpaint {

inline double worst(const Tensor& a, const Tensor& b) {
    REQUIRE(a.sizes() == b.sizes());
    return (a - b).abs().max().item<double>();
}

inline double worst(const Weights& a, const Weights& b) {
    double most = 0;
    for (const auto& [name, t] : a) most = std::max(most, worst(t, b.at(name)));
    return most;
}

inline Tensor random_tensor(at::IntArrayRef sizes, uint64_t seed) {
    return noise(sizes, seed, 0);
}

inline ModelConfig small(Kind kind, bool flow, int64_t window = 0) {
    ModelConfig c = parse_model_config(R"({"unet":{"widths":[8,12]},
        "dit":{"dim":24,"ffn_dim":48,"layers":2,"heads":2,"freq_dim":16,"text_dim":0,"patch":[1,4,4]},
        "vae":{"dim":4,"dec_dim":4,"z_dim":3,"res_blocks":1}})", "test");
    c.kind = kind;
    c.flow = flow;
    c.window = window;
    if (kind == Kind::latent_dit) c.dit.patch = {1, 1, 1};
    return c;
}

/// A model whose output is not zero.
inline Model woken(const ModelConfig& c) {
    Model m = initial_model(c, 3);
    for (auto& [name, t] : m.weights)
        if (t.abs().max().item<double>() == 0 && name.find("weight") != std::string::npos)
            t.copy_(random_tensor(t.sizes(), 4) * 0.05);
    return m;
}

/// Something to learn: under the hole lies what the fill shows, but with red and blue swapped.
inline Views sample(uint64_t number, int64_t frames = 1, int64_t height = 16, int64_t width = 24) {
    Views v;
    v.fill = at::sigmoid(noise({1, 3, frames, (height + 3) / 4, (width + 3) / 4}, 11, number));
    v.fill = v.fill.repeat_interleave(4, 3).repeat_interleave(4, 4).narrow(3, 0, height).narrow(4, 0, width).contiguous();
    v.hole = at::zeros({1, 1, frames, height, width});
    v.hole.narrow(4, width / 4, width / 2).fill_(1);
    v.neighbor = at::zeros_like(v.hole);
    v.inverse_depth = at::full_like(v.hole, 0.1) * (1 - v.hole);
    v.target = at::where(v.hole > 0, v.fill.flip(1), v.fill);
    return v;
}

inline TrainHooks samples(std::function<bool(int64_t, double)> after = {}) {
    return {[](uint64_t i) { return sample(i); }, std::move(after)};
}

template <class Work>
std::string told(Work work) {
    try {
        work();
    } catch (const Error& e) {
        return e.what();
    }
    return "";
}

struct Scratch {
    std::filesystem::path folder = std::filesystem::temp_directory_path() / ("vshift-train-" + std::to_string(::getpid()));
    Scratch() { std::filesystem::create_directories(folder); }
    ~Scratch() { std::filesystem::remove_all(folder); }
};

}  // namespace vshift::inpaint
