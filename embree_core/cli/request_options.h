// SPDX-License-Identifier: Apache-2.0
// Role: the request's keys as options of a verb; their texts are parsed by `resolve_request` alone.
#pragma once
#include <CLI/CLI.hpp>
#include <string>
#include <utility>
#include <vector>

namespace vshift::cli {

using RequestPairs = std::vector<std::pair<std::string, std::string>>;

/// `pairs` lives as long as the verb.
inline void add_request_key(CLI::App& verb, RequestPairs& pairs, const char* flags, const std::string& key,
                            const char* help) {
    verb.add_option_function<std::string>(
        flags, [&pairs, key](const std::string& text) { pairs.emplace_back(key, text); }, help);
}

/// Which view is asked for: camera, frame, shift, yaw; and whose geometry answers.
inline void add_view_keys(CLI::App& verb, RequestPairs& pairs, const char* from_help) {
    add_request_key(verb, pairs, "--camera", "camera", "one camera's name; * or none: all of them");
    add_request_key(verb, pairs, "--frame", "frame", "frame index");
    add_request_key(verb, pairs, "--shift", "shift", "x,y,z in ego metres (x forward, y left, z up)");
    add_request_key(verb, pairs, "--yaw_deg,--yaw-deg", "yaw_deg", "turn of the ego about its z axis, to the left");
    add_request_key(verb, pairs, "--from", "from", from_help);
    add_request_key(verb, pairs, "--tolerance_px,--tolerance-px", "tolerance_px",
                    "how far surfaces may move for fewer triangles, 0 to 4 px");
}

}  // namespace vshift::cli
