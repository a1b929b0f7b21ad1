// SPDX-License-Identifier: Apache-2.0
// Role: the lift's vectorised loops over rows of a depth map, chosen for the machine when the program runs (Highway).
// No fused operations, so every machine gives the same bytes.
#pragma once
#include <cstddef>
#include <cstdint>
#include <limits>

#include "embree_core/types.h"

namespace vshift::lifting {

/// What a row of depth, or all of it, holds.
struct RowCounts {
    uint32_t invalid = 0, sky = 0;
    float nearest_m = 1e12f;
};

/// When neighbours along one image axis are torn apart (DepthRules, in floats).
struct TearRule {
    float least_step;  ///< of 1/z, that shows
    float tear_break, crease_break;
    float constant, relative, squared;  ///< error of 1/z
};

/// Of 1/z and tears within a box of pixels.
struct BoxBounds {
    float low = std::numeric_limits<float>::infinity(), high = 0;
    bool invalid = false, torn = false;
};

struct Kernels {
    /// w = 1/z: 0 sky, NaN no measurement.
    RowCounts (*inverse)(const float* z, size_t n, float* w);
    /// Tears of pixels 0 to n - 1 of row `w`, from the right neighbour (bit 0) and the lower one (bit 1). w[-1] and
    /// w[n + 1] are read, and n values of the rows before and after. Returns how many pixels it did, from the first on.
    size_t (*tears)(const float* above, const float* w, const float* below, const float* below2, size_t n,
                    const TearRule& across, const TearRule& down, uint8_t* tears);
    /// Whether all corners of the n cells between two rows are joined: 2 where they are, else 0. n + 1 values of each
    /// row are read.
    void (*whole)(const float* w, const float* below, const uint8_t* tears, const uint8_t* tears_below, size_t n,
                  uint8_t* kinds);
    /// Points at z on rays (ray_x, ray_y, 1): x, y, z, 0, the origin where there is no measurement.
    void (*points)(const float* z, const double* ray_x, double ray_y, size_t n, float* xyz0);
    /// Rows are `stride` apart.
    BoxBounds (*bounds)(const float* w, const uint8_t* tears, size_t stride, size_t columns, size_t rows);
};

const Kernels& kernels();

/// 1/z of a whole depth map, by all cores; `w` has its size.
RowCounts inverse_of(const DepthMap& depth, Grid<float>& w);

}  // namespace vshift::lifting
