// SPDX-License-Identifier: Apache-2.0
// Role: the one name of libvshift_pictures.so. It is of the same build as the program: C++ types pass through it.
#include "embree_core/pictures.h"

extern "C" __attribute__((visibility("default"))) const vshift::Pictures* vshift_pictures() {
    return &vshift::pictures_by_oiio();
}
