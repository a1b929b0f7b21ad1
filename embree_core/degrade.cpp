// SPDX-License-Identifier: Apache-2.0
#include "embree_core/degrade.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <vector>

namespace vshift {
namespace {

constexpr double field_sigma_px = 16;
constexpr int lookup_steps = 6;

uint64_t mixed(uint64_t x) {  // splitmix64
    x += 0x9e3779b97f4a7c15ull;
    x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9ull;
    x = (x ^ (x >> 27)) * 0x94d049bb133111ebull;
    return x ^ (x >> 31);
}

/// Numbers that depend on seed, camera and purpose alone, so that one error does not change another's draw.
class Draw {
public:
    Draw(int seed, const std::string& camera, const char* purpose) : state_(uint64_t(seed)) {
        for (const char c : camera) state_ = mixed(state_ ^ uint64_t(static_cast<unsigned char>(c)));
        for (; *purpose; ++purpose) state_ = mixed(state_ ^ (uint64_t(static_cast<unsigned char>(*purpose)) << 8));
    }
    double unit() { return double(next() >> 11) * 0x1p-53; }
    double sign() { return next() >> 63 ? 1 : -1; }
    glm::dvec3 direction() {
        const double z = 2 * unit() - 1, angle = 6.283185307179586 * unit(), r = std::sqrt(std::max(0.0, 1 - z * z));
        return {r * std::cos(angle), r * std::sin(angle), z};
    }

private:
    uint64_t next() { return mixed(state_++); }
    uint64_t state_;
};

/// Gaussian blur of `data`, weighted by `weight` (what has none neither gives nor takes).
void blur(std::vector<float>& data, std::vector<float>& weight, int width, int height, double sigma) {
    const int reach = std::max(1, int(std::ceil(3 * sigma)));
    std::vector<float> kernel(size_t(reach) + 1);
    for (int i = 0; i <= reach; ++i) kernel[size_t(i)] = float(std::exp(-0.5 * i * i / (sigma * sigma)));
    std::vector<float> out(data.size()), out_weight(data.size());
    for (const bool columns : {false, true}) {
        const int length = columns ? height : width;
        const size_t step = columns ? size_t(width) : 1;
        tbb::parallel_for(0, height, [&](int y) {
            for (int x = 0; x < width; ++x) {
                const size_t at = size_t(y) * size_t(width) + size_t(x);
                const int place = columns ? y : x;
                float sum = 0, total = 0;
                for (int i = std::max(-reach, -place); i <= std::min(reach, length - 1 - place); ++i) {
                    const size_t other = at + size_t(long(i)) * step;
                    const float k = kernel[size_t(std::abs(i))] * weight[other];
                    sum += k * data[other];
                    total += k;
                }
                out[at] = total > 0 ? sum / total : 0;
                out_weight[at] = total > 0 ? 1.0f : 0.0f;
            }
        });
        data.swap(out);
        weight.swap(out_weight);
    }
}

}  // namespace

glm::vec3 degraded_gain(const Degradations& sizes, const std::string& camera) {
    const double all = Draw(sizes.seed, camera, "exposure").sign() * sizes.exposure_stops;
    const double half = 0.5 * Draw(sizes.seed, camera, "white balance").sign() * sizes.white_balance_stops;
    return {std::exp2(all + half), std::exp2(all), std::exp2(all - half)};
}

Pose degraded_pose(const Degradations& sizes, const std::string& camera, const Pose& world_from_cam) {
    if (!(sizes.pose_m > 0 || sizes.pose_deg > 0)) return world_from_cam;
    Draw draw(sizes.seed, camera, "pose");
    const glm::dvec3 move = sizes.pose_m * draw.direction(), axis = draw.direction();
    const glm::dquat turn = glm::angleAxis(sizes.pose_deg * radians_per_degree, axis);
    return compose(world_from_cam, {glm::mat3_cast(turn), move});
}

double degraded_delay_s(const Degradations& sizes, const std::string& camera) {
    return Draw(sizes.seed, camera, "time").sign() * sizes.time_s;
}

Grid<float> degraded_inverse_depth(const Degradations& sizes, const std::string& camera, const Grid<float>& w) {
    Grid<float> out = w;
    if (!sizes.bends_depth()) return out;
    const size_t count = w.size();
    if (sizes.depth_blur_px > 0) {
        std::vector<float> weight(count);
        std::vector<float> value(count);
        for (size_t i = 0; i < count; ++i) {
            weight[i] = w.data[i] >= 0 ? 1.0f : 0.0f;  // sky takes part: it bleeds too
            value[i] = w.data[i] >= 0 ? w.data[i] : 0.0f;
        }
        blur(value, weight, w.width, w.height, sizes.depth_blur_px);
        for (size_t i = 0; i < count; ++i)
            if (w.data[i] > 0) out.data[i] = value[i];
    }
    std::vector<float> field;
    if (sizes.depth_field > 0) {
        Draw draw(sizes.seed, camera, "field");
        field.resize(count);
        for (float& f : field) f = float(draw.unit() - 0.5);
        std::vector<float> weight(count, 1.0f);
        blur(field, weight, w.width, w.height, field_sigma_px);
        double squares = 0;
        for (const float f : field) squares += double(f) * double(f);
        const float scale = squares > 0 ? float(sizes.depth_field / std::sqrt(squares / double(count))) : 0;
        for (float& f : field) f *= scale;
    }
    const double log_scale = Draw(sizes.seed, camera, "scale").sign() * sizes.depth_scale;
    const double bias_m = Draw(sizes.seed, camera, "bias").sign() * sizes.depth_bias_m;
    for (size_t i = 0; i < count; ++i) {
        if (!(out.data[i] > 0)) continue;
        const double z = std::exp(log_scale + (field.empty() ? 0 : double(field[i]))) / double(out.data[i]) + bias_m;
        out.data[i] = float(1 / std::max(z, 1e-3));
    }
    return out;
}

glm::vec2 bent_source_px(const BentView& view, const glm::dvec3& from, const glm::dvec3& along, double start) {
    const Intrinsics& k = view.intrinsics;
    const Pose cam_from_world = inverse(view.world_from_cam);
    const glm::dvec3 o = cam_from_world.point(from), d = cam_from_world.direction(along);
    const bool endless = !std::isfinite(start);
    double t = start;
    glm::dvec2 u(0);
    for (int step = 0;; ++step) {
        const auto at = project(k, endless ? d : o + t * d);
        if (!at) break;
        u = glm::clamp(*at, glm::dvec2(0.5), glm::dvec2(k.width - 0.5, k.height - 0.5));
        if (endless || step == lookup_steps) break;
        const double gx = u.x - 0.5, gy = u.y - 0.5;
        const int x0 = std::min(int(gx), std::max(k.width - 2, 0)), y0 = std::min(int(gy), std::max(k.height - 2, 0));
        const int x1 = std::min(x0 + 1, k.width - 1), y1 = std::min(y0 + 1, k.height - 1);
        const Grid<float>& w = view.inverse_depth;
        const float corners[4] = {w.at(x0, y0), w.at(x1, y0), w.at(x0, y1), w.at(x1, y1)};
        const auto [low, high] = std::minmax_element(corners, corners + 4);
        const double fx = gx - x0, fy = gy - y0;
        double q = double(corners[(fx < 0.5 ? 0 : 1) + (fy < 0.5 ? 0 : 2)]);
        if (*low > 0 && *high < 1.1f * *low)  // one surface
            q = (1 - fy) * ((1 - fx) * double(corners[0]) + fx * double(corners[1])) +
                fy * ((1 - fx) * double(corners[2]) + fx * double(corners[3]));
        if (!(q > 0) || std::fabs(d.z) < 1e-6) break;
        t = std::clamp((1 / q - o.z) / d.z, 0.25 * start, 4 * start);
    }
    return glm::vec2(u);
}

}  // namespace vshift
