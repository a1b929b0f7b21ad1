// SPDX-License-Identifier: Apache-2.0
#include "embree_core/c_api.h"

#include <tbb/global_control.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <memory>
#include <mutex>
#include <new>

#include "embree_core/truth.h"
#include "embree_core/version.h"

struct vshift_scene {
    vshift::TrueScene scene;
};

namespace {
using namespace vshift;

thread_local std::string last_error;
constexpr double farthest_m = 1e15;  ///< squares of it are floats

/// Exceptions end here: every function of the ABI runs its body through this.
template <class Body>
int guarded(Body&& body) noexcept {
    try {
        last_error.clear();
        body();
        return int(ExitCode::done);
    } catch (const Error& e) {
        last_error = e.what();
        return int(e.code());
    } catch (const std::bad_alloc&) {
        last_error = "memory: got none, expected enough for the request";
        return int(ExitCode::over_limit);
    } catch (const std::exception& e) {
        last_error = std::string("internal: got ") + e.what() + ", expected no exception";
        return int(ExitCode::our_bug);
    }
}

void require(bool holds, const std::string& message) {
    if (!holds) throw Error(ExitCode::bad_input, message);
}

TrueCamera checked_camera(const vshift_camera* c, const std::string& name) {
    require(c != nullptr, name + ": got NULL, expected a camera");
    require(c->width > 0 && c->height > 0 && c->width <= 16384 && c->height <= 16384,
            name + ": size: got " + std::to_string(c->width) + "x" + std::to_string(c->height) + ", expected 1..16384");
    for (double value : {c->fx, c->fy, c->cx, c->cy})
        require(std::isfinite(value), name + ": intrinsic: got a number that is not finite, expected finite");
    require(c->fx > 0 && c->fy > 0,
            name + ": fx, fy: got " + std::to_string(c->fx) + ", " + std::to_string(c->fy) + ", expected > 0");
    // As in a recipe; beyond them rays are no longer finite, and Embree with assertions aborts.
    require(c->fx >= 1e-3 && c->fy >= 1e-3 && c->fx <= 1e7 && c->fy <= 1e7 && std::fabs(c->cx) <= 1e7 &&
                std::fabs(c->cy) <= 1e7,
            name +
                ": intrinsic: got numbers out of range, expected focal lengths from 0.001 to 1e7 pixels and a centre "
                "within 1e7");
    TrueCamera camera;
    camera.intrinsics = {c->width, c->height, c->fx, c->fy, c->cx, c->cy};
    for (int row = 0; row < 3; ++row) {
        for (int column = 0; column < 3; ++column)
            camera.world_from_cam.rotation[column][row] = c->world_from_cam[row * 4 + column];
        camera.world_from_cam.translation_m[row] = c->world_from_cam[row * 4 + 3];
    }
    const glm::dmat3 unit = camera.world_from_cam.rotation * glm::transpose(camera.world_from_cam.rotation);
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j)
            require(std::fabs(unit[i][j] - (i == j)) < 1e-5,
                    name + ": world_from_cam: got a matrix that is no rotation, expected one");
    require(glm::determinant(camera.world_from_cam.rotation) > 0,
            name + ": world_from_cam: got a mirrored rotation, expected determinant +1");
    for (int i = 0; i < 3; ++i)
        require(std::fabs(camera.world_from_cam.translation_m[i]) < farthest_m,
                name + ": world_from_cam: got a translation that is not finite or too far, expected less than 1e15 m");
    return camera;
}

std::vector<TrueCamera> checked_rig(const vshift_camera* rig, int32_t count, int32_t own) {
    require(rig != nullptr && count >= 1 && count <= 64,
            "rig: got " + std::to_string(count) + " cameras, expected 1..64");
    require(own >= 0 && own < count, "own: got " + std::to_string(own) + ", expected 0.." + std::to_string(count - 1));
    std::vector<TrueCamera> cameras;
    for (int32_t i = 0; i < count; ++i) cameras.push_back(checked_camera(rig + i, "rig[" + std::to_string(i) + "]"));
    return cameras;
}

const TrueScene& checked_scene(const vshift_scene* scene) {
    require(scene != nullptr, "scene: got NULL, expected a scene");
    return scene->scene;
}

template <class T, class U>
void copy_out(const Grid<T>& from, U* to) {
    if (to) std::memcpy(to, from.data.data(), from.data.size() * sizeof(T));
}

std::unique_ptr<tbb::global_control> thread_limit;
std::mutex thread_limit_mutex;

}  // namespace

extern "C" {

const char* vshift_version(void) {
    static const std::string text = std::string("vshift ") + version_string + ", " + tracer_version();
    return text.c_str();
}

const char* vshift_last_error(void) {
    return last_error.c_str();
}

int vshift_set_threads(int threads) {
    return guarded([&] {
        require(threads >= 1 && threads <= 1024, "threads: got " + std::to_string(threads) + ", expected 1..1024");
        const std::lock_guard lock(thread_limit_mutex);
        thread_limit =
            std::make_unique<tbb::global_control>(tbb::global_control::max_allowed_parallelism, size_t(threads));
    });
}

int vshift_self_test(void) {
    return guarded([] {
        if (!tracer_self_test())
            throw Error(ExitCode::our_bug,
                        "embree: self test: got a miss on a known quad, expected a hit "
                        "(does the host bring another Embree?)");
    });
}

int vshift_scene_create(const double* vertices_xyz, size_t vertex_count, const uint32_t* triangles,
                        size_t triangle_count, const double origin[3], vshift_scene** out) {
    return guarded([&] {
        require(out != nullptr, "out: got NULL, expected a place for the scene");
        *out = nullptr;
        require(vertices_xyz && triangles && origin, "mesh: got NULL, expected vertices, triangles and an origin");
        require(vertex_count > 0 && vertex_count < 0xffffffffu,
                "vertices: got " + std::to_string(vertex_count) + ", expected 1..2^32-2");
        require(triangle_count > 0 && triangle_count < 0xffffffffu,
                "triangles: got " + std::to_string(triangle_count) + ", expected 1..2^32-2");
        auto made = std::make_unique<vshift_scene>();
        made->scene.origin_m = {origin[0], origin[1], origin[2]};
        std::vector<LiftedVertex> vertices(vertex_count);
        for (size_t i = 0; i < vertex_count; ++i) {
            const double* v = vertices_xyz + 3 * i;
            for (int axis = 0; axis < 3; ++axis)
                require(std::isfinite(v[axis]) && std::fabs(v[axis] - origin[axis]) < farthest_m &&
                            std::fabs(origin[axis]) < farthest_m,
                        "vertices[" + std::to_string(i) + "]: got a coordinate that is not finite, expected finite");
            vertices[i] = {float(v[0] - origin[0]), float(v[1] - origin[1]), float(v[2] - origin[2]), 0};
        }
        std::vector<std::array<uint32_t, 3>> indices(triangle_count);
        for (size_t i = 0; i < triangle_count; ++i)
            for (size_t corner = 0; corner < 3; ++corner) {
                const uint32_t index = triangles[3 * i + corner];
                require(index < vertex_count, "triangles[" + std::to_string(i) + "]: got vertex " +
                                                  std::to_string(index) + ", expected < " +
                                                  std::to_string(vertex_count));
                indices[i][corner] = index;
            }
        made->scene.traced = TracedScene(std::move(vertices), indices);
        *out = made.release();
    });
}

void vshift_scene_free(vshift_scene* scene) {
    delete scene;
}

int vshift_cast_camera(const vshift_scene* scene, const vshift_camera* camera, float* depth, int32_t* triangle,
                       float* normal, double* position) {
    return guarded([&] {
        const TrueCamera c = checked_camera(camera, "camera");
        const CameraHits hits = cast_camera(checked_scene(scene), c);
        copy_out(hits.depth, depth);
        copy_out(hits.triangle, triangle);
        copy_out(hits.normal, normal);
        if (!position) return;
        for (int y = 0; y < hits.depth.height; ++y)
            for (int x = 0; x < hits.depth.width; ++x, position += 3) {
                const glm::dvec3 p =
                    c.world_from_cam.point(ray(c.intrinsics, {x + 0.5, y + 0.5}) * double(hits.depth.at(x, y)));
                std::memcpy(position, &p, sizeof p);
            }
    });
}

int vshift_cast_rays(const vshift_scene* scene, const double* origins_xyz, const double* directions_xyz, size_t count,
                     float* distance, int32_t* triangle) {
    return guarded([&] {
        const TrueScene& s = checked_scene(scene);
        require(count == 0 || (origins_xyz && directions_xyz), "rays: got NULL, expected origins and directions");
        tbb::parallel_for(size_t(0), count, [&](size_t i) {
            const double *o = origins_xyz + 3 * i, *d = directions_xyz + 3 * i;
            const glm::vec3 origin(glm::dvec3{o[0], o[1], o[2]} - s.origin_m), direction(glm::dvec3{d[0], d[1], d[2]});
            // Embree with assertions aborts on a NaN: such a ray hits nothing.
            const bool finite =
                std::isfinite(glm::dot(origin, origin)) && std::isfinite(glm::dot(direction, direction));
            const Hit hit =
                finite ? s.traced.intersect(origin, direction, 0, std::numeric_limits<float>::infinity()) : Hit{};
            if (distance) distance[i] = hit ? hit.t : std::numeric_limits<float>::infinity();
            if (triangle) triangle[i] = hit ? int32_t(hit.primitive) : -1;
        });
    });
}

int vshift_truth_recorded(const vshift_scene* scene, const vshift_camera* rig, int32_t rig_count, int32_t own,
                          const vshift_camera* shifted, uint8_t* flags) {
    return guarded([&] {
        copy_out(truth_recorded(checked_scene(scene), checked_rig(rig, rig_count, own), own,
                                checked_camera(shifted, "shifted")),
                 flags);
    });
}

int vshift_truth_shifted(const vshift_scene* scene, const vshift_camera* rig, int32_t rig_count, int32_t own,
                         const vshift_camera* shifted, uint8_t* klass, int8_t* source, float* depth) {
    return guarded([&] {
        const ShiftedTruth truth = truth_shifted(checked_scene(scene), checked_rig(rig, rig_count, own), own,
                                                 checked_camera(shifted, "shifted"));
        copy_out(truth.klass, klass);
        copy_out(truth.source, source);
        copy_out(truth.depth, depth);
    });
}

int vshift_clearance(const vshift_scene* scene, const double point[3], double limit_m, double* clearance_m,
                     int32_t* inside) {
    return guarded([&] {
        const TrueScene& s = checked_scene(scene);
        require(point && std::fabs(point[0]) < farthest_m && std::fabs(point[1]) < farthest_m &&
                    std::fabs(point[2]) < farthest_m,
                "point: got a coordinate that is not finite or too far, expected less than 1e15 m");
        require(limit_m > 0 && std::isfinite(limit_m), "limit_m: got " + std::to_string(limit_m) + ", expected > 0");
        const glm::vec3 origin(glm::dvec3{point[0], point[1], point[2]} - s.origin_m);
        constexpr int directions = 1024;  // a Fibonacci sphere: neighbours 6 degrees apart
        double nearest = limit_m;
        int hits = 0, from_behind = 0;
        for (int i = 0; i < directions; ++i) {
            const double z = 1 - (2 * i + 1.0) / directions, r = std::sqrt(1 - z * z), turn = i * 2.399963229728653;
            const glm::vec3 d(float(r * std::cos(turn)), float(r * std::sin(turn)), float(z));
            const Hit hit = s.traced.intersect(origin, d, 0, std::numeric_limits<float>::infinity());
            if (!hit) continue;
            ++hits;
            from_behind += glm::dot(hit.normal, d) > 0;
            nearest = std::min(nearest, double(hit.t));
        }
        if (clearance_m) *clearance_m = nearest;
        if (inside) *inside = hits > directions / 2 && from_behind > hits / 2;
    });
}

}  // extern "C"
