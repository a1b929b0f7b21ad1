// SPDX-License-Identifier: Apache-2.0
// Role: what OpenImageIO does for the core: PNG, JPEG and the push-pull fill. Its 260 libraries take 240 ms to load, so
// programs of ours load it when it is asked for (pictures_on_demand.cpp, libvshift_pictures.so); the OpenImageIO plugin,
// whose host has it anyway, links it (pictures_linked.cpp). The only header between the two.
#pragma once
#include "embree_core/fill.h"
#include "embree_core/image_formats.h"

namespace vshift {

struct Pictures {
    /// Throws Error: bad_input for a broken file, io_failed when OpenImageIO lacks the format.
    void (*decode)(const std::filesystem::path& file, const std::string& bytes, formats::Decoded& out);
    /// 8 or 16 bits, 1 to 4 channels. Throws Error io_failed.
    std::string (*encode_png)(const std::filesystem::path& file, const Channels& image, SampleType type);
    ColorImage (*fill_pushpull)(const HoledView& view);
};

/// Throws Error io_failed when it cannot be loaded.
const Pictures& pictures();

/// The one implementation (pictures_oiio.cpp).
const Pictures& pictures_by_oiio();

}  // namespace vshift
