// SPDX-License-Identifier: Apache-2.0
// Role: the mask of one camera without a mesh: sweeps along epipolar lines. Stage: mask (method.md section 2).
//
// In (u, v, 1/z) the segment from a surface point to V's centre is straight, and the depth map is a height
// field over (u, v). All segments of an epipolar plane lie over one line of the image and run to one end
// (the epipole, or infinity), so along that line they are ordered by where V sees them: the key. A point is
// hidden when something ahead of it on the way to V has no smaller key; it is occluded when an observed
// surface covers its key, unknown when only torn walls do. One pass from V's end answers a whole line.
//
// A shift along the image rows is exact: the lines are the pixel rows. Other shifts sample the height field
// along lines that are less than half a pixel apart, and each pixel takes the answer of the nearest one. A tear lies
// midway between two samples, or where the line crosses into the row of pixels beyond it; the corner of a pixel that it
// passes over between two samples counts.
#pragma once
#include <memory>

#include "embree_core/depth_source.h"
#include "embree_core/mask.h"

namespace vshift {

namespace sweep {
struct PixelRule;
}

struct SweepCamera {
    Intrinsics recorded, shifted;
    Pose recorded_from_shifted;  ///< V in R's frame
    double clear_m = 2.0;        ///< radius round V's centre that is taken as free
    DepthRules rules{};
    float reach_px = 0.5f;  ///< how far a surface goes on past its last pixel's centre: from 0 to 1 it may be
    /// Where lines are not the rows, at the image's far border; 1.1 at least. With 2.2 every shift agrees with the rays
    /// to F1 .99 (docs/measured.md, "Sweep against rays").
    double lines_per_px = 2.2;
};

/// Keeps its buffers between frames. One sweeper serves one thread; inside it uses all cores.
class Sweeper {
public:
    Sweeper();
    ~Sweeper();

    /// One byte of ClassBits per pixel. The same bytes whatever the number of threads. Throws Error
    /// bad_input when a size does not fit.
    void classes(const SweepCamera& camera, const DepthMap& depth, Grid<uint8_t>& out);

    /// Pixels whose class hinges on where between two pixels a silhouette lies, which depth sampled once a pixel does
    /// not tell: those that change between the shortest and the longest reach of every surface, suspected tears
    /// included. Where lines do not follow the rows, their neighbours too. Takes the time of two more sweeps.
    Mask edges(const SweepCamera& camera, const DepthMap& depth, const Grid<uint8_t>& classes);

private:
    struct Buffers;
    std::unique_ptr<Buffers> buffers_;
};

/// Adds what a pixel's own point tells to a row of classes: outside and unseen bits; what has no measurement is unknown
/// and nothing else.
class PointBits {
public:
    explicit PointBits(const SweepCamera& camera);
    ~PointBits();
    void add(const DepthMap& depth, int row, uint8_t* classes) const;

private:
    std::unique_ptr<sweep::PixelRule> rule_;
};

}  // namespace vshift
