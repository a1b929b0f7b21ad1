// SPDX-License-Identifier: Apache-2.0
// Role: a user's monocular depth estimator as TorchScript, a program of its author: the caller has asked for trust.
// Stage: before lift. The one place that includes Torch's script loader.
#pragma once
#include <memory>

#include "inpaint/torch_api.h"

namespace vshift::inpaint {

/// Whether a file is a zip archive, as TorchScript is. False for a file that cannot be read.
bool is_script(const std::string& file);

class DepthScript {
public:
    /// Throws Error bad_input for what it cannot load.
    explicit DepthScript(const std::string& file);
    ~DepthScript();

    /// `color` [1, 3, H, W] in 0..1; planar z in metres, [H, W], NaN where the module gave none above 0. Throws Error
    /// bad_input when it fails or gives another shape.
    at::Tensor depth_of(const at::Tensor& color) const;

private:
    struct Module;
    std::string file_;
    std::unique_ptr<Module> module_;
};

}  // namespace vshift::inpaint
