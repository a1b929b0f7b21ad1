// SPDX-License-Identifier: Apache-2.0
#include "embree_core/sweep_fan.h"

#include <tbb/blocked_range.h>
#include <tbb/enumerable_thread_specific.h>
#include <tbb/parallel_for.h>

#include <array>
#include <bit>

namespace vshift::sweep {
namespace {

// With the epipole nearer than this, lines are numbered from it; farther off that would take more digits than a
// whole number has, and no line is left out anyway.
constexpr double near_epipole_px = 65536;

}  // namespace

TearRule tear_rule(const DepthRules& rules, double px_per_q) {
    return {float(px_per_q),          float(rules.tear_px),     float(rules.tear_break), float(rules.crease_break),
            4 * rules.error.constant, 4 * rules.error.relative, 4 * rules.error.squared};
}

LineRule line_rule(const Axis& major, const SweepCamera& camera, int first, int heading) {
    const glm::dvec3& centre_m = camera.recorded_from_shifted.translation_m;
    const double centre_z = centre_m.z;
    LineRule rule;
    rule.gain0 = float((first + 0.5 - major.middle) * centre_z - major.focal * major.centre_m);
    rule.gain_step = float(heading * centre_z);
    rule.centre_z = float(centre_z);
    rule.tear = tear_rule(camera.rules, major.focal * glm::length(centre_m));
    rule.error = camera.rules.error;
    rule.reach = camera.reach_px;
    return rule;
}

std::pair<int, int> Fan::read(int major) const {
    // Bundles may begin and end a little farther out, and marks look two elements on.
    constexpr double margin = Bundle::lines + 4;
    const double across = reach(major) + margin;
    return {int(std::clamp(std::floor(epipole_minor - across), 0.0, double(minors))),
            int(std::clamp(std::ceil(epipole_minor + across), 0.0, double(minors)))};
}

void plan(const Axis& x, const Axis& y, double centre_z, double density, std::vector<Fan>& fans) {
    size_t count = 0;
    const auto next = [&](bool transposed, const Axis& major, const Axis& minor) -> Fan& {
        if (count == fans.size()) fans.emplace_back();
        Fan& fan = fans[count++];
        fan.transposed = transposed;
        fan.majors = major.size, fan.minors = minor.size;
        fan.origin.assign(size_t(major.size), 0.0);
        fan.spacing.assign(size_t(major.size), 1 / density);
        fan.level.assign(size_t(major.size), 0);
        return fan;
    };
    const double dx = x.focal * x.centre_m, dy = y.focal * y.centre_m;
    // With the epipole this far away no line of the image turns by a hundredth of a pixel.
    const double size = std::max(x.size, y.size);
    const bool parallel = std::max(std::fabs(dx), std::fabs(dy)) > 100 * size * size * std::fabs(centre_z);
    for (const bool transposed : {false, true}) {
        const Axis &major = transposed ? y : x, &minor = transposed ? x : y;
        const double along = transposed ? dy : dx, across = transposed ? dx : dy;
        if (parallel) {
            if (transposed ? std::fabs(along) <= std::fabs(across) : std::fabs(along) < std::fabs(across)) continue;
            Fan& fan = next(transposed, major, minor);
            fan.heading = along >= 0 ? 1 : -1;
            fan.major_begin = 0, fan.major_end = major.size;
            fan.epipole_major = std::numeric_limits<double>::infinity(), fan.epipole_minor = 0;
            const double slope = along != 0 ? across / along : 0;
            for (int m = 0; m < major.size; ++m) fan.origin[size_t(m)] = 0.5 + slope * (m + 1 - major.size);
            const double turn = slope * (major.size - 1);
            fan.first_line = int(std::floor(density * (std::min(0.0, turn) - 1)));
            fan.last_line = int(std::ceil(density * (std::max(0.0, turn) + minor.size + 1)));
            continue;
        }
        const double e_major = along / centre_z + major.middle, e_minor = across / centre_z + minor.middle;
        for (const int side : {-1, 1}) {
            const double far = side > 0 ? major.size - 0.5 : 0.5;
            const double reach = (far - e_major) * side;
            if (reach <= 0) continue;
            const int begin = side > 0 ? std::max(0, int(std::floor(e_major + 0.5))) : 0;
            const int end = side > 0 ? major.size : std::min(major.size, int(std::ceil(e_major - 0.5)));
            if (begin >= end) continue;
            const double nearest = std::max(1e-3, ((side > 0 ? begin : end - 1) + 0.5 - e_major) * side);
            // Where the image's borders, seen from the epipole, fall on the far border.
            double low = std::numeric_limits<double>::infinity(), high = -low;
            for (const double edge : {0.0, double(minor.size)})
                for (const double r : {nearest / reach, 1.0}) {
                    const double at = (edge - e_minor) / r;
                    low = std::min(low, at), high = std::max(high, at);
                }
            low = std::max(low, -reach), high = std::min(high, reach);
            if (low >= high) continue;
            Fan& fan = next(transposed, major, minor);
            fan.heading = centre_z > 0 ? -side : side;
            fan.major_begin = begin, fan.major_end = end;
            fan.epipole_major = e_major, fan.epipole_minor = e_minor;
            const bool near = std::max(std::fabs(e_major), std::fabs(e_minor)) < near_epipole_px;
            const double far_minor = near ? e_minor : 0.5;  // of line 0 at the far border
            const double origin = e_minor - far_minor;
            fan.first_line = int(std::floor(density * (low + origin - 2)));
            fan.last_line = int(std::ceil(density * (high + origin + 2)));
            for (int m = begin; m < end; ++m) {
                const double share = std::max((m + 0.5 - e_major) * side / reach, 1e-6);
                fan.origin[size_t(m)] = e_minor - origin * share;
                fan.spacing[size_t(m)] = share / density;
                if (near) fan.level[size_t(m)] = int(std::min<double>(highest_level, std::floor(std::log2(1 / share))));
            }
        }
    }
    fans.resize(count);
}

void MarkedImage::fill(const Fan& fan, const DepthMap& depth, const TearRule& tear) {
    stride_ = fan.minors + 2 * row_room;
    const size_t width = size_t(depth.width);
    if (const size_t needed = size_t(fan.majors) * size_t(stride_); room_.size() < needed) room_.resize(needed);
    // Some rows at a time, first without marks.
    constexpr int band = 16;
    tbb::enumerable_thread_specific<std::vector<float>> rooms(
        [&] { return std::vector<float>(size_t(band) * size_t(stride_)); });
    const int begin = fan.major_begin, count = fan.major_end - fan.major_begin;
    tbb::parallel_for(0, (count + band - 1) / band, [&](int at) {
        const int first = begin + at * band, last = std::min(first + band, fan.major_end);
        float* room = rooms.local().data() + row_room;
        const std::pair<int, int> a = fan.read(first), b = fan.read(last - 1);
        const int from = std::min(a.first, b.first), to = std::max(a.second, b.second);
        if (from >= to) return;
        if (!fan.transposed)
            kernels().inverse_columns(depth.data.data(), width, size_t(first), size_t(last - first), size_t(from),
                                      size_t(to), room, size_t(stride_));
        for (int row = first; row < last; ++row) {
            float* q = room + ptrdiff_t(row - first) * stride_;
            float* marked = room_.data() + row_room + ptrdiff_t(row) * stride_;
            if (fan.transposed)
                kernels().inverse(&depth.data[size_t(row) * width + size_t(from)], size_t(to - from), q + from);
            for (const int beside : {from - 2, from - 1, to, to + 1})
                q[beside] = std::numeric_limits<float>::quiet_NaN();
            kernels().mark_row(q + from, size_t(to - from), tear, marked + from);
            // What lies past the image is as its border.
            if (from == 0) marked[-1] = marked[0];
            if (to == fan.minors) marked[to] = marked[to - 1];
        }
    });
}

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
        first_line_ = first_line, level_ = stretch.level;
        walk_.number = std::ldexp(first_line, level_), walk_.unit = std::ldexp(1, level_);
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
        kernels().walk(walk_, bundle_);
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
    int first_line_ = 0, level_ = 0;

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

}  // namespace

void sweep_fan(const SweepCamera& camera, const MarkedImage& image, Fan& fan, Grid<uint8_t>& out) {
    tbb::enumerable_thread_specific<BundleSweep> rooms([&] { return BundleSweep(camera, image, fan, out); });
    int before = -1;  // the level that the pass comes from
    for (const Stretch& stretch : stretches(fan)) {
        const auto [first, count] = lines_of(fan, stretch.level);
        std::swap(fan.horizons, fan.horizons_before);
        std::swap(fan.known, fan.known_before);
        if (fan.horizons.size() < size_t(count)) fan.horizons.resize(size_t(count));
        fan.known.assign(size_t(count), 0);
        const int first_now = first, level = stretch.level;
        tbb::parallel_for(0, count / int(Bundle::lines), [&](int at) {
            const int begin = at * int(Bundle::lines);
            if (before >= 0) {
                const int first_before = lines_of(fan, before).first;
                for (int k = begin; k < begin + int(Bundle::lines); ++k) {
                    // The line itself, or the one that it branches off from towards the epipole.
                    const int number = first_now + k;
                    const int from =
                        (before > level ? number / (1 << (before - level)) : number * (1 << (level - before))) -
                        first_before;
                    if (from < 0 || from >= int(fan.known_before.size()) || !fan.known_before[size_t(from)]) continue;
                    fan.horizons[size_t(k)] = fan.horizons_before[size_t(from)];
                    fan.known[size_t(k)] = 1;
                }
            }
            rooms.local().run(stretch, first_now + begin, &fan.horizons[size_t(begin)], &fan.known[size_t(begin)]);
        });
        before = stretch.level;
    }
}

}  // namespace vshift::sweep
