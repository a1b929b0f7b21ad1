# SPDX-License-Identifier: Apache-2.0
"""Turns a set's EXR files into the small JPEG and palette PNG pictures of the report.

Colours are linear in the set and sRGB here. Masks are palette PNGs with transparency that the page
lays over a photograph, so that no photograph is stored twice.
"""
import base64
import io

import numpy as np
from PIL import Image

from report import fills
from report.read_set import read_channels, refuse

# Okabe and Ito's colour-blind-safe palette; style.css and the charts use the same values.
COLOURS = {"occluded": (213, 94, 0), "outside": (86, 180, 233), "unknown": (240, 228, 66), "unseen": (255, 255, 255),
           "true_positive": (0, 158, 115), "false_positive": (213, 94, 0), "false_negative": (86, 180, 233),
           "undecided": (240, 228, 66)}
HOLE = (214, 51, 132)  # --hole of report.css
MASK_CHANNELS = ("lost", "occluded", "outside", "unknown", "unseen")
DIFFERENCE_FULL_SCALE = 0.25
INFERNO = np.array([[0, 0, 4], [40, 11, 84], [101, 21, 110], [159, 42, 99], [212, 72, 66],
                    [245, 125, 21], [250, 193, 39], [252, 255, 164]], float)


def srgb8(linear):
    """Linear light as 8-bit sRGB; NaN is black, what is above white is white."""
    linear = np.clip(np.nan_to_num(linear, nan=0.0, posinf=1.0, neginf=0.0), 0, 1)
    return (np.where(linear <= .0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - .055) * 255 + .5).astype(np.uint8)


def fit(array, width, smooth):
    """The picture no wider than `width`: photographs by area, masks by nearest pixel."""
    h, w = array.shape[:2]
    if w <= width:
        return array
    return np.asarray(Image.fromarray(array).resize((width, max(1, round(h * width / w))), Image.BOX if smooth else Image.NEAREST))


def jpeg(rgb8, quality=84):
    """JPEG bytes."""
    out = io.BytesIO()
    Image.fromarray(rgb8).save(out, "JPEG", quality=quality, optimize=True, progressive=True)
    return out.getvalue()


def palette_png(index, colours):
    """A palette PNG of `index` (0 is clear); `colours` are (r, g, b, a) of 1, 2, ..."""
    table = [(0, 0, 0, 0)] + list(colours)
    image = Image.fromarray(index.astype(np.uint8), "P")
    image.putpalette([v for c in table for v in c[:3]])
    out = io.BytesIO()
    image.save(out, "PNG", optimize=True, transparency=bytes(c[3] for c in table))
    return out.getvalue()


def mask_index(mask):
    """Overlay of a mask: 1 occluded, 2 outside, 3 unknown, 4 unseen (hatched, with its outline)."""
    lost, occluded, outside, unknown, unseen = (mask[:, :, i] > .5 for i in range(5))
    y, x = np.indices(unseen.shape)
    plain = unseen & ~(occluded | outside | unknown)
    pad = np.pad(plain, 1, mode="edge")
    inner = pad[:-2, 1:-1] & pad[2:, 1:-1] & pad[1:-1, :-2] & pad[1:-1, 2:]
    step = max(6, unseen.shape[1] // 60)
    index = np.where(plain & ((np.mod(x + y, step) == 0) | ~inner), 4, 0)
    return np.select([unknown, outside, occluded], [3, 2, 1], index)


def mask_colours(alpha=150):
    """The palette of mask_index."""
    return [(*COLOURS["occluded"], alpha), (*COLOURS["outside"], alpha), (*COLOURS["unknown"], alpha), (*COLOURS["unseen"], 210)]


def error_index(lost, unknown, truth):
    """1 true positive, 2 false positive, 3 false negative, 4 unknown and truly lost, 5 unknown and not."""
    return np.select([lost & truth, lost & ~truth, unknown & truth, unknown, truth], [1, 2, 4, 5, 3], 0)


def error_colours():
    """The palette of error_index."""
    names = ("true_positive", "false_positive", "false_negative")
    return [(*COLOURS[n], 225) for n in names] + [(*COLOURS["undecided"], 235), (*COLOURS["undecided"], 90)]


def difference(a8, b8, hole):
    """Absolute difference of two sRGB pictures, worst channel, as colours; holes are grey."""
    worst = np.abs(a8.astype(float) - b8).max(2) / 255 / DIFFERENCE_FULL_SCALE
    at = np.clip(worst, 0, 1) * (len(INFERNO) - 1)
    low = np.minimum(at.astype(int), len(INFERNO) - 2)
    rgb = INFERNO[low] + (INFERNO[low + 1] - INFERNO[low]) * (at - low)[:, :, None]
    rgb[hole] = (120, 124, 130)
    return (rgb + .5).astype(np.uint8)


def photo8(data, relative, camera):
    """A view as 8-bit sRGB, or None. A view whose depth was cast but never rendered is its depth in grey."""
    item = data["manifest"]["items"].get(relative, {})
    if item.get("rendered", True):
        rgb = read_channels(data, relative, camera, ("R", "G", "B"))
        return None if rgb is None else srgb8(rgb)
    z = read_channels(data, relative, camera, ("Z",))
    if z is None:
        return None
    with np.errstate(divide="ignore", invalid="ignore"):
        near = np.where(z > 0, np.clip(1 - np.log(z) / np.log(200), 0, 1), 0)
    return (np.repeat(near, 3, 2) * 225 + 15).astype(np.uint8)


def bleed(rgb8, hole, steps=3):
    """Colours grown a few pixels into the holes, so that no dark seam shows where the page paints them."""
    rgb, empty = rgb8.astype(np.float32), hole.copy()
    for _ in range(steps):
        weight = np.pad((~empty).astype(np.float32), 1)[:, :, None]
        value = np.pad(rgb, ((1, 1), (1, 1), (0, 0))) * weight
        around = ((slice(None, -2), slice(1, -1)), (slice(2, None), slice(1, -1)), (slice(1, -1), slice(None, -2)), (slice(1, -1), slice(2, None)))
        total, count = sum(value[a] for a in around), sum(weight[a] for a in around)
        grow = empty & (count[:, :, 0] > 0)
        rgb[grow] = (total / np.maximum(count, 1))[grow]
        empty &= ~grow
    rgb[empty] = HOLE
    return rgb.astype(np.uint8)


class Store:
    """Pictures as base64 texts, numbered; equal pictures are kept once."""

    def __init__(self):
        self.pictures, self.known, self.bytes = [], {}, 0

    def add(self, content, kind):
        """The number of a picture; `kind` is jpeg or png."""
        if content not in self.known:
            text = f"data:image/{kind};base64," + base64.b64encode(content).decode()
            self.known[content] = len(self.pictures)
            self.pictures.append(text)
            self.bytes += len(text)
        return self.known[content]


def paths(data, shift, frame, camera):
    """Where the pictures of one camera against one shift lie, relative to the set."""
    tail = f"{shift}/{frame:04d}/{camera}.exr"
    return {"shifted": f"shifts/{tail}", "truth": f"truth/{tail}",
            **{f"{kind}.{m}": f"{kind}/{m}/{tail}" for kind in ("masks", "holes", "warps") for m in data["methods"]}}


def read_view(data, shift, frame, camera, method):
    """All that one method said of one camera against one shift, as arrays; what does not exist is None.

    A scored view must have its mask. Raises ReportError.
    """
    where = paths(data, shift, frame, camera)
    out = {"mask": read_channels(data, where[f"masks.{method}"], camera, MASK_CHANNELS),
           "holes": read_channels(data, where[f"holes.{method}"], camera, ("hole", "disoccluded", "outside")),
           "warp": read_channels(data, where[f"warps.{method}"], camera, ("R", "G", "B", "hole"))}
    if out["mask"] is None and (method, shift, frame, camera) in data["scored"]:
        refuse(where[f"masks.{method}"], "file", "nothing", "the mask that scores.json speaks of")
    return out


def count_errors(index):
    """Pixels of each kind of an error_index."""
    n = np.bincount(index.reshape(-1), minlength=6)
    return {"tp": int(n[1]), "fp": int(n[2]), "fn": int(n[3]), "ul": int(n[4]), "uv": int(n[5])}


def add_method(data, store, shift, frame, camera, method, truth, shifted8, width):
    """Pictures of one method: dict of picture numbers and counts."""
    got, out = read_view(data, shift, frame, camera, method), {}
    if got["mask"] is not None:
        mask = got["mask"]
        out["mask"] = store.add(palette_png(fit(mask_index(mask).astype(np.uint8), width, False), mask_colours()), "png")
        out["share"] = {k: float((mask[:, :, i] > .5).mean()) for i, k in enumerate(MASK_CHANNELS)}
        if truth is not None:
            lost, unknown = mask[:, :, 0] > .5, mask[:, :, 3] > .5
            outside = truth[:, :, 2] > .5
            shell = outside | (truth[:, :, 3 if method == "self" else 4] > .5)
            for against, true in (("scene", truth[:, :, 0] > .5), ("shell", shell)):
                index = error_index(lost, unknown, true)
                out["error_" + against] = store.add(palette_png(fit(index.astype(np.uint8), width, False), error_colours()), "png")
                out["counts_" + against] = count_errors(index)
    if got["warp"] is not None:
        warp8, hole = srgb8(got["warp"][:, :, :3]), got["warp"][:, :, 3] > .5
        out["warp"] = store.add(jpeg(fit(bleed(warp8, hole), width, True)), "jpeg")
        out["hole"] = store.add(palette_png(fit(hole.astype(np.uint8), width, False), [(255, 255, 255, 255)]), "png")
        out["hole_share"] = float(hole.mean())
        if shifted8 is not None:
            out["difference"] = store.add(jpeg(fit(difference(warp8, shifted8, hole), width, True), 80), "jpeg")
    if got["holes"] is not None:
        hole, behind, outside = (got["holes"][:, :, i] > .5 for i in range(3))
        index = np.select([outside, behind, hole], [2, 1, 3], 0)
        out["holes"] = store.add(palette_png(fit(index.astype(np.uint8), width, False), mask_colours(185)), "png")
        out["holes_share"] = {"disoccluded": float(behind.mean()), "outside": float(outside.mean())}
    return out


def add_fills(data, store, shift, frame, camera, width):
    """Filled views of one camera: {arm: {"picture": number, "psnr": {region: dB}}}."""
    psnr, out = fills.view_scores(data["scores"], shift, frame, camera), {}
    for arm in fills.picture_arms(data["scores"]):
        rgb = read_channels(data, f"fills/{arm}/{shift}/{frame:04d}/{camera}.exr", camera, ("R", "G", "B"))
        if rgb is not None:
            out[arm] = {"picture": store.add(jpeg(fit(srgb8(rgb), width, True)), "jpeg"), "psnr": psnr.get(arm, {})}
    return out


def add_frame(data, store, frame, width, with_fills=False):
    """Pictures of one frame: {"CAMERA": {"recorded": n}, "CAMERA|SHIFT": {"shifted": n, "method": {...}}}."""
    out = {}
    items = data["manifest"]["items"]
    for camera in data["cameras"]:
        photo = photo8(data, f"frames/{frame:04d}/{camera}.exr", camera)
        out[camera] = {"recorded": None if photo is None else store.add(jpeg(fit(photo, width, True)), "jpeg")}
        for shift in data["shifts"]:
            where = paths(data, shift, frame, camera)
            view = {}
            item = items.get(where["shifted"], {})
            if item.get("status") in ("refused", "planned"):
                view["why"] = item["status"] + (": " + str(item["reason"]) if item.get("reason") else "")
            if item.get("moved_to"):
                view["moved"] = "moved to " + ", ".join(map(str, item["moved_to"])) + " m"
            shifted8 = photo8(data, where["shifted"], camera)
            if shifted8 is not None:
                view["shifted"] = store.add(jpeg(fit(shifted8, width, True)), "jpeg")
            truth = read_channels(data, where["truth"], camera, ("lost", "occluded", "outside", "shell_self", "shell_rig"))
            for method in data["methods"]:
                view[method] = add_method(data, store, shift, frame, camera, method, truth, shifted8, width)
            if with_fills:
                view["fills"] = add_fills(data, store, shift, frame, camera, width)
            out[f"{camera}|{shift}"] = view
    return out


def spread(frames):
    """Frames in the order in which to embed them: first, last, then halves of the gaps."""
    frames = list(frames)
    order, gaps = [frames[0], frames[-1]][:len(frames)], [(0, len(frames) - 1)]
    while gaps:
        a, b = gaps.pop(0)
        if b - a > 1:
            middle = (a + b) // 2
            order.append(frames[middle])
            gaps += [(a, middle), (middle, b)]
    return order


def embed(data, max_bytes, max_frames, width):
    """Pictures of as many frames as fit: (pictures, views by frame, width used). At least one frame."""
    order = spread(data["frames"])[:max_frames]
    while True:
        store, views = Store(), {}
        views[order[0]] = add_frame(data, store, order[0], width, with_fills=True)
        if store.bytes <= max_bytes or width <= 240:
            break
        width = max(240, int(width * .75))
    for frame in order[1:]:
        if store.bytes * (len(views) + 1) / len(views) > max_bytes:
            break
        views[frame] = add_frame(data, store, frame, width)
    return store.pictures, {f: views[f] for f in sorted(views)}, width
