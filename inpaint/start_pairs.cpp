// SPDX-License-Identifier: Apache-2.0
#include "inpaint/start_pairs.h"

#include <algorithm>

#include "inpaint/network_library.h"

namespace vshift::inpaint {
namespace {

constexpr uint64_t squares_of_a_pair = 8;
constexpr int pairs_at_once = 32;  // that neighbouring samples are drawn from

}  // namespace

StartPairs::StartPairs(const RecordedViews& recorded, const std::string& rays_file, uint64_t seed, int crop_px, Arm arm)
    : recorded_(recorded), seed_(seed), crop_px_(crop_px), arm_(arm) {
    check(network_library().model_open(rays_file.c_str(), &rays_));
}

StartPairs::~StartPairs() {
    network_library().model_free(rays_);
}

const PairPlanes& StartPairs::whole(uint64_t number) {
    const auto found = kept_.find(number);
    if (found != kept_.end()) return found->second;
    PairPlanes pair = training_pair(recorded_, seed_, number, 0, arm_);
    std::vector<float> color(pair.fill.size());
    pair.texture.resize(pair.fill.size());
    const vshift_inpaint_views views = pair.views();
    check(network_library().texture(rays_, &views, color.data(), pair.texture.data()));
    pair.fill = std::move(color);
    return kept_.emplace(number, std::move(pair)).first->second;
}

PairPlanes StartPairs::sample(uint64_t number) {
    analytic::Stream random(uint32_t(seed_ * 7919 + number), uint32_t(number >> 20) + 31);
    const uint64_t first = number / squares_of_a_pair;
    kept_.erase(kept_.begin(), kept_.lower_bound(first));
    const PairPlanes& pair = whole(first + uint64_t(random.whole(0, pairs_at_once - 1)));
    return crop_px_ == 0 ? pair : cropped_pair(pair, crop_px_, random);
}

}  // namespace vshift::inpaint
