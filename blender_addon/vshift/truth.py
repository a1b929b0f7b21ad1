# SPDX-License-Identifier: GPL-3.0-or-later
"""Truth classes of recorded and shifted views as EXR channels (docs/set_layout.md). Needs no Blender."""
import numpy as np

from . import core

RECORDED_CHANNELS = (("occluded", core.OCCLUDED), ("outside", core.OUTSIDE), ("sky", core.SKY),
                     ("shell_self", core.SHELL_SELF), ("shell_rig", core.SHELL_RIG),
                     ("faces_away", core.FACES_AWAY))


# Categories of objects in which a pixel of leaves and gaps is no surface at all: scored apart.
FOLIAGE_CATEGORIES = ("tree", "plant")


def foliage(triangle_category, categories):
    """(M,) bool: which triangles belong to trees and plants."""
    return np.isin(triangle_category, [i for i, name in enumerate(categories) if name in FOLIAGE_CATEGORIES])


def shows(scene, camera, triangles):
    """(H, W) bool: pixels at whose centre a camera sees one of the triangles; `triangles` is a bool for each."""
    hit = scene.cast_camera(camera)["triangle"]
    return (hit >= 0) & triangles[np.maximum(hit, 0)]


def recorded_channels(scene, rig_views, own, shifted):
    """Channels of truth/SHIFT/FFFF/CAMERA.exr: each 0 or 1; lost is occluded or outside (the paper's M).

    rig_views: core.Camera of every recorded camera; own: index; shifted: core.Camera.
    """
    flags = scene.truth_recorded(rig_views, own, shifted)
    out = [("lost", (flags & (core.OCCLUDED | core.OUTSIDE)) > 0, "half")]
    return out + [(name, (flags & bit) > 0, "half") for name, bit in RECORDED_CHANNELS]


def shifted_channels(scene, rig_views, own, shifted):
    """(truth.class and truth.source channels of a shifted view, its depth (H, W) by rays)."""
    klass, source, depth = scene.truth_shifted(rig_views, own, shifted)
    return [("truth.class", klass.astype(np.float32), "half"),
            ("truth.source", source.astype(np.float32), "half")], depth


def clearance(scene, street, camera, t_s, limit_m):
    """None when a camera stands free, else (distance in m, name of what it stands in or near, whether inside).

    Distance is asked of the true mesh; street.obstacles gives the name, and refuses a camera that stands
    inside an obstacle's box however hollow its mesh is.
    """
    point = camera.centre
    distance, inside = scene.clearance(point, limit_m)
    name, gap = nearest_obstacle(street, point, t_s)
    if gap <= 0.0:
        return 0.0, name, True
    if inside:
        return 0.0, name if gap < 2.0 else "something closed", True
    if distance < limit_m:
        return distance, name if gap < limit_m + 0.5 else "the ground or a small part", False
    return None


def nearest_obstacle(street, point, t_s):
    """(name, distance in m; 0 or less inside) of the obstacle box nearest to a world point at t_s."""
    best = ("nothing", np.inf)
    for name, _, (centre, half, yaw) in street.obstacles(t_s):
        d = np.asarray(point, float) - centre
        c, s = np.cos(yaw), np.sin(yaw)
        outside = np.abs([c * d[0] + s * d[1], -s * d[0] + c * d[1], d[2]]) - np.asarray(half, float)
        gap = float(np.linalg.norm(np.maximum(outside, 0.0))) if outside.max() > 0 else float(outside.max())
        if gap < best[1]:
            best = (name, gap)
    return best
