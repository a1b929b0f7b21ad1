# SPDX-License-Identifier: Apache-2.0
"""The paper's Table 2 on analytic streets: each arm trained at the same budget, all judged on the same true shifted views.

    /usr/bin/python3 benchmark/ablation.py -o DIR [--vshift build/bin/vshift] [--figure docs/figures]

Makes a model per arm (those that are there are kept), DIR/ablation.json (vshift train's judgement), the table on
standard output, and ablation.{svg,png}.
"""
import argparse
import json
import subprocess
import sys
from pathlib import Path

import matplotlib
import numpy as np
matplotlib.use("agg")
from matplotlib import pyplot as plt  # noqa: E402

sys.path.insert(0, str(Path(__file__).resolve().parent / "charts"))
from fills import STYLE  # noqa: E402

BLIND = ["--no-masks", "--no-depth"]
ARMS = {  # file's name: what it is called, and its options
    "extrapolation": ("extrapolation target", ["--arm", "extrapolation", *BLIND]),
    "virtual_shift": ("virtual shift", ["--arm", "virtual_shift", *BLIND]),
    "seam": ("+ seam", ["--arm", "seam", *BLIND]),
    "masks": ("+ mask channels", ["--arm", "seam", "--no-depth"]),
    "double_warp": ("+ double-warped inputs", ["--arm", "double_warp", "--no-depth"]),
    "depth": ("+ mask channels and 1/z", ["--arm", "seam"]),
}
AGAINST = {"extrapolation": "background", "virtual_shift": "extrapolation", "seam": "virtual_shift", "masks": "seam",
           "double_warp": "masks", "depth": "masks"}
# The same streets, samples, noise and steps for every arm; a smaller network than the shipped one.
BUDGET = ["--streets", "1-12", "--frames", "2", "--width", "256", "--crop", "96", "--batch", "8", "--learning-rate", "1e-3",
          "--ema", "0.99", "--threads", "1"]
NETWORK = {"unet": {"widths": [16, 32, 64, 96]}}
PANELS = (("psnr_db", "PSNR in disocclusions, dB"), ("outside_db", "PSNR outside the frame, dB"),
          ("gradient_share", "gradient energy / truth's"), ("texture_distance", "texture distance (low: near)"))


def call(*words):
    print("$", *words, file=sys.stderr)
    subprocess.run([str(w) for w in words], check=True)


def train(args):
    config = args.out / "network.json"
    config.write_text(json.dumps(NETWORK))
    files = {name: args.out / f"{name}.safetensors" for name in ARMS}
    for name, (_, options) in ARMS.items():
        if not files[name].exists():
            call(args.vshift, "train", "-o", files[name], "--config", config, *BUDGET, "--steps", args.steps, "--seed",
                 args.seed, *options)
    first, *others = files.values()
    call(args.vshift, "train", "-o", first, "--judge-only", "--judge", args.judge, "--width", "256", "--threads", "1",
         "--judge-also", ",".join(map(str, others)))
    (args.out / "ablation.json").write_text(first.with_suffix(".judge.json").read_text())


def rows_of(judged, shift):
    """(what it is called, row) in the order of the table."""
    names = {"background": "classical fill", "extrapolation": "", "virtual_shift": "", "seam+background": "seam, classical fill"}
    names.update({name: called for name, (called, _) in ARMS.items()})
    rows = {row["way"]: row for row in judged["ways"] if row["shift_m"] == shift}
    return [(called, rows[way]) for way, called in names.items()]


def paired_gain(judged, way, other):
    """PSNR of one way over another's in disocclusions, pooled, and its 95 % interval: streets drawn with replacement."""
    seeds = sorted({v["seed"] for v in judged["views"]})
    sums = {(v, s): 0.0 for v in (way, other) for s in seeds}
    for view in judged["views"]:
        if view["way"] in (way, other):
            sums[view["way"], view["seed"]] += view["error"]
    errors = np.array([[sums[v, s] for s in seeds] for v in (way, other)])
    drawn = np.random.default_rng(1).integers(0, len(seeds), (2000, len(seeds)))
    gain = 10 * np.log10(errors[1, drawn].sum(1) / errors[0, drawn].sum(1))
    return 10 * np.log10(errors[1].sum() / errors[0].sum()), *np.percentile(gain, (2.5, 97.5))


def table(judged):
    lines = ["| arm | 1 m | 2 m | 4 m | all | gain | outside the frame | gradient energy | texture distance |",
             "|---|---|---|---|---|---|---|---|---|"]
    for name, row in rows_of(judged, 0):
        same = [next(r for n, r in rows_of(judged, s) if n == name) for s in (1, 2, 4)]
        near, far = row["texture_distance_95"]
        gain = ""
        if row["steps"]:
            other = AGAINST[row["way"]]
            gain = "{:+.2f} ({:+.2f} to {:+.2f})".format(*paired_gain(judged, row["way"], other))
            gain += f" over {next(n for n, r in rows_of(judged, 0) if r['way'] == other).removeprefix('+ ')}"
        lines.append(f"| {name} | " + " | ".join(f"{r['psnr_db']:.2f}" for r in same) + f" | {row['psnr_db']:.2f} | {gain} | "
                     f"{row['outside_db']:.2f} | {row['gradient_share']:.2f} | {row['texture_distance']:.2f} ({near:.2f} to {far:.2f}) |")
    return "\n".join(lines)


def draw(judged, folder):
    rows = rows_of(judged, 0)
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(1, len(PANELS), figsize=(14, 3.4), sharey=True)
        for ax, (field, title) in zip(axes, PANELS):
            for y, (name, row) in enumerate(rows):
                low, high = row[field + "_95"]
                classical = not row["steps"]
                ax.errorbar(row[field], y, xerr=[[max(row[field] - low, 0)], [max(high - row[field], 0)]], fmt="s" if classical else "o",
                            color="#8f99a3" if classical else "#0a7fc2", capsize=3)
            ax.set_title(title, fontsize=10)
            ax.set_ylim(len(rows) - .5, -.5)
        axes[2].axvline(1, color="#333333", linewidth=1, linestyle=":")
        axes[0].set_yticks(range(len(rows)), [name for name, _ in rows])
        figure.tight_layout()
        for kind in ("svg", "png"):
            figure.savefig(folder / f"ablation.{kind}", bbox_inches="tight", dpi=140,
                           metadata={"Date": None} if kind == "svg" else None)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--vshift", type=Path, default=Path("build/bin/vshift"))
    parser.add_argument("--figure", type=Path, help="where the chart goes, else DIR")
    parser.add_argument("--steps", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--judge", default="101-116", help="streets that none trains on")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    train(args)
    judged = json.loads((args.out / "ablation.json").read_text())
    print(table(judged))
    draw(judged, args.figure or args.out)


if __name__ == "__main__":
    main()
