// SPDX-License-Identifier: Apache-2.0
#include "inpaint/rays.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>

namespace vshift::inpaint {
namespace {

// By angle: the mirror image of ray k is ray (8 - k) mod 16.
constexpr int step[ray_count][2] = {{1, 0},  {2, 1},   {1, 1},   {1, 2},   {0, 1},  {-1, 2}, {-1, 1}, {-2, 1},
                                    {-1, 0}, {-2, -1}, {-1, -1}, {-1, -2}, {0, -1}, {1, -2}, {1, -1}, {2, -1}};
constexpr float near_m = 8, nearest = 8, far_inverse_m = 0.005f;
constexpr int most_beyond = 17;      // pixels that are looked at, from the edge on
constexpr int slope_steps = 6;       // at most
constexpr float one_surface = 0.03f;  // how far 1/z may be from going on straight, as a share of it

size_t mirrored_ray(size_t ray) {
    return (ray_count / 2 + ray_count - ray) % ray_count;
}

/// Per pixel of the image the first known one in a direction (itself where it is known), -1 where the image ends before.
void find_first(const RayPlanes& p, int dx, int dy, std::vector<int32_t>& first) {
    first.resize(size_t(p.width) * size_t(p.height));
    const auto look = [&](int x, int y) {
        const size_t at = size_t(y) * size_t(p.width) + size_t(x);
        const int nx = x + dx, ny = y + dy;
        if (p.hole[at] <= 0) first[at] = int32_t(at);
        else if (nx < 0 || ny < 0 || nx >= p.width || ny >= p.height) first[at] = -1;
        else first[at] = first[size_t(ny) * size_t(p.width) + size_t(nx)];
    };
    // The next pixel's answer must be there already.
    if (dy > 0 || (dy == 0 && dx > 0)) {
        for (int y = p.height - 1; y >= 0; --y)
            for (int x = p.width - 1; x >= 0; --x) look(x, y);
    } else {
        for (int y = 0; y < p.height; ++y)
            for (int x = 0; x < p.width; ++x) look(x, y);
    }
}

struct Color {
    float r = 0, g = 0, b = 0;
};

/// edge_numbers of the pixel `edge`, looking along (dx, dy). Returns the slope of 1/z a step.
float describe_edge(const RayPlanes& p, int32_t edge, int dx, int dy, float* to) {
    const size_t n = size_t(p.width) * size_t(p.height);
    std::array<Color, most_beyond> color;
    std::array<float, most_beyond> near;
    int count = 0;
    for (int x = edge % p.width, y = edge / p.width; count < most_beyond; x += dx, y += dy, ++count) {
        if (x < 0 || y < 0 || x >= p.width || y >= p.height) break;
        const size_t at = size_t(y) * size_t(p.width) + size_t(x);
        if (p.hole[at] > 0) break;
        color[size_t(count)] = {2 * p.fill[at] - 1, 2 * p.fill[n + at] - 1, 2 * p.fill[2 * n + at] - 1};
        near[size_t(count)] = near_m * p.inverse_depth[at];
    }
    int run = 1;  // pixels of one surface: 1/z goes on straight
    const auto bends = [&](float by, size_t i) { return std::fabs(by) > one_surface * std::max(near[i], near[i - 1]) + 0.002f; };
    const auto bend = [&](size_t i) { return near[i] - 2 * near[i - 1] + near[i - 2]; };
    for (; run < count; ++run)
        if (const size_t i = size_t(std::max(run, 2)); count > 2 ? bends(bend(i), i) : bends(near[1] - near[0], 1)) break;
    const auto put_color = [&](const Color& c) {
        *to++ = c.r;
        *to++ = c.g;
        *to++ = c.b;
    };
    const auto beyond = [&](int steps) { return size_t(std::min(steps, count - 1)); };
    put_color(color[0]);
    put_color(color[beyond(2)]);
    for (const int s : {0, 2}) *to++ = std::min(near[beyond(s)], nearest);
    for (const int s : {0, 2}) *to++ = std::log(near[beyond(s)] / near_m + far_inverse_m);
    for (const int s : {4, 8, 16}) {
        put_color(color[beyond(s)]);
        *to++ = std::min(near[beyond(s)], nearest);
    }
    for (const int most : {6, most_beyond}) {
        Color sum;
        const int some = std::min(most, run);
        for (int i = 0; i < some; ++i) {
            const Color& c = color[size_t(i)];
            sum.r += c.r, sum.g += c.g, sum.b += c.b;
        }
        put_color({sum.r / float(some), sum.g / float(some), sum.b / float(some)});
    }
    *to = std::log(float(run)) / 3;
    const int over = std::min(run - 1, slope_steps);
    return over > 0 ? (near[0] - near[size_t(over)]) / float(over) : 0;
}

}  // namespace

RayNumbers ray_numbers_of(const RayPlanes& p, const std::vector<int32_t>& chosen) {
    RayNumbers out;
    out.edge.assign(chosen.size() * ray_count, 0);
    out.ways.assign(chosen.size() * ray_count * way_numbers, 0);
    out.own.resize(chosen.size() * own_numbers);
    const size_t n = size_t(p.width) * size_t(p.height);
    std::array<std::vector<float>, ray_count> edges;
    tbb::parallel_for(0, ray_count, [&](int k) {
        thread_local std::vector<int32_t> first, number;  // of an edge: 0 not met yet
        const int dx = step[k][0], dy = step[k][1];
        const float length = std::sqrt(float(dx * dx + dy * dy));
        find_first(p, dx, dy, first);
        number.assign(n, 0);
        std::vector<float> slope;
        std::vector<float> log_far(size_t(std::max(p.width, p.height)) + 1);
        for (size_t i = 0; i < log_far.size(); ++i) log_far[i] = std::log1p(float(i) * length);
        for (size_t i = 0; i < chosen.size(); ++i) {
            const int32_t at = chosen[i], edge = first[size_t(at)];
            if (edge < 0) continue;
            int32_t& known = number[size_t(edge)];
            if (known == 0) {
                std::vector<float>& all = edges[size_t(k)];
                all.resize(all.size() + edge_numbers);
                slope.push_back(describe_edge(p, edge, dx, dy, all.data() + all.size() - edge_numbers));
                known = int32_t(slope.size());
            }
            out.edge[i * ray_count + size_t(k)] = known;
            const float* numbers = edges[size_t(k)].data() + size_t(known - 1) * edge_numbers;
            const int steps = dx ? (edge % p.width - at % p.width) / dx : (edge / p.width - at / p.width) / dy;
            float* v = out.ways.data() + (i * ray_count + size_t(k)) * way_numbers;
            v[0] = log_far[size_t(steps)];
            v[1] = 1 / (1 + float(steps) * length);
            v[2] = std::clamp(numbers[6] + slope[size_t(known - 1)] * float(steps), -1.0f, nearest);
            v[3] = 1;
        }
    });
    std::array<int32_t, ray_count> before{};
    size_t total = edge_numbers;
    for (const auto& some : edges) total += some.size();
    out.edges.reserve(total);
    out.edges.assign(edge_numbers, 0);
    for (size_t k = 0; k < ray_count; ++k) {
        before[k] = int32_t(out.edges.size() / edge_numbers) - 1;
        out.edges.insert(out.edges.end(), edges[k].begin(), edges[k].end());
    }
    tbb::parallel_for(tbb::blocked_range<size_t>(0, chosen.size(), 1024), [&](const auto& some) {
        for (size_t i = some.begin(); i < some.end(); ++i) {
            for (size_t k = 0; k < ray_count; ++k)
                if (int32_t& e = out.edge[i * ray_count + k]; e > 0) e += before[k];
            const size_t at = size_t(chosen[i]);
            float* v = out.own.data() + i * own_numbers;
            for (size_t c = 0; c < 3; ++c) v[c] = 2 * p.fill[c * n + at] - 1;
            v[3] = 2 * (float(at / size_t(p.width)) + 0.5f) / float(p.height) - 1;
            v[4] = std::fabs(2 * (float(at % size_t(p.width)) + 0.5f) / float(p.width) - 1);
        }
    });
    return out;
}

int32_t mirrored_at_edge(const RayPlanes& p, int32_t pixel, size_t ray, const float* edge) {
    const int dx = step[ray][0], dy = step[ray][1], run = int(std::lround(std::exp(3 * edge[edge_numbers - 1])));
    const int32_t along = dy * p.width + dx;
    int32_t at = pixel;
    int steps = 0;
    for (; p.hole[at] > 0; at += along) ++steps;
    const int there = (steps - 1) % (2 * run);
    return at + along * (there < run ? there : 2 * run - 1 - there);
}

void write_seen(const RayNumbers& numbers, size_t pixel, float* to) {
    for (size_t k = pixel * ray_count; k < (pixel + 1) * ray_count; ++k) {
        to = std::copy_n(numbers.edges.data() + size_t(numbers.edge[k]) * edge_numbers, edge_numbers, to);
        to = std::copy_n(numbers.ways.data() + k * way_numbers, way_numbers, to);
    }
    std::copy_n(numbers.own.data() + pixel * own_numbers, own_numbers, to);
}

void mirror_seen(const float* from, float* to) {
    for (size_t k = 0; k < ray_count; ++k)
        std::copy_n(from + mirrored_ray(k) * ray_numbers, ray_numbers, to + k * ray_numbers);
    std::copy_n(from + ray_count * ray_numbers, own_numbers, to + ray_count * ray_numbers);
}

}  // namespace vshift::inpaint
