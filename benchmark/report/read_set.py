# SPDX-License-Identifier: Apache-2.0
"""Reads a set's manifest, recipe, scores and pictures, and refuses what docs/set_layout.md does not allow.

Everything that is wrong with a set leaves here as a ReportError of one line:
`file: field: got X, expected Y`.
"""
import hashlib
import json
import math
import os
import re
import stat
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

BAD_INPUT, IO_FAILED = 3, 4
METHODS = ("self", "rig")
MASK_CLASSES = ("lost", "occluded", "outside")
HOLE_CLASSES = ("hole", "disoccluded", "outside")
COUNTS = ("true_positive", "false_positive", "false_negative", "true_negative")
CERTIFICATE_COUNTS = ("pixels", "occluded", "occluded_wrong", "visible_certain", "visible_wrong",
                      "visible_unseen", "unknown", "invalid")
MAX_JSON_BYTES = 512 << 20
DISTANCE = re.compile(r"^[0-9.e+]{1,12} m$")
SAFE_NAME = re.compile(r"[A-Za-z0-9_+\-]([A-Za-z0-9_+.\-]*[A-Za-z0-9_+\-])?\Z")


class ReportError(Exception):
    """One line for the user, and the exit code that goes with it."""

    def __init__(self, code, message):
        super().__init__(" ".join(str(message).split()))
        self.code = code


def refuse(file, field, got, expected):
    """Raise the error of a bad field."""
    text = got if isinstance(got, str) and got.startswith("nothing") else json.dumps(got, default=str)
    text = text if len(text) <= 80 else text[:77] + "..."
    raise ReportError(BAD_INPUT, f"{file}: {field}: got {text}, expected {expected}")


def read_bytes(path, name, limit=None):
    """The bytes of a regular file; `name` is what messages call it."""
    try:
        info = os.stat(path)
        if not stat.S_ISREG(info.st_mode):
            refuse(name, "file", "something else", "a regular file")
        if limit and info.st_size > limit:
            refuse(name, "size", info.st_size, f"at most {limit} bytes")
        with open(path, "rb") as file:
            return file.read()
    except (FileNotFoundError, NotADirectoryError):
        raise ReportError(IO_FAILED, f"{name}: file: got nothing, expected a file of the set (docs/set_layout.md)") from None
    except OSError as error:
        raise ReportError(IO_FAILED, f"{name}: file: got {error.strerror}, expected to read it") from None


def read_json(path, name):
    """A JSON object, strictly: no duplicate keys, no NaN, no deep nesting."""
    def pairs(items):
        out = {}
        for key, value in items:
            if key in out:
                refuse(name, key, "the key twice", "it once")
            out[key] = value
        return out

    def constant(text):
        refuse(name, "number", text, "a finite number")

    data = read_bytes(path, name, MAX_JSON_BYTES)
    try:
        value = json.loads(data.decode("utf-8"), object_pairs_hook=pairs, parse_constant=constant)
    except RecursionError:
        refuse(name, "json", "nesting too deep", "plain JSON")
    except ValueError as error:
        refuse(name, "json", str(error), "valid JSON in UTF-8")
    if not isinstance(value, dict):
        refuse(name, "json", type(value).__name__, "an object")
    return value


def need(data, key, kind, file, where=""):
    """data[key], checked to be a `kind`: str, int, float (any finite number), list or dict."""
    field = f"{where}{key}"
    if key not in data:
        refuse(file, field, "nothing", kind.__name__)
    value = data[key]
    good = isinstance(value, (int, float) if kind is float else kind) and (kind is bool or not isinstance(value, bool))
    if good and kind is float:
        try:
            good = math.isfinite(value)
        except OverflowError:
            good = False
    if not good:
        refuse(file, field, value, {"str": "a text", "int": "a whole number", "float": "a finite number",
                                    "list": "a list", "dict": "an object"}[kind.__name__])
    return value


def need_name(data, key, file, where=""):
    """A text that may be a folder or file name."""
    value = need(data, key, str, file, where)
    if not SAFE_NAME.match(value):
        refuse(file, where + key, value, "a name of letters, digits and _ + - .")
    return value


def read_manifest(folder):
    """manifest.json, checked as far as the report uses it."""
    name = "manifest.json"
    data = read_json(folder / name, name)
    if need(data, "vshift_manifest", int, name) != 1:
        refuse(name, "vshift_manifest", data["vshift_manifest"], "1")
    for key in ("versions", "machine", "street", "render", "items"):
        need(data, key, dict, name)
    for key in ("width", "height"):
        need(data["render"], key, int, name, "render.")
    seen = set()
    for index, shift in enumerate(need(data, "shifts", list, name)):
        where = f"shifts[{index}]."
        if not isinstance(shift, dict):
            refuse(name, where[:-1], shift, "an object")
        need_name(shift, "name", name, where)
        vector = need(shift, "shift", list, name, where)
        if len(vector) != 3 or not all(isinstance(v, (int, float)) and math.isfinite(v) for v in vector):
            refuse(name, where + "shift", vector, "three finite numbers")
        if "yaw_deg" in shift:
            need(shift, "yaw_deg", float, name, where)
        if shift["name"] in seen:
            refuse(name, where + "name", shift["name"], "a name used once")
        seen.add(shift["name"])
    if not seen:
        refuse(name, "shifts", [], "at least one shift")
    for path, item in data["items"].items():
        field = f"items[{path}]"
        if path.startswith("/") or ".." in path.split("/"):
            refuse(name, field, path, "a path below the set")
        if not isinstance(item, dict):
            refuse(name, field, item, "an object")
        if need(item, "status", str, name, field + ".") not in ("planned", "done", "refused"):
            refuse(name, field + ".status", item["status"], "planned, done or refused")
        if item["status"] == "done":
            need(item, "sha256", str, name, field + ".")
        if "seconds" in item:
            need(item, "seconds", float, name, field + ".")
    return data


def read_recipe(folder):
    """set.vshift: the cameras and frames, as far as the report uses them."""
    name = "set.vshift"
    data = read_json(folder / name, name)
    if need(data, "vshift", int, name) != 1:
        refuse(name, "vshift", data["vshift"], "1")
    for index, camera in enumerate(need(data, "cameras", list, name)):
        where = f"cameras[{index}]."
        if not isinstance(camera, dict):
            refuse(name, where[:-1], camera, "an object")
        need_name(camera, "name", name, where)
        for key in ("width", "height"):
            if not 1 <= need(camera, key, int, name, where) <= 32768:
                refuse(name, where + key, camera[key], "1 to 32768")
    for index, frame in enumerate(need(data, "frames", list, name)):
        if not isinstance(frame, dict):
            refuse(name, f"frames[{index}]", frame, "an object")
        if need(frame, "index", int, name, f"frames[{index}].") < 0:
            refuse(name, f"frames[{index}].index", frame["index"], "0 or more")
    for key in ("cameras", "frames"):
        if not data[key]:
            refuse(name, key, [], "at least one")
    return data


def read_scores(folder, shifts, frames, cameras):
    """scores/scores.json; every row must speak of this set's shifts, frames and cameras."""
    name = "scores/scores.json"
    data = read_json(folder / name, name)
    if need(data, "vshift_scores", int, name) != 1:
        refuse(name, "vshift_scores", data["vshift_scores"], "1")
    known = {"method": METHODS, "shift": shifts, "frame": frames, "camera": cameras}
    ratios = ("iou", "precision", "recall", "f1")
    data.setdefault("mask_regions", [])  # sets made before truth said what is foliage have none
    extra = {"masks": (COUNTS, ratios), "mask_regions": (("pixels", *COUNTS[:3]), ("f1", "boundary_f1")), "holes": (COUNTS, ratios), "certificates": (CERTIFICATE_COUNTS, ()),
             "warps": (("pixels",), ()), "times": ((), ("lift_ms", "build_ms", "cast_ms"))}
    one_of = {"masks": {"class": MASK_CLASSES, "against": ("scene", "shell")},
              "mask_regions": {"region": ("foliage", "rest"), "against": ("scene", "shell")}, "holes": {"class": HOLE_CLASSES},
              "warps": {"region": ("seen", "all")}, "certificates": {}, "times": {}}
    for table, (counts, numbers) in extra.items():
        for index, row in enumerate(need(data, table, list, name)):
            where = f"{table}[{index}]."
            if not isinstance(row, dict):
                refuse(name, where[:-1], row, "an object")
            for key, allowed in {**known, **one_of[table]}.items():
                if need(row, key, int if key == "frame" else str, name, where) not in allowed:
                    refuse(name, where + key, row[key], "one of " + ", ".join(map(str, list(allowed)[:8])))
            for key in counts:
                if need(row, key, int, name, where) < 0:
                    refuse(name, where + key, row[key], "0 or more")
            for key in numbers:
                if row.get(key, 0) is not None:  # null: not measured
                    need(row, key, float, name, where)
            if table == "times":
                need(row, "out", str, name, where)
                if row.get("read_ms") is not None:
                    need(row, "read_ms", float, name, where)
            if table in ("masks", "holes"):
                need(row, "boundary_f1", dict, name, where)
                for px in ("1", "2", "4"):
                    if row["boundary_f1"].get(px, 0) is not None:
                        need(row["boundary_f1"], px, float, name, where + "boundary_f1.")
            if table == "warps":
                for key in ("psnr_db", "ssim"):
                    if row.get(key, 0) is not None:
                        need(row, key, float, name, where)
    check_fills(data, name, shifts, frames, cameras)
    if not (data["masks"] or data["holes"] or data["warps"]):
        refuse(name, "masks", [], "at least one row (run `vshift score` first)")
    return data


def check_fills(data, name, shifts, frames, cameras):
    """The tables of filled views, which a set may lack."""
    pools = set(shifts) | {"all"}
    tables = {"images": {"shift": shifts, "frame": frames, "camera": cameras}, "image_summary": {"camera": cameras + ["all"]},
              "temporal": {}, "overlap": {}, "fill_times": {}}
    numbers = {"images": ("psnr_db",), "image_summary": ("psnr_db", "ssim", "ms_ssim", "flip", "gradient_error", "sharpness"),
               "temporal": ("difference", "truth_difference", "error_change"), "overlap": ("difference", "truth_difference", "error_change"),
               "fill_times": ("fill_cpu_ms", "warp_cpu_ms", "fill_ms", "warp_ms")}
    for table, one_of in tables.items():
        data.setdefault(table, [])
        for index, row in enumerate(need(data, table, list, name)):
            where = f"{table}[{index}]."
            if not isinstance(row, dict):
                refuse(name, where[:-1], row, "an object")
            need_name(row, "arm", name, where)
            for key, allowed in one_of.items():
                if need(row, key, int if key == "frame" else str, name, where) not in allowed:
                    refuse(name, where + key, row[key], "one of " + ", ".join(map(str, list(allowed)[:8])))
            if table in ("image_summary", "temporal", "overlap"):
                shift = need(row, "shift", str, name, where)
                if shift not in pools and not DISTANCE.match(shift):
                    refuse(name, where + "shift", shift, "a shift of the set, a distance such as 2 m, or all")
                if need(row, "frames", int, name, where) < 1:
                    refuse(name, where + "frames", row["frames"], "1 or more")
            if table != "fill_times":
                need(row, "region", str, name, where)
                if need(row, "pixels", int, name, where) < 0:
                    refuse(name, where + "pixels", row["pixels"], "0 or more")
            for key in numbers[table]:
                if row.get(key, 0) is not None:
                    need(row, key, float, name, where)
            for key in [k for k in row if k.endswith("_95")]:
                ends = row[key]
                if ends is not None and not (isinstance(ends, list) and len(ends) == 2 and all(isinstance(e, (int, float)) and math.isfinite(e) for e in ends)):
                    refuse(name, where + key, ends, "two finite numbers or null")


def read_set(folder):
    """The whole of a set but its pictures: folder, manifest, recipe, scores and the lists in order."""
    folder = Path(folder)
    if folder.name == "set.vshift" and folder.is_file():
        folder = folder.parent
    if not folder.is_dir():
        refuse(folder.name or str(folder), "folder", "nothing", "the folder of a benchmark set")
    manifest, recipe = read_manifest(folder), read_recipe(folder)
    shifts = [s["name"] for s in manifest["shifts"]]
    cameras = [c["name"] for c in recipe["cameras"]]
    frames = [f["index"] for f in recipe["frames"]]
    scores = read_scores(folder, shifts, frames, cameras)
    scored = {(r["method"], r["shift"], r["frame"], r["camera"]) for r in scores["masks"]}
    methods = {r["method"] for table in ("masks", "holes", "warps") for r in scores[table]}
    return {"folder": folder, "manifest": manifest, "recipe": recipe, "scores": scores, "shifts": shifts,
            "cameras": cameras, "frames": frames, "scored": scored,
            "methods": [m for m in METHODS if m in methods],
            "size": {c["name"]: (c["width"], c["height"]) for c in recipe["cameras"]}}


def read_channels(data, relative, camera, channels):
    """The named channels of a picture of the set as float32 (height, width, n), or None.

    None when the manifest says that the picture was refused or is only planned, or when it says
    nothing and there is no file. A picture that the manifest calls done must match its sha256.
    """
    item = data["manifest"]["items"].get(relative)
    path = data["folder"] / relative
    if item is not None and item["status"] != "done":
        return None
    if item is None and not path.exists():
        return None
    content = read_bytes(path, relative)
    if item is not None:
        digest = hashlib.sha256(content).hexdigest()
        if digest != item["sha256"].lower():
            refuse(relative, "sha256", digest[:16], f"{item['sha256'][:16]} as in manifest.json")
    return decode(path, relative, data["size"][camera], channels)


def decode(path, name, size, channels):
    """Channels of an image file by name; the size must be the recipe's, which is checked before allocating."""
    oiio.geterror()
    image = oiio.ImageInput.open(str(path))
    if image is None:
        refuse(name, "image", oiio.geterror() or "nothing", "a readable EXR")
    try:
        spec = image.spec()
        if (spec.width, spec.height) != tuple(size):
            refuse(name, "size", f"{spec.width}x{spec.height}", "{}x{} as in set.vshift".format(*size))
        names = list(spec.channelnames)
        for channel in channels:
            if channel not in names:
                refuse(name, "channels", ", ".join(names), "a channel " + channel)
        if spec.nchannels > 64:
            refuse(name, "channels", spec.nchannels, "at most 64")
        pixels = image.read_image(0, 0, 0, spec.nchannels, oiio.FLOAT)
        error = image.geterror()
        if pixels is None or error:
            refuse(name, "pixels", error or "nothing", "a whole EXR")
        return np.asarray(pixels, np.float32)[:, :, [names.index(c) for c in channels]]
    finally:
        image.close()
