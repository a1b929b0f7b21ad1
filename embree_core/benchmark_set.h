// SPDX-License-Identifier: Apache-2.0
// Role: a benchmark set on disk (docs/set_layout.md): names, the manifest, scores over the whole set.
#pragma once
#include <filesystem>
#include <functional>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "embree_core/camera.h"
#include "embree_core/recipe.h"

namespace vshift {

/// A shift as a set names it.
struct NamedShift {
    std::string name;  ///< x+0.00_y+1.00_z+0.00_yaw+0.00
    Shift shift;
};
std::string shift_name(const Shift& shift);

/// SHIFT/FFFF/CAMERA.exr
std::filesystem::path item_path(const std::string& shift, int frame, const std::string& camera);

std::string sha256_of(const std::string& bytes);
std::string sha256_of_file(const std::filesystem::path& file);

/// manifest.json beside the recipe. Every change takes the set's lock and rewrites the file whole.
class Manifest {
public:
    /// Throws Error: io_failed when there is none, bad_input when it is no manifest.
    explicit Manifest(const std::filesystem::path& set_dir);
    std::vector<NamedShift> shifts() const;
    bool is_refused(const std::string& item) const;
    /// Where a shifted view really stands: the shift as named, or nearer where the set moved it out of
    /// something (`moved_to`).
    Shift shift_of(const std::string& item, const Shift& named) const;
    /// The file of the item is there and has the recorded hash; and it was made from `made_from`, unless that is empty.
    bool is_done(const std::string& item, const std::string& made_from = {}) const;
    void record_done(const std::string& item, const std::string& kind, double seconds,
                     const std::string& made_from = {});
    /// What an item is made from: the words of the request, and each file's hash where it is an item itself, else its
    /// size and time.
    std::string made_from(const std::string& request, const std::vector<std::filesystem::path>& files) const;
    const nlohmann::ordered_json& data() const { return data_; }
    const std::filesystem::path& folder() const { return folder_; }

private:
    std::filesystem::path folder_;
    nlohmann::ordered_json data_;
};

/// Verifies every item that is done; one line per fault. Planned items are counted, not faults.
struct SetCheck {
    std::vector<std::string> faults;
    uint64_t done = 0, planned = 0, refused = 0;
};
SetCheck check_set(const Manifest& manifest, const std::function<void(size_t, size_t, const std::string&)>& progress);

/// Scores of every method's masks, holes, warps and fills against the set's truth, in the layout of
/// docs/set_layout.md. `progress(done, total, what)` is called per item.
nlohmann::ordered_json score_set(const Recipe& recipe, const Manifest& manifest,
                                 const std::function<void(size_t, size_t, const std::string&)>& progress);

/// The mask and hole rows of `scores` as CSV.
std::string scores_csv(const nlohmann::ordered_json& scores);

/// Scores of one file against a truth file: mask channels of the same names, and R,G,B (docs/set_layout.md), where the
/// first channel of `region` is above 0.5 (empty: everywhere).
nlohmann::ordered_json score_pair(const std::filesystem::path& got, const std::filesystem::path& truth,
                                  const std::filesystem::path& region = {});

}  // namespace vshift
