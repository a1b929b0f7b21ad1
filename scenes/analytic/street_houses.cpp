// SPDX-License-Identifier: Apache-2.0
// Ground and houses of the analytic street.
#include <algorithm>
#include <cmath>

#include "scenes/analytic/street_mesh.h"

namespace vshift::analytic {
namespace {

using glm::dvec3;
using glm::vec3;

const double right_angle = std::acos(0.0);

const std::array<vec3, 9> wall_colors = {{{0.62f, 0.52f, 0.38f},
                                          {0.42f, 0.16f, 0.11f},
                                          {0.58f, 0.40f, 0.20f},
                                          {0.45f, 0.45f, 0.43f},
                                          {0.40f, 0.48f, 0.55f},
                                          {0.43f, 0.48f, 0.36f},
                                          {0.55f, 0.28f, 0.18f},
                                          {0.68f, 0.64f, 0.57f},
                                          {0.33f, 0.24f, 0.20f}}};

/// What one house is made of; the same numbers wherever it stands.
struct House {
    double width = 12, depth = 10;
    int floors = 4;
    bool plain = false;  ///< no shop, balconies nor ledges: seen from afar only
    bool balconies = true;
};

/// A front with `columns` windows a floor: cuts, recesses and what lies in them.
struct Front {
    std::vector<double> x, z, recess_m;
    std::vector<vec3> inner;
    double pitch_m = 2.6;
    int columns = 1;

    size_t cell(size_t column, size_t row) const { return row * (x.size() - 1) + 1 + 2 * column; }
};

/// `openings_m`: lower and upper edge of each row of windows. Rows lie between cuts 1 and 2, 3 and 4 and so on.
Front plan_front(Stream& r, double width, double window_m, double pitch_m, double z0,
                 const std::vector<std::pair<double, double>>& openings_m, double top, double recess) {
    Front f;
    f.columns = std::max(1, int((width - 0.8) / pitch_m));
    f.pitch_m = width / f.columns;
    window_m = std::min(window_m, f.pitch_m - 0.4);
    f.x = {0};
    for (int c = 0; c < f.columns; ++c) {
        f.x.push_back((c + 0.5) * f.pitch_m - window_m / 2);
        f.x.push_back((c + 0.5) * f.pitch_m + window_m / 2);
    }
    f.x.push_back(width);
    f.z = {z0};
    for (const auto& [sill, head] : openings_m) f.z.push_back(sill), f.z.push_back(head);
    f.z.push_back(top);
    const size_t cells = (f.x.size() - 1) * (f.z.size() - 1);
    f.recess_m.assign(cells, 0);
    f.inner.assign(cells, vec3(0));
    for (size_t row = 1; row + 1 < f.z.size(); row += 2)
        for (size_t c = 0; c < size_t(f.columns); ++c) {
            f.recess_m[f.cell(c, row)] = recess;
            f.inner[f.cell(c, row)] = vec3(0.05f, 0.065f, 0.08f) * float(r.within(0.7, 1.4));
            if (r.chance(0.25)) f.inner[f.cell(c, row)] = vec3(0.35f, 0.33f, 0.28f);  // a drawn curtain
        }
    return f;
}

/// Makes one window of the lowest row a door down to `threshold_z`.
void add_door(Front& f, size_t column, double threshold_z) {
    const size_t wide = f.x.size() - 1;
    f.z.insert(f.z.begin() + 1, threshold_z);
    f.recess_m.insert(f.recess_m.begin(), wide, 0);
    f.inner.insert(f.inner.begin(), wide, vec3(0));
    for (const size_t row : {1, 2}) {
        f.recess_m[f.cell(column, row)] = f.recess_m[f.cell(column, 2)];
        f.inner[f.cell(column, row)] = vec3(0.14f, 0.08f, 0.045f);
    }
}

void add_balcony(MeshBuilder& mesh, double x0, double x1, double z, const vec3& wall) {
    const vec3 iron(0.07f, 0.08f, 0.09f);
    const double out = 1.1;
    mesh.box(Kind::building, {x0, -out, z - 0.18}, {x1, 0.06, z}, wall * 0.8f);
    mesh.box(Kind::slat, {x0 + 0.02, -out + 0.02, z + 0.98}, {x1 - 0.02, -out + 0.06, z + 1.02}, iron);
    for (const double x : {x0 + 0.02, x1 - 0.06})
        mesh.box(Kind::slat, {x, -out + 0.05, z + 0.981}, {x + 0.04, 0.05, z + 1.019}, iron);
    for (double x = x0 + 0.025; x < x1 - 0.04; x += 0.125)
        mesh.box(Kind::slat, {x, -out + 0.028, z - 0.01}, {x + 0.025, -out + 0.052, z + 0.99}, iron);
    for (double y = -out + 0.16; y < -0.05; y += 0.125)
        for (const double x : {x0 + 0.028, x1 - 0.052})
            mesh.box(Kind::slat, {x, y, z - 0.01}, {x + 0.024, y + 0.024, z + 0.99}, iron);
}

/// Stands on local [0, width] x [0, depth], its front at y = 0 facing -y.
void add_house(MeshBuilder& mesh, Stream& r, const Place& place, const House& house) {
    mesh.begin(place);
    const vec3 wall = r.pick(wall_colors) * float(r.within(0.85, 1.1));
    const double ground_m = r.within(3.5, 4.1), floor_m = r.within(2.95, 3.3);
    const bool shop = !house.plain && r.chance(0.45);
    const double joint = kerb_z + ground_m, top = joint + (house.floors - 1) * floor_m + 0.5;
    const double recess = r.within(0.12, 0.3);

    const vec3 base = shop ? r.pick(wall_colors) * 0.8f : wall * 0.75f;
    const std::pair<double, double> low_openings = {kerb_z + (shop ? 0.45 : 0.9), joint - 0.75};
    Front lower =
        plan_front(r, house.width, shop ? 2.9 : 1.3, shop ? 3.6 : 2.7, -sunk_m, {low_openings}, joint, recess + 0.1);
    add_door(lower, size_t(r.whole(0, lower.columns - 1)), kerb_z + 0.1);
    mesh.block(lower.x, lower.z, house.depth, lower.recess_m, base, lower.inner);

    std::vector<std::pair<double, double>> openings;
    const double sill = r.within(0.75, 0.95), head = r.within(2.3, 2.55);
    for (int f = 0; f + 1 < house.floors; ++f)
        openings.push_back({joint + f * floor_m + sill, joint + f * floor_m + head});
    // The upper floors stand 2 cm before the lower ones and reach 5 cm into them.
    mesh.begin({place.world({0, -0.02, 0}), place.yaw_rad});
    const Front upper =
        plan_front(r, house.width - 0.004, r.within(1.0, 1.5), r.within(2.3, 3.0), joint - 0.05, openings, top, recess);
    mesh.block(upper.x, upper.z, house.depth + 0.04, upper.recess_m, wall, upper.inner);

    const vec3 stone = glm::min(wall * 1.25f, vec3(0.8f));
    mesh.begin(place);
    if (!house.plain)
        mesh.box(Kind::building, {0.01, -0.1, joint - 0.14}, {house.width - 0.011, 0.2, joint + 0.11}, stone);
    if (r.chance(0.45)) {
        const vec3 roof = r.chance(0.6) ? vec3(0.30f, 0.11f, 0.07f) : vec3(0.10f, 0.11f, 0.13f);
        mesh.gable(house.width, house.depth, top + 0.03, r.within(1.8, 3.2), roof, wall * 0.9f);
    } else {
        mesh.box(Kind::building, {0.012, -0.22, top - 0.3}, {house.width - 0.013, 0.3, top + 0.25}, stone);
    }
    for (int i = r.whole(0, 2); i > 0; --i) {
        const double x = r.within(0.6, house.width - 1.4), y = house.depth * r.within(0.35, 0.6);
        mesh.box(Kind::building, {x, y, top - 0.5}, {x + 0.7, y + 0.6, top + r.within(2.4, 3.8)},
                 vec3(0.33f, 0.14f, 0.10f));
    }
    if (house.plain || !r.chance(0.4) || !house.balconies) return;
    const int column = r.whole(0, std::max(0, upper.columns - 1));
    for (int f = 0; f + 1 < house.floors; ++f) {
        const double middle = (column + 0.5) * upper.pitch_m, half = upper.pitch_m / 2 - 0.12;
        mesh.begin({place.world({0, -0.02, 0}), place.yaw_rad});
        add_balcony(mesh, middle - half, middle + half, joint + f * floor_m + 0.25, wall);
    }
}

/// A slat fence along local x from 0 to `length`, standing at local z.
void add_fence(MeshBuilder& mesh, Stream& r, const Place& place, double length, double height) {
    mesh.begin(place);
    const vec3 wood = vec3(0.34f, 0.22f, 0.12f) * float(r.within(0.7, 1.3));
    const double slat = r.within(0.07, 0.11), gap = r.within(0.04, 0.09);
    for (double x = 0; x + slat <= length; x += slat + gap)
        mesh.box(Kind::slat, {x, -0.012, kerb_z - sunk_m}, {x + slat, 0.012, kerb_z + height},
                 wood * float(r.within(0.85, 1.1)));
    for (const double z : {0.3, height - 0.25})
        mesh.box(Kind::slat, {-0.02, 0.008, kerb_z + z}, {length, 0.045, kerb_z + z + 0.08}, wood * 0.8f);
    for (double x = 0.06; x < length; x += 2.4)
        mesh.prism(Kind::pole, {x, 0.07, kerb_z - sunk_m}, {x, 0.07, kerb_z + height + 0.05}, 0.04, wood * 0.7f);
}

/// Houses side by side along local x, their fronts near local y = 0; gaps are closed with fences.
void add_row(MeshBuilder& mesh, Stream& r, const Place& row, double length, bool plain, double scaffold_x = 1e9) {
    double x = 0, last_setback = -1;
    int until_gap = r.whole(2, 4);
    while (x < length - 6) {
        House house;
        house.plain = plain;
        house.width = std::min(r.within(8.5, 16), length - x);
        house.depth = r.within(9.5, 11);
        house.floors = plain ? r.whole(3, 5) : r.whole(2, 5);
        double setback = r.within(0, 0.5);  // no two fronts in one plane
        if (std::abs(setback - last_setback) < 0.06) setback += 0.1;
        last_setback = setback;
        const double a = row.world({x, 0, 0}).x, b = row.world({x + house.width, 0, 0}).x;
        house.balconies = std::max(a, b) < scaffold_x - 1 || std::min(a, b) > scaffold_x + scaffold_m + 1;
        add_house(mesh, r, {row.world({x, setback, 0}), row.yaw_rad}, house);
        x += house.width - 0.03;  // a neighbour stands a little inside
        if (--until_gap > 0 || x > length - 12) continue;
        const double gap = r.within(4, 6.5);
        if (!plain) add_fence(mesh, r, {row.world({x + 0.12, 0.8, 0}), row.yaw_rad}, gap - 0.2, r.within(1.1, 1.8));
        x += gap;
        until_gap = r.whole(2, 4);
    }
}

}  // namespace

void add_ground(MeshBuilder& mesh) {
    mesh.begin({});
    const vec3 asphalt(0.105f, 0.107f, 0.112f), paving(0.36f, 0.345f, 0.32f), stone(0.46f, 0.45f, 0.43f);
    // Across: yards, pavement, kerb stone with its upright face, road.
    struct Line {
        double y, z;
        vec3 color;  ///< of the strip to the next
    };
    std::vector<Line> across = {{-110, kerb_z, paving * 0.7f}};
    for (double y = -70; y < -front_y - 6; y += 10) across.push_back({y, kerb_z, paving * 0.7f});
    const auto add = [&](double y, double z, const vec3& color) { across.push_back({y, z, color}); };
    add(-front_y - 1, kerb_z, paving), add(-kerb_y - 0.16, kerb_z, stone), add(-kerb_y, kerb_z, stone);
    add(-kerb_y, 0, asphalt), add(-5.3, 0, asphalt), add(-1.75, 0, asphalt), add(1.75, 0, asphalt);
    add(5.3, 0, asphalt), add(kerb_y, 0, stone), add(kerb_y, kerb_z, stone), add(kerb_y + 0.16, kerb_z, paving);
    add(front_y + 1, kerb_z, paving * 0.7f);
    for (double y = 20; y <= 70; y += 10) add(y, kerb_z, paving * 0.7f);
    add(110, kerb_z, paving);
    for (double x = -200; x < 240; x += 10)
        for (size_t i = 0; i + 1 < across.size(); ++i) {
            const Line &a = across[i], &b = across[i + 1];
            mesh.quad(Kind::ground, {x, a.y, a.z}, {x + 10, a.y, a.z}, {x + 10, b.y, b.z}, {x, b.y, b.z}, a.color);
        }
    mesh.count(Kind::ground);
}

void add_buildings(MeshBuilder& mesh, uint32_t seed) {
    Stream r(seed, 1);
    const double length = street_to_x - street_from_x;
    add_row(mesh, r, {{street_from_x, front_y, 0}, 0}, length, false, scaffold_from_x(seed, 1));
    add_row(mesh, r, {{street_to_x, -front_y, 0}, 2 * right_angle}, length, false, scaffold_from_x(seed, -1));
    // What shows through the gaps, and what closes both ends of the street.
    add_row(mesh, r, {{street_from_x, front_y + 27, 0}, 0}, length, true);
    add_row(mesh, r, {{street_to_x, -front_y - 27, 0}, 2 * right_angle}, length, true);
    add_row(mesh, r, {{street_to_x + 14, 50, 0}, -right_angle}, 100, true);
    add_row(mesh, r, {{street_from_x - 14, -50, 0}, right_angle}, 100, true);
}

}  // namespace vshift::analytic
