// SPDX-License-Identifier: Apache-2.0
// Role: what a depth map's origin says about its errors, and the rules of lift, mask and sweep that follow from it.
// Stage: lift. `vshift bench` measures every rule beside the one for exact depth (docs/measured.md).
#pragma once
#include <string>
#include <vector>

#include "embree_core/types.h"

namespace vshift {

/// Where depth comes from, as a recipe or a request states it.
enum class DepthSource {
    exact,       ///< 32-bit floats of a renderer
    half,        ///< 16-bit floats
    mm16,        ///< 16-bit integers, in steps of `step_m` (millimetres as a rule)
    disparity8,  ///< 8-bit disparity, in steps of 1/255 of the nearest pixel's
    mono,        ///< estimated from pictures: silhouettes are blurred over some pixels
};
/// The words for them, in the order of the enum.
const std::vector<std::string>& depth_source_words();

/// How far a stored 1/z may lie from the true one: `constant + relative / z + squared / z^2`.
struct InverseDepthError {
    float constant = 0, relative = 0, squared = 0;
    float at(float inverse_depth) const { return constant + inverse_depth * (relative + inverse_depth * squared); }
    bool none() const { return constant == 0 && relative == 0 && squared == 0; }
};

/// Two neighbouring pixels are torn apart where the step of 1/z shows as more than `tear_px` of disparity and no plane
/// on either side explains it: both second differences (zero on a plane) reach `tear_break` of the step, and what four
/// erroneous values can add up to. Where both bend the same way the planes of the two sides may meet in a crease, and
/// `crease_break` counts instead. A surface hides a point that its error cannot lift above that surface: rays start,
/// and keys are asked, at 1/z plus two errors (the point's and the surface's).
struct DepthRules {
    double tear_px = 1.0;
    double tear_break = 0.25, crease_break = 0.5;
    InverseDepthError error;
};

/// `depth` says where the 8-bit scale ends; `step_m` is that of mm16.
DepthRules depth_rules(DepthSource source, const DepthMap& depth, double step_m = 0.001);

/// What monocular depth goes through before anything else: silhouettes that are blurred over a few pixels, made sharp
/// again. A pixel on the slope between two surfaces goes to the nearer one's nearest 1/z within two pixels, or to the
/// farther one's farthest, whichever it is closer to. Steps of less than a twentieth of 1/z stay, and so does a frame
/// of four pixels.
DepthMap snap_edges(const DepthMap& depth);

}  // namespace vshift
