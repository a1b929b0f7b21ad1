// SPDX-License-Identifier: Apache-2.0
#include "scenes/scene_files.h"

#include <cmath>
#include <cstdio>
#include <glm/gtc/quaternion.hpp>

namespace vshift::minimal {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

namespace {

/// Millimetres in 16 bits; what does not fit (beyond 65.535 m, sky) is 0: no measurement.
std::vector<float> millimetres(const DepthMap& depth) {
    std::vector<float> plane(depth.size());
    for (size_t i = 0; i < plane.size(); ++i) {
        const double mm = std::round(1000.0 * double(depth.data[i]));
        plane[i] = mm >= 1 && mm <= 65535 ? float(mm / 65535.0) : 0.0f;
    }
    return plane;
}

}  // namespace

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

Channels sized(int width, int height) {
    Channels out;
    out.width = width;
    out.height = height;
    return out;
}

void add_flags(Channels& out, const std::string& name, const Grid<uint8_t>& flags, unsigned bits) {
    std::vector<float> plane(flags.size());
    for (size_t i = 0; i < plane.size(); ++i) plane[i] = (flags.data[i] & bits) ? 1.0f : 0.0f;
    out.add(name, std::move(plane));
}

void write_view(const fs::path& folder, const std::string& camera, const Picture& picture,
                const std::string& depth_kind) {
    Channels image = sized(picture.depth.width, picture.depth.height);
    image.add_color(picture.color);
    if (depth_kind == "exr") image.add("Z", picture.depth.data);
    write_image(folder / (camera + ".exr"), image);
    if (depth_kind == "exr") return;
    Channels depth = sized(picture.depth.width, picture.depth.height);
    const bool png = depth_kind == "png";
    depth.add("Z", png ? millimetres(picture.depth) : picture.depth.data);
    write_image(folder / (camera + "_depth." + depth_kind), depth, {png ? SampleType::uint16 : SampleType::float32});
}

Json recipe_of(const MinimalScene& s, const std::string& depth_kind, double dt_s) {
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
                                    {"timestamp_s", dt_s * double(i)},
                                    {"rotation", rotation_of(s.frames[i].rotation)},
                                    {"translation", vector_of(s.frames[i].translation_m)}});
    recipe["camera"] = s.rig[size_t(s.own)].name;
    recipe["frame"] = 0;
    recipe["shift"] = vector_of(s.shift.translation_m);
    recipe["yaw_deg"] = s.shift.yaw_rad * 180 / std::acos(-1.0);
    recipe["out"] = "mask";
    return recipe;
}

}  // namespace vshift::minimal
