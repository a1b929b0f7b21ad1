// SPDX-License-Identifier: Apache-2.0
// Role: training, the paper's way: AdamW (0.9, 0.999), cosine without warm-up, gradient accumulation. Stage: inpaint.
//
// Sample i is what `views(i)` gives, its noise and time follow from the seed and i: a run that was killed goes on from
// its checkpoint and ends with the same bytes. The autoencoder is never touched.
#pragma once
#include <array>
#include <functional>

#include "inpaint/model.h"

namespace vshift::inpaint {

struct TrainOptions {
    int64_t steps = 1000;
    int64_t batch = 8;       ///< samples to a pass
    int64_t accumulate = 1;  ///< passes to a step
    double learning_rate = 1e-4;
    double beta1 = 0.9, beta2 = 0.999, eps = 1e-8, weight_decay = 0.01;
    double ema = 0.999;  ///< of the weights that are saved
    uint64_t seed = 1;
    int64_t checkpoint_every = 0;           ///< steps; 0: none
    std::filesystem::path checkpoint_file;  ///< safetensors; gone on from when it is there
    at::Device device = at::kCPU;           ///< where weights and samples go
    bool bf16 = false;                      ///< what Autocast says
};

/// While it lives and `bf16` is asked for, Torch's autocast computes matrix products and convolutions, and so their
/// derivatives, in bfloat16. Weights, loss and optimizer stay float32.
class Autocast {
public:
    explicit Autocast(const TrainOptions& options);
    ~Autocast();
    Autocast(const Autocast&) = delete;
    Autocast& operator=(const Autocast&) = delete;

private:
    const at::DeviceType device_;
    const bool on_;
};

struct TrainState {
    int64_t step = 0;
    Weights weights, first, second, average;  ///< parameters, Adam's moments, their moving average
    std::vector<std::array<double, 3>> curve;  ///< step, mean loss, learning rate
};

struct TrainHooks {
    /// A batch of one sample, with a target.
    std::function<Views(uint64_t sample)> views;
    /// After every step; false stops, with a checkpoint.
    std::function<bool(int64_t step, double loss)> after_step;
};

double cosine_rate(double rate, int64_t step, int64_t steps);

/// One step's gradients, mean over its samples, and its mean loss.
std::pair<double, Weights> gradients(const Model& model, const Weights& weights, const TrainOptions& options,
                                     int64_t step, const TrainHooks& hooks);

/// Runs to the end, or until a hook stops it. What comes back lies on the CPU. Throws Error bad_input when a checkpoint belongs to another run.
TrainState train(const Model& model, const TrainOptions& options, const TrainHooks& hooks);

/// The same for anything with a loss: `config` tells its checkpoints from others, `loss` is the mean of pass `pass` (of
/// `accumulate`) of a step.
using LossOfPass = std::function<Tensor(const Weights& weights, int64_t step, int64_t pass)>;
/// A model's: samples, their noise and times follow from the seed and the samples' numbers. The weights must lie on the options'
/// device; `options` and `hooks` must live as long.
LossOfPass loss_of_model(const Model& model, const TrainOptions& options, const TrainHooks& hooks);
TrainState train(const std::string& config, const Weights& initial, const TrainOptions& options, const LossOfPass& loss,
                 const std::function<bool(int64_t step, double loss)>& after_step);

/// "step,loss,learning_rate"
std::string curve_csv(const TrainState& state);

}  // namespace vshift::inpaint
