// SPDX-License-Identifier: Apache-2.0
#include "embree_core/request.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <limits>
#include <set>

#include "embree_core/recipe.h"
#include "embree_core/words.h"

namespace vshift {
namespace {

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

const std::vector<std::string> all_keys = [] {
    std::vector<std::string> keys = {"camera", "frame",  "shift",      "yaw_deg",      "out",
                                     "from",   "view",   "method",     "edge",         "match",
                                     "arm",    "stride", "noise_seed", "depth_source", "certify"};
    for (const NumberKey& key : number_keys) keys.push_back(key.name);
    return keys;
}();

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

}  // namespace

void check_request(const Recipe& recipe, const Request& request, const std::string& where) {
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

const std::vector<std::string>& request_keys() {
    return all_keys;
}

std::optional<DepthSource> depth_source_of(const std::string& text, const std::string& where) {
    std::vector<std::string> words{"auto"};
    words.insert(words.end(), depth_source_words().begin(), depth_source_words().end());
    one_of(text, words, where);
    const auto at = std::find(words.begin(), words.end(), text) - words.begin();
    if (at == 0) return std::nullopt;
    return DepthSource(at - 1);
}

void set_request_key(Request& request, const std::string& key, const std::string& text, const std::string& where) {
    const std::string at = where + ": " + key;
    const auto number_from = [&](double lowest, double highest, const std::string& expected) {
        const double value = parse_number(text, at);
        if (!(value >= lowest && value <= highest)) refuse(at, shown(text), expected);
        return value;
    };
    const auto whole_from = [&](int lowest, int highest) {
        return parse_whole(text, lowest, highest, at,
                           "a whole number from " + std::to_string(lowest) + " to " + std::to_string(highest));
    };
    if (key == "camera") {
        request.camera = text;
    } else if (key == "frame") {
        request.frame = parse_whole(text, 0, std::numeric_limits<int>::max(), at, "a whole number >= 0");
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
               "one of " + list_of(all_keys) + " (did you mean " + nearest_word(key, all_keys) + "?)");
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
    check_request(recipe, request, where);
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

}  // namespace vshift
