// SPDX-License-Identifier: Apache-2.0
// Role: the verbs of the command line. A verb reads its options and calls the library.
#pragma once
#include <CLI/CLI.hpp>
#include <filesystem>
#include <string>

namespace vshift::cli {

/// Each adds its subcommand; the work runs in the subcommand's callback and throws Error.
void add_answer_verbs(CLI::App& app);  // mask, holes, warp
void add_inpaint_verb(CLI::App& app);
void add_train_verb(CLI::App& app);
void add_depth_verb(CLI::App& app);
void add_score_verb(CLI::App& app);
void add_stress_verb(CLI::App& app);
void add_check_verb(CLI::App& app);
void add_report_verb(CLI::App& app);
void add_bench_verb(CLI::App& app);

/// A result as text: a whole file, or standard output when `file` is "-".
void write_text(const std::string& file, const std::string& text);
/// The folder and those above it. Throws Error io_failed.
void make_folders(const std::filesystem::path& folder);

}  // namespace vshift::cli
