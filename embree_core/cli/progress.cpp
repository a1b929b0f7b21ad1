// SPDX-License-Identifier: Apache-2.0
#include "embree_core/cli/progress.h"

#include <unistd.h>

#include <csignal>
#include <cstdio>

#include "embree_core/types.h"

namespace vshift::cli {
namespace {

volatile std::sig_atomic_t interrupted = 0;

extern "C" void on_signal(int) {
    interrupted = 1;
}

std::string clock_text(double seconds) {
    char text[32];
    std::snprintf(text, sizeof text, "%d:%02d", int(seconds) / 60, int(seconds) % 60);
    return text;
}

}  // namespace

Progress::Progress(std::string verb)
    : verb_(std::move(verb)), start_(Clock::now()), last_(start_), terminal_(isatty(STDERR_FILENO)) {}

void Progress::show(size_t done, size_t total, const std::string& what) {
    const auto now = Clock::now();
    const double since_last = std::chrono::duration<double>(now - last_).count();
    if (total < 2 || since_last < (terminal_ ? 0.1 : 2.0)) return;
    last_ = now;
    const double elapsed = std::chrono::duration<double>(now - start_).count();
    const std::string left = done ? clock_text(elapsed / double(done) * double(total - done)) : "?";
    std::fprintf(stderr, "%s%s  %zu/%zu  %s left  %s%s", terminal_ ? "\r\033[K" : "", verb_.c_str(), done, total,
                 left.c_str(), what.c_str(), terminal_ ? "" : "\n");
    std::fflush(stderr);
    open_ = terminal_;
}

void Progress::finish() {
    if (open_) std::fprintf(stderr, "\r\033[K");
    open_ = false;
}

void catch_interrupts() {
    struct sigaction action = {};
    action.sa_handler = on_signal;
    action.sa_flags = int(SA_RESETHAND);  // a second signal ends the program at once
    sigaction(SIGINT, &action, nullptr);
    sigaction(SIGTERM, &action, nullptr);
}

void stop_if_interrupted() {
    if (interrupted) throw interrupted_error();
}

}  // namespace vshift::cli
