# SPDX-License-Identifier: GPL-3.0-or-later
"""Builds a benchmark set (docs/set_layout.md): street, recorded and shifted views, truth, recipe, manifest.

One process renders many views: within a frame the scene does not change, so that Cycles keeps its
data. The ego's own body is absent from every picture and from the mesh.
"""
import importlib
import importlib.util
import json
import os
import platform
import sys
import time
import zipfile
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import bpy
import numpy as np

from . import core, exr, manifest, mesh_export, progress, rig, truth, views
from .core import VshiftError

STREET_HZ_DT_S = 0.5
WHAT = ("street", "truth", "views", "all", "rays")


@dataclass
class Options:
    """What to build. shifts: (x, y, z, yaw_deg) of the ego. `what`: street = mesh, recipe and manifest;
    truth = truth/; views = frames/ and shifts/; all = these; rays = all of it without rendering (no R,G,B)."""
    out: Path
    seed: int = 1
    detail: int = 2
    frames: int = 1
    dt_s: float = STREET_HZ_DT_S
    length_m: float = 240.0
    traffic: float = 1.0
    width: int = 400
    height: int = 225
    samples: int = 8
    smooth: bool = True
    shifts: list = field(default_factory=lambda: [(0.0, s * d, 0.0, 0.0) for d in (1, 2, 4) for s in (1, -1)])
    only_frames: list = None
    only_cameras: list = None
    what: str = "all"
    threads: int = 0
    on_collision: str = "refuse"
    clearance_m: float = 0.3


# ------------------------------------------------------------------ the street
def street_package():
    """The package `street`: from $VSHIFT_SCENES, beside the addon, or the checkout's scenes/."""
    if "street" in sys.modules:
        return sys.modules["street"]
    here = Path(__file__).resolve().parent
    places = [Path(os.environ["VSHIFT_SCENES"])] if os.environ.get("VSHIFT_SCENES") else []
    places += [here / "scenes", here.parents[1] / "scenes"]
    for place in places:
        start = place / "street" / "__init__.py"
        if start.is_file():
            spec = importlib.util.spec_from_file_location("street", start, submodule_search_locations=[str(start.parent)])
            module = importlib.util.module_from_spec(spec)
            sys.modules["street"] = module
            try:
                spec.loader.exec_module(module)
            except BaseException:
                sys.modules.pop("street", None)
                raise
            return module
    raise VshiftError("street: -: package: got none of " + ", ".join(map(str, places)) + ", expected street/", 3)


def generate_street(options):
    return street_package().generate(seed=options.seed, detail=options.detail, length_m=options.length_m,
                                     traffic=options.traffic)


def new_scene(name="vshift"):
    """A new, empty scene, made the current one. In background mode everything else is dropped first."""
    if bpy.app.background:
        bpy.data.batch_remove([i for kind in (bpy.data.objects, bpy.data.meshes, bpy.data.lights, bpy.data.cameras,
                                              bpy.data.materials, bpy.data.collections) for i in kind])
    scene = bpy.data.scenes.new(name)
    bpy.context.window.scene = scene
    if bpy.app.background:
        bpy.data.batch_remove([s for s in bpy.data.scenes if s != scene])
    return scene


def build_street(options):
    """Builds the street in a new scene; returns the street."""
    street_scene = importlib.import_module(".street_scene", __package__)
    street = generate_street(options)
    new_scene()
    street_scene.build(street)
    return street


def street_figures(street, options):
    return {"seed": options.seed, "detail": options.detail, "length_m": options.length_m,
            "traffic": options.traffic, "geometry_hash": street.geometry_hash(), "triangles": street.triangle_count()}


# ------------------------------------------------------------------ planning
def item_names(options, cameras):
    """Every item of the set: name -> {"kind", "frame", "camera", "shift"}, in the order of the work."""
    out = {"set.vshift": {"kind": "recipe"}}
    shifts = [(rig.shift_name(s[:3], s[3]), s) for s in options.shifts]
    for f in range(options.frames):
        out[f"scene/mesh_{f:04d}.npz"] = {"kind": "mesh", "frame": f}
        for name, _ in shifts:
            for c in cameras:
                out[f"truth/{name}/{f:04d}/{c.name}.exr"] = {"kind": "truth", "frame": f, "camera": c.name, "shift": name}
        for c in cameras:
            out[f"frames/{f:04d}/{c.name}.exr"] = {"kind": "recorded", "frame": f, "camera": c.name}
        for name, _ in shifts:
            for c in cameras:
                out[f"shifts/{name}/{f:04d}/{c.name}.exr"] = {"kind": "shifted", "frame": f, "camera": c.name,
                                                              "shift": name}
    return out


def header(options, street):
    return {"versions": {"vshift": core.version().split(",")[0].removeprefix("vshift ").strip(),
                         "blender": bpy.app.version_string, "python": platform.python_version(),
                         "embree": core.version().partition("Embree ")[2].strip()},
            "machine": manifest.machine(), "street": street_figures(street, options),
            "render": {"width": options.width, "height": options.height, "samples": options.samples,
                       "smooth": options.smooth, "dt_s": options.dt_s, "clearance_m": options.clearance_m,
                       "on_collision": options.on_collision},
            "conventions": {"camera_frame": "x right, y down, z forward", "pixel_centre": 0.5,
                            "depth": "planar z, metres, +inf sky", "ego_frame": "x forward, y left, z up",
                            "quaternion": "w,x,y,z sensor-to-ego", "colour": "linear Rec.709"},
            "shifts": [{"name": rig.shift_name(s[:3], s[3]), "shift": [float(v) for v in s[:3]], "yaw_deg": float(s[3])}
                       for s in options.shifts]}


_KINDS = {"street": {"recipe", "mesh"}, "truth": {"recipe", "mesh", "truth"},
          "views": {"recipe", "mesh", "recorded", "shifted"},
          "all": {"recipe", "mesh", "truth", "recorded", "shifted"},
          "rays": {"recipe", "mesh", "truth", "recorded", "shifted"}}


def pending(options, data):
    """Names of the items this run has to make, in order."""
    render = options.what != "rays"
    out = []
    for name, item in data["items"].items():
        if item["kind"] not in _KINDS[options.what] or item["status"] == "refused":
            continue
        if options.only_frames is not None and item.get("frame") not in (None, *options.only_frames):
            continue
        if options.only_cameras and item.get("camera") not in (None, *options.only_cameras):
            continue
        if not manifest.is_done(options.out, data, name, rendered=render and item["kind"] in ("recorded", "shifted")):
            out.append(name)
    return out


# ------------------------------------------------------------------ building
def build_set(options, report=None):
    """Builds what is missing of the set; returns the status counts of its manifest."""
    check(options)
    core.load()
    if options.threads:
        core.set_threads(options.threads)
    cameras = rig.make_rig(options.width, options.height)
    street = build_street(options)
    poses = [np.asarray(street.ego_pose(i * options.dt_s), float) for i in range(options.frames)]
    poses = [rig.rigid(rig.quaternion(m), m[:3, 3]) for m in poses]
    data = manifest.plan(options.out, header(options, street), item_names(options, cameras))
    todo = pending(options, data)
    work = report or progress.Progress(Counter(data["items"][n]["kind"] for n in todo))
    work.say(f"{len(todo)} of {len(data['items'])} items to do in {options.out}")
    with manifest.run_folder(options.out) as temp:
        progress.guard(temp)
        _recipe(options, cameras, poses, data, work, temp)
        views.configure_for_set(bpy.context.scene, options.samples, options.threads, options.smooth)
        for f in range(options.frames):
            mine = [n for n in todo if data["items"][n].get("frame") == f]
            if mine:
                _frame(options, street, cameras, poses[f], f, mine, data["items"], work, temp)
    return manifest.status(manifest.load(options.out))


def check(options):
    """Bad options raise with code 3 before anything is made."""
    limits = [("frames", options.frames, 1, 10000), ("width", options.width, 8, 16384),
              ("height", options.height, 8, 16384), ("samples", options.samples, 1, 65536),
              ("detail", options.detail, 0, 3), ("seed", options.seed, 0, 2**31 - 1),
              ("clearance_m", options.clearance_m, 0.0, 10.0), ("dt_s", options.dt_s, 1e-3, 100.0)]
    for name, value, low, high in limits:
        if not low <= value <= high:
            raise VshiftError(f"set: -: {name}: got {value}, expected {low} to {high}", 3)
    for name, value, known in (("what", options.what, WHAT), ("on-collision", options.on_collision, ("refuse", "move"))):
        if value not in known:
            raise VshiftError(f"set: -: {name}: got {value}, expected one of {', '.join(known)}", 3)
    for f in options.only_frames or []:
        if not 0 <= f < options.frames:
            raise VshiftError(f"set: -: only frames: got {f}, expected 0 to {options.frames - 1}", 3)
    for c in options.only_cameras or []:
        if c not in rig.NAMES:
            raise VshiftError(f"set: -: only cameras: got {c}, expected one of {', '.join(rig.NAMES)}", 3)
    names = [rig.shift_name(s[:3], s[3]) for s in options.shifts]
    if len(set(names)) != len(names):
        raise VshiftError("set: -: shifts: got the same shift twice (to 0.01), expected different ones", 3)


def _recipe(options, cameras, poses, data, work, temp):
    text = json.dumps(rig.recipe(cameras, poses, options.dt_s, *_first_shift(options)), indent=1) + "\n"
    path = options.out / "set.vshift"
    if path.is_file() and path.read_text() == text and manifest.is_done(options.out, data, "set.vshift"):
        return
    start = time.monotonic()
    (temp / "set.vshift").write_text(text)
    exr.commit(temp / "set.vshift", path)
    manifest.done(options.out, "set.vshift", time.monotonic() - start)
    work.add("recipe", "set.vshift", time.monotonic() - start)


def _first_shift(options):
    s = options.shifts[0] if options.shifts else (0.0, 1.0, 0.0, 0.0)
    return s[:3], s[3]


def _savez(out, **arrays):
    """np.savez_compressed at the fastest level: as small here (30 MB for 2.1 M triangles), four times as fast."""
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as z:
        for name, a in arrays.items():
            with z.open(name + ".npy", "w", force_zip64=True) as f:
                np.lib.format.write_array(f, np.asanyarray(a), allow_pickle=False)


def _mesh(options, f, todo, work, temp):
    """(vertices, triangles, which are foliage) of frame f: read back when done, else exported and written."""
    name = f"scene/mesh_{f:04d}.npz"
    if name not in todo:
        with np.load(options.out / name) as z:
            return z["vertices"], z["triangles"], truth.foliage(z["triangle_category"], z["categories"].tolist())
    start = time.monotonic()
    v, t, category, categories = mesh_export.world_triangles()
    if not len(t):
        raise VshiftError(f"{name}: -: triangles: got 0, expected a street", 6)
    temporary = temp / "mesh.npz"
    try:
        with open(temporary, "wb") as out:
            _savez(out, vertices=v, triangles=t, triangle_category=category, categories=np.array(categories))
    except OSError as e:
        raise VshiftError(f"{name}: -: write: got {e.strerror}, expected a whole file", 4) from e
    exr.commit(temporary, options.out / name)
    manifest.done(options.out, name, time.monotonic() - start, triangles=len(t))
    work.add("mesh", name, time.monotonic() - start)
    return v, t, truth.foliage(category, categories)


def _frame(options, street, cameras, world_from_ego, f, todo, items, work, temp):
    """All items of one frame."""
    t_s = f * options.dt_s
    importlib.import_module(".street_scene", __package__).set_time(street, t_s)
    vertices, triangles, foliage = _mesh(options, f, todo, work, temp)
    todo = [n for n in todo if items[n]["kind"] != "mesh"]
    if not todo:
        return
    index = {c.name: i for i, c in enumerate(cameras)}
    recorded = [rig.view(c, world_from_ego) for c in cameras]
    leaves = {}  # by camera: which pixels show foliage
    with core.Scene(vertices, triangles, world_from_ego[:3, 3]) as scene:
        for c, v in zip(cameras, recorded):
            hit = truth.clearance(scene, street, v, t_s, options.clearance_m)
            if hit:
                raise VshiftError(f"frame {f}: {c.name}: recorded place: got {_says(hit, options)}, expected a free one", 3)
        placed = _place_shifted(options, scene, street, cameras, world_from_ego, t_s, todo, items, work)
        for name in todo:
            item = items[name]
            own = index[item["camera"]]
            shifted, extra = placed.get((item.get("shift"), item["camera"]), (None, {}))
            if item["kind"] != "recorded" and shifted is None:
                continue
            start = time.monotonic()
            if item["kind"] == "truth":
                if own not in leaves:
                    leaves[own] = truth.shows(scene, recorded[own], foliage)
                channels = truth.recorded_channels(scene, recorded, own, shifted)
                channels.append(("foliage", leaves[own], "half"))
            else:
                channels = []
                camera, rays_depth = recorded[own], None
                if item["kind"] == "shifted":
                    camera = shifted
                    channels, rays_depth = truth.shifted_channels(scene, recorded, own, shifted)
                if options.what == "rays":
                    depth = rays_depth if rays_depth is not None else scene.cast_camera(camera)["depth"]
                    channels = [("Z", depth, "float")] + channels
                else:
                    channels = views.view_channels(*views.render_view(camera, temp, options.smooth)) + channels
                extra = {**extra, "rendered": options.what != "rays"}
            exr.write(options.out / name, channels, temp, {"Software": f"vshift {core.version()}"})
            seconds = time.monotonic() - start
            manifest.done(options.out, name, seconds, **extra)
            work.add(item["kind"], name, seconds)


def _says(hit, options):
    distance, name, inside = hit
    return f"it lands in {name} (clearance {distance:.2f} m < {options.clearance_m:.2f} m" + (", inside)" if inside else ")")


def _place_shifted(options, scene, street, cameras, world_from_ego, t_s, todo, items, work):
    """(shift name, camera name) -> (core.Camera or None when refused, fields for the manifest)."""
    by_name = {rig.shift_name(s[:3], s[3]): s for s in options.shifts}
    by_camera = {c.name: c for c in cameras}
    out, refused = {}, {}
    for name in todo:
        item = items[name]
        key = (item.get("shift"), item["camera"])
        if item["kind"] == "recorded" or key[0] not in by_name:
            continue
        if key not in out:
            out[key] = _free_place(options, scene, street, by_camera[key[1]], world_from_ego, t_s, by_name[key[0]])
        camera, fields = out[key]
        if camera is None:
            refused[name] = fields
            work.drop(item["kind"], name, "refused: " + fields["reason"])
        elif "moved_to" in fields and item["kind"] == "shifted":
            work.say(f"{name}: moved to {fields['moved_to']}: {fields['reason']}")
    if refused:
        manifest.record_all(options.out, refused)
    return out


def _free_place(options, scene, street, camera, world_from_ego, t_s, shift):
    """The shifted view where it was asked for, nearer in 0.1 m steps (on_collision move), or refused."""
    view = rig.view(camera, world_from_ego, shift[:3], shift[3])
    hit = truth.clearance(scene, street, view, t_s, options.clearance_m)
    if not hit:
        return view, {}
    reason = _says(hit, options).replace("it lands", "the camera lands")
    fields = {"status": "refused", "reason": reason, "obstacle": hit[1], "clearance_m": round(hit[0], 3)}
    if options.on_collision == "refuse":
        return None, fields
    length = float(np.linalg.norm(shift[:3]))
    for step in range(1, int(round(length * 10))):
        moved = [round(float(v) * (length - 0.1 * step) / length, 6) for v in shift[:3]]
        view = rig.view(camera, world_from_ego, moved, shift[3])
        if not truth.clearance(scene, street, view, t_s, options.clearance_m):
            return view, {"moved_to": moved, "reason": reason, "obstacle": hit[1]}
    return None, fields
