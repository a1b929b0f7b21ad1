# SPDX-License-Identifier: Apache-2.0
"""The chart of every fill and every network setting: CPU time against PSNR, gradient energy and texture distance.

    /usr/bin/python3 benchmark/charts/network_steps.py MODEL.judge.json ... [-o DIR]

The files are what `vshift train --judge-only --judge STREETS --judge-also MODEL,... --euler-steps 1,2,4,8` writes; several
must be of the same views.
"""
import argparse
import json
import re
import sys
from pathlib import Path

import matplotlib
matplotlib.use("agg")
from matplotlib import pyplot as plt  # noqa: E402
from matplotlib import ticker  # noqa: E402

from fills import STYLE  # noqa: E402

PANELS = (("psnr_db", "PSNR in disocclusions, dB"), ("gradient_share", "gradient energy, share of the truth's"),
          ("texture_distance", "texture distance (lower is nearer)"))
COLOURS = ("#0a7fc2", "#d55e00", "#009e73", "#cc79a7", "#6b5b3e", "#b79f00")
# Three of the classical fills lie close together.
LABEL_SIDES = {"pushpull": ((-6, 4), "right"), "ns": ((-6, 4), "right")}
MARKERS = ("o", "s", "D", "^", "v", "P")


def series(rows):
    """{name: rows in the order of their steps}; classical fills one each."""
    out = {}
    for row in rows:
        out.setdefault(re.sub(r", \d+ steps?$", "", row["way"]), []).append(row)
    return out


def rows_of(files):
    """Pooled over all shifts; a way that several files have, from the first."""
    rows, views = {}, None
    for file in files:
        judged = json.loads(file.read_text())
        of = {(v["seed"], v["camera"], v["shift_m"], v["disoccluded_px"]) for v in judged["views"]}
        views = views or of
        if of != views:
            sys.exit(f"network_steps: {file}: got other views than {files[0]} has, expected the same")
        for row in judged["ways"]:
            if row["shift_m"] == 0:
                rows.setdefault(row["way"], row)
    return list(rows.values())


def draw(rows):
    networks = [name for name, of in series(rows).items() if of[0]["steps"]]
    figure, axes = plt.subplots(1, len(PANELS), figsize=(14, 4.2))
    for ax, (field, title) in zip(axes, PANELS):
        for name, of in series(rows).items():
            x, y = [r["cpu_ms"] for r in of], [r[field] for r in of]
            spread = [[v - (r[field + "_95"] or [v])[0] for v, r in zip(y, of)], [(r[field + "_95"] or [v])[-1] - v for v, r in zip(y, of)]]
            network = name in networks
            colour = COLOURS[networks.index(name) % len(COLOURS)] if network else "#8f99a3"
            marker = MARKERS[networks.index(name) % len(MARKERS)] if network else "x"
            ax.errorbar(x, y, yerr=spread, color=colour, marker=marker, capsize=2, linewidth=1, label=name if network else None)
            for r, px, py in zip(of, x, y):
                many = network and len(of) > 1
                text = str(r["steps"]) if many else "" if network else name
                offset, side = LABEL_SIDES.get(text, ((6, 5), "left"))
                ax.annotate(text, (px, py), textcoords="offset points", xytext=offset, ha=side, fontsize=8, color=colour)
        if field == "gradient_share":
            ax.axhspan(.85, 1.15, color="#009e73", alpha=.12, linewidth=0)
        ax.set_xscale("log")
        ax.xaxis.set_major_formatter(ticker.FuncFormatter(lambda v, _: f"{v:g}"))
        ax.set_xlabel("CPU ms per view, one thread")
        ax.set_title(title, fontsize=10)
    axes[1].legend(fontsize=8, loc="center left", bbox_to_anchor=(0, .66))
    figure.tight_layout()
    return figure


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("judged", type=Path, nargs="+")
    parser.add_argument("-o", "--out", type=Path, default=Path("docs/figures"))
    args = parser.parse_args()
    with plt.rc_context(STYLE):
        figure = draw(rows_of(args.judged))
        for kind in ("svg", "png"):
            figure.savefig(args.out / f"network_steps.{kind}", bbox_inches="tight", dpi=140,
                           metadata={"Date": None} if kind == "svg" else None)
    print(args.out / "network_steps.png")


if __name__ == "__main__":
    main()
