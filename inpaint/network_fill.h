// SPDX-License-Identifier: Apache-2.0
// Role: a model as one more way to fill a view's holes, frame after frame. Stage: inpaint. No Torch here: the library
// that has it is loaded on construction.
#pragma once
#include <map>
#include <string>

#include "embree_core/fill.h"
#include "inpaint/c_api.h"

namespace vshift::inpaint {

/// A model and its streams: one for each camera and shift, whose frames come in order. Throws Error: io_failed without
/// the library or the file, bad_input for what the file holds.
class NetworkFill {
public:
    /// `steps` counts for flow models; `threads` are Torch's, 0: as many as there are cores.
    explicit NetworkFill(const std::string& model_file, int steps = 1, uint64_t noise_seed = 1, int threads = 0);
    ~NetworkFill();
    NetworkFill(const NetworkFill&) = delete;
    NetworkFill& operator=(const NetworkFill&) = delete;

    /// The next frame of `stream`. Known pixels come back bit for bit, as from fill(). Linear RGB.
    ColorImage next(const HoledView& view, const std::string& stream = "");

private:
    const int steps_;
    const uint64_t noise_seed_;
    vshift_inpaint_model* model_ = nullptr;
    bool looks_back_ = false;  ///< frames depend on those before
    std::map<std::string, vshift_inpaint_stream*> streams_;
};

}  // namespace vshift::inpaint
