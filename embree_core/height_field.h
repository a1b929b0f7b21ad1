// SPDX-License-Identifier: Apache-2.0
// Role: rays against the lifted surface of one depth map, without a mesh. Stage: lift, build and cast of a mask of one
// camera alone.
//
// The surface of lift.h is a height field of 1/z over the picture, in which the way from a pixel's point to V is
// straight, too. The picture is cut into tiles of cells; Embree finds the tiles whose range of 1/z a ray passes, and
// within one the ray is followed from cell to cell: in each triangle of it the ray stays above (nearer to the camera
// than) or below the surface, or passes through it; where the side changes between two parts of a split cell it passes
// a wall. So nothing is modelled but the tiles that a mask's rays can meet, and the surface is the one of full
// resolution.
#pragma once
#include <memory>
#include <vector>

#include "embree_core/height_field_kernels.h"
#include "embree_core/surface_field.h"
#include "embree_core/trace.h"

namespace vshift {

class RayFilter;

class HeightField {
public:
    HeightField() = default;  ///< nothing
    /// Of the field (lift.h), which must stay where it is, what the rays of `filter` (null: all) can meet.
    /// `px_per_inverse_depth` tells Embree how long a step of 1/z is beside a pixel.
    HeightField(const SurfaceField& field, float wall_top, const RayFilter* filter, float px_per_inverse_depth);

    /// The rays' `end` is shortened to where nothing is any more.
    heights::Met meet(heights::Rays& rays, uint32_t asked) const;

    size_t tiles() const { return tiles_.size(); }
    /// What it and Embree hold beside the field.
    size_t bytes() const;

private:
    /// What one row of tiles keeps beside the field.
    struct Row {
        struct Made {
            heights::Tile tile;
            size_t first_code, first_value;  ///< of a tile with codes
        };
        std::vector<Made> made;
        std::vector<int32_t> codes;
        std::vector<float> values;
        void add(const SurfaceField& field, float wall_top, const uint8_t* const* kinds, int x, int y);
    };
    heights::Surface surface_{};
    float px_per_inverse_depth_ = 0;
    float highest_ = 0;
    std::vector<Row> rows_;
    std::vector<heights::Tile> tiles_;
    TracedBoxes boxes_;
};

}  // namespace vshift
