// SPDX-License-Identifier: Apache-2.0
// vshift-scenes: writes minimal scenes as recipes with exact images, depth and expected masks, and
// prints their closed forms as JSON.
#include <CLI/CLI.hpp>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <glm/gtc/quaternion.hpp>
#include <iostream>
#include <nlohmann/json.hpp>

#include "embree_core/c_api.h"
#include "embree_core/image_file.h"
#include "scenes/minimal/minimal.h"

namespace vshift::minimal {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

struct Options {
    std::string scene, depth = "exr";
    fs::path folder;
    Size size;
    uint32_t seed = 1;
};

std::string frame_folder(size_t index) {
    char text[32];
    std::snprintf(text, sizeof text, "%04zu", index);
    return text;
}

Json rotation_of(const glm::dmat3& rotation) {
    glm::dquat q = glm::quat_cast(rotation);
    if (q.w < 0) q = -q;
    return {q.w, q.x, q.y, q.z};
}

Json vector_of(const glm::dvec3& v) {
    return {v.x, v.y, v.z};
}

std::vector<float> channel(const ColorImage& image, int c) {
    std::vector<float> plane(image.size());
    for (size_t i = 0; i < plane.size(); ++i) plane[i] = image.data[i][c];
    return plane;
}

Channels sized(int width, int height) {
    Channels out;
    out.width = width;
    out.height = height;
    return out;
}

void add_color(Channels& out, const ColorImage& image) {
    out.add("R", channel(image, 0));
    out.add("G", channel(image, 1));
    out.add("B", channel(image, 2));
}

void add_flags(Channels& out, const std::string& name, const Grid<uint8_t>& flags, unsigned bits) {
    std::vector<float> plane(flags.size());
    for (size_t i = 0; i < plane.size(); ++i) plane[i] = (flags.data[i] & bits) ? 1.0f : 0.0f;
    out.add(name, std::move(plane));
}

/// Millimetres in 16 bits; what does not fit (beyond 65.535 m, sky) is 0: no measurement.
std::vector<float> millimetres(const DepthMap& depth) {
    std::vector<float> plane(depth.size());
    for (size_t i = 0; i < plane.size(); ++i) {
        const double mm = std::round(1000.0 * double(depth.data[i]));
        plane[i] = mm >= 1 && mm <= 65535 ? float(mm / 65535.0) : 0.0f;
    }
    return plane;
}

void write_view(const fs::path& folder, const std::string& camera, const Picture& picture,
                const std::string& depth_kind) {
    Channels image = sized(picture.depth.width, picture.depth.height);
    add_color(image, picture.color);
    if (depth_kind == "exr") image.add("Z", picture.depth.data);
    write_image(folder / (camera + ".exr"), image);
    if (depth_kind == "exr") return;
    Channels depth = sized(picture.depth.width, picture.depth.height);
    const bool png = depth_kind == "png";
    depth.add("Z", png ? millimetres(picture.depth) : picture.depth.data);
    write_image(folder / (camera + "_depth." + depth_kind), depth, {png ? SampleType::uint16 : SampleType::float32});
}

Json recipe_of(const MinimalScene& s, const std::string& depth_kind) {
    Json recipe = {{"vshift", 1}, {"cameras", Json::array()}, {"frames", Json::array()}};
    for (const Camera& c : s.rig) {
        const Intrinsics& k = c.intrinsics;
        Json camera = {{"name", c.name}, {"width", k.width}, {"height", k.height}};
        camera["intrinsic"] =
            Json::array({Json::array({k.fx, 0, k.cx}), Json::array({0, k.fy, k.cy}), Json::array({0, 0, 1})});
        camera["rotation"] = rotation_of(c.ego_from_cam.rotation);
        camera["translation"] = vector_of(c.ego_from_cam.translation_m);
        camera["image"] = "frames/%04d/" + c.name + ".exr";
        if (depth_kind == "exr") {
            camera["depth"] = camera["image"];
            camera["depth_channel"] = "Z";
        } else {
            camera["depth"] = "frames/%04d/" + c.name + "_depth." + depth_kind;
            if (depth_kind == "png") camera["depth_scale_m"] = 0.001;
        }
        recipe["cameras"].push_back(camera);
    }
    for (size_t i = 0; i < s.frames.size(); ++i)
        recipe["frames"].push_back({{"index", i},
                                    {"timestamp_s", 0.1 * double(i)},
                                    {"rotation", rotation_of(s.frames[i].rotation)},
                                    {"translation", vector_of(s.frames[i].translation_m)}});
    recipe["camera"] = s.rig[size_t(s.own)].name;
    recipe["frame"] = 0;
    recipe["shift"] = vector_of(s.shift.translation_m);
    recipe["yaw_deg"] = s.shift.yaw_rad * 180 / std::acos(-1.0);
    recipe["out"] = "mask";
    return recipe;
}

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
    add_color(shifted, picture.color);
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

int run(int argc, char** argv) {
    Options options;
    bool list = false;
    CLI::App app{"Minimal scenes whose masks are known in closed form."};
    app.add_option("scene", options.scene, "a name of --list, or all");
    app.add_option("-o,--output", options.folder, "folder to write into");
    app.add_option("--width", options.size.width, "pixels; the focal length is the width")->check(CLI::Range(8, 8192));
    app.add_option("--height", options.size.height, "pixels")->check(CLI::Range(8, 8192));
    app.add_option("--seed", options.seed, "of the scene called random");
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
        return 0;
    }
    if (options.scene.empty()) throw Error(ExitCode::bad_input, "scene: got none, expected a name of --list, or all");
    if (options.folder.empty()) throw Error(ExitCode::bad_input, "-o: got none, expected a folder");
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
