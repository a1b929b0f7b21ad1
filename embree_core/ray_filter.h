// SPDX-License-Identifier: Apache-2.0
// Role: which pixels of a lifted camera V sees for sure, told without a ray. Stage: mask.
//
// The picture is cut into tiles. In V's picture, with R's orientation, every tile lies in a box, and whatever hides a
// point there has a larger 1/z in R. A tile is clear when its surface and its neighbours' are whole and rise on the way to
// V less steeply than the segments to V do, so that it does not hide itself, and nothing else in its box stands nearer:
// of what is nearer by less than the neighbours reach, the neighbours are all there is.
#pragma once
#include "embree_core/lift.h"

namespace vshift {

class RayFilter {
public:
    /// `centre_m`: V's centre in the mesh's camera.
    RayFilter(const LiftedMesh& mesh, const glm::dvec3& centre_m);
    /// V sees the pixel's point (the sky's too), past no wall. False: ask by a ray.
    bool sees(int x, int y) const { return clear_.at(x / tile_width, y / tile_height_); }

private:
    static constexpr int tile_width = 16;
    int tile_height_;
    Grid<uint8_t> clear_;
};

}  // namespace vshift
