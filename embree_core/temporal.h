// SPDX-License-Identifier: Apache-2.0
// Role: consistency of results over time and across cameras, by exact correspondence: where a surface point that one
// view shows stands in another, from true depth and poses. Stage: score. The scene stands still; what moves between
// the two views finds no match there and is left out.
#pragma once
#include <cstdint>

#include "embree_core/camera.h"
#include "embree_core/types.h"

namespace vshift {

/// A view with its true depth.
struct PosedDepth {
    Intrinsics intrinsics;
    Pose world_from_cam;
    const DepthMap& depth;
};

/// Per pixel of `from`: its surface point's place in `to` (pixels), where `to` sees that same surface: inside its
/// image, 1/z within 1 % or half a pixel of disparity of the surface there, and no torn edge among the four pixels
/// around. Sky matches sky.
struct Correspondence {
    Grid<glm::vec2> place_px;
    Mask matched;
};
Correspondence correspond(const PosedDepth& from, const PosedDepth& to);

/// Bilinear at `u_px`; the outermost pixels continue.
glm::vec3 sample(const ColorImage& image, glm::vec2 u_px);

/// Mean absolute differences over matched pixels (and the region, in `from`, where there is one): all three channels,
/// display-referred sRGB.
struct ConsistencyScore {
    uint64_t pixels = 0;
    double difference = 0;        ///< sum of |got_from - got_to at its place|: the warping error
    double truth_difference = 0;  ///< the same of the true images: what sampling and gloss alone cost
    double flicker = 0;  ///< sum of |(got - truth)_from - (got - truth)_to|: what the result's error changed by
};
ConsistencyScore score_consistency(const Correspondence& match, const ColorImage& got_from, const ColorImage& got_to,
                                   const ColorImage& truth_from, const ColorImage& truth_to,
                                   const Mask* region = nullptr);

}  // namespace vshift
