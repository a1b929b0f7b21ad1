# SPDX-License-Identifier: GPL-3.0-or-later
"""The six-camera rig: intrinsics, poses, shifts; recipe entries and Blender cameras from the same numbers.

Ego frame: x forward, y left, z up, origin on the ground under the rear axle. Camera frame: x right,
y down, z forward. Quaternions are w, x, y, z. `a_from_b` takes b to a. Needs Blender only in the
functions that take a Blender object.
"""
import math
from dataclasses import dataclass

import numpy as np

from .core import Camera

BASE_WIDTH, BASE_HEIGHT = 1600, 900
SENSOR_WIDTH_MM = 36.0
BLENDER_FROM_CV = np.diag([1.0, -1.0, -1.0, 1.0])

# name: (yaw to the left in degrees, pitch down in degrees, (x, y, z) in ego metres, f, cx, cy at 1600x900)
_CAMERAS = {
    "CAM_FRONT": (0.0, 0.0, (1.70, 0.00, 1.51), 1266.4, 816.3, 491.5),
    "CAM_FRONT_LEFT": (55.2, 0.2, (1.52, 0.49, 1.51), 1272.6, 826.6, 479.8),
    "CAM_FRONT_RIGHT": (-56.0, 0.3, (1.55, -0.49, 1.50), 1260.8, 808.0, 495.3),
    "CAM_BACK": (180.0, 0.1, (0.03, 0.00, 1.58), 809.2, 829.2, 481.8),
    "CAM_BACK_LEFT": (108.4, 0.6, (1.04, 0.48, 1.59), 1256.7, 792.1, 492.8),
    "CAM_BACK_RIGHT": (-110.1, 0.5, (1.01, -0.48, 1.56), 1259.5, 807.3, 501.2),
}
NAMES = tuple(_CAMERAS)


@dataclass(frozen=True)
class RigCamera:
    """One camera of the rig at a given image size; rotation (w, x, y, z) and translation_m are ego_from_cam."""
    name: str
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    rotation: tuple
    translation_m: tuple

    @property
    def ego_from_cam(self):
        """(4, 4)"""
        return rigid(self.rotation, self.translation_m)


# ------------------------------------------------------------------ small geometry
def rigid(rotation, translation_m):
    """(4, 4) from a quaternion w, x, y, z and a translation."""
    w, x, y, z = np.asarray(rotation, float) / np.linalg.norm(rotation)
    m = np.eye(4)
    m[:3, :3] = [[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                 [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                 [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]]
    m[:3, 3] = translation_m
    return m


def quaternion(matrix):
    """w, x, y, z of the rotation of a (3, 3) or (4, 4) matrix; w, or else the first part, is not negative."""
    r = np.asarray(matrix, float)[:3, :3]
    k = np.array([[r[0, 0] + r[1, 1] + r[2, 2], 0, 0, 0],
                  [r[2, 1] - r[1, 2], r[0, 0] - r[1, 1] - r[2, 2], 0, 0],
                  [r[0, 2] - r[2, 0], r[1, 0] + r[0, 1], r[1, 1] - r[0, 0] - r[2, 2], 0],
                  [r[1, 0] - r[0, 1], r[2, 0] + r[0, 2], r[2, 1] + r[1, 2], r[2, 2] - r[0, 0] - r[1, 1]]]) / 3.0
    values, vectors = np.linalg.eigh(k)
    q = vectors[:, np.argmax(values)]
    lead = q[np.argmax(np.abs(q) > 1e-9)]
    return tuple(float(v) for v in (q if lead > 0 else -q))


def _ego_from_cam_rotation(yaw_deg, pitch_down_deg):
    """(3, 3): the forward camera turned down, then to the left about the ego's z."""
    forward = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # camera axes in ego coordinates, as columns
    a, b = math.radians(yaw_deg), math.radians(pitch_down_deg)
    yaw = np.array([[math.cos(a), -math.sin(a), 0], [math.sin(a), math.cos(a), 0], [0, 0, 1]])
    pitch = np.array([[math.cos(b), 0, math.sin(b)], [0, 1, 0], [-math.sin(b), 0, math.cos(b)]])
    return yaw @ pitch @ forward


def make_rig(width=BASE_WIDTH, height=BASE_HEIGHT):
    """The six cameras at width x height: fx and cx scale by width/1600, fy and cy by height/900."""
    sx, sy = width / BASE_WIDTH, height / BASE_HEIGHT
    return [RigCamera(name, width, height, f * sx, f * sy, cx * sx, cy * sy,
                      quaternion(_ego_from_cam_rotation(yaw, pitch)), place)
            for name, (yaw, pitch, place, f, cx, cy) in _CAMERAS.items()]


def shift_pose(shift_m, yaw_deg=0.0):
    """recorded_ego_from_shifted_ego (4, 4): the translation in ego metres, then a turn about the ego's z."""
    a = math.radians(yaw_deg)
    m = np.eye(4)
    m[:2, :2] = [[math.cos(a), -math.sin(a)], [math.sin(a), math.cos(a)]]
    m[:3, 3] = shift_m
    return m


def shift_name(shift_m, yaw_deg=0.0):
    """The folder name of a shift, e.g. x+0.00_y+1.00_z+0.00_yaw+0.00."""
    x, y, z, yaw = (float(v) + 0.0 if round(float(v), 2) else 0.0 for v in (*shift_m, yaw_deg))
    return f"x{x:+.2f}_y{y:+.2f}_z{z:+.2f}_yaw{yaw:+.2f}"


def view(camera, world_from_ego, shift_m=(0.0, 0.0, 0.0), yaw_deg=0.0):
    """core.Camera of a rig camera after the ego at world_from_ego (4, 4) moved by the shift."""
    m = np.asarray(world_from_ego, float) @ shift_pose(shift_m, yaw_deg) @ camera.ego_from_cam
    return Camera(camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy, m[:3].copy())


# ------------------------------------------------------------------ the recipe
def recipe_camera(camera):
    """The camera's entry of a .vshift file."""
    path = f"frames/%04d/{camera.name}.exr"
    return {"name": camera.name, "width": camera.width, "height": camera.height,
            "intrinsic": [[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]],
            "rotation": list(camera.rotation), "translation": list(camera.translation_m),
            "image": path, "depth": path, "depth_channel": "Z"}


def recipe(cameras, ego_poses, dt_s, shift_m=(0.0, 1.0, 0.0), yaw_deg=0.0):
    """A whole .vshift file as a dict; ego_poses are world_from_ego (4, 4), one a frame, dt_s apart."""
    frames = [{"index": i, "timestamp_s": i * dt_s, "rotation": list(quaternion(m)),
               "translation": [float(v) for v in np.asarray(m)[:3, 3]]} for i, m in enumerate(ego_poses)]
    return {"vshift": 1, "cameras": [recipe_camera(c) for c in cameras], "frames": frames,
            "camera": cameras[0].name, "frame": 0, "shift": [float(v) for v in shift_m],
            "yaw_deg": float(yaw_deg), "out": "mask"}


# ------------------------------------------------------------------ Blender
def pixel_aspect(fx, fy):
    """(aspect_x, aspect_y), both at least 1, so that a Blender camera has these two focal lengths."""
    return (fy / fx, 1.0) if fy > fx else (1.0, fx / fy)


def apply_to_blender(camera, scene, camera_object):
    """Gives a Blender camera the intrinsics and the pose of a core.Camera, and the scene its size."""
    ax, ay = pixel_aspect(camera.fx, camera.fy)
    render = scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = camera.width, camera.height, 100
    render.pixel_aspect_x, render.pixel_aspect_y = ax, ay
    data = camera_object.data
    data.type, data.sensor_fit, data.sensor_width = "PERSP", "HORIZONTAL", SENSOR_WIDTH_MM
    data.lens = camera.fx * SENSOR_WIDTH_MM / camera.width
    data.shift_x = -(camera.cx - camera.width / 2) / camera.width
    data.shift_y = (camera.cy - camera.height / 2) * (ay / ax) / camera.width
    data.clip_start, data.clip_end = 0.01, 1e5
    data.dof.use_dof = False
    m = np.vstack([np.asarray(camera.world_from_cam, float), (0, 0, 0, 1)]) @ BLENDER_FROM_CV
    camera_object.rotation_mode = "QUATERNION"
    camera_object.parent = None
    camera_object.scale = (1, 1, 1)
    camera_object.rotation_quaternion = quaternion(m)
    camera_object.location = m[:3, 3]


def camera_object(name="vshift_view"):
    """The one Blender camera that all views are rendered through (made when missing, made the scene's camera)."""
    import bpy
    scene = bpy.context.scene
    found = bpy.data.objects.get(name)
    if found is None or found.type != "CAMERA":
        found = bpy.data.objects.new(name, bpy.data.cameras.new(name))
    if found.name not in scene.collection.all_objects:
        scene.collection.objects.link(found)
    scene.camera = found
    return found


def add_rig(width=BASE_WIDTH, height=BASE_HEIGHT, world_from_ego=None):
    """Six Blender cameras at an ego pose, for looking at; returns them by name."""
    import bpy
    pose = np.eye(4) if world_from_ego is None else world_from_ego
    out = {}
    for c in make_rig(width, height):
        ob = camera_object(c.name)
        apply_to_blender(view(c, pose), bpy.context.scene, ob)
        out[c.name] = ob
    bpy.context.scene.camera = out["CAM_FRONT"]
    return out
