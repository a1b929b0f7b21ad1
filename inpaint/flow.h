// SPDX-License-Identifier: Apache-2.0
// Role: flow matching (paper III-E): from noise z1 to data z0 along straight lines. Stage: inpaint.
//
// z_t = (1 - t) z0 + t z1, so the velocity dz/dt is v = z1 - z0: it points to the noise, as the paper's loss has it (its
// text says the opposite). Sampling goes from t = 1 to 0 and so subtracts.
#pragma once
#include <functional>
#include <vector>

#include "inpaint/torch_api.h"

namespace vshift::inpaint {

inline at::Tensor flow_point(const at::Tensor& z0, const at::Tensor& z1, const at::Tensor& t) {
    return (1 - t) * z0 + t * z1;
}
inline at::Tensor flow_velocity(const at::Tensor& z0, const at::Tensor& z1) {
    return z1 - z0;
}

/// Wan's time shift: s t / (1 + (s - 1) t). s = 5, or 3 at 480p; 1 changes nothing. 0 and 1 stay.
inline double shifted_time(double t, double shift) {
    return shift * t / (1 + (shift - 1) * t);
}

/// steps + 1 times from 1 down to 0.
inline std::vector<double> flow_times(int steps, double shift) {
    std::vector<double> times;
    for (int i = 0; i <= steps; ++i) times.push_back(shifted_time(1 - double(i) / steps, shift));
    return times;
}

/// Euler steps from z1 along `velocity(z, t, step)`.
inline at::Tensor euler(at::Tensor z, const std::vector<double>& times,
                        const std::function<at::Tensor(const at::Tensor&, double, int)>& velocity) {
    for (size_t i = 0; i + 1 < times.size(); ++i)
        z = z + (times[i + 1] - times[i]) * velocity(z, times[i], int(i));
    return z;
}

}  // namespace vshift::inpaint
