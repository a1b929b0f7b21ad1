// SPDX-License-Identifier: Apache-2.0
#include "inpaint/depth_judge.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <random>

#include "embree_core/depth_source.h"
#include "embree_core/score.h"
#include "embree_core/sweep.h"
#include "inpaint/depth_estimator.h"
#include "scenes/analytic/analytic_street.h"

namespace vshift::inpaint {
namespace {

using nlohmann::ordered_json;

constexpr double judged_to_m = 80, edge_step = 0.2, edge_to_m = 50, edge_px = 1.5;
constexpr const char* sources[] = {"exact", "mono"};

double inverse_of(float z) {
    return is_measured(z) ? 1 / double(z) : 0;
}

/// Where 1/z steps by more than a fifth to the right or lower neighbour; the nearer pixel of the two, within 50 m.
Mask edges_of(const DepthMap& depth) {
    Mask edges(depth.width, depth.height);
    const auto mark = [&](int x0, int y0, int x1, int y1) {
        const double a = inverse_of(depth.at(x0, y0)), b = inverse_of(depth.at(x1, y1)), near = std::max(a, b);
        if (near > 1 / edge_to_m && std::abs(a - b) > edge_step * near) edges.at(a > b ? x0 : x1, a > b ? y0 : y1) = 1;
    };
    for (int y = 0; y < depth.height; ++y)
        for (int x = 0; x < depth.width; ++x) {
            if (x + 1 < depth.width) mark(x, y, x + 1, y);
            if (y + 1 < depth.height) mark(x, y, x, y + 1);
        }
    return edges;
}

/// For every set pixel of `of`, the distance to the nearest of `to`, up to `most_px` (which is also given where none is).
void add_distances(const Mask& of, const Mask& to, int most_px, std::vector<float>& out) {
    for (int y = 0; y < of.height; ++y)
        for (int x = 0; x < of.width; ++x) {
            if (!of.at(x, y)) continue;
            int best = most_px * most_px;
            for (int v = std::max(0, y - most_px); v <= std::min(of.height - 1, y + most_px); ++v)
                for (int u = std::max(0, x - most_px); u <= std::min(of.width - 1, x + most_px); ++u)
                    if (to.at(u, v)) best = std::min(best, (u - x) * (u - x) + (v - y) * (v - y));
            out.push_back(std::sqrt(float(best)));
        }
}

size_t within(const std::vector<float>& distances, double px) {
    return size_t(std::count_if(distances.begin(), distances.end(), [&](float d) { return d <= px; }));
}

double quantile(std::vector<double> values, double share) {
    if (values.empty()) return 0;
    const auto at = values.begin() + std::ptrdiff_t(share * double(values.size() - 1) + 0.5);
    std::nth_element(values.begin(), at, values.end());
    return *at;
}

struct DepthSums {
    double pixels = 0, relative = 0, scaled_relative = 0, close = 0;
    std::vector<double> scales;  ///< one per view
    Confusion sky;
    std::vector<float> found_to_true, true_to_found;

    void add(const DepthMap& got, const DepthMap& truth) {
        std::vector<double> ratios;
        for (size_t i = 0; i < truth.size(); ++i) {
            const bool is = is_sky(truth.data[i]), said = is_sky(got.data[i]);
            ++(is ? said ? sky.true_positive : sky.false_negative : said ? sky.false_positive : sky.true_negative);
            if (truth.data[i] <= judged_to_m && is_measured(truth.data[i]))
                ratios.push_back(std::min(is_measured(got.data[i]) ? double(got.data[i]) : judged_to_m, judged_to_m) / double(truth.data[i]));
        }
        if (ratios.empty()) return;
        const double scale = quantile(ratios, 0.5);
        scales.push_back(scale);
        pixels += double(ratios.size());
        for (const double r : ratios) {
            relative += std::abs(r - 1);
            scaled_relative += std::abs(r / scale - 1);
            close += std::max(r, 1 / r) < 1.25;
        }
        const Mask found = edges_of(got), true_edges = edges_of(truth);
        add_distances(found, true_edges, 16, found_to_true);
        add_distances(true_edges, found, 16, true_to_found);
    }

    ordered_json json() const {
        const double precision = double(within(found_to_true, edge_px)) / std::max<double>(1, double(found_to_true.size()));
        const double recall = double(within(true_to_found, edge_px)) / std::max<double>(1, double(true_to_found.size()));
        const double sum = precision + recall;
        const double sky_f1 = 2.0 * double(sky.true_positive) /
                              std::max<double>(1, 2.0 * double(sky.true_positive) + double(sky.false_positive + sky.false_negative));
        return {{"views", scales.size()},
                {"pixels", pixels},
                {"abs_rel", relative / pixels},
                {"delta1", close / pixels},
                {"scale", quantile(scales, 0.5)},
                {"scale_5_to_95", {quantile(scales, 0.05), quantile(scales, 0.95)}},
                {"abs_rel_scaled", scaled_relative / pixels},
                {"sky_f1", sky_f1},
                {"edges", {{"precision", precision}, {"recall", recall}, {"f1", sum > 0 ? 2 * precision * recall / sum : 0},
                           {"offset_px", quantile({true_to_found.begin(), true_to_found.end()}, 0.5)}}}};
    }
};

using Counts = std::array<Confusion, 2>;  ///< in the order of `sources`

double f1_of(const Confusion& c) {
    const double t = double(c.true_positive);
    return t > 0 ? 2 * t / (2 * t + double(c.false_positive + c.false_negative)) : 0;
}

void add(Confusion& to, const Confusion& c) {
    to.true_positive += c.true_positive;
    to.false_positive += c.false_positive;
    to.false_negative += c.false_negative;
    to.true_negative += c.true_negative;
}

/// The sweep's `occluded` against the scene, inside V's picture.
Confusion mask_counts(const SweepCamera& camera, const DepthMap& depth, const Grid<uint8_t>& truth) {
    Grid<uint8_t> classes;
    Sweeper().classes(camera, depth, classes);
    Confusion c;
    for (size_t i = 0; i < truth.size(); ++i) {
        if (truth.data[i] & VSHIFT_TRUTH_OUTSIDE) continue;
        const bool is = truth.data[i] & VSHIFT_TRUTH_OCCLUDED, said = classes.data[i] & occluded_bit;
        ++(is ? said ? c.true_positive : c.false_negative : said ? c.false_positive : c.true_negative);
    }
    return c;
}

ordered_json mask_row(double shift_m, size_t source, const std::map<uint32_t, Counts>& streets) {
    std::vector<Confusion> each;
    Confusion all;
    for (const auto& [seed, counts] : streets) {
        each.push_back(counts[source]);
        add(all, counts[source]);
    }
    ordered_json interval = nullptr;
    if (each.size() > 1) {
        std::mt19937 random(1);
        std::vector<double> drawn;
        for (int round = 0; round < 2000; ++round) {
            Confusion c;
            for (size_t i = 0; i < each.size(); ++i) add(c, each[size_t((uint64_t(random()) * each.size()) >> 32)]);
            drawn.push_back(f1_of(c));
        }
        interval = {quantile(drawn, 0.025), quantile(drawn, 0.975)};
    }
    const double t = double(all.true_positive);
    return {{"shift_m", shift_m},
            {"depth", sources[source]},
            {"precision", t / std::max(1.0, t + double(all.false_positive))},
            {"recall", t / std::max(1.0, t + double(all.false_negative))},
            {"f1", f1_of(all)},
            {"f1_95", interval}};
}

}  // namespace

ordered_json judge_depth(const DepthJudgeOptions& o, const std::function<void(size_t, size_t)>& show) {
    const DepthEstimator estimator(o.model_file, o.trust);
    const auto rig = analytic::six_camera_rig(o.width, o.width * 9 / 16);
    DepthSums depth;
    std::map<double, std::map<uint32_t, Counts>> masks;
    size_t done = 0;
    for (const uint32_t seed : o.seeds) {
        const analytic::StreetScene street = analytic::build_street(seed);
        for (size_t own = 0; own < rig.size(); ++own) {
            show(done++, o.seeds.size() * rig.size());
            const analytic::RigCamera& camera = rig[own];
            const TrueCamera at = analytic::recorded_camera(camera, o.frame);
            const DepthMap truth = cast_camera(street.scene, at).depth;
            const DepthMap got = estimator.depth(analytic::street_color(street, at, 2), camera.intrinsics, camera.ego_from_cam);
            depth.add(got, truth);
            for (const double shift_m : o.shifts_m) {
                Shift shift;
                shift.translation_m = {0, shift_m, 0};
                const auto flags = analytic::street_truth(street, rig, int(own), o.frame, shift).truth_flags;
                SweepCamera sweep;
                sweep.recorded = sweep.shifted = camera.intrinsics;
                sweep.recorded_from_shifted =
                    compose(inverse(camera.ego_from_cam), shifted_ego_from_cam(camera.ego_from_cam, shift));
                Counts& counts = masks[std::abs(shift_m)][seed];
                add(counts[0], mask_counts(sweep, truth, flags));
                sweep.rules = depth_rules(DepthSource::mono, got);
                add(counts[1], mask_counts(sweep, snap_edges(got), flags));
            }
        }
    }
    ordered_json rows = ordered_json::array();
    for (const auto& [shift_m, streets] : masks)
        for (size_t source = 0; source < 2; ++source) rows.push_back(mask_row(shift_m, source, streets));
    return {{"model", o.model_file}, {"width", o.width}, {"streets", o.seeds}, {"depth", depth.json()}, {"masks", rows}};
}

std::string depth_table(const ordered_json& result) {
    const ordered_json& d = result["depth"];
    char line[400];
    std::snprintf(line, sizeof line,
                  "%d views: AbsRel %.3f, delta1 %.3f, scale %.3f (5 %% to 95 %% of views: %.3f to %.3f), AbsRel without it %.3f, "
                  "sky F1 %.3f; edges: precision %.3f, recall %.3f, F1 %.3f, offset %.1f px\n",
                  d["views"].get<int>(), d["abs_rel"].get<double>(), d["delta1"].get<double>(), d["scale"].get<double>(),
                  d["scale_5_to_95"][0].get<double>(), d["scale_5_to_95"][1].get<double>(), d["abs_rel_scaled"].get<double>(),
                  d["sky_f1"].get<double>(), d["edges"]["precision"].get<double>(), d["edges"]["recall"].get<double>(),
                  d["edges"]["f1"].get<double>(), d["edges"]["offset_px"].get<double>());
    std::string text = line;
    text += "shift_m  depth  precision  recall  f1     95 %\n";
    for (const auto& r : result["masks"]) {
        char interval[40] = "";
        if (const auto& i = r["f1_95"]; i.is_array())
            std::snprintf(interval, sizeof interval, "%.3f to %.3f", i[0].get<double>(), i[1].get<double>());
        std::snprintf(line, sizeof line, "%7g  %-5s  %9.3f  %6.3f  %.3f  %s\n", r["shift_m"].get<double>(),
                      r["depth"].get<std::string>().c_str(), r["precision"].get<double>(), r["recall"].get<double>(),
                      r["f1"].get<double>(), interval);
        text += line;
    }
    return text;
}

}  // namespace vshift::inpaint
