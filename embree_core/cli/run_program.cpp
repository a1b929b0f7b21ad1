// SPDX-License-Identifier: Apache-2.0
#include "embree_core/cli/run_program.h"

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstdlib>
#include <cstring>
#include <fstream>

#include "embree_core/cli/progress.h"
#include "embree_core/types.h"

namespace vshift::cli {
namespace {

constexpr size_t output_limit_bytes = size_t(1) << 20;

/// A started program and our end of its output; neither outlives this object.
struct Child {
    pid_t id = -1;
    int pipe = -1, status = 0;
    bool ended = false;
    ~Child() {
        ::close(pipe);
        if (id <= 0 || ended) return;
        ::kill(-id, SIGKILL);
        while (::waitpid(id, &status, 0) < 0 && errno == EINTR) continue;
    }
    bool has_ended() { return ended = ended || ::waitpid(id, &status, WNOHANG) == id; }
};

std::vector<char*> pointers(Words& words) {
    std::vector<char*> out;
    for (std::string& word : words) out.push_back(word.data());
    out.push_back(nullptr);
    return out;
}

void add_environment(Words& settings) {
    const size_t given = settings.size();
    for (char** v = environ; *v; ++v) {
        const std::string name(*v, std::strcspn(*v, "="));
        if (std::none_of(settings.begin(), settings.begin() + long(given),
                         [&](const std::string& s) { return s.compare(0, s.find('='), name) == 0; }))
            settings.emplace_back(*v);
    }
}

/// Starts the program in a process group of its own, its output going to `output`. 0 or an error number.
int start(Child& child, Words words, Words settings, const std::filesystem::path& folder, int output) {
    posix_spawn_file_actions_t actions;
    posix_spawnattr_t attributes;
    posix_spawn_file_actions_init(&actions);
    posix_spawnattr_init(&attributes);
    posix_spawn_file_actions_addchdir_np(&actions, folder.c_str());
    posix_spawn_file_actions_adddup2(&actions, output, STDOUT_FILENO);
    posix_spawn_file_actions_adddup2(&actions, output, STDERR_FILENO);
    posix_spawn_file_actions_addopen(&actions, STDIN_FILENO, "/dev/null", O_RDONLY, 0);
    posix_spawnattr_setflags(&attributes, POSIX_SPAWN_SETPGROUP);
    const int error = ::posix_spawn(&child.id, words[0].c_str(), &actions, &attributes, pointers(words).data(),
                                    pointers(settings).data());
    if (error) child.id = -1;
    posix_spawnattr_destroy(&attributes);
    posix_spawn_file_actions_destroy(&actions);
    return error;
}

}  // namespace

Words split(const std::string& text, const char* separators) {
    Words parts;
    for (size_t at = 0; at < text.size();) {
        const size_t end = std::min(text.find_first_of(separators, at), text.size());
        if (end > at) parts.push_back(text.substr(at, end - at));
        at = end + 1;
    }
    return parts;
}

std::string ProgramRun::told() const {
    const Words lines = split(output, "\n");
    return lines.empty() ? ending : ending + ", saying '" + lines.back().substr(0, 300) + "'";
}

ProgramRun run_program(Words words, Words settings, const std::filesystem::path& folder, int time_limit_s) {
    add_environment(settings);
    ProgramRun run;
    int ends[2];
    if (::pipe2(ends, O_CLOEXEC) != 0) {
        run.ending = std::string("no pipe: ") + std::strerror(errno);
        return run;
    }
    Child child;
    child.pipe = ends[0];
    const int error = start(child, std::move(words), std::move(settings), folder, ends[1]);
    ::close(ends[1]);
    if (error) {
        run.ending = std::string("not started: ") + std::strerror(error);
        return run;
    }
    const auto deadline = std::chrono::steady_clock::now() + std::chrono::seconds(time_limit_s);
    for (bool open = true; open || !child.has_ended();) {
        stop_if_interrupted();
        if (std::chrono::steady_clock::now() > deadline) {
            run.ending = "no end within " + std::to_string(time_limit_s) + " s";
            return run;
        }
        pollfd output = {open ? child.pipe : -1, POLLIN, 0};
        if (::poll(&output, 1, open ? 100 : 2) <= 0) continue;
        char bytes[65536];
        const ssize_t got = ::read(child.pipe, bytes, sizeof bytes);
        if (got < 0 && errno == EINTR) continue;
        open = got > 0;
        if (open) run.output.append(bytes, std::min(size_t(got), output_limit_bytes - run.output.size()));
    }
    if (WIFSIGNALED(child.status)) {
        const int number = WTERMSIG(child.status);
        run.ending = "signal " + std::to_string(number) + " (" + ::strsignal(number) + ")";
    } else {
        run.code = WEXITSTATUS(child.status);
        run.ending = "exit status " + std::to_string(run.code);
    }
    return run;
}

std::string source_program(const std::string& verb, const std::filesystem::path& within) {
    namespace fs = std::filesystem;
    std::error_code error;
    const fs::path self = fs::read_symlink("/proc/self/exe", error);
    for (const fs::path& root : {self.parent_path() / ".." / "share" / "vshift", fs::path(VSHIFT_SOURCE_DIR)})
        if (fs::exists(root / within, error)) return (root / within).string();
    throw Error(ExitCode::io_failed,
                verb + ": program: got none beside " + self.string() + ", expected " + within.string());
}

std::string program_on_path(const std::string& name) {
    namespace fs = std::filesystem;
    std::error_code error;
    const char* path = std::getenv("PATH");
    for (const std::string& folder : split(path ? path : "", ":")) {
        const fs::path program = fs::absolute(fs::path(folder) / name, error);
        if (fs::is_regular_file(program, error) && ::access(program.c_str(), X_OK) == 0) return program.string();
    }
    return "";
}

std::string python_program() {
    const char* chosen = std::getenv("VSHIFT_PYTHON");
    return chosen && *chosen ? chosen : VSHIFT_PYTHON;
}

void wait_without_spinning() {
    if (std::getenv("OMP_WAIT_POLICY")) return;
    ::setenv("OMP_WAIT_POLICY", "passive", 1);
    std::ifstream file("/proc/self/cmdline", std::ios::binary);
    std::vector<std::string> words;
    for (std::string word; std::getline(file, word, '\0');) words.push_back(word);
    std::vector<char*> argv;
    for (std::string& word : words) argv.push_back(word.data());
    argv.push_back(nullptr);
    if (!words.empty()) ::execv("/proc/self/exe", argv.data());  // when it fails, all goes on, only slower
}

}  // namespace vshift::cli
