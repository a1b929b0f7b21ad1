// SPDX-License-Identifier: Apache-2.0
// Role: what an image file's own header claims, read without trust and before anything is
// allocated, and the two formats small enough to read and write here: PFM and NPY. No OpenImageIO.
#pragma once
#include <cstdint>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "embree_core/image_file.h"

namespace vshift::formats {

enum class Kind { exr, png, jpeg, pfm, npy };

/// What one stored sample is.
enum class Stored { uint8, uint16, float32, float64, other };

/// Bytes of one stored sample of a PFM or NPY file.
size_t sample_bytes(Stored stored);

/// What the header says. Sizes are the file's word: not yet checked against any limit.
struct Claim {
    Kind kind = Kind::exr;
    int64_t width = 0, height = 0, channels = 0;
    Stored stored = Stored::other;
    // EXR only
    std::map<std::string, int> exr_types;  ///< channel name -> 0 uint, 1 half, 2 float
    // PFM and NPY only
    size_t data_offset = 0;
    bool big_endian = false;
};

/// Samples as stored: a sample divided by `unit_top` is the 0..1 value (1 for float files).
struct Decoded {
    Claim claim;
    Channels image;
    double unit_top = 1;
};

/// `got Depth, expected one of R, G, B, Z (nearest: Z)`.
std::string unknown_channel(const std::string& name, const std::vector<std::string>& names);
/// Whether a text attribute describes the encoding, not the picture.
bool is_encoding_key(const std::string& key);

/// Reads the header from the first bytes of a file of `file_size` bytes. Empty when the header goes
/// on past `head`: call again with more. Throws Error bad_input for an unknown or broken file.
std::optional<Claim> read_claim(const std::filesystem::path& file, std::string_view head, uint64_t file_size);

/// Throws Error over_limit when a size is more than image_file.h allows, with the estimate.
void check_limits(const std::filesystem::path& file, int64_t width, int64_t height, int64_t channels);

/// The file goes on to its end mark (PNG, JPEG) or has exactly the bytes claimed (PFM, NPY).
/// Throws Error bad_input.
void check_whole(const std::filesystem::path& file, std::string_view bytes, const Claim& claim);

/// The samples of a PFM or NPY file as stored numbers, one plane per channel, row 0 on top.
/// `claim` has passed check_limits and check_whole.
std::vector<std::vector<float>> decode_pfm(std::string_view bytes, const Claim& claim);
std::vector<std::vector<float>> decode_npy(std::string_view bytes, const Claim& claim);

/// The bytes of a file; planes have width * height samples each. `encode_pfm` takes 1 or 3 planes.
std::string encode_pfm(const Channels& image);
std::string encode_npy(const Channels& image, SampleType type);

/// A 0..1 sample as an integer of 0..`top`: rounded, clamped; NaN is 0.
uint32_t quantize(float value, uint32_t top);

}  // namespace vshift::formats
