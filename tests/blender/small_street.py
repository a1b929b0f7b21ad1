# SPDX-License-Identifier: GPL-3.0-or-later
"""A street of a few boxes with the API of scenes/street and street_scene: tests start in a second with it."""
import sys
import types

import numpy as np

# name, category, centre, half size, yaw
BOXES = [("road", "road", (40, 0, -0.5), (80, 40, 0.5), 0.0)]
for _i in range(8):
    BOXES += [(f"house_l{_i}", "building", (_i * 12 - 20, 12, 4), (5, 3, 4), 0.0),
              (f"house_r{_i}", "building", (_i * 12 - 20, -13, 5), (5, 3, 5), 0.0),
              (f"car_{_i}", "car", (_i * 11 - 12, 1.9, 0.75), (2.2, 0.9, 0.75), 0.05),
              (f"pole_{_i}", "pole", (_i * 7 - 20, 6.5, 3), (0.06, 0.06, 3), 0.3)]
# a van beside the ego: CAM_FRONT shifted 4 m to the left lands in it at t = 0
BOXES.append(("van", "car", (1.7, 2.25, 1.2), (2.5, 1.0, 1.2), 0.0))


class SmallStreet:
    parts, instances, movers = {}, [], {}

    def ego_pose(self, t_s):
        m = np.eye(4)
        m[:3, 3] = (8.0 * t_s, -1.75, 0.0)
        return m

    def obstacles(self, t_s):
        return [(n, c, (np.array(p, float), np.array(h, float), y)) for n, c, p, h, y in BOXES if c != "road"]

    def geometry_hash(self):
        return "small"

    def triangle_count(self):
        return 12 * len(BOXES)


def generate(seed=1, detail=2, length_m=240.0, traffic=1.0):
    return SmallStreet()


def build(street):
    import bpy
    scene = bpy.context.scene
    scene.world = bpy.data.worlds.new("sky")
    light = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    light.rotation_euler = (0.6, 0.4, 0)
    scene.collection.objects.link(light)
    corners = np.array([[x, y, z] for z in (-1, 1) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))], float)
    faces = [[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]]
    for i, (name, category, centre, half, yaw) in enumerate(BOXES):
        mesh = bpy.data.meshes.new(name)
        mesh.from_pydata((corners * half).tolist(), [], faces)
        material = bpy.data.materials.new(name)
        material.diffuse_color = ((i % 5) / 5 + 0.1, (i % 3) / 3 + 0.1, 0.4, 1.0)
        mesh.materials.append(material)
        ob = bpy.data.objects.new(name, mesh)
        ob.location, ob.rotation_euler = centre, (0, 0, yaw)
        ob["vshift_category"] = category
        scene.collection.objects.link(ob)


def set_time(street, t_s):
    """The van drives on at 3 m/s."""
    import bpy
    bpy.data.objects["van"].location.x = 1.7 + 3.0 * t_s
    bpy.context.view_layer.update()


def install():
    """Puts this street in the place of the real one in this process."""
    for name, functions in (("street", (generate,)), ("vshift.street_scene", (build, set_time))):
        module = types.ModuleType(name)
        for f in functions:
            setattr(module, f.__name__, f)
        sys.modules[name] = module
