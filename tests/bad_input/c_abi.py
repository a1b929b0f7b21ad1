# SPDX-License-Identifier: Apache-2.0
"""Bad calls of the C ABI (embree_core/c_api.h): (name, return code, call(lib, scene) -> code)."""
import ctypes
import json
import os
import resource
import select
import signal
from ctypes import byref, c_double, c_float, c_int8, c_int32, c_size_t, c_uint8, c_uint32, c_void_p

from base_case import LIBVSHIFT, SPACE_LIMIT, TIME_LIMIT_S

NAN, INF = float("nan"), float("inf")
QUAD = (5, -9, -9, 5, 9, -9, 5, 9, 9, 5, -9, 9)  # at x = 5
TRIANGLES = (0, 1, 2, 0, 2, 3)
FORWARD = (0, 0, 1, 0, -1, 0, 0, 0, 0, -1, 0, 0)  # looks along +x


class Camera(ctypes.Structure):
    _fields_ = [("width", c_int32), ("height", c_int32), ("fx", c_double), ("fy", c_double), ("cx", c_double),
                ("cy", c_double), ("world_from_cam", c_double * 12)]


def camera(width=8, height=6, fx=8.0, fy=8.0, cx=4.0, cy=3.0, pose=FORWARD):
    return Camera(width, height, fx, fy, cx, cy, (c_double * 12)(*pose))


def doubles(*values):
    return (c_double * len(values))(*values)


def load():
    lib = ctypes.CDLL(LIBVSHIFT)
    lib.vshift_last_error.restype = ctypes.c_char_p
    lib.vshift_scene_free.argtypes = [c_void_p]
    lib.vshift_scene_create.argtypes = [c_void_p, c_size_t, c_void_p, c_size_t, c_void_p, c_void_p]
    lib.vshift_cast_camera.argtypes = [c_void_p] * 6
    lib.vshift_cast_rays.argtypes = [c_void_p, c_void_p, c_void_p, c_size_t, c_void_p, c_void_p]
    lib.vshift_truth_recorded.argtypes = [c_void_p, c_void_p, c_int32, c_int32, c_void_p, c_void_p]
    lib.vshift_truth_shifted.argtypes = [c_void_p, c_void_p, c_int32, c_int32, c_void_p, c_void_p, c_void_p, c_void_p]
    lib.vshift_clearance.argtypes = [c_void_p, c_void_p, c_double, c_void_p, c_void_p]
    return lib


def create(lib, vertices=QUAD, triangles=TRIANGLES, origin=(0, 0, 0), vertex_count=None, triangle_count=None, out=None):
    scene = c_void_p()
    code = lib.vshift_scene_create(vertices and doubles(*vertices), len(vertices or ()) // 3 if vertex_count is None else vertex_count,
                                   triangles and (c_uint32 * len(triangles))(*triangles),
                                   len(triangles or ()) // 3 if triangle_count is None else triangle_count,
                                   origin and doubles(*origin), byref(scene) if out is None else None)
    assert out is not None or (code == 0) == bool(scene.value), "a scene and an error, or neither"
    return code, scene


def mesh(**bad):
    return lambda lib, scene: create(lib, **bad)[0]


def cast(null=False, **bad):
    def call(lib, scene):
        n = 8 * 6
        places = ((c_float * n)(), (c_int32 * n)(), (c_float * (3 * n))(), (c_double * (3 * n))())
        return lib.vshift_cast_camera(scene, None if null else byref(camera(**bad)), *(places if not bad else (None,) * 4))
    return call


def recorded(count=1, own=0, rig=True, shifted=True, **bad):
    return lambda lib, scene: lib.vshift_truth_recorded(scene, byref(camera(**bad)) if rig else None, count, own,
                                                        byref(camera()) if shifted else None, (c_uint8 * 48)())


def seen(count=1, own=0, rig=True, **bad):
    return lambda lib, scene: lib.vshift_truth_shifted(scene, byref(camera()) if rig else None, count, own, byref(camera(**bad)),
                                                       (c_uint8 * 48)(), (c_int8 * 48)(), (c_float * 48)())


def rays(origin, direction, count=1):
    def call(lib, scene):
        distance = (c_float * 1)(-1)
        code = lib.vshift_cast_rays(scene, origin and doubles(*origin), direction and doubles(*direction), count, distance, None)
        assert code or count == 0 or distance[0] == INF, f"distance: got {distance[0]}, expected inf"
        return code
    return call


def clearance(point=(0, 0, 0), limit=10.0):
    return lambda lib, scene: lib.vshift_clearance(scene, point and doubles(*point), limit, byref(c_double()), byref(c_int32()))


def without_scene(call):
    return lambda lib, scene: call(lib, None)


def turned(*values):
    """FORWARD with its first numbers replaced."""
    return tuple(values) + FORWARD[len(values):]


CASES = [
    ("good mesh", 0, mesh()),
    ("good camera", 0, cast()),
    ("good truth", 0, recorded()),
    ("good shifted truth", 0, seen()),
    ("good clearance", 0, clearance()),
    ("mesh: NULL vertices", 3, mesh(vertices=None, vertex_count=4)),
    ("mesh: NULL triangles", 3, mesh(triangles=None, triangle_count=2)),
    ("mesh: NULL origin", 3, mesh(origin=None)),
    ("mesh: NULL out", 3, mesh(out=False)),
    ("mesh: no vertices", 3, mesh(vertex_count=0)),
    ("mesh: no triangles", 3, mesh(triangle_count=0)),
    ("mesh: 2^62 vertices", 3, mesh(vertex_count=1 << 62)),
    ("mesh: 2^62 triangles", 3, mesh(triangle_count=1 << 62)),
    ("mesh: 4e9 vertices", 5, mesh(vertex_count=4000000000)),
    ("mesh: NaN vertex", 3, mesh(vertices=(NAN, *QUAD[1:]))),
    ("mesh: infinite vertex", 3, mesh(vertices=(*QUAD[:-1], INF))),
    ("mesh: vertex at 1e300", 3, mesh(vertices=(1e300, *QUAD[1:]))),
    ("mesh: NaN origin", 3, mesh(origin=(NAN, 0, 0))),
    ("mesh: infinite origin", 3, mesh(origin=(0, INF, 0))),
    ("mesh: index 4 of 4", 3, mesh(triangles=(0, 1, 4))),
    ("mesh: index 2^32-1", 3, mesh(triangles=(0, 1, 0xFFFFFFFF))),
    ("mesh: a point for a triangle", 0, mesh(triangles=(1, 1, 1))),
    ("free NULL", 0, lambda lib, scene: lib.vshift_scene_free(None) and 0 or 0),
    ("threads 0", 3, lambda lib, scene: lib.vshift_set_threads(0)),
    ("threads -1", 3, lambda lib, scene: lib.vshift_set_threads(-1)),
    ("threads 10^9", 3, lambda lib, scene: lib.vshift_set_threads(10 ** 9)),
    ("camera: NULL", 3, cast(null=True)),
    ("camera: NULL scene", 3, without_scene(cast())),
    ("camera: width 0", 3, cast(width=0)),
    ("camera: width -8", 3, cast(width=-8)),
    ("camera: width 2^31-1", 3, cast(width=2 ** 31 - 1)),
    ("camera: 16384x16384", 5, cast(width=16384, height=16384)),
    ("camera: fx 0", 3, cast(fx=0)),
    ("camera: fx NaN", 3, cast(fx=NAN)),
    ("camera: fx 1e-300", 3, cast(fx=1e-300)),
    ("camera: fx 1e300", 3, cast(fx=1e300)),
    ("camera: cx infinite", 3, cast(cx=INF)),
    ("camera: cx 1e300", 3, cast(cx=1e300)),
    ("camera: rotation twice as long", 3, cast(pose=turned(0, 0, 2))),
    ("camera: rotation of zeros", 3, cast(pose=(0,) * 12)),
    ("camera: rotation NaN", 3, cast(pose=turned(NAN))),
    ("camera: mirrored", 3, cast(pose=turned(0, 0, -1))),
    ("camera: sheared", 3, cast(pose=turned(0.1, 0, 1))),
    ("camera: translation NaN", 3, cast(pose=turned(0, 0, 1, NAN))),
    ("camera: translation 1e300", 3, cast(pose=turned(0, 0, 1, 1e300))),
    ("rays: NULL", 3, rays(None, None)),
    ("rays: NULL directions", 3, rays((0, 0, 0), None)),
    ("rays: none, NULL", 0, rays(None, None, 0)),
    ("rays: NULL scene", 3, without_scene(rays((0, 0, 0), (1, 0, 0)))),
    ("rays: NaN origin", (0, 3), rays((NAN, 0, 0), (1, 0, 0))),
    ("rays: NaN direction", (0, 3), rays((0, 0, 0), (NAN, 0, 0))),
    ("rays: origin 1e300", (0, 3), rays((1e300, 0, 0), (1, 0, 0))),
    ("rays: direction of zeros", (0, 3), rays((0, 0, 0), (0, 0, 0))),
    ("rays: tiny direction", (0, 3), rays((0, 0, 0), (1e-44, 0, 0))),
    ("truth: NULL scene", 3, without_scene(recorded())),
    ("truth: NULL rig", 3, recorded(rig=False)),
    ("truth: rig of 0", 3, recorded(count=0)),
    ("truth: rig of -1", 3, recorded(count=-1)),
    ("truth: rig of 2^31-1", 3, recorded(count=2 ** 31 - 1)),
    ("truth: own -1", 3, recorded(own=-1)),
    ("truth: own beyond", 3, recorded(own=1)),
    ("truth: NULL shifted", 3, recorded(shifted=False)),
    ("truth: rig camera broken", 3, recorded(fy=-1)),
    ("shifted truth: NULL scene", 3, without_scene(seen())),
    ("shifted truth: NULL rig", 3, seen(rig=False)),
    ("shifted truth: own beyond", 3, seen(own=9)),
    ("shifted truth: NaN pose", 3, seen(pose=turned(0, 0, 1, INF))),
    ("clearance: NULL scene", 3, without_scene(clearance())),
    ("clearance: NULL point", 3, clearance(None)),
    ("clearance: NaN point", 3, clearance((NAN, 0, 0))),
    ("clearance: point at 1e300", 3, clearance((1e300, 0, 0))),
    ("clearance: limit 0", 3, clearance(limit=0)),
    ("clearance: limit NaN", 3, clearance(limit=NAN)),
]


def in_child(call):
    """(code, message) of the call in a child process; code is 'signal N', 'timeout' or 'exception'."""
    read_end, write_end = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            os.close(read_end)
            os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # an assertion's last words
            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
            resource.setrlimit(resource.RLIMIT_AS, (SPACE_LIMIT // 2 or resource.RLIM_INFINITY,) * 2)
            lib = load()
            code, scene = create(lib)
            assert code == 0, "the good scene is refused"
            code = call(lib, scene)
            result = [code, lib.vshift_last_error().decode()]
        except BaseException as error:  # the child must never come back into the test
            result = ["exception", repr(error)]
        os.write(write_end, json.dumps(result).encode())
        os._exit(0)
    os.close(write_end)
    ready, _, _ = select.select([read_end], [], [], TIME_LIMIT_S)
    if not ready:
        os.kill(child, signal.SIGKILL)
    data = os.read(read_end, 65536)
    os.close(read_end)
    status = os.waitpid(child, 0)[1]
    if not data:
        return (f"signal {os.WTERMSIG(status)}" if ready else "timeout"), "the process ended"
    return tuple(json.loads(data))
