// SPDX-License-Identifier: Apache-2.0
// The networks against outputs of Wan2.2's and of Diffusers' own implementations, and against themselves in pieces.
#include <cstdlib>

#include "inpaint/vae.h"
#include "tests/inpaint/small_models.h"

namespace fs = std::filesystem;
using namespace vshift;
using namespace vshift::inpaint;

namespace {

constexpr double parity = 1e-5;

Tensor named(const TensorFiles& files, const char* name) {
    const StoredTensor* t = files.find(name);
    REQUIRE(t);
    return tensor_of(*t);
}

DitConfig tiny_dit() {
    return parse_dit_config(nlohmann::json::parse(R"({"in_channels":8,"out_channels":4,"dim":48,"ffn_dim":96,"layers":2,
        "heads":2,"freq_dim":32,"text_dim":20,"text_len":12})"), "test");
}

VaeConfig tiny_vae(const TensorFiles& io, const char* json = R"({"dim":8,"dec_dim":12,"z_dim":6})") {
    VaeConfig c = parse_vae_config(nlohmann::json::parse(json), "test");
    const Tensor mean = named(io, "mean"), std = named(io, "std");
    for (int64_t i = 0; i < c.z_dim; ++i) {
        c.mean.push_back(mean[i].item<float>());
        c.std.push_back(std[i].item<float>());
    }
    return c;
}

/// The same weights written under Diffusers' names, and read back.
template <class Rename>
Weights by_way_of_diffusers(const Weights& weights, const Layout& layout, Network network, Rename rename) {
    std::vector<StoredTensor> stored;
    for (const auto& [name, t] : weights) stored.push_back(stored_of(rename(name), t));
    const fs::path file = fs::temp_directory_path() / ("vshift-parity-" + std::to_string(std::rand()) + ".safetensors");
    write_tensor_file(file, stored, {});
    const Weights back = load_weights(TensorFiles(file), layout, network);
    fs::remove(file);
    return back;
}

Vae random_vae(uint64_t seed) {
    Vae vae;
    vae.config = parse_vae_config(nlohmann::json::parse(R"({"dim":4,"dec_dim":4,"z_dim":3,"res_blocks":1})"), "test");
    at::manual_seed(seed);
    for (const auto& [name, shape] : vae_layout(vae.config)) {
        const Tensor t = at::randn(shape);
        vae.weights[name] = name.find("gamma") != std::string::npos ? 1 + 0.1 * t
                                                                     : t / std::sqrt(double(t.numel() / t.size(0)) + 1);
    }
    return vae;
}

void vae_reproduces(const fs::path& weights_file, const fs::path& io_file, const char* json, bool of_wan) {
    const TensorFiles weights(weights_file), io(io_file);
    Vae vae{tiny_vae(io, json), {}};
    vae.weights = load_weights(weights, vae_layout(vae.config), Network::vae);
    const Tensor video = named(io, "vid"), z = named(io, "z"), r = named(io, "r");
    const auto decoded = [&](const Tensor& x) { return of_wan ? x : x.clamp(-1, 1); };  // Diffusers clamps
    VaeState once, down;
    const double encoding = worst(vae_encode(vae, video, once), z), decoding = worst(decoded(vae_decode(vae, z, down)), r);
    WARN((of_wan ? "Wan2.2" : "Diffusers") << " VAE: " << encoding << " encoding, " << decoding << " decoding");
    CHECK(encoding < parity);
    CHECK(decoding < parity);
    // In pieces of 1, 4, 4, ... frames, as Wan2.2 does.
    VaeState e, d;
    std::vector<Tensor> latents, frames;
    for (int64_t at = 0; at < video.size(2); at += at ? 4 : 1)
        latents.push_back(vae_encode(vae, video.narrow(2, at, at ? 4 : 1), e));
    for (const Tensor& latent : latents) frames.push_back(vae_decode(vae, latent, d));
    CHECK(worst(at::cat(latents, 2), z) < parity);
    CHECK(worst(decoded(at::cat(frames, 2)), r) < parity);
    if (of_wan) {
        vae.weights = by_way_of_diffusers(vae.weights, vae_layout(vae.config), Network::vae, vae_name_to_diffusers);
        VaeState again;
        CHECK(worst(vae_encode(vae, video, again), z) < parity);
    }
}

}  // namespace

TEST_CASE("DiT: Wan2.2's own outputs, in both sets of names", "[parity]") {
    at::NoGradGuard no_grad;
    const fs::path folder(VSHIFT_NETWORK_FIXTURES);
    const TensorFiles files(folder / "wan_tiny.safetensors"), io(folder / "wan_io.safetensors");
    Dit dit{tiny_dit(), {}};
    dit.weights = load_weights(files, dit_layout(dit.config), Network::dit);
    const Tensor x = named(io, "x").unsqueeze(0), t = named(io, "t").unsqueeze(0), text = named(io, "ctx").unsqueeze(0);
    const auto check = [&] {
        const double token = worst(dit_forward(dit, x, t, text)[0], named(io, "y"));
        const double scalar = worst(dit_forward(dit, x, at::full({1, 1}, 250.0), text)[0], named(io, "y1"));
        WARN("Wan2.2 DiT: " << token << " with a time per token, " << scalar << " with one time");
        CHECK(token < parity);
        CHECK(scalar < parity);
        // A time per frame is a time per token: here 0 for the first frame, 713 for the others.
        CHECK(worst(dit_forward(dit, x, at::tensor({0.0, 713.0, 713.0}).unsqueeze(0), text)[0], named(io, "y")) < parity);
    };
    check();
    dit.weights = by_way_of_diffusers(dit.weights, dit_layout(dit.config), Network::dit, dit_name_to_diffusers);
    check();
    // The check can fail: one weight changed by a hundredth shows.
    dit.weights["blocks.1.ffn.2.weight"][0][0] += 0.01;
    CHECK(worst(dit_forward(dit, x, t, text)[0], named(io, "y")) > parity);
}

TEST_CASE("VAE: Wan2.2's and Diffusers' own outputs, in one shot and in pieces", "[parity]") {
    at::NoGradGuard no_grad;
    const fs::path own(VSHIFT_NETWORK_FIXTURES), shared = fs::path(VSHIFT_SHARED_DIR) / "fixtures" / "wan";
    vae_reproduces(own / "vae_small.safetensors", own / "vae_small_io.safetensors",
                   R"({"dim":4,"dec_dim":4,"z_dim":3,"res_blocks":1})", false);
    // Wan2.2's own are 7 MB and come with the project's shared data; where that is there, they must be.
    if (fs::exists(VSHIFT_SHARED_DIR))
        vae_reproduces(shared / "vae_tiny.safetensors", shared / "vae_io.safetensors",
                       R"({"dim":8,"dec_dim":12,"z_dim":6})", true);
    else
        WARN("no shared data: Wan2.2's VAE is compared through Diffusers' outputs only");
}

TEST_CASE("VAE: any pieces give what one shot gives, for 1, 5 and 49 frames", "[parity]") {
    at::NoGradGuard no_grad;
    const Vae vae = random_vae(3);
    for (const int64_t frames : {1, 5, 49}) {
        const Tensor video = random_tensor({1, 3, frames, 32, 48}, 5).clamp(-1, 1);
        VaeState once;
        const Tensor z = vae_encode(vae, video, once);
        CHECK(z.size(2) == 1 + (frames - 1) / 4);
        VaeState once_down;
        const Tensor r = vae_decode(vae, z, once_down);
        CHECK(r.size(2) == frames);
        for (const std::vector<int64_t>& sizes : {std::vector<int64_t>{1, 4}, {5, 8}, {9, 4, 12}}) {
            VaeState e, d;
            std::vector<Tensor> latents, out;
            size_t piece = 0;
            for (int64_t at = 0; at < frames;) {
                const int64_t n = std::min(frames - at, sizes[std::min(piece++, sizes.size() - 1)]);
                latents.push_back(vae_encode(vae, video.narrow(2, at, n), e));
                out.push_back(vae_decode(vae, latents.back(), d));
                at += n;
            }
            CHECK(worst(at::cat(latents, 2), z) < parity);
            CHECK(worst(at::cat(out, 2), r) < 1e-5 * std::max(1.0, r.abs().max().item<double>()));
        }
        // Causal: the first frames do not know of the others.
        VaeState alone;
        CHECK(worst(vae_encode(vae, video.narrow(2, 0, 1), alone), z.narrow(2, 0, 1)) < parity);
    }
}

TEST_CASE("DiT: more input channels keep the old ones bit for bit", "[parity]") {
    at::NoGradGuard no_grad;
    DitConfig c = tiny_dit();
    c.in_channels = 48;
    c.text_dim = 0;
    Dit base{c, initial_dit(c, 7)};
    base.weights["head.head.weight"] = random_tensor({16, 48}, 8) * 0.1;
    const Tensor old = base.weights.at("patch_embedding.weight").clone();
    const Tensor x = random_tensor({1, 48, 2, 4, 6}, 9), t = at::full({1, 1}, 500.0);
    const Tensor y = dit_forward(base, x, t);
    REQUIRE(y.abs().max().item<double>() > 0.01);
    const Tensor condition = random_tensor({1, 48, 2, 4, 6}, 10);

    Dit wide = base;
    widen_input(wide.weights, wide.config, 96, 11);
    const Tensor& weight = wide.weights.at("patch_embedding.weight");
    CHECK(weight.size(1) == 96);
    CHECK(at::equal(weight.narrow(1, 0, 48), old));
    CHECK(wide.config.in_channels == 96);
    // Kaiming: variance 2 / fan in over all 96 channels of 2x2.
    CHECK(weight.narrow(1, 48, 48).var().item<double>() == Approx(2.0 / (96 * 4)).epsilon(0.05));
    CHECK(worst(dit_forward(wide, at::cat({x, condition}, 1), t), y) > 1e-3);

    Dit zero = base;
    widen_input(zero.weights, zero.config, 96, 11, true);
    CHECK(worst(dit_forward(zero, at::cat({x, condition}, 1), t), y) < 1e-5);
    CHECK(hash_of(zero.weights) != hash_of(base.weights));
}

TEST_CASE("latent_dit: begins with Wan2.2's weights of either name, without their text", "[parity][model]") {
    const fs::path folder(VSHIFT_NETWORK_FIXTURES);
    ModelConfig c = parse_model_config(R"({"kind":"latent_dit","flow":true,"dit":{"dim":48,"ffn_dim":96,"layers":2,"heads":2,
        "freq_dim":32,"text_dim":0},"vae":{"dim":4,"dec_dim":4,"z_dim":4,"res_blocks":1}})", "test");
    Model m = initial_model(c, 3);
    const Weights fresh = m.weights, theirs = load_weights(TensorFiles(folder / "wan_tiny.safetensors"), dit_layout(tiny_dit()), Network::dit);
    begin_with_dit(m, folder / "wan_tiny.safetensors", 3);
    REQUIRE(m.weights.size() == fresh.size());
    for (const auto& [name, t] : m.weights) {
        INFO(name);
        REQUIRE(t.sizes() == fresh.at(name).sizes());
        CHECK(at::equal(name == "patch_embedding.weight" ? t.narrow(1, 0, 8) : t, theirs.at(name)));
    }
    CHECK(m.weights.at("patch_embedding.weight").size(1) == 11);  // latent, condition, two masks, 1/z
    CHECK(m.weights.at("patch_embedding.weight").narrow(1, 8, 3).abs().min().item<double>() > 0);

    const auto refusal = [&](const char* config) {
        Model other = initial_model(parse_model_config(config, "test"), 3);
        return told([&] { begin_with_dit(other, folder / "wan_tiny.safetensors", 3); });
    };
    CHECK(refusal(R"({"kind":"pixel_dit","dit":{"dim":48,"heads":2,"text_dim":0}})").find("expected a latent_dit") != std::string::npos);
    CHECK(refusal(R"({"kind":"latent_dit","dit":{"dim":48,"ffn_dim":96,"layers":3,"heads":2,"freq_dim":32,"text_dim":0},
        "vae":{"dim":4,"dec_dim":4,"z_dim":4}})").find("blocks.2.") != std::string::npos);
    CHECK(refusal(R"({"kind":"latent_dit","dit":{"dim":48,"ffn_dim":96,"layers":2,"heads":2,"freq_dim":32,"text_dim":0},
        "vae":{"dim":4,"dec_dim":4,"z_dim":2}})").find("at most the model's 7") != std::string::npos);

    // And the autoencoder, here under Diffusers' names.
    c.vae = parse_vae_config(nlohmann::json::parse(R"({"dim":4,"dec_dim":4,"z_dim":3,"res_blocks":1})"), "test");
    const fs::path vae = folder / "vae_small.safetensors";
    CHECK_THROWS_AS(initial_model(c, 3, vae), Error);  // its latents' mean and spread are not in the file
    c.vae.mean = {0, 0, 0}, c.vae.std = {1, 1, 1};
    const Weights expected = load_weights(TensorFiles(vae), vae_layout(c.vae), Network::vae);
    CHECK(hash_of(initial_model(c, 3, vae).vae.weights) == hash_of(expected));
}

TEST_CASE("DiT: sizes that do not fit are refused", "[parity]") {
    at::NoGradGuard no_grad;
    const Dit dit{tiny_dit(), initial_dit(tiny_dit(), 1)};
    const Tensor text = at::zeros({1, 3, 20}), t = at::zeros({1, 1});
    CHECK_NOTHROW(dit_forward(dit, at::zeros({1, 8, 1, 4, 4}), t, text));
    CHECK_THROWS_AS(dit_forward(dit, at::zeros({1, 7, 1, 4, 4}), t, text), Error);
    CHECK_THROWS_AS(dit_forward(dit, at::zeros({1, 8, 1, 5, 4}), t, text), Error);
    CHECK_THROWS_AS(dit_forward(dit, at::zeros({1, 8, 1, 4, 4}), t), Error);
    CHECK_THROWS_AS(dit_forward(dit, at::zeros({1, 8, 1, 4, 4}), t, at::zeros({1, 13, 20})), Error);
    CHECK_THROWS_AS(dit_forward(dit, at::zeros({1, 8, 1, 4, 4}), at::zeros({1, 2}), text), Error);
}

// Run by tests/inpaint/compare_diffusers.py, which makes the folder from Diffusers' own classes.
TEST_CASE("DiT and VAE: Diffusers' classes with random weights", "[.][diffusers]") {
    at::NoGradGuard no_grad;
    const char* folder = std::getenv("VSHIFT_DIFFUSERS_DIR");
    REQUIRE(folder);
    const fs::path f(folder);
    const TensorFiles io(f / "dit_io.safetensors");
    Dit dit{tiny_dit(), {}};
    dit.weights = load_weights(TensorFiles(f / "dit.safetensors"), dit_layout(dit.config), Network::dit);
    const Tensor x = named(io, "x").unsqueeze(0), text = named(io, "ctx").unsqueeze(0);
    const double token = worst(dit_forward(dit, x, named(io, "t").unsqueeze(0), text)[0], named(io, "y"));
    const double scalar = worst(dit_forward(dit, x, at::full({1, 1}, 250.0), text)[0], named(io, "y1"));
    WARN("WanTransformer3DModel: " << token << " with a time per token, " << scalar << " with one time");
    CHECK(token < parity);
    CHECK(scalar < parity);
    vae_reproduces(f / "vae_small.safetensors", f / "vae_small_io.safetensors",
                   R"({"dim":4,"dec_dim":4,"z_dim":3,"res_blocks":1})", false);
}
