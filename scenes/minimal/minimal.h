// SPDX-License-Identifier: Apache-2.0
// Role: minimal scenes whose masks are known in closed form, and exact truth for them: rectangles,
// boxes and cylinders cast in double precision. No Embree, no Blender, and nothing of the code under
// test but its plain types: projections are written out here once more on purpose.
// Frames, units and pixel centres as in embree_core/camera.h; the world is the ego of frame 0.
#pragma once
#include <cstdint>
#include <string>
#include <vector>

#include "embree_core/camera.h"
#include "embree_core/types.h"

namespace vshift::minimal {

enum class Shape { rectangle, box, cylinder };

/// A convex surface. A rectangle lies in its local z = 0 and has two sides; the axis of a cylinder
/// (with caps) is its local z, its radius `half_m.x`. Half sizes of a rectangle may be infinite.
struct Primitive {
    Shape shape = Shape::rectangle;
    Pose world_from_local;
    glm::dvec3 half_m{1.0};
    glm::dvec3 color{0.5};
};
using World = std::vector<Primitive>;

/// A pinhole somewhere in the world.
struct View {
    Intrinsics intrinsics;
    Pose world_from_cam;
};

struct Camera {
    std::string name;
    Intrinsics intrinsics;
    Pose ego_from_cam;
};

/// A rectangle of an image in pixels: [x0, x1) x [y0, y1). A pixel belongs to it by its centre.
struct RectPx {
    double x0, y0, x1, y1;
    bool holds(double x, double y) const { return x >= x0 && x < x1 && y >= y0 && y < y1; }
};

/// One mask that is known without any ray: what it is called in a request, the rule, the pixels.
struct ClosedForm {
    std::string out;      ///< "mask" (recorded view), "holes" (shifted view), or "truth" where what
                          ///< one camera can know is less than what is so
    std::string channel;  ///< "occluded", "outside", "unknown", "hole", ...
    std::string rule;
    Mask expected;
};

struct Size {
    int width = 320;
    int height = 240;
};

struct MinimalScene {
    std::string name, about;
    World world;
    std::vector<Camera> rig;
    int own = 0;                           ///< the camera that the closed forms speak of
    std::vector<Pose> frames;              ///< world_from_ego; the first is the identity
    Shift shift;                           ///< the default request
    std::vector<ClosedForm> closed_forms;  ///< of rig[own] in frame 0

    View recorded(int camera, int frame = 0) const;
    View shifted(const Shift& by, int camera, int frame = 0) const;
    std::vector<View> views(int frame = 0) const;
};

// ---------------------------------------------------------------- named scenes (minimal.cpp)

std::vector<std::string> scene_names();
/// Throws Error bad_input with the nearest name. `seed` matters to `random` only. The focal length is
/// the image's width in pixels, so scenes look the same at every size.
MinimalScene make_scene(const std::string& name, Size size = {}, uint32_t seed = 1);

/// Fronto-parallel cards at one depth before an infinite wall; the camera moves to the left by
/// `left_m` (negative: right). Every mask of it is known: with D = f left (1/card - 1/wall) a wall
/// pixel u is occluded when u - D lies on a card, unknown when a card's edge lies between.
MinimalScene cards_before_wall(const std::string& name, Size size, const std::vector<RectPx>& cards, double card_m,
                               double wall_m, double left_m);

/// The set pixels of a mask as rectangles (runs of a row, merged downwards).
std::vector<RectPx> rectangles(const Mask& mask);

// ---------------------------------------------------------------- exact answers (exact.cpp)

struct SurfaceHit {
    double t = 0;
    int primitive = -1;
    glm::dvec3 normal{0.0};  ///< outward; of a rectangle, towards the ray's origin
    explicit operator bool() const { return primitive >= 0; }
};
/// The nearest surface on origin + t direction, t > 0.
SurfaceHit cast(const World& world, const glm::dvec3& origin, const glm::dvec3& direction);
/// Every surface there, unsorted: 0 < t < t_max.
std::vector<SurfaceHit> cast_all(const World& world, const glm::dvec3& origin, const glm::dvec3& direction,
                                 double t_max);

struct Picture {
    ColorImage color;
    DepthMap depth;           ///< planar z, +inf is sky
    Grid<int32_t> primitive;  ///< -1 is sky
};
Picture render(const World& world, const View& view);

/// Scene and shell truth of the pixels of rig[own] against V: VSHIFT_TRUTH_* flags of c_api.h.
Grid<uint8_t> truth_recorded(const World& world, const std::vector<View>& rig, int own, const View& shifted);

/// For each pixel of V: VSHIFT_SEEN_BY_OWN ... VSHIFT_NOBODY_OUTSIDE of c_api.h.
Grid<uint8_t> truth_shifted(const World& world, const std::vector<View>& rig, int own, const View& shifted);

/// 1 where the scene truth (occluded or not) of a pixel hangs on where a silhouette falls within
/// `radius_px`: a neighbour's answer differs, or the answer of the same segment does when R's image is
/// moved against it by that much. Sampling at pixel centres cannot decide these.
Mask undecided_by_sampling(const World& world, const View& recorded, const View& shifted, double radius_px);

/// 1 where the segment from a pixel's surface to V's centre leaves every frustum of the rig farther
/// than `clear_m` from V. Sky is 0.
Mask exact_unseen(const World& world, const std::vector<View>& rig, int own, const View& shifted, double clear_m);

}  // namespace vshift::minimal
