// SPDX-License-Identifier: Apache-2.0
// Role: another program, run without a shell, with bounded time and output.
#pragma once
#include <filesystem>
#include <string>
#include <vector>

namespace vshift::cli {

using Words = std::vector<std::string>;

/// The parts of `text` between any of `separators`; empty parts are left out.
Words split(const std::string& text, const char* separators);

inline constexpr int program_time_limit_s = 20;

struct ProgramRun {
    int code = -1;       ///< exit status; -1: not started, ended by a signal, or by the time limit
    std::string ending;  ///< the same in words
    std::string output;  ///< standard output and error together, their first MiB

    std::string told() const;  ///< `ending`, and the last line of the output
};

/// Runs `words` (the program by its path, then its arguments) in `folder` with `settings`, each NAME=VALUE,
/// laid over this process's environment and nothing on its standard input. It and what it started are killed
/// after `time_limit_s`, and when a signal comes for us (then throws Error interrupted).
ProgramRun run_program(Words words, Words settings, const std::filesystem::path& folder = ".",
                       int time_limit_s = program_time_limit_s);

/// A program of the source tree that this was built from, or beside an installed vshift. Throws Error io_failed for
/// `verb` when there is none.
std::string source_program(const std::string& verb, const std::filesystem::path& within);
/// The first of that name on PATH; empty where there is none.
std::string program_on_path(const std::string& name);
/// $VSHIFT_PYTHON, or the Python that this was configured with.
std::string python_program();

/// Begins this program anew, with the same arguments, with OMP_WAIT_POLICY=passive unless the user has set it. OpenMP's
/// threads otherwise wait by spinning, which on a machine that others use as well costs a factor of five to ten; and
/// OpenMP looks when it is loaded, which is before main.
void wait_without_spinning();

}  // namespace vshift::cli
