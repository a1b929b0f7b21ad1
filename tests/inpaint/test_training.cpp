// SPDX-License-Identifier: Apache-2.0
// Flow matching's signs, streams in pieces, and training: accumulation, resumption, what it leaves alone.
#include <sys/resource.h>

#include <cstdio>
#include <cstdlib>
#include <fstream>

#include <torch/csrc/jit/api/module.h>

#include "tests/inpaint/small_models.h"

namespace fs = std::filesystem;
using namespace vshift;
using namespace vshift::inpaint;

namespace {

/// A latent model of 1 M parameters, to be measured.
ModelConfig streaming(int64_t window) {
    ModelConfig c = small(Kind::latent_dit, true, window);
    c.vae = parse_vae_config(nlohmann::json::parse(R"({"dim":16,"dec_dim":16,"z_dim":16,"res_blocks":1})"), "test");
    c.dit = parse_dit_config(nlohmann::json::parse(R"({"dim":128,"ffn_dim":512,"layers":4,"heads":4,"freq_dim":64,
        "text_dim":0,"patch":[1,1,1]})"), "test");
    return c;
}

}  // namespace

TEST_CASE("flow: on a straight line every number of steps ends at the data", "[flow]") {
    const Tensor z0 = random_tensor({2, 3, 4}, 1), z1 = random_tensor({2, 3, 4}, 2);
    CHECK(worst(flow_point(z0, z1, at::zeros({})), z0) == 0);
    CHECK(worst(flow_point(z0, z1, at::ones({})), z1) == 0);
    // The velocity is the derivative of the path.
    const Tensor slope = (flow_point(z0, z1, at::full({}, 0.75)) - flow_point(z0, z1, at::full({}, 0.25))) / 0.5;
    CHECK(worst(slope, flow_velocity(z0, z1)) < 1e-6);
    for (const int steps : {1, 2, 4, 8})
        for (const double shift : {1.0, 3.0, 5.0}) {
            const Tensor end = euler(z1, flow_times(steps, shift), [&](const Tensor& z, double t, int) {
                CHECK(worst(z, flow_point(z0, z1, at::full({}, t))) < 1e-5);  // on the path all along
                return flow_velocity(z0, z1);
            });
            CHECK(worst(end, z0) < 1e-5);
            // The opposite sign does not: it ends as far beyond the noise.
            const Tensor wrong = euler(z1, flow_times(steps, shift), [&](const Tensor&, double, int) { return -flow_velocity(z0, z1); });
            CHECK(worst(wrong, 2 * z1 - z0) < 1e-5);
        }
    const std::vector<double> times = flow_times(4, 5);
    CHECK(times.front() == 1);
    CHECK(times.back() == 0);
    CHECK(times[2] == Approx(5 * 0.5 / (1 + 4 * 0.5)));
}

TEST_CASE("models begin at the fill, and leave known pixels alone bit for bit", "[model]") {
    for (const Kind kind : {Kind::pixel_unet, Kind::pixel_dit}) {
        const Views v = sample(1, 1, 18, 25);  // no multiple of anything
        Stream a, b;
        CHECK(worst(inpaint::inpaint(initial_model(small(kind, false), 1), v, 1, 1, a), v.fill) == 0);
        const Tensor out = inpaint::inpaint(woken(small(kind, false)), v, 1, 1, b);
        const Tensor known = (v.hole == 0).expand_as(out);
        CHECK(at::equal(out.masked_select(known), v.fill.masked_select(known)));
        CHECK(worst(out, v.fill) > 1e-3);
    }
    Stream s;
    const Views v = sample(1, 1, 32, 32);
    const Tensor out = inpaint::inpaint(woken(small(Kind::latent_dit, true)), v, 2, 1, s);
    const Tensor known = (v.hole == 0).expand_as(out);
    CHECK(at::equal(out.masked_select(known), v.fill.masked_select(known)));
}

TEST_CASE("flow: a network that gives the data goes there in any number of steps", "[flow]") {
    for (const Kind kind : {Kind::pixel_dit, Kind::latent_dit}) {
        ModelConfig c = small(kind, true);
        c.gives_data = true;
        const Model m = initial_model(c, 1);  // its output is 0: the fill, or the condition's latent
        const Views v = sample(1, 1, 32, 32);
        const Example e = prepare(m, v);
        for (const int steps : {1, 2, 4, 8}) {
            Stream s;
            const Tensor out = inpaint::inpaint(m, v, steps, 1, s);
            if (kind == Kind::pixel_dit) {
                CHECK(worst(out, v.fill) < 1e-6);
            } else {
                VaeState decoding;
                const Tensor back = (vae_decode(m.vae, e.condition.narrow(1, 0, c.vae.z_dim), decoding) + 1) / 2;
                const Tensor open = (v.hole > 0).expand_as(out);
                CHECK(worst(out.masked_select(open), back.clamp(0, 1).masked_select(open)) < 1e-5);
            }
        }
        // Near t = 0 the loss stays finite.
        const Tensor loss = loss_of(m, m.weights, e, random_tensor(e.z0.sizes(), 2), at::full({1}, 1e-6));
        CHECK(std::isfinite(loss.item<double>()));
    }
}

TEST_CASE("flow: training may begin with a regression", "[flow]") {
    const Scratch scratch;
    const fs::path file = scratch.folder / "regression.safetensors";
    const Model regression = woken(small(Kind::pixel_unet, false));
    save_model(file, regression, regression.weights);
    ModelConfig c = small(Kind::pixel_unet, true);
    c.gives_data = true;
    Model m = initial_model(c, 5);
    begin_with_regression(m, file);
    const Views v = sample(1);
    Stream a, b;
    const Tensor out = inpaint::inpaint(m, v, 1, 1, a);  // whatever the noise
    REQUIRE(worst(out, v.fill) > 1e-3);
    CHECK(worst(out, inpaint::inpaint(regression, v, 1, 1, b)) < 1e-5);
    Model other = initial_model(small(Kind::pixel_dit, true), 5);
    CHECK(told([&] { begin_with_regression(other, file); }).find("a regression by the same network") != std::string::npos);
}

TEST_CASE("flow: what may not change is neither noise nor moved", "[flow]") {
    // Whatever the network says of known pixels: it sees there what it saw in training, the fill, at every step.
    const ModelConfig c = small(Kind::pixel_dit, true);
    const Model m = woken(c);
    Views v = sample(1, 1, 16, 64);
    v.hole.narrow(4, 0, 32).zero_();
    Stream a, b;
    const Tensor out = inpaint::inpaint(m, v, 3, 1, a);
    const Example e = prepare(m, v);
    std::vector<double> known;
    Tensor z = noise({1, 3, 1, 16, 64}, 1, 0) * e.may_change;
    z = euler(z, flow_times(3, 1), [&](const Tensor& at_t, double t, int) {
        known.push_back((at_t * (1 - e.may_change)).abs().max().item<double>());
        return velocity(m, m.weights, at_t, at::full({1}, t), e.condition) * e.may_change;
    });
    CHECK(known == std::vector<double>{0, 0, 0});
    CHECK(worst(out, at::where(v.hole > 0, (v.fill + z / c.residual_scale).clamp(0, 1), v.fill)) < 1e-6);
}

TEST_CASE("reach: far tokens do not matter, near ones do", "[dit]") {
    ModelConfig c = small(Kind::pixel_dit, false);
    c.dit.layers = 1;
    Views v = sample(1, 1, 16, 64), other = v;
    v.hole.fill_(1);
    other.hole = v.hole;
    other.inverse_depth = v.inverse_depth.clone();
    other.inverse_depth.narrow(4, 40, 24).fill_(0.05);  // tokens 10 to 15 of 16
    for (const int64_t reach : {0, 4}) {
        c.dit.reach = reach;
        const Model m = woken(c);
        Stream a, b;
        const Tensor difference = (inpaint::inpaint(m, v, 1, 1, a) - inpaint::inpaint(m, other, 1, 1, b)).abs();
        CHECK((difference.narrow(4, 16, 12).max().item<double>() == 0) == (reach == 4));  // tokens 4 to 6
        CHECK(difference.narrow(4, 28, 12).max().item<double>() > 0);
    }
}

TEST_CASE("autoencoder: learns to give back single frames, and takes a video frame by frame", "[train]") {
    const Scratch scratch;
    ModelConfig c = small(Kind::autoencoder, false);
    c.vae = parse_vae_config(nlohmann::json::parse(R"({"dim":8,"dec_dim":8,"z_dim":6,"dim_mult":[2,2],"res_blocks":1,
        "temporal_down":[false]})"), "test");
    Model m = initial_model(c, 2);
    TrainOptions o;
    o.steps = 80;
    o.batch = 4;
    o.learning_rate = 5e-3;
    o.ema = 0.9;
    const std::vector<Views> checks{sample(1000, 1, 16, 16), sample(1001, 1, 16, 16)};
    const double before = reconstruction_of(m, m.weights, checks).psnr_db;
    const TrainState s = train(m, o, {[](uint64_t i) { return sample(i, 1, 16, 16); }, {}});
    const Reconstruction after = reconstruction_of(m, s.average, checks);
    INFO(before << " dB to " << after.psnr_db << " dB");
    CHECK(after.psnr_db > before + 3);
    m.config.vae.mean = after.mean;
    m.config.vae.std = after.std;
    const fs::path file = scratch.folder / "vae.safetensors";
    save_model(file, m, s.average);
    // A latent model takes it over as it is, with its latents' mean and deviation.
    ModelConfig latent = small(Kind::latent_dit, true);
    const Model with = initial_model(latent, 3, file);
    CHECK(hash_of(with.vae.weights) == hash_of(s.average));
    CHECK(with.config.dit.out_channels == 6);
    at::NoGradGuard no_grad;
    const Tensor video = sample(7, 3, 16, 16).fill * 2 - 1;
    VaeState state;
    const Tensor latents = vae_encode(with.vae, video, state);
    CHECK(latents.size(2) == 3);
    for (int64_t f = 0; f < 3; ++f) {
        VaeState alone;
        CHECK(worst(vae_encode(with.vae, video.narrow(2, f, 1), alone), latents.narrow(2, f, 1)) < 1e-5);
    }
    CHECK(told([&] { initial_model(small(Kind::pixel_dit, true), 3, file); }).find("latent_dit") != std::string::npos);
}

TEST_CASE("models come back from their files", "[model]") {
    const Scratch scratch;
    for (const Kind kind : {Kind::pixel_unet, Kind::pixel_dit, Kind::latent_dit, Kind::autoencoder}) {
        Model m = woken(small(kind, true, kind == Kind::pixel_unet ? 0 : 3));
        m.metadata = {{"license", "Apache-2.0"}, {"training", "{\"steps\": 0}"}};
        const fs::path file = scratch.folder / "m.safetensors";
        save_model(file, m, m.weights);
        const Model back = load_model(file);
        CHECK(json_of(back.config) == json_of(m.config));
        CHECK(hash_of(back.weights) == hash_of(m.weights));
        CHECK(hash_of(back.vae.weights) == hash_of(m.vae.weights));
        CHECK(back.metadata.at("license") == "Apache-2.0");
        Weights fewer = m.weights;
        fewer.erase(fewer.begin());
        save_model(file, m, fewer);
        CHECK(told([&] { load_model(file); }).find((kind == Kind::autoencoder ? "vae." : "network.") + m.weights.begin()->first) != std::string::npos);
        Weights more = m.weights;
        more["surplus"] = at::zeros({1});
        save_model(file, m, more);
        CHECK_THROWS_AS(load_model(file), Error);
    }
}

TEST_CASE("streams: any pieces give what one shot gives, and memory stays", "[stream]") {
    at::NoGradGuard no_grad;
    for (const Kind kind : {Kind::pixel_dit, Kind::latent_dit}) {
        const Model m = woken(small(kind, true, 3));
        const int64_t frames = 13, unit = kind == Kind::latent_dit ? 4 : 1;
        const Views all = sample(5, frames, 32, 32);
        const auto piece = [&](int64_t at, int64_t n) {
            return Views{all.fill.narrow(2, at, n), all.hole.narrow(2, at, n), all.neighbor.narrow(2, at, n),
                         all.inverse_depth.narrow(2, at, n), {}, {}, {}, {}};
        };
        Stream once;
        const Tensor whole = inpaint::inpaint(m, all, 2, 7, once);
        REQUIRE(worst(whole, all.fill) > 1e-3);
        for (const int64_t length : {unit, 2 * unit}) {
            Stream stream;
            std::vector<Tensor> parts;
            int64_t kept = 0;
            for (int64_t at = 0; at < frames;) {
                const int64_t n = at == 0 ? 1 : std::min(length, frames - at);
                parts.push_back(inpaint::inpaint(m, piece(at, n), 2, 7, stream));
                at += n;
                int64_t now = 0;
                for (const DitCache& c : stream.caches)
                    for (const Tensor& k : c.keys) now += k.numel();
                for (const auto& [name, t] : stream.condition.past) now += t.numel();
                for (const auto& [name, t] : stream.output.past) now += t.numel();
                if (at > 3 * unit) {
                    if (kept) CHECK(now == kept);
                    kept = now;
                }
            }
            CHECK(worst(at::cat(parts, 2), whole) < 1e-5);
        }
        // The window counts: without it the first frames would know of the last ones, and the last of the first.
        Model wide = m;
        wide.config.window = 0;
        Stream full;
        CHECK(worst(inpaint::inpaint(wide, all, 2, 7, full), whole) > 1e-4);
        Stream first;
        CHECK(worst(inpaint::inpaint(m, piece(0, 1), 2, 7, first), whole.narrow(2, 0, 1)) < 1e-5);
    }
}

// For test_streams.py and benchmark/charts/streaming.py: models that were never trained, VSHIFT_MODELS=FOLDER.
TEST_CASE("models with a window, as files", "[.][models]") {
    const char* folder = std::getenv("VSHIFT_MODELS");
    REQUIRE(folder);
    for (const Kind kind : {Kind::pixel_dit, Kind::latent_dit}) {
        const Model m = woken(small(kind, true, 3));
        save_model(fs::path(folder) / (kind == Kind::pixel_dit ? "pixels.safetensors" : "latents.safetensors"), m, m.weights);
    }
    // What a user's estimator may look like, and one that gives something else.
    for (const auto& [name, body] : {std::pair<const char*, const char*>{"seven.pt", "torch.ones_like(x[:, 0:1]) * 7.0"},
                                     {"nothing.pt", "x.mean()"}}) {
        torch::jit::Module module("estimator");
        module.define(std::string("def forward(self, x):\n  return ") + body + "\n");
        module.save((fs::path(folder) / name).string());
    }
    const Model m = woken(streaming(4));
    save_model(fs::path(folder) / "streaming.safetensors", m, m.weights);
}

// For benchmark/charts/streaming.py, on one thread: peak memory of the process, so one run each. VSHIFT_STREAM=97
// streamed, VSHIFT_STREAM=-97 in one shot, with full attention.
TEST_CASE("streams: memory and time against the number of frames", "[.][streaming]") {
    const char* given = std::getenv("VSHIFT_STREAM");
    REQUIRE(given);
    at::set_num_threads(1);
    const bool streamed = given[0] != '-';
    const int64_t frames = std::abs(std::atoi(given));
    const Model m = woken(streaming(streamed ? 4 : 0));
    Stream stream;
    for (int64_t at = 0; at < frames;) {
        const int64_t n = !streamed ? frames : at == 0 ? 1 : piece_frames(m.config);
        inpaint::inpaint(m, sample(uint64_t(at), n, 128, 224), 2, 7, stream);
        at += n;
    }
    rusage usage{};
    getrusage(RUSAGE_SELF, &usage);
    const auto ms = [&](double seconds) { return 1000 * seconds / double(frames); };
    std::printf("streaming: %lld frames, %s, peak %ld MB, ms a frame: encode %.2f, DiT %.2f, decode %.2f\n", (long long)frames,
                streamed ? "streamed" : "full", usage.ru_maxrss / 1024, ms(stream.cpu_s.encode), ms(stream.cpu_s.network),
                ms(stream.cpu_s.decode));
    CHECK(ms(stream.cpu_s.network) > 0);
}

TEST_CASE("training: accumulated gradients are those of the large batch", "[train]") {
    for (const bool flow : {false, true}) {
        const Model m = woken(small(Kind::pixel_dit, flow));
        TrainOptions large, pieces;
        large.batch = 6;
        pieces.batch = 2;
        pieces.accumulate = 3;
        const auto [loss, grads] = gradients(m, m.weights, large, 4, samples());
        const auto [loss3, grads3] = gradients(m, m.weights, pieces, 4, samples());
        CHECK(loss == Approx(loss3).epsilon(1e-5));
        double size = 0;
        for (const auto& [name, g] : grads) size = std::max(size, g.abs().max().item<double>());
        REQUIRE(size > 1e-4);
        CHECK(worst(grads, grads3) < 1e-5 * std::max(1.0, size));
        pieces.accumulate = 2;  // other samples: another gradient
        CHECK(worst(grads, gradients(m, m.weights, pieces, 4, samples()).second) > 1e-4 * size);
    }
}

TEST_CASE("training: one step of AdamW, by hand", "[train]") {
    const Model m = woken(small(Kind::pixel_unet, false));
    TrainOptions o;
    o.steps = 2;
    o.batch = 2;
    o.learning_rate = 1e-2;
    const Weights g = gradients(m, m.weights, o, 0, samples()).second;
    const TrainState s = train(m, o, samples([](int64_t, double) { return false; }));
    REQUIRE(s.step == 1);
    for (const auto& [name, w] : m.weights) {
        // First step: both moments are the gradient itself once their bias is taken out.
        const Tensor expected = w * (1 - 1e-2 * 0.01) - 1e-2 * g.at(name) / (g.at(name).abs() + 1e-8);
        CHECK(worst(s.weights.at(name), expected) < 2e-5);
    }
    CHECK(cosine_rate(1e-4, 0, 100) == Approx(1e-4));
    CHECK(cosine_rate(1e-4, 50, 100) == Approx(0.5e-4));
    CHECK(cosine_rate(1e-4, 100, 100) == Approx(0).margin(1e-12));
}

TEST_CASE("training: a run that stops goes on to the same bytes", "[train]") {
    const Scratch scratch;
    for (const bool flow : {false, true}) {
        const Model m = initial_model(small(Kind::pixel_dit, flow), 2);
        TrainOptions o;
        o.steps = 8;
        o.batch = 2;
        o.learning_rate = 1e-3;
        const TrainState straight = train(m, o, samples());
        o.checkpoint_file = scratch.folder / (flow ? "flow.safetensors" : "regression.safetensors");
        o.checkpoint_every = 3;
        // Killed in step 5: the checkpoint of step 3 is what is left.
        struct Killed {};
        int64_t seen = 0;
        CHECK_THROWS_AS(train(m, o, samples([&](int64_t step, double) { seen = step; return step == 5 ? throw Killed() : true; })), Killed);
        CHECK(seen == 5);
        const TrainState resumed = train(m, o, samples());
        CHECK(hash_of(resumed.weights) == hash_of(straight.weights));
        CHECK(hash_of(resumed.average) == hash_of(straight.average));
        CHECK(curve_csv(resumed) == curve_csv(straight));
        o.seed = 9;
        CHECK(told([&] { train(m, o, samples()); }).find("checkpoint of another") != std::string::npos);
    }
}

TEST_CASE("training: the loss falls, for every kind; the autoencoder stays as it was", "[train]") {
    for (const Kind kind : {Kind::pixel_unet, Kind::pixel_dit, Kind::latent_dit})
        for (const bool flow : {false, true}) {
            const bool latent = kind == Kind::latent_dit;
            Model m = initial_model(small(kind, flow), 2);
            const uint64_t frozen = hash_of(m.vae.weights), before = hash_of(m.weights);
            TrainOptions o;
            o.steps = latent ? 120 : 60;
            o.batch = 4;
            o.learning_rate = 1e-2;
            o.ema = 0.9;
            const TrainHooks hooks{[&](uint64_t i) { return latent ? sample(i % 4, 1, 32, 32) : sample(i); }, {}};
            const TrainState s = train(m, o, hooks);
            double first = 0, last = 0;
            for (int i = 0; i < 5; ++i) {
                first += s.curve[size_t(i)][1] / 5;
                last += s.curve[s.curve.size() - 1 - size_t(i)][1] / 5;
            }
            INFO("kind " << int(kind) << " flow " << flow << " loss " << first << " to " << last);
            CHECK(last < 0.8 * first);
            CHECK(hash_of(m.vae.weights) == frozen);
            CHECK(hash_of(m.weights) == before);
            CHECK(hash_of(s.weights) != before);
            if (flow || latent) continue;
            // And what it learned shows in the picture.
            m.weights = s.average;
            const Views v = sample(1000);
            Stream stream;
            CHECK((inpaint::inpaint(m, v, 1, 1, stream) - v.target).pow(2).mean().item<double>() <
                  0.7 * (v.fill - v.target).pow(2).mean().item<double>());
        }
}
