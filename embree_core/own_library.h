// SPDX-License-Identifier: Apache-2.0
// Role: libraries of ours that a program loads when they are asked for, because they take long to load.
#pragma once
#include <string>

namespace vshift {

struct OwnLibrary {
    std::string part;      ///< of the program, begins messages
    std::string name;      ///< libvshift_....so
    std::string variable;  ///< an environment variable that may say where it lies
    std::string remedy;    ///< what to do when there is none
};

/// Looks in the variable, or in ../lib and . beside the program, then where the system looks. Throws Error io_failed. It
/// stays loaded.
void* open_library(const OwnLibrary& library);

/// Throws Error io_failed when it has none of that name.
void* own_function(void* handle, const OwnLibrary& library, const std::string& name);

}  // namespace vshift
