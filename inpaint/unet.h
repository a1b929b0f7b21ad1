// SPDX-License-Identifier: Apache-2.0
// Role: a small convolutional network over pixels, told the time: the rival that is fast on a CPU. Stage: inpaint.
// Frames are taken one by one.
#pragma once
#include "inpaint/weights.h"

namespace vshift::inpaint {

struct UnetConfig {
    int64_t in_channels = 9;
    int64_t out_channels = 3;
    std::vector<int64_t> widths{24, 48, 96, 128};  ///< by level; the first at half the image's size
    int64_t freq_dim = 32;
};

UnetConfig parse_unet_config(const nlohmann::json& json, const std::string& where);
nlohmann::ordered_json json_of(const UnetConfig& config);
Layout unet_layout(const UnetConfig& config);
/// What of the layout begins at zero: the output, and what every block adds.
bool unet_begins_at_zero(const std::string& name);
/// H and W are multiples of it.
int64_t unet_side(const UnetConfig& config);

/// `x` [B, C, F, H, W]; `t` in 0..1000, [B]. Returns [B, out_channels, F, H, W].
Tensor unet_forward(const UnetConfig& config, const Weights& weights, const Tensor& x, const Tensor& t);

}  // namespace vshift::inpaint
