// SPDX-License-Identifier: Apache-2.0
#include "inpaint/rays.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>

namespace vshift::inpaint {
namespace {

// By angle: the mirror image of ray k is ray (8 - k) mod 16.
constexpr int step[ray_count][2] = {{1, 0},  {2, 1},   {1, 1},   {1, 2},   {0, 1},  {-1, 2}, {-1, 1}, {-2, 1},
                                    {-1, 0}, {-2, -1}, {-1, -1}, {-1, -2}, {0, -1}, {1, -2}, {1, -1}, {2, -1}};
constexpr float near_m = 8, far_inverse_m = 0.005f;

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

}  // namespace

RayNumbers ray_numbers_of(const RayPlanes& p, const std::vector<int32_t>& chosen) {
    RayNumbers out;
    out.rays.assign(chosen.size() * ray_count * ray_numbers, 0);
    out.own.resize(chosen.size() * own_numbers);
    const size_t n = size_t(p.width) * size_t(p.height);
    struct Known {
        float color[3], near, log_inverse;
    };
    std::vector<Known> known(n);  // of a pixel all in one place
    tbb::parallel_for(0, p.height, [&](int y) {
        for (size_t i = size_t(y) * size_t(p.width), end = i + size_t(p.width); i < end; ++i) {
            if (p.hole[i] > 0) continue;
            for (size_t c = 0; c < 3; ++c) known[i].color[c] = 2 * p.fill[c * n + i] - 1;
            known[i].near = near_m * p.inverse_depth[i];
            known[i].log_inverse = std::log(p.inverse_depth[i] + far_inverse_m);
        }
    });
    tbb::parallel_for(0, ray_count, [&](int k) {
        thread_local std::vector<int32_t> first;
        const int dx = step[k][0], dy = step[k][1];
        const float length = std::sqrt(float(dx * dx + dy * dy));
        find_first(p, dx, dy, first);
        std::vector<float> log_far(size_t(std::max(p.width, p.height)) + 1);
        for (size_t i = 0; i < log_far.size(); ++i) log_far[i] = std::log1p(float(i) * length);
        for (size_t i = 0; i < chosen.size(); ++i) {
            const int32_t at = chosen[i], edge = first[size_t(at)];
            if (edge < 0) continue;
            const int ex = edge % p.width, ey = edge / p.width;
            const int steps = dx ? (ex - at % p.width) / dx : (ey - at / p.width) / dy;
            const int bx = std::clamp(ex + 2 * dx, 0, p.width - 1), by = std::clamp(ey + 2 * dy, 0, p.height - 1);
            const size_t there = size_t(by) * size_t(p.width) + size_t(bx);
            const Known& a = known[size_t(edge)];
            const Known& b = p.hole[there] <= 0 ? known[there] : a;
            float* v = out.rays.data() + (i * ray_count + size_t(k)) * ray_numbers;
            std::copy(a.color, a.color + 3, v);
            std::copy(b.color, b.color + 3, v + 3);
            v[6] = a.near;
            v[7] = b.near;
            v[8] = a.log_inverse;
            v[9] = b.log_inverse;
            v[10] = log_far[size_t(steps)];
            v[11] = 1 / (1 + float(steps) * length);
            v[12] = 1;
        }
    });
    for (size_t i = 0; i < chosen.size(); ++i) {
        const size_t at = size_t(chosen[i]);
        float* v = out.own.data() + i * own_numbers;
        for (size_t c = 0; c < 3; ++c) v[c] = 2 * p.fill[c * n + at] - 1;
        v[3] = 2 * (float(at / size_t(p.width)) + 0.5f) / float(p.height) - 1;
        v[4] = std::fabs(2 * (float(at % size_t(p.width)) + 0.5f) / float(p.width) - 1);
    }
    return out;
}

}  // namespace vshift::inpaint
