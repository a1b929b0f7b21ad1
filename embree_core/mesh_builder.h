// SPDX-License-Identifier: Apache-2.0
// Role: inside lift: writes the vertices, kept quads and torn walls that a plan of cells asks for.
#pragma once
#include "embree_core/collapse.h"
#include "embree_core/lift.h"

namespace vshift {

/// Fills `mesh.vertices`, `kept`, `wall_vertices`, `torn` and `kept_triangles`.
/// Parallel; the same mesh whatever the number of threads.
void build_mesh(LiftedMesh& mesh, const CellPlan& plan);

}  // namespace vshift
