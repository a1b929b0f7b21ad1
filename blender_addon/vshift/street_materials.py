# SPDX-License-Identifier: GPL-3.0-or-later
"""The street's materials as procedural node shaders, by the material names of its parts.

Everything is opaque. Few noise octaves: a handful of samples a pixel must look decent.
Colours are linear RGB. Metres everywhere.
"""
import bpy

from .street_nodes import Graph

# name: (colour, roughness, metallic, specular); plain materials
PLAIN = {
    "car_under": ((.012, .012, .012), .8, 0, .2), "car_plastic": ((.020, .020, .021), .45, 0, .4), "car_seam": ((.006, .006, .006), .7, 0, .1),
    "brake": ((.10, .10, .10), .45, .8, .5), "mirror": ((.45, .52, .60), .04, 1, .5),
    "chrome": ((.66, .67, .69), .16, 1, .5), "head_lamp": ((.62, .65, .69), .05, .55, .8),
    "lamp_glass": ((.80, .78, .70), .25, 0, .5), "iron": ((.022, .024, .026), .42, .3, .5), "iron_dark": ((.014, .014, .015), .5, 0, .4),
    "metal": ((.42, .43, .44), .38, .85, .5), "metal_sheet": ((.30, .32, .34), .40, .7, .5), "pipe": ((.20, .20, .19), .45, .35, .5),
    "frame": ((.72, .70, .66), .45, 0, .4), "blind": ((.55, .52, .46), .6, 0, .3), "shutter": ((.09, .17, .12), .55, 0, .4),
    "door": ((.11, .05, .025), .35, 0, .5), "door_panel": ((.14, .07, .035), .35, 0, .5), "appliance": ((.62, .62, .60), .5, 0, .4), "appliance_dark": ((.06, .06, .06), .5, 0, .4),
    "chimney": ((.26, .12, .08), .85, 0, .2), "roof_dark": ((.07, .07, .07), .9, 0, .2), "signal_black": ((.012, .012, .013), .4, 0, .4),
    "signal_green_off": ((.01, .05, .03), .2, 0, .5), "signal_amber_off": ((.07, .035, .005), .2, 0, .5), "signal_red_off": ((.06, .008, .006), .2, 0, .5),
    "hydrant": ((.50, .04, .025), .35, 0, .5), "bin": ((.035, .075, .05), .45, 0, .4), "white_band": ((.75, .75, .73), .45, 0, .4), "fence": ((.025, .10, .065), .40, 0, .5),
    "bench_wood": ((.26, .13, .055), .55, 0, .3), "planter": ((.34, .32, .29), .85, 0, .2), "planter_box": ((.28, .10, .05), .8, 0, .2), "soil": ((.05, .035, .022), .95, 0, .1),
    "hedge_core": ((.018, .038, .012), .9, 0, .1), "cabinet": ((.22, .25, .23), .5, .2, .4), "mailbox": ((.60, .38, .02), .35, 0, .5), "shelter_pane": ((.10, .13, .15), .06, 0, .8),
    "paper": ((.70, .69, .64), .8, 0, .2), "cardboard": ((.36, .24, .13), .85, 0, .2), "eye": ((.03, .025, .02), .1, 0, .6), "lips": ((.32, .12, .10), .5, 0, .3), "wire": ((.012, .012, .012), .6, 0, .3), "sign_edge": ((.10, .10, .10), .45, .2, .4), "shoe": ((.030, .022, .018), .45, 0, .4), "hair": ((.045, .026, .014), .6, 0, .3),
    "bag": ((.10, .045, .02), .5, 0, .4), "mannequin": ((.62, .56, .48), .5, 0, .3), "shelf": ((.34, .23, .13), .6, 0, .3), "bread": ((.50, .26, .08), .7, 0, .2),
    "shop_frame_dark": ((.025, .027, .03), .35, .3, .5), "shop_frame_wood": ((.19, .085, .035), .4, 0, .5), "shop_frame_green": ((.025, .10, .065), .35, 0, .5),
    "shop_frame_white": ((.68, .67, .63), .4, 0, .5), "shop_frame_red": ((.26, .025, .025), .35, 0, .5), "shop_frame_blue": ((.03, .075, .17), .35, 0, .5),
    "goods2": ((.62, .50, .22), .55, 0, .3), "goods3": ((.10, .26, .42), .55, 0, .3),
}
# Lit things: colour, strength. None is sampled as a lamp: at few samples that only makes noise.
GLOWING = {"signal_green": ((.03, .85, .42), 2.6), "signal_red": ((.95, .04, .02), 2.4), "signal_amber": ((.95, .45, .02), 2.0), "shop_lamp": ((1.0, .90, .72), 1.7)}
INTERIOR = {"shop_wall": (.66, .58, .47), "shop_ceiling": (.72, .70, .66), "shop_floor": (.30, .20, .12), "goods0": (.40, .09, .06), "goods1": (.17, .25, .13), "goods2": (.58, .47, .30),
            "goods3": (.12, .19, .30), "shelf": (.42, .28, .16), "bread": (.55, .30, .10), "mannequin": (.66, .60, .52)}
AWNINGS = {"awning0": ((.04, .22, .16), (.78, .76, .70)), "awning1": ((.45, .05, .04), (.78, .74, .66)), "awning2": ((.05, .10, .30), (.78, .77, .73)), "awning3": ((.62, .36, .06), (.78, .74, .64))}


def make(name, images):
    """The material of a part's material name; images: {"atlas", "road": [(image, image, box)]}."""
    m = bpy.data.materials.new(name)
    m.use_nodes = True
    g = Graph(m.node_tree)
    if name in _SPECIAL:
        _SPECIAL[name](g, images)
    elif name.startswith("wall_"):
        _wall(g, name[5:])
    elif name in INTERIOR:
        c = INTERIOR[name]
        n = g.noise(g.local(), 2.0, 1)
        c = g.mix(g.ramp(n, .3, .7, 0, .5), c, tuple(v * .72 for v in c))
        g.surface(g.principled(color=c, rough=.6, spec=.3, emission=c, emission_strength=.15))
    elif name in GLOWING:
        c, k = GLOWING[name]
        g.surface(g.principled(color=c, rough=.3, emission=c, emission_strength=k))
    elif name in AWNINGS:
        _awning(g, *AWNINGS[name])
    else:
        c, r, metal, spec = PLAIN.get(name, ((.3, .3, .3), .6, 0, .3))
        n = g.noise(g.local(), 5.0, 2)
        c = g.mix(g.ramp(n, .35, .75, 0, .45), c, tuple(v * .7 + .012 for v in c))
        g.surface(g.principled(color=c, rough=r, metal=metal, spec=spec))
    _no_lamp(m)
    m.diffuse_color = (.5, .5, .5, 1)
    return m


def _no_lamp(m):
    if hasattr(m.cycles, "emission_sampling"):
        m.cycles.emission_sampling = "NONE"
    elif hasattr(m.cycles, "sample_as_light"):
        m.cycles.sample_as_light = False


# ------------------------------------------------------------------ ground
def _road(g, images):
    pos = g.position()
    x, y, _ = g.xyz(pos)
    white = yellow = stain = cover = patch = puddle = crack = None
    for paint, wear, (x0, y0, x1, y1) in images["road"]:
        v = g.vector(g.share(x, x0, x1), g.share(y, y0, y1))
        colour, d = g.image(paint, v)
        a, b, c = g.split(colour)
        e, f, h = g.split(g.image(wear, v)[0])
        if white is None:
            white, yellow, stain, cover, patch, puddle, crack = a, b, c, d, e, f, h
        else:
            top = lambda p, q: g.math("MAXIMUM", p, q)
            white, yellow, stain, cover, patch, puddle, crack = top(white, a), top(yellow, b), top(stain, c), top(cover, d), top(patch, e), top(puddle, f), top(crack, h)
    fine = g.noise(pos, 55.0, 2, .6)
    mid = g.noise(pos, 1.3, 3, .55)
    broad = g.noise(pos, .22, 2)
    streak = g.noise(g.stretched(pos, .10, 2.2, 1), 1.0, 2)
    base = g.mix(broad, (.060, .061, .064), (.105, .104, .101))
    base = g.scale(base, g.ramp(streak, .3, .7, .80, 1.18))
    base = g.scale(base, g.ramp(mid, .25, .75, .86, 1.12))
    base = g.scale(base, g.ramp(fine, .25, .75, .78, 1.20))
    grain = g.noise(pos, 150.0, 0)
    base = g.scale(base, g.ramp(grain, .30, .72, .80, 1.30))
    # Patches: newer and darker or older and lighter, by place; a tarred seam around each.
    inside = g.ramp(patch, .497, .503)
    tone = g.noise(g.stretched(pos, .13, .13, 0), 1.0, 0)
    base = g.mix(inside, base, g.scale(base, g.ramp(tone, .40, .60, .55, 1.28)))
    seam = g.math("COMPARE", patch, .5, .016)
    wobble = g.mul(g.sub(g.noise(pos, 9.0, 1), .5), .05)
    line = g.ramp(g.add(crack, wobble), .500, .512)
    tar = g.math("MAXIMUM", line, g.mul(seam, .8))
    base = g.mix(g.mul(tar, .82), base, (.017, .017, .018))
    oil = g.ramp(g.add(stain, g.mul(g.sub(mid, .5), .30)), .46, .60)
    base = g.scale(base, g.ramp(oil, 0, 1, 1, .52))
    # Paint: worn by a noise threshold; the distance map keeps its edges sharp.
    worn = g.ramp(g.add(g.mul(fine, .55), g.mul(mid, .55)), .50, .66, 1.0, .12)
    edge = g.mul(g.sub(fine, .5), .02)
    w = g.mul(g.ramp(g.add(white, edge), .494, .504), worn)
    q = g.mul(g.ramp(g.add(yellow, edge), .494, .504), worn)
    dirt = g.ramp(mid, .3, .8, 1.0, .72)
    base = g.mix(w, base, g.scale((.66, .66, .64), dirt))
    base = g.mix(q, base, g.scale((.66, .42, .04), dirt))
    # Manhole covers: cast iron with a rim and a waffle pattern.
    iron = g.ramp(cover, .497, .503)
    rim = g.math("COMPARE", cover, .5, .022)
    cell = g.mul(g.math("SINE", g.mul(x, 90.0)), g.math("SINE", g.mul(y, 90.0)))
    waffle = g.ramp(cell, -.1, .1)
    base = g.mix(iron, base, g.mix(waffle, (.045, .042, .040), (.095, .088, .080)))
    base = g.mix(g.mul(rim, .85), base, (.018, .018, .018))
    # Water: darkens around, mirrors inside.
    level = g.add(puddle, g.mul(g.sub(mid, .5), .34))
    damp = g.ramp(level, .40, .52)
    pool = g.ramp(level, .545, .60)
    damp = g.math("MAXIMUM", damp, g.mul(g.ramp(broad, .60, .72), .35))
    base = g.scale(base, g.ramp(damp, 0, 1, 1, .46))
    rough = g.mix_value(damp, g.ramp(fine, .2, .8, .62, .80), .30)
    rough = g.mix_value(g.mul(oil, .5), rough, .35)
    rough = g.mix_value(g.mul(w, .6), rough, .50)
    rough = g.mix_value(iron, rough, .38)
    rough = g.mix_value(pool, rough, .035)
    height = g.add(fine, g.mul(g.mul(waffle, iron), 1.2))
    normal = g.bump(height, g.mul(g.ramp(pool, 0, 1, 1, 0), g.ramp(damp, 0, 1, .22, .10)), .010)
    g.surface(g.principled(color=base, rough=rough, spec=g.mix_value(pool, .38, .62), normal=normal))


def _pavement(g, images):
    pos = g.position()
    a, joint = g.brick(pos, .62, .62, .006, (.255, .245, .228), (.335, .325, .305), (.085, .08, .075))
    broad, mid = g.noise(pos, .45, 2), g.noise(pos, 3.0, 3, .6)
    c = g.scale(a, g.ramp(broad, .3, .7, .82, 1.08))
    c = g.scale(c, g.ramp(mid, .3, .75, 1.10, .78))
    gum = g.ramp(g.noise(pos, 13.0, 0), .73, .76)
    c = g.mix(g.mul(gum, .6), c, (.075, .07, .066))
    fine = g.noise(pos, 60.0, 1)
    c = g.scale(c, g.ramp(fine, .3, .7, .88, 1.10))
    damp = g.ramp(broad, .62, .70)
    c = g.scale(c, g.ramp(damp, 0, 1, 1, .70))
    n = g.bump(g.sub(g.mul(fine, .25), joint), .30, .006)
    g.surface(g.principled(color=c, rough=g.mix_value(damp, .78, .45), spec=.3, normal=n))


def _kerb(g, images):
    pos = g.position()
    x, y, z = g.xyz(pos)
    a, joint = g.brick(g.vector(g.add(x, y), g.mul(z, 1.0)), 1.0, 5.0, .005, (.36, .35, .33), (.44, .43, .41), (.06, .06, .06), 0.0)
    mid, fine = g.noise(pos, 4.0, 3, .6), g.noise(pos, 80.0, 1)
    c = g.scale(a, g.ramp(mid, .3, .7, .72, 1.10))
    c = g.scale(c, g.ramp(fine, .3, .7, .85, 1.12))
    c = g.scale(c, g.ramp(z, .0, .10, .45, 1.0))
    g.surface(g.principled(color=c, rough=.75, spec=.3))


# ------------------------------------------------------------------ houses
def _facade_dirt(g, c, z, place, strength=1.0):
    """Rain streaks, splash zone, blotches."""
    streak = g.noise(g.stretched(place, 2.6, 2.6, .12), 1.0, 2, .6)
    blotch = g.noise(place, .55, 2, .55)
    c = g.scale(c, g.ramp(streak, .42, .72, 1.03, 1.03 - .30 * strength))
    c = g.scale(c, g.ramp(blotch, .35, .70, 1.06, 1.06 - .20 * strength))
    splash = g.mul(g.ramp(g.add(z, g.mul(g.sub(blotch, .5), 1.4)), .0, 1.1, 1, 0), .55 * strength)
    return g.mix(splash, c, (.095, .085, .07)), streak, blotch


def _place(g):
    """Object coordinates, shifted per house so that no two share their stains."""
    k = g.mul(g.random(), 91.0)
    return g.offset(g.local(), g.vector(k, g.mul(k, 1.7), 0.0))


def _wall(g, kind):
    place, c = _place(g), g.colour()
    lx, ly, z = g.xyz(g.local())
    along = g.vector(g.add(lx, ly), z, 0.0)
    spec, rough, normal = .25, .85, None
    if kind == "reveal":
        c = g.scale(c, .92)
        g.surface(g.principled(color=c, rough=.85, spec=.2))
        return
    if kind == "brick":
        a, joint = g.brick(along, .25, .078, .010, g.scale(c, .74), g.scale(c, 1.22), (.34, .31, .28))
        tone = g.noise(g.stretched(along, 4.0, 12.8, 1), 1.0, 0)
        c = g.scale(a, g.ramp(tone, .3, .7, .82, 1.16))
        normal = g.bump(g.sub(1.0, joint), .35, .006)
    elif kind == "stone":
        a, joint = g.brick(along, .95, .44, .007, g.scale(c, .90), g.scale(c, 1.08), g.scale(c, .42))
        grain = g.noise(place, 14.0, 2, .6)
        c = g.scale(a, g.ramp(grain, .3, .7, .90, 1.07))
        normal = g.bump(g.sub(g.mul(grain, .3), joint), .4, .010)
    elif kind == "render":
        a, joint = g.brick(along, 2.4, 1.5, .008, c, g.scale(c, 1.03), g.scale(c, .45), 0.0)
        c, rough, spec = a, .70, .3
    else:
        grain = g.noise(place, 9.0, 2, .6)
        c = g.scale(c, g.ramp(grain, .3, .7, .965, 1.03))
        crumble = g.ramp(g.noise(place, .9, 3, .62), .655, .672)     # lost plaster here and there
        c = g.mix(g.mul(crumble, .55), c, g.scale(c, .58))
        normal = g.bump(grain, .10, .01)
    c, _, _ = _facade_dirt(g, c, z, place, .75 if kind == "brick" else (.8 if kind == "render" else 1.0))
    inputs = {"color": c, "rough": rough, "spec": spec}
    if normal is not None:
        inputs["normal"] = normal
    g.surface(g.principled(**inputs))


def _trim(g, images):
    place = _place(g)
    _, _, z = g.xyz(g.local())
    c = g.mix(g.ramp(g.random(), .3, .7), (.58, .55, .49), (.50, .49, .46))
    c = g.mix(.22, c, g.colour())
    streak = g.noise(g.stretched(place, 5.0, 5.0, .5), 1.0, 2, .6)
    c = g.scale(c, g.ramp(streak, .40, .72, 1.05, .66))
    up = g.xyz(g.normal())[2]
    c = g.scale(c, g.ramp(up, .3, .9, 1.0, .68))      # soot lies on what looks up
    g.surface(g.principled(color=c, rough=.8, spec=.25))


def _window(g, images):
    u, v, _ = g.xyz(g.uv())
    k = g.math("FLOOR", u)
    s = g.math("FRACT", u)
    k = g.add(k, g.math("FLOOR", g.mul(g.random(), 997.0)))
    r1, r2, r3 = g.white(k), g.white(g.add(k, 1013.3)), g.white(g.add(k, 2027.7))
    # Curtains at both sides, wider for some; folds by a sine; net curtains over the lower half.
    d = g.math("ABSOLUTE", g.sub(s, .5))
    width = g.ramp(r1, 0, 1, .48, .16)
    curtain = g.mul(g.ramp(d, width, g.add(width, .012)), g.math("GREATER_THAN", r2, .42))
    folds = g.ramp(g.math("SINE", g.mul(s, 95.0)), -1, 1, .45, 1.0)
    cloth = g.mix(r3, (.50, .46, .38), (.36, .38, .40))
    room = g.mix(g.ramp(v, 0, 1), (.012, .012, .013), (.030, .029, .028))
    warm = g.math("GREATER_THAN", r3, .86)
    room = g.mix(g.mul(warm, .8), room, (.22, .14, .06))
    c = g.mix(g.mul(curtain, .55), room, g.scale(cloth, folds))
    net = g.mul(g.math("LESS_THAN", r1, .22), g.ramp(v, .56, .55))
    c = g.mix(g.mul(net, .40), c, g.scale((.55, .55, .53), g.ramp(g.math("SINE", g.mul(s, 160.0)), -1, 1, .7, 1)))
    tilt = g.bump(g.noise(g.offset(g.local(), g.vector(g.mul(r1, 50), 0, 0)), .8, 0), .05, .05)
    g.surface(g.principled(color=c, rough=.03, spec=.9, normal=tilt))


def _roof_tile(g, images):
    lx, ly, z = g.xyz(g.local())
    warm = g.math("GREATER_THAN", g.random(), .5)
    c1 = g.mix(warm, (.085, .09, .10), (.27, .09, .05))
    a, joint = g.brick(g.vector(lx, g.mul(z, 1.3)), .24, .22, .012, c1, g.scale(c1, .72), g.scale(c1, .3))
    c = g.scale(a, g.ramp(g.noise(_place(g), .8, 3, .6), .3, .7, 1.1, .72))
    g.surface(g.principled(color=c, rough=.75, spec=.3))


def _awning(g, a, b):
    u, v, _ = g.xyz(g.uv())
    stripe = g.math("GREATER_THAN", g.math("FRACT", g.mul(u, .5)), .5)
    c = g.mix(stripe, a, b)
    c = g.scale(c, g.ramp(g.noise(g.local(), 1.8, 3, .6), .35, .75, 1.05, .72))
    g.surface(g.principled(color=c, rough=.85, spec=.15))


# ------------------------------------------------------------------ cars
def _car_paint(g, images):
    x, y, z = g.xyz(g.local())
    k = g.mul(g.random(), 57.0)
    n = g.noise(g.offset(g.local(), g.vector(k, k, k)), 2.2, 3, .65)
    dust = g.mul(g.ramp(z, .25, .70, .45, .0), g.ramp(n, .35, .70, .25, 1.0))
    up = g.xyz(g.normal())[2]
    dust = g.add(dust, g.mul(g.ramp(up, .5, .95, 0, .05), n))
    c = g.mix(dust, g.colour(), (.16, .14, .115))
    flake = g.math("GREATER_THAN", g.white(g.math("FLOOR", g.mul(g.random(), 977.0))), .35)
    g.surface(g.principled(color=c, metal=g.mul(flake, .40), rough=g.mix_value(dust, .34, .7), spec=.5, coat=g.ramp(dust, 0, .6, 1.0, .25), coat_rough=.018))


def _car_glass(g, images):
    x, y, z = g.xyz(g.local())
    n = g.noise(g.local(), 3.0, 2, .6)
    c = g.mix(g.ramp(n, .45, .8, 0, .35), (.010, .012, .013), (.045, .043, .040))
    g.surface(g.principled(color=c, rough=.02, spec=.85))


def _tail_lamp(g, images):
    x, y, z = g.xyz(g.local())
    rows = g.ramp(g.math("SINE", g.mul(z, 150.0)), -.3, .3, .55, 1.0)
    c = g.scale((.50, .008, .008), rows)
    g.surface(g.principled(color=c, rough=.08, spec=.8, emission=(.6, .01, .008), emission_strength=.22))


def _grille(g, images):
    x, y, z = g.xyz(g.local())
    bars = g.ramp(g.math("SINE", g.mul(z, 170.0)), -.2, .3)
    g.surface(g.principled(color=g.mix(bars, (.006, .006, .006), (.06, .06, .062)), rough=.35, spec=.5))


def _tyre(g, images):
    n = g.noise(g.local(), 6.0, 2)
    g.surface(g.principled(color=g.mix(n, (.014, .014, .014), (.045, .041, .036)), rough=.85, spec=.2))


def _rim(g, images):
    n = g.noise(g.local(), 5.0, 2)
    g.surface(g.principled(color=g.mix(g.ramp(n, .4, .8, 0, .5), (.50, .51, .52), (.15, .13, .11)), rough=.32, metal=.85, spec=.5))


def _object_paint(g, images):
    g.surface(g.principled(color=g.colour(), rough=.3, spec=.5, coat=.6, coat_rough=.08))


# ------------------------------------------------------------------ plants and people
def _leaf(g, images):
    r, t, _ = g.xyz(g.uv())
    c = g.scale(g.colour(), g.ramp(r, 0, 1, .62, 1.55))
    c = g.mix(g.math("GREATER_THAN", r, .93), c, g.mix(.5, g.colour(), (.30, .24, .03)))
    g.surface(g.principled(color=c, rough=.48, spec=.35))


def _bark(g, images):
    n = g.noise(g.stretched(g.local(), 9, 9, 1.6), 1.0, 3, .6)
    g.surface(g.principled(color=g.mix(g.ramp(n, .3, .7), (.055, .043, .032), (.19, .16, .125)), rough=.9, spec=.15, normal=g.bump(n, .5, .02)))


def _cloth(g, images, legs=False):
    k = g.white(g.math("FLOOR", g.mul(g.random(), 4999.0)))
    fold = g.noise(g.stretched(g.local(), 9, 9, 3.5), 1.0, 2)
    if legs:
        c = g.mix(g.math("GREATER_THAN", k, .5), (.028, .042, .085), (.055, .050, .046))
        c = g.mix(g.math("GREATER_THAN", k, .82), c, (.30, .26, .19))
    else:
        c = g.colour()
    c = g.scale(c, g.ramp(fold, .3, .7, .72, 1.15))
    g.surface(g.principled(color=c, rough=.85, spec=.15, sheen=.15, normal=g.bump(fold, .35, .03)))


def _skin(g, images):
    k = g.white(g.math("FLOOR", g.mul(g.random(), 3001.0)))
    c = g.mix(k, (.62, .38, .27), (.20, .095, .055))
    g.surface(g.principled(color=c, rough=.5, spec=.35))


def _flowers(g, images):
    n = g.noise(g.local(), 9.0, 0)
    c = g.mix(g.ramp(n, .42, .58), (.55, .03, .09), (.75, .42, .06))
    c = g.mix(g.math("GREATER_THAN", n, .60), c, (.06, .20, .04))
    g.surface(g.principled(color=c, rough=.7, spec=.2))


def _parasol(g, images):
    g.surface(g.principled(color=g.mix(.25, g.colour(), (.74, .71, .64)), rough=.85, spec=.15))


def _sign(g, images):
    c, _ = g.image(images["atlas"], g.uv(), clip=False)
    c = g.scale(c, g.ramp(g.noise(g.local(), 3.0, 2), .4, .8, 1.0, .82))
    g.surface(g.principled(color=c, rough=.40, spec=.35))


_SPECIAL = {"asphalt": _road, "pavement": _pavement, "kerb": _kerb, "trim": _trim, "window": _window, "roof_tile": _roof_tile, "car_paint": _car_paint,
            "car_glass": _car_glass, "tail_lamp": _tail_lamp, "car_grille": _grille, "tyre": _tyre, "rim": _rim, "bike_paint": _object_paint, "leaf": _leaf, "bark": _bark,
            "cloth_top": _cloth, "cloth_legs": lambda g, i: _cloth(g, i, True), "skin": _skin, "flowers": _flowers, "parasol": _parasol, "sign_atlas": _sign}

