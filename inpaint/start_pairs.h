// SPDX-License-Identifier: Apache-2.0
// Role: training samples for flows with a start (model.h): squares of training pairs whose fill is a pixel_rays' colors,
// with the texture beside them. Stage: inpaint (paper III-C). No Torch here.
#pragma once
#include <map>

#include "inpaint/street_pairs.h"

namespace vshift::inpaint {

/// Rays look over a whole view, and take longer than a square does in training: so a view gives some squares, which
/// come among those of others. Sample `number` follows from seed and number alone, in whatever order they are asked for.
class StartPairs {
public:
    /// Throws Error bad_input when `rays_file` is no pixel_rays.
    StartPairs(const RecordedViews& recorded, const std::string& rays_file, uint64_t seed, int crop_px, Arm arm);
    ~StartPairs();
    StartPairs(const StartPairs&) = delete;
    StartPairs& operator=(const StartPairs&) = delete;

    PairPlanes sample(uint64_t number);

private:
    const PairPlanes& whole(uint64_t pair);

    const RecordedViews& recorded_;
    const uint64_t seed_;
    const int crop_px_;
    const Arm arm_;
    vshift_inpaint_model* rays_ = nullptr;
    std::map<uint64_t, PairPlanes> kept_;
};

}  // namespace vshift::inpaint
