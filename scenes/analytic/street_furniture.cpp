// SPDX-License-Identifier: Apache-2.0
// What stands on the road and the pavements of the analytic street. Every footprint is reserved before
// anything is placed on it, so that nothing stands in anything else.
#include <algorithm>
#include <cmath>

#include "scenes/analytic/street_mesh.h"

namespace vshift::analytic {
namespace {

using glm::dvec3;
using glm::vec3;

const double right_angle = std::acos(0.0);

struct Footprint {
    double x0, x1, y0, y1;
};

class Furniture {
public:
    Furniture(MeshBuilder& mesh, uint32_t seed, const StreetOptions& options)
        : mesh_(mesh), seed_(seed), options_(options) {}

    void place_all() {
        scaffolds();
        lamps_and_trees();
        kiosks_and_shelters();
        signs_and_bollards();
        parked_cars();
        standing_cars();
        benches_and_planters();
        stone_balls();
        fences();
        bins();
        fill_with_crates();
    }

private:
    /// Takes a place if it is free; `margin_m` is kept to the others.
    bool take(double x, double y, double half_x, double half_y, double margin_m = 0.15) {
        const Footprint f{x - half_x, x + half_x, y - half_y, y + half_y};
        for (const Footprint& o : taken_)
            if (f.x0 < o.x1 + margin_m && o.x0 < f.x1 + margin_m && f.y0 < o.y1 + margin_m && o.y0 < f.y1 + margin_m)
                return false;
        taken_.push_back(f);
        return true;
    }
    /// Local x along the street as seen from it, local y towards the houses, z = 0 on the pavement.
    static Place on_pavement(double x, int side, double from_kerb_m) {
        return {{x, side * (kerb_y + from_kerb_m), kerb_z}, side > 0 ? 0 : 2 * right_angle};
    }
    static double pavement_y(int side, double from_kerb_m) { return side * (kerb_y + from_kerb_m); }

    vec3 metal(Stream& r) { return vec3(0.17f, 0.19f, 0.20f) * float(r.within(0.6, 1.6)); }

    // ------------------------------------------------------------ poles, trees
    void lamp(Stream& r, double x, int side) {
        mesh_.begin(on_pavement(x, side, 0.55));
        const vec3 iron = metal(r);
        const double h = r.within(6.6, 7.4);
        mesh_.prism(Kind::pole, {0, 0, -sunk_m}, {0, 0, 0.9}, 0.075, iron * 0.8f);
        mesh_.prism(Kind::pole, {0, 0, 0.88}, {0, 0, h}, 0.055, iron);
        mesh_.prism(Kind::pole, {0, 0.02, h - 0.08}, {0, -1.7, h + 0.12}, 0.03, iron);
        mesh_.box(Kind::box, {-0.15, -2.2, h + 0.06}, {0.15, -1.6, h + 0.2}, vec3(0.5f));
    }
    void globe_lamp(Stream& r, double x, int side) {
        mesh_.begin(on_pavement(x, side, 0.55));
        const double h = r.within(3.2, 3.8);
        mesh_.prism(Kind::pole, {0, 0, -sunk_m}, {0, 0, h}, 0.045, metal(r));
        mesh_.sphere(Kind::sphere, {0, 0, h + 0.17}, 0.2, vec3(0.8f, 0.78f, 0.7f), 0.95e-3);
    }
    void tree(Stream& r, Stream& leaves, double x, int side) {
        mesh_.begin(on_pavement(x, side, 1.0));
        const double h = r.within(2.9, 3.4);
        mesh_.prism(Kind::pole, {0, 0, -sunk_m}, {0.05, 0.04, h + 0.9}, r.within(0.065, 0.075),
                    vec3(0.13f, 0.09f, 0.06f));
        if (!options_.foliage) return;
        const double size = leaves.within(0.8, 1.05);
        const vec3 green = vec3(0.10f, 0.19f, 0.045f) * float(leaves.within(0.8, 1.25));
        for (int i = 0; i < 12; ++i) {
            const double a = i * 2.39996, up = (i + 0.5) / 12.0, out = size * 0.95 * std::sin(up * 2.6 + 0.35);
            const dvec3 at(out * std::cos(a), out * std::sin(a), h + 0.45 + size * (0.5 + 2.2 * up));
            mesh_.sphere(Kind::foliage, at, size * leaves.within(0.62, 0.9), green * float(leaves.within(0.8, 1.2)),
                         0.02);
        }
    }
    void lamps_and_trees() {
        Stream r(seed_, 2), leaves(seed_, 3);
        for (const int side : {1, -1}) {
            int n = 0;
            for (double x = street_from_x + r.within(3, 9); x < street_to_x - 2; x += r.within(7.5, 9.5), ++n) {
                const double half = n % 2 ? 0.5 : 0.1;
                if (!take(x, pavement_y(side, n % 2 ? 1.0 : 0.55), half, half)) continue;
                if (n % 2)
                    tree(r, leaves, x, side);
                else if (n % 4 == 0)
                    lamp(r, x, side);
                else
                    globe_lamp(r, x, side);
            }
        }
    }

    void signs_and_bollards() {
        Stream r(seed_, 4);
        for (const int side : {1, -1}) {
            for (int i = 0; i < 14; ++i) {
                const double x = r.within(street_from_x + 4, street_to_x - 4);
                if (!take(x, pavement_y(side, 0.5), 0.35, 0.12)) continue;
                mesh_.begin({{x, pavement_y(side, 0.5), kerb_z}, r.within(-0.2, 0.2) + side * right_angle});
                const double h = r.within(2.2, 2.9);
                const std::array<vec3, 3> faces = {{{0.05f, 0.12f, 0.45f}, {0.5f, 0.04f, 0.04f}, {0.65f, 0.5f, 0.05f}}};
                mesh_.prism(Kind::pole, {0, 0, -sunk_m}, {0, 0, h + 0.05}, r.within(0.021, 0.035), vec3(0.38f));
                mesh_.box(Kind::box, {-0.3, -0.065, h - 0.6}, {0.3, -0.04, h}, r.pick(faces));
                mesh_.prism(Kind::pole, {0, -0.05, h - 0.3}, {0, 0.0, h - 0.3}, 0.025, vec3(0.3f));
            }
            for (int run = 0; run < 4; ++run) {
                const double from = r.within(street_from_x + 4, street_to_x - 16), step = r.within(1.4, 1.8);
                const bool balls = run % 2 == 0;
                for (int i = 0; i < 7; ++i) {
                    const double x = from + i * step;
                    if (!take(x, pavement_y(side, 0.4), 0.1, 0.1)) continue;
                    mesh_.begin(on_pavement(x, side, 0.4));
                    mesh_.prism(Kind::pole, {0, 0, -sunk_m}, {0, 0, 0.85}, 0.05, vec3(0.05f, 0.05f, 0.055f));
                    if (balls) mesh_.sphere(Kind::sphere, {0, 0, 0.9}, 0.07, vec3(0.55f, 0.5f, 0.4f), 0.9e-3);
                }
            }
        }
    }

    /// Tubes and decks before a house front.
    void scaffolds() {
        for (const int side : {1, -1}) {
            const double x = scaffold_from_x(seed_, side), bay = scaffold_m / 4;
            if (!take(x + 2 * bay, pavement_y(side, 3.7), 2 * bay + 0.3, 0.65)) continue;
            mesh_.begin(on_pavement(side > 0 ? x : x + 4 * bay, side, 3.15));
            const vec3 steel(0.32f, 0.33f, 0.34f), deck(0.42f, 0.32f, 0.19f);
            const int lifts = 4;
            for (int i = 0; i <= 4; ++i)
                for (const double y : {0.0, 1.0})
                    mesh_.prism(Kind::pole, {i * bay, y, -sunk_m}, {i * bay, y, 2.0 * lifts + 1.1}, 0.0242, steel);
            for (int k = 1; k <= lifts; ++k) {
                for (const double up : {0.0, 1.0})
                    mesh_.prism(Kind::pole, {-0.2, -0.04, 2.0 * k + up}, {4 * bay + 0.2, -0.04, 2.0 * k + up}, 0.0242,
                                steel);
                for (int i = 0; i <= 4; ++i)
                    mesh_.prism(Kind::pole, {i * bay + 0.04, -0.15, 2.0 * k - 0.05},
                                {i * bay + 0.04, 1.15, 2.0 * k - 0.05}, 0.0242, steel);
                mesh_.box(Kind::box, {-0.1, 0.05, 2.0 * k - 0.03}, {4 * bay + 0.1, 0.95, 2.0 * k + 0.02}, deck);
            }
        }
    }

    // ------------------------------------------------------------ cars
    /// Local x forward, wheels on local z = 0. Two boxes and four wheels.
    void car(Stream& r, const Place& place) {
        static const std::array<vec3, 9> paints = {{{0.62f, 0.62f, 0.60f},
                                                    {0.03f, 0.03f, 0.035f},
                                                    {0.20f, 0.21f, 0.23f},
                                                    {0.42f, 0.04f, 0.03f},
                                                    {0.04f, 0.10f, 0.32f},
                                                    {0.30f, 0.33f, 0.36f},
                                                    {0.08f, 0.18f, 0.12f},
                                                    {0.50f, 0.36f, 0.06f},
                                                    {0.45f, 0.47f, 0.50f}}};
        mesh_.begin(place);
        const vec3 paint = r.pick(paints), glass(0.035f, 0.045f, 0.055f), tyre(0.02f);
        const bool van = r.chance(0.15);
        const double l = van ? r.within(4.9, 5.3) : r.within(3.9, 4.7), w = van ? 1.86 : r.within(1.68, 1.82);
        const double waist = van ? 1.1 : r.within(0.82, 0.9), roof = van ? 2.15 : r.within(1.4, 1.6);
        mesh_.box(Kind::box, {-l / 2, -w / 2, 0.24}, {l / 2, w / 2, waist}, paint);
        const double back = van ? 0.49 : r.within(0.34, 0.46), ahead = van ? 0.34 : 0.21;
        mesh_.glazed_box({-l * back, -w / 2 + 0.08, waist - sunk_m}, {l * ahead, w / 2 - 0.08, roof}, paint * 0.97f,
                         glass, van ? 3 : 2);
        for (const double x : {-l * 0.31, l * 0.31})
            for (const double y : {-1.0, 1.0})
                mesh_.prism(Kind::box, {x, y * (w / 2 - 0.2), 0.305}, {x, y * (w / 2 + 0.015), 0.305}, 0.315, tyre, 20,
                            false);
    }
    void parked_cars() {
        Stream r(seed_, 6);
        for (const int side : {1, -1})
            for (double x = street_from_x + r.within(1, 4); x < street_to_x - 4; x += r.within(5.7, 6.4)) {
                const double y = side * 6.42, turn = r.within(-0.012, 0.012) + (side > 0 ? 2 * right_angle : 0);
                if (r.chance(0.14) || !take(x, y, 2.7, 0.97)) continue;
                car(r, {{x, y, 0}, turn});
            }
    }
    /// In the lanes, but never where the ego and its shifted cameras pass.
    void standing_cars() {
        Stream r(seed_, 7);
        for (const double lane : {-3.5, 0.0, 3.5})
            for (double x = street_from_x + r.within(4, 20); x < street_to_x - 6; x += r.within(9, 22)) {
                if (x > free_from_x - 8 && x < free_to_x + 7) continue;
                if (r.chance(0.25) || !take(x, lane, 2.7, 0.97)) continue;
                car(r, {{x, lane, 0}, r.within(-0.01, 0.01) + (lane > 0 ? 2 * right_angle : 0)});
            }
    }

    // ------------------------------------------------------------ boxes on the pavement
    void kiosks_and_shelters() {
        Stream r(seed_, 8);
        for (const int side : {1, -1}) {
            for (int i = 0; i < 3; ++i) {
                const double x = street_from_x + 20 + 78 * i + r.within(0, 40);
                if (!take(x, pavement_y(side, 2.0), 1.6, 1.4)) continue;
                mesh_.begin(on_pavement(x, side, 2.0));
                const std::array<vec3, 3> paints = {
                    {{0.06f, 0.22f, 0.16f}, {0.36f, 0.10f, 0.06f}, {0.10f, 0.16f, 0.32f}}};
                const vec3 paint = r.pick(paints);
                mesh_.box(Kind::box, {-1.2, -0.9, -sunk_m}, {1.2, 0.95, 2.35}, paint);
                mesh_.box(Kind::box, {-1.5, -1.3, 2.3}, {1.5, 1.2, 2.44}, paint * 0.6f);
                mesh_.box(Kind::box, {-1.0, -1.15, 0.95}, {1.0, -0.85, 1.02}, vec3(0.45f, 0.33f, 0.2f));
                mesh_.box(Kind::box, {-0.95, -0.915, 1.1}, {0.95, -0.87, 2.05}, vec3(0.04f, 0.05f, 0.06f));
            }
            const double x = r.within(free_from_x + 4, free_to_x);
            if (!take(x, pavement_y(side, 1.75), 2.1, 0.85)) continue;
            mesh_.begin(on_pavement(x, side, 1.2));  // a bus shelter, open to the road
            const vec3 steel(0.12f, 0.14f, 0.15f);
            for (const double px : {-1.9, 0.0, 1.9})
                mesh_.prism(Kind::pole, {px, 1.2, -sunk_m}, {px, 1.2, 2.45}, 0.035, steel);
            mesh_.box(Kind::box, {-2.05, -0.25, 2.42}, {2.05, 1.3, 2.52}, steel);
            mesh_.box(Kind::box, {-1.8, 1.19, 0.35}, {1.8, 1.215, 2.3}, vec3(0.33f, 0.38f, 0.40f));
            mesh_.box(Kind::box, {-1.93, 0.25, 0.3}, {-1.87, 1.12, 2.35}, vec3(0.5f, 0.42f, 0.2f));
            mesh_.box(Kind::box, {-1.3, 0.75, 0.44}, {1.3, 1.1, 0.5}, vec3(0.4f, 0.28f, 0.16f));
            for (const double px : {-1.1, 1.1})
                mesh_.prism(Kind::pole, {px, 0.92, -sunk_m}, {px, 0.92, 0.45}, 0.03, steel);
        }
    }
    void benches_and_planters() {
        Stream r(seed_, 9), leaves(seed_, 10);
        for (const int side : {1, -1})
            for (int i = 0; i < 16; ++i) {
                const double x = r.within(street_from_x + 4, street_to_x - 4);
                const bool bench = i % 2;
                if (!take(x, pavement_y(side, 1.0), bench ? 1.0 : 0.75, 0.4)) continue;
                mesh_.begin(on_pavement(x, side, 1.0));
                const vec3 wood(0.33f, 0.2f, 0.1f), stone(0.42f, 0.40f, 0.37f);
                if (bench) {
                    for (const double px : {-0.75, 0.65})
                        mesh_.box(Kind::box, {px, -0.2, -sunk_m}, {px + 0.1, 0.2, 0.43}, stone * 0.6f);
                    mesh_.box(Kind::box, {-0.9, -0.24, 0.42}, {0.9, 0.22, 0.47}, wood);
                    mesh_.box(Kind::box, {-0.9, 0.21, 0.41}, {0.9, 0.255, 0.85}, wood * 0.9f);
                    continue;
                }
                mesh_.box(Kind::box, {-0.65, -0.3, -sunk_m}, {0.65, 0.3, 0.5}, stone * float(r.within(0.8, 1.1)));
                for (int k = 0; k < 3 && options_.foliage; ++k)
                    mesh_.sphere(Kind::foliage, {-0.4 + 0.4 * k, leaves.within(-0.04, 0.04), 0.56},
                                 leaves.within(0.21, 0.27), vec3(0.09f, 0.17f, 0.05f), 0.008);
            }
    }
    void stone_balls() {
        Stream r(seed_, 11);
        for (const int side : {1, -1})
            for (int run = 0; run < 2; ++run) {
                const double from = run == 0 ? r.within(free_from_x, free_to_x - 8) : r.within(60, 120);
                for (int i = 0; i < 5; ++i) {
                    const double x = from + 1.9 * i, radius = 0.25;
                    if (!take(x, pavement_y(side, 0.5), radius, radius)) continue;
                    mesh_.begin(on_pavement(x, side, 0.5));
                    mesh_.sphere(Kind::sphere, {0, 0, radius - sunk_m}, radius, vec3(0.44f, 0.42f, 0.39f), 0.95e-3);
                }
            }
    }
    /// Site fences along the kerb.
    void fences() {
        Stream r(seed_, 12);
        for (const int side : {1, -1})
            for (int i = 0; i < 5; ++i) {
                const double length = r.within(3.5, 7), x = r.within(street_from_x + 6, street_to_x - 6);
                if (!take(x, pavement_y(side, 0.75), length / 2 + 0.1, 0.1)) continue;
                mesh_.begin({{x - side * length / 2, pavement_y(side, 0.75), kerb_z}, side > 0 ? 0 : 2 * right_angle});
                const double slat = r.within(0.06, 0.1), gap = r.within(0.05, 0.09), h = r.within(0.9, 1.3);
                const vec3 paint = r.chance(0.5) ? vec3(0.5f, 0.48f, 0.44f) : vec3(0.09f, 0.16f, 0.12f);
                for (double at = 0; at + slat <= length; at += slat + gap)
                    mesh_.box(Kind::slat, {at, -0.012, 0.06}, {at + slat, 0.012, h}, paint);
                for (const double z : {0.15, h - 0.2})
                    mesh_.box(Kind::slat, {0, 0.008, z}, {length, 0.045, z + 0.06}, paint * 0.8f);
                for (double at = 0.05; at < length; at += (length - 0.1) / 3)
                    mesh_.prism(Kind::pole, {at, 0.06, -sunk_m}, {at, 0.06, h + 0.04}, 0.03, paint * 0.7f);
            }
    }
    void bins() {
        Stream r(seed_, 13);
        for (const int side : {1, -1})
            for (int i = 0; i < 12; ++i) {
                const double x0 = r.within(street_from_x + 4, street_to_x - 4);
                for (int k = r.whole(1, 3); k > 0 && int(mesh_.counted(Kind::box)) + 2 <= options_.boxes; --k) {
                    const double x = x0 + 0.75 * k;
                    if (!take(x, pavement_y(side, 4.0), 0.34, 0.42, 0.05)) continue;
                    mesh_.begin(
                        {{x, pavement_y(side, 4.0), kerb_z}, (side > 0 ? 0 : 2 * right_angle) + r.within(-0.08, 0.08)});
                    const std::array<vec3, 4> paints = {
                        {{0.04f, 0.05f, 0.045f}, {0.05f, 0.14f, 0.07f}, {0.05f, 0.09f, 0.22f}, {0.4f, 0.3f, 0.05f}}};
                    const vec3 lid = r.pick(paints);
                    mesh_.box(Kind::box, {-0.27, -0.34, -sunk_m}, {0.27, 0.34, 1.02}, vec3(0.07f, 0.075f, 0.07f));
                    mesh_.box(Kind::box, {-0.29, -0.38, 1.0}, {0.29, 0.36, 1.08}, lid);
                }
            }
    }
    /// Cabinets, parcels and stacks of crates before the houses, until the boxes are as many as asked for.
    void fill_with_crates() {
        Stream r(seed_, 14);
        const auto missing = [&] { return options_.boxes - int(mesh_.counted(Kind::box)); };
        for (int tries = 0; missing() > 0 && tries < 4000; ++tries) {
            const int side = r.chance(0.5) ? 1 : -1;
            const bool by_the_house = r.chance(0.7);
            const double x = r.within(street_from_x + 3, street_to_x - 3), out = by_the_house ? 4.0 : 0.9;
            if (!take(x, pavement_y(side, out), 0.5, 0.42)) continue;
            const double turn = r.within(-0.15, 0.15) + (side > 0 ? 0 : 2 * right_angle);
            mesh_.begin({{x, pavement_y(side, out), kerb_z}, turn});
            if (r.chance(0.25)) {
                mesh_.box(Kind::box, {-0.4, -0.2, -sunk_m}, {0.4, 0.2, r.within(0.9, 1.3)}, vec3(0.36f, 0.38f, 0.35f));
                continue;
            }
            for (int k = 0, n = std::min(missing(), r.whole(1, 4)); k < n; ++k) {
                mesh_.begin({{x + r.within(-0.04, 0.04), pavement_y(side, out), kerb_z}, turn + r.within(-0.1, 0.1)});
                const vec3 wood = vec3(0.42f, 0.28f, 0.14f) * float(r.within(0.7, 1.2));
                mesh_.box(Kind::box, {-0.33, -0.24, 0.31 * k - sunk_m}, {0.33, 0.24, 0.31 * (k + 1) - 0.025}, wood);
            }
        }
    }

    MeshBuilder& mesh_;
    uint32_t seed_;
    StreetOptions options_;
    std::vector<Footprint> taken_;
};

}  // namespace

double scaffold_from_x(uint32_t seed, int side) {
    Stream r(seed, side > 0 ? 5 : 15);
    return r.within(free_from_x + 14, free_to_x + 4);
}

void add_furniture(MeshBuilder& mesh, uint32_t seed, const StreetOptions& options) {
    Furniture(mesh, seed, options).place_all();
}

}  // namespace vshift::analytic
