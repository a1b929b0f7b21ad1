// SPDX-License-Identifier: Apache-2.0
// Role: the recipe (a .vshift file) and the request: load, validate, resolve. Stage: rig.
// The grammar is docs/formats.md; every message has the form `file: camera: field: got X, expected Y`.
#pragma once
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "embree_core/camera.h"
#include "embree_core/depth_source.h"
#include "embree_core/degrade.h"
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

/// A longer shift along any axis is refused.
inline constexpr double longest_shift_m = 1e6;

/// Which cameras' geometry answers a request.
enum class Source { self, rig };

/// One resolved request: the same keys for the command line, the plugin and the recipe's defaults.
struct Request {
    std::string camera;  ///< empty or "*": every camera
    int frame = 0;
    Shift shift;
    std::string out = "mask";
    Source from = Source::self;
    std::string view;  ///< "recorded" or "shifted"; empty: the default of `out` (see `chosen_view`)
    double tolerance_px = 0;
    std::string method = "auto";  ///< see `chosen_method`
    double clear_m = 2.0;
    std::optional<DepthSource> depth_source;  ///< none: as each camera of the recipe says
    bool certify = false;                     ///< of a mask: say where it hinges on a silhouette's place within a pixel
    // Colours: warp, seam, condition.
    std::string edge = "drop";          ///< "drop" or "keep": the far side's last half pixel at a tear
    std::string match = "none";         ///< "none", "exposure" or "color"
    double depth_tolerance = 0.02;      ///< share by which two depths of one surface may differ
    std::string arm = "virtual_shift";  ///< of a condition; see condition.h
    int stride = 1;                     ///< of a condition, in pixels
    Degradations noise;
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

/// The recipe's defaults with `key=value` pairs laid over them, strictly parsed and checked
/// against the recipe (cameras, frames). `where` leads each message, e.g. the recipe's file name.
Request resolve_request(const Recipe& recipe, const std::vector<std::pair<std::string, std::string>>& pairs);

/// The request with `text` set as its `key`: the one parser of request values.
void set_request_key(Request& request, const std::string& key, const std::string& text, const std::string& where);

/// Every key of a request with its value, `camera=A&frame=0&shift=0,1,0&...`: two requests that ask for the
/// same have the same text, and `resolve_request` takes it back.
std::string canonical_text(const Request& request);

/// "sweep", "raster" or "embree": what the request names, or, for "auto", the fastest that can answer.
std::string chosen_method(const Request& request);

/// "recorded" or "shifted".
std::string chosen_view(const Request& request);

/// Cameras that a request asks for: the one it names, or all.
std::vector<std::string> requested_cameras(const Recipe& recipe, const Request& request);

/// Strict, locale-free: the whole text must be one finite number. Throws Error bad_input.
double parse_number(const std::string& text, const std::string& where);

/// The known word nearest to `word` (edit distance), for messages.
std::string nearest_word(const std::string& word, const std::vector<std::string>& known);

}  // namespace vshift
