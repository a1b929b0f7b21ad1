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

namespace vshift::inpaint {

/// Planes as the network takes them (c_api.h).
struct PairPlanes {
    int width = 0, height = 0;
    std::vector<float> target, fill, hole, neighbor, inverse_depth, weight;
    std::vector<float> seen;  ///< of single pixels alone (pixel_pool.h)
    vshift_inpaint_views views() const;
};

/// Fills the hole (fill_background) and makes planes. `target` may be null; `color` and `depth` are not read in holes.
PairPlanes planes_of(const ColorImage& color, const DepthMap& depth, const Mask& hole, const ColorImage* target);

/// Recorded views of streets, kept in memory: per seed `frames` frames of six cameras at `width` x 9/16 width.
struct RecordedViews {
    struct View {
        ColorImage color;
        DepthMap depth;
        analytic::RigCamera camera;
    };
    std::vector<View> views;
};
RecordedViews record_streets(const std::vector<uint32_t>& seeds, int frames, int width,
                             const std::function<void(size_t done, size_t total)>& show);

/// Training pair `number` of a run: a view and a sideways shift of 0.5 to 4 m to either side (up to 1 m along) follow
/// from seed and number. What is lost from there is the hole (method.md section 2). Views in which nothing is occluded are passed by. What
/// is outside V's frame weighs a tenth: it is several times as much and can be guessed less. With `crop_px`, a square of
/// that side that holds an occluded pixel, every other one mirrored; 0: whole views. `twice`: what is not lost is warped
/// there and back (condition.h, warp_twice), so that edges and sharpness are those of a shifted view.
PairPlanes training_pair(const RecordedViews& recorded, uint64_t seed, uint64_t number, int crop_px = 0, bool twice = false);

/// A true shifted view: what the own camera saw, warped there; its holes; and the truth, rendered.
struct TrueShiftedView {
    Warped warped;
    DepthMap depth;
    PairPlanes planes;
    Mask disoccluded;
};
/// 3 planes of display values, as PairPlanes has them.
std::vector<float> display_planes(const ColorImage& image);
TrueShiftedView true_shifted_view(const analytic::StreetScene& street, const std::vector<analytic::RigCamera>& rig, int own,
                                  int frame, const Shift& shift);

}  // namespace vshift::inpaint
