// SPDX-License-Identifier: Apache-2.0
// Role: an image against the true shifted render, per region: PSNR, SSIM, MS-SSIM, FLIP, gradients; and pooled over
// frames with intervals. Stage: score.
//
// Conventions: linear colors become display-referred sRGB in 0..1 first; every map is computed on the whole image and
// then averaged over the region's pixels, so a window that reaches over the region's edge sees what stands there.
#pragma once
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "embree_core/structure.h"
#include "embree_core/types.h"

namespace vshift {

struct ImageMaps {
    Grid<double> squared_error;  ///< summed over the three channels
    Grid<double> ssim;
    MsSsimMaps ms_ssim;
    Grid<float> flip;
    GradientMaps gradient;
};
/// Linear colors of one size (Error bad_input).
ImageMaps compare_images(const ColorImage& got_linear, const ColorImage& truth_linear);

/// Sums over a region, so that rows can be pooled by pixel count. `ms_ssim` is NaN where structure.h says so.
struct RegionScore {
    uint64_t pixels = 0;
    double squared_error = 0, ssim = 0, flip = 0, gradient_error = 0, got_energy = 0, truth_energy = 0;
    double ms_ssim = 0;

    double psnr_db() const;    ///< infinite when equal, NaN when empty
    double sharpness() const;  ///< gradient energy as a share of the truth's
};
RegionScore score_region(const ImageMaps& maps, const Mask* region = nullptr);

/// The regions of a shifted view by its truth (set_layout.md): who saw what stands there.
struct Region {
    std::string name;
    Mask mask;
};
/// all; own (the own camera saw it), neighbour (only a neighbour did), visible (either); hole (nobody),
/// hole_disoccluded and hole_outside by reason; lost (the own camera did not: neighbour and hole); seam_band (within
/// `band_px`, Chebyshev, of a border between two sources, or a source and a hole). `klass` and `source` as in
/// truth.class and truth.source.
std::vector<Region> regions_of(const Grid<uint8_t>& klass, const Grid<int8_t>& source, int band_px = 3);

/// What one frame contributes to a pooled mean: sum over pixels, and their number.
struct FrameSum {
    double sum = 0, weight = 0;
};
struct Interval {
    double low = 0, high = 0;
};
/// 95 % interval of the pooled mean sum/weight: frames drawn with replacement `rounds` times from a seeded generator,
/// 2.5th and 97.5th percentiles (the nearest draw). None for fewer than two frames with weight.
std::optional<Interval> bootstrap(const std::vector<FrameSum>& frames, uint32_t seed = 1, int rounds = 2000);

}  // namespace vshift
