// SPDX-License-Identifier: Apache-2.0
// Role: what is asked of a recipe: keys and values, from the command line, the plugin and the recipe alike.
// The grammar is docs/formats.md.
#pragma once
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "embree_core/degrade.h"
#include "embree_core/depth_source.h"
#include "embree_core/types.h"

namespace vshift {

struct Recipe;

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

/// Throws Error bad_input where the recipe cannot answer the request.
void check_request(const Recipe& recipe, const Request& request, const std::string& where);

/// The names of all keys.
const std::vector<std::string>& request_keys();

/// A depth source's word, "auto" (none) included.
std::optional<DepthSource> depth_source_of(const std::string& text, const std::string& where);

}  // namespace vshift
