// SPDX-License-Identifier: Apache-2.0
// Role: what a hole's pixel sees around it: the first known pixels in 16 directions. Stage: inpaint. No Torch here.
//
// fill_background averages these by rules of its own; kind pixel_rays (model.h) learns how.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

namespace vshift::inpaint {

inline constexpr int ray_count = 16;
/// Per ray: color at the hole's edge and two steps beyond it (-1..1), 1/z at both in eighths of a metre, the logarithms of
/// both 1/z, the distance's logarithm and inverse, and 1: all 0 where the image ends before.
inline constexpr int ray_numbers = 13;
/// Per pixel: the fill's color (-1..1), height in the image (-1..1), distance from its middle column (0..1).
inline constexpr int own_numbers = 5;

/// The ray that is this one in the mirrored image.
inline constexpr std::size_t mirrored_ray(std::size_t ray) {
    return (ray_count / 2 + ray_count - ray) % ray_count;
}

/// Planes as the network takes them (c_api.h), one frame.
struct RayPlanes {
    int width, height;
    const float *fill, *hole, *inverse_depth;
};

/// For every pixel of `chosen`, which lie in holes (hole > 0): `rays` [pixel][ray][number], `own` [pixel][number].
struct RayNumbers {
    std::vector<float> rays, own;
};
RayNumbers ray_numbers_of(const RayPlanes& planes, const std::vector<int32_t>& chosen);

}  // namespace vshift::inpaint
