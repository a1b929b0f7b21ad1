// SPDX-License-Identifier: Apache-2.0
// Role: training samples for kind pixel_rays: single hole pixels of many training pairs, so that every step sees many
// streets. Stage: inpaint (paper III-C). No Torch here.
#pragma once
#include "inpaint/street_pairs.h"

namespace vshift::inpaint {

struct PixelPool {
    std::vector<float> seen, fill, target;  ///< per pixel: what ray_mixer_forward takes, and two colors
    std::vector<double> up_to;              ///< the weights of the pixels up to this one, summed
    size_t size() const { return up_to.size(); }
};

/// Pairs 0 ... pairs - 1 of training_pair(recorded, seed, ...), warped there and back: of each some pixels that are occluded and some that are
/// outside, weighted so that each pair counts as its weights say.
PixelPool pixel_pool(const RecordedViews& recorded, uint64_t seed, size_t pairs,
                     const std::function<void(size_t done, size_t total)>& show);

/// Sample `number`: one row of `pixels` pixels, drawn by weight with replacement, every other one mirrored.
PairPlanes pixel_sample(const PixelPool& pool, uint64_t seed, uint64_t number, int pixels);

}  // namespace vshift::inpaint
