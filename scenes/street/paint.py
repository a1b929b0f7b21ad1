# SPDX-License-Identifier: CC0-1.0
"""Road paint, patches, puddles and wear as small float maps for the shader.

A map holds signed distances (metres, positive inside, cut at +-LIMIT_M), which
stay sharp when a shader thresholds them, at 5 cm a pixel. Raised paint would
make hairline occlusions, so nothing here is geometry.
"""
import math
from dataclasses import dataclass

import numpy as np

from .rng import stream

CELL_M = 0.05
LIMIT_M = 0.5


@dataclass
class RoadMap:
    """Channels over a rectangle: paint (H, W, 4) = white, yellow, stain, manhole cover; wear (H, W, 4) = patch, puddle, crack, 1.

    Row 0 is at y0 and column 0 at x0; distances are stored as 0.5 + d / (2 LIMIT_M).
    """
    x0: float
    y0: float
    x1: float
    y1: float
    paint: np.ndarray
    wear: np.ndarray


class _Field:
    """One signed-distance channel; shapes are united by the maximum."""

    def __init__(self, x0, y0, w, h):
        self.x0, self.y0 = x0, y0
        self.d = np.full((h, w), -LIMIT_M, np.float32)

    def window(self, ax, ay, bx, by):
        h, w = self.d.shape
        i0, i1 = int((ay - LIMIT_M - self.y0) / CELL_M), int((by + LIMIT_M - self.y0) / CELL_M) + 2
        j0, j1 = int((ax - LIMIT_M - self.x0) / CELL_M), int((bx + LIMIT_M - self.x0) / CELL_M) + 2
        i0, j0, i1, j1 = max(i0, 0), max(j0, 0), min(i1, h), min(j1, w)
        if i0 >= i1 or j0 >= j1:
            return None
        x = self.x0 + (np.arange(j0, j1) + .5) * CELL_M
        y = self.y0 + (np.arange(i0, i1) + .5) * CELL_M
        return (slice(i0, i1), slice(j0, j1)), x[None, :], y[:, None]

    def put(self, where, d):
        self.d[where] = np.maximum(self.d[where], d)

    def bar(self, ax, ay, bx, by, width):
        """A straight bar from a to b."""
        q = self.window(min(ax, bx) - width, min(ay, by) - width, max(ax, bx) + width, max(ay, by) + width)
        if q is None:
            return
        where, x, y = q
        l = math.hypot(bx - ax, by - ay)
        ux, uy = (bx - ax) / l, (by - ay) / l
        s = (x - ax) * ux + (y - ay) * uy
        t = -(x - ax) * uy + (y - ay) * ux
        self.put(where, np.minimum(np.minimum(s, l - s), width / 2 - np.abs(t)))

    def ring(self, cx, cy, r, width, stretch=1.0):
        q = self.window(cx - r * stretch - width, cy - r - width, cx + r * stretch + width, cy + r + width)
        if q is not None:
            where, x, y = q
            self.put(where, width / 2 - np.abs(np.sqrt(((x - cx) / stretch) ** 2 + (y - cy) ** 2) - r))

    def blob(self, cx, cy, rx, ry):
        q = self.window(cx - rx, cy - ry, cx + rx, cy + ry)
        if q is not None:
            where, x, y = q
            e = np.sqrt(((x - cx) / rx) ** 2 + ((y - cy) / ry) ** 2)
            self.put(where, np.clip((1 - e) * min(rx, ry), -LIMIT_M, LIMIT_M))

    def polygon(self, points):
        """A convex polygon, counter-clockwise."""
        p = np.asarray(points, float)
        q = self.window(p[:, 0].min(), p[:, 1].min(), p[:, 0].max(), p[:, 1].max())
        if q is None:
            return
        where, x, y = q
        d = None
        for a, b in zip(p, np.roll(p, -1, 0)):
            l = math.hypot(*(b - a))
            e = (-(b[1] - a[1]) * (x - a[0]) + (b[0] - a[0]) * (y - a[1])) / l
            d = e if d is None else np.minimum(d, e)
        self.put(where, d)

    def stored(self):
        return 0.5 + np.clip(self.d, -LIMIT_M, LIMIT_M) / (2 * LIMIT_M)


def _dashes(f, x0, x1, y, on, off, width=.14):
    x = x0
    while x < x1:
        f.bar(x, y, min(x + on, x1), y, width)
        x += on + off


def _arrow(f, x, y, way, kind):
    """A lane arrow of 4 m: straight, or straight and right."""
    f.bar(x, y, x + way * 2.6, y, .16)
    tip = [(x + way * 2.5, y + .42), (x + way * 2.5, y - .42), (x + way * 4.0, y)]
    f.polygon(tip[::-1] if way < 0 else [tip[1], tip[2], tip[0]])
    if kind == "right":
        s = -way
        f.bar(x + way * .8, y, x + way * 1.7, y + s * .55, .15)
        e = (x + way * 1.7, y + s * .55)
        pts = [(e[0] - way * .35, e[1] - s * .05 + s * .20), (e[0] + way * .5, e[1] - s * .15), (e[0] + way * .35, e[1] + s * .45)]
        a = (pts[1][0] - pts[0][0]) * (pts[2][1] - pts[0][1]) - (pts[1][1] - pts[0][1]) * (pts[2][0] - pts[0][0])
        f.polygon(pts if a > 0 else pts[::-1])


def _cycle_mark(f, x, y, way):
    """A bicycle symbol, stretched along the road as painted ones are."""
    for d in (-.62, .62):
        f.ring(x + way * d, y, .27, .08, 1.35)
    for a, b in (((-.62, 0), (-.15, .42)), ((-.15, .42), (.45, .40)), ((.45, .40), (0, 0)), ((0, 0), (-.62, 0)), ((0, 0), (-.22, .55)), ((.62, 0), (.40, .62)), ((.40, .62), (.22, .66))):
        f.bar(x + way * a[0], y + a[1] * .75 - .1, x + way * b[0], y + b[1] * .75 - .1, .075)


def road_maps(street):
    """(along the street, across it): RoadMaps. Outside of both the road is bare."""
    p, seed = street.plan, street.seed
    main = _blank(p.x_min - 14, p.kerb_right, p.x_max + 14, p.kerb_left)
    cross = _blank(p.cross_x - p.cross_half - 1, -p.cross_end_y, p.cross_x + p.cross_half + 1, p.cross_end_y)
    box = dict(zip(("white", "yellow", "patch", "puddle", "stain", "crack", "cover"), main[1]))
    white, yellow = box["white"], box["yellow"]
    stop, stop_back = p.stop_lines()
    x_in, x_out = p.cross_x - p.cross_half, p.cross_x + p.cross_half
    zebra = (p.zebra_x - 1.9, p.zebra_x + 1.9)
    spans = [(p.x_min + 5.5, stop), (stop_back, zebra[0] - 1.6), (zebra[1] + 1.6, p.x_max - 5.5)]
    bike0, bike1 = -3.55, -5.35
    for a, b in spans:
        for y in (-.10, .10):
            yellow.bar(a, y, b, y, .11)
        _dashes(white, a + 1, b, 3.45, 3.0, 4.5)
        white.bar(a, bike0, b, bike0, .13)
        _dashes(white, a, b, bike1, 1.0, 1.0, .10)
        white.bar(a, 6.85, b, 6.85, .12)
        # Parking bays.
        x = a + 6.5
        while x < b - 3:
            white.bar(x, p.kerb_right + .02, x, bike1 - .25, .10)
            white.bar(x, 6.85, x, p.kerb_left - .02, .10)
            x += 5.6
    for x in (0.0 - 36, 8.0, 30.5, 66.0, 92.0, 126.0, 150.0):
        _cycle_mark(white, x, .5 * (bike0 + bike1), 1)
    for x, y, way, kind in ((stop - 9.5, -1.75, 1, "right"), (stop - 24, -1.75, 1, "straight"), (stop_back + 9.5, 5.15, -1, "right"), (stop_back + 9.5, 1.75, -1, "straight"),
                            (-24.0, -1.75, 1, "straight"), (122.0, -1.75, 1, "straight"), (-30.0, 1.75, -1, "straight"), (-30.0, 5.15, -1, "straight")):
        _arrow(white, x, y, way, kind)
    # Stop lines and crosswalks at the crossing, the zebra, give-way lines at the ends.
    white.bar(stop + .2, -.25, stop + .2, bike0 - 1.75, .40)
    white.bar(stop_back - .2, .25, stop_back - .2, 6.75, .40)
    for c in (x_in - 2.4, x_out + 2.4):
        y = p.kerb_right + .55
        while y < p.kerb_left - .3:
            white.bar(c - 1.35, y, c + 1.35, y, .48)
            y += .98
    y = p.kerb_right + .45
    while y < p.kerb_left - .2:
        white.bar(zebra[0], y, zebra[1], y, .50)
        y += 1.0
    for x, s in ((p.x_min + 4.2, 1), (p.x_max - 4.2, -1)):
        white.bar(x, .3 if s > 0 else bike0, x, 6.75 if s > 0 else -.3, .40)
    _wear(box, stream(seed, "wear"), p.x_min - 10, p.x_max + 10, p.kerb_right, p.kerb_left)
    # Puddles on the ego's way, where a mirror-like patch shows best.
    r = stream(seed, "puddles")
    for x, y in ((6.8, -.5), (12.5, -6.0), (22.0, 1.2), (29.5, -4.6), (58.0, -2.2), (70.0, 6.3), (90.0, -1.0), (-18.0, -2.8)):
        for _ in range(4):
            box["puddle"].blob(x + 1.8 * (r.random() - .5), y + .8 * (r.random() - .5), .7 + .9 * r.random(), .35 + .45 * r.random())
    for x, y, k in manholes(street):
        box["cover"].blob(x, y, k, k)
    out = []
    out.append(_finish(main))
    cb = dict(zip(("white", "yellow", "patch", "puddle", "stain", "crack", "cover"), cross[1]))
    for s, yk in ((-1, p.kerb_right), (1, p.kerb_left)):
        far = s * (p.cross_end_y - 2)
        near = yk + s * 5.4
        cb["yellow"].bar(p.cross_x, min(near, far), p.cross_x, max(near, far), .12)
        x = p.cross_x - p.cross_half + .5
        while x < p.cross_x + p.cross_half - .2:
            cb["white"].bar(x, yk + s * 1.2, x, yk + s * 3.8, .48)
            x += .98
        a, b = (p.cross_x + .2, p.cross_x + p.cross_half - .2) if s < 0 else (p.cross_x - p.cross_half + .2, p.cross_x - .2)
        cb["white"].bar(a, yk + s * 4.9, b, yk + s * 4.9, .40)
    _wear(cb, stream(seed, "wear", "cross"), p.cross_x - 5, p.cross_x + 5, -p.cross_end_y, p.cross_end_y)
    out.append(_finish(cross))
    return out


def _blank(x0, y0, x1, y1):
    w, h = int(round((x1 - x0) / CELL_M)), int(round((y1 - y0) / CELL_M))
    return (x0, y0, x0 + w * CELL_M, y0 + h * CELL_M), [_Field(x0, y0, w, h) for _ in range(7)]


def _finish(m):
    (x0, y0, x1, y1), f = m
    one = np.ones_like(f[0].d)
    paint = np.stack([f[0].stored(), f[1].stored(), f[4].stored(), f[6].stored()], -1)
    wear = np.stack([f[2].stored(), f[3].stored(), f[5].stored(), one], -1)
    return RoadMap(x0, y0, x1, y1, paint.astype(np.float32), wear.astype(np.float32))


def _wear(box, r, xa, xb, ya, yb):
    """Patches of newer asphalt, trenches, tar-filled cracks, oil stains."""
    area = (xb - xa) * (yb - ya)
    for _ in range(int(area / 130)):
        x, y = xa + (xb - xa) * r.random(), ya + (yb - ya) * r.random()
        w, h, a = .7 + 2.6 * r.random(), .5 + 1.0 * r.random(), .12 * (r.random() - .5)
        c, s = math.cos(a), math.sin(a)
        box["patch"].polygon([(x + c * u - s * v, y + s * u + c * v) for u, v in ((-w, -h), (w, -h), (w, h), (-w, h))])
    for _ in range(int(area / 700)):                      # utility trenches across
        x = xa + (xb - xa) * r.random()
        if yb - ya < 40:
            box["patch"].bar(x, ya + .3, x + 1.5 * (r.random() - .5), yb - .3, .7 + .3 * r.random())
    for _ in range(int(area / 28)):                       # tar-filled cracks: wandering chains
        x, y = xa + (xb - xa) * r.random(), ya + (yb - ya) * r.random()
        a = 6.2832 * r.random()
        for _ in range(4 + int(5 * r.random())):
            l = .35 + .7 * r.random()
            nx, ny = x + l * math.cos(a), y + l * math.sin(a)
            box["crack"].bar(x, y, nx, ny, .035)
            x, y, a = nx, ny, a + 1.5 * (r.random() - .5)
    for _ in range(int(area / 22)):                       # oil drops
        x, y = xa + (xb - xa) * r.random(), ya + (yb - ya) * r.random()
        k = .12 + .32 * r.random() * r.random()
        box["stain"].blob(x, y, k * (1 + r.random()), k)
    # Tyre marks: pairs of short dark bars, and manhole covers as rings in the same channel.
    for _ in range(int(area / 420)):
        x, y = xa + (xb - xa) * r.random(), ya + (yb - ya) * r.random()
        l, a = 3 + 6 * r.random(), .05 * (r.random() - .5)
        for d in (-.74, .74):
            box["stain"].bar(x, y + d, x + l, y + d + l * a, .16)


def manholes(street):
    """(x, y, radius) of manhole covers, metres; drawn by the shader."""
    p = street.plan
    out = [(3.6, .9, .36), (17.5, -2.9, .34), (33.0, 2.4, .36), (57.5, -1.2, .36), (73.0, 4.0, .36), (95.0, -2.5, .36), (47.0, 1.5, .38), (-14.0, 1.0, .36), (-35.0, -2.0, .36), (128.0, 1.0, .36)]
    r = stream(street.seed, "manholes")
    return [(round(x + 1.5 * (r.random() - .5), 3), round(y + .3 * (r.random() - .5), 3), k) for x, y, k in out if p.x_min < x < p.x_max]
