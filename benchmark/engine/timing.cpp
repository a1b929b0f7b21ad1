// SPDX-License-Identifier: Apache-2.0
#include "benchmark/engine/timing.h"

#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <fstream>
#include <string>
#include <thread>

namespace vshift::bench {

using nlohmann::ordered_json;

double quantile(std::vector<double> values, double q) {
    std::sort(values.begin(), values.end());
    const double at = q * double(values.size() - 1);
    const size_t below = size_t(std::floor(at)), above = std::min(below + 1, values.size() - 1);
    return values[below] + (at - double(below)) * (values[above] - values[below]);
}

ordered_json spread(std::vector<double> values) {
    if (values.empty()) return {{"median", nullptr}, {"q1", nullptr}, {"q3", nullptr}, {"least", nullptr}, {"n", 0}};
    return {{"median", quantile(values, 0.5)},
            {"q1", quantile(values, 0.25)},
            {"q3", quantile(values, 0.75)},
            {"least", quantile(values, 0)},
            {"n", values.size()}};
}

ordered_json spread_of(const std::vector<Elapsed>& samples) {
    std::vector<double> wall, cpu;
    for (const Elapsed& s : samples) wall.push_back(s.wall_ms), cpu.push_back(s.cpu_ms);
    return {{"wall_ms", spread(wall)}, {"cpu_ms", spread(cpu)}};
}

double load() {
    double average[1] = {0};
    return getloadavg(average, 1) == 1 ? average[0] : -1;
}

uint64_t resident_bytes() {
    uint64_t total = 0, resident = 0;
    std::ifstream("/proc/self/statm") >> total >> resident;
    return resident * uint64_t(sysconf(_SC_PAGESIZE));
}

ordered_json machine_facts() {
    std::string model = "unknown";
    std::ifstream cpu("/proc/cpuinfo");
    for (std::string line; std::getline(cpu, line);)
        if (line.rfind("model name", 0) == 0 && line.find(": ") != std::string::npos) {
            model = line.substr(line.find(": ") + 2);
            break;
        }
    return {{"cpu", model}, {"cores", std::thread::hardware_concurrency()}, {"load_before", load()}};
}

}  // namespace vshift::bench
