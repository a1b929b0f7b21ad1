# SPDX-License-Identifier: GPL-3.0-or-later
"""The C ABI of libvshift.so through ctypes: numpy arrays in, numpy arrays out. Needs no Blender.

Metres; camera frame x right, y down, z forward; `world_from_cam` is (3, 4); images are (H, W),
row 0 on top, pixel centres at +0.5; depth is planar z, +inf is sky.
"""
import ctypes
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

OCCLUDED, OUTSIDE, SKY, SHELL_SELF, SHELL_RIG, FACES_AWAY = 1, 2, 4, 8, 16, 32
SEEN_BY_OWN, NEIGHBOUR_OCCLUDED, NEIGHBOUR_OUTSIDE, NOBODY_OCCLUDED, NOBODY_OUTSIDE = range(5)


class VshiftError(RuntimeError):
    """A failed call of the core; `code` is an exit code of the product (3 input, 4 io, 5 limit, 6 bug)."""

    def __init__(self, message, code=6):
        super().__init__(message)
        self.code = code


class _Camera(ctypes.Structure):
    _fields_ = [("width", ctypes.c_int32), ("height", ctypes.c_int32),
                ("fx", ctypes.c_double), ("fy", ctypes.c_double),
                ("cx", ctypes.c_double), ("cy", ctypes.c_double),
                ("world_from_cam", ctypes.c_double * 12)]


@dataclass(frozen=True)
class Camera:
    """One pinhole view. fx, fy, cx, cy in pixels; world_from_cam (3, 4) float64."""
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    world_from_cam: np.ndarray

    @property
    def centre(self):
        """(3,) world position, metres."""
        return np.asarray(self.world_from_cam)[:, 3]

    def project(self, points_world):
        """(N, 3) world points -> (N, 2) pixels and (N,) planar depth."""
        m = np.asarray(self.world_from_cam, float)
        p = (np.asarray(points_world, float) - m[:, 3]) @ m[:, :3]
        with np.errstate(divide="ignore", invalid="ignore"):
            uv = p[:, :2] / p[:, 2:3] * (self.fx, self.fy) + (self.cx, self.cy)
        return uv, p[:, 2]

    def rays(self):
        """(H, W, 3) world directions through the pixel centres, scaled to planar depth 1."""
        x = (np.arange(self.width) + 0.5 - self.cx) / self.fx
        y = (np.arange(self.height) + 0.5 - self.cy) / self.fy
        d = np.stack(np.broadcast_arrays(x[None, :], y[:, None], 1.0), -1)
        return d @ np.asarray(self.world_from_cam, float)[:, :3].T


def _c_camera(camera):
    m = _array(camera.world_from_cam, np.float64, (3, 4), "world_from_cam")
    return _Camera(camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy,
                   (ctypes.c_double * 12)(*m.ravel()))


def _array(value, dtype, shape, name):
    """`value` as a C-contiguous array of `dtype`; None in `shape` is any length."""
    a = np.asarray(value)
    if a.ndim != len(shape) or any(s is not None and s != n for s, n in zip(shape, a.shape)):
        want = "x".join("N" if s is None else str(s) for s in shape)
        raise VshiftError(f"core: -: {name}: got shape {a.shape}, expected {want}", 3)
    if a.dtype.kind not in "fiu" or (np.dtype(dtype).kind in "iu" and a.dtype.kind == "f"):
        raise VshiftError(f"core: -: {name}: got {a.dtype}, expected {np.dtype(dtype)}", 3)
    return np.ascontiguousarray(a, dtype=dtype)


# ------------------------------------------------------------------ the library
_P = ctypes.c_void_p
_SIGNATURES = {
    "vshift_set_threads": [ctypes.c_int],
    "vshift_self_test": [],
    "vshift_scene_create": [_P, ctypes.c_size_t, _P, ctypes.c_size_t, _P, ctypes.POINTER(_P)],
    "vshift_cast_camera": [_P, ctypes.POINTER(_Camera), _P, _P, _P, _P],
    "vshift_cast_rays": [_P, _P, _P, ctypes.c_size_t, _P, _P],
    "vshift_truth_recorded": [_P, ctypes.POINTER(_Camera), ctypes.c_int32, ctypes.c_int32,
                              ctypes.POINTER(_Camera), _P],
    "vshift_truth_shifted": [_P, ctypes.POINTER(_Camera), ctypes.c_int32, ctypes.c_int32,
                             ctypes.POINTER(_Camera), _P, _P, _P],
    "vshift_clearance": [_P, _P, ctypes.c_double, _P, _P],
}
_loaded = None


def candidates():
    """Where libvshift.so is looked for: $VSHIFT_LIBRARY alone if set, else the addon, then the checkout."""
    if os.environ.get("VSHIFT_LIBRARY"):
        return [Path(os.environ["VSHIFT_LIBRARY"])]
    here = Path(__file__).resolve().parent
    return [here / "lib" / "libvshift.so", here / "libvshift.so", here.parents[1] / "build" / "lib" / "libvshift.so"]


def load():
    """The library, loaded once and proven by its own self-test.

    RTLD_DEEPBIND keeps the Embree that Blender brings from shadowing ours (every ray would miss).
    """
    global _loaded
    if _loaded is not None:
        return _loaded
    tried = candidates()
    path = next((p for p in tried if p.is_file()), None)
    if path is None:
        raise VshiftError("libvshift.so: -: path: got none of " + ", ".join(map(str, tried)) +
                          ", expected the built library (set VSHIFT_LIBRARY)", 3)
    try:
        lib = ctypes.CDLL(str(path), mode=os.RTLD_LOCAL | os.RTLD_NOW | getattr(os, "RTLD_DEEPBIND", 0))
        for name in ("vshift_version", "vshift_last_error"):
            getattr(lib, name).restype = ctypes.c_char_p
            getattr(lib, name).argtypes = []
        for name, arguments in _SIGNATURES.items():
            getattr(lib, name).restype = ctypes.c_int
            getattr(lib, name).argtypes = arguments
        lib.vshift_scene_free.restype = None
        lib.vshift_scene_free.argtypes = [_P]
    except (OSError, AttributeError) as e:
        raise VshiftError(f"{path}: -: library: got {e}, expected a loadable libvshift.so", 3) from e
    if lib.vshift_self_test() != 0:
        raise VshiftError(f"{path}: -: self-test: got '{_last_error(lib)}', expected known rays to hit a known "
                          "triangle (another Embree in this process may shadow ours)", 6)
    _loaded = lib
    return lib


def _last_error(lib):
    return (lib.vshift_last_error() or b"").decode("utf-8", "replace")


def _call(name, *arguments):
    lib = load()
    code = getattr(lib, name)(*arguments)
    if code:
        raise VshiftError(_last_error(lib) or f"{name}: failed with code {code}", code)


def version():
    return load().vshift_version().decode()


def set_threads(threads):
    _call("vshift_set_threads", int(threads))


# ------------------------------------------------------------------ the scene
class Scene:
    """The true mesh of one instant: vertices (N, 3) world metres, triangles (M, 3), origin (3,)."""

    def __init__(self, vertices, triangles, origin=(0.0, 0.0, 0.0)):
        self._handle = _P()
        v = _array(vertices, np.float64, (None, 3), "vertices")
        t = _array(triangles, np.uint32, (None, 3), "triangles")
        o = _array(origin, np.float64, (3,), "origin")
        _call("vshift_scene_create", v.ctypes.data, len(v), t.ctypes.data, len(t), o.ctypes.data,
              ctypes.byref(self._handle))

    def close(self):
        if self._handle:
            load().vshift_scene_free(self._handle)
            self._handle = _P()

    __del__ = close

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def _live(self):
        if not self._handle:
            raise VshiftError("core: -: scene: got a closed scene, expected an open one", 6)
        return self._handle

    def cast_camera(self, camera, normal=False, position=False):
        """dict: depth (H, W) float32, triangle (H, W) int32; normal (H, W, 3) float32 and
        position (H, W, 3) float64 when asked for."""
        h, w = camera.height, camera.width
        out = {"depth": np.empty((h, w), np.float32), "triangle": np.empty((h, w), np.int32)}
        if normal:
            out["normal"] = np.empty((h, w, 3), np.float32)
        if position:
            out["position"] = np.empty((h, w, 3), np.float64)
        at = [out[k].ctypes.data if k in out else None for k in ("depth", "triangle", "normal", "position")]
        _call("vshift_cast_camera", self._live(), ctypes.byref(_c_camera(camera)), *at)
        return out

    def cast_rays(self, origins, directions):
        """(N, 3) world origins, (N, 3) unit directions -> distance (N,) float32, triangle (N,) int32."""
        o = _array(origins, np.float64, (None, 3), "origins")
        d = _array(directions, np.float64, (len(o), 3), "directions")
        distance, triangle = np.empty(len(o), np.float32), np.empty(len(o), np.int32)
        _call("vshift_cast_rays", self._live(), o.ctypes.data, d.ctypes.data, len(o), distance.ctypes.data,
              triangle.ctypes.data)
        return distance, triangle

    def truth_recorded(self, rig, own, shifted):
        """Flags (H, W) uint8 of the pixels of rig[own] against the camera `shifted`."""
        cameras = (_Camera * len(rig))(*map(_c_camera, rig))
        flags = np.empty((rig[own].height, rig[own].width), np.uint8)
        _call("vshift_truth_recorded", self._live(), cameras, len(rig), own, ctypes.byref(_c_camera(shifted)),
              flags.ctypes.data)
        return flags

    def truth_shifted(self, rig, own, shifted):
        """(class (H, W) uint8, source (H, W) int8, depth (H, W) float32) of the pixels of `shifted`."""
        cameras = (_Camera * len(rig))(*map(_c_camera, rig))
        shape = (shifted.height, shifted.width)
        klass, source, depth = np.empty(shape, np.uint8), np.empty(shape, np.int8), np.empty(shape, np.float32)
        _call("vshift_truth_shifted", self._live(), cameras, len(rig), own, ctypes.byref(_c_camera(shifted)),
              klass.ctypes.data, source.ctypes.data, depth.ctypes.data)
        return klass, source, depth

    def clearance(self, point, limit_m):
        """(distance in m to the nearest surface, at most limit_m; whether the point is inside something)."""
        p = _array(point, np.float64, (3,), "point")
        distance, inside = ctypes.c_double(), ctypes.c_int32()
        _call("vshift_clearance", self._live(), p.ctypes.data, float(limit_m), ctypes.byref(distance),
              ctypes.byref(inside))
        return distance.value, bool(inside.value)
