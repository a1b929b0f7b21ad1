// SPDX-License-Identifier: Apache-2.0
// Image files: what goes in comes out, what is broken or too large is an Error and never a crash or
// a hang, and a write that fails leaves the old file as it was.
#include <fcntl.h>
#include <sys/mount.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

#include <clocale>
#include <cmath>
#include <csignal>
#include <cstring>
#include <functional>
#include <limits>
#include <numeric>
#include <set>

#include "embree_core/image_file.h"
#include "embree_core/srgb.h"
#include "tests/catch.h"

using namespace vshift;
namespace fs = std::filesystem;

namespace {

constexpr float infinite = std::numeric_limits<float>::infinity();

/// A folder of this test's own, removed at the end.
struct Folder {
    fs::path path;
    Folder() {
        std::string name = (fs::temp_directory_path() / "vshift-test-XXXXXX").string();
        REQUIRE(::mkdtemp(name.data()) != nullptr);
        path = name;
    }
    ~Folder() {
        std::error_code ignored;
        fs::remove_all(path, ignored);
    }
    fs::path operator/(const std::string& name) const { return path / name; }
    size_t count() const { return size_t(std::distance(fs::directory_iterator(path), fs::directory_iterator{})); }
};

struct Caught {
    bool thrown = false;
    ExitCode code = ExitCode::done;
    std::string text;
};

/// Runs `work` and says which Error it threw; anything else thrown fails the test.
Caught caught(const std::function<void()>& work) {
    Caught result;
    try {
        work();
    } catch (const Error& error) {
        result = {true, error.code(), error.what()};
        CHECK(result.text.find('\n') == std::string::npos);
    }
    return result;
}

#define REFUSED(expression, expected_code, part)               \
    do {                                                       \
        const Caught c_ = caught([&] { (void)(expression); }); \
        INFO(c_.text);                                         \
        CHECK(c_.thrown);                                      \
        CHECK(int(c_.code) == int(ExitCode::expected_code));   \
        CHECK(c_.text.find(part) != std::string::npos);        \
    } while (false)

Channels sample_image(int width, int height, const std::vector<std::string>& names) {
    Channels image;
    image.width = width;
    image.height = height;
    for (size_t c = 0; c < names.size(); ++c) {
        std::vector<float> plane(size_t(width) * size_t(height));
        for (size_t i = 0; i < plane.size(); ++i)  // spread, and hard to compress
            plane[i] = float((i * 2654435761u + c * 40503u) % 65536u) / 65535.0f;
        image.add(names[c], std::move(plane));
    }
    return image;
}

std::string bytes_of(const fs::path& file) {
    return read_whole_file(file, size_t(1) << 30);
}

bool same_bits(const std::vector<float>& a, const std::vector<float>& b) {
    return a.size() == b.size() && std::memcmp(a.data(), b.data(), a.size() * 4) == 0;
}

std::string be32(uint32_t v) {
    return {char(v >> 24), char(v >> 16 & 255), char(v >> 8 & 255), char(v & 255)};
}

std::string chunk(const std::string& type, const std::string& data) {
    uint32_t crc = 0xffffffffu;
    for (const char c : type + data) {
        crc ^= static_cast<unsigned char>(c);
        for (int k = 0; k < 8; ++k) crc = crc & 1 ? 0xedb88320u ^ crc >> 1 : crc >> 1;
    }
    return be32(uint32_t(data.size())) + type + data + be32(~crc);
}

/// A PNG of the given claim whose pixels are a few bytes of zlib stream.
std::string claiming_png(uint32_t width, uint32_t height, int bits, int color) {
    const std::string header = be32(width) + be32(height) + std::string{char(bits), char(color), 0, 0, 0};
    return "\x89PNG\r\n\x1a\n" + chunk("IHDR", header) +
           chunk("IDAT", std::string("\x78\x9c\x63\x00\x00\x00\x01\x00\x01", 9)) + chunk("IEND", "");
}

size_t peak_memory_kb() {
    struct rusage usage {};
    ::getrusage(RUSAGE_SELF, &usage);
    return size_t(usage.ru_maxrss);
}

std::string npy(const std::string& dict, const std::string& data, int major = 1) {
    std::string head("\x93NUMPY", 6);
    head += char(major);
    head += char(0);
    for (int i = 0; i < (major == 1 ? 2 : 4); ++i) head += char(dict.size() >> (8 * i) & 255);
    return head + dict + data;
}

template <class T>
std::string raw(std::initializer_list<T> values, bool swap = false) {
    std::string out;
    for (T v : values) {
        std::string b(reinterpret_cast<const char*>(&v), sizeof(T));
        out += swap ? std::string(b.rbegin(), b.rend()) : b;
    }
    return out;
}

}  // namespace

TEST_CASE("EXR float keeps every bit, names and metadata", "[image_file]") {
    Folder dir;
    Channels image = sample_image(37, 23, {"R", "G", "B", "Z", "lost", "view.depth"});
    image.planes[3][0] = infinite;
    image.planes[3][1] = std::numeric_limits<float>::quiet_NaN();
    image.planes[3][2] = 1234.5678f;
    image.planes[3][3] = -0.0f;
    image.metadata["vshift.camera"] = "CAM_FRONT";
    image.metadata["compression"] = "none";  // describes the encoding: not taken from metadata
    write_image(dir / "a.exr", image);
    const Channels back = read_image(dir / "a.exr");
    REQUIRE(back.width == 37);
    REQUIRE(back.height == 23);
    CHECK(back.names.size() == 6);
    for (size_t c = 0; c < image.names.size(); ++c) CHECK(same_bits(back.plane(image.names[c]), image.planes[c]));
    CHECK(back.metadata.at("vshift.camera") == "CAM_FRONT");
    CHECK(back.metadata.count("DateTime") == 0);
    CHECK(back.metadata.count("capDate") == 0);
    CHECK(dir.count() == 1);

    const DepthMap depth = read_depth(dir / "a.exr", "Z", 2, 37, 23);
    CHECK(depth.at(0, 0) == infinite);
    CHECK(std::isnan(depth.at(1, 0)));
    CHECK(depth.at(2, 0) == 2 * 1234.5678f);
    const ColorImage color = read_color(dir / "a.exr", 37, 23);
    CHECK(color.at(5, 7).g == image.planes[1][7 * 37 + 5]);
}

TEST_CASE("EXR takes half and float side by side", "[image_file]") {
    Folder dir;
    Channels image = sample_image(20, 33, {"hole", "R", "Z"});
    image.planes[1][4] = 0.1f;
    const std::vector<SampleType> types = {SampleType::float16, SampleType::float16, SampleType::float32};
    write_image(dir / "a.exr", image, types);
    const Channels back = read_image(dir / "a.exr");
    CHECK(same_bits(back.plane("Z"), image.planes[2]));
    CHECK(back.plane("R")[4] == 0.0999755859375f);  // the half nearest to 0.1
    for (size_t i = 0; i < image.planes[0].size(); ++i)
        REQUIRE(std::abs(back.plane("hole")[i] - image.planes[0][i]) <= 0.00025f);
    write_image(dir / "b.exr", back, {SampleType::float16, SampleType::float16, SampleType::float16});
    const Channels again = read_image(dir / "b.exr");
    CHECK(same_bits(again.plane("R"), back.plane("R")));
}

TEST_CASE("EXR whose window begins elsewhere than at (0, 0)", "[image_file]") {
    const Folder folder;
    Channels image;
    image.width = 5, image.height = 4;
    image.add("Z", std::vector<float>(20));
    std::iota(image.planes[0].begin(), image.planes[0].end(), 1.0f);
    write_image(folder / "z.exr", image);
    std::string bytes = read_whole_file(folder / "z.exr", 1 << 20);
    const auto number = [&](size_t at) {
        int32_t value;
        std::memcpy(&value, &bytes[at], 4);
        return value;
    };
    const auto add = [&](size_t at, int32_t by) {
        const int32_t value = number(at) + by;
        std::memcpy(&bytes[at], &value, 4);
    };
    for (const char* window : {"dataWindow", "displayWindow"}) {  // name, box2i, its 16 bytes, then two corners
        const size_t at = bytes.find(window) + std::strlen(window) + 1 + 6 + 4;
        for (const size_t corner : {0, 8}) add(at + corner, -30), add(at + corner + 4, 1000);
    }
    // After the header's end: where the one chunk lies, which begins with its first row.
    const size_t end = bytes.find(std::string("screenWindowWidth\0float\0\4\0\0\0", 28)) + 28 + 4 + 1;
    add(size_t(number(end)), 1000);
    write_whole_file(folder / "moved.exr", bytes);
    CHECK(read_image(folder / "moved.exr").plane("Z") == image.planes[0]);
}

TEST_CASE("PNG: integers come back exactly, alpha does not touch colour", "[image_file]") {
    Folder dir;
    for (const auto& names : std::vector<std::vector<std::string>>{{"Y"}, {"R", "G", "B"}, {"R", "G", "B", "A"}}) {
        const Channels image = sample_image(31, 9, names);
        write_image(dir / "a.png", image, {SampleType::uint16});
        const Channels back = read_image(dir / "a.png");
        REQUIRE(back.planes.size() == names.size());
        for (size_t c = 0; c < names.size(); ++c) CHECK(same_bits(back.planes[c], image.planes[c]));
    }
    Channels image = sample_image(4, 1, {"Y"});
    image.planes[0] = {-1, 0.5f, 7, std::numeric_limits<float>::quiet_NaN()};
    write_image(dir / "b.png", image, {SampleType::uint8});
    CHECK(read_image(dir / "b.png").planes[0] == std::vector<float>{0, 128 / 255.0f, 1, 0});
}

TEST_CASE("depth from 16-bit PNG is the stored integer times the scale", "[image_file]") {
    Folder dir;
    Channels image = sample_image(4, 1, {"Y"});
    image.planes[0] = {0, 1 / 65535.0f, 12345 / 65535.0f, 1};
    write_image(dir / "mm.png", image, {SampleType::uint16});
    const DepthMap depth = read_depth(dir / "mm.png", "Z", 0.001, 4, 1);
    CHECK(depth.data == std::vector<float>{0, 0.001f, 12.345f, 65.535f});
    CHECK(read_depth(dir / "mm.png", "Z", 1, 0, 0).data[2] == 12345);
    REFUSED(read_depth(dir / "mm.png", "Z", 0.001, 5, 1), bad_input, "size: got 4x1, expected 5x1");
    REFUSED(read_depth(dir / "mm.png", "Z", 0, 4, 1), bad_input, "depth scale");
    write_image(dir / "8.png", image, {SampleType::uint8});
    REFUSED(read_depth(dir / "8.png", "Z", 1, 4, 1), bad_input, "got 8-bit integers");
    write_image(dir / "rgb.png", sample_image(4, 1, {"R", "G", "B"}), {SampleType::uint16});
    REFUSED(read_depth(dir / "rgb.png", "Z", 1, 4, 1), bad_input, "channels: got 3, expected 1");
}

TEST_CASE("colour from PNG is decoded from sRGB, 8 and 16 bits, grey spread", "[image_file]") {
    Folder dir;
    Channels image = sample_image(3, 1, {"R", "G", "B"});
    image.planes = {{0, 1, 0.5f}, {0.02f, 0.5f, 1}, {1, 0, 0.75f}};
    for (const SampleType type : {SampleType::uint8, SampleType::uint16}) {
        write_image(dir / "c.png", image, {type});
        const ColorImage color = read_color(dir / "c.png", 3, 1);
        const double top = type == SampleType::uint8 ? 255 : 65535;
        for (int x = 0; x < 3; ++x)
            for (int c = 0; c < 3; ++c) {
                const double stored = std::floor(double(image.planes[size_t(c)][size_t(x)]) * top + 0.5) / top;
                CHECK(color.at(x, 0)[c] == float(linear_from_srgb(stored)));
            }
    }
    CHECK(linear_from_srgb(0.5) == Approx(0.21404114).epsilon(1e-7));  // IEC 61966-2-1
    for (double v = 0; v <= 1; v += 1.0 / 1024) CHECK(srgb_from_linear(linear_from_srgb(v)) == Approx(v).margin(3e-8));
    write_image(dir / "y.png", sample_image(3, 1, {"Y"}), {SampleType::uint8});
    const ColorImage grey = read_color(dir / "y.png", 3, 1);
    CHECK(grey.at(1, 0).r == grey.at(1, 0).b);
    write_image(dir / "y.pfm", sample_image(3, 1, {"Y"}));  // a float plane may be depth: not colour
    REFUSED(read_color(dir / "y.pfm", 3, 1), bad_input, "channel: got R");
}

TEST_CASE("PFM: rows from the bottom, either byte order, strict header", "[image_file]") {
    Folder dir;
    const std::string little = raw({3.0f, 4.0f, 1.0f, 2.0f}), big = raw({3.0f, 4.0f, 1.0f, 2.0f}, true);
    const std::vector<float> expected = {1, 2, 3, 4};
    const auto put = [&](const std::string& bytes) { write_whole_file(dir / "a.pfm", bytes); };
    const auto depth = [&] { return read_depth(dir / "a.pfm", "Z", 1, 2, 2).data; };
    put("Pf\n2 2\n-1.0\n" + little);
    CHECK(depth() == expected);
    put("Pf\n2 2\n1\n" + big);
    CHECK(depth() == expected);
    put("Pf 2 2 -1\n" + little);
    CHECK(depth() == expected);
    put("Pf\r\n2 2\r\n-1.0\r\n" + little);
    CHECK(depth() == expected);
    put("PF\n2 1\n-1\n" + raw({1.f, 2.f, 3.f, 4.f, 5.f, 6.f}));
    CHECK(read_image(dir / "a.pfm").plane("G") == std::vector<float>{2, 5});
    for (const std::string bad :
         {"Pf\n2 2\n-0.5\n", "Pf\n2 2\n0\n", "Pf\n-2 2\n-1\n", "Pf\n2 x\n-1\n", "Pf\n2 2\nnan\n", "Pf\n2\n-1\n",
          "Pf\n99999999999999999999 2\n-1\n", "Pfoo\n2 2\n-1\n", "Pf\n2 2\n- 1\n"}) {
        INFO(bad);
        put(bad + little);
        REFUSED(depth(), bad_input, "a.pfm: ");
    }
    put("Pf\n2 2\n-1.0\n" + little + "x");
    REFUSED(depth(), bad_input, "size: got");
    put("Pf\n20000 2\n-1\n" + little);
    REFUSED(read_image(dir / "a.pfm"), over_limit, "20000x2");
    const Channels image = sample_image(13, 7, {"R", "G", "B"});
    write_image(dir / "b.pfm", image);
    for (size_t c = 0; c < 3; ++c) CHECK(same_bits(read_image(dir / "b.pfm").planes[c], image.planes[c]));
    REFUSED(write_image(dir / "b.pfm", image, {SampleType::uint8}), bad_input, "sample type");
}

TEST_CASE("NPY: the types and shapes that are read, and those that are not", "[image_file]") {
    Folder dir;
    const fs::path file = dir / "a.npy";
    const auto dict = [](const std::string& descr, const std::string& shape, const char* order = "False") {
        return "{'descr': '" + descr + "', 'fortran_order': " + order + ", 'shape': " + shape + ", }   \n";
    };
    const auto put = [&](const std::string& bytes) { write_whole_file(file, bytes); };
    const auto depth = [&] { return read_depth(file, "Z", 0.5, 2, 1).data; };
    put(npy(dict("<f4", "(1, 2)"), raw({3.0f, infinite})));
    CHECK(depth() == std::vector<float>{1.5f, infinite});
    put(npy(dict("<f8", "(1, 2, 1)"), raw({3.0, 1e300}), 2));
    CHECK(depth() == std::vector<float>{1.5f, infinite});
    put(npy(dict("<u2", "(1, 2)"), raw<uint16_t>({3, 65535})));
    CHECK(depth() == std::vector<float>{1.5f, 32767.5f});
    put(npy(dict("|u1", "(1,2)"), raw<uint8_t>({0, 255})));
    CHECK(read_image(file).planes[0] == std::vector<float>{0, 1});
    REFUSED(depth(), bad_input, "8-bit");
    const std::string two = raw({3.0f, 4.0f});
    put(npy(dict("<f4", "(1, 2)", "True"), two));
    REFUSED(depth(), bad_input, "fortran_order: got True");
    put(npy(dict(">f4", "(1, 2)"), two));
    REFUSED(depth(), bad_input, "descr: got >f4");
    put(npy(dict("<f4", "(2,)"), two));
    REFUSED(depth(), bad_input, "shape");
    put(npy(dict("<f4", "(1, 0)"), ""));
    REFUSED(depth(), bad_input, "shape");
    put(npy(dict("<f4", "(-1, -2)"), two));
    REFUSED(depth(), bad_input, "header");
    put(npy(dict("<f4", "(1, 2)"), two + "x"));
    REFUSED(depth(), bad_input, "size");
    put(npy(dict("<f4", "(1, 9223372036854775807)"), two));
    REFUSED(read_image(file), over_limit, "expected at most");
    put(npy(dict("<f4", "(16384, 16384, 9999999999)"), two));
    REFUSED(read_image(file), over_limit, "channels");
    put(npy(dict("<f4", "(1, 2)"), two, 3));
    REFUSED(depth(), bad_input, "version");
    put(npy("{'shape': (1, 2), 'shape': (1, 2), 'descr': '<f4', 'fortran_order': False}", two));
    REFUSED(depth(), bad_input, "header");
    put(npy("{'shape': (1, 2), 'descr': '<f4'}", two));
    REFUSED(depth(), bad_input, "header");
    put(npy("__import__('os')", two));
    REFUSED(depth(), bad_input, "header");
    put(std::string("\x93NUMPY\x02\x00\xff\xff\xff\xff{", 13));
    REFUSED(depth(), bad_input, "header");

    const Channels image = sample_image(13, 7, {"a", "b", "c", "d", "e"});
    for (const SampleType type : {SampleType::float32, SampleType::uint16}) {
        write_image(file, image, {type});
        const Channels back = read_image(file);
        for (size_t c = 0; c < 5; ++c) CHECK(same_bits(back.planes[c], image.planes[c]));
    }
}

TEST_CASE("a file cut short anywhere is an Error", "[image_file]") {
    Folder dir;
    const Channels color = sample_image(61, 47, {"R", "G", "B"});
    write_image(dir / "a.exr", color);
    write_image(dir / "b.exr", color, {SampleType::float16});
    write_image(dir / "a.png", color, {SampleType::uint16});
    write_image(dir / "b.png", color, {SampleType::uint8});
    write_image(dir / "a.pfm", color);
    write_image(dir / "a.npy", color);
    for (const std::string name : {"a.exr", "b.exr", "a.png", "b.png", "a.pfm", "a.npy"}) {
        const std::string whole = bytes_of(dir / name);
        REQUIRE(read_image(dir / name).planes.size() == 3);
        std::set<size_t> lengths = {0, 1, 4, 11, 33, whole.size() - 1};
        for (size_t i = 0; i < 64; ++i) lengths.insert(whole.size() * i / 64);
        for (const size_t length : lengths) {
            INFO(name << " cut to " << length << " of " << whole.size());
            write_whole_file(dir / name, whole.substr(0, length));
            REFUSED(read_image(dir / name), bad_input, name);
            CHECK(caught([&] { read_color(dir / name, 0, 0); }).thrown);
        }
    }
}

TEST_CASE("a file with bytes changed is read or refused, never a crash", "[image_file]") {
    Folder dir;
    const Channels color = sample_image(19, 11, {"R", "G", "B"});
    for (const std::string name : {"a.exr", "a.png", "a.pfm", "a.npy"}) {
        write_image(dir / name, color, {name == "a.png" ? SampleType::uint16 : SampleType::float32});
        const std::string whole = bytes_of(dir / name);
        uint32_t state = 1;
        for (int round = 0; round < 400; ++round) {
            std::string broken = whole;
            for (int k = 0; k < 1 + round % 3; ++k) {
                state = state * 1664525u + 1013904223u;
                const size_t span = round % 2 ? broken.size() : std::min<size_t>(broken.size(), 400);
                broken[(state >> 8) % span] = char(state >> 3 & 255);
            }
            write_whole_file(dir / name, broken);
            caught([&] { read_image(dir / name); });
        }
    }
}

TEST_CASE("bytes after the end of a PNG or EXR are let be", "[image_file]") {
    Folder dir;
    const Channels color = sample_image(19, 11, {"R", "G", "B"});
    for (const std::string name : {"a.exr", "a.png"}) {
        write_image(dir / name, color, {name == "a.png" ? SampleType::uint16 : SampleType::float32});
        write_whole_file(dir / name, bytes_of(dir / name) + "trailing");
        CHECK(same_bits(read_image(dir / name).plane("G"), color.planes[1]));
    }
}

TEST_CASE("a size claim is refused before anything is allocated", "[image_file]") {
    Folder dir;
    const std::string png = claiming_png(46340, 46340, 8, 2);
    CHECK(png.size() < 80);
    write_whole_file(dir / "bomb.png", png);
    const size_t before = peak_memory_kb();
    REFUSED(read_image(dir / "bomb.png"), over_limit, "46340x46340");
    REFUSED(read_color(dir / "bomb.png", 0, 0), over_limit, "16384x16384");
    REFUSED(read_depth(dir / "bomb.png", "Z", 1, 0, 0), over_limit, "1073741824");
    write_whole_file(dir / "rgb.png", claiming_png(16384, 16384, 8, 2));  // sides fit, bytes do not
    REFUSED(read_image(dir / "rgb.png"), over_limit, "3221225472 bytes decoded");
    // The same in an EXR: dataWindow and displayWindow of a real file, enlarged.
    write_image(dir / "a.exr", sample_image(16, 16, {"Z"}));
    std::string exr = bytes_of(dir / "a.exr");
    for (const std::string name : {"dataWindow", "displayWindow"}) {
        const size_t at = exr.find(name) + name.size() + 1 + 6 + 4;
        const int32_t corner[2] = {46339, 2000000000};
        std::memcpy(exr.data() + at + 8, corner, 8);
    }
    write_whole_file(dir / "a.exr", exr);
    REFUSED(read_image(dir / "a.exr"), over_limit, "46340x2000000001");
    REFUSED(read_depth(dir / "a.exr", "Z", 1, 0, 0), over_limit, "got 46340");
    CHECK(peak_memory_kb() < before + 64 * 1024);
}

TEST_CASE("only regular files are read, and nothing hangs", "[image_file]") {
    Folder dir;
    REQUIRE(::mkfifo((dir / "pipe.exr").c_str(), 0600) == 0);
    ::alarm(20);  // a hang fails the test
    REFUSED(read_image(dir / "pipe.exr"), io_failed, "got a FIFO, expected a regular file");
    REFUSED(read_whole_file(dir / "pipe.exr", 10), io_failed, "FIFO");
    REFUSED(read_image("/dev/zero"), io_failed, "character device");
    REFUSED(read_image(dir.path), io_failed, "a folder");
    REFUSED(read_image(dir / "none.exr"), io_failed, "No such file");
    REFUSED(read_image("/proc/self/status"), bad_input, "format");  // regular, and states size 0
    fs::create_symlink("/dev/zero", dir / "zero.png");
    REFUSED(read_image(dir / "zero.png"), io_failed, "character device");
    // Writing would replace the device, not fill it.
    fs::create_symlink("/dev/null", dir / "null.exr");
    REFUSED(write_image(dir / "null.exr", sample_image(2, 2, {"Z"})), io_failed, "character device");
    REFUSED(write_whole_file(dir / "pipe.exr", "x"), io_failed, "FIFO");
    REFUSED(write_whole_file(dir.path, "x"), io_failed, "a folder");
    ::alarm(0);
    struct stat status {};
    REQUIRE(::stat("/dev/null", &status) == 0);
    CHECK(S_ISCHR(status.st_mode));
}

TEST_CASE("channels are looked up strictly, and the nearest is named", "[image_file]") {
    Folder dir;
    write_image(dir / "a.exr", sample_image(4, 4, {"R", "G", "B", "ViewLayer.Depth.Z"}));
    REFUSED(read_depth(dir / "a.exr", "Z", 1, 4, 4), bad_input, "channel: got Z, expected one of ");
    REFUSED(read_depth(dir / "a.exr", "z", 1, 4, 4), bad_input, "(nearest: ViewLayer.Depth.Z)");
    REFUSED(read_depth(dir / "a.exr", "Viewlayer.Depth.Z", 1, 4, 4), bad_input, "(nearest: ViewLayer.Depth.Z)");
    CHECK(read_depth(dir / "a.exr", "ViewLayer.Depth.Z", 1, 4, 4).width == 4);
    write_image(dir / "z.exr", sample_image(4, 4, {"Z", "lost"}));
    REFUSED(read_color(dir / "z.exr", 4, 4), bad_input, "z.exr: channel: got R, expected one of ");
    REFUSED(read_image(dir / "z.exr").plane("last"), bad_input, "(nearest: lost)");
    CHECK(read_image(dir / "z.exr").has("lost"));
    CHECK_FALSE(read_image(dir / "z.exr").has("Lost"));
}

TEST_CASE("the same pixels give the same bytes", "[image_file]") {
    Folder dir;
    Channels image = sample_image(200, 150, {"R", "G", "B"});
    image.metadata["vshift.shift"] = "0,1,0";
    const std::vector<std::string> names = {"a.exr", "a.png", "a.pfm", "a.npy"};
    std::vector<std::string> first;
    for (const std::string& name : names) {
        const std::vector<SampleType> types = {name == "a.png" ? SampleType::uint8 : SampleType::float32};
        write_image(dir / name, image, types);
        first.push_back(bytes_of(dir / name));
    }
    ::usleep(1100000);  // a time stamp counts whole seconds
    for (size_t i = 0; i < names.size(); ++i) {
        INFO(names[i]);
        write_image(dir / names[i], image, {names[i] == "a.png" ? SampleType::uint8 : SampleType::float32});
        CHECK(first[i] == bytes_of(dir / names[i]));
        CHECK(first[i].substr(0, 400).find("tIME") == std::string::npos);
    }
    CHECK(dir.count() == 4);
}

TEST_CASE("a failed write leaves the old file and nothing else", "[image_file]") {
    Folder dir;
    const Channels image = sample_image(256, 256, {"R", "G", "B"});
    REFUSED(write_image(dir / "none/a.exr", image), io_failed, "No such file or directory");
    CHECK_FALSE(fs::exists(dir / "none"));
    write_whole_file(dir / "plain", "x");
    REFUSED(write_image(dir / "plain/a.exr", image), io_failed, "Not a directory");
    REFUSED(write_image("/proc/vshift.exr", image), io_failed, "got ");  // not even root may
    REFUSED(write_image(dir / "a.jpg", image), bad_input, "expected .exr, .png, .pfm or .npy");
    REFUSED(write_image(dir / "a.png", image), bad_input, "got float32, expected uint16 or uint8");
    REFUSED(write_image(dir / "a.exr", image, {SampleType::uint8}), bad_input, "sample type");
    CHECK(dir.count() == 1);

    // A limit on file sizes cuts the write in the middle, for root too.
    write_whole_file(dir / "a.exr", "the old bytes");
    struct rlimit old_limit {};
    REQUIRE(::getrlimit(RLIMIT_FSIZE, &old_limit) == 0);
    const auto old_handler = std::signal(SIGXFSZ, SIG_IGN);
    struct rlimit small = old_limit;
    small.rlim_cur = 4096;
    REQUIRE(::setrlimit(RLIMIT_FSIZE, &small) == 0);
    const Caught cut = caught([&] { write_image(dir / "a.exr", image); });
    ::setrlimit(RLIMIT_FSIZE, &old_limit);
    std::signal(SIGXFSZ, old_handler);
    INFO(cut.text);
    CHECK(cut.thrown);
    CHECK(cut.code == ExitCode::io_failed);
    CHECK(cut.text.find("File too large") != std::string::npos);
    CHECK(bytes_of(dir / "a.exr") == "the old bytes");
    CHECK(dir.count() == 2);

    // A read-only folder, where that means something.
    if (::geteuid() != 0) {
        fs::permissions(dir.path, fs::perms::owner_read | fs::perms::owner_exec);
        REFUSED(write_image(dir / "b.exr", image), io_failed, "Permission denied");
        fs::permissions(dir.path, fs::perms::owner_all);
    }
}

TEST_CASE("a full disk", "[image_file]") {
    Folder dir;
    if (::mount("tmpfs", dir.path.c_str(), "tmpfs", 0, "size=64k") != 0) {
        WARN("no full disk tried: mounting a tmpfs is not allowed here");
        return;
    }
    struct Unmount {
        fs::path path;
        ~Unmount() { ::umount2(path.c_str(), MNT_DETACH); }
    } unmount{dir.path};
    write_whole_file(dir / "a.exr", "the old bytes");
    REFUSED(write_image(dir / "a.exr", sample_image(256, 256, {"R", "G", "B"})), io_failed, "No space left on device");
    CHECK(bytes_of(dir / "a.exr") == "the old bytes");
    CHECK(dir.count() == 1);
    write_image(dir / "a.exr", sample_image(8, 8, {"Z"}));  // what fits is still written
    CHECK(read_image(dir / "a.exr").width == 8);

    // A file system mounted read-only stops root as well.
    REQUIRE(::mount(nullptr, dir.path.c_str(), nullptr, MS_REMOUNT | MS_RDONLY, nullptr) == 0);
    REFUSED(write_image(dir / "a.exr", sample_image(9, 9, {"Z"})), io_failed, "Read-only file system");
    CHECK(read_image(dir / "a.exr").width == 8);
}

TEST_CASE("replacing keeps a link and the old permissions", "[image_file]") {
    Folder dir;
    write_whole_file(dir / "real.json", "1");
    fs::permissions(dir / "real.json", fs::perms(0640));
    fs::create_symlink("real.json", dir / "link.json");
    write_whole_file(dir / "link.json", "2");
    CHECK(fs::is_symlink(dir / "link.json"));
    CHECK(bytes_of(dir / "real.json") == "2");
    CHECK((fs::status(dir / "real.json").permissions() & fs::perms::all) == fs::perms(0640));
    REFUSED(read_whole_file(dir / "real.json", 0), over_limit, "got 1 bytes, expected at most 0");
    REFUSED(read_whole_file("/proc/self/status", 8), over_limit, "more than 8");
    CHECK(read_whole_file(dir / "real.json", 1) == "2");
}

TEST_CASE("the locale does not matter", "[image_file]") {
    Folder dir;
    const Channels image = sample_image(5, 4, {"Y"});
    write_image(dir / "a.pfm", image);
    write_image(dir / "a.exr", image);
    const std::string pfm = bytes_of(dir / "a.pfm"), exr = bytes_of(dir / "a.exr");
    const std::string before = std::setlocale(LC_ALL, nullptr);
    bool found = false;
    for (const char* name : {"de_DE.UTF-8", "de_DE.utf8", "de_DE", "fr_FR.UTF-8"})
        found = found || std::setlocale(LC_ALL, name);
    if (!found) WARN("no locale with a decimal comma is installed: tried in the plain one only");
    const DepthMap depth = read_depth(dir / "a.pfm", "Z", 0.5, 5, 4);
    write_image(dir / "a.pfm", image);
    write_image(dir / "a.exr", image);
    std::setlocale(LC_ALL, before.c_str());
    CHECK(depth.data[3] == image.planes[0][3] * 0.5f);
    CHECK(bytes_of(dir / "a.pfm") == pfm);
    CHECK(bytes_of(dir / "a.exr") == exr);
}
