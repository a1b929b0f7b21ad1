// SPDX-License-Identifier: Apache-2.0
// Role: the verbs of the command line. A verb reads its options and calls the library.
#pragma once
#include <CLI/CLI.hpp>

namespace vshift::cli {

/// Each adds its subcommand; the work runs in the subcommand's callback and throws Error.
void add_answer_verbs(CLI::App& app);  // mask, holes, warp
void add_score_verb(CLI::App& app);
void add_check_verb(CLI::App& app);
void add_report_verb(CLI::App& app);

}  // namespace vshift::cli
