// SPDX-License-Identifier: Apache-2.0
// Role: the names in image files: channels that are asked for, attributes that are kept.
#include <algorithm>
#include <limits>
#include <numeric>

#include "embree_core/image_formats.h"

namespace vshift::formats {
namespace {

size_t edit_distance(const std::string& a, const std::string& b) {
    std::vector<size_t> row(b.size() + 1);
    std::iota(row.begin(), row.end(), size_t(0));
    const auto lower = [](char c) { return c >= 'A' && c <= 'Z' ? char(c - 'A' + 'a') : c; };
    for (size_t i = 0; i < a.size(); ++i) {
        size_t diagonal = row[0];
        row[0] = i + 1;
        for (size_t j = 0; j < b.size(); ++j) {
            const size_t replaced = diagonal + (lower(a[i]) != lower(b[j]));
            diagonal = row[j + 1];
            row[j + 1] = std::min({replaced, row[j] + 1, row[j + 1] + 1});
        }
    }
    return row.back();
}

}  // namespace

std::string unknown_channel(const std::string& name, const std::vector<std::string>& names) {
    if (names.empty()) return "got " + name + ", expected a file with channels";
    std::string text = "got " + (name.empty() ? std::string("no name") : name) + ", expected one of ";
    constexpr size_t listed = 32;
    std::string nearest;
    size_t best = std::numeric_limits<size_t>::max();
    for (size_t i = 0; i < names.size(); ++i) {
        if (i < listed) text += (i ? ", " : "") + names[i];
        // The last part counts too: Z is near ViewLayer.Depth.Z.
        const std::string last = names[i].substr(names[i].rfind('.') + 1);
        const size_t distance = std::min(2 * edit_distance(name, names[i]), 2 * edit_distance(name, last) + 1);
        if (distance < best) best = distance, nearest = names[i];
    }
    if (names.size() > listed) text += " and " + std::to_string(names.size() - listed) + " more";
    return text + " (nearest: " + nearest + ")";
}

bool is_encoding_key(const std::string& key) {
    static const char* const keys[] = {"compression",
                                       "name",
                                       "type",
                                       "channels",
                                       "dataWindow",
                                       "displayWindow",
                                       "lineOrder",
                                       "pixelAspectRatio",
                                       "tiles",
                                       "screenWindowCenter",
                                       "screenWindowWidth",
                                       "version",
                                       "chunkCount",
                                       "view",
                                       "multiView",
                                       "preview",
                                       "worldtocamera",
                                       "worldtoscreen",
                                       "Compression"};
    if (key.rfind("oiio:", 0) == 0 || key.rfind("openexr:", 0) == 0 || key.rfind("png:", 0) == 0 ||
        key.rfind("jpeg:", 0) == 0 || key.rfind("CICP", 0) == 0)
        return true;
    return std::find(std::begin(keys), std::end(keys), key) != std::end(keys);
}

}  // namespace vshift::formats
