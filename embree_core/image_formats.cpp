// SPDX-License-Identifier: Apache-2.0
// Role: headers of EXR, PNG, JPEG, PFM and NPY, read without trust.
// Contract: no allocation is larger than the bytes at hand until check_limits has passed.
#include "embree_core/image_formats.h"

#include <algorithm>
#include <charconv>

#include <zlib.h>

#include "embree_core/whole_file.h"

namespace vshift::formats {
namespace fs = std::filesystem;
namespace {

constexpr size_t max_npy_header = 65536;
constexpr size_t max_exr_channels = 1024;

/// The header goes on past the bytes at hand.
struct NeedMore {};

/// Reads forward through bytes and never past them.
struct Cursor {
    std::string_view bytes;
    size_t at = 0;

    std::string_view take(size_t count) {
        if (count > bytes.size() - at) throw NeedMore{};
        const std::string_view part = bytes.substr(at, count);
        at += count;
        return part;
    }
    uint32_t number(int count, bool big) {
        const std::string_view part = take(size_t(count));
        uint32_t value = 0;
        for (int i = 0; i < count; ++i)
            value = value << 8 | static_cast<unsigned char>(part[size_t(big ? i : count - 1 - i)]);
        return value;
    }
    uint32_t u8() { return number(1, true); }
    uint32_t be16() { return number(2, true); }
    uint32_t be32() { return number(4, true); }
    int32_t le32() { return int32_t(number(4, false)); }
    char peek() const {
        if (at >= bytes.size()) throw NeedMore{};
        return bytes[at];
    }
    /// Text up to a zero byte, of at most `limit` bytes; false in `ok` when it is longer.
    std::string text(size_t limit, bool& ok) {
        std::string value;
        for (;;) {
            const char c = take(1)[0];
            if (c == 0) break;
            if (value.size() >= limit) {
                ok = false;
                break;
            }
            value += c;
        }
        return value;
    }
};

bool blank(char c) {
    return c == ' ' || c == '\t' || c == '\n' || c == '\r';
}

[[noreturn]] void bad(const fs::path& file, const std::string& field, const std::string& text) {
    fail_file(ExitCode::bad_input, file, field, text);
}

int64_t exr_lines_per_chunk(int compression) {
    switch (compression) {
        case 0:
        case 1:
        case 2:
            return 1;  // none, RLE, ZIPS
        case 3:
        case 5:
            return 16;  // ZIP, PXR24
        case 4:
        case 6:
        case 7:
        case 8:
            return 32;  // PIZ, B44, B44A, DWAA
        default:
            return 4096;  // DWAB 256; later ones: no claim is made
    }
}

struct Box {
    int64_t x0 = 0, y0 = 0, x1 = -1, y1 = -1;
    bool operator==(const Box&) const = default;
    std::string text() const {
        return "(" + std::to_string(x0) + "," + std::to_string(y0) + ")-(" + std::to_string(x1) + "," +
               std::to_string(y1) + ")";
    }
};

Box exr_box(Cursor value) {
    Box box;
    box.x0 = value.le32(), box.y0 = value.le32();
    box.x1 = value.le32(), box.y1 = value.le32();
    return box;
}

void exr_channels(const fs::path& file, Cursor value, Claim& claim) {
    while (value.peek() != 0) {
        bool ok = true;
        const std::string name = value.text(255, ok);
        const int type = value.le32();
        value.take(4);
        const int xs = value.le32(), ys = value.le32();
        if (!ok || type < 0 || type > 2) bad(file, "channels", "got a broken list, expected EXR channels");
        if (xs != 1 || ys != 1) bad(file, "channels", "got subsampled " + name + ", expected full-size channels");
        if (!claim.exr_types.emplace(name, type).second)
            bad(file, "channels", "got " + name + " twice, expected it once");
        if (claim.exr_types.size() > max_exr_channels)
            bad(file, "channels", "got more than " + std::to_string(max_exr_channels) + ", expected fewer");
    }
}

Claim claim_exr(const fs::path& file, Cursor in, uint64_t file_size) {
    Claim claim;
    claim.kind = Kind::exr;
    in.take(4);
    const uint32_t version = in.number(4, false);
    if ((version & 0xff) != 2) bad(file, "EXR version", "got " + std::to_string(version & 0xff) + ", expected 2");
    if (version & 0x800) bad(file, "EXR kind", "got deep samples, expected flat pixels");
    if (version & 0x1000)
        bad(file, "EXR parts", "got a multi-part file, expected one part (oiiotool --subimage takes one out)");
    Box data, display;
    bool has_channels = false, has_data = false, has_display = false;
    int compression = -1;
    int64_t tile_width = 0, tile_height = 0;
    for (;;) {
        bool ok = true;
        const std::string name = in.text(255, ok);
        if (ok && name.empty()) break;
        const std::string type = ok ? in.text(255, ok) : "";
        if (!ok) bad(file, "EXR header", "got an overlong name, expected at most 255 bytes");
        const int32_t size = in.le32();
        if (size < 0 || uint64_t(size) > file_size)
            bad(file, "EXR header",
                "got " + std::to_string(size) + " bytes for " + name + ", expected what the file holds");
        const Cursor value{in.take(size_t(size))};
        try {
            if (name == "channels" && type == "chlist")
                exr_channels(file, value, claim), has_channels = true;
            else if (name == "dataWindow" && type == "box2i")
                data = exr_box(value), has_data = true;
            else if (name == "displayWindow" && type == "box2i")
                display = exr_box(value), has_display = true;
            else if (name == "compression")
                compression = int(Cursor(value).u8());
            else if (name == "tiles") {
                Cursor tiles = value;
                tile_width = tiles.number(4, false), tile_height = tiles.number(4, false);
            } else if (type == "preview") {
                Cursor preview = value;
                const uint64_t w = preview.number(4, false), h = preview.number(4, false);
                if (w > 65536 || h > 65536 || 8 + 4 * w * h != uint64_t(size))
                    bad(file, name, "got a preview of another size than its bytes, expected the same");
            }
        } catch (const NeedMore&) {
            bad(file, "EXR header", "got " + std::to_string(size) + " bytes for " + name + ", expected more");
        }
    }
    if (!has_channels || !has_data || !has_display || compression < 0)
        bad(file, "EXR header", "got no channels, dataWindow, displayWindow or compression, expected all");
    claim.width = data.x1 - data.x0 + 1;
    claim.height = data.y1 - data.y0 + 1;
    claim.channels = int64_t(claim.exr_types.size());
    if (claim.width <= 0 || claim.height <= 0 || claim.channels == 0)
        bad(file, "size",
            "got " + data.text() + " and " + std::to_string(claim.channels) + " channels, expected pixels");
    if (claim.width > max_image_side || claim.height > max_image_side) return claim;  // refused later
    if (!(data == display))
        bad(file, "data window", "got " + data.text() + ", expected the display window " + display.text());
    int64_t chunks;
    if (version & 0x200) {
        if (tile_width <= 0 || tile_height <= 0) bad(file, "tiles", "got an empty tile, expected pixels");
        check_limits(file, std::max(tile_width, claim.width), std::max(tile_height, claim.height),
                     claim.channels);  // a tile is decoded whole
        chunks = ((claim.width + tile_width - 1) / tile_width) * ((claim.height + tile_height - 1) / tile_height);
    } else {
        const int64_t lines = exr_lines_per_chunk(compression);
        chunks = (claim.height + lines - 1) / lines;
    }
    // Each chunk has an offset of 8 bytes and, itself, at least a line number and a length.
    if (in.at + 16 * uint64_t(chunks) > file_size)
        bad(file, "EXR chunks",
            "got " + std::to_string(file_size) + " bytes, expected at least " +
                std::to_string(in.at + 16 * uint64_t(chunks)));
    return claim;
}

Claim claim_png(const fs::path& file, Cursor in) {
    Claim claim;
    claim.kind = Kind::png;
    in.take(8);
    if (in.be32() != 13 || in.take(4) != "IHDR") bad(file, "PNG header", "got another chunk first, expected IHDR");
    claim.width = in.be32();
    claim.height = in.be32();
    const uint32_t bits = in.u8(), color = in.u8();
    claim.stored = bits == 16 ? Stored::uint16 : Stored::uint8;
    claim.channels = color == 0 ? 1 : color == 2 || color == 3 ? 3 : color == 4 ? 2 : 4;
    if (claim.width == 0 || claim.height == 0) bad(file, "size", "got no pixels, expected some");
    return claim;
}

Claim claim_jpeg(const fs::path& file, Cursor in) {
    Claim claim;
    claim.kind = Kind::jpeg;
    claim.stored = Stored::uint8;
    in.take(2);
    for (;;) {
        if (in.u8() != 0xff) bad(file, "JPEG header", "got no marker, expected one");
        uint32_t marker = in.u8();
        while (marker == 0xff) marker = in.u8();
        if (marker == 0x01 || (marker >= 0xd0 && marker <= 0xd7)) continue;
        if (marker == 0xd9 || marker == 0xda)
            bad(file, "JPEG header", "got pixels or the end, expected the frame's size first");
        const uint32_t length = in.be16();
        if (length < 2) bad(file, "JPEG header", "got an empty segment, expected at least 2 bytes");
        Cursor segment{in.take(length - 2)};
        if (marker < 0xc0 || marker > 0xcf || marker == 0xc4 || marker == 0xc8 || marker == 0xcc) continue;
        if (length < 8) bad(file, "JPEG header", "got a short frame header, expected 8 bytes or more");
        segment.u8();
        claim.height = segment.be16();
        claim.width = segment.be16();
        claim.channels = segment.u8();
        if (claim.width == 0 || claim.height == 0 || claim.channels == 0)
            bad(file, "size", "got no pixels, expected some");
        return claim;
    }
}

/// One word between blanks, of at most 32 bytes; the blank after it is not taken.
std::string pfm_word(const fs::path& file, Cursor& in) {
    while (blank(in.peek())) in.take(1);
    std::string word;
    while (!blank(in.peek())) {
        word += in.take(1);
        if (word.size() > 32) bad(file, "PFM header", "got an overlong word, expected a number");
    }
    return word;
}

template <class T>
T pfm_number(const fs::path& file, Cursor& in, const char* field) {
    const std::string word = pfm_word(file, in);
    T value{};
    const char* begin = word.c_str() + (word.size() > 1 && word[0] == '+' && word[1] != '-' ? 1 : 0);
    const auto [end, error] = std::from_chars(begin, word.c_str() + word.size(), value);
    if (error != std::errc() || end != word.c_str() + word.size())
        bad(file, field, "got " + word + ", expected a number");
    return value;
}

Claim claim_pfm(const fs::path& file, Cursor in, uint64_t file_size) {
    Claim claim;
    claim.kind = Kind::pfm;
    claim.stored = Stored::float32;
    claim.channels = in.take(2) == "PF" ? 3 : 1;
    if (!blank(in.peek())) bad(file, "PFM header", "got no blank after the first word, expected one");
    claim.width = pfm_number<int64_t>(file, in, "PFM width");
    claim.height = pfm_number<int64_t>(file, in, "PFM height");
    const double scale = pfm_number<double>(file, in, "PFM scale");
    if (claim.width <= 0 || claim.height <= 0)
        bad(file, "size",
            "got " + std::to_string(claim.width) + "x" + std::to_string(claim.height) + ", expected pixels");
    // Some readers multiply by the scale, some ignore it: no guess is made about metres.
    if (scale != 1 && scale != -1)
        bad(file, "PFM scale", "got another factor, expected 1 (big-endian) or -1 (little-endian)");
    claim.big_endian = scale > 0;
    const bool carriage_return = in.take(1) == "\r";
    claim.data_offset = in.at;
    const bool sane = claim.width <= max_image_side && claim.height <= max_image_side;
    if (carriage_return && sane && file_size == in.at + 1 + 4 * uint64_t(claim.width * claim.height * claim.channels))
        ++claim.data_offset;  // the header's last line ended in \r\n
    return claim;
}

/// The dict of a NPY header: {'descr': '<f4', 'fortran_order': False, 'shape': (2, 3), }
struct NpyDict {
    const fs::path& file;
    std::string_view text;
    size_t at = 0;
    std::string descr;
    int fortran = -1;
    std::optional<std::vector<int64_t>> shape;

    [[noreturn]] void broken() const {
        bad(file, "NPY header", "got a broken dict, expected 'descr', 'fortran_order' and 'shape'");
    }
    char next() {
        while (at < text.size() && blank(text[at])) ++at;
        if (at >= text.size()) broken();
        return text[at];
    }
    void expect(char c) {
        if (next() != c) broken();
        ++at;
    }
    bool take(std::string_view word) {
        next();
        if (text.substr(at, word.size()) != word) return false;
        at += word.size();
        return true;
    }
    std::string quoted() {
        const char quote = next();
        if (quote != '\'' && quote != '"') broken();
        const size_t end = text.find(quote, at + 1);
        if (end == std::string_view::npos || end - at > 64) broken();
        const std::string value(text.substr(at + 1, end - at - 1));
        at = end + 1;
        return value;
    }
    std::vector<int64_t> tuple() {
        std::vector<int64_t> values;
        for (expect('('); next() != ')';) {
            int64_t value = 0;
            const auto [end, error] = std::from_chars(text.data() + at, text.data() + text.size(), value);
            if (error != std::errc() || value < 0 || values.size() >= 8) broken();
            at = size_t(end - text.data());
            values.push_back(value);
            if (next() != ')') expect(',');
        }
        ++at;
        return values;
    }
    void parse() {
        for (expect('{'); next() != '}';) {
            const std::string key = quoted();
            expect(':');
            if (key == "descr" && descr.empty() && next() != '[')
                descr = quoted();
            else if (key == "fortran_order" && fortran < 0 && take("True"))
                fortran = 1;
            else if (key == "fortran_order" && fortran < 0 && take("False"))
                fortran = 0;
            else if (key == "shape" && !shape)
                shape = tuple();
            else
                broken();
            if (next() != '}') expect(',');
        }
        ++at;
        while (at < text.size())
            if (!blank(text[at++])) broken();
        if (descr.empty() || fortran < 0 || !shape) broken();
    }
};

Claim claim_npy(const fs::path& file, Cursor in) {
    Claim claim;
    claim.kind = Kind::npy;
    in.take(6);
    const uint32_t major = in.u8();
    in.u8();
    if (major != 1 && major != 2) bad(file, "NPY version", "got " + std::to_string(major) + ", expected 1 or 2");
    const uint32_t length = in.number(major == 1 ? 2 : 4, false);
    if (length > max_npy_header)
        bad(file, "NPY header",
            "got " + std::to_string(length) + " bytes, expected at most " + std::to_string(max_npy_header));
    NpyDict dict{file, in.take(length), 0, {}, -1, {}};
    claim.data_offset = in.at;
    dict.parse();
    if (dict.descr == "<f4")
        claim.stored = Stored::float32;
    else if (dict.descr == "<f8")
        claim.stored = Stored::float64;
    else if (dict.descr == "<u2")
        claim.stored = Stored::uint16;
    else if (dict.descr == "|u1")
        claim.stored = Stored::uint8;
    else
        bad(file, "NPY descr", "got " + dict.descr + ", expected <f4, <f8, <u2 or |u1");
    if (dict.fortran == 1) bad(file, "NPY fortran_order", "got True, expected False (numpy.ascontiguousarray)");
    const std::vector<int64_t>& shape = *dict.shape;
    if (shape.size() != 2 && shape.size() != 3)
        bad(file, "NPY shape", "got " + std::to_string(shape.size()) + " dimensions, expected (H, W) or (H, W, C)");
    claim.height = shape[0];
    claim.width = shape[1];
    claim.channels = shape.size() == 3 ? shape[2] : 1;
    if (claim.width == 0 || claim.height == 0 || claim.channels == 0)
        bad(file, "NPY shape", "got no pixels, expected some");
    return claim;
}

}  // namespace

size_t sample_bytes(Stored stored) {
    switch (stored) {
        case Stored::uint8:
            return 1;
        case Stored::uint16:
            return 2;
        case Stored::float64:
            return 8;
        default:
            return 4;
    }
}

std::optional<Claim> read_claim(const fs::path& file, std::string_view head, uint64_t file_size) {
    const auto starts = [&](std::string_view magic) { return head.substr(0, magic.size()) == magic; };
    try {
        const Cursor in{head};
        if (starts("\x76\x2f\x31\x01")) return claim_exr(file, in, file_size);
        if (starts("\x89PNG\r\n\x1a\n")) return claim_png(file, in);
        if (starts("\xff\xd8\xff")) return claim_jpeg(file, in);
        if (starts("\x93NUMPY")) return claim_npy(file, in);
        if (starts("Pf") || starts("PF")) return claim_pfm(file, in, file_size);
    } catch (const NeedMore&) {
        if (head.size() < file_size) return std::nullopt;
        bad(file, "size", "got " + std::to_string(file_size) + " bytes, expected more: the header is cut short");
    }
    bad(file, "format",
        head.empty() ? "got an empty file, expected EXR, PNG, JPEG, PFM or NPY"
                     : "got unknown first bytes, expected EXR, PNG, JPEG, PFM or NPY");
}

void check_limits(const fs::path& file, int64_t width, int64_t height, int64_t channels) {
    const bool sides = width <= max_image_side && height <= max_image_side;
    const double bytes = 4.0 * double(width) * double(height) * double(channels);
    if (sides && bytes <= double(max_decoded_bytes)) return;
    std::string estimate =
        std::to_string(width) + "x" + std::to_string(height) + " pixels of " + std::to_string(channels) + " channels";
    if (bytes < 9e15) estimate += " (" + std::to_string(int64_t(bytes)) + " bytes decoded)";
    fail_file(ExitCode::over_limit, file, "size",
              "got " + estimate + ", expected at most " + std::to_string(max_image_side) + "x" +
                  std::to_string(max_image_side) + " pixels and " + std::to_string(max_decoded_bytes) + " bytes");
}

void check_whole(const fs::path& file, std::string_view bytes, const Claim& claim) {
    try {
        Cursor in{bytes};
        if (claim.kind == Kind::png) {
            // libpng prints its complaints: what can be told without decoding is told here.
            in.take(8);
            uint64_t packed = 0;
            for (std::string_view type; type != "IEND";) {
                const uint32_t length = in.be32();
                const std::string_view chunk = in.take(size_t(length) + 4);
                type = chunk.substr(0, 4);
                if (type == "IDAT") packed += length;
                if (::crc32(0, reinterpret_cast<const unsigned char*>(chunk.data()), uInt(chunk.size())) != in.be32())
                    bad(file, "PNG checksum", "got another one than that of the chunk's bytes, expected the same");
            }
            const uint64_t bits =
                uint64_t(static_cast<unsigned char>(bytes[24])) * (bytes[25] == 3 ? 1 : uint64_t(claim.channels));
            const uint64_t raw = uint64_t(claim.height) * (1 + uint64_t(claim.width) * bits / 8);
            if (raw > 1100 * packed)  // deflate packs 1032 to 1 at most
                bad(file, "pixels",
                    "got " + std::to_string(packed) + " packed bytes, expected those of " + std::to_string(raw));
        } else if (claim.kind == Kind::jpeg) {
            in.take(2);
            for (uint32_t marker = 0; marker != 0xd9;) {
                while (in.u8() != 0xff) {  // entropy-coded data, or padding
                }
                marker = in.u8();
                while (marker == 0xff) marker = in.u8();
                const bool bare = marker == 0 || marker == 1 || (marker >= 0xd0 && marker <= 0xd9);
                if (!bare) {
                    const uint32_t length = in.be16();
                    in.take(length < 2 ? 0 : length - 2);
                }
            }
        } else if (claim.kind == Kind::pfm || claim.kind == Kind::npy) {
            const uint64_t expected =
                claim.data_offset + uint64_t(claim.width * claim.height * claim.channels) * sample_bytes(claim.stored);
            if (bytes.size() != expected)
                bad(file, "size",
                    "got " + std::to_string(bytes.size()) + " bytes, expected " + std::to_string(expected));
        }
    } catch (const NeedMore&) {
        bad(file, "size", "got " + std::to_string(bytes.size()) + " bytes, expected more: the file is cut short");
    }
}

}  // namespace vshift::formats
