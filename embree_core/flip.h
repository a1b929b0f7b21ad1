// SPDX-License-Identifier: Apache-2.0
// Role: FLIP, the difference that an observer notices when flipping between two images (Andersson et al. 2020, for
// low dynamic range), written from the paper's formulas. Stage: score.
#pragma once
#include "embree_core/types.h"

namespace vshift {

/// Pixels per degree of the usual set-up: 0.7 m from a screen 0.7 m wide with 3840 pixels.
inline constexpr double flip_pixels_per_degree = 3840 / 0.7 * 0.7 * 3.14159265358979323846 / 180;

/// Per pixel 0 (no difference) to 1. Both images display-referred sRGB in 0..1, of one size (Error bad_input). The
/// border is continued by its outermost pixels. A pixel's value hangs on some 10 pixels around it, and so does the
/// mean over a region.
Grid<float> flip_map(const ColorImage& got, const ColorImage& truth, double pixels_per_degree = flip_pixels_per_degree);

}  // namespace vshift
