// SPDX-License-Identifier: Apache-2.0
// Pictures that several tests are made of.
#pragma once
#include "embree_core/types.h"

namespace vshift {

/// Reproducible noise in [0, 1).
inline ColorImage textured(int width, int height, uint32_t seed) {
    ColorImage image(width, height);
    for (auto& c : image.data)
        for (int k = 0; k < 3; ++k) {
            seed = seed * 1664525u + 1013904223u;
            c[k] = float(seed >> 8) / float(1 << 24);
        }
    return image;
}

}  // namespace vshift
