// SPDX-License-Identifier: Apache-2.0
// Role: image files in and out (EXR, PNG, PFM, NPY). The only file of the core that includes
// OpenImageIO. Reads are checked before anything is allocated; writes are whole or not at all.
#pragma once
#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "embree_core/types.h"

namespace vshift {

/// Named float channels of one size.
struct Channels {
    int width = 0;
    int height = 0;
    std::vector<std::string> names;
    std::vector<std::vector<float>> planes;  ///< one plane of width * height per name
    std::map<std::string, std::string> metadata;  ///< string attributes

    const std::vector<float>& plane(const std::string& name) const;  ///< throws Error bad_input
    bool has(const std::string& name) const;
    void add(const std::string& name, std::vector<float> plane);
};

/// How samples are stored: float, half (EXR only), or 16-bit / 8-bit integer (PNG).
enum class SampleType { float32, float16, uint16, uint8 };

/// Largest image that is read or written: 16384 x 16384 pixels, and 1 GiB of decoded floats.
inline constexpr int max_image_side = 16384;
inline constexpr size_t max_decoded_bytes = size_t(1) << 30;

/// All channels of an EXR, PNG, PFM or NPY file as float. Integer files come as 0..1 floats except
/// through `read_depth`. Refuses anything but regular files. Throws Error io_failed / bad_input /
/// over_limit.
Channels read_image(const std::filesystem::path& file);

/// Depth in metres: EXR channel `channel`, single-channel PFM or NPY, or 16-bit PNG, times
/// `scale_m` (metres per stored unit; PNG units are the stored integers). Checks the size against
/// `width` x `height` when these are > 0.
DepthMap read_depth(const std::filesystem::path& file, const std::string& channel, double scale_m,
                    int width, int height);

/// Linear RGB of an image file (8-bit and 16-bit PNG are decoded from sRGB).
ColorImage read_color(const std::filesystem::path& file, int width, int height);

/// Writes EXR (ZIP), PNG (8- or 16-bit), PFM (1 or 3 channels) or NPY (H x W or H x W x C) by the
/// file's ending: encode to memory, write beside, fsync, rename. `types` holds one entry per channel
/// or a single entry for all. Throws Error io_failed; an old file stays as it was.
void write_image(const std::filesystem::path& file, const Channels& image,
                 const std::vector<SampleType>& types = {SampleType::float32});

/// The same guarantee for any bytes (JSON, CSV, HTML).
void write_whole_file(const std::filesystem::path& file, const std::string& bytes);

/// Reads a regular file of at most `limit_bytes`. Throws Error io_failed / over_limit.
std::string read_whole_file(const std::filesystem::path& file, size_t limit_bytes);

}  // namespace vshift
