// SPDX-License-Identifier: Apache-2.0
// Role: inside lift: which cells of the mesh collapse into larger blocks, and where their surface then is.
//
// A quadtree: a block of 2^level x 2^level whole cells becomes one polygon when 1/z leaves a plane by no
// more than the bound over all its pixels. The polygon has a vertex wherever a neighbour has one on its
// border, so that every edge is shared: no T-junction. Cells beside a tear have no half edges where their
// parts are planes to the bound (`merged`), else they keep them all (`split`).
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

// Blocks of 32 x 32 cells: on streets there are so few of them that larger ones save next to nothing.
inline constexpr int most_levels = 5;

/// The border of a collapsed block as the neighbours see it: on each side, in ring order, where its vertices
/// stand, in half pixels from the side's first corner, which is the first of them.
struct BlockBorder {
    int cells = 0;  ///< along a side
    std::array<int, 4> counts{};
    std::array<std::array<int16_t, 2 << most_levels>, 4> stops;

    int count() const { return counts[0] + counts[1] + counts[2] + counts[3]; }
    /// A point `along` a side and `deep` in from it, both in the unit of `size`, the side's length.
    static glm::ivec2 place(int side, int size, int along, int deep) {
        switch (side) {
            case 0:
                return {along, deep};
            case 1:
                return {size - deep, along};
            case 2:
                return {size - along, size - deep};
            default:
                return {deep, size - along};
        }
    }
};
BlockBorder block_border(const CellPlan& plan, int level, int block_x, int block_y);

/// How a block's polygon is cut: into the ray tracer's two halves of a quad, into a fan from the middle of a
/// side where no side has more than one vertex between its corners, else into a fan from the block's centre.
enum class BlockFan { quad, side, centre };
BlockFan block_fan(const BlockBorder& border);

/// Ring of a `quad` or of a fan from a `side` (its first point), as pixel offsets from the upper left.
struct BlockRing {
    int count = 0;
    std::array<glm::ivec2, 8> at;
};
BlockRing block_ring(const BlockBorder& border);

/// Puts 1/z of a block's pixels, but for its last column and row, which the neighbours own, onto its polygon
/// where they are no vertices any more, and calls `moved(x, y)` for each.
template <class Moved>
void snap_block(Grid<float>& w, const CellPlan& plan, int level, int block_x, int block_y, Moved&& moved) {
    const int x0 = block_x << level, y0 = block_y << level, n = 1 << level;
    const BlockBorder border = block_border(plan, level, block_x, block_y);
    const BlockFan fan = block_fan(border);
    const auto value = [&](glm::ivec2 p) { return double(w.at(x0 + p.x, y0 + p.y)); };
    const auto put = [&](int x, int y, double height) {
        w.at(x0 + x, y0 + y) = float(height);
        moved(x0 + x, y0 + y);
    };
    if (fan == BlockFan::centre) {
        // Triangle by triangle, row by row in from its side: `share` is 1 on the side and 0 at the centre.
        const int half = n / 2;
        const double middle = value({half, half});
        for (int side = 0; side < 4; ++side)
            for (int i = 0, a = 0; a < n; ++i) {
                int b = n;
                for (; i + 1 < border.counts[size_t(side)]; ++i)
                    if (const int stop = border.stops[size_t(side)][size_t(i) + 1]; stop % 2 == 0) {
                        b = stop / 2;
                        break;
                    }
                const double at_a = value(BlockBorder::place(side, n, a, 0));
                const double at_b = value(BlockBorder::place(side, n, b, 0));
                for (int deep = 0; deep < half; ++deep) {
                    const int left = half - deep;
                    const double share = double(left) / half;
                    const int first = (half * deep + a * left + half - 1) / half;
                    const int last = (half * deep + b * left) / half;
                    for (int along = first; along <= last; ++along) {
                        if (deep == 0 && (side == 1 || side == 2 || along == a || along == b)) continue;
                        const glm::ivec2 p = BlockBorder::place(side, n, along, deep);
                        const double on_side = (along - half + (half - a) * share) / (b - a);
                        put(p.x, p.y, (1 - share) * middle + share * at_a + on_side * (at_b - at_a));
                    }
                }
                a = b;
            }
        return;
    }
    const BlockRing ring = block_ring(border);
    struct Plane {
        glm::ivec2 edge;  ///< from the apex to the triangle's last point
        double dx, dy;
    };
    std::array<Plane, 6> planes;
    // A quad is split along the diagonal (1,0)-(0,1), as the ray tracer does: a fan from (1,0).
    const int first = fan == BlockFan::side ? 0 : 1;
    const glm::ivec2 apex = ring.at[size_t(first)];
    const double own = value(apex);
    const int triangles = ring.count - 2;
    for (int k = 0; k < triangles; ++k) {
        const glm::ivec2 pa = ring.at[size_t((first + k + 1) % ring.count)];
        const glm::ivec2 pb = ring.at[size_t((first + k + 2) % ring.count)];
        const glm::ivec2 a = pa - apex, b = pb - apex;
        const double wa = value(pa) - own, wb = value(pb) - own, area = a.x * b.y - a.y * b.x;
        planes[size_t(k)] = {b, (wa * b.y - wb * a.y) / area, (wb * a.x - wa * b.x) / area};
    }
    for (int y = 0; y < n; ++y)
        for (int x = 0; x < n; ++x) {
            if (x == 0 || y == 0) {
                bool vertex = false;
                for (int i = 0; i < ring.count; ++i) vertex |= ring.at[size_t(i)] == glm::ivec2(x, y);
                if (vertex) continue;
            }
            const int dx = x - apex.x, dy = y - apex.y;
            int k = 0;
            while (k < triangles - 1 && planes[size_t(k)].edge.x * dy - planes[size_t(k)].edge.y * dx > 0) ++k;
            put(x, y, own + planes[size_t(k)].dx * dx + planes[size_t(k)].dy * dy);
        }
}

}  // namespace vshift
