# SPDX-License-Identifier: GPL-3.0-or-later
"""One picture of a street, as the recorded car's camera sees it.

    blender -b --python-exit-code 3 -P blender_addon/street_picture.py -- --seed 1 --detail 2 \
        --width 1280 --height 720 --samples 64 -o out.png

--azimuth_deg turns the camera to the left; --hfov_deg widens it; --time_s moves along the drive;
--shift x,y,z moves the car in its own frame. Noise is smoothed by guide passes unless --raw is given.
"""
import argparse
import importlib
import math
import sys
import tempfile
import time
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

HERE = Path(__file__).resolve().parent
CAMERA_M = (1.70, 0.0, 1.51)


def options(argv):
    a = argparse.ArgumentParser(prog="street_picture", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    a.add_argument("--seed", type=int, default=1)
    a.add_argument("--detail", type=int, default=2, choices=(0, 1, 2, 3))
    a.add_argument("--width", type=int, default=1280)
    a.add_argument("--height", type=int, default=720)
    a.add_argument("--samples", type=int, default=64)
    a.add_argument("--time_s", type=float, default=0.0)
    a.add_argument("--azimuth_deg", type=float, default=0.0)
    a.add_argument("--hfov_deg", type=float, default=None)
    a.add_argument("--shift", default="0,0,0")
    a.add_argument("--position", default=None, help="x,y,z of the camera in the world instead of on the car")
    a.add_argument("--pitch_deg", type=float, default=0.0)
    a.add_argument("--raw", action="store_true")
    a.add_argument("-o", "--out", default="street.png")
    return a.parse_args(argv)


def place_camera(scene, o, street):
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(camera)
    scene.camera = camera
    fx = 0.79 * o.width if o.hfov_deg is None else 0.5 * o.width / math.tan(math.radians(o.hfov_deg) / 2)
    camera.data.sensor_fit = "HORIZONTAL"
    camera.data.sensor_width = 36.0
    camera.data.lens = fx * 36.0 / o.width
    camera.data.clip_start, camera.data.clip_end = 0.05, 2000.0
    shift = np.array([float(v) for v in o.shift.split(",")])
    a, p = math.radians(o.azimuth_deg), math.radians(o.pitch_deg)
    forward = np.array([math.cos(a) * math.cos(p), math.sin(a) * math.cos(p), math.sin(p)])
    right = np.array([math.sin(a), -math.cos(a), 0.0])
    m = np.eye(4)
    m[:3, 0], m[:3, 1], m[:3, 2] = right, np.cross(right, forward), -forward
    m[:3, 3] = np.array(CAMERA_M) + shift
    m = street.ego_pose(o.time_s) @ m
    if o.position:
        m[:3, 3] = [float(v) for v in o.position.split(",")]
    camera.matrix_world = Matrix(m.tolist())


def main(argv):
    o = options(argv)
    for folder in (str(HERE), str(HERE.parent / "scenes")):
        if folder not in sys.path:
            sys.path.insert(0, folder)
    from street import generate
    from vshift import street_scene
    for x in list(bpy.data.objects):
        bpy.data.objects.remove(x)
    scene = bpy.context.scene
    began = time.perf_counter()
    street = generate(seed=o.seed, detail=o.detail)
    made = time.perf_counter()
    street_scene.build(street)
    street_scene.set_time(street, o.time_s)
    place_camera(scene, o, street)
    r = scene.render
    r.resolution_x, r.resolution_y, r.resolution_percentage = o.width, o.height, 100
    scene.cycles.samples = o.samples
    r.image_settings.file_format = "PNG"
    r.image_settings.color_mode = "RGB"
    r.filepath = str(Path(o.out).resolve())
    built = time.perf_counter()
    bpy.ops.render.render(write_still=True)
    if not Path(r.filepath).is_file():
        raise RuntimeError(r.filepath + ": the picture was not written")
    print("street: generate %.2f s, build %.2f s, render %.1f s, %d triangles" % (
        made - began, built - made, time.perf_counter() - built, street.triangle_count()))


if __name__ == "__main__":
    main(sys.argv[sys.argv.index("--") + 1:] if "--" in sys.argv else [])
