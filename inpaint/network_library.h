// SPDX-License-Identifier: Apache-2.0
// Role: loads libvshift_inpaint.so when the network is asked for, so that nothing else waits for Torch's 280 shared
// objects or needs them at all. Stage: inpaint. No Torch here.
#pragma once
#include <string>

#include "inpaint/c_api.h"
#include "inpaint/depth_api.h"

namespace vshift::inpaint {

/// The functions of c_api.h and depth_api.h, looked up once.
struct NetworkLibrary {
    decltype(&vshift_inpaint_version) version;
    decltype(&vshift_inpaint_last_error) last_error;
    decltype(&vshift_inpaint_set_threads) set_threads;
    decltype(&vshift_inpaint_has_device) has_device;
    decltype(&vshift_inpaint_linear_speed) linear_speed;
    decltype(&vshift_inpaint_train) train;
    decltype(&vshift_inpaint_model_open) model_open;
    decltype(&vshift_inpaint_model_free) model_free;
    decltype(&vshift_inpaint_model_piece) model_piece;
    decltype(&vshift_inpaint_model_config) model_config;
    decltype(&vshift_inpaint_texture) texture;
    decltype(&vshift_inpaint_stream_open) stream_open;
    decltype(&vshift_inpaint_stream_free) stream_free;
    decltype(&vshift_inpaint_stream_next) stream_next;
    decltype(&vshift_depth_train) depth_train;
    decltype(&vshift_depth_model_open) depth_model_open;
    decltype(&vshift_depth_model_free) depth_model_free;
    decltype(&vshift_depth_of) depth_of;
};

/// What OMP_NUM_THREADS says, else as many as there are cores.
int all_threads();

/// Looks in $VSHIFT_INPAINT_LIBRARY, then in ../lib and . beside the program, then where the system looks. Throws Error
/// io_failed that says what to install.
const NetworkLibrary& network_library();

/// Throws what a function's return code and message say; nothing for 0.
void check(int code);

/// Prints a line that names the package to install when linear layers are slow here (under 25 GFLOP/s a thread).
void warn_of_slow_blas(int threads);

}  // namespace vshift::inpaint
