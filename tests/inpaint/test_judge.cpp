// SPDX-License-Identifier: Apache-2.0
// Texture distance against closed forms; what the arms' training pairs are made of. No Torch here.
#include <cmath>
#include <random>

#include "inpaint/street_pairs.h"
#include "inpaint/texture.h"
#include "tests/catch.h"

using namespace vshift;
using namespace vshift::inpaint;

namespace {

constexpr int side = 16;

/// Gray planes of a function of the pixel.
template <class F>
std::vector<float> gray(int width, int height, F value) {
    std::vector<float> planes;
    for (int c = 0; c < 3; ++c)
        for (int y = 0; y < height; ++y)
            for (int x = 0; x < width; ++x) planes.push_back(float(value(x, y)));
    return planes;
}

double mean_of(const std::vector<float>& v) {
    double sum = 0;
    for (const float x : v) sum += double(x);
    return sum / double(v.size());
}

}  // namespace

TEST_CASE("Frechet distance: closed forms", "[texture]") {
    // Axes apart: the means' distance and that of the standard deviations.
    CHECK(frechet_distance({1, 2}, {4, 0, 0, 9}, {1, 2}, {4, 0, 0, 9}) == Approx(0).margin(1e-12));
    CHECK(frechet_distance({1, 2}, {4, 0, 0, 9}, {4, 6}, {1, 0, 0, 25}) == Approx(9 + 16 + 1 + 4));
    // Turned by any angle: the same.
    const double c = std::cos(0.7), s = std::sin(0.7);
    const auto turned = [&](double a, double b) {
        return std::vector<double>{c * c * a + s * s * b, c * s * (a - b), c * s * (a - b), s * s * a + c * c * b};
    };
    CHECK(frechet_distance({0, 0}, turned(4, 9), {0, 0}, turned(1, 25)) == Approx(1 + 4));
    // Covariances that do not commute: of 2 x 2, tr (AB)^1/2 = sqrt(tr AB + 2 sqrt(det AB)).
    const std::vector<double> a{2, 1, 1, 3}, b{5, -2, -2, 1.5};
    const double trace = 2 * 5 + 2 * (1 * -2) + 3 * 1.5, det = (2 * 3 - 1) * (5 * 1.5 - 4);
    const double expected = 5 + 6.5 - 2 * std::sqrt(trace + 2 * std::sqrt(det));
    CHECK(frechet_distance({0, 0}, a, {0, 0}, b) == Approx(expected));
    CHECK(frechet_distance({0, 0}, b, {0, 0}, a) == Approx(expected));
    CHECK(frechet_distance({0, 0}, {1, 1, 1, 1}, {0, 0}, {0, 0, 0, 0}) == Approx(2));  // of no rank
}

TEST_CASE("texture: the features of known patches", "[texture]") {
    const auto flat = texture_at(gray(side, side, [](int, int) { return 0.25; }), side, side, 4, 8);
    CHECK(flat[0] == Approx(0.25));
    for (size_t i = 1; i < texture_features; ++i) CHECK(flat[i] == Approx(0).margin(1e-7));
    // A cosine of the inner 4x4's grid is one coefficient. The basis is orthonormal: it is the patch's norm, 0.1
    // sqrt(16 / 2).
    const auto wave =
        texture_at(gray(side, side, [](int x, int) { return 0.5 + 0.1 * std::cos(M_PI * (x - 4 + 0.5) * 2 / 4); }),
                   side, side, 4, 4);
    for (size_t i = 3; i < 18; ++i) CHECK(wave[i] == Approx(i == 4 ? 0.1 * std::sqrt(8.0) : 0).margin(1e-6));
    // Rows and columns are told apart, and a mirrored edge is the same edge.
    const auto step = [](bool down, bool mirrored) {
        return texture_at(gray(side, side, [=](int x, int y) { return ((down ? y : x) >= 6) != mirrored ? 0.8 : 0.2; }),
                          side, side, 4, 4);
    };
    const auto a = step(false, false), b = step(false, true), d = step(true, false);
    CHECK(a[3] == Approx(b[3]));
    CHECK(a[3] == Approx(d[6]));
    CHECK(a[6] == Approx(0).margin(1e-6));
    // Red is above its luma in Cr, blue in Cb.
    std::vector<float> red(3 * side * side, 0);
    std::fill_n(red.begin(), side * side, 1.0f);
    const auto r = texture_at(red, side, side, 4, 4);
    CHECK(r[0] == Approx(0.299));
    CHECK(r[1] == Approx(-0.169).margin(1e-3));
    CHECK(r[2] == Approx(0.5).margin(1e-3));
}

TEST_CASE("texture: blur and noise are far from the truth, another part of it is near", "[texture]") {
    const int width = 128, height = 96;
    std::mt19937 random(3);
    std::normal_distribution<double> normal(0, 0.1);
    const auto texture = [&] {
        return gray(width, height,
                    [&](int x, int y) { return 0.5 + 0.2 * std::sin(x * 0.9) * std::cos(y * 0.5) + normal(random); });
    };
    const auto truth = texture(), other = texture();
    auto noisy = truth, blurred = truth;
    for (float& v : noisy) v += float(2 * normal(random));
    for (size_t i = 0; i < truth.size(); ++i)
        blurred[i] = 0.5f * truth[i] + 0.25f * (truth[i - (i > 0)] + truth[std::min(i + 1, truth.size() - 1)]);
    const Mask mask(width, height, 1);
    const TextureMoments of_truth = texture_moments(truth, mask);
    CHECK(of_truth.count == (width / 4 - 2) * (height / 4 - 2));
    CHECK(texture_distance(of_truth, of_truth) == Approx(0).margin(1e-6));
    const double near = texture_distance(texture_moments(other, mask), of_truth);
    CHECK(texture_distance(texture_moments(noisy, mask), of_truth) > 5 * near);
    CHECK(texture_distance(texture_moments(blurred, mask), of_truth) > 5 * near);
    // Sums of parts are the whole; nothing in the mask, nothing to say.
    Mask left = mask, right = mask;
    for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x) (x < width / 2 ? right : left).at(x, y) = 0;
    TextureMoments sum = texture_moments(truth, left);
    sum.add(texture_moments(truth, right));
    CHECK(sum.count == of_truth.count);
    CHECK(texture_distance(sum, of_truth) == Approx(0).margin(1e-6));
    CHECK(std::isnan(texture_distance(texture_moments(truth, Mask(width, height)), of_truth)));
}

TEST_CASE("training pairs: a rig in another lane sees what a shifted camera sees", "[pairs]") {
    const analytic::StreetScene street = analytic::build_street(3);
    const RecordedViews middle = record_frame(street, 20, 96), left = record_frame(street, 20, 96, 2.5);
    REQUIRE(left.views.size() == middle.views.size());
    Shift shift;
    shift.translation_m = {0, 2.5, 0};
    const TrueShiftedView there = true_shifted_view(street, middle, 1, 20, shift, false);
    CHECK(display_planes(left.views[1].color) == there.planes.target);
    const RecordedViews lanes = record_streets({3, 4}, 2, 64, 4, [](size_t, size_t) {});
    for (size_t i = 0; i < lanes.views.size(); ++i) {
        CHECK(std::abs(lanes.views[i].lane_m) <= 4);
        CHECK(lanes.views[i].lane_m == lanes.views[i - i % lanes.rig_size].lane_m);
        if (i >= lanes.rig_size) CHECK(lanes.views[i].lane_m != lanes.views[i - lanes.rig_size].lane_m);
    }
}

TEST_CASE("training pairs: what each arm is made of", "[pairs]") {
    const RecordedViews recorded = record_streets({3}, 1, 128, 0, [](size_t, size_t) {});
    REQUIRE(recorded.views.size() == recorded.rig_size);
    size_t neighbors = 0, resampled = 0, unknown = 0;
    for (uint64_t number = 0; number < 12; ++number) {
        const PairPlanes plain = training_pair(recorded, 1, number, 0, Arm::virtual_shift);
        const PairPlanes seam = training_pair(recorded, 1, number, 0, Arm::seam);
        const PairPlanes twice = training_pair(recorded, 1, number, 0, Arm::double_warp);
        const PairPlanes splat = training_pair(recorded, 1, number, 0, Arm::extrapolation);
        const size_t n = plain.hole.size();
        REQUIRE(mean_of(plain.neighbor) == 0);
        REQUIRE(mean_of(plain.hole) > 0);
        // The same view and shift; what was lost is now a neighbour's or still a hole.
        REQUIRE(seam.target == plain.target);
        double error = 0, far = 0;
        for (size_t i = 0; i < n; ++i) {
            REQUIRE(seam.hole[i] + seam.neighbor[i] == plain.hole[i]);
            REQUIRE(twice.hole[i] + twice.neighbor[i] >= plain.hole[i]);
            for (size_t c = 0; c < 3; ++c) {
                const size_t at = c * n + i;
                if (!plain.hole[i]) REQUIRE(plain.fill[at] == plain.target[at]);
                if (!twice.hole[i] && !twice.neighbor[i]) resampled += twice.fill[at] != twice.target[at];
                if (seam.neighbor[i]) {  // a neighbour's picture of the same surface, not a guess
                    error += std::pow(double(seam.fill[at] - seam.target[at]), 2);
                    far += std::pow(double(plain.fill[at] - plain.target[at]), 2);
                }
            }
            neighbors += seam.neighbor[i] > 0;
            unknown += splat.hole[i] > 0 && splat.weight[i] == 0;
            if (!splat.hole[i]) REQUIRE(splat.weight[i] == 0);
        }
        if (far > 0) CHECK(error < far);
    }
    CHECK(neighbors > 100);
    CHECK(resampled > 100);
    CHECK(unknown > 100);
}
