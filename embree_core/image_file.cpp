// SPDX-License-Identifier: Apache-2.0
// Role: image files in and out. The only file of the core that includes OpenImageIO, which sees
// nothing but memory: bytes come from read_first and go to write_whole_file.
#include "embree_core/image_file.h"

#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/imageio.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstring>
#include <limits>
#include <new>
#include <numeric>

#include "embree_core/image_formats.h"
#include "embree_core/srgb.h"
#include "embree_core/whole_file.h"

namespace vshift {
namespace fs = std::filesystem;
using formats::Claim;
using formats::Kind;
using formats::Stored;

namespace {

/// EXR: without a date OIIO writes the clock's, and no two files would be the same. OIIO 3.1 drops empty
/// strings with a complaint on stderr.
constexpr const char* no_date = " ";
constexpr size_t head_bytes = 65536;
/// An honest file is hardly larger than its samples: float64 NPY is the largest there is.
constexpr size_t max_file_bytes = 2 * max_decoded_bytes + (size_t(64) << 20);

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

/// `got Depth, expected one of R, G, B, Z (nearest: Z)`.
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

std::string size_text(int64_t width, int64_t height) {
    return std::to_string(width) + "x" + std::to_string(height);
}

/// Samples as stored: a sample divided by `unit_top` is the 0..1 value (1 for float files).
struct Decoded {
    Claim claim;
    Channels image;
    double unit_top = 1;
};

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

/// Attributes that describe the encoding, not the picture.
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

std::string first_line(std::string text) {
    while (!text.empty() && (text.back() == '\n' || text.back() == '\r')) text.pop_back();
    return text.substr(0, std::min(text.find('\n'), size_t(200)));
}

void decode_oiio(const fs::path& file, const std::string& bytes, const std::vector<std::string>& wanted, Decoded& out) {
    const char* format = out.claim.kind == Kind::exr ? "exr" : out.claim.kind == Kind::png ? "png" : "jpg";
    auto in = OIIO::ImageInput::create(format);
    if (!in) {
        fail_file(ExitCode::io_failed, file, "format",
                  "got " + first_line(OIIO::geterror()) + ", expected a reader for it");
    }
    const auto refuse = [&](const char* field) {
        std::string reason = first_line(in->geterror());
        if (reason.empty()) reason = "no reason given";
        fail_file(ExitCode::bad_input, file, field, "got " + reason + ", expected a whole file");
    };
    OIIO::Filesystem::IOMemReader memory(bytes.data(), bytes.size());
    OIIO::ImageSpec config, spec;
    config.attribute("oiio:UnassociatedAlpha", 1);  // colour as stored, not times alpha
    if (!in->set_ioproxy(&memory) || !in->open(file.filename().string(), spec, config)) refuse("header");
    if (in->has_error()) refuse("header");
    if (spec.width != out.claim.width || spec.height != out.claim.height || spec.depth > 1)
        fail_file(ExitCode::bad_input, file, "size",
                  "got " + size_text(spec.width, spec.height) + " from the decoder, expected " +
                      size_text(out.claim.width, out.claim.height));

    // Decode only the span of channels that holds the wanted ones.
    int begin = 0, end = spec.nchannels;
    const std::vector<std::string>& names = spec.channelnames;
    if (out.claim.kind == Kind::exr && !wanted.empty()) {
        begin = spec.nchannels, end = 0;
        for (const std::string& name : wanted) {
            const auto found = std::find(names.begin(), names.end(), name);
            if (found == names.end()) fail_file(ExitCode::bad_input, file, "channel", unknown_channel(name, names));
            begin = std::min(begin, int(found - names.begin()));
            end = std::max(end, int(found - names.begin()) + 1);
        }
    }
    formats::check_limits(file, spec.width, spec.height, end - begin);
    const size_t pixels = size_t(spec.width) * size_t(spec.height), step = size_t(end - begin);
    out.image.planes.assign(step, {});
    const auto read = [&](auto sample, OIIO::TypeDesc type) {
        std::vector<decltype(sample)> interleaved(pixels * step);
        if (!in->read_image(0, 0, begin, end, type, interleaved.data()) || in->has_error())
            refuse("pixels");  // it may return true with an error pending
        for (size_t c = 0; c < step; ++c) {
            out.image.planes[c].resize(pixels);
            for (size_t i = 0; i < pixels; ++i) out.image.planes[c][i] = float(interleaved[i * step + c]);
        }
    };
    if (out.claim.kind == Kind::exr) {
        read(float{}, OIIO::TypeFloat);
    } else if (spec.format == OIIO::TypeDesc::UINT16) {
        read(uint16_t{}, OIIO::TypeDesc(OIIO::TypeDesc::UINT16));
        out.unit_top = 65535;
    } else {
        read(uint8_t{}, OIIO::TypeDesc(OIIO::TypeDesc::UINT8));
        out.unit_top = 255;
    }
    out.image.names.assign(names.begin() + begin, names.begin() + end);
    for (const auto& attribute : spec.extra_attribs) {
        const std::string key = attribute.name().string();
        if (attribute.type() != OIIO::TypeString || is_encoding_key(key)) continue;
        const std::string value = attribute.get_string();
        if (key != "DateTime" || value != no_date) out.image.metadata[key] = value;
    }
    in->close();
    in->geterror();  // nothing may stay pending: it would be printed
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
        } else {
            decode_oiio(file, bytes, wanted, out);
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

OIIO::TypeDesc oiio_type(SampleType type) {
    switch (type) {
        case SampleType::float16:
            return OIIO::TypeDesc(OIIO::TypeDesc::HALF);
        case SampleType::uint16:
            return OIIO::TypeDesc(OIIO::TypeDesc::UINT16);
        case SampleType::uint8:
            return OIIO::TypeDesc(OIIO::TypeDesc::UINT8);
        default:
            return OIIO::TypeDesc(OIIO::TypeDesc::FLOAT);
    }
}

/// Interleaved samples in their stored types.
std::vector<unsigned char> pack(const Channels& image, const std::vector<SampleType>& types) {
    const size_t pixels = size_t(image.width) * size_t(image.height);
    size_t step = 0;
    for (const SampleType type : types) step += oiio_type(type).size();
    std::vector<unsigned char> packed(pixels * step);
    size_t offset = 0;
    for (size_t c = 0; c < types.size(); ++c) {
        const size_t size = oiio_type(types[c]).size();
        std::vector<unsigned char> plane(pixels * size);
        const float* from = image.planes[c].data();
        if (types[c] == SampleType::float16) {
            for (size_t at = 0; at < pixels; at += size_t(1) << 30)
                OIIO::convert_pixel_values(OIIO::TypeFloat, from + at, oiio_type(types[c]), plane.data() + at * size,
                                           int(std::min(pixels - at, size_t(1) << 30)));
        } else if (types[c] == SampleType::float32) {
            std::memcpy(plane.data(), from, pixels * size);
        } else {
            for (size_t i = 0; i < pixels; ++i) {
                if (types[c] == SampleType::uint8) {
                    plane[i] = uint8_t(formats::quantize(from[i], 255));
                } else {
                    const uint16_t value = uint16_t(formats::quantize(from[i], 65535));
                    std::memcpy(plane.data() + 2 * i, &value, 2);
                }
            }
        }
        for (size_t i = 0; i < pixels; ++i)
            std::memcpy(packed.data() + i * step + offset, plane.data() + i * size, size);
        offset += size;
    }
    return packed;
}

std::string encode_oiio(const fs::path& file, const Channels& image, const std::vector<SampleType>& types, bool exr) {
    const std::string name = exr ? "image.exr" : "image.png";
    auto out = OIIO::ImageOutput::create(name);
    if (!out)
        fail_file(ExitCode::io_failed, file, "format",
                  "got " + first_line(OIIO::geterror()) + ", expected a writer for it");
    OIIO::ImageSpec spec(image.width, image.height, int(types.size()), oiio_type(types[0]));
    for (size_t c = 0; c < types.size(); ++c) {
        if (exr) spec.channelformats.push_back(oiio_type(types[c]));
        if (types[c] == SampleType::float32) spec.format = oiio_type(types[c]);
    }
    if (std::all_of(types.begin(), types.end(), [&](SampleType t) { return t == types[0]; }))
        spec.channelformats.clear();
    if (exr) {
        spec.channelnames = image.names;
        spec.alpha_channel = spec.z_channel = -1;
        for (size_t c = 0; c < image.names.size(); ++c) {
            if (image.names[c] == "A") spec.alpha_channel = int(c);
            if (image.names[c] == "Z") spec.z_channel = int(c);
        }
    }
    for (const auto& [key, value] : image.metadata)
        if (!value.empty() && !is_encoding_key(key)) spec.attribute(key, value);
    if (exr) {
        spec.attribute("compression", "zip");
        if (!spec.find_attribute("DateTime")) spec.attribute("DateTime", no_date);
    }
    spec.attribute("oiio:UnassociatedAlpha", 1);  // samples go out as they are
    const auto refuse = [&] {
        fail_file(ExitCode::io_failed, file, "encoding",
                  "got " + first_line(out->geterror()) + ", expected a whole file");
    };
    OIIO::Filesystem::IOVecOutput memory;
    const std::vector<unsigned char> packed = pack(image, types);
    if (!out->set_ioproxy(&memory) || !out->open(name, spec) || out->has_error()) refuse();
    if (!out->write_image(OIIO::TypeUnknown, packed.data()) || out->has_error()) refuse();
    if (!out->close() || out->has_error()) refuse();
    const std::vector<unsigned char>& buffer = memory.buffer();
    return std::string(buffer.begin(), buffer.end());
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
        bytes = encode_oiio(file, image, each, true);
    } else if (ending == ".png") {
        require_types({SampleType::uint16, SampleType::uint8}, true);
        require_channels(each.size() <= 4, "1 to 4 in a .png file");
        bytes = encode_oiio(file, image, each, false);
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
