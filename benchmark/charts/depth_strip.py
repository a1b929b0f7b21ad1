# SPDX-License-Identifier: Apache-2.0
"""Pictures, true 1/z and estimated 1/z of an analytic street, side by side (vshift depth).

    build/bin/vshift-scenes analytic_street --seed 104 --width 400 --samples 2 -o out/street
    build/bin/vshift depth out/street/analytic_street.vshift -o out/street/mono.vshift
    /usr/bin/python3 benchmark/charts/depth_strip.py out/street analytic_street mono docs/figures/depth.jpg
"""
import json
import sys
from pathlib import Path

import matplotlib
import numpy as np
import OpenImageIO as oiio
from PIL import Image

CAMERAS = ("CAM_FRONT", "CAM_FRONT_LEFT", "CAM_BACK_RIGHT")


def planes(folder, camera, key, channels):
    buffer = oiio.ImageBuf(str(folder / (camera[key] % 0 if "%" in camera[key] else camera[key])))
    names = list(buffer.spec().channelnames)
    return buffer.get_pixels(oiio.FLOAT)[..., [names.index(c) for c in channels]]


def main():
    folder, recipes, output = Path(sys.argv[1]), sys.argv[2:4], sys.argv[4]
    true, mono = ({c["name"]: c for c in json.loads((folder / f"{r}.vshift").read_text())["cameras"]} for r in recipes)
    rows = []
    for name in CAMERAS:
        linear = np.clip(planes(folder, true[name], "image", "RGB"), 0, 1)
        shown = [np.where(linear <= .0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - .055)]
        for recipe in (true, mono):
            near = 1 / planes(folder, recipe[name], "depth", "Z")[..., 0]
            shown.append(matplotlib.colormaps["inferno"](np.clip(near * 4, 0, 1) ** .5)[..., :3])  # 4 m and nearer: brightest
        rows.append(np.concatenate(shown, 1))
    Image.fromarray((255 * np.concatenate(rows) + .5).astype(np.uint8)).save(output, quality=88)


if __name__ == "__main__":
    main()
