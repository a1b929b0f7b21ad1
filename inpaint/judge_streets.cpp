// SPDX-License-Identifier: Apache-2.0
#include "inpaint/judge_streets.h"

#include <chrono>
#include <cmath>
#include <map>
#include <memory>

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

struct Pool {
    double pixels = 0, ms = 0, views = 0;
    Sums fill, network, truth;
};

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
                const Sums fill = sums_of(v.planes.fill, v.planes.target, v.disoccluded);
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
                                     {"disoccluded_px", pixels}, {"fill_error", fill.error}, {"network_error", made.error},
                                     {"fill_gradient", fill.gradient}, {"network_gradient", made.gradient},
                                     {"truth_gradient", truth.gradient}, {"ms", ms}});
                    Pool& p = pools[{steps, std::abs(shift_m)}];
                    p.pixels += pixels;
                    p.ms += ms;
                    p.views += 1;
                    p.fill.error += fill.error;
                    p.fill.gradient += fill.gradient;
                    p.network.error += made.error;
                    p.network.gradient += made.gradient;
                    p.truth.gradient += truth.gradient;
                }
            }
    }
    ordered_json pooled = ordered_json::array();
    for (const auto& [key, p] : pools)
        pooled.push_back({{"steps", key.first}, {"shift_m", key.second}, {"views", p.views}, {"disoccluded_px", p.pixels},
                          {"fill_db", psnr_db(p.fill.error, p.pixels)}, {"network_db", psnr_db(p.network.error, p.pixels)},
                          {"fill_gradient_share", p.fill.gradient / p.truth.gradient},
                          {"network_gradient_share", p.network.gradient / p.truth.gradient}, {"ms", p.ms / p.views}});
    return {{"model", o.model_file}, {"width", o.width}, {"views", views}, {"pooled", pooled}};
}

std::string judge_table(const ordered_json& result) {
    std::string text = "steps  shift_m  fill_db  network_db  gain_db  gradient(fill)  gradient(network)  ms\n";
    char line[160];
    for (const auto& r : result["pooled"]) {
        const double fill = r["fill_db"], network = r["network_db"];
        std::snprintf(line, sizeof line, "%5d  %7g  %7.2f  %10.2f  %+7.2f  %14.2f  %17.2f  %.0f\n", r["steps"].get<int>(),
                      r["shift_m"].get<double>(), fill, network, network - fill, r["fill_gradient_share"].get<double>(),
                      r["network_gradient_share"].get<double>(), r["ms"].get<double>());
        text += line;
    }
    return text;
}

}  // namespace vshift::inpaint
