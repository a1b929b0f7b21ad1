# SPDX-License-Identifier: GPL-3.0-or-later
"""Our ray tracer against Cycles and Blender, on the street and on planes whose depth is known.

Each check states what it got and what it expected; `run` lists those that failed. Cycles' Depth pass
is a point sample at the pixel's centre whatever the filter: it is taken with the very settings of a
set. Its Position pass is an average over the pixel, so it is taken at one sample with a filter of 0.01 px.

Where the two tracers disagree, both may be right: a ray through an edge falls to either side by the
last bit. Hence quotas of pixels; the depth limit is max(1e-3 m, 1e-3 of the depth).
"""
import importlib
import tempfile
import time
from pathlib import Path

import bpy
import numpy as np

from . import core, mesh_export, rig, set_builder, views

HITS_AGREE = 0.9999          # share of pixels where both tracers hit, or both miss
DEPTH_LIMIT = 1e-3           # metres, or of the depth where that is more
DEPTH_OFF_SHARE = 1e-3
RAYS = 3000
RAY_OFF_SHARE = 1e-3
PLANE_LIMIT_M = 1e-4
GROUND_LIMIT_M = {"core": 1e-4, "cycles": 5e-4}   # Cycles' filter table moves rays by about 5e-4 px: felt at grazing angles
PROJECT_LIMIT_PX = 0.03      # at the 99.9th percentile of pixels; the largest is reported


def run(seed=1, detail=2, width=400, height=225, length_m=240.0, traffic=1.0, threads=0, t_s=0.0):
    """dict: checks name -> {got, expected, passed, ...}, failed [names], and what was measured on."""
    core.load()
    checks = {}
    with tempfile.TemporaryDirectory(prefix="vshift_proof_") as temp:
        temp = Path(temp)
        _planes(checks, temp, width, height, threads)
        options = set_builder.Options(out=temp, seed=seed, detail=detail, length_m=length_m, traffic=traffic)
        street = set_builder.build_street(options)
        importlib.import_module(".street_scene", __package__).set_time(street, t_s)
        started = time.monotonic()
        vertices, triangles, _, categories = mesh_export.world_triangles()
        export_s = time.monotonic() - started
        pose = np.asarray(street.ego_pose(t_s), float)
        cameras = rig.make_rig(width, height)
        started = time.monotonic()
        with core.Scene(vertices, triangles, pose[:3, 3]) as scene:
            build_s = time.monotonic() - started
            _street(checks, scene, cameras, pose, temp, threads)
            _rays(checks, scene, pose)
    return {"vshift_proof": 1, "version": core.version(), "blender": bpy.app.version_string, "seed": seed,
            "detail": detail, "width": width, "height": height, "geometry_hash": street.geometry_hash(),
            "triangles": int(len(triangles)), "triangles_by_generator": int(street.triangle_count()),
            "categories": categories, "export_s": round(export_s, 3), "bvh_build_s": round(build_s, 3),
            "checks": checks, "failed": [n for n, c in checks.items() if not c["passed"]]}


def _check(checks, name, got, expected, passed, **more):
    checks[name] = {"got": got, "expected": expected, "passed": bool(passed), **more}


# ------------------------------------------------------------------ planes
def _planes(checks, temp, width, height, threads):
    """A wall across the view at 10 m and a ground 1.51 m below: depth in closed form, both tracers."""
    set_builder.new_scene()
    camera = rig.view(rig.make_rig(width, height)[0], np.eye(4))
    centre, toward = camera.centre, camera.world_from_cam[:, 2]
    far = np.float64(10.0)
    corners = [(-40.0, -40.0), (40.0, -40.0), (40.0, 40.0), (-40.0, 40.0)]
    wall = [camera.world_from_cam[:, :3] @ (x, y, far) + centre for x, y in corners]
    ground = [(x, y, 0.0) for x, y in corners]
    mesh = bpy.data.meshes.new("planes")
    mesh.from_pydata([tuple(p) for p in wall + ground], [], [[0, 1, 2, 3], [4, 5, 6, 7]])
    bpy.context.scene.collection.objects.link(bpy.data.objects.new("planes", mesh))
    direction = camera.rays()
    with np.errstate(divide="ignore"):
        to_ground = np.where(direction[:, :, 2] < 0, -centre[2] / direction[:, :, 2], np.inf)
    to_wall = far / (direction @ toward)
    views.configure(bpy.context.scene, 1, threads, ("Depth",))
    rendered = views.render_passes(camera, temp, ("Depth",))["Depth"]
    v, t, _, _ = mesh_export.world_triangles()
    with core.Scene(v, t, centre) as scene:
        ours = scene.cast_camera(camera)["depth"]
    ground_first = to_ground < to_wall
    for tracer, depth in (("core", ours), ("cycles", rendered)):
        wall_off = float(np.abs(depth - to_wall)[~ground_first].max())
        ground_off = float(np.abs(depth - to_ground)[ground_first].max())
        limit = GROUND_LIMIT_M[tracer]
        _check(checks, f"wall_depth_{tracer}", wall_off, f"<= {PLANE_LIMIT_M} m at every pixel", wall_off <= PLANE_LIMIT_M)
        _check(checks, f"ground_depth_{tracer}", ground_off, f"<= {limit} m at every pixel", ground_off <= limit)


# ------------------------------------------------------------------ the street
def _street(checks, scene, cameras, pose, temp, threads):
    for c in cameras:
        camera = rig.view(c, pose)
        ours = scene.cast_camera(camera)["depth"]
        views.configure(bpy.context.scene, 4, threads, views.GUIDES)
        cycles = views.render_passes(camera, temp, ("Depth",))["Depth"]
        hit, hit_cycles = np.isfinite(ours), np.isfinite(cycles)
        agree = float((hit == hit_cycles).mean())
        both = hit & hit_cycles
        off = np.abs(ours[both].astype(float) - cycles[both])
        allowed = np.maximum(DEPTH_LIMIT, DEPTH_LIMIT * cycles[both])
        share = float((off > allowed).mean()) if both.any() else 0.0
        _check(checks, f"hits_{c.name}", agree, f">= {HITS_AGREE}", agree >= HITS_AGREE, camera=c.name,
               pixels=int(hit.size), differing=int((hit != hit_cycles).sum()), hit_share=float(hit.mean()))
        _check(checks, f"depth_{c.name}", share, f"<= {DEPTH_OFF_SHARE} of pixels off by more than "
               f"max({DEPTH_LIMIT} m, {DEPTH_LIMIT} of the depth)", share <= DEPTH_OFF_SHARE, camera=c.name,
               median_m=float(np.median(off)) if off.size else 0.0, worst_m=float(off.max()) if off.size else 0.0)
        _position(checks, c, camera, ours, temp, threads)


def _position(checks, c, camera, ours, temp, threads):
    """Cycles' world positions, projected by our K, against the pixel centres they were rendered at."""
    views.configure(bpy.context.scene, 1, threads, ("Depth", "Position"), exact_centres=True)
    passes = views.render_passes(camera, temp, ("Depth", "Position"))
    hit = np.isfinite(passes["Depth"])
    uv, z = camera.project(passes["Position"][hit])
    v, u = np.nonzero(hit)
    off = np.hypot(uv[:, 0] - (u + 0.5), uv[:, 1] - (v + 0.5))
    # a glass pane: the Depth pass is the pane's, the Position pass may be too; only pixels where the two agree
    same = np.abs(z - passes["Depth"][hit]) <= np.maximum(1e-3, 1e-3 * z)
    p999 = float(np.percentile(off[same], 99.9)) if same.any() else np.inf
    _check(checks, f"project_{c.name}", p999, f"<= {PROJECT_LIMIT_PX} px at the 99.9th percentile", camera=c.name,
           passed=p999 <= PROJECT_LIMIT_PX, median_px=float(np.median(off[same])) if same.any() else None,
           largest_px=float(off[same].max()) if same.any() else None, pixels=int(same.sum()),
           mean_offset_px=[float(np.mean(uv[same, 0] - (u[same] + 0.5))), float(np.mean(uv[same, 1] - (v[same] + 0.5)))])
    both = np.isfinite(ours[hit]) & same
    apart = np.abs(z[both] - ours[hit][both])
    share = float((apart > np.maximum(DEPTH_LIMIT, DEPTH_LIMIT * z[both])).mean()) if both.any() else 0.0
    # the filter of 0.01 px moves the ray a little: at grazing angles and at edges more than the limit
    _check(checks, f"position_{c.name}", share, f"<= {4 * DEPTH_OFF_SHARE} of pixels", share <= 4 * DEPTH_OFF_SHARE,
           camera=c.name, median_m=float(np.median(apart)) if apart.size else 0.0)


def _rays(checks, scene, pose):
    """Random rays from around the ego against scene.ray_cast of Blender."""
    rng = np.random.default_rng(7)
    origins = pose[:3, 3] + (0, 0, 2.0) + rng.uniform((-2, -2, -0.5), (2, 2, 1.0), (RAYS, 3))
    directions = rng.normal(size=(RAYS, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    # Blender's rays are 32-bit: give ours the same numbers
    origins, directions = origins.astype(np.float32), directions.astype(np.float32)
    distance, _ = scene.cast_rays(origins.astype(np.float64), directions.astype(np.float64))
    depsgraph = bpy.context.evaluated_depsgraph_get()
    theirs = np.full(RAYS, np.inf)
    started = time.monotonic()
    for i in range(RAYS):
        hit, place, *_ = bpy.context.scene.ray_cast(depsgraph, origins[i].tolist(), directions[i].tolist())
        if hit:
            theirs[i] = np.linalg.norm(np.array(place) - origins[i])
    seconds = time.monotonic() - started
    both = np.isfinite(distance) & np.isfinite(theirs)
    off = np.isfinite(distance) != np.isfinite(theirs)
    off[both] = np.abs(distance[both] - theirs[both]) > np.maximum(DEPTH_LIMIT, DEPTH_LIMIT * theirs[both])
    _check(checks, "ray_cast", float(off.mean()), f"<= {RAY_OFF_SHARE} of {RAYS} rays", off.mean() <= RAY_OFF_SHARE,
           hit_differs=int((np.isfinite(distance) != np.isfinite(theirs)).sum()), hits=int(both.sum()),
           largest_m=float(np.abs(distance[both] - theirs[both]).max()) if both.any() else None,
           blender_s=round(seconds, 2))
