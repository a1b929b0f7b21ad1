// SPDX-License-Identifier: Apache-2.0
// Role: scenes as files: views as EXR with color and depth, recipes as JSON. Used by vshift-scenes.
#pragma once
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "embree_core/image_file.h"
#include "scenes/minimal/minimal.h"

namespace vshift::minimal {

/// "0007"
std::string frame_folder(size_t index);
nlohmann::ordered_json rotation_of(const glm::dmat3& rotation);  ///< w,x,y,z
nlohmann::ordered_json vector_of(const glm::dvec3& v);
Channels sized(int width, int height);
/// A channel that is 1 where any of the bits is set.
void add_flags(Channels& out, const std::string& name, const Grid<uint8_t>& flags, unsigned bits);
/// FOLDER/CAMERA.exr with R,G,B and, as `depth_kind` says ("exr", "png", "pfm", "npy"), Z in it or beside it.
void write_view(const std::filesystem::path& folder, const std::string& camera, const Picture& picture,
                const std::string& depth_kind);
/// The recipe of the rig and its frames, `dt_s` apart, with the scene's own request as default.
nlohmann::ordered_json recipe_of(const MinimalScene& s, const std::string& depth_kind, double dt_s = 0.1);

}  // namespace vshift::minimal
