// SPDX-License-Identifier: Apache-2.0
// Role: colours for the shifted view from a recorded picture. Stage: warp (paper III-C, I_shift).
//
// Bilinear; where V sees the surface smaller than R does, a tent as wide as V's pixel, so that fine patterns average
// instead of aliasing. No sample is mixed across a tear. Beside a tear the far side's last half pixel is a mixture of
// both in any antialiased picture: under EdgeBand::drop those pixels get no colour.
#pragma once
#include "embree_core/holes.h"
#include "embree_core/surface_field.h"

namespace vshift {

enum class EdgeBand { drop, keep };

/// Samples one recorded picture for pixels of V.
class Sampler {
public:
    /// All three must stay alive; `field` is of the recorded camera.
    Sampler(const SurfaceField& field, const ColorImage& image, const ProjectiveMap& shifted_from_recorded);
    /// At an image position of R; whatever the position the result is a mean of pixels of one surface.
    glm::vec3 at(glm::vec2 source_px) const;
    /// Whether the position lies on the far side of a tear, nearer to it than the last pixel's centre.
    bool is_edge(glm::vec2 source_px) const;

private:
    glm::vec3 wide(int px, int py, glm::vec2 g, glm::vec2 reach) const;
    SurfaceField field_;
    const ColorImage& image_;
    float x_[4], y_[4], z_[4];
};

/// V's colours; holes (and dropped edges) are black. `missing`: 1 where there is no colour.
struct Warped {
    ColorImage color;
    Mask missing;
};
Warped warp(const Reprojection& shown, const Sampler& sampler, EdgeBand edge);
/// The same from the whole rig: `samplers[k]` belongs to view k.
Warped warp(const ShiftedHoles& seen, const std::vector<Sampler>& samplers, EdgeBand edge);

}  // namespace vshift
