// SPDX-License-Identifier: Apache-2.0
// Image scores against answers worked out by hand: MS-SSIM, gradients, FLIP, regions, intervals, correspondence.
#include <tbb/global_control.h>

#include <cmath>
#include <limits>

#include "embree_core/flip.h"
#include "embree_core/image_scores.h"
#include "embree_core/score.h"
#include "embree_core/temporal.h"
#include "scenes/minimal/minimal.h"
#include "tests/catch.h"
#include "tests/image_support.h"

using namespace vshift;

namespace {

ColorImage constant(int width, int height, glm::vec3 value) {
    return {width, height, value};
}

Grid<double> ramp(int width, int height, double per_x, double per_y) {
    Grid<double> out(width, height);
    for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x) out.at(x, y) = 0.1 + per_x * x + per_y * y;
    return out;
}

}  // namespace

TEST_CASE("MS-SSIM: one for itself; an offset of a constant leaves the last scale's luminance", "[score][ms_ssim]") {
    const Grid<double> a = luma(textured(200, 180, 3));
    CHECK(ms_ssim(ms_ssim_maps(a, a)) == 1);
    const double p = 0.25, q = 0.75, l = (2 * p * q + 1e-4) / (p * p + q * q + 1e-4);
    CHECK(ms_ssim(ms_ssim_maps(Grid<double>(180, 176, p), Grid<double>(180, 176, q))) ==
          Approx(std::pow(l, 0.1333)).epsilon(1e-9));
    CHECK(std::isnan(ms_ssim(ms_ssim_maps(Grid<double>(400, 175, p), Grid<double>(400, 175, q)))));
    // A region far from a spoiled corner does not see it.
    Grid<double> b = a;
    for (int y = 0; y < 32; ++y)
        for (int x = 0; x < 32; ++x) b.at(x, y) = 1 - b.at(x, y);
    Mask far(200, 180), near(200, 180);
    for (int y = 0; y < 180; ++y)
        for (int x = 0; x < 200; ++x) far.at(x, y) = x >= 144 && y >= 128, near.at(x, y) = x < 32 && y < 32;
    const MsSsimMaps maps = ms_ssim_maps(b, a);
    CHECK(ms_ssim(maps, &far) == Approx(1).epsilon(1e-12));
    CHECK(ms_ssim(maps, &near) < 0.5);
    CHECK(ms_ssim(maps) < 1);
    const Mask none(200, 180);
    CHECK(std::isnan(ms_ssim(maps, &none)));
}

TEST_CASE("gradients of ramps", "[score][gradient]") {
    const GradientMaps maps = gradient_maps(ramp(20, 10, 0.03, 0.04), ramp(20, 10, 0, 0.02));
    for (size_t i = 0; i < maps.error.size(); ++i) {  // one-sided at the border, and so exact there too
        REQUIRE(maps.error.data[i] == Approx(std::hypot(0.03, 0.02)).epsilon(1e-9));
        REQUIRE(maps.got_energy.data[i] == Approx(0.0025).epsilon(1e-9));
        REQUIRE(maps.truth_energy.data[i] == Approx(0.0004).epsilon(1e-9));
    }
    CHECK(gradient_maps(Grid<double>(1, 1, 0.5), Grid<double>(1, 1, 0.2)).error.data[0] == 0);
}

TEST_CASE("FLIP at the ends of its scale", "[score][flip]") {
    // Equal images: nothing. Green against blue is the largest color difference there is: exactly 1, as the scale is
    // defined by it. Black against white is a step of 100 in lightness.
    const ColorImage t = textured(40, 30, 8);
    for (const float v : flip_map(t, t).data) REQUIRE(v == 0);
    for (const float v : flip_map(constant(40, 30, {0, 1, 0}), constant(40, 30, {0, 0, 1})).data)
        REQUIRE(v == Approx(1).epsilon(1e-5));
    for (const float v : flip_map(constant(40, 30, {0, 0, 1}), constant(40, 30, {0, 1, 0})).data)
        REQUIRE(v == Approx(1).epsilon(1e-5));
    // Lightness 100 apart: 100^0.7 = 25.119 against cmax = hyab(green, blue)^0.7 = 41.277, beyond the bend at 0.4.
    const double most = 41.27706, d = std::pow(100.0, 0.7), bend = 0.4 * most;
    for (const float v : flip_map(constant(40, 30, glm::vec3(1)), constant(40, 30, glm::vec3(0))).data)
        REQUIRE(v == Approx(0.95 + (d - bend) / (most - bend) * 0.05).epsilon(1e-4));
    // A pixel that differs is seen around it and no farther than the filters reach (10 px).
    ColorImage spot = constant(61, 61, glm::vec3(0.5f));
    spot.at(30, 30) = glm::vec3(1);
    const Grid<float> map = flip_map(spot, constant(61, 61, glm::vec3(0.5f)));
    CHECK(map.at(30, 30) > 0.05f);
    CHECK(map.at(41, 30) < 1e-3f);
    CHECK(map.at(30, 30) > map.at(33, 30));
    CHECK(map.at(27, 30) == Approx(map.at(33, 30)).epsilon(1e-4));
    CHECK_THROWS_AS(flip_map(t, constant(40, 31, glm::vec3(0))), Error);
    CHECK_THROWS_AS(flip_map(t, t, 0), Error);
}

TEST_CASE("regions by hand", "[score][regions]") {
    Grid<uint8_t> klass(8, 2);
    Grid<int8_t> source(8, 2);
    const int row[8] = {0, 0, 1, 2, 3, 4, 4, 0}, from[8] = {0, 0, 1, 1, -1, -1, -1, 0};
    for (int y = 0; y < 2; ++y)
        for (int x = 0; x < 8; ++x) klass.at(x, y) = uint8_t(row[x]), source.at(x, y) = int8_t(from[x]);
    const auto bits = [&](const std::string& name, int band) {
        for (const Region& r : regions_of(klass, source, band))
            if (r.name == name) {
                std::string text;
                for (int x = 0; x < 8; ++x) text += r.mask.at(x, 1) ? '1' : '0';
                return text;
            }
        return std::string("none");
    };
    CHECK(bits("all", 1) == "11111111");
    CHECK(bits("own", 1) == "11000001");
    CHECK(bits("neighbour", 1) == "00110000");
    CHECK(bits("visible", 1) == "11110001");
    CHECK(bits("hole", 1) == "00001110");
    CHECK(bits("hole_disoccluded", 1) == "00001000");
    CHECK(bits("hole_outside", 1) == "00000110");
    CHECK(bits("lost", 1) == "00111110");
    CHECK(bits("seam_band", 0) == "01111011");
    CHECK(bits("seam_band", 1) == "11111111");
}

TEST_CASE("a region's scores are the image's where the region is all of it", "[score][regions]") {
    const ColorImage got = textured(190, 180, 1), truth = textured(190, 180, 2);
    const ImageMaps maps = compare_images(got, truth);
    const RegionScore all = score_region(maps);
    const ColorImage a = srgb_from_linear(got), b = srgb_from_linear(truth);
    CHECK(all.pixels == 190 * 180);
    CHECK(all.psnr_db() == Approx(psnr_db(a, b)).epsilon(1e-9));
    CHECK(all.ssim / double(all.pixels) == Approx(ssim(a, b)).epsilon(1e-9));
    Mask half(190, 180);
    for (int y = 0; y < 180; ++y)
        for (int x = 0; x < 95; ++x) half.at(x, y) = 1;
    CHECK(score_region(maps, &half).psnr_db() == Approx(psnr_db(a, b, &half)).epsilon(1e-9));
    const Mask none(190, 180);
    CHECK(std::isnan(score_region(maps, &none).psnr_db()));
    CHECK(std::isinf(score_region(compare_images(got, got)).psnr_db()));
    // A got image that is the mean everywhere has no gradients at all.
    CHECK(score_region(compare_images(constant(190, 180, glm::vec3(0.3f)), truth)).sharpness() ==
          Approx(0).margin(1e-9));
    const auto bytes = [&] {
        const RegionScore s = score_region(compare_images(got, truth));
        return std::vector<double>{s.squared_error, s.ssim, s.flip, s.gradient_error, s.ms_ssim};
    };
    std::vector<double> one;
    {
        tbb::global_control single(tbb::global_control::max_allowed_parallelism, 1);
        one = bytes();
    }
    tbb::global_control several(tbb::global_control::max_allowed_parallelism, 4);
    CHECK(bytes() == one);
}

TEST_CASE("bootstrap over frames", "[score][bootstrap]") {
    CHECK(!bootstrap({{3, 1}}));
    CHECK(!bootstrap({{3, 1}, {0, 0}}));
    const auto same = bootstrap({{2, 1}, {4, 2}, {6, 3}});  // the same mean in every frame
    REQUIRE(same);
    CHECK((same->low == 2 && same->high == 2));
    // Two frames, 0 and 1: a quarter of the draws is all 0 and a quarter all 1.
    const auto two = bootstrap({{0, 1}, {1, 1}});
    CHECK((two->low == 0 && two->high == 1));
    // Many frames of 0 and 1: near the normal interval 0.5 +- 1.96 * 0.5 / sqrt(n).
    std::vector<FrameSum> many;
    for (int i = 0; i < 400; ++i) many.push_back({double(i % 2), 1});
    const auto wide = bootstrap(many);
    CHECK(wide->low == Approx(0.5 - 1.96 * 0.5 / 20).margin(0.006));
    CHECK(wide->high == Approx(0.5 + 1.96 * 0.5 / 20).margin(0.006));
    CHECK(bootstrap(many, 7)->low == bootstrap(many, 7)->low);
    // A frame counts by its pixels.
    CHECK(bootstrap({{0, 1e9}, {1, 1}})->low < 1e-6);
}

TEST_CASE("correspondence of two planes is the closed form", "[score][temporal]") {
    // A card at 4 m before a wall at 10 m; the camera moves 1 m to the left: the wall moves 32 px to the right, the
    // card 80, and what the card hides has no match.
    const minimal::MinimalScene s = minimal::make_scene("box");
    const minimal::View a = s.recorded(s.own), b = s.shifted(s.shift, s.own);
    const minimal::Picture pa = minimal::render(s.world, a), pb = minimal::render(s.world, b);
    const Correspondence c =
        correspond({a.intrinsics, a.world_from_cam, pa.depth}, {b.intrinsics, b.world_from_cam, pb.depth});
    size_t wall = 0, card = 0, wrong = 0, lost_wall = 0;
    for (int y = 20; y < 220; ++y)
        for (int x = 0; x < 320; ++x) {
            const float z = pa.depth.at(x, y);
            if (c.matched.at(x, y)) {
                const float moved = c.place_px.at(x, y).x - (float(x) + 0.5f);
                wrong += std::abs(moved - (z < 7 ? 80.0f : 32.0f)) > 1e-3f ||
                         std::abs(c.place_px.at(x, y).y - (float(y) + 0.5f)) > 1e-3f;
                (z < 7 ? card : wall) += 1;
            } else {
                lost_wall += z > 7;
            }
        }
    CHECK(wrong == 0);
    CHECK(card >= 38 * 38);                  // all but its rim
    CHECK(lost_wall >= 200 * 32 + 40 * 40);  // left the frame, or behind the card
    CHECK(lost_wall <= 200 * 33 + 42 * 42 + 200);
    CHECK(wall + card + lost_wall <= 200 * 320);
    // Zero motion: every pixel matches itself but those beside a tear.
    const Correspondence own =
        correspond({a.intrinsics, a.world_from_cam, pa.depth}, {a.intrinsics, a.world_from_cam, pa.depth});
    size_t matched = 0;
    for (size_t i = 0; i < own.matched.size(); ++i) matched += own.matched.data[i];
    CHECK(matched > own.matched.size() * 99 / 100);
}

TEST_CASE("warping error, flicker and their floors", "[score][temporal]") {
    const int w = 64, h = 48;
    const Intrinsics k{w, h, 64, 64, 32, 24};
    const DepthMap depth(w, h, 8.0f);
    Pose moved;
    moved.translation_m = {1, 0, 0};  // 64 * 1 / 8 = 8 px
    const Correspondence c = correspond({k, Pose{}, depth}, {k, moved, depth});
    ColorImage first(w, h), second(w, h);
    for (int y = 0; y < h; ++y)
        for (int x = 0; x < w; ++x) {
            first.at(x, y) = glm::vec3(0.2f + 0.005f * float(x));
            second.at(x, y) = glm::vec3(0.2f + 0.005f * float(x + 8));
        }
    const ConsistencyScore still = score_consistency(c, first, second, first, second);
    CHECK(still.pixels == size_t(h) * size_t(w - 8));
    CHECK(still.difference / double(still.pixels) == Approx(0).margin(1e-6));
    CHECK(still.flicker == 0);
    const auto brighter = [](ColorImage image, float by) {
        for (auto& p : image.data) p += by;
        return image;
    };
    // An error that stays is no flicker; one that comes and goes is.
    const ConsistencyScore steady = score_consistency(c, brighter(first, 0.1f), brighter(second, 0.1f), first, second);
    CHECK(steady.flicker / double(steady.pixels) == Approx(0).margin(1e-6));
    const ConsistencyScore changed = score_consistency(c, brighter(first, 0.1f), second, first, second);
    CHECK(changed.flicker / double(changed.pixels) == Approx(0.1).epsilon(1e-4));
    CHECK(changed.difference / double(changed.pixels) == Approx(0.1).epsilon(1e-4));
    CHECK(changed.truth_difference / double(changed.pixels) == Approx(0).margin(1e-6));
    const Mask none(w, h);
    CHECK(score_consistency(c, first, second, first, second, &none).pixels == 0);
    const DepthMap sky(w, h, std::numeric_limits<float>::infinity());
    const Correspondence far = correspond({k, Pose{}, sky}, {k, moved, sky});
    size_t matched = 0;
    for (const uint8_t m : far.matched.data) matched += m;
    CHECK(matched == size_t(w) * size_t(h));
    CHECK(correspond({k, Pose{}, sky}, {k, moved, depth}).matched.data == Mask(w, h).data);
}
