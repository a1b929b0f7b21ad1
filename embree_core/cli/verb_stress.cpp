// SPDX-License-Identifier: Apache-2.0
// vshift stress: what the method takes for granted does not hold (scenes/trouble); what that costs.
#include <cmath>
#include <cstdio>
#include <memory>

#include "embree_core/benchmark_set.h"
#include "embree_core/cli/progress.h"
#include "embree_core/cli/verbs.h"
#include "embree_core/image_file.h"
#include "embree_core/score.h"
#include "scenes/trouble/trouble.h"

namespace vshift::cli {
namespace {

namespace fs = std::filesystem;
using nlohmann::ordered_json;

struct Options {
    std::string scene = "all", output = "out/stress";
    int width = 800;
    std::vector<double> shifts = {1, 2, 4};
};

/// Recorded, truth, result, and the result without the fault, as one row of pictures; the affected pixels of the
/// result are framed by darkening the rest.
void write_strip(const fs::path& file, const trouble::Outcome& o) {
    const int w = o.truth.width, h = o.truth.height;
    Channels image;
    image.width = 4 * w;
    image.height = h;
    ColorImage strip(image.width, h);
    int column = 0;
    for (const ColorImage* linear : {&o.recorded, &o.truth, &o.result, &o.control}) {
        const ColorImage shown = srgb_from_linear(*linear);
        for (int y = 0; y < h; ++y)
            for (int x = 0; x < w; ++x) {
                const float dim = column >= 2 && !o.affected.at(x, y) ? 0.55f : 1;
                strip.at(column * w + x, y) = dim * shown.at(x, y);
            }
        ++column;
    }
    image.add_color(strip);
    write_image(file, image, {SampleType::uint8});
}

std::string decibels(double value) {
    char text[32];
    std::snprintf(text, sizeof text, "%.1f", value);
    return std::isfinite(value) ? text : "-";
}

void run(const Options& options) {
    std::vector<const trouble::Scene*> chosen;
    if (options.scene == "all")
        for (const trouble::Scene& s : trouble::scenes()) chosen.push_back(&s);
    else
        chosen.push_back(&trouble::scene(options.scene));
    for (const double metres : options.shifts)
        if (!(std::abs(metres) > 0 && std::abs(metres) <= 4))
            throw Error(ExitCode::bad_input, "usage: --shifts: got " + ordered_json(metres).dump() +
                                                 ", expected metres to the left, up to 4, not 0");
    make_folders(options.output);
    Progress progress("stress");
    ordered_json rows = ordered_json::array();
    std::string table =
        "| scene | fault | without it | shift | affected | PSNR there | without the fault | lost | elsewhere |\n"
        "|---|---|---|---|---|---|---|---|---|\n";
    std::string csv = "scene,shift_m,affected_share,psnr_db,control_psnr_db,elsewhere_psnr_db\n";
    const auto finite = [](double v) { return std::isfinite(v) ? ordered_json(v) : ordered_json(nullptr); };
    size_t done = 0;
    for (const trouble::Scene* scene : chosen)
        for (size_t i = 0; i < options.shifts.size(); ++i) {
            stop_if_interrupted();
            progress.show(done++, chosen.size() * options.shifts.size(), scene->name);
            Shift shift;
            shift.translation_m = {0, options.shifts[i], 0};
            const trouble::Outcome o = trouble::run(*scene, shift, options.width);
            char share[16], metres[16];
            std::snprintf(share, sizeof share, "%.2f %%", 100 * o.affected_share);
            std::snprintf(metres, sizeof metres, "%+g m", options.shifts[i]);
            table += "| " +
                     (i ? std::string("| | ") : scene->name + " | " + scene->fault + " | " + scene->control + " ") +
                     "| " + metres + " | " + share + " | " + decibels(o.psnr_db) + " dB | " +
                     decibels(o.control_psnr_db) + " dB | " + decibels(o.control_psnr_db - o.psnr_db) + " dB | " +
                     decibels(o.elsewhere_psnr_db) + " dB |\n";
            rows.push_back({{"scene", scene->name},
                            {"fault", scene->fault},
                            {"control", scene->control},
                            {"shift_m", options.shifts[i]},
                            {"affected_px", o.affected_px},
                            {"affected_share", o.affected_share},
                            {"psnr_db", finite(o.psnr_db)},
                            {"control_psnr_db", finite(o.control_psnr_db)},
                            {"elsewhere_psnr_db", finite(o.elsewhere_psnr_db)}});
            csv += scene->name + "," + ordered_json(options.shifts[i]).dump() + "," +
                   ordered_json(o.affected_share).dump() + "," + finite(o.psnr_db).dump() + "," +
                   finite(o.control_psnr_db).dump() + "," + finite(o.elsewhere_psnr_db).dump() + "\n";
            write_strip(
                fs::path(options.output) / (scene->name + "_" + ordered_json(options.shifts[i]).dump() + "m.png"), o);
        }
    progress.finish();
    write_whole_file(fs::path(options.output) / "stress.json", rows.dump(1) + "\n");
    write_whole_file(fs::path(options.output) / "stress.csv", csv);
    write_whole_file(fs::path(options.output) / "stress.md", table);
    std::printf("%s", table.c_str());
}

}  // namespace

void add_stress_verb(CLI::App& app) {
    CLI::App* sub = app.add_subcommand(
        "stress", "Glass, mirrors, leaves, wires, moving cars, roof lines: what goes wrong there, and how badly");
    auto options = std::make_shared<Options>();
    sub->add_option("scene", options->scene, "glass, mirror, foliage, wires, moving_car, roof_line, or all")
        ->capture_default_str();
    sub->add_option("-o,--output", options->output, "folder for stress.json, stress.csv, stress.md and pictures")
        ->capture_default_str();
    sub->add_option("--width", options->width, "of the pictures, 64 to 4096")->capture_default_str();
    sub->add_option("--shifts", options->shifts, "metres to the left")->delimiter(',')->capture_default_str();
    sub->callback([options] { run(*options); });
}

}  // namespace vshift::cli
