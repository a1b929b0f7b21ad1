# SPDX-License-Identifier: CC0-1.0
"""People with rounded limbs, walking or standing, in differing clothes.

Local frame: origin on the ground between the feet, facing +x, about 1.75 m tall.
"""
import math

import numpy as np

from .mesh import Builder, circle

POSES = ("walk0", "walk1", "walk2", "stand0", "stand1", "sit")
LOOKS = ("jacket", "dress", "coat", "shirt")


def _limb(b, material, points, radii, sides):
    """A tapered limb with rounded ends."""
    p, r = np.asarray(points, float), np.asarray(radii, float)
    t0, t1 = p[0] - p[1], p[-1] - p[-2]
    t0, t1 = t0 / np.sqrt((t0 * t0).sum()), t1 / np.sqrt((t1 * t1).sum())
    p = np.concatenate([[p[0] + t0 * r[0] * .7], [p[0] + t0 * r[0] * .45], p, [p[-1] + t1 * r[-1] * .45], [p[-1] + t1 * r[-1] * .7]])
    r = np.concatenate([[r[0] * .25], [r[0] * .78], r, [r[-1] * .78], [r[-1] * .25]])
    b.tube(material, p, r, sides)


def _trunk(b, material, rows, sides):
    """Elliptic sections (x, y, z, rx, ry)."""
    c = circle(sides)
    b.loft(material, np.stack([np.c_[c[:, 0] * rx + x, c[:, 1] * ry + y, np.full(sides, z)] for x, y, z, rx, ry in rows]))


def build_person(pose, look, detail, height=1.75):
    """(Builder, solid) of a person."""
    b = Builder()
    solid = ((0.0, 0.0, .875), (.28, .28, .875))
    if detail == 0:
        b.box("cloth_top", -.14, .14, -.22, .22, .80, 1.45)
        b.box("cloth_legs", -.12, .12, -.17, .17, 0.0, .7995)
        b.box("skin", -.10, .10, -.08, .08, 1.4505, 1.74)
        return b, solid
    n = {1: 6, 2: 8, 3: 18}[detail]
    step = {"walk0": .30, "walk1": -.24, "walk2": .12, "stand0": .0, "stand1": .03, "sit": 0.0}[pose]
    hip = .92 - abs(step) * .12
    legs = "cloth_legs" if look != "dress" else "skin"
    dress = look == "dress"
    for s, ph in ((1, step), (-1, -step)):
        foot = np.array([ph * 1.05, s * .095, .085 + max(0, -ph) * .20])
        knee = np.array([ph * .50 + .06 + max(0, -ph) * .10, s * .095, hip * .53])
        top = np.array([0, s * .095, hip])
        if pose == "sit":
            knee, foot = np.array([.42, s * .12, .62 + s * .10]), np.array([.30, s * .12, .25 + s * .10])
        _limb(b, legs, [top, top * .6 + knee * .4 + [.012, 0, 0], knee, knee * .55 + foot * .45 + [-.022, 0, 0], foot + [0, 0, .03]],
              [.092, .084, .060, .058, .040] if look != "shirt" else [.10, .094, .074, .068, .058], n)
        tilt = max(0, -ph) * .35
        _limb(b, "shoe", [foot + [-.06, 0, -.035 + tilt * .25], foot + [.04, 0, -.040], foot + [.155, 0, -.050 - tilt * .12]], [.046, .047, .034], n)
    lean = .03 if pose.startswith("walk") else 0.0
    sh = hip + .50
    top = "cloth_top"
    _trunk(b, top if not dress else top, [(0, 0, hip - .125, .118, .176), (0, 0, hip - .12, .125, .184), (0, 0, hip - .02, .122, .176), (0, 0, hip + .08, .115, .162), (lean * .4, 0, hip + .20, .105, .145),
                                         (lean * .8, 0, hip + .34, .122, .170), (lean, 0, sh - .06, .118, .185), (lean, 0, sh, .095, .165), (lean, 0, sh + .045, .065, .09), (lean, 0, sh + .075, .05, .055)], n + 4)
    if look == "coat":
        _trunk(b, top, [(-.0, 0, hip - .36, .175, .205), (0, 0, hip - .20, .155, .195), (0, 0, hip, .135, .183), (0, 0, hip + .14, .120, .162), (0, 0, hip + .17, .09, .12)], n + 4)
    if dress:
        _trunk(b, top, [(0, 0, hip - .40, .20, .235), (0, 0, hip - .20, .17, .21), (0, 0, hip, .135, .182), (0, 0, hip + .14, .115, .155), (0, 0, hip + .17, .09, .12)], n + 4)
    # Arms swing against the legs.
    for s, ph in ((1, -step), (-1, step)):
        a = np.array([lean, s * .190, sh - .035])
        e = np.array([lean + ph * .35 - .03, s * .245, sh - .30])
        h = np.array([lean + ph * .95 + .06, s * .235, sh - .53 + abs(ph) * .12])
        if pose == "stand1" and s == 1:
            e, h = a + [.06, .06, -.27], a + [.26, -.04, -.20]       # looking at a phone
        if pose == "sit":
            e, h = a + [.20, .05, -.20], a + [.45, .02, -.20]
        sleeve = top if look != "shirt" and not dress else "skin"
        if sleeve == top:
            _limb(b, top, [a, a * .5 + e * .5, e, h * .85 + e * .15], [.062, .054, .047, .040], n)
        else:
            _limb(b, "skin", [a, e, h], [.043, .038, .030], n)
            _limb(b, top, [a, a * .55 + e * .45], [.064, .056], n)
        b.ellipsoid("skin", h + [.01, 0, -.03], (.036, .024, .052), n, 6)
    if pose == "stand1":
        q = np.array([lean, .19, sh - .035]) + [.30, -.05, -.17]
        b.box("car_glass", q[0] - .01, q[0] + .0, q[1] - .035, q[1] + .035, q[2] - .06, q[2] + .08)
    # Neck, head, hair, nose.
    z = sh + .075
    _limb(b, "skin", [(lean, 0, z - .03), (lean + .008, 0, z + .06)], [.052, .050], n)
    head = np.array([lean + .018, 0, z + .155])
    b.ellipsoid("skin", head, (.098, .078, .122), n + 2, n)
    b.ellipsoid("skin", head + [.094, 0, -.018], (.020, .013, .022), 6, 5)
    if detail >= 2:
        for y in (-.032, .032):
            b.ellipsoid("eye", head + [.086, y, .012], (.012, .011, .009), 6, 4)
            b.ellipsoid("hair", head + [.090, y, .034], (.010, .018, .005), 6, 4)
        b.ellipsoid("lips", head + [.088, 0, -.062], (.010, .024, .007), 6, 4)
        b.ellipsoid("hair", head + [-.020, 0, .030], (.098, .086, .107), n + 2, n)
        if dress or look == "coat":
            b.ellipsoid("hair", head + [-.055, 0, -.075], (.060, .078, .125), n, 8)
        # A bag for some.
        if look in ("dress", "jacket"):
            y = -.255
            b.boxes("bag", [(lean - .13, y - .05, hip - .12)], [(lean + .13, y + .045, hip + .10)])
            b.tube("bag", [(lean - .11, y, hip + .095), (lean - .02, -.17, sh + .035), (lean + .10, y, hip + .095)], .011, 5)
    return b, solid


CLOTH_COLOURS = [(0.45, 0.04, 0.04), (0.05, 0.08, 0.20), (0.035, 0.035, 0.04), (0.50, 0.47, 0.42), (0.10, 0.16, 0.10), (0.58, 0.40, 0.08),
                 (0.30, 0.10, 0.22), (0.60, 0.60, 0.62), (0.08, 0.22, 0.34), (0.35, 0.20, 0.10)]
