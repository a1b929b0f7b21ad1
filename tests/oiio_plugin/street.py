# SPDX-License-Identifier: Apache-2.0
"""A 1600x900 street with analytic depth: a road, houses and parked boxes, seen by two cameras. Written as NPY and EXR."""
import json

import numpy as np
from support import write_exr

WIDTH, HEIGHT, F = 1600, 900, 1266.4
EYE_M = 1.5
CAMERAS = {"CAM_FRONT": 0.0, "CAM_LEFT": 0.6}   # metres to the left of the ego's axis
BOXES_M = (                                     # ego x, y, z: lowest and highest corner
    ((6, 1.5, 0), (10, 3.3, 1.5)), ((14, -4.5, 0), (18.5, -2.7, 1.6)), ((9, -1.4, 0), (9.3, -1.1, 3)),
    ((5, 9, 0), (80, 10, 12)), ((5, -11, 0), (60, -10, 9)), ((90, -40, 0), (91, 40, 6)))


def depth_and_color(y_m):
    """Planar depth (inf where there is sky) and a colour that depends on where each pixel's point lies."""
    right, down = np.meshgrid((np.arange(WIDTH) + 0.5 - WIDTH / 2) / F, (np.arange(HEIGHT) + 0.5 - HEIGHT / 2) / F)
    ray = np.stack([np.ones_like(right), -right, -down], axis=-1)
    eye = np.array([0, y_m, EYE_M])
    with np.errstate(divide="ignore"):
        z = np.where(down > 0, EYE_M / down, np.inf)
        for low, high in BOXES_M:
            a, b = (np.array(low) - eye) / ray, (np.array(high) - eye) / ray
            enter, leave = np.minimum(a, b).max(axis=-1), np.maximum(a, b).min(axis=-1)
            z = np.where((enter < leave) & (enter > 0), np.minimum(z, enter), z)
    z[z > 300] = np.inf
    point = np.where(np.isfinite(z)[..., None], eye + ray * np.where(np.isfinite(z), z, 0)[..., None], 0)
    return z.astype(np.float32), 0.5 + 0.4 * np.sin(point * 1.7)


def write(folder):
    """street.vshift and its files below the folder."""
    cameras = []
    for name, y_m in CAMERAS.items():
        z, color = depth_and_color(y_m)
        folder.mkdir(parents=True, exist_ok=True)
        np.save(folder / f"{name}.npy", z)
        write_exr(folder / f"{name}.exr", {"R": color[..., 0], "G": color[..., 1], "B": color[..., 2]})
        cameras.append({"name": name, "width": WIDTH, "height": HEIGHT,
                        "intrinsic": [[F, 0, WIDTH / 2], [0, F, HEIGHT / 2], [0, 0, 1]],
                        "rotation": [0.5, -0.5, 0.5, -0.5], "translation": [0, y_m, EYE_M],
                        "image": f"{name}.exr", "depth": f"{name}.npy"})
    frames = [{"index": 0, "timestamp_s": 0, "rotation": [1, 0, 0, 0], "translation": [0, 0, 0]}]
    recipe = folder / "street.vshift"
    recipe.write_text(json.dumps({"vshift": 1, "cameras": cameras, "frames": frames}))
    return recipe
