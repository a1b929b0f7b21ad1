// SPDX-License-Identifier: Apache-2.0
#include "inpaint/network_library.h"

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <thread>

#include "embree_core/own_library.h"
#include "embree_core/types.h"

namespace vshift::inpaint {
namespace {

const OwnLibrary own{"inpaint: network", "libvshift_inpaint.so", "VSHIFT_INPAINT_LIBRARY",
                     "install libtorch-dev and libopenblas0-openmp and build again"};

constexpr int least_gflop_per_s = 25;  // of a thread

template <class Function>
void look_up(void* handle, const char* name, Function& to) {
    to = reinterpret_cast<Function>(own_function(handle, own, name));
}

NetworkLibrary load() {
    // Read by Torch, which may begin with one thread. Its own call for more starts the pool of its NNPACK as well, whose
    // idle threads spin through the first views: on two cores that made them half as slow again.
    setenv("OMP_NUM_THREADS", std::to_string(all_threads()).c_str(), 0);
    void* handle = open_library(own);
    NetworkLibrary l{};
    look_up(handle, "vshift_inpaint_version", l.version);
    look_up(handle, "vshift_inpaint_last_error", l.last_error);
    look_up(handle, "vshift_inpaint_set_threads", l.set_threads);
    look_up(handle, "vshift_inpaint_has_device", l.has_device);
    look_up(handle, "vshift_inpaint_linear_speed", l.linear_speed);
    look_up(handle, "vshift_inpaint_train", l.train);
    look_up(handle, "vshift_inpaint_model_open", l.model_open);
    look_up(handle, "vshift_inpaint_model_free", l.model_free);
    look_up(handle, "vshift_inpaint_model_piece", l.model_piece);
    look_up(handle, "vshift_inpaint_model_config", l.model_config);
    look_up(handle, "vshift_inpaint_texture", l.texture);
    look_up(handle, "vshift_inpaint_stream_open", l.stream_open);
    look_up(handle, "vshift_inpaint_stream_free", l.stream_free);
    look_up(handle, "vshift_inpaint_stream_next", l.stream_next);
    look_up(handle, "vshift_depth_train", l.depth_train);
    look_up(handle, "vshift_depth_model_open", l.depth_model_open);
    look_up(handle, "vshift_depth_model_free", l.depth_model_free);
    look_up(handle, "vshift_depth_of", l.depth_of);
    return l;
}

}  // namespace

int all_threads() {
    const char* asked = std::getenv("OMP_NUM_THREADS");
    const int threads = asked ? std::atoi(asked) : 0;
    return threads > 0 ? threads : int(std::max(1u, std::thread::hardware_concurrency()));
}

const NetworkLibrary& network_library() {
    static const NetworkLibrary library = load();
    return library;
}

void check(int code) {
    if (code != 0) throw Error(ExitCode(code), network_library().last_error());
}

void warn_of_slow_blas(int threads) {
    double speed = 0;
    check(network_library().linear_speed(&speed));
    if (speed >= least_gflop_per_s * threads) return;
    std::fprintf(stderr,
                 "vshift: warning: linear layers reach %.1f GFLOP/s on %d threads, expected %d or more: install libopenblas0-openmp, or "
                 "the machine is busy\n",
                 speed, threads, least_gflop_per_s * threads);
}

}  // namespace vshift::inpaint
