// SPDX-License-Identifier: Apache-2.0
// Role: depth map -> mesh. Stage: lift (paper III-B; method.md sections 1 and 2).
//
// The mesh is a watertight height field in (u, v, 1/z). Where four neighbouring pixels lie on one
// surface, their centres span a kept quad. Where they do not (a tear), every pixel keeps a quarter of
// the cell, its 1/z extrapolated by half a pixel from its own side, and a torn wall stands on the line
// between, from the near to the far side. The image's border is a tear to nothing: surfaces end half
// a pixel outside the outermost centres, without a wall. Beside a pixel without a measurement the
// walls reach (nearly) to the camera's centre, for nothing is known along that pixel's ray.
//
// Surfaces are given in camera coordinates. Walls are given in projective ones, (x/z, y/z, 1/z), where
// straight lines stay straight: there a wall is upright, thin and finite even when it ends at the sky
// (1/z = 0), while in space it would be a needle along the recorded rays, which no ray tracer likes.
//
// Under a tolerance flat areas collapse into few triangles (collapse.h). Pixels that are no vertices any more
// then move onto the mesh, in `vertices` and in `inverse_depth`: rays that start there start on the surface
// itself, so their offset need not grow with the tolerance. Tears and walls are found before and stay.
#pragma once
#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include "embree_core/camera.h"
#include "embree_core/depth_source.h"
#include "embree_core/ray_filter.h"
#include "embree_core/types.h"

namespace vshift {

struct LiftOptions {
    /// Distance between the recorded and the shifted camera's centres: turns a step of 1/z into
    /// pixels of disparity. 0 tears nothing.
    double baseline_m = 0;
    DepthRules rules{};  ///< where the mesh is torn, and the error that rays allow for
    /// How far a point of the surface may move, in pixels of disparity at `baseline_m`, for the sake of
    /// fewer triangles. 0: every pixel is a vertex.
    double tolerance_px = 0;
};

/// However small the shift: collapsing moves no surface by more than about this share of its 1/z.
inline constexpr float largest_share = 0.01f;

/// Leaves what `resize` adds as it is: memory that nobody writes costs nothing.
template <class T>
struct Uninitialized : std::allocator<T> {
    template <class U>
    struct rebind {
        using other = Uninitialized<U>;
    };
    template <class U>
    void construct(U* at) noexcept {
        ::new (static_cast<void*>(at)) U;
    }
    template <class U, class... Arguments>
    void construct(U* at, Arguments&&... arguments) {
        ::new (static_cast<void*>(at)) U(std::forward<Arguments>(arguments)...);
    }
};

struct LiftedVertex {
    float x, y, z, pad;  ///< camera coordinates in metres; padded to 16 bytes for the ray tracer
};
/// Corners in order round the quad; a triangle repeats its last corner.
using LiftedQuad = std::array<uint32_t, 4>;

/// The mesh of one depth map, in the camera's own frame.
struct LiftedMesh {
    Intrinsics intrinsics;
    /// The first width*height are the pixel centres, row-major.
    std::vector<LiftedVertex, Uninitialized<LiftedVertex>> vertices;
    std::vector<LiftedQuad> kept;                                          ///< lie on one observed surface
    std::vector<LiftedVertex, Uninitialized<LiftedVertex>> wall_vertices;  ///< (x/z, y/z, 1/z)
    std::vector<LiftedQuad> torn;  ///< walls across a discontinuity, over wall_vertices
    uint64_t kept_triangles = 0;
    float wall_top = 0;         ///< largest 1/z of a wall
    InverseDepthError error;    ///< of inverse_depth
    Grid<float> inverse_depth;  ///< 1/z at pixel centres; 0 is sky; NaN no measurement
    Grid<uint8_t> tears;        ///< bit 0: torn from the right neighbour, bit 1: from the lower
    uint64_t invalid_px = 0;    ///< NaN, 0, negative
    uint64_t sky_px = 0;
    DepthMap depth;   ///< as recorded
    float bound = 0;  ///< 1/z of the mesh may be off by this for the sake of fewer triangles

    RayFilter::Surface surface() const {
        return {intrinsics, inverse_depth, tears, wall_top, 2 * bound, 2 * largest_share, error};
    }
};

/// Throws Error bad_input unless `depth` has the intrinsics' size.
void check_size(const Intrinsics& intrinsics, const DepthMap& depth);

/// `depth` has the intrinsics' size (Error bad_input otherwise). Any content is accepted: what is no
/// measurement is counted.
LiftedMesh lift(const Intrinsics& intrinsics, const DepthMap& depth, const LiftOptions& options);

/// Which neighbouring pixels are torn apart: bit 0 from the right one, bit 1 from the lower. `w` is 1/z (0 sky, NaN no
/// measurement).
void find_tears(const Intrinsics& intrinsics, const Grid<float>& w, const LiftOptions& options, Grid<uint8_t>& tears);

/// Where a wall beside a pixel without a measurement ends, in 1/z: a power of two times the nearest surface's, so that
/// the mesh of a scaled scene is the scaled mesh to the bit.
inline constexpr float wall_top_of_nearest = 1024.0f;

/// 1/z of the mesh's surface at an image position: 0 for sky, NaN where there is no measurement or
/// outside the image. A point with larger 1/z at that position was seen through: it is free.
float surface_inverse_depth(const LiftedMesh& mesh, glm::dvec2 u_px);
/// The same of a depth map's 1/z and tears.
float surface_inverse_depth(const Grid<float>& w, const Grid<uint8_t>& tears, glm::dvec2 u_px);

}  // namespace vshift
