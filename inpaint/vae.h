// SPDX-License-Identifier: Apache-2.0
// Role: the causal video autoencoder of Wan2.2 at any size. Stage: inpaint (paper III-E, latent space operation).
//
// Frames 0; 1..4; 5..8; ... become latents 0, 1, 2, ...: nothing depends on later frames. A state carries what the
// next piece needs of the last one, so a video of any length passes in pieces, with the same output as in one shot.
#pragma once
#include <unordered_map>

#include "inpaint/weights.h"

namespace vshift::inpaint {

struct Vae {
    VaeConfig config;
    Weights weights;
};

/// The past of one stream: the last inputs of every convolution over time, by its name. Empty: the video begins.
struct VaeState {
    std::unordered_map<std::string, Tensor> past;
    bool begun = false;
};

/// Pixels along a latent's side, and frames to a latent but the first.
int64_t vae_side(const VaeConfig& config);
int64_t vae_frames(const VaeConfig& config);

/// `video` [B, 3, T, H, W] in -1..1; T = 1 + 4k in the first piece and 4k in others; H and W multiples of vae_side.
/// Returns the normalised means [B, z, latents, H / side, W / side].
Tensor vae_encode(const Vae& vae, const Tensor& video, VaeState& state);
/// What the latents follow, not normalised: means, then logarithms of variances, [B, 2 z, latents, H / side, W / side].
Tensor vae_moments(const Vae& vae, const Tensor& video, VaeState& state);
/// Latents that are not normalised, to the video.
Tensor vae_decode_raw(const Vae& vae, const Tensor& latents, VaeState& state);
/// Weights to begin training from. What looks at past frames begins at 0: trained on single frames, it stays there, and
/// a video is then taken frame by frame.
Weights initial_vae(const VaeConfig& config, uint64_t seed);
/// Any number of latents. Returns [B, 3, T, H, W], not clamped.
Tensor vae_decode(const Vae& vae, const Tensor& latents, VaeState& state);

}  // namespace vshift::inpaint
