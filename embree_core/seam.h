// SPDX-License-Identifier: Apache-2.0
// Role: what the own camera lacks, from the neighbours that saw it (paper III-D; method.md sections 3 and 4).
// Stage: seam. Cameras fire at different times: each has its own pose in the world.
//
// In the shifted view a surface is shown only where it is the front-most of all that the rig saw on the pixel's ray,
// walls of its own not before it: where a neighbour saw something nearer than the own camera did, outside the own
// camera's frame, that hides what the own camera saw. (Inside its frame the own camera knows best.) In the recorded view the surface point is known, and a neighbour saw it
// when its own depth map says so there. Of several the one with the nearest viewing direction gives the colour; of the
// sky, which is endless, the one whose axis lies nearest.
#pragma once
#include <optional>
#include <string>

#include "embree_core/degrade.h"
#include "embree_core/warp.h"

namespace vshift {

/// One camera of the rig; what it points to must stay alive.
struct SeamCamera {
    std::string name;
    const SurfaceView* surface = nullptr;
    const ColorImage* image = nullptr;
    const LiftedView* lifted = nullptr;  ///< when given, the shifted view is cast instead of rasterised
    glm::vec3 gain{1};                   ///< on its colours
    const BentView* bent = nullptr;      ///< where colours are fetched, when not from `surface`
};

struct SeamOptions {
    double depth_tolerance = same_surface_share;  ///< share by which two depths of one surface may differ
    /// Under `drop` a sample in the band that mixes both sides of an edge gives way to any camera's that does not; where
    /// there is none it stands, the own camera's before a neighbour's: what a fill would put there is farther off
    /// (docs/measured.md).
    EdgeBand edge = EdgeBand::drop;
    bool depth = false;  ///< of the shifted view: `ShiftedSeam::inverse_depth` too
};

/// Colours (black where nobody saw anything) and which camera of the rig they are from: -1 none.
struct Seam {
    ColorImage color;
    Grid<int16_t> source;
};

/// The shifted view. `own`'s colours where it saw V's pixel. `out` may be of an earlier frame: its memory is used again.
struct ShiftedSeam {
    Seam seam;
    Reprojection own;                     ///< what the own camera shows
    Mask missing;                         ///< 1 where it gives no colour, or but a mixed one
    Grid<float> inverse_depth;            ///< when asked for: 1/Z of what is shown, 0 sky; NaN where nothing is
    Grid<float> floor;                    ///< scratch: 1/Z beyond which a neighbour's surface matters
    std::vector<uint8_t> asked;           ///< scratch: pixels that neighbours decide
    std::vector<Reprojection> neighbors;  ///< scratch
};
void seam_shifted(const std::vector<SeamCamera>& rig, int own, const ShiftedCamera& shifted,
                  const SeamOptions& options, ShiftedSeam& out);
inline ShiftedSeam seam_shifted(const std::vector<SeamCamera>& rig, int own, const ShiftedCamera& shifted,
                                const SeamOptions& options) {
    ShiftedSeam out;
    seam_shifted(rig, own, shifted, options, out);
    return out;
}

/// The recorded view: `lost` pixels (the paper's M) from the neighbours, all others as recorded.
Seam seam_recorded(const std::vector<SeamCamera>& rig, int own, const Mask& lost, const SeamOptions& options);

/// The gain that makes a neighbour's colours the own camera's, from what both saw: the median of the ratios, one for
/// all channels or one for each. 1 where fewer than 64 samples overlap.
glm::vec3 fitted_gain(const SeamCamera& own, const SeamCamera& neighbor, double depth_tolerance, bool per_channel);

}  // namespace vshift
