# SPDX-License-Identifier: Apache-2.0
"""The forward splat that TrajectoryCrafter and CogNVS warp with, and the depth test that makes a mask of it:
our own short rendering in PyTorch of the published method, for `vshift bench`.

Every recorded pixel is a point; it falls between four pixels of the shifted picture and is added to each with its
bilinear weight times exp(-50 log(1 + z) / max log(1 + z)), so that the nearest prevails. Colour (three channels)
and depth are splatted, as a warp needs them. A recorded pixel is then occluded when it lies more than 2 %
behind the splatted depth at its own place.

    /usr/bin/python3 torch_splat.py FOLDER     # FOLDER/job.json -> FOLDER/result.json and masks

With `peer_code` in the job, TrajectoryCrafter's own file models/utils.py, its class Warper runs beside: its forward
warp of the colours, and for the depth test its bilinear splat of the depth, which it has no use for itself.

Times are of the work alone, without files. Exit status 77: there is no PyTorch.
"""
import ast
import json
import sys
import typing
import time
from pathlib import Path

import numpy as np

try:
    import torch
except ImportError:
    sys.exit(77)

BIAS = .02
FAR_M = 1000.0


def project(depth, job):
    """Place (pixel centres at whole numbers) and depth of every point in the shifted picture."""
    height, width = depth.shape
    fx, fy, cx, cy = job["k_recorded"]
    gx, gy, hx, hy = job["k_shifted"]
    v, u = torch.meshgrid(torch.arange(height) + .5, torch.arange(width) + .5, indexing="ij")
    rays = torch.stack([(u - cx) / fx, (v - cy) / fy, torch.ones_like(u)], -1)
    rotation = torch.tensor(job["rotation"], dtype=torch.float32)
    # The sky is a point very far away, as in a network's depth map.
    points = rays * depth.clamp(max=1e6)[..., None] @ rotation.T + torch.tensor(job["translation_m"], dtype=torch.float32)
    z = points[..., 2]
    ahead = z > 1e-3
    safe = torch.where(ahead, z, torch.ones_like(z))
    return points[..., 0] / safe * gx + hx - .5, points[..., 1] / safe * gy + hy - .5, z, ahead


def corners(x, y, width, height):
    """The four pixels round each place: index, bilinear weight, whether in the picture."""
    x0, y0 = torch.floor(x), torch.floor(y)
    for dy in (0, 1):
        for dx in (0, 1):
            px, py = x0 + dx, y0 + dy
            weight = (1 - (x - px).abs()) * (1 - (y - py).abs())
            inside = (px >= 0) & (py >= 0) & (px < width) & (py < height)
            index = py.clamp(0, height - 1).long() * width + px.clamp(0, width - 1).long()
            yield index, weight, inside


def splat(colour, depth, job):
    """Colour and depth of the shifted picture, and how much fell on each pixel."""
    height, width = depth.shape
    x, y, z, ahead = project(depth, job)
    log_depth = torch.log1p(z.clamp(0, FAR_M))
    nearness = torch.exp(-50 * log_depth / log_depth.max())
    values = torch.cat([colour, z.clamp(max=FAR_M)[..., None]], -1).reshape(-1, 4)
    sums = torch.zeros(height * width, 4)
    weights = torch.zeros(height * width)
    for index, weight, inside in corners(x, y, width, height):
        w = (weight * nearness * (inside & ahead)).reshape(-1)
        index = index.reshape(-1)
        sums.index_add_(0, index, values * w[:, None])
        weights.index_add_(0, index, w)
    covered = weights > 0
    return sums / torch.where(covered, weights, torch.ones_like(weights))[:, None], covered


def depth_test(depth, job, shown_depth, covered):
    """Which recorded pixels lie behind what the warp shows at their place; the warp's depth and cover by pixel."""
    height, width = depth.shape
    x, y, z, ahead = project(depth, job)
    shown = torch.zeros_like(z)
    weights = torch.zeros_like(z)
    for index, weight, inside in corners(x, y, width, height):
        w = weight * inside * covered[index]
        shown += w * shown_depth[index]
        weights += w
    known = ahead & (weights > 0)
    return known & (z.clamp(max=FAR_M) > (1 + BIAS) * shown / weights.clamp(min=1e-12))


def own_method(colour, depth, job):
    """Yields after the warp, then the mask."""
    warped, covered = splat(colour, depth, job)
    yield
    yield depth_test(depth, job, warped[:, 3], covered)


def peer_method(warper):
    def run(colour, depth, job):
        def matrix(fx, fy, cx, cy):  # its pixel centres are whole numbers
            return torch.tensor([[[fx, 0, cx - .5], [0, fy, cy - .5], [0, 0, 1]]])

        pose = torch.eye(4)[None]
        pose[0, :3, :3], pose[0, :3, 3] = torch.tensor(job["rotation"]), torch.tensor(job["translation_m"])
        frame = (colour * 2 - 1).permute(2, 0, 1)[None].contiguous()
        _, covered, _, flow = warper.forward_warp(frame, None, depth.clamp(max=1e6)[None, None], torch.eye(4)[None], pose,
                                                  matrix(*job["k_recorded"]), matrix(*job["k_shifted"]))
        yield
        z = project(depth, job)[2].clamp(0, FAR_M)[None]
        shown, _ = warper.bilinear_splatting(z[:, None], None, z, flow, None, is_image=False)
        yield depth_test(depth, job, shown.reshape(-1), covered.reshape(-1) > 0)
    return run


def load_warper(file):
    """The class alone: the file around it wants a dozen packages that the class does not."""
    found = [node for node in ast.parse(Path(file).read_text()).body if isinstance(node, ast.ClassDef) and node.name == "Warper"]
    if not found:
        sys.exit(f"torch_splat.py: {file}: class Warper: got none, expected TrajectoryCrafter's models/utils.py")
    names = {"torch": torch, "numpy": np, "np": np, "Path": Path, "Tuple": typing.Tuple, "Optional": typing.Optional}
    exec(compile(ast.Module(found, []), file, "exec"), names)
    return names["Warper"](device="cpu")


def main(folder):
    asked = json.loads((folder / "job.json").read_text())
    methods = {"torch_splat": own_method}
    if asked["peer_code"]:
        methods["trajectorycrafter"] = peer_method(load_warper(asked["peer_code"]))
    times = []
    with torch.no_grad():
        for number, job in enumerate(asked["jobs"]):
            depth = torch.from_numpy(np.load(folder / job["depth"]).astype(np.float32))
            depth = depth.reshape(depth.shape[0], depth.shape[1])
            colour = torch.rand(depth.shape[0], depth.shape[1], 3)
            for name, method in methods.items():
                if number == 0:
                    next(method(colour, depth, job))  # wakes the threads and the allocator
                for threads in job["threads"]:
                    torch.set_num_threads(threads)
                    wall, cpu = time.perf_counter(), time.process_time()
                    stages = method(colour, depth, job)
                    next(stages)
                    between = time.perf_counter()
                    occluded = next(stages)
                    times.append({"job": number, "method": name, "threads": threads,
                                  "wall_ms": (time.perf_counter() - wall) * 1e3,
                                  "cpu_ms": (time.process_time() - cpu) * 1e3, "splat_ms": (between - wall) * 1e3})
                if job["out"]:
                    np.save(folder / f"{name}_{job['out']}", occluded.numpy().astype(np.uint8))
    (folder / "result.json").write_text(json.dumps({"torch": torch.__version__, "times": times}))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
