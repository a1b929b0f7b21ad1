// SPDX-License-Identifier: Apache-2.0
#include "embree_core/own_library.h"

#include <dlfcn.h>

#include <cstdlib>
#include <filesystem>
#include <vector>

#include "embree_core/types.h"

namespace vshift {

void* open_library(const OwnLibrary& library) {
    namespace fs = std::filesystem;
    std::vector<std::string> places;
    if (const char* given = std::getenv(library.variable.c_str())) {
        places.push_back(given);
    } else {
        std::error_code error;
        const fs::path program = fs::read_symlink("/proc/self/exe", error);
        if (!error)
            for (const char* folder : {"../lib", "."}) {
                const fs::path file = program.parent_path() / folder / library.name;
                if (fs::exists(file, error)) places.push_back(file.string());
            }
        places.push_back(library.name);
    }
    std::string reason;
    for (const std::string& place : places) {
        if (void* handle = ::dlopen(place.c_str(), RTLD_NOW | RTLD_LOCAL)) return handle;
        if (reason.empty()) reason = ::dlerror();
    }
    throw Error(ExitCode::io_failed,
                library.part + ": got " + reason + ", expected " + library.name + " (" + library.remedy + ")");
}

void* own_function(void* handle, const OwnLibrary& library, const std::string& name) {
    if (void* function = ::dlsym(handle, name.c_str())) return function;
    throw Error(ExitCode::io_failed, library.part + ": got a library without " + name + ", expected one of this version");
}

}  // namespace vshift
