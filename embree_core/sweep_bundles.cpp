// SPDX-License-Identifier: Apache-2.0
// Role: the pass over a fan, sixteen lines at a time (`walk`): what it knows of each between two levels, what
// takes more than comparisons, and the pixels.
#include <tbb/enumerable_thread_specific.h>
#include <tbb/parallel_for.h>

#include <bit>

#include "embree_core/sweep_fan.h"

namespace vshift::sweep {
namespace {

/// The majors of a fan that one level's lines pass, in the order of the pass.
struct Stretch {
    int level;
    int first, count;
};

std::vector<Stretch> stretches(const Fan& fan) {
    std::vector<Stretch> all;
    const int step = -fan.heading;
    const int first = fan.heading > 0 ? fan.major_end - 1 : fan.major_begin;
    for (int m = first; m >= fan.major_begin && m < fan.major_end; m += step) {
        if (all.empty() || all.back().level != fan.level[size_t(m)]) all.push_back({fan.level[size_t(m)], m, 0});
        ++all.back().count;
    }
    return all;
}

int divide_down(int a, int b) {
    return a >= 0 ? a / b : -((-a + b - 1) / b);
}

/// The first and the number of the lines of a fan that pass a level, in the level's own numbers.
std::pair<int, int> lines_of(const Fan& fan, int level) {
    const int first = divide_down(fan.first_line, 1 << level), last = divide_down(fan.last_line, 1 << level) + 1;
    return {first, (last - first + int(Bundle::lines)) / int(Bundle::lines) * int(Bundle::lines)};
}

/// The rule of depth_source.h for samples `a` and `b`, as `Kernels::keys` and `mark_row` have it.
bool is_torn(float before, float a, float b, float after, const TearRule& rule) {
    const bool both = is_solid(a) && is_solid(b), neither = a <= least_solid && b <= least_solid;
    const float change = b - a, step = std::fabs(change);
    if (neither || (both && !(rule.px_per_q * step > rule.tear_px))) return false;
    if (!both) return true;
    const float left = before - a + change, right = after - b - change;
    const float share = left * right > 0 ? rule.crease_break : rule.tear_break;
    const float q = std::max(a, b), errors = q * (q * rule.squared + rule.relative) + rule.constant;
    const auto size = [](float bend) {
        return bend == bend ? std::fabs(bend) : std::numeric_limits<float>::infinity();
    };
    return std::min(size(left), size(right)) >= share * step + errors;
}

/// Passes bundles of a fan; one per thread.
class BundleSweep {
public:
    BundleSweep(const BundleSweep&) = delete;
    BundleSweep(const SweepCamera& camera, const MarkedImage& image, const Fan& fan, Grid<uint8_t>& out)
        : camera_(camera), image_(image), fan_(fan), out_(out) {
        const Intrinsics& k = camera.recorded;
        const glm::dvec3& c = camera.recorded_from_shifted.translation_m;
        const Axis major = fan.transposed ? Axis{k.fy, k.cy, c.y, k.height} : Axis{k.fx, k.cx, c.x, k.width};
        walk_.rule = line_rule(major, camera, fan.heading > 0 ? 0 : fan.majors - 1, fan.heading);
        walk_.image = image.row(0), walk_.stride = image.stride();
        walk_.majors = fan.majors, walk_.minors = fan.minors;
        walk_.begin = fan.major_begin, walk_.end = fan.major_end;
        walk_.origin = fan.origin.data(), walk_.spacing = fan.spacing.data();
        walk_.step = -fan.heading;
        walk_.decide = [](void* self, const BundlePlace& place, uint32_t lanes) {
            return static_cast<BundleSweep*>(self)->decide(place, lanes);
        };
        walk_.put = [](void* self, int major, uint32_t occluded, uint32_t unknown) {
            static_cast<BundleSweep*>(self)->put(major, occluded, unknown);
        };
        walk_.self = this;
    }

    /// Lines `first_line` and on of the stretch, in its level's numbers. `horizons` and `known` are what was known of
    /// each before, and what is after.
    void run(const Stretch& stretch, int first_line, Horizon* horizons, uint8_t* known) {
        first_line_ = first_line;
        walk_.number = std::ldexp(first_line, stretch.level), walk_.unit = std::ldexp(1, stretch.level);
        int first = stretch.first, count = stretch.count;
        // Only where the bundle is in the image: from one major to another.
        while (count > 0 && !in_image(first)) first += walk_.step, --count;
        const bool begins = first == stretch.first;
        const int whole = count;
        while (count > 0 && !in_image(first + walk_.step * (count - 1))) --count;
        if (count == 0) {
            std::fill_n(known, Bundle::lines, uint8_t(0));
            return;
        }
        horizons_ = horizons;
        bundle_.known = 0;
        for (size_t k = 0; k < Bundle::lines; ++k) {
            if (begins && known[k]) bundle_.known |= 1u << k;
            keep(k);
        }
        walk_.first = first, walk_.count = count;
        walk(walk_, bundle_);
        for (size_t k = 0; k < Bundle::lines; ++k) {
            known[k] = count == whole && (bundle_.known >> k & 1);
            give_back(k);
        }
    }

private:
    const SweepCamera& camera_;
    const MarkedImage& image_;
    const Fan& fan_;
    Grid<uint8_t>& out_;
    BundleWalk walk_;
    Bundle bundle_;
    Horizon* horizons_ = nullptr;
    int first_line_ = 0;

    /// Where one of the bundle's lines is at a major.
    double minor_of(double line, int major) const {
        return fan_.origin[size_t(major)] + (walk_.number + line * walk_.unit) * fan_.spacing[size_t(major)];
    }
    bool in_image(int major) const {
        return minor_of(0, major) <= fan_.minors + 1 && minor_of(Bundle::lines - 1, major) >= -1;
    }

    /// Between a line's horizon and what the bundle has of it.
    void keep(size_t k) {
        const Horizon& h = horizons_[k];
        const Gaps::Range gap = h.gaps.from_above(0);
        bundle_.highest[k] = h.highest, bundle_.gap_low[k] = gap.low, bundle_.gap_high[k] = gap.high;
        bundle_.below_gap[k] = h.gaps.from_above(1).high;
    }
    void give_back(size_t k) {
        horizons_[k].highest = bundle_.highest[k];
        horizons_[k].gaps.raise_highest(bundle_.gap_low[k]);
    }

    /// As `sweep::free_from`, at a place of a line.
    double free_from(size_t lane, double position) const {
        const double along = fan_.heading > 0 ? position : fan_.majors - 1 - position;
        const int major = std::clamp(int(along), fan_.major_begin, fan_.major_end - 1);
        const int beside = major + 1 < fan_.major_end ? major + 1 : std::max(major - 1, fan_.major_begin);
        const double at = minor_of(double(lane), major);
        const double slope = beside == major ? 0 : (minor_of(double(lane), beside) - at) / (beside - major);
        const double minor = at + (along - major) * slope;
        return sweep::free_from(
            ray(camera_.recorded, fan_.transposed ? glm::dvec2(minor, along + 0.5) : glm::dvec2(along + 0.5, minor)),
            camera_.recorded_from_shifted.translation_m, camera_.clear_m);
    }

    /// Where the tears between the sample at `major` and the one ahead lie: midway between the two, and where the line
    /// crosses into another row of pixels if those are torn there. On its way it may pass over the corner of a third
    /// pixel, which is in the row of one sample and beside the other.
    void place_tears(size_t lane, int major, Around& around) const {
        const int ahead = major - walk_.step;
        if (ahead < fan_.major_begin || ahead >= fan_.major_end) return;
        const float at = float(minor_of(double(lane), major)), to = float(minor_of(double(lane), ahead));
        const int lower = int(0.5f * (at + to) + 0.5f);  // the border of rows that it is nearest to on its way
        const float before = float(lower) - at, after = to - float(lower);
        // At a sample itself it crosses a border for either side of it or for none.
        if (before * after <= 0 || std::min(std::fabs(before), std::fabs(after)) < between_pixels || lower < 1 ||
            lower >= fan_.minors)
            return;
        constexpr float digits = 256, middle = 0.5f;  // few enough for whole keys
        const float share = float(int(before / (to - at) * digits + 0.5f)) / digits;
        // The third pixel is in the sample's column, or in the one ahead; where the line passes between two, the
        // nearer.
        const auto at_row = [&](int m, int row) {
            return m < fan_.major_begin || m >= fan_.major_end ? std::numeric_limits<float>::quiet_NaN()
                                                               : image_.row(m)[row];
        };
        const int row = at < to ? lower - 1 : lower, row_ahead = at < to ? lower : lower - 1;
        const bool in_own = share < middle || (share == middle && at_row(major, row_ahead) > at_row(ahead, row));
        const int third = in_own ? row_ahead : row;
        const float* column = image_.row(in_own ? major : ahead);
        if (!(std::bit_cast<uint32_t>(column[lower - 1]) & 1)) return;
        around.tear = around.tear_ahead = share;
        if (is_invalid(column[third])) return;
        const int step = walk_.step;
        if (!is_torn(at_row(major + step, third), at_row(major, third), at_row(ahead, third),
                     at_row(ahead - step, third), walk_.rule.tear))
            return;
        around.between = column[third];
        around.tear = share == middle ? middle - 1 / digits : std::min(share, middle);
        around.tear_ahead = share == middle ? middle + 1 / digits : std::max(share, middle);
    }

    uint32_t decide(const BundlePlace& at, uint32_t lanes) {
        const Bundle& b = bundle_;
        uint32_t answers = 0;
        const float *behind = b.q[(at.u + 1) % Bundle::kept], *here = b.q[at.u % Bundle::kept],
                    *ahead = b.q[(at.u - 1) % Bundle::kept], *beyond = b.q[(at.u - 2) % Bundle::kept];
        const int32_t *key = b.key[at.u % 2], *key_ahead = b.key[(at.u + 1) % 2];
        for (; lanes; lanes &= lanes - 1) {
            const size_t k = size_t(std::countr_zero(lanes));
            const auto bit = [k](uint32_t bits) { return bool(bits >> k & 1); };
            Around around{behind[k],           here[k], ahead[k],     beyond[k],     bit(at.torn_behind), bit(at.torn),
                          bit(at.torn_beyond), key[k],  key_ahead[k], !bit(at.begun)};
            if (bit(at.crossing) && !around.is_last) place_tears(k, at.major, around);
            Horizon& horizon = horizons_[k];
            give_back(k);
            const uint8_t answer =
                horizon.pass(walk_.rule, at.position, around, [&](double position) { return free_from(k, position); });
            keep(k);
            answers |= uint32_t(answer == occluded_bit) << k | uint32_t(answer == unknown_bit) << (Bundle::lines + k);
        }
        return answers;
    }

    /// Each pixel takes the answer of its nearest line.
    void put(int major, uint32_t occluded, uint32_t unknown) {
        const uint32_t any = occluded | unknown;
        const double origin = fan_.origin[size_t(major)], per_px = 1 / (fan_.spacing[size_t(major)] * walk_.unit);
        const double low = minor_of(std::countr_zero(any) - 0.5, major) - 0.5;
        const double high = minor_of(31 - std::countl_zero(any) + 0.5, major) - 0.5;
        const int begin = int(std::max(0.0, std::ceil(low - 1e-3)));
        const int end = int(std::min(double(fan_.minors), std::floor(high + 1e-3) + 1));
        const double reach = fan_.reach(major);
        for (int minor = begin; minor < end; ++minor) {
            const int lane = int(std::lrint((minor + 0.5 - origin) * per_px)) - first_line_;
            if (lane < 0 || lane >= int(Bundle::lines) || !(any >> lane & 1)) continue;
            const double across = std::fabs(minor + 0.5 - fan_.epipole_minor);
            if (fan_.transposed ? across >= reach : across > reach) continue;
            const uint8_t answer = occluded >> lane & 1 ? occluded_bit : unknown_bit;
            (fan_.transposed ? out_.at(minor, major) : out_.at(major, minor)) = answer;
        }
    }
};

/// The horizon of line `number` of a level, in the level's own numbers, from the level that the pass comes from: its
/// own, or that of the line that it branches off from, on the epipole's side.
void go_on_from(Fan& fan, int level_before, int level, int number, size_t at) {
    const int own =
        level_before > level ? number / (1 << (level_before - level)) : number * (1 << (level - level_before));
    const int from = own - lines_of(fan, level_before).first;
    if (from < 0 || from >= int(fan.known_before.size()) || !fan.known_before[size_t(from)]) return;
    fan.horizons[at] = fan.horizons_before[size_t(from)];
    fan.known[at] = 1;
}

}  // namespace

void sweep_fan(const SweepCamera& camera, const MarkedImage& image, Fan& fan, Grid<uint8_t>& out) {
    tbb::enumerable_thread_specific<BundleSweep> rooms([&] { return BundleSweep(camera, image, fan, out); });
    int before = -1;  // the level that the pass comes from, if it comes from one
    for (const Stretch& stretch : stretches(fan)) {
        const auto [first, count] = lines_of(fan, stretch.level);
        std::swap(fan.horizons, fan.horizons_before);
        std::swap(fan.known, fan.known_before);
        if (fan.horizons.size() < size_t(count)) fan.horizons.resize(size_t(count));
        fan.known.assign(size_t(count), 0);
        const int first_line = first;
        tbb::parallel_for(0, count / int(Bundle::lines), [&](int bundle) {
            const int begin = bundle * int(Bundle::lines);
            for (int k = begin; before >= 0 && k < begin + int(Bundle::lines); ++k)
                go_on_from(fan, before, stretch.level, first_line + k, size_t(k));
            rooms.local().run(stretch, first_line + begin, &fan.horizons[size_t(begin)], &fan.known[size_t(begin)]);
        });
        before = stretch.level;
    }
}

}  // namespace vshift::sweep
