// SPDX-License-Identifier: Apache-2.0
// Role: the recipe (a .vshift file): load, validate. Stage: rig.
// The grammar is docs/formats.md; every message has the form `file: camera: field: got X, expected Y`.
#pragma once
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "embree_core/camera.h"
#include "embree_core/depth_source.h"
#include "embree_core/request.h"
#include "embree_core/types.h"

namespace vshift {

/// One camera of the rig as the recipe states it. Paths are patterns relative to the recipe.
struct CameraSpec {
    std::string name;
    Intrinsics intrinsics;
    Pose ego_from_cam;
    std::string image;                        ///< may be empty: masks need depth only
    std::string depth;                        ///< EXR, 16-bit PNG, PFM or NPY; may be empty before vshift depth
    std::string depth_channel;                ///< for EXR; default "Z"
    double depth_scale_m = 1;                 ///< metres per stored unit (0.001 for millimetre PNG)
    std::optional<DepthSource> depth_source;  ///< none: as the file stores it
};

/// The ego's pose when a camera fired, where it differs from the frame's own.
struct CameraInstant {
    double timestamp_s = 0;
    Pose world_from_ego;
};

struct FrameSpec {
    int index = 0;
    double timestamp_s = 0;
    Pose world_from_ego;
    std::map<std::string, CameraInstant> cameras;
};

struct Recipe {
    std::filesystem::path file;
    std::vector<CameraSpec> cameras;
    std::vector<FrameSpec> frames;
    Request defaults;

    std::filesystem::path folder() const;  ///< where the recipe lies; "." when its name has no folder
    const CameraSpec& camera(const std::string& name) const;
    const FrameSpec& frame(int index) const;
    /// Absolute path of a camera's file in a frame; the pattern's %04d is the frame's index.
    std::filesystem::path path(const std::string& pattern, int frame_index) const;
    Pose world_from_ego(const std::string& camera, int frame_index) const;
    Pose world_from_cam(const std::string& camera, int frame_index) const;
};

/// Throws Error: bad_input for what the file says, io_failed when it cannot be read.
Recipe load_recipe(const std::filesystem::path& file);

/// Cameras that a request asks for: the one it names, or all.
std::vector<std::string> requested_cameras(const Recipe& recipe, const Request& request);

}  // namespace vshift
