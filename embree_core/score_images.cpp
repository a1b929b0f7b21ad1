// SPDX-License-Identifier: Apache-2.0
#include "embree_core/score_images.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <optional>
#include <thread>

#include "embree_core/image_file.h"
#include "embree_core/image_scores.h"
#include "embree_core/score.h"
#include "embree_core/temporal.h"

namespace vshift {
namespace {

using nlohmann::ordered_json;
namespace fs = std::filesystem;

ordered_json finite_or_null(double value) {
    return std::isfinite(value) ? ordered_json(value) : ordered_json(nullptr);
}

/// A true shifted view.
struct TrueView {
    ColorImage linear, shown;
    DepthMap depth;
    std::vector<Region> regions;
    PosedDepth posed() const { return {intrinsics, world_from_cam, depth}; }
    Intrinsics intrinsics;
    Pose world_from_cam;

    const Mask& region(const std::string& name) const {
        return std::find_if(regions.begin(), regions.end(), [&](const Region& r) { return r.name == name; })->mask;
    }
};

struct Sets {
    const Recipe& recipe;
    const Manifest& manifest;
    std::vector<std::string> arms;

    fs::path got(const std::string& arm, const fs::path& item) const {
        return manifest.folder() / "fills" / arm / item;
    }
    bool has(const std::string& arm, const fs::path& item) const {
        std::error_code error;
        return fs::exists(got(arm, item), error);
    }
    TrueView truth(const NamedShift& shift, int frame, const CameraSpec& camera) const {
        const fs::path item = item_path(shift.name, frame, camera.name), file = manifest.folder() / "shifts" / item;
        const Channels image = read_image(file);
        if (image.width != camera.intrinsics.width || image.height != camera.intrinsics.height)
            throw Error(ExitCode::bad_input, file.string() + ": size: got " + std::to_string(image.width) + "x" +
                                                 std::to_string(image.height) + ", expected " +
                                                 std::to_string(camera.intrinsics.width) + "x" +
                                                 std::to_string(camera.intrinsics.height));
        TrueView out;
        out.linear = image.color();
        out.shown = srgb_from_linear(out.linear);
        out.depth = DepthMap(image.width, image.height);
        out.depth.data = image.plane("Z");
        Grid<uint8_t> klass(image.width, image.height);
        Grid<int8_t> source(image.width, image.height);
        const auto &c = image.plane("truth.class"), &s = image.plane("truth.source");
        for (size_t i = 0; i < klass.size(); ++i) {
            klass.data[i] = uint8_t(std::clamp(c[i], 0.0f, 4.0f) + 0.5f);
            source.data[i] = int8_t(std::lround(std::clamp(s[i], -1.0f, 126.0f)));
        }
        out.regions = regions_of(klass, source);
        out.intrinsics = camera.intrinsics;
        const Shift moved = manifest.shift_of((fs::path("shifts") / item).string(), shift.shift);
        out.world_from_cam =
            compose(recipe.world_from_ego(camera.name, frame), shifted_ego_from_cam(camera.ego_from_cam, moved));
        return out;
    }
    ColorImage result(const std::string& arm, const fs::path& item, const ColorImage& truth) const {
        const fs::path file = got(arm, item);
        const Channels image = read_image(file);
        if (image.width != truth.width || image.height != truth.height)
            throw Error(ExitCode::bad_input, file.string() + ": size: got " + std::to_string(image.width) + "x" +
                                                 std::to_string(image.height) + ", expected " +
                                                 std::to_string(truth.width) + "x" + std::to_string(truth.height));
        return image.color();
    }
};

struct ItemRow {
    std::string arm, camera, region;
    NamedShift shift;
    int frame;
    RegionScore score;
};
struct PairRow {  // two views of one arm
    std::string arm, camera, other, region;
    NamedShift shift;
    int frame;
    ConsistencyScore score;
};
struct Unit {
    std::vector<ItemRow> items;
    std::vector<PairRow> temporal, overlap;
};

/// One shift and camera, frame after frame: images, and each against the frame before.
void score_drive(const Sets& sets, const NamedShift& shift, const CameraSpec& camera, Unit& out) {
    std::optional<TrueView> before;
    std::map<std::string, ColorImage> shown_before;
    for (const FrameSpec& frame : sets.recipe.frames) {
        const fs::path item = item_path(shift.name, frame.index, camera.name);
        std::map<std::string, ColorImage> shown;
        std::optional<TrueView> truth;
        if (!sets.manifest.is_refused((fs::path("shifts") / item).string()) &&
            std::any_of(sets.arms.begin(), sets.arms.end(),
                        [&](const std::string& arm) { return sets.has(arm, item); })) {
            truth = sets.truth(shift, frame.index, camera);
            std::optional<Correspondence> match;
            if (before) match = correspond(truth->posed(), before->posed());
            for (const std::string& arm : sets.arms) {
                if (!sets.has(arm, item)) continue;
                const ColorImage got = sets.result(arm, item, truth->linear);
                const ImageMaps maps = compare_images(got, truth->linear);
                for (const Region& region : truth->regions) {
                    const RegionScore score = score_region(maps, &region.mask);
                    if (score.pixels > 0)
                        out.items.push_back({arm, camera.name, region.name, shift, frame.index, score});
                }
                shown[arm] = srgb_from_linear(got);
                if (match && shown_before.contains(arm))
                    for (const std::string region : {"all", "own", "lost", "hole"})
                        out.temporal.push_back({arm, camera.name, camera.name, region, shift, frame.index,
                                                score_consistency(*match, shown[arm], shown_before[arm], truth->shown,
                                                                  before->shown, &truth->region(region))});
            }
        }
        before = std::move(truth);
        shown_before = std::move(shown);
    }
}

/// One shift and frame: every camera against every other that sees the same.
void score_overlap(const Sets& sets, const NamedShift& shift, int frame, Unit& out) {
    std::map<std::string, TrueView> truths;
    for (const CameraSpec& camera : sets.recipe.cameras) {
        const fs::path item = item_path(shift.name, frame, camera.name);
        if (sets.manifest.is_refused((fs::path("shifts") / item).string())) continue;
        if (std::any_of(sets.arms.begin(), sets.arms.end(),
                        [&](const std::string& arm) { return sets.has(arm, item); }))
            truths.emplace(camera.name, sets.truth(shift, frame, camera));
    }
    std::map<std::pair<std::string, std::string>, Correspondence> matches;
    for (const auto& [a, from] : truths)
        for (const auto& [b, to] : truths)
            if (a != b) {
                Correspondence match = correspond(from.posed(), to.posed());
                if (std::any_of(match.matched.data.begin(), match.matched.data.end(), [](uint8_t m) { return m != 0; }))
                    matches.emplace(std::pair{a, b}, std::move(match));
            }
    for (const std::string& arm : sets.arms) {
        std::map<std::string, ColorImage> shown;
        for (const auto& [camera, truth] : truths) {
            const fs::path item = item_path(shift.name, frame, camera);
            if (sets.has(arm, item)) shown[camera] = srgb_from_linear(sets.result(arm, item, truth.linear));
        }
        for (const auto& [pair, match] : matches) {
            const auto& [a, b] = pair;
            if (!shown.contains(a) || !shown.contains(b)) continue;
            for (const std::string region : {"all", "lost", "hole"})
                out.overlap.push_back({arm, a, b, region, shift, frame,
                                       score_consistency(match, shown[a], shown[b], truths.at(a).shown,
                                                         truths.at(b).shown, &truths.at(a).region(region))});
        }
    }
}

std::string distance_name(const NamedShift& shift) {
    const double metres = glm::length(shift.shift.translation_m);
    char text[32];
    std::snprintf(text, sizeof text, "%g m", std::round(metres * 100) / 100);
    return text;
}

/// The pools that a view belongs to: its shift, its distance to either side, all; the latter two also by camera.
std::vector<std::pair<std::string, std::string>> pools_of(const NamedShift& shift, const std::string& camera) {
    const std::string distance = distance_name(shift);
    return {{shift.name, "all"}, {distance, "all"}, {"all", "all"}, {distance, camera}, {"all", camera}};
}

ordered_json interval_of(const std::map<int, FrameSum>& frames, const std::function<double(double)>& statistic) {
    std::vector<FrameSum> sums;
    for (const auto& [frame, sum] : frames) sums.push_back(sum);
    const auto interval = bootstrap(sums);
    if (!interval) return nullptr;
    double a = statistic(interval->low), b = statistic(interval->high);
    if (a > b) std::swap(a, b);
    return std::isfinite(a) && std::isfinite(b) ? ordered_json{a, b} : ordered_json(nullptr);
}

ordered_json summary_of(const std::vector<Unit>& units) {
    struct Pool {
        std::map<int, RegionScore> frames;
        double ms_ssim = 0;
        uint64_t ms_ssim_pixels = 0;
        size_t views = 0;
    };
    std::map<std::array<std::string, 4>, Pool> pools;
    for (const Unit& unit : units)
        for (const ItemRow& row : unit.items)
            for (const auto& [shift, camera] : pools_of(row.shift, row.camera)) {
                Pool& pool = pools[{row.arm, shift, camera, row.region}];
                RegionScore& sum = pool.frames[row.frame];
                const RegionScore& s = row.score;
                ++pool.views;
                sum.pixels += s.pixels, sum.squared_error += s.squared_error, sum.ssim += s.ssim, sum.flip += s.flip;
                sum.gradient_error += s.gradient_error, sum.got_energy += s.got_energy,
                    sum.truth_energy += s.truth_energy;
                if (std::isfinite(s.ms_ssim)) {
                    pool.ms_ssim += s.ms_ssim * double(s.pixels);
                    pool.ms_ssim_pixels += s.pixels;
                }
            }
    ordered_json out = ordered_json::array();
    for (const auto& [key, pool] : pools) {
        RegionScore sum;
        std::map<int, FrameSum> error, flip, ssim;
        for (const auto& [frame, s] : pool.frames) {
            sum.pixels += s.pixels, sum.squared_error += s.squared_error, sum.ssim += s.ssim, sum.flip += s.flip;
            sum.gradient_error += s.gradient_error, sum.got_energy += s.got_energy, sum.truth_energy += s.truth_energy;
            error[frame] = {s.squared_error, 3.0 * double(s.pixels)};
            flip[frame] = {s.flip, double(s.pixels)};
            ssim[frame] = {s.ssim, double(s.pixels)};
        }
        const double n = double(sum.pixels);
        ordered_json row = {{"arm", key[0]},
                            {"shift", key[1]},
                            {"camera", key[2]},
                            {"region", key[3]},
                            {"frames", pool.frames.size()},
                            {"views", pool.views}};
        row.update(image_score_fields(sum.pixels, sum.psnr_db(), sum.ssim / n,
                                      pool.ms_ssim / double(pool.ms_ssim_pixels), sum.flip / n, sum.gradient_error / n,
                                      sum.sharpness()));
        row["psnr_db_95"] = interval_of(error, [](double mean) { return -10 * std::log10(mean); });
        const auto same = [](double mean) { return mean; };
        row["ssim_95"] = interval_of(ssim, same);
        row["flip_95"] = interval_of(flip, same);
        out.push_back(std::move(row));
    }
    return out;
}

ordered_json consistency_of(const std::vector<Unit>& units, std::vector<PairRow> Unit::*rows) {
    std::map<std::array<std::string, 3>, std::map<int, ConsistencyScore>> pools;
    for (const Unit& unit : units)
        for (const PairRow& row : unit.*rows)
            for (const std::string& shift : {row.shift.name, distance_name(row.shift), std::string("all")}) {
                ConsistencyScore& sum = pools[{row.arm, shift, row.region}][row.frame];
                sum.pixels += row.score.pixels, sum.difference += row.score.difference;
                sum.truth_difference += row.score.truth_difference, sum.flicker += row.score.flicker;
            }
    ordered_json out = ordered_json::array();
    for (const auto& [key, frames] : pools) {
        ConsistencyScore sum;
        std::map<int, FrameSum> difference, flicker;
        for (const auto& [frame, s] : frames) {
            sum.pixels += s.pixels, sum.difference += s.difference, sum.truth_difference += s.truth_difference;
            sum.flicker += s.flicker;
            difference[frame] = {s.difference, double(s.pixels)}, flicker[frame] = {s.flicker, double(s.pixels)};
        }
        if (sum.pixels == 0) continue;
        const double n = double(sum.pixels);
        const auto same = [](double mean) { return mean; };
        out.push_back({{"arm", key[0]},
                       {"shift", key[1]},
                       {"region", key[2]},
                       {"frames", frames.size()},
                       {"pixels", sum.pixels},
                       {"difference", sum.difference / n},
                       {"truth_difference", sum.truth_difference / n},
                       {"error_change", sum.flicker / n},
                       {"difference_95", interval_of(difference, same)},
                       {"error_change_95", interval_of(flicker, same)}});
    }
    return out;
}

double median(std::vector<double> values) {
    std::nth_element(values.begin(), values.begin() + std::ptrdiff_t(values.size() / 2), values.end());
    return values[values.size() / 2];
}

ordered_json times_of(const Sets& sets) {
    ordered_json out = ordered_json::array();
    for (const std::string& arm : sets.arms) {
        const fs::path file = sets.manifest.folder() / "fills" / arm / "run.json";
        std::error_code error;
        if (!fs::exists(file, error)) continue;
        const ordered_json rows = ordered_json::parse(read_whole_file(file, size_t(256) << 20), nullptr, false);
        if (!rows.is_array())
            throw Error(ExitCode::bad_input, file.string() + ": json: got something else, expected a list of runs");
        ordered_json times{{"arm", arm}, {"views", rows.size()}};
        for (const char* key : {"fill_cpu_ms", "warp_cpu_ms", "fill_ms", "warp_ms", "hole_px"}) {
            std::vector<double> values;
            for (const auto& row : rows)
                if (row.is_object() && row.contains(key) && row[key].is_number()) values.push_back(row[key]);
            times[key] = values.empty() ? ordered_json() : ordered_json(median(values));
        }
        out.push_back(std::move(times));
    }
    return out;
}

}  // namespace

std::vector<std::string> fill_arms(const Manifest& manifest) {
    std::vector<std::string> out;
    std::error_code error, kind;
    for (const auto& entry : fs::directory_iterator(manifest.folder() / "fills", error))
        if (entry.is_directory(kind)) out.push_back(entry.path().filename().string());
    std::sort(out.begin(), out.end());
    return out;
}

ordered_json image_score_fields(uint64_t pixels, double psnr_db, double ssim, double ms_ssim, double flip,
                                double gradient_error, double sharpness) {
    ordered_json row = {{"pixels", pixels}, {"psnr_db", finite_or_null(psnr_db)}};
    if (std::isinf(psnr_db)) row["equal"] = true;
    row["ssim"] = finite_or_null(ssim);
    row["ms_ssim"] = finite_or_null(ms_ssim);
    row["flip"] = finite_or_null(flip);
    row["gradient_error"] = finite_or_null(gradient_error);
    row["sharpness"] = finite_or_null(sharpness);
    return row;
}

ImageScores score_images(const Recipe& recipe, const Manifest& manifest,
                         const std::function<void(size_t, size_t, const std::string&)>& progress) {
    const Sets sets{recipe, manifest, fill_arms(manifest)};
    const std::vector<NamedShift> shifts = manifest.shifts();
    std::vector<std::function<void(Unit&)>> work;
    std::vector<std::string> names;
    for (const NamedShift& shift : shifts) {
        for (const CameraSpec& camera : recipe.cameras) {
            work.push_back([&](Unit& unit) { score_drive(sets, shift, camera, unit); });
            names.push_back("images " + camera.name);
        }
        for (const FrameSpec& frame : recipe.frames) {
            work.push_back([&](Unit& unit) { score_overlap(sets, shift, frame.index, unit); });
            names.push_back("overlap " + shift.name);
        }
    }
    std::vector<Unit> units(work.size());
    const size_t batch = std::max(1u, std::thread::hardware_concurrency());  // bounds the memory
    for (size_t begin = 0; begin < work.size(); begin += batch) {
        progress(begin, work.size(), names[begin]);
        tbb::parallel_for(begin, std::min(begin + batch, work.size()), [&](size_t i) { work[i](units[i]); });
    }
    progress(work.size(), work.size(), "");
    ImageScores out;
    out.items = ordered_json::array();
    for (const Unit& unit : units)
        for (const ItemRow& row : unit.items) {
            const RegionScore& s = row.score;
            const double n = double(s.pixels);
            ordered_json item = {{"arm", row.arm},
                                 {"shift", row.shift.name},
                                 {"frame", row.frame},
                                 {"camera", row.camera},
                                 {"region", row.region}};
            item.update(image_score_fields(s.pixels, s.psnr_db(), s.ssim / n, s.ms_ssim, s.flip / n,
                                           s.gradient_error / n, s.sharpness()));
            out.items.push_back(std::move(item));
        }
    out.summary = summary_of(units);
    out.temporal = consistency_of(units, &Unit::temporal);
    out.overlap = consistency_of(units, &Unit::overlap);
    out.times = times_of(sets);
    return out;
}

std::string image_scores_csv(const ordered_json& items) {
    const char* keys[] = {"arm",     "shift", "frame",   "camera", "region",         "pixels",
                          "psnr_db", "ssim",  "ms_ssim", "flip",   "gradient_error", "sharpness"};
    std::string text;
    for (const char* key : keys) text += (text.empty() ? "" : ",") + std::string(key);
    text += "\n";
    for (const ordered_json& row : items) {
        std::string line;
        for (const char* key : keys) {
            const ordered_json& value = row[key];
            line += (line.empty() ? "" : ",") + (value.is_string() ? value.get<std::string>()
                                                 : value.is_null() ? ""
                                                                   : value.dump());
        }
        text += line + "\n";
    }
    return text;
}

}  // namespace vshift
