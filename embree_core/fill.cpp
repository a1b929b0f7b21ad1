// SPDX-License-Identifier: Apache-2.0
#include "embree_core/fill.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "embree_core/pictures.h"
#include "embree_core/words.h"

namespace vshift {
namespace {

constexpr int directions = 16;
constexpr int step[directions][2] = {{1, 0}, {0, 1}, {-1, 0}, {0, -1}, {1, 1},   {-1, 1},  {-1, -1}, {1, -1},
                                     {2, 1}, {1, 2}, {-1, 2}, {-2, 1}, {-2, -1}, {-1, -2}, {1, -2},  {2, -1}};
constexpr int open_directions = 5;       // from so many on that leave the image, the hole is out of frame
constexpr float far_inverse_m = 0.005f;  // beyond 200 m all is equally far
constexpr int smoothing_passes = 2;
constexpr float nearest_counted = 0.5f;  // as a share of the background's distance

void require_size(const char* field, int width, int height, const ColorImage& color) {
    if (width != color.width || height != color.height)
        throw Error(ExitCode::bad_input, std::string("fill: ") + field + " size: got " + std::to_string(width) + "x" +
                                             std::to_string(height) + ", expected " + std::to_string(color.width) +
                                             "x" + std::to_string(color.height));
}

void check(const HoledView& view) {
    require_size("hole", view.hole.width, view.hole.height, view.color);
    require_size("depth", view.depth.width, view.depth.height, view.color);
}

/// The hole pixels, numbered in reading order; -1 elsewhere.
struct Holes {
    Grid<int32_t> number;
    std::vector<int32_t> pixel;
};
Holes number_holes(const Mask& hole) {
    Holes out{Grid<int32_t>(hole.width, hole.height, -1), {}};
    for (size_t i = 0; i < hole.size(); ++i)
        if (hole.data[i]) {
            out.number.data[i] = int32_t(out.pixel.size());
            out.pixel.push_back(int32_t(i));
        }
    return out;
}

/// For every hole pixel the first known pixel in one direction, -1 where the image ends before: one look at the next
/// pixel, whose own answer is there already.
std::vector<int32_t> first_known(const Holes& holes, int dx, int dy) {
    const int width = holes.number.width, height = holes.number.height;
    const bool down = dy > 0 || (dy == 0 && dx > 0);  // the next pixel comes later: backwards
    std::vector<int32_t> first(holes.pixel.size());
    const auto look = [&](size_t n) {
        const int at = holes.pixel[n], x = at % width + dx, y = at / width + dy;
        if (x < 0 || y < 0 || x >= width || y >= height) return int32_t(-1);
        const int32_t next = holes.number.at(x, y);
        return next < 0 ? int32_t(y * width + x) : first[size_t(next)];
    };
    if (down)
        for (size_t n = first.size(); n-- > 0;) first[n] = look(n);
    else
        for (size_t n = 0; n < first.size(); ++n) first[n] = look(n);
    return first;
}

glm::vec3 root(const glm::vec3& c) {
    return {std::sqrt(std::max(c.r, 0.0f)), std::sqrt(std::max(c.g, 0.0f)), std::sqrt(std::max(c.b, 0.0f))};
}

float counted_inverse(float depth_m) {
    if (is_sky(depth_m)) return far_inverse_m;
    if (!is_measured(depth_m)) return 1e6f;
    return std::max(1 / depth_m, far_inverse_m);
}

/// Mean of the roots of all known pixels, for hole pixels that no direction leads out of.
glm::vec3 mean_known(const HoledView& view) {
    glm::dvec3 sum(0);
    size_t count = 0;
    for (size_t i = 0; i < view.hole.size(); ++i)
        if (!view.hole.data[i]) sum += glm::dvec3(root(view.color.data[i])), ++count;
    return count ? glm::vec3(sum / double(count)) : glm::vec3(0);
}

}  // namespace

const std::vector<std::string>& fill_method_names() {
    static const std::vector<std::string> names = {"background", "pushpull", "telea", "ns"};
    return names;
}

FillMethod fill_method(const std::string& name, const std::string& where) {
    const auto& names = fill_method_names();
    const auto found = std::find(names.begin(), names.end(), name);
    if (found == names.end())
        throw Error(ExitCode::bad_input,
                    where + ": got '" + name +
                        "', expected background, pushpull, telea or ns (nearest: " + nearest_word(name, names) + ")");
    return FillMethod(found - names.begin());
}

ColorImage fill(const HoledView& view, FillMethod method) {
    switch (method) {
        case FillMethod::pushpull:
            return fill_pushpull(view);
        case FillMethod::telea:
            return fill_telea(view);
        case FillMethod::ns:
            return fill_navier_stokes(view);
        default:
            return fill_background(view);
    }
}

ColorImage fill_pushpull(const HoledView& view) {
    check(view);
    return pictures().fill_pushpull(view);
}

ColorImage fill_background(const HoledView& view) {
    check(view);
    const Holes holes = number_holes(view.hole);
    std::array<std::vector<int32_t>, directions> first;
    tbb::parallel_for(0, directions, [&](int k) { first[size_t(k)] = first_known(holes, step[k][0], step[k][1]); });

    const int width = view.color.width, height = view.color.height;
    const glm::vec3 mean = mean_known(view);
    std::vector<glm::vec3> roots(holes.pixel.size());
    const auto pixel = [&](size_t n) {
        const int at = holes.pixel[n], x = at % width, y = at / width;
        std::array<float, directions> inverse;
        float farthest = std::numeric_limits<float>::infinity();
        int open = 0;
        for (size_t k = 0; k < directions; ++k) {
            const int32_t q = first[k][n];
            if (q < 0) {
                ++open;
                continue;
            }
            inverse[k] = counted_inverse(view.depth.data[size_t(q)]);
            farthest = std::min(farthest, inverse[k]);
        }
        glm::vec3 sum(0);
        float weights = 0;
        for (size_t k = 0; k < directions; ++k) {
            const int32_t q = first[k][n];
            if (q < 0) continue;
            const float dx = float(q % width - x), dy = float(q / width - y);
            float weight = 1 / std::sqrt(std::sqrt(dx * dx + dy * dy));
            if (open < open_directions) {
                const float near = std::max(0.0f, farthest / inverse[k] - nearest_counted);
                weight *= near * near;
            }
            sum += weight * root(view.color.data[size_t(q)]);
            weights += weight;
        }
        roots[n] = weights > 0 ? sum / weights : mean;
    };
    const auto every_hole = [&](auto&& work) {
        tbb::parallel_for(size_t(0), (holes.pixel.size() + 4095) / 4096, [&](size_t part) {
            const size_t end = std::min(holes.pixel.size(), (part + 1) * 4096);
            for (size_t n = part * 4096; n < end; ++n) work(n);
        });
    };
    every_hole(pixel);
    // Rays from neighbouring pixels pass an edge on either side: without this they leave streaks.
    for (int pass = 0; pass < smoothing_passes; ++pass) {
        const std::vector<glm::vec3> before = roots;
        every_hole([&](size_t n) {
            const int at = holes.pixel[n], x = at % width, y = at / width;
            glm::vec3 sum = before[n];
            float count = 1;
            for (int k = 0; k < 4; ++k) {
                const int i = x + step[k][0], j = y + step[k][1];
                if (i < 0 || j < 0 || i >= width || j >= height) continue;
                const int32_t next = holes.number.at(i, j);
                if (next >= 0) sum += before[size_t(next)], count += 1;
            }
            roots[n] = sum / count;
        });
    }
    ColorImage out = view.color;
    every_hole([&](size_t n) { out.data[size_t(holes.pixel[n])] = roots[n] * roots[n]; });
    return out;
}

}  // namespace vshift
