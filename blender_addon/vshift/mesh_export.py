# SPDX-License-Identifier: GPL-3.0-or-later
"""The true mesh of the current instant: every mesh of the evaluated scene, instances included, as triangles.

The triangles are Blender's own (loop triangles), which are those that Cycles traces.
"""
import bpy
import numpy as np

_SOLID = {"MESH", "CURVE", "SURFACE", "META", "FONT"}


def category_of(ob):
    """Category of an object: its own property, else its collection's name."""
    for key in ("vshift_category", "category"):
        if ob.get(key):
            return str(ob[key])
    for collection in ob.users_collection:
        if collection.library is None and collection != bpy.context.scene.collection:
            return collection.name
    return "other"


def _local(mesh):
    """(vertices (N, 3) float32, triangles (M, 3) int32) in object coordinates."""
    mesh.calc_loop_triangles()
    v = np.empty((len(mesh.vertices), 3), np.float32)
    t = np.empty((len(mesh.loop_triangles), 3), np.int32)
    mesh.vertices.foreach_get("co", v.ravel())
    mesh.loop_triangles.foreach_get("vertices", t.ravel())
    return v, t


def world_triangles(depsgraph=None):
    """vertices (N, 3) float64 world metres, triangles (M, 3) uint32, triangle_category (M,) uint8, categories [str].

    Only what Cycles renders: hidden objects and objects that the camera cannot see are left out.
    """
    depsgraph = depsgraph or bpy.context.evaluated_depsgraph_get()
    depsgraph.update()
    meshes, vertices, triangles, category, names = {}, [], [], [], {}
    offset = 0
    for instance in depsgraph.object_instances:
        ob = instance.object
        source = ob.original
        shown = instance.show_self if not instance.is_instance else True
        if ob.type not in _SOLID or not shown or source.hide_render or not getattr(source, "visible_camera", True):
            continue
        key = (ob.data.original if ob.data else ob).as_pointer() if not ob.modifiers else source.as_pointer()
        if key not in meshes:
            if ob.type == "MESH":
                meshes[key] = _local(ob.data)
            else:
                mesh = ob.to_mesh()
                meshes[key] = _local(mesh) if mesh else (np.empty((0, 3), np.float32), np.empty((0, 3), np.int32))
                ob.to_mesh_clear()
        v, t = meshes[key]
        if not len(t):
            continue
        m = np.array(instance.matrix_world, np.float64)
        vertices.append(v.astype(np.float64) @ m[:3, :3].T + m[:3, 3])
        triangles.append(t.astype(np.uint32) + np.uint32(offset))
        who = instance.parent.original if instance.is_instance and instance.parent else source
        name = category_of(source if source.get("vshift_category") or source.get("category") else who)
        category.append(np.full(len(t), names.setdefault(name, len(names)), np.uint8))
        offset += len(v)
        if len(names) > 255:
            raise ValueError("scene: -: categories: got more than 255, expected at most 255")
    if not triangles:
        return np.empty((0, 3)), np.empty((0, 3), np.uint32), np.empty(0, np.uint8), []
    return np.concatenate(vertices), np.concatenate(triangles), np.concatenate(category), list(names)
