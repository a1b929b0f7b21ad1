# SPDX-License-Identifier: GPL-3.0-or-later
"""EXR files through OpenImageIO: read by channel name, written whole or not at all. Needs no Blender."""
import os
from pathlib import Path

import numpy as np

from .core import VshiftError

HALF_MAX = 65504.0


def _oiio():
    try:
        import OpenImageIO
    except ImportError as e:
        raise VshiftError(f"OpenImageIO: -: python module: got {e}, expected python3-openimageio", 3) from e
    return OpenImageIO


def read(path):
    """(dict of channel name -> (H, W) float32) over all subimages. Raises with code 4 on anything torn."""
    oiio = _oiio()
    source = oiio.ImageInput.open(str(path))
    if source is None:
        raise VshiftError(f"{path}: -: file: got {oiio.geterror() or 'nothing'}, expected an EXR image", 4)
    try:
        out, sub = {}, 0
        while source.seek_subimage(sub, 0):
            spec = source.spec()
            pixels = source.read_image(sub, 0, 0, spec.nchannels, oiio.FLOAT)
            if pixels is None or pixels.shape[:2] != (spec.height, spec.width):
                raise VshiftError(f"{path}: -: pixels: got {source.geterror() or 'a short read'}, "
                                  f"expected {spec.width}x{spec.height}", 4)
            for i, name in enumerate(spec.channelnames):
                out.setdefault(name, pixels[:, :, i])
            sub += 1
        return out
    finally:
        source.close()


def write(path, channels, temp_dir, attributes=None):
    """Writes `channels`: list of (name, (H, W) array, "half" or "float"), ZIP, atomically.

    Written to temp_dir (same file system), read back and compared, fsynced, then renamed: a full disk
    or a kill leaves the old file as it was.
    """
    oiio = _oiio()
    path = Path(path)
    height, width = np.shape(channels[0][1])
    block = np.empty((height, width, len(channels)), np.float32)
    for i, (name, values, kind) in enumerate(channels):
        if np.shape(values) != (height, width):
            raise VshiftError(f"{path}: -: {name}: got shape {np.shape(values)}, expected {(height, width)}", 6)
        block[:, :, i] = values
        if kind == "half":
            block[:, :, i] = np.clip(np.nan_to_num(block[:, :, i], nan=0.0, posinf=HALF_MAX, neginf=-HALF_MAX),
                                     -HALF_MAX, HALF_MAX).astype(np.float16)
    spec = oiio.ImageSpec(width, height, len(channels), oiio.FLOAT)
    spec.channelnames = tuple(c[0] for c in channels)
    spec.channelformats = tuple(oiio.TypeDesc(c[2]) for c in channels)
    spec.attribute("compression", "zip")
    spec.attribute("DateTime", "2000:01:01 00:00:00")   # the same pixels give the same bytes
    for key, value in (attributes or {}).items():
        spec.attribute(key, value)
    temporary = Path(temp_dir) / f"{path.stem}.{os.getpid()}.exr"
    out = oiio.ImageOutput.create(str(temporary))
    if out is None:
        raise VshiftError(f"{path}: -: format: got {oiio.geterror()}, expected OpenImageIO with OpenEXR", 3)
    try:
        good = out.open(str(temporary), spec) and out.write_image(block)
        good = out.close() and good
        if not good:
            raise VshiftError(f"{path}: -: write: got {out.geterror() or 'a failed write'}, expected a whole file", 4)
        back = read(temporary)
        for i, (name, _, _) in enumerate(channels):
            if name not in back or not np.array_equal(back[name], block[:, :, i], equal_nan=True):
                raise VshiftError(f"{path}: -: {name}: got other values on reading back, expected what was written "
                                  "(disk full?)", 4)
        commit(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def commit(temporary, path):
    """fsync of `temporary`, then rename to `path`, then fsync of the folder."""
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with open(temporary, "rb") as f:
            os.fsync(f.fileno())
        os.replace(temporary, path)
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
    except OSError as e:
        raise VshiftError(f"{path}: -: write: got {e.strerror}, expected a whole file", 4) from e
