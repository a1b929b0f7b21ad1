# SPDX-License-Identifier: GPL-3.0-or-later
"""What Blender itself offers: `scene.ray_cast` from the point that a recorded pixel shows towards the shifted camera, in
the true scene. For `vshift bench`.

    blender -b --factory-startup --python-exit-code 3 -P ray_cast.py -- FOLDER

FOLDER/vertices.bin (float32 x 3), triangles.bin (uint32 x 3); jobs of job.json: rays.bin (float32: origin, direction,
length) -> FOLDER/hits_N.bin (uint8) and result.json, with the CPU time of the rays alone.
"""
import json
import sys
import time
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector


def add_mesh(vertices, triangles):
    mesh = bpy.data.meshes.new("street")
    mesh.vertices.add(len(vertices))
    mesh.vertices.foreach_set("co", vertices.ravel())
    mesh.loops.add(triangles.size)
    mesh.loops.foreach_set("vertex_index", triangles.ravel())
    mesh.polygons.add(len(triangles))
    mesh.polygons.foreach_set("loop_start", np.arange(0, triangles.size, 3, dtype=np.int32))
    if bpy.app.version < (4, 1):
        mesh.polygons.foreach_set("loop_total", np.full(len(triangles), 3, dtype=np.int32))
    mesh.update(calc_edges=True)
    bpy.context.scene.collection.objects.link(bpy.data.objects.new("street", mesh))


def main(folder):
    for thing in list(bpy.data.objects):
        bpy.data.objects.remove(thing)
    add_mesh(np.fromfile(folder / "vertices.bin", np.float32).reshape(-1, 3),
             np.fromfile(folder / "triangles.bin", np.int32).reshape(-1, 3))
    scene, graph = bpy.context.scene, bpy.context.evaluated_depsgraph_get()
    scene.ray_cast(graph, Vector((0, 0, 1)), Vector((1, 0, 0)))  # builds its tree
    times = []
    for number, job in enumerate(json.loads((folder / "job.json").read_text())["jobs"]):
        rays = [(Vector(r[:3]), Vector(r[3:6]), r[6])
                for r in np.fromfile(folder / job["rays"], np.float32).reshape(-1, 7).tolist()]
        wall, cpu = time.perf_counter(), time.process_time()
        hits = [scene.ray_cast(graph, origin, direction, distance=length)[0] for origin, direction, length in rays]
        times.append({"wall_ms": (time.perf_counter() - wall) * 1e3, "cpu_ms": (time.process_time() - cpu) * 1e3})
        np.array(hits, np.uint8).tofile(folder / f"hits_{number}.bin")
    (folder / "result.json").write_text(json.dumps({"blender": bpy.app.version_string, "times": times}))


main(Path(sys.argv[sys.argv.index("--") + 1]))
