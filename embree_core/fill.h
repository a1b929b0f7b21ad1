// SPDX-License-Identifier: Apache-2.0
// Role: what remains of the holes in a shifted view, filled without a network. Stage: inpaint (its classical arm,
// the baselines that a network must beat, and the first guess that it starts from).
#pragma once
#include <string>
#include <vector>

#include "embree_core/types.h"

namespace vshift {

/// A view with holes: linear RGB, what to fill (not 0), and planar depth where there is no hole (+inf sky; NaN, 0 and
/// negative: not known, taken as near). Colors and depths under a hole are never read.
struct HoledView {
    const ColorImage& color;
    const Mask& hole;
    const DepthMap& depth;
};

enum class FillMethod { background, pushpull, telea, ns };
/// background, pushpull, telea, ns.
const std::vector<std::string>& fill_method_names();
/// Throws Error bad_input with the nearest name; `where` leads the message.
FillMethod fill_method(const std::string& name, const std::string& where);

/// Every method gives back the known pixels bit for bit and finite colors in the holes; the whole image comes back
/// black when all of it is a hole. Sizes must agree (Error bad_input). One thread and many give the same bytes.
ColorImage fill(const HoledView& view, FillMethod method);

/// Our own: a disocclusion belongs to the surface behind. From each hole pixel the first known pixels in 16
/// directions are averaged, weighted by 1 / sqrt(distance) and by how near their depth comes to the farthest among
/// them: (r - 0.5)^2 for r = farthest 1/z over own 1/z (both at least 0.005 / m), nothing below 0.5, so that a surface
/// in front that stands at less than half the background's distance gives none of its color. Where 5 or more
/// directions leave the image no torn edge is near (the hole is out of frame), and depth has no say. Averages are
/// taken of square roots, which is near what a display shows; in the end each hole pixel becomes the mean of itself and
/// its four neighbours among the holes, twice.
ColorImage fill_background(const HoledView& view);

/// OpenImageIO's fillholes_pushpull (pictures.h).
ColorImage fill_pushpull(const HoledView& view);

/// OpenCV's inpaint, Telea's fast marching or Navier-Stokes, over `radius_px` (fill_peers.cpp). Both work on 8-bit
/// sRGB, so filled colors are clamped to 0..1 and come in steps of 1/255; holes within three pixels
/// of the image's border get fill_background's color, since OpenCV fills them with black.
ColorImage fill_telea(const HoledView& view, double radius_px = 3);
ColorImage fill_navier_stokes(const HoledView& view, double radius_px = 3);

}  // namespace vshift
