// SPDX-License-Identifier: Apache-2.0
// The street as a whole, its rig and drive, and its truth.
#include <tbb/parallel_for.h>

#include <cmath>

#include "scenes/analytic/street_mesh.h"

namespace vshift::analytic {

using glm::dmat3;
using glm::dvec3;

const char* kind_name(Kind kind) {
    static const char* const names[kind_count] = {"ground", "building", "box", "pole", "slat", "sphere", "foliage"};
    return size_t(kind) < kind_count ? names[size_t(kind)] : "sky";
}

AnalyticStreet make_analytic_street(uint32_t seed, const StreetOptions& options) {
    AnalyticStreet street;
    street.seed = seed;
    MeshBuilder mesh(street);
    add_ground(mesh);
    add_buildings(mesh, seed);
    add_furniture(mesh, seed, options);
    return street;
}

uint64_t geometry_hash(const AnalyticStreet& street) {
    uint64_t hash = 14695981039346656037ull;
    const auto add = [&](const auto& values) {
        const auto* bytes = reinterpret_cast<const unsigned char*>(values.data());
        for (size_t i = 0; i < values.size() * sizeof(values[0]); ++i) hash = (hash ^ bytes[i]) * 1099511628211ull;
    };
    add(street.vertices), add(street.triangles), add(street.kind), add(street.albedo);
    return hash;
}

// ---------------------------------------------------------------- rig and drive

std::vector<RigCamera> six_camera_rig(int width, int height) {
    struct Row {
        const char* name;
        double yaw_deg, down_deg;
        dvec3 at;
        double f, cx, cy;  ///< at 1600x900
    };
    static const Row rows[6] = {{"CAM_FRONT", 0.0, 0.0, {1.70, 0.00, 1.51}, 1266.4, 816.3, 491.5},
                                {"CAM_FRONT_LEFT", 55.2, 0.2, {1.52, 0.49, 1.51}, 1272.6, 826.6, 479.8},
                                {"CAM_FRONT_RIGHT", -56.0, 0.3, {1.55, -0.49, 1.50}, 1260.8, 808.0, 495.3},
                                {"CAM_BACK", 180.0, 0.1, {0.03, 0.00, 1.58}, 809.2, 829.2, 481.8},
                                {"CAM_BACK_LEFT", 108.4, 0.6, {1.04, 0.48, 1.59}, 1256.7, 792.1, 492.8},
                                {"CAM_BACK_RIGHT", -110.1, 0.5, {1.01, -0.48, 1.56}, 1259.5, 807.3, 501.2}};
    const double sx = width / 1600.0, sy = height / 900.0;
    std::vector<RigCamera> rig;
    for (const Row& r : rows) {
        const double a = r.yaw_deg * radians_per_degree, b = r.down_deg * radians_per_degree;
        const dvec3 forward(std::cos(a) * std::cos(b), std::sin(a) * std::cos(b), -std::sin(b));
        const dvec3 right(std::sin(a), -std::cos(a), 0);
        const dmat3 rotation(right, glm::cross(forward, right), forward);  // camera axes as columns
        rig.push_back({r.name, {width, height, r.f * sx, r.f * sy, r.cx * sx, r.cy * sy}, {rotation, r.at}});
    }
    return rig;
}

Pose ego_pose(int frame) {
    if (frame < 0 || frame >= most_frames)
        throw Error(ExitCode::bad_input,
                    "frame: got " + std::to_string(frame) + ", expected 0 to " + std::to_string(most_frames - 1));
    return {dmat3(1.0), {metres_per_frame * frame, 0, 0}};
}

TrueCamera recorded_camera(const RigCamera& camera, int frame) {
    return {camera.intrinsics, compose(ego_pose(frame), camera.ego_from_cam)};
}

TrueCamera shifted_camera(const RigCamera& camera, int frame, const Shift& shift) {
    return {camera.intrinsics, compose(ego_pose(frame), shifted_ego_from_cam(camera.ego_from_cam, shift))};
}

std::vector<TrueCamera> recorded_rig(const std::vector<RigCamera>& rig, int frame) {
    std::vector<TrueCamera> all;
    for (const RigCamera& camera : rig) all.push_back(recorded_camera(camera, frame));
    return all;
}

// ---------------------------------------------------------------- truth

StreetScene build_street(uint32_t seed, const StreetOptions& options) {
    StreetScene out;
    out.street = make_analytic_street(seed, options);
    out.scene.traced = TracedScene(out.street.vertices, out.street.triangles);
    return out;
}

Grid<uint8_t> kinds_of(const AnalyticStreet& street, const CameraHits& hits) {
    Grid<uint8_t> kinds(hits.triangle.width, hits.triangle.height, uint8_t(Kind::sky));
    for (size_t i = 0; i < kinds.size(); ++i)
        if (hits.triangle.data[i] >= 0) kinds.data[i] = street.kind[size_t(hits.triangle.data[i])];
    return kinds;
}

namespace {

/// `truth_recorded` lifts each segment off its surface, by about 0.1 mm at 10 m and 1 mm at 100 m, and within that
/// of a silhouette it may report a surface that is not in the way. A ray from V to the point needs no such
/// distance: an occlusion that it does not confirm is dropped.
void drop_unconfirmed(const TrueScene& scene, const TrueCamera& recorded, const TrueCamera& v, const CameraHits& hits,
                      Grid<uint8_t>& flags) {
    const dvec3 eye = recorded.world_from_cam.translation_m, centre = v.world_from_cam.translation_m;
    tbb::parallel_for(0, flags.height, [&](int y) {
        for (int x = 0; x < flags.width; ++x) {
            uint8_t& f = flags.at(x, y);
            if (!(f & VSHIFT_TRUTH_OCCLUDED) || (f & (VSHIFT_TRUTH_FACES_AWAY | VSHIFT_TRUTH_SKY))) continue;
            const dvec3 d = recorded.world_from_cam.rotation * ray(recorded.intrinsics, {x + 0.5, y + 0.5});
            const dvec3 point = eye + double(hits.depth.at(x, y)) * d;
            const Hit hit =
                scene.traced.intersect(glm::vec3(centre - scene.origin_m), glm::vec3(point - centre), 0, 1.0f - 2e-5f);
            if (!hit || int32_t(hit.primitive) == hits.triangle.at(x, y))
                f &= uint8_t(~(VSHIFT_TRUTH_OCCLUDED | VSHIFT_TRUTH_SHELL_SELF | VSHIFT_TRUTH_SHELL_RIG));
        }
    });
}

}  // namespace

StreetTruth street_truth(const StreetScene& street, const std::vector<RigCamera>& rig, int own, int frame,
                         const Shift& shift) {
    const std::vector<TrueCamera> recorded = recorded_rig(rig, frame);
    CameraHits hits = cast_camera(street.scene, recorded.at(size_t(own)));
    StreetTruth out;
    out.kind = kinds_of(street.street, hits);
    const TrueCamera v = shifted_camera(rig[size_t(own)], frame, shift);
    out.truth_flags = truth_recorded(street.scene, recorded, own, v);
    drop_unconfirmed(street.scene, recorded[size_t(own)], v, hits, out.truth_flags);
    out.depth = std::move(hits.depth);
    return out;
}

std::vector<StreetTruth> street_truths(const StreetScene& street, const std::vector<RigCamera>& rig, int frame,
                                       const Shift& shift) {
    std::vector<StreetTruth> all;
    for (int i = 0; i < int(rig.size()); ++i) all.push_back(street_truth(street, rig, i, frame, shift));
    return all;
}

bool clear_of_solids(const StreetScene& street, const dvec3& point, double margin_m) {
    constexpr int directions = 512;
    for (int i = 0; i < directions; ++i) {  // a spiral over the sphere
        const double z = 1 - (2 * i + 1.0) / directions, r = std::sqrt(1 - z * z), a = i * 2.399963;
        const glm::vec3 d(r * std::cos(a), r * std::sin(a), z);
        const Hit hit = street.scene.traced.intersect(glm::vec3(point - street.scene.origin_m), d, 0, 1e4f);
        if (!hit) continue;
        if (hit.t < margin_m || glm::dot(hit.normal, d) > 0) return false;  // near, or seen from behind
    }
    return true;
}

}  // namespace vshift::analytic
