// SPDX-License-Identifier: Apache-2.0
// Role: the masks of the recorded view, the paper's M (III-C; method.md section 2). Stage: mask.
#pragma once
#include "embree_core/ray_filter.h"
#include "embree_core/view.h"

namespace vshift {

/// Bits of a pixel's class; none of them: visible.
enum ClassBit : uint8_t { occluded_bit = 1, outside_bit = 2, unknown_bit = 4, unseen_bit = 8 };

/// Per pixel of R, 0 or 1. `lost` = occluded or outside. `unknown` never overlaps `occluded`;
/// `outside` depends on V's frame alone and may overlap either.
struct RecordedMasks {
    Mask lost, occluded, outside, unknown, unseen;
};

RecordedMasks masks_of(const Grid<uint8_t>& classes);

/// Whether pixels that V sees for sure (ray_filter.h) are asked by a ray all the same: slower, the same masks.
enum class Casting { where_needed, everywhere };

/// Rays end this share of the segment before V, and those against a mesh start as far from its ends. Any value from
/// 1e-6 to 1e-3 gives the same masks; 0 finds the surface itself.
inline constexpr double ray_offset = 1e-4;
/// A ray that meets a vertex to the bit can slip between its triangles, even in a robust scene, and a shift along the
/// rows would send every ray from vertex to vertex. So V's centre is missed by this much in pixels of the recorded
/// pixel, along both image axes.
inline constexpr glm::dvec2 miss_px{0.001, largest_miss_px};

/// `clear_m`: radius of the ball round V's centre that is taken as free space (the ego must fit).
/// With more than one view in the rig hidden space is carved by all of them.
RecordedMasks mask(const LiftedRig& rig, const ShiftedCamera& shifted, double clear_m,
                   Casting casting = Casting::where_needed);

}  // namespace vshift
