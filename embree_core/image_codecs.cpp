// SPDX-License-Identifier: Apache-2.0
// Role: the samples of PFM and NPY files, to and from bytes. Claims have been checked before.
#include <bit>
#include <cstring>
#include <limits>
#include <utility>

#include "embree_core/image_formats.h"

namespace vshift::formats {
namespace {

template <class T>
T load(const char* from, bool big_endian) {
    unsigned char raw[sizeof(T)];
    std::memcpy(raw, from, sizeof(T));
    if (big_endian != (std::endian::native == std::endian::big))
        for (size_t i = 0; i < sizeof(T) / 2; ++i) std::swap(raw[i], raw[sizeof(T) - 1 - i]);
    T value;
    std::memcpy(&value, raw, sizeof(T));
    return value;
}

template <class T>
void store_le(std::string& out, T value) {
    unsigned char raw[sizeof(T)];
    std::memcpy(raw, &value, sizeof(T));
    if (std::endian::native == std::endian::big)
        for (size_t i = 0; i < sizeof(T) / 2; ++i) std::swap(raw[i], raw[sizeof(T) - 1 - i]);
    out.append(reinterpret_cast<const char*>(raw), sizeof(T));
}

float narrowed(double value) {
    constexpr double top = std::numeric_limits<float>::max();
    constexpr float infinite = std::numeric_limits<float>::infinity();
    return value > top ? infinite : value < -top ? -infinite : float(value);
}

}  // namespace

std::vector<std::vector<float>> decode_pfm(std::string_view bytes, const Claim& claim) {
    const size_t w = size_t(claim.width), h = size_t(claim.height), n = size_t(claim.channels);
    std::vector<std::vector<float>> planes(n, std::vector<float>(w * h));
    const char* from = bytes.data() + claim.data_offset;
    for (size_t row = 0; row < h; ++row)
        for (size_t x = 0; x < w; ++x)
            for (size_t c = 0; c < n; ++c, from += 4)
                planes[c][(h - 1 - row) * w + x] = load<float>(from, claim.big_endian);
    return planes;
}

std::vector<std::vector<float>> decode_npy(std::string_view bytes, const Claim& claim) {
    const size_t count = size_t(claim.width) * size_t(claim.height), n = size_t(claim.channels);
    std::vector<std::vector<float>> planes(n, std::vector<float>(count));
    const char* from = bytes.data() + claim.data_offset;
    const size_t step = sample_bytes(claim.stored);
    for (size_t i = 0; i < count; ++i)
        for (size_t c = 0; c < n; ++c, from += step) switch (claim.stored) {
                case Stored::uint8:
                    planes[c][i] = load<uint8_t>(from, false);
                    break;
                case Stored::uint16:
                    planes[c][i] = load<uint16_t>(from, false);
                    break;
                case Stored::float64:
                    planes[c][i] = narrowed(load<double>(from, false));
                    break;
                default:
                    planes[c][i] = load<float>(from, false);
                    break;
            }
    return planes;
}

std::string encode_pfm(const Channels& image) {
    const size_t w = size_t(image.width), h = size_t(image.height), n = image.planes.size();
    std::string out = (n == 3 ? "PF\n" : "Pf\n") + std::to_string(w) + " " + std::to_string(h) + "\n-1.0\n";
    out.reserve(out.size() + 4 * w * h * n);
    for (size_t row = h; row-- > 0;)
        for (size_t x = 0; x < w; ++x)
            for (size_t c = 0; c < n; ++c) store_le(out, image.planes[c][row * w + x]);
    return out;
}

std::string encode_npy(const Channels& image, SampleType type) {
    const size_t count = size_t(image.width) * size_t(image.height), n = image.planes.size();
    const char* descr = type == SampleType::uint8 ? "|u1" : type == SampleType::uint16 ? "<u2" : "<f4";
    std::string dict = std::string("{'descr': '") + descr + "', 'fortran_order': False, 'shape': (" +
                       std::to_string(image.height) + ", " + std::to_string(image.width) +
                       (n > 1 ? ", " + std::to_string(n) : "") + "), }";
    dict.append(63 - (10 + dict.size()) % 64, ' ');  // numpy aligns the data to 64 bytes
    dict += '\n';
    std::string out("\x93NUMPY\x01\x00", 8);
    store_le(out, uint16_t(dict.size()));
    out += dict;
    out.reserve(out.size() + 4 * count * n);
    for (size_t i = 0; i < count; ++i)
        for (size_t c = 0; c < n; ++c) {
            const float value = image.planes[c][i];
            if (type == SampleType::uint8)
                store_le(out, uint8_t(quantize(value, 255)));
            else if (type == SampleType::uint16)
                store_le(out, uint16_t(quantize(value, 65535)));
            else
                store_le(out, value);
        }
    return out;
}

uint32_t quantize(float value, uint32_t top) {
    if (!(value > 0)) return 0;
    if (value >= 1) return top;
    return uint32_t(double(value) * top + 0.5);
}

}  // namespace vshift::formats
