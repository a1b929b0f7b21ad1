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

}  // namespace vshift::cli
