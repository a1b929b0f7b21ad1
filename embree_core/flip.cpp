// SPDX-License-Identifier: Apache-2.0
#include "embree_core/flip.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "embree_core/srgb.h"

namespace vshift {
namespace {

using glm::dvec3;
using Plane = Grid<float>;
using Kernel = std::vector<double>;  // 2 radius + 1 weights
const double pi = std::acos(-1.0);

// Linear sRGB to XYZ for D65, as the exact fractions of the primaries; the white point is the image of (1,1,1).
const glm::dmat3 xyz_from_rgb =
    glm::transpose(glm::dmat3(dvec3(10135552.0 / 24577794, 8788810.0 / 24577794, 4435075.0 / 24577794),
                              dvec3(2613072.0 / 12288897, 8788810.0 / 12288897, 887015.0 / 12288897),
                              dvec3(1425312.0 / 73733382, 8788810.0 / 73733382, 70074185.0 / 73733382)));
const glm::dmat3 rgb_from_xyz = glm::inverse(xyz_from_rgb);
const dvec3 white = xyz_from_rgb * dvec3(1);

/// Opponent space in which the eye's blur is modelled.
dvec3 ycxcz_from_rgb(const dvec3& rgb) {
    const dvec3 n = xyz_from_rgb * rgb / white;
    return {116 * n.y - 16, 500 * (n.x - n.y), 200 * (n.y - n.z)};
}
dvec3 rgb_from_ycxcz(const dvec3& c) {
    const double y = (c.x + 16) / 116;
    return rgb_from_xyz * (dvec3(y + c.y / 500, y, y - c.z / 200) * white);
}

/// CIELAB with the Hunt effect: colors look less colorful when they are dark.
dvec3 hunt_lab_from_rgb(const dvec3& rgb) {
    const auto bent = [](double t) {
        constexpr double delta = 6.0 / 29;
        return t > delta * delta * delta ? std::cbrt(t) : t / (3 * delta * delta) + 4.0 / 29;
    };
    const dvec3 n = xyz_from_rgb * rgb / white;
    const double x = bent(n.x), y = bent(n.y), z = bent(n.z), l = 116 * y - 16;
    return {l, 0.01 * l * 500 * (x - y), 0.01 * l * 200 * (y - z)};
}

double hyab(const dvec3& a, const dvec3& b) {
    return std::abs(a.x - b.x) + std::hypot(a.y - b.y, a.z - b.z);
}

/// Rows with `across`, then columns with `down`; the border is continued.
Plane filtered(const Plane& image, const Kernel& across, const Kernel& down) {
    const int width = image.width, height = image.height, ra = int(across.size() / 2), rd = int(down.size() / 2);
    Plane rows(width, height), out(width, height);
    tbb::parallel_for(0, height, [&](int y) {
        std::vector<float> line(size_t(width + 2 * ra));
        for (int x = -ra; x < width + ra; ++x) line[size_t(x + ra)] = image.at(std::clamp(x, 0, width - 1), y);
        for (int x = 0; x < width; ++x) {
            double sum = 0;
            for (size_t i = 0; i < across.size(); ++i) sum += across[i] * double(line[size_t(x) + i]);
            rows.at(x, y) = float(sum);
        }
    });
    tbb::parallel_for(0, height, [&](int y) {
        std::vector<double> sum(size_t(width), 0.0);
        for (int j = -rd; j <= rd; ++j) {
            const float* from = &rows.data[size_t(std::clamp(y + j, 0, height - 1)) * size_t(width)];
            const double w = down[size_t(j + rd)];
            for (int x = 0; x < width; ++x) sum[size_t(x)] += w * double(from[x]);
        }
        for (int x = 0; x < width; ++x) out.at(x, y) = float(sum[size_t(x)]);
    });
    return out;
}

struct Gaussian {
    double a, b;
};
/// The eye's contrast sensitivity in one channel: a sum of Gaussians a sqrt(pi/b) exp(-pi^2 d^2 / b), d in degrees.
Plane seen(const Plane& image, std::initializer_list<Gaussian> parts, double ppd, int radius) {
    double total = 0;
    std::vector<std::pair<double, Kernel>> kernels;
    for (const Gaussian& g : parts) {
        Kernel kernel;
        double sum = 0;
        for (int i = -radius; i <= radius; ++i)
            sum += kernel.emplace_back(std::exp(-pi * pi * (i / ppd) * (i / ppd) / g.b));
        const double weight = g.a * std::sqrt(pi / g.b);
        total += weight * sum * sum;
        kernels.emplace_back(weight, std::move(kernel));
    }
    Plane out(image.width, image.height);
    for (auto& [weight, kernel] : kernels) {
        const Plane part = filtered(image, kernel, kernel);
        for (size_t i = 0; i < out.size(); ++i) out.data[i] += float(weight / total) * part.data[i];
    }
    return out;
}

struct Opponent {
    Plane y, cx, cz;
};
Opponent opponent_of(const ColorImage& image) {
    Opponent out{Plane(image.width, image.height), Plane(image.width, image.height), Plane(image.width, image.height)};
    tbb::parallel_for(0, image.height, [&](int row) {
        for (int x = 0; x < image.width; ++x) {
            const glm::vec3& s = image.at(x, row);
            const dvec3 c = ycxcz_from_rgb(
                {linear_from_srgb(double(s.r)), linear_from_srgb(double(s.g)), linear_from_srgb(double(s.b))});
            out.y.at(x, row) = float(c.x), out.cx.at(x, row) = float(c.y), out.cz.at(x, row) = float(c.z);
        }
    });
    return out;
}

/// Perceptually uniform color after the eye's blur.
Grid<dvec3> looks(const Opponent& image, double ppd) {
    const int radius = int(std::ceil(3 * std::sqrt(0.04 / (2 * pi * pi)) * ppd));
    const Plane y = seen(image.y, {{1, 0.0047}}, ppd, radius), cx = seen(image.cx, {{1, 0.0053}}, ppd, radius),
                cz = seen(image.cz, {{34.1, 0.04}, {13.5, 0.025}}, ppd, radius);
    Grid<dvec3> out(y.width, y.height);
    tbb::parallel_for(size_t(0), out.size(), [&](size_t i) {
        const dvec3 rgb = rgb_from_ycxcz({y.data[i], cx.data[i], cz.data[i]});
        out.data[i] = hunt_lab_from_rgb(glm::clamp(rgb, 0.0, 1.0));
    });
    return out;
}

/// Edges and points of one image: lengths of the first and second derivatives of a Gaussian, as wide as a line that
/// the eye can just make out (0.082 degrees).
struct Features {
    Plane edge, point;
};
Features features_of(const Plane& y, double ppd) {
    const double sigma = 0.5 * 0.082 * ppd;
    const int radius = int(std::ceil(3 * sigma));
    Kernel smooth, first, second;
    for (int i = -radius; i <= radius; ++i) {
        const double g = std::exp(-i * i / (2 * sigma * sigma));
        smooth.push_back(g), first.push_back(-i * g), second.push_back((i * i / (sigma * sigma) - 1) * g);
    }
    double sum = 0;
    for (const double g : smooth) sum += g;
    for (double& g : smooth) g /= sum;
    for (Kernel* kernel : {&first, &second}) {  // positive weights add up to 1, negative ones to -1
        double above = 0, below = 0;
        for (const double w : *kernel) (w > 0 ? above : below) += w;
        for (double& w : *kernel) w /= w > 0 ? above : -below;
    }
    Plane gray(y.width, y.height);
    for (size_t i = 0; i < gray.size(); ++i) gray.data[i] = (y.data[i] + 16) / 116;
    const auto length = [&](const Kernel& kernel) {
        const Plane a = filtered(gray, kernel, smooth), b = filtered(gray, smooth, kernel);
        Plane out(y.width, y.height);
        for (size_t i = 0; i < out.size(); ++i) out.data[i] = std::hypot(a.data[i], b.data[i]);
        return out;
    };
    return {length(first), length(second)};
}

}  // namespace

Grid<float> flip_map(const ColorImage& got, const ColorImage& truth, double ppd) {
    if (got.width != truth.width || got.height != truth.height)
        throw Error(ExitCode::bad_input, "flip: size: got another, expected the truth's");
    if (!(ppd >= 1 && ppd <= 1000))
        throw Error(ExitCode::bad_input, "flip: pixels per degree: got a number out of range, expected 1 to 1000");
    constexpr double color_power = 0.7, knee = 0.4, knee_value = 0.95, feature_power = 0.5;
    const double most =
        std::pow(hyab(hunt_lab_from_rgb({0, 1, 0}), hunt_lab_from_rgb({0, 0, 1})), color_power);  // green to blue
    const Opponent a = opponent_of(got), b = opponent_of(truth);
    const Grid<dvec3> look_a = looks(a, ppd), look_b = looks(b, ppd);
    const Features feature_a = features_of(a.y, ppd), feature_b = features_of(b.y, ppd);
    Grid<float> out(truth.width, truth.height);
    tbb::parallel_for(size_t(0), out.size(), [&](size_t i) {
        const double d = std::pow(hyab(look_a.data[i], look_b.data[i]), color_power), bend = knee * most;
        const double color =
            d < bend ? d * knee_value / bend : knee_value + (d - bend) / (most - bend) * (1 - knee_value);
        const double feature = std::max(std::abs(feature_a.edge.data[i] - feature_b.edge.data[i]),
                                        std::abs(feature_a.point.data[i] - feature_b.point.data[i]));
        out.data[i] = float(std::pow(color, 1 - std::pow(feature / std::sqrt(2.0), feature_power)));
    });
    return out;
}

}  // namespace vshift
