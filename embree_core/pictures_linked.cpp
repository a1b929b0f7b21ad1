// SPDX-License-Identifier: Apache-2.0
#include "embree_core/pictures.h"

namespace vshift {

const Pictures& pictures() {
    return pictures_by_oiio();
}

}  // namespace vshift
