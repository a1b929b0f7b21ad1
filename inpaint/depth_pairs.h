// SPDX-License-Identifier: Apache-2.0
// Role: pictures with their true depth from analytic streets, to train a depth estimator. Stage: before lift. No Torch.
#pragma once
#include <functional>
#include <string>
#include <vector>

#include "embree_core/types.h"
#include "inpaint/depth_api.h"
#include "scenes/analytic/analytic_street.h"

namespace vshift::inpaint {

/// A picture, its camera, and 1/z (0 in the sky; empty where it is not known), as the network takes them.
struct DepthPlanes {
    int width = 0, height = 0;
    Intrinsics intrinsics;
    glm::dmat3 ego_from_cam{1.0};
    double height_m = 0;
    std::vector<float> color;  ///< 3 planes of display values
    std::vector<float> inverse_depth;

    vshift_depth_view view() const;
};
DepthPlanes depth_planes(const ColorImage& color, const Intrinsics& intrinsics, const Pose& ego_from_cam);

/// Views of streets at `width` x 9/16 width, kept in memory: per seed `frames` frames of six cameras. Every camera
/// stands a little elsewhere than the rig's (up to 2 m sideways, 0.4 m up or down, 3 degrees about each axis, focal
/// length times 0.8 to 1.25), so that the network cannot learn the six by heart.
std::vector<DepthPlanes> record_depth_views(const std::vector<uint32_t>& seeds, int frames, int width,
                                            const std::function<void(size_t done, size_t total)>& show);

/// Training sample `number` of a run: a view's part of `crop_px` square (0: all of it), every other one mirrored, all of
/// them brighter or darker by up to half a stop and a little redder or bluer.
DepthPlanes depth_sample(const std::vector<DepthPlanes>& views, uint64_t seed, uint64_t number, int crop_px);

}  // namespace vshift::inpaint
