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
    std::vector<std::vector<float>> planes;       ///< one plane of width * height per name
    std::map<std::string, std::string> metadata;  ///< string attributes
    std::string file;                             ///< where it was read from, for messages; may be empty

    const std::vector<float>& plane(const std::string& name) const;  ///< throws Error bad_input
    bool has(const std::string& name) const;
    void add(const std::string& name, std::vector<float> plane);
    /// Channels R, G and B.
    void add_color(const ColorImage& color);
    ColorImage color() const;  ///< throws Error bad_input where one of them is not there
};

/// How samples are stored: float, half (EXR only), or 16-bit / 8-bit integer (PNG).
enum class SampleType { float32, float16, uint16, uint8 };

/// Largest image that is read or written: 16384 x 16384 pixels, and 1 GiB of decoded floats.
inline constexpr int max_image_side = 16384;
inline constexpr size_t max_decoded_bytes = size_t(1) << 30;

/// All channels of an EXR, PNG, JPEG, PFM or NPY file as float; the first bytes say which it is.
/// Integer files come as 0..1 floats except through `read_depth`. Channels without names are Y; Y, A;
/// R, G, B; R, G, B, A; or 0, 1, 2 and so on. Refuses anything but regular files, EXR of several
/// parts or with a data window that is not the display window, NPY in Fortran order, and PFM whose
/// scale is neither 1 nor -1. Throws Error: io_failed when it cannot be read, bad_input for what it
/// holds (a cut file too), over_limit for its size, checked before anything is allocated.
Channels read_image(const std::filesystem::path& file);

/// Depth in metres: EXR channel `channel`, single-channel PFM or NPY, or 16-bit PNG, times
/// `scale_m` (metres per stored unit, > 0; units of 16-bit PNG and NPY are the stored integers).
/// 8-bit files are refused. Checks the size against `width` x `height` when these are > 0. `stored`, where given,
/// becomes how the samples lie in the file.
DepthMap read_depth(const std::filesystem::path& file, const std::string& channel, double scale_m, int width,
                    int height, SampleType* stored = nullptr);

/// Linear RGB of an image file: integer samples (PNG, JPEG, integer NPY) are decoded from sRGB, floats
/// are linear. One grey integer channel is spread to three; alpha is ignored.
ColorImage read_color(const std::filesystem::path& file, int width, int height);

/// Writes EXR (ZIP), PNG (8- or 16-bit), PFM (1 or 3 channels) or NPY (H x W or H x W x C) by the
/// file's ending: encode to memory, write beside, fsync, rename. `types` holds one entry per channel
/// or a single entry for all; EXR takes float32 and float16, PNG uint16 or uint8, PFM float32, NPY
/// float32, uint16 or uint8. Integers are the 0..1 samples rounded and clamped (NaN is 0), never
/// sRGB-encoded. The same image gives the same bytes. Folders are not created, a symbolic link is
/// followed. Throws Error: io_failed, and then an old file stays as it was and nothing is left behind;
/// bad_input for an ending, type or channel count that does not fit; over_limit.
void write_image(const std::filesystem::path& file, const Channels& image,
                 const std::vector<SampleType>& types = {SampleType::float32});

/// The same guarantee for any bytes (JSON, CSV, HTML).
void write_whole_file(const std::filesystem::path& file, const std::string& bytes);

/// Removes what killed runs of this machine left below `folder` (the temporary files of `write_...`).
void remove_stale_temporaries(const std::filesystem::path& folder);

/// Reads a regular file of at most `limit_bytes`. Throws Error io_failed / over_limit.
std::string read_whole_file(const std::filesystem::path& file, size_t limit_bytes);

}  // namespace vshift
