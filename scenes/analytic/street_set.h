// SPDX-License-Identifier: Apache-2.0
// Role: an analytic street as a benchmark set (docs/set_layout.md): recorded and true shifted views in color, truth
// classes, manifest. A minute where a renderer takes an hour, and several frames, so that intervals and scores over
// time have something to stand on.
#pragma once
#include <cstdint>
#include <filesystem>

namespace vshift::analytic {

struct StreetSetOptions {
    uint32_t seed = 1;
    int width = 400, height = 225, frames = 1;
    int samples = 2;  ///< n x n color samples per pixel
    std::filesystem::path folder;
};

/// Writes set.vshift, frames/, shifts/, truth/ and manifest.json for shifts of 1, 2 and 4 m to either side. Frames
/// stand 2 m apart (four steps of the drive).
void write_street_set(const StreetSetOptions& options);

}  // namespace vshift::analytic
