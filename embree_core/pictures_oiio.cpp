// SPDX-License-Identifier: Apache-2.0
// The only file of the core that includes OpenImageIO, which sees nothing but memory.
#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/imagebuf.h>
#include <OpenImageIO/imagebufalgo.h>
#include <OpenImageIO/imageio.h>

#include <cmath>
#include <cstring>

#include "embree_core/pictures.h"
#include "embree_core/whole_file.h"

namespace vshift {
namespace fs = std::filesystem;
namespace {

std::string first_line(std::string text) {
    while (!text.empty() && (text.back() == '\n' || text.back() == '\r')) text.pop_back();
    return text.substr(0, std::min(text.find('\n'), size_t(200)));
}

void decode(const fs::path& file, const std::string& bytes, formats::Decoded& out) {
    auto in = OIIO::ImageInput::create(out.claim.kind == formats::Kind::png ? "png" : "jpg");
    if (!in)
        fail_file(ExitCode::io_failed, file, "format",
                  "got " + first_line(OIIO::geterror()) + ", expected a reader for it");
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
                  "got " + std::to_string(spec.width) + "x" + std::to_string(spec.height) + " from the decoder, expected " +
                      std::to_string(out.claim.width) + "x" + std::to_string(out.claim.height));
    formats::check_limits(file, spec.width, spec.height, spec.nchannels);
    const size_t pixels = size_t(spec.width) * size_t(spec.height), step = size_t(spec.nchannels);
    out.image.planes.assign(step, {});
    const auto read = [&](auto sample, OIIO::TypeDesc type) {
        std::vector<decltype(sample)> interleaved(pixels * step);
        if (!in->read_image(0, 0, 0, spec.nchannels, type, interleaved.data()) || in->has_error())
            refuse("pixels");  // it may return true with an error pending
        for (size_t c = 0; c < step; ++c) {
            out.image.planes[c].resize(pixels);
            for (size_t i = 0; i < pixels; ++i) out.image.planes[c][i] = float(interleaved[i * step + c]);
        }
    };
    if (spec.format == OIIO::TypeDesc::UINT16) {
        read(uint16_t{}, OIIO::TypeDesc(OIIO::TypeDesc::UINT16));
        out.unit_top = 65535;
    } else {
        read(uint8_t{}, OIIO::TypeDesc(OIIO::TypeDesc::UINT8));
        out.unit_top = 255;
    }
    out.image.names = spec.channelnames;
    for (const auto& attribute : spec.extra_attribs) {
        const std::string key = attribute.name().string();
        if (attribute.type() == OIIO::TypeString && !formats::is_encoding_key(key))
            out.image.metadata[key] = attribute.get_string();
    }
    in->close();
    in->geterror();  // nothing may stay pending: it would be printed
}

/// Interleaved samples in their stored type.
std::vector<unsigned char> packed(const Channels& image, SampleType type) {
    const size_t channels = image.planes.size(), size = type == SampleType::uint8 ? 1 : 2;
    std::vector<unsigned char> out(image.planes[0].size() * channels * size);
    for (size_t c = 0; c < channels; ++c)
        for (size_t i = 0; i < image.planes[c].size(); ++i) {
            unsigned char* to = out.data() + (i * channels + c) * size;
            if (size == 1) {
                *to = uint8_t(formats::quantize(image.planes[c][i], 255));
            } else {
                const auto value = uint16_t(formats::quantize(image.planes[c][i], 65535));
                std::memcpy(to, &value, 2);
            }
        }
    return out;
}

std::string encode_png(const fs::path& file, const Channels& image, SampleType type) {
    auto out = OIIO::ImageOutput::create("image.png");
    if (!out)
        fail_file(ExitCode::io_failed, file, "format",
                  "got " + first_line(OIIO::geterror()) + ", expected a writer for it");
    OIIO::ImageSpec spec(image.width, image.height, int(image.planes.size()),
                         type == SampleType::uint8 ? OIIO::TypeDesc::UINT8 : OIIO::TypeDesc::UINT16);
    for (const auto& [key, value] : image.metadata)
        if (!value.empty() && !formats::is_encoding_key(key)) spec.attribute(key, value);
    spec.attribute("oiio:UnassociatedAlpha", 1);  // samples go out as they are
    const auto refuse = [&] {
        fail_file(ExitCode::io_failed, file, "encoding", "got " + first_line(out->geterror()) + ", expected a whole file");
    };
    OIIO::Filesystem::IOVecOutput memory;
    const std::vector<unsigned char> samples = packed(image, type);
    if (!out->set_ioproxy(&memory) || !out->open("image.png", spec) || out->has_error()) refuse();
    if (!out->write_image(OIIO::TypeUnknown, samples.data()) || out->has_error()) refuse();
    if (!out->close() || out->has_error()) refuse();
    const std::vector<unsigned char>& buffer = memory.buffer();
    return std::string(buffer.begin(), buffer.end());
}

ColorImage pushpull(const HoledView& view) {
    const int width = view.color.width, height = view.color.height;
    std::vector<float> pixels(view.color.size() * 4);
    for (size_t i = 0; i < view.color.size(); ++i)
        if (!view.hole.data[i]) {  // square roots, as in fill_background; alpha says what is known
            for (size_t c = 0; c < 3; ++c) pixels[4 * i + c] = std::sqrt(std::max(view.color.data[i][int(c)], 0.0f));
            pixels[4 * i + 3] = 1;
        }
    OIIO::ImageSpec spec(width, height, 4, OIIO::TypeDesc::FLOAT);
    spec.channelnames = {"R", "G", "B", "A"};
    spec.alpha_channel = 3;
    const OIIO::ImageBuf holed(spec, pixels.data());
    OIIO::ImageBuf filled;
    // One thread: the order of its sums is then the same everywhere.
    if (!OIIO::ImageBufAlgo::fillholes_pushpull(filled, holed, {}, 1) ||
        !filled.get_pixels(OIIO::ROI(0, width, 0, height, 0, 1, 0, 4), OIIO::TypeDesc::FLOAT, pixels.data()))
        throw Error(ExitCode::our_bug, "fill: pushpull: got " + filled.geterror() + ", expected filled pixels");
    ColorImage out = view.color;
    for (size_t i = 0; i < out.size(); ++i)
        if (view.hole.data[i])
            for (size_t c = 0; c < 3; ++c) {
                const float root = pixels[4 * i + c];
                out.data[i][int(c)] = std::isfinite(root) ? root * root : 0;
            }
    return out;
}

}  // namespace

const Pictures& pictures_by_oiio() {
    static const Pictures all{decode, encode_png, pushpull};
    return all;
}

}  // namespace vshift
