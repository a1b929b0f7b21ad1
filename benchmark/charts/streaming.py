# SPDX-License-Identifier: Apache-2.0
"""The paper's efficiency figure: memory and CPU time against the number of frames, streamed and with full attention.

    /usr/bin/python3 benchmark/charts/streaming.py build/bin/vshift_network_tests docs/figures/streaming

Every point is a process of its own on one thread (the latent DiT of 1 M parameters that `[streaming]` makes, never
trained, 224x128, 2 steps, window 4). Writes NAME.csv, NAME.png and NAME.svg; with NAME.csv alone given, draws it again.
"""
import csv
import os
import re
import subprocess
import sys
from pathlib import Path

import matplotlib
matplotlib.use("agg")
from matplotlib import pyplot as plt  # noqa: E402

plt.rcParams.update({"svg.hashsalt": "vshift", "font.size": 10, "axes.grid": True, "axes.axisbelow": True, "grid.color": "#dddddd",
                     "axes.spines.top": False, "axes.spines.right": False})
FRAMES = {"streamed": [13, 49, 97, 193, 385, 1001], "full": [13, 25, 49, 97]}
PARTS = {"encode": "#0a7fc2", "DiT": "#d55e00", "decode": "#1b9e77"}
LINE = re.compile(r"streaming: (\d+) frames, (\w+), peak (\d+) MB, ms a frame: encode ([\d.]+), DiT ([\d.]+), decode ([\d.]+)")


def measure(program):
    rows = []
    for kind, all_frames in FRAMES.items():
        for frames in all_frames:
            said = subprocess.run([program, "[streaming]"], check=True, capture_output=True, text=True, env={
                **os.environ, "OMP_WAIT_POLICY": "passive", "VSHIFT_STREAM": str(frames if kind == "streamed" else -frames)}).stdout
            number, word, peak, *ms = LINE.search(said).groups()
            rows.append({"frames": int(number), "kind": word, "peak_mb": int(peak), **dict(zip(PARTS, map(float, ms)))})
            print(rows[-1], flush=True)
    return rows


def draw(rows, name):
    figure, (memory, streamed, full) = plt.subplots(1, 3, figsize=(12, 3.7), constrained_layout=True)
    of = {kind: [r for r in rows if r["kind"] == kind] for kind in FRAMES}
    for kind, color in (("streamed", "#0a7fc2"), ("full", "#d55e00")):
        memory.plot([r["frames"] for r in of[kind]], [r["peak_mb"] for r in of[kind]], "o-", color=color,
                    label="streamed, window 4" if kind == "streamed" else "in one shot, full attention")
    memory.set(xlabel="frames", ylabel="peak memory of the process, MB", xscale="log", title="Memory")
    memory.set_ylim(0)
    memory.legend(frameon=False)
    top = 1.15 * max(sum(r[p] for p in PARTS) for r in rows)
    for ax, kind, title in ((streamed, "streamed", "CPU time a frame, streamed"), (full, "full", "CPU time a frame, full attention")):
        below = [0.0] * len(of[kind])
        for part, color in PARTS.items():
            values = [r[part] for r in of[kind]]
            ax.bar(range(len(values)), values, bottom=below, color=color, width=.6, label=part)
            below = [a + b for a, b in zip(below, values)]
        ax.set_xticks(range(len(below)), [r["frames"] for r in of[kind]])
        ax.set(xlabel="frames", ylabel="ms", title=title, ylim=(0, top))
        ax.grid(axis="x", visible=False)
    streamed.legend(frameon=False, ncols=3, loc="upper left")
    for ax in (memory,):
        ax.set_xticks([13, 49, 97, 385, 1001], ["13", "49", "97", "385", "1001"])
        ax.minorticks_off()
    for ending in (".png", ".svg"):
        figure.savefig(f"{name}{ending}", dpi=130, metadata={"Date": None} if ending == ".svg" else None)


def main():
    if sys.argv[1].endswith(".csv"):
        name = sys.argv[1].removesuffix(".csv")
        with open(sys.argv[1], newline="") as file:
            rows = [{k: v if k == "kind" else float(v) if k in PARTS else int(v) for k, v in r.items()} for r in csv.DictReader(file)]
    else:
        name = sys.argv[2]
        rows = measure(str(Path(sys.argv[1]).resolve()))
        with open(f"{name}.csv", "w", newline="") as file:
            out = csv.DictWriter(file, ["frames", "kind", "peak_mb", *PARTS], lineterminator="\n")
            out.writeheader()
            out.writerows(rows)
    draw(rows, name)


if __name__ == "__main__":
    main()
