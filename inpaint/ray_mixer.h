// SPDX-License-Identifier: Apache-2.0
// Role: a small network for one hole pixel at a time: the fill and what 16 rays meet (rays.h), mixed by learned weights.
// Stage: inpaint. The rival that learns the most in little time on a CPU: known pixels cost it nothing.
#pragma once
#include "inpaint/rays.h"
#include "inpaint/weights.h"

namespace vshift::inpaint {

struct RayMixerConfig {
    int64_t ray_dim = 24;  ///< what is kept of each ray
    int64_t dim = 128;
    int64_t layers = 2;  ///< between the rays and the output
    double detail = 0;   ///< texture that is added in filling: a share of the surface's own (ray_mixer_fill)
};

RayMixerConfig parse_ray_mixer_config(const nlohmann::json& json, const std::string& where);
nlohmann::ordered_json json_of(const RayMixerConfig& config);
Layout ray_mixer_layout(const RayMixerConfig& config);
/// The output: what is mixed begins near the fill.
bool ray_mixer_begins_at_zero(const std::string& name);

/// `seen` [N, seen_numbers] (rays.h). Returns colors in 0..1 (or a little beyond), [N, 3]: a mean of the fill and the
/// rays' colors beyond the edge, weighted by softmax, and a small color added.
Tensor ray_mixer_forward(const RayMixerConfig& config, const Weights& weights, const Tensor& seen);

/// The same for the holes of a frame: their colors, in 0..1, in place of `color`'s (3 planes). From the fourth, seventh and
/// thirteenth pixel into a hole every second, fourth and eighth one is computed, the others are means of their neighbours. With
/// `detail` all are, and each gets this share of its texture: the mean of all that could be there has none, the surface beside it
/// has. Sharper, and further from the truth pixel by pixel.
void ray_mixer_fill(const RayMixerConfig& config, const Weights& weights, const RayPlanes& planes, float* color);

/// Both apart, whatever `detail` is, in place of holes' `color` and `texture` (3 planes each). Texture is the deviation from
/// its surface's mean color that the pixel has which lies as far beyond the edge, along the ray with the largest weight.
/// Colors are as ray_mixer_forward gives them.
void ray_mixer_texture(const RayMixerConfig& config, const Weights& weights, const RayPlanes& planes, float* color, float* texture);

}  // namespace vshift::inpaint
