# SPDX-License-Identifier: CC0-1.0
"""Paints the sign texture: shop names in a stroke alphabet, traffic signs, plates, posters.

`paint_atlas(seed)` gives (ATLAS_SIZE, ATLAS_SIZE, 3) float32, sRGB-coded 0..1, row 0 on top.
All shapes are signed distances, so edges are smooth at any size.
"""
import numpy as np

from .atlas import ATLAS_SIZE, RECTS_PX
from .rng import pick, stream

# Strokes on a grid 0..4 wide, 0..6 high (y up); each string is a polyline "xy xy ..."; o marks a ring.
_GLYPHS = {
    "A": ["00 26 40", "12 32"], "B": ["00 06 26 35 34 23 03", "23 32 31 20 00"], "C": ["45 36 16 05 01 10 30 41"], "D": ["00 06 26 44 42 20 00"],
    "E": ["40 00 06 46", "03 33"], "F": ["00 06 46", "03 33"], "G": ["45 36 16 05 01 10 30 41 43 23"], "H": ["00 06", "40 46", "03 43"], "I": ["20 26"],
    "J": ["01 10 30 41 46"], "K": ["00 06", "46 03 40"], "L": ["06 00 40"], "M": ["00 06 22 46 40"], "N": ["00 06 40 46"], "O": ["10 01 05 16 36 45 41 30 10"],
    "P": ["00 06 36 45 44 33 03"], "Q": ["10 01 05 16 36 45 41 30 10", "22 40"], "R": ["00 06 36 45 44 33 03", "23 40"], "S": ["45 36 16 05 04 13 33 42 41 30 10 01"],
    "T": ["20 26", "06 46"], "U": ["06 01 10 30 41 46"], "V": ["06 20 46"], "W": ["06 10 24 30 46"], "X": ["00 46", "06 40"], "Y": ["06 23 46", "23 20"], "Z": ["06 46 00 40"],
    "0": ["10 01 05 16 36 45 41 30 10"], "1": ["14 26 20"], "2": ["05 16 36 45 44 00 40"], "3": ["05 16 36 45 44 33 23", "33 42 41 30 10 01"], "4": ["30 36 02 42"],
    "5": ["46 06 03 33 42 41 30 00"], "6": ["45 36 16 05 01 10 30 41 42 33 03"], "7": ["06 46 10"], "8": ["13 04 05 16 36 45 44 33 13 02 01 10 30 41 42 33"], "9": ["01 10 30 41 45 36 16 05 04 13 43"],
    "&": ["40 05 16 25 24 02 01 10 20 42"], "-": ["13 33"], "'": ["25 26"], ".": ["20 20"], " ": [],
}
_WORDS = ["LIBRERIA NOVA", "CAFE AURORA", "BOULANGERIE", "TAVOLA 21", "OPTIK MAIER", "FLORA & CO", "PHARMACY", "THE CORNER", "HOTEL LUMEN", "VINO BAR",
          "BARBER JACK", "FRESH MARKET", "KIOSK 24", "STOFF & GARN", "MUSIC BOX", "BIKE WORKS", "PIZZERIA SOLE", "SCHUHHAUS", "ATELIER 9", "TEA ROOM", "PAPETERIE", "NORD BANK", "GALERIE K", "ICE CREAM"]
_BOARDS = [((.08, .22, .18), (.93, .90, .80)), ((.10, .12, .30), (.95, .93, .88)), ((.45, .07, .08), (.96, .92, .82)), ((.93, .91, .86), (.12, .12, .13)), ((.13, .13, .14), (.93, .80, .45)),
           ((.85, .62, .12), (.15, .11, .08)), ((.20, .34, .45), (.97, .96, .93)), ((.30, .20, .13), (.95, .87, .70)), ((.06, .35, .22), (.97, .97, .95)), ((.90, .88, .82), (.50, .08, .10))]


class _Sheet:
    """A rectangle of the texture with pixel coordinates, y up from its lower edge."""

    def __init__(self, image, name):
        self.rect = x, y, w, h = RECTS_PX[name]
        self.view = image[y:y + h, x:x + w]
        self.w, self.h = w, h
        self.x = (np.arange(w) + .5)[None, :]
        self.y = (h - np.arange(h) - .5)[:, None]

    def fill(self, colour):
        self.view[:] = colour

    def put(self, d, colour):
        """Blends a colour in where the signed distance (px) is positive."""
        a = np.clip(d + .5, 0, 1)[..., None]
        self.view[:] = self.view * (1 - a) + np.asarray(colour, np.float32) * a

    def box(self, x0, y0, x1, y1, colour, r=0.0):
        dx = np.abs(self.x - (x0 + x1) / 2) - (x1 - x0) / 2 + r
        dy = np.abs(self.y - (y0 + y1) / 2) - (y1 - y0) / 2 + r
        d = np.sqrt(np.maximum(dx, 0) ** 2 + np.maximum(dy, 0) ** 2) + np.minimum(np.maximum(dx, dy), 0) - r
        self.put(-d, colour)

    def disc(self, cx, cy, r, colour, inner=0.0):
        q = np.sqrt((self.x - cx) ** 2 + (self.y - cy) ** 2)
        self.put(np.minimum(r - q, q - inner), colour)

    def line(self, x0, y0, x1, y1, width, colour):
        self.put(width / 2 - _segment(self.x, self.y, x0, y0, x1, y1), colour)

    def polygon(self, points, colour):
        """Convex, counter-clockwise in y-up coordinates."""
        d = None
        for (ax, ay), (bx, by) in zip(points, points[1:] + points[:1]):
            l = max(((bx - ax) ** 2 + (by - ay) ** 2) ** .5, 1e-6)
            e = (-(by - ay) * (self.x - ax) + (bx - ax) * (self.y - ay)) / l
            d = e if d is None else np.minimum(d, e)
        self.put(d, colour)

    def text(self, string, cx, cy, height, colour, bold=.15, wide=1.0, spacing=1.5, max_width=None):
        """Centred text; `bold` is the stroke's width as a share of the height."""
        u = height / 6.0
        advance = (4 * wide + spacing) * u
        total = advance * len(string) - spacing * u
        if max_width and total > max_width:
            wide, spacing = wide * max_width / total, spacing * max_width / total
            advance = (4 * wide + spacing) * u
            total = advance * len(string) - spacing * u
        x = cx - total / 2
        y0 = cy - height / 2
        for ch in string:
            for stroke in _GLYPHS.get(ch, []):
                p = [(x + int(q[0]) * u * wide, y0 + int(q[1]) * u) for q in stroke.split()]
                # Only the letter's own columns are touched.
                a = max(int(x - 2 * u), 0)
                b = min(int(x + advance + 2 * u), self.w)
                if a >= b:
                    continue
                xs = self.x[:, a:b]
                d = np.full((self.h, b - a), 1e9)
                for (ax, ay), (bx, by) in zip(p, p[1:] if len(p) > 1 else p):
                    d = np.minimum(d, _segment(xs, self.y, ax, ay, bx, by))
                al = np.clip(height * bold / 2 - d + .5, 0, 1)[..., None]
                self.view[:, a:b] = self.view[:, a:b] * (1 - al) + np.asarray(colour, np.float32) * al
            x += advance


def _segment(x, y, x0, y0, x1, y1):
    dx, dy = x1 - x0, y1 - y0
    l2 = dx * dx + dy * dy
    t = 0.0 if l2 < 1e-9 else np.clip(((x - x0) * dx + (y - y0) * dy) / l2, 0, 1)
    return np.sqrt((x - x0 - t * dx) ** 2 + (y - y0 - t * dy) ** 2)


def paint_atlas(seed):
    """The sign texture of a street."""
    im = np.full((ATLAS_SIZE, ATLAS_SIZE, 3), .5, np.float32)
    for k in range(24):
        r = stream(seed, "shopname", k)
        s = _Sheet(im, "shop%d" % k)
        board, ink = _BOARDS[int(r.random() * len(_BOARDS))]
        s.fill(board)
        if r.random() < .5:
            s.box(8, 8, 1016, 120, ink, 6)
            s.box(13, 13, 1011, 115, board, 4)
        word = _WORDS[(k + int(stream(seed, "shopnames").random() * 24)) % 24]
        s.text(word, 512, 64, 62, ink, bold=pick(r, (.13, .17, .21)), wide=pick(r, (.85, 1.0, 1.1)), spacing=pick(r, (1.5, 2.2, 3.0)), max_width=760)
        for x in (70, 954):
            if r.random() < .6:
                s.disc(x, 64, 30, ink)
                s.disc(x, 64, 22, board)
                s.disc(x, 64, 12, ink)
        # Blade sign of the same shop family.
        if k < 8:
            q = _Sheet(im, "blade%d" % k)
            q.fill(board)
            q.disc(64, 64, 54, ink, 48)
            q.text(word[0], 64, 66, 56, ink, bold=.17)
    _traffic(im)
    for k in range(8):
        r = stream(seed, "plate", k)
        s = _Sheet(im, "plate%d" % k)
        s.fill((.93, .93, .91))
        s.box(0, 0, 26, 64, (.05, .16, .55))
        letters = "ABCDEFGHKLMNPRSTUVWXYZ"
        t = "".join(pick(r, letters) for _ in range(2)) + " " + "".join(str(int(r.random() * 10)) for _ in range(3)) + " " + pick(r, letters) + pick(r, letters)
        s.text(t, 142, 32, 38, (.06, .06, .08), bold=.16, wide=.8, max_width=205)
    for k in range(4):
        s = _Sheet(im, "street%d" % k)
        s.fill((.05, .22, .45))
        s.box(4, 4, 252, 60, (.95, .95, .95), 6)
        s.box(8, 8, 248, 56, (.05, .22, .45), 4)
        s.text(("STATION ST", "OAK AVENUE", "RUE HAUTE", "MARKT")[k], 128, 32, 26, (.97, .97, .97), bold=.15, max_width=220)
    for k in range(2):
        s = _Sheet(im, "number%d" % k)
        s.fill((.02, .02, .02))
        s.text(("24 CENTRAL", "7 HARBOUR")[k], 256, 32, 36, (1.0, .62, .05), bold=.14, max_width=440)
    for k in range(8):
        _poster(_Sheet(im, "poster%d" % k), stream(seed, "poster", k))
    for k in range(2):
        s = _Sheet(im, "ad%d" % k)
        s.fill(((.95, .80, .15), (.10, .35, .55))[k])
        s.text(("CITY LINES", "GREEN POWER")[k], 256, 64, 56, ((.15, .12, .10), (.97, .97, .97))[k], bold=.19, max_width=420)
    return np.clip(im, 0, 1)


def _traffic(im):
    red, white, blue, black, yellow = (.78, .05, .07), (.95, .95, .95), (.04, .22, .60), (.05, .05, .06), (.96, .78, .08)
    s = _Sheet(im, "stop"); s.fill(white)
    o = [(64 + 59 * c, 64 + 59 * d) for c, d in ((.924, .383), (.383, .924), (-.383, .924), (-.924, .383), (-.924, -.383), (-.383, -.924), (.383, -.924), (.924, -.383))]
    s.polygon(o, red); s.text("STOP", 64, 64, 34, white, bold=.19, wide=.9, max_width=92)
    s = _Sheet(im, "no_entry"); s.fill(white); s.disc(64, 64, 61, red); s.box(20, 52, 108, 76, white)
    s = _Sheet(im, "limit30"); s.fill(red); s.disc(64, 64, 46, white); s.text("30", 64, 64, 46, black, bold=.19, wide=.9)
    s = _Sheet(im, "priority"); s.fill(white)
    s.polygon([(64, 26), (102, 64), (64, 102), (26, 64)], yellow)
    s = _Sheet(im, "crossing"); s.fill(blue); s.polygon([(14, 16), (114, 16), (64, 112)], white)
    s.disc(62, 74, 6.5, black)
    for a in ((62, 66, 58, 46), (58, 46, 48, 26), (58, 46, 72, 26), (62, 62, 76, 52), (61, 62, 48, 52)):
        s.line(*a, 6, black)
    for k in range(4):
        s.box(34 + 17 * k, 17, 42 + 17 * k, 22, black)
    s = _Sheet(im, "parking"); s.fill(blue); s.box(5, 5, 123, 123, white, 8); s.box(9, 9, 119, 119, blue, 6); s.text("P", 66, 64, 72, white, bold=.19)
    s = _Sheet(im, "no_parking"); s.fill(red); s.disc(64, 64, 50, blue); s.line(24, 104, 104, 24, 12, red)
    s = _Sheet(im, "turn_right"); s.fill(white); s.disc(64, 64, 61, blue)
    s.line(44, 28, 44, 66, 13, white); s.line(44, 66, 78, 66, 13, white); s.polygon([(74, 46), (104, 66), (74, 86)], white)


def _poster(s, r):
    base = [r.random() * .7 + .15 for _ in range(3)]
    s.fill(base)
    for _ in range(5):
        c = [r.random() for _ in range(3)]
        k = r.random()
        if k < .4:
            s.disc(s.w * r.random(), s.h * r.random(), 20 + 60 * r.random(), c)
        elif k < .7:
            x, y = s.w * r.random(), s.h * r.random()
            s.box(x - 40, y - 30, x + 40, y + 30, c, 4)
        else:
            s.line(0, s.h * r.random(), s.w, s.h * r.random(), 10 + 20 * r.random(), c)
    light = sum(base) > 1.4
    ink = (.06, .06, .07) if light else (.96, .95, .92)
    s.box(0, 0, s.w, 58, [1 - .9 * (1 - v) if light else v * .3 for v in base])
    s.text(pick(r, ("SALE", "JAZZ", "NEW", "EXPO", "OPEN", "MENU", "CINE")), s.w / 2, 30, 32, ink, bold=.19, max_width=s.w - 40)
