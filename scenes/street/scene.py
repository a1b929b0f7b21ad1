# SPDX-License-Identifier: CC0-1.0
"""The street as plain structs: parts, instances, movers, and questions about them.

World frame: x along the street, y left, z up, road surface at z = 0. Metres,
radians, seconds. `a_from_b` takes b to a.
"""
import hashlib
import math
from dataclasses import dataclass, field

import numpy as np

from .mesh import pose

DETAIL_LEVELS = {
    0: "boxes: ground, kerbs, building blocks, car boxes, pole cylinders, tree blobs",
    1: "openings and body shapes without small parts",
    2: "default: frames, railings, wires, shop interiors, wheels and rims, leaves",
    3: "finest: more leaves, rounder bodies, more wires and railing bars",
}

EGO_SIZE_M = (4.6, 1.9, 1.6)      # length, width, height of the recorded car
EGO_CENTRE_X_M = 1.35             # centre of the body ahead of the rear axle
EGO_SPEED_M_S = 8.0
EGO_LANE_Y_M = -1.75


@dataclass
class Part:
    """One mesh of one material, in local coordinates.

    vertices (N, 3) float32; faces (M, 4) int32, -1 in column 3 for triangles;
    uv (N, 2) float32 or None, one per vertex.
    """
    name: str
    material: str
    category: str
    vertices: np.ndarray
    faces: np.ndarray
    uv: np.ndarray = None
    smooth: bool = False

    def triangle_count(self):
        return int(len(self.faces) + (self.faces[:, 3] >= 0).sum())


@dataclass
class Instance:
    """Parts placed in the world; relative to the mover if `mover` names one.

    colour: linear RGB for the materials that take the object's colour (paint, plaster, cloth), or None.
    """
    name: str
    parts: list
    matrix: np.ndarray
    category: str
    mover: str = None
    colour: tuple = None


@dataclass
class Mover:
    """Something driving or walking: constant speed along a straight line."""
    x_m: float
    y_m: float
    yaw_rad: float
    speed_m_s: float
    z_m: float = 0.0

    def world_from_mover(self, t_s):
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        d = self.speed_m_s * t_s
        return pose(self.x_m + c * d, self.y_m + s * d, self.z_m, self.yaw_rad)


@dataclass
class Solid:
    """An oriented box for `obstacles`, in mover coordinates if `mover` names one."""
    name: str
    category: str
    centre: tuple
    half: tuple
    yaw_rad: float
    mover: str = None


@dataclass
class Street:
    seed: int
    detail: int
    length_m: float
    traffic: float
    plan: object = None                                # layout.Plan: where kerbs, crossings and lines are
    parts: dict = field(default_factory=dict)
    instances: list = field(default_factory=list)
    movers: dict = field(default_factory=dict)
    solids: list = field(default_factory=list)

    # -- building up
    def add_model(self, name, builder, category):
        """Stores the parts of `builder` once; returns their names for instances."""
        out = []
        for part in builder.parts(name, category):
            self.parts[part.name] = part
            out.append(part.name)
        return out

    def place(self, name, part_names, matrix, category, mover=None, colour=None, solid=None):
        """Adds an instance; `solid` = (centre, half) in local coordinates makes it an obstacle."""
        self.instances.append(Instance(name, list(part_names), np.asarray(matrix, float), category, mover, colour))
        if solid is not None:
            self.add_solid(name, category, matrix, solid, mover)

    def add_solid(self, name, category, matrix, solid, mover=None):
        m = np.asarray(matrix, float)
        scale = math.sqrt(float((m[:3, 0] ** 2).sum()))
        centre = m[:3, :3] @ np.asarray(solid[0], float) + m[:3, 3]
        half = tuple(float(h) * scale for h in solid[1])
        self.solids.append(Solid(name, category, tuple(float(c) for c in centre), half, math.atan2(m[1, 0], m[0, 0]), mover))

    # -- questions
    def ego_pose(self, t_s):
        """world_from_ego (4, 4): origin on the ground at the rear axle, x forward."""
        return ego_pose(t_s)

    def obstacles(self, t_s):
        """(name, category, (centre (3), half size (3), yaw)) of what a shifted ego could land in, at t_s."""
        out = []
        for s in self.solids:
            centre, yaw = np.array(s.centre), s.yaw_rad
            if s.mover is not None:
                m = self.movers[s.mover].world_from_mover(t_s)
                centre, yaw = m[:3, :3] @ centre + m[:3, 3], yaw + self.movers[s.mover].yaw_rad
            out.append((s.name, s.category, (centre, np.array(s.half), float(yaw))))
        return out

    def triangle_count(self):
        """Triangles with every instance flattened."""
        n = {k: p.triangle_count() for k, p in self.parts.items()}
        return sum(n[p] for i in self.instances for p in i.parts)

    def geometry_hash(self):
        """sha256 over names, vertices, faces, matrices and movers: equal wherever it is computed."""
        h = hashlib.sha256()
        for name in sorted(self.parts):
            p = self.parts[name]
            h.update((name + "|" + p.material + "|" + p.category + "|" + str(int(p.smooth))).encode())
            h.update(np.ascontiguousarray(p.vertices, "<f4").tobytes())
            h.update(np.ascontiguousarray(p.faces, "<i4").tobytes())
        for i in self.instances:
            h.update("|".join([i.name, i.category, str(i.mover)] + i.parts).encode())
            h.update(_stable_bytes(i.matrix))
        for name in sorted(self.movers):
            m = self.movers[name]
            h.update(name.encode())
            h.update(_stable_bytes([m.x_m, m.y_m, m.z_m, m.yaw_rad, m.speed_m_s]))
        return h.hexdigest()

    def counts(self):
        """Per category: instances and flattened triangles."""
        n = {k: p.triangle_count() for k, p in self.parts.items()}
        out = {}
        for i in self.instances:
            c = out.setdefault(i.category, {"instances": 0, "triangles": 0})
            c["instances"] += 1
            c["triangles"] += sum(n[p] for p in i.parts)
        return dict(sorted(out.items()))


def _stable_bytes(numbers):
    """Rounded to 1e-5 as whole numbers, so that last-bit differences vanish."""
    return np.floor(np.asarray(numbers, float) * 1e5 + 0.5123).astype("<i8").tobytes()


def ego_pose(t_s):
    """world_from_ego of the recorded drive: about 8 m/s, weaving 0.1 m about the lane's centre."""
    w = 2.0 * math.pi / 9.0
    y = EGO_LANE_Y_M + 0.10 * math.sin(w * t_s)
    yaw = math.atan2(0.10 * w * math.cos(w * t_s), EGO_SPEED_M_S)
    return pose(EGO_SPEED_M_S * t_s, y, 0.0, yaw)


def box_gap(centre_a, half_a, yaw_a, centre_b, half_b, yaw_b):
    """Free distance in the ground plane between two oriented boxes by the separating axes (0 or less: they overlap).

    It never overstates the distance.
    """
    d = np.asarray(centre_b, float)[:2] - np.asarray(centre_a, float)[:2]
    best = -1e9
    for yaw in (yaw_a, yaw_b):
        for axis in ((math.cos(yaw), math.sin(yaw)), (-math.sin(yaw), math.cos(yaw))):
            gap = abs(d[0] * axis[0] + d[1] * axis[1])
            for half, y in ((half_a, yaw_a), (half_b, yaw_b)):
                c, s = math.cos(y), math.sin(y)
                gap -= abs(half[0] * (c * axis[0] + s * axis[1])) + abs(half[1] * (-s * axis[0] + c * axis[1]))
            best = max(best, gap)
    return best


def ego_gap(street, t_s, shift=(0.0, 0.0, 0.0)):
    """(distance in m, name) of the obstacle nearest to the ego body at t_s, moved by `shift` in ego metres."""
    m = ego_pose(t_s)
    centre = m[:3, :3] @ (np.array([EGO_CENTRE_X_M, 0.0, 0.8]) + np.asarray(shift, float)) + m[:3, 3]
    yaw = math.atan2(m[1, 0], m[0, 0])
    half = [v / 2 for v in EGO_SIZE_M]
    best = (1e9, "")
    for name, _, (c, h, y) in street.obstacles(t_s):
        if c[2] - h[2] > EGO_SIZE_M[2] + 0.1:
            continue
        g = box_gap(centre, half, yaw, c, h, y)
        if g < best[0]:
            best = (g, name)
    return best
