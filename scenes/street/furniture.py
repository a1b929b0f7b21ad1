# SPDX-License-Identifier: CC0-1.0
"""Street furniture: lamps, signals, signs, hydrants, bins, benches, cycles, stalls.

Each function returns (Builder, solid) in a local frame: origin on the ground,
x along the street, the road on the -y side. Lengths in metres.
"""
import math

import numpy as np

from .atlas import ROUND, uv_rect
from .mesh import Builder, circle, pose, rotation_x, rotation_y, rotation_z, translation


def _turned(material, profile, sides, matrix, smooth=True):
    b = Builder()
    b.lathe(material, profile, sides)
    out = Builder()
    out.merge(b, [matrix])
    return out


def lamp_post(detail):
    b = Builder()
    h = 7.6
    if detail == 0:
        b.lathe("iron", [(0, -.1), (.07, -.1), (.07, -.1), (.07, h), (.07, h), (0, h)], 6)
        return b, ((0, 0, h / 2), (.1, .1, h / 2))
    s = 8 if detail == 1 else 14
    b.lathe("iron", [(0, -.1), (.15, -.1), (.15, .25), (.13, .32), (.10, .36), (.10, 1.1), (.085, 1.18), (.07, 1.25), (.055, h - .6), (.05, h)], s)
    t = np.linspace(0, 1, 9)
    arc = np.array([[0, -2.0 * (1 - math.cos(x * 1.45)), h - .05 + .75 * math.sin(x * 1.45)] for x in t])
    b.tube("iron", np.round(arc, 6), np.linspace(.05, .035, 9), s)
    e = arc[-1]
    b.loft("iron", np.stack([np.c_[circle(10)[:, 0] * w, np.full(10, e[1] + d), circle(10)[:, 1] * k + e[2] - .01] for d, w, k in ((.1, .04, .03), (.0, .12, .055), (-.35, .15, .06), (-.62, .10, .045), (-.68, .03, .02))]), flip=True)
    b.box("lamp_glass", -.09, .09, e[1] - .55, e[1] - .05, e[2] - .085, e[2] - .03)
    if detail >= 2:
        b.box("iron_dark", -.05, .05, -.112, -.09, .45, .85)
    return b, ((0, 0, h / 2), (.16, .16, h / 2))


def signal_head(detail, go=True, sides=16):
    """Three-lamp head, looking to -x (towards a driver who comes along +x); origin at its middle."""
    b = Builder()
    b.box("signal_black", -.10, .12, -.17, .17, -.50, .50)
    if detail < 2:
        b.box("signal_green" if go else "signal_red", -.115, -.1005, -.1, .1, (-.42 if go else .22), (-.22 if go else .42))
        return b
    b.boxes("signal_black", [(-.02, -.30, -.62)], [(.0, .30, .62)])
    for k, name in enumerate(("signal_green", "signal_amber", "signal_red")):
        z = -.32 + .32 * k
        lit = (k == 0 and go) or (k == 2 and not go)
        m = translation(-.10, 0, z) @ rotation_y(-math.pi / 2)
        b.merge(_turned(name if lit else name + "_off", [(.115, -.01), (.115, .012), (.08, .035), (0, .045)], sides, m))
        # Visor: a half tube open below.
        ang = np.array([math.pi * (i / 10 * 1.24 - .12) for i in range(11)])
        ring = np.array([[math.cos(a) * .135, math.sin(a) * .135] for a in ang])
        ring = np.round(ring, 9)
        o = np.concatenate([ring, ring[::-1] * .93])
        def at(x, q):
            return np.c_[np.full(len(o), x), o[:, 0], o[:, 1] * q + z]
        b.loft("signal_black", np.stack([at(-.09, 1), at(-.30, 1)]), smooth=False, caps=False)
    return b


def mast_arm(detail, arm_m=5.6, go=True):
    """Traffic signal on a mast arm reaching to -y over the road, with a head on the pole and a walk signal."""
    b = Builder()
    h = 6.1
    s = 8 if detail < 2 else 14
    if detail == 0:
        b.lathe("iron", [(0, -.1), (.1, -.1), (.1, -.1), (.1, h), (.1, h), (0, h)], 6)
        b.box("iron", -.06, .06, -arm_m, 0, h - .2, h - .08)
        b.box("signal_black", -.12, .12, -arm_m + .03, -arm_m + .37, h - .7, h + .3)
        return b, ((0, 0, h / 2), (.14, .14, h / 2))
    b.lathe("iron", [(0, -.1), (.20, -.1), (.20, .18), (.12, .22), (.115, h - .4), (.10, h + .12), (0, h + .16)], s)
    b.tube("iron", [(0, 0, h - .30), (0, -arm_m * .5, h - .08), (0, -arm_m, h - .02)], [.085, .065, .045], s)
    for y in (-arm_m + .25, -arm_m * .52):
        b.merge(signal_head(detail, go), [translation(-.16, y, h - .05)])
    b.merge(signal_head(detail, go), [translation(-.10, -.32, 2.75)])
    if detail >= 2:
        b.rods("iron", [(-.05, -.12, 2.55), (-.05, -.12, 2.95)], [(-.05, -.32, 2.55), (-.05, -.32, 2.95)], .015, 6)
        b.box("signal_black", -.10, .10, .13, .38, 2.25, 2.85)
        b.box("signal_red", -.112, -.1005, .18, .33, 2.60, 2.78)
        b.box("signal_red_off", -.112, -.1005, .18, .33, 2.32, 2.50)
        b.box("appliance", -.055, .055, -.17, -.105, 1.02, 1.22)
        (u0, v0), (u1, v1) = uv_rect("street0")
        b.box("sign_edge", -.015, .015, -2.25, -1.05, h - .75, h - .45)
        for x, y0, y1 in ((-.0155, -1.06, -2.24), (.0155, -2.24, -1.06)):
            b.quads("sign_atlas", [[(x, y0, h - .74), (x, y1, h - .74), (x, y1, h - .46), (x, y0, h - .46)]], [[(u0, v0), (u1, v0), (u1, v1), (u0, v1)]])
        b.rods("iron", [(0, -1.3, h - .451), (0, -2.0, h - .451)], [(0, -1.3, h - .2), (0, -2.0, h - .15)], .012, 4)
    return b, ((0, 0, h / 2), (.2, .2, h / 2))


def sign_post(names, detail, h=2.55):
    """A pole with signs looking to -x; names from atlas.py, top first."""
    b = Builder()
    b.lathe("metal", [(0, -.1), (.032, -.1), (.032, -.1), (.032, h + .3), (.032, h + .3), (0, h + .31)], 6 if detail < 2 else 10)
    z = h
    for name in names:
        r = .33
        n = 8 if name == "stop" else (4 if name in ("priority",) else (28 if name in ROUND else 4))
        start = {"stop": math.pi / 8, "priority": 0.0}.get(name, math.pi / 4 if n == 4 else 0.0)
        k = r if n != 4 or name == "priority" else r * 1.32
        c = circle(n if detail >= 2 else min(n, 8), start) * k
        m = len(c)
        x0, x1 = -.060, -.040
        # Disc: grey back and rim, printed front.
        back = np.c_[np.full(m, x1), c[:, 0], c[:, 1] + z]
        front = np.c_[np.full(m, x0), c[:, 0], c[:, 1] + z]
        b.loft("metal", np.stack([back, front]), smooth=False, flip=True)
        (u0, v0), (u1, v1) = uv_rect(name)
        span = k * (1.0 if n != 4 or name == "priority" else math.sqrt(.5))
        half = span * (1.0 if n != 8 else .924)
        uv = np.c_[u0 + (u1 - u0) * (.5 - .5 * np.clip(c[:, 0] / half, -1, 1)), v0 + (v1 - v0) * (.5 + .5 * np.clip(c[:, 1] / half, -1, 1))]
        from .mesh import fan_faces
        b.add("sign_atlas", front + [-.0012, 0, 0], fan_faces(m, flip=True), uv)
        b.rods("metal", [(-.0395, -.05, z), (-.0395, -.05, z + .12)], [(-.0395, .05, z), (-.0395, .05, z + .12)], .02, 4)
        z -= .78
    return b, ((0, 0, h / 2 + .15), (.06, .06, h / 2 + .15))


def hydrant():
    b = Builder()
    b.lathe("hydrant", [(0, -.05), (.15, -.05), (.15, .04), (.15, .04), (.11, .06), (.10, .42), (.13, .44), (.13, .48), (.10, .50), (.10, .56), (.075, .64), (.03, .68), (.03, .72), (0, .72)], 16)
    for a in (0, math.pi / 2, math.pi):
        m = rotation_z(a) @ translation(.09, 0, .36) @ rotation_y(math.pi / 2)
        b.merge(_turned("hydrant", [(0, 0), (.052, 0), (.052, .05), (.06, .055), (.06, .085), (0, .09)], 10, m))
    return b, ((0, 0, .36), (.2, .2, .36))


def bin_():
    b = Builder()
    b.lathe("bin", [(0, 0), (.20, 0), (.20, 0), (.23, .80), (.245, .80), (.245, .84), (.21, .84), (.19, .70), (0, .68)], 18)
    a = np.arange(18) * 2 * math.pi / 18
    b.rods("bin", [(round(.222 * math.cos(x), 6), round(.222 * math.sin(x), 6), .06) for x in a], [(round(.243 * math.cos(x), 6), round(.243 * math.sin(x), 6), .78) for x in a], .012, 4)
    b.rods("iron", [(.22, 0, .82), (-.22, 0, .82)], [(.20, 0, 1.12), (-.20, 0, 1.12)], .012)
    b.lathe("bin", [(0, 1.10), (.25, 1.10), (.24, 1.14), (.12, 1.20), (0, 1.21)], 18)
    return b, ((0, 0, .6), (.25, .25, .6))


def bollard():
    b = Builder()
    b.lathe("iron", [(0, -.05), (.09, -.05), (.09, .10), (.06, .13), (.055, .80), (.075, .82), (.075, .86), (.06, .90), (.04, .96), (0, .98)], 12)
    b.lathe("white_band", [(.0585, .62), (.060, .62), (.060, .62), (.059, .74), (.059, .74), (.0565, .74)], 12)
    return b, ((0, 0, .49), (.09, .09, .49))


def bench(detail):
    b = Builder()
    for x in (-.72, .72):
        b.extrude("iron", [(-.20, .38), (.20, .38), (.20, .44), (-.20, .44)], x - .03, x + .03)
        b.rods("iron", [(x, -.18, 0), (x, .20, 0)], [(x, -.17, .40), (x, .17, .40)], .028, 6)
        b.rods("iron", [(x, .18, .40)], [(x, .28, .86)], .026, 6)
    n = 5
    for k in range(n):
        y = -.20 + .095 * k
        b.box("bench_wood", -.90, .90, y, y + .075, .4405, .475)
    for k in range(3):
        z, y = .55 + .12 * k, .235 + .025 * k
        b.box("bench_wood", -.90, .90, y - .045, y - .015, z, z + .09)
    return b, ((0, .03, .43), (.92, .30, .43))


def railing_run(length, detail, step=.12):
    """Pedestrian railing along x from 0, with posts and slats."""
    b = Builder()
    if detail == 0:
        b.box("fence", 0, length, -.02, .02, .1, 1.0)
        return b, ((length / 2, 0, .5), (length / 2, .04, .5))
    n = int(round(length / 2.0))
    b.rods("fence", [(i * length / n, 0, -.08) for i in range(n + 1)], [(i * length / n, 0, 1.06) for i in range(n + 1)], .032, 8)
    b.rods("fence", [(0, 0, .98), (0, 0, .16)], [(length, 0, .98), (length, 0, .16)], .020, 6)
    if detail >= 2:
        step = step * (1 if detail == 2 else .8)
        k = int(length / step)
        x = (np.arange(k) + .5) * length / k
        b.rods("fence", np.c_[x, 0 * x, 0 * x + .165], np.c_[x, 0 * x, 0 * x + .975], .0095, 5)
    return b, ((length / 2, 0, .5), (length / 2, .05, .5))


def _ring(b, material, centre, radius, tube, sides, rows=6, axis="y"):
    c = circle(sides)
    p = np.array([[centre[0] + radius * q[0], centre[1], centre[2] + radius * q[1]] for q in c])
    t = circle(rows)
    v = np.stack([np.c_[centre[0] + (radius + tube * q[0]) * c[:, 0], np.full(sides, centre[1] + tube * q[1]), centre[2] + (radius + tube * q[0]) * c[:, 1]] for q in t], 1)
    from .mesh import grid_faces
    f = grid_faces(sides + 1, rows, wrap=True) % (sides * rows)
    b.add(material, v.reshape(-1, 3), f, smooth=True)


def bicycle(detail, leaning=True):
    """A city bicycle along x; leaning a little unless ridden."""
    g = Builder()
    r = .34
    n = 12 if detail < 3 else 32
    for x in (-.52, .54):
        _ring(g, "tyre", (x, 0, r), r - .018, .018, n, 5)
        _ring(g, "chrome", (x, 0, r), r - .04, .010, n, 3)
        k = 8 if detail < 3 else 20
        a = [2 * math.pi * i / k for i in range(k)]
        g.rods("chrome", [(x, (-1) ** i * .018, r) for i in range(k)], [(x + round((r - .045) * math.cos(q), 6), 0, r + round((r - .045) * math.sin(q), 6)) for i, q in enumerate(a)], .0025, 3)
        g.rods("chrome", [(x, -.05, r)], [(x, .05, r)], .022, 8)
    bb, seat, head, head2 = (-.08, 0, .30), (-.20, 0, .80), (.36, 0, .86), (.40, 0, .70)
    g.rods("bike_paint", [bb, bb, seat, (-.16, 0, .62), (-.52, .03, r), (-.52, -.03, r), (-.52, .03, r), (-.52, -.03, r), head, (.42, .045, .66), (.42, -.045, .66)],
           [seat, head2, head, head2, (-.08, .03, .30), (-.08, -.03, .30), (-.19, .02, .74), (-.19, -.02, .74), (.42, 0, .64), (.54, .045, r), (.54, -.045, r)], .016, 8)
    g.tube("chrome", [(.36, 0, .85), (.34, 0, 1.02)], .013, 8)
    g.tube("chrome", [(.16, .28, 1.04), (.26, .26, 1.05), (.34, .12, 1.02), (.34, -.12, 1.02), (.26, -.26, 1.05), (.16, -.28, 1.04)], .012, 8)
    g.tube("car_plastic", [(.10, .285, 1.035), (.20, .275, 1.048)], .018, 8)
    g.tube("car_plastic", [(.10, -.285, 1.035), (.20, -.275, 1.048)], .018, 8)
    g.rods("chrome", [seat], [(-.22, 0, .92)], .013, 6)
    g.ellipsoid("car_plastic", (-.24, 0, .94), (.14, .07, .035), 10, 6)
    g.ellipsoid("car_plastic", (-.14, 0, .94), (.12, .035, .025), 8, 6)
    _ring(g, "chrome", (-.08, -.03, .30), .085, .006, 14, 4)
    g.rods("car_plastic", [(-.08, -.045, .30), (-.08, .045, .30)], [(.02, -.085, .17), (-.18, .085, .43)], .01, 5)
    g.box("car_plastic", -.02, .06, -.14, -.06, .155, .185)
    g.rods("iron", [(-.52, .05, r), (-.52, -.05, r)], [(-.62, .05, .72), (-.62, -.05, .72)], .008)
    g.box("iron", -.78, -.34, -.06, .06, .72, .735)
    out = Builder()
    out.merge(g, [rotation_x(-.10) if leaning else np.eye(4)])
    return out, ((0, 0, .52), (.9, .3, .52))


def cycle_stand():
    b = Builder()
    b.tube("chrome", [(-.35, 0, -.1), (-.35, 0, .62), (-.28, 0, .75), (-.18, 0, .80), (.18, 0, .80), (.28, 0, .75), (.35, 0, .62), (.35, 0, -.1)], .024, 8)
    return b, ((0, 0, .4), (.38, .04, .4))


def planter(rng, detail):
    from .trees import _leaves
    from .rng import directions, uniform_array
    b = Builder()
    b.lathe("planter", [(0, 0), (.30, 0), (.30, 0), (.40, .48), (.44, .50), (.44, .56), (.38, .56), (.36, .46), (0, .46)], 18)
    if detail < 2:
        b.ellipsoid("leaf", (0, 0, .72), (.40, .40, .34), 8, 6)
        return b, ((0, 0, .5), (.44, .44, .5))
    b.ellipsoid("hedge_core", (0, 0, .66), (.30, .30, .24), 10, 6)
    n = 420 if detail == 2 else 1000
    d = directions(rng, n)
    d[:, 2] = np.abs(d[:, 2]) * 1.1 - .15
    p = np.array([0, 0, .66]) + d * np.array([.40, .40, .36]) * (.8 + .3 * uniform_array(rng, n))[:, None]
    b.add("leaf", *_leaves(rng, p, d + .5 * directions(rng, n), .05, detail))
    q = directions(rng, 36)
    q[:, 2] = np.abs(q[:, 2])
    p = np.array([0, 0, .68]) + q * np.array([.42, .42, .38])
    b.boxes("flowers", p - .028, p + .028)
    return b, ((0, 0, .5), (.44, .44, .5))


def cafe_table():
    b = Builder()
    b.lathe("iron", [(0, 0), (.22, 0), (.22, .02), (.03, .04), (.025, .70), (.0, .70)], 14)
    b.lathe("bench_wood", [(0, .70), (.34, .70), (.34, .70), (.34, .73), (.34, .73), (0, .73)], 20)
    for s in (-1, 1):
        x = s * .58
        b.box("goods3", x - .19, x + .19, -.19, .19, .43, .46)
        b.box("goods3", x + s * .17 - .012, x + s * .17 + .012, -.18, .18, .62, .86)
        b.rods("iron", [(x + p, q, 0) for p in (-.17, .17) for q in (-.17, .17)], [(x + p * .95, q * .95, .431) for p in (-.17, .17) for q in (-.17, .17)], .012, 6)
        b.rods("iron", [(x + s * .165, q, .455) for q in (-.16, .16)], [(x + s * .172, q, .85) for q in (-.16, .16)], .011, 6)
    b.lathe("white_band", [(0, .7305), (.045, .7305), (.05, .80), (0, .80)], 10, (.10, .08, 0))
    return b, ((0, 0, .45), (.80, .36, .45))


def parasol():
    b = Builder()
    b.lathe("planter", [(0, 0), (.28, 0), (.28, .08), (.06, .11), (0, .11)], 14)
    b.rods("bench_wood", [(0, 0, .1)], [(0, 0, 2.62)], .024, 8)
    n = 8
    c = circle(n) * 1.35
    top = np.array([0, 0, 2.60])
    rim = np.c_[c, np.full(n, 2.12)]
    low = np.c_[c, np.full(n, 1.96)]
    v = np.concatenate([[top], rim, low, [top - [0, 0, .03]], rim - [0, 0, .02] - np.c_[c, np.zeros(n)] * .01, low - np.c_[c, np.zeros(n)] * .01])
    i = np.arange(n)
    j = (i + 1) % n
    m1 = np.full(n, -1)
    f = np.concatenate([np.c_[0 * i, 1 + i, 1 + j, m1], np.c_[1 + n + i, 1 + n + j, 1 + j, 1 + i]])
    o = 2 * n + 1
    g = np.concatenate([np.c_[0 * i + o, o + 1 + j, o + 1 + i, m1], np.c_[o + 1 + n + j, o + 1 + n + i, o + 1 + i, o + 1 + j]])
    uv = np.concatenate([[[0, 0]], np.c_[i, 0 * i + .5], np.c_[i, 0 * i + 1], [[0, 0]], np.c_[i, 0 * i + .5], np.c_[i, 0 * i + 1]])
    b.add("parasol", v, np.concatenate([f, g]).astype(np.int32), uv)
    return b, ((0, 0, 1.3), (.3, .3, 1.3))


def cabinet():
    b = Builder()
    b.box("planter", -.46, .46, -.20, .20, 0, .10)
    b.box("cabinet", -.43, .43, -.17, .17, .1005, 1.25)
    b.box("cabinet", -.46, .46, -.20, .20, 1.2505, 1.31)
    b.boxes("iron_dark", [(-.004, -.174, .2), (.05, -.19, .70)], [(.004, -.169, 1.2), (.08, -.165, .82)])
    (u0, v0), (u1, v1) = uv_rect("poster3")
    b.quads("sign_atlas", [[(-.38, -.1712, .55), (-.10, -.1712, .55), (-.10, -.1712, .95), (-.38, -.1712, .95)]], [[(u0, v0), (u1, v0), (u1, v1), (u0, v1)]])
    return b, ((0, 0, .65), (.46, .2, .65))


def mailbox():
    b = Builder()
    c = circle(20)
    b.lathe("mailbox", [(0, 0), (.22, 0), (.22, .10), (.20, .12), (.20, 1.18), (.24, 1.20), (.24, 1.26), (.18, 1.34), (.06, 1.40), (0, 1.41)], 20)
    b.box("signal_black", -.12, .12, -.215, -.15, 1.02, 1.07)
    b.box("white_band", -.10, .10, -.213, -.15, .66, .90)
    return b, ((0, 0, .7), (.24, .24, .7))


def meter():
    b = Builder()
    b.lathe("iron", [(0, -.05), (.045, -.05), (.04, 1.05), (0, 1.05)], 8)
    b.loft("metal", np.stack([np.c_[circle(10)[:, 0] * w, circle(10)[:, 1] * w * .7, np.full(10, z)] for z, w in ((1.04, .06), (1.10, .10), (1.32, .11), (1.42, .07), (1.45, .02))]))
    b.box("car_glass", -.06, .06, -.082, -.05, 1.24, 1.34)
    return b, ((0, 0, .7), (.11, .1, .7))


def bus_shelter(detail):
    b = Builder()
    for x in (-2.0, 0.0, 2.0):
        b.box("metal", x - .04, x + .04, .55, .63, 0, 2.42)
    b.box("iron_dark", -2.2, 2.2, -.75, .75, 2.4205, 2.54)
    b.box("appliance", -2.1, 2.1, -.65, .65, 2.40, 2.4195)
    for x0, x1 in ((-1.95, -.05), (.05, 1.95)):
        b.box("shelter_pane", x0, x1, .585, .60, .25, 2.2)
        b.boxes("metal", [(x0, .57, .22), (x0, .57, 2.2)], [(x1, .615, .25), (x1, .615, 2.24)])
    b.box("metal", 2.05, 2.15, -.60, .54, .10, 2.41)
    (u0, v0), (u1, v1) = uv_rect("poster1")
    for x, y0, y1 in ((2.049, .44, -.50), (2.151, -.50, .44)):
        b.quads("sign_atlas", [[(x, y0, .45), (x, y1, .45), (x, y1, 1.95), (x, y0, 1.95)]], [[(u0, v0), (u1, v0), (u1, v1), (u0, v1)]])
    b.box("bench_wood", -1.5, 1.5, .18, .48, .44, .48)
    b.rods("metal", [(-1.2, .33, 0), (1.2, .33, 0)], [(-1.2, .33, .441), (1.2, .33, .441)], .03, 8)
    return b, ((0, 0, 1.25), (2.2, .75, 1.25))


def a_board(k):
    """A folding sign on the pavement."""
    b = Builder()
    (u0, v0), (u1, v1) = uv_rect("poster%d" % k)
    for s in (1, -1):
        m = translation(0, 0, 0) @ rotation_z(0 if s > 0 else math.pi) @ translation(.20, 0, 0) @ rotation_y(-.17)
        g = Builder()
        g.box("bench_wood", -.012, .012, -.30, .30, 0.0, 1.05)
        g.quads("sign_atlas", [[(.0125, -.26, .12), (.0125, .26, .12), (.0125, .26, 1.0), (.0125, -.26, 1.0)]], [[(u0, v0), (u1, v0), (u1, v1), (u0, v1)]])
        b.merge(g, [m])
    return b, ((0, 0, .5), (.25, .32, .5))


def wire(a, c, sag, radius, sides=4, n=14):
    """A hanging cable between two points; `sag` at the middle."""
    b = Builder()
    t = np.linspace(0, 1, n)[:, None]
    p = np.asarray(a, float) * (1 - t) + np.asarray(c, float) * t
    p[:, 2] -= (4 * sag * t * (1 - t))[:, 0]
    b.tube("wire", p, radius, sides)
    return b


def hanging_lamp():
    b = Builder()
    b.lathe("iron", [(0, -.05), (.05, -.02), (.20, -.16), (.26, -.24), (.25, -.25), (.18, -.18), (0, -.14)][::-1], 16)
    b.lathe("lamp_glass", [(0, -.30), (.08, -.27), (.10, -.20), (.06, -.15), (0, -.15)], 12)
    b.rods("wire", [(0, 0, -.06)], [(0, 0, .02)], .008)
    return b


def litter(rng, places):
    """Cups, boxes and crumpled paper at (x, y, z) places; nothing lower than 2 cm."""
    b = Builder()
    for x, y, z in places:
        kind, a = rng.random(), 6.2832 * rng.random()
        m = pose(x, y, z, a)
        g = Builder()
        if kind < .45:
            g.lathe("white_band", [(0, 0), (.028, 0), (.028, 0), (.038, .095), (.038, .095), (0, .085)], 10)
            if rng.random() < .6:
                m = m @ translation(0, 0, .034) @ rotation_y(1.47)
        elif kind < .75:
            g.ellipsoid("paper", (0, 0, .028), (.05, .04, .034), 6, 4)
        else:
            g.boxes("cardboard", [(-.14, -.10, -.005)], [(.14, .10, .06 + .10 * rng.random())])
        b.merge(g, [m])
    return b
