// SPDX-License-Identifier: Apache-2.0
// Role: OpenCV's inpainting, as peers of our own fill. The only file that includes OpenCV.
#include <algorithm>
#include <cmath>
#include <opencv2/photo.hpp>

#include "embree_core/fill.h"
#include "embree_core/srgb.h"

namespace vshift {
namespace {

ColorImage opencv_inpaint(const HoledView& view, double radius_px, int method) {
    const int width = view.color.width, height = view.color.height;
    if (view.hole.width != width || view.hole.height != height)
        throw Error(ExitCode::bad_input, "fill: hole size: got another, expected the image's");
    ColorImage out = view.color;
    size_t known = 0;
    for (const uint8_t hole : view.hole.data) known += hole == 0;
    if (known == 0) {
        std::fill(out.data.begin(), out.data.end(), glm::vec3(0));
        return out;
    }
    if (known == view.hole.size()) return out;
    // OpenCV neither fills the outermost pixels nor takes color from the two next to them, and so fills holes at the
    // border with black: in a ring of three pixels holes get our own fill's color first.
    const ColorImage ring = fill_background(view);
    const auto on_ring = [&](int x, int y) { return std::min({x, y, width - 1 - x, height - 1 - y}) < 3; };
    cv::Mat picture(height, width, CV_8UC3), mask(height, width, CV_8U), filled;
    for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x) {
            const bool hole = view.hole.at(x, y) != 0 && !on_ring(x, y);
            mask.at<uint8_t>(y, x) = hole ? 255 : 0;
            auto& to = picture.at<cv::Vec3b>(y, x);
            for (int c = 0; c < 3; ++c) {
                const double shown = hole ? 0 : srgb_from_linear(double(ring.at(x, y)[c]));
                to[c] = uint8_t(std::isnan(shown) ? 0 : std::lround(255 * shown));
            }
        }
    filled = picture;
    if (width > 6 && height > 6) cv::inpaint(picture, mask, filled, radius_px, method);
    for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x)
            if (view.hole.at(x, y))
                for (int c = 0; c < 3; ++c)
                    out.at(x, y)[c] = on_ring(x, y) ? ring.at(x, y)[c]
                                                    : float(linear_from_srgb(filled.at<cv::Vec3b>(y, x)[c] / 255.0));
    return out;
}

}  // namespace

ColorImage fill_telea(const HoledView& view, double radius_px) {
    return opencv_inpaint(view, radius_px, cv::INPAINT_TELEA);
}

ColorImage fill_navier_stokes(const HoledView& view, double radius_px) {
    return opencv_inpaint(view, radius_px, cv::INPAINT_NS);
}

}  // namespace vshift
