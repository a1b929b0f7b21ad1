// SPDX-License-Identifier: Apache-2.0
#include "embree_core/image_scores.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>

#include "embree_core/c_api.h"
#include "embree_core/flip.h"
#include "embree_core/score.h"

namespace vshift {

ImageMaps compare_images(const ColorImage& got_linear, const ColorImage& truth_linear) {
    if (got_linear.width != truth_linear.width || got_linear.height != truth_linear.height)
        throw Error(ExitCode::bad_input, "score: image size: got another, expected the truth's");
    const ColorImage got = srgb_from_linear(got_linear), truth = srgb_from_linear(truth_linear);
    const Grid<double> a = luma(got), b = luma(truth);
    ImageMaps maps;
    maps.squared_error = Grid<double>(truth.width, truth.height);
    for (size_t i = 0; i < truth.size(); ++i) {
        const glm::dvec3 d = glm::dvec3(got.data[i]) - glm::dvec3(truth.data[i]);
        maps.squared_error.data[i] = glm::dot(d, d);
    }
    maps.ssim = ssim_maps(a, b).ssim;
    maps.ms_ssim = ms_ssim_maps(a, b);
    maps.flip = flip_map(got, truth);
    maps.gradient = gradient_maps(a, b);
    return maps;
}

double RegionScore::psnr_db() const {
    if (pixels == 0) return std::numeric_limits<double>::quiet_NaN();
    if (squared_error == 0) return std::numeric_limits<double>::infinity();
    return -10 * std::log10(squared_error / (3.0 * double(pixels)));
}

double RegionScore::sharpness() const {
    return truth_energy > 0 ? got_energy / truth_energy : std::numeric_limits<double>::quiet_NaN();
}

RegionScore score_region(const ImageMaps& maps, const Mask* region) {
    RegionScore out;
    for (size_t i = 0; i < maps.ssim.size(); ++i) {
        if (region && !region->data[i]) continue;
        ++out.pixels;
        out.squared_error += maps.squared_error.data[i];
        out.ssim += maps.ssim.data[i];
        out.flip += double(maps.flip.data[i]);
        out.gradient_error += maps.gradient.error.data[i];
        out.got_energy += maps.gradient.got_energy.data[i];
        out.truth_energy += maps.gradient.truth_energy.data[i];
    }
    out.ms_ssim = ms_ssim(maps.ms_ssim, region);
    return out;
}

std::vector<Region> regions_of(const Grid<uint8_t>& klass, const Grid<int8_t>& source, int band_px) {
    const int width = klass.width, height = klass.height;
    const auto where = [&](auto&& rule) {
        Mask mask(width, height);
        for (size_t i = 0; i < mask.size(); ++i) mask.data[i] = rule(klass.data[i]);
        return mask;
    };
    // Borders first, then everything within the band: rows, then columns.
    Mask border(width, height), rows(width, height), band(width, height);
    for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x) {
            if (x + 1 < width && source.at(x, y) != source.at(x + 1, y)) border.at(x, y) = border.at(x + 1, y) = 1;
            if (y + 1 < height && source.at(x, y) != source.at(x, y + 1)) border.at(x, y) = border.at(x, y + 1) = 1;
        }
    for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x)
            for (int i = std::max(0, x - band_px); i <= std::min(width - 1, x + band_px); ++i)
                rows.at(x, y) |= border.at(i, y);
    for (int y = 0; y < height; ++y)
        for (int j = std::max(0, y - band_px); j <= std::min(height - 1, y + band_px); ++j)
            for (int x = 0; x < width; ++x) band.at(x, y) |= rows.at(x, j);
    std::vector<Region> regions;
    regions.push_back({"all", where([](uint8_t) { return true; })});
    regions.push_back({"own", where([](uint8_t c) { return c == VSHIFT_SEEN_BY_OWN; })});
    regions.push_back(
        {"neighbour", where([](uint8_t c) { return c != VSHIFT_SEEN_BY_OWN && c < VSHIFT_NOBODY_OCCLUDED; })});
    regions.push_back({"visible", where([](uint8_t c) { return c < VSHIFT_NOBODY_OCCLUDED; })});
    regions.push_back({"hole", where([](uint8_t c) { return c >= VSHIFT_NOBODY_OCCLUDED; })});
    regions.push_back({"hole_disoccluded", where([](uint8_t c) { return c == VSHIFT_NOBODY_OCCLUDED; })});
    regions.push_back({"hole_outside", where([](uint8_t c) { return c == VSHIFT_NOBODY_OUTSIDE; })});
    regions.push_back({"lost", where([](uint8_t c) { return c != VSHIFT_SEEN_BY_OWN; })});
    regions.push_back({"seam_band", std::move(band)});
    return regions;
}

std::optional<Interval> bootstrap(const std::vector<FrameSum>& all, uint32_t seed, int rounds) {
    std::vector<FrameSum> frames;
    for (const FrameSum& f : all)
        if (f.weight > 0) frames.push_back(f);
    if (frames.size() < 2 || rounds < 1) return std::nullopt;
    std::mt19937 random(seed);  // its numbers are the same everywhere; distributions' are not
    std::vector<double> means;
    for (int round = 0; round < rounds; ++round) {
        FrameSum drawn;
        for (size_t i = 0; i < frames.size(); ++i) {
            const FrameSum& f = frames[size_t((uint64_t(random()) * frames.size()) >> 32)];
            drawn.sum += f.sum, drawn.weight += f.weight;
        }
        means.push_back(drawn.sum / drawn.weight);
    }
    std::sort(means.begin(), means.end());
    const auto at = [&](double share) { return means[size_t(std::lround(share * double(means.size() - 1)))]; };
    return Interval{at(0.025), at(0.975)};
}

}  // namespace vshift
