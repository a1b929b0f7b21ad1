// SPDX-License-Identifier: Apache-2.0
// Role: what SSIM, MS-SSIM and the gradient scores are made of: maps over a pair of images. Stage: score.
// Images are display-referred sRGB in 0..1 (score.h), luma is Rec.709 of those values, the data range is 1.
#pragma once
#include <vector>

#include "embree_core/types.h"

namespace vshift {

Grid<double> luma(const ColorImage& image);

/// Per pixel: SSIM = luminance x contrast_structure (Wang et al. 2004: 11x11 Gaussian window, sigma 1.5, K1 0.01,
/// K2 0.03, population covariance). Windows are cut at the image's border and renormalised.
struct SsimMaps {
    Grid<double> ssim, contrast_structure;
};
SsimMaps ssim_maps(const Grid<double>& got, const Grid<double>& truth);

/// Multi-scale SSIM (Wang et al. 2003) over five scales, each half of the one before by 2x2 means (an odd last row or
/// column is dropped): contrast and structure at the first four, SSIM at the last, to the powers 0.0448, 0.2856,
/// 0.3001, 0.2363, 0.1333; a scale's mean below 0 counts as 0. A region weighs the pixels of a scale by the share of
/// their area that it covers.
struct MsSsimMaps {
    std::vector<Grid<double>> scales;  ///< contrast and structure; SSIM in the last; none when too small
};
MsSsimMaps ms_ssim_maps(Grid<double> got, Grid<double> truth);
/// NaN where an image side is below 176 px (11 px at the last scale), or the region is empty at some scale.
double ms_ssim(const MsSsimMaps& maps, const Mask* region = nullptr);

/// Gradients of luma by central differences, one-sided at the border.
struct GradientMaps {
    Grid<double> error;                     ///< length of the difference of the two gradients
    Grid<double> got_energy, truth_energy;  ///< squared lengths
};
GradientMaps gradient_maps(const Grid<double>& got, const Grid<double>& truth);

}  // namespace vshift
