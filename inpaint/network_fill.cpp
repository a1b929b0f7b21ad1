// SPDX-License-Identifier: Apache-2.0
#include "inpaint/network_fill.h"

#include "embree_core/srgb.h"
#include "inpaint/network_library.h"
#include "inpaint/street_pairs.h"

namespace vshift::inpaint {

NetworkFill::NetworkFill(const std::string& model_file, int steps, uint64_t noise_seed, int threads) {
    const NetworkLibrary& library = network_library();
    check(library.set_threads(threads));
    check(library.model_open(model_file.c_str(), &model_));
    config_ = library.model_config(model_);
    try {
        check(library.stream_open(model_, steps, noise_seed, &stream_));
    } catch (...) {
        library.model_free(model_);
        throw;
    }
}

NetworkFill::~NetworkFill() {
    network_library().stream_free(stream_);
    network_library().model_free(model_);
}

ColorImage NetworkFill::next(const HoledView& view) {
    const PairPlanes planes = planes_of(view.color, view.depth, view.hole, nullptr);
    const vshift_inpaint_views given = planes.views();
    std::vector<float> made(planes.fill.size());
    check(network_library().stream_next(stream_, &given, made.data()));
    ColorImage out = view.color;
    const size_t n = out.size();
    for (size_t i = 0; i < n; ++i)
        if (view.hole.data[i])
            for (int c = 0; c < 3; ++c) out.data[i][c] = float(linear_from_srgb(double(made[size_t(c) * n + i])));
    return out;
}

}  // namespace vshift::inpaint
