// SPDX-License-Identifier: Apache-2.0
// vshift: exact occlusion masks for shifted cameras. See docs/conventions.md for exit codes.
#include <cstdio>
#include <new>

#include "embree_core/cli/progress.h"
#include "embree_core/cli/verbs.h"
#include "embree_core/printable.h"
#include "embree_core/trace.h"
#include "embree_core/types.h"
#include "embree_core/version.h"
#include "embree_core/words.h"

namespace vshift::cli {
namespace {

/// What to say of a verb or an option that nobody knows, with the nearest one; empty when all are known.
std::string unknown_word(const CLI::App& app) {
    const auto chosen = app.get_subcommands();
    const std::vector<std::string> extras = app.remaining(true);
    std::vector<std::string> known;
    if (chosen.empty())
        for (const CLI::App* sub : app.get_subcommands({})) known.push_back(sub->get_name());
    else
        for (const CLI::Option* option : chosen[0]->get_options())
            for (const std::string& name : option->get_lnames()) known.push_back("--" + name);
    for (const std::string& word : extras)
        if (chosen.empty() || word.rfind("-", 0) == 0)
            return "usage: got " + word + ", expected a known " + (chosen.empty() ? "verb" : "option") +
                   " (did you mean " + nearest_word(word.substr(0, word.find('=')), known) + "?)";
    return "";
}

}  // namespace
}  // namespace vshift::cli

int main(int argc, char** argv) {
    using namespace vshift;
    const auto fail = [](ExitCode code, const std::string& message) {
        std::fprintf(stderr, "vshift: %s\n", printable(message).c_str());
        return int(code);
    };
    try {
        cli::catch_interrupts();
        CLI::App app{"Exact occlusion masks, holes and warps for a shifted camera rig, and their scores."};
        app.name("vshift");
        app.set_version_flag("--version",
                             [] { return std::string("vshift ") + version_string + ", " + tracer_version(); });
        app.require_subcommand(1);
        cli::add_answer_verbs(app);
        cli::add_inpaint_verb(app);
        cli::add_train_verb(app);
        cli::add_depth_verb(app);
        cli::add_score_verb(app);
        cli::add_check_verb(app);
        cli::add_report_verb(app);
        cli::add_bench_verb(app);
        cli::add_stress_verb(app);
        try {
            app.parse(argc, argv);
        } catch (const CLI::Success& e) {
            return app.exit(e);  // --help, --version
        } catch (const CLI::ParseError& e) {
            if (const std::string unknown = cli::unknown_word(app); !unknown.empty())
                return fail(ExitCode::bad_input, unknown);
            return fail(ExitCode::bad_input,
                        std::string("usage: ") + e.what() + " (vshift --help lists what there is)");
        }
        return int(ExitCode::done);
    } catch (const Error& e) {
        return fail(e.code(), e.what());
    } catch (const std::bad_alloc&) {
        return fail(ExitCode::over_limit, "memory: got none, expected enough for the request");
    } catch (const std::exception& e) {
        return fail(ExitCode::our_bug,
                    std::string("internal: got ") + e.what() + ", expected no exception (please report this)");
    }
}
