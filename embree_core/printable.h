// SPDX-License-Identifier: Apache-2.0
// Role: messages that any terminal and any UTF-8 reader takes, whatever a file's name or content holds.
#pragma once
#include <string>

namespace vshift {

/// One line of valid UTF-8: control characters and bytes that are no UTF-8 become '?'.
inline std::string printable(std::string text) {
    const auto follows = [&](size_t i) {
        return i < text.size() && (static_cast<unsigned char>(text[i]) & 0xc0) == 0x80;
    };
    for (size_t i = 0; i < text.size();) {
        const auto lead = static_cast<unsigned char>(text[i]);
        const size_t length = lead < 0x80                   ? 1
                              : lead >= 0xf5 || lead < 0xc2 ? 0
                              : lead >= 0xf0                ? 4
                              : lead >= 0xe0                ? 3
                                                            : 2;
        bool valid = length > 0 && lead >= 0x20 && lead != 0x7f;
        for (size_t k = 1; k < length; ++k) valid = valid && follows(i + k);
        if (valid && length > 2) {  // overlong forms, surrogates, beyond the last code point
            const auto second = static_cast<unsigned char>(text[i + 1]);
            valid = !(lead == 0xe0 && second < 0xa0) && !(lead == 0xed && second > 0x9f) &&
                    !(lead == 0xf0 && second < 0x90) && !(lead == 0xf4 && second > 0x8f);
        }
        if (!valid) text[i] = '?';
        i += valid ? length : 1;
    }
    return text;
}

}  // namespace vshift
