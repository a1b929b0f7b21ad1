// SPDX-License-Identifier: Apache-2.0
// Training in bf16 beside float32, and on a device that is not the CPU.
#include <numeric>

#include "tests/inpaint/small_models.h"

namespace fs = std::filesystem;
using namespace vshift;
using namespace vshift::inpaint;

namespace {

std::vector<double> losses_of(const TrainState& s) {
    std::vector<double> all;
    for (const auto& row : s.curve) all.push_back(row[1]);
    return all;
}
double mean_of(const std::vector<double>& all, size_t from, size_t count) {
    return std::accumulate(all.begin() + std::ptrdiff_t(from), all.begin() + std::ptrdiff_t(from + count), 0.0) / double(count);
}
/// Samples of pixel_rays: chance numbers, of which the target is the first ray's color.
Views ray_sample(uint64_t number) {
    Views v;
    v.seen = noise({1, seen_numbers, 1, 1, 64}, 12, number);
    v.fill = (v.seen.narrow(1, ray_count * ray_numbers, 3) + 1) / 2;
    v.target = (v.seen.narrow(1, 3, 3) + 1) / 2;
    v.hole = at::ones({1, 1, 1, 1, 64});
    v.neighbor = at::zeros_like(v.hole);
    v.inverse_depth = at::zeros_like(v.hole);
    return v;
}
Views any_sample(Kind kind, uint64_t number) {
    return kind == Kind::pixel_rays ? ray_sample(number) : kind == Kind::latent_dit ? sample(number, 1, 32, 32) : sample(number, 1, 16, 16);
}
constexpr std::pair<Kind, bool> every_arm[] = {{Kind::pixel_unet, false}, {Kind::pixel_unet, true}, {Kind::pixel_dit, false},
                                               {Kind::pixel_dit, true},   {Kind::latent_dit, true}, {Kind::autoencoder, false},
                                               {Kind::pixel_rays, false}};

}  // namespace

TEST_CASE("training: bf16 follows float32, with float32 weights, and resumes to the same bytes", "[train]") {
    const Scratch scratch;
    for (const auto& [kind, flow] : every_arm) {
        const Model m = woken(small(kind, flow));
        TrainOptions o;
        o.steps = 16;
        o.batch = 2;
        o.learning_rate = 2e-3;
        const TrainHooks hooks{[kind = kind](uint64_t i) { return any_sample(kind, i % 4); }, {}};
        const std::vector<double> exact = losses_of(train(m, o, hooks));
        o.bf16 = true;
        const auto [loss, grads] = gradients(m, m.weights, o, 0, hooks);
        for (const auto& [name, g] : grads) CHECK(g.scalar_type() == at::kFloat);
        const TrainState s = train(m, o, hooks);
        const std::vector<double> rounded = losses_of(s);
        double apart = 0;
        for (size_t i = 0; i < exact.size(); ++i) apart = std::max(apart, std::abs(rounded[i] / exact[i] - 1));
        const double first = mean_of(rounded, 0, 4), last = mean_of(rounded, 12, 4);
        INFO("kind " << int(kind) << " flow " << flow << ": loss " << first << " to " << last << ", float32 " << mean_of(exact, 12, 4)
                     << "; at most " << apart << " apart");
        CHECK(rounded[0] != exact[0]);
        CHECK(rounded[0] == Approx(exact[0]).epsilon(0.01));
        CHECK(apart < 0.1);  // docs/network.md
        CHECK(last < first);
        for (const Weights* group : {&s.weights, &s.first, &s.second, &s.average})
            for (const auto& [name, t] : *group) CHECK(t.scalar_type() == at::kFloat);
        o.checkpoint_file = scratch.folder / "bf16.safetensors";
        train(m, o, {hooks.views, [](int64_t step, double) { return step < 6; }});
        o.bf16 = false;
        CHECK(told([&] { train(m, o, hooks); }).find("checkpoint of another") != std::string::npos);
        o.bf16 = true;
        CHECK(hash_of(train(m, o, hooks).average) == hash_of(s.average));
        fs::remove(o.checkpoint_file);
    }
}

TEST_CASE("training: nothing of a step stays on the CPU when weights are elsewhere", "[train]") {
    // Tensors of the meta device have no memory: an operation that takes one of the CPU as well, or reads numbers, throws. LibTorch
    // has neither convolutions nor norms for it.
    const Model m = initial_model(small(Kind::pixel_rays, false), 2);
    TrainOptions o;
    o.batch = 2;
    o.device = at::kMeta;
    const TrainHooks hooks{ray_sample, {}};
    Weights there;
    std::vector<Tensor> leaves;
    for (const auto& [name, t] : m.weights) leaves.push_back(there[name] = t.to(at::kMeta).requires_grad_(true));
    const Tensor loss = loss_of_model(m, o, hooks)(there, 0, 0);
    CHECK(loss.is_meta());
    for (const Tensor& g : torch::autograd::grad({loss}, leaves)) CHECK(g.is_meta());
}
