// SPDX-License-Identifier: Apache-2.0
// Role: colours for the shifted view from a recorded picture. Stage: warp (paper III-C, I_shift).
//
// Bilinear; where V sees the surface smaller than R does, a tent as wide as V's pixel, so that fine patterns average
// instead of aliasing. A shear does not make it smaller. No sample is mixed across a tear. Beside a tear the far side's last half pixel is a mixture of
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
    /// At an image position of R that V shows at `shifted_px`; whatever they are the result is a mean of pixels of one
    /// surface.
    glm::vec3 at(glm::vec2 source_px, glm::vec2 shifted_px) const;
    /// `at`, unless the place is an edge and these are dropped: then false.
    bool sample(glm::vec2 source_px, glm::vec2 shifted_px, EdgeBand edge, glm::vec3& color) const;
    /// `sample` for a run of V's pixels, the first at `shifted_px`: places that are not `seen` (and dropped edges) become
    /// black, and `missing`.
    void run(const glm::vec2* source_px, glm::vec2 shifted_px, size_t n, const Sight* sight, EdgeBand edge,
             glm::vec3* color, uint8_t* missing) const;
    /// Whether the position lies on the far side of a tear, nearer to it than the last pixel's centre.
    bool is_edge(glm::vec2 source_px) const;

private:
    struct Place {
        int px, py;    ///< the pixel that the position belongs to
        float dx, dy;  ///< from its centre
    };
    Place place(glm::vec2 source_px) const;
    bool is_edge(const Place& at) const;
    glm::vec3 at(const Place& at, glm::vec2 source_px, glm::vec2 shifted_px) const;
    glm::vec3 torn(const Place& at) const;
    glm::vec3 wide(const Place& at, glm::vec2 reach) const;
    bool is_one_surface(int x0, int x1, int y0, int y1) const;
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
/// The same into memory of an earlier frame.
void warp(const Reprojection& shown, const Sampler& sampler, EdgeBand edge, ColorImage& color, Mask& missing);
/// One row of it.
void warp_row(const Reprojection& shown, const Sampler& sampler, EdgeBand edge, int y, ColorImage& color, Mask& missing);
/// The same from the whole rig: `samplers[k]` belongs to view k.
Warped warp(const ShiftedHoles& seen, const std::vector<Sampler>& samplers, EdgeBand edge);

}  // namespace vshift
