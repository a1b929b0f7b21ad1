// SPDX-License-Identifier: Apache-2.0
// Peers, in our own short rendering of the published methods; named as such wherever they are shown.
#include <tbb/parallel_for.h>

#include <atomic>
#include <cmath>
#include <limits>
#include <memory>

#include "benchmark/engine/methods.h"

namespace vshift::bench {
namespace {

constexpr float endless = std::numeric_limits<float>::infinity();

/// V's image position and depth of a recorded pixel: A (x, y, 1) z + b, in V's pixels.
struct Reprojection {
    glm::mat3 a;
    glm::vec3 b;
    int width, height;

    explicit Reprojection(const Job& job) {
        const Intrinsics &k = job.recorded.intrinsics, &v = job.shifted.intrinsics;
        const Pose v_from_r = compose(inverse(job.shifted.world_from_cam), job.recorded.world_from_cam);
        const glm::dmat3 ray_of(1 / k.fx, 0, 0, 0, 1 / k.fy, 0, -k.cx / k.fx, -k.cy / k.fy, 1);
        const glm::dmat3 pixel_of(v.fx, 0, 0, 0, v.fy, 0, v.cx, v.cy, 1);
        a = glm::mat3(pixel_of * v_from_r.rotation * ray_of);
        b = glm::vec3(pixel_of * v_from_r.translation_m);
        width = v.width, height = v.height;
    }

    struct Place {
        int32_t index = -1;  ///< of V's pixel; -1: outside
        float depth = 0;     ///< in V; infinite for the sky
    };
    Place place(int x, int y, float depth_m) const {
        const glm::vec3 direction = a * glm::vec3(float(x) + 0.5f, float(y) + 0.5f, 1.0f);
        const bool sky = is_sky(depth_m);
        const glm::vec3 p = sky ? direction : direction * depth_m + b;
        if (!(p.z > 0)) return {};
        const float u = p.x / p.z, v = p.y / p.z;
        if (!(u >= 0 && v >= 0 && u < float(width) && v < float(height))) return {};
        return {int32_t(v) * width + int32_t(u), sky ? endless : p.z};
    }
};

uint8_t tested(const Reprojection::Place& place, float nearest, float bias) {
    if (place.index < 0) return outside_bit;
    return place.depth > nearest * (1 + bias) ? uint8_t(occluded_bit) : uint8_t(0);
}

/// Points of `side` x `side` pixels into V's z-buffer; a pixel is occluded when its own point lost there by
/// more than the bias.
Method splat(const std::string& name, const std::string& label, int side, float bias) {
    Method m{name, label, "peer", "our own short rendering", false, true, {}};
    auto buffer = std::make_shared<std::vector<std::atomic<float>>>();
    auto places = std::make_shared<std::vector<Reprojection::Place>>();
    m.run = [=](const Job& job, Result& out) {
        const DepthMap& depth = *job.depth;
        const Reprojection to(job);
        if (buffer->size() != size_t(to.width) * size_t(to.height))
            *buffer = std::vector<std::atomic<float>>(size_t(to.width) * size_t(to.height));
        places->resize(depth.size());
        if (out.classes.size() != depth.size()) out.classes = Grid<uint8_t>(depth.width, depth.height);
        tbb::parallel_for(size_t(0), size_t(to.height), [&](size_t y) {
            for (size_t i = y * size_t(to.width); i < (y + 1) * size_t(to.width); ++i)
                (*buffer)[i].store(endless, std::memory_order_relaxed);
        });
        const auto put = [&](size_t i, float z) {
            std::atomic<float>& nearest = (*buffer)[i];
            float held = nearest.load(std::memory_order_relaxed);
            while (z < held && !nearest.compare_exchange_weak(held, z, std::memory_order_relaxed)) continue;
        };
        const int reach = side / 2;
        tbb::parallel_for(0, depth.height, [&](int y) {
            for (int x = 0; x < depth.width; ++x) {
                const size_t i = size_t(y) * size_t(depth.width) + size_t(x);
                const auto p = to.place(x, y, depth.data[i]);
                (*places)[i] = p;
                if (p.index < 0 || p.depth == endless) continue;
                const int u = p.index % to.width, v = p.index / to.width;
                for (int dv = std::max(v - reach, 0); dv <= std::min(v + reach, to.height - 1); ++dv)
                    for (int du = std::max(u - reach, 0); du <= std::min(u + reach, to.width - 1); ++du)
                        put(size_t(dv) * size_t(to.width) + size_t(du), p.depth);
            }
        });
        tbb::parallel_for(0, depth.height, [&](int y) {
            for (size_t i = size_t(y) * size_t(depth.width); i < size_t(y + 1) * size_t(depth.width); ++i) {
                const auto& p = (*places)[i];
                const float nearest =
                    p.index < 0 ? endless : (*buffer)[size_t(p.index)].load(std::memory_order_relaxed);
                out.classes.data[i] = tested(p, nearest, bias);
            }
        });
    };
    return m;
}

/// Given what V truly sees, which no recording has.
Method true_depth_test() {
    Method m{"ztest_true",
             "z-test of V's true depth",
             "peer",
             "given the true depth of the shifted view, which no recording has; that render is not timed; bias 2 %",
             false,
             false,
             {}};
    m.run = [](const Job& job, Result& out) {
        const DepthMap& depth = *job.depth;
        const Reprojection to(job);
        if (out.classes.size() != depth.size()) out.classes = Grid<uint8_t>(depth.width, depth.height);
        tbb::parallel_for(0, depth.height, [&](int y) {
            for (int x = 0; x < depth.width; ++x) {
                const auto p = to.place(x, y, depth.at(x, y));
                out.classes.at(x, y) =
                    tested(p, p.index < 0 ? endless : job.shifted_depth->data[size_t(p.index)], 0.02f);
            }
        });
    };
    return m;
}

struct Triangle {
    glm::vec3 a, ab, ac;
};

/// Two triangles per four pixels, but for cells whose depths differ by more than a tenth.
std::vector<Triangle> triangles_of(const Intrinsics& k, const DepthMap& depth) {
    std::vector<Triangle> out;
    for (int y = 0; y + 1 < depth.height; ++y)
        for (int x = 0; x + 1 < depth.width; ++x) {
            glm::vec3 p[4];
            float least = endless, most = 0;
            for (int i = 0; i < 4; ++i) {
                const int cx = x + i % 2, cy = y + i / 2;
                const float z = depth.at(cx, cy);
                least = std::min(least, z), most = std::max(most, z);
                p[i] = glm::vec3(ray(k, {cx + 0.5, cy + 0.5})) * z;
            }
            if (!(most < 1.1f * least)) continue;
            out.push_back({p[0], p[1] - p[0], p[2] - p[0]});
            out.push_back({p[3], p[2] - p[3], p[1] - p[3]});
        }
    return out;
}

/// Where on origin + t direction, 1e-4 < t < end? (Moeller and Trumbore)
bool meets(const Triangle& triangle, const glm::vec3& origin, const glm::vec3& direction, float end) {
    const glm::vec3 n = glm::cross(direction, triangle.ac);
    const float inverse = 1.0f / glm::dot(triangle.ab, n);
    const glm::vec3 s = origin - triangle.a, q = glm::cross(s, triangle.ab);
    const float u = glm::dot(s, n) * inverse, v = glm::dot(direction, q) * inverse;
    const float t = glm::dot(triangle.ac, q) * inverse;
    return (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 1e-4f) & (t < end);
}

}  // namespace

std::vector<Method> peer_methods() {
    return {splat("splat_1", "point splat, 1 px, 2 %", 1, 0.02f), splat("splat_3", "point splat, 3x3, 5 %", 3, 0.05f),
            true_depth_test()};
}

Method copy_loop() {
    Method m{"copy", "read depth, write mask", "bound", "no method can do with less", false, false, {}};
    m.run = [](const Job& job, Result& out) {
        const DepthMap& depth = *job.depth;
        if (out.classes.size() != depth.size()) out.classes = Grid<uint8_t>(depth.width, depth.height);
        tbb::parallel_for(0, depth.height, [&](int y) {
            const int width = depth.width;  // a byte written may be anything's: kept apart, the loop is vectorised
            const float* __restrict from = &depth.data[size_t(y) * size_t(width)];
            uint8_t* __restrict to = &out.classes.data[size_t(y) * size_t(width)];
            for (int x = 0; x < width; ++x) to[x] = from[x] > 1e12f;
        });
    };
    return m;
}

Method brute_force() {
    Method m{"brute_force",
             "every triangle for every ray",
             "peer",
             "our own short rendering, as in GEN3C; run at 80x45, its time extrapolated by rays x triangles",
             false,
             false,
             {}};
    m.run = [](const Job& job, Result& out) {
        const DepthMap& depth = *job.depth;
        const Intrinsics& k = job.recorded.intrinsics;
        const std::vector<Triangle> triangles = triangles_of(k, depth);
        out.triangles = triangles.size();
        const glm::vec3 centre(inverse(job.recorded.world_from_cam).point(job.shifted.world_from_cam.translation_m));
        const Reprojection to(job);
        out.classes = Grid<uint8_t>(depth.width, depth.height);
        tbb::parallel_for(0, depth.height, [&](int y) {
            for (int x = 0; x < depth.width; ++x) {
                const float z = depth.at(x, y);
                const glm::vec3 r(ray(k, {x + 0.5, y + 0.5}));
                const bool sky = is_sky(z);
                const glm::vec3 origin = sky ? centre : r * z, direction = sky ? r : centre - r * z;
                bool hit = false;
                for (const Triangle& t : triangles) hit |= meets(t, origin, direction, sky ? 1e6f : 1 - 1e-4f);
                out.classes.at(x, y) =
                    uint8_t((hit ? occluded_bit : 0) | (to.place(x, y, z).index < 0 ? outside_bit : 0));
            }
        });
    };
    return m;
}

}  // namespace vshift::bench
