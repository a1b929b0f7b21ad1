// SPDX-License-Identifier: Apache-2.0
// Role: small scenes in which what the method takes for granted does not hold: color and depth belong to one opaque
// surface that stands still and is wider than a pixel. Each comes twice, with the fault and without it and else the
// same, so that what the fault costs is a difference of two figures. Needs no Blender.
#pragma once
#include <string>
#include <vector>

#include "embree_core/types.h"
#include "scenes/analytic/analytic_street.h"

namespace vshift::trouble {

struct Scene {
    std::string name;
    std::string fault;    ///< what is wrong with it
    std::string control;  ///< what stands in its place in the scene without the fault
    bool rig = false;     ///< answered from the whole rig, else from the own camera
};
const std::vector<Scene>& scenes();
/// Throws Error bad_input with the nearest name.
const Scene& scene(const std::string& name);

struct View {
    ColorImage color;  ///< linear, 3x3 samples a pixel
    DepthMap depth;    ///< planar z at the pixel's centre, as a recording gives it
    Mask touched;      ///< a sample of the pixel shows the faulty thing
};

/// The scene's cameras (the own one first) and everything they record at frame 0, and the true shifted view.
struct Views {
    std::vector<analytic::RigCamera> rig;
    std::vector<View> recorded;
    View shifted;
};
/// `width` from 64 to 4096, height 9/16 of it; shifts as far as 4 m sideways stay clear of solids.
Views render(const Scene& scene, bool fault, const Shift& shift, int width);

/// How the result of warp and background-side fill fares where the fault shows: pixels of V that show the faulty
/// thing or were made from recorded pixels that do, and one pixel around.
struct Outcome {
    uint64_t affected_px = 0;
    double affected_share = 0;                    ///< of the image
    double psnr_db = 0;                           ///< there, with the fault
    double control_psnr_db = 0;                   ///< there, without
    double elsewhere_psnr_db = 0;                 ///< in the rest of what the warp filled, with the fault
    ColorImage recorded, truth, result, control;  ///< linear, of the own camera
    Mask affected;
};
Outcome run(const Scene& scene, const Shift& shift, int width);

}  // namespace vshift::trouble
