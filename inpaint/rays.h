// SPDX-License-Identifier: Apache-2.0
// Role: what a hole's pixel sees around it: the first known pixels in 16 directions and what lies beyond them. Stage:
// inpaint. No Torch here.
//
// fill_background averages these by rules of its own; kind pixel_rays (model.h) learns how. Pixels of a hole share its
// edges: what a ray meets is described once for each edge pixel and direction.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

namespace vshift::inpaint {

inline constexpr int ray_count = 16;
/// Of an edge pixel and a direction: colors (-1..1) at the edge and 2 steps beyond; 1/z at both in eighths of a metre, and
/// their logarithms; color and 1/z 4, 8 and 16 steps beyond (where the image or the next hole ends before: the last one
/// there); mean colors of the first 6 and 17 pixels of one surface, and the logarithm of how many these are.
inline constexpr int edge_numbers = 29;
/// Of a hole's pixel and a ray: the logarithm and the inverse of the distance, 1/z that the surface would have here if it
/// went on straight, in eighths of a metre, and 1.
inline constexpr int way_numbers = 4;
/// Of one ray: of its edge, then of the way there. All 0 where the image ends before an edge.
inline constexpr int ray_numbers = edge_numbers + way_numbers;
/// Per pixel: the fill's color (-1..1), height in the image (-1..1), distance from its middle column (0..1).
inline constexpr int own_numbers = 5;
/// Per pixel, as training takes it: its rays, one after the other, and its own numbers.
inline constexpr int seen_numbers = ray_count * ray_numbers + own_numbers;

/// Planes as the network takes them (c_api.h), one frame.
struct RayPlanes {
    int width, height;
    const float *fill, *hole, *inverse_depth;
};

struct RayNumbers {
    std::vector<float> edges;   ///< [edge][edge_numbers]; the first is none: all 0
    std::vector<int32_t> edge;  ///< [pixel][ray]
    std::vector<float> ways;    ///< [pixel][ray][way_numbers]
    std::vector<float> own;     ///< [pixel][own_numbers]
};
/// For every pixel of `chosen`, which lie in holes (hole > 0).
RayNumbers ray_numbers_of(const RayPlanes& planes, const std::vector<int32_t>& chosen);

/// The known pixel that lies as far beyond the edge that `ray` meets as the hole's pixel `pixel` lies before it, back and
/// forth over the pixels of one surface there; `edge`: that edge's numbers.
int32_t mirrored_at_edge(const RayPlanes& planes, int32_t pixel, size_t ray, const float* edge);

/// Pixel `pixel` of these as seen_numbers floats at `to`.
void write_seen(const RayNumbers& numbers, size_t pixel, float* to);
/// The same for a pixel of the mirrored image.
void mirror_seen(const float* from, float* to);

}  // namespace vshift::inpaint
