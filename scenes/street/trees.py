# SPDX-License-Identifier: CC0-1.0
"""Street trees: trunk, branching limbs and opaque leaves (never alpha), and hedges.

Local frame: origin at the foot of the trunk. Leaves are flat rhombi grouped
around the ends of twigs, tilted outward so that the crown shades softly.
"""
import math

import numpy as np

from .mesh import Builder
from .rng import directions, stream, uniform_array


def build_tree(seed, key, detail):
    """(Builder, solid) of one tree of about 5-7 m."""
    rng = stream(seed, "tree", key)
    b = Builder()
    height = 5.2 + 1.6 * rng.random()
    fork = 2.3 + 0.35 * rng.random()
    r0 = 0.13 + 0.05 * rng.random()
    crown_r = 1.75 + 0.5 * rng.random()
    solid = ((0.0, 0.0, fork / 2), (r0 + .08, r0 + .08, fork / 2))
    centre = np.array([0, 0, fork + (height - fork) * .55])
    if detail == 0:
        b.lathe("bark", [(0, -.1), (r0, -.1), (r0, -.1), (r0, fork + .3), (r0, fork + .3), (0, fork + .3)], 6)
        b.ellipsoid("leaf", centre, (crown_r, crown_r, (height - fork) * .62), 10, 6)
        return b, solid
    lean = np.array([rng.random() - .5, rng.random() - .5, 0]) * .35
    z = np.linspace(0, 1, 7)
    trunk = np.c_[lean[0] * z * z, lean[1] * z * z, -.15 + (fork + .15) * z]
    flare = r0 * (1.0 + .7 * np.clip(1 - z * 5, 0, 1) - .28 * z)
    b.tube("bark", trunk, flare, 7 if detail < 2 else 10)
    tips, limbs = [], 5 if detail < 3 else 6
    for k in range(limbs):
        a = 2 * math.pi * (k + .5 * rng.random()) / limbs
        out = crown_r * (.45 + .3 * rng.random())
        up = (height - fork) * (.35 + .35 * rng.random())
        s = trunk[-1] - np.array([0, 0, .12 + .25 * rng.random()])
        if k == 0:
            out, up = .25, (height - fork) * .8
        end = s + np.array([math.cos(a) * out, math.sin(a) * out, up])
        mid = s + (end - s) * .5 + np.array([0, 0, -.10 * up]) + (np.array([rng.random(), rng.random(), rng.random()]) - .5) * .25
        b.tube("bark", np.round([s, s + (mid - s) * .5, mid, end], 6), [r0 * .55, r0 * .48, r0 * .36, r0 * .16], 6 if detail < 3 else 8)
        tips.append(end)
        for q in range(4 if detail >= 2 else 2):
            t = .35 + .6 * rng.random()
            p = mid + (end - mid) * t
            d = directions(rng, 1)[0]
            d[2] = abs(d[2]) * .8 + .1
            e = p + d * (.55 + .55 * rng.random()) * crown_r * .55
            if detail >= 2:
                b.tube("bark", np.round([p, p + (e - p) * .5 + [0, 0, .05], e], 6), [r0 * .22, r0 * .15, r0 * .06], 4)
            tips += [e, p + (e - p) * .55]
    # Clusters: around each tip, plus some on the crown's ellipsoid so that no hole is too big.
    tips = np.array(tips)
    d = directions(rng, 26)
    d = d[d[:, 2] > -.55]
    shell = centre + d * np.array([crown_r, crown_r, (height - fork) * .55]) * (.62 + .2 * uniform_array(rng, len(d)))[:, None]
    clusters = np.concatenate([tips, shell])
    if detail == 1:
        for c in clusters:
            b.ellipsoid("leaf", np.round(c, 6), (.60, .60, .46), 7, 5)
        return b, solid
    n = 4800 if detail == 2 else 16000
    size = .091 if detail == 2 else .056
    pick = (uniform_array(rng, n) * len(clusters)).astype(int)
    d = directions(rng, n)
    rad = np.sqrt(np.sqrt(uniform_array(rng, n)))
    p = clusters[pick] + d * (rad * (.42 + .26 * uniform_array(rng, n)))[:, None] * np.array([1.1, 1.1, .8])
    out = (p - centre) / np.array([crown_r, crown_r, (height - fork) * .6])
    nrm = out * .75 + directions(rng, n) * .75 + np.array([0, 0, .45])
    b.add("leaf", *_leaves(rng, p, nrm, size, detail))
    return b, solid


def _leaves(rng, p, nrm, size, detail):
    """Rhombic leaves folded along the middle: six corners, two quads at detail 3, else one quad."""
    n = len(p)
    nrm = nrm / (np.sqrt((nrm * nrm).sum(1))[:, None] + 1e-9)
    t = np.cross(nrm, directions(rng, n))
    t /= np.sqrt((t * t).sum(1))[:, None] + 1e-9
    s = np.cross(nrm, t)
    k = (size * (.7 + .6 * uniform_array(rng, n)))[:, None]
    a, c = p - t * k, p + t * k * 1.15
    l, r = p - s * k * .62 - t * k * .1 + nrm * k * .16, p + s * k * .62 - t * k * .1 + nrm * k * .16
    v = np.stack([a, r, c, l], 1).reshape(-1, 3)
    f = np.arange(4 * n, dtype=np.int32).reshape(-1, 4)
    # uv.x: one number per leaf for its tint
    uv = np.repeat(uniform_array(rng, n), 4).reshape(-1, 1)
    return v, f, np.c_[uv, np.tile([0, .5, 1, .5], n)]


def tree_pit():
    """The square grate and soil around a trunk, sunk into the pavement (top above it)."""
    b = Builder()
    b.box("soil", -.62, .62, -.62, .62, 0.0, .125)
    lo, hi = [], []
    for s in (-1, 1):
        lo += [(-.72, s * .67 - .05, 0), (s * .67 - .05, -.6195, 0)]
        hi += [(.72, s * .67 + .05, .15), (s * .67 + .05, .6195, .1495)]
    b.boxes("kerb", lo, hi)
    return b


def hedge(rng, length, detail):
    """A clipped hedge in a stone trough, along x from 0; 0.55 m wide, 0.95 m high."""
    b = Builder()
    b.box("planter", 0, length, -.28, .28, 0, .42)
    if detail < 2:
        b.box("leaf", .04, length - .04, -.25, .25, .40, .95)
        return b
    b.box("hedge_core", .07, length - .07, -.21, .21, .38, .84)
    n = int(length * (340 if detail == 2 else 900))
    u = uniform_array(rng, 3 * n).reshape(3, n)
    p = np.c_[.06 + u[0] * (length - .12), -.23 + .46 * u[1], .43 + .47 * u[2]]
    # Push to the nearest of top and sides.
    w = uniform_array(rng, n)
    p[:, 2] = np.where(w < .4, .84 + .07 * u[2], p[:, 2])
    p[:, 1] = np.where(w >= .4, np.where(u[1] < .5, -.22 - .03 * u[0], .22 + .03 * u[0]), p[:, 1])
    nrm = np.where(w[:, None] < .4, [[0, 0, 1.0]], np.c_[0 * w, np.where(u[1] < .5, -1.0, 1.0), 0 * w + .3]) + .55 * directions(rng, n)
    b.add("leaf", *_leaves(rng, p, nrm, .042, detail))
    return b
