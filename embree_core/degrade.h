// SPDX-License-Identifier: Apache-2.0
// Role: errors of a known size for training and for ablations (paper III-D keeps "imperfect" seams). Stage: seam.
//
// The exact warp decides what is filled and from where; an error then moves where a neighbour's colour is fetched
// (pose, time, depth) or changes the colour (exposure, white balance). Sizes are exact, the seed gives signs and
// directions; a size of 0 changes nothing. Each camera draws its own.
#pragma once
#include <string>

#include "embree_core/camera.h"
#include "embree_core/types.h"

namespace vshift {

/// Sizes of errors; all 0 by default.
struct Degradations {
    double exposure_stops = 0;       ///< |log2| of a gain on all channels
    double white_balance_stops = 0;  ///< |log2| of the gain of R against that of B, G unchanged: half on either
    double pose_m = 0, pose_deg = 0; ///< length of a translation and angle of a turn, any direction or axis
    double time_s = 0;               ///< the camera fired that much earlier or later
    double depth_scale = 0;          ///< |log| of a factor on z
    double depth_bias_m = 0;         ///< added to z
    double depth_blur_px = 0;        ///< sigma of a Gaussian over 1/z: edges bleed into each other
    double depth_field = 0;          ///< rms of log z: a smooth random field, sigma 16 px
    int seed = 0;

    bool bends_geometry() const {
        return pose_m > 0 || pose_deg > 0 || time_s > 0 || bends_depth();
    }
    bool bends_depth() const { return depth_scale > 0 || depth_bias_m > 0 || depth_blur_px > 0 || depth_field > 0; }
};

/// Gains of R, G and B.
glm::vec3 degraded_gain(const Degradations& sizes, const std::string& camera);

/// The camera's pose with the pose error (in its own frame); timing is `degraded_delay_s`.
Pose degraded_pose(const Degradations& sizes, const std::string& camera, const Pose& world_from_cam);

/// +- time_s.
double degraded_delay_s(const Degradations& sizes, const std::string& camera);

/// 1/z with the depth errors; 0 (sky) and NaN stay what they are.
Grid<float> degraded_inverse_depth(const Degradations& sizes, const std::string& camera, const Grid<float>& w);

/// A camera as the colour lookup has it, errors included.
struct BentView {
    Intrinsics intrinsics;
    Pose world_from_cam;
    Grid<float> inverse_depth;
};

/// Where the bent camera has the colour that it would put on the ray `from` + t `along` (world), near t = `start`: the
/// crossing of the ray with its bent surface, found by a few steps. Stays in the image.
glm::vec2 bent_source_px(const BentView& view, const glm::dvec3& from, const glm::dvec3& along, double start);

}  // namespace vshift
