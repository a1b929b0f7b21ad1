// SPDX-License-Identifier: Apache-2.0
// Role: clocks, medians and the machine's own facts for `vshift bench`.
#pragma once
#include <chrono>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <vector>

namespace vshift::bench {

/// Wall time and CPU time (of all threads of this process) of one piece of work.
struct Sample {
    double wall_ms = 0, cpu_ms = 0;
};
double cpu_clock_ms();

class Stopwatch {
public:
    Stopwatch() : start_(Clock::now()), cpu_start_ms_(cpu_clock_ms()) {}
    Sample read() const {
        const double cpu_ms = cpu_clock_ms() - cpu_start_ms_;
        return {std::chrono::duration<double, std::milli>(Clock::now() - start_).count(), cpu_ms};
    }

private:
    using Clock = std::chrono::steady_clock;
    Clock::time_point start_;
    double cpu_start_ms_;
};

/// {median, q1, q3, least, n}; nulls where there is no value.
nlohmann::ordered_json spread(std::vector<double> values);
/// The q-quantile, linear between values. Not for an empty list.
double quantile(std::vector<double> values, double q);

/// {wall_ms, cpu_ms}: spreads of both.
nlohmann::ordered_json spread_of(const std::vector<Sample>& samples);

/// CPU model, cores, what else ran.
nlohmann::ordered_json machine_facts();
/// The load average over the last minute: how many wanted a core.
double load();
uint64_t resident_bytes();

}  // namespace vshift::bench
