// SPDX-License-Identifier: Apache-2.0
// Flows that begin with a pixel_rays' picture: their start, what is there without training, their files.
#include <cmath>
#include <filesystem>

#include "tests/inpaint/small_models.h"

namespace fs = std::filesystem;
using namespace vshift;
using namespace vshift::inpaint;

namespace {

/// A hole in noise, over all rows.
Views views(int64_t height = 24, int64_t width = 40) {
    Views v;
    v.fill = at::sigmoid(noise({1, 3, 1, height, width}, 5, 0));
    v.hole = at::zeros({1, 1, 1, height, width});
    v.hole.narrow(4, width / 4, width / 2).fill_(1);
    v.neighbor = at::zeros_like(v.hole);
    v.inverse_depth = at::full_like(v.hole, 0.1) * (1 - v.hole);
    return v;
}

ModelConfig config_of(double detail, double noise, double coupling) {
    ModelConfig c = parse_model_config(
        R"({"kind":"pixel_unet","flow":true,"start":{},"unet":{"widths":[8,12]},"rays":{"dim":16}})", "test");
    c.rays.detail = detail;
    c.start = {noise, coupling, 1};
    return c;
}

/// Its rays are no mean of the fill alone.
Model with_rays(const ModelConfig& c) {
    Model m = initial_model(c, 3);
    m.rays.at("out.weight").copy_(noise(m.rays.at("out.weight").sizes(), 3, 1) * 0.1);
    return m;
}

Model rays_of(const Model& m) {
    Model rays;
    rays.config.kind = Kind::pixel_rays;
    rays.config.rays = m.config.rays;
    rays.weights = m.rays;
    return rays;
}

}  // namespace

TEST_CASE(
    "start: without velocity and noise a flow gives its pixel_rays' picture, texture and all, in any number of steps",
    "[start]") {
    const Model m = with_rays(config_of(1.1, 0, 0.7));  // its output begins at 0, and is v
    const Views v = views(26, 41);                      // no multiple of anything
    Stream of_rays;
    const Tensor expected = inpaint::inpaint(rays_of(m), v, 1, 1, of_rays);
    REQUIRE(worst(expected, v.fill) > 0.1);
    for (const int steps : {1, 2, 8}) {
        Stream s;
        const Tensor out = inpaint::inpaint(m, v, steps, 1, s);
        CHECK(worst(out, expected) < 1e-5);
        const Tensor known = (v.hole == 0).expand_as(out);
        CHECK(at::equal(out.masked_select(known), v.fill.masked_select(known)));
    }
    // One that gives the data begins at the rays' colors alone.
    Model data = m;
    data.config.gives_data = true;
    Stream s;
    const Tensor colors = started(rays_of(m), v).fill.clamp(0, 1);
    CHECK(worst(inpaint::inpaint(data, v, 4, 1, s), colors) < 1e-5);
    CHECK(worst(colors, expected) > 0.01);
}

TEST_CASE("start: with an oracle's velocity Euler reaches the truth from any start", "[start][flow]") {
    for (const double coupling : {0.0, 0.7})
        for (const double strength : {0.0, 0.1}) {
            const Model m = with_rays(config_of(1.1, strength, coupling));
            Views v = started(m, views());
            v.target = v.fill + 0.3 * noise(v.fill.sizes(), 8, 1) * v.hole;
            const Example e = prepare(m, v);
            const Tensor given = noise(e.z0.sizes(), 9, 1);
            // In training, where z1 knows something of the truth, and in filling, where it does not.
            const Tensor coupled = beginning(m.config, e, given, e.z0), alone = beginning(m.config, e, given);
            CHECK((worst(coupled, alone) > 0.01) == (coupling > 0));
            for (const Tensor& z1 : {coupled, alone})
                for (const int steps : {1, 2, 4, 8}) {
                    const Tensor end = euler(z1, flow_times(steps, 1), [&](const Tensor& z, double t, int) {
                        CHECK(worst(z, flow_point(e.z0, z1, at::full({}, t))) < 1e-5);
                        return flow_velocity(e.z0, z1);
                    });
                    CHECK(worst(end, e.z0) < 1e-5);
                    CHECK(worst(v.fill + end / m.config.residual_scale, v.target) < 1e-5);
                }
        }
}

TEST_CASE("start: texture, the truth's part of it and noise have the strengths that are stated", "[start]") {
    const int64_t side = 64;
    Views v;
    v.fill = at::full({1, 3, 1, side, side}, 0.5);
    v.hole = v.neighbor = v.inverse_depth = at::ones({1, 1, 1, side, side});
    const Tensor column =
        at::arange(side).remainder(2).mul(2).sub(1).view({1, 1, 1, 1, side}).expand_as(v.fill);  // -1, 1, -1 ...
    v.texture = at::full_like(v.fill, 0.05);
    v.target = v.fill + 0.2 + 0.1 * column;
    const auto start = [&](double detail, double strength, double coupling, bool training) {
        const ModelConfig c = config_of(detail, strength, coupling);
        const Example e = prepare(initial_model(c, 1), v);
        return beginning(c, e, noise(e.z0.sizes(), 4, 0), training ? e.z0 : Tensor()) / c.residual_scale;
    };
    CHECK(worst(start(1.1, 0, 0.6, false), at::full_like(v.fill, 1.1 * 0.05)) < 1e-6);
    CHECK(worst(start(1.1, 0, 0, true), at::full_like(v.fill, 1.1 * 0.05)) < 1e-6);
    // Of the truth only what deviates from the mean of 17x17: the stripes, less a seventeenth of them, not the 0.2.
    const Tensor expected = 1.1 * (0.6 * 0.1 * column + 0.8 * 0.05);
    const auto inner = [](const Tensor& t) { return t.narrow(3, 8, 48).narrow(4, 8, 48); };
    CHECK(worst(inner(start(1.1, 0, 0.6, true)), inner(expected)) < 1.1 * 0.6 * 0.1 / 17 + 1e-6);
    CHECK(start(0, 0.03, 0, false).std().item<double>() == Approx(0.03).epsilon(0.03));
    // A gain counts in filling alone.
    ModelConfig c = config_of(1.1, 0, 0.6);
    c.start.gain = 2;
    const Example filled = prepare(initial_model(c, 1), v);
    CHECK(worst(beginning(c, filled, at::zeros_like(filled.z0)) / c.residual_scale,
                at::full_like(v.fill, 2 * 1.1 * 0.05)) < 1e-6);
    // The loss is that of v = z1 - z0 with this z1: here of a network whose v is 0.
    const Model m = initial_model(c, 1);
    const Example e = prepare(m, v);
    const Tensor z1 = beginning(c, e, at::zeros_like(e.z0), e.z0);
    CHECK(loss_of(m, m.weights, e, at::zeros_like(e.z0), at::full({1}, 0.5)).item<double>() ==
          Approx((z1 - e.z0).pow(2).mean().item<double>()).epsilon(1e-5));
}

TEST_CASE("start: its file holds the rays, and what does not fit is refused", "[start][model]") {
    const Scratch scratch;
    const fs::path rays_file = scratch.folder / "rays.safetensors", file = scratch.folder / "flow.safetensors";
    Model rays = rays_of(with_rays(config_of(1.1, 0.02, 0.7)));
    rays.metadata["training"] = "some";
    save_model(rays_file, rays, rays.weights);
    const Model m = initial_model_with_start(config_of(1.1, 0.02, 0.7), 2, rays_file);
    save_model(file, m, m.weights);
    const Model back = load_model(file);
    CHECK(hash_of(back.rays) == hash_of(rays.weights));
    CHECK(json_of(back.config) == json_of(m.config));
    CHECK(back.config.start.coupling == 0.7);
    CHECK(back.metadata.at("start_training") == "some");
    Stream a, b;
    CHECK(at::equal(inpaint::inpaint(m, views(), 2, 1, a), inpaint::inpaint(back, views(), 2, 1, b)));

    ModelConfig wider = m.config;
    wider.rays.dim = 8;
    CHECK(told([&] { initial_model_with_start(wider, 2, rays_file); }).find("a pixel_rays of the size") !=
          std::string::npos);
    CHECK(told([&] { initial_model_with_start(m.config, 2, file); }).find("a pixel_rays of the size") !=
          std::string::npos);
    Model without = m;
    without.rays.erase("out.bias");
    save_model(file, without, without.weights);
    CHECK(told([&] { load_model(file); }).find("start.out.bias") != std::string::npos);
    Views v = views();
    CHECK(told([&] { prepare(m, v); }).find("views: texture") != std::string::npos);
    for (const char* text :
         {R"({"start":{}})", R"({"kind":"pixel_rays","start":{}})", R"({"kind":"latent_dit","flow":true,"start":{}})",
          R"({"flow":true,"neighbors":true,"start":{}})", R"({"flow":true,"start":{"noise":-1}})",
          R"({"flow":true,"start":{"coupling":1}})", R"({"flow":true,"start":{"coupling":"x"}})",
          R"({"flow":true,"start":{"gain":4}})", R"({"flow":true,"start":{"size":1}})", R"({"flow":true,"start":7})",
          R"({"flow":true,"start":null})"})
        CHECK(told([&] { parse_model_config(text, "m"); }).find("m: config: start") == 0);
}

TEST_CASE(
    "flow: from a start that tells nothing of the data, Euler keeps cos(pi/2N)^2N of a normal one's variance at most",
    "[flow]") {
    // A perfect network: of two independent standard normals, E[z0 | z] = (1 - t) z / ((1 - t)^2 + t^2).
    const auto kept = [](const std::vector<double>& times) {
        return euler(at::ones({1}), times,
                     [](const Tensor& z, double t, int) { return (z - z * (1 - t) / ((1 - t) * (1 - t) + t * t)) / t; })
            .pow(2)
            .item<double>();
    };
    const double quarter_turn = std::acos(0.0);
    for (const int steps : {1, 2, 4, 8}) {
        std::vector<double> best;  // equal angles between z0's and z1's share
        for (int i = steps; i >= 0; --i) {
            const double angle = quarter_turn * i / steps;
            best.push_back(std::sin(angle) / (std::sin(angle) + std::cos(angle)));
        }
        const double bound = std::pow(std::cos(quarter_turn / steps), 2 * steps);
        CHECK(kept(best) == Approx(bound).margin(1e-5));
        for (const double shift : {0.5, 1.0, 3.0}) CHECK(kept(flow_times(steps, shift)) < bound + 1e-5);
    }
}
