// SPDX-License-Identifier: Apache-2.0
// Role: the mask of one camera alone by rays against its height field. Stage: mask.
#pragma once
#include "embree_core/height_field.h"
#include "embree_core/mask.h"
#include "embree_core/ray_filter.h"
#include "embree_core/reproject.h"

namespace vshift {

/// One recorded camera, ready for the rays of one mask.
struct FieldView {
    SurfaceView surface;
    InverseDepthError error;                  ///< of 1/z: rays start as far above the surface
    glm::dvec3 centre_m;                      ///< V's, in the camera's frame
    std::unique_ptr<const RayFilter> filter;  ///< null: every pixel asks
    HeightField field;
};

/// `surface` as it was made for V's centre (in the world).
FieldView field_view(SurfaceView surface, const InverseDepthError& error, const glm::dvec3& shifted_centre_m,
                     Casting casting = Casting::where_needed);

/// As `mask` of a rig of this camera alone at full resolution. `depth`: what the surface was made of. Throws Error
/// our_bug where V stands elsewhere.
RecordedMasks mask(const FieldView& view, const DepthMap& depth, const ShiftedCamera& shifted, double clear_m);

}  // namespace vshift
