// SPDX-License-Identifier: Apache-2.0
// Role: the epipolar lines of a shift that is not along the rows: fans of lines, passed sixteen at a time, and which
// line answers for which pixel.
#pragma once
#include <utility>
#include <vector>

#include "embree_core/sweep_line.h"

namespace vshift::sweep {

/// One image axis of the camera as the lines see it.
struct Axis {
    double focal, middle, centre_m;  ///< of R along this axis: focal length, principal point, V's centre
    int size;
};

/// The rule of a line whose sample 0 lies at `first` on the axis.
LineRule line_rule(const Axis& major, const SweepCamera& camera, int first, int heading);

/// The same tears as `lift`'s, along an axis of this focal length.
TearRule tear_rule(const DepthRules& rules, double px_per_q);

// Near the epipole only every 2^level-th line goes on, and no more than this.
constexpr int highest_level = 5;

/// Lines of one fan: those that run along one image axis (the major one) more than along the other, on one side of the
/// epipole. They are numbered outwards from the epipole, so that a mirrored image has the mirrored lines.
struct Fan {
    bool transposed = false;  ///< the major axis is y
    int heading = 1;          ///< +1: towards V the major coordinate grows
    int majors = 0, minors = 0;
    int major_begin = 0, major_end = 0;
    double epipole_major = 0, epipole_minor = 0;  ///< lines that do not meet: infinity and 0
    std::vector<double> origin, spacing;          ///< per major: line j passes minor origin + j spacing
    std::vector<int> level;  ///< per major: every 2^level-th line is there; falls with the way from the epipole
    int first_line = 0, last_line = 0;
    std::vector<Horizon> horizons, horizons_before;  ///< what the passes know between two levels, per line
    std::vector<uint8_t> known, known_before;

    /// The pixels across the lines at `major` that the fan answers for: those no farther from the epipole's minor.
    double reach(int major) const { return std::fabs(major + 0.5 - epipole_major); }
    /// The elements of a marked row that its lines read.
    std::pair<int, int> read(int major) const;
};

/// The fans of lines that cover the image, `density` lines a pixel where they are farthest apart; their buffers are
/// reused.
void plan(const Axis& x, const Axis& y, double centre_z, double density, std::vector<Fan>& fans);

/// 1/z of an image with its tears marked (`Kernels::mark_row`), in rows across a fan's lines.
class MarkedImage {
public:
    /// For fans along this one's axis.
    void make_room(const Fan& fan);
    /// What the fan reads of the depth map. Two fans along one axis may be filled at once: they read other majors.
    void fill(const Fan& fan, const DepthMap& depth, const TearRule& tear);
    const float* row(int major) const { return room_.data() + row_room + ptrdiff_t(major) * stride_; }
    ptrdiff_t stride() const { return stride_; }

private:
    std::vector<float> room_;
    ptrdiff_t stride_ = 0;
    int rows_ = 0;
};

/// Passes every line of a fan and gives its pixels in `out`, which are 0, the answer of the nearest one.
void sweep_fan(const SweepCamera& camera, const MarkedImage& image, Fan& fan, Grid<uint8_t>& out);

}  // namespace vshift::sweep
