// SPDX-License-Identifier: Apache-2.0
#include "embree_core/recipe.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <nlohmann/json.hpp>
#include <set>

#include "embree_core/image_file.h"

namespace vshift {
namespace {

using nlohmann::json;
namespace fs = std::filesystem;

constexpr size_t recipe_limit_bytes = size_t(64) << 20;
constexpr int deepest_nesting = 16;

const std::vector<std::string> known_outs = {"mask", "holes", "warp", "seam", "condition"};

/// Request keys that are a number in a range.
struct NumberKey {
    const char* name;
    double lowest, highest;
    const char* expected;
    double& (*in)(Request&);
};
const NumberKey number_keys[] = {
    {"tolerance_px", 0, 4, "0 (a vertex for every pixel) to 4 pixels",
     [](Request& r) -> double& { return r.tolerance_px; }},
    {"clear_m", 0, 1000, "metres from 0 to 1000", [](Request& r) -> double& { return r.clear_m; }},
    {"depth_tolerance", 0, 1, "a share of the depth from 0 to 1",
     [](Request& r) -> double& { return r.depth_tolerance; }},
    {"noise_exposure", 0, 8, "stops from 0 to 8", [](Request& r) -> double& { return r.noise.exposure_stops; }},
    {"noise_white_balance", 0, 8, "stops from 0 to 8",
     [](Request& r) -> double& { return r.noise.white_balance_stops; }},
    {"noise_pose_m", 0, 10, "metres from 0 to 10", [](Request& r) -> double& { return r.noise.pose_m; }},
    {"noise_pose_deg", 0, 45, "degrees from 0 to 45", [](Request& r) -> double& { return r.noise.pose_deg; }},
    {"noise_time_s", 0, 10, "seconds from 0 to 10", [](Request& r) -> double& { return r.noise.time_s; }},
    {"noise_depth_scale", 0, 1, "a share of the depth from 0 to 1",
     [](Request& r) -> double& { return r.noise.depth_scale; }},
    {"noise_depth_bias_m", 0, 100, "metres from 0 to 100", [](Request& r) -> double& { return r.noise.depth_bias_m; }},
    {"noise_depth_blur_px", 0, 64, "pixels from 0 to 64", [](Request& r) -> double& { return r.noise.depth_blur_px; }},
    {"noise_depth_field", 0, 1, "a share of the depth from 0 to 1",
     [](Request& r) -> double& { return r.noise.depth_field; }},
};

const std::vector<std::string> request_keys = [] {
    std::vector<std::string> keys = {"camera", "frame",  "shift",      "yaw_deg",      "out",
                                     "from",   "view",   "method",     "edge",         "match",
                                     "arm",    "stride", "noise_seed", "depth_source", "certify"};
    for (const NumberKey& key : number_keys) keys.push_back(key.name);
    return keys;
}();

[[noreturn]] void refuse(const std::string& where, const std::string& got, const std::string& expected) {
    throw Error(ExitCode::bad_input, where + ": got " + got + ", expected " + expected);
}

std::string list_of(const std::vector<std::string>& words) {
    std::string text;
    for (const std::string& word : words) text += (text.empty() ? "" : ", ") + word;
    return text;
}

/// A short, printable form of a value for messages.
std::string shown(const std::string& text) {
    std::string out = "'";
    for (char c : text.substr(0, 60)) out += static_cast<unsigned char>(c) < 32 || c == 127 ? '?' : c;
    return out + (text.size() > 60 ? "...'" : "'");
}
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

const std::string& one_of(const std::string& text, const std::vector<std::string>& words, const std::string& where) {
    if (std::find(words.begin(), words.end(), text) == words.end())
        refuse(where, shown(text), "one of " + list_of(words) + " (did you mean " + nearest_word(text, words) + "?)");
    return text;
}

std::optional<DepthSource> depth_source_of(const std::string& text, const std::string& where) {
    std::vector<std::string> words{"auto"};
    words.insert(words.end(), depth_source_words().begin(), depth_source_words().end());
    one_of(text, words, where);
    const auto at = std::find(words.begin(), words.end(), text) - words.begin();
    if (at == 0) return std::nullopt;
    return DepthSource(at - 1);
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

/// The sweep answers for one height field, at full resolution.
bool can_sweep(const Request& request) {
    return request.out == "mask" && request.from == Source::self && request.tolerance_px == 0;
}
/// The rasteriser takes any number of cameras, at full resolution.
bool can_raster(const Request& request) {
    return request.out != "mask" && request.tolerance_px == 0;
}
bool has_neighbors(const Request& request) {
    return request.out == "seam" || request.out == "condition";
}

void check_against(const Recipe& recipe, const Request& request, const std::string& where) {
    if (!request.camera.empty() && request.camera != "*") recipe.camera(request.camera);
    recipe.frame(request.frame);
    const std::string view = request.out == "mask" ? "recorded" : "shifted";
    if (!has_neighbors(request) && !request.view.empty() && request.view != view)
        refuse(where + ": view", shown(request.view), view + " for out=" + request.out);
    const std::string asked = "out=" + request.out + ", from=" + (request.from == Source::rig ? "rig" : "self") +
                              (request.tolerance_px > 0 ? " and a mesh tolerance" : "");
    if (request.method == "sweep" && !can_sweep(request))
        refuse(where + ": method", "'sweep' for " + asked,
               "out=mask, from=self and tolerance_px=0, or method=" +
                   std::string(can_raster(request) ? "raster" : "embree"));
    if (request.method == "raster" && !can_raster(request))
        refuse(where + ": method", "'raster' for " + asked, "out=holes, warp, seam or condition and tolerance_px=0");
    if (request.certify && chosen_method(request) != "sweep")
        refuse(where + ": certify", "'1' for " + asked, "out=mask, from=self, tolerance_px=0 and method=sweep");
    if (!has_neighbors(request)) return;
    if (request.from == Source::rig)
        refuse(where + ": from", "'rig' for out=" + request.out,
               "self: the own depth map says what is missing, the neighbours fill it");
    if (request.out != "condition") return;
    const std::string of_arm = request.arm == "splat"                                     ? "shifted"
                               : request.arm == "literal" || request.arm == "double_warp" ? "recorded"
                                                                                          : "";
    if (!of_arm.empty() && chosen_view(request) != of_arm)
        refuse(where + ": view", shown(chosen_view(request)), of_arm + " for arm=" + request.arm);
}

}  // namespace

double parse_number(const std::string& text, const std::string& where) {
    double value = 0;
    const bool plus = text.size() > 1 && text[0] == '+' && text[1] != '-';  // from_chars takes no plus
    const char* begin = text.data() + plus;
    const auto [end, error] = std::from_chars(begin, text.data() + text.size(), value);
    if (error != std::errc() || end != text.data() + text.size() || text.empty() || !std::isfinite(value))
        refuse(where, shown(text), "a finite number");
    return value;
}

std::string nearest_word(const std::string& word, const std::vector<std::string>& known) {
    std::string best;
    size_t best_distance = std::string::npos;
    for (const std::string& candidate : known) {
        std::vector<size_t> row(candidate.size() + 1);
        for (size_t j = 0; j < row.size(); ++j) row[j] = j;
        for (size_t i = 0; i < std::min<size_t>(word.size(), 64); ++i) {
            size_t diagonal = row[0];
            row[0] = i + 1;
            for (size_t j = 0; j < candidate.size(); ++j) {
                const size_t replaced = diagonal + (word[i] != candidate[j]);
                diagonal = row[j + 1];
                row[j + 1] = std::min({replaced, row[j] + 1, row[j + 1] + 1});
            }
        }
        if (row.back() < best_distance) {
            best_distance = row.back();
            best = candidate;
        }
    }
    return best;
}

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
    known.insert(known.end(), request_keys.begin(), request_keys.end());
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
    for (const std::string& key : request_keys)
        if (fields.has(key)) set_request_key(recipe.defaults, key, request_text(root[key], fields.at(key)), file);
    check_against(recipe, recipe.defaults, file);
    return recipe;
}

void set_request_key(Request& request, const std::string& key, const std::string& text, const std::string& where) {
    const std::string at = where + ": " + key;
    const auto number_from = [&](double lowest, double highest, const std::string& expected) {
        const double value = parse_number(text, at);
        if (!(value >= lowest && value <= highest)) refuse(at, shown(text), expected);
        return value;
    };
    const auto whole_from = [&](int lowest, int highest) {
        int value = 0;
        const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
        if (error != std::errc() || end != text.data() + text.size() || value < lowest || value > highest)
            refuse(at, shown(text), "a whole number from " + std::to_string(lowest) + " to " + std::to_string(highest));
        return value;
    };
    if (key == "camera") {
        request.camera = text;
    } else if (key == "frame") {
        int value = 0;
        const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
        if (error != std::errc() || end != text.data() + text.size() || text.empty() || value < 0)
            refuse(at, shown(text), "a whole number >= 0");
        request.frame = value;
    } else if (key == "shift") {
        std::vector<std::string> parts(1);
        for (char c : text)
            if (c == ',')
                parts.emplace_back();
            else
                parts.back() += c;
        if (parts.size() != 3) refuse(at, shown(text), "three numbers x,y,z in metres");
        for (size_t i = 0; i < 3; ++i) {
            const double value = parse_number(parts[i], at);
            if (std::fabs(value) > longest_shift_m) refuse(at, shown(text), "at most 1000000 m along each axis");
            request.shift.translation_m[int(i)] = value;
        }
    } else if (key == "yaw_deg") {
        request.shift.yaw_rad = number_from(-360, 360, "degrees from -360 to 360") * radians_per_degree;
    } else if (key == "out") {
        request.out = one_of(text, known_outs, at);
    } else if (key == "from") {
        request.from = one_of(text, {"self", "rig"}, at) == "rig" ? Source::rig : Source::self;
    } else if (key == "view") {
        request.view = one_of(text, {"recorded", "shifted"}, at);
    } else if (key == "method") {
        request.method = one_of(text, {"auto", "sweep", "raster", "embree"}, at);
    } else if (key == "edge") {
        request.edge = one_of(text, {"drop", "keep"}, at);
    } else if (key == "match") {
        request.match = one_of(text, {"none", "exposure", "color"}, at);
    } else if (key == "arm") {
        request.arm = one_of(text, {"virtual_shift", "double_warp", "literal", "splat"}, at);
    } else if (key == "stride") {
        request.stride = whole_from(1, 256);
    } else if (key == "noise_seed") {
        request.noise.seed = whole_from(0, 999999999);
    } else if (key == "depth_source") {
        request.depth_source = depth_source_of(text, at);
    } else if (key == "certify") {
        request.certify = one_of(text, {"0", "1"}, at) == "1";
    } else if (const auto number = std::find_if(std::begin(number_keys), std::end(number_keys),
                                                [&](const NumberKey& k) { return key == k.name; });
               number != std::end(number_keys)) {
        number->in(request) = number_from(number->lowest, number->highest, number->expected);
    } else {
        refuse(where + ": " + shown(key), "an unknown key",
               "one of " + list_of(request_keys) + " (did you mean " + nearest_word(key, request_keys) + "?)");
    }
}

Request resolve_request(const Recipe& recipe, const std::vector<std::pair<std::string, std::string>>& pairs) {
    Request request = recipe.defaults;
    const std::string where = recipe.file.string();
    std::set<std::string> seen;
    for (const auto& [key, text] : pairs) {
        if (!seen.insert(key).second) refuse(where + ": " + key, "the key twice", "it once");
        set_request_key(request, key, text, where);
        if (key == "out" && !seen.contains("view")) request.view.clear();  // the recipe's view was for its own out
    }
    check_against(recipe, request, where);
    return request;
}

std::string canonical_text(const Request& request) {
    const auto number = [](double value) {
        char text[32];
        const auto [end, error] = std::to_chars(text, text + sizeof text, value == 0 ? 0.0 : value);  // no -0
        return std::string(text, end);
    };
    const glm::dvec3 s = request.shift.translation_m;
    std::string text = "camera=" + (request.camera.empty() ? "*" : request.camera);
    text += "&frame=" + std::to_string(request.frame);
    text += "&shift=" + number(s.x) + "," + number(s.y) + "," + number(s.z);
    text += "&yaw_deg=" + number(request.shift.yaw_rad * degrees_per_radian);
    text += "&out=" + request.out;
    text += std::string("&from=") + (request.from == Source::rig ? "rig" : "self");
    if (!request.view.empty()) text += "&view=" + request.view;
    text += "&method=" + request.method + "&edge=" + request.edge + "&match=" + request.match;
    text += "&arm=" + request.arm + "&stride=" + std::to_string(request.stride);
    text += "&depth_source=" + (request.depth_source ? depth_source_words()[size_t(*request.depth_source)] : "auto");
    text += request.certify ? "&certify=1" : "&certify=0";
    text += "&noise_seed=" + std::to_string(request.noise.seed);
    Request copy = request;
    for (const NumberKey& key : number_keys) text += std::string("&") + key.name + "=" + number(key.in(copy));
    return text;
}

std::string chosen_method(const Request& request) {
    if (request.method != "auto") return request.method;
    return can_sweep(request) ? "sweep" : can_raster(request) ? "raster" : "embree";
}

std::string chosen_view(const Request& request) {
    if (!request.view.empty()) return request.view;
    return request.out == "mask" || request.out == "condition" ? "recorded" : "shifted";
}

std::vector<std::string> requested_cameras(const Recipe& recipe, const Request& request) {
    if (!request.camera.empty() && request.camera != "*") return {request.camera};
    std::vector<std::string> names;
    for (const CameraSpec& c : recipe.cameras) names.push_back(c.name);
    return names;
}

}  // namespace vshift
