// SPDX-License-Identifier: Apache-2.0
// Role: the epipolar lines of a shift that is not along the rows: fans of lines, what they sample, and which
// line answers for which pixel.
#pragma once
#include <array>
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
constexpr int lines_per_block = 1 << highest_level;

/// Lines of one fan: those that run along one image axis more than along the other, on one side of the epipole.
/// They are numbered outwards from the epipole at the far border, so that a mirrored image has the mirrored lines.
struct Fan {
    bool transposed = false;  ///< the major axis is y
    int heading = 1;          ///< +1: towards V the major coordinate grows
    int majors = 0, minors = 0;
    int first_line = 0, lines = 0;  ///< multiples of lines_per_block
    int major_begin = 0, major_end = 0;
    double far_major = 0, far_minor = 0;  ///< line j passes far_minor + j / density at the far border
    double density = 1;                   ///< lines per pixel at the far border
    enum class Epipole { none, far, near } epipole = Epipole::none;
    double epipole_major = 0, epipole_minor = 0;
    double slope = 0;  ///< of lines that do not meet
    // A pixel's line is by_major * by_minor with a near epipole, else density * minor + by_major * by_minor.
    std::vector<float> by_major, by_minor;
    std::vector<int32_t> level;    ///< per major: every 2^level-th line is there; falls with the way from the epipole
    /// Per level: the major nearest to the epipole to which lines of that level reach, as `level` says.
    std::array<int, highest_level + 1> innermost{};
    std::vector<uint8_t> classes;  ///< lines x majors

    struct Straight {
        double at_zero, slope;  ///< minor = at_zero + slope * major, both in pixels as in the image
    };
    Straight line(int number) const {
        const double at_far = far_minor + number / density;
        const double s = epipole == Epipole::none ? slope : (at_far - epipole_minor) / (far_major - epipole_major);
        return {at_far - s * far_major, s};
    }
};

/// The fans of lines that cover the image; their buffers are reused.
void plan(const Axis& x, const Axis& y, double centre_z, double density, std::vector<Fan>& fans);

/// Every line of a fan. `image` is 1/z with its tears marked (`Kernels::mark_rows`), its rows along the major axis.
void sweep_fan(const SweepCamera& camera, const float* image, Fan& fan);

/// Each pixel of a run takes the answer of its nearest line. `x_table[x]` is x.
void take_run(const Fan& fan, int x_begin, int x_end, int y, const float* x_table, uint8_t* out);

}  // namespace vshift::sweep
