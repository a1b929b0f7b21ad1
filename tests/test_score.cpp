// SPDX-License-Identifier: Apache-2.0
// Scores against answers worked out by hand.
#include <tbb/global_control.h>

#include <cmath>
#include <limits>

#include "embree_core/score.h"
#include "tests/catch.h"
#include "tests/image_support.h"

using namespace vshift;

namespace {

Mask square(int width, int height, int x0, int y0, int side) {
    Mask mask(width, height);
    for (int y = y0; y < y0 + side; ++y)
        for (int x = x0; x < x0 + side; ++x) mask.at(x, y) = 1;
    return mask;
}

ColorImage constant(int width, int height, float value) {
    return {width, height, glm::vec3(value)};
}

/// SSIM at one pixel by its definition: the whole window at once, no separation.
double ssim_by_definition(const ColorImage& a, const ColorImage& b, int x, int y) {
    const auto luma = [](const glm::vec3& c) { return 0.2126 * c.r + 0.7152 * c.g + 0.0722 * c.b; };
    double sum = 0, ma = 0, mb = 0, va = 0, vb = 0, cov = 0;
    for (int pass = 0; pass < 2; ++pass) {
        for (int j = -5; j <= 5; ++j)
            for (int i = -5; i <= 5; ++i) {
                if (x + i < 0 || y + j < 0 || x + i >= a.width || y + j >= a.height) continue;
                const double w = std::exp(-(i * i + j * j) / (2 * 1.5 * 1.5));
                const double p = luma(a.at(x + i, y + j)), q = luma(b.at(x + i, y + j));
                if (pass == 0)
                    sum += w, ma += w * p, mb += w * q;
                else
                    va += w / sum * (p - ma) * (p - ma), vb += w / sum * (q - mb) * (q - mb),
                        cov += w / sum * (p - ma) * (q - mb);
            }
        if (pass == 0) ma /= sum, mb /= sum;
    }
    return (2 * ma * mb + 1e-4) * (2 * cov + 9e-4) / ((ma * ma + mb * mb + 1e-4) * (va + vb + 9e-4));
}

}  // namespace

TEST_CASE("mask counts and ratios of hand-made masks", "[score]") {
    // Squares of 10 px side, 4 px apart: 60 shared, 40 and 40 not.
    const Mask truth = square(40, 30, 5, 5, 10), got = square(40, 30, 9, 5, 10);
    const MaskScore s = score_mask(got, truth);
    CHECK(s.counts.true_positive == 60);
    CHECK(s.counts.false_positive == 40);
    CHECK(s.counts.false_negative == 40);
    CHECK(s.counts.true_negative == 40 * 30 - 140);
    CHECK(s.iou == 60.0 / 140);
    CHECK(s.precision == 0.6);
    CHECK(s.recall == 0.6);
    CHECK(s.f1 == 0.6);
    Mask half = got;  // any value but 0 is set
    for (auto& v : half.data) v = v ? 255 : 0;
    CHECK(score_mask(half, truth).counts.true_positive == 60);
    Mask valid(40, 30);
    for (int y = 0; y < 30; ++y)
        for (int x = 0; x < 12; ++x) valid.at(x, y) = 1;  // columns 9, 10, 11 are shared
    const MaskScore part = score_mask(got, truth, &valid);
    CHECK(part.counts.true_positive == 30);
    CHECK(part.counts.false_positive == 0);
    CHECK(part.counts.false_negative == 40);
    CHECK(part.precision == 1);
    CHECK(part.recall == 30.0 / 70);
}

TEST_CASE("empty masks: agreement is 1, disagreement 0", "[score]") {
    const Mask empty(20, 20), full = square(20, 20, 0, 0, 20), some = square(20, 20, 5, 5, 4);
    MaskScore s = score_mask(empty, empty);
    CHECK((s.iou == 1 && s.precision == 1 && s.recall == 1 && s.f1 == 1));
    s = score_mask(some, empty);
    CHECK((s.iou == 0 && s.precision == 0 && s.recall == 0 && s.f1 == 0));
    s = score_mask(empty, some);
    CHECK((s.iou == 0 && s.precision == 0 && s.recall == 0 && s.f1 == 0));
    const Mask nothing_valid(20, 20);
    CHECK(score_mask(some, empty, &nothing_valid).iou == 1);
    BoundaryScore b = score_boundary(empty, empty, 1);
    CHECK((b.precision == 1 && b.recall == 1 && b.f1 == 1 && b.got_px == 0));
    b = score_boundary(some, empty, 1);
    CHECK((b.precision == 0 && b.recall == 0 && b.f1 == 0 && b.got_px == 12));
    b = score_boundary(full, full, 1);  // the image's border is no boundary
    CHECK((b.got_px == 0 && b.f1 == 1));
    CHECK_THROWS_AS(score_mask(empty, Mask(20, 21)), Error);
    CHECK_THROWS_AS(score_mask(empty, empty, &static_cast<const Mask&>(Mask(2, 2))), Error);
    CHECK_THROWS_AS(score_boundary(empty, empty, -1), Error);
    CHECK_THROWS_AS(score_boundary(empty, empty, std::numeric_limits<double>::quiet_NaN()), Error);
}

TEST_CASE("boundary of a shifted square, counted by hand", "[score]") {
    // Ring of a 10 px square: 36 px. Moved by 4 px to the right, truth at columns 5-14, got at 9-18,
    // rows 5-14 both. Within 0 px: the columns 9-14 of the top and bottom rows are shared: 12.
    // Within t = 1, 2, 4 px (of got; the mirror image holds for truth):
    //   top and bottom rows: columns 9 to 14+t;
    //   left side, column 9, inner rows 6-13: 4 px from truth's left side, and near truth's top row
    //     (row 5) where row <= 5+t, near its bottom row where row >= 14-t: 2t rows;
    //   right side, column 18: 4 px from truth's right side at every inner row.
    const Mask truth = square(40, 30, 5, 5, 10), got = square(40, 30, 9, 5, 10);
    struct Row {
        double tolerance;
        int matched;
    };
    for (const Row row : {Row{0, 12}, Row{1, 2 * 7 + 2}, Row{2, 2 * 8 + 4}, Row{4, 36}, Row{3.999, 2 * 9 + 6}}) {
        INFO(row.tolerance);
        const BoundaryScore s = score_boundary(got, truth, row.tolerance);
        CHECK(s.got_px == 36);
        CHECK(s.truth_px == 36);
        CHECK(s.precision == row.matched / 36.0);
        CHECK(s.recall == row.matched / 36.0);
        CHECK(s.f1 == Approx(row.matched / 36.0).epsilon(1e-12));
    }
}

TEST_CASE("boundary distances are Euclidean and exact", "[score]") {
    Mask a(60, 60), b(60, 60);
    a.at(20, 20) = 1;
    for (int dy = -7; dy <= 7; ++dy)
        for (int dx = -7; dx <= 7; ++dx) {
            b.data.assign(b.data.size(), 0);
            b.at(20 + dx, 20 + dy) = 1;
            const double distance = std::sqrt(double(dx * dx + dy * dy));
            REQUIRE(score_boundary(a, b, distance).f1 == 1);
            if (distance > 0) REQUIRE(score_boundary(a, b, distance - 1e-6).f1 == 0);
        }
    CHECK(score_boundary(a, b, 1e9).f1 == 1);
}

TEST_CASE("boundary: symmetric, and blind to what is not valid", "[score]") {
    Mask a(80, 50), b(80, 50), valid(80, 50);
    uint32_t seed = 7;
    for (size_t i = 0; i < a.size(); ++i) {
        seed = seed * 1664525u + 1013904223u;
        a.data[i] = (seed >> 16) % 11 == 0, b.data[i] = (seed >> 20) % 9 == 0;
        valid.data[i] = i % 80 < 40;
    }
    const BoundaryScore ab = score_boundary(a, b, 1.5), ba = score_boundary(b, a, 1.5);
    CHECK((ab.precision == ba.recall && ab.recall == ba.precision && ab.f1 == ba.f1));
    const MaskScore mab = score_mask(a, b), mba = score_mask(b, a);
    CHECK((mab.precision == mba.recall && mab.iou == mba.iou));
    const BoundaryScore clean = score_boundary(a, b, 1.5, &valid);
    Mask dirty = a;
    for (size_t i = 0; i < a.size(); ++i)
        if (!valid.data[i]) dirty.data[i] = !dirty.data[i];
    const BoundaryScore same = score_boundary(dirty, b, 1.5, &valid);
    CHECK((clean.precision == same.precision && clean.recall == same.recall && clean.got_px == same.got_px));
}

TEST_CASE("PSNR of a known offset", "[score]") {
    const ColorImage truth = constant(16, 16, 0.25f);
    ColorImage got = constant(16, 16, 0.25f + 0.125f);
    CHECK(psnr_db(got, truth) == Approx(20 * std::log10(8.0)).epsilon(1e-12));
    CHECK(psnr_db(truth, truth) == std::numeric_limits<double>::infinity());
    // One channel off in half of the pixels: a sixth of the squared error.
    got = truth;
    for (int y = 0; y < 8; ++y)
        for (int x = 0; x < 16; ++x) got.at(x, y).g += 0.125f;
    CHECK(psnr_db(got, truth) == Approx(20 * std::log10(8.0) + 10 * std::log10(6.0)).epsilon(1e-12));
    Mask region(16, 16);
    CHECK(std::isnan(psnr_db(got, truth, &region)));
    region.at(3, 3) = 1;  // of three channels one is off
    CHECK(psnr_db(got, truth, &region) == Approx(20 * std::log10(8.0) + 10 * std::log10(3.0)).epsilon(1e-12));
    region = square(16, 16, 0, 8, 8);  // the lower half is equal
    CHECK(std::isinf(psnr_db(got, truth, &region)));
    CHECK(psnr_db(got, truth) == psnr_db(truth, got));
    CHECK_THROWS_AS(psnr_db(got, constant(16, 15, 0)), Error);
}

TEST_CASE("SSIM: identical is 1, a constant offset leaves the luminance term", "[score]") {
    const ColorImage a = textured(37, 29, 3), b = textured(37, 29, 4);
    CHECK(ssim(a, a) == 1);
    const double p = double(0.25f), q = double(0.75f);
    CHECK(ssim(constant(20, 20, 0.25f), constant(20, 20, 0.75f)) ==
          Approx((2 * p * q + 1e-4) / (p * p + q * q + 1e-4)).epsilon(1e-10));
    CHECK(ssim(a, b) == ssim(b, a));
    CHECK(ssim(a, b) < 0.2);
    Mask region(37, 29);
    CHECK(std::isnan(ssim(a, b, &region)));
    double sum = 0;
    for (const auto& [x, y] : {std::pair{0, 0}, {36, 28}, {18, 14}, {3, 27}, {30, 5}}) {
        region.data.assign(region.data.size(), 0);
        region.at(x, y) = 1;
        const double expected = ssim_by_definition(a, b, x, y);
        CHECK(ssim(a, b, &region) == Approx(expected).epsilon(1e-9));
        sum += expected;
    }
    region.data.assign(region.data.size(), 0);
    for (const auto& [x, y] : {std::pair{0, 0}, {36, 28}, {18, 14}, {3, 27}, {30, 5}}) region.at(x, y) = 1;
    CHECK(ssim(a, b, &region) == Approx(sum / 5).epsilon(1e-9));
    CHECK(ssim(constant(1, 1, 0.5f), constant(1, 1, 0.5f)) == 1);
}

TEST_CASE("sRGB at its published points", "[score]") {
    ColorImage linear(2, 1);
    linear.at(0, 0) = {0, 0.0031308f, 0.18f};
    linear.at(1, 0) = {1, 5, -1};
    const ColorImage srgb = srgb_from_linear(linear);
    CHECK(srgb.at(0, 0).r == 0);
    CHECK(srgb.at(0, 0).g == Approx(0.04045).epsilon(1e-4));
    CHECK(srgb.at(0, 0).b == Approx(0.46135613).epsilon(1e-6));
    CHECK(srgb.at(1, 0).r == 1);
    CHECK(srgb.at(1, 0).g == 1);
    CHECK(srgb.at(1, 0).b == 0);
    linear.at(0, 0).r = std::numeric_limits<float>::quiet_NaN();
    CHECK(std::isnan(srgb_from_linear(linear).at(0, 0).r));
}

TEST_CASE("one thread and many give the same bytes", "[score]") {
    const ColorImage a = textured(333, 217, 3), b = textured(333, 217, 4);
    Mask m(333, 217), n(333, 217);
    for (size_t i = 0; i < m.size(); ++i) m.data[i] = a.data[i].r > 0.8f, n.data[i] = b.data[i].r > 0.7f;
    const auto all = [&] {
        const BoundaryScore s = score_boundary(m, n, 1.5);
        return std::vector<double>{psnr_db(a, b),
                                   ssim(a, b, &m),
                                   ssim(a, b),
                                   s.precision,
                                   s.recall,
                                   score_mask(m, n).iou,
                                   double(srgb_from_linear(a).at(100, 100).g)};
    };
    std::vector<double> one;
    {
        tbb::global_control single(tbb::global_control::max_allowed_parallelism, 1);
        one = all();
    }
    tbb::global_control several(tbb::global_control::max_allowed_parallelism, 4);
    for (int round = 0; round < 3; ++round) CHECK(all() == one);
}
