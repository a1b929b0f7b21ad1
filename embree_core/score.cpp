// SPDX-License-Identifier: Apache-2.0
// Role: scores of masks and images against truth. Sums are taken row by row and rows are added in
// order, so that one thread and many give the same bytes.
#include "embree_core/score.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "embree_core/srgb.h"
#include "embree_core/structure.h"

namespace vshift {
namespace {

constexpr double not_a_number = std::numeric_limits<double>::quiet_NaN();

std::string size_text(int width, int height) {
    return std::to_string(width) + "x" + std::to_string(height);
}

template <class A, class B>
void require_same_size(const Grid<A>& got, const Grid<B>& expected, const char* field) {
    if (got.width != expected.width || got.height != expected.height || got.size() != expected.size())
        throw Error(ExitCode::bad_input, std::string("score: ") + field + " size: got " +
                                             size_text(got.width, got.height) + ", expected " +
                                             size_text(expected.width, expected.height));
}

/// Calls `work(row)` for every row, in any order and on any thread.
template <class Work>
void for_rows(int height, Work&& work) {
    tbb::parallel_for(tbb::blocked_range<int>(0, height, 8), [&](const tbb::blocked_range<int>& rows) {
        for (int y = rows.begin(); y != rows.end(); ++y) work(y);
    });
}

/// part / whole, and `empty` when there is nothing to share.
double ratio(uint64_t part, uint64_t whole, double empty) {
    return whole == 0 ? empty : double(part) / double(whole);
}

double harmonic(double precision, double recall) {
    return precision + recall > 0 ? 2 * precision * recall / (precision + recall) : 0;
}

/// 1 where a set valid pixel has a clear valid 4-neighbour inside the image.
Mask boundary_of(const Mask& mask, const Mask* valid) {
    Mask boundary(mask.width, mask.height);
    for_rows(mask.height, [&](int y) {
        const auto clear = [&](int i, int j) {
            return i >= 0 && j >= 0 && i < mask.width && j < mask.height && mask.at(i, j) == 0 &&
                   (!valid || valid->at(i, j) != 0);
        };
        for (int x = 0; x < mask.width; ++x)
            boundary.at(x, y) = mask.at(x, y) != 0 && (!valid || valid->at(x, y) != 0) &&
                                (clear(x - 1, y) || clear(x + 1, y) || clear(x, y - 1) || clear(x, y + 1));
    });
    return boundary;
}

/// Distance along the column to the nearest set pixel; a large number where the column has none.
Grid<int> column_distance(const Mask& mask) {
    constexpr int far = std::numeric_limits<int>::max() / 2;
    Grid<int> distance(mask.width, mask.height, far);
    tbb::parallel_for(tbb::blocked_range<int>(0, mask.width, 64), [&](const tbb::blocked_range<int>& columns) {
        const auto relax = [&](int y, int from) {
            for (int x = columns.begin(); x != columns.end(); ++x) {
                if (mask.at(x, y))
                    distance.at(x, y) = 0;
                else if (from >= 0 && from < mask.height)
                    distance.at(x, y) = std::min(distance.at(x, y), distance.at(x, from) + 1);
            }
        };
        for (int y = 0; y < mask.height; ++y) relax(y, y - 1);
        for (int y = mask.height - 1; y >= 0; --y) relax(y, y + 1);
    });
    return distance;
}

struct Matched {
    uint64_t total = 0, near = 0;
};

/// How many set pixels of `boundary` have a set pixel of the other within the tolerance. Exact: the
/// nearest in each column within reach is all that can matter, and distances are whole squares.
Matched match(const Mask& boundary, const Grid<int>& other, double tolerance_px) {
    // The slack lets sqrt(13) reach 2 across and 3 down, though its double squares to less than 13.
    const double reach = tolerance_px * tolerance_px * (1 + 1e-12);
    const int span = int(std::min(std::sqrt(reach), double(boundary.width)));
    std::vector<Matched> rows(size_t(boundary.height));
    for_rows(boundary.height, [&](int y) {
        Matched& row = rows[size_t(y)];
        for (int x = 0; x < boundary.width; ++x) {
            if (!boundary.at(x, y)) continue;
            ++row.total;
            const int begin = std::max(0, x - span), end = std::min(boundary.width - 1, x + span);
            for (int i = begin; i <= end; ++i) {
                const double across = i - x, down = other.at(i, y);
                if (across * across + down * down > reach) continue;
                ++row.near;
                break;
            }
        }
    });
    Matched sum;
    for (const Matched& row : rows) sum.total += row.total, sum.near += row.near;
    return sum;
}

struct RowSum {
    double sum = 0;
    uint64_t count = 0;
};

RowSum added(const std::vector<RowSum>& rows) {
    RowSum total;
    for (const RowSum& row : rows) total.sum += row.sum, total.count += row.count;
    return total;
}

bool inside(const Mask* region, int x, int y) {
    return !region || region->at(x, y) != 0;
}

}  // namespace

MaskScore score_mask(const Mask& got, const Mask& truth, const Mask* valid) {
    require_same_size(got, truth, "mask");
    if (valid) require_same_size(*valid, truth, "valid");
    std::vector<Confusion> rows(size_t(truth.height));
    for_rows(truth.height, [&](int y) {
        Confusion& row = rows[size_t(y)];
        for (int x = 0; x < truth.width; ++x) {
            if (!inside(valid, x, y)) continue;
            const bool g = got.at(x, y) != 0, t = truth.at(x, y) != 0;
            row.true_positive += g && t;
            row.false_positive += g && !t;
            row.false_negative += !g && t;
            row.true_negative += !g && !t;
        }
    });
    MaskScore score;
    Confusion& sum = score.counts;
    for (const Confusion& row : rows) {
        sum.true_positive += row.true_positive;
        sum.false_positive += row.false_positive;
        sum.false_negative += row.false_negative;
        sum.true_negative += row.true_negative;
    }
    const uint64_t tp = sum.true_positive, fp = sum.false_positive, fn = sum.false_negative;
    score.iou = ratio(tp, tp + fp + fn, 1);
    score.precision = ratio(tp, tp + fp, fn == 0 ? 1 : 0);
    score.recall = ratio(tp, tp + fn, fp == 0 ? 1 : 0);
    score.f1 = ratio(2 * tp, 2 * tp + fp + fn, 1);
    return score;
}

BoundaryScore score_boundary(const Mask& got, const Mask& truth, double tolerance_px, const Mask* valid) {
    require_same_size(got, truth, "mask");
    if (valid) require_same_size(*valid, truth, "valid");
    if (!(tolerance_px >= 0) || !std::isfinite(tolerance_px))
        throw Error(ExitCode::bad_input, "score: tolerance_px: got no finite number, expected 0 or more");
    const Mask got_edge = boundary_of(got, valid), truth_edge = boundary_of(truth, valid);
    const Matched of_got = match(got_edge, column_distance(truth_edge), tolerance_px);
    const Matched of_truth = match(truth_edge, column_distance(got_edge), tolerance_px);
    BoundaryScore score;
    score.got_px = of_got.total;
    score.truth_px = of_truth.total;
    score.precision = ratio(of_got.near, of_got.total, of_truth.total == 0 ? 1 : 0);
    score.recall = ratio(of_truth.near, of_truth.total, of_got.total == 0 ? 1 : 0);
    score.f1 = harmonic(score.precision, score.recall);
    return score;
}

double psnr_db(const ColorImage& got, const ColorImage& truth, const Mask* region) {
    require_same_size(got, truth, "image");
    if (region) require_same_size(*region, truth, "region");
    std::vector<RowSum> rows(size_t(truth.height));
    for_rows(truth.height, [&](int y) {
        RowSum& row = rows[size_t(y)];
        for (int x = 0; x < truth.width; ++x) {
            if (!inside(region, x, y)) continue;
            const glm::vec3 &g = got.at(x, y), &t = truth.at(x, y);
            for (int c = 0; c < 3; ++c) {
                const double difference = double(g[c]) - double(t[c]);
                row.sum += difference * difference;
            }
            row.count += 3;
        }
    });
    const RowSum total = added(rows);
    if (total.count == 0) return not_a_number;
    if (total.sum == 0) return std::numeric_limits<double>::infinity();
    return -10 * std::log10(total.sum / double(total.count));
}

double ssim(const ColorImage& got, const ColorImage& truth, const Mask* region) {
    require_same_size(got, truth, "image");
    if (region) require_same_size(*region, truth, "region");
    const SsimMaps maps = ssim_maps(luma(got), luma(truth));
    RowSum total;
    for (size_t i = 0; i < maps.ssim.size(); ++i)
        if (!region || region->data[i]) total.sum += maps.ssim.data[i], ++total.count;
    return total.count == 0 ? not_a_number : total.sum / double(total.count);
}

ColorImage srgb_from_linear(const ColorImage& linear) {
    ColorImage srgb(linear.width, linear.height);
    for_rows(linear.height, [&](int y) {
        for (int x = 0; x < linear.width; ++x)
            for (int c = 0; c < 3; ++c) srgb.at(x, y)[c] = float(srgb_from_linear(double(linear.at(x, y)[c])));
    });
    return srgb;
}

}  // namespace vshift
