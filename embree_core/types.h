// SPDX-License-Identifier: Apache-2.0
// Role: the plain types that every stage exchanges, and the one error type.
#pragma once
#include <cstdint>
#include <glm/glm.hpp>
#include <stdexcept>
#include <string>
#include <vector>

namespace vshift {

/// Exit codes of the command line, and the category of every error (docs/conventions.md).
enum class ExitCode : int {
    done = 0,
    below_threshold = 2,
    bad_input = 3,
    io_failed = 4,
    over_limit = 5,
    our_bug = 6,
    interrupted = 130,
};

/// What loaders, constructors and stages throw. `what()` is one line:
/// `file: camera: field: got X, expected Y`.
class Error : public std::runtime_error {
public:
    Error(ExitCode code, const std::string& message) : std::runtime_error(message), code_(code) {}
    ExitCode code() const { return code_; }

private:
    ExitCode code_;
};

/// A signal came between two items.
inline Error interrupted_error() {
    return {ExitCode::interrupted, "interrupted: got a signal, expected to finish; what was written is whole"};
}

/// A row-major image plane, row 0 on top; pixel (x, y) has its centre at (x + 0.5, y + 0.5).
template <class T>
struct Grid {
    int width = 0;
    int height = 0;
    std::vector<T> data;

    Grid() = default;
    Grid(int w, int h, T fill = T{}) : width(w), height(h), data(size_t(w) * size_t(h), fill) {}
    T& at(int x, int y) { return data[size_t(y) * size_t(width) + size_t(x)]; }
    const T& at(int x, int y) const { return data[size_t(y) * size_t(width) + size_t(x)]; }
    size_t size() const { return data.size(); }
};

/// Planar z in metres; +inf is sky; NaN, 0 and negative are "no measurement".
using DepthMap = Grid<float>;
inline bool is_sky(float depth_m) {
    return depth_m > 1e12f;
}
/// Neither sky nor "no measurement". Below 1e-12 m, as above 1e12 m, 1/z and its square are no normal floats.
inline bool is_measured(float depth_m) {
    return depth_m > 1e-12f && !is_sky(depth_m);
}
/// Linear RGB.
using ColorImage = Grid<glm::vec3>;
/// 0 or 1 per pixel.
using Mask = Grid<uint8_t>;

}  // namespace vshift
