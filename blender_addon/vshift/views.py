# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders one view with Cycles and writes it as EXR: R,G,B (half, linear) and Z (float, planar metres).

Z is Cycles' Depth pass: sampled once at each pixel's centre, never anti-aliased, 1e10 becomes +inf.
Colour is the view transform-free linear image; at few samples it is smoothed by guide passes
(denoise.py), which leaves Z alone.
"""
import os
import sys
from contextlib import contextmanager
from pathlib import Path

import bpy
import numpy as np

from . import denoise, exr, rig
from .core import VshiftError

SKY_DEPTH_M = 1e9   # Cycles writes 1e10 where nothing is hit
PASSES = {"Depth": "use_pass_z", "Normal": "use_pass_normal", "DiffCol": "use_pass_diffuse_color",
          "DiffDir": "use_pass_diffuse_direct", "DiffInd": "use_pass_diffuse_indirect", "Position": "use_pass_position"}
_LONG = {"DiffCol": "Diffuse Color", "DiffDir": "Diffuse Direct", "DiffInd": "Diffuse Indirect", "Depth": "Z"}


def refuse_pitfalls(scene, camera_object):
    """Raises (code 3) for settings that would corrupt depth or fail silently; `configure` sets none of them."""
    render, cycles, where = scene.render, scene.cycles, camera_object.name
    checks = [("render.engine", render.engine, "CYCLES"), ("use_motion_blur", render.use_motion_blur, False),
              ("camera.dof.use_dof", camera_object.data.dof.use_dof, False),
              ("camera.type", camera_object.data.type, "PERSP"),
              ("cycles.use_denoising", cycles.use_denoising, False), ("render.use_border", render.use_border, False),
              ("render.use_multiview", render.use_multiview, False),
              ("resolution_percentage", render.resolution_percentage, 100)]
    for field, got, want in checks:
        if got != want:
            raise VshiftError(f"{scene.name}: {where}: {field}: got {got}, expected {want}", 3)


def configure(scene, samples, threads=0, passes=("Depth",), seed=0, exact_centres=False):
    """Cycles on the CPU with the settings every view of a set shares; bounces and clamps stay the scene's own.

    exact_centres shrinks the pixel filter to a point (for the proof; colour then has jagged edges).
    """
    render = scene.render
    render.engine = "CYCLES"
    c = scene.cycles
    c.device, c.samples, c.seed = "CPU", int(samples), int(seed)
    for name, value in (("use_adaptive_sampling", False), ("use_denoising", False), ("use_animated_seed", False),
                        ("time_limit", 0.0), ("use_auto_tile", False),
                        ("caustics_reflective", False), ("caustics_refractive", False),
                        ("pixel_filter_type", "BLACKMAN_HARRIS"),   # BOX would ignore the width
                        ("filter_width", 0.01 if exact_centres else 1.5)):
        if hasattr(c, name):
            setattr(c, name, value)
    render.use_persistent_data = True
    render.use_motion_blur = render.use_border = render.use_multiview = False
    render.use_compositing = render.use_sequencer = False
    render.film_transparent = False
    render.dither_intensity = 0.0
    render.threads_mode = "FIXED" if threads else "AUTO"
    if threads:
        render.threads = int(threads)
    scene.view_settings.view_transform = "Standard"
    scene.view_settings.look = "None"
    scene.view_settings.exposure, scene.view_settings.gamma = 0.0, 1.0
    layer = scene.view_layers[0]
    for name, attribute in PASSES.items():
        setattr(layer, attribute, name in passes)
    settings = render.image_settings
    if hasattr(settings, "media_type"):            # Blender 5
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format = "OPEN_EXR_MULTILAYER"
    settings.color_depth, settings.exr_codec = "32", "NONE"
    render.use_file_extension, render.use_overwrite = True, True


@contextmanager
def quiet():
    """Keeps Blender's own progress lines off standard output."""
    sys.stdout.flush()
    keep, null = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 1)
    try:
        yield
    finally:
        os.dup2(keep, 1)
        os.close(keep)
        os.close(null)


def render_passes(camera, temp_dir, passes=("Depth",)):
    """Renders a core.Camera of the current scene; dict of pass -> (H, W) or (H, W, C) float32.

    "Combined" is (H, W, 3); "Depth" is (H, W) with +inf for sky. Raises with code 4 when the file that
    Blender says it saved is missing, torn, of another size or without a pass.
    """
    scene = bpy.context.scene
    ob = rig.camera_object()
    rig.apply_to_blender(camera, scene, ob)
    refuse_pitfalls(scene, ob)
    path = Path(temp_dir) / "blender.exr"
    scene.render.filepath = str(path)
    try:
        path.unlink(missing_ok=True)
        with quiet():
            result = bpy.ops.render.render(write_still=True)
        if "FINISHED" not in result or not path.is_file():
            raise VshiftError(f"{path.name}: {ob.name}: render: got {result}, expected a file", 4)
        channels = exr.read(path)
    except VshiftError:
        raise
    except (RuntimeError, OSError) as e:
        raise VshiftError(f"{path.name}: {ob.name}: render: got '{str(e).strip()}', expected a picture", 4) from e
    finally:
        if path.exists():
            path.unlink()
    out = {}
    for name in ("Combined", *passes):
        value = _pass(channels, name)
        if value is None or value.shape[:2] != (camera.height, camera.width):
            got = "nothing" if value is None else f"{value.shape[1]}x{value.shape[0]}"
            raise VshiftError(f"{path.name}: {ob.name}: {name}: got {got}, expected {camera.width}x{camera.height}", 4)
        out[name] = value
    if "Depth" in out:
        out["Depth"] = np.where(out["Depth"] >= SKY_DEPTH_M, np.float32(np.inf), out["Depth"])
    return out


def _pass(channels, name):
    """One pass of a multilayer EXR, whatever the version calls layer, pass and parts."""
    parts = {}
    for channel, values in channels.items():
        words = channel.split(".")
        if len(words) >= 2 and words[-2] in (name, _LONG.get(name, name)):
            parts.setdefault(words[-1], values)
    if not parts:
        return None
    if len(parts) == 1:
        return next(iter(parts.values()))
    order = "RGB" if "R" in parts else "XYZ"
    return np.stack([parts[k] for k in order], -1)


GUIDES = ("Depth", "Normal", "DiffCol", "DiffDir", "DiffInd")


def configure_for_set(scene, samples, threads=0, smooth=True):
    """Settings of the views of a set; smooth adds the guide passes."""
    configure(scene, samples, threads, GUIDES if smooth else ("Depth",))


def render_view(camera, temp_dir, smooth=True):
    """(rgb (H, W, 3) float32 linear, depth (H, W) float32) of the current scene."""
    passes = render_passes(camera, temp_dir, GUIDES if smooth else ("Depth",))
    rgb = denoise.smooth(passes, bpy.context.scene.cycles.samples) if smooth else passes["Combined"]
    return rgb, passes["Depth"]


def view_channels(rgb, depth):
    """The channels of a view's EXR."""
    return [("R", rgb[:, :, 0], "half"), ("G", rgb[:, :, 1], "half"), ("B", rgb[:, :, 2], "half"),
            ("Z", depth, "float")]
