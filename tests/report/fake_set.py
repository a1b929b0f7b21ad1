# SPDX-License-Identifier: Apache-2.0
"""A small benchmark set made without Blender: a street of boxes seen by a numpy ray caster.

The masks, holes and warps are plausible answers with invented errors; the truth and the scores are
computed from the same rays. Only for developing and testing the report:
    /usr/bin/python3 tests/report/fake_set.py SET_DIR [--cameras 6] [--shifts 6] [--frames 1] [--width 400]
"""
import argparse
import hashlib
import json
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

INF = np.float32(np.inf)
RIG = {"CAM_FRONT": 0, "CAM_FRONT_LEFT": 55, "CAM_FRONT_RIGHT": -55,
       "CAM_BACK": 180, "CAM_BACK_LEFT": 110, "CAM_BACK_RIGHT": -110}


def shift_name(shift, yaw_deg=0.0):
    """The folder name of a shift, as docs/set_layout.md gives it."""
    return "x%+.2f_y%+.2f_z%+.2f_yaw%+.2f" % (*shift, yaw_deg)


def street(seed):
    """Boxes (n, 2, 3) in world metres and their colours: houses on both sides, cars, poles."""
    rng = np.random.default_rng(seed)
    boxes, colours = [], []

    def add(x, y, z, sx, sy, sz, colour):
        boxes.append([[x - sx / 2, y - sy / 2, z], [x + sx / 2, y + sy / 2, z + sz]])
        colours.append(colour)

    for side in (-1, 1):
        x = -60.0
        while x < 90:
            length = rng.uniform(9, 18)
            add(x + length / 2, side * rng.uniform(14, 16), 0, length - .6, 9, rng.uniform(7, 16),
                rng.uniform(.25, .6) * np.array([1, .9, .8]))
            x += length
        for x in np.arange(-40, 60, 9.0):
            add(x + rng.uniform(-2, 2), side * rng.uniform(5.4, 6.4), .25, 4.3, 1.8, 1.35, rng.uniform(.03, .7, 3))
            add(x + 4, side * 8.2, 0, .25, .25, rng.uniform(3, 6), np.array([.12, .2, .1]))
    for x in (14, -13, 26):
        add(x, rng.uniform(-2, 2), .25, 4.4, 1.9, 1.4, rng.uniform(.05, .8, 3))
    return np.array(boxes), np.array(colours)


def cast(origin, direction, boxes):
    """Nearest hit of rays (n,3): t (inf for none), box index (-1 ground, -2 sky), normal axis."""
    n = direction.shape[0]
    origin = np.broadcast_to(origin, direction.shape)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.where(direction[:, 2] < -1e-9, -origin[:, 2] / direction[:, 2], np.inf)
        inverse = 1.0 / direction
    t = np.where(t > 1e-6, t, np.inf)
    which, axis = np.where(np.isfinite(t), -1, -2), np.full(n, 2)
    for k, (low, high) in enumerate(boxes):
        with np.errstate(invalid="ignore"):
            a, b = (low - origin) * inverse, (high - origin) * inverse
        near, far = np.minimum(a, b), np.maximum(a, b)
        enter, leave = near.max(1), far.min(1)
        hit = (enter < leave) & (enter > 1e-6) & (enter < t)
        t, which = np.where(hit, enter, t), np.where(hit, k, which)
        axis = np.where(hit, near.argmax(1), axis)
    return t, which, axis


def colour(point, which, axis, direction, colours):
    """Linear colour of hits: lit boxes with windows, a road with lane marks, a plain sky."""
    out = np.empty((len(which), 3))
    sky, road = which == -2, which == -1
    up = np.clip(direction[:, 2:3], 0, 1)
    out[:] = (1 - up) * [.75, .85, 1.0] + up * [.15, .35, .8]
    lane = (np.abs(np.abs(point[:, 1]) - 3.4) < .08) & (np.mod(point[:, 0], 6) < 3)
    grain = .03 * np.sin(point[:, 0] * 7) * np.sin(point[:, 1] * 9)
    ground = np.where(lane, .7, np.where(np.abs(point[:, 1]) > 7.4, .3, .13)) + grain
    out[road] = ground[road, None]
    box = ~sky & ~road
    shade = np.array([.75, .5, 1.0])[axis]
    window = (np.mod(point[:, 0] + point[:, 1], 2.6) < 1.1) & (np.mod(point[:, 2], 3) > 1.3) & (axis < 2)
    shade = np.where(window, shade * .35, shade)
    out[box] = colours[which[box]] * shade[box, None]
    return np.clip(out, 0, None)


class View:
    """One camera at one place: the rays it shoots and what they hit."""

    def __init__(self, yaw_deg, centre, width, height):
        yaw = np.radians(yaw_deg)
        self.axes = np.array([[np.sin(yaw), -np.cos(yaw), 0], [0, 0, -1], [np.cos(yaw), np.sin(yaw), 0]])
        self.centre, self.width, self.height = np.asarray(centre, float), width, height
        self.f = width * 0.7914
        y, x = np.mgrid[0:height, 0:width] + .5
        self.rays = np.stack([(x - width / 2) / self.f, (y - height / 2) / self.f, np.ones_like(x)], -1).reshape(-1, 3) @ self.axes

    def render(self, boxes, colours):
        """Fill z, point, rgb, which, axis."""
        self.z, self.which, self.axis = cast(self.centre, self.rays, boxes)
        self.point = self.centre + self.rays * np.where(np.isfinite(self.z), self.z, 1e4)[:, None]
        unit = self.rays / np.linalg.norm(self.rays, axis=1, keepdims=True)
        self.rgb = colour(self.point, self.which, self.axis, unit, colours)
        return self

    def project(self, point):
        """Pixel index (int, clipped) and whether the point is inside the frame."""
        p = (point - self.centre) @ self.axes.T
        with np.errstate(divide="ignore", invalid="ignore"):
            u, v = p[:, 0] / p[:, 2] * self.f + self.width / 2, p[:, 1] / p[:, 2] * self.f + self.height / 2
        inside = (p[:, 2] > 0) & (u >= 0) & (u < self.width) & (v >= 0) & (v < self.height)
        index = np.where(inside, v, 0).astype(int) * self.width + np.where(inside, u, 0).astype(int)
        return index, inside

    def sees(self, point, boxes):
        """Whether nothing stands between the centre and each point."""
        t, _, _ = cast(self.centre, point - self.centre, boxes)
        return t > 1 - 1e-3


def write_exr(path, channels, width, height):
    """Channels: dict of name to flat array; R, G, B are stored as half."""
    path.parent.mkdir(parents=True, exist_ok=True)
    spec = oiio.ImageSpec(width, height, len(channels), oiio.FLOAT)
    spec.channelnames = tuple(channels)
    spec.channelformats = tuple(oiio.HALF if n in "RGB" else oiio.FLOAT for n in channels)
    spec.attribute("compression", "zip")
    pixels = np.stack([np.asarray(a, np.float32).reshape(height, width) for a in channels.values()], -1)
    out = oiio.ImageOutput.create(str(path))
    assert out.open(str(path), spec) and out.write_image(np.ascontiguousarray(pixels)), oiio.geterror()
    out.close()


def read_exr(path):
    """Dict of name to (height, width) array."""
    image = oiio.ImageInput.open(str(path))
    names, pixels = image.spec().channelnames, image.read_image(oiio.FLOAT)
    image.close()
    return {n: pixels[..., i] for i, n in enumerate(names)}


def ratios(got, truth, width):
    """Counts, ratios and boundary F1 of a mask against truth."""
    tp, fp, fn = int((got & truth).sum()), int((got & ~truth).sum()), int((~got & truth).sum())
    share = lambda a, b: 1.0 if b == 0 else a / b
    row = {"true_positive": tp, "false_positive": fp, "false_negative": fn, "true_negative": int((~got & ~truth).sum()),
           "iou": share(tp, tp + fp + fn), "precision": share(tp, tp + fp), "recall": share(tp, tp + fn),
           "f1": share(2 * tp, 2 * tp + fp + fn)}
    edges = []
    for mask in (got, truth):
        pad = np.pad(mask.reshape(-1, width), 1, mode="edge")
        edges.append(pad[1:-1, 1:-1] & ~(pad[:-2, 1:-1] & pad[2:, 1:-1] & pad[1:-1, :-2] & pad[1:-1, 2:]))
    grown, row["boundary_f1"] = [e.copy() for e in edges], {}
    for px in range(1, 5):
        grown = [np.pad(e, 1) for e in grown]
        grown = [e[1:-1, 1:-1] | e[:-2, 1:-1] | e[2:, 1:-1] | e[1:-1, :-2] | e[1:-1, 2:] for e in grown]
        if px != 3:
            p, r = (share((edges[i] & grown[1 - i]).sum(), edges[i].sum()) for i in (0, 1))
            row["boundary_f1"][str(px)] = float(0 if p + r == 0 else 2 * p * r / (p + r))
    return row


def srgb(linear):
    """Display-referred colour in 0..1."""
    linear = np.clip(linear, 0, 1)
    return np.where(linear <= .0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - .055)


def smooth_noise(rng, width, height):
    """Blotches in 0..1, so that invented errors look like patches and not like salt."""
    coarse = rng.random((height // 6 + 2, width // 6 + 2))
    return np.kron(coarse, np.ones((6, 6)))[:height, :width].reshape(-1)


def make_set(folder, cameras=6, shifts=((0, 1, 0), (0, -1, 0), (0, 2, 0), (0, -2, 0), (0, 4, 0), (0, -4, 0)),
             frames=1, width=400, height=225, refuse=(), seed=1):
    """Write a whole set; `refuse` lists (shift index, camera index) pairs that the set refuses."""
    folder, rng = Path(folder), np.random.default_rng(seed)
    boxes, colours = street(seed)
    names = list(RIG)[:cameras]
    shift_names = [shift_name(s) for s in shifts]
    items, size = {}, (width, height)
    scores = {"vshift_scores": 1, "vshift": "0.1.0", "set": "set.vshift", "cores": 2,
              "masks": [], "certificates": [], "holes": [], "warps": [], "times": []}

    def store(relative, channels, kind):
        path = folder / relative
        write_exr(path, channels, *size)
        items[relative] = {"kind": kind, "status": "done", "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
                           "bytes": path.stat().st_size, "seconds": round(float(rng.uniform(3, 5)), 2)}

    for frame in range(frames):
        ego = np.array([1.5 * frame, 0, 1.5])
        rig = {n: View(RIG[n], ego, *size).render(boxes, colours) for n in names}
        for index, name in enumerate(names):
            r = rig[name]
            store(f"frames/{frame:04d}/{name}.exr", {"R": r.rgb[:, 0], "G": r.rgb[:, 1], "B": r.rgb[:, 2], "Z": r.z}, "recorded")
            for s, shift in enumerate(shifts):
                where = f"{shift_names[s]}/{frame:04d}/{name}.exr"
                if (s, index) in refuse:
                    items[f"shifts/{where}"] = {"kind": "shifted", "status": "refused",
                                                "reason": "the camera lands in car_012 (clearance 0.12 m < 0.30 m)"}
                    continue
                v = View(RIG[name], ego + shift, *size).render(boxes, colours)
                one_pair(store, scores, r, v, rig, boxes, rng, where,
                         {"shift": shift_names[s], "frame": frame, "camera": name}, list(shift))
    recipe = {"vshift": 1, "cameras": [{"name": n, "width": width, "height": height,
                                        "intrinsic": [[r.f, 0, width / 2], [0, r.f, height / 2], [0, 0, 1]],
                                        "rotation": [1, 0, 0, 0], "translation": [0, 0, 1.5],
                                        "image": f"frames/%04d/{n}.exr", "depth": f"frames/%04d/{n}.exr"} for n in names],
              "frames": [{"index": f, "timestamp_s": .1 * f, "rotation": [1, 0, 0, 0], "translation": [1.5 * f, 0, 0]} for f in range(frames)]}
    manifest = {"vshift_manifest": 1, "versions": {"vshift": "0.1.0", "blender": "3.4.1", "python": "3.11.2", "embree": "3.13.5"},
                "machine": {"cores": 2, "cpu": "a made-up processor"},
                "street": {"seed": seed, "detail": 2, "length_m": 150.0, "traffic": 1.0,
                           "geometry_hash": hashlib.sha256(boxes.tobytes()).hexdigest(), "triangles": 12 * len(boxes) + 2},
                "render": {"width": width, "height": height, "samples": 16},
                "conventions": {"camera_frame": "x right, y down, z forward", "pixel_centre": 0.5, "depth": "planar z, metres, +inf sky"},
                "shifts": [{"name": n, "shift": list(s), "yaw_deg": 0} for n, s in zip(shift_names, shifts)], "items": items}
    (folder / "scores").mkdir(exist_ok=True)
    for path, data in (("set.vshift", recipe), ("manifest.json", manifest), ("scores/scores.json", scores)):
        (folder / path).write_text(json.dumps(data, indent=1))
    return folder


def one_pair(store, scores, r, v, rig, boxes, rng, where, key, shift):
    """Truth, invented answers and scores of one camera against one shift."""
    width, height = r.width, r.height
    pick, inside = v.project(r.point)
    t, _, _ = cast(v.centre, r.point - v.centre, boxes)
    hidden = (t < 1 - 1e-3) & inside
    blocker = v.centre + (r.point - v.centre) * np.where(hidden, t, 1)[:, None]
    in_sight = hidden & r.sees(blocker, boxes)  # every camera of this rig has the same centre
    outside, sky = ~inside, r.which == -2
    shell_self = in_sight & r.project(blocker)[1]
    shell_rig = in_sight & np.any([c.project(blocker)[1] for c in rig.values()], 0)
    lost = outside | hidden
    store(f"truth/{where}", {"lost": lost, "occluded": hidden, "outside": outside, "sky": sky, "shell_self": shell_self,
                             "shell_rig": shell_rig, "faces_away": np.zeros_like(sky),
                             "foliage": np.arange(width * height) // width % 3 == 0}, "truth")
    index, in_r = r.project(v.point)
    seen = in_r & r.sees(v.point, boxes)
    cls = np.where(v.which == -2, 4, np.where(seen, 0, np.where(in_r, 1, 2)))
    store(f"shifts/{where}", {"R": v.rgb[:, 0], "G": v.rgb[:, 1], "B": v.rgb[:, 2], "Z": v.z, "truth.class": cls,
                              "truth.source": np.where(seen, 0, -1)}, "shifted")
    z = np.where(np.isfinite(r.z), r.z, 200).reshape(height, width)
    edge = (np.abs(np.gradient(1 / z)[0]) + np.abs(np.gradient(1 / z)[1]) > .004).reshape(-1)
    for method, shell in (("self", shell_self), ("rig", shell_rig)):
        blot = smooth_noise(rng, width, height)
        wrong = edge & (blot > (.8 if method == "self" else .9))
        occluded = (shell ^ (wrong & inside)) & inside
        unknown = inside & ~occluded & (hidden | (edge & (blot < .2)))
        unseen = inside & ~occluded & ~unknown & (np.abs(np.arange(r.z.size) % width - width / 2) > width * (.40 if method == "self" else .48))
        got = {"lost": occluded | outside, "occluded": occluded, "outside": outside, "unknown": unknown, "unseen": unseen}
        store(f"masks/{method}/{where}", got, "mask")
        for name in ("lost", "occluded", "outside"):
            for against in ("scene", "shell"):
                truth = {"lost": outside | (hidden if against == "scene" else shell), "outside": outside,
                         "occluded": hidden if against == "scene" else shell}[name]
                scores["masks"].append({"method": method, **key, "shift_m": shift, "class": name, "against": against,
                                        **ratios(got[name], truth, width)})
        visible = inside & ~occluded & ~unknown
        scores["certificates"].append({"method": method, **key, "pixels": int(lost.size), "occluded": int(occluded.sum()),
                                       "occluded_wrong": int((occluded & ~hidden).sum()),
                                       "visible_certain": int((visible & ~unseen).sum()),
                                       "visible_wrong": int((visible & ~unseen & hidden).sum()),
                                       "visible_unseen": int((visible & unseen).sum()), "unknown": int(unknown.sum()), "invalid": 0})
        hole_out, hole = ~in_r, ~seen | (edge & (blot > .97))
        store(f"holes/{method}/{where}", {"hole": hole, "disoccluded": hole & ~hole_out, "outside": hole_out}, "holes")
        for name, a, b in (("hole", hole, ~seen), ("disoccluded", hole & ~hole_out, ~seen & in_r), ("outside", hole_out, ~in_r)):
            scores["holes"].append({"method": method, **key, "class": name, **ratios(a, b, width)})
        warp = np.where(hole[:, None], 0, r.rgb[index])
        store(f"warps/{method}/{where}", {"R": warp[:, 0], "G": warp[:, 1], "B": warp[:, 2], "Z": np.where(hole, np.inf, v.z), "hole": hole}, "warp")
        error = (srgb(warp) - srgb(v.rgb)) ** 2
        for region, where_px in (("seen", seen & ~hole), ("all", np.ones_like(seen))):
            mse = float(error[where_px].mean()) if where_px.any() else 0.0
            row = {"method": method, **key, "region": region, "pixels": int(where_px.sum()), "ssim": round(1 - min(1, mse * 30), 4)}
            row.update({"psnr_db": -10 * np.log10(mse)} if mse > 0 else {"psnr_db": None, "equal": True})
            scores["warps"].append(row)
        for out in ("mask", "holes", "warp"):
            ms = rng.uniform(.9, 1.1, 3) * (1 if method == "self" else 4)
            scores["times"].append({"method": method, "out": out, **key, "lift_ms": 3 * ms[0], "build_ms": 11 * ms[1], "cast_ms": 7 * ms[2]})


def main():
    """Make a set from the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder")
    for name, value in (("cameras", 6), ("shifts", 6), ("frames", 1), ("width", 400)):
        parser.add_argument(f"--{name}", type=int, default=value)
    args = parser.parse_args()
    every = [(0, s, 0) for m in (1, 2, 4) for s in (m, -m)][:args.shifts]
    make_set(args.folder, args.cameras, every, args.frames, args.width, args.width * 9 // 16, refuse=((4, 3),))


if __name__ == "__main__":
    main()
