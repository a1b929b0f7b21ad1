// SPDX-License-Identifier: Apache-2.0
// Role: EXR, by OpenEXR itself. OpenImageIO would do it too, but takes 240 ms of loading its 260 libraries (OpenEXR: 2),
// which is more than a mask takes. The only file of the core that includes OpenEXR.
#pragma once
#include "embree_core/image_formats.h"

namespace vshift::formats {

/// The wanted channels (empty: all) of a file that `claim` describes, and its text attributes. In the order R, G, B, A, Z,
/// then by name. Throws Error bad_input.
void decode_exr(const std::filesystem::path& file, const std::string& bytes, const std::vector<std::string>& wanted,
                Decoded& out);

/// float32 and float16; ZIP. The same image gives the same bytes, and without a date in it. Throws Error io_failed.
std::string encode_exr(const std::filesystem::path& file, const Channels& image, const std::vector<SampleType>& types);

}  // namespace vshift::formats
