// SPDX-License-Identifier: Apache-2.0
// Role: image files in and out. Codecs see nothing but memory: bytes come from read_first and go to write_whole_file.
#include "embree_core/image_file.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstring>
#include <limits>
#include <new>
#include <numeric>

#include "embree_core/exr_codec.h"
#include "embree_core/image_formats.h"
#include "embree_core/pictures.h"
#include "embree_core/srgb.h"
#include "embree_core/whole_file.h"

namespace vshift {
namespace fs = std::filesystem;
using formats::Claim;
using formats::Decoded;
using formats::Kind;
using formats::Stored;
using formats::unknown_channel;

namespace {

constexpr size_t head_bytes = 65536;
/// An honest file is hardly larger than its samples: float64 NPY is the largest there is.
constexpr size_t max_file_bytes = 2 * max_decoded_bytes + (size_t(64) << 20);

std::string size_text(int64_t width, int64_t height) {
    return std::to_string(width) + "x" + std::to_string(height);
}

std::vector<std::string> plain_names(int64_t channels) {
    switch (channels) {
        case 1:
            return {"Y"};
        case 2:
            return {"Y", "A"};
        case 3:
            return {"R", "G", "B"};
        case 4:
            return {"R", "G", "B", "A"};
        default:
            break;
    }
    std::vector<std::string> names;
    for (int64_t i = 0; i < channels; ++i) names.push_back(std::to_string(i));
    return names;
}

/// Reads, checks and decodes. `wanted` (EXR): the channels needed, empty for all.
/// `inspect` sees the claim before anything is decoded.
template <class Inspect>
Decoded decode(const fs::path& file, const std::vector<std::string>& wanted, Inspect&& inspect) {
    const RegularFile source(file);
    if (source.size() > max_file_bytes)
        fail_file(
            ExitCode::over_limit, file, "size",
            "got " + std::to_string(source.size()) + " bytes, expected at most " + std::to_string(max_file_bytes));
    try {
        Decoded out;
        const auto checked = [&](const std::string& bytes, uint64_t file_size) {
            auto claim = formats::read_claim(file, bytes, file_size);
            if (!claim) return false;
            const bool one_plane = claim->kind == Kind::exr && !wanted.empty();
            formats::check_limits(file, claim->width, claim->height, one_plane ? 1 : claim->channels);
            out.claim = std::move(*claim);
            return true;
        };
        std::string bytes = source.read_first(head_bytes);
        const bool complete = bytes.size() < head_bytes;
        const bool early = checked(bytes, complete ? bytes.size() : source.size());
        if (early) inspect(out.claim);
        if (!complete) {
            bytes = source.read_first(max_file_bytes);
            if (!early) {
                if (!checked(bytes, bytes.size()))
                    fail_file(ExitCode::bad_input, file, "header", "got a cut one, expected a whole one");
                inspect(out.claim);
            }
        }
        formats::check_whole(file, bytes, out.claim);
        out.image.width = int(out.claim.width);
        out.image.height = int(out.claim.height);
        if (out.claim.kind == Kind::pfm || out.claim.kind == Kind::npy) {
            out.image.planes = out.claim.kind == Kind::pfm ? formats::decode_pfm(bytes, out.claim)
                                                           : formats::decode_npy(bytes, out.claim);
            out.image.names = plain_names(out.claim.channels);
            if (out.claim.stored == Stored::uint8) out.unit_top = 255;
            if (out.claim.stored == Stored::uint16) out.unit_top = 65535;
        } else if (out.claim.kind == Kind::exr) {
            formats::decode_exr(file, bytes, wanted, out);
        } else {
            pictures().decode(file, bytes, out);
        }
        return out;
    } catch (const std::bad_alloc&) {
        fail_file(ExitCode::over_limit, file, "memory", "got too little, expected enough to decode the image");
    }
}

void require_size(const fs::path& file, const Claim& claim, int width, int height) {
    if ((width > 0 && claim.width != width) || (height > 0 && claim.height != height))
        fail_file(ExitCode::bad_input, file, "size",
                  "got " + size_text(claim.width, claim.height) + ", expected " + size_text(width, height));
}

std::string ending_of(const fs::path& file) {
    std::string ending = file.extension().string();
    for (char& c : ending)
        if (c >= 'A' && c <= 'Z') c = char(c - 'A' + 'a');
    return ending;
}

const char* type_name(SampleType type) {
    switch (type) {
        case SampleType::float32:
            return "float32";
        case SampleType::float16:
            return "float16";
        case SampleType::uint16:
            return "uint16";
        case SampleType::uint8:
            return "uint8";
    }
    return "?";
}

/// Throws Error our_bug: the caller's own image does not hold together.
void require_consistent(const fs::path& file, const Channels& image) {
    bool sound =
        image.width > 0 && image.height > 0 && !image.names.empty() && image.names.size() == image.planes.size();
    for (const auto& plane : image.planes) sound = sound && plane.size() == size_t(image.width) * size_t(image.height);
    std::vector<std::string> names = image.names;
    std::sort(names.begin(), names.end());
    sound = sound && std::adjacent_find(names.begin(), names.end()) == names.end() &&
            std::find(names.begin(), names.end(), "") == names.end();
    if (!sound)
        fail_file(ExitCode::our_bug, file, "image",
                  "got " + size_text(image.width, image.height) + " with " + std::to_string(image.names.size()) +
                      " names and " + std::to_string(image.planes.size()) +
                      " planes, expected one full plane for each of its distinct names");
}

}  // namespace

const std::vector<float>& Channels::plane(const std::string& name) const {
    const auto found = std::find(names.begin(), names.end(), name);
    if (found == names.end())
        throw Error(ExitCode::bad_input,
                    (file.empty() ? "" : file + ": ") + "channel: " + unknown_channel(name, names));
    return planes[size_t(found - names.begin())];
}

bool Channels::has(const std::string& name) const {
    return std::find(names.begin(), names.end(), name) != names.end();
}

void Channels::add(const std::string& name, std::vector<float> plane) {
    names.push_back(name);
    planes.push_back(std::move(plane));
}

void Channels::add_color(const ColorImage& color) {
    for (int c = 0; c < 3; ++c) {
        std::vector<float> plane(color.size());
        for (size_t i = 0; i < plane.size(); ++i) plane[i] = color.data[i][c];
        add(std::string(1, "RGB"[c]), std::move(plane));
    }
}

ColorImage Channels::color() const {
    ColorImage out(width, height);
    const auto &r = plane("R"), &g = plane("G"), &b = plane("B");
    for (size_t i = 0; i < out.size(); ++i) out.data[i] = {r[i], g[i], b[i]};
    return out;
}

Channels read_image(const fs::path& file) {
    Decoded decoded = decode(file, {}, [](const Claim&) {});
    if (decoded.unit_top != 1)
        for (auto& plane : decoded.image.planes)
            for (float& value : plane) value = float(double(value) / decoded.unit_top);
    decoded.image.file = file.string();
    return std::move(decoded.image);
}

DepthMap read_depth(const fs::path& file, const std::string& channel, double scale_m, int width, int height,
                    SampleType* stored) {
    if (!(scale_m > 0) || !std::isfinite(scale_m))
        fail_file(ExitCode::bad_input, file, "depth scale", "got no positive number, expected metres per stored unit");
    Decoded decoded = decode(file, {channel}, [&](const Claim& claim) {
        require_size(file, claim, width, height);
        if (claim.kind == Kind::jpeg)
            fail_file(ExitCode::bad_input, file, "format", "got JPEG, expected EXR, 16-bit PNG, PFM or NPY");
        if (claim.kind != Kind::exr && claim.channels != 1)
            fail_file(ExitCode::bad_input, file, "channels",
                      "got " + std::to_string(claim.channels) + ", expected 1 for depth");
        if (claim.stored == Stored::uint8)
            fail_file(ExitCode::bad_input, file, "sample type",
                      "got 8-bit integers, expected 16-bit integers or floats for depth");
        const auto type = claim.exr_types.find(channel);
        if (type != claim.exr_types.end() && type->second == 0)
            fail_file(ExitCode::bad_input, file, "sample type",
                      "got 32-bit integers in " + channel + ", expected half or float for depth");
        if (stored)
            *stored = claim.stored == Stored::uint16                               ? SampleType::uint16
                      : type != claim.exr_types.end() && type->second == 1 /*half*/ ? SampleType::float16
                                                                                   : SampleType::float32;
    });
    // A decoder may add a channel of its own (a PNG's transparent value becomes alpha).
    if (decoded.image.planes.size() != 1)
        fail_file(ExitCode::bad_input, file, "channels",
                  "got " + std::to_string(decoded.image.planes.size()) + ", expected 1 for depth");
    DepthMap depth;
    depth.width = decoded.image.width;
    depth.height = decoded.image.height;
    depth.data = std::move(decoded.image.planes[0]);
    if (scale_m != 1) {
        constexpr double top = std::numeric_limits<float>::max();
        for (float& value : depth.data) {
            const double metres = double(value) * scale_m;
            value =
                std::abs(metres) > top ? std::copysign(std::numeric_limits<float>::infinity(), value) : float(metres);
        }
    }
    return depth;
}

ColorImage read_color(const fs::path& file, int width, int height) {
    const Decoded decoded =
        decode(file, {"R", "G", "B"}, [&](const Claim& claim) { require_size(file, claim, width, height); });
    const Channels& image = decoded.image;
    const bool integers = decoded.unit_top != 1;
    const bool gray = integers && !image.has("R") && image.has("Y");
    const std::vector<float>* planes[3];
    for (int c = 0; c < 3; ++c) {
        const std::string name = gray ? "Y" : std::string(1, "RGB"[c]);
        if (!image.has(name)) fail_file(ExitCode::bad_input, file, "channel", unknown_channel(name, image.names));
        planes[c] = &image.plane(name);
    }
    std::vector<float> linear;  // by stored integer
    if (integers) {
        linear.resize(size_t(decoded.unit_top) + 1);
        for (size_t i = 0; i < linear.size(); ++i) linear[i] = float(linear_from_srgb(double(i) / decoded.unit_top));
    }
    ColorImage color(image.width, image.height);
    for (size_t i = 0; i < color.data.size(); ++i)
        for (int c = 0; c < 3; ++c) {
            const float stored = (*planes[c])[i];
            color.data[i][c] = integers ? linear[size_t(stored)] : stored;
        }
    return color;
}

void write_image(const fs::path& file, const Channels& image, const std::vector<SampleType>& types) {
    require_consistent(file, image);
    formats::check_limits(file, image.width, image.height, int64_t(image.names.size()));
    std::vector<SampleType> each = types;
    if (types.size() == 1) each.assign(image.names.size(), types[0]);
    if (each.size() != image.names.size())
        fail_file(ExitCode::our_bug, file, "sample types",
                  "got " + std::to_string(types.size()) + ", expected 1 or one per channel");
    const std::string ending = ending_of(file);
    const auto require_types = [&](std::initializer_list<SampleType> allowed, bool same) {
        for (const SampleType type : each)
            if (std::find(allowed.begin(), allowed.end(), type) == allowed.end() || (same && type != each[0])) {
                std::string text = std::string("got ") + type_name(type) + ", expected ";
                for (const SampleType other : allowed)
                    text += (other == *allowed.begin() ? "" : " or ") + std::string(type_name(other));
                fail_file(ExitCode::bad_input, file, "sample type",
                          text + (same ? " for every channel of a " : " in a ") + ending + " file");
            }
    };
    const auto require_channels = [&](bool allowed, const char* expected) {
        if (!allowed)
            fail_file(ExitCode::bad_input, file, "channels",
                      "got " + std::to_string(each.size()) + ", expected " + expected);
    };
    std::string bytes;
    if (ending == ".exr") {
        require_types({SampleType::float32, SampleType::float16}, false);
        bytes = formats::encode_exr(file, image, each);
    } else if (ending == ".png") {
        require_types({SampleType::uint16, SampleType::uint8}, true);
        require_channels(each.size() <= 4, "1 to 4 in a .png file");
        bytes = pictures().encode_png(file, image, each[0]);
    } else if (ending == ".pfm") {
        require_types({SampleType::float32}, true);
        require_channels(each.size() == 1 || each.size() == 3, "1 or 3 in a .pfm file");
        bytes = formats::encode_pfm(image);
    } else if (ending == ".npy") {
        require_types({SampleType::float32, SampleType::uint16, SampleType::uint8}, true);
        bytes = formats::encode_npy(image, each[0]);
    } else {
        fail_file(ExitCode::bad_input, file, "ending",
                  "got " + (ending.empty() ? std::string("none") : ending) + ", expected .exr, .png, .pfm or .npy");
    }
    write_whole_file(file, bytes);
}

}  // namespace vshift
