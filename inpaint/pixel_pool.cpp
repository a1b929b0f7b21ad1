// SPDX-License-Identifier: Apache-2.0
#include "inpaint/pixel_pool.h"

#include <algorithm>
#include <array>

#include "inpaint/rays.h"
#include "scenes/analytic/street_mesh.h"

namespace vshift::inpaint {
namespace {

constexpr std::array<size_t, 2> pixels_of_a_pair{120, 40};  // occluded, outside
// There are far more pixels outside the frame, and a ray has less to tell there: they count so much less again.
constexpr double outside_share = 0.25;

}  // namespace

PixelPool pixel_pool(const RecordedViews& recorded, uint64_t seed, size_t pairs,
                     const std::function<void(size_t, size_t)>& show) {
    PixelPool pool;
    double sum = 0;
    const size_t most = pairs * (pixels_of_a_pair[0] + pixels_of_a_pair[1]);
    pool.seen.reserve(most * seen_numbers);
    for (size_t number = 0; number < pairs; ++number) {
        show(number, pairs);
        const PairPlanes pair = training_pair(recorded, seed, number, 0, Arm::there_and_back);
        analytic::Stream random(uint32_t(seed * 7919 + number), 23);
        std::array<std::vector<int32_t>, 2> of;
        for (size_t i = 0; i < pair.weight.size(); ++i)
            if (pair.weight[i] > 0) of[pair.weight[i] < 1].push_back(int32_t(i));
        std::vector<int32_t> chosen;
        for (size_t k = 0; k < 2; ++k) {
            std::vector<int32_t>& from = of[k];
            const size_t some = std::min(pixels_of_a_pair[k], from.size());
            double weights = 0;
            for (const int32_t i : from) weights += double(pair.weight[size_t(i)]);
            for (size_t i = 0; i < some; ++i) {  // the front of a shuffled list
                std::swap(from[i], from[size_t(random.whole(int(i), int(from.size()) - 1))]);
                chosen.push_back(from[i]);
                pool.up_to.push_back(sum += (k == 0 ? 1 : outside_share) * weights / double(some));
            }
        }
        const RayNumbers seen =
            ray_numbers_of({pair.width, pair.height, pair.fill.data(), pair.hole.data(), pair.inverse_depth.data()}, chosen);
        const size_t n = size_t(pair.width) * size_t(pair.height);
        for (size_t i = 0; i < chosen.size(); ++i) {
            pool.seen.resize(pool.seen.size() + seen_numbers);
            write_seen(seen, i, pool.seen.data() + pool.seen.size() - seen_numbers);
            for (size_t c = 0; c < 3; ++c) {
                pool.fill.push_back(pair.fill[c * n + size_t(chosen[i])]);
                pool.target.push_back(pair.target[c * n + size_t(chosen[i])]);
            }
        }
    }
    return pool;
}

PairPlanes pixel_sample(const PixelPool& pool, uint64_t seed, uint64_t number, int pixels) {
    analytic::Stream random(uint32_t(seed * 7919 + number), uint32_t(number >> 20) + 29);
    PairPlanes out;
    out.width = pixels;
    out.height = 1;
    const size_t n = size_t(pixels);
    out.fill.resize(3 * n);
    out.target.resize(3 * n);
    out.hole.assign(n, 1);
    out.neighbor.assign(n, 0);
    out.inverse_depth.assign(n, 0);
    out.weight.assign(n, 1);
    out.seen.resize(seen_numbers * n);
    std::vector<float> mirror(seen_numbers);
    for (size_t i = 0; i < n; ++i) {
        const auto found = std::upper_bound(pool.up_to.begin(), pool.up_to.end(), random.within(0, pool.up_to.back()));
        const size_t at = std::min(size_t(found - pool.up_to.begin()), pool.size() - 1);
        const bool mirrored = i % 2 == 1;
        for (size_t c = 0; c < 3; ++c) {
            out.fill[c * n + i] = pool.fill[3 * at + c];
            out.target[c * n + i] = pool.target[3 * at + c];
        }
        const float* from = pool.seen.data() + seen_numbers * at;
        if (mirrored) mirror_seen(from, mirror.data());
        for (size_t j = 0; j < seen_numbers; ++j) out.seen[j * n + i] = mirrored ? mirror[j] : from[j];
    }
    return out;
}

}  // namespace vshift::inpaint
