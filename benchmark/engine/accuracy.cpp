// SPDX-License-Identifier: Apache-2.0
// What is right: masks against shell and scene truth, the certificate, noise, and the rig's carving.
#include <tbb/global_control.h>
#include <tbb/parallel_for.h>

#include <map>
#include <memory>

#include "benchmark/engine/bench.h"
#include "embree_core/score.h"

namespace vshift::bench {
namespace {

constexpr double boundary_px = 1.5;

Mask bits(const Grid<uint8_t>& of, unsigned wanted) {
    Mask out(of.width, of.height, 0);
    for (size_t i = 0; i < of.size(); ++i) out.data[i] = (of.data[i] & wanted) != 0;
    return out;
}

ordered_json scored(const Mask& got, const Mask& truth, const Mask& valid, bool boundary = true) {
    const MaskScore s = score_mask(got, truth, &valid);
    ordered_json row{{"f1", s.f1},
                     {"precision", s.precision},
                     {"recall", s.recall},
                     {"tp", s.counts.true_positive},
                     {"fp", s.counts.false_positive},
                     {"fn", s.counts.false_negative}};
    if (boundary) row["boundary_f1"] = score_boundary(got, truth, boundary_px, &valid).f1;
    return row;
}

/// Whether truth or kind changes within one pixel: a silhouette's sampling.
bool at_silhouette(const Mask& truth, const Grid<uint8_t>& kind, int x, int y) {
    for (int dy = -1; dy <= 1; ++dy)
        for (int dx = -1; dx <= 1; ++dx) {
            const int u = x + dx, v = y + dy;
            if (u < 0 || v < 0 || u >= truth.width || v >= truth.height) continue;
            if (truth.at(u, v) != truth.at(x, y) || kind.at(u, v) != kind.at(x, y)) return true;
        }
    return false;
}

/// What is called certain and is wrong against the scene, over all pixels of the picture.
ordered_json certificate(const Grid<uint8_t>& classes, const Mask& scene, const Grid<uint8_t>& kind) {
    uint64_t certain = 0, false_occluded = 0, false_visible = 0, silhouette = 0, foliage = 0, unknown = 0, unseen = 0;
    for (int y = 0; y < classes.height; ++y)
        for (int x = 0; x < classes.width; ++x) {
            const uint8_t c = classes.at(x, y);
            unknown += (c & unknown_bit) != 0, unseen += (c & unseen_bit) != 0;
            const bool occluded = c & occluded_bit;
            if (!occluded && (c & (unknown_bit | unseen_bit))) continue;
            ++certain;
            if (occluded == bool(scene.at(x, y))) continue;
            ++(occluded ? false_occluded : false_visible);
            silhouette += at_silhouette(scene, kind, x, y);
            foliage += kind.at(x, y) == uint8_t(analytic::Kind::foliage);
        }
    const double all = double(classes.size());
    return {{"certain_share", double(certain) / all},
            {"wrong_share", certain ? double(false_occluded + false_visible) / double(certain) : 0},
            {"certain_px", certain},
            {"wrong_occluded_px", false_occluded},
            {"wrong_visible_px", false_visible},
            {"wrong_at_silhouette_px", silhouette},
            {"wrong_foliage_px", foliage},
            {"unknown_share", double(unknown) / all},
            {"unseen_share", double(unseen) / all}};
}

/// How two methods' classes differ in a case, and where.
ordered_json compared(const Case& c, const Grid<uint8_t>& a, const Grid<uint8_t>& b) {
    const Mask shell = bits(c.truth, VSHIFT_TRUTH_SHELL_SELF);
    const Grid<uint8_t>& kind = c.world->kind[size_t(c.own)];
    uint64_t occluded = 0, unknown = 0, any = 0, silhouette = 0;
    for (int y = 0; y < a.height; ++y)
        for (int x = 0; x < a.width; ++x) {
            const unsigned d = a.at(x, y) ^ b.at(x, y);
            occluded += (d & occluded_bit) != 0, unknown += (d & unknown_bit) != 0, any += d != 0;
            silhouette += (d & occluded_bit) && at_silhouette(shell, kind, x, y);
        }
    const double all = double(a.size());
    return {{"differing_share", double(occluded) / all},
            {"at_silhouette_share", occluded ? double(silhouette) / double(occluded) : 1},
            {"differing_unknown_share", double(unknown) / all},
            {"differing_any_share", double(any) / all},
            {"f1", score_mask(bits(a, occluded_bit), bits(b, occluded_bit)).f1}};
}

bool is_zero(const Shift& shift) {
    return shift.translation_m == glm::dvec3(0.0);
}
/// 2 m to the left: what noise is measured at.
bool is_two_left(const Shift& shift) {
    return shift.translation_m == glm::dvec3(0, 2, 0);
}

/// A case's depth in gray; red: the first method alone calls it occluded, blue: the second.
ColorImage difference_picture(const Case& c, const Grid<uint8_t>& first, const Grid<uint8_t>& second) {
    const DepthMap& depth = c.world->depth[size_t(c.own)];
    ColorImage out(depth.width, depth.height);
    for (size_t i = 0; i < out.size(); ++i) {
        const float near = is_sky(depth.data[i]) ? 0.0f : std::min(1.0f, 4 / depth.data[i]);
        const bool by_first = first.data[i] & occluded_bit, by_second = second.data[i] & occluded_bit;
        out.data[i] = glm::vec3(by_first && by_second ? 0.9f - 0.3f * near : 0.5f - 0.45f * near);
        if (by_first != by_second) out.data[i] = by_first ? glm::vec3(1, 0.1f, 0) : glm::vec3(0, 0.4f, 1);
    }
    return out;
}

/// The shifts at which the whole rig carves.
std::vector<double> rig_shifts_left_m(const Bench& bench) {
    return bench.options.quick ? std::vector<double>{2} : std::vector<double>{1, 2, 4};
}
bool asked_of_rig(const Bench& bench, const Shift& shift) {
    for (const double y : rig_shifts_left_m(bench))
        if (shift.translation_m == glm::dvec3(0, y, 0)) return true;
    return false;
}

ordered_json noise_row(const std::string& method, const Case& c, const Grid<uint8_t>& first,
                       const Grid<uint8_t>& second, const Grid<uint8_t>& clean) {
    ordered_json row = row_head(method, c);
    row["flicker"] = flicker(first, second);
    const Mask inside = bits(c.truth, VSHIFT_TRUTH_OUTSIDE);
    Mask valid = inside;
    for (uint8_t& v : valid.data) v = !v;
    const Mask scene = bits(c.truth, VSHIFT_TRUTH_OCCLUDED);
    row["noisy_f1_scene"] = score_mask(bits(first, occluded_bit), scene, &valid).f1;
    row["clean_f1_scene"] = score_mask(bits(clean, occluded_bit), scene, &valid).f1;
    return row;
}

/// Wrong pixels in columns of at least `rows` that are wrong the same way: what stands upright before an upright camera
/// runs along a column, and no sample tells where between two columns.
uint64_t wrong_upright(const Case& c, const Grid<uint8_t>& classes, int rows) {
    const auto error = [&](int x, int y) {
        const bool got = classes.at(x, y) & occluded_bit, right = c.truth.at(x, y) & VSHIFT_TRUTH_SHELL_SELF;
        return c.truth.at(x, y) & VSHIFT_TRUTH_OUTSIDE ? 0 : int(got) - int(right);
    };
    uint64_t wrong = 0;
    for (int x = 0; x < classes.width; ++x)
        for (int y = 0, end; y < classes.height; y = end) {
            for (end = y + 1; end < classes.height && error(x, end) == error(x, y);) ++end;
            if (error(x, y) && end - y >= rows) wrong += uint64_t(end - y);
        }
    return wrong;
}

/// Every method on one case; sweep against Embree; 1 thread against 2; noise where it is asked for.
void run_case(Bench& bench, Case c, const std::vector<Method>& methods) {
    std::vector<Result> results(methods.size());
    for (size_t i = 0; i < methods.size(); ++i) {
        methods[i].run(job_of(c), results[i]);
        join_classes(results[i]);
    }
    std::vector<ordered_json> rows(methods.size());
    tbb::parallel_for(size_t(0), methods.size(), [&](size_t i) {
        rows[i] = row_head(methods[i].name, c);
        rows[i].update(score_classes(c, results[i].classes, methods[i].certifies));
        if (methods[i].name == "sweep")
            for (const int length : {8, 16, 32})
                rows[i]["shell"]["wrong_upright_px"][std::to_string(length)] =
                    wrong_upright(c, results[i].classes, length);
        if (results[i].triangles) rows[i]["triangles"] = results[i].triangles;
        if (results[i].tiles) rows[i]["tiles"] = results[i].tiles;
        if (results[i].bvh_bytes) rows[i]["bvh_bytes"] = results[i].bvh_bytes;
    });
    for (ordered_json& row : rows) bench.out["accuracy"].push_back(std::move(row));

    // What one view can know at all: the shell's truth, scored as if it were a method.
    Grid<uint8_t> shell(c.truth.width, c.truth.height);
    for (size_t i = 0; i < shell.size(); ++i)
        shell.data[i] = c.truth.data[i] & VSHIFT_TRUTH_SHELL_SELF ? occluded_bit : 0;
    ordered_json limit = row_head("shell_truth", c);
    limit.update(score_classes(c, shell, false));
    bench.out["accuracy"].push_back(std::move(limit));

    std::map<std::string, size_t> at;
    for (size_t i = 0; i < methods.size(); ++i) at[methods[i].name] = i;
    for (const char* method : {"sweep", "embree_tiles"}) {
        ordered_json agreement = row_head(method, c);
        agreement["against"] = "embree";
        agreement.update(compared(c, results[at[method]].classes, results[at["embree"]].classes));
        bench.out["agreement"].push_back(std::move(agreement));
    }
    if (c.own == 1 && is_two_left(c.shift))
        bench.differences = difference_picture(c, results[at["sweep"]].classes, results[at["embree"]].classes);

    if (bench.threads.size() > 1)
        for (size_t i = 0; i < methods.size(); ++i) {
            if (methods[i].group != "ours" || (methods[i].name != "sweep" && !is_two_left(c.shift))) continue;
            const tbb::global_control one(tbb::global_control::max_allowed_parallelism, 1);
            Result again;
            methods[i].run(job_of(c), again);
            join_classes(again);
            ordered_json row = row_head(methods[i].name, c);
            row["equal"] = again.classes.data == results[i].classes.data;
            bench.out["bytes_equal"].push_back(std::move(row));
        }

    if (is_two_left(c.shift) && (bench.options.quick ? c.own < 1 : c.own < 3)) {
        const DepthMap first = mono_like(c.world->depth[size_t(c.own)], 1);
        const DepthMap second = mono_like(c.world->depth[size_t(c.own)], 2);
        for (size_t i = 0; i < methods.size(); ++i) {
            if (!methods[i].noisy) continue;
            Result a, b;
            methods[i].run(job_of(c, first), a);
            methods[i].run(job_of(c, second), b);
            join_classes(a), join_classes(b);
            bench.out["noise"].push_back(noise_row(methods[i].name, c, a.classes, b.classes, results[i].classes));
        }
    }
    c.shifted_depth = {};
    bench.cases.push_back(std::move(c));
}

/// The whole rig's carving: how many pixels stay unknown or unseen, and what it wins against the scene.
void run_rig(Bench& bench, const Shift& shift) {
    constexpr double tolerance_px = 0.02;
    const World& world = bench.full();
    LiftedRig rig;
    for (size_t i = 0; i < world.rig.size(); ++i) {
        const TrueCamera recorded = world.recorded(int(i));
        rig.views.push_back(lift_view(world.rig[i].name, recorded.intrinsics, recorded.world_from_cam, world.depth[i],
                                      world.shifted(int(i), shift).world_from_cam.translation_m, tolerance_px));
    }
    for (int own = 0; own < int(world.rig.size()); ++own) {
        bench.hooks.show(0, 0, "");
        rig.own = own;
        const Case c = make_case(world, own, shift);
        const TrueCamera v = world.shifted(own, shift);
        Result by_rig;
        const Stopwatch casting;
        by_rig.masks = mask(rig, {v.intrinsics, v.world_from_cam}, 2.0);
        const Elapsed cost = casting.read();
        join_classes(by_rig);
        ordered_json row = row_head("embree_0.02 from=rig", c);
        row.update(score_classes(c, by_rig.classes, true));
        const Mask shell = bits(c.truth, VSHIFT_TRUTH_SHELL_RIG);
        Mask valid = bits(c.truth, VSHIFT_TRUTH_OUTSIDE);
        for (uint8_t& inside : valid.data) inside = !inside;
        row["shell_rig"] = scored(bits(by_rig.classes, occluded_bit), shell, valid);
        row["shell_rig_limit_f1_scene"] = score_mask(shell, bits(c.truth, VSHIFT_TRUTH_OCCLUDED), &valid).f1;
        row["cast_cpu_ms"] = cost.cpu_ms;
        bench.out["rig"].push_back(std::move(row));
    }
}

}  // namespace

ordered_json row_head(const std::string& method, const Case& c) {
    return {{"method", method}, {"camera", c.camera()}, {"shift", c.shift_text()}};
}

double flicker(const Grid<uint8_t>& a, const Grid<uint8_t>& b) {
    uint64_t changed = 0, size = 0;
    for (size_t i = 0; i < a.size(); ++i) {
        const bool in_a = a.data[i] & occluded_bit, in_b = b.data[i] & occluded_bit;
        changed += in_a != in_b, size += uint64_t(in_a) + uint64_t(in_b);
    }
    return size ? 2.0 * double(changed) / double(size) : 0;
}

ordered_json score_classes(const Case& c, const Grid<uint8_t>& classes, bool certifies) {
    const Mask got = bits(classes, occluded_bit), shell = bits(c.truth, VSHIFT_TRUTH_SHELL_SELF),
               scene = bits(c.truth, VSHIFT_TRUTH_OCCLUDED);
    const Grid<uint8_t>& kind = c.world->kind[size_t(c.own)];
    // Peers that work in V's picture say nothing of what leaves it, and what leaves it is lost anyway.
    Mask inside(got.width, got.height), foliage = inside, rest = inside, everywhere(got.width, got.height, 1);
    for (size_t i = 0; i < inside.size(); ++i) {
        inside.data[i] = !(c.truth.data[i] & VSHIFT_TRUTH_OUTSIDE);
        const bool leaf = kind.data[i] == uint8_t(analytic::Kind::foliage);
        foliage.data[i] = inside.data[i] && leaf;
        rest.data[i] = inside.data[i] && !leaf;
    }
    ordered_json row{{"shell", scored(got, shell, inside)}, {"scene", scored(got, scene, inside)}};
    row["shell_everywhere"] = scored(got, shell, everywhere, false);
    row["scene_everywhere"] = scored(got, scene, everywhere, false);
    row["foliage"] = {{"px", 0}, {"shell", scored(got, shell, foliage, false)}};
    uint64_t foliage_px = 0;
    for (uint8_t f : foliage.data) foliage_px += f;
    row["foliage"]["px"] = foliage_px;
    row["rest"] = {{"shell", scored(got, shell, rest)}};
    if (certifies) row["certificate"] = certificate(classes, scene, kind);
    return row;
}

void plan_accuracy(Bench& bench, Plan& plan) {
    auto methods = std::make_shared<std::vector<Method>>(our_methods());
    for (Method& peer : peer_methods()) methods->push_back(std::move(peer));
    for (const char* section : {"accuracy", "agreement", "bytes_equal", "noise", "rig"})
        bench.out[section] = ordered_json::array();
    const double area = bench.scale() * bench.scale();
    const int cameras = bench.options.quick ? 3 : 6;
    for (int own = 0; own < cameras; ++own)
        for (const Shift& shift : bench_shifts(bench.options.quick)) {
            if (is_zero(shift) && own > 0) continue;
            // The second half of the rig only where the rig itself is asked.
            if (own >= 3 && !asked_of_rig(bench, shift)) continue;
            Case name = make_question(bench.full(), own, shift);
            plan.add(0.05 + 6 * area, "accuracy: " + name.camera() + " " + name.shift_text(),
                     [&bench, methods, own, shift] { run_case(bench, make_case(bench.full(), own, shift), *methods); });
        }
    plan.add(0.3, "accuracy: every triangle for every ray", [&bench] {
        const Method brute = brute_force();
        for (int own = 0; own < 2; ++own) {
            const Case c = make_case(bench.world[1], own, moved(0, 2));
            Result result;
            brute.run(job_of(c), result);
            ordered_json row = row_head(brute.name, c);
            row.update(score_classes(c, result.classes, false));
            row["triangles"] = result.triangles;
            bench.out["accuracy"].push_back(std::move(row));
        }
    });
}

void plan_rig(Bench& bench, Plan& plan) {
    const double area = bench.scale() * bench.scale();
    for (const double y : rig_shifts_left_m(bench))
        plan.add(0.1 + 12 * area, "rig", [&bench, y] { run_rig(bench, moved(0, y)); });
}

}  // namespace vshift::bench
