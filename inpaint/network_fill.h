// SPDX-License-Identifier: Apache-2.0
// Role: a model as one more way to fill a view's holes, frame after frame. Stage: inpaint. No Torch here: the library
// that has it is loaded on construction.
#pragma once
#include <memory>
#include <string>

#include "embree_core/fill.h"
#include "inpaint/c_api.h"

namespace vshift::inpaint {

/// One stream: the frames of one camera and shift, in order. Throws Error: io_failed without the library or the file,
/// bad_input for what the file holds.
class NetworkFill {
public:
    NetworkFill(const std::string& model_file, int steps, uint64_t noise_seed, int threads);
    ~NetworkFill();
    NetworkFill(const NetworkFill&) = delete;
    NetworkFill& operator=(const NetworkFill&) = delete;

    /// Known pixels come back bit for bit, as from fill(). Linear RGB.
    ColorImage next(const HoledView& view);
    const std::string& config() const { return config_; }  ///< the model's, as JSON

private:
    vshift_inpaint_model* model_ = nullptr;
    vshift_inpaint_stream* stream_ = nullptr;
    std::string config_;
};

}  // namespace vshift::inpaint
