# SPDX-License-Identifier: GPL-3.0-or-later
"""One picture of a street, as the recorded car's camera sees it.

    blender -b --python-exit-code 3 -P blender_addon/street_picture.py -- --seed 1 --detail 2 \
        --width 1280 --height 720 --samples 64 -o out.png

--azimuth_deg turns the camera to the left; --hfov_deg widens it; --time_s moves along the drive;
--shift x,y,z moves the car in its own frame. Noise is smoothed by guide passes unless --raw is given.
"""
import argparse
import math
import struct
import sys
import tempfile
import time
import zlib
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


def smooth_picture(scene, out):
    """Renders with guide passes, filters the noise, applies exposure and the sRGB curve, writes a PNG."""
    from vshift import denoise, exr, views
    layer = scene.view_layers[0]
    layer.use_pass_z = layer.use_pass_normal = True
    layer.use_pass_diffuse_direct = layer.use_pass_diffuse_indirect = layer.use_pass_diffuse_color = True
    s = scene.render.image_settings
    if hasattr(s, "media_type"):
        s.media_type = "MULTI_LAYER_IMAGE"
    s.file_format, s.color_depth = "OPEN_EXR_MULTILAYER", "32"
    with tempfile.TemporaryDirectory(prefix="street_") as temp:
        scene.render.filepath = str(Path(temp) / "street.exr")
        bpy.ops.render.render(write_still=True)
        channels = exr.read(Path(scene.render.filepath))
    passes = {k: views._pass(channels, k) for k in ("Combined", "Depth", "Normal", "DiffCol", "DiffDir", "DiffInd")}
    rgb = denoise.smooth(passes) * 2.0 ** scene.view_settings.exposure
    rgb = np.clip(rgb, 0.0, 1.0)
    coded = np.where(rgb <= 0.0031308, 12.92 * rgb, 1.055 * rgb ** (1 / 2.4) - 0.055)
    h, w = coded.shape[:2]
    rows = np.zeros((h, 1 + 3 * w), np.uint8)
    rows[:, 1:] = np.round(coded * 255).astype(np.uint8).reshape(h, -1)
    def chunk(tag, data):
        return struct.pack(">I", len(data)) + tag + data + struct.pack(">I", zlib.crc32(tag + data))
    out.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", w, h, 8, 2, 0, 0, 0))
                    + chunk(b"IDAT", zlib.compress(rows.tobytes(), 6)) + chunk(b"IEND", b""))


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
    out = Path(o.out).resolve()
    built = time.perf_counter()
    if o.raw:
        r.image_settings.file_format = "PNG"
        r.image_settings.color_mode = "RGB"
        r.filepath = str(out)
        bpy.ops.render.render(write_still=True)
    else:
        smooth_picture(scene, out)
    if not out.is_file():
        raise RuntimeError(str(out) + ": the picture was not written")
    print("street: generate %.2f s, build %.2f s, render %.1f s, %d triangles" % (
        made - began, built - made, time.perf_counter() - built, street.triangle_count()))


if __name__ == "__main__":
    main(sys.argv[sys.argv.index("--") + 1:] if "--" in sys.argv else [])
