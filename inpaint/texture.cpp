// SPDX-License-Identifier: Apache-2.0
#include "inpaint/texture.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <opencv2/core.hpp>

namespace vshift::inpaint {
namespace {

constexpr int side = 4, margin = 2;

/// Magnitudes of the 4x4's orthonormal DCT, the mean's left out, row by row.
void dct_magnitudes(const double (&block)[side][side], double* out) {
    static const auto basis = [] {
        std::array<std::array<double, side>, side> b{};
        for (int k = 0; k < side; ++k)
            for (int i = 0; i < side; ++i)
                b[size_t(k)][size_t(i)] = std::sqrt((k ? 2.0 : 1.0) / side) * std::cos(M_PI * (i + 0.5) * k / side);
        return b;
    }();
    for (size_t v = 0; v < side; ++v)
        for (size_t u = 0; u < side; ++u) {
            if (u == 0 && v == 0) continue;
            double sum = 0;
            for (size_t y = 0; y < side; ++y)
                for (size_t x = 0; x < side; ++x) sum += basis[v][y] * basis[u][x] * block[y][x];
            *out++ = std::fabs(sum);
        }
}

/// The symmetric square root; small negative eigenvalues are rounding.
cv::Mat square_root(const cv::Mat& m) {
    cv::Mat values, vectors;
    cv::eigen(m, values, vectors);
    for (int i = 0; i < values.rows; ++i) {
        const double root = std::sqrt(std::sqrt(std::max(values.at<double>(i), 0.0)));
        for (int j = 0; j < vectors.cols; ++j) vectors.at<double>(i, j) *= root;
    }
    return vectors.t() * vectors;
}

}  // namespace

TextureFeatures texture_at(const std::vector<float>& planes, int width, int height, int x0, int y0) {
    const size_t n = size_t(width) * size_t(height);
    const auto at = [&](size_t c, int x, int y) {
        return double(planes[c * n + size_t(y) * size_t(width) + size_t(x)]);
    };
    const auto luma = [&](int x, int y) { return 0.299 * at(0, x, y) + 0.587 * at(1, x, y) + 0.114 * at(2, x, y); };
    TextureFeatures f{};
    double inner[side][side], coarse[side][side] = {}, red = 0, blue = 0;
    for (int y = 0; y < side; ++y)
        for (int x = 0; x < side; ++x) {
            inner[y][x] = luma(x0 + x, y0 + y);
            f[0] += inner[y][x] / (side * side);
            red += at(0, x0 + x, y0 + y) / (side * side);
            blue += at(2, x0 + x, y0 + y) / (side * side);
        }
    f[1] = 0.564 * (blue - f[0]);
    f[2] = 0.713 * (red - f[0]);
    for (int y = 0; y < 2 * side; ++y)
        for (int x = 0; x < 2 * side; ++x) coarse[y / 2][x / 2] += luma(x0 - margin + x, y0 - margin + y) / 4;
    dct_magnitudes(inner, f.data() + 3);
    dct_magnitudes(coarse, f.data() + 18);
    return f;
}

void TextureMoments::add(const TextureFeatures& f) {
    count += 1;
    for (size_t i = 0; i < texture_features; ++i) {
        sum[i] += f[i];
        for (size_t j = 0; j < texture_features; ++j) products[i * texture_features + j] += f[i] * f[j];
    }
}

void TextureMoments::add(const TextureMoments& other) {
    count += other.count;
    for (size_t i = 0; i < sum.size(); ++i) sum[i] += other.sum[i];
    for (size_t i = 0; i < products.size(); ++i) products[i] += other.products[i];
}

TextureMoments texture_moments(const std::vector<float>& planes, const Mask& mask) {
    TextureMoments m;
    for (int y = side; y + side + margin <= mask.height; y += side)
        for (int x = side; x + side + margin <= mask.width; x += side) {
            int inside = 0;
            for (int i = 0; i < side * side; ++i) inside += mask.at(x + i % side, y + i / side) != 0;
            if (2 * inside >= side * side) m.add(texture_at(planes, mask.width, mask.height, x, y));
        }
    return m;
}

double frechet_distance(const std::vector<double>& mean1, const std::vector<double>& covariance1,
                        const std::vector<double>& mean2, const std::vector<double>& covariance2) {
    const int n = int(mean1.size());
    const cv::Mat c1 = cv::Mat(covariance1).reshape(1, n), c2 = cv::Mat(covariance2).reshape(1, n);
    const cv::Mat root = square_root(c1);
    // The eigenvalues of root c2 root are those of c1 c2.
    cv::Mat product = root * c2 * root, values;
    product = (product + product.t()) / 2;
    cv::eigen(product, values);
    double distance = cv::trace(c1)[0] + cv::trace(c2)[0];
    for (int i = 0; i < n; ++i) {
        distance += (mean1[size_t(i)] - mean2[size_t(i)]) * (mean1[size_t(i)] - mean2[size_t(i)]);
        distance -= 2 * std::sqrt(std::max(values.at<double>(i), 0.0));
    }
    return std::max(distance, 0.0);
}

double texture_distance(const TextureMoments& got, const TextureMoments& truth) {
    if (!(got.count > 0 && truth.count > 0)) return std::numeric_limits<double>::quiet_NaN();
    constexpr size_t n = texture_features;
    std::vector<double> unit(n);
    for (size_t i = 0; i < n; ++i) {
        const double mean = truth.sum[i] / truth.count;
        unit[i] = std::sqrt(std::max(truth.products[i * n + i] / truth.count - mean * mean, 1e-12));
    }
    const auto gaussian = [&](const TextureMoments& m) {
        std::pair<std::vector<double>, std::vector<double>> g{std::vector<double>(n), std::vector<double>(n * n)};
        for (size_t i = 0; i < n; ++i) g.first[i] = m.sum[i] / m.count / unit[i];
        for (size_t i = 0; i < n; ++i)
            for (size_t j = 0; j < n; ++j)
                g.second[i * n + j] = m.products[i * n + j] / m.count / (unit[i] * unit[j]) - g.first[i] * g.first[j];
        return g;
    };
    const auto a = gaussian(got), b = gaussian(truth);
    return frechet_distance(a.first, a.second, b.first, b.second);
}

}  // namespace vshift::inpaint
