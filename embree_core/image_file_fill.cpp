// SPDX-License-Identifier: Apache-2.0
// Role: OpenImageIO's push-pull fill, as a peer of our own; beside image_file.cpp because OpenImageIO stays there.
#include <OpenImageIO/imagebuf.h>
#include <OpenImageIO/imagebufalgo.h>

#include <cmath>

#include "embree_core/fill.h"

namespace vshift {

ColorImage fill_pushpull(const HoledView& view) {
    const int width = view.color.width, height = view.color.height;
    if (view.hole.width != width || view.hole.height != height)
        throw Error(ExitCode::bad_input, "fill: hole size: got another, expected the image's");
    std::vector<float> pixels(view.color.size() * 4);
    for (size_t i = 0; i < view.color.size(); ++i)
        if (!view.hole.data[i]) {  // square roots, as in fill_background; alpha says what is known
            for (size_t c = 0; c < 3; ++c) pixels[4 * i + c] = std::sqrt(std::max(view.color.data[i][int(c)], 0.0f));
            pixels[4 * i + 3] = 1;
        }
    OIIO::ImageSpec spec(width, height, 4, OIIO::TypeDesc::FLOAT);
    spec.channelnames = {"R", "G", "B", "A"};
    spec.alpha_channel = 3;
    const OIIO::ImageBuf holed(spec, pixels.data());
    OIIO::ImageBuf filled;
    // One thread: the order of its sums is then the same everywhere.
    if (!OIIO::ImageBufAlgo::fillholes_pushpull(filled, holed, {}, 1) ||
        !filled.get_pixels(OIIO::ROI(0, width, 0, height, 0, 1, 0, 4), OIIO::TypeDesc::FLOAT, pixels.data()))
        throw Error(ExitCode::our_bug, "fill: pushpull: got " + filled.geterror() + ", expected filled pixels");
    ColorImage out = view.color;
    for (size_t i = 0; i < out.size(); ++i)
        if (view.hole.data[i])
            for (size_t c = 0; c < 3; ++c) {
                const float root = pixels[4 * i + c];
                out.data[i][int(c)] = std::isfinite(root) ? root * root : 0;
            }
    return out;
}

}  // namespace vshift
