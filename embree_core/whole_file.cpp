// SPDX-License-Identifier: Apache-2.0
// Role: reading and writing whole files. A write is encode, write beside, fsync, rename, fsync the
// folder: a reader sees the old bytes or the new ones, and a failure leaves the old ones.
#include "embree_core/whole_file.h"

#include <fcntl.h>
#include <signal.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cstdio>
#include <cstring>

#include "embree_core/image_file.h"

namespace vshift {
namespace fs = std::filesystem;

void fail_file(ExitCode code, const fs::path& file, const std::string& field, const std::string& text) {
    std::string message = file.string() + ": " + field + ": " + text;
    for (char& c : message)
        if (static_cast<unsigned char>(c) < 0x20 || c == 0x7f) c = '?';
    throw Error(code, message);
}

namespace {

std::string reason(int error) {
    return std::strerror(error);
}

const char* kind_name(mode_t mode) {
    if (S_ISDIR(mode)) return "a folder";
    if (S_ISFIFO(mode)) return "a FIFO";
    if (S_ISCHR(mode)) return "a character device";
    if (S_ISBLK(mode)) return "a block device";
    if (S_ISSOCK(mode)) return "a socket";
    return "no regular file";
}

void require_regular(const struct stat& status, const fs::path& file) {
    if (!S_ISREG(status.st_mode))
        fail_file(ExitCode::io_failed, file, "file",
                  std::string("got ") + kind_name(status.st_mode) + ", expected a regular file");
}

/// A descriptor that closes itself.
struct Descriptor {
    int fd = -1;
    explicit Descriptor(int f) : fd(f) {}
    ~Descriptor() {
        if (fd >= 0) ::close(fd);
    }
    Descriptor(const Descriptor&) = delete;
    Descriptor& operator=(const Descriptor&) = delete;
    int close() {
        const int closing = fd;
        fd = -1;
        return ::close(closing);
    }
};

/// The temporary file beside the target; removed unless it was renamed.
struct Temporary {
    fs::path path;
    bool renamed = false;
    ~Temporary() {
        if (!renamed && !path.empty()) ::unlink(path.c_str());
    }
};

}  // namespace

RegularFile::RegularFile(const fs::path& file) : file_(file) {
    struct stat status {};
    if (::stat(file.c_str(), &status) != 0)
        fail_file(ExitCode::io_failed, file, "reading", "got " + reason(errno) + ", expected a readable file");
    require_regular(status, file);
    // The file may have been exchanged since: do not block on opening, and look again.
    const int fd = ::open(file.c_str(), O_RDONLY | O_NONBLOCK | O_CLOEXEC | O_NOCTTY);
    if (fd < 0) fail_file(ExitCode::io_failed, file, "reading", "got " + reason(errno) + ", expected a readable file");
    Descriptor guard(fd);
    if (::fstat(fd, &status) != 0)
        fail_file(ExitCode::io_failed, file, "reading", "got " + reason(errno) + ", expected a readable file");
    require_regular(status, file);
    size_ = uint64_t(status.st_size);
    fd_ = fd;
    guard.fd = -1;
}

RegularFile::~RegularFile() {
    if (fd_ >= 0) ::close(fd_);
}

std::string RegularFile::read_first(size_t count) const {
    // Files such as those of /proc state size 0 and still hold bytes: grow as they come.
    std::string bytes;
    size_t used = 0;
    const size_t stated = size_t(std::min<uint64_t>(size_, count));
    bytes.resize(std::min(count, stated + 1));
    while (used < count) {
        if (used == bytes.size()) bytes.resize(std::min(count, used + std::max(used, size_t(65536))));
        const ssize_t got = ::pread(fd_, bytes.data() + used, bytes.size() - used, off_t(used));
        if (got < 0 && errno == EINTR) continue;
        if (got < 0)
            fail_file(ExitCode::io_failed, file_, "reading", "got " + reason(errno) + ", expected a readable file");
        if (got == 0) break;
        used += size_t(got);
    }
    bytes.resize(used);
    return bytes;
}

std::string read_whole_file(const fs::path& file, size_t limit_bytes) {
    const RegularFile source(file);
    const auto refuse = [&](const std::string& got) {
        fail_file(ExitCode::over_limit, file, "size",
                  "got " + got + " bytes, expected at most " + std::to_string(limit_bytes));
    };
    if (source.size() > limit_bytes) refuse(std::to_string(source.size()));
    const bool countable = limit_bytes < SIZE_MAX;
    std::string bytes = source.read_first(countable ? limit_bytes + 1 : limit_bytes);
    if (bytes.size() > limit_bytes) refuse("more than " + std::to_string(limit_bytes));
    return bytes;
}

void write_whole_file(const fs::path& file, const std::string& bytes) {
    const auto refuse = [&](int error) {
        fail_file(ExitCode::io_failed, file, "writing", "got " + reason(error) + ", expected a whole file");
    };
    fs::path target = file;
    mode_t old_mode = 0;
    struct stat status {};
    if (::stat(file.c_str(), &status) == 0) {
        // A device or FIFO would be replaced by the rename, not written to.
        require_regular(status, file);
        old_mode = status.st_mode & 07777;
        std::error_code error;
        target = fs::canonical(file, error);  // keep a symbolic link, replace what it names
        if (error) refuse(error.value());
    } else if (errno != ENOENT) {
        refuse(errno);
    }
    if (target.filename().empty() || target.filename() == "." || target.filename() == "..")
        fail_file(ExitCode::io_failed, file, "writing", "got no file name, expected one");
    const fs::path folder = target.has_parent_path() ? target.parent_path() : fs::path(".");

    static std::atomic<unsigned> counter{0};
    Temporary temporary;
    int fd = -1;
    for (int attempt = 0; fd < 0; ++attempt) {
        const fs::path name =
            folder / (".vshift-" + std::to_string(::getpid()) + "-" + std::to_string(counter.fetch_add(1)) + ".tmp");
        fd = ::open(name.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC | O_NOFOLLOW, 0666);
        if (fd >= 0)
            temporary.path = name;
        else if (errno != EINTR && (errno != EEXIST || attempt >= 1000))
            refuse(errno);
    }
    Descriptor out(fd);
    for (size_t used = 0; used < bytes.size();) {
        const ssize_t wrote = ::write(out.fd, bytes.data() + used, bytes.size() - used);
        if (wrote < 0 && errno == EINTR) continue;
        if (wrote < 0) refuse(errno);
        if (wrote == 0) refuse(ENOSPC);
        used += size_t(wrote);
    }
    if (old_mode != 0 && ::fchmod(out.fd, old_mode) != 0) refuse(errno);
    if (::fsync(out.fd) != 0) refuse(errno);
    if (out.close() != 0) refuse(errno);
    if (::rename(temporary.path.c_str(), target.c_str()) != 0) refuse(errno);
    temporary.renamed = true;

    Descriptor dir(::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
    // A folder that may be written but not listed cannot be opened, and some file systems cannot
    // sync one: the file itself is whole either way.
    if (dir.fd >= 0 && ::fsync(dir.fd) != 0 && errno != EINVAL && errno != ENOTSUP) refuse(errno);
}

void remove_stale_temporaries(const fs::path& folder) {
    std::error_code error;
    for (fs::recursive_directory_iterator entry(folder, error), end; !error && entry != end; entry.increment(error)) {
        const std::string name = entry->path().filename().string();
        int process = 0, count = 0, length = 0;
        if (std::sscanf(name.c_str(), ".vshift-%d-%d.tmp%n", &process, &count, &length) != 2 ||
            size_t(length) != name.size() || process <= 0)
            continue;
        if (::kill(process, 0) != 0 && errno == ESRCH) ::unlink(entry->path().c_str());
    }
}

}  // namespace vshift
