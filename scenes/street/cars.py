# SPDX-License-Identifier: CC0-1.0
"""Cars, vans and buses as smooth lofted bodies.

Local frame: x forward, y left, z up, origin on the ground under the body's
middle. A body is two closed grids: the lower body (stations along x, levels
from underside over the flank to the bonnet) and the greenhouse (a ring of
points around the cabin, levels from the belt to the middle of the roof). Both
are shaded smooth; panes lie in real recesses; wheel arches are cut by raising
the flank's lower edge along a circle.
"""
from dataclasses import dataclass, replace

import numpy as np

from .mesh import Builder, circle, grid_faces, rotation_x, rotation_z, scaling, smoothstep, translation


@dataclass(frozen=True)
class CarSpec:
    """Lengths in metres; shoulder points are (x, z) of the flank's upper edge from tail to nose."""
    name: str
    length: float = 4.5
    width: float = 1.80
    roof: float = 1.45
    wheel_x: tuple = (-1.32, 1.33)
    wheel_r: float = 0.325
    sill: float = 0.21
    shoulder: tuple = ((-2.25, 0.86), (-1.7, 0.93), (-0.6, 0.92), (0.7, 0.89), (1.5, 0.82), (2.25, 0.66))
    glass_front: tuple = (1.05, 0.30)     # windscreen x at the belt, at the roof
    glass_rear: tuple = (-1.80, -1.15)    # rear pane x at the belt, at the roof
    roof_width: float = 0.74              # share of the width
    panes: tuple = ((None, 0.02), (-0.06, None))   # side panes (x0, x1); None: follow the pillar
    doors: tuple = (0.98, -0.02, -1.02)
    cladding: bool = False
    rails: bool = False
    nose_round: float = 0.62
    tail_round: float = 0.50
    rear_pane: bool = True
    tall_lamps: bool = False
    kind: str = "car"


SPECS = {
    "sedan": CarSpec("sedan", length=4.65, shoulder=((-2.32, 0.88), (-1.75, 0.95), (-0.6, 0.93), (0.7, 0.90), (1.45, 0.83), (2.32, 0.64)),
                     glass_front=(1.12, 0.32), glass_rear=(-1.72, -1.02), wheel_x=(-1.38, 1.40), roof=1.44,
                     panes=((None, -0.02), (-0.10, None)), doors=(1.02, -0.06, -1.08)),
    "hatchback": CarSpec("hatchback", length=4.05, shoulder=((-2.02, 0.88), (-1.6, 0.93), (-0.5, 0.92), (0.65, 0.89), (1.35, 0.82), (2.02, 0.66)),
                         glass_front=(1.02, 0.30), glass_rear=(-1.86, -1.52), wheel_x=(-1.22, 1.28), roof=1.47,
                         panes=((None, 0.0), (-0.08, -0.98), (-1.06, None)), doors=(0.95, -0.04, -1.02), width=1.76),
    "wagon": CarSpec("wagon", length=4.75, shoulder=((-2.37, 0.88), (-1.8, 0.94), (-0.6, 0.93), (0.7, 0.90), (1.5, 0.83), (2.37, 0.65)),
                     glass_front=(1.15, 0.36), glass_rear=(-2.22, -1.86), wheel_x=(-1.40, 1.42), roof=1.47,
                     panes=((None, 0.0), (-0.08, -1.04), (-1.12, None)), doors=(1.02, -0.04, -1.08), rails=True),
    "suv": CarSpec("suv", length=4.55, width=1.88, roof=1.68, wheel_r=0.365, sill=0.27,
                   shoulder=((-2.27, 0.98), (-1.8, 1.06), (-0.5, 1.05), (0.8, 1.03), (1.5, 0.98), (2.27, 0.80)),
                   glass_front=(1.08, 0.46), glass_rear=(-2.12, -1.78), wheel_x=(-1.35, 1.36), roof_width=0.78,
                   panes=((None, 0.05), (-0.04, -1.0), (-1.08, None)), doors=(0.98, 0.0, -1.04), cladding=True, rails=True),
    "coupe": CarSpec("coupe", length=4.35, roof=1.33, sill=0.18,
                     shoulder=((-2.17, 0.86), (-1.7, 0.91), (-0.6, 0.88), (0.6, 0.85), (1.3, 0.79), (2.17, 0.60)),
                     glass_front=(0.98, 0.16), glass_rear=(-1.80, -0.86), wheel_x=(-1.28, 1.32), roof_width=0.70,
                     panes=((None, -0.42), (-0.48, None)), doors=(0.86, -0.50)),
    "minivan": CarSpec("minivan", length=4.7, width=1.86, roof=1.78, wheel_r=0.335,
                       shoulder=((-2.35, 1.0), (-1.8, 1.04), (-0.5, 1.03), (1.0, 1.0), (1.7, 0.92), (2.35, 0.72)),
                       glass_front=(1.58, 0.62), glass_rear=(-2.24, -1.98), wheel_x=(-1.42, 1.48), roof_width=0.80,
                       panes=((None, 0.45), (0.37, -0.72), (-0.80, None)), doors=(1.16, 0.41, -0.76)),
    "van": CarSpec("van", length=5.2, width=1.98, roof=2.35, wheel_r=0.35, sill=0.27,
                   shoulder=((-2.6, 1.18), (-1.8, 1.2), (0.0, 1.2), (1.2, 1.18), (1.9, 1.08), (2.6, 0.84)),
                   glass_front=(1.92, 1.20), glass_rear=(-2.56, -2.48), wheel_x=(-1.55, 1.68), roof_width=0.88,
                   panes=((None, 0.72),), doors=(1.36, 0.66, -0.62), nose_round=0.7, tail_round=0.14, tall_lamps=True, kind="van"),
    "bus": CarSpec("bus", length=11.4, width=2.50, roof=3.02, wheel_r=0.48, sill=0.30,
                   shoulder=((-5.7, 1.16), (-3.0, 1.16), (0.0, 1.16), (3.0, 1.16), (5.7, 1.08)),
                   glass_front=(5.58, 5.42), glass_rear=(-5.58, -5.50), wheel_x=(-3.0, 3.1), roof_width=0.93,
                   panes=((None, 4.35), (4.25, 2.75), (2.65, 1.05), (0.95, -0.65), (-0.75, -2.35), (-2.45, -4.05), (-4.15, None)),
                   doors=(5.05, 3.95, 0.75, -0.5), nose_round=0.30, tail_round=0.22, tall_lamps=True, kind="bus"),
}
SPECS["taxi"] = replace(SPECS["sedan"], name="taxi")


def curve(points, x):
    """A smooth curve through (x, z) points (cubic Hermite, tangents from neighbours)."""
    p = np.asarray(points, float)
    xs, ys = p[:, 0], p[:, 1]
    slope = np.empty(len(p))
    slope[1:-1] = (ys[2:] - ys[:-2]) / (xs[2:] - xs[:-2])
    slope[0] = (ys[1] - ys[0]) / (xs[1] - xs[0])
    slope[-1] = (ys[-1] - ys[-2]) / (xs[-1] - xs[-2])
    x = np.clip(np.asarray(x, float), xs[0], xs[-1])
    k = np.clip(np.searchsorted(xs, x, side="right") - 1, 0, len(xs) - 2)
    h = xs[k + 1] - xs[k]
    t = (x - xs[k]) / h
    return (ys[k] * (1 + 2 * t) * (1 - t) ** 2 + ys[k + 1] * t * t * (3 - 2 * t)
            + h * t * (1 - t) * (slope[k] * (1 - t) - slope[k + 1] * t))


def _root(t, p):
    """(1 - t^p)^(1/p) for p = 2 or 4 by square roots only (exact on every machine)."""
    if p == 2:
        return np.sqrt(np.clip(1 - t * t, 0, 1))
    t2 = t * t
    return np.sqrt(np.sqrt(np.clip(1 - t2 * t2, 0, 1)))


def _half_width(spec, x):
    """Half width of the plan outline at x: parallel flanks, rounded and slightly tapered ends."""
    half = spec.length / 2
    tn = np.clip(1 - (half - x) / spec.nose_round, 0, 1)
    tt = np.clip(1 - (half + x) / spec.tail_round, 0, 1)
    taper = 1 - 0.06 * smoothstep(half - 1.4, half, x) - 0.045 * smoothstep(half - 1.4, half, -x)
    return spec.width / 2 * taper * _root(tn, 4) * _root(tt, 4)


def _stations(spec, detail):
    half = spec.length / 2
    n_end, n_arch, step = {1: (6, 9, 0.5), 2: (6, 9, 0.7), 3: (14, 25, 0.16)}[detail]
    t = np.arange(n_end + 1) / n_end
    xs = list(half - spec.nose_round * t * t) + list(-half + spec.tail_round * t * t)
    arch = spec.wheel_r * 1.13
    for w in spec.wheel_x:
        c = circle(2 * (n_arch - 1))[:n_arch, 0]
        xs += list(w + arch * 0.9995 * c) + [w + arch + 0.006, w - arch - 0.006]
    if detail >= 2:
        for d in spec.doors:
            xs += [d - 0.004, d + 0.004]
        xs += [half - 0.40, -half + 0.32]
    xs += list(np.arange(-half + 0.3, half - 0.3, step))
    xs = np.array(sorted(xs))
    keep = [0]
    seams = {round(d + s, 6) for d in spec.doors for s in (-0.004, 0.004)} if detail >= 2 else set()
    for i in range(1, len(xs)):
        gap = xs[i] - xs[keep[-1]]
        if gap < 0.002 or (gap < 0.03 and round(xs[i], 6) not in seams and round(xs[keep[-1]], 6) in seams and gap > 0.0085):
            continue
        keep.append(i)
    return xs[keep]


def _lower_body(b, spec, detail):
    half = spec.length / 2
    x = _stations(spec, detail)
    y = _half_width(spec, x)
    sh = curve(spec.shoulder, x)
    arch = spec.wheel_r * 1.13
    low = spec.sill + 0.07 * smoothstep(half - 0.7, half, x) + 0.09 * smoothstep(half - 0.7, half, -x)
    for w in spec.wheel_x:
        d = x - w
        low = np.maximum(low, np.where(np.abs(d) < arch, spec.wheel_r + np.sqrt(np.clip(arch * arch - d * d, 0, None)), 0))
    f = {1: [0, .12, .35, .60, .88, 1], 2: [0, .12, .22, .34, .352, .46, .60, .75, .90, 1],
         3: [0, .03, .08, .14, .22, .28, .34, .35, .40, .46, .53, .60, .67, .74, .80, .85, .90, .94, .97, 1]}[detail]
    f = np.array(f)
    z = low[:, None] + f * (sh - low)[:, None]
    mid = 0.5 * (spec.sill + sh)[:, None] + 0.03
    rel = np.where(z > mid, (z - mid) / (sh[:, None] - mid), (mid - z) / (mid - spec.sill))
    # Flank section: fullest at mid height, tucked in at the sill, a soft shoulder line above the handles.
    inset = np.where(z > mid, 0.040, 0.050) * rel * rel * spec.width / 1.8
    crease = sh[:, None] - 0.17
    inset = inset - 0.010 * np.clip(1 - np.abs(z - crease) / 0.10, 0, 1)
    inset[:, 0] += 0.012
    yy = y[:, None] * (1 - inset / (spec.width / 2))
    # Ends: bumpers stand out, bonnet edge and boot lid lean back.
    front, back = smoothstep(half - 0.75, half, x)[:, None], smoothstep(half - 0.55, half, -x)[:, None]
    bump = 0.05 + 0.42 * (sh[:, None] - spec.sill) + spec.sill
    lean_f = np.where(z > bump, 0.13 * ((z - bump) / (sh[:, None] - bump)) ** 2, 0.05 * ((bump - z) / bump) ** 2)
    lean_b = np.where(z > bump, 0.09 * ((z - bump) / (sh[:, None] - bump)) ** 2, 0.06 * ((bump - z) / bump) ** 2)
    if spec.kind == "bus":
        lean_f, lean_b = lean_f * 0.3, lean_b * 0.2
    xx = x[:, None] - front * lean_f + back * lean_b
    # Bonnet, boot and the hidden deck under the cabin: a fillet, then a crowned deck to the middle.
    ys, zs, xs = [yy], [z], [xx]
    for share, up, inward in ((.985, .014, .012), (.955, .026, .03), (.90, .036, .06), (.66, .066, .105), (.33, .086, .14), (0, .091, .155)):
        e = yy[:, -1:] * share
        ys.append(e)
        zs.append((sh + up * np.clip(spec.width / 1.8, 1, 1.2))[:, None] - (0.03 * front + 0.01 * back) * (1 if share < .95 else .5))
        xs.append(xx[:, -1:] - front * inward + back * inward * 0.6)
    # Underside: arch liner, inner wall, floor.
    yin = y * 0.60
    floor = np.full_like(x, spec.sill + 0.03) + 0.08 * smoothstep(half - 0.7, half, np.abs(x))
    first = np.stack([np.zeros_like(x), yin, yin, yy[:, 0] - 0.02 * (y > 0.1)], 1)
    firstz = np.stack([floor, floor, np.maximum(low, floor) - 0.0, low + 0.004], 1)
    firstx = np.repeat(xx[:, :1], 4, 1)
    Y = np.concatenate([first] + ys, 1)
    Z = np.concatenate([firstz] + zs, 1)
    X = np.concatenate([firstx] + xs, 1)
    n_under, n_side = 4, len(f)
    _mirrored_grid(b, X, Y, Z, _lower_materials(spec, X, Y, Z, n_under, n_side, f, detail))
    return x


def _lower_materials(spec, X, Y, Z, n_under, n_side, f, detail):
    """Material index per grid cell of the half body: 0 paint, 1 under, 2 black, 3 head lamp, 4 tail lamp, 5 grille, 6 seam."""
    half = spec.length / 2
    s, j = X.shape
    m = np.zeros((s - 1, j - 1), int)
    cx = 0.25 * (X[1:, 1:] + X[:-1, 1:] + X[1:, :-1] + X[:-1, :-1])
    cy = 0.25 * (Y[1:, 1:] + Y[:-1, 1:] + Y[1:, :-1] + Y[:-1, :-1])
    fc = np.full(j - 1, 2.0)
    fc[n_under:n_under + n_side - 1] = 0.5 * (f[1:] + f[:-1])
    fc = np.broadcast_to(fc, m.shape)
    xm = 0.5 * (X[1:, n_under + n_side - 1] + X[:-1, n_under + n_side - 1])[:, None]
    x0 = 0.5 * (X[1:, n_under + 1] + X[:-1, n_under + 1])[:, None]
    side = (fc < 1) & (fc > 0)
    m[:, :n_under] = 1
    trim = 0.12 if not spec.cladding else 0.22
    m[side & (fc < trim)] = 2
    w = spec.width / 2
    lamp = side & (fc > (.60 if not spec.tall_lamps else .34)) & (fc < (.90 if not spec.tall_lamps else .60))
    m[lamp & (x0 > half - 0.40) & (cy > 0.52 * w)] = 3
    lamp = side & (fc > .46) & (fc < .90) if not spec.tall_lamps else side & (fc > .22) & (fc < .80)
    m[lamp & (x0 < -half + 0.32) & (cy > 0.60 * w)] = 4
    front = cx > half - 0.14
    m[side & front & (fc > .12) & (fc < .34) & (cy < 0.62 * w)] = 5
    m[side & front & (fc > .60) & (fc < .80) & (cy < 0.50 * w)] = 5 if spec.kind != "bus" else 0
    if detail >= 2:
        for d in spec.doors:
            m[side & (np.abs(xm - d) < 0.0039) & (fc > trim)] = 6
        # Joint between the bumpers and the body, and the van's rubbing strip.
        ends = (x0 > spec.wheel_x[1] + spec.wheel_r * 1.13) | (x0 < spec.wheel_x[0] - spec.wheel_r * 1.13)
        m[side & (fc > .34) & (fc < .352) & ends & (m == 0)] = 6
        if spec.kind == "van":
            m[side & (fc > .22) & (fc < .34) & ~ends & (m == 0)] = 2
    return m


BODY_MATERIALS = ["car_paint", "car_under", "car_plastic", "head_lamp", "tail_lamp", "car_grille", "car_seam", "car_glass"]


def _mirrored_grid(b, X, Y, Z, m, closed_ring=True):
    """Adds the half grid (stations, levels) and its mirror as one smooth closed surface, split by material."""
    s, j = X.shape
    P = np.stack([X, Y, Z], -1)
    mirror = P[:, j - 2:0:-1] * np.array([1.0, -1.0, 1.0])
    full = np.concatenate([P, mirror], 1)
    f = grid_faces(s, 2 * j - 2, wrap=True).reshape(s - 1, 2 * j - 2, 4)
    mm = np.concatenate([m, m[:, ::-1]], 1)
    v = full.reshape(-1, 3)
    # One smooth surface: normals are shared inside a material; borders are material changes anyway.
    for k, name in enumerate(BODY_MATERIALS):
        sel = f[mm == k]
        if len(sel):
            used, inverse = np.unique(sel, return_inverse=True)
            b.add(name, v[used], inverse.reshape(-1, 4).astype(np.int32), smooth=name != "car_seam")


def _greenhouse(b, spec, detail):
    w = spec.width / 2
    tall = spec.roof
    v = {1: [0, .12, .50, .90, 1.0], 2: [0, .07, .12, .45, .89, .95, 1.0], 3: [0, .07, .12, .22, .34, .48, .62, .76, .89, .93, .97, 1.0]}[detail]
    v = np.array(v)
    j_glass0, j_glass1 = int(np.argmin(abs(v - .12))), int(np.argmin(abs(v - .89)))
    na, nc, ns = {1: (3, 1, 1), 2: (4, 3, 2), 3: (8, 5, 5)}[detail]
    bow_f = 0.20 if spec.kind != "bus" else 0.14
    bow_r = 0.14 if spec.kind == "car" else 0.05
    cor = 0.13 if spec.kind == "car" else 0.10
    gw = w * (0.955 + (spec.roof_width - 0.955) * (0.45 * v + 0.55 * v * v))
    fx = spec.glass_front[0] + (spec.glass_front[1] - spec.glass_front[0]) * (v + 0.16 * v * (1 - v))
    rx = spec.glass_rear[0] + (spec.glass_rear[1] - spec.glass_rear[0]) * (v - 0.16 * v * (1 - v))
    # Ring of points from the front middle over the left flank to the rear middle.
    xs, ys, pane = [], [], []   # pane[i]: kind of the cell between point i and i+1
    for a in np.arange(na + 1) / na:
        xs.append(fx - bow_f * a * a); ys.append(gw * 0.88 * a); pane.append("front")
    pane[-1] = "pillar"
    for a in (np.arange(1, nc + 1) / nc):
        c = np.sqrt(np.clip(1 - (1 - a) ** 2, 0, 1))
        xs.append(fx - bow_f - cor * a * (0.5 + 0.5 * a)); ys.append(gw * (0.88 + 0.12 * c)); pane.append("pillar")
    side0, side1 = fx - bow_f - cor, rx + bow_r + cor
    edges = []
    for x0, x1 in spec.panes:
        p0 = side0 - 0.03 if x0 is None else np.full_like(v, x0)
        p1 = side1 + (0.10 if spec.kind == "car" else 0.05) if x1 is None else np.full_like(v, x1)
        edges.append((p0, p1))
    first = True
    for p0, p1 in edges:
        for k in range(ns + 1):
            t = k / ns
            xs.append(p0 + (p1 - p0) * t); ys.append(gw * 1.0); pane.append("side" if k < ns else "post")
    if spec.panes[-1][1] is not None:      # panelled flank behind the last pane (van)
        for t in np.arange(1, 5) / 5:
            xs.append(edges[-1][1] + (side1 - edges[-1][1]) * t); ys.append(gw * 1.0); pane.append("panel")
        pane[-5] = "panel"
    else:
        pane[-1] = "pillar"
    xs.append(side1); ys.append(gw * 1.0); pane.append("pillar")
    for a in np.arange(1, nc + 1) / nc:
        c = np.sqrt(np.clip(1 - a * a, 0, 1))
        xs.append(rx + bow_r + cor * (1 - a) * (1 - .5 * a)); ys.append(gw * (0.86 + 0.14 * c)); pane.append("rear" if a == 1 else "pillar")
    for a in np.arange(1, na + 1) / na:
        xs.append(rx + bow_r * (1 - a) ** 2); ys.append(gw * 0.86 * (1 - a)); pane.append("rear")
    pane = pane[:-1]
    X, Y = np.array(xs), np.array(ys)                        # (ring, level)
    base = curve(spec.shoulder, X[:, 0]) - 0.05
    crown = 0.05 * np.clip(spec.length / 4.5, 1, 1.3)
    top = tall - crown
    mid_x = 0.5 * (spec.glass_front[1] + spec.glass_rear[1])
    # The roof falls towards its ends.
    fall = 0.035 * ((X[:, -1:] - mid_x) / (0.5 * (spec.glass_front[1] - spec.glass_rear[1]) + 0.2)) ** 2
    zt = top - np.clip(fall, 0, 0.05)
    Z = base[:, None] + (zt - base[:, None]) * v
    # Roof: keep turning in towards the middle.
    for share, up in ((.955, .33), (.88, .58), (.70, .83), (.45, .95), (.2, 1.0), (0, 1.01)):
        X = np.concatenate([X, X[:, len(v) - 1:len(v)] + (mid_x - X[:, len(v) - 1:len(v)]) * (1 - share) * 0.06], 1)
        Y = np.concatenate([Y, Y[:, len(v) - 1:len(v)] * share], 1)
        Z = np.concatenate([Z, zt + crown * up - 0.0], 1)
    n, j = X.shape
    m = np.zeros((n - 1, j - 1), int)
    glass = slice(j_glass0, j_glass1)
    blocks = []
    i = 0
    while i < n - 1:
        k = i
        while k < n - 1 and pane[k] == pane[i]:
            k += 1
        kind = pane[i]
        if kind in ("front", "side") or (kind == "rear" and spec.rear_pane):
            low = j_glass0 if not (kind == "rear" and spec.kind == "van") else int(np.argmin(abs(v - .45)))
            blocks.append((i, k, kind, low))
            m[i:k, low:j_glass1] = 7
        if kind == "post":
            m[i:k, glass] = 2
        i = k
    _ring_grid(b, X, Y, Z, m, blocks, j_glass1, detail)


def _ring_grid(b, X, Y, Z, m, blocks, j1, detail):
    n, j = X.shape
    P = np.stack([X, Y, Z], -1)
    mirror = P[n - 2:0:-1] * np.array([1.0, -1.0, 1.0])
    full = np.concatenate([P, mirror], 0)                    # ring closed
    ring = len(full)
    gf = grid_faces(j, ring, wrap=True).reshape(j - 1, ring, 4)
    mm = np.concatenate([m, m[::-1]], 0).T                   # (level, ring)
    v = full.transpose(1, 0, 2).reshape(-1, 3)               # level major
    for k, name in enumerate(BODY_MATERIALS):
        if name == "car_glass" and detail >= 2:
            continue
        sel = gf[mm == k]
        if len(sel):
            used, inverse = np.unique(sel, return_inverse=True)
            b.add(name, v[used], inverse.reshape(-1, 4).astype(np.int32), smooth=True)
    if detail < 2:
        return
    # Panes: a recessed copy of the block with a black rim.
    g = v.reshape(j, ring, 3)
    du = np.roll(g, -1, 1) - np.roll(g, 1, 1)
    dv = np.empty_like(g)
    dv[1:-1] = g[2:] - g[:-2]
    dv[0], dv[-1] = g[1] - g[0], g[-1] - g[-2]
    nn = np.cross(du, dv)
    nn /= np.sqrt((nn * nn).sum(-1))[..., None] + 1e-12
    spans = []
    for i, k, kind, j0 in blocks:
        if kind == "front":
            spans.append(([(q % ring) for q in range(-k, k + 1)], j0))
        elif kind == "rear":
            spans.append((list(range(i, i + 2 * (k - i) + 1)), j0))
        else:
            spans.append((list(range(i, k + 1)), j0))
            spans.append(([(ring - q) % ring for q in range(k, i - 1, -1)], j0))
    for cols, j0 in spans:
        outer = g[j0:j1 + 1][:, cols]
        inner = outer - 0.011 * nn[j0:j1 + 1][:, cols]
        r, c = outer.shape[:2]
        b.add("car_glass", inner.reshape(-1, 3), grid_faces(r, c), smooth=True)
        def loop(a):
            return np.concatenate([a[0, :-1], a[:-1, -1], a[-1, :0:-1], a[:0:-1, 0]])
        lo, li = loop(outer), loop(inner)
        b.add("car_plastic", np.concatenate([lo, li]), grid_faces(2, len(lo), wrap=True))


def wheel(spec, detail):
    """One wheel about the y axis at the origin, its outer face to +y."""
    r, width = spec.wheel_r, 0.205 if spec.kind != "bus" else 0.30
    b = Builder()
    sides = {1: 14, 2: 18, 3: 44}[detail]
    h = width / 2
    rim = r * 0.66
    if detail == 1:
        b.lathe("tyre", [(0, -h), (r, -h), (r, -h), (r, h), (r, h), (0, h)], sides)
        b.lathe("rim", [(0, h + .004), (rim, h + .004), (rim, h + .004), (0, h + .012)], sides)
    else:
        b.lathe("tyre", [(0, -h), (r * .93, -h), (r * .93, -h), (r * .99, -h * .82), (r * .99, h * .82),
                         (r * .93, h * 1.02), (r * .80, h * 1.04), (rim + .004, h * .97), (rim - .012, h * .6)], sides)
        b.lathe("rim", [(rim + .008, h * .96), (rim + .007, h * 1.04), (rim - .008, h * 1.05), (rim - .024, h * .93), (rim - .03, h * .05)], sides)
        b.lathe("brake", [(rim - .029, h * .05), (0, h * .06)], sides)
        hub = Builder()
        hub.lathe("rim", [(.045 + .02, h * .10), (.065, h * .80), (.05, h * .90), (0, h * .92)], 12)
        b.merge(hub)
        spoke = Builder()
        p = np.array([[.03, -.030, h * .55], [.03, .030, h * .55], [.03, .024, h * .86], [.03, -.024, h * .86]])
        q = np.array([[rim - .02, -.034, h * .60], [rim - .02, .034, h * .60], [rim - .02, .026, h * .90], [rim - .02, -.026, h * .90]])
        mid = 0.5 * (p + q) * np.array([1, .70, 1.0]) + np.array([0, 0, .012 * 1.0])
        spoke.loft("rim", np.stack([p, mid, q] if detail > 2 else [p, q]), smooth=False, flip=False)
        b.merge(spoke, [rotation_z(2 * np.pi * k / 5) for k in range(5)])
    out = Builder()
    out.merge(b, [rotation_x(-np.pi / 2)])
    return out


def build_car(name, detail, plate=0):
    """(Builder, centre, half size) of a body style."""
    from .atlas import uv_rect
    spec = SPECS[name]
    b = Builder()
    l, w = spec.length / 2, spec.width / 2
    solid = ((0.0, 0.0, spec.roof / 2), (l, w + 0.02, spec.roof / 2))
    if detail == 0:
        z = spec.shoulder[2][1]
        b.box("car_paint", -l, l, -w, w, 0.22, z)
        b.box("car_glass", spec.glass_rear[0] * .95, spec.glass_front[0] * .75, -w * .9, w * .9, z - 0.02, spec.roof)
        for x in spec.wheel_x:
            b.box("tyre", x - .3, x + .3, -w - .01, w + .01, 0.0, 0.6)
        return b, solid
    _lower_body(b, spec, detail)
    _greenhouse(b, spec, detail)
    wh = wheel(spec, detail)
    y = w - 0.115 if spec.kind != "bus" else w - 0.18
    for x in spec.wheel_x:
        b.merge(wh, [translation(x, y, spec.wheel_r)])
        b.merge(wh, [rotation_z(np.pi) @ translation(-x, y, spec.wheel_r)])
    if detail >= 2:
        _small_parts(b, spec, uv_rect("plate%d" % (plate % 8)))
    return b, solid


def _rounded_box(b, material, centre, size, r=0.02):
    """A closed box with bevelled edges, smooth."""
    c, h = np.asarray(centre, float), np.asarray(size, float) / 2
    ring = np.array([(1, .6), (.6, 1), (-.6, 1), (-1, .6), (-1, -.6), (-.6, -1), (.6, -1), (1, -.6)])
    def at(x, k):
        return np.c_[np.full(8, x), ring * h[1:] * k]
    b.loft(material, c + np.stack([at(-h[0], .75), at(-h[0] + r, 1), at(h[0] - r, 1), at(h[0], .75)]), smooth=True)


def _small_parts(b, spec, plate_uv):
    half, w = spec.length / 2, spec.width / 2
    (u0, v0), (u1, v1) = plate_uv
    zf, zr = spec.sill + 0.22, (0.72 if spec.kind == "car" else 0.52)
    if spec.cladding:
        zr = 0.80
    # Number plates: thin boxes sunk into the bumpers, lettering on the outer face.
    for x, s, z in ((half - 0.015, 1, zf), (-half + 0.035, -1, zr)):
        b.box("car_plastic", x - .04, x + .04, -.28, .28, z - .075, z + .075)
        xo = x + s * 0.046
        q = [(xo, -s * .26, z - .055), (xo, s * .26, z - .055), (xo, s * .26, z + .055), (xo, -s * .26, z + .055)]
        b.quads("sign_atlas", [q], [[(u0, v0), (u1, v0), (u1, v1), (u0, v1)]])
    if spec.kind == "bus":
        for s in (1, -1):
            b.tube("car_plastic", [(half - .12, s * (w - .25), 2.55), (half + .22, s * (w - .05), 2.5), (half + .26, s * (w + .02), 2.2)], .018, 6)
            _rounded_box(b, "car_plastic", (half + .26, s * (w + .04), 2.02), (.10, .20, .40))
        _rounded_box(b, "car_plastic", (1.5, 0, spec.roof + .10), (2.2, 1.7, .30), .08)
        _rounded_box(b, "car_plastic", (-3.2, 0, spec.roof + .09), (1.6, 1.6, .28), .08)
        _bus_signs(b, spec)
        return
    # Mirrors on stalks.
    xm = spec.glass_front[0] - 0.42
    zm = float(curve(spec.shoulder, np.array([xm]))[0]) + 0.10
    for s in (1, -1):
        b.tube("car_plastic", [(xm, s * (w - .10), zm - .04), (xm - .02, s * (w + .04), zm - .02)], .022, 6)
        _rounded_box(b, "car_paint", (xm - .01, s * (w + .11), zm + .02), (.12, .20, .13), .045)
        b.box("mirror", xm - .078, xm - .060, s * (w + .11) - .075, s * (w + .11) + .075, zm - .025, zm + .065)
    # Door handles.
    for k, d in enumerate(spec.doors[1:]):
        z = float(curve(spec.shoulder, np.array([d]))[0]) - 0.13
        for s in (1, -1):
            _rounded_box(b, "car_paint" if spec.kind == "car" else "car_plastic", (d + .17, s * (w - .012), z), (.19, .045, .030), .03)
    # Wipers on the windscreen's foot, aerial, exhaust.
    zb = float(curve(spec.shoulder, np.array([spec.glass_front[0]]))[0])
    x0, x1 = spec.glass_front
    for y in (-.52 * w, .10 * w):
        b.tube("car_plastic", [(x0 - .005, y, zb + .055), (x0 - .03 + (x1 - x0) * .05, y + .28 * w, zb + .10), (x0 + .02 + (x1 - x0) * .12, y + .52 * w, zb + .14)], .008, 4)
    if spec.kind == "van":     # joint, hinges and handle of the rear doors
        x = -half + .012
        b.box("car_seam", x - .02, x + .05, -.006, .006, .55, 2.05)
        b.box("car_plastic", x - .035, x + .05, .05, .20, 1.02, 1.08)
        for z in (.75, 1.35, 1.95):
            b.boxes("car_plastic", [(x - .02, -w * .84, z), (x - .02, w * .80, z)], [(x + .08, -w * .80, z + .09), (x + .08, w * .84, z + .09)])
    if spec.kind == "car":
        b.tube("chrome", [(-half + .03, .48 * w, spec.sill + .06), (-half + .22, .48 * w, spec.sill + .06)], .032, 10)
        xr = spec.glass_rear[1] + .12
        b.loft("car_paint", np.stack([np.c_[np.full(6, xr), circle(6) * [.014, .01] + [0, spec.roof - .025]],
                                      np.c_[np.full(6, xr - .10), circle(6) * [.012, .02] + [0, spec.roof - .01]],
                                      np.c_[np.full(6, xr - .16), circle(6) * [.004, .025] + [0, spec.roof - .005]]]), flip=True)
    if spec.rails:
        x0, x1 = spec.glass_front[1] - .15, spec.glass_rear[1] + .15
        yr, zr = w * spec.roof_width * .90, spec.roof - .015
        for s in (1, -1):
            b.tube("chrome", [(x0, s * yr, zr - .06), (x0 - .12, s * yr, zr + .025), ((x0 + x1) / 2, s * yr, zr + .03), (x1 + .12, s * yr, zr + .025), (x1, s * yr, zr - .06)], .016, 6)
    # Badge and lamp bars.
    b.lathe("chrome", [(0, -.02), (.045, -.02), (.05, .0), (.04, .012), (0, .014)], 14, smooth=True)
    chunk = b.chunks[("chrome", True)].pop()
    v = chunk[0]
    z = float(curve(spec.shoulder, np.array([half]))[0]) - .09
    m = np.stack([v[:, 2] + half - .075, v[:, 0], v[:, 1] + z], 1)
    b.add("chrome", m, chunk[1], smooth=True)
    zt = spec.sill + .62 * (float(curve(spec.shoulder, np.array([-half]))[0]) - spec.sill)
    v2 = np.stack([-v[:, 2] - half + .03, -v[:, 0], v[:, 1] + zt + .10], 1)
    b.add("chrome", v2, chunk[1], smooth=True)


def _bus_signs(b, spec):
    """Line number over the windscreen, banners along the flanks."""
    from .atlas import uv_rect
    half, w = spec.length / 2, spec.width / 2
    def board(name, corners):
        (u0, v0), (u1, v1) = uv_rect(name)
        b.quads("sign_atlas", [corners], [[(u0, v0), (u1, v0), (u1, v1), (u0, v1)]])
    x = half - .16
    b.box("car_plastic", x - .3, x + .02, -.85, .85, 2.66, 2.92)
    board("number0", [(x + .0205, -.80, 2.70), (x + .0205, .80, 2.70), (x + .0205, .80, 2.89), (x + .0205, -.80, 2.89)])
    for s in (1, -1):
        y = s * (w + .012)
        b.box("car_plastic", -2.0, 2.0, min(y, s * (w - .05)), max(y, s * (w - .05)), .55, 1.05)
        x0, x1 = (1.95, -1.95) if s > 0 else (-1.95, 1.95)
        board("ad0", [(x0, y + s * .0005, .58), (x1, y + s * .0005, .58), (x1, y + s * .0005, 1.02), (x0, y + s * .0005, 1.02)])


CAR_COLOURS = [(0.80, 0.81, 0.82), (0.62, 0.64, 0.66), (0.33, 0.35, 0.37), (0.035, 0.037, 0.042), (0.10, 0.11, 0.125), (0.42, 0.025, 0.02),
               (0.55, 0.035, 0.03), (0.02, 0.075, 0.26), (0.03, 0.16, 0.40), (0.025, 0.13, 0.09), (0.55, 0.50, 0.42), (0.83, 0.82, 0.78),
               (0.60, 0.24, 0.03), (0.14, 0.22, 0.28)]
TAXI_COLOUR = (0.85, 0.48, 0.02)
