// SPDX-License-Identifier: Apache-2.0
// Role: scores. Masks against truth: IoU, precision, recall, F1, boundary F1. Images against truth,
// per region: PSNR, SSIM. Stage: score.
#pragma once
#include <cstdint>

#include "embree_core/types.h"

namespace vshift {

/// Counts of a binary mask against truth, over the pixels where `valid` is not 0.
struct Confusion {
    uint64_t true_positive = 0, false_positive = 0, false_negative = 0, true_negative = 0;
};
/// Ratios of a Confusion. An empty truth and an empty result agree: every ratio is 1.
struct MaskScore {
    Confusion counts;
    double iou = 0, precision = 0, recall = 0, f1 = 0;
};
/// Sizes must agree (Error bad_input). `valid` may be null: every pixel counts.
MaskScore score_mask(const Mask& got, const Mask& truth, const Mask* valid = nullptr);

/// Boundary precision, recall and F1 at a tolerance: the share of boundary pixels of one mask within
/// `tolerance_px` (Euclidean, between pixel centres) of the other's boundary. A boundary pixel is a
/// set pixel with a clear 4-neighbour inside the image (Perazzi et al., CVPR 2016, contour accuracy F).
/// Pixels that are not `valid` do not exist: what stands there changes nothing. Two empty boundaries
/// agree (1); an empty one against another is 0. `tolerance_px` is finite and >= 0 (Error bad_input).
struct BoundaryScore {
    double precision = 0, recall = 0, f1 = 0;
    uint64_t got_px = 0, truth_px = 0;
};
BoundaryScore score_boundary(const Mask& got, const Mask& truth, double tolerance_px, const Mask* valid = nullptr);

/// Peak signal-to-noise ratio in dB over the region (null: everywhere), all three channels pooled,
/// peak 1. Infinite when equal; NaN when the region is empty.
double psnr_db(const ColorImage& got, const ColorImage& truth, const Mask* region = nullptr);

/// Structural similarity (Wang et al. 2004: 11x11 Gaussian, sigma 1.5, K1 0.01, K2 0.03, peak 1) of
/// Rec.709 luma, averaged over the region's pixels; windows are cut at the image's border and
/// renormalised. NaN when the region is empty.
double ssim(const ColorImage& got, const ColorImage& truth, const Mask* region = nullptr);

/// Linear light to display-referred sRGB in 0..1, what PSNR and SSIM are taken on (call it first: they
/// take pixels as they are). Clamped; NaN stays NaN and shows in the score.
ColorImage srgb_from_linear(const ColorImage& linear);

}  // namespace vshift
