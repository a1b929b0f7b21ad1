// SPDX-License-Identifier: Apache-2.0
// Role: rays against meshes. trace.cpp is the only file that includes Embree (3 or 4).
// Scenes are built robust: no ray slips between two primitives that share an edge.
#pragma once
#include <array>
#include <cstdint>
#include <glm/glm.hpp>
#include <memory>
#include <span>
#include <string>
#include <type_traits>

#include "embree_core/lift.h"

namespace vshift {

inline constexpr uint32_t no_primitive = 0xffffffffu;

struct Hit {
    float t = 0;
    uint32_t primitive = no_primitive;
    glm::vec3 normal{0};  ///< geometric, not normalised
    explicit operator bool() const { return primitive != no_primitive; }
};

/// Rays that are cast together; those side by side go fastest.
struct RayPacket {
    static constexpr int size = 8;
    alignas(32) float origin[3][size]{}, direction[3][size]{}, t_min[size]{}, t_max[size]{};

    void set(int i, const glm::vec3& o, const glm::vec3& d, float from, float to) {
        for (int k = 0; k < 3; ++k) origin[k][i] = o[k], direction[k][i] = d[k];
        t_min[i] = from, t_max[i] = to;
    }
};

/// A built, immutable scene: safe to use from any number of threads.
class TracedScene {
public:
    TracedScene();  ///< nothing in it: every ray misses
    /// Both are used where they lie: they must stay there as long as the scene (a vector may be moved).
    /// Quads that repeat their last corner are triangles.
    TracedScene(std::span<const LiftedVertex> vertices, const std::vector<LiftedQuad>& quads);
    /// Copies what it needs.
    TracedScene(std::vector<LiftedVertex> vertices, const std::vector<std::array<uint32_t, 3>>& triangles);
    ~TracedScene();
    TracedScene(TracedScene&&) noexcept;
    TracedScene& operator=(TracedScene&&) noexcept;

    /// What Embree holds for it beside the mesh. Counted while it was built, so exact only when nothing
    /// else was built meanwhile.
    size_t bytes() const;

    /// Anything on origin + t direction, t_min <= t <= t_max? Not for NaN input.
    bool occluded(const glm::vec3& origin, const glm::vec3& direction, float t_min, float t_max) const;
    /// The same of a packet's rays: those of bit mask `asked` that meet anything.
    uint32_t occluded(const RayPacket& rays, uint32_t asked) const;
    /// The nearest such hit.
    Hit intersect(const glm::vec3& origin, const glm::vec3& direction, float t_min, float t_max) const;
    /// Calls `found(t)` for every hit on the way, nearest first (at most 256).
    template <class Found>
    void crossings(const glm::vec3& origin, const glm::vec3& direction, double t_min, double t_max,
                   Found&& found) const {
        for (int count = 0; count < 256; ++count) {
            const Hit hit = intersect(origin, direction, float(t_min), float(t_max));
            if (!hit) return;
            found(double(hit.t));
            t_min = double(hit.t) * (1 + 1e-6) + 1e-9;
        }
    }

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

/// Boxes that rays pass; what is in them the caller tests. Safe to use from any number of threads.
class TracedBoxes {
public:
    struct Box {
        glm::vec3 low, high;
    };
    TracedBoxes();  ///< none
    explicit TracedBoxes(std::span<const Box> boxes);
    ~TracedBoxes();
    TracedBoxes(TracedBoxes&&) noexcept;
    TracedBoxes& operator=(TracedBoxes&&) noexcept;

    size_t bytes() const;  ///< as of a TracedScene

    /// Calls `test(box, rays)` for boxes that rays of bit mask `asked` may pass, in any order; it returns those that
    /// need go no further.
    template <class Test>
    void visit(const RayPacket& rays, uint32_t asked, Test&& test) const {
        visit(rays, asked, const_cast<void*>(static_cast<const void*>(&test)),
              [](void* own, uint32_t box, uint32_t passing) -> uint32_t {
                  return (*static_cast<std::remove_reference_t<Test>*>(own))(box, passing);
              });
    }

private:
    using Call = uint32_t (*)(void* test, uint32_t box, uint32_t rays);
    void visit(const RayPacket& rays, uint32_t asked, void* test, Call call) const;
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

/// "Embree 3.13.5"
std::string tracer_version();

/// Casts known rays at a known quad; false when another library answers for ours.
bool tracer_self_test();

}  // namespace vshift
