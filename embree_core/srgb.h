// SPDX-License-Identifier: Apache-2.0
// Role: the sRGB transfer curve and its inverse (IEC 61966-2-1), per value. The only pair in the
// core: image files and scores use it, so that what one encodes the other decodes.
#pragma once
#include <cmath>

namespace vshift {

/// Linear light to display value; both 0..1. Values outside are clamped; NaN stays NaN.
inline double srgb_from_linear(double linear) {
    if (std::isnan(linear)) return linear;
    if (linear <= 0) return 0;
    if (linear >= 1) return 1;
    return linear <= 0.0031308 ? 12.92 * linear : 1.055 * std::pow(linear, 1 / 2.4) - 0.055;
}

/// Display value to linear light; both 0..1. Values outside are clamped; NaN stays NaN.
inline double linear_from_srgb(double srgb) {
    if (std::isnan(srgb)) return srgb;
    if (srgb <= 0) return 0;
    if (srgb >= 1) return 1;
    return srgb <= 0.04045 ? srgb / 12.92 : std::pow((srgb + 0.055) / 1.055, 2.4);
}

}  // namespace vshift
