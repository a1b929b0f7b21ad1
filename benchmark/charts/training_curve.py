# SPDX-License-Identifier: Apache-2.0
"""Draws DIR/NAME.curve.csv of `vshift train` as NAME.curve.png and NAME.curve.svg.

    /usr/bin/python3 benchmark/charts/training_curve.py DIR/NAME.curve.csv
"""
import sys
from pathlib import Path

import matplotlib
import numpy as np
matplotlib.use("agg")
from matplotlib import pyplot as plt  # noqa: E402

plt.rcParams.update({"svg.hashsalt": "vshift", "font.size": 10, "axes.grid": True, "grid.color": "#dddddd",
                     "axes.spines.top": False, "axes.spines.right": False})


def main():
    file = Path(sys.argv[1])
    rows = np.atleast_1d(np.genfromtxt(file, delimiter=",", names=True))
    step, loss = rows["step"], rows["loss"]
    figure, ax = plt.subplots(figsize=(7, 3.6), constrained_layout=True)
    ax.plot(step, loss, color="#c9ced3", linewidth=.8, label="loss of each step")
    span = max(1, len(loss) // 50)
    if span > 1:  # means of whole spans: nothing is invented at the ends
        n = len(loss) // span * span
        ax.plot(step[:n].reshape(-1, span).mean(1), loss[:n].reshape(-1, span).mean(1), color="#d55e00", linewidth=1.8,
                label=f"mean of {span} steps")
    ax.set(xlabel="step", ylabel="loss (weighted squared error)", yscale="log", title=file.name.removesuffix(".curve.csv"))
    rate = ax.twinx()
    rate.plot(step, rows["learning_rate"], color="#0a7fc2", linewidth=1, linestyle=":")
    rate.set_ylabel("learning rate (dotted)", color="#0a7fc2")
    rate.set_ylim(0)
    rate.grid(False)
    ax.legend(frameon=False)
    for ending in (".png", ".svg"):
        figure.savefig(file.with_suffix(ending), dpi=130, metadata={"Date": None} if ending == ".svg" else None)


if __name__ == "__main__":
    main()
