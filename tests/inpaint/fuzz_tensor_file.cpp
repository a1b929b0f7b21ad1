// SPDX-License-Identifier: Apache-2.0
// Mutates weight files and feeds them to the reader and the layout check: everything is taken or refused with a
// message, and every byte of what is taken is there to be read. Built with the sanitizers, which end it at a fault.
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <random>

#include "inpaint/wan_layout.h"

using namespace vshift;
using namespace vshift::inpaint;

namespace {

std::string seed_file(int kind) {
    std::vector<StoredTensor> tensors;
    static const std::vector<uint8_t> zeros(1 << 20, 0);
    if (kind == 0) {
        DitConfig c;
        c.in_channels = c.out_channels = 2;
        c.dim = c.ffn_dim = c.freq_dim = 8;
        c.heads = c.layers = 1;
        c.text_dim = 0;
        for (const auto& [name, shape] : dit_layout(c)) {
            size_t bytes = 4;
            for (const int64_t n : shape) bytes *= size_t(n);
            tensors.push_back({name, ElementType::f32, shape, zeros.data(), bytes});
        }
        return encode_tensor_file(tensors, {{"config", json_of(c).dump()}});
    }
    for (int i = 0; i < 3; ++i)
        tensors.push_back({"t" + std::to_string(i), ElementType(3 * i), {i, 2}, zeros.data(),
                           size_t(2 * i) * bytes_of(ElementType(3 * i))});
    return encode_tensor_file(tensors, {{"a", "b"}});
}

std::string mutated(std::string text, std::mt19937& random) {
    static const char* pieces[] = {"\"", "{", "}", "[", "]", ",", ":", "-1", "1e9", "18446744073709551615", "0", "null",
                                   "\"F32\"", "\"data_offsets\"", "\"shape\"", "\\u0000", "\xff", "[[[[", "__metadata__",
                                   "9223372036854775807", "true", "1.5"};
    const auto below = [&](size_t n) { return size_t(random() % std::max<size_t>(n, 1)); };
    for (size_t edits = 1 + below(6); edits > 0; --edits) {
        const size_t at = below(text.size());
        switch (below(8)) {
            case 0: if (!text.empty()) text[at] = char(random()); break;
            case 1: if (!text.empty()) text[at] = char(text[at] ^ (1 << below(8))); break;
            case 2: text.insert(at, pieces[below(std::size(pieces))]); break;
            case 3: text.erase(at, 1 + below(16)); break;
            case 4: text.resize(at); break;
            case 5: text.insert(at, text.substr(below(text.size()), below(64))); break;
            case 6: if (text.size() > 8) text[below(8)] = char(random()); break;
            default: {  // a digit becomes another: sizes and offsets that nearly fit
                const size_t d = text.find_first_of("0123456789", at);
                if (d != std::string::npos) text[d] = char('0' + below(10));
            }
        }
    }
    if (below(3) == 0 && text.size() > 8) {  // let the stated header length fit again
        const size_t end = text.rfind('}');
        const uint64_t n = end == std::string::npos || end < 8 ? text.size() - 8 : end - 7;
        for (int i = 0; i < 8; ++i) text[size_t(i)] = char(uint8_t(n >> (8 * i)));
    }
    return text;
}

}  // namespace

int main(int argc, char** argv) {
    double seconds = 30;
    uint32_t seed = 1;
    for (int i = 1; i + 1 < argc; i += 2) {
        if (!std::strcmp(argv[i], "--seconds")) seconds = std::atof(argv[i + 1]);
        if (!std::strcmp(argv[i], "--seed")) seed = uint32_t(std::atoi(argv[i + 1]));
    }
    std::mt19937 random(seed);
    const auto start = std::chrono::steady_clock::now();
    const std::string seeds[] = {seed_file(0), seed_file(1)};
    std::vector<std::string> corpus(seeds, seeds + 2);
    uint64_t runs = 0, taken = 0, configs = 0, sum = 0;
    while (std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count() < seconds) {
        const std::string bytes = mutated(corpus[random() % corpus.size()], random);
        // An exact copy on the heap: a read one byte past its end is seen.
        const std::unique_ptr<char[]> exact(new char[bytes.size()]);
        std::memcpy(exact.get(), bytes.data(), bytes.size());
        ++runs;
        try {
            const TensorDirectory d = parse_tensor_file({exact.get(), bytes.size()}, "fuzz");
            ++taken;
            for (const StoredTensor& t : d.tensors)
                for (size_t i = 0; i < t.bytes; ++i) sum += t.data[i];
            if (corpus.size() < 2000) corpus.push_back(bytes);
            if (const auto at = d.metadata.find("config"); at != d.metadata.end()) {
                const auto json = nlohmann::json::parse(at->second, nullptr, false);
                dit_layout(parse_dit_config(json, "fuzz"));
                ++configs;
            }
        } catch (const Error& e) {
            if (e.code() == ExitCode::our_bug || std::strlen(e.what()) > 1000) {
                std::printf("finding: %s\n", e.what());
                return 1;
            }
        }
    }
    std::printf("%llu files, %llu taken, %llu with a configuration, no finding (%llu)\n", (unsigned long long)runs,
                (unsigned long long)taken, (unsigned long long)configs, (unsigned long long)sum);
    return taken > 0 && taken < runs ? 0 : 1;  // a fuzzer that takes or refuses everything tests nothing
}
