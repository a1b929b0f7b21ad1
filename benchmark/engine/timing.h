// SPDX-License-Identifier: Apache-2.0
// Role: clocks, medians and the machine's own facts for `vshift bench`.
#pragma once
#include <cstdint>
#include <nlohmann/json.hpp>
#include <vector>

#include "embree_core/stopwatch.h"

namespace vshift::bench {

/// {median, q1, q3, least, n}; nulls where there is no value.
nlohmann::ordered_json spread(std::vector<double> values);
/// The q-quantile, linear between values. Not for an empty list.
double quantile(std::vector<double> values, double q);

/// {wall_ms, cpu_ms}: spreads of both.
nlohmann::ordered_json spread_of(const std::vector<Elapsed>& samples);

/// CPU model, cores, what else ran.
nlohmann::ordered_json machine_facts();
/// The load average over the last minute: how many wanted a core.
double load();
uint64_t resident_bytes();

}  // namespace vshift::bench
