# SPDX-License-Identifier: Apache-2.0
"""The picture strip: recorded, mask, warp and the real render of one camera, good enough for a README."""
import io

import numpy as np
from matplotlib import font_manager
from PIL import Image, ImageDraw, ImageFont

from report import pictures, pool
from report.read_set import refuse

WIDTH, GAP, TOP, BOTTOM = 1600, 8, 30, 34
PAPER, INK, SOFT = (255, 255, 255), (25, 30, 36), (92, 101, 112)


def font(size, bold=False):
    """The sans-serif font that matplotlib carries."""
    path = font_manager.findfont(font_manager.FontProperties(family="DejaVu Sans", weight="bold" if bold else "normal"))
    return ImageFont.truetype(path, size)


def choose(data, camera, shift, method):
    """Camera, shift and method of the strip: as asked, or the first that exists and lies nearest to 2 m."""
    cameras = [camera] if camera else sorted(data["cameras"], key=lambda c: c != "CAM_FRONT")
    if camera and camera not in data["cameras"]:
        refuse("set.vshift", "--strip-camera", camera, "one of " + ", ".join(data["cameras"][:8]))
    if shift and shift not in data["shifts"]:
        refuse("manifest.json", "--strip-shift", shift, "one of " + ", ".join(data["shifts"][:8]))
    size = {s["name"]: float(np.linalg.norm(s["shift"])) for s in data["manifest"]["shifts"]}
    shifts = [shift] if shift else sorted(data["shifts"], key=lambda n: abs(size[n] - 2))
    frame = data["frames"][0]
    for c in cameras:
        for s in shifts:
            for m in [method] if method else data["methods"]:
                where = pictures.paths(data, s, frame, c)
                ready = (where["shifted"], f"masks/{m}/{s}/{frame:04d}/{c}.exr", f"warps/{m}/{s}/{frame:04d}/{c}.exr")
                if all((data["folder"] / p).exists() and data["manifest"]["items"].get(p, {"status": "done"})["status"] == "done" for p in ready):
                    return c, s, m
    refuse("manifest.json", "items", "no such view", "a camera with shifted view, mask and warp for the strip")


def lay_over(rgb8, index, colours):
    """A photograph with the palette overlay drawn on it."""
    table = np.array([(0, 0, 0, 0)] + list(colours), float)[index]
    alpha = table[:, :, 3:] / 255
    return (rgb8 * (1 - alpha) + table[:, :, :3] * alpha + .5).astype(np.uint8)


def strip(data, camera=None, shift=None, method=None, columns=4, jpeg=False):
    """PNG (or JPEG) bytes of the strip: four panels, `columns` of them side by side."""
    camera, shift, method = choose(data, camera, shift, method)
    frame = data["frames"][0]
    recorded8 = pictures.photo8(data, f"frames/{frame:04d}/{camera}.exr", camera)
    real8 = pictures.photo8(data, f"shifts/{shift}/{frame:04d}/{camera}.exr", camera)
    got = pictures.read_view(data, shift, frame, camera, method)
    if recorded8 is None:
        refuse(f"frames/{frame:04d}/{camera}.exr", "file", "nothing", "the recorded view")
    index = pictures.mask_index(got["mask"])
    warp8 = pictures.srgb8(got["warp"][:, :, :3])
    warp8[got["warp"][:, :, 3] > .5] = pictures.HOLE
    how = pool.shift_label(next(s for s in data["manifest"]["shifts"] if s["name"] == shift))
    whose = {"self": "its own depth", "rig": "the whole rig's depth"}[method]
    chips = {k: pictures.COLOURS[k] for k, v in (("occluded", 1), ("outside", 2), ("unknown", 3)) if (index == v).any()}
    panels = [("Recorded", recorded8, camera, {}),
              ("Mask", lay_over(recorded8, index, pictures.mask_colours(165)), "hatched: unseen" if (index == 4).any() else "", chips),
              ("Warp", warp8, f"from {whose}", {"hole": pictures.HOLE}),
              ("Truth", real8, "the real render from there", {})]
    each = (WIDTH - GAP * (columns - 1)) // columns
    high = max(1, round(each * recorded8.shape[0] / recorded8.shape[1]))
    row_high = TOP + high + BOTTOM
    out = Image.new("RGB", (WIDTH, row_high * -(-len(panels) // columns)), PAPER)
    draw = ImageDraw.Draw(out)
    heads = {"Mask": f"Lost after a shift of {how}", "Warp": f"Seen from {how}", "Truth": f"Rendered {how}"}
    for i, (title, picture, note, legend) in enumerate(panels):
        x, top = i % columns * (each + GAP), i // columns * row_high
        way = Image.BOX if picture.shape[1] >= each else Image.BICUBIC
        out.paste(Image.fromarray(picture).resize((each, high), way), (x, top + TOP))
        draw.text((x, top + 4), heads.get(title, title), INK, font(16, True))
        at, low = x, top + TOP + high + 8
        for name, colour in legend.items():
            draw.rectangle((at, low + 2, at + 13, low + 15), colour)
            draw.text((at + 19, low - 1), name, SOFT, font(13))
            at += 19 + draw.textlength(name, font(13)) + 11
        draw.text((at, low - 1), note, SOFT, font(13))
    content = io.BytesIO()
    out.save(content, **({"format": "JPEG", "quality": 88} if jpeg else {"format": "PNG", "optimize": True}))
    return content.getvalue()
