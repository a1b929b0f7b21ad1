// SPDX-License-Identifier: Apache-2.0
#include "embree_core/trace.h"

#if __has_include(<embree4/rtcore.h>)
#include <embree4/rtcore.h>
#else
#include <embree3/rtcore.h>
#endif

#include <algorithm>
#include <atomic>
#include <cstring>
#include <limits>

#include "embree_core/types.h"

namespace vshift {
namespace {

/// What Embree holds at present, over all scenes.
std::atomic<int64_t> held_bytes{0};

/// The one global: a device is costly to make and safe to share.
RTCDevice device() {
    static RTCDevice shared = [] {
        RTCDevice made = rtcNewDevice(nullptr);
        const auto count = [](void*, ssize_t bytes, bool) {
            held_bytes.fetch_add(bytes, std::memory_order_relaxed);
            return true;
        };
        if (made) rtcSetDeviceMemoryMonitorFunction(made, count, nullptr);
        return made;
    }();
    if (!shared) throw Error(ExitCode::our_bug, "embree: device: got none, expected one");
    return shared;
}

void check(const char* what) {
    const RTCError error = rtcGetDeviceError(device());
    if (error == RTC_ERROR_NONE) return;
    const bool memory = error == RTC_ERROR_OUT_OF_MEMORY;
    throw Error(memory ? ExitCode::over_limit : ExitCode::our_bug,
                std::string("embree: ") + what + ": got error " + std::to_string(int(error)) +
                    (memory ? " (out of memory)" : "") + ", expected none");
}

RTCRay make_ray(const glm::vec3& o, const glm::vec3& d, float t_min, float t_max) {
    RTCRay ray;
    ray.org_x = o.x;
    ray.org_y = o.y;
    ray.org_z = o.z;
    ray.tnear = t_min;
    ray.dir_x = d.x;
    ray.dir_y = d.y;
    ray.dir_z = d.z;
    ray.time = 0;
    ray.tfar = t_max;
    ray.mask = 0xffffffffu;  // Embree 4 skips geometry whose mask shares no bit
    ray.id = 0;
    ray.flags = 0;
    return ray;
}

}  // namespace

struct TracedScene::Impl {
    RTCScene scene = nullptr;
    std::vector<LiftedVertex> own_vertices;
    size_t bytes = 0;

    /// Vertices and indices are the caller's, to be kept as long as this.
    Impl(std::span<const LiftedVertex> vertices, RTCGeometryType type, const void* indices, size_t count,
         bool share_indices) {
        device();  // before counting
        const int64_t held_before = held_bytes;
        const bool quads = type == RTC_GEOMETRY_TYPE_QUAD;
        const RTCFormat format = quads ? RTC_FORMAT_UINT4 : RTC_FORMAT_UINT3;
        const size_t stride = (quads ? 4 : 3) * sizeof(uint32_t);
        RTCGeometry geometry = rtcNewGeometry(device(), type);
        rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, vertices.data(), 0,
                                   sizeof(LiftedVertex), vertices.size());
        if (share_indices) {
            rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, format, indices, 0, stride, count);
        } else {
            void* own = rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, format, stride, count);
            check("index buffer");
            std::memcpy(own, indices, stride * count);
        }
        check("buffers");
        rtcSetGeometryMask(geometry, 0xffffffffu);
        // LOW builds three times as fast and traces as fast on the quads of a height field and its walls, for a
        // third more memory; true meshes want the better tree.
        const RTCBuildQuality quality = quads ? RTC_BUILD_QUALITY_LOW : RTC_BUILD_QUALITY_MEDIUM;
        rtcSetGeometryBuildQuality(geometry, quality);
        rtcCommitGeometry(geometry);
        scene = rtcNewScene(device());
        rtcSetSceneFlags(scene, RTC_SCENE_FLAG_ROBUST);
        rtcSetSceneBuildQuality(scene, quality);
        rtcAttachGeometry(scene, geometry);
        rtcReleaseGeometry(geometry);
        rtcCommitScene(scene);
        check("build");
        bytes = size_t(std::max<int64_t>(0, held_bytes - held_before));
    }
    ~Impl() { rtcReleaseScene(scene); }
    Impl(const Impl&) = delete;
    Impl& operator=(const Impl&) = delete;
};

TracedScene::TracedScene(std::span<const LiftedVertex> vertices, const std::vector<LiftedQuad>& quads) {
    if (quads.empty()) return;
    impl_ = std::make_unique<Impl>(vertices, RTC_GEOMETRY_TYPE_QUAD, quads.data(), quads.size(), true);
}

TracedScene::TracedScene(std::vector<LiftedVertex> vertices, const std::vector<std::array<uint32_t, 3>>& triangles) {
    if (triangles.empty()) return;
    impl_ = std::make_unique<Impl>(vertices, RTC_GEOMETRY_TYPE_TRIANGLE, triangles.data(), triangles.size(), false);
    impl_->own_vertices = std::move(vertices);  // keeps its place in memory
}

TracedScene::TracedScene() = default;
TracedScene::~TracedScene() = default;
TracedScene::TracedScene(TracedScene&&) noexcept = default;
TracedScene& TracedScene::operator=(TracedScene&&) noexcept = default;

size_t TracedScene::bytes() const {
    return impl_ ? impl_->bytes : 0;
}

bool TracedScene::occluded(const glm::vec3& origin, const glm::vec3& direction, float t_min, float t_max) const {
    if (!impl_ || !(t_min < t_max)) return false;
    RTCRay ray = make_ray(origin, direction, t_min, t_max);
#if RTC_VERSION_MAJOR >= 4
    rtcOccluded1(impl_->scene, &ray, nullptr);
#else
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    rtcOccluded1(impl_->scene, &context, &ray);
#endif
    return ray.tfar < 0;
}

namespace {

#if RTC_VERSION_MAJOR >= 4
using QueryContext = RTCRayQueryContext;
#else
using QueryContext = RTCIntersectContext;
#endif

/// Casts a packet's rays; those that met anything then end below 0. Returns which were cast. `context`: null or the
/// caller's own.
uint32_t cast_packet(RTCScene scene, const RayPacket& rays, uint32_t asked, QueryContext* context, RTCRay8& ray) {
    constexpr int n = RayPacket::size;
    alignas(32) int valid[n];
    for (int i = 0; i < n; ++i) {
        if (!(rays.t_min[i] < rays.t_max[i])) asked &= ~(1u << i);
        valid[i] = asked >> i & 1 ? -1 : 0;
        ray.time[i] = 0, ray.mask[i] = 0xffffffffu, ray.id[i] = uint32_t(i), ray.flags[i] = 0;
    }
    if (!asked) return 0;
    float* const vectors[8] = {ray.org_x, ray.org_y, ray.org_z, ray.dir_x, ray.dir_y, ray.dir_z, ray.tnear, ray.tfar};
    const float* const from[8] = {rays.origin[0],    rays.origin[1],    rays.origin[2], rays.direction[0],
                                  rays.direction[1], rays.direction[2], rays.t_min,     rays.t_max};
    for (int k = 0; k < 8; ++k) std::copy_n(from[k], n, vectors[k]);
#if RTC_VERSION_MAJOR >= 4
    RTCOccludedArguments arguments;
    rtcInitOccludedArguments(&arguments);
    arguments.flags = RTC_RAY_QUERY_FLAG_COHERENT;
    arguments.context = context;
    rtcOccluded8(valid, scene, &ray, &arguments);
#else
    RTCIntersectContext own;
    if (!context) rtcInitIntersectContext(context = &own);
    context->flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
    rtcOccluded8(valid, scene, context, &ray);
#endif
    return asked;
}

}  // namespace

uint32_t TracedScene::occluded(const RayPacket& rays, uint32_t asked) const {
    if (!impl_) return 0;
    constexpr int n = RayPacket::size;
    RTCRay8 ray;
    asked = cast_packet(impl_->scene, rays, asked, nullptr, ray);
    if (!asked) return 0;
    uint32_t met = 0;
    for (int i = 0; i < n; ++i) met |= uint32_t(ray.tfar[i] < 0) << i;
    return met & asked;
}

Hit TracedScene::intersect(const glm::vec3& origin, const glm::vec3& direction, float t_min, float t_max) const {
    if (!impl_ || !(t_min < t_max)) return {};
    RTCRayHit rayhit;
    rayhit.ray = make_ray(origin, direction, t_min, t_max);
    rayhit.hit.geomID = RTC_INVALID_GEOMETRY_ID;
    rayhit.hit.primID = RTC_INVALID_GEOMETRY_ID;
    rayhit.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
#if RTC_VERSION_MAJOR >= 4
    rtcIntersect1(impl_->scene, &rayhit, nullptr);
#else
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    rtcIntersect1(impl_->scene, &context, &rayhit);
#endif
    if (rayhit.hit.geomID == RTC_INVALID_GEOMETRY_ID) return {};
    return {rayhit.ray.tfar, rayhit.hit.primID, {rayhit.hit.Ng_x, rayhit.hit.Ng_y, rayhit.hit.Ng_z}};
}

struct TracedBoxes::Impl {
    RTCScene scene = nullptr;
    size_t bytes = 0;
    ~Impl() { rtcReleaseScene(scene); }
};

TracedBoxes::TracedBoxes() = default;
TracedBoxes::~TracedBoxes() = default;
TracedBoxes::TracedBoxes(TracedBoxes&&) noexcept = default;
TracedBoxes& TracedBoxes::operator=(TracedBoxes&&) noexcept = default;

namespace {

/// One packet's query; Embree hands its context to the callback.
struct BoxQuery {
    QueryContext context;
    void* test;
    uint32_t (*call)(void*, uint32_t, uint32_t);
};

void bounds_of_box(const RTCBoundsFunctionArguments* of) {
    const auto& box = static_cast<const TracedBoxes::Box*>(of->geometryUserPtr)[of->primID];
    RTCBounds& out = *of->bounds_o;
    out.lower_x = box.low.x, out.lower_y = box.low.y, out.lower_z = box.low.z;
    out.upper_x = box.high.x, out.upper_y = box.high.y, out.upper_z = box.high.z;
}

void test_box(const RTCOccludedFunctionNArguments* at) {
    uint32_t passing = 0;
    for (uint32_t i = 0; i < at->N; ++i)
        if (at->valid[i]) passing |= 1u << RTCRayN_id(at->ray, at->N, i);
    if (!passing) return;
    const auto* query = reinterpret_cast<const BoxQuery*>(at->context);
    const uint32_t done = query->call(query->test, at->primID, passing);
    if (!done) return;
    for (uint32_t i = 0; i < at->N; ++i)
        if (at->valid[i] && done >> RTCRayN_id(at->ray, at->N, i) & 1)
            RTCRayN_tfar(at->ray, at->N, i) = -std::numeric_limits<float>::infinity();
}

}  // namespace

TracedBoxes::TracedBoxes(std::span<const Box> boxes) {
    if (boxes.empty()) return;
    device();
    const int64_t held_before = held_bytes;
    impl_ = std::make_unique<Impl>();
    RTCGeometry geometry = rtcNewGeometry(device(), RTC_GEOMETRY_TYPE_USER);
    rtcSetGeometryUserPrimitiveCount(geometry, unsigned(boxes.size()));
    rtcSetGeometryUserData(geometry, const_cast<Box*>(boxes.data()));  // asked for only while it is built
    rtcSetGeometryBoundsFunction(geometry, bounds_of_box, nullptr);
    rtcSetGeometryOccludedFunction(geometry, test_box);
    rtcSetGeometryMask(geometry, 0xffffffffu);
    rtcCommitGeometry(geometry);
    impl_->scene = rtcNewScene(device());
    rtcSetSceneFlags(impl_->scene, RTC_SCENE_FLAG_ROBUST);
    rtcSetSceneBuildQuality(impl_->scene, RTC_BUILD_QUALITY_MEDIUM);
    rtcAttachGeometry(impl_->scene, geometry);
    rtcReleaseGeometry(geometry);
    rtcCommitScene(impl_->scene);
    check("build");
    impl_->bytes = size_t(std::max<int64_t>(0, held_bytes - held_before));
}

size_t TracedBoxes::bytes() const {
    return impl_ ? impl_->bytes : 0;
}

void TracedBoxes::visit(const RayPacket& rays, uint32_t asked, void* test, Call call) const {
    if (!impl_) return;
    BoxQuery query;
#if RTC_VERSION_MAJOR >= 4
    rtcInitRayQueryContext(&query.context);
#else
    rtcInitIntersectContext(&query.context);
#endif
    query.test = test, query.call = call;
    RTCRay8 ray;
    cast_packet(impl_->scene, rays, asked, &query.context, ray);
}

std::string tracer_version() {
    const auto part = [](RTCDeviceProperty p) { return std::to_string(rtcGetDeviceProperty(device(), p)); };
    return "Embree " + part(RTC_DEVICE_PROPERTY_VERSION_MAJOR) + "." + part(RTC_DEVICE_PROPERTY_VERSION_MINOR) + "." +
           part(RTC_DEVICE_PROPERTY_VERSION_PATCH);
}

bool tracer_self_test() {
    const std::vector<LiftedVertex> corners = {{-1, -1, 2, 0}, {1, -1, 2, 0}, {1, 1, 2, 0}, {-1, 1, 2, 0}};
    const std::vector<LiftedQuad> quads = {{0, 1, 2, 3}};
    const TracedScene scene(corners, quads);
    const Hit hit = scene.intersect({0.25f, -0.5f, 0}, {0, 0, 1}, 0, 10);
    return hit && hit.t > 1.9999f && hit.t < 2.0001f && scene.occluded({0, 0, 0}, {0, 0, 1}, 0, 10) &&
           !scene.occluded({3, 0, 0}, {0, 0, 1}, 0, 10) && !scene.occluded({0, 0, 0}, {0, 0, -1}, 0, 10);
}

}  // namespace vshift
