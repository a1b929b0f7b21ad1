// SPDX-License-Identifier: Apache-2.0
// Role: wall time and CPU time of a piece of work. A busy machine stretches the one and hardly the other.
#pragma once
#include <chrono>
#include <ctime>

namespace vshift {

/// Milliseconds; CPU time is that of all threads of this process.
struct Elapsed {
    double wall_ms = 0, cpu_ms = 0;
};

class Stopwatch {
public:
    Elapsed read() const {
        const double cpu_ms = cpu_clock_ms() - cpu_start_ms_;
        return {std::chrono::duration<double, std::milli>(Clock::now() - start_).count(), cpu_ms};
    }

private:
    using Clock = std::chrono::steady_clock;
    static double cpu_clock_ms() {
        timespec t{};
        clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
        return double(t.tv_sec) * 1e3 + double(t.tv_nsec) * 1e-6;
    }
    Clock::time_point start_ = Clock::now();
    double cpu_start_ms_ = cpu_clock_ms();
};

}  // namespace vshift
