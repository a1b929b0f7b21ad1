// SPDX-License-Identifier: Apache-2.0
// The layouts of Wan2.2's networks: a checkpoint of 5 billion parameters is checked without loading it.
#include <sys/resource.h>
#include <unistd.h>

#include <chrono>
#include <fstream>

#include "inpaint/wan_layout.h"
#include "tests/catch.h"

namespace fs = std::filesystem;
using namespace vshift;
using namespace vshift::inpaint;

namespace {

/// Shards of the layout as sparse files: headers, and holes where the numbers would be.
fs::path sparse_checkpoint(const fs::path& folder, const Layout& layout, size_t shards,
                           const std::function<std::string(const std::string&)>& rename, const std::string& dtype) {
    fs::create_directories(folder);
    nlohmann::json map;
    std::vector<nlohmann::ordered_json> headers(shards, nlohmann::ordered_json::object());
    std::vector<uint64_t> ends(shards, 0);
    size_t i = 0;
    for (const auto& [name, shape] : layout) {
        const size_t k = i++ * shards / layout.size();
        uint64_t bytes = dtype == "F32" ? 4 : 2;
        for (const int64_t n : shape) bytes *= uint64_t(n);
        headers[k][rename(name)] = {{"dtype", dtype}, {"shape", shape}, {"data_offsets", {ends[k], ends[k] + bytes}}};
        ends[k] += bytes;
        map[rename(name)] = "diffusion_pytorch_model-" + std::to_string(k + 1) + ".safetensors";
    }
    for (size_t k = 0; k < shards; ++k) {
        const fs::path file = folder / ("diffusion_pytorch_model-" + std::to_string(k + 1) + ".safetensors");
        const std::string header = headers[k].dump();
        std::string head;
        for (int b = 0; b < 8; ++b) head += char(uint8_t(uint64_t(header.size()) >> (8 * b)));
        std::ofstream(file, std::ios::binary) << head << header;
        fs::resize_file(file, 8 + header.size() + ends[k]);
    }
    const fs::path index = folder / "diffusion_pytorch_model.safetensors.index.json";
    std::ofstream(index) << nlohmann::json{{"metadata", {{"total_size", 0}}}, {"weight_map", map}}.dump();
    return index;
}

std::string told(const TensorFiles& files, const Layout& layout, Network network = Network::dit) {
    try {
        require_layout(files, layout, network);
    } catch (const Error& e) {
        return e.what();
    }
    return "";
}

struct Scratch {
    fs::path folder = fs::temp_directory_path() / ("vshift-layout-" + std::to_string(::getpid()));
    ~Scratch() { fs::remove_all(folder); }
};

std::string same(const std::string& name) {
    return name;
}

}  // namespace

TEST_CASE("layout: the sizes of Wan2.2 TI2V-5B", "[weights]") {
    uint64_t dit = 0, vae = 0;
    for (const auto& [name, shape] : dit_layout({})) {
        uint64_t n = 1;
        for (const int64_t s : shape) n *= uint64_t(s);
        dit += n;
    }
    for (const auto& [name, shape] : vae_layout({})) {
        uint64_t n = 1;
        for (const int64_t s : shape) n *= uint64_t(s);
        vae += n;
    }
    CHECK(dit_layout({}).size() == 825);
    CHECK(dit > 4.9e9);
    CHECK(dit < 5.1e9);
    CHECK(vae > 0.6e9);
    CHECK(vae < 0.8e9);
}

TEST_CASE("layout: names there and back", "[weights]") {
    for (const auto& [name, shape] : dit_layout({})) {
        CHECK(dit_name_to_diffusers(name) != name + "!");
        CHECK(dit_name_from_diffusers(dit_name_to_diffusers(name)) == name);
    }
    size_t starred = 0;
    for (const auto& [name, shape] : vae_layout({})) {
        const std::string back = vae_name_from_diffusers(vae_name_to_diffusers(name));
        if (back.find('*') != std::string::npos)
            ++starred;
        else
            CHECK(back == name);
    }
    CHECK(starred == 20);  // 3 + 3 resamplings, 2 + 2 of them in time: weights and biases
    CHECK(dit_name_to_diffusers("blocks.3.norm3.weight") == "blocks.3.norm2.weight");
    CHECK(dit_name_to_diffusers("blocks.3.modulation") == "blocks.3.scale_shift_table");
    CHECK(dit_name_to_diffusers("head.modulation") == "scale_shift_table");
    CHECK(vae_name_to_diffusers("encoder.downsamples.1.downsamples.2.time_conv.weight") ==
          "encoder.down_blocks.1.downsampler.time_conv.weight");
    CHECK(vae_name_to_diffusers("decoder.upsamples.2.upsamples.0.residual.6.bias") ==
          "decoder.up_blocks.2.resnets.0.conv2.bias");
    CHECK(vae_name_to_diffusers("decoder.middle.2.residual.3.gamma") == "decoder.mid_block.resnets.1.norm2.gamma");
}

TEST_CASE("layout: five billion parameters in shards are checked from their headers", "[weights]") {
    const Scratch scratch;
    const Layout layout = dit_layout({});
    for (const bool diffusers : {false, true}) {
        const fs::path folder = scratch.folder / (diffusers ? "diffusers" : "wan");
        const fs::path index = sparse_checkpoint(folder, layout, 3, diffusers ? dit_name_to_diffusers : same, "BF16");
        const auto start = std::chrono::steady_clock::now();
        const TensorFiles files(index);
        const auto found = require_layout(files, layout, Network::dit);
        const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
        rusage usage{};
        getrusage(RUSAGE_SELF, &usage);
        WARN("5B layout checked in " << seconds << " s, peak " << usage.ru_maxrss / 1024 << " MB");
        CHECK(found.size() == 825);
        CHECK(seconds < 2);
        CHECK(usage.ru_maxrss / 1024 < 300);
        // One at fault among 825, named as the file names it.
        const auto name = [&](const char* wan) { return diffusers ? dit_name_to_diffusers(wan) : std::string(wan); };
        Layout other = layout;
        other["blocks.7.extra.weight"] = {1};
        CHECK(told(files, other).find("1 missing (first blocks.7.extra.weight)") != std::string::npos);
        other = layout;
        other.erase("blocks.29.ffn.2.bias");
        CHECK(told(files, other).find("1 extra (first " + name("blocks.29.ffn.2.bias") + ")") != std::string::npos);
        other = layout;
        other["patch_embedding.weight"] = {3072, 96, 1, 2, 2};
        CHECK(told(files, other).find("1 misshapen (first patch_embedding.weight has shape [3072, 48, 1, 2, 2], "
                                      "expected [3072, 96, 1, 2, 2])") != std::string::npos);
    }
    const fs::path vae = sparse_checkpoint(scratch.folder / "vae", vae_layout({}), 2, vae_name_to_diffusers, "F32");
    CHECK(require_layout(TensorFiles(vae), vae_layout({}), Network::vae).size() == vae_layout({}).size());
}

TEST_CASE("layout: configurations are checked", "[weights]") {
    using nlohmann::json;
    const auto dit = [](const char* text) {
        try {
            parse_dit_config(json::parse(text), "m: config");
        } catch (const Error& e) {
            return std::string(e.what());
        }
        return std::string();
    };
    const auto vae = [](const char* text) {
        try {
            parse_vae_config(json::parse(text), "m: config");
        } catch (const Error& e) {
            return std::string(e.what());
        }
        return std::string();
    };
    CHECK(dit("{}").empty());
    CHECK(vae("{}").empty());
    CHECK(json(json_of(parse_dit_config(json::parse(R"({"dim":48,"heads":2,"patch":[1,8,8]})"), ""))) ==
          json(json_of(parse_dit_config(json(json_of(parse_dit_config(json::parse(R"({"dim":48,"heads":2,"patch":[1,8,8]})"), ""))), ""))));
    CHECK(dit(R"({"dims":48})").find("dims: got an unknown field") != std::string::npos);
    CHECK(dit(R"({"dim":1e9})").find("dim") != std::string::npos);
    CHECK(dit(R"({"dim":-8})").find("whole number from 8") != std::string::npos);
    CHECK(dit(R"({"dim":50,"heads":4})").find("even width") != std::string::npos);
    CHECK(dit(R"({"patch":[2,2,2]})").find("patch") != std::string::npos);
    CHECK(dit(R"({"patch":[1,2]})").find("list of 3") != std::string::npos);
    CHECK(dit(R"({"eps":0})").find("eps") != std::string::npos);
    CHECK(dit("[]").find("expected an object") != std::string::npos);
    CHECK(vae(R"({"dim_mult":[1,2],"temporal_down":[]})").find("one fewer") != std::string::npos);
    CHECK(vae(R"({"z_dim":2,"std":[1,0],"mean":[0,0]})").find("above 0") != std::string::npos);
    CHECK(vae(R"({"dim":8,"dim_mult":[1,3],"temporal_down":[false]})").find("divisor") != std::string::npos);
    CHECK(vae(R"({"temporal_down":[1,0,0]})").find("true or false") != std::string::npos);
}
