// SPDX-License-Identifier: Apache-2.0
// Role: what the image readers share beneath image_file.h: a regular file opened without ever
// hanging on a FIFO or device, and the one-line error `file: field: got X, expected Y`.
#pragma once
#include <cstdint>
#include <filesystem>
#include <string>

#include "embree_core/types.h"

namespace vshift {

/// Throws Error with the message `file: field: text`, on one line whatever the parts hold.
[[noreturn]] void fail_file(ExitCode code, const std::filesystem::path& file, const std::string& field,
                            const std::string& text);

/// A regular file, open for reading. The constructor throws Error io_failed for anything else; it
/// looks before it opens, so that no device is touched and no FIFO is waited for.
class RegularFile {
public:
    explicit RegularFile(const std::filesystem::path& file);
    ~RegularFile();
    RegularFile(const RegularFile&) = delete;
    RegularFile& operator=(const RegularFile&) = delete;

    uint64_t size() const { return size_; }  ///< as the file system states it on opening
    int descriptor() const { return fd_; }   ///< for mapping it; closed with this object
    /// The first bytes of the file: `count` of them, or fewer where it ends before.
    std::string read_first(size_t count) const;

private:
    std::filesystem::path file_;
    int fd_ = -1;
    uint64_t size_ = 0;
};

}  // namespace vshift
