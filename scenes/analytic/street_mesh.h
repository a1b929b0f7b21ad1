// SPDX-License-Identifier: Apache-2.0
// Role: the shapes that an analytic street is made of, and its random numbers. Internal to scenes/analytic.
#pragma once
#include <random>

#include "scenes/analytic/analytic_street.h"

namespace vshift::analytic {

/// Numbers that are the same everywhere (the engine's are; distributions' are not). One stream per sort of
/// thing, so that leaving out one sort moves nothing else.
class Stream {
public:
    Stream(uint32_t seed, uint32_t sort) : engine_(seed * 2654435761u ^ (sort * 40503u + 977u)) { engine_.discard(16); }
    double within(double a, double b) { return a + (b - a) * (engine_() / 4294967296.0); }
    int whole(int a, int b) { return a + int(engine_() % uint32_t(b - a + 1)); }  ///< a ... b
    bool chance(double p) { return within(0, 1) < p; }
    template <class T, size_t N>
    const T& pick(const std::array<T, N>& of) {
        return of[size_t(whole(0, int(N) - 1))];
    }

private:
    std::mt19937 engine_;
};

/// Where a thing stands: local x, y, z turned about z and moved.
struct Place {
    glm::dvec3 origin{0.0};
    double yaw_rad = 0;

    glm::dvec3 world(const glm::dvec3& p) const;
};

/// Adds shapes to a street. A shape belongs to the thing begun last.
class MeshBuilder {
public:
    explicit MeshBuilder(AnalyticStreet& street) : street_(street) {}

    void begin(const Place& place) {
        place_ = place;
        ++street_.things;
    }
    /// Six faces; the top may have its own albedo.
    void box(Kind kind, const glm::dvec3& lo, const glm::dvec3& hi, const glm::vec3& albedo,
             const glm::vec3* top = nullptr);
    /// A box of kind `box` whose upright faces bear panes: along x `panes`, along y one. Only the colour differs.
    void glazed_box(const glm::dvec3& lo, const glm::dvec3& hi, const glm::vec3& albedo, const glm::vec3& pane,
                    int panes);
    /// A prism with `sides` corners on the circle of `radius`, and flat ends.
    void prism(Kind kind, const glm::dvec3& from, const glm::dvec3& to, double radius, const glm::vec3& albedo,
               int sides = 24, bool counted = true);
    /// A round sphere to within `error_m`, by subdividing an icosahedron.
    void sphere(Kind kind, const glm::dvec3& centre, double radius, const glm::vec3& albedo, double error_m);
    /// A front at local y = 0 that faces -y, cut at x and z; where `recess_m` is not 0 the cell lies back by as
    /// much and has `inner` albedo; cells one above the other that lie equally deep are one opening. Sides, roof and
    /// back complete the block to y = depth.
    void block(const std::vector<double>& x, const std::vector<double>& z, double depth,
               const std::vector<double>& recess_m, const glm::vec3& wall, const std::vector<glm::vec3>& inner);
    /// A gable roof over [0, width] x [0, depth], ridge along x.
    void gable(double width, double depth, double z0, double rise, const glm::vec3& roof, const glm::vec3& wall);
    void quad(Kind kind, const glm::dvec3& a, const glm::dvec3& b, const glm::dvec3& c, const glm::dvec3& d,
              const glm::vec3& albedo);
    void count(Kind kind) { ++street_.shapes[size_t(kind)]; }
    uint32_t counted(Kind kind) const { return street_.shapes[size_t(kind)]; }

private:
    uint32_t vertex(const glm::dvec3& local);
    void triangle(Kind kind, uint32_t a, uint32_t b, uint32_t c, const glm::vec3& albedo);

    AnalyticStreet& street_;
    Place place_;
};

// The street's fixed lines, metres.
inline constexpr double kerb_y = 7.6, kerb_z = 0.12, front_y = 12.2;
inline constexpr double street_from_x = -104, street_to_x = 150, sunk_m = 0.03;
/// Where the ego and its shifted cameras pass: nothing in it.
inline constexpr double free_from_x = -8, free_to_x = 48;

/// Where the scaffold on one side (1 left, -1 right) may stand: no balconies there.
inline constexpr double scaffold_m = 8.8;
double scaffold_from_x(uint32_t seed, int side);

void add_ground(MeshBuilder& mesh);
void add_buildings(MeshBuilder& mesh, uint32_t seed);
/// Everything that stands before the houses.
void add_furniture(MeshBuilder& mesh, uint32_t seed, const StreetOptions& options);

}  // namespace vshift::analytic
