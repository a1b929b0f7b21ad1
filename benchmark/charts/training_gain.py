# SPDX-License-Identifier: Apache-2.0
"""Draws what more training pairs give: the gain over the best classical fill of models that `vshift train --judge` left.

    /usr/bin/python3 benchmark/charts/training_gain.py OUT few.judge.json more.judge.json most.judge.json

Each model lies beside its judge.json and says how many pairs and streets it saw; OUT.svg and OUT.png are drawn over the
streets that all were judged on. Models of drives in other lanes (--lanes-m) are stars, apart from the others' line.
"""
import json
import math
import struct
import sys
from pathlib import Path

import matplotlib
matplotlib.use("agg")
from matplotlib import pyplot as plt  # noqa: E402

plt.rcParams.update({"svg.hashsalt": "vshift", "font.size": 10, "axes.grid": True, "grid.color": "#dddddd",
                     "axes.spines.top": False, "axes.spines.right": False})
COLORS = {1: "#0a7fc2", 2: "#d55e00", 4: "#009e73"}


def training_record(judge_file):
    data = Path(str(judge_file).removesuffix(".judge.json") + ".safetensors").read_bytes()
    header = json.loads(data[8:8 + struct.unpack("<Q", data[:8])[0]])
    return json.loads(header["__metadata__"]["training"])


FILLS = ("background", "pushpull", "telea", "ns")


def gain_db(rows):
    """Over the best fill of all rows, which hold the fills and one model."""
    errors = {}
    for row in rows:
        way = row["way"] if row["way"] in FILLS else "network"
        errors[way] = errors.get(way, 0) + row["error"]
    return 10 * math.log10(min(errors[fill] for fill in FILLS) / errors["network"])


def main():
    out, files = sys.argv[1], sys.argv[2:]
    models = sorted(((training_record(f), json.loads(Path(f).read_text())["views"]) for f in files),
                    key=lambda m: m[0]["pairs"])
    lanes = [bool(m.get("lanes_m")) for m, _ in models]
    common = set.intersection(*({r["seed"] for r in views} for _, views in models))
    figure, ax = plt.subplots(figsize=(6, 3.8), constrained_layout=True)
    for shift, color in COLORS.items():
        gains = [gain_db([r for r in views if abs(r["shift_m"]) == shift and r["seed"] in common]) for _, views in models]
        points = [(m["pairs"], g, other) for (m, _), g, other in zip(models, gains, lanes)]
        ax.plot(*zip(*[p[:2] for p in points if not p[2]]), "o-", color=color, label=f"{shift} m")
        ax.plot(*zip(*[p[:2] for p in points if p[2]]), "*", color=color, markersize=13)
        print(f"{shift} m:", ", ".join(f"{m['pairs']} pairs {g:+.2f} dB" for (m, _), g in zip(models, gains)))
    ax.axhline(1, color="#666666", linestyle=":", linewidth=1)
    ax.set(xscale="log", xlabel="training pairs (streets)", ylabel="gain over the best classical fill, dB",
           title=f"true disocclusions, {len(common)} streets that no training saw")
    middle = [m for (m, _), other in zip(models, lanes) if not other]
    ax.set_xticks([m["pairs"] for m in middle], [f"{m['pairs']} ({m['streets']})" for m in middle])
    for (m, _), other in zip(models, lanes):
        if other:
            ax.annotate(f"{m['pairs']} pairs,\nother lanes too", (m["pairs"], ax.get_ylim()[1]), textcoords="offset points", xytext=(-14, -24), ha="right", fontsize=8)
    ax.minorticks_off()
    ax.set_ylim(bottom=min(0, ax.get_ylim()[0]))
    ax.legend(frameon=False, title="shift")
    for ending in (".png", ".svg"):
        figure.savefig(out + ending, dpi=130, metadata={"Date": None} if ending == ".svg" else None)


if __name__ == "__main__":
    main()
