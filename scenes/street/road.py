# SPDX-License-Identifier: CC0-1.0
"""Ground, kerbs and pavement islands.

The road is one flat sheet at z = 0; everything painted or worn on it is in the
shader (paint.py), since raised paint makes hairline occlusions. Four pavement
islands with rounded corners stand in it; a kerb runs along each.
"""
import math

import numpy as np

from .mesh import Builder, cos_sin, grid_faces

KERB_M = 0.16           # width of the kerb stones
WALK_Z_M = 0.12         # pavement height
KERB_Z_M = 0.135
CORNER_M = 4.0          # kerb radius at the corners


def ground(plan):
    b = Builder()
    x = np.arange(plan.x_min - 60, plan.x_max + 61, 12.0)
    y = np.arange(-120, 121, 12.0)
    gx, gy = np.meshgrid(x, y, indexing="ij")
    v = np.stack([gx.ravel(), gy.ravel(), np.zeros(gx.size)], 1)
    b.add("asphalt", v, grid_faces(len(x), len(y), flip=True))
    return b


def _corner(cx, cy, sx, sy, r, n):
    """Points of a rounded corner of a kerb line, from the x-running side to the y-running side.

    (cx, cy) is the sharp corner, the island lies towards (-sx, -sy) of it.
    """
    out = []
    for i in range(n + 1):
        c, s = cos_sin(0.5 * math.pi * i / n)
        out.append((cx - sx * r + sx * r * s, cy - sy * r + sy * r * c))
    return out


def island_outline(x0, x1, y_kerb, y_far, n, inset=0.0):
    """Kerb line of an island: from (x0, y_far) around both corners at y_kerb to (x1, y_far)."""
    s = -1.0 if y_kerb > 0 else 1.0      # towards the road's middle
    x0, x1, yk = x0 + inset, x1 - inset, y_kerb - s * inset
    r = CORNER_M - inset
    a = _corner(x0, yk, -1.0, s, r, n)[::-1]
    b = _corner(x1, yk, 1.0, s, r, n)
    return [(x0, y_far)] + a + b + [(x1, y_far)]


def islands(plan, detail):
    """Builder of kerbs and pavements."""
    b = Builder()
    n = {0: 3, 1: 6, 2: 12, 3: 20}[detail]
    for x0, x1 in plan.blocks():
        for yk, far in ((plan.kerb_right, -plan.far_y), (plan.kerb_left, plan.far_y)):
            line = island_outline(x0, x1, yk, far, n)
            _kerb(b, line, yk > 0)
            poly = island_outline(x0, x1, yk, far, n, inset=KERB_M * .5)
            b.prism("pavement", poly if yk < 0 else poly[::-1], -.25, WALK_Z_M, cap_bottom=False) if _ccw(poly if yk < 0 else poly[::-1]) else b.prism("pavement", poly if yk > 0 else poly[::-1], -.25, WALK_Z_M, cap_bottom=False)
    # The far sides of the end roads, and of the cross street's ends.
    w = plan.end_road
    for s, x in ((-1, plan.x_min - w), (1, plan.x_max + w)):
        line = [(x, -110.0), (x, 110.0)]
        _kerb(b, line if s > 0 else line[::-1], False, straight=True)
        lo, hi = (x + KERB_M * .5, x + 45) if s > 0 else (x - 45, x - KERB_M * .5)
        b.box("pavement", lo, hi, -110, 110, -.25, WALK_Z_M)
    for s in (-1, 1):
        y = s * plan.cross_end_y
        x0, x1 = plan.cross_x - plan.cross_half - .02, plan.cross_x + plan.cross_half + .02
        b.box("kerb", x0, x1, min(y, y + s * KERB_M), max(y, y + s * KERB_M), -.25, KERB_Z_M - .004)
        b.box("pavement", x0, x1, min(y + s * .08, s * plan.far_y), max(y + s * .08, s * plan.far_y), -.24, WALK_Z_M - .004)
    return b


def _ccw(p):
    p = np.asarray(p)
    q = np.roll(p, -1, 0)
    return (p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]).sum() > 0


def _kerb(b, line, island_right, straight=False):
    """A kerb along the line; the stone lies on the island's side."""
    p = np.c_[np.asarray(line, float), np.zeros(len(line))]
    # Section (right, up): the road face leans back a little and has a chamfer.
    sec = np.array([(0.0, -.25), (KERB_M, -.25), (KERB_M, KERB_Z_M), (.03, KERB_Z_M), (.012, KERB_Z_M - .02)])
    if straight:
        b.sweep("kerb", sec, p)
        return
    # A left island is walked clockwise about itself, a right one counter-clockwise: put the stone inside.
    d = np.asarray(line[1]) - np.asarray(line[0])
    inside = np.asarray(line[-1]) - np.asarray(line[0])
    right = d[1] * inside[0] - d[0] * inside[1] > 0
    if right:
        b.sweep("kerb", sec, p)
    else:
        b.sweep("kerb", sec, p[::-1])
