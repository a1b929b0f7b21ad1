// SPDX-License-Identifier: Apache-2.0
// Role: what one recorded camera shows at the pixels of a shifted one: surface, sky, hidden space or nothing.
// Stage: between lift and warp (method.md section 3).
//
// The surface is the one of lift.h: kept cells in (u, v, 1/z), torn walls across discontinuities. A rasteriser
// carries its triangles over into V: in (u, v, 1/z) that is one projective map, and 1/Z is affine in V's image, so
// interpolation is exact. Embree casts V's rays at the mesh and is the oracle (`cast`).
#pragma once
#include "embree_core/view.h"

namespace vshift {

/// A recorded camera with its depth map as the rasteriser takes it: no mesh is built.
struct SurfaceView {
    Intrinsics intrinsics;
    Pose world_from_cam;
    Grid<float> inverse_depth;  ///< 1/z; 0 sky, NaN no measurement
    Grid<uint8_t> tears;        ///< as in lift.h
    float wall_top = 0;         ///< largest 1/z of a wall
    uint64_t invalid_px = 0, sky_px = 0;
};

/// Torn as V's distance asks; the same tears as `lift_towards`. Throws Error bad_input when the size does not fit.
SurfaceView surface_view(const Intrinsics& intrinsics, const Pose& world_from_cam, const DepthMap& depth,
                         const glm::dvec3& shifted_centre_m, const DepthRules& rules = {});
/// The same into memory of an earlier frame.
void surface_view(const Intrinsics& intrinsics, const Pose& world_from_cam, const DepthMap& depth,
                  const glm::dvec3& shifted_centre_m, const DepthRules& rules, SurfaceView& out);

/// Two depth maps of one surface differ by their sampling: by up to this share of depth they mean the same one.
inline constexpr double same_surface_share = 0.02;

enum class Sight : uint8_t {
    none,         ///< nothing on the ray: outside what the camera saw
    sky,          ///< the camera saw sky in that direction
    seen,         ///< a kept surface, from its front
    back_face,    ///< a kept surface from behind
    behind_wall,  ///< hidden space begins before anything else
};
inline bool is_seen(Sight s) {
    return s == Sight::sky || s == Sight::seen;
}

/// Per pixel of V, in certain columns of each band of rows; others hold nothing.
struct Reprojection {
    static constexpr int band_rows = 32;
    struct Columns {
        int x0 = 0, x1 = 0;  ///< half open
        bool holds(int x) const { return x >= x0 && x < x1; }
    };
    std::vector<Columns> columns;  ///< by band
    Grid<Sight> sight;
    Grid<float> inverse_depth;    ///< 1/Z in V of the nearest kept surface, also where a wall stands before it; else 0
    Grid<glm::vec2> source_px;    ///< where that surface (or the sky) lies in the recorded image

    int bands() const { return int(columns.size()); }
    bool holds(int x, int y) const { return columns[size_t(y / band_rows)].holds(x); }
    /// Makes room for V's pixels, and holds none of them.
    void fit(const Intrinsics& shifted);
};

/// By rasterising. `floor` (null: 0 everywhere): only surfaces with a greater 1/Z are answered, in as many columns as it
/// takes; where it is above 0 other pixels hold 0 and Sight::none, sky and walls alone are not told. Returns false where
/// there is nothing to answer. The same bytes whatever the number of threads.
bool reproject(const SurfaceView& view, const ShiftedCamera& shifted, const Grid<float>* floor, Reprojection& out);

/// By casting rays at the lifted mesh.
void cast(const LiftedView& view, const ShiftedCamera& shifted, Reprojection& out);

/// The projective map from R's (u, v, 1/z) to V's homogeneous pixel (x Z', y Z', Z') with Z' = Z / z.
struct ProjectiveMap {
    glm::dmat3 turn;  ///< of (u, v, 1)
    glm::dvec3 move;  ///< times 1/z
    glm::dvec3 at(double u, double v, double w) const { return turn * glm::dvec3(u, v, 1) + move * w; }
};
ProjectiveMap projective_map(const Intrinsics& from, const Pose& world_from_from, const Intrinsics& to,
                             const Pose& world_from_to);

}  // namespace vshift
