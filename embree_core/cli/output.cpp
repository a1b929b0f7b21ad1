// SPDX-License-Identifier: Apache-2.0
#include <cstdio>

#include "embree_core/cli/verbs.h"
#include "embree_core/image_file.h"

namespace vshift::cli {

void write_text(const std::string& file, const std::string& text) {
    if (file == "-")
        std::fwrite(text.data(), 1, text.size(), stdout);
    else
        write_whole_file(file, text);
}

void make_folders(const std::filesystem::path& folder) {
    std::error_code error;
    std::filesystem::create_directories(folder, error);
    if (error)
        throw Error(ExitCode::io_failed,
                    folder.string() + ": folder: got " + error.message() + ", expected to make it");
}

}  // namespace vshift::cli
