# SPDX-License-Identifier: CC0-1.0
"""House fronts with real depth: recessed windows, sills, cornices, balconies, shops.

Local frame of a building: the facade lies in the plane y = 0 and looks to -y,
x from 0 to width, z up from the pavement's level 0. The wall is one surface of
rectangles around openings; each opening has reveals and a back, so nothing
behind the facade shows.
"""
import math
from dataclasses import dataclass

import numpy as np

from .mesh import Builder, grid_faces, rotation_z, translation
from .rng import pick, stream
from .shops import shop_front

STYLES = ("plaster", "brick", "stone", "render")
WALL_COLOURS = {
    "plaster": [(0.58, 0.52, 0.40), (0.60, 0.56, 0.49), (0.62, 0.50, 0.36), (0.55, 0.56, 0.55), (0.58, 0.46, 0.35), (0.55, 0.36, 0.27),
                (0.50, 0.55, 0.58), (0.60, 0.55, 0.40), (0.58, 0.60, 0.50)],
    "brick": [(0.36, 0.15, 0.10), (0.42, 0.22, 0.14), (0.30, 0.13, 0.10), (0.46, 0.30, 0.20), (0.40, 0.17, 0.13)],
    "stone": [(0.56, 0.52, 0.45), (0.50, 0.48, 0.44), (0.54, 0.48, 0.39)],
    "render": [(0.60, 0.60, 0.59), (0.62, 0.63, 0.64), (0.66, 0.62, 0.56), (0.48, 0.50, 0.52)],
}


@dataclass
class Style:
    """One building's taste; lengths in metres."""
    wall: str
    colour: tuple
    floors: int
    ground_m: float
    floor_m: float
    bay_m: float
    window_w: float
    window_h: float
    sill_m: float
    recess_m: float
    surround: bool
    quoins: bool
    balcony: int          # 0 none, 1 single, 2 every second bay, 3 long ones
    shutters: bool
    roof: str             # "flat", "mansard", "gable"
    cornice_m: float
    shop: bool
    far: bool = False     # closes a view far off: shops without goods

    def height(self):
        return self.ground_m + self.floors * self.floor_m


def style_of(rng, shop=True):
    wall = pick(rng, ("plaster", "plaster", "brick", "stone", "render", "plaster", "brick"))
    modern = wall == "render"
    return Style(
        wall=wall, colour=pick(rng, WALL_COLOURS[wall]), floors=3 + int(rng.random() * 3.4),
        ground_m=3.9 + 0.5 * rng.random(), floor_m=(2.95 if modern else 3.15) + 0.35 * rng.random(),
        bay_m=(3.3 if modern else 2.55) + 0.7 * rng.random(),
        window_w=(1.9 if modern else 1.02) + 0.25 * rng.random(), window_h=(1.45 if modern else 1.68) + 0.3 * rng.random(),
        sill_m=0.86 if modern else 0.72 + 0.15 * rng.random(), recess_m=0.16 + 0.12 * rng.random(),
        surround=(not modern) and rng.random() < 0.75, quoins=wall in ("brick", "plaster") and rng.random() < 0.45,
        balcony=int(rng.random() * 4), shutters=wall == "plaster" and rng.random() < 0.4,
        roof=pick(rng, ("flat", "mansard", "gable", "flat")) if not modern else "flat",
        cornice_m=0.30 + 0.35 * rng.random() if not modern else 0.12, shop=shop)


class Wall:
    """Collects the rectangles of one facade, then adds them in one go."""

    def __init__(self):
        self.front, self.reveal, self.pane = [], [], []

    def band(self, u0, u1, z0, z1, openings):
        """A strip of wall; openings (ua, ub, za, zb, depth, pane id or None), sorted by ua."""
        u = u0
        for ua, ub, za, zb, d, pane in openings:
            if ua > u:
                self.rect(u, ua, z0, z1)
            if za > z0:
                self.rect(ua, ub, z0, za)
            if zb < z1:
                self.rect(ua, ub, zb, z1)
            self.reveal += [[(ua, 0, za), (ua, 0, zb), (ua, d, zb), (ua, d, za)][::-1], [(ub, 0, za), (ub, d, za), (ub, d, zb), (ub, 0, zb)][::-1],
                            [(ua, 0, zb), (ub, 0, zb), (ub, d, zb), (ua, d, zb)][::-1], [(ua, 0, za), (ua, d, za), (ub, d, za), (ub, 0, za)][::-1]]
            if pane is not None:
                self.pane.append((ua, ub, za, zb, d, pane))
            u = ub
        if u1 > u:
            self.rect(u, u1, z0, z1)

    def rect(self, ua, ub, za, zb):
        self.front.append([(ua, 0, za), (ub, 0, za), (ub, 0, zb), (ua, 0, zb)])

    def into(self, b, wall, reveal):
        if self.front:
            b.quads(wall, self.front)
        if self.reveal:
            b.quads(reveal, self.reveal)
        if self.pane:
            c, uv = [], []
            for ua, ub, za, zb, d, k in self.pane:
                c.append([(ua, d, za), (ub, d, za), (ub, d, zb), (ua, d, zb)])
                uv.append([(k, 0), (k + .999, 0), (k + .999, 1), (k, 1)])
            b.quads("window", c, uv)


def window_frame(w, h, detail, modern):
    """Frame of a window w x h; origin at the opening's lower left corner, pane at y = 0, outside to -y."""
    b = Builder()
    t, d = 0.06, 0.055
    # The outer frame as one ring of four sides: front, inner and outer faces (its back is in the wall).
    o = np.array([(0, 0), (w, 0), (w, h), (0, h)], float)
    i = np.array([(t, t), (w - t, t), (w - t, h - t), (t, h - t)], float)
    ring = np.stack([np.c_[p[:, 0], np.full(4, y), p[:, 1]] for p, y in ((o, .02), (o, -d), (i, -d), (i, .02))])
    b.add("frame", ring.reshape(-1, 3), np.concatenate([grid_faces(4, 4, wrap=True), [[12, 13, 1, 0], [13, 14, 2, 1], [14, 15, 3, 2], [15, 12, 0, 3]]]))
    rows = []
    if not modern or w > 1.4:
        rows.append((w / 2 - .035, w / 2 + .035, t, h - t))
    if not modern:
        z = h * 0.70
        rows += [(t, w / 2 - .035, z, z + .05), (w / 2 + .035, w - t, z, z + .05)]
        if detail >= 3:
            rows += [(t, w / 2 - .035, h * .36, h * .36 + .03), (w / 2 + .035, w - t, h * .36, h * .36 + .03)]
    if rows:
        b.boxes("frame", [(a, -d + .006, c) for a, _, c, _ in rows], [(e, 0.02, g) for _, e, _, g in rows])
    return b


def railing(width, height, detail, material="iron", depth=0.0):
    """A railing along x from 0 to width at y = 0: rails and bars, closed solids; `depth` adds returns to +y."""
    b = Builder()
    def run(n, place, length):
        k = max(2, int(length / (0.11 if detail >= 3 else 0.18)))
        u = (np.arange(k) + 0.5) / k * length
        lo, hi = place(u)
        b.rods(material, lo, hi, 0.009, 3 if detail < 3 else 6)
    zt = height
    b.box(material, -.02, width + .02, -.022, .022, zt - .035, zt)
    b.box(material, -.02, width + .02, -.015, .015, .07, .10)
    run(0, lambda u: (np.c_[u, 0 * u, 0 * u + .09], np.c_[u, 0 * u, 0 * u + zt - .02]), width)
    if depth > 0:
        for x in (0.0, width):
            b.box(material, x - .02, x + .02, .0225, depth, zt - .034, zt - .001)
            b.box(material, x - .014, x + .014, .0155, depth, .071, .099)
            run(0, lambda u: (np.c_[0 * u + x, u + .03, 0 * u + .09], np.c_[0 * u + x, u + .03, 0 * u + zt - .02]), depth - .05)
    return b


def balcony(width, detail):
    """A balcony slab with brackets and railing; origin at the left end on the wall, slab top at z = 0."""
    b = Builder()
    d = 0.95
    b.box("trim", 0, width, -d, 0.05, -0.16, 0.0)
    b.box("trim", .04, width - .04, -d + .05, 0.05, -0.22, -0.161)
    if detail >= 2:
        for x in (0.18, width - 0.30):
            b.extrude("trim", [(0.04, -.221), (-.62, -.221), (-.50, -.30), (0.04, -.62)], x, x + .12)
        r = railing(width - .08, 1.0, detail, depth=d - .07)
        b.merge(r, [translation(.04, -d + .05, 0)])
    else:
        b.box("iron", 0.02, width - .02, -d + .02, -d + .05, 0.05, 1.0)
    return b


def ac_unit():
    """An air-conditioning box on the wall with its fan ring and brackets; origin at its middle on the wall."""
    b = Builder()
    b.box("appliance", -.40, .40, -.36, -.06, -.28, .28)
    b.lathe("appliance_dark", [(.10, 0), (.22, 0), (.22, 0), (.22, .015), (.22, .015), (.20, .022), (.0, .024)], 16)
    chunks = b.chunks.pop(("appliance_dark", True))
    for v, f, _ in chunks:
        b.add("appliance_dark", np.stack([v[:, 0] - .1, -.352 - v[:, 2], v[:, 1]], 1), f, smooth=True)
    b.boxes("iron", [(-.34, -.36, -.33), (.30, -.36, -.33)], [(-.30, .02, -.281), (.34, .02, -.281)])
    return b


def facade(b, style, rng, width, detail, shops=True, margin0=0.0, margin1=0.0, shop_seed=0, sign0=0):
    """One front of `width` with openings; margins keep the shops' rooms off the corners."""
    h = style.height()
    n = max(1, int(width / style.bay_m))
    pitch = width / n
    w = min(style.window_w, pitch - 0.7)
    modern = style.wall == "render"
    wall = "wall_" + style.wall
    build = Wall()
    french = [style.balcony and rng.random() < (0.6 if style.balcony == 2 else 0.35) for _ in range(n)]
    if style.balcony == 2:
        french = [k % 2 == 1 for k in range(n)]
    frames, french_frames, pane_id = [], [], int(rng.random() * 40) * 50
    blinds, sills, heads, balconies = [], [], [], []
    for floor in range(style.floors):
        z0 = style.ground_m + floor * style.floor_m
        row = []
        for k in range(n):
            u = (k + 0.5) * pitch
            tall = french[k] and floor < style.floors
            za = z0 + (0.12 if tall else style.sill_m)
            zb = z0 + style.sill_m + style.window_h
            zb = min(zb, z0 + style.floor_m - 0.35)
            row.append((u - w / 2, u + w / 2, za, zb, style.recess_m, pane_id))
            pane_id += 1
            (french_frames if tall else frames).append((u - w / 2, style.recess_m, za))
            drop = rng.random()
            if drop < 0.22:
                blinds.append((u, zb, (0.15 + 0.75 * rng.random()) * (zb - za)))
            if tall:
                balconies.append((u, z0 + 0.10))
            else:
                sills.append((u, za))
            heads.append((u, za, zb, tall))
        build.band(0, width, z0, z0 + style.floor_m, row)
    # Ground floor: shops or doors and windows.
    if style.shop and shops and detail >= 1:
        shop_front(b, build, style, stream(shop_seed, "shop"), width, detail, margin0, margin1, wall, sign0)
    else:
        row = []
        door = n // 2
        for k in range(n):
            u = (k + 0.5) * pitch
            if k == door and shops:
                row.append((u - .75, u + .75, 0.0, 2.75, 0.35, None))
                b.box("door", u - .75, u + .75, .30, .40, -.1, 2.40) if detail >= 1 else None
                b.box("window", u - .75, u + .75, .33, .40, 2.401, 2.75) if detail >= 1 else None
                if detail >= 2:
                    b.boxes("door_panel", [(u - .62, .27, .25), (u + .07, .27, .25), (u - .62, .27, 1.15), (u + .07, .27, 1.15)],
                            [(u - .07, .305, 1.0), (u + .62, .305, 1.0), (u - .07, .305, 2.25), (u + .62, .305, 2.25)])
                    b.box("trim", u - 1.0, u + 1.0, -.55, .0, -.13, .05)
                    b.box("trim", u - .98, u + .98, -.16, .02, 2.80, 3.0)
            else:
                row.append((u - w / 2, u + w / 2, 1.0, 1.0 + style.window_h, style.recess_m, pane_id))
                pane_id += 1
                frames.append((u - w / 2, style.recess_m, 1.0))
                heads.append((u, 1.0, 1.0 + style.window_h, False))
                sills.append((u, 1.0))
        build.band(0, width, -0.3, style.ground_m, row)
    build.into(b, wall, wall if not style.surround else "wall_reveal")
    if detail < 1:
        return
    # Horizontal profiles: string course above the ground floor, cornice below the roof.
    e = 0.0
    c = style.cornice_m
    b.extrude("trim", [(0.03, h - .52 * c - .25), (-.06, h - .52 * c - .22), (-.08, h - .30 * c), (-.55 * c, h - .12 * c), (-.62 * c - .05, h + .02), (0.03, h + .02)][::-1], 0.0 - e, width + e)
    b.extrude("trim", [(0.03, style.ground_m - .12), (-.07, style.ground_m - .10), (-.10, style.ground_m + .08), (0.03, style.ground_m + .14)][::-1], 0.0, width)
    if detail < 2:
        for u, z in balconies:
            b.merge(balcony(min(pitch - .3, w + .8), detail), [translation(u - min(pitch - .3, w + .8) / 2, 0, z)])
        return
    _dress(b, style, rng, width, detail, pitch, w, modern, frames, french_frames, blinds, sills, heads, balconies, n, h)


def _dress(b, style, rng, width, detail, pitch, w, modern, frames, french_frames, blinds, sills, heads, balconies, n, h):
    """Frames, sills, surrounds, balconies, pipes and boxes of one front."""
    hw = min(style.window_h, style.floor_m - .35 - style.sill_m)
    plain = modern or style.far
    b.merge_at(window_frame(w, hw, detail, plain), frames)
    b.merge_at(window_frame(w, hw + style.sill_m - .12, detail, plain), french_frames)
    if sills:
        s = np.array(sills)
        b.boxes("trim", np.c_[s[:, 0] - w / 2 - .08, 0 * s[:, 0] - .10, s[:, 1] - .09], np.c_[s[:, 0] + w / 2 + .08, 0 * s[:, 0] + style.recess_m - .06, s[:, 1] + .012])
    if style.surround:
        a = np.array([(u, za, zb) for u, za, zb, tall in heads])
        o = np.zeros(len(a))
        t = 0.13
        for x0, x1 in ((-w / 2 - t, -w / 2 + .004), (w / 2 - .004, w / 2 + t)):
            b.boxes("trim", np.c_[a[:, 0] + x0, o - .045, a[:, 1] + .013], np.c_[a[:, 0] + x1, o + .05, a[:, 2] + .003])
        b.boxes("trim", np.c_[a[:, 0] - w / 2 - t - .04, o - .07, a[:, 2] + .0035], np.c_[a[:, 0] + w / 2 + t + .04, o + .05, a[:, 2] + .17])
        if style.wall != "brick":
            b.boxes("trim", np.c_[a[:, 0] - w / 2 - t - .09, o - .13, a[:, 2] + .1705], np.c_[a[:, 0] + w / 2 + t + .09, o + .02, a[:, 2] + .24])
    else:
        a = np.array([(u, za, zb) for u, za, zb, tall in heads])
        o = np.zeros(len(a))
        if style.wall == "brick":
            b.boxes("trim", np.c_[a[:, 0] - w / 2 - .10, o - .02, a[:, 2] + .002], np.c_[a[:, 0] + w / 2 + .10, o + .05, a[:, 2] + .22])
    if blinds:
        s = np.array(blinds)
        y = style.recess_m
        b.boxes("blind", np.c_[s[:, 0] - w / 2 + .062, 0 * s[:, 0] + y - .05, s[:, 1] - .055 - s[:, 2]], np.c_[s[:, 0] + w / 2 - .062, 0 * s[:, 0] + y - .02, s[:, 1] - .061])
    if style.shutters:
        a = np.array([(u, za, zb) for u, za, zb, tall in heads if not tall]).reshape(-1, 3)
        for side in (-1, 1) if len(a) else ():
            x0 = a[:, 0] + side * (w / 2 + .28)
            o = np.zeros(len(a))
            b.boxes("shutter", np.c_[x0 - .23, o - .075, a[:, 1]], np.c_[x0 + .23, o - .046, a[:, 2]])
            if detail >= 2:
                for k in range(7):
                    z = a[:, 1] + (a[:, 2] - a[:, 1]) * (k + .8) / 7.6
                    b.boxes("shutter", np.c_[x0 - .19, o - .092, z - .05], np.c_[x0 + .19, o - .0745, z + .015])
    bw = min(pitch - .3, w + .8)
    if balconies:
        b.merge_at(balcony(bw, 1 if style.far else detail), [(u - bw / 2, 0, z) for u, z in balconies])
        for u, z in balconies:
            if rng.random() < .35 and not style.far:      # flower boxes on the rail
                b.box("planter_box", u - .45, u + .45, -1.02, -.87, z + .72, z + .90)
                k = 9
                uu = (np.arange(k) + .5) / k * .9 - .45 + u
                zz = z + .90 + np.array([rng.random() * .16 for _ in range(k)])
                b.boxes("flowers", np.c_[uu - .06, np.full(k, -1.03), np.full(k, z + .86)], np.c_[uu + .06, np.full(k, -.86), zz])
    # Quoins.
    if style.quoins:
        k = int((h - style.ground_m - .8) / .5)
        z = style.ground_m + .3 + np.arange(k) * .5
        d = np.where(np.arange(k) % 2 == 0, .48, .32)
        b.boxes("trim", np.c_[np.full(k, .02), np.full(k, -.035), z], np.c_[d, np.full(k, .05), z + .47])
        b.boxes("trim", np.c_[width - d, np.full(k, -.035), z], np.c_[np.full(k, width - .02), np.full(k, .05), z + .47])
    # Floor bands.
    if not modern and rng.random() < .5:
        for floor in range(1, style.floors):
            z = style.ground_m + floor * style.floor_m
            if not balconies:
                b.box("trim", .03, width - .03, -.05, .03, z - .06, z + .10)
    # Downpipes with brackets and a hopper.
    for u in ([.28] if width < 13 else [.28, width - .28]):
        b.tube("pipe", [(u, -.19, h - .55), (u, -.13, h - .85), (u, -.13, .35), (u, -.22, .16)], .05, 8)
        k = max(2, int(h / 2.2))
        z = 1.0 + np.arange(k) * (h - 2.2) / k
        b.boxes("pipe", np.c_[np.full(k, u - .075), np.full(k, -.195), z], np.c_[np.full(k, u + .075), np.full(k, .02), z + .05])
        b.box("pipe", u - .12, u + .12, -.30, -.02, h - .62, h - .34)
    # Air conditioners beside or below windows.
    spots = []
    for _ in range(int(rng.random() * 5) + (2 if modern else 0)):
        k, f = int(rng.random() * n), 1 + int(rng.random() * (style.floors - 1))
        u, z = (k + .5) * pitch, style.ground_m + f * style.floor_m + .34
        if not any(abs(u - p) < .9 and abs(z - q) < .9 for p, _, q in spots) and not any(abs(u - p) < bw and -.6 < z - q < 1.6 for p, q in balconies):
            spots.append((u, 0, z))
    b.merge_at(ac_unit(), spots)
    # Satellite dishes, wall lamps and cables.
    for _ in range(int(rng.random() * 3)):
        k, f = int(rng.random() * n), 1 + int(rng.random() * style.floors)
        u, z = k * pitch + .12, style.ground_m + (f - .4) * style.floor_m
        if k == 0:
            continue
        dish = Builder()
        dish.lathe("appliance", [(0, 0), (.15, .02), (.27, .075), (.30, .10), (.28, .085), (.14, .03), (0, .012)], 16)
        m = np.eye(4)
        m[:3, :3] = np.array([[1, 0, 0], [0, .5, -.866], [0, .866, .5]])
        m[:3, 3] = (u, -.38, z)
        b.merge(dish, [m])
        b.tube("iron", [(u, .02, z - .2), (u, -.30, z - .2), (u, -.36, z)], .018, 6)


def roof(b, style, rng, width, depth, detail):
    """Roof, parapet, chimneys, dormers; sits on the block of `depth`."""
    h = style.height()
    if style.roof == "flat":
        b.boxes("trim", [(0, -.02, h + .0205), (0, depth - .25, h - .3), (0, .3, h - .3), (width - .28, .3, h - .3)],
                [(width, .28, h + .62), (width, depth, h + .60), (.28, depth - .251, h + .605), (width, depth - .251, h + .605)])
        if detail >= 2:
            b.box("metal_sheet", -.04, width + .04, -.10, .34, h + .6205, h + .66)
            b.box("roof_dark", width * .3, width * .3 + 3.2, depth * .35, depth * .35 + 3, h - .3, h + 2.3)
            x = width * (.55 + .25 * rng.random())
            b.tube("iron", [(x, depth * .4, h - .3), (x, depth * .4, h + 2.6)], .025, 6)
            for k in range(4):
                b.rods("iron", [(x - .45 + .08 * k, depth * .4, h + 1.6 + .25 * k)], [(x + .45 - .08 * k, depth * .4, h + 1.6 + .25 * k)], .01)
            if rng.random() < .5:
                b.boxes("appliance", [(width * .7, depth * .3, h - .3), (width * .7 + 1.3, depth * .3, h - .3)], [(width * .7 + 1, depth * .3 + 1, h + 1.0), (width * .7 + 2.2, depth * .3 + .9, h + .9)])
        return
    rise, back = (2.6, 1.1) if style.roof == "mansard" else (min(3.4, depth * .26), depth / 2)
    y0 = -.15
    if style.roof == "mansard":
        b.extrude("roof_tile", [(depth + .05, h + .025), (depth - back, h + rise), (back, h + rise), (y0, h + .025)][::1], 0, width)
    else:
        b.extrude("roof_tile", [(depth + .3, h + .025), (depth / 2, h + rise), (-.3, h + .025)], 0, width)
    if detail < 2:
        return
    # Gutter along the eaves.
    ye = -.62 * style.cornice_m - .12
    b.tube("pipe", [(0.02, min(ye, -.3), h + .05), (width - .02, min(ye, -.3), h + .05)], .07, 8)
    k = max(1, int(width / 4.2))
    for i in range(k):
        u = (i + .5) * width / k
        if style.roof == "mansard":
            b.box("trim", u - .62, u + .62, .12, 1.2, h + .35, h + 1.95)
            b.extrude("roof_tile", [(.0, h + 1.951), (1.3, h + 1.951), (1.3, h + 2.2), (.0, h + 2.05)], u - .74, u + .74)
            b.quads("window", [[(u - .44, .112, h + .62), (u + .44, .112, h + .62), (u + .44, .112, h + 1.75), (u - .44, .112, h + 1.75)]],
                    [[(i + 900, 0), (i + 900.999, 0), (i + 900.999, 1), (i + 900, 1)]])
            b.boxes("frame", [(u - .5, .06, h + .55), (u - .5, .06, h + 1.75), (u - .5, .06, h + .621), (u + .44, .06, h + .621), (u - .03, .06, h + .621)],
                    [(u + .5, .13, h + .62), (u + .5, .13, h + 1.82), (u - .44, .13, h + 1.749), (u + .5, .13, h + 1.749), (u + .03, .13, h + 1.749)])
    for i in range(1 + int(rng.random() * 2)):
        u = width * (.15 + .6 * rng.random())
        y, z = depth * (.36 if style.roof == "gable" else .4), h + rise
        b.box("chimney", u, u + 1.3, y, y + .55, h, z + 1.2)
        b.box("trim", u - .06, u + 1.36, y - .06, y + .61, z + 1.201, z + 1.32)
        for q in range(3):
            b.lathe("roof_tile", [(.13, 0), (.15, .0), (.12, .45), (.0, .45)], 10, (u + .25 + .4 * q, y + .27, z + 1.3))


def build_building(seed, key, width, depth, detail, left_open=False, right_open=False, shop=True, far=False):
    """(Builder, Style, height): a terrace house; open sides (corner houses) get a facade too."""
    rng = stream(seed, "building", key, "style")
    style = style_of(rng, shop)
    style.far = far
    b = Builder()
    h = style.height()
    if detail == 0:
        b.box("wall_" + style.wall, 0, width, 0, depth, -.3, h)
        return b, style, h
    wall = "wall_" + style.wall
    room = 2.4
    sign0 = int(stream(seed, "building", key, "signs").random() * 24)
    facade(b, style, stream(seed, "building", key, "front"), width, detail, True, room if left_open else .35, room if right_open else .35,
           str(seed) + "/" + str(key), sign0)
    quads = []
    for side_open, x, turn in ((left_open, 0.0, -math.pi / 2), (right_open, width, math.pi / 2)):
        if side_open:
            s = Builder()
            facade(s, style, stream(seed, "building", key, "side", x > 0), depth, detail, True, room, .35, str(seed) + "/" + str(key) + "/side" + str(int(x > 0)), sign0 + 7)
            # Local x of the side runs along the side wall, outside to -y.
            b.merge(s, [translation(x, 0 if x > 0 else depth, 0) @ rotation_z(turn)])
        elif x == 0.0:
            quads.append([(0, 0, -.3), (0, 0, h), (0, depth, h), (0, depth, -.3)])
        else:
            quads.append([(x, 0, -.3), (x, depth, -.3), (x, depth, h), (x, 0, h)])
    quads.append([(0, depth, -.3), (0, depth, h), (width, depth, h), (width, depth, -.3)])
    b.quads(wall, quads)
    b.quads("roof_dark", [[(0, 0, h), (width, 0, h), (width, depth, h), (0, depth, h)]])
    roof(b, style, stream(seed, "building", key, "roof"), width, depth, detail)
    return b, style, h
