// SPDX-License-Identifier: Apache-2.0
// Role: inside lift: which cells of the mesh collapse into larger blocks, and where their surface then is.
//
// A restricted quadtree: a block of 2^level x 2^level whole cells becomes one polygon when 1/z leaves a
// plane by no more than the bound over all its pixels, and neighbours differ by one level at most. A
// polygon has a vertex at the middle of a side where the neighbour is finer, so that every edge is
// shared: no T-junction. Cells beside a tear are level 0 when their parts are planes to the bound
// (`merged`), else they keep all their half edges (`split`, one level finer still).
#pragma once
#include <vector>

#include "embree_core/surface_field.h"

namespace vshift {

enum CellKind : uint8_t { split_kind = 0, merged_kind = 1, whole_kind = 2 };

struct CellPlan {
    /// One entry more than the image has on each side: cell (x, y) is entry (x + 1, y + 1).
    Grid<uint8_t> kinds;
    /// collapsed[level - 1]: which blocks of that level stand for all their cells.
    std::vector<Grid<uint8_t>> collapsed;
    /// How much 1/z may change; 0: nothing collapses.
    float bound = 0;

    uint8_t kind(int x, int y) const { return kinds.at(x + 1, y + 1); }
    bool is_collapsed(int level, int block_x, int block_y) const {
        const Grid<uint8_t>& blocks = collapsed[size_t(level) - 1];
        return block_x >= 0 && block_y >= 0 && block_x < blocks.width && block_y < blocks.height &&
               blocks.at(block_x, block_y);
    }
    /// Of the largest block that whole cell (x, y) belongs to; 0: the cell stands for itself.
    int level(int x, int y) const {
        int found = 0;
        while (found < int(collapsed.size()) && is_collapsed(found + 1, x >> (found + 1), y >> (found + 1))) ++found;
        return found;
    }
};

/// `bound` is in 1/z.
CellPlan plan_cells(const SurfaceField& field, float bound);

/// The bound at a place: no depth changes by more than about this share, however small the shift.
inline constexpr float largest_share = 0.01f;

/// The polygon of a collapsed block: corners and side middles in ring order, as pixel offsets from its
/// upper left pixel. As a fan from its first point: triangles (0, k, k + 1).
struct BlockPolygon {
    int count = 0;
    bool middles = false;  ///< false: a plain quad, in corner order
    std::array<glm::ivec2, 8> at;
};
BlockPolygon block_polygon(const CellPlan& plan, int level, int block_x, int block_y);

/// Puts 1/z of every pixel that is no vertex any more onto the polygon above it; calls
/// `moved(x, y)` for each. A block owns its pixels but for its last column and row.
template <class Moved>
void snap_block(Grid<float>& w, const CellPlan& plan, int level, int block_x, int block_y, Moved&& moved) {
    const BlockPolygon polygon = block_polygon(plan, level, block_x, block_y);
    const int n = 1 << level, x0 = block_x << level, y0 = block_y << level;
    struct Plane {
        glm::ivec2 edge;  ///< from the apex to the second point: what is to its left belongs to this triangle
        double at_apex, dx, dy;
    };
    std::array<Plane, 6> planes;
    const auto value = [&](glm::ivec2 p) { return double(w.at(x0 + p.x, y0 + p.y)); };
    // A quad is split along the diagonal (1,0)-(0,1), as the ray tracer does: a fan from (1,0).
    const int first = polygon.middles ? 0 : 1;
    const glm::ivec2 apex = polygon.at[size_t(first)];
    const double own = value(apex);
    const int triangles = polygon.count - 2;
    for (int k = 0; k < triangles; ++k) {
        const glm::ivec2 pa = polygon.at[size_t((first + k + 1) % polygon.count)];
        const glm::ivec2 pb = polygon.at[size_t((first + k + 2) % polygon.count)];
        const glm::ivec2 a = pa - apex, b = pb - apex;
        const double wa = value(pa) - own, wb = value(pb) - own, area = a.x * b.y - a.y * b.x;
        planes[size_t(k)] = {b, own, (wa * b.y - wb * a.y) / area, (wb * a.x - wa * b.x) / area};
    }
    for (int y = 0; y < n; ++y)
        for (int x = 0; x < n; ++x) {
            if (x == 0 || y == 0) {
                bool vertex = false;
                for (int i = 0; i < polygon.count; ++i) vertex |= polygon.at[size_t(i)] == glm::ivec2(x, y);
                if (vertex) continue;
            }
            const int dx = x - apex.x, dy = y - apex.y;
            int k = 0;
            while (k < triangles - 1 && planes[size_t(k)].edge.x * dy - planes[size_t(k)].edge.y * dx > 0) ++k;
            const Plane& plane = planes[size_t(k)];
            w.at(x0 + x, y0 + y) = float(plane.at_apex + plane.dx * dx + plane.dy * dy);
            moved(x0 + x, y0 + y);
        }
}

}  // namespace vshift
