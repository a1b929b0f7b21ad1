// SPDX-License-Identifier: Apache-2.0
#include "embree_core/depth_source.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <limits>

namespace vshift {
namespace {

constexpr int snap_reach_px = 2;
constexpr float least_step = 0.05f;  // of 1/z
// A slope goes on farther out, a blurred step does not: over twice the reach it rises by less than this.
constexpr float step_rise = 1.5f;
// On a blurred step a pixel differs from both neighbours across it by this share of the step. Beside a sharp one it
// is like its own side.
constexpr float slope_share = 0.05f;

/// The smallest or largest value within `snap_reach_px` along both axes.
template <class Pick>
Grid<float> extreme(const Grid<float>& in, const Pick& pick) {
    const int width = in.width, height = in.height;
    Grid<float> rows(width, height), out(width, height);
    tbb::parallel_for(0, height, [&](int y) {
        const float* from = &in.data[size_t(y) * size_t(width)];
        float* to = &rows.data[size_t(y) * size_t(width)];
        for (int x = 0; x < width; ++x) {
            float value = from[x];
            for (int k = std::max(0, x - snap_reach_px); k <= std::min(width - 1, x + snap_reach_px); ++k)
                value = pick(value, from[k]);
            to[x] = value;
        }
    });
    tbb::parallel_for(0, height, [&](int y) {
        float* to = &out.data[size_t(y) * size_t(width)];
        std::copy_n(&rows.data[size_t(y) * size_t(width)], width, to);
        for (int k = std::max(0, y - snap_reach_px); k <= std::min(height - 1, y + snap_reach_px); ++k) {
            const float* from = &rows.data[size_t(k) * size_t(width)];
            for (int x = 0; x < width; ++x) to[x] = pick(to[x], from[x]);
        }
    });
    return out;
}

}  // namespace

const std::vector<std::string>& depth_source_words() {
    static const std::vector<std::string> words{"exact", "half", "mm16", "disparity8", "mono"};
    return words;
}

DepthRules depth_rules(DepthSource source, const DepthMap& depth, double step_m) {
    DepthRules rules;
    switch (source) {
        case DepthSource::exact:
            break;
        case DepthSource::half:
            rules.error.relative = 1.0f / 2048;  // half a unit in the last of 11 binary digits
            break;
        case DepthSource::mm16:
            rules.error.squared = float(0.5 * step_m);
            break;
        case DepthSource::disparity8: {
            float nearest_m = std::numeric_limits<float>::infinity();
            for (const float z : depth.data)
                if (is_measured(z)) nearest_m = std::min(nearest_m, z);
            rules.error.constant = 0.5f / 255 / nearest_m;
            break;
        }
        case DepthSource::mono:
            rules.tear_px = 2, rules.tear_break = 0.5;
            break;
    }
    return rules;
}

DepthMap snap_edges(const DepthMap& depth) {
    const int width = depth.width, height = depth.height;
    // NaN, no measurement, is no extreme: std::min and std::max keep what they have.
    Grid<float> w(width, height);
    for (size_t i = 0; i < w.size(); ++i)
        w.data[i] = is_sky(depth.data[i])        ? 0.0f
                    : is_measured(depth.data[i]) ? 1.0f / depth.data[i]
                                                 : std::numeric_limits<float>::quiet_NaN();
    const auto lower = [](float a, float b) { return b < a || std::isnan(a) ? b : a; };
    const auto upper = [](float a, float b) { return b > a || std::isnan(a) ? b : a; };
    const Grid<float> low = extreme(w, lower), high = extreme(w, upper);
    const Grid<float> low_wide = extreme(low, lower), high_wide = extreme(high, upper);
    DepthMap out = depth;
    // Nearer to the image's border a slope cannot be told from a step.
    constexpr int frame = 2 * snap_reach_px;
    tbb::parallel_for(frame, std::max(frame, height - frame), [&](int y) {
        const auto on_slope = [&](int x, float own, float least) {
            constexpr int ways[4][2] = {{1, 0}, {0, 1}, {1, 1}, {1, -1}};
            for (const auto& [dx, dy] : ways) {
                const float ahead = w.at(x + dx, y + dy) - own, behind = own - w.at(x - dx, y - dy);
                if ((ahead > least && behind > least) || (ahead < -least && behind < -least)) return true;
            }
            return false;
        };
        for (int x = frame; x < width - frame; ++x) {
            const size_t i = size_t(y) * size_t(width) + size_t(x);
            const float own = w.data[i], least = low.data[i], most = high.data[i], step = most - least;
            if (!(step >= least_step * most)) continue;
            if (high_wide.data[i] - low_wide.data[i] > step_rise * step) continue;
            if (!on_slope(x, own, slope_share * step)) continue;
            const float snapped = own - least > most - own ? most : least;
            out.data[i] = snapped > 0 ? 1.0f / snapped : std::numeric_limits<float>::infinity();
        }
    });
    return out;
}

}  // namespace vshift
