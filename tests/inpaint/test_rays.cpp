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

/// As training takes it.
std::vector<float> seen_from(const Picture& p, int x, int y) {
    std::vector<float> seen(seen_numbers);
    write_seen(ray_numbers_of(p.planes(), {int32_t(p.at(x, y))}), 0, seen.data());
    return seen;
}

Tensor tensor_of(const std::vector<float>& seen) {
    return at::from_blob(const_cast<float*>(seen.data()), {1, seen_numbers}, at::kFloat).clone();
}

}  // namespace

TEST_CASE("rays: the first known pixels of a strip, by hand", "[rays]") {
    const Picture p = two_walls(20, 9, 8, 12);
    const std::vector<float> seen = seen_from(p, 9, 4);
    const auto ray = [&](size_t k) { return seen.data() + k * ray_numbers; };
    const auto check = [&](size_t k, bool red, float far, double pixels) {
        CAPTURE(k);
        for (const size_t color : {0, 3, 10, 14, 18, 22, 25}) {
            CHECK(ray(k)[color] == (red ? 1.0f : -1.0f));
            CHECK(ray(k)[color + 2] == (red ? -1.0f : 1.0f));
        }
        for (const size_t near : {6, 7, 13, 17, 21, 31}) CHECK(ray(k)[near] == Approx(red ? 2.0 : 0.4));
        CHECK(ray(k)[8] == Approx(std::log((red ? 0.25 : 0.05) + 0.005)));
        CHECK(ray(k)[28] == Approx(std::log(pixels) / 3));
        CHECK(ray(k)[29] == Approx(std::log(1.0 + double(far))));
        CHECK(ray(k)[30] == Approx(1 / (1.0 + double(far))));
        CHECK(ray(k)[32] == 1);
    };
    check(0, false, 4, 7);                      // 9 -> 13
    check(8, true, 2, 8);                       // 9 -> 7
    check(2, false, 4 * std::sqrt(2.0f), 1);    // row 8, the last one
    check(1, false, 2 * std::sqrt(5.0f), 3);    // (2, 1) twice; columns 13, 15, 17, rows 6, 7, 8
    check(5, true, 2 * std::sqrt(5.0f), 1);     // (-1, 2) twice: row 8
    check(11, true, 2 * std::sqrt(5.0f), 1);
    for (const size_t k : {3, 4, 12, 13})  // the image ends before
        for (size_t j = 0; j < ray_numbers; ++j) CHECK(ray(k)[j] == 0);
    CHECK(seen[ray_count * ray_numbers + 3] == Approx(0));
    CHECK(seen[ray_count * ray_numbers + 4] == Approx(std::fabs(2 * 9.5 / 20 - 1)));
}

TEST_CASE("rays: a plane that goes on under the hole is known there; what stands on it ends its run", "[rays]") {
    Picture p = two_walls(60, 40, 28, 35);
    const auto plane = [](int x, int y) { return 0.02f + 0.001f * float(x) + 0.002f * float(y); };
    const size_t n = p.hole.size();
    for (int y = 0; y < p.height; ++y)
        for (int x = 0; x < p.width; ++x) {
            const size_t i = p.at(x, y);
            for (size_t c = 0; c < 3; ++c) p.fill[c * n + i] = float(x) / 60;
            p.inverse_depth[i] = x >= 40 ? 0.9f : plane(x, y);  // right of column 39 something nearer
        }
    const std::vector<float> seen = seen_from(p, 30, 20);
    size_t met = 0;
    for (size_t k = 0; k < ray_count; ++k)
        if (const float* ray = seen.data() + k * ray_numbers; ray[32] > 0 && (k > 2 && k < 14)) {  // to the left
            CHECK(ray[31] == Approx(8 * plane(30, 20)).epsilon(1e-3));
            ++met;
        }
    CHECK(met >= 5);
    const float* right = seen.data();  // columns 36 to 39 are the plane
    CHECK(right[31] == Approx(8 * plane(30, 20)).epsilon(1e-3));
    CHECK(right[28] == Approx(std::log(4.0) / 3));
    for (const size_t mean : {22, 25}) CHECK(right[mean] == Approx(2 * 37.5 / 60 - 1));
    CHECK(right[13] == Approx(8 * 0.9));  // 4 steps beyond it is what stands there
    CHECK(right[10] == Approx(2 * 40.0 / 60 - 1));
    // Pixels of one row share the edge.
    const RayNumbers row = ray_numbers_of(p.planes(), {int32_t(p.at(29, 20)), int32_t(p.at(33, 20))});
    CHECK(row.edge[0] == row.edge[ray_count]);
    CHECK(row.edge[8] == row.edge[ray_count + 8]);
    CHECK(row.edge[0] != row.edge[8]);
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
    std::vector<float> mirrored(seen_numbers);
    mirror_seen(seen_from(p, 10, 6).data(), mirrored.data());
    const std::vector<float> there = seen_from(q, p.width - 1 - 10, 6);
    for (size_t j = 0; j < seen_numbers; ++j) CHECK(mirrored[j] == Approx(there[j]));
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
    const std::vector<float> seen = seen_from(p, 9, 4);
    double red = 0, met = 0;
    for (size_t k = 0; k < ray_count; ++k)
        if (seen[k * ray_numbers + ray_numbers - 1] > 0) {
            met += 1;
            red += (double(seen[k * ray_numbers + 3]) + 1) / 2;
        }
    REQUIRE(red > 2);
    CHECK(out[0][0][0][4][9].item<double>() == Approx(red / (met + std::exp(3.0))).epsilon(1e-5));
    CHECK(out[0][2][0][4][9].item<double>() == Approx(1 - red / (met + std::exp(3.0))).epsilon(1e-5));
}

TEST_CASE("pixel_rays: fills as it was trained, and deep in a hole the other pixels are means", "[rays][model]") {
    Picture p = two_walls(60, 30, 8, 51);
    const size_t n = p.hole.size();
    for (size_t i = 0; i < 3 * n; ++i) p.fill[i] = float((i * 2654435761u >> 8) % 1000) / 1000;
    ModelConfig config;
    config.kind = Kind::pixel_rays;
    Model model = initial_model(config, 1);
    for (auto& [name, t] : model.weights) t = noise(t.sizes(), 3, t.numel()) * 0.1;
    const Views v = views_of(p);
    Stream stream;
    const Tensor out = inpaint::inpaint(model, v, 1, 1, stream);
    for (const int x : {8, 9, 10, 12, 16, 18, 26, 30, 50}) {  // with row 10 on the grid of its depth
        const std::vector<float> seen = seen_from(p, x, 10);
        // The velocity at its only time is the way back from what is made to the fill.
        const Tensor back = velocity(model, model.weights, at::zeros({1, 3, 1, 1, 1}), at::ones({1}), tensor_of(seen).view({1, -1, 1, 1, 1}));
        for (int64_t c = 0; c < 3; ++c) {
            const double made = v.fill[0][c][0][10][x].item<double>() - back[0][c].item<double>() / config.residual_scale;
            CHECK(out[0][c][0][10][x].item<double>() == Approx(std::clamp(made, 0.0, 1.0)).margin(1e-5));
        }
    }
    for (int64_t c = 0; c < 3; ++c) {
        const auto at = [&](int y, int x) { return out[0][c][0][y][x].item<double>(); };
        const auto mean_at = [&](int y, int x, std::initializer_list<std::pair<int, int>> beside) {
            double sum = 0;
            for (const auto& [dy, dx] : beside) sum += at(y + dy, x + dx) / double(beside.size());
            CHECK(at(y, x) == Approx(sum).margin(1e-6));
        };
        for (const int x : {11, 13, 21, 29}) {  // 4, 6, 14 and 22 from the edge: with the row an odd sum
            mean_at(10, x, {{-1, 0}, {1, 0}, {0, -1}, {0, 1}});
            mean_at(0, x, {{1, 0}, {0, -1}, {0, 1}});
        }
        mean_at(11, 17, {{-1, -1}, {-1, 1}, {1, -1}, {1, 1}});  // 10 from the edge: both odd
        mean_at(29, 17, {{-1, -1}, {-1, 1}});
        mean_at(10, 28, {{-2, 0}, {2, 0}, {0, -2}, {0, 2}});  // 21 from the edge: both even, no multiple of 4 together
        mean_at(0, 30, {{2, 0}, {0, -2}, {0, 2}});
    }
    // The same on any number of threads.
    const int before = at::get_num_threads();
    at::set_num_threads(before == 1 ? 2 : 1);
    Stream again;
    CHECK(at::equal(inpaint::inpaint(model, v, 1, 1, again), out));
    at::set_num_threads(before);
}

TEST_CASE("pixel_rays: detail is the mirrored deviation from the surface's mean", "[rays][model]") {
    Picture p = two_walls(40, 9, 8, 31);
    const size_t n = p.hole.size();
    for (size_t i = 0; i < 3 * n; ++i) p.fill[i] = 0.4f + 0.2f * float((i * 2654435761u >> 8) % 1000) / 1000;
    ModelConfig config;
    config.kind = Kind::pixel_rays;
    Model model = initial_model(config, 1);
    model.weights.at("out.bias")[1 + 8] = 5;  // the ray to the left weighs most
    const Views v = views_of(p);
    Stream stream, other;
    const Tensor plain = inpaint::inpaint(model, v, 1, 1, stream);
    model.config.rays.detail = 0.5;
    const Tensor detailed = inpaint::inpaint(model, v, 1, 1, other);
    const int y = 4;
    for (int x = 8; x < 32; x += 2) {  // even: computed in both
        const int steps = x - 7, back = (steps - 1) % 16, column = 7 - (back < 8 ? back : 15 - back);  // the wall is 8 pixels wide
        for (size_t c = 0; c < 3; ++c) {
            double mean = 0;
            for (int i = 0; i < 8; ++i) mean += double(p.fill[c * n + p.at(i, y)]) / 8;
            const auto at = [&](const Tensor& t) { return t[0][int64_t(c)][0][y][x].item<double>(); };
            CHECK(at(detailed) - at(plain) == Approx(0.5 * (double(p.fill[c * n + p.at(column, y)]) - mean)).margin(1e-5));
        }
    }
    CHECK(parse_model_config(json_of(model.config), "m").rays.detail == 0.5);
}

TEST_CASE("pixel_rays: what does not fit is refused", "[rays][model]") {
    CHECK_THROWS_AS(parse_model_config(R"({"kind":"pixel_rays","flow":true})", "m"), Error);
    CHECK_THROWS_AS(parse_model_config(R"({"kind":"pixel_rays","rays":{"dim":0}})", "m"), Error);
    CHECK_THROWS_AS(parse_model_config(R"({"kind":"pixel_rays","rays":{"width":8}})", "m"), Error);
    CHECK_THROWS_AS(parse_model_config(R"({"kind":"pixel_rays","rays":{"detail":3}})", "m"), Error);
    ModelConfig config;
    config.kind = Kind::pixel_rays;
    Views v = views_of(two_walls(8, 4, 3, 4));
    v.target = v.fill;
    CHECK_THROWS_AS(prepare(initial_model(config, 1), v), Error);  // no rays of drawn pixels
}
