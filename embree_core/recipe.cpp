// SPDX-License-Identifier: Apache-2.0
#include "embree_core/recipe.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <nlohmann/json.hpp>
#include <set>

#include "embree_core/image_file.h"
#include "embree_core/words.h"

namespace vshift {
namespace {

using nlohmann::json;
namespace fs = std::filesystem;

constexpr size_t recipe_limit_bytes = size_t(64) << 20;
constexpr int deepest_nesting = 16;

using vshift::shown;  // of text
std::string shown(const json& value) {
    switch (value.type()) {
        case json::value_t::object:
            return "an object";
        case json::value_t::array:
            return "an array of " + std::to_string(value.size());
        case json::value_t::string:
            return shown(value.get_ref<const std::string&>());
        default:
            return value.dump();
    }
}

/// Parses with the two things that the library lets pass refused: duplicate keys and deep nesting.
json parse_strict(const std::string& text, const std::string& file) {
    std::vector<std::set<std::string>> keys;
    const auto callback = [&](int depth, json::parse_event_t event, json& parsed) {
        if (depth > deepest_nesting)
            refuse(file + ": json", "nesting deeper than " + std::to_string(deepest_nesting), "a recipe");
        if (event == json::parse_event_t::object_start) keys.emplace_back();
        if (event == json::parse_event_t::object_end) keys.pop_back();
        if (event == json::parse_event_t::key) {
            const std::string key = parsed.get<std::string>();
            if (!keys.back().insert(key).second) refuse(file + ": " + key, "the key twice", "it once");
        }
        return true;
    };
    try {
        return json::parse(text, callback);
    } catch (const json::exception& e) {
        std::string reason = e.what();
        if (const size_t end = reason.find("] "); end != std::string::npos) reason = reason.substr(end + 2);
        std::replace(reason.begin(), reason.end(), '\n', ' ');
        refuse(file + ": json", reason.substr(0, 160), "valid JSON");
    }
}

/// Typed access to one JSON object; `where` is `file: camera` so far.
class Fields {
public:
    Fields(const json& object, std::string where, const std::vector<std::string>& known)
        : object_(object), where_(std::move(where)) {
        if (!object.is_object()) refuse(where_, shown(object), "an object");
        for (const auto& [key, value] : object.items())
            if (std::find(known.begin(), known.end(), key) == known.end())
                refuse(where_ + ": " + shown(key), "an unknown key",
                       "one of " + list_of(known) + " (did you mean " + nearest_word(key, known) + "?)");
    }
    std::string at(const std::string& key) const { return where_ + ": " + key; }
    bool has(const std::string& key) const { return object_.contains(key); }

    const json& required(const std::string& key, const std::string& expected) const {
        if (!has(key)) refuse(at(key), "nothing", expected);
        return object_.at(key);
    }
    std::string text(const std::string& key) const {
        const json& v = required(key, "text");
        if (!v.is_string()) refuse(at(key), shown(v), "text");
        return v.get<std::string>();
    }
    std::string text_or(const std::string& key, const std::string& otherwise) const {
        return has(key) ? text(key) : otherwise;
    }
    double number(const std::string& key) const { return as_number(required(key, "a number"), at(key)); }
    int whole(const std::string& key, int lowest, int highest) const {
        const std::string expected = "a whole number from " + std::to_string(lowest) + " to " + std::to_string(highest);
        const json& v = required(key, expected);
        if (!v.is_number_integer()) refuse(at(key), shown(v), expected);
        const bool too_big = v.is_number_unsigned() && v.get<uint64_t>() > uint64_t(highest);
        if (too_big || v.get<int64_t>() < lowest || v.get<int64_t>() > highest) refuse(at(key), shown(v), expected);
        return v.get<int>();
    }
    std::vector<double> numbers(const std::string& key, size_t count) const {
        return as_numbers(required(key, std::to_string(count) + " numbers"), at(key), count);
    }
    static double as_number(const json& v, const std::string& where) {
        if (!v.is_number()) refuse(where, shown(v), "a number");
        const double value = v.get<double>();
        if (!std::isfinite(value)) refuse(where, shown(v), "a finite number");
        return value;
    }
    static std::vector<double> as_numbers(const json& v, const std::string& where, size_t count) {
        if (!v.is_array() || v.size() != count) refuse(where, shown(v), std::to_string(count) + " numbers");
        std::vector<double> out;
        for (size_t i = 0; i < count; ++i) out.push_back(as_number(v[i], where + "[" + std::to_string(i) + "]"));
        return out;
    }

private:
    const json& object_;
    std::string where_;
};

Pose read_pose(const Fields& fields) {
    const auto q = fields.numbers("rotation", 4);
    const auto t = fields.numbers("translation", 3);
    const double norm = std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    if (std::fabs(norm - 1) > 1e-3)
        refuse(fields.at("rotation"), "a quaternion of length " + std::to_string(norm),
               "a rotation: w,x,y,z of length 1");
    const glm::dquat unit = glm::normalize(glm::dquat(q[0], q[1], q[2], q[3]));
    return {glm::mat3_cast(unit), {t[0], t[1], t[2]}};
}

/// A path pattern below the recipe's folder with at most one %0Nd.
std::string checked_pattern(const std::string& pattern, const std::string& where) {
    const fs::path path(pattern);
    if (pattern.empty()) refuse(where, "''", "a path");
    if (pattern.find('\0') != std::string::npos) refuse(where, shown(pattern), "a path");
    if (path.is_absolute()) refuse(where, shown(pattern), "a path relative to the recipe");
    int level = 0;
    for (const fs::path& part : path) {
        if (part == "..")
            --level;
        else if (part != "." && !part.empty())
            ++level;
        if (level < 0) refuse(where, shown(pattern), "a path that stays below the recipe's folder");
    }
    const size_t percent = pattern.find('%');
    if (percent == std::string::npos) return pattern;
    const bool frame = pattern.size() >= percent + 4 && pattern[percent + 1] == '0' && pattern[percent + 2] >= '1' &&
                       pattern[percent + 2] <= '9' && pattern[percent + 3] == 'd';
    if (!frame || pattern.find('%', percent + 1) != std::string::npos)
        refuse(where, shown(pattern), "at most one frame number such as %04d");
    return pattern;
}

void check_name(const std::string& name, const std::string& where) {
    const bool good = !name.empty() && name.size() <= 64 && std::all_of(name.begin(), name.end(), [](char c) {
        return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_' || c == '-';
    });
    if (!good) refuse(where, shown(name), "a name of letters, digits, _ and -");
}

CameraSpec read_camera(const json& value, const std::string& file, size_t position) {
    std::string where = file + ": cameras[" + std::to_string(position) + "]";
    if (value.is_object() && value.contains("name") && value["name"].is_string() &&
        !value["name"].get_ref<const std::string&>().empty())
        where = file + ": " + value["name"].get<std::string>().substr(0, 64);
    const Fields fields(value, where,
                        {"name", "width", "height", "intrinsic", "rotation", "translation", "image", "depth",
                         "depth_channel", "depth_scale_m", "depth_source"});
    CameraSpec camera;
    camera.name = fields.text("name");
    check_name(camera.name, fields.at("name"));
    for (const char* side : {"width", "height"}) {
        const json& v = fields.required(side, "a whole number");
        if (v.is_number_integer() && v.get<double>() > max_image_side)
            throw Error(ExitCode::over_limit,
                        fields.at(side) + ": got " + shown(v) + ", expected at most " + std::to_string(max_image_side));
    }
    Intrinsics& k = camera.intrinsics;
    k.width = fields.whole("width", 1, max_image_side);
    k.height = fields.whole("height", 1, max_image_side);
    const json& matrix = fields.required("intrinsic", "a 3x3 matrix");
    if (!matrix.is_array() || matrix.size() != 3) refuse(fields.at("intrinsic"), shown(matrix), "a 3x3 matrix");
    double m[3][3];
    for (size_t row = 0; row < 3; ++row) {
        const auto numbers = Fields::as_numbers(matrix[row], fields.at("intrinsic[" + std::to_string(row) + "]"), 3);
        std::copy(numbers.begin(), numbers.end(), m[row]);
    }
    k.fx = m[0][0], k.fy = m[1][1], k.cx = m[0][2], k.cy = m[1][2];
    const auto number = [](double v) { return json(v).dump(); };
    if (!(k.fx > 0)) refuse(fields.at("intrinsic[0][0]"), "fx = " + number(k.fx), "fx > 0");
    if (!(k.fy > 0)) refuse(fields.at("intrinsic[1][1]"), "fy = " + number(k.fy), "fy > 0");
    if (m[0][1] != 0 || m[1][0] != 0)
        refuse(fields.at("intrinsic"), "skew " + number(m[0][1] != 0 ? m[0][1] : m[1][0]), "no skew");
    if (m[2][0] != 0 || m[2][1] != 0 || m[2][2] != 1)
        refuse(fields.at("intrinsic[2]"), "[" + number(m[2][0]) + "," + number(m[2][1]) + "," + number(m[2][2]) + "]",
               "[0,0,1]");
    if (std::max(k.fx, k.fy) > 1e7 || std::fabs(k.cx) > 1e7 || std::fabs(k.cy) > 1e7 || std::min(k.fx, k.fy) < 1e-3)
        refuse(fields.at("intrinsic"), shown(matrix), "focal lengths from 0.001 to 1e7 pixels and a centre within 1e7");
    camera.ego_from_cam = read_pose(fields);
    if (fields.has("image")) camera.image = checked_pattern(fields.text("image"), fields.at("image"));
    if (fields.has("depth")) camera.depth = checked_pattern(fields.text("depth"), fields.at("depth"));
    camera.depth_channel = fields.text_or("depth_channel", "Z");
    if (fields.has("depth_scale_m")) camera.depth_scale_m = fields.number("depth_scale_m");
    if (!(camera.depth_scale_m > 0)) refuse(fields.at("depth_scale_m"), number(camera.depth_scale_m), "> 0 metres");
    if (fields.has("depth_source"))
        camera.depth_source = depth_source_of(fields.text("depth_source"), fields.at("depth_source"));
    return camera;
}

FrameSpec read_frame(const json& value, const std::string& file, size_t position, const Recipe& recipe) {
    const std::string where = file + ": frames[" + std::to_string(position) + "]";
    const Fields fields(value, where, {"index", "timestamp_s", "rotation", "translation", "cameras"});
    FrameSpec frame;
    frame.index = fields.whole("index", 0, 99999999);
    frame.timestamp_s = fields.has("timestamp_s") ? fields.number("timestamp_s") : 0;
    frame.world_from_ego = read_pose(fields);
    if (!fields.has("cameras")) return frame;
    const json& overrides = fields.required("cameras", "an object");
    if (!overrides.is_object()) refuse(fields.at("cameras"), shown(overrides), "an object of cameras");
    for (const auto& [name, entry] : overrides.items()) {
        recipe.camera(name);
        const Fields own(entry, where + ": " + name, {"timestamp_s", "rotation", "translation"});
        frame.cameras[name] = {own.number("timestamp_s"), read_pose(own)};
    }
    return frame;
}

/// The text form of a request value in a recipe, so that one parser serves all.
std::string request_text(const json& value, const std::string& where) {
    if (value.is_string()) return value.get<std::string>();
    if (value.is_number()) return value.dump();
    if (value.is_array()) {
        std::string text;
        for (const json& part : value) {
            if (!part.is_number()) refuse(where, shown(part), "a number");
            text += (text.empty() ? "" : ",") + part.dump();
        }
        return text;
    }
    refuse(where, shown(value), "text or numbers");
}

}  // namespace

fs::path Recipe::folder() const {
    return file.parent_path().empty() ? fs::path(".") : file.parent_path();
}

const CameraSpec& Recipe::camera(const std::string& name) const {
    std::vector<std::string> names;
    for (const CameraSpec& c : cameras) {
        if (c.name == name) return c;
        names.push_back(c.name);
    }
    refuse(file.string() + ": camera", shown(name),
           "one of " + list_of(names) + " (did you mean " + nearest_word(name, names) + "?)");
}

const FrameSpec& Recipe::frame(int index) const {
    for (const FrameSpec& f : frames)
        if (f.index == index) return f;
    refuse(file.string() + ": frame", std::to_string(index),
           frames.size() == 1
               ? std::to_string(frames[0].index)
               : "one of the " + std::to_string(frames.size()) + " frames from " +
                     std::to_string(frames.front().index) + " to " + std::to_string(frames.back().index));
}

fs::path Recipe::path(const std::string& pattern, int frame_index) const {
    std::string text = pattern;
    if (const size_t percent = text.find('%'); percent != std::string::npos) {
        std::string digits = std::to_string(frame_index);
        const size_t width = size_t(text[percent + 2] - '0');
        if (digits.size() < width) digits.insert(0, width - digits.size(), '0');
        text.replace(percent, 4, digits);
    }
    return file.parent_path() / text;
}

Pose Recipe::world_from_ego(const std::string& name, int frame_index) const {
    const FrameSpec& f = frame(frame_index);
    const auto own = f.cameras.find(name);
    return own == f.cameras.end() ? f.world_from_ego : own->second.world_from_ego;
}

Pose Recipe::world_from_cam(const std::string& name, int frame_index) const {
    return compose(world_from_ego(name, frame_index), camera(name).ego_from_cam);
}

Recipe load_recipe(const fs::path& path) {
    const std::string file = path.string();
    const json root = parse_strict(read_whole_file(path, recipe_limit_bytes), file);
    std::vector<std::string> known = {"vshift", "cameras", "frames"};
    known.insert(known.end(), request_keys().begin(), request_keys().end());
    const Fields fields(root, file, known);
    if (const json& version = fields.required("vshift", "1"); !version.is_number_integer() || version != 1)
        refuse(fields.at("vshift"), shown(version), "1");

    Recipe recipe;
    recipe.file = path;
    const json& cameras = fields.required("cameras", "an array of cameras");
    if (!cameras.is_array() || cameras.empty() || cameras.size() > 64)
        refuse(fields.at("cameras"), shown(cameras), "an array of 1 to 64 cameras");
    std::set<std::string> names;
    for (size_t i = 0; i < cameras.size(); ++i) {
        recipe.cameras.push_back(read_camera(cameras[i], file, i));
        if (!names.insert(recipe.cameras.back().name).second)
            refuse(file + ": " + recipe.cameras.back().name + ": name", "the name twice", "different names");
    }
    const json& frames = fields.required("frames", "an array of frames");
    if (!frames.is_array() || frames.empty() || frames.size() > 1000000)
        refuse(fields.at("frames"), shown(frames), "an array of 1 to 1000000 frames");
    std::set<int> indices;
    for (size_t i = 0; i < frames.size(); ++i) {
        recipe.frames.push_back(read_frame(frames[i], file, i, recipe));
        if (!indices.insert(recipe.frames.back().index).second)
            refuse(file + ": frames[" + std::to_string(i) + "]: index",
                   std::to_string(recipe.frames.back().index) + " twice", "different indices");
    }
    recipe.defaults.frame = recipe.frames.front().index;
    for (const std::string& key : request_keys())
        if (fields.has(key)) set_request_key(recipe.defaults, key, request_text(root[key], fields.at(key)), file);
    check_request(recipe, recipe.defaults, file);
    return recipe;
}

std::vector<std::string> requested_cameras(const Recipe& recipe, const Request& request) {
    if (!request.camera.empty() && request.camera != "*") return {request.camera};
    std::vector<std::string> names;
    for (const CameraSpec& c : recipe.cameras) names.push_back(c.name);
    return names;
}

}  // namespace vshift
