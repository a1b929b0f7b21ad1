# SPDX-License-Identifier: CC0-1.0
"""Vectorised mesh making: boxes, tubes, lathes, lofts and sweeps.

All lengths in metres, angles in radians, faces counter-clockwise seen from
outside. A face is a row of four vertex numbers; -1 in column 3 means a triangle.
Sine and cosine come from tables rounded to 1e-9, so that the last bit of a
machine's libm never reaches a vertex.
"""
import math

import numpy as np

IDENTITY = np.eye(4)


# ------------------------------------------------------------------ transforms
def cos_sin(angle_rad):
    return round(math.cos(angle_rad), 9), round(math.sin(angle_rad), 9)


def translation(x, y, z=0.0):
    m = np.eye(4)
    m[:3, 3] = (x, y, z)
    return m


def rotation_z(angle_rad):
    c, s = cos_sin(angle_rad)
    m = np.eye(4)
    m[:2, :2] = ((c, -s), (s, c))
    return m


def rotation_y(angle_rad):
    c, s = cos_sin(angle_rad)
    m = np.eye(4)
    m[0, 0], m[0, 2], m[2, 0], m[2, 2] = c, s, -s, c
    return m


def rotation_x(angle_rad):
    c, s = cos_sin(angle_rad)
    m = np.eye(4)
    m[1:3, 1:3] = ((c, -s), (s, c))
    return m


def scaling(x, y=None, z=None):
    return np.diag([x, x if y is None else y, x if z is None else z, 1.0])


def pose(x, y, z=0.0, yaw_rad=0.0, scale=1.0):
    m = rotation_z(yaw_rad)
    m[:3, :3] *= scale
    m[:3, 3] = (x, y, z)
    return m


def to_grid(x):
    """Rounded to 1e-5 m. The odd offset keeps even decimals off the rounding's edge, so last-bit differences vanish."""
    return np.floor(np.asarray(x, float) * 1e5 + 0.5123) / 1e5


def circle(n, start_rad=0.0):
    """(n, 2) points of the unit circle, counter-clockwise."""
    return np.array([cos_sin(start_rad + 2.0 * math.pi * i / n) for i in range(n)])


def smoothstep(a, b, x):
    t = np.clip((np.asarray(x, float) - a) / (b - a), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


# ------------------------------------------------------------------ primitives, as (vertices, faces)
_BOX_FACES = np.array([[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]], np.int32)
_BOX_CORNERS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]], float)


def grid_faces(rows, cols, wrap=False, flip=False):
    """Quads of a (rows, cols) vertex grid; `wrap` closes the columns into a ring."""
    c = cols if wrap else cols - 1
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(c), indexing="ij")
    j1 = (j + 1) % cols
    f = np.stack([i * cols + j, i * cols + j1, (i + 1) * cols + j1, (i + 1) * cols + j], -1).reshape(-1, 4)
    return (f[:, ::-1] if flip else f).astype(np.int32)


def fan_faces(n, flip=False):
    """Triangles of a convex polygon with vertices 0..n-1."""
    i = np.arange(1, n - 1)
    f = np.stack([np.zeros_like(i), i, i + 1, np.full_like(i, -1)], -1)
    return (f[:, [0, 2, 1, 3]] if flip else f).astype(np.int32)


def frames_along(path):
    """Unit tangent, side and up at each point of a (K, 3) path (up leans to +z)."""
    path = np.asarray(path, float)
    t = np.empty_like(path)
    t[1:-1] = path[2:] - path[:-2]
    t[0], t[-1] = path[1] - path[0], path[-1] - path[-2]
    t /= np.sqrt((t * t).sum(1))[:, None]
    ref = np.array([0.0, 0.0, 1.0]) if abs(t[:, 2]).max() < 0.9 else np.array([0.0, 1.0, 0.03])
    side = np.cross(t, ref)
    side /= np.sqrt((side * side).sum(1))[:, None]
    return t, side, np.cross(side, t)


class Builder:
    """Collects triangles and quads per (material, smooth); `parts` turns them into Parts."""

    def __init__(self):
        self.chunks = {}

    # -- raw
    def add(self, material, vertices, faces, uv=None, smooth=False):
        if len(faces):
            self.chunks.setdefault((material, bool(smooth)), []).append(
                (np.asarray(vertices, float), np.asarray(faces, np.int32), None if uv is None else np.asarray(uv, float)))

    def merge(self, other, matrices=None):
        """Adds `other`, once per (4, 4) matrix (default: once, as it is). Mirrors turn their faces."""
        m = np.eye(4)[None] if matrices is None else np.asarray(matrices, float).reshape(-1, 4, 4)
        if not len(m):
            return
        flip = np.linalg.det(m[0, :3, :3]) < 0
        k = len(m)
        for (material, smooth), chunks in other.chunks.items():
            v, f, uv = _concatenate(chunks)
            vv = (np.einsum("kij,nj->kni", m[:, :3, :3], v) + m[:, None, :3, 3]).reshape(-1, 3)
            if flip:
                f = np.where(f[:, 3:4] < 0, f[:, [0, 2, 1, 3]], f[:, [0, 3, 2, 1]])
            ff = f[None] + (np.arange(k, dtype=np.int32) * len(v))[:, None, None]
            ff[:, f[:, 3] < 0, 3] = -1
            self.add(material, vv, ff.reshape(-1, 4), None if uv is None else np.tile(uv, (k, 1)), smooth)

    def merge_at(self, other, positions):
        """Adds `other` at each (x, y, z)."""
        p = np.asarray(positions, float).reshape(-1, 3)
        if len(p):
            m = np.tile(np.eye(4), (len(p), 1, 1))
            m[:, :3, 3] = p
            self.merge(other, m)

    # -- flat things
    def boxes(self, material, low, high, uv=None):
        """Closed boxes between rows of low and high corners."""
        low, high = np.atleast_2d(np.asarray(low, float)), np.atleast_2d(np.asarray(high, float))
        v = (low[:, None] + (high - low)[:, None] * _BOX_CORNERS).reshape(-1, 3)
        f = (_BOX_FACES[None] + (8 * np.arange(len(low), dtype=np.int32))[:, None, None]).reshape(-1, 4)
        self.add(material, v, f, uv)

    def box(self, material, x0, x1, y0, y1, z0, z1):
        self.boxes(material, (x0, y0, z0), (x1, y1, z1))

    def quads(self, material, corners, uv=None):
        """(K, 4, 3) corners, counter-clockwise from outside; uv (K, 4, 2)."""
        c = np.asarray(corners, float).reshape(-1, 4, 3)
        f = np.arange(4 * len(c), dtype=np.int32).reshape(-1, 4)
        self.add(material, c.reshape(-1, 3), f, None if uv is None else np.asarray(uv, float).reshape(-1, 2))

    def prism(self, material, outline, z0, z1, cap_bottom=True):
        """A convex outline (n, 2), counter-clockwise, raised from z0 to z1."""
        p = np.asarray(outline, float)
        n = len(p)
        ring = np.concatenate([np.c_[p, np.full(n, z0)], np.c_[p, np.full(n, z1)]])
        f = [grid_faces(2, n, wrap=True), fan_faces(n) + np.array([n, n, n, 0], np.int32)]
        if cap_bottom:
            f.append(fan_faces(n, flip=True))
        self.add(material, ring, np.concatenate(f))

    def extrude(self, material, profile, a, b, axis="x"):
        """A convex or star-shaped profile (n, 2) swept straight from a to b along an axis.

        axis x: profile is (y, z), counter-clockwise seen from +x; axis y: profile is (z, x), from +y.
        """
        p = np.asarray(profile, float)
        n = len(p)
        def place(t):
            c = np.full(n, float(t))
            return np.c_[c, p] if axis == "x" else np.c_[p[:, 1], c, p[:, 0]]
        v = np.concatenate([place(a), place(b)])
        f = np.concatenate([grid_faces(2, n, wrap=True), fan_faces(n, flip=True), fan_faces(n) + np.array([n, n, n, 0], np.int32)])
        self.add(material, v, f)

    # -- round things
    def tube(self, material, path, radius, sides=8, caps=True, smooth=True):
        """A round tube along (K, 3) points; radius a number or one per point."""
        path = np.asarray(path, float)
        r = np.broadcast_to(np.asarray(radius, float), (len(path),))
        _, side, up = frames_along(path)
        c = circle(sides)
        v = path[:, None] + r[:, None, None] * (c[None, :, :1] * side[:, None] + c[None, :, 1:] * up[:, None])
        self.loft(material, v, caps=caps, smooth=smooth, flip=True)

    def rods(self, material, starts, ends, radius, sides=4):
        """Many straight closed rods at once."""
        a, b = np.atleast_2d(np.asarray(starts, float)), np.atleast_2d(np.asarray(ends, float))
        t = b - a
        t /= np.sqrt((t * t).sum(1))[:, None]
        ref = np.where(np.abs(t[:, 2:]) < 0.9, np.array([[0.0, 0.0, 1.0]]), np.array([[0.0, 1.0, 0.0]]))
        s = np.cross(t, ref)
        s /= np.sqrt((s * s).sum(1))[:, None]
        u = np.cross(s, t)
        c = circle(sides, math.pi / sides)
        ring = radius * (c[None, :, :1] * s[:, None] + c[None, :, 1:] * u[:, None])
        v = np.concatenate([a[:, None] + ring, b[:, None] + ring], 1)
        n = sides
        f = np.concatenate([grid_faces(2, n, wrap=True, flip=True), fan_faces(n), fan_faces(n, flip=True) + np.array([n, n, n, 0], np.int32)])
        ff = f[None] + (np.arange(len(a), dtype=np.int32) * 2 * n)[:, None, None]
        ff[:, f[:, 3] < 0, 3] = -1
        self.add(material, v.reshape(-1, 3), ff.reshape(-1, 4))

    def loft(self, material, rings, caps=True, smooth=True, flip=False):
        """(S, P, 3) closed rings joined in order; counter-clockwise seen from the last ring."""
        g = np.asarray(rings, float)
        s, p = g.shape[:2]
        self.add(material, g.reshape(-1, 3), grid_faces(s, p, wrap=True, flip=flip), smooth=smooth)
        if caps:  # own vertices, so that the cap's edge stays sharp
            self.add(material, g[0], fan_faces(p, flip=not flip), smooth=smooth)
            self.add(material, g[-1], fan_faces(p, flip=flip), smooth=smooth)

    def lathe(self, material, profile, sides=16, centre=(0, 0, 0), smooth=True):
        """(r, z) points from bottom to top, turned about z; r = 0 closes an end. Repeat a point for a sharp edge."""
        pr = np.asarray(profile, float)
        c = circle(sides)
        runs, start = [], 0
        for i in range(1, len(pr)):
            if abs(pr[i] - pr[i - 1]).max() < 1e-9:
                runs.append(pr[start:i])
                start = i
        runs.append(pr[start:])
        for run in runs:
            if len(run) < 2:
                continue
            rings = np.concatenate([run[:, None, :1] * c[None], np.broadcast_to(run[:, None, 1:], (len(run), sides, 1))], 2) + np.asarray(centre, float)
            f = grid_faces(len(run), sides, wrap=True)
            v = rings.reshape(-1, 3)
            low, high = run[0, 0] < 1e-9, run[-1, 0] < 1e-9
            # At a pole the ring has shrunk to a point: keep triangles only.
            f = f.copy()
            if low:
                f[:sides] = np.c_[f[:sides][:, [0, 2, 3]], np.full(sides, -1)]
                f[:sides, 0] = 0
            if high:
                top = (len(run) - 1) * sides
                f[-sides:] = np.c_[f[-sides:, [0, 1]], np.full(sides, top), np.full(sides, -1)]
            self.add(material, v, f, smooth=smooth)

    def ellipsoid(self, material, centre, radii, sides=12, rows=8):
        prof = [(cos_sin(a)[0], cos_sin(a)[1]) for a in [(-0.5 + i / rows) * math.pi for i in range(rows + 1)]]
        prof[0], prof[-1] = (0.0, -1.0), (0.0, 1.0)
        b = Builder()
        b.lathe(material, prof, sides)
        m = np.diag([radii[0], radii[1], radii[2], 1.0])
        m[:3, 3] = centre
        self.merge(b, m)

    def sweep(self, material, section, path, smooth=False):
        """A closed section (n, 2) of (side, up) swept along a level (K, 3) path with mitred corners.

        `side` is to the right of the path; the section is counter-clockwise with side to the right, up upwards.
        """
        path, sec = np.asarray(path, float), np.asarray(section, float)
        d = path[1:] - path[:-1]
        d /= np.sqrt((d * d).sum(1))[:, None]
        right = np.c_[d[:, 1], -d[:, 0], np.zeros(len(d))]
        n = np.concatenate([right[:1], right[:-1] + right[1:], right[-1:]])
        n /= np.sqrt((n * n).sum(1))[:, None]
        lead = np.concatenate([right[:1], right])
        n /= (n * lead).sum(1)[:, None]
        v = path[:, None] + sec[None, :, :1] * n[:, None] + sec[None, :, 1:] * np.array([0.0, 0.0, 1.0])
        self.loft(material, v, caps=True, smooth=smooth, flip=True)

    # -- out
    def parts(self, prefix, category):
        """Parts named prefix.material[.s], vertices rounded to 1e-5 m, degenerate faces dropped."""
        from .scene import Part
        out = []
        for (material, smooth), chunks in self.chunks.items():
            v, f, uv = _concatenate(chunks)
            v = to_grid(v).astype(np.float32)
            v[v == 0] = 0.0  # no negative zero: it would change the hash
            f = _clean(v, f)
            if len(f):
                out.append(Part(prefix + "." + material + (".s" if smooth else ""), material, category, v, f,
                                None if uv is None else to_grid(uv).astype(np.float32), smooth))
        return out

    def bounds(self):
        v = np.concatenate([c[0] for chunks in self.chunks.values() for c in chunks])
        return v.min(0), v.max(0)


def _concatenate(chunks):
    counts = np.cumsum([0] + [len(c[0]) for c in chunks])
    v = np.concatenate([c[0] for c in chunks])
    f = np.concatenate([np.where(c[1] < 0, -1, c[1] + np.int32(o)) for c, o in zip(chunks, counts)]).astype(np.int32)
    uv = None
    if any(c[2] is not None for c in chunks):
        uv = np.concatenate([np.zeros((len(c[0]), 2)) if c[2] is None else c[2] for c in chunks])
    return v, f, uv


def _clean(v, f):
    """Quads with two equal corners become triangles; faces without area are dropped."""
    f = f.copy()
    quad = f[:, 3] >= 0
    p = v[np.where(f < 0, f[:, :1], f)]
    for k in range(4):  # corner k equal to corner k+1: drop corner k+1
        same = quad & (np.abs(p[:, k] - p[:, (k + 1) % 4]).max(1) < 1.5e-5)
        if same.any():
            order = [i for i in range(4) if i != (k + 1) % 4]
            f[same] = np.c_[f[same][:, order], np.full(same.sum(), -1)]
            quad = f[:, 3] >= 0
            p = v[np.where(f < 0, f[:, :1], f)]
    a = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    b = np.cross(p[:, 2] - p[:, 0], p[:, 3] - p[:, 0])
    area = np.sqrt((a.astype(float) ** 2).sum(1)) + np.where(quad, np.sqrt((b.astype(float) ** 2).sum(1)), 0.0)
    return np.ascontiguousarray(f[area > 1e-9])
