// SPDX-License-Identifier: Apache-2.0
// What the tests on minimal scenes share: running the product on a scene, and counting differences.
#pragma once
#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include "embree_core/c_api.h"
#include "embree_core/field_mask.h"
#include "embree_core/holes.h"
#include "embree_core/mask.h"
#include "scenes/minimal/minimal.h"

namespace vshift::minimal {

inline Shift moved(double ahead_m, double left_m, double up_m = 0, double yaw_rad = 0) {
    Shift s;
    s.translation_m = {ahead_m, left_m, up_m};
    s.yaw_rad = yaw_rad;
    return s;
}

inline LiftedView lift_exact(const std::string& name, const World& world, const View& view,
                             const glm::dvec3& shifted_centre_m) {
    return lift_view(name, view.intrinsics, view.world_from_cam, render(world, view).depth, shifted_centre_m);
}

inline ShiftedCamera as_shifted(const View& view) {
    return {view.intrinsics, view.world_from_cam};
}

/// The recorded rig with exact depth, and V.
struct Case {
    LiftedRig rig;
    View v;
};

inline Case lift_scene(const MinimalScene& s, const Shift& shift, bool whole_rig = false) {
    Case c;
    c.v = s.shifted(shift, s.own);
    for (int i = 0; i < int(s.rig.size()); ++i) {
        if (!whole_rig && i != s.own) continue;
        if (i == s.own) c.rig.own = int(c.rig.views.size());
        c.rig.views.push_back(
            lift_exact(s.rig[size_t(i)].name, s.world, s.recorded(i), c.v.world_from_cam.translation_m));
    }
    return c;
}

constexpr double clear_m = 2.0;  ///< the product's default

inline RecordedMasks masks_of(const MinimalScene& s, const Shift& shift, bool whole_rig = false) {
    const Case c = lift_scene(s, shift, whole_rig);
    return mask(c.rig, as_shifted(c.v), clear_m);
}

/// By rays against the height field of R's depth.
inline RecordedMasks by_field(const View& r, const View& v, const DepthMap& depth, double clear = clear_m,
                              Casting casting = Casting::where_needed, const DepthRules& rules = {}) {
    const glm::dvec3& centre_m = v.world_from_cam.translation_m;
    SurfaceView surface = surface_view(r.intrinsics, r.world_from_cam, depth, centre_m, rules);
    return mask(field_view(std::move(surface), rules.error, centre_m, casting), depth, as_shifted(v), clear);
}

inline size_t count(const Mask& m) {
    return size_t(std::count_if(m.data.begin(), m.data.end(), [](uint8_t v) { return v != 0; }));
}

inline size_t differing(const Mask& a, const Mask& b) {
    if (a.width != b.width || a.height != b.height) return std::numeric_limits<size_t>::max();
    size_t n = 0;
    for (size_t i = 0; i < a.size(); ++i) n += (a.data[i] != 0) != (b.data[i] != 0);
    return n;
}

/// Pixels that differ in any channel.
inline size_t differing(const RecordedMasks& a, const RecordedMasks& b) {
    size_t n = 0;
    for (size_t i = 0; i < a.lost.size(); ++i)
        n += a.occluded.data[i] != b.occluded.data[i] || a.outside.data[i] != b.outside.data[i] ||
             a.unknown.data[i] != b.unknown.data[i] || a.unseen.data[i] != b.unseen.data[i];
    return n;
}

/// Pixels of `m` that are not in `allowed`.
inline size_t beyond(const Mask& m, const Mask& allowed) {
    size_t n = 0;
    for (size_t i = 0; i < m.size(); ++i) n += m.data[i] && !allowed.data[i];
    return n;
}

inline Mask flagged(const Grid<uint8_t>& flags, unsigned bit) {
    Mask m(flags.width, flags.height, 0);
    for (size_t i = 0; i < m.size(); ++i) m.data[i] = (flags.data[i] & bit) != 0;
    return m;
}

inline Mask either(const Mask& a, const Mask& b) {
    Mask m = a;
    for (size_t i = 0; i < m.size(); ++i) m.data[i] = a.data[i] || b.data[i];
    return m;
}

inline Mask mirrored(const Mask& m) {
    Mask out = m;
    for (int y = 0; y < m.height; ++y)
        for (int x = 0; x < m.width; ++x) out.at(x, y) = m.at(m.width - 1 - x, y);
    return out;
}

inline const Mask& channel_of(const RecordedMasks& m, const std::string& name) {
    return name == "occluded"  ? m.occluded
           : name == "outside" ? m.outside
           : name == "unknown" ? m.unknown
           : name == "unseen"  ? m.unseen
                               : m.lost;
}

inline double f1(const Mask& got, const Mask& truth) {
    size_t both = 0;
    for (size_t i = 0; i < got.size(); ++i) both += got.data[i] && truth.data[i];
    const size_t sum = count(got) + count(truth);
    return sum ? 2.0 * double(both) / double(sum) : 1.0;
}

}  // namespace vshift::minimal
