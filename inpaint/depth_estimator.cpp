// SPDX-License-Identifier: Apache-2.0
#include "inpaint/depth_estimator.h"

#include "inpaint/depth_pairs.h"
#include "inpaint/network_library.h"

namespace vshift::inpaint {

DepthEstimator::DepthEstimator(const std::string& model_file, bool trust, int threads) {
    const NetworkLibrary& library = network_library();
    check(library.set_threads(threads > 0 ? threads : all_threads()));
    check(library.depth_model_open(model_file.c_str(), trust, &model_));
}

DepthEstimator::~DepthEstimator() {
    network_library().depth_model_free(model_);
}

DepthMap DepthEstimator::depth(const ColorImage& color, const Intrinsics& intrinsics, const Pose& ego_from_cam) const {
    const DepthPlanes planes = depth_planes(color, intrinsics, ego_from_cam);
    const vshift_depth_view view = planes.view();
    DepthMap z(color.width, color.height);
    check(network_library().depth_of(model_, &view, z.data.data()));
    return z;
}

}  // namespace vshift::inpaint
