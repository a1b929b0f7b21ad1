// SPDX-License-Identifier: Apache-2.0
#include "benchmark/engine/bench.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <sstream>
#include <thread>

#include "embree_core/trace.h"
#include "embree_core/version.h"

namespace vshift::bench {
namespace {

using Numbers = std::vector<double>;

ordered_json described(const Method& m) {
    ordered_json row{{"method", m.name}, {"label", m.label}, {"group", m.group}};
    if (!m.note.empty()) row["note"] = m.note;
    return row;
}

/// F1 of all rows' pixels together, and the rows' quartiles.
ordered_json pooled(const std::vector<const ordered_json*>& rows, const std::string& against) {
    double tp = 0, wrong = 0;
    Numbers f1, boundary;
    for (const ordered_json* row : rows) {
        const ordered_json& s = (*row)[against];
        tp += s["tp"].get<double>();
        wrong += s["fp"].get<double>() + s["fn"].get<double>();
        f1.push_back(s["f1"]);
        boundary.push_back(s["boundary_f1"]);
    }
    return {{"pooled_f1", tp + wrong > 0 ? 2 * tp / (2 * tp + wrong) : 1},
            {"f1", spread(f1)},
            {"boundary_f1", spread(boundary)}};
}

}  // namespace

ordered_json Plan::run(const Hooks& hooks) {
    double total = 0, done = 0;
    ordered_json took = ordered_json::array();
    for (const Step& step : steps_) total += step.seconds;
    // In tenths of a second: small runs too have steps to count.
    for (const Step& step : steps_) {
        hooks.show(size_t(done * 10), size_t(total * 10) + 1, step.what);
        const Stopwatch watch;
        step.work();
        const Elapsed sample = watch.read();
        took.push_back({{"what", step.what},
                        {"foreseen_s", step.seconds},
                        {"wall_s", sample.wall_ms / 1e3},
                        {"cpu_s", sample.cpu_ms / 1e3}});
        done += step.seconds;
    }
    return took;
}

/// One row per method: its cost in core-milliseconds and its scores over all cases that shift at all.
void summarise(Bench& bench) {
    ordered_json summary = ordered_json::array();
    for (const ordered_json& method : bench.out["methods"]) {
        const std::string name = method["method"];
        ordered_json row{{"method", name}, {"label", method["label"]}, {"group", method["group"]}};
        ordered_json ms = ordered_json::array();
        for (const ordered_json& t : bench.out["timing"])
            if (t["method"] == name)
                ms.push_back({{"camera", t["camera"]},
                              {"shift", t["shift"]},
                              {"threads", t["threads"]},
                              {"cpu_ms", t["cpu_ms"]},
                              {"wall_ms", t["wall_ms"]}});
        row["ms"] = ms;
        std::vector<const ordered_json*> rows;
        for (const ordered_json& a : bench.out["accuracy"])
            if (a["method"] == name && a["shift"] != "0,0,0") rows.push_back(&a);
        row["cases"] = rows.size();
        if (!rows.empty()) {
            row["shell"] = pooled(rows, "shell"), row["scene"] = pooled(rows, "scene");
            std::vector<const ordered_json*> rest;  // without pixels that show leaves
            for (const ordered_json* a : rows) rest.push_back(&(*a)["rest"]);
            row["shell_without_foliage"] = pooled(rest, "shell");
        }
        Numbers flickers;
        for (const ordered_json& n : bench.out["noise"])
            if (n["method"] == name) flickers.push_back(n["flicker"]);
        if (!flickers.empty()) row["flicker"] = spread(flickers);
        uint64_t certain = 0, wrong = 0, silhouette = 0;
        Numbers unknown, unseen;
        for (const ordered_json* a : rows)
            if (a->contains("certificate")) {
                const ordered_json& c = (*a)["certificate"];
                certain += c["certain_px"].get<uint64_t>();
                wrong += c["wrong_occluded_px"].get<uint64_t>() + c["wrong_visible_px"].get<uint64_t>();
                silhouette += c["wrong_at_silhouette_px"].get<uint64_t>();
                unknown.push_back(c["unknown_share"]), unseen.push_back(c["unseen_share"]);
            }
        if (certain)
            row["certificate"] = {{"wrong_share", double(wrong) / double(certain)},
                                  {"wrong_px", wrong},
                                  {"wrong_at_silhouette_px", silhouette},
                                  {"unknown_share", spread(unknown)},
                                  {"unseen_share", spread(unseen)}};
        summary.push_back(std::move(row));
    }
    bench.out["summary"] = std::move(summary);
}

ordered_json run_bench(const Options& options, const Hooks& hooks, ColorImage& differences) {
    const int width = options.picture_width();
    if (width < 64 || width > 4096 || width % 16)
        throw Error(ExitCode::bad_input,
                    "bench: width: got " + std::to_string(width) + ", expected a multiple of 16 from 64 to 4096");
    const Stopwatch whole;
    Bench bench;
    bench.options = options, bench.hooks = hooks;
    bench.threads = std::thread::hardware_concurrency() > 1 ? std::vector<int>{1, 2} : std::vector<int>{1};
    bench.out = {{"program", std::string("vshift ") + version_string},
                 {"tracer", tracer_version()},
                 {"quick", options.quick},
                 {"seed", options.seed},
                 {"width", width},
                 {"height", width * 9 / 16},
                 {"machine", machine_facts()}};
    bench.out["scored"] =
        "`occluded` over the pixels that V's picture holds (peers work in that picture; the rest is `outside`, hence "
        "lost "
        "anyway); *_everywhere: over all pixels; boundary F1 at 1.5 px; shell: what an infinitely fine depth map of "
        "the own "
        "camera could know; foliage: pixels that show leaves";
    bench.out["noise_model"] = mono_model;
    hooks.show(0, 2, "street");
    bench.street = analytic::build_street(options.seed);
    bench.world.emplace_back(bench.street, width);
    bench.world.emplace_back(bench.street, brute_force_width);
    ordered_json methods = ordered_json::array();
    methods.push_back(described(copy_loop()));
    for (const Method& m : our_methods()) methods.push_back(described(m));
    for (const Method& m : peer_methods()) methods.push_back(described(m));
    methods.push_back(described(brute_force()));
    methods.push_back({{"method", "torch_splat"},
                       {"label", "bilinear splat, PyTorch"},
                       {"group", "peer"},
                       {"note",
                        "our own short rendering of TrajectoryCrafter's and CogNVS's depth-weighted forward splat, "
                        "then a depth test with bias 2 %"}});
    if (!options.peer_code.empty())
        methods.push_back({{"method", "trajectorycrafter"},
                           {"label", "TrajectoryCrafter's own warp, PyTorch"},
                           {"group", "peer"},
                           {"note",
                            "its class Warper, run from its own repository: forward warp of the colors, bilinear splat "
                            "of the depth, then a depth test with bias 2 %"}});
    methods.push_back({{"method", "ray_cast"},
                       {"label", "scene.ray_cast"},
                       {"group", "peer"},
                       {"note", "Blender's, in the true scene, which no recording has; run at 80x45, time by its pixels"}});
    methods.push_back({{"method", "shell_truth"},
                       {"label", "all that one view can know"},
                       {"group", "limit"},
                       {"note",
                        "the shell's truth as if it were a method: its distance from the scene is what one "
                        "recording cannot know"}});
    bench.out["methods"] = std::move(methods);

    // Times first, while the machine is as cool as it was found.
    Plan plan;
    plan_timing(bench, plan);
    plan_costs(bench, plan);
    plan_accuracy(bench, plan);
    plan_torch(bench, plan);
    plan_ray_cast(bench, plan);
    plan_rig(bench, plan);
    plan_sources(bench, plan);
    ordered_json steps = plan.run(hooks);
    bench.out["torch"] = bench.no_torch.empty() ? "measured" : "not measured: " + bench.no_torch;
    bench.out["blender"] = bench.no_blender.empty() ? "measured" : "not measured: " + bench.no_blender;
    summarise(bench);
    differences = std::move(bench.differences);
    bench.out["machine"]["load_after"] = load();
    bench.out["steps"] = std::move(steps);
    bench.out["seconds"] = whole.read().wall_ms / 1e3;
    return std::move(bench.out);
}

namespace {

/// Numbers of a nested row as dotted quantities.
void flatten(const ordered_json& value, const std::string& name, const std::string& head, std::ostringstream& out) {
    static const std::vector<std::string> heads{"method", "camera", "shift", "threads"};
    if (value.is_object())
        for (const auto& [key, inner] : value.items()) {
            if (name.empty() && std::find(heads.begin(), heads.end(), key) != heads.end()) continue;
            flatten(inner, name.empty() ? key : name + "." + key, head, out);
        }
    else if (value.is_number() || value.is_boolean())
        out << head << name << ',' << value.dump() << '\n';
}

std::string field(const ordered_json& row, const char* name) {
    if (!row.contains(name)) return "";
    const std::string text = row[name].is_string() ? row[name].get<std::string>() : row[name].dump();
    return text.find(',') == std::string::npos ? text : '"' + text + '"';
}

}  // namespace

std::string bench_csv(const ordered_json& bench) {
    std::ostringstream out;
    out << "section,method,camera,shift,threads,quantity,value\n";
    for (const auto& [section, rows] : bench.items()) {
        if (section == "methods" || section == "steps" || !(rows.is_array() || section == "steady")) continue;
        const auto line = [&, name = section](const ordered_json& row) {
            flatten(row, "",
                    name + ',' + field(row, "method") + ',' + field(row, "camera") + ',' + field(row, "shift") + ',' +
                        field(row, "threads") + ',',
                    out);
        };
        if (rows.is_array())
            for (const ordered_json& row : rows) line(row);
        else
            line(rows);
    }
    return out.str();
}

}  // namespace vshift::bench
