# SPDX-License-Identifier: CC0-1.0
"""Where each sign lies in the sign texture, a square of ATLAS_SIZE pixels.

`uv_rect(name)` gives ((u0, v0), (u1, v1)), v up. signs.py paints the texture.
"""
ATLAS_SIZE = 2048


def _layout():
    r = {}
    for k in range(24):                                   # fascia boards, 2 columns of 12
        r["shop%d" % k] = (1024 * (k % 2), 128 * (k // 2), 1024, 128)
    names = ["stop", "no_entry", "limit30", "priority", "crossing", "parking", "no_parking", "turn_right"]
    for k, n in enumerate(names):
        r[n] = (128 * k, 1536, 128, 128)
    for k in range(8):
        r["plate%d" % k] = (1024 + 256 * (k % 4), 1536 + 64 * (k // 4), 256, 64)
    for k in range(8):                                    # round or square hanging signs
        r["blade%d" % k] = (128 * k, 1664, 128, 128)
    for k in range(4):
        r["street%d" % k] = (1024 + 256 * k, 1664, 256, 64)
    for k in range(2):
        r["number%d" % k] = (1024 + 512 * k, 1728, 512, 64)
    for k in range(8):                                    # posters
        r["poster%d" % k] = (192 * k, 1792, 192, 256)
    for k in range(2):                                    # bus side banners
        r["ad%d" % k] = (1536, 1792 + 128 * k, 512, 128)
    return r


RECTS_PX = _layout()
ROUND = {"no_entry", "limit30", "no_parking", "turn_right"}


def uv_rect(name):
    """((u0, v0), (u1, v1)) of a sign, half a pixel inside its rectangle, v up."""
    x, y, w, h = RECTS_PX[name]
    s = ATLAS_SIZE
    return ((x + .5) / s, 1 - (y + h - .5) / s), ((x + w - .5) / s, 1 - (y + .5) / s)
