// SPDX-License-Identifier: Apache-2.0
// Role: the rasteriser by bands of V's rows, so that what comes next (warp, seam) takes a band while it is in the
// cache. Stage: raster; `reproject` does all bands.
#pragma once
#include <tbb/parallel_for.h>

#include "embree_core/raster_map.h"

namespace vshift {

/// One recorded camera on its way to V.
class Raster {
public:
    /// `view` must stay alive.
    Raster(const SurfaceView& view, const ShiftedCamera& shifted);

    /// Draws a band of rows into `out`, which fits V. Of `floor` (see `reproject`) only the band's rows are read. Bands
    /// may be drawn at once.
    void band(int number, const Grid<float>* floor, Reprojection& out) const;

private:
    const SurfaceView& view_;
    ProjectiveMap from_shifted_;
    raster::FloatMap map_;
    int width_, height_;
    std::vector<raster::Tile> tiles_;
};

/// Calls `task` with every band's number, each a task of its own: they differ much in what they hold.
template <class Task>
void each_band(const Reprojection& out, const Task& task) {
    tbb::parallel_for(
        tbb::blocked_range<int>(0, out.bands(), 1),
        [&](const tbb::blocked_range<int>& some) {
            for (int band = some.begin(); band < some.end(); ++band) task(band);
        },
        tbb::simple_partitioner());
}

}  // namespace vshift
