# SPDX-License-Identifier: Apache-2.0
"""The tiny valid recipe and set that the bad-input tests spoil, writers of odd files, and the runner.

Base: 64x36 pixels, cameras A and B, frames 0 and 1, a box at 4 m before a wall at 10 m.
Commands run with the base's folder as working directory, under limits of time and address space.
"""
import hashlib
import json
import os
import shutil
import stat
import struct
import subprocess
import zlib
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

ROOT = Path(__file__).resolve().parents[2]
VSHIFT = str(Path(os.environ.get("VSHIFT_BIN", ROOT / "build/bin/vshift")).resolve())
LIBVSHIFT = str(Path(os.environ.get("VSHIFT_LIBRARY", ROOT / "build/lib/libvshift.so")).resolve())
TIME_LIMIT_S = 10
SPACE_LIMIT = int(os.environ.get("VSHIFT_SPACE_LIMIT", 3 << 30))  # bytes of address space; 0: none (sanitizers need it)
WIDTH, HEIGHT = 64, 36
SHIFTS = ([0, 1, 0], [0, -1, 0], [0, 2, 0])
CAMERAS, FRAMES = ("A", "B"), (0, 1)


# -- files ------------------------------------------------------------------------------------------

def exr(path, channels, **attributes):
    """An EXR from {name: HxW array}."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    planes = np.stack([np.asarray(p, np.float32) for p in channels.values()], axis=-1)
    spec = oiio.ImageSpec(planes.shape[1], planes.shape[0], planes.shape[2], "float")
    spec.channelnames = tuple(channels)
    for key, value in attributes.items():
        spec.attribute(key.replace("__", "."), value)
    out = oiio.ImageOutput.create(str(path))
    assert out and out.open(str(path), spec) and out.write_image(planes) and out.close(), oiio.geterror()


def png(width, height, bits, claim=None):
    """A grey PNG whose header may claim another size."""
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    header = struct.pack(">IIBBBBB", *(claim or (width, height)), bits, 0, 0, 0, 0)
    rows = (b"\0" + b"\x10" * (width * bits // 8)) * height
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


def npy(shape="(36, 64)", descr="<f4", fortran=False, count=WIDTH * HEIGHT, size=4):
    head = f"{{'descr': '{descr}', 'fortran_order': {fortran}, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head + b"\0" * (count * size)


def pfm(head=f"Pf\n{WIDTH} {HEIGHT}\n-1.0\n", count=WIDTH * HEIGHT):
    return head.encode() + struct.pack("<f", 5.0) * count


def exr_window(data, x1, y1):
    """The bytes of an EXR with both windows enlarged to (0,0)-(x1,y1)."""
    for name in (b"dataWindow", b"displayWindow"):
        at = data.index(name + b"\0box2i\0") + len(name) + 7 + 4
        data = data[:at] + struct.pack("<4i", 0, 0, x1, y1) + data[at + 16:]
    return data


# -- the base ---------------------------------------------------------------------------------------

def scene_depth(width, height):
    z = np.full((height, width), 10.0, np.float32)
    z[height // 4: 3 * height // 4, width // 3: width // 2] = 4.0
    return z


def recipe_of(width, height):
    def camera(name, y_m):
        return {"name": name, "width": width, "height": height,
                "intrinsic": [[width, 0, width / 2], [0, width, height / 2], [0, 0, 1]],
                "rotation": [0.5, -0.5, 0.5, -0.5], "translation": [1.0, y_m, 1.5],
                "image": f"frames/%04d/{name}.exr", "depth": f"frames/%04d/{name}.exr"}
    return {"vshift": 1, "cameras": [camera("A", 0.0), camera("B", 0.4)],
            "frames": [{"index": i, "timestamp_s": 0.5 * i, "rotation": [1, 0, 0, 0], "translation": [i, 0, 0]} for i in FRAMES],
            "camera": "A", "shift": [0, 1, 0]}


def shift_name(shift):
    return "x{:+.2f}_y{:+.2f}_z{:+.2f}_yaw+0.00".format(*shift)


class Base:
    """A folder with r.vshift and its frames; `out/` is there and empty."""

    def __init__(self, folder, width=WIDTH, height=HEIGHT):
        self.folder, self.width, self.height = Path(folder), width, height
        self.recipe = recipe_of(width, height)

    def write(self):
        z = scene_depth(self.width, self.height)
        for frame in FRAMES:
            for name in CAMERAS:
                exr(self / f"frames/{frame:04d}/{name}.exr", {"R": z / 10, "G": z / 20, "B": z / 30, "Z": z})
        (self / "out").mkdir()
        self.save()
        return self

    def copy_to(self, folder):
        shutil.copytree(self.folder, folder, dirs_exist_ok=True)
        return Base(folder, self.width, self.height)

    def __truediv__(self, name):
        return self.folder / name

    def save(self):
        (self / "r.vshift").write_text(json.dumps(self.recipe))

    def text(self, text):
        (self / "r.vshift").write_text(text) if isinstance(text, str) else (self / "r.vshift").write_bytes(text)

    @property
    def depth(self):
        return self / "frames/0000/A.exr"

    def manifest(self, **changes):
        items = {f"frames/{f:04d}/{c}.exr": {"kind": "recorded", "status": "planned"} for f in FRAMES for c in CAMERAS}
        data = {"vshift_manifest": 1, "items": items,
                "shifts": [{"name": shift_name(s), "shift": s, "yaw_deg": 0} for s in SHIFTS]}
        (self / "manifest.json").write_text(json.dumps({**data, **changes}))

    def scored(self, **attributes):
        """A set with one mask and its truth, so that `score` has something to do."""
        self.manifest()
        zero = np.zeros((self.height, self.width))
        item = f"{shift_name(SHIFTS[0])}/0000/A.exr"
        exr(self / "masks/self" / item, {n: zero for n in ("lost", "occluded", "outside", "unknown", "unseen")}, **attributes)
        exr(self / "truth" / item, {n: zero for n in ("lost", "occluded", "outside", "shell_self", "shell_rig")})

    def tree(self):
        """Every path below the folder with what it holds; equal before and after a refused command."""
        out = {}
        for path in sorted(self.folder.rglob("*")):
            info = path.lstat()
            content = os.readlink(path) if path.is_symlink() else ""
            if stat.S_ISREG(info.st_mode):
                content = info.st_size if info.st_size > 1 << 24 else hashlib.sha256(path.read_bytes()).hexdigest()
            out[str(path.relative_to(self.folder))] = (stat.S_IFMT(info.st_mode), content)
        return out


# -- running ----------------------------------------------------------------------------------------

def environment():
    # On many cores the allocator's arenas alone would pass the address-space limit.
    return {**os.environ, "MALLOC_ARENA_MAX": "2", "LC_ALL": "C.UTF-8"}


def start(words, folder):
    """The running program; the shell sets the limits and becomes it."""
    limits = f'ulimit -c 0; ulimit -v {SPACE_LIMIT >> 10 or "unlimited"}; exec "$@"'
    return subprocess.Popen(["/bin/sh", "-c", limits, "sh", VSHIFT, *words], cwd=folder, stdin=subprocess.DEVNULL,
                            stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment())


def run(words, folder):
    """(exit code, stdout, stderr); code is 'timeout' after TIME_LIMIT_S."""
    child = start(words.split() if isinstance(words, str) else words, folder)
    try:
        out, err = child.communicate(timeout=TIME_LIMIT_S)
        code = child.returncode
    except subprocess.TimeoutExpired:
        child.kill()
        out, err = child.communicate()
        code = "timeout"
    return code, out.decode("utf-8", "replace"), err.decode("utf-8", "replace")
