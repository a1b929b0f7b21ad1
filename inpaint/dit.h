// SPDX-License-Identifier: Apache-2.0
// Role: the transformer that predicts velocities (paper III-E), in Wan2.2's structure at any size. Stage: inpaint.
//
// The input's channels are the noisy latent, then the condition, then whatever else the config counts. With
// `window` = 0 every frame attends to every frame, as Wan2.2 does. With `window` = w a frame attends to itself and the
// w - 1 frames before it (block-causal), and a cache of keys and values carries the past from call to call: the same
// output whatever the pieces, in memory that does not grow. That is our addition, not Wan2.2's.
#pragma once
#include <vector>

#include "inpaint/weights.h"

namespace vshift::inpaint {

struct Dit {
    DitConfig config;
    Weights weights;
};

/// The last `window` - 1 frames' keys and values of every layer, as a stream goes on.
struct DitCache {
    int64_t frames_before = 0;    ///< latent frames that went by: the next one's position in time
    std::vector<Tensor> keys;     ///< per layer [B, heads, tokens, dim / heads], rotated
    std::vector<Tensor> values;
};

struct DitOptions {
    int64_t window = 0;
    DitCache* cache = nullptr;  ///< needs a window
    bool commit = true;         ///< whether this call's frames become the cache's past
};

/// cos, then sin, of t times 10000^(-i / half): [..., dim] for t [...].
Tensor time_sinusoids(const Tensor& t, int64_t dim);

/// `x` [B, C, F, H, W]; `t` in 0..1000, [B, 1], [B, F] or [B, tokens]; `text` [B, n, text_dim] with n <= text_len, or
/// undefined where the config has no text. Returns [B, out_channels, F, H, W]. H and W are multiples of the patch.
Tensor dit_forward(const Dit& dit, const Tensor& x, const Tensor& t, const Tensor& text = {},
                   const DitOptions& options = {});

}  // namespace vshift::inpaint
