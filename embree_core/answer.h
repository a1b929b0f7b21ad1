// SPDX-License-Identifier: Apache-2.0
// Role: from a recipe and a request to the channels of the answer: reads the files that the request
// needs, runs mask | holes | warp | seam | condition. The command line and the plugin both call this, so
// they give the same pixels.
#pragma once
#include <map>
#include <memory>
#include <string>

#include "embree_core/image_file.h"
#include "embree_core/recipe.h"

namespace vshift {

struct ViewRoom;

/// Depth maps and pictures that several requests of one frame share, and the memory in which views are made, which the
/// next one uses again. Not safe across threads.
class FrameFiles {
public:
    explicit FrameFiles(const Recipe& recipe);
    ~FrameFiles();
    /// Ready to lift: what is estimated from pictures has its silhouettes snapped.
    const DepthMap& depth(const Request& request, const std::string& camera);
    /// Of a depth map that has been read: as the request, else the recipe, else the file says.
    DepthSource depth_source(const Request& request, const std::string& camera) const;
    DepthRules depth_rules(const Request& request, const std::string& camera) const;
    const ColorImage& color(const std::string& camera, int frame);
    ViewRoom& room() { return *room_; }

private:
    void keep_frame(int frame);
    const Recipe& recipe_;
    int frame_ = -1;
    std::map<std::string, DepthMap> depths_, snapped_;
    std::map<std::string, SampleType> stored_;
    std::map<std::string, ColorImage> colors_;
    std::unique_ptr<ViewRoom> room_;
};

struct AnswerTimes {
    double read_ms = 0, lift_ms = 0, build_ms = 0, cast_ms = 0;
};

struct Answer {
    Channels image;             ///< channels as in contract order; metadata says what was asked and counted
    std::vector<float> seam_z;  ///< of a seam in the shifted view: Z of what it shows; inf sky, NaN nothing
    uint64_t invalid_px = 0;    ///< pixels of the own depth map without a measurement
    uint64_t sky_px = 0;
    uint64_t kept_quads = 0, torn_quads = 0;  ///< over all views that were lifted
    uint64_t triangles = 0;                   ///< of both kinds, likewise
    uint64_t tiles = 0;                       ///< of the height field, where there is no mesh
    uint64_t bvh_bytes = 0;                   ///< what the ray tracer held for them
    bool centre_hidden = false;               ///< V's centre lies behind what the own camera saw: hidden space
    AnswerTimes times;
};

/// The files that an answer is made from: depth maps, and pictures where it has colours. `request.camera`
/// names one camera.
std::vector<std::filesystem::path> input_files(const Recipe& recipe, const Request& request);

/// `request.camera` names one camera. Throws Error (recipe, files, sizes).
Answer answer(const Recipe& recipe, const Request& request, FrameFiles& files);

}  // namespace vshift
