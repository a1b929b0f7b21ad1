// SPDX-License-Identifier: Apache-2.0
#include "inpaint/network_fill.h"

#include <nlohmann/json.hpp>

#include "embree_core/srgb.h"
#include "inpaint/network_library.h"
#include "inpaint/street_pairs.h"

namespace vshift::inpaint {

NetworkFill::NetworkFill(const std::string& model_file, int steps, uint64_t noise_seed, int threads)
    : steps_(steps), noise_seed_(noise_seed) {
    const NetworkLibrary& library = network_library();
    check(library.set_threads(threads));
    check(library.model_open(model_file.c_str(), &model_));
    const auto config = nlohmann::json::parse(library.model_config(model_), nullptr, false);
    looks_back_ = config.is_object() && config.value("window", 0) > 0;
}

NetworkFill::~NetworkFill() {
    for (const auto& [name, stream] : streams_) network_library().stream_free(stream);
    network_library().model_free(model_);
}

ColorImage NetworkFill::next(const HoledView& view, const std::string& name) {
    const NetworkLibrary& library = network_library();
    vshift_inpaint_stream*& stream = streams_[name];
    if (stream && !looks_back_) {  // a view alone: the same, whatever came before
        library.stream_free(stream);
        stream = nullptr;
    }
    if (!stream) check(library.stream_open(model_, steps_, noise_seed_, &stream));
    const PairPlanes planes = planes_of(view.color, view.depth, view.hole, nullptr);
    const vshift_inpaint_views given = planes.views();
    std::vector<float> made(planes.fill.size());
    check(library.stream_next(stream, &given, made.data()));
    ColorImage out = view.color;
    const size_t n = out.size();
    for (size_t i = 0; i < n; ++i)
        if (view.hole.data[i])
            for (int c = 0; c < 3; ++c) out.data[i][c] = float(linear_from_srgb(double(made[size_t(c) * n + i])));
    return out;
}

}  // namespace vshift::inpaint
