// SPDX-License-Identifier: Apache-2.0
// Scores over a whole set: pairs what the methods said with the set's truth, item by item.
#include <tbb/parallel_for.h>
#include <unistd.h>

#include <cmath>
#include <optional>
#include <thread>

#include "embree_core/benchmark_set.h"
#include "embree_core/c_api.h"
#include "embree_core/image_file.h"
#include "embree_core/score.h"
#include "embree_core/score_images.h"
#include "embree_core/image_scores.h"
#include "embree_core/version.h"

namespace vshift {
namespace {

using nlohmann::ordered_json;
namespace fs = std::filesystem;

constexpr double boundary_tolerances_px[] = {1, 2, 4};

Mask mask_of(const Channels& image, const std::string& channel) {
    const std::vector<float>& plane = image.plane(channel);
    Mask out(image.width, image.height);
    for (size_t i = 0; i < plane.size(); ++i) out.data[i] = plane[i] > 0.5f;
    return out;
}

template <class Rule>
Mask combine(const Mask& a, const Mask& b, Rule&& rule) {
    Mask out(a.width, a.height);
    for (size_t i = 0; i < out.size(); ++i) out.data[i] = rule(a.data[i] != 0, b.data[i] != 0);
    return out;
}

uint64_t count(const Mask& mask) {
    uint64_t n = 0;
    for (uint8_t v : mask.data) n += v;
    return n;
}

ordered_json finite_or_null(double value) {
    return std::isfinite(value) ? ordered_json(value) : ordered_json(nullptr);
}

void add_mask_scores(ordered_json& row, const Mask& got, const Mask& truth, const Mask* valid = nullptr) {
    const MaskScore s = score_mask(got, truth, valid);
    row["true_positive"] = s.counts.true_positive;
    row["false_positive"] = s.counts.false_positive;
    row["false_negative"] = s.counts.false_negative;
    row["true_negative"] = s.counts.true_negative;
    row["iou"] = s.iou;
    row["precision"] = s.precision;
    row["recall"] = s.recall;
    row["f1"] = s.f1;
    for (double tolerance : boundary_tolerances_px)
        row["boundary_f1"][std::to_string(int(tolerance))] = score_boundary(got, truth, tolerance, valid).f1;
}

void check_sizes(const Channels& a, const fs::path& file_a, const Channels& b) {
    if (a.width != b.width || a.height != b.height)
        throw Error(ExitCode::bad_input, file_a.string() + ": size: got " + std::to_string(a.width) + "x" +
                                             std::to_string(a.height) + ", expected " + std::to_string(b.width) + "x" +
                                             std::to_string(b.height));
}

struct Item {
    std::string kind, method;  ///< kind: masks, holes or warps
    NamedShift shift;
    int frame;
    std::string camera;

    ordered_json row() const {
        const glm::dvec3& t = shift.shift.translation_m;
        return {{"method", method},
                {"shift", shift.name},
                {"shift_m", {t.x, t.y, t.z}},
                {"frame", frame},
                {"camera", camera}};
    }
};

struct Rows {
    std::vector<ordered_json> masks, mask_regions, certificates, holes, warps;
};

/// `occluded` where V's picture holds the point, apart for foliage and the rest.
void add_region_rows(const Item& item, const Channels& truth, const Mask& occluded, const Mask& outside,
                     const Mask& shell, std::vector<ordered_json>& rows) {
    constexpr double boundary_px = 1.5;
    const Mask foliage = mask_of(truth, "foliage"), scene = mask_of(truth, "occluded");
    for (const bool leaves : {true, false}) {
        const Mask region = combine(foliage, outside, [&](bool leaf, bool out) { return leaf == leaves && !out; });
        for (const bool of_scene : {true, false}) {
            const Mask& want = of_scene ? scene : shell;
            const MaskScore s = score_mask(occluded, want, &region);
            ordered_json row = item.row();
            row["class"] = "occluded";
            row["against"] = of_scene ? "scene" : "shell";
            row["region"] = leaves ? "foliage" : "rest";
            row["pixels"] = count(region);
            row["true_positive"] = s.counts.true_positive;
            row["false_positive"] = s.counts.false_positive;
            row["false_negative"] = s.counts.false_negative;
            row["f1"] = s.f1;
            row["boundary_f1"] = score_boundary(occluded, want, boundary_px, &region).f1;
            rows.push_back(std::move(row));
        }
    }
}

Rows score_mask_item(const Item& item, const fs::path& got_file, const fs::path& truth_file) {
    const Channels got = read_image(got_file), truth = read_image(truth_file);
    check_sizes(got, got_file, truth);
    Rows rows;
    const Mask outside = mask_of(truth, "outside");
    const Mask shell = mask_of(truth, item.method == "rig" ? "shell_rig" : "shell_self");
    const auto either = [](bool a, bool b) { return a || b; };
    for (const std::string klass : {"lost", "occluded", "outside"})
        for (const std::string against : {"scene", "shell"}) {
            if (klass == "outside" && against == "shell") continue;  // a matter of the frame alone
            const Mask want = against == "scene"    ? mask_of(truth, klass)
                              : klass == "occluded" ? shell
                                                    : combine(shell, outside, either);
            ordered_json row = item.row();
            row["class"] = klass;
            row["against"] = against;
            add_mask_scores(row, mask_of(got, klass), want);
            rows.masks.push_back(std::move(row));
        }
    if (truth.has("foliage"))
        add_region_rows(item, truth, mask_of(got, "occluded"), outside, shell, rows.mask_regions);
    const Mask lost = mask_of(got, "lost"), occluded = mask_of(got, "occluded"), unknown = mask_of(got, "unknown"),
               unseen = mask_of(got, "unseen");
    const Mask true_occluded = mask_of(truth, "occluded"), true_lost = mask_of(truth, "lost");
    const auto but_not = [](bool a, bool b) { return a && !b; };
    const auto neither = [](bool a, bool b) { return !a && !b; };
    const Mask visible = combine(lost, unknown, neither);
    const Mask certain = combine(visible, unseen, but_not);
    ordered_json row = item.row();
    row["pixels"] = lost.size();
    row["occluded"] = count(occluded);
    row["occluded_wrong"] = count(combine(occluded, true_occluded, but_not));
    row["visible_certain"] = count(certain);
    row["visible_wrong"] = count(combine(certain, true_lost, [](bool a, bool b) { return a && b; }));
    row["visible_unseen"] = count(visible) - count(certain);
    row["unknown"] = count(unknown);
    const std::string invalid = got.metadata.contains("vshift.invalid_px") ? got.metadata.at("vshift.invalid_px") : "0";
    if (invalid.empty() || invalid.size() > 12 || invalid.find_first_not_of("0123456789") != std::string::npos)
        throw Error(ExitCode::bad_input,
                    got_file.string() + ": vshift.invalid_px: got '" + invalid + "', expected a number of pixels");
    row["invalid"] = std::stoll(invalid);
    rows.certificates.push_back(std::move(row));
    return rows;
}

Rows score_hole_item(const Item& item, const fs::path& got_file, const fs::path& truth_file) {
    const Channels got = read_image(got_file), truth = read_image(truth_file);
    check_sizes(got, got_file, truth);
    const std::vector<float>& klass = truth.plane("truth.class");
    const auto where = [&](auto&& rule) {
        Mask out(truth.width, truth.height);
        for (size_t i = 0; i < out.size(); ++i) out.data[i] = rule(int(std::lround(klass[i])));
        return out;
    };
    const bool rig = item.method == "rig";
    Rows rows;
    const auto add = [&](const std::string& name, const Mask& want) {
        ordered_json row = item.row();
        row["class"] = name;
        add_mask_scores(row, mask_of(got, name), want);
        rows.holes.push_back(std::move(row));
    };
    add("hole", where([&](int c) { return rig ? c >= VSHIFT_NOBODY_OCCLUDED : c != VSHIFT_SEEN_BY_OWN; }));
    add("disoccluded",
        where([&](int c) { return c == VSHIFT_NOBODY_OCCLUDED || (!rig && c == VSHIFT_NEIGHBOUR_OCCLUDED); }));
    add("outside", where([&](int c) { return c == VSHIFT_NOBODY_OUTSIDE || (!rig && c == VSHIFT_NEIGHBOUR_OUTSIDE); }));
    return rows;
}

Rows score_warp_item(const Item& item, const fs::path& got_file, const fs::path& truth_file) {
    const Channels got = read_image(got_file), truth = read_image(truth_file);
    check_sizes(got, got_file, truth);
    const ColorImage shown = srgb_from_linear(got.color()), wanted = srgb_from_linear(truth.color());
    const std::vector<float>&hole = got.plane("hole"), &klass = truth.plane("truth.class");
    Mask seen(got.width, got.height), all(got.width, got.height, 1);
    for (size_t i = 0; i < seen.size(); ++i) {
        const int c = int(std::lround(klass[i]));
        seen.data[i] = hole[i] < 0.5f && (item.method == "rig" ? c < VSHIFT_NOBODY_OCCLUDED : c == VSHIFT_SEEN_BY_OWN);
    }
    Rows rows;
    for (const auto& [name, region] : {std::pair<std::string, const Mask*>{"seen", &seen}, {"all", &all}}) {
        ordered_json row = item.row();
        row["region"] = name;
        row["pixels"] = count(*region);
        const double psnr = psnr_db(shown, wanted, region);
        row["psnr_db"] = finite_or_null(psnr);
        if (std::isinf(psnr)) row["equal"] = true;
        row["ssim"] = finite_or_null(ssim(shown, wanted, region));
        rows.warps.push_back(std::move(row));
    }
    return rows;
}

std::vector<std::string> methods_of(const fs::path& folder) {
    std::vector<std::string> out;
    std::error_code error;
    std::error_code kind;  // of a link that leads nowhere
    for (const auto& entry : fs::directory_iterator(folder, error))
        if (entry.is_directory(kind) && (entry.path().filename() == "self" || entry.path().filename() == "rig"))
            out.push_back(entry.path().filename().string());
    std::sort(out.begin(), out.end(), std::greater<>());  // self before rig
    return out;
}

}  // namespace

nlohmann::ordered_json score_set(const Recipe& recipe, const Manifest& manifest,
                                 const std::function<void(size_t, size_t, const std::string&)>& progress) {
    const fs::path& folder = manifest.folder();
    std::vector<Item> items;
    ordered_json times = ordered_json::array();
    for (const std::string kind : {"masks", "holes", "warps"})
        for (const std::string& method : methods_of(folder / kind)) {
            for (const NamedShift& shift : manifest.shifts())
                for (const FrameSpec& frame : recipe.frames)
                    for (const CameraSpec& camera : recipe.cameras) {
                        const fs::path path = item_path(shift.name, frame.index, camera.name);
                        const fs::path truth = (kind == "masks" ? fs::path("truth") : fs::path("shifts")) / path;
                        if (manifest.is_refused(truth.string())) continue;
                        if (!fs::exists(folder / kind / method / path)) continue;
                        items.push_back({kind, method, shift, frame.index, camera.name});
                    }
            const fs::path run = folder / kind / method / "run.json";
            if (!fs::exists(run)) continue;
            const ordered_json runs = ordered_json::parse(read_whole_file(run, size_t(256) << 20), nullptr, false);
            if (!runs.is_array())
                throw Error(ExitCode::bad_input, run.string() + ": json: got something else, expected a list of runs");
            for (const auto& row : runs) times.push_back(row);
        }
    const bool filled = !fill_arms(manifest).empty();
    if (items.empty() && !filled)
        throw Error(
            ExitCode::bad_input,
            folder.string() + ": masks, holes, warps: got none, expected results of vshift mask, holes, warp or inpaint");

    std::vector<Rows> rows(items.size());
    const size_t batch = std::max(1u, std::thread::hardware_concurrency()) * 2;  // bounds the memory
    for (size_t begin = 0; begin < items.size(); begin += batch) {
        const size_t end = std::min(begin + batch, items.size());
        progress(begin, items.size(), items[begin].kind + " " + items[begin].camera);
        tbb::parallel_for(begin, end, [&](size_t i) {
            const Item& item = items[i];
            const fs::path path = item_path(item.shift.name, item.frame, item.camera);
            const fs::path got = folder / item.kind / item.method / path;
            rows[i] = item.kind == "masks"   ? score_mask_item(item, got, folder / "truth" / path)
                      : item.kind == "holes" ? score_hole_item(item, got, folder / "shifts" / path)
                                             : score_warp_item(item, got, folder / "shifts" / path);
        });
    }
    progress(items.size(), items.size(), "");
    ordered_json out = {{"vshift_scores", 1},
                        {"vshift", version_string},
                        {"set", recipe.file.filename().string()},
                        {"cores", std::thread::hardware_concurrency()}};
    for (const char* part : {"masks", "mask_regions", "certificates", "holes", "warps"}) out[part] = ordered_json::array();
    for (Rows& r : rows) {
        for (auto& row : r.masks) out["masks"].push_back(std::move(row));
        for (auto& row : r.mask_regions) out["mask_regions"].push_back(std::move(row));
        for (auto& row : r.certificates) out["certificates"].push_back(std::move(row));
        for (auto& row : r.holes) out["holes"].push_back(std::move(row));
        for (auto& row : r.warps) out["warps"].push_back(std::move(row));
    }
    out["times"] = std::move(times);
    if (filled) {
        ImageScores images = score_images(recipe, manifest, progress);
        for (auto& [name, part] : {std::pair{"images", &images.items}, {"image_summary", &images.summary},
                                   {"temporal", &images.temporal}, {"overlap", &images.overlap},
                                   {"fill_times", &images.times}})
            out[name] = std::move(*part);
    }
    return out;
}

std::string scores_csv(const ordered_json& scores) {
    std::string text =
        "method,shift,frame,camera,class,against,true_positive,false_positive,false_negative,true_negative,iou,"
        "precision,recall,f1,boundary_f1_1px,boundary_f1_2px,boundary_f1_4px\n";
    for (const char* part : {"masks", "holes"})
        for (const ordered_json& row : scores[part]) {
            const auto cell = [](const ordered_json& v) { return v.is_string() ? v.get<std::string>() : v.dump(); };
            for (const char* key : {"method", "shift", "frame", "camera", "class"}) text += cell(row[key]) + ",";
            text += row.contains("against") ? cell(row["against"]) : "scene";
            for (const char* key : {"true_positive", "false_positive", "false_negative", "true_negative", "iou",
                                    "precision", "recall", "f1"})
                text += "," + cell(row[key]);
            for (const char* tolerance : {"1", "2", "4"}) text += "," + cell(row["boundary_f1"][tolerance]);
            text += "\n";
        }
    return text;
}

ordered_json score_pair(const fs::path& got_file, const fs::path& truth_file, const fs::path& region_file) {
    const Channels got = read_image(got_file), truth = read_image(truth_file);
    check_sizes(got, got_file, truth);
    std::optional<Mask> where;
    if (!region_file.empty()) {
        const Channels region = read_image(region_file);
        check_sizes(region, region_file, truth);
        where = mask_of(region, region.names.at(0));
    }
    ordered_json out = {
        {"got", got_file.string()}, {"truth", truth_file.string()}, {"channels", ordered_json::object()}};
    for (const std::string channel : {"lost", "occluded", "outside", "unknown", "unseen", "hole", "disoccluded"})
        if (got.has(channel) && truth.has(channel))
            add_mask_scores(out["channels"][channel], mask_of(got, channel), mask_of(truth, channel),
                            where ? &*where : nullptr);
    if (got.has("R") && got.has("G") && got.has("B") && truth.has("R") && truth.has("G") && truth.has("B")) {
        const RegionScore s = score_region(compare_images(got.color(), truth.color()), where ? &*where : nullptr);
        const double n = double(s.pixels);
        out.update(image_score_fields(s.pixels, s.psnr_db(), s.ssim / n, s.ms_ssim, s.flip / n, s.gradient_error / n,
                                      s.sharpness()));
    }
    if (out["channels"].empty() && !out.contains("ssim"))
        throw Error(ExitCode::bad_input, got_file.string() + ": channels: got none in common with " +
                                             truth_file.string() + ", expected mask channels or R, G, B");
    return out;
}

}  // namespace vshift
