// SPDX-License-Identifier: Apache-2.0
// Role: training pairs and true shifted views from analytic streets: recorded views, masks of random virtual shifts by
// the mask engine, classical fills. Stage: inpaint (paper III-C). No Torch here.
#pragma once
#include <functional>
#include <string>
#include <vector>

#include "embree_core/types.h"
#include "embree_core/warp.h"
#include "inpaint/c_api.h"
#include "scenes/analytic/analytic_street.h"
#include "scenes/analytic/street_mesh.h"

namespace vshift::inpaint {

/// Planes as the network takes them (c_api.h).
struct PairPlanes {
    int width = 0, height = 0;
    std::vector<float> target, fill, hole, neighbor, inverse_depth, weight;
    std::vector<float> texture;  ///< of flows with a start alone (start_pairs.h)
    std::vector<float> seen;     ///< of single pixels alone (pixel_pool.h)
    vshift_inpaint_views views() const;
};

/// Fills the hole (fill_background) and makes planes. `target` and `neighbor` (which pixels a neighbour gave: their depth
/// counts as not known) may be null; `color` and `own_depth` are not read in holes.
PairPlanes planes_of(const ColorImage& color, const DepthMap& own_depth, const Mask& hole, const ColorImage* target,
                     const Mask* neighbor = nullptr);

/// What a training pair is made of; the rows of the paper's Table 2 and what we add.
enum class Arm {
    extrapolation,  ///< own points splatted to V; the target is every camera's, so it is known only where a neighbour saw
    virtual_shift,  ///< the recorded view without what V would lose; the target is the recorded view (paper III-C)
    seam,           ///< the same with the neighbours' pixels in what is lost (paper III-D)
    double_warp,    ///< the same, and what is not lost warped R -> V -> R
    there_and_back  ///< virtual_shift, and what is not lost warped R -> V -> R
};
/// As above, by name.
const std::vector<std::string>& arm_names();
inline bool has_neighbors(Arm arm) { return arm == Arm::seam || arm == Arm::double_warp; }

/// Recorded views of streets, kept in memory: per seed `frames` frames of six cameras at `width` x 9/16 width. The
/// cameras of a rig follow each other.
struct RecordedViews {
    struct View {
        ColorImage color;
        DepthMap depth;
        analytic::RigCamera camera;
        double lane_m = 0;  ///< how far left of the drive's line the rig stood
    };
    std::vector<View> views;
    size_t rig_size = 6;
};
/// Each rig stands up to `lanes_m` to either side of the drive's line, by chance: drives in other lanes.
RecordedViews record_streets(const std::vector<uint32_t>& seeds, int frames, int width, double lanes_m,
                             const std::function<void(size_t done, size_t total)>& show);

/// Training pair `number` of a run: a view and a sideways shift of 0.5 to 4 m to either side (up to 1 m along) follow
/// from seed and number; the side is the one that keeps V within 4 m of the drive's line, or drawn. What is lost from there is the hole (method.md section 2). Views in which nothing is occluded are passed by. What
/// is outside V's frame weighs a tenth: it is several times as much and can be guessed less. With `crop_px`, a square of
/// that side that holds an occluded pixel, every other one mirrored; 0: whole views.
PairPlanes training_pair(const RecordedViews& recorded, uint64_t seed, uint64_t number, int crop_px = 0,
                         Arm arm = Arm::virtual_shift);
/// Such a square of a whole pair.
PairPlanes cropped_pair(const PairPlanes& pair, int crop_px, analytic::Stream& random);

/// A true shifted view: what the own camera saw, warped there; its holes by reason; and the truth, rendered.
struct TrueShiftedView {
    Warped warped;
    DepthMap depth;
    ColorImage truth;
    Mask disoccluded, outside;
    PairPlanes planes;       ///< of the own camera alone
    PairPlanes seam_planes;  ///< with the neighbours' pixels in its holes; when asked for
};
/// 3 planes of display values, as PairPlanes has them.
std::vector<float> display_planes(const ColorImage& image);
/// `recorded` is one frame of one street: a rig.
TrueShiftedView true_shifted_view(const analytic::StreetScene& street, const RecordedViews& recorded, size_t own, int frame,
                                  const Shift& shift, bool with_seam);
/// That frame.
RecordedViews record_frame(const analytic::StreetScene& street, int frame, int width, double lane_m = 0);

}  // namespace vshift::inpaint
