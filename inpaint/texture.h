// SPDX-License-Identifier: Apache-2.0
// Role: how near filled pixels come to the truth's look, wherever its details lie: a Frechet distance between the
// features of patches. Stage: score. (The usual features are those of a pretrained network; these need none.)
//
// The features of a patch of 8x8 pixels, 33: the means of Y, Cb and Cr (BT.601) over its inner 4x4; the magnitudes of
// the 15 coefficients other than the mean of the inner 4x4's orthonormal DCT of Y; and the same of the whole patch
// averaged 2x2. Magnitudes, since an edge and its mirror image are the same texture.
#pragma once
#include <array>
#include <vector>

#include "embree_core/types.h"

namespace vshift::inpaint {

inline constexpr size_t texture_features = 33;
using TextureFeatures = std::array<double, texture_features>;

/// `planes`: 3 planes of display values. (x, y): the upper left pixel of the inner 4x4, at least 2 from every border.
TextureFeatures texture_at(const std::vector<float>& planes, int width, int height, int x, int y);

/// Sums over patches: their number, mean and covariance. Sums of parts are those of the whole.
struct TextureMoments {
    double count = 0;
    std::vector<double> sum = std::vector<double>(texture_features);
    std::vector<double> products = std::vector<double>(texture_features * texture_features);

    void add(const TextureFeatures& features);
    void add(const TextureMoments& other);
};

/// Of all patches on a grid of 4 pixels of whose inner 4x4 at least half lies in the mask.
TextureMoments texture_moments(const std::vector<float>& planes, const Mask& mask);

/// |m1 - m2|^2 + tr(C1 + C2 - 2 (C1 C2)^1/2): between the Gaussians of these means (n) and covariances (n x n).
double frechet_distance(const std::vector<double>& mean1, const std::vector<double>& covariance1,
                        const std::vector<double>& mean2, const std::vector<double>& covariance2);

/// The same, every feature in units of the truth's standard deviation. NaN without patches.
double texture_distance(const TextureMoments& got, const TextureMoments& truth);

}  // namespace vshift::inpaint
