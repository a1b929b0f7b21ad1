// SPDX-License-Identifier: Apache-2.0
#include "inpaint/judge_streets.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <map>
#include <memory>
#include <random>

#include "embree_core/fill.h"
#include "inpaint/network_library.h"
#include "inpaint/street_pairs.h"

namespace vshift::inpaint {
namespace {

using nlohmann::ordered_json;

struct Sums {
    double error = 0, gradient = 0;
};

/// Over the mask's pixels: squared error against `truth`, and squared differences to the right and lower neighbours.
Sums sums_of(const std::vector<float>& image, const std::vector<float>& truth, const Mask& mask) {
    Sums s;
    const size_t n = mask.size(), w = size_t(mask.width);
    for (size_t i = 0; i < n; ++i) {
        if (!mask.data[i]) continue;
        const bool right = (i + 1) % w != 0, below = i + w < n;
        for (size_t c = 0; c < 3; ++c) {
            const size_t at = c * n + i;
            const double e = double(image[at]) - double(truth[at]);
            s.error += e * e / 3;
            const double dx = right ? double(image[at + 1]) - double(image[at]) : 0;
            const double dy = below ? double(image[at + w]) - double(image[at]) : 0;
            s.gradient += (dx * dx + dy * dy) / 3;
        }
    }
    return s;
}

double psnr_db(double error, double pixels) {
    return -10 * std::log10(std::max(error / pixels, 1e-12));
}

/// Over views: squared errors of every classical fill in the order of fill_method_names(), and of the network.
struct Errors {
    double pixels = 0, network = 0;
    std::vector<double> fills = std::vector<double>(fill_method_names().size());

    void add(const Errors& e) {
        pixels += e.pixels;
        network += e.network;
        for (size_t i = 0; i < fills.size(); ++i) fills[i] += e.fills[i];
    }
    size_t best_fill() const { return size_t(std::min_element(fills.begin(), fills.end()) - fills.begin()); }
    double gain_db() const { return psnr_db(network, pixels) - psnr_db(fills[best_fill()], pixels); }
};

struct Pool {
    double ms = 0, views = 0;
    Sums fill, network, truth;
    std::map<uint32_t, Errors> streets;

    Errors errors() const {
        Errors all;
        for (const auto& [seed, e] : streets) all.add(e);
        return all;
    }
};

/// 95 % interval of the gain over the best fill of each draw: streets drawn with replacement. None for one street.
ordered_json gain_interval(const Pool& pool) {
    std::vector<const Errors*> streets;
    for (const auto& [seed, e] : pool.streets) streets.push_back(&e);
    if (streets.size() < 2) return nullptr;
    std::mt19937 random(1);
    std::vector<double> gains;
    for (int round = 0; round < 2000; ++round) {
        Errors drawn;
        for (size_t i = 0; i < streets.size(); ++i) drawn.add(*streets[size_t((uint64_t(random()) * streets.size()) >> 32)]);
        gains.push_back(drawn.gain_db());
    }
    std::sort(gains.begin(), gains.end());
    return {gains[50], gains[1949]};
}

}  // namespace

ordered_json judge_streets(const JudgeOptions& o, const std::function<void(size_t, size_t)>& show) {
    const NetworkLibrary& library = network_library();
    vshift_inpaint_model* opened = nullptr;
    check(library.model_open(o.model_file.c_str(), &opened));
    const std::unique_ptr<vshift_inpaint_model, decltype(library.model_free)> model(opened, library.model_free);

    const auto rig = analytic::six_camera_rig(o.width, o.width * 9 / 16);
    ordered_json views = ordered_json::array();
    std::map<std::pair<int, double>, Pool> pools;
    const size_t total = o.seeds.size() * o.shifts_m.size() * rig.size();
    size_t done = 0;
    for (const uint32_t seed : o.seeds) {
        const analytic::StreetScene street = analytic::build_street(seed);
        for (const double shift_m : o.shifts_m)
            for (size_t own = 0; own < rig.size(); ++own) {
                show(done++, total);
                Shift shift;
                shift.translation_m = {0, shift_m, 0};
                const TrueShiftedView v = true_shifted_view(street, rig, int(own), o.frame, shift);
                double pixels = 0;
                for (const uint8_t d : v.disoccluded.data) pixels += d != 0;
                if (pixels == 0) continue;
                const Sums truth = sums_of(v.planes.target, v.planes.target, v.disoccluded);
                const Sums background = sums_of(v.planes.fill, v.planes.target, v.disoccluded);
                Errors errors;
                errors.pixels = pixels;
                ordered_json fill_errors;
                for (size_t m = 0; m < errors.fills.size(); ++m) {
                    const ColorImage filled = fill({v.warped.color, v.warped.missing, v.depth}, FillMethod(m));
                    errors.fills[m] = sums_of(display_planes(filled), v.planes.target, v.disoccluded).error;
                    fill_errors[fill_method_names()[m]] = errors.fills[m];
                }
                for (const int steps : o.steps) {
                    vshift_inpaint_stream* begun = nullptr;
                    check(library.stream_open(model.get(), steps, o.noise_seed, &begun));
                    const std::unique_ptr<vshift_inpaint_stream, decltype(library.stream_free)> stream(begun, library.stream_free);
                    std::vector<float> color(v.planes.fill.size());
                    const vshift_inpaint_views given = v.planes.views();
                    const auto start = std::chrono::steady_clock::now();
                    check(library.stream_next(stream.get(), &given, color.data()));
                    const double ms = std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
                    const Sums made = sums_of(color, v.planes.target, v.disoccluded);
                    views.push_back({{"seed", seed}, {"camera", rig[own].name}, {"shift_m", shift_m}, {"steps", steps},
                                     {"disoccluded_px", pixels}, {"fill_errors", fill_errors}, {"network_error", made.error},
                                     {"fill_gradient", background.gradient}, {"network_gradient", made.gradient},
                                     {"truth_gradient", truth.gradient}, {"ms", ms}});
                    Pool& p = pools[{steps, std::abs(shift_m)}];
                    p.ms += ms;
                    p.views += 1;
                    errors.network = made.error;
                    p.streets[seed].add(errors);
                    p.fill.gradient += background.gradient;
                    p.network.gradient += made.gradient;
                    p.truth.gradient += truth.gradient;
                }
            }
    }
    ordered_json pooled = ordered_json::array();
    for (const auto& [key, p] : pools) {
        const Errors e = p.errors();
        ordered_json fills_db;
        for (size_t m = 0; m < e.fills.size(); ++m) fills_db[fill_method_names()[m]] = psnr_db(e.fills[m], e.pixels);
        pooled.push_back({{"steps", key.first}, {"shift_m", key.second}, {"views", p.views}, {"disoccluded_px", e.pixels},
                          {"fills_db", fills_db}, {"best_fill", fill_method_names()[e.best_fill()]},
                          {"network_db", psnr_db(e.network, e.pixels)}, {"gain_db", e.gain_db()}, {"gain_db_95", gain_interval(p)},
                          {"fill_gradient_share", p.fill.gradient / p.truth.gradient},
                          {"network_gradient_share", p.network.gradient / p.truth.gradient}, {"ms", p.ms / p.views}});
    }
    return {{"model", o.model_file}, {"width", o.width}, {"views", views}, {"pooled", pooled}};
}

std::string judge_table(const ordered_json& result) {
    std::string text = "steps  shift_m  best fill    fill_db  network_db  gain_db        95 %        gradient(background)  gradient(network)  ms\n";
    char line[200];
    for (const auto& r : result["pooled"]) {
        const std::string best = r["best_fill"];
        char interval[40] = "";
        if (const auto& i = r["gain_db_95"]; i.is_array())
            std::snprintf(interval, sizeof interval, "%+.2f to %+.2f", i[0].get<double>(), i[1].get<double>());
        std::snprintf(line, sizeof line, "%5d  %7g  %-10s  %8.2f  %10.2f  %+7.2f  %16s  %20.2f  %17.2f  %.0f\n", r["steps"].get<int>(),
                      r["shift_m"].get<double>(), best.c_str(), r["fills_db"][best].get<double>(), r["network_db"].get<double>(),
                      r["gain_db"].get<double>(), interval, r["fill_gradient_share"].get<double>(),
                      r["network_gradient_share"].get<double>(), r["ms"].get<double>());
        text += line;
    }
    return text;
}

}  // namespace vshift::inpaint
