// SPDX-License-Identifier: Apache-2.0
// Role: a model as one more way to fill a view's holes, frame after frame. Stage: inpaint. No Torch here: the library
// that has it is loaded on construction.
#pragma once
#include <string>
#include <vector>

#include "embree_core/fill.h"
#include "inpaint/c_api.h"

namespace vshift::inpaint {

/// A view to fill, and which of its pixels a neighbour gave (by a seam); null: none. Models that were trained with
/// neighbours see that and may change those pixels; to others they are known ones.
struct NetworkView {
    HoledView view;
    const Mask* neighbor = nullptr;
};

/// A model and one stream of it at a time. Throws Error: io_failed without the library or the file, bad_input for what
/// the file holds.
class NetworkFill {
public:
    /// `steps` counts for flow models; `threads` are Torch's, 0: all_threads().
    explicit NetworkFill(const std::string& model_file, int steps = 1, uint64_t noise_seed = 1, int threads = 0);
    ~NetworkFill();
    NetworkFill(const NetworkFill&) = delete;
    NetworkFill& operator=(const NetworkFill&) = delete;

    /// Whether a frame depends on those before it, so that the frames of a camera and shift must come in order.
    bool looks_back() const { return looks_back_; }
    /// A new stream: what came before is forgotten.
    void begin();
    /// Frames to a piece, after a stream's first, which is one frame.
    int piece() const { return piece_; }
    /// The stream's next piece, of one size; at its end fewer frames will do (the last is then taken again: a latent's
    /// frames are made together). Known pixels come back bit for bit, as from fill(). Linear RGB. Where the model does
    /// not look back, each is a stream of its own.
    std::vector<ColorImage> next(const std::vector<NetworkView>& views);

private:
    const int steps_;
    const uint64_t noise_seed_;
    vshift_inpaint_model* model_ = nullptr;
    bool looks_back_ = false, neighbors_ = false, begun_ = false;
    int piece_ = 1;
    vshift_inpaint_stream* stream_ = nullptr;
};

}  // namespace vshift::inpaint
