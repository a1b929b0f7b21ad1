// SPDX-License-Identifier: Apache-2.0
// Role: depth maps from pictures alone, by a model of ours or a user's. Stage: before lift. No Torch here: the library
// that has it is loaded on construction.
#pragma once
#include <string>

#include "embree_core/camera.h"
#include "embree_core/types.h"
#include "inpaint/depth_api.h"

namespace vshift::inpaint {

class DepthEstimator {
public:
    /// `trust` lets a TorchScript module, a program of its author, be loaded; without it only safetensors are. Throws
    /// Error: io_failed without the library or the file, bad_input for what the file holds. `threads`: Torch's, 0: all_threads().
    explicit DepthEstimator(const std::string& model_file, bool trust = false, int threads = 0);
    ~DepthEstimator();
    DepthEstimator(const DepthEstimator&) = delete;
    DepthEstimator& operator=(const DepthEstimator&) = delete;

    /// Planar z in metres of a linear RGB picture; +inf in the sky, NaN where a user's model gave none.
    DepthMap depth(const ColorImage& color, const Intrinsics& intrinsics, const Pose& ego_from_cam) const;

private:
    vshift_depth_model* model_ = nullptr;
};

}  // namespace vshift::inpaint
