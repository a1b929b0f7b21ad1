// SPDX-License-Identifier: Apache-2.0
// Role: seeded streets made of boxes, prisms and spheres, small enough that every truth is cast exactly
// from the same triangles: depth, kind, scene truth and shell truth of a six-camera rig, for any shift.
// Needs the core alone (Embree through truth.h), no Blender and no files.
//
// World frame: the ego of frame 0: x along the street, y left, z up, road at z = 0, metres. The ego drives
// along y = 0. Between x = -8 and 48 m nothing stands nearer than 5.3 m to that line below 2.9 m, so that a
// rig shifted by up to 4 m sideways and 2 m along is clear of solids in every frame. Solids stand a few
// centimetres deep in the ground and in each other, so that no two faces share a plane.
#pragma once
#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "embree_core/c_api.h"
#include "embree_core/camera.h"
#include "embree_core/trace.h"
#include "embree_core/truth.h"
#include "embree_core/types.h"

namespace vshift::analytic {

/// What a triangle belongs to. Wheels count as `box` (their car), tree trunks as `pole`.
enum class Kind : uint8_t { ground, building, box, pole, slat, sphere, foliage, sky = 255 };
inline constexpr size_t kind_count = 7;
const char* kind_name(Kind kind);

struct StreetOptions {
    int boxes = 400;      ///< exactly so many from 330 on; cars, kiosks and benches alone are 256 to 320
    bool foliage = true;  ///< crowns and plants; the rest of the street is the same without them
};

struct AnalyticStreet {
    uint32_t seed = 0;
    std::vector<LiftedVertex> vertices;  ///< world frame
    std::vector<std::array<uint32_t, 3>> triangles;
    std::vector<uint8_t> kind;                  ///< per triangle: Kind
    std::vector<uint32_t> thing;                ///< per triangle: which object, 0 ... things - 1
    std::vector<glm::vec3> albedo;              ///< per triangle, linear
    std::array<uint32_t, kind_count> shapes{};  ///< boxes, prisms, spheres placed, by Kind (wheels not counted)
    uint32_t things = 0;
};

/// Same seed and options, same bytes. Below 300 000 triangles. Spheres of kind `sphere` deviate from the round
/// one by less than 1 mm, poles (24 sides, 4 to 15 cm thick) by less than 1 mm, foliage by less than 2 cm.
AnalyticStreet make_analytic_street(uint32_t seed, const StreetOptions& options = {});

/// FNV-1a over vertices, triangles, kinds and albedos.
uint64_t geometry_hash(const AnalyticStreet& street);

// ---------------------------------------------------------------- rig and drive

struct RigCamera {
    std::string name;
    Intrinsics intrinsics;
    Pose ego_from_cam;
};

/// The six cameras of the street sets (nuScenes-like, 1600x900), scaled to any size.
std::vector<RigCamera> six_camera_rig(int width = 1600, int height = 900);

inline constexpr double metres_per_frame = 0.5;
inline constexpr int most_frames = 81;  ///< 40 m
/// world_from_ego; throws Error bad_input outside 0 ... most_frames - 1.
Pose ego_pose(int frame);

TrueCamera recorded_camera(const RigCamera& camera, int frame);
TrueCamera shifted_camera(const RigCamera& camera, int frame, const Shift& shift);
std::vector<TrueCamera> recorded_rig(const std::vector<RigCamera>& rig, int frame);

// ---------------------------------------------------------------- truth

/// The street with its ray-traced scene. Immutable: use it from any number of threads.
struct StreetScene {
    AnalyticStreet street;
    TrueScene scene;
};
StreetScene build_street(uint32_t seed, const StreetOptions& options = {});

struct StreetTruth {
    DepthMap depth;             ///< planar z of the recorded view, +inf is sky
    Grid<uint8_t> kind;         ///< Kind of the triangle hit, Kind::sky
    Grid<uint8_t> truth_flags;  ///< VSHIFT_TRUTH_* of c_api.h against the shifted camera
};
/// Of rig[own] in a frame, its shell truth by the whole rig.
StreetTruth street_truth(const StreetScene& street, const std::vector<RigCamera>& rig, int own, int frame,
                         const Shift& shift);
/// Of every camera of the rig.
std::vector<StreetTruth> street_truths(const StreetScene& street, const std::vector<RigCamera>& rig, int frame,
                                       const Shift& shift);

/// Kind per pixel of what `cast_camera` hit.
Grid<uint8_t> kinds_of(const AnalyticStreet& street, const CameraHits& hits);

/// Whether 512 rays all round the point meet nothing nearer than `margin_m` and no surface from behind, as they
/// would inside a solid.
bool clear_of_solids(const StreetScene& street, const glm::dvec3& point, double margin_m);

// ---------------------------------------------------------------- colour

/// Linear RGB of what a ray meets: Lambert under one sun with shadows and a sky, albedos with simple patterns. The
/// colour of a point does not depend on where it is seen from.
glm::vec3 ray_color(const StreetScene& street, const glm::dvec3& origin, const glm::dvec3& direction);
/// Every pixel is the mean of side x side samples.
ColorImage street_color(const StreetScene& street, const TrueCamera& camera, int side = 1);

}  // namespace vshift::analytic
