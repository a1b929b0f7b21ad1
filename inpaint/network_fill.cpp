// SPDX-License-Identifier: Apache-2.0
#include "inpaint/network_fill.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "embree_core/srgb.h"
#include "inpaint/network_library.h"
#include "inpaint/street_pairs.h"

namespace vshift::inpaint {
namespace {

/// Planes of frames as planes of a video: [channel][frame][pixel].
class Video {
public:
    Video(const std::vector<PairPlanes>& frames) : count_(frames.size()), pixels_(frames[0].hole.size()) {
        for (auto plane : {&PairPlanes::fill, &PairPlanes::hole, &PairPlanes::neighbor, &PairPlanes::inverse_depth}) {
            std::vector<float>& all = planes_.*plane;
            const size_t channels = (frames[0].*plane).size() / pixels_;
            all.resize(channels * count_ * pixels_);
            for (size_t c = 0; c < channels; ++c)
                for (size_t f = 0; f < count_; ++f)
                    std::copy_n((frames[f].*plane).begin() + std::ptrdiff_t(c * pixels_), pixels_, all.begin() + std::ptrdiff_t(at(c, f)));
        }
        planes_.width = frames[0].width, planes_.height = frames[0].height;
    }
    vshift_inpaint_views views() const {
        vshift_inpaint_views v = planes_.views();
        v.frames = int32_t(count_);
        return v;
    }
    size_t at(size_t channel, size_t frame) const { return (channel * count_ + frame) * pixels_; }

private:
    size_t count_, pixels_;
    PairPlanes planes_;
};

}  // namespace

NetworkFill::NetworkFill(const std::string& model_file, int steps, uint64_t noise_seed, int threads)
    : steps_(steps), noise_seed_(noise_seed) {
    const NetworkLibrary& library = network_library();
    check(library.set_threads(threads > 0 ? threads : all_threads()));
    check(library.model_open(model_file.c_str(), &model_));
    const auto config = nlohmann::json::parse(library.model_config(model_), nullptr, false);
    neighbors_ = config.is_object() && config.value("neighbors", false);
    looks_back_ = config.is_object() && config.value("window", 0) > 0;
    piece_ = looks_back_ ? library.model_piece(model_) : 1;
    begin();
}

NetworkFill::~NetworkFill() {
    network_library().stream_free(stream_);
    network_library().model_free(model_);
}

void NetworkFill::begin() {
    network_library().stream_free(stream_);
    stream_ = nullptr;
    begun_ = false;
    check(network_library().stream_open(model_, steps_, noise_seed_, &stream_));
}

std::vector<ColorImage> NetworkFill::next(const std::vector<NetworkView>& views) {
    if (!looks_back_) begin();  // a view alone: the same, whatever came before
    const auto wanted = size_t(begun_ ? piece_ : 1);
    begun_ = true;
    if (views.empty() || views.size() > wanted)
        throw Error(ExitCode::our_bug, "inpaint: frames: got " + std::to_string(views.size()) + ", expected " + std::to_string(wanted));
    std::vector<PairPlanes> frames;
    const auto neighbor_of = [&](const NetworkView& v) { return neighbors_ ? v.neighbor : nullptr; };
    for (const NetworkView& v : views)
        frames.push_back(planes_of(v.view.color, v.view.depth, v.view.hole, nullptr, neighbor_of(v)));
    while (frames.size() < wanted) frames.push_back(frames.back());
    const Video video(frames);
    const vshift_inpaint_views given = video.views();
    std::vector<float> made(video.at(3, 0));
    check(network_library().stream_next(stream_, &given, made.data()));
    std::vector<ColorImage> out;
    for (size_t f = 0; f < views.size(); ++f) {
        const Mask *hole = &views[f].view.hole, *neighbor = neighbor_of(views[f]);
        out.push_back(views[f].view.color);
        tbb::parallel_for(tbb::blocked_range<size_t>(0, out[f].size()), [&](const auto& some) {
            for (size_t i = some.begin(); i < some.end(); ++i)
                if (hole->data[i] || (neighbor && neighbor->data[i]))
                    for (size_t c = 0; c < 3; ++c)
                        out[f].data[i][int(c)] = float(linear_from_srgb(double(made[video.at(c, f) + i])));
        });
    }
    return out;
}

}  // namespace vshift::inpaint
