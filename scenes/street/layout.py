# SPDX-License-Identifier: CC0-1.0
"""Where everything stands: the street's plan and `generate`.

Placement draws only from streams named after what is placed, never from the
level of detail, so that every level shows the same street.
"""
import math
from dataclasses import dataclass

import numpy as np

from . import cars, furniture, people, road, trees
from .buildings import build_building
from .mesh import Builder, pose, rotation_x, scaling, translation
from .rng import pick, stream
from .scene import EGO_LANE_Y_M, Mover, Street, box_gap, ego_gap

WALK = road.WALK_Z_M


@dataclass(frozen=True)
class Plan:
    """The street's fixed lines, metres in the world frame."""
    x_min: float
    x_max: float
    kerb_right: float = -7.8
    kerb_left: float = 9.2
    walk: float = 4.2
    cross_x: float = 47.0
    cross_half: float = 5.5
    cross_walk: float = 3.0
    end_road: float = 13.0
    end_walk: float = 3.0
    depth: float = 11.0            # of the houses
    cross_end_y: float = 74.0
    far_y: float = 110.0
    zebra_x: float = 104.0

    @property
    def front_right(self):
        return self.kerb_right - self.walk

    @property
    def front_left(self):
        return self.kerb_left + self.walk

    def blocks(self):
        """x ranges of the kerbed islands before and behind the crossing."""
        return [(self.x_min, self.cross_x - self.cross_half), (self.cross_x + self.cross_half, self.x_max)]

    def rows(self):
        """x ranges of the house rows."""
        (a, b), (c, d) = self.blocks()
        return [(a + self.end_walk, b - self.cross_walk), (c + self.cross_walk, d - self.end_walk)]

    def stop_lines(self):
        """x of the stop lines for traffic along +x and along -x."""
        return self.cross_x - self.cross_half - 5.2, self.cross_x + self.cross_half + 5.2


def generate(seed=1, detail=2, length_m=240.0, traffic=1.0):
    """The street of `seed`. detail 0..3 (DETAIL_LEVELS), length 140..600 m, traffic 0..2 scales moving things."""
    if detail not in (0, 1, 2, 3):
        raise ValueError("detail: got %r, expected 0, 1, 2 or 3" % (detail,))
    if not 140.0 <= length_m <= 600.0:
        raise ValueError("length_m: got %r, expected 140 to 600" % (length_m,))
    if not 0.0 <= traffic <= 2.0:
        raise ValueError("traffic: got %r, expected 0 to 2" % (traffic,))
    s = Street(int(seed), detail, float(length_m), float(traffic))
    s.plan = plan = Plan(x_min=-round(length_m * .25, 3), x_max=round(length_m * .75, 3))
    s.place("ground", s.add_model("ground", road.ground(plan), "road"), np.eye(4), "road")
    s.place("pavement", s.add_model("pavement", road.islands(plan, detail), "pavement"), np.eye(4), "pavement")
    _houses(s, plan)
    _furniture(s, plan)
    _trees(s, plan)
    _wires(s, plan)
    _parked(s, plan)
    _moving(s, plan)
    _people(s, plan)
    return s


# ------------------------------------------------------------------ houses
def _widths(rng, length):
    n = max(1, int(round(length / 12.5)))
    w = np.array([.75 + .6 * rng.random() for _ in range(n)])
    return w / w.sum() * length


def _row(s, key, start, end, place, first_open, last_open, shop=True, far=False):
    """Terrace houses from start to end; `place(a, b)` gives (matrix, reversed)."""
    w = _widths(stream(s.seed, "row", key), end - start)
    a = start
    for k, width in enumerate(w):
        b = a + float(width)
        r = stream(s.seed, "row", key, "setback", k)
        setback = .05 + (k % 2) * .07 + .04 * r.random()
        over = .05 if k + 1 < len(w) else 0.0       # reach a little into the neighbour: no shared planes
        m, rev = place(a, b + over, setback)
        lo, hi = first_open and k == 0, last_open and k + 1 == len(w)
        name = "house." + key + "." + str(k)
        bld, style, h = build_building(s.seed, name, b + over - a, s.plan.depth - .13 * (k % 2), s.detail, hi if rev else lo, lo if rev else hi, shop,
                                       far or (key[0] == "X" and abs(.5 * (a + b)) > 42.0))
        s.place(name, s.add_model(name, bld, "building"), m, "building", colour=style.colour,
                solid=(((b + over - a) / 2, s.plan.depth / 2, h / 2), ((b + over - a) / 2, s.plan.depth / 2, h / 2)))
        a = b


def _houses(s, p):
    for q, (x0, x1) in enumerate(p.rows()):
        _row(s, "L%d" % q, x0, x1, lambda a, b, d: (pose(a, p.front_left + d, WALK), False), True, True)
        _row(s, "R%d" % q, x0, x1, lambda a, b, d: (pose(b, p.front_right - d, WALK, math.pi), True), True, True)
    # Along the cross street.
    xa, xb = p.cross_x - p.cross_half - p.cross_walk, p.cross_x + p.cross_half + p.cross_walk
    for side, y0, y1 in (("L", p.front_left + p.depth + .25, p.cross_end_y + 4), ("R", -(p.cross_end_y + 4), p.front_right - p.depth - .25)):
        _row(s, "XA" + side, y0, y1, lambda a, b, d: (pose(xa - d, a, WALK, math.pi / 2), False), False, False, False)
        _row(s, "XB" + side, y0, y1, lambda a, b, d: (pose(xb + d, b, WALK, -math.pi / 2), True), False, False, False)
    # Rows that close the views: across the ends of the street and of the cross street.
    e = p.end_road + p.end_walk
    _row(s, "E", -46.0, 46.0, lambda a, b, d: (pose(p.x_max + e + d, b, WALK, -math.pi / 2), True), False, False, far=True)
    _row(s, "W", -46.0, 46.0, lambda a, b, d: (pose(p.x_min - e - d, a, WALK, math.pi / 2), False), False, False, far=True)
    y = p.cross_end_y + 2.6
    _row(s, "N", p.cross_x - 8.9, p.cross_x + 8.9, lambda a, b, d: (pose(a, y + d, WALK - .004), False), False, False, far=True)
    _row(s, "S", p.cross_x - 8.9, p.cross_x + 8.9, lambda a, b, d: (pose(b, -y - d, WALK - .004, math.pi), True), False, False, far=True)


# ------------------------------------------------------------------ street furniture
def mirrored_y(b):
    """A copy mirrored in y; lettering is turned back so that it still reads."""
    out = Builder()
    for (material, smooth), chunks in b.chunks.items():
        for v, f, uv in chunks:
            if material == "sign_atlas" and uv is not None and len(uv) % 4 == 0:
                uv = uv.reshape(-1, 4, 2)[:, [1, 0, 3, 2]].reshape(-1, 2)
            c = Builder()
            c.add(material, v, f, uv, smooth)
            out.merge(c, [scaling(1, -1, 1)])
    return out


def _furniture(s, p):
    d, seed = s.detail, s.seed
    models = {}

    def model(name, made, category="furniture"):
        if d == 0 and category in ("furniture", "bicycle", "plant", "fence"):
            b, (c, h) = Builder(), made[1]
            b.boxes(next(iter(made[0].chunks))[0], np.subtract(c, h), np.add(c, h))
            made = (b, made[1])
        models[name] = (s.add_model(name, made[0], category), made[1], category)

    def put(name, tag, m, colour=None):
        parts, solid, category = models[name]
        if category == "plant":
            colour = (.050, .125, .022)
        s.place(name + "." + tag, parts, m, category, colour=colour, solid=solid)

    model("lamp", furniture.lamp_post(d), "pole")
    mast = furniture.mast_arm(d)
    model("mast_r", mast, "signal")
    model("mast_l", (mirrored_y(mast[0]), mast[1]), "signal")
    mast = furniture.mast_arm(d, 3.6, go=False)
    model("mast_red", (mirrored_y(mast[0]), mast[1]), "signal")
    free = []                                   # (side, x) taken near the kerb: see _trees
    yl, yr = p.kerb_left + .75, p.kerb_right - .75
    stop, stop_back = p.stop_lines()
    put("mast_l", "ego", pose(stop + .9, yr, WALK))
    put("mast_l", "ego_back", pose(stop_back - .9, yl, WALK, math.pi))
    put("mast_red", "south", pose(p.cross_x + p.cross_half + .8, p.kerb_right - 5.4, WALK, math.pi / 2))
    put("mast_red", "north", pose(p.cross_x - p.cross_half - .8, p.kerb_left + 5.4, WALK, -math.pi / 2))
    lamps = _lamp_places(s, p)
    for k, (x, left) in enumerate(lamps):
        put("lamp", str(k), pose(x, yl if left else yr, WALK, 0.0 if left else math.pi))
    for k, names in enumerate((("no_parking",), ("limit30",), ("no_entry",), ("priority",), ("crossing",), ("parking",), ("stop",), ("turn_right", "no_parking"))):
        model("sign%d" % k, furniture.sign_post(names, d), "sign")
    spots = [(0, stop - 9.5, 0), (1, -6.0, 0), (4, p.zebra_x - 4.2, 0), (5, 66.0, 0), (7, stop - 2.0, 0), (3, 24.5, 0), (0, 86.0, 0), (1, p.x_max - 30, 0), (5, -30.0, 0),
             (4, p.zebra_x + 4.2, 1), (0, 30.0, 1), (5, 12.0, 1), (1, 78.0, 1), (3, stop_back + 6, 1), (2, p.cross_x + 8.2, 2), (6, p.x_min + 5.0, 1), (6, p.x_max - 5.0, 0)]
    for k, (n, x, side) in enumerate(spots):
        if side == 2:
            put("sign%d" % n, str(k), pose(x - 4.6, p.kerb_left + 6.5, WALK, -math.pi / 2))
        else:
            put("sign%d" % n, str(k), pose(x, (yl - .25) if side else (yr + .25), WALK, math.pi if side else 0.0))
    model("hydrant", furniture.hydrant())
    model("bin", furniture.bin_())
    model("bollard", furniture.bollard())
    model("bench", furniture.bench(d))
    model("railing", furniture.railing_run(6.0, d), "fence")
    model("cabinet", furniture.cabinet())
    model("mailbox", furniture.mailbox())
    model("meter", furniture.meter())
    model("table", furniture.cafe_table())
    model("parasol", furniture.parasol())
    model("shelter", furniture.bus_shelter(d))
    model("bike", furniture.bicycle(d), "bicycle")
    model("stand", furniture.cycle_stand())
    for k in range(3):
        model("board%d" % k, furniture.a_board(k))
        model("planter%d" % k, furniture.planter(stream(seed, "planter", k), d), "plant")
        model("hedge%d" % k, (trees.hedge(stream(seed, "hedge", k), 3.0, d), ((1.5, 0, .48), (1.5, .3, .48))), "plant")
    # Corners: pedestrian railings and bollards.
    (a0, a1), (b0, b1) = p.blocks()
    for tag, x, y in (("a", a1 - 11.6, yr + .30), ("b", a1 - 11.6, yl - .30), ("c", b0 + 5.6, yr + .30), ("d", b0 + 5.6, yl - .30)):
        put("railing", tag, pose(x, y, WALK))
    for tag, x, y, yaw in (("e", a1 - .5, p.kerb_right - 15.0, math.pi / 2), ("f", b0 + .5, p.kerb_right - 15.0, math.pi / 2),
                           ("g", a1 - .5, p.kerb_left + 9.2, math.pi / 2), ("h", b0 + .5, p.kerb_left + 9.2, math.pi / 2)):
        put("railing", tag, pose(x, y, WALK, yaw))
    for q, (xc, s1) in enumerate(((a1, -1), (b0, 1))):
        for r, (yc, s2) in enumerate(((p.kerb_right, -1), (p.kerb_left, 1))):
            for k in range(3):
                t = math.radians(18 + 27 * k)
                put("bollard", "%d%d%d" % (q, r, k), pose(xc + s1 * (4 - 3.4 * math.cos(t)), yc + s2 * (4 - 3.4 * math.sin(t)), WALK))
    # Along the pavements: a seeded sequence of things in the strip by the kerb and the strip by the houses.
    rng = stream(seed, "strip")
    taken = [(x, left) for x, left in lamps] + [(x, bool(sd)) for _, x, sd in spots if sd < 2]
    kinds = ("bin", "bench", "meter", "hydrant", "cabinet", "bike", "mailbox", "planter0", "meter", "bike", "bin", "planter1", "bench", "bike", "meter")
    count = 0
    for left in (False, True):
        for x0, x1 in ((a0 + 6, a1 - 13), (b0 + 13, b1 - 6)):
            x = x0
            while x < x1:
                kind = pick(rng, kinds)
                jitter = rng.random()
                if all(abs(x - tx) > 1.6 or tl != left for tx, tl in taken) and all(abs(x - tx) > 1.7 for tx in _tree_xs(s, p, left)):
                    y = (yl + .15) if left else (yr - .15)
                    yaw = 0.0 if not left else math.pi
                    if kind == "bike":
                        for j in range(1 + int(jitter * 3)):
                            put("stand", "s%d_%d" % (count, j), pose(x + .75 * j, y + (.3 if left else -.3), WALK, math.pi / 2))
                            put("bike", "%d_%d" % (count, j), pose(x + .75 * j + .12, y + (.35 if left else -.35), WALK, math.pi / 2 + .15 * (jitter - .5) + (math.pi if j % 2 else 0)), colour=cars.CAR_COLOURS[5 + (count + j) % 8])
                        x += 1.5
                    elif kind == "bench":
                        put("bench", str(count), pose(x, y, WALK, yaw + math.pi))
                    elif kind == "meter":
                        put("meter", str(count), pose(x, y + (-.3 if left else .3), WALK, yaw + math.pi))
                    else:
                        put(kind, str(count), pose(x, y, WALK, yaw))
                    count += 1
                x += 2.6 + 3.4 * rng.random()
            # House side: café tables, boards, planters, hedges.
            x = x0
            while x < x1:
                kind = pick(rng, ("board0", "table", "planter2", "hedge0", "board1", "table", "bike", "planter1", "hedge1", "none", "board2"))
                y = (p.front_left - .62) if left else (p.front_right + .62)
                yaw = 0.0 if left else math.pi
                if kind == "table":
                    for j in range(2):
                        put("table", "t%d_%d" % (count, j), pose(x + 2.0 * j, y, WALK, yaw))
                    put("parasol", "p%d" % count, pose(x + 1.0, y - (.35 if left else -.35), WALK), colour=pick(rng, people.CLOTH_COLOURS))
                    x += 3.0
                elif kind == "bike":
                    put("bike", "w%d" % count, pose(x, y + (.2 if left else -.2), WALK, yaw), colour=cars.CAR_COLOURS[5 + count % 8])
                elif kind.startswith("hedge"):
                    put(kind, "w%d" % count, pose(x, y, WALK, 0.0))
                    x += 2.0
                elif kind != "none":
                    put(kind, "w%d" % count, pose(x, y, WALK, rng.random() * .6 - .3 if kind.startswith("board") else 0.0))
                count += 1
                x += 4.0 + 6.5 * rng.random()
    if d >= 2:
        r = stream(seed, "litter")
        places = []
        for _ in range(46):
            left, near = r.random() < .5, r.random()
            x = p.x_min + 8 + (p.x_max - p.x_min - 16) * r.random()
            if p.cross_x - 14 < x < p.cross_x + 14:
                continue
            if near < .5:      # in the gutter
                places.append((x, (p.kerb_left - .12 - .2 * r.random()) if left else (p.kerb_right + .12 + .2 * r.random()), 0.0))
            else:
                places.append((x, (p.kerb_left + .4 + 2.5 * r.random()) if left else (p.kerb_right - .4 - 2.5 * r.random()), WALK))
        s.place("litter", s.add_model("litter", furniture.litter(r, places), "litter"), np.eye(4), "litter")
    put("shelter", "bus", pose(82.0, p.kerb_left + 1.35, WALK, 0.0))


def _lamp_places(s, p):
    rng = stream(s.seed, "lamps")
    out = []
    for left in (False, True):
        off = 4 + 6 * rng.random()
        for a, b in p.blocks():
            x = a + 7 + off
            while x < b - 7:
                if abs(x - p.stop_lines()[0]) > 4 and abs(x - p.stop_lines()[1]) > 4 and abs(x - 82) > 3.5:
                    out.append((round(x, 4), left))
                x += 24.0
    return out


def _tree_xs(s, p, left):
    """x of the trees on one side: a rhythm with gaps, off lamps, crossings and signals."""
    rng = stream(s.seed, "trees", int(left))
    lamps = [x for x, l in _lamp_places(s, p) if l == left]
    out = []
    for a, b in p.blocks():
        x = a + 9 + 5 * rng.random()
        while x < b - 9:
            skip = rng.random() < .18
            ok = all(abs(x - q) > 2.6 for q in lamps) and abs(x - p.stop_lines()[0]) > 6.5 and abs(x - p.stop_lines()[1]) > 6.5 \
                and abs(x - p.zebra_x) > 5 and (not left or abs(x - 82) > 5)
            if ok and not skip:
                out.append(round(x, 4))
            x += 7.6 + 1.6 * rng.random()
    return out


def _trees(s, p):
    variants = [trees.build_tree(s.seed, k, s.detail) for k in range(4)]
    names = [s.add_model("tree%d" % k, b, "tree") for k, (b, _) in enumerate(variants)]
    pit = s.add_model("tree_pit", trees.tree_pit(), "pavement")
    for left in (False, True):
        y = p.kerb_left + 1.15 if left else p.kerb_right - 1.15
        for k, x in enumerate(_tree_xs(s, p, left)):
            r = stream(s.seed, "tree", int(left), k)
            v = int(r.random() * len(names))
            tint = .8 + .4 * r.random()
            c = (.044 * tint + .022 * r.random(), .112 * tint, .014 + .010 * r.random())
            s.place("tree.%s%d" % ("L" if left else "R", k), names[v], pose(x, y, WALK + .1, 6.28318 * r.random(), .88 + .3 * r.random()), "tree", colour=c, solid=variants[v][1])
            s.place("pit.%s%d" % ("L" if left else "R", k), pit, pose(x, y, WALK - .05), "pavement")


# ------------------------------------------------------------------ wires
def _wires(s, p):
    if s.detail < 1:
        return
    rng = stream(s.seed, "wires")
    b = Builder()
    lamps = Builder()
    n = {1: 8, 2: 16, 3: 30}[s.detail]
    xs = [-34.0, -12.0, 9.0, 31.0, 63.0, 88.0, 112.0, 137.0]
    ends = []
    for x in xs:
        x += 5 * rng.random()
        z = 7.2 + 1.6 * rng.random()
        if x > p.x_max - 8:
            continue
        a, c = (x, p.front_left + .2, z + .5), (x + 3 * (rng.random() - .5), p.front_right - .2, z + .3)
        b.merge(furniture.wire(a, c, .55, .012, 4, n))
        ends.append((x, z))
        if s.detail >= 2:
            m = np.asarray(a) * .5 + np.asarray(c) * .5
            lamps.merge(furniture.hanging_lamp(), [translation(m[0], m[1], m[2] - .55 - .0)])
    # Lengthwise cables along both fronts, in hops between the crossing wires, and a bundle over the cross street.
    for y in (p.front_left - 1.6, p.front_right + 1.6):
        for (x0, z0), (x1, z1) in zip(ends[:-1], ends[1:]):
            for k in range({1: 1, 2: 2, 3: 3}[s.detail]):
                b.merge(furniture.wire((x0, y + .12 * k, z0 + .12 * k), (x1, y + .12 * k, z1 + .1 * k), .45 + .15 * k, .009, 4, n))
    for x in (p.cross_x - 8.4, p.cross_x + 8.4):
        b.merge(furniture.wire((x, p.front_right - .3, 8.4), (x, p.front_left + .3, 8.8), .7, .013, 4, n))
    for y in (p.front_right - 6.0, p.front_left + 7.5, p.front_left + 24.0, p.front_right - 22.0):
        b.merge(furniture.wire((p.cross_x - p.cross_half - p.cross_walk - .3, y, 8.0), (p.cross_x + p.cross_half + p.cross_walk + .3, y + 2, 8.4), .4, .011, 4, n))
    s.place("wires", s.add_model("wires", b, "wire"), np.eye(4), "wire")
    if lamps.chunks:
        s.place("hanging_lamps", s.add_model("hanging_lamps", lamps, "pole"), np.eye(4), "pole")


# ------------------------------------------------------------------ cars
class _Cars:
    """Models of car bodies made on first use, one per style and number plate."""

    def __init__(self, s):
        self.s, self.models = s, {}

    def get(self, style, plate):
        key = (style, plate)
        if key not in self.models:
            b, solid = cars.build_car(style, self.s.detail, plate)
            self.models[key] = (self.s.add_model("%s%d" % key, b, "car"), solid)
        return self.models[key]


def _look(rng, styles):
    style = pick(rng, styles)
    return style, int(rng.random() * 2) * 4 + int(rng.random() * 2), pick(rng, cars.CAR_COLOURS)


PARKED_STYLES = ("sedan", "hatchback", "wagon", "suv", "coupe", "minivan", "hatchback", "sedan", "suv", "van")


def _parked(s, p):
    s.cars = _Cars(s)
    stop, stop_back = p.stop_lines()
    (a0, a1), (b0, b1) = p.blocks()
    for tag, y, yaw, spans in (("R", p.kerb_right + 1.10, 0.0, ((a0 + 7, stop - 7.5), (b0 + 9, p.zebra_x - 7), (p.zebra_x + 6, b1 - 7))),
                               ("L", p.kerb_left - 1.10, math.pi, ((a0 + 7, a1 - 11), (stop_back + 8, 76.0), (90.0, p.zebra_x - 6), (p.zebra_x + 7, b1 - 7)))):
        k = 0
        for x0, x1 in spans:
            x = x0
            while True:
                rng = stream(s.seed, "parked", tag, k)
                style, plate, colour = _look(rng, PARKED_STYLES)
                half = cars.SPECS[style].length / 2
                if x + 2 * half > x1:
                    break
                gap = rng.random()
                if rng.random() < .80:
                    parts, solid = s.cars.get(style, plate)
                    flip = math.pi if rng.random() < .06 else 0.0
                    s.place("parked.%s%d" % (tag, k), parts, pose(x + half, y + .16 * (rng.random() - .5), 0.0, yaw + flip + .02 * (rng.random() - .5)), "car", colour=colour, solid=solid)
                x += 2 * half + .75 + 1.1 * gap
                k += 1
    # On the cross street: waiting at the red light, and parked further off.
    for tag, x, y, yaw in (("w0", p.cross_x + 2.6, p.kerb_right - 9.2, math.pi / 2), ("w1", p.cross_x - 2.6, p.kerb_left + 9.4, -math.pi / 2), ("w2", p.cross_x + 2.6, p.kerb_right - 16.0, math.pi / 2),
                           ("x0", p.cross_x + 4.3, p.kerb_left + 30.0, math.pi / 2), ("x1", p.cross_x + 4.3, p.kerb_left + 37.0, math.pi / 2), ("x2", p.cross_x - 4.3, p.kerb_right - 33.0, -math.pi / 2),
                           ("x3", p.cross_x - 4.3, p.kerb_right - 40.0, -math.pi / 2)):
        rng = stream(s.seed, "parked", tag)
        style, plate, colour = _look(rng, PARKED_STYLES[:9])
        parts, solid = s.cars.get(style, plate)
        s.place("waiting." + tag, parts, pose(x, y, 0.0, yaw), "car", colour=colour, solid=solid)


def _moving(s, p):
    rng = stream(s.seed, "moving")
    lanes = [
        # tag, style choices, x at t = 0, lane y, direction, speed; traffic needed
        ("lead", ("sedan", "hatchback", "wagon", "coupe"), 19.5, EGO_LANE_Y_M, 1, 7.4, .1),
        ("van", ("van", "minivan"), 27.0, 5.15, -1, 7.2, .2),
        ("behind", ("suv", "sedan", "hatchback"), -15.0, EGO_LANE_Y_M, 1, 7.9, .3),
        ("on1", ("taxi",), 58.0, 5.1, -1, 7.2, .4),
        ("ahead", ("suv", "wagon", "minivan"), 62.0, EGO_LANE_Y_M, 1, 8.2, .5),
        ("on2", ("sedan", "hatchback", "coupe"), 96.0, 1.85, -1, 7.8, .6),
        ("on3", ("bus",), 118.0, 5.2, -1, 7.2, .8),
        ("back1", ("hatchback", "wagon"), -28.0, EGO_LANE_Y_M, 1, 7.8, 1.0),
        ("far", ("hatchback", "sedan"), 96.0, EGO_LANE_Y_M, 1, 8.4, 1.0),
        ("on4", ("suv", "sedan"), 148.0, 1.85, -1, 7.6, 1.2),
    ]
    for tag, styles, x, y, way, speed, need in lanes:
        style, plate, colour = _look(rng, styles)
        jitter = rng.random()
        end = x + way * speed * 10.0
        if s.traffic < need or not all(p.x_min - 6 < q < p.x_max + 6 for q in (x + 1.5, end)):
            continue
        if style == "taxi":
            colour = cars.TAXI_COLOUR
        if style == "bus":
            colour = (.42, .03, .03)
        if tag == "van":
            colour = (.80, .81, .80)
        parts, solid = s.cars.get(style, plate)
        s.movers[tag] = Mover(round(x + 1.5 * jitter, 4), y, 0.0 if way > 0 else math.pi, round(speed, 4))
        s.place("driving." + tag, parts, np.eye(4), "car", mover=tag, colour=colour, solid=solid)
    if s.traffic >= .5:      # a cyclist in the cycle lane
        bike, solid = furniture.bicycle(s.detail, leaning=False)
        parts = s.add_model("ridden_bike", bike, "bicycle")
        b, _ = people.build_person("sit", "jacket", s.detail)
        rider = s.add_model("rider", b, "person")
        s.movers["cyclist"] = Mover(36.0, -4.45, 0.0, 5.0)
        s.place("cyclist.bike", parts, np.eye(4), "bicycle", mover="cyclist", colour=(.05, .20, .35), solid=((0, 0, .9), (.9, .3, .9)))
        s.place("cyclist.rider", rider, pose(-.18, 0, .06), "person", mover="cyclist", colour=(.60, .30, .03))


# ------------------------------------------------------------------ people
def _people(s, p):
    models = {}

    def get(pose_name, look):
        if (pose_name, look) not in models:
            b, solid = people.build_person(pose_name, look, s.detail)
            models[pose_name, look] = (s.add_model("person_%s_%s" % (pose_name, look), b, "person"), solid)
        return models[pose_name, look]

    (a0, a1), (b0, b1) = p.blocks()
    # Walkers on the pavements.
    for k in range(int(22 * s.traffic)):
        r = stream(s.seed, "walker", k)
        left, block = r.random() < .5, (a0, a1) if r.random() < .40 else (b0, b1)
        way, speed = (1 if r.random() < .5 else -1), 1.0 + .5 * r.random()
        lo, hi = block[0] + 3, block[1] - 3
        x = lo + (hi - lo) * r.random()
        y = (p.kerb_left + 2.05 + .9 * r.random()) if left else (p.kerb_right - 2.05 - .9 * r.random())
        look, phase = pick(r, people.LOOKS), pick(r, ("walk0", "walk1", "walk2"))
        colour, size = pick(r, people.CLOTH_COLOURS), .93 + .12 * r.random()
        if not lo <= x + way * speed * 11 <= hi:
            way = -way
        if not lo <= x + way * speed * 11 <= hi:
            continue
        parts, solid = get(phase, look)
        tag = "walker%d" % k
        s.movers[tag] = Mover(round(x, 4), round(y, 4), 0.0 if way > 0 else math.pi, round(speed, 4), WALK)
        s.place(tag, parts, pose(0, 0, 0, 0, size), "person", mover=tag, colour=colour, solid=solid)
    # Crossing the cross street on green, along the ego's way.
    for k, (x, y, way) in enumerate(((p.cross_x - 5.0, p.kerb_right - 2.6, 1), (p.cross_x + 5.2, p.kerb_right - 3.3, -1), (p.cross_x - 4.2, p.kerb_left + 2.7, 1))):
        if s.traffic < .3 * (k + 1):
            continue
        r = stream(s.seed, "crosser", k)
        parts, solid = get(pick(r, ("walk0", "walk1")), pick(r, people.LOOKS))
        tag = "crosser%d" % k
        s.movers[tag] = Mover(x, y, 0.0 if way > 0 else math.pi, round(.85 + .1 * r.random(), 4), 0.0)
        s.place(tag, parts, pose(0, 0, 0, 0, .95 + .1 * r.random()), "person", mover=tag, colour=pick(r, people.CLOTH_COLOURS), solid=solid)
    # Over the zebra, when no moving car meets them.
    for k in range(int(3 * s.traffic)):
        r = stream(s.seed, "zebra", k)
        up = r.random() < .5
        m = Mover(round(p.zebra_x - 1.2 + 2.4 * r.random(), 4), p.kerb_right + .4 + 2.0 * k if up else p.kerb_left - .4 - 2.2 * k, math.pi / 2 if up else -math.pi / 2, round(1.1 + .3 * r.random(), 4))
        parts, solid = get(pick(r, ("walk0", "walk1", "walk2")), pick(r, people.LOOKS))
        colour = pick(r, people.CLOTH_COLOURS)
        if _meets_cars(s, m):
            continue
        tag = "zebra%d" % k
        s.movers[tag] = m
        s.place(tag, parts, np.eye(4), "person", mover=tag, colour=colour, solid=solid)
    # Standing: waiting at corners, talking in pairs, before shop windows, at the bus stop.
    spots = [(a1 - 2.4, p.kerb_right - 1.9, 0.2), (a1 - 3.1, p.kerb_left + 1.7, -1.3), (b0 + 2.6, p.kerb_right - 2.4, 2.9), (b0 + 3.0, p.kerb_left + 2.5, -2.0),
             (81.0, p.kerb_left + 1.25, -1.5), (83.2, p.kerb_left + 1.0, -1.8)]
    for k in range(6):
        r = stream(s.seed, "pair", k)
        left, block = r.random() < .5, pick(r, ((a0 + 8, a1 - 8), (b0 + 8, b1 - 8), (2, 30)))
        x, a = block[0] + (block[1] - block[0]) * r.random(), 6.2832 * r.random()
        y = (p.front_left - 1.35) if left else (p.front_right + 1.35)
        spots += [(x, y, a), (x + .75 * math.cos(a), y + .45 * math.sin(a), a + math.pi + .3)] if k % 2 == 0 else [(x, y, (math.pi / 2 if left else -math.pi / 2) + .4 * (r.random() - .5))]
    for k, (x, y, yaw) in enumerate(spots):
        r = stream(s.seed, "stander", k)
        parts, solid = get(pick(r, ("stand0", "stand1")), pick(r, people.LOOKS))
        s.place("stander%d" % k, parts, pose(round(x, 4), round(y, 4), WALK, yaw, .92 + .13 * r.random()), "person", colour=pick(r, people.CLOTH_COLOURS), solid=solid)


def _meets_cars(s, m):
    for q in s.solids:
        if q.mover is None or q.category not in ("car", "bicycle"):
            continue
        for t in np.arange(-1.0, 11.01, .25):
            w, v = m.world_from_mover(t), s.movers[q.mover].world_from_mover(t)
            c = v[:3, :3] @ np.asarray(q.centre) + v[:3, 3]
            if box_gap(w[:2, 3], (.35, .35), 0.0, c, q.half, s.movers[q.mover].yaw_rad) < .5:
                return True
    return False
