// SPDX-License-Identifier: Apache-2.0
// What the rays of a hole's pixel meet, and the network that mixes it.
#include <cmath>

#include "inpaint/model.h"
#include "tests/catch.h"

using namespace vshift;
using namespace vshift::inpaint;

namespace {

struct Picture {
    int width, height;
    std::vector<float> fill, hole, inverse_depth;
    RayPlanes planes() const { return {width, height, fill.data(), hole.data(), inverse_depth.data()}; }
    size_t at(int x, int y) const { return size_t(y) * size_t(width) + size_t(x); }
};

/// Red left of the hole at 4 m, blue right of it at 20 m; the hole from column `from` to `to`, over all rows.
Picture two_walls(int width, int height, int from, int to) {
    Picture p{width, height, {}, {}, {}};
    const size_t n = size_t(width) * size_t(height);
    p.fill.assign(3 * n, 0);
    p.hole.assign(n, 0);
    p.inverse_depth.assign(n, 0);
    for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x) {
            const size_t i = p.at(x, y);
            p.fill[(x < from ? 0 : 2) * n + i] = 1;
            p.hole[i] = x >= from && x <= to;
            if (p.hole[i] == 0) p.inverse_depth[i] = x < from ? 0.25f : 0.05f;
        }
    return p;
}

Views views_of(const Picture& p) {
    const auto tensor = [&](const std::vector<float>& v, int64_t channels) {
        return at::from_blob(const_cast<float*>(v.data()), {1, channels, 1, p.height, p.width}, at::kFloat).clone();
    };
    Views v;
    v.fill = tensor(p.fill, 3);
    v.hole = tensor(p.hole, 1);
    v.neighbor = at::zeros_like(v.hole);
    v.inverse_depth = tensor(p.inverse_depth, 1);
    return v;
}

}  // namespace

TEST_CASE("rays: the first known pixels of a strip, by hand", "[rays]") {
    const Picture p = two_walls(20, 9, 8, 12);
    const RayNumbers seen = ray_numbers_of(p.planes(), {int32_t(p.at(9, 4))});
    const auto ray = [&](size_t k) { return seen.rays.data() + k * ray_numbers; };
    const auto check = [&](size_t k, bool red, float far) {
        CAPTURE(k);
        CHECK(ray(k)[0] == (red ? 1.0f : -1.0f));
        CHECK(ray(k)[2] == (red ? -1.0f : 1.0f));
        CHECK(ray(k)[3] == ray(k)[0]);
        CHECK(ray(k)[6] == Approx(red ? 2.0 : 0.4));
        CHECK(ray(k)[8] == Approx(std::log((red ? 0.25 : 0.05) + 0.005)));
        CHECK(ray(k)[10] == Approx(std::log(1.0 + double(far))));
        CHECK(ray(k)[12] == 1);
    };
    check(0, false, 4);                      // 9 -> 13
    check(8, true, 2);                       // 9 -> 7
    check(2, false, 4 * std::sqrt(2.0f));    // row 8, the last one
    check(1, false, 2 * std::sqrt(5.0f));    // (2, 1) twice
    check(5, true, 2 * std::sqrt(5.0f));   // (-1, 2) twice: row 8
    check(11, true, 2 * std::sqrt(5.0f));
    for (const size_t k : {3, 4, 12, 13})  // the image ends before
        for (size_t j = 0; j < ray_numbers; ++j) CHECK(ray(k)[j] == 0);
    CHECK(seen.own[3] == Approx(0));
    CHECK(seen.own[4] == Approx(std::fabs(2 * 9.5 / 20 - 1)));
}

TEST_CASE("rays: the mirrored image gives the mirrored rays", "[rays]") {
    Picture p = two_walls(23, 11, 7, 13), q = p;
    const size_t n = p.hole.size();
    for (size_t i = 0; i < 3 * n; ++i) p.fill[i] = float((i * 2654435761u >> 8) % 1000) / 1000;
    for (int y = 0; y < p.height; ++y)
        for (int x = 0; x < p.width; ++x) {
            const size_t from = p.at(p.width - 1 - x, y), to = p.at(x, y);
            for (size_t c = 0; c < 3; ++c) q.fill[c * n + to] = p.fill[c * n + from];
            q.hole[to] = p.hole[from];
            q.inverse_depth[to] = p.inverse_depth[from];
        }
    const RayNumbers a = ray_numbers_of(p.planes(), {int32_t(p.at(10, 6))});
    const RayNumbers b = ray_numbers_of(q.planes(), {int32_t(q.at(p.width - 1 - 10, 6))});
    for (size_t k = 0; k < ray_count; ++k)
        for (size_t j = 0; j < ray_numbers; ++j) CHECK(a.rays[k * ray_numbers + j] == b.rays[mirrored_ray(k) * ray_numbers + j]);
    for (size_t j = 0; j < own_numbers; ++j) CHECK(a.own[j] == Approx(b.own[j]));
}

TEST_CASE("pixel_rays: begins as a mean that the fill leads, and leaves known pixels alone bit for bit", "[rays][model]") {
    const Picture p = two_walls(20, 9, 8, 12);
    ModelConfig config;
    config.kind = Kind::pixel_rays;
    const Model model = initial_model(config, 1);
    const Views v = views_of(p);
    Stream stream;
    const Tensor out = inpaint::inpaint(model, v, 1, 1, stream);
    const Tensor known = (v.hole == 0).expand_as(out);
    CHECK(at::equal(out.masked_select(known), v.fill.masked_select(known)));
    // At (9, 4): the fill (blue) with e^3, each ray that meets something with 1.
    const RayNumbers seen = ray_numbers_of(p.planes(), {int32_t(p.at(9, 4))});
    double red = 0, met = 0;
    for (size_t k = 0; k < ray_count; ++k)
        if (seen.rays[k * ray_numbers + 12] > 0) {
            met += 1;
            red += (double(seen.rays[k * ray_numbers + 3]) + 1) / 2;
        }
    REQUIRE(red > 2);
    CHECK(out[0][0][0][4][9].item<double>() == Approx(red / (met + std::exp(3.0))).epsilon(1e-5));
    CHECK(out[0][2][0][4][9].item<double>() == Approx(1 - red / (met + std::exp(3.0))).epsilon(1e-5));
    // Training sees the same: the velocity at its only time is the way back from what is made to the fill.
    const Tensor input = at::cat({at::from_blob(const_cast<float*>(seen.rays.data()), {1, ray_count * ray_numbers}, at::kFloat),
                                  at::from_blob(const_cast<float*>(seen.own.data()), {1, own_numbers}, at::kFloat)}, 1)
                             .view({1, -1, 1, 1, 1});
    const Tensor back = velocity(model, model.weights, at::zeros({1, 3, 1, 1, 1}), at::ones({1}), input);
    for (int64_t c = 0; c < 3; ++c)
        CHECK(-back[0][c].item<double>() / config.residual_scale ==
              Approx((out[0][c][0][4][9] - v.fill[0][c][0][4][9]).item<double>()).margin(1e-6));
}

TEST_CASE("pixel_rays: what does not fit is refused", "[rays][model]") {
    CHECK_THROWS_AS(parse_model_config(R"({"kind":"pixel_rays","flow":true})", "m"), Error);
    CHECK_THROWS_AS(parse_model_config(R"({"kind":"pixel_rays","rays":{"dim":0}})", "m"), Error);
    CHECK_THROWS_AS(parse_model_config(R"({"kind":"pixel_rays","rays":{"width":8}})", "m"), Error);
    ModelConfig config;
    config.kind = Kind::pixel_rays;
    Views v = views_of(two_walls(8, 4, 3, 4));
    v.target = v.fill;
    CHECK_THROWS_AS(prepare(initial_model(config, 1), v), Error);  // no rays of drawn pixels
}
