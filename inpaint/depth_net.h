// SPDX-License-Identifier: Apache-2.0
// Role: depth from one picture (the paper is camera-only), in metres. Stage: before lift.
//
// A U-Net over display values and, per pixel, where the camera looks: the unit ray in ego coordinates and the 1/z that
// the ground (ego z = 0) would have there, which the camera's height gives in metres. So scale is known, not guessed.
// It predicts log(1/z) as a correction to the ground's, and a logit of sky. A correction of zero is an empty road.
#pragma once
#include "inpaint/unet.h"

namespace vshift::inpaint {

struct DepthConfig {
    int64_t width = 400;  ///< wider pictures are shrunk to this, and 1/z grown back
    UnetConfig unet{7, 2, {24, 40, 64, 96, 128}, 16};
};
/// Throws Error bad_input; `file` begins messages.
DepthConfig parse_depth_config(const std::string& json, const std::string& file);
std::string json_of(const DepthConfig& config);

struct DepthModel {
    DepthConfig config;
    Weights weights;
    std::map<std::string, std::string> metadata;  ///< license, training record
};
DepthModel initial_depth_model(const DepthConfig& config, uint64_t seed);
DepthModel load_depth_model(const std::filesystem::path& file);
void save_depth_model(const std::filesystem::path& file, const DepthModel& model, const Weights& weights);

/// A pinhole camera over the ground, in pixels and metres.
struct DepthCamera {
    double fx = 0, fy = 0, cx = 0, cy = 0;
    double ego_from_cam[9] = {};  ///< rotation, row by row
    double height_m = 0;          ///< above the ground
};
/// Where each pixel looks: [1, 4, H, W], the unit ray in ego coordinates, and 1/z of the ground: below 0 above the
/// horizon, never past +-1 / 0.5 m.
Tensor depth_rays(const DepthCamera& camera, int64_t height, int64_t width);

/// What the network sees, [B, 7, H, W]: `color` [B, 3, H, W] in 0..1 with `rays`.
Tensor depth_input(const Tensor& color, const Tensor& rays);

struct DepthGuess {
    Tensor log_inverse;  ///< [B, 1, H, W]: log of 1/z in 1/m
    Tensor sky;          ///< the same size: a logit
};
/// H and W are multiples of unet_side.
DepthGuess depth_forward(const DepthConfig& config, const Weights& weights, const Tensor& seen);

/// The mean over samples of: the root of the scale-invariant squared error of log z (Eigen et al. 2014, lambda 0.5), the
/// absolute error of its slopes at 1, 2 and 4 px (five times where the truth steps by 0.1 or more: silhouettes), and a fifth of the cross-entropy of sky. `inverse_depth`
/// [B, 1, H, W] in 1/m, 0 in the sky; beyond 200 m all is as far.
Tensor depth_loss(const DepthGuess& guess, const Tensor& inverse_depth);

/// Planar z of a whole picture, any size, [H, W]; +inf in the sky. `color` [1, 3, H, W].
Tensor depth_of(const DepthModel& model, const Tensor& color, const DepthCamera& camera);

}  // namespace vshift::inpaint
