// SPDX-License-Identifier: Apache-2.0
// Role: one line of progress with time left, on standard error.
#pragma once
#include <chrono>
#include <string>

namespace vshift::cli {

/// On a terminal the line is rewritten; elsewhere a line is printed every two seconds at most.
class Progress {
public:
    explicit Progress(std::string verb);
    void show(size_t done, size_t total, const std::string& what);
    void finish();

private:
    using Clock = std::chrono::steady_clock;
    std::string verb_;
    Clock::time_point start_, last_;
    bool terminal_, open_ = false;
};

/// Turns SIGINT and SIGTERM into a flag; work stops between two items, with nothing half written.
void catch_interrupts();
/// Throws Error(interrupted) once a signal has come.
void stop_if_interrupted();

}  // namespace vshift::cli
