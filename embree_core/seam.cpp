// SPDX-License-Identifier: Apache-2.0
#include "embree_core/seam.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <list>
#include <memory>

#include "embree_core/raster.h"

namespace vshift {
namespace {

SurfaceField field_of(const SurfaceView& view) {
    return {view.inverse_depth, view.tears};
}

/// A neighbour, ready for one target camera.
struct Neighbor {
    const SeamCamera* camera;
    int index;
    Sampler sampler;
    glm::dvec3 centre_m;  ///< world
    double axis_cosine;   ///< between its optical axis and the target's
    Pose cam_from_world;
    Reprojection* shown;

    glm::vec3 color(glm::vec2 source_px, glm::vec2 target_px, const glm::dvec3& from, const glm::dvec3& along,
                    double t) const {
        if (camera->bent) source_px = bent_source_px(*camera->bent, from, along, t);
        return camera->gain * sampler.at(source_px, target_px);
    }
};

std::list<Neighbor> neighbors_of(const std::vector<SeamCamera>& rig, int own, const Intrinsics& target,
                                 const Pose& world_from_target) {
    std::list<Neighbor> out;
    const glm::dvec3 axis = world_from_target.direction({0, 0, 1});
    for (size_t i = 0; i < rig.size(); ++i) {
        if (int(i) == own) continue;
        const SurfaceView& view = *rig[i].surface;
        const ProjectiveMap map = projective_map(view.intrinsics, view.world_from_cam, target, world_from_target);
        out.push_back({&rig[i], int(i), Sampler(field_of(view), *rig[i].image, map), view.world_from_cam.translation_m,
                       glm::dot(axis, view.world_from_cam.direction({0, 0, 1})), inverse(view.world_from_cam),
                       nullptr});
    }
    // Ties in viewing direction, and the sky, go to the camera that looks most nearly the same way.
    out.sort([](const Neighbor& a, const Neighbor& b) { return a.axis_cosine > b.axis_cosine; });
    return out;
}

/// How nearly the neighbour looks at point p as the target does, which looks along `along`.
double direction_cosine(const Neighbor& n, const glm::dvec3& p, const glm::dvec3& along) {
    const glm::dvec3 d = p - n.centre_m;
    return glm::dot(d, along) / std::sqrt(glm::dot(d, d) * glm::dot(along, along));
}

/// The neighbour whose colour is taken: of those that show the surface unmixed, or else of all, the one that looks most
/// nearly the same way.
struct Choice {
    const Neighbor* of = nullptr;
    bool mixed = true;
    glm::vec2 source_px{0};
    double cosine = -2, t = 0;

    void offer(const Neighbor& n, glm::vec2 at_px, EdgeBand edge, double its_cosine, double its_t) {
        if (!mixed && !(its_cosine > cosine)) return;
        const bool its_mixed = edge == EdgeBand::drop && n.sampler.is_edge(at_px);
        if (its_mixed == mixed ? its_cosine > cosine : mixed) *this = {&n, its_mixed, at_px, its_cosine, its_t};
    }
};

/// Where the neighbour saw the point t along a ray of the target (infinite: the sky), if it did.
std::optional<glm::vec2> seen_at(const Neighbor& n, const glm::dvec3& from, const glm::dvec3& along, double t,
                                 double tolerance) {
    const bool sky = !std::isfinite(t);
    const SurfaceView& view = *n.camera->surface;
    const glm::dvec3 p = sky ? n.cam_from_world.direction(along) : n.cam_from_world.point(from + t * along);
    const auto u = project(view.intrinsics, p);
    if (!u || !in_image(view.intrinsics, *u)) return std::nullopt;
    const double w = double(surface_inverse_depth(view.inverse_depth, view.tears, *u));
    const bool same = sky ? w == 0 : std::fabs(w * p.z - 1) <= tolerance;
    return same ? std::optional(glm::vec2(*u)) : std::nullopt;
}

/// 1/Z in V above which a neighbour's surface is news to the own camera: 0 where that gave no colour; else where the
/// pixel's ray has left its frame towards V, and nearer than what it saw there. In its pixels and w = 1/Z of V the
/// planes of its frustum are a(x, y) + m w >= 0.
class Floor {
public:
    Floor(const SurfaceView& own, const ShiftedCamera& shifted, double tolerance)
        : width_(shifted.intrinsics.width), nearer_(float(1 / (1 - tolerance))) {
        const Intrinsics& k = own.intrinsics;
        const ProjectiveMap map = projective_map(shifted.intrinsics, shifted.world_from_cam, k, own.world_from_cam);
        const auto plane = [&](double x, double y, double z) {
            const glm::dvec3 of(x, y, z);
            return Plane{glm::dot(of, map.move), of * map.turn};
        };
        planes_ = {plane(1, 0, 0), plane(-1, 0, k.width), plane(0, 1, 0), plane(0, -1, k.height)};
        std::erase_if(planes_, [](const Plane& p) { return !(p.m < 0); });
    }
    void row(int y, const float* shown_q, const uint8_t* missing, float* out) const {
        constexpr float never = std::numeric_limits<float>::infinity(), least = std::numeric_limits<float>::min();
        std::fill_n(out, width_, never);
        for (const Plane& p : planes_) {
            const float step = float(-p.a.x / p.m), start = float(-(p.a.x * 0.5 + p.a.y * (y + 0.5) + p.a.z) / p.m);
            for (int x = 0; x < width_; ++x) out[x] = std::min(out[x], start + step * float(x));
        }
        for (int x = 0; x < width_; ++x) {
            const float here = std::max(std::max(out[x], shown_q[x] * nearer_), least);
            out[x] = missing[x] ? 0.0f : here;
        }
    }

private:
    struct Plane {
        double m;
        glm::dvec3 a;
    };
    std::vector<Plane> planes_;
    int width_;
    float nearer_;
};

/// The shifted view's rows, once the own camera's and the neighbours' are drawn.
class ShiftedRows {
public:
    ShiftedRows(const ShiftedCamera& shifted, int own_index, const Sampler& own_sampler, const SeamOptions& options,
                const std::list<Neighbor>& neighbors, ShiftedSeam& out)
        : width_(shifted.intrinsics.width),
          own_index_(own_index),
          own_sampler_(own_sampler),
          options_(options),
          centre_(shifted.world_from_cam.translation_m),
          out_(out),
          neighbors_(neighbors) {
        const Intrinsics& k = shifted.intrinsics;
        for (int x = 0; x < k.width; ++x)
            along_x_.push_back(shifted.world_from_cam.direction({(x + 0.5 - k.cx) / k.fx, 0, 0}));
        for (int y = 0; y < k.height; ++y)
            along_y_.push_back(shifted.world_from_cam.direction({0, (y + 0.5 - k.cy) / k.fy, 1}));
    }

    void decide(int y) const {
        const size_t first = size_t(y) * size_t(width_);
        std::vector<Row> rows;
        for (const Neighbor& n : neighbors_)
            if (const auto columns = n.shown->columns[size_t(y / Reprojection::band_rows)]; columns.x0 < columns.x1)
                rows.push_back({&n, columns, &n.shown->inverse_depth.data[first], &n.shown->sight.data[first],
                                &n.shown->source_px.data[first]});
        uint8_t* const asked = &out_.asked[first];
        const uint8_t* const missing = &out_.missing.data[first];
        const float *const floor = &out_.floor.data[first], *const own_q = &out_.own.inverse_depth.data[first];
        std::copy_n(missing, width_, asked);
        for (const Row& n : rows)
            for (int x = n.columns.x0; x < n.columns.x1; ++x) asked[x] |= n.q[x] > floor[x];
        int16_t* const source = &out_.seam.source.data[first];
        std::fill_n(source, width_, int16_t(own_index_));
        if (options_.depth) std::copy_n(own_q, width_, &out_.inverse_depth.data[first]);
        for (int x = 0; x < width_; ++x) {
            if (uint64_t eight; x + 8 <= width_) {
                std::memcpy(&eight, asked + x, 8);
                if (eight == 0) {
                    x += 7;
                    continue;
                }
            }
            if (!asked[x]) continue;
            float front = missing[x] ? own_q[x] : floor[x];
            for (const Row& n : rows)
                if (n.columns.holds(x)) front = std::max(front, n.q[x]);
            const float least = front * float(1 - options_.depth_tolerance);
            const Row* candidate = nullptr;
            int candidates = 0;
            for (const Row& n : rows)
                if (n.columns.holds(x) && is_seen(n.sight[x]) && !(n.q[x] < std::max(least, floor[x])))
                    candidate = &n, ++candidates;
            const bool own_stands = missing[x] && is_seen(out_.own.sight.data[first + size_t(x)]) && own_q[x] >= least;
            bool mixed = true;
            if (candidates > 1)
                candidate = best_of(rows, x, y, std::max(least, floor[x]), mixed);
            else if (candidate && own_stands)
                mixed = options_.edge == EdgeBand::drop && candidate->of->sampler.is_edge(candidate->source_px[x]);
            const size_t at = first + size_t(x);
            float shown_q = own_q[x];
            if (mixed && own_stands) {
                out_.seam.color.data[at] = own_sampler_.at(out_.own.source_px.data[at], {x + 0.5f, y + 0.5f});
            } else if (candidate) {
                shown_q = candidate->q[x];
                source[x] = int16_t(candidate->of->index);
            } else {
                shown_q = std::numeric_limits<float>::quiet_NaN();
                source[x] = -1;
                out_.seam.color.data[at] = glm::vec3(0);
            }
            if (options_.depth) out_.inverse_depth.data[at] = shown_q;
        }
        for (const Row& n : rows) color(n, y, source, &out_.seam.color.data[first]);
    }

private:
    struct Row {
        const Neighbor* of;
        Reprojection::Columns columns;
        const float* q;
        const Sight* sight;
        const glm::vec2* source_px;
    };
    int width_, own_index_;
    const Sampler& own_sampler_;
    const SeamOptions& options_;
    glm::dvec3 centre_;
    ShiftedSeam& out_;
    const std::list<Neighbor>& neighbors_;
    std::vector<glm::dvec3> along_x_, along_y_;

    glm::dvec3 along(int x, int y) const { return along_x_[size_t(x)] + along_y_[size_t(y)]; }

    const Row* best_of(const std::vector<Row>& rows, int x, int y, float least, bool& mixed) const {
        Choice best;
        const Row* found = nullptr;
        for (const Row& n : rows) {
            if (!n.columns.holds(x) || !is_seen(n.sight[x]) || n.q[x] < least) continue;
            const double t = 1 / double(n.q[x]);
            const glm::dvec3 direction = along(x, y);
            const double cosine = n.q[x] > 0 ? direction_cosine(*n.of, centre_ + t * direction, direction) : 1;
            best.offer(*n.of, n.source_px[x], options_.edge, cosine, t);
            if (best.of == n.of) found = &n;
        }
        mixed = best.mixed;
        return found;
    }

    /// The colours of the pixels that a neighbour gives.
    void color(const Row& n, int y, const int16_t* source, glm::vec3* out) const {
        constexpr int most = 64, fewest = 4;  // a run costs as much as a few pixels by themselves
        for (int x0 = n.columns.x0; x0 < n.columns.x1; x0 += most) {
            const int count = std::min(most, n.columns.x1 - x0);
            int wanted = 0;
            Sight sight[most];
            for (int i = 0; i < count; ++i) {
                const bool is = source[x0 + i] == n.of->index;
                wanted += is;
                sight[i] = is ? Sight::seen : Sight::none;
            }
            if (wanted == 0) continue;
            if (wanted < fewest || n.of->camera->bent) {
                for (int x = x0; x < x0 + count; ++x)
                    if (sight[x - x0] == Sight::seen)
                        out[x] =
                            n.of->color(n.source_px[x], {x + 0.5f, y + 0.5f}, centre_, along(x, y), 1 / double(n.q[x]));
                continue;
            }
            glm::vec3 run[most];
            uint8_t missing[most];
            n.of->sampler.run(n.source_px + x0, {x0 + 0.5f, y + 0.5f}, size_t(count), sight, EdgeBand::keep, run,
                              missing);
            for (int i = 0; i < count; ++i)
                if (sight[i] == Sight::seen) out[x0 + i] = n.of->camera->gain * run[i];
        }
    }
};

}  // namespace

void seam_shifted(const std::vector<SeamCamera>& rig, int own_index, const ShiftedCamera& shifted,
                  const SeamOptions& options, ShiftedSeam& out) {
    const SeamCamera& own = rig.at(size_t(own_index));
    const Intrinsics& k = shifted.intrinsics;
    const size_t pixels = size_t(k.width) * size_t(k.height);
    std::list<Neighbor> neighbors = neighbors_of(rig, own_index, k, shifted.world_from_cam);
    out.neighbors.resize(neighbors.size());
    std::vector<Reprojection*> shown(rig.size(), &out.own);
    size_t place = 0;
    for (Neighbor& n : neighbors) shown[size_t(n.index)] = n.shown = &out.neighbors[place++];
    if (out.seam.color.width != k.width || out.seam.color.height != k.height)
        out.seam.color = ColorImage(k.width, k.height);
    if (out.missing.width != k.width || out.missing.height != k.height) {
        out.missing = Mask(k.width, k.height);
        out.seam.source = Grid<int16_t>(k.width, k.height);
        out.floor = Grid<float>(k.width, k.height);
    }
    out.asked.resize(pixels);
    if (options.depth && (out.inverse_depth.width != k.width || out.inverse_depth.height != k.height))
        out.inverse_depth = Grid<float>(k.width, k.height);

    std::vector<std::unique_ptr<Raster>> rasters(rig.size());
    tbb::parallel_for(size_t(0), rig.size(), [&](size_t i) {
        if (rig[i].lifted) return cast(*rig[i].lifted, shifted, *shown[i]);
        shown[i]->fit(k);
        rasters[i] = std::make_unique<Raster>(*rig[i].surface, shifted);
    });
    const auto draw = [&](int index, int band, const Grid<float>* floor) {
        if (const auto& raster = rasters[size_t(index)]) raster->band(band, floor, *shown[size_t(index)]);
    };
    const Sampler own_sampler(
        field_of(*own.surface), *own.image,
        projective_map(own.surface->intrinsics, own.surface->world_from_cam, k, shifted.world_from_cam));
    const Floor floor(*own.surface, shifted, options.depth_tolerance);
    const ShiftedRows rows(shifted, own_index, own_sampler, options, neighbors, out);
    each_band(out.own, [&](int band) {
        const int y0 = band * Reprojection::band_rows, y1 = std::min(y0 + Reprojection::band_rows, k.height);
        draw(own_index, band, nullptr);
        for (int y = y0; y < y1; ++y) {
            const size_t first = size_t(y) * size_t(k.width);
            warp_row(out.own, own_sampler, options.edge, y, out.seam.color, out.missing);
            floor.row(y, &out.own.inverse_depth.data[first], &out.missing.data[first], &out.floor.data[first]);
        }
        for (const Neighbor& n : neighbors) draw(n.index, band, &out.floor);
        for (int y = y0; y < y1; ++y) rows.decide(y);
    });
}

Seam seam_recorded(const std::vector<SeamCamera>& rig, int own_index, const Mask& lost, const SeamOptions& options) {
    const SeamCamera& own = rig.at(size_t(own_index));
    const Intrinsics& k = own.surface->intrinsics;
    const Pose& world_from_own = own.surface->world_from_cam;
    Seam out{*own.image, Grid<int16_t>(k.width, k.height, int16_t(own_index))};
    const std::list<Neighbor> neighbors = neighbors_of(rig, own_index, k, world_from_own);
    const glm::dvec3 centre = world_from_own.translation_m;
    tbb::parallel_for(0, k.height, [&](int y) {
        for (int x = 0; x < k.width; ++x) {
            const size_t at = size_t(y) * size_t(k.width) + size_t(x);
            if (!lost.data[at]) continue;
            out.color.data[at] = glm::vec3(0);
            out.source.data[at] = -1;
            const float w = own.surface->inverse_depth.data[at];
            if (!(w >= 0)) continue;
            const glm::dvec3 along = world_from_own.direction(ray(k, {x + 0.5, y + 0.5}));
            const double t = 1 / double(w);
            Choice best;
            for (const Neighbor& n : neighbors) {
                const double cosine = w > 0 ? direction_cosine(n, centre + t * along, along) : 1;
                if (!best.mixed && !(cosine > best.cosine)) continue;
                if (const auto u = seen_at(n, centre, along, t, options.depth_tolerance))
                    best.offer(n, *u, options.edge, cosine, t);
            }
            if (!best.of) continue;
            out.source.data[at] = int16_t(best.of->index);
            out.color.data[at] = best.of->color(best.source_px, {x + 0.5f, y + 0.5f}, centre, along, t);
        }
    });
    return out;
}

glm::vec3 fitted_gain(const SeamCamera& own, const SeamCamera& neighbor, double depth_tolerance, bool per_channel) {
    constexpr int step = 4;
    constexpr size_t fewest = 64;
    constexpr float darkest = 0.004f, brightest = 0.98f;  // of linear light: noise below, clipped above
    const Intrinsics& k = own.surface->intrinsics;
    const Pose& world_from_own = own.surface->world_from_cam;
    const std::vector<SeamCamera> pair{own, neighbor};
    const std::list<Neighbor> found = neighbors_of(pair, 0, k, world_from_own);
    const Neighbor& n = found.front();
    std::vector<std::vector<glm::vec3>> rows(size_t((k.height + step - 1) / step));
    tbb::parallel_for(size_t(0), rows.size(), [&](size_t r) {
        const int y = int(r) * step;
        for (int x = 0; x < k.width; x += step) {
            const float w = own.surface->inverse_depth.at(x, y);
            if (!(w >= 0)) continue;
            const glm::dvec3 along = world_from_own.direction(ray(k, {x + 0.5, y + 0.5}));
            const auto u = seen_at(n, world_from_own.translation_m, along, 1 / double(w), depth_tolerance);
            if (!u) continue;
            const glm::vec3 a = own.image->at(x, y), b = neighbor.gain * n.sampler.at(*u, {x + 0.5f, y + 0.5f});
            const auto good = [&](const glm::vec3& c) {
                return std::min({c.x, c.y, c.z}) > darkest && std::max({c.x, c.y, c.z}) < brightest;
            };
            if (good(a) && good(b)) rows[r].push_back(glm::log2(a) - glm::log2(b));
        }
    });
    std::vector<glm::vec3> all;
    for (const auto& row : rows) all.insert(all.end(), row.begin(), row.end());
    if (all.size() < fewest) return glm::vec3(1);
    const auto median = [&](const auto& value) {
        std::vector<float> v;
        for (const glm::vec3& a : all) v.push_back(value(a));
        std::nth_element(v.begin(), v.begin() + long(v.size() / 2), v.end());
        return std::exp2(v[v.size() / 2]);
    };
    if (!per_channel) return glm::vec3(median([](const glm::vec3& a) { return (a.x + a.y + a.z) / 3; }));
    return {median([](const glm::vec3& a) { return a.x; }), median([](const glm::vec3& a) { return a.y; }),
            median([](const glm::vec3& a) { return a.z; })};
}

}  // namespace vshift
