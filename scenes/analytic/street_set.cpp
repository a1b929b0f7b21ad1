// SPDX-License-Identifier: Apache-2.0
#include "scenes/analytic/street_set.h"

#include "embree_core/benchmark_set.h"
#include "embree_core/version.h"
#include "scenes/analytic/analytic_street.h"
#include "scenes/scene_files.h"

namespace vshift::analytic {
namespace {

namespace fs = std::filesystem;
using nlohmann::ordered_json;
constexpr int steps_per_frame = 4;  // of metres_per_frame

/// What the set's manifest says of a file that was just written.
void add_item(ordered_json& items, const fs::path& folder, const fs::path& item, const char* kind) {
    items[item.string()] = {{"kind", kind},
                            {"status", "done"},
                            {"sha256", sha256_of_file(folder / item)},
                            {"bytes", fs::file_size(folder / item)},
                            {"seconds", 0.0}};
}

}  // namespace

void write_street_set(const StreetSetOptions& options) {
    if (options.frames > (most_frames - 1) / steps_per_frame + 1)
        throw Error(ExitCode::bad_input, "frames: got " + std::to_string(options.frames) + ", expected at most " +
                                             std::to_string((most_frames - 1) / steps_per_frame + 1));
    const StreetScene street = build_street(options.seed);
    const std::vector<RigCamera> rig = six_camera_rig(options.width, options.height);
    minimal::MinimalScene set;
    set.name = "set";
    set.shift.translation_m = {0, 1, 0};
    for (const RigCamera& c : rig) set.rig.push_back({c.name, c.intrinsics, c.ego_from_cam});
    ordered_json shifts = ordered_json::array(), items;
    std::vector<NamedShift> named;
    for (const double left_m : {1.0, -1.0, 2.0, -2.0, 4.0, -4.0}) {
        Shift shift;
        shift.translation_m = {0, left_m, 0};
        named.push_back({shift_name(shift), shift});
        shifts.push_back({{"name", named.back().name}, {"shift", {0, left_m, 0}}, {"yaw_deg", 0}});
    }
    const auto write = [&](const fs::path& item, Channels& image, const char* kind, std::vector<SampleType> types) {
        fs::create_directories((options.folder / item).parent_path());
        write_image(options.folder / item, image, types);
        add_item(items, options.folder, item, kind);
    };
    const SampleType half = SampleType::float16, whole = SampleType::float32;
    for (int f = 0; f < options.frames; ++f) {
        const int step = f * steps_per_frame;
        set.frames.push_back(ego_pose(step));
        const std::vector<TrueCamera> recorded = recorded_rig(rig, step);
        for (size_t c = 0; c < rig.size(); ++c) {
            Channels image = minimal::sized(options.width, options.height);
            image.add_color(street_color(street, recorded[c], options.samples));
            image.add("Z", cast_camera(street.scene, recorded[c]).depth.data);
            write(fs::path("frames") / minimal::frame_folder(size_t(f)) / (rig[c].name + ".exr"), image, "recorded",
                  {half, half, half, whole});
            for (const NamedShift& shift : named) {
                const fs::path item = item_path(shift.name, f, rig[c].name);
                const TrueCamera v = shifted_camera(rig[c], step, shift.shift);
                const ShiftedTruth seen = truth_shifted(street.scene, recorded, int(c), v);
                Channels shown = minimal::sized(options.width, options.height);
                shown.add_color(street_color(street, v, options.samples));
                shown.add("Z", seen.depth.data);
                shown.add("truth.class", {seen.klass.data.begin(), seen.klass.data.end()});
                shown.add("truth.source", {seen.source.data.begin(), seen.source.data.end()});
                write(fs::path("shifts") / item, shown, "shifted", {half, half, half, whole, half, half});
                const StreetTruth truth = street_truth(street, rig, int(c), step, shift.shift);
                Channels flags = minimal::sized(options.width, options.height);
                minimal::add_flags(flags, "lost", truth.truth_flags, VSHIFT_TRUTH_OCCLUDED | VSHIFT_TRUTH_OUTSIDE);
                minimal::add_flags(flags, "occluded", truth.truth_flags, VSHIFT_TRUTH_OCCLUDED);
                minimal::add_flags(flags, "outside", truth.truth_flags, VSHIFT_TRUTH_OUTSIDE);
                minimal::add_flags(flags, "sky", truth.truth_flags, VSHIFT_TRUTH_SKY);
                minimal::add_flags(flags, "shell_self", truth.truth_flags, VSHIFT_TRUTH_SHELL_SELF);
                minimal::add_flags(flags, "shell_rig", truth.truth_flags, VSHIFT_TRUTH_SHELL_RIG);
                minimal::add_flags(flags, "faces_away", truth.truth_flags, VSHIFT_TRUTH_FACES_AWAY);
                write(fs::path("truth") / item, flags, "truth", {half});
            }
        }
    }
    ordered_json recipe = minimal::recipe_of(set, "exr", 0.2);
    recipe["camera"] = "CAM_FRONT";
    write_whole_file(options.folder / "set.vshift", recipe.dump(2) + "\n");
    add_item(items, options.folder, "set.vshift", "recipe");
    char hash[17];
    std::snprintf(hash, sizeof hash, "%016llx", (unsigned long long)geometry_hash(street.street));
    const ordered_json manifest = {
        {"vshift_manifest", 1},
        {"versions", {{"vshift", version_string}}},
        {"machine", ordered_json::object()},
        {"street",
         {{"seed", options.seed},
          {"kind", "analytic"},
          {"geometry_hash", hash},
          {"triangles", street.street.triangles.size()}}},
        {"render",
         {{"width", options.width}, {"height", options.height}, {"samples", options.samples * options.samples}}},
        {"conventions",
         {{"camera_frame", "x right, y down, z forward"},
          {"pixel_centre", 0.5},
          {"depth", "planar z, metres, +inf sky"}}},
        {"shifts", shifts},
        {"items", items}};
    write_whole_file(options.folder / "manifest.json", manifest.dump(1) + "\n");
}

}  // namespace vshift::analytic
