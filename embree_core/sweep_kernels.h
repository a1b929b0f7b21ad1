// SPDX-License-Identifier: Apache-2.0
// Role: the vectorised loops of the sweep, chosen for the machine when the program runs (Highway).
#pragma once
#include <cstddef>
#include <cstdint>

#include "embree_core/depth_source.h"

namespace vshift::sweep {

/// Samples of 1/z are stored with this many floats (NaN) free before the first and after the last.
inline constexpr size_t padding = 64;
/// Keys are in 1 / key_scale pixels; nothing is nearer than this disparity.
inline constexpr float key_scale = 8192, largest_disparity_px = 65536;
/// 1/z above this is a surface; a sky pixel's is 0 or, with its mark, a denormal.
inline constexpr float least_solid = 1e-20f;
/// The key of what reaches to the camera's centre.
inline constexpr int32_t top_key = (1 << 30) + (1 << 20);

/// When neighbouring samples are torn apart: DepthRules, for one image axis.
struct TearRule {
    float px_per_q;  ///< focal length times baseline
    float tear_px, tear_break, crease_break;
    float constant, relative, squared;  ///< four errors of 1/z
};

/// One epipolar line, sample 0 first on the way to V.
struct LineRule {
    float gain0, gain_step;  ///< |disparity| of sample i is |gain0 + gain_step i| q / (1 - centre_z q)
    float centre_z;          ///< V's centre along R's axis, metres
    TearRule tear;
    InverseDepthError error;
    float reach;  ///< of a surface past its last sample, 0 to 1
};

/// a x + b y + c over the pixels of an image.
struct Linear {
    float a, b, c;
};

/// How a pixel's own point lies to V: for `outside` and `unseen`. A frustum's sides that no pixel can leave are left
/// out.
struct PixelRule {
    /// A side of V's frustum: the pixel's point lies beyond it where z * at + move < 0 (`strict`: where it is 0 too);
    /// the sky, where at < 0.
    struct Outside {
        Linear at;
        float move;
        bool strict;
    };
    /// A side of R's frustum, beyond which V lies: what the segment enters the ball round V by is beyond it too where V
    /// is farther off than clear_m + z * at (the sky: than at, with a ray of z = 1).
    Outside outside[4];
    Linear unseen[4];
    int outside_count = 0, unseen_count = 0;
    float ray_x0, ray_y0, ray_dx, ray_dy;  ///< recorded ray of pixel (x, y), z = 1
    float centre[3];
    float clear_m;
};

/// Neighbouring lines of a fan that are passed together, and what the pass knows of them. Sample u is the u-th of the
/// pass, which goes away from V.
struct Bundle {
    static constexpr size_t lines = 16, kept = 8;
    alignas(64) float q[kept][lines];  ///< 1/z of sample u is in q[u mod kept]; NaN outside the image
    int32_t row[kept];                 ///< where they lie across the lines: half a pixel past this one,
    float past_row[kept], step[kept];  ///< so much on, and from one line to the next
    uint32_t torn_across[kept];        ///< a bit where the pixel is, or may be, torn from the next nearest one
    alignas(64) int32_t key[2][lines];
    alignas(64) int32_t highest[lines];  ///< of `Horizon`
    alignas(64) int32_t gap_low[lines];  ///< its highest gap; the least number where there is none
    alignas(64) int32_t gap_high[lines];
    alignas(64) int32_t below_gap[lines];  ///< the highest key of the gaps below that one, or the least number
    uint32_t known = 0;                    ///< a bit for each line whose pass has begun
};

/// Where a bundle stands: sample u of its lines, at `major`.
struct BundlePlace {
    size_t u;  ///< of `Bundle::q` and `Bundle::key`
    int major;
    float position;
    uint32_t torn_behind, torn, torn_beyond;  ///< a bit per line, as in `Around`
    uint32_t crossing;                        ///< lines that come from another row of pixels over a tear between rows
    uint32_t begun;                           ///< lines that the pass had reached before this sample
};

/// A pass along a bundle, from major `first` on in steps of `step`.
struct BundleWalk {
    LineRule rule;       ///< sample 0 is that of the first major on the way to V
    const float* image;  ///< 1/z marked by `mark_row`; rows lie across the lines, with room as for `row_room`
    ptrdiff_t stride;
    int majors, minors;
    int begin, end;                  ///< the majors that may be read
    const double *origin, *spacing;  ///< per major: line j of the fan is at origin + j spacing
    double number, unit;             ///< of the bundle's first line, and from one to the next
    int first, step, count;
    /// Answers the lines of `lanes`, for which it takes more than some comparisons: occluded bits, and unknown ones
    /// << 16.
    uint32_t (*decide)(void* self, const BundlePlace& place, uint32_t lanes);
    /// Takes the answers at one major, if any bit is set.
    void (*put)(void* self, int major, uint32_t occluded, uint32_t unknown);
    void* self;
};

/// Rows that are read across lines begin with this many elements to spare, and end with at least so many.
inline constexpr int row_room = 24;

/// A line this near the border of two pixels, where it is sampled, counts as between them.
inline constexpr float between_pixels = 1e-3f;

struct Kernels {
    /// q = 1/z of a row: 0 sky, NaN no measurement.
    void (*inverse)(const float* z, size_t n, float* q);
    void (*inverse_reversed)(const float* z, size_t n, float* q);
    /// keys of samples 0..n-1; bit i of `torn` (16 to an element): samples i and i + 1 are not joined; bit i of
    /// `rising`: they are, and the key of i is the greater.
    void (*keys)(const LineRule& rule, const float* q, size_t n, int32_t* key, uint16_t* torn, uint16_t* rising);
    /// outside, unseen and unknown (no measurement) bits of a row of pixels, laid over `classes` (`reversed`: that run
    /// from the last pixel to the first). `out` may be `classes`, unless they are reversed.
    void (*pixels)(const PixelRule& rule, const float* z, int y, size_t n, const uint8_t* classes, bool reversed,
                   uint8_t* out);
    /// inverse() of columns x to x + count (16 at most) of rows y0 to y1 - 1: column k goes to q + k * stride, from its
    /// element y0 on.
    void (*inverse_columns)(const float* z, size_t width, size_t x, size_t count, size_t y0, size_t y1, float* q,
                            size_t stride);
    /// q of a row with its lowest bit set where a pixel is torn from the next one. `q` has values or NaN two elements
    /// before and after, and both rows room for a vector after that.
    void (*mark_row)(const float* q, size_t n, const TearRule& tear, float* marked);
};

const Kernels& kernels();

void walk(const BundleWalk& walk, Bundle& bundle);

}  // namespace vshift::sweep
