// SPDX-License-Identifier: Apache-2.0
// Fills of holes against answers known in closed form.
#include <tbb/global_control.h>

#include <cmath>
#include <cstring>
#include <limits>
#include <string>

#include "embree_core/fill.h"
#include "embree_core/warp.h"
#include "scenes/minimal/minimal.h"
#include "tests/catch.h"
#include "tests/minimal_support.h"

using namespace vshift;

namespace {

struct Scene {
    ColorImage color;
    Mask hole;
    DepthMap depth;

    Scene(int width, int height, glm::vec3 value = glm::vec3(0.25f), float depth_m = 10)
        : color(width, height, value), hole(width, height), depth(width, height, depth_m) {}
    void cut(int x0, int y0, int x1, int y1) {
        for (int y = y0; y < y1; ++y)
            for (int x = x0; x < x1; ++x) {
                hole.at(x, y) = 1;
                color.at(x, y) = glm::vec3(NAN);  // whatever stands under a hole is not read
                depth.at(x, y) = NAN;
            }
    }
    ColorImage filled(FillMethod method) const { return fill({color, hole, depth}, method); }
};

/// The value that a fill left, as a share of what it should be.
double worst_error(const ColorImage& got, const glm::vec3& want) {
    double worst = 0;
    for (const glm::vec3& c : got.data)
        for (int k = 0; k < 3; ++k)
            worst = std::max(worst, std::isfinite(c[k]) ? std::abs(double(c[k]) - double(want[k])) : INFINITY);
    return worst;
}

Scene noisy(int width, int height, uint32_t seed) {
    Scene s(width, height);
    const auto next = [&] { return seed = seed * 1664525u + 1013904223u, float(seed >> 8) / float(1 << 24); };
    for (auto& c : s.color.data) c = {2 * next(), next(), next()};  // above 1 too: light is not a display's
    for (auto& z : s.depth.data) z = 2 + 40 * next();
    s.cut(0, 0, 9, 14);
    s.cut(20, 5, 33, 30);
    s.cut(width - 4, 0, width, height);
    for (int y = 0; y < height; y += 3) s.cut(12, y, 13, y + 1);
    return s;
}

const FillMethod all_methods[] = {FillMethod::background, FillMethod::pushpull, FillMethod::telea, FillMethod::ns};

}  // namespace

TEST_CASE("a fill leaves every known pixel as it was, bit for bit, and no hole unfilled", "[fill]") {
    Scene s = noisy(61, 43, 5);
    s.color.at(50, 40) = {-0.25f, 1e-20f, std::numeric_limits<float>::quiet_NaN()};  // known, whatever it is
    s.hole.at(50, 40) = 0;
    Scene clean = noisy(61, 43, 5);
    for (const FillMethod method : all_methods) {
        INFO(fill_method_names()[size_t(method)]);
        const ColorImage got = s.filled(method);
        REQUIRE((got.width == 61 && got.height == 43));
        for (size_t i = 0; i < got.size(); ++i)
            if (!s.hole.data[i]) REQUIRE(std::memcmp(&got.data[i], &s.color.data[i], sizeof(glm::vec3)) == 0);
        const ColorImage finite = clean.filled(method);
        for (const auto& c : finite.data) REQUIRE((std::isfinite(c.r) && c.r >= 0 && std::isfinite(c.b)));
    }
}

TEST_CASE("a constant is filled with itself", "[fill]") {
    Scene s(64, 48, {0.5f, 0.125f, 0.0f});
    s.cut(10, 10, 30, 40), s.cut(50, 0, 64, 20);
    // Ours and push-pull to rounding of floats; OpenCV works in steps of 1/255 of the display's value.
    CHECK(worst_error(s.filled(FillMethod::background), {0.5f, 0.125f, 0}) < 1e-6);
    CHECK(worst_error(s.filled(FillMethod::pushpull), {0.5f, 0.125f, 0}) < 2e-6);
    CHECK(worst_error(s.filled(FillMethod::telea), {0.5f, 0.125f, 0}) < 0.03);
    CHECK(worst_error(s.filled(FillMethod::ns), {0.5f, 0.125f, 0}) < 0.007);
}

TEST_CASE("a ramp across a thin hole is continued by the background fill", "[fill]") {
    // Directions come in opposite pairs, so at the middle of a hole that is symmetric about it a ramp (of square
    // roots, which are what is averaged) comes back to rounding.
    Scene s(41, 41);
    for (int y = 0; y < 41; ++y)
        for (int x = 0; x < 41; ++x) s.color.at(x, y) = glm::vec3(float(std::pow(0.2 + x * 0.01 + y * 0.005, 2)));
    const glm::vec3 middle = s.color.at(20, 20);
    s.cut(14, 14, 27, 27);
    CHECK(std::abs(s.filled(FillMethod::background).at(20, 20).r - middle.r) < 1e-6);
}

TEST_CASE("a disocclusion takes the color of the far side alone", "[fill]") {
    // A near card, the strip that it uncovers beside it, and the wall behind everywhere else.
    const auto scene = [](float near_m, float far_m) {
        Scene s(80, 60, {0.1f, 0.6f, 0.2f}, far_m);
        for (int y = 15; y < 45; ++y)
            for (int x = 30; x < 50; ++x) s.color.at(x, y) = {0.9f, 0, 0}, s.depth.at(x, y) = near_m;
        s.cut(50, 15, 58, 45);
        return s;
    };
    const glm::vec3 wall{0.1f, 0.6f, 0.2f};
    const auto worst_in_strip = [&](const Scene& s, FillMethod method) {
        const ColorImage got = s.filled(method);
        double worst = 0;
        for (int y = 15; y < 45; ++y)
            for (int x = 50; x < 58; ++x)
                for (int k = 0; k < 3; ++k) worst = std::max(worst, std::abs(double(got.at(x, y)[k] - wall[k])));
        return worst;
    };
    CHECK(worst_in_strip(scene(3, 12), FillMethod::background) < 1e-6);
    CHECK(worst_in_strip(scene(3, std::numeric_limits<float>::infinity()), FillMethod::background) < 1e-6);
    CHECK(worst_in_strip(scene(NAN, 12), FillMethod::background) < 1e-6);  // no measurement: taken as near
    // The peers know no depth and bleed the card into the wall: the test tells them apart.
    for (const FillMethod peer : {FillMethod::pushpull, FillMethod::telea, FillMethod::ns})
        CHECK(worst_in_strip(scene(3, 12), peer) > 0.1);
}

TEST_CASE("the warp of a card before a wall is filled with the wall", "[fill]") {
    const minimal::MinimalScene s = minimal::make_scene("box");
    const minimal::View r = s.recorded(s.own);
    const ShiftedCamera v = minimal::as_shifted(s.shifted(s.shift, s.own));
    const DepthMap depth = minimal::render(s.world, r).depth;
    const SurfaceView surface = surface_view(r.intrinsics, r.world_from_cam, depth, v.world_from_cam.translation_m);
    Reprojection shown;
    REQUIRE(reproject(surface, v, nullptr, shown));
    const ShiftedHoles seen = holes({{surface.intrinsics, surface.world_from_cam, &shown}}, 0, v);
    // Plain colors by depth: the box white, the wall behind it blue.
    ColorImage recorded(seen.hole.width, seen.hole.height, {0, 0, 0.5f});
    for (size_t i = 0; i < depth.size(); ++i)
        if (depth.data[i] < 7) recorded.data[i] = glm::vec3(1);
    const Sampler sampler({surface.inverse_depth, surface.tears}, recorded,
                          projective_map(r.intrinsics, r.world_from_cam, v.intrinsics, v.world_from_cam));
    const Warped warped = warp(seen, {sampler}, EdgeBand::drop);
    const ColorImage got = fill({warped.color, warped.missing, seen.depth}, FillMethod::background);
    size_t filled = 0, wrong = 0;
    for (size_t i = 0; i < got.size(); ++i)
        if (seen.disoccluded.data[i]) {
            ++filled;
            wrong += glm::length(got.data[i] - glm::vec3(0, 0, 0.5f)) > 1e-5f;
        }
    CHECK(filled == 40 * 48);  // f shift (1/4 - 1/10) wide
    CHECK(wrong == 0);
}

TEST_CASE("no hole, nothing but holes, and odd sizes", "[fill]") {
    for (const FillMethod method : all_methods) {
        INFO(fill_method_names()[size_t(method)]);
        Scene whole(7, 5, glm::vec3(0.3f));
        CHECK(std::memcmp(whole.filled(method).data.data(), whole.color.data.data(), 35 * sizeof(glm::vec3)) == 0);
        whole.cut(0, 0, 7, 5);
        CHECK(worst_error(whole.filled(method), glm::vec3(0)) == 0);
        for (const auto& [w, h] : {std::pair{1, 1}, {1, 9}, {9, 1}, {2, 2}, {3, 1000}}) {
            Scene s(w, h, glm::vec3(0.5f));
            CHECK(worst_error(s.filled(method), glm::vec3(0.5f)) == 0);
            s.cut(0, 0, 1, 1);
            const ColorImage got = s.filled(method);
            if (w * h > 1) CHECK(worst_error(got, glm::vec3(0.5f)) < 0.007);
        }
        Scene bad(6, 6);
        bad.hole = Mask(6, 5);
        CHECK_THROWS_AS(bad.filled(method), Error);
    }
    CHECK_THROWS_AS(fill_method("tela", "x"), Error);
    CHECK(fill_method("ns", "x") == FillMethod::ns);
}

TEST_CASE("fills: one thread and many give the same bytes", "[fill]") {
    const Scene s = noisy(333, 217, 9);
    for (const FillMethod method : all_methods) {
        INFO(fill_method_names()[size_t(method)]);
        const auto bytes = [&] {
            const ColorImage got = s.filled(method);
            return std::string(reinterpret_cast<const char*>(got.data.data()), got.size() * sizeof(glm::vec3));
        };
        std::string one;
        {
            tbb::global_control single(tbb::global_control::max_allowed_parallelism, 1);
            one = bytes();
        }
        tbb::global_control several(tbb::global_control::max_allowed_parallelism, 4);
        CHECK(bytes() == one);
    }
}
