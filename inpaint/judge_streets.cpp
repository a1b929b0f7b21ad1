// SPDX-License-Identifier: Apache-2.0
#include "inpaint/judge_streets.h"

#include <algorithm>
#include <cmath>
#include <ctime>
#include <filesystem>
#include <map>
#include <memory>
#include <random>

#include "embree_core/fill.h"
#include "inpaint/network_library.h"
#include "inpaint/street_pairs.h"
#include "inpaint/texture.h"

namespace vshift::inpaint {
namespace {

using nlohmann::ordered_json;

struct Sums {
    double error = 0, gradient = 0;

    void add(const Sums& s) {
        error += s.error;
        gradient += s.gradient;
    }
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
    return pixels > 0 ? -10 * std::log10(std::max(error / pixels, 1e-12)) : std::nan("");
}

double cpu_ms() {
    timespec t{};
    ::clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return double(t.tv_sec) * 1e3 + double(t.tv_nsec) * 1e-6;
}

/// Over views of a street: one way to fill them.
struct Filled {
    Sums disoccluded;
    double outside_error = 0, ms = 0, least_ms = 1e300;
    TextureMoments texture;

    void add(const Filled& f) {
        disoccluded.add(f.disoccluded);
        outside_error += f.outside_error;
        ms += f.ms;
        least_ms = std::min(least_ms, f.least_ms);
        texture.add(f.texture);
    }
};

/// Over views of a street, or of many: the truth and every way.
struct Pool {
    double views = 0, pixels = 0, outside_pixels = 0, truth_gradient = 0;
    TextureMoments truth_texture;
    std::vector<Filled> ways;

    void add(const Pool& p) {
        ways.resize(p.ways.size());
        views += p.views;
        pixels += p.pixels;
        outside_pixels += p.outside_pixels;
        truth_gradient += p.truth_gradient;
        truth_texture.add(p.truth_texture);
        for (size_t i = 0; i < ways.size(); ++i) ways[i].add(p.ways[i]);
    }
    double db(size_t way) const { return psnr_db(ways[way].disoccluded.error, pixels); }
    double gradient_share(size_t way) const { return ways[way].disoccluded.gradient / truth_gradient; }
    double distance(size_t way) const { return texture_distance(ways[way].texture, truth_texture); }
    size_t best_fill() const {
        size_t best = 0;
        for (size_t i = 1; i < fill_method_names().size(); ++i)
            if (db(i) > db(best)) best = i;
        return best;
    }
    double gain_db(size_t way) const { return db(way) - db(best_fill()); }
};

/// A shift size's streets, apart.
using Streets = std::map<uint32_t, Pool>;

Pool sum_of(const Streets& streets) {
    Pool all;
    for (const auto& [seed, p] : streets) all.add(p);
    return all;
}

/// 95 % intervals of what `figures` gives: streets drawn with replacement. Null for one street.
ordered_json intervals(const Streets& streets, int rounds, const std::function<std::vector<double>(const Pool&)>& figures) {
    std::vector<const Pool*> all;
    for (const auto& [seed, p] : streets) all.push_back(&p);
    std::mt19937 random(1);
    std::vector<std::vector<double>> drawn;
    for (int round = 0; round < rounds && all.size() > 1; ++round) {
        Pool pool;
        for (size_t i = 0; i < all.size(); ++i) pool.add(*all[size_t((uint64_t(random()) * all.size()) >> 32)]);
        const std::vector<double> values = figures(pool);
        drawn.resize(values.size());
        for (size_t i = 0; i < values.size(); ++i) drawn[i].push_back(values[i]);
    }
    ordered_json out = ordered_json::array();
    for (auto& values : drawn) {
        std::sort(values.begin(), values.end());
        const auto at = [&](double share) { return values[size_t(share * double(values.size() - 1) + 0.5)]; };
        out.push_back({at(0.025), at(0.975)});
    }
    return out;
}

struct Way {
    std::string name;  ///< a fill's, "seam+background", or "MODEL" or "MODEL, N steps"
    size_t model = 0;  ///< of networks
    int steps = 0;     ///< 0: no network
    bool seam = false;
};

using OpenModel = std::unique_ptr<vshift_inpaint_model, decltype(&vshift_inpaint_model_free)>;

std::vector<Way> ways_of(const JudgeOptions& o, const std::vector<OpenModel>& models) {
    std::vector<Way> ways;
    for (const std::string& name : fill_method_names()) ways.push_back({name, 0, 0, false});
    std::vector<Way> networks;
    bool seam = false;
    for (size_t m = 0; m < models.size(); ++m) {
        const auto config = nlohmann::json::parse(network_library().model_config(models[m].get()));
        const bool neighbors = config.value("neighbors", false), flow = config.value("flow", false);
        const std::string name = std::filesystem::path(o.model_files[m]).stem().string();
        seam = seam || neighbors;
        for (const int steps : flow ? o.steps : std::vector<int>{1})
            networks.push_back({name + (flow ? ", " + std::to_string(steps) + (steps == 1 ? " step" : " steps") : ""), m, steps, neighbors});
    }
    if (seam) ways.push_back({"seam+background", 0, 0, true});
    ways.insert(ways.end(), networks.begin(), networks.end());
    return ways;
}

std::vector<float> filled_by(const Way& way, const TrueShiftedView& v, vshift_inpaint_model* model, uint64_t noise_seed) {
    if (!way.steps && way.seam) return v.seam_planes.fill;
    if (!way.steps)
        return display_planes(fill({v.warped.color, v.warped.missing, v.depth}, fill_method(way.name, "judge")));
    vshift_inpaint_stream* begun = nullptr;
    check(network_library().stream_open(model, way.steps, noise_seed, &begun));
    const std::unique_ptr<vshift_inpaint_stream, decltype(network_library().stream_free)> stream(begun, network_library().stream_free);
    std::vector<float> color(v.planes.fill.size());
    const vshift_inpaint_views given = (way.seam ? v.seam_planes : v.planes).views();
    check(network_library().stream_next(stream.get(), &given, color.data()));
    return color;
}

double count_of(const Mask& mask) {
    double count = 0;
    for (const uint8_t m : mask.data) count += m != 0;
    return count;
}

}  // namespace

ordered_json judge_streets(const JudgeOptions& o, const std::function<void(size_t, size_t)>& show) {
    std::vector<OpenModel> models;
    for (const std::string& file : o.model_files) {
        vshift_inpaint_model* opened = nullptr;
        check(network_library().model_open(file.c_str(), &opened));
        models.emplace_back(opened, network_library().model_free);
    }
    const std::vector<Way> ways = ways_of(o, models);
    const bool seam = std::any_of(ways.begin(), ways.end(), [](const Way& w) { return w.seam; });

    ordered_json views = ordered_json::array();
    std::map<double, Streets> pools;  // by shift size; 0: all
    const size_t cameras = analytic::six_camera_rig().size(), total = o.seeds.size() * o.shifts_m.size() * cameras;
    size_t done = 0;
    for (const uint32_t seed : o.seeds) {
        const analytic::StreetScene street = analytic::build_street(seed);
        const RecordedViews recorded = record_frame(street, o.frame, o.width);
        for (const double shift_m : o.shifts_m)
            for (size_t own = 0; own < cameras; ++own) {
                show(done++, total);
                Shift shift;
                shift.translation_m = {0, shift_m, 0};
                const TrueShiftedView v = true_shifted_view(street, recorded, own, o.frame, shift, seam);
                const std::vector<float>& truth = v.planes.target;
                Pool pool;
                pool.views = 1;
                pool.pixels = count_of(v.disoccluded);
                pool.outside_pixels = count_of(v.outside);
                if (pool.pixels == 0) continue;
                pool.truth_gradient = sums_of(truth, truth, v.disoccluded).gradient;
                pool.truth_texture = texture_moments(truth, v.disoccluded);
                for (const Way& way : ways) {
                    Filled f;
                    const double start = cpu_ms();
                    const std::vector<float> color = filled_by(way, v, models[way.model].get(), o.noise_seed);
                    f.ms = f.least_ms = cpu_ms() - start;
                    f.disoccluded = sums_of(color, truth, v.disoccluded);
                    f.outside_error = sums_of(color, truth, v.outside).error;
                    f.texture = texture_moments(color, v.disoccluded);
                    views.push_back({{"seed", seed}, {"camera", recorded.views[own].camera.name}, {"shift_m", shift_m},
                                     {"way", way.name}, {"disoccluded_px", pool.pixels}, {"error", f.disoccluded.error},
                                     {"gradient", f.disoccluded.gradient}, {"truth_gradient", pool.truth_gradient},
                                     {"outside_px", pool.outside_pixels}, {"outside_error", f.outside_error}, {"cpu_ms", f.ms}});
                    pool.ways.push_back(std::move(f));
                }
                for (const double size : {std::abs(shift_m), 0.0}) pools[size][seed].add(pool);
            }
    }

    ordered_json rows = ordered_json::array();
    for (const auto& [size, streets] : pools) {
        const Pool all = sum_of(streets);
        const ordered_json gains = intervals(streets, 2000, [&](const Pool& p) {
            std::vector<double> figures;
            for (size_t w = 0; w < ways.size(); ++w) figures.push_back(p.gain_db(w));
            for (size_t w = 0; w < ways.size(); ++w) figures.push_back(p.db(w));
            for (size_t w = 0; w < ways.size(); ++w) figures.push_back(psnr_db(p.ways[w].outside_error, p.outside_pixels));
            for (size_t w = 0; w < ways.size(); ++w) figures.push_back(p.gradient_share(w));
            return figures;
        });
        const ordered_json distances = intervals(streets, 200, [&](const Pool& p) {
            std::vector<double> figures;
            for (size_t w = 0; w < ways.size(); ++w) figures.push_back(p.distance(w));
            return figures;
        });
        const auto interval = [&](const ordered_json& of, size_t kind, size_t way) {
            return of.empty() ? ordered_json(nullptr) : of[kind * ways.size() + way];
        };
        for (size_t w = 0; w < ways.size(); ++w) {
            const Filled& f = all.ways[w];
            rows.push_back({{"shift_m", size}, {"way", ways[w].name}, {"steps", ways[w].steps}, {"views", all.views},
                            {"disoccluded_px", all.pixels}, {"best_fill", fill_method_names()[all.best_fill()]},
                            {"psnr_db", all.db(w)}, {"psnr_db_95", interval(gains, 1, w)}, {"gain_db", all.gain_db(w)},
                            {"gain_db_95", interval(gains, 0, w)}, {"outside_db", psnr_db(f.outside_error, all.outside_pixels)},
                            {"outside_db_95", interval(gains, 2, w)}, {"gradient_share", all.gradient_share(w)},
                            {"gradient_share_95", interval(gains, 3, w)}, {"texture_distance", all.distance(w)},
                            {"texture_distance_95", interval(distances, 0, w)}, {"patches", f.texture.count},
                            {"cpu_ms", f.ms / all.views}, {"least_cpu_ms", f.least_ms}});
        }
    }
    return {{"models", o.model_files}, {"width", o.width}, {"views", views}, {"ways", rows}};
}

std::string judge_table(const ordered_json& result) {
    std::string text = "shift_m  way                             psnr_db   gain_db        95 %        outside_db  gradient  texture  cpu_ms\n";
    char line[240];
    for (const auto& r : result["ways"]) {
        char interval[40] = "";
        if (const auto& i = r["gain_db_95"]; i.is_array())
            std::snprintf(interval, sizeof interval, "%+.2f to %+.2f", i[0].get<double>(), i[1].get<double>());
        const double shift = r["shift_m"];
        char shown[16] = "all";
        if (shift > 0) std::snprintf(shown, sizeof shown, "%g", shift);
        const auto number = [&](const char* field) { return r[field].is_number() ? r[field].get<double>() : std::nan(""); };
        std::snprintf(line, sizeof line, "%7s  %-30s  %7.2f  %+8.2f  %16s  %10.2f  %8.2f  %7.3f  %6.1f\n", shown,
                      r["way"].get_ref<const std::string&>().c_str(), number("psnr_db"), number("gain_db"), interval,
                      number("outside_db"), number("gradient_share"), number("texture_distance"), number("cpu_ms"));
        text += line;
    }
    return text;
}

}  // namespace vshift::inpaint
