// SPDX-License-Identifier: Apache-2.0
// vshift-scenes: writes minimal scenes as recipes with exact images, depth and expected masks, and
// prints their closed forms as JSON; writes analytic streets as recipes with colour and exact depth.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <glm/gtc/quaternion.hpp>
#include <iostream>
#include <nlohmann/json.hpp>

#include "embree_core/c_api.h"
#include "embree_core/image_file.h"
#include "embree_core/srgb.h"
#include "scenes/analytic/analytic_street.h"
#include "scenes/analytic/street_set.h"
#include "scenes/minimal/minimal.h"
#include "scenes/scene_files.h"
#include "scenes/trouble/trouble.h"

namespace vshift::minimal {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

struct Options {
    std::string scene, depth = "exr";
    fs::path folder;
    Size size;
    uint32_t seed = 1;
    int frames = 1, samples = 2;  // of the analytic street
};

constexpr const char *street_name = "analytic_street", *set_name = "analytic_set";

size_t set_pixels(const Grid<uint8_t>& flags, unsigned bits) {
    size_t n = 0;
    for (uint8_t f : flags.data) n += (f & bits) != 0;
    return n;
}

Json closed_forms_of(const MinimalScene& s) {
    Json all = Json::array();
    for (const ClosedForm& form : s.closed_forms) {
        size_t n = 0;
        for (uint8_t v : form.expected.data) n += v;
        Json entry = {{"out", form.out}, {"channel", form.channel}, {"rule", form.rule}, {"pixels", n}};
        const std::vector<RectPx> found = rectangles(form.expected);
        if (found.size() <= 64) {  // as [x0, y0, x1, y1], ends excluded
            entry["rectangles_px"] = Json::array();
            for (const RectPx& r : found)
                entry["rectangles_px"].push_back({int(r.x0), int(r.y0), int(r.x1), int(r.y1)});
        }
        all.push_back(entry);
    }
    return all;
}

/// Writes one scene and returns what is known about it.
Json write_scene(const Options& options, const fs::path& folder) {
    const MinimalScene s = make_scene(options.scene, options.size, options.seed);
    for (size_t f = 0; f < s.frames.size(); ++f) {
        const fs::path into = folder / "frames" / frame_folder(f);
        fs::create_directories(into);
        for (size_t c = 0; c < s.rig.size(); ++c)
            write_view(into, s.rig[c].name, render(s.world, s.recorded(int(c), int(f))), options.depth);
    }
    const View v = s.shifted(s.shift, s.own);
    const Grid<uint8_t> recorded = truth_recorded(s.world, s.views(), s.own, v);
    const Grid<uint8_t> classes = truth_shifted(s.world, s.views(), s.own, v);
    const unsigned lost = VSHIFT_TRUTH_OCCLUDED | VSHIFT_TRUTH_OUTSIDE;

    fs::create_directories(folder / "expected");
    Channels masks = sized(recorded.width, recorded.height);
    add_flags(masks, "lost", recorded, lost);
    add_flags(masks, "occluded", recorded, VSHIFT_TRUTH_OCCLUDED);
    add_flags(masks, "outside", recorded, VSHIFT_TRUTH_OUTSIDE);
    add_flags(masks, "shell_self", recorded, VSHIFT_TRUTH_SHELL_SELF);
    add_flags(masks, "shell_rig", recorded, VSHIFT_TRUTH_SHELL_RIG);
    write_image(folder / "expected" / "mask.exr", masks);

    const Picture picture = render(s.world, v);
    Channels shifted = sized(classes.width, classes.height);
    shifted.add_color(picture.color);
    shifted.add("Z", picture.depth.data);
    shifted.add("class", std::vector<float>(classes.data.begin(), classes.data.end()));
    write_image(folder / "expected" / "shifted.exr", shifted);

    const Intrinsics& k = s.rig[size_t(s.own)].intrinsics;
    const Json known = {{"scene", s.name},
                        {"about", s.about},
                        {"camera", s.rig[size_t(s.own)].name},
                        {"width", k.width},
                        {"height", k.height},
                        {"focal_px", k.fx},
                        {"shift_m", vector_of(s.shift.translation_m)},
                        {"closed_forms", closed_forms_of(s)},
                        {"truth_px",
                         {{"lost", set_pixels(recorded, lost)},
                          {"occluded", set_pixels(recorded, VSHIFT_TRUTH_OCCLUDED)},
                          {"outside", set_pixels(recorded, VSHIFT_TRUTH_OUTSIDE)},
                          {"faces_away", set_pixels(recorded, VSHIFT_TRUTH_FACES_AWAY)},
                          {"shell_self", set_pixels(recorded, VSHIFT_TRUTH_SHELL_SELF)},
                          {"shell_rig", set_pixels(recorded, VSHIFT_TRUTH_SHELL_RIG)}}}};
    write_whole_file(folder / "expected" / "closed_form.json", known.dump(2) + "\n");
    write_whole_file(folder / (s.name + ".vshift"), recipe_of(s, options.depth).dump(2) + "\n");
    return known;
}

/// The rig's six pictures side by side as they look round the car, at most 640 px wide each, sRGB.
void write_preview(const fs::path& file, const std::vector<ColorImage>& pictures) {
    const int by[6] = {1, 0, 2, 4, 3, 5};  // column and row of each camera: front row, back row
    const int step = (pictures[0].width + 639) / 640, w = pictures[0].width / step, h = pictures[0].height / step;
    ColorImage all(3 * w, 2 * h);
    for (size_t c = 0; c < pictures.size(); ++c)
        for (int y = 0; y < h; ++y)
            for (int x = 0; x < w; ++x) {
                glm::vec3 sum(0);
                for (int i = 0; i < step * step; ++i) sum += pictures[c].at(x * step + i % step, y * step + i / step);
                for (int i = 0; i < 3; ++i) sum[i] = float(srgb_from_linear(double(sum[i]) / (step * step)));
                all.at(by[c] % 3 * w + x, by[c] / 3 * h + y) = sum;
            }
    Channels image = sized(all.width, all.height);
    image.add_color(all);
    write_image(file, image, {SampleType::uint8});
}

/// Writes an analytic street and returns its counts.
Json write_street(const Options& options) {
    const analytic::StreetScene street = analytic::build_street(options.seed);
    const std::vector<analytic::RigCamera> rig = analytic::six_camera_rig(options.size.width, options.size.height);
    MinimalScene set;  // what the recipe needs of one
    set.name = street_name;
    set.shift.translation_m = {0, 1, 0};
    for (const analytic::RigCamera& c : rig) set.rig.push_back({c.name, c.intrinsics, c.ego_from_cam});
    for (int f = 0; f < options.frames; ++f) {
        set.frames.push_back(analytic::ego_pose(f));
        const fs::path into = options.folder / "frames" / frame_folder(size_t(f));
        fs::create_directories(into);
        std::vector<ColorImage> pictures;
        for (const analytic::RigCamera& c : rig) {
            const TrueCamera camera = analytic::recorded_camera(c, f);
            pictures.push_back(analytic::street_color(street, camera, options.samples));
            write_view(into, c.name, {pictures.back(), cast_camera(street.scene, camera).depth, {}}, options.depth);
        }
        if (f == 0) write_preview(options.folder / "preview.png", pictures);
    }
    write_whole_file(options.folder / (set.name + ".vshift"), recipe_of(set, options.depth).dump(2) + "\n");
    Json shapes;
    for (size_t k = 0; k < analytic::kind_count; ++k)
        shapes[analytic::kind_name(analytic::Kind(k))] = street.street.shapes[k];
    char hash[17];
    std::snprintf(hash, sizeof hash, "%016llx", (unsigned long long)analytic::geometry_hash(street.street));
    return {{"scene", street_name},     {"seed", options.seed},
            {"frames", options.frames}, {"triangles", street.street.triangles.size()},
            {"shapes", shapes},         {"geometry_hash", hash}};
}

constexpr const char* trouble_prefix = "trouble_";

/// One twin of a trouble scene: what was recorded, as a recipe, and the true view from its default shift.
void write_trouble_twin(const trouble::Scene& scene, bool fault, const Options& options, const fs::path& folder) {
    MinimalScene set;  // what the recipe needs of one
    set.name = trouble_prefix + scene.name;
    set.shift.translation_m = {0, 2, 0};
    set.frames = {Pose{}};
    const trouble::Views views = trouble::render(scene, fault, set.shift, options.size.width);
    fs::create_directories(folder / "frames" / "0000");
    for (size_t c = 0; c < views.rig.size(); ++c) {
        set.rig.push_back({views.rig[c].name, views.rig[c].intrinsics, views.rig[c].ego_from_cam});
        write_view(folder / "frames" / "0000", views.rig[c].name, {views.recorded[c].color, views.recorded[c].depth, {}},
                   options.depth);
    }
    fs::create_directories(folder / "expected");
    Channels shifted = sized(views.shifted.color.width, views.shifted.color.height);
    shifted.add_color(views.shifted.color);
    shifted.add("Z", views.shifted.depth.data);
    add_flags(shifted, "fault", views.shifted.touched, 1);
    write_image(folder / "expected" / "shifted.exr", shifted);
    write_whole_file(folder / (set.name + ".vshift"), recipe_of(set, options.depth).dump(2) + "\n");
}

int run(int argc, char** argv) {
    Options options;
    bool list = false;
    CLI::App app{"Minimal scenes whose masks are known in closed form, and streets whose truth is cast exactly."};
    app.add_option("scene", options.scene, "a name of --list, or all");
    app.add_option("-o,--output", options.folder, "folder to write into");
    app.add_option("--width", options.size.width, "pixels; the focal length is the width")->check(CLI::Range(8, 8192));
    auto* height =
        app.add_option("--height", options.size.height, "pixels; of analytic_street 9/16 of the width unless given")
            ->check(CLI::Range(8, 8192));
    app.add_option("--seed", options.seed, "of the scenes called random, analytic_street and analytic_set");
    app.add_option("--frames", options.frames, "of analytic_street and analytic_set: the ego drives 0.5 m from one to the next")
        ->check(CLI::Range(1, analytic::most_frames));
    app.add_option("--samples", options.samples, "of analytic_street and analytic_set: n x n colour samples per pixel")
        ->check(CLI::Range(1, 8));
    app.add_option("--depth", options.depth, "file of the depth")->check(CLI::IsMember({"exr", "png", "pfm", "npy"}));
    app.add_flag("--list", list, "print the names of the scenes");
    try {
        app.parse(argc, argv);
    } catch (const CLI::Success& e) {
        return app.exit(e);
    } catch (const CLI::ParseError& e) {
        app.exit(e);
        return int(ExitCode::bad_input);
    }
    if (list) {
        for (const std::string& name : scene_names()) std::cout << name << "\n";
        std::cout << street_name << "\n" << set_name << "\n";
        for (const trouble::Scene& scene : trouble::scenes()) std::cout << trouble_prefix << scene.name << "\n";
        return 0;
    }
    if (options.scene.empty()) throw Error(ExitCode::bad_input, "scene: got none, expected a name of --list, or all");
    if (options.folder.empty()) throw Error(ExitCode::bad_input, "-o: got none, expected a folder");
    if (options.scene.rfind(trouble_prefix, 0) == 0) {
        const trouble::Scene& scene = trouble::scene(options.scene.substr(std::string(trouble_prefix).size()));
        write_trouble_twin(scene, true, options, options.folder);
        write_trouble_twin(scene, false, options, options.folder / "without_fault");
        std::cout << Json{{"scene", options.scene}, {"fault", scene.fault}, {"without_fault", scene.control}}.dump(2) << "\n";
        return 0;
    }
    if (options.scene == street_name || options.scene == set_name) {
        if (height->count() == 0) options.size.height = std::max(8, options.size.width * 9 / 16);
        if (options.scene == set_name) {
            analytic::write_street_set({options.seed, options.size.width, options.size.height, options.frames,
                                        options.samples, options.folder});
            return 0;
        }
        std::cout << write_street(options).dump(2) << "\n";
        return 0;
    }
    if (options.scene != "all") {
        std::cout << write_scene(options, options.folder).dump(2) << "\n";
        return 0;
    }
    Json all = Json::array();
    for (const std::string& name : scene_names()) {
        Options one = options;
        one.scene = name;
        all.push_back(write_scene(one, options.folder / name));
    }
    std::cout << all.dump(2) << "\n";
    return 0;
}

}  // namespace
}  // namespace vshift::minimal

int main(int argc, char** argv) {
    using vshift::ExitCode;
    try {
        return vshift::minimal::run(argc, argv);
    } catch (const vshift::Error& e) {
        std::cerr << "vshift-scenes: " << e.what() << "\n";
        return int(e.code());
    } catch (const std::filesystem::filesystem_error& e) {
        std::cerr << "vshift-scenes: " << e.path1().string() << ": got " << e.code().message()
                  << ", expected a writable folder\n";
        return int(ExitCode::io_failed);
    } catch (const std::exception& e) {
        std::cerr << "vshift-scenes: " << e.what() << "\n";
        return int(ExitCode::our_bug);
    }
}
