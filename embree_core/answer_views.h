// SPDX-License-Identifier: Apache-2.0
// Role: inside answer: what its parts share, and the answers that show a view: holes, warp, seam, condition.
#pragma once
#include <chrono>

#include "embree_core/answer.h"
#include "embree_core/condition.h"
#include "embree_core/view.h"

namespace vshift {

using Clock = std::chrono::steady_clock;
inline double ms_since(Clock::time_point start) {
    return std::chrono::duration<double, std::milli>(Clock::now() - start).count();
}

inline std::vector<float> plane_of(const Mask& mask) {
    return {mask.data.begin(), mask.data.end()};
}

/// The own camera and V, in the world.
struct Views {
    const CameraSpec& own;
    Pose world_from_own;
    ShiftedCamera shifted;
};

/// Memory of earlier views.
struct ViewRoom {
    std::vector<SurfaceView> surfaces;
    std::vector<Reprojection> shown;
    ShiftedSeam seam;
    Condition condition;
};

bool has_colors(const Request& request);
/// Whose depth maps answer the request.
std::vector<const CameraSpec*> cameras_used(const Recipe& recipe, const Request& request);

/// Says in `out` whether V's centre lies behind what the own camera saw: 1/z and tears of its surface.
void note_centre(const Views& views, const Grid<float>& w, const Grid<uint8_t>& tears, Answer& out);

/// Those cameras lifted and ready to trace; counts and times go to `out`.
LiftedRig lifted_rig(const Recipe& recipe, const Views& views, const Request& request, FrameFiles& files, Answer& out);

/// holes, warp, seam and condition.
void view_answer(const Recipe& recipe, const Views& views, const Request& request, FrameFiles& files, Answer& out);

}  // namespace vshift
