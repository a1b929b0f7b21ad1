# SPDX-License-Identifier: CC0-1.0
"""Shop fronts: framed openings onto shallow furnished rooms, fascia signs, awnings.

Same local frame as buildings.py. The windows are open holes (all materials of
the street are opaque), so the rooms are real boxes that a camera sees into.
"""
import numpy as np

from .atlas import uv_rect
from .mesh import Builder, circle, grid_faces
from .rng import pick, uniform_array

KINDS = ("books", "clothes", "grocery", "cafe", "bakery", "flowers")
ROOM_DEPTH_M = 1.9


def shop_front(b, wall, style, rng, width, detail, margin0, margin1, wall_material, sign0):
    """Fills the ground floor of a facade: shops of 4-7 m and one house door."""
    z_top = min(3.05, style.ground_m - 0.85)
    sign_z0 = z_top + 0.08
    sign_z1 = min(sign_z0 + 0.62, style.ground_m - .14)
    openings, shops = [], []
    u = margin0
    usable = width - margin0 - margin1
    if usable < 3.0:
        wall.band(0, width, -.3, style.ground_m, [])
        return
    door_w = 1.7
    n = max(1, int((usable - door_w) / 5.6))
    shop_w = (usable - door_w) / n if usable > 6 else usable
    door_at = int(rng.random() * (n + 1)) if usable > 6 else -1
    for k in range(n + 1):
        if k == door_at:
            openings.append((u + .3, u + door_w - .3, -.02, 2.55, .40, None))
            _house_door(b, u + .3, u + door_w - .3, detail)
            u += door_w
        if k < n:
            a, e = u + .28, u + shop_w - .28
            openings.append((a, e, -.02, z_top, ROOM_DEPTH_M, None))
            shops.append((a, e))
            u += shop_w
    # The openings' reveals are the rooms' side walls, ceiling and floor (the floor stands a little up).
    wall.band(0, width, -.3, style.ground_m, sorted(openings))
    for k, (a, e) in enumerate(shops):
        kind = pick(rng, KINDS)
        _shop(b, style, rng, kind, a, e, z_top, sign_z0, sign_z1, detail, sign0 + 3 * k)


def _house_door(b, a, e, detail):
    b.box("door", a - .02, e + .02, .36, .45, -.1, 2.10 if detail >= 2 else 2.155)
    b.box("window", a - .02, e + .02, .385, .45, 2.16, 2.60)
    if detail >= 2:
        b.box("frame", a, e, .33, .45, 2.101, 2.159)
        m = (a + e) / 2
        b.boxes("door_panel", [(a + .10, .335, .2), (a + .10, .335, 1.1)], [(e - .10, .362, .95), (e - .10, .362, 1.95)])
        b.ellipsoid("chrome", (e - .07, .32, 1.02), (.025, .035, .025), 8, 6)
        b.box("appliance_dark", e + .10, e + .22, -.02, .03, 1.25, 1.55)     # doorbell plate


def _shop(b, style, rng, kind, a, e, top, sz0, sz1, detail, sign):
    d = ROOM_DEPTH_M
    w = e - a
    # Room lining: set off the reveals so that no two faces share a plane.
    b.quads("shop_wall", [[(a, d - .02, 0), (e, d - .02, 0), (e, d - .02, top), (a, d - .02, top)]])
    b.quads("shop_wall", [[(a + .012, .14, 0), (a + .012, .14, top), (a + .012, d, top), (a + .012, d, 0)][::-1],
                          [(e - .012, .14, 0), (e - .012, d, 0), (e - .012, d, top), (e - .012, .14, top)][::-1]])
    b.quads("shop_ceiling", [[(a, .14, top - .015), (a, d, top - .015), (e, d, top - .015), (e, .14, top - .015)]])
    b.quads("shop_floor", [[(a, .02, .13), (e, .02, .13), (e, d, .13), (a, d, .13)]])
    b.quads("shop_wall", [[(a, .02, -.02), (e, .02, -.02), (e, .02, .13), (a, .02, .13)]])
    frame = pick(rng, ("shop_frame_dark", "shop_frame_wood", "shop_frame_green", "shop_frame_white", "shop_frame_red", "shop_frame_blue"))
    name = "shop%d" % (sign % 24)
    # Fascia: a board with the name, on every level of detail from 1 up.
    b.box(frame, a - .16, e + .16, -.10, .03, sz0, sz1)
    (u0, v0), (u1, v1) = uv_rect(name)
    hgt = (sz1 - sz0) * .80
    sw = min(w * .92, hgt * 8)
    m, zc = (a + e) / 2, (sz0 + sz1) / 2
    cut = (sw / (hgt * 8))
    hh = hgt / 2 if cut > .999 else sw / 16
    b.box("sign_edge", m - sw / 2 - .02, m + sw / 2 + .02, -.135, -.101, zc - hh - .02, zc + hh + .02)
    b.quads("sign_atlas", [[(m - sw / 2, -.1355, zc - hh), (m + sw / 2, -.1355, zc - hh), (m + sw / 2, -.1355, zc + hh), (m - sw / 2, -.1355, zc + hh)]],
            [[(u0, v0), (u1, v0), (u1, v1), (u0, v1)]])
    if detail < 2:
        return
    # Stall riser, mullions, transom, recessed door.
    door_left = rng.random() < .5
    dw = 1.05
    d0, d1 = (a + .02, a + dw) if door_left else (e - dw, e - .02)
    g0, g1 = (a + dw, e) if door_left else (a, e - dw)
    b.box(frame, g0, g1, .04, .13, -.1, .50)
    b.box(frame, g0 + .06, g1 - .06, .025, .05, .10, .42)
    b.box(frame, a, e, .03, .12, top - .10, top + .02)
    b.box(frame, a, e, .045, .115, top - .62, top - .56)
    posts = [a + .005, e - .065, d1 if door_left else d0 - .06]
    k = max(1, int(round((g1 - g0) / 1.7)))
    posts += [g0 + (g1 - g0) * i / k for i in range(1, k)]
    b.boxes(frame, [(p, .035, -.1) for p in posts], [(p + .06, .125, top - .10) for p in posts])
    # Door leaf: a frame with a dark pane; the pull in chrome.
    b.boxes(frame, [(d0 + .05, .50, .13), (d1 - .15, .50, .13), (d0 + .151, .50, .13), (d0 + .151, .50, top - .72)],
            [(d0 + .15, .55, top - .62), (d1 - .05, .55, top - .62), (d1 - .151, .55, .38), (d1 - .151, .55, top - .62)])
    b.box("car_glass", d0 + .15, d1 - .15, .52, .53, .38, top - .72)
    b.tube("chrome", [(d1 - .19 if door_left else d0 + .19, .45, .85), (d1 - .19 if door_left else d0 + .19, .45, 1.35)], .015, 6)
    if not style.far:
        _goods(b, rng, kind, g0 + .1, g1 - .1, a, e, d, top, detail)
    # Lamps under the ceiling: drawn as bright boxes.
    for i in range(max(1, int(w / 1.6))):
        x = a + (i + .5) * w / max(1, int(w / 1.6))
        b.box("shop_lamp", x - .35, x + .35, .75, .87, top - .09, top - .02)
    # Swan-neck lamps over the fascia.
    if rng.random() < .5:
        for x in (a + w * .2, m, e - w * .2):
            b.tube("iron", [(x, .0, sz1 + .04), (x, -.30, sz1 + .18), (x, -.45, sz1 + .10)], .014, 6)
            b.lathe("iron", [(.0, 0), (.09, 0), (.03, .09), (0, .09)], 10, (x, -.45, sz1 + .0))
    if rng.random() < .62:
        awning(b, rng, a - .1, e + .1, sz0 - .01, detail)
    if rng.random() < .45:
        _blade(b, e + .12 if rng.random() < .5 else a - .12, style.ground_m + .75, "blade%d" % (sign % 8))


def _goods(b, rng, kind, g0, g1, a, e, d, top, detail):
    """Displays in the window and shelves on the back wall."""
    # Back wall shelves with coloured goods.
    rows = 4
    s0, s1 = a + .15, e - .15
    if kind != "cafe":
        b.boxes("shelf", [(s0, d - .36, .35 + .52 * k) for k in range(rows)], [(s1, d - .025, .375 + .52 * k) for k in range(rows)])
        b.boxes("shelf", [(x, d - .37, .131) for x in (s0 - .03, (s0 + s1) / 2 - .015, s1)], [(x + .03, d - .03, 2.35) for x in (s0 - .03, (s0 + s1) / 2 - .015, s1)])
        # Goods stand in groups of one colour and size, as a shopkeeper would set them.
        for k in range(rows):
            x = s0 + .05
            while x < s1 - .35:
                span = min(.45 + .5 * rng.random(), s1 - .05 - x)
                n = max(1, int(span / (.11 + .10 * rng.random())))
                tone, tall, deep = int(rng.random() * 4), .13 + .24 * rng.random(), .06 + .12 * rng.random()
                if rng.random() < .86:
                    q = x + (np.arange(n) + .04) * span / n
                    b.boxes("goods%d" % tone, np.c_[q, np.full(n, d - .34 + deep * .3), np.full(n, .376 + .52 * k)],
                            np.c_[q + span / n * .84, np.full(n, d - .10), .376 + .52 * k + tall * (1 - .12 * uniform_array(rng, n))])
                x += span + .05
    w = g1 - g0
    if kind == "clothes":
        n = max(1, int(w / .95))
        for k in range(n):
            mannequin(b, g0 + (k + .5) * w / n, .62, .55, rng)
        b.box("shelf", g0, g1, .20, 1.0, .131, .52)
    elif kind in ("grocery", "flowers", "bakery"):
        b.extrude("shelf", [(.18, .131), (1.05, .131), (1.05, .95), (.98, .95), (.18, .58)], g0, g1)
        n, m = max(2, int(w / .32)), 4
        i, j = np.meshgrid(np.arange(n), np.arange(m), indexing="ij")
        i, j = i.ravel(), j.ravel()
        r = uniform_array(rng, len(i) * 2).reshape(2, -1)
        x = g0 + (i + .5) * w / n
        y = .26 + .20 * j
        z = .59 + (y - .18) * .4625
        ball = Builder()
        ball.lathe("x", [(0, -.06), (.075, -.02), (.075, .04), (0, .085)], 7)
        v, f, _ = ball.chunks[("x", True)][0]
        for c in range(4):
            sel = ((i // 2 + j * 3) % 4) == c
            o = np.c_[x[sel] + .04 * r[0][sel], y[sel] + .03 * r[1][sel], z[sel] + .05]
            mat = "goods%d" % c if kind != "bakery" else "bread"
            bb = Builder()
            bb.add(mat, v * (1.25 if kind == "flowers" else 1.0), f, smooth=True)
            b.merge_at(bb, o)
    elif kind == "cafe":
        n = max(1, int(w / 1.3))
        for k in range(n):
            x = g0 + (k + .5) * w / n
            b.lathe("shelf", [(.22, .131), (.22, .15), (.03, .17), (.03, .84), (.34, .85), (.34, .88), (0, .88)], 14, (x, .85, 0))
            for s in (-.48, .48):
                b.box("goods2", x + s - .18, x + s + .18, .70, 1.06, .56, .60)
                b.box("goods2", x + s + (.15 if s > 0 else -.18), x + s + (.18 if s > 0 else -.15), .70, 1.06, .601, .98)
                b.rods("iron", [(x + s + p, .74 + q, .131) for p in (-.14, .14) for q in (0, .28)], [(x + s + p, .74 + q, .561) for p in (-.14, .14) for q in (0, .28)], .012)
        b.box("shelf", a + .2, e - .2, d - .55, d - .03, .131, 1.1)
        b.box("trim", a + .15, e - .15, d - .60, d - .03, 1.101, 1.14)
        for x in np.arange(a + .5, e - .3, .75):
            b.lathe("shop_lamp", [(0, 0), (.11, .02), (.06, .16), (0, .17)], 10, (x, d - .5, top - .85))
            b.rods("iron", [(x, d - .5, top - .70)], [(x, d - .5, top - .01)], .006)
    else:
        b.box("shelf", g0, g1, .25, .75, .131, .70)
        n = int(w / .22)
        r = uniform_array(rng, n * 2).reshape(2, -1)
        x = g0 + (np.arange(n) + .3) * w / n
        for c in range(4):
            sel = (r[1] * 4).astype(int) == c
            if sel.any():
                q = x[sel]
                b.boxes("goods%d" % c, np.c_[q, np.full(len(q), .35) + .2 * r[0][sel], np.full(len(q), .701)], np.c_[q + .15, np.full(len(q), .39) + .2 * r[0][sel], .90 + .14 * r[0][sel]])
    # Posters on the back or side.
    for k in range(2 if kind == "cafe" else 1):
        (u0, v0), (u1, v1) = uv_rect("poster%d" % int(rng.random() * 8))
        x = g0 + (k + .25 + .4 * rng.random()) * w / 2
        z = 1.15 if kind == "cafe" else top - 1.42
        y = d - .03 if kind == "cafe" else .20
        z = z + .1
        b.box("sign_edge", x - .02, x + .50, y - .012, y, z - .02, z + .70)
        b.quads("sign_atlas", [[(x, y - .0125, z), (x + .48, y - .0125, z), (x + .48, y - .0125, z + .68), (x, y - .0125, z + .68)]], [[(u0, v0), (u1, v0), (u1, v1), (u0, v1)]])


def mannequin(b, x, y, z, rng):
    """A dressed dummy, 1.55 m, standing at (x, y, z)."""
    c = circle(10)
    def ring(h, rx, ry, dx=0.0):
        return np.c_[c[:, 0] * rx + x + dx, c[:, 1] * ry + y, np.full(10, z + h)]
    m = "goods%d" % int(rng.random() * 4)
    b.loft(m, np.stack([ring(.50, .20, .15), ring(.80, .16, .11), ring(.98, .13, .09), ring(1.15, .17, .11), ring(1.28, .18, .10), ring(1.33, .08, .06)]))
    b.ellipsoid("mannequin", (x, y, z + 1.47), (.075, .09, .12), 10, 8)
    b.tube("mannequin", [(x, y, z + 1.30), (x, y, z + 1.40)], .045, 8)
    n = "goods%d" % int(rng.random() * 4)
    for s in (-1, 1):
        b.tube("mannequin", [(x + s * .18, y, z + 1.25), (x + s * .23, y + .02, z + 1.0), (x + s * .21, y - .06, z + .75)], [.045, .036, .03], 7)
        b.tube(n, [(x + s * .08, y, z + .55), (x + s * .08, y, z + .02)], [.085, .055], 8)


def awning(b, rng, a, e, z, detail):
    """A striped sloping cloth with a scalloped front edge and two arms."""
    out, drop, t = 1.15 + .3 * rng.random(), .50, .012
    z0, z1 = z - .06, z - .06 - drop
    n = max(4, int((e - a) / .22))
    x = a + np.arange(n + 1) * (e - a) / n
    stripes = "awning%d" % int(rng.random() * 4)
    sag = 0.06
    s = np.array([0, .25, .5, .75, 1.0])
    yz = np.c_[-.12 - (out - .12) * s, z0 + (z1 - z0) * s - sag * 4 * s * (1 - s) * .5]
    top = np.stack([np.c_[x, np.full(n + 1, y), np.full(n + 1, q)] for y, q in yz])
    low = top - np.array([0, 0, t])
    k = np.arange(n + 1)
    uv = np.stack([np.c_[k, np.full(n + 1, q)] for q in s]).reshape(-1, 2)
    b.add(stripes, top.reshape(-1, 3), grid_faces(5, n + 1, flip=True), uv)
    b.add(stripes, low.reshape(-1, 3), grid_faces(5, n + 1), uv)
    # Scallops: each stripe's lower edge is a shallow arc of five points.
    m = 4
    xx = a + np.arange(n * m + 1) * (e - a) / (n * m)
    ph = (np.arange(n * m + 1) % m) / m
    dz = .15 + .07 * 4 * ph * (1 - ph)
    f_top = np.c_[xx, np.full(len(xx), -out - .002), np.full(len(xx), z1)]
    f_bot = np.c_[xx, np.full(len(xx), -out - .002), z1 - dz]
    v = np.concatenate([f_bot, f_top, f_bot + [0, .010, 0], f_top + [0, .010, 0]])
    q = len(xx)
    g = grid_faces(2, q)
    uvv = np.tile(np.c_[np.arange(q) / m, np.zeros(q)], (4, 1))
    b.add(stripes, v, np.concatenate([g, g[:, ::-1] + 2 * q]), uvv)
    for xe in (a + .05, e - .05):
        b.rods("iron", [(xe, .0, z - .75)], [(xe, -out + .03, z1 - .02)], .014, 6)
    b.rods("iron", [(a, -out + .012, z1 - .016)], [(e, -out + .012, z1 - .016)], .016, 6)


def _blade(b, x, z, name):
    """A hanging sign on a bracket, readable from both sides."""
    b.rods("iron", [(x, .02, z + .34)], [(x, -.92, z + .34)], .016, 6)
    b.rods("iron", [(x, -.25, z + .33), (x, -.75, z + .33)], [(x, -.25, z + .28), (x, -.75, z + .28)], .008, 4)
    b.box("sign_edge", x - .03, x + .03, -.81, -.19, z - .31, z + .31)
    (u0, v0), (u1, v1) = uv_rect(name)
    for s in (-1, 1):
        xo = x + s * .0305
        y0, y1 = (-.20, -.80) if s < 0 else (-.80, -.20)
        b.quads("sign_atlas", [[(xo, y0, z - .30), (xo, y1, z - .30), (xo, y1, z + .30), (xo, y0, z + .30)]], [[(u0, v0), (u1, v0), (u1, v1), (u0, v1)]])
