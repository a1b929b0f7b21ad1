// SPDX-License-Identifier: Apache-2.0
// Weight files: what is written comes back, and what is hostile is refused.
#include <unistd.h>

#include <cstring>
#include <fstream>

#include "embree_core/image_file.h"
#include "inpaint/tensor_file.h"
#include "tests/catch.h"

namespace fs = std::filesystem;
using namespace vshift;
using namespace vshift::inpaint;

namespace {

struct Scratch {
    fs::path folder = fs::temp_directory_path() / ("vshift-weights-" + std::to_string(::getpid()));
    Scratch() { fs::create_directories(folder); }
    ~Scratch() { fs::remove_all(folder); }
    fs::path file(const std::string& name, const std::string& bytes) const {
        std::ofstream(folder / name, std::ios::binary) << bytes;
        return folder / name;
    }
};

std::string with_header(const std::string& header, size_t data_bytes, uint64_t stated = 0) {
    std::string out;
    const uint64_t n = stated ? stated : header.size();
    for (int i = 0; i < 8; ++i) out += char(uint8_t(n >> (8 * i)));
    return out + header + std::string(data_bytes, '\1');
}

std::string entry(const std::string& dtype, const std::string& shape, const std::string& offsets) {
    return R"({"dtype":")" + dtype + R"(","shape":)" + shape + R"(,"data_offsets":)" + offsets + "}";
}

std::string told(const std::string& bytes) {
    try {
        parse_tensor_file(bytes, "x.safetensors");
    } catch (const Error& e) {
        return e.what();
    }
    return "";
}

}  // namespace

TEST_CASE("weight files: what is written comes back, bytes and all", "[weights]") {
    const Scratch scratch;
    const float a[6] = {1, -2, 3.5f, 0, 5, 6};
    const uint16_t b[3] = {1, 2, 3};
    std::vector<StoredTensor> tensors(3);
    tensors[0] = {"z.weight", ElementType::f32, {2, 3}, reinterpret_cast<const uint8_t*>(a), sizeof a};
    tensors[1] = {"b", ElementType::bf16, {3}, reinterpret_cast<const uint8_t*>(b), sizeof b};
    tensors[2] = {"empty", ElementType::i64, {0, 4}, nullptr, 0};
    const std::map<std::string, std::string> metadata{{"config", "{\"dim\": 48}"}, {"license", "Apache-2.0"}};
    const fs::path file = scratch.folder / "m.safetensors";
    write_tensor_file(file, tensors, metadata);

    const TensorFiles read(file);
    CHECK(read.metadata() == metadata);
    REQUIRE(read.tensors().size() == 3);
    const StoredTensor* z = read.find("z.weight");
    REQUIRE(z);
    CHECK(z->shape == Shape{2, 3});
    CHECK(std::memcmp(z->data, a, sizeof a) == 0);
    REQUIRE(read.find("b"));
    CHECK(std::memcmp(read.find("b")->data, b, sizeof b) == 0);
    CHECK(read.find("empty")->bytes == 0);
    CHECK(read.find("nothing") == nullptr);
    CHECK(hash_of(read.tensors()) == hash_of(tensors));
    const float other[6] = {1, -2, 3.5f, 0, 5, 7};
    tensors[0].data = reinterpret_cast<const uint8_t*>(other);
    CHECK(hash_of(read.tensors()) != hash_of(tensors));

    // The same tensors in any order are the same bytes; the data begin on a multiple of 8.
    tensors[0].data = reinterpret_cast<const uint8_t*>(a);
    const std::string bytes = encode_tensor_file(tensors, metadata);
    std::swap(tensors[0], tensors[2]);
    CHECK(encode_tensor_file(tensors, metadata) == bytes);
    CHECK(read_whole_file(file, SIZE_MAX) == bytes);
    CHECK(uint8_t(bytes[0]) % 8 == 0);
    tensors[1].bytes = 5;
    CHECK_THROWS_AS(encode_tensor_file(tensors, metadata), Error);
}

TEST_CASE("weight files: a header whose length begins like a pickle is a header all the same", "[weights]") {
    const std::string start = "{\"a\":" + entry("F32", "[1]", "[0,4]") + "}";
    for (const size_t length : {0x180u, 0x280u, 0x580u})
        CHECK(told(with_header(start + std::string(length - start.size(), ' '), 4)) == "");
}

TEST_CASE("weight files: hostile ones are refused, each for its own reason", "[weights]") {
    const std::string good = "{\"a\":" + entry("F32", "[2]", "[0,8]") + "}";
    CHECK(told(with_header(good, 8)).empty());
    CHECK(told(with_header(good + "   ", 8)).empty());  // padding

    const auto refused = [](const std::string& bytes, const std::string& part) {
        INFO(part);
        const std::string message = told(bytes);
        INFO(message);
        CHECK(message.find("x.safetensors: ") == 0);
        CHECK(message.find(part) != std::string::npos);
        CHECK(message.find('\n') == std::string::npos);
        CHECK(message.size() < 700);
    };
    const auto single = [](const std::string& e) { return "{\"a\":" + e + "}"; };
    refused("", "0 bytes");
    refused("123456789", "9 bytes");
    refused(with_header(good, 8, 1u << 20), "expected at most the");               // header longer than the file
    refused(with_header(good, 8, ~uint64_t(0)), "18446744073709551615 bytes");      // and by far
    refused(with_header(std::string(max_header_bytes + 1, ' '), 0), "at most 8388608");
    refused(with_header(good, 7), "a range within");                               // cut short
    refused(with_header(good, 9), "9 data bytes");                                 // something is smuggled along
    refused(with_header(" " + good, 8), "begins with {");
    refused(with_header("[1, 2]    ", 0), "begins with {");
    refused(with_header(good + "x", 8), "valid JSON");
    refused(with_header("{\"a\":", 8), "valid JSON");
    refused(with_header("{\"a\xff\":1}", 8), "valid JSON");
    refused(with_header("{\"a\":" + std::string(100000, '['), 8), "flat object");  // deep nesting
    refused(with_header("{\"a\":" + entry("F32", "[1]", "[0,4]") + ",\"a\":" + entry("F32", "[1]", "[4,8]") + "}", 8),
            "a: got the key twice");
    refused(with_header(single(R"({"dtype":"F32","shape":[2],"data_offsets":[0,8],"x":1})"), 8), "an object of dtype");
    refused(with_header(single("7"), 8), "an object of dtype");
    refused(with_header(single(entry("F31", "[2]", "[0,8]")), 8), "one of BOOL");
    refused(with_header(single(entry("F32", "[-2]", "[0,8]")), 8), "whole numbers");
    refused(with_header(single(entry("F32", "[2.0]", "[0,8]")), 8), "whole numbers");
    refused(with_header(single(entry("F32", "2", "[0,8]")), 8), "dimensions");
    refused(with_header(single(entry("F32", "[1,1,1,1,1,1,1,1,2]", "[0,8]")), 8), "9 dimensions");
    refused(with_header(single(entry("F32", "[4611686018427387906]", "[0,8]")), 8), "2^64");  // wraps to 8
    refused(with_header(single(entry("F32", "[4294967296,4294967296,4]", "[0,0]")), 0), "2^64");
    refused(with_header(single(entry("F32", "[3]", "[0,8]")), 8), "12 for shape [3]");
    refused(with_header(single(entry("F32", "[2]", "[8,0]")), 8), "a range within");
    refused(with_header(single(entry("F32", "[2]", "[0,18446744073709551615]")), 8), "a range within");
    refused(with_header(single(entry("F32", "[2]", "[0,18446744073709551616]")), 8), "two whole numbers");
    refused(with_header(single(entry("F32", "[2]", "[-8,0]")), 8), "two whole numbers");
    refused(with_header("{\"a\":" + entry("F32", "[2]", "[0,8]") + ",\"b\":" + entry("F32", "[2]", "[4,12]") + "}", 12),
            "gap or overlap");
    refused(with_header("{\"a\":" + entry("F32", "[1]", "[0,4]") + ",\"b\":" + entry("F32", "[1]", "[8,12]") + "}", 12),
            "gap or overlap");
    refused(with_header("{\"__metadata__\":{\"k\":1}}", 0), "expected a string");
    refused(with_header("{\"__metadata__\":[]}", 0), "object of strings");
    // What runs code when it is loaded is named.
    refused("PK\x03\x04" + std::string(40, '\0'), "a zip archive");
    refused("\x80\x02}q\x01." + std::string(40, '\0'), "a pickle");
    refused("version https://git-lfs.github.com/spec/v1", "Git LFS");
}

TEST_CASE("weight files: shards lie beside their index and hold what it says", "[weights]") {
    const Scratch s;
    const std::string one = with_header("{\"a\":" + entry("F32", "[1]", "[0,4]") + "}", 4);
    const std::string two = with_header("{\"b\":" + entry("F32", "[1]", "[0,4]") + "}", 4);
    s.file("m-1.safetensors", one);
    s.file("m-2.safetensors", two);
    const auto index = [&](const std::string& map) { return s.file("model.safetensors.index.json", "{\"weight_map\":" + map + "}"); };
    const auto fails = [&](const fs::path& path) {
        try {
            TensorFiles f(path);
        } catch (const Error& e) {
            return std::string(e.what());
        }
        return std::string();
    };
    const fs::path good = index(R"({"a":"m-1.safetensors","b":"m-2.safetensors"})");
    CHECK(TensorFiles(good).tensors().size() == 2);
    CHECK(TensorFiles(s.folder).find("b"));  // the folder stands for its index
    CHECK(fails(index(R"({"a":"m-1.safetensors","c":"m-2.safetensors"})")).find("c: got no such tensor") != std::string::npos);
    CHECK(fails(index(R"({"a":"m-1.safetensors","b":"m-1.safetensors"})")).find("b: got no such tensor") != std::string::npos);
    s.file("m-3.safetensors", with_header("{\"b\":" + entry("F32", "[1]", "[0,4]") + ",\"d\":" + entry("U8", "[0]", "[4,4]") + "}", 4));
    CHECK(fails(index(R"({"a":"m-1.safetensors","b":"m-3.safetensors"})")).find("d: got a tensor that the index") != std::string::npos);
    for (const char* path : {"../m-1.safetensors", "/etc/passwd", "", "m-1.bin", "sub/m-1.safetensors"})
        CHECK(fails(index(std::string("{\"a\":\"") + path + "\"}")).find("beside the index") != std::string::npos);
    CHECK(fails(index(R"({"a":"none.safetensors"})")).find("none.safetensors") != std::string::npos);
    CHECK(fails(index("7")).find("weight_map") != std::string::npos);
    CHECK(fails(s.folder / "nothing.safetensors").find("nothing.safetensors") != std::string::npos);
    CHECK(fails("/dev/zero").find("/dev/zero") != std::string::npos);
}
