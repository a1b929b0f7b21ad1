// SPDX-License-Identifier: Apache-2.0
// Role: the product's version, in one place (CMake reads it from here).
#pragma once

namespace vshift {
inline constexpr const char* version_string = "0.1.0";
}  // namespace vshift
