// SPDX-License-Identifier: Apache-2.0
// Role: what the network is given: I_cond and its mask channels (paper III-A eq. 1, III-D eq. 5). Stage: condition.
#pragma once
#include "embree_core/seam.h"

namespace vshift {

/// I_cond and, per pixel, whose it is: 0 or 1, or a share of the area at a stride. The three add up to 1.
struct Condition {
    ColorImage color;
    Grid<float> own, neighbor, hole;
};
/// At a stride: means over blocks of stride x stride pixels, fewer at the right and lower borders. `out` may be of an
/// earlier frame: its memory is used again. At stride 1 its colours change places with the seam's, without a copy.
void condition_of(Seam& seam, int own, int stride, Condition& out);
inline Condition condition_of(Seam seam, int own, int stride = 1) {
    Condition out;
    condition_of(seam, own, stride, out);
    return out;
}

/// Ablation "double_warp": what is not lost is warped R -> V -> R, so that training sees resampled pixels as inference
/// does. Pixels that V's picture cannot give back become lost. `color` and `lost` of the recorded view, in place.
void warp_twice(const SurfaceView& own, const ShiftedCamera& shifted, const Warped& warped, const Reprojection& shown,
                double depth_tolerance, ColorImage& color, Mask& lost);

/// Ablation "literal", the paper read word by word: V's holes applied to the recorded picture at the same pixel
/// coordinates, and V's seam pasted there. Misplaced by the disparity on purpose.
Seam literal_seam(const ColorImage& recorded, const ShiftedSeam& shifted, int own);

/// Ablation "splat": each recorded pixel carried over to the nearest pixel of V, the nearest depth wins; holes get the
/// neighbours' points.
Seam splatted_seam(const std::vector<SeamCamera>& rig, int own, const ShiftedCamera& shifted);

}  // namespace vshift
