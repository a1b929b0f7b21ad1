// SPDX-License-Identifier: Apache-2.0
#include "embree_core/own_library.h"
#include "embree_core/pictures.h"

namespace vshift {

const Pictures& pictures() {
    static const Pictures& loaded = [&]() -> const Pictures& {
        const OwnLibrary library{"pictures", "libvshift_pictures.so", "VSHIFT_PICTURES_LIBRARY", "build again, or install it beside the program"};
        return *reinterpret_cast<const Pictures* (*)()>(own_function(open_library(library), library, "vshift_pictures"))();
    }();
    return loaded;
}

}  // namespace vshift
