// SPDX-License-Identifier: Apache-2.0
// The mesh under a tolerance: how far it moves, that it stays closed, and what the masks make of it.
#include <tbb/global_control.h>

#include <cstring>

#include "embree_core/surface_field.h"
#include "tests/catch.h"
#include "tests/minimal_support.h"
#include "tests/subjects.h"

using namespace vshift;
using namespace vshift::minimal;

namespace {

constexpr double tolerances[] = {0, 0.02, 0.1, 0.5};

bool is_whole(const LiftedMesh& m, int x, int y) {
    const Grid<float>& w = m.inverse_depth;
    return w.at(x, y) > 0 && w.at(x + 1, y) > 0 && w.at(x, y + 1) > 0 && w.at(x + 1, y + 1) > 0 &&
           !(m.tears.at(x, y) & 3) && !(m.tears.at(x + 1, y) & 2) && !(m.tears.at(x, y + 1) & 1);
}

/// 1/z of the mesh under R's ray through u; NaN where it meets nothing.
double under(const LiftedView& view, glm::dvec2 u) {
    const Hit hit = view.kept.intersect(glm::vec3(0), glm::vec3(ray(view.mesh.intrinsics, u)), 0,
                                        std::numeric_limits<float>::infinity());
    return hit ? 1 / double(hit.t) : std::numeric_limits<double>::quiet_NaN();
}

template <class Vector>
bool same_bytes(const Vector& a, const Vector& b) {
    return a.size() == b.size() && (a.empty() || std::memcmp(a.data(), b.data(), a.size() * sizeof(a[0])) == 0);
}

}  // namespace

TEST_CASE("no pixel's surface moves by more than the tolerance", "[adaptive]") {
    for (const Subject& s : subjects())
        for (double tolerance : tolerances) {
            const LiftedView view = s.lifted(tolerance);
            size_t missed = 0, solid = 0;
            double worst_px = 0, worst_origin_px = 0;
            for (int y = 0; y < s.k.height; ++y)
                for (int x = 0; x < s.k.width; ++x) {
                    if (!is_measured(s.depth.at(x, y))) continue;
                    ++solid;
                    double w = under(view, {x + 0.5, y + 0.5});
                    if (std::isnan(w)) w = under(view, {x + 0.5 + 1e-3, y + 0.5 + 6e-4});  // a vertex to the bit
                    if (std::isnan(w)) {
                        ++missed;
                        continue;
                    }
                    const double scale = s.px_per_inverse_depth();
                    worst_px = std::max(worst_px, scale * std::fabs(w - 1 / double(s.depth.at(x, y))));
                    // Rays start on the mesh itself.
                    const double origin = 1 / double(view.mesh.vertices[size_t(y) * size_t(s.k.width) + size_t(x)].z);
                    worst_origin_px = std::max(worst_origin_px, scale * std::fabs(origin - w));
                }
            INFO(s.name << ", tolerance " << tolerance << ": worst " << worst_px << " px, origins " << worst_origin_px
                        << " px off the mesh");
            CHECK(solid > 1000);
            CHECK(missed == 0);
            // A ray to the side of a vertex sees a neighbouring height: slopes are below 1 px per px here.
            CHECK(worst_px <= tolerance + 2e-3);
            CHECK(worst_origin_px <= 2e-3);
        }
}

TEST_CASE("the collapsed mesh has no gap, and agrees with its height field", "[adaptive]") {
    std::mt19937 random(11);
    std::uniform_real_distribution<double> share(0, 1);
    for (const Subject& s : subjects())
        for (double tolerance : tolerances) {
            const LiftedView view = s.lifted(tolerance);
            size_t missed = 0, asked = 0;
            double worst_px = 0, worst_field_px = 0;
            for (int i = 0; i < 40000; ++i) {
                const int x = int(share(random) * (s.k.width - 1)), y = int(share(random) * (s.k.height - 1));
                if (!is_whole(view.mesh, x, y)) continue;
                // Along rows and columns of centres as well, where the edges are.
                const double fx = i % 3 == 0 ? 0 : share(random), fy = i % 3 == 1 ? 0 : share(random);
                const glm::dvec2 u(x + 0.5 + fx, y + 0.5 + fy);
                const double w = under(view, u);
                ++asked;
                if (std::isnan(w)) {
                    ++missed;
                    continue;
                }
                const auto at = [&](int cx, int cy) { return 1 / double(s.depth.at(cx, cy)); };
                const double ref = fx + fy < 1
                                       ? at(x, y) + fx * (at(x + 1, y) - at(x, y)) + fy * (at(x, y + 1) - at(x, y))
                                       : at(x + 1, y + 1) + (1 - fx) * (at(x, y + 1) - at(x + 1, y + 1)) +
                                             (1 - fy) * (at(x + 1, y) - at(x + 1, y + 1));
                // Beside tears the mesh of tolerance 0 is a fan already: its twist is the cell's own.
                const double twist = std::fabs(at(x, y) - at(x + 1, y) + at(x + 1, y + 1) - at(x, y + 1));
                const double scale = s.px_per_inverse_depth();
                worst_px = std::max(worst_px, scale * (std::fabs(w - ref) - 0.5 * twist));
                worst_field_px = std::max(
                    worst_field_px, scale * (std::fabs(w - double(surface_inverse_depth(view.mesh, u))) - 0.5 * twist));
            }
            INFO(s.name << ", tolerance " << tolerance << ": " << asked << " rays, worst " << worst_px << " px, field "
                        << worst_field_px << " px");
            CHECK(asked > 1000);
            CHECK(missed == 0);
            CHECK(worst_px <= tolerance + 2e-3);
            CHECK(worst_field_px <= tolerance + 2e-3);
        }
}

TEST_CASE("a larger tolerance takes fewer triangles and less memory", "[adaptive]") {
    for (const Subject& s : subjects()) {
        std::vector<uint64_t> triangles;
        std::vector<size_t> bytes;
        for (double tolerance : tolerances) {
            const LiftedView view = s.lifted(tolerance);
            uint64_t counted = 0;
            for (const LiftedQuad& quad : view.mesh.kept) counted += quad[2] == quad[3] ? 1 : 2;
            CHECK(view.mesh.kept_triangles == counted);
            triangles.push_back(counted);
            bytes.push_back(bvh_bytes(view));
            CHECK(view.mesh.torn.size() == s.lifted(0).mesh.torn.size());
        }
        INFO(s.name << ": " << triangles[0] << " " << triangles[1] << " " << triangles[2] << " " << triangles[3]
                    << " triangles, " << bytes[0] << " ... " << bytes[3] << " bytes");
        for (size_t i = 1; i < triangles.size(); ++i) CHECK(triangles[i] <= triangles[i - 1]);
        CHECK(bytes[3] < bytes[0]);
        if (s.name == "plane") CHECK(triangles[1] * 20 < triangles[0]);
        if (s.name == "two_planes") CHECK(triangles[1] * 20 < triangles[0]);
    }
}

TEST_CASE("one thread and two build the same mesh", "[adaptive]") {
    for (const Subject& s : subjects())
        for (double tolerance : {0.0, 0.1}) {
            const auto built = [&](size_t threads) {
                const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, threads);
                return s.lifted(tolerance);
            };
            const LiftedView one = built(1), two = built(2);
            INFO(s.name << ", tolerance " << tolerance);
            CHECK(same_bytes(one.mesh.vertices, two.mesh.vertices));
            CHECK(same_bytes(one.mesh.kept, two.mesh.kept));
            CHECK(same_bytes(one.mesh.wall_vertices, two.mesh.wall_vertices));
            CHECK(same_bytes(one.mesh.torn, two.mesh.torn));
            CHECK(same_bytes(one.mesh.inverse_depth.data, two.mesh.inverse_depth.data));
        }
}

TEST_CASE("no pinhole: a slanted near wall hides all of a strip of the far one", "[adaptive]") {
    const Subject s = of_disparity("walls", 320, 240, walls_px);
    for (double tolerance : tolerances) {
        const RecordedMasks m = s.masks(tolerance);
        size_t pinholes = 0, beyond_strip = 0, expected = 0;
        for (int y = 0; y < 240; ++y) {
            const double strip_px = near_wall_px(150, y + 0.5) - 20;  // V is to the left by the baseline
            for (int x = 150; x < 320; ++x) {
                const double from_edge = x + 0.5 - 150;
                expected += from_edge < strip_px - 1;
                pinholes += from_edge < strip_px - 1 && !m.occluded.at(x, y);
                beyond_strip += from_edge > strip_px + 1 && m.occluded.at(x, y);
            }
        }
        INFO("tolerance " << tolerance << ": " << pinholes << " of " << expected << " px");
        CHECK(expected > 10000);
        CHECK(pinholes == 0);
        CHECK(beyond_strip == 0);
    }
}

TEST_CASE("every closed form holds under a tolerance of 0.02 px, and masks stay the same", "[adaptive]") {
    for (const std::string& name : scene_names()) {
        const MinimalScene s = make_scene(name);
        const View r = s.recorded(s.own), v = s.shifted(s.shift, s.own);
        const DepthMap depth = render(s.world, r).depth;
        const auto rig_at = [&](const View& shifted, double tolerance) {
            LiftedRig rig;
            rig.views.push_back(
                lift_view("R", r.intrinsics, r.world_from_cam, depth, shifted.world_from_cam.translation_m, tolerance));
            return rig;
        };
        const LiftedRig rig = rig_at(v, 0.02);
        const RecordedMasks m = mask(rig, as_shifted(v), clear_m);
        const ShiftedHoles h = holes(rig, as_shifted(v));
        for (const ClosedForm& form : s.closed_forms) {
            if (form.out == "truth" || (name == "step_kerb" && form.channel == "occluded")) continue;
            INFO(name << " " << form.out << " " << form.channel << ": " << form.rule);
            CHECK(differing(form.out == "holes" ? h.hole : channel_of(m, form.channel), form.expected) == 0);
        }
        const RecordedMasks full = mask(rig_at(v, 0), as_shifted(v), clear_m);
        INFO(name);
        for (const char* channel : {"lost", "occluded", "outside", "unknown", "unseen"})
            CHECK(differing(channel_of(m, channel), channel_of(full, channel)) * 1000 < full.lost.size());
        // Zero shift loses nothing, collapsed as for no shift and as for a large one.
        for (const auto& [shifted, tolerance] : {std::pair{r, 0.02}, {r, 4.0}, {v, 0.02}}) {
            const LiftedRig still = rig_at(shifted, tolerance);
            const RecordedMasks none = mask(still, as_shifted(r), clear_m);
            CHECK(count(none.lost) + count(none.unknown) + count(none.unseen) == 0);
            CHECK(count(holes(still, as_shifted(r)).hole) == 0);
        }
    }
}

TEST_CASE("a cell that is torn along one edge alone is one part, whichever edge it is", "[adaptive]") {
    const int edges[4][3] = {{1, 1, 1}, {2, 1, 2}, {1, 2, 1}, {1, 1, 2}};  // after each corner: x, y, bit of its tear
    for (int torn = 0; torn < 4; ++torn) {
        INFO("edge " << torn);
        Grid<float> w(4, 4, 0.1f);
        Grid<uint8_t> tears(4, 4, 0);
        const auto& edge = edges[torn];
        tears.at(edge[0], edge[1]) = uint8_t(edge[2]);
        const SplitCell cell = split_cell({w, tears}, 1, 1);
        for (int c = 0; c < 4; ++c) {
            CHECK(cell.joined_next[size_t(c)] == (c != torn));
            CHECK(cell.part[size_t(c)] == 0);
        }
        CHECK(cell.centre[0] == 0.1f);
    }
}

TEST_CASE("a tear that ends within the surface is lifted under any tolerance", "[adaptive]") {
    // A flap that bends towards the camera over its length: torn at one end, joined at the other.
    for (const bool across : {true, false})
        for (const bool turned : {true, false}) {
            INFO(across << turned);
            Subject s = of_disparity("flap", 48, 48, [](double, double) { return 200.0; });
            for (int y = 0; y < 48; ++y)
                for (int x = 0; x < 48; ++x) {
                    const int u = turned ? 47 - (across ? x : y) : (across ? x : y), v = across ? y : x;
                    if (v > 24) s.depth.at(x, y) = float(320.0 / (200.0 + 0.06 * u));
                }
            for (const double tolerance : {0.0, 0.02, 0.5, 4.0}) CHECK(s.lifted(tolerance).mesh.kept_triangles > 0);
        }
}
