// SPDX-License-Identifier: Apache-2.0
#include "inpaint/train.h"

#include <ATen/autocast_mode.h>

#include <cmath>
#include <cstring>

namespace vshift::inpaint {
namespace {

namespace fs = std::filesystem;

/// What makes a run: a checkpoint of another one is refused.
std::string run_of(const std::string& config, const TrainOptions& o) {
    return nlohmann::ordered_json{{"config", config},                {"steps", o.steps},   {"batch", o.batch},
                                  {"accumulate", o.accumulate},      {"seed", o.seed},     {"learning_rate", o.learning_rate},
                                  {"weight_decay", o.weight_decay},  {"ema", o.ema},       {"device", o.device.str()},
                                  {"bf16", o.bf16}}
        .dump();
}

void write_checkpoint(const std::string& config, const TrainOptions& options, const TrainState& state) {
    std::vector<Tensor> kept;
    std::vector<StoredTensor> stored;
    const auto add = [&](const std::string& name, const Tensor& t) {
        kept.push_back(t.detach().cpu().contiguous());
        stored.push_back(stored_of(name, kept.back()));
    };
    for (const auto& [prefix, group] : {std::pair<const char*, const Weights*>{"weights.", &state.weights},
                                        {"first.", &state.first}, {"second.", &state.second}, {"average.", &state.average}})
        for (const auto& [name, t] : *group) add(prefix + name, t);
    Tensor curve = at::empty({int64_t(state.curve.size()), 3}, at::kDouble);
    for (size_t i = 0; i < state.curve.size(); ++i)
        std::copy(state.curve[i].begin(), state.curve[i].end(), curve.data_ptr<double>() + 3 * i);
    add("curve", curve);
    write_tensor_file(options.checkpoint_file, stored,
                      {{"run", run_of(config, options)}, {"step", std::to_string(state.step)}});
}

TrainState read_checkpoint(const std::string& config, const Weights& like, const TrainOptions& options) {
    const TensorFiles files(options.checkpoint_file);
    const auto& metadata = files.metadata();
    if (!metadata.count("run") || metadata.at("run") != run_of(config, options))
        throw Error(ExitCode::bad_input, files.file() + ": run: got a checkpoint of another one, expected the same "
                                                        "model, steps, batch and seed (remove it to begin anew)");
    TrainState s;
    const StoredTensor* rows = files.find("curve");
    if (!rows || rows->type != ElementType::f64 || rows->shape.size() != 2 || rows->shape[1] != 3)
        throw Error(ExitCode::bad_input, files.file() + ": curve: got none, expected one");
    s.curve.resize(size_t(rows->shape[0]));
    s.step = rows->shape[0];
    if (rows->bytes) std::memcpy(s.curve.data(), rows->data, rows->bytes);
    for (const auto& [prefix, group] : {std::pair<const char*, Weights*>{"weights.", &s.weights}, {"first.", &s.first},
                                        {"second.", &s.second}, {"average.", &s.average}})
        for (const auto& [name, t] : like) {
            const StoredTensor* stored = files.find(prefix + name);
            if (!stored || stored->shape != Shape(t.sizes().begin(), t.sizes().end()))
                throw Error(ExitCode::bad_input, files.file() + ": " + prefix + name + ": got none of its shape, expected it");
            (*group)[name] = tensor_of(*stored).to(options.device);
        }
    return s;
}

/// The samples of one pass.
Views gathered(const TrainHooks& hooks, uint64_t first, int64_t count) {
    std::vector<Views> all;
    for (int64_t i = 0; i < count; ++i) all.push_back(hooks.views(first + uint64_t(i)));
    const auto joined = [&](Tensor Views::*field) {
        std::vector<Tensor> parts;
        for (const Views& v : all)
            if ((v.*field).defined()) parts.push_back(v.*field);
        return parts.empty() ? Tensor() : at::cat(parts, 0);
    };
    return {joined(&Views::fill), joined(&Views::hole), joined(&Views::neighbor), joined(&Views::inverse_depth),
            joined(&Views::target), joined(&Views::weight), joined(&Views::texture), joined(&Views::seen)};
}

std::pair<double, Weights> gradients(const Weights& weights, const TrainOptions& o, int64_t step, const LossOfPass& loss_of_pass) {
    std::vector<Tensor> leaves;
    Weights tracked;
    for (const auto& [name, t] : weights) {
        leaves.push_back(t.detach().requires_grad_(true));
        tracked[name] = leaves.back();
    }
    std::vector<Tensor> sums;
    double loss = 0;
    for (int64_t pass = 0; pass < o.accumulate; ++pass) {
        const Tensor l = loss_of_pass(tracked, step, pass) / double(o.accumulate);
        const auto grads = torch::autograd::grad({l}, leaves, {}, {}, false, true);
        loss += l.item<double>();
        if (sums.empty()) sums.resize(grads.size());
        for (size_t i = 0; i < grads.size(); ++i)
            if (grads[i].defined()) sums[i] = sums[i].defined() ? sums[i] + grads[i] : grads[i];
    }
    Weights out;
    size_t i = 0;
    for (const auto& [name, t] : weights) {
        out[name] = sums[i].defined() ? sums[i] : at::zeros_like(t);
        ++i;
    }
    return {loss, out};
}

void set_autocast(at::DeviceType device, bool on) {
#if TORCH_VERSION_MAJOR > 2 || (TORCH_VERSION_MAJOR == 2 && TORCH_VERSION_MINOR >= 4)
    at::autocast::set_autocast_dtype(device, at::kBFloat16);
    at::autocast::set_autocast_enabled(device, on);
#else
    if (device == at::kCUDA) {
        at::autocast::set_autocast_gpu_dtype(at::kBFloat16);
        at::autocast::set_enabled(on);
    } else {
        at::autocast::set_autocast_cpu_dtype(at::kBFloat16);
        at::autocast::set_cpu_enabled(on);
    }
#endif
}

Weights moved(const Weights& weights, at::Device device) {
    Weights there;
    for (const auto& [name, t] : weights) there[name] = t.to(device);
    return there;
}

}  // namespace

Autocast::Autocast(const TrainOptions& options) : device_(options.device.type()), on_(options.bf16) {
    if (!on_) return;
    at::autocast::increment_nesting();
    set_autocast(device_, true);
}

Autocast::~Autocast() {
    if (!on_) return;
    set_autocast(device_, false);
    if (at::autocast::decrement_nesting() == 0) at::autocast::clear_cache();
}

LossOfPass loss_of_model(const Model& model, const TrainOptions& o, const TrainHooks& hooks) {
    const Model there{model.config, {}, {}, {model.vae.config, moved(model.vae.weights, o.device)}, {}};
    return [there, &o, &hooks](const Weights& weights, int64_t step, int64_t pass) {
        const uint64_t first = uint64_t(step * o.accumulate * o.batch + pass * o.batch);
        Views views = padded(there.config, gathered(hooks, first, o.batch));
        for (Tensor* t : {&views.fill, &views.hole, &views.neighbor, &views.inverse_depth, &views.target, &views.weight, &views.texture,
                          &views.seen})
            if (t->defined()) *t = t->to(o.device);
        const Example e = prepare(there, views);
        const auto one = noise_sizes(there, e);
        const bool noisy = there.config.flow || there.config.kind == Kind::autoencoder;
        std::vector<Tensor> noises, times;
        for (int64_t i = 0; i < o.batch && noisy; ++i) {
            const uint64_t sample = first + uint64_t(i);
            noises.push_back(noise(one, o.seed, 2 * sample));
            // Uniform by way of a normal number's distribution: one source of numbers for all.
            const double u = 0.5 * std::erfc(-noise({1}, o.seed, 2 * sample + 1).item<double>() / std::sqrt(2.0));
            times.push_back(at::full({1}, shifted_time(u, there.config.time_shift)));
        }
        const Autocast casts(o);
        return loss_of(there, weights, e, noisy ? at::cat(noises, 0).to(o.device) : Tensor(),
                       noisy ? at::cat(times, 0).to(o.device) : Tensor());
    };
}

double cosine_rate(double rate, int64_t step, int64_t steps) {
    return rate * 0.5 * (1 + std::cos(3.14159265358979323846 * double(step) / double(steps)));
}

std::pair<double, Weights> gradients(const Model& model, const Weights& weights, const TrainOptions& options,
                                     int64_t step, const TrainHooks& hooks) {
    return gradients(weights, options, step, loss_of_model(model, options, hooks));
}

TrainState train(const Model& model, const TrainOptions& options, const TrainHooks& hooks) {
    return train(json_of(model.config), model.weights, options, loss_of_model(model, options, hooks), hooks.after_step);
}

TrainState train(const std::string& config, const Weights& initial, const TrainOptions& o, const LossOfPass& loss_of_pass,
                 const std::function<bool(int64_t, double)>& after_step) {
    TrainState s;
    std::error_code error;
    if (!o.checkpoint_file.empty() && fs::exists(o.checkpoint_file, error)) {
        s = read_checkpoint(config, initial, o);
    } else {
        for (const auto& [name, t] : initial) {
            const Tensor there = t.detach().to(o.device);
            s.weights[name] = there.clone();
            s.average[name] = there.clone();
            s.first[name] = at::zeros_like(there);
            s.second[name] = at::zeros_like(there);
        }
    }
    while (s.step < o.steps) {
        auto [loss, grads] = gradients(s.weights, o, s.step, loss_of_pass);
        if (!std::isfinite(loss))
            throw Error(ExitCode::bad_input, "train: loss: got " + std::to_string(loss) + " at step " +
                                                 std::to_string(s.step) + ", expected a finite one (lower the learning rate)");
        const double rate = cosine_rate(o.learning_rate, s.step, o.steps);
        ++s.step;
        const double even1 = 1 - std::pow(o.beta1, double(s.step)), even2 = 1 - std::pow(o.beta2, double(s.step));
        // The average follows closely at first, when the weights move fast.
        const double keep = std::min(o.ema, double(s.step) / double(s.step + 9));
        at::NoGradGuard no_grad;
        for (auto& [name, w] : s.weights) {
            const Tensor& g = grads.at(name);
            Tensor& m = s.first.at(name);
            Tensor& v = s.second.at(name);
            m.mul_(o.beta1).add_(g, 1 - o.beta1);
            v.mul_(o.beta2).addcmul_(g, g, 1 - o.beta2);
            w.mul_(1 - rate * o.weight_decay);
            w.addcdiv_(m, (v / even2).sqrt_().add_(o.eps), -rate / even1);
            s.average.at(name).mul_(keep).add_(w, 1 - keep);
        }
        s.curve.push_back({double(s.step), loss, rate});
        const bool go_on = !after_step || after_step(s.step, loss);
        const bool due = o.checkpoint_every > 0 && s.step % o.checkpoint_every == 0;
        if (!o.checkpoint_file.empty() && (due || !go_on)) write_checkpoint(config, o, s);
        if (!go_on) break;
    }
    for (Weights* group : {&s.weights, &s.first, &s.second, &s.average}) *group = moved(*group, at::kCPU);
    return s;
}

std::string curve_csv(const TrainState& state) {
    std::string text = "step,loss,learning_rate\n";
    char row[96];
    for (const auto& [step, loss, rate] : state.curve) {
        std::snprintf(row, sizeof row, "%lld,%.9g,%.9g\n", (long long)step, loss, rate);
        text += row;
    }
    return text;
}

}  // namespace vshift::inpaint
