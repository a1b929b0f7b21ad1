// SPDX-License-Identifier: Apache-2.0
// Depth from one picture: where pixels look, what an untrained network says, and its loss, in closed form.
#include <cmath>

#include "inpaint/depth_net.h"
#include "inpaint/depth_pairs.h"
#include "inpaint/model.h"
#include "tests/catch.h"

using namespace vshift;
using namespace vshift::inpaint;

namespace {

/// Looks along the ego's x axis from 1.5 m above the ground.
DepthCamera forward(double focal_px, int width, int height) {
    return {focal_px, focal_px, width / 2.0, height / 2.0, {0, 0, 1, -1, 0, 0, 0, -1, 0}, 1.5};
}

DepthConfig small() {
    DepthConfig c;
    c.unet.widths = {8, 12};
    return c;
}

}  // namespace

TEST_CASE("depth: rays look where the camera looks, and know the ground's depth", "[depth]") {
    const Tensor rays = depth_rays(forward(100, 80, 60), 60, 80);
    const auto at = [&](int64_t channel, int64_t y, int64_t x) { return rays[0][channel][y][x].item<double>(); };
    CHECK(at(0, 29, 39) == Approx(1).epsilon(1e-4));   // the middle: straight ahead
    CHECK(at(1, 30, 10) > 0.2);                        // on the picture's left is the ego's left
    CHECK(at(2, 59, 40) < -0.2);                       // its lower border looks down
    CHECK(at(3, 59, 40) == Approx(0.295 / 1.5));       // 29.5 px below the horizon: z = 1.5 m * 100 px / 29.5 px
    CHECK(at(3, 0, 40) == Approx(-0.295 / 1.5));
    const Tensor norm = rays.narrow(1, 0, 3).pow(2).sum(1);
    CHECK((norm - 1).abs().max().item<double>() < 1e-6);
}

TEST_CASE("depth: before it learns, a network sees an empty road", "[depth]") {
    const DepthModel m = initial_depth_model(small(), 1);
    const Tensor color = noise({1, 3, 45, 70}, 3, 0).sigmoid();  // no multiple of anything
    const Tensor z = depth_of(m, color, forward(100, 70, 45));
    REQUIRE(z.size(0) == 45);
    REQUIRE(z.size(1) == 70);
    CHECK(z[44][10].item<double>() == Approx(1.5 * 100 / 22).epsilon(1e-4));
    CHECK(z[2][10].item<double>() == Approx(40).epsilon(1e-4));
    // Twice as large a picture than it works at, of the same camera: the same, between its pixels.
    DepthModel half = m;
    half.config.width = 64;
    const Tensor wide = depth_of(half, at::ones({1, 3, 96, 128}), forward(200, 128, 96));
    CHECK(wide[90][64].item<double>() == Approx(1.5 * 200 / 42.5).epsilon(2e-2));
    CHECK(wide[2][64].item<double>() == Approx(40).epsilon(1e-4));
}

TEST_CASE("depth: the loss counts scale by half, edges and sky", "[depth]") {
    const Tensor inverse = noise({2, 1, 12, 16}, 5, 0).sigmoid() * 0.3 + 0.02;
    const Tensor no_sky = at::full_like(inverse, -20);
    const auto loss = [&](const Tensor& log_inverse, const Tensor& sky, const Tensor& truth) {
        return depth_loss({log_inverse, sky}, truth).item<double>();
    };
    CHECK(loss(inverse.log(), no_sky, inverse) < 2e-3);
    // A wrong scale: sqrt(c^2 - c^2 / 2), and no wrong slope.
    CHECK(loss(inverse.log() + 0.4, no_sky, inverse) == Approx(0.4 / std::sqrt(2.0)).epsilon(1e-3));
    // One wrong pixel weighs more than its square: its four neighbours' slopes are wrong too.
    Tensor one = inverse.log().clone();
    one[0][0][5][5] += 1;
    CHECK(loss(one, no_sky, inverse) > 0.5 * std::sqrt(1.0 / 192) + 0.001);
    // The same wrong step counts five times where the truth has a silhouette: 1, 2 and 4 of 16 columns.
    const Tensor flat = at::full_like(inverse, 0.1);
    Tensor broken = flat.clone(), wrong = at::zeros_like(flat);
    broken.narrow(3, 8, 8).fill_(0.05);
    wrong.narrow(3, 8, 8).fill_(0.4);
    CHECK(loss(broken.log() + wrong, no_sky, broken) - loss(flat.log() + wrong, no_sky, flat) ==
          Approx(4 * 0.4 / 6 * (1 / 15.0 + 2 / 14.0 + 4 / 12.0)).epsilon(1e-4));
    // Where the truth is sky depth does not count, saying so does.
    Tensor open = inverse.clone();
    open.narrow(2, 0, 6).fill_(0);
    Tensor guess = inverse.log().clone();
    guess.narrow(2, 0, 6).fill_(3);
    const Tensor right = at::where(open > 0, at::full_like(open, -20), at::full_like(open, 20));
    CHECK(loss(guess, right, open) < 2e-3);
    CHECK(loss(guess, -right, open) > 3);
    const Tensor leaf = inverse.log().clone().requires_grad_(true);
    const auto g = torch::autograd::grad({depth_loss({leaf + 0.1, no_sky}, inverse)}, {leaf});
    CHECK(g[0].sum().item<double>() > 0);  // too near: 1/z must fall
}

TEST_CASE("depth: a mirrored sample is the mirrored street's", "[depth]") {
    const auto views = record_depth_views({3}, 1, 64, [](size_t, size_t) {});
    REQUIRE(views.size() == 6);
    const auto rays = [](const DepthPlanes& p) {
        const vshift_depth_view v = p.view();
        DepthCamera c{v.fx, v.fy, v.cx, v.cy, {}, v.height_m};
        std::copy(v.ego_from_cam, v.ego_from_cam + 9, c.ego_from_cam);
        return depth_rays(c, v.height, v.width);
    };
    int mirrored = 0;
    for (uint64_t number = 0; number < 24; ++number) {
        const DepthPlanes s = depth_sample(views, 1, number, 0);
        for (const DepthPlanes& v : views) {
            const Tensor own = rays(v), its = rays(s);
            std::vector<float> flipped = v.inverse_depth;
            for (int y = 0; y < v.height; ++y)
                std::reverse(flipped.begin() + y * v.width, flipped.begin() + (y + 1) * v.width);
            if (s.inverse_depth == v.inverse_depth) CHECK((own - its).abs().max().item<double>() < 1e-6);
            if (s.inverse_depth != flipped) continue;
            ++mirrored;
            Tensor expected = own.flip(3).clone();
            expected.select(1, 1).neg_();  // left is right
            CHECK((expected - its).abs().max().item<double>() < 1e-5);
        }
    }
    CHECK(mirrored > 4);
}
