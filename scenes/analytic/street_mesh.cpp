// SPDX-License-Identifier: Apache-2.0
#include "scenes/analytic/street_mesh.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <tuple>

namespace vshift::analytic {
namespace {

using glm::dvec3;

struct UnitSphere {
    std::vector<dvec3> vertices;
    std::vector<std::array<uint32_t, 3>> triangles;
    double sag = 0;  ///< largest depth of a face below the unit sphere
};

/// An icosahedron with every edge cut into n parts, on the unit sphere.
UnitSphere make_unit_sphere(int n) {
    const double g = (1 + std::sqrt(5.0)) / 2;
    const dvec3 corner[12] = {{-1, g, 0},  {1, g, 0},  {-1, -g, 0}, {1, -g, 0}, {0, -1, g},  {0, 1, g},
                              {0, -1, -g}, {0, 1, -g}, {g, 0, -1},  {g, 0, 1},  {-g, 0, -1}, {-g, 0, 1}};
    const int face[20][3] = {{0, 11, 5},  {0, 5, 1},  {0, 1, 7},  {0, 7, 10}, {0, 10, 11}, {1, 5, 9}, {5, 11, 4},
                             {11, 10, 2}, {10, 7, 6}, {7, 1, 8},  {3, 9, 4},  {3, 4, 2},   {3, 2, 6}, {3, 6, 8},
                             {3, 8, 9},   {4, 9, 5},  {2, 4, 11}, {6, 2, 10}, {8, 6, 7},   {9, 8, 1}};
    UnitSphere s;
    std::map<std::tuple<double, double, double>, uint32_t> known;
    for (const auto& f : face) {
        // On an edge two weights are not 0, so both of its faces get the same sum, bit for bit.
        const auto at = [&](int i, int j) {
            const dvec3 p =
                glm::normalize(double(n - i - j) * corner[f[0]] + double(i) * corner[f[1]] + double(j) * corner[f[2]]);
            const auto [place, fresh] = known.try_emplace({p.x, p.y, p.z}, uint32_t(s.vertices.size()));
            if (fresh) s.vertices.push_back(p);
            return place->second;
        };
        for (int i = 0; i < n; ++i)
            for (int j = 0; i + j < n; ++j) {
                s.triangles.push_back({at(i, j), at(i + 1, j), at(i, j + 1)});
                if (i + j + 1 < n) s.triangles.push_back({at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)});
            }
    }
    for (const auto& t : s.triangles) {
        const dvec3 &a = s.vertices[t[0]], &b = s.vertices[t[1]], &c = s.vertices[t[2]];
        s.sag = std::max(s.sag, 1 - std::abs(glm::dot(a, glm::normalize(glm::cross(b - a, c - a)))));
    }
    return s;
}

const UnitSphere& unit_sphere(int n) {
    static thread_local std::map<int, UnitSphere> made;
    const auto found = made.find(n);
    return found != made.end() ? found->second : made.emplace(n, make_unit_sphere(n)).first->second;
}

}  // namespace

dvec3 Place::world(const dvec3& p) const {
    const double c = std::cos(yaw_rad), s = std::sin(yaw_rad);
    return origin + dvec3(c * p.x - s * p.y, s * p.x + c * p.y, p.z);
}

uint32_t MeshBuilder::vertex(const dvec3& local) {
    const dvec3 p = place_.world(local);
    street_.vertices.push_back({float(p.x), float(p.y), float(p.z), 0});
    return uint32_t(street_.vertices.size() - 1);
}

void MeshBuilder::triangle(Kind kind, uint32_t a, uint32_t b, uint32_t c, const glm::vec3& albedo) {
    street_.triangles.push_back({a, b, c});
    street_.kind.push_back(uint8_t(kind));
    street_.thing.push_back(street_.things - 1);
    street_.albedo.push_back(albedo);
}

void MeshBuilder::quad(Kind kind, const dvec3& a, const dvec3& b, const dvec3& c, const dvec3& d,
                       const glm::vec3& albedo) {
    const uint32_t i = vertex(a);
    vertex(b), vertex(c), vertex(d);
    triangle(kind, i, i + 1, i + 2, albedo);
    triangle(kind, i, i + 2, i + 3, albedo);
}

void MeshBuilder::box(Kind kind, const dvec3& lo, const dvec3& hi, const glm::vec3& albedo, const glm::vec3* top) {
    const uint32_t first = uint32_t(street_.vertices.size());
    for (int i = 0; i < 8; ++i) vertex({i & 1 ? hi.x : lo.x, i & 2 ? hi.y : lo.y, i & 4 ? hi.z : lo.z});
    static const uint32_t face[6][4] = {{4, 5, 7, 6}, {0, 2, 3, 1}, {0, 1, 5, 4},
                                        {2, 6, 7, 3}, {0, 4, 6, 2}, {1, 3, 7, 5}};  // the top first
    for (int f = 0; f < 6; ++f) {
        const uint32_t* q = face[f];
        const glm::vec3& color = f == 0 && top ? *top : albedo;
        triangle(kind, first + q[0], first + q[1], first + q[2], color);
        triangle(kind, first + q[0], first + q[2], first + q[3], color);
    }
    count(kind);
}

void MeshBuilder::glazed_box(const dvec3& lo, const dvec3& hi, const glm::vec3& albedo, const glm::vec3& pane,
                             int panes) {
    const double pillar = 0.09, low = lo.z + 0.06, high = hi.z - 0.09;
    const auto cuts = [&](double from, double to, int n) {
        std::vector<double> at = {from};
        const double wide = (to - from - (n + 1) * pillar) / n;
        for (int i = 0; i < n; ++i) {
            at.push_back(from + pillar + i * (wide + pillar));
            at.push_back(at.back() + wide);
        }
        at.push_back(to);
        return at;
    };
    const double z[4] = {lo.z, low, high, hi.z};
    const auto wall = [&](const std::vector<double>& u, auto&& at) {  // u to the right as seen from outside
        for (size_t i = 0; i + 1 < u.size(); ++i)
            for (int j = 0; j < 3; ++j)
                quad(Kind::box, at(u[i], z[j]), at(u[i + 1], z[j]), at(u[i + 1], z[j + 1]), at(u[i], z[j + 1]),
                     j == 1 && i % 2 == 1 ? pane : albedo);
    };
    const std::vector<double> x = cuts(lo.x, hi.x, panes), y = cuts(lo.y, hi.y, 1);
    const std::vector<double> x_back(x.rbegin(), x.rend()), y_back(y.rbegin(), y.rend());
    wall(x, [&](double u, double v) { return dvec3(u, lo.y, v); });
    wall(y, [&](double u, double v) { return dvec3(hi.x, u, v); });
    wall(x_back, [&](double u, double v) { return dvec3(u, hi.y, v); });
    wall(y_back, [&](double u, double v) { return dvec3(lo.x, u, v); });
    for (size_t i = 0; i + 1 < x.size(); ++i)  // the same cuts above and below
        for (const bool top : {true, false}) {
            const dvec3 a(x[i], lo.y, top ? hi.z : lo.z), b(x[i + 1], lo.y, a.z);
            const dvec3 c(x[i + 1], hi.y, a.z), d(x[i], hi.y, a.z);
            top ? quad(Kind::box, a, b, c, d, albedo) : quad(Kind::box, a, d, c, b, albedo);
        }
    count(Kind::box);
}

void MeshBuilder::prism(Kind kind, const dvec3& from, const dvec3& to, double radius, const glm::vec3& albedo,
                        int sides, bool counted) {
    const dvec3 w = glm::normalize(to - from);
    const dvec3 u = glm::normalize(glm::cross(std::abs(w.z) > 0.9 ? dvec3(0, 1, 0) : dvec3(0, 0, 1), w));
    const dvec3 v = glm::cross(w, u);
    const uint32_t low = vertex(from), high = vertex(to);
    for (int i = 0; i < sides; ++i) {
        const double a = 2 * std::acos(-1.0) * i / sides;
        const dvec3 out = radius * (std::cos(a) * u + std::sin(a) * v);
        vertex(from + out);
        vertex(to + out);
    }
    for (int i = 0; i < sides; ++i) {
        const uint32_t a = low + 2 + 2 * uint32_t(i), b = low + 2 + 2 * uint32_t((i + 1) % sides);
        triangle(kind, a, b, b + 1, albedo);
        triangle(kind, a, b + 1, a + 1, albedo);
        triangle(kind, low, b, a, albedo);
        triangle(kind, high, a + 1, b + 1, albedo);
    }
    if (counted) count(kind);
}

void MeshBuilder::sphere(Kind kind, const dvec3& centre, double radius, const glm::vec3& albedo, double error_m) {
    int n = 2;
    while (n < 64 && radius * unit_sphere(n).sag >= error_m) ++n;
    const UnitSphere& s = unit_sphere(n);
    const uint32_t first = uint32_t(street_.vertices.size());
    for (const dvec3& p : s.vertices) vertex(centre + radius * p);
    for (const auto& t : s.triangles) triangle(kind, first + t[0], first + t[1], first + t[2], albedo);
    count(kind);
}

void MeshBuilder::block(const std::vector<double>& x, const std::vector<double>& z, double depth,
                        const std::vector<double>& recess_m, const glm::vec3& wall,
                        const std::vector<glm::vec3>& inner) {
    const size_t nx = x.size(), nz = z.size();
    const uint32_t first = uint32_t(street_.vertices.size());
    for (size_t j = 0; j < nz; ++j)
        for (size_t i = 0; i < nx; ++i) vertex({x[i], 0, z[j]});
    const auto at = [&](size_t i, size_t j) { return first + uint32_t(j * nx + i); };
    const auto two = [&](uint32_t a, uint32_t b, uint32_t c, uint32_t d, const glm::vec3& color) {
        triangle(Kind::building, a, b, c, color);
        triangle(Kind::building, a, c, d, color);
    };
    for (size_t j = 0; j + 1 < nz; ++j)
        for (size_t i = 0; i + 1 < nx; ++i) {
            const uint32_t a = at(i, j), b = at(i + 1, j), c = at(i + 1, j + 1), d = at(i, j + 1);
            const size_t cell = j * (nx - 1) + i;
            if (recess_m[cell] == 0) {
                two(a, b, c, d, wall);
                continue;
            }
            const double y = recess_m[cell];
            const uint32_t e = vertex({x[i], y, z[j]}), f = vertex({x[i + 1], y, z[j]});
            const uint32_t g = vertex({x[i + 1], y, z[j + 1]}), h = vertex({x[i], y, z[j + 1]});
            const glm::vec3 reveal = glm::min(wall * 1.15f, glm::vec3(0.85f));
            two(e, f, g, h, inner[cell]);
            const auto open = [&](size_t other) { return recess_m[other] == y; };  // one opening of two cells
            if (j == 0 || !open(cell - (nx - 1))) two(a, b, f, e, reveal);
            if (j + 2 == nz || !open(cell + (nx - 1))) two(c, d, h, g, reveal);
            two(b, c, g, f, reveal);
            two(d, a, e, h, reveal);
        }
    std::vector<uint32_t> left, right, top;  // the same cuts behind, so that the corners are watertight
    for (double h : z) left.push_back(vertex({x.front(), depth, h})), right.push_back(vertex({x.back(), depth, h}));
    for (double w : x) top.push_back(vertex({w, depth, z.back()}));
    for (size_t j = 0; j + 1 < nz; ++j) {
        two(left[j], at(0, j), at(0, j + 1), left[j + 1], wall * 0.9f);
        two(at(nx - 1, j), right[j], right[j + 1], at(nx - 1, j + 1), wall * 0.9f);
    }
    for (size_t i = 0; i + 1 < nx; ++i) two(at(i, nz - 1), at(i + 1, nz - 1), top[i + 1], top[i], glm::vec3(0.22f));
    two(right.front(), left.front(), left.back(), right.back(), wall * 0.9f);
    count(Kind::building);
}

void MeshBuilder::gable(double width, double depth, double z0, double rise, const glm::vec3& roof,
                        const glm::vec3& wall) {
    const double over = 0.35;  // eaves
    const double drop = over * rise / (depth / 2);
    const uint32_t a = vertex({0, -over, z0 - drop}), b = vertex({width, -over, z0 - drop});
    const uint32_t c = vertex({width, depth + over, z0 - drop}), d = vertex({0, depth + over, z0 - drop});
    const uint32_t e = vertex({0, depth / 2, z0 + rise}), f = vertex({width, depth / 2, z0 + rise});
    const auto face = [&](uint32_t p, uint32_t q, uint32_t r, const glm::vec3& color) {
        triangle(Kind::building, p, q, r, color);
    };
    face(a, b, f, roof), face(a, f, e, roof), face(c, d, e, roof), face(c, e, f, roof);
    face(b, c, f, wall), face(d, a, e, wall), face(a, d, c, wall), face(a, c, b, wall);
    count(Kind::building);
}

}  // namespace vshift::analytic
