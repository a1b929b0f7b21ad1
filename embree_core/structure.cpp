// SPDX-License-Identifier: Apache-2.0
#include "embree_core/structure.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

namespace vshift {
namespace {

constexpr int radius = 5;
constexpr double sigma = 1.5, c1 = 0.01 * 0.01, c2 = 0.03 * 0.03;
constexpr double scale_power[] = {0.0448, 0.2856, 0.3001, 0.2363, 0.1333};
constexpr int scale_count = 5;

/// A window cut at the border is a rectangle, so its weights renormalise per axis.
struct Window {
    int begin, end;
    std::array<double, 2 * radius + 1> weight;

    Window(int center, int size) : begin(std::max(0, center - radius)), end(std::min(size - 1, center + radius)) {
        double sum = 0;
        for (int i = begin; i <= end; ++i)
            sum += weight[size_t(i - begin)] = std::exp(-(i - center) * (i - center) / (2 * sigma * sigma));
        for (int i = begin; i <= end; ++i) weight[size_t(i - begin)] /= sum;
    }
};

template <class T>
Grid<T> halved(const Grid<T>& image) {
    Grid<T> out(image.width / 2, image.height / 2);
    for (int y = 0; y < out.height; ++y)
        for (int x = 0; x < out.width; ++x)
            out.at(x, y) = (image.at(2 * x, 2 * y) + image.at(2 * x + 1, 2 * y) + image.at(2 * x, 2 * y + 1) +
                            image.at(2 * x + 1, 2 * y + 1)) /
                           4;
    return out;
}

}  // namespace

Grid<double> luma(const ColorImage& image) {
    Grid<double> out(image.width, image.height);
    for (size_t i = 0; i < out.size(); ++i) {
        const glm::vec3& c = image.data[i];
        out.data[i] = 0.2126 * c.r + 0.7152 * c.g + 0.0722 * c.b;
    }
    return out;
}

SsimMaps ssim_maps(const Grid<double>& a, const Grid<double>& b) {
    const int width = a.width, height = a.height;
    SsimMaps maps{Grid<double>(width, height), Grid<double>(width, height)};
    std::vector<Window> across;
    for (int x = 0; x < width; ++x) across.emplace_back(x, width);
    using Moments = std::array<double, 5>;  // a, b, aa, bb, ab
    tbb::parallel_for(0, height, [&](int y) {
        const Window down(y, height);
        std::vector<Moments> column(static_cast<size_t>(width), Moments{});
        for (int j = down.begin; j <= down.end; ++j) {
            const double w = down.weight[size_t(j - down.begin)];
            for (int x = 0; x < width; ++x) {
                const double p = a.at(x, j), q = b.at(x, j);
                Moments& m = column[size_t(x)];
                m[0] += w * p, m[1] += w * q, m[2] += w * (p * p), m[3] += w * (q * q), m[4] += w * (p * q);
            }
        }
        for (int x = 0; x < width; ++x) {
            const Window& window = across[size_t(x)];
            Moments m{};
            for (int i = window.begin; i <= window.end; ++i)
                for (size_t k = 0; k < m.size(); ++k)
                    m[k] += window.weight[size_t(i - window.begin)] * column[size_t(i)][k];
            const double var_a = m[2] - m[0] * m[0], var_b = m[3] - m[1] * m[1], cov = m[4] - m[0] * m[1];
            const double cs = (2 * cov + c2) / (var_a + var_b + c2);
            maps.contrast_structure.at(x, y) = cs;
            maps.ssim.at(x, y) = (2 * m[0] * m[1] + c1) / (m[0] * m[0] + m[1] * m[1] + c1) * cs;
        }
    });
    return maps;
}

MsSsimMaps ms_ssim_maps(Grid<double> got, Grid<double> truth) {
    MsSsimMaps out;
    if (std::min(got.width, got.height) >> (scale_count - 1) < 2 * radius + 1) return out;
    for (int s = 0; s < scale_count; ++s) {
        SsimMaps maps = ssim_maps(got, truth);
        const bool last = s == scale_count - 1;
        out.scales.push_back(std::move(last ? maps.ssim : maps.contrast_structure));
        if (!last) got = halved(got), truth = halved(truth);
    }
    return out;
}

double ms_ssim(const MsSsimMaps& maps, const Mask* region) {
    constexpr double none = std::numeric_limits<double>::quiet_NaN();
    if (maps.scales.empty()) return none;
    Grid<double> weight(maps.scales[0].width, maps.scales[0].height, 1.0);
    if (region)
        for (size_t i = 0; i < weight.size(); ++i) weight.data[i] = region->data[i] != 0;
    double product = 1;
    for (size_t s = 0; s < maps.scales.size(); ++s) {
        const Grid<double>& map = maps.scales[s];
        double sum = 0, weights = 0;
        for (size_t i = 0; i < map.size(); ++i)
            if (weight.data[i] > 0) sum += weight.data[i] * map.data[i], weights += weight.data[i];
        if (weights == 0) return none;
        const double mean = sum / weights;
        product *= std::pow(mean < 0 ? 0 : mean, scale_power[s]);
        if (s + 1 < maps.scales.size()) weight = halved(weight);
    }
    return product;
}

GradientMaps gradient_maps(const Grid<double>& got, const Grid<double>& truth) {
    const int width = truth.width, height = truth.height;
    GradientMaps maps{Grid<double>(width, height), Grid<double>(width, height), Grid<double>(width, height)};
    const auto slope = [&](const Grid<double>& image, int x, int y) {
        const int l = std::max(0, x - 1), r = std::min(width - 1, x + 1), t = std::max(0, y - 1),
                  b = std::min(height - 1, y + 1);
        return glm::dvec2(r > l ? (image.at(r, y) - image.at(l, y)) / (r - l) : 0,
                          b > t ? (image.at(x, b) - image.at(x, t)) / (b - t) : 0);
    };
    tbb::parallel_for(0, height, [&](int y) {
        for (int x = 0; x < width; ++x) {
            const glm::dvec2 g = slope(got, x, y), t = slope(truth, x, y);
            maps.error.at(x, y) = glm::length(g - t);
            maps.got_energy.at(x, y) = glm::dot(g, g);
            maps.truth_energy.at(x, y) = glm::dot(t, t);
        }
    });
    return maps;
}

}  // namespace vshift
