# SPDX-License-Identifier: Apache-2.0
"""Charts and tables of `vshift bench` beside its bench.json: speed_accuracy.{svg,png}, cost.{svg,png}, tables.md.

    /usr/bin/python3 benchmark/charts/speed_accuracy.py DIR/bench.json [-o DIR]
"""
import argparse
import json
import os
import sys
import tempfile
from pathlib import Path

import matplotlib
import numpy as np
matplotlib.use("agg")
from matplotlib import pyplot as plt  # noqa: E402
from matplotlib import ticker  # noqa: E402
from matplotlib.lines import Line2D  # noqa: E402

import tables  # noqa: E402

STYLE = {"svg.hashsalt": "vshift", "font.size": 10, "axes.grid": True, "grid.color": "#dddddd", "grid.linewidth": .6,
         "axes.axisbelow": True, "axes.spines.top": False, "axes.spines.right": False, "legend.frameon": False,
         "axes.titlesize": 11, "axes.titleweight": "bold", "figure.facecolor": "white"}
LOOK = {"sweep": ("#d55e00", "o"), "embree_tiles": ("#56b4e9", "D"), "embree_0.1": ("#0a7fc2", "s"), "embree_0.02": ("#7a86c8", "p"), "embree": ("#004d7a", "^"),
        "splat_1": ("#009e73", "v"), "splat_3": ("#7cc6a5", "P"), "ztest_true": ("#8f99a3", "X"),
        "torch_splat": ("#cc79a7", "h"), "trajectorycrafter": ("#8a2b6b", "H"), "ray_cast": ("#e0a800", ">"),
        "brute_force": ("#6b5b3e", "*"), "copy": ("#333333", "|")}
SIZE = {"embree_0.1": 12, "embree_0.02": 8, "embree": 6, "brute_force": 12}  # they may fall on each other


def pick(row, threads=1):
    return [t for t in row["ms"] if t["threads"] == threads]


def core_ms(t):
    """Core-milliseconds: CPU time of one thread, which a busy neighbour disturbs least."""
    return t["cpu_ms"]


# Scores crowd near 1: an axis that is even in the logarithm of what is missing.
NEAR_ONE = .004
TICKS = (0, .3, .5, .6, .7, .8, .9, .95, .98, .99, 1)


def spread_near_one(ax, lowest):
    ax.set_yscale("function", functions=(lambda y: -np.log(np.maximum(1 + NEAR_ONE - y, 1e-9)), lambda s: 1 + NEAR_ONE - np.exp(-s)))
    ax.set_ylim(max(lowest - .05, -.05), 1.0)
    ax.set_yticks([t for t in TICKS if t >= max(lowest - .05, 0)])
    ax.yaxis.set_major_formatter(ticker.FuncFormatter(lambda v, _: f"{v:g}"))
    ax.yaxis.set_minor_locator(ticker.NullLocator())


def panel(ax, summary, score, title, bench):
    """A marker per method and timed case: filled against the shell, hollow against the scene."""
    bound = [core_ms(t)["median"] for row in summary if row["method"] == "copy" for t in pick(row)]
    if bound:
        ax.axvline(min(bound), color="#333333", linewidth=1.2, linestyle=":")
    lowest = 1.0
    for row in summary:
        if row["method"] == "copy" or not pick(row):
            continue
        colour, marker = LOOK[row["method"]]
        cases = pick(row)
        # The first timed case is row-aligned, the others are not: one marker each where the cost differs.
        for number, t in enumerate(cases):
            x = core_ms(t)
            for value in score(row):
                if value is None:
                    continue
                y, low, high, filled = value
                lowest = min(lowest, low)
                ax.errorbar(x["median"], y, xerr=[[x["median"] - x["q1"]], [x["q3"] - x["median"]]],
                            yerr=[[max(y - low, 0)], [max(high - y, 0)]], fmt="none", ecolor=colour,
                            elinewidth=.9, alpha=.7 if number == 0 else 0, capsize=2)
                ax.plot(x["median"], y, marker=marker, color=colour, markersize=SIZE.get(row["method"], 9) if number == 0 else 5,
                        markerfacecolor=colour if filled else "white", markeredgewidth=1.3, linestyle="none",
                        alpha=1 if number == 0 else .6, zorder=3)
            if number > 0 and cases:
                for value in score(row):
                    if value:
                        ax.plot([core_ms(cases[0])["median"], x["median"]], [value[0]] * 2, color=colour, linewidth=.8, alpha=.5)
    ax.set_xscale("log")
    ax.set_title(title, loc="left")
    ax.set_xlabel(f"core-ms per {bench['width']}x{bench['height']} frame")
    return lowest


def milliseconds(value, _position):
    for unit, name in ((3.6e6, "h"), (6e4, "min"), (1e3, "s")):
        if value >= unit:
            return f"{value / unit:.2g} {name}"
    return f"{value:g} ms"


def f1(row):
    for against, filled in (("shell", True), ("scene", False)):
        if against in row:
            s = row[against]
            yield s["pooled_f1"], s["f1"]["q1"], s["f1"]["q3"], filled


def boundary_f1(row):
    for against, filled in (("shell", True), ("scene", False)):
        if against in row:
            s = row[against]["boundary_f1"]
            yield s["median"], s["q1"], s["q3"], filled


def flicker(row):
    if "flicker" in row:
        s = row["flicker"]
        yield s["median"], s["q1"], s["q3"], True


def caption(bench):
    machine = bench["machine"]
    cores = machine["cores"]
    return (f"{machine['cpu']}, {cores} core{'s' if cores != 1 else ''}; load when it began {machine['load_before']:.1f}, at the end "
            f"{machine['load_after']:.1f}. Core-ms: CPU time on one thread. {bench['program']}, {bench['tracer']}; "
            f"analytic street, seed {bench['seed']}" + ("; QUICK RUN: figures mean little" if bench["quick"] else "") + ".")


def draw_accuracy(bench):
    summary = bench["summary"]
    figure, axes = plt.subplots(1, 3, figsize=(15, 7))
    low = panel(axes[0], summary, f1, "F1 of `occluded`", bench)
    spread_near_one(axes[0], low)
    low = panel(axes[1], summary, boundary_f1, "boundary F1 (1.5 px)", bench)
    spread_near_one(axes[1], low)
    panel(axes[2], summary, flicker, "flicker on mono-like depth (less is better)", bench)
    axes[2].set_ylim(bottom=0)
    limit = next((row for row in summary if row["method"] == "shell_truth"), None)
    for k, ax in enumerate(axes):
        ax.set_xlim(axes[0].get_xlim())
        least, most = ax.get_xlim()
        ax.xaxis.set_major_locator(ticker.LogLocator(base=100 if most > 1e6 * least else 10))
        ax.xaxis.set_minor_locator(ticker.LogLocator(base=10))
        ax.xaxis.set_major_formatter(ticker.FuncFormatter(milliseconds))
        ax.xaxis.set_minor_formatter(ticker.NullFormatter())
        bound = [core_ms(t)["median"] for row in summary if row["method"] == "copy" for t in pick(row)]
        if bound:
            ax.text(min(bound), .02, " read depth,\n write mask", transform=ax.get_xaxis_transform(), fontsize=8, va="bottom")
        if limit and k < 2:
            y = limit["scene"]["pooled_f1"] if k == 0 else limit["scene"]["boundary_f1"]["median"]
            ax.axhline(y, color="#333333", linewidth=1, linestyle="--")
            ax.text(.99, y, "one view's limit against the scene", transform=ax.get_yaxis_transform(), fontsize=8,
                    ha="right", va="bottom")
    handles = []
    for row in summary:
        if row["method"] not in LOOK or row["method"] == "copy":
            continue
        colour, marker = LOOK[row["method"]]
        label = row["label"]
        if row["method"] in ("brute_force", "ray_cast"):
            label += " (80x45, time extrapolated)"
        if not pick(row):
            why = {"torch_splat": "torch", "ray_cast": "blender"}.get(row["method"])
            label += f" ({bench[why]})" if why else " (not measured)"
        handles.append(Line2D([], [], color=colour, marker=marker, linestyle="none", markersize=8, label=label))
    ink = "#333333"
    notes = [Line2D([], [], color=ink, marker="o", linestyle="none", markersize=8, label="filled: against what the view shows (shell)"),
             Line2D([], [], color=ink, marker="o", markerfacecolor="white", linestyle="none", markersize=8, label="hollow: against the scene"),
             Line2D([], [], color=ink, marker="o", linestyle="none", markersize=4, label="small: time of other timed cases (side camera, forward)")]
    figure.legend(handles=handles, loc="upper left", ncol=3, bbox_to_anchor=(.04, .2), fontsize=9)
    figure.legend(handles=notes, loc="upper right", ncol=1, bbox_to_anchor=(.995, .2), fontsize=9)
    figure.text(.5, .015, caption(bench) + "\nBig marker: front camera, 2 m sideways (row-aligned). Bars: quartiles of runs and of cases.",
                ha="center", fontsize=8, color="#444444", linespacing=1.5)
    figure.subplots_adjust(left=.045, right=.99, top=.94, bottom=.28, wspace=.16)
    return figure


def line(ax, x, rows, colour, marker, label, style="-"):
    pairs = sorted((a, core_ms(r)["median"], core_ms(r)["q1"], core_ms(r)["q3"]) for a, r in zip(x, rows))
    if not pairs:
        return
    xs, ys, low, high = zip(*pairs)
    ax.errorbar(xs, ys, yerr=[[y - a for y, a in zip(ys, low)], [b - y for y, b in zip(ys, high)]], color=colour,
                marker=marker, linestyle=style, linewidth=1.5, markersize=5, capsize=2, label=label,
                markerfacecolor="white" if style != "-" else colour)


NAMES = {"sweep": "sweep", "embree_tiles": "Embree, adaptive: tiles", "embree": "Embree, full resolution",
         "copy": "read depth, write mask"}


def draw_cost(bench):
    figure, axes = plt.subplots(1, 3, figsize=(15, 5.6))
    ax = axes[0]
    for method in ("copy", "sweep", "embree_tiles", "embree"):
        for camera, style in (("CAM_FRONT", "-"), ("CAM_FRONT_LEFT", "--")):
            rows = [r for r in bench["resolution"] if r["method"] == method and r["camera"] == camera]
            line(ax, [r["width"] for r in rows], rows, *LOOK[method], NAMES[method] + (", side camera" if style == "--" else ""), style)
    ax.set_xscale("log", base=2)
    ax.set_xticks(sorted({r["width"] for r in bench["resolution"]}))
    ax.xaxis.set_major_formatter(ticker.FuncFormatter(lambda v, _: f"{v:g}"))
    ax.set_xlabel("width in pixels (16:9); front camera, 2 m sideways")
    ax.set_title("against resolution", loc="left")

    ax = axes[1]
    for method in ("sweep", "embree_tiles"):
        for threads, style in ((1, "-"), (2, "--")):
            rows = [dict(r, cpu_ms=r["wall_ms"]) for r in bench["cameras"] if r["method"] == method and r["threads"] == threads]
            line(ax, [r["cameras"] for r in rows], rows, *LOOK[method],
                 f"{NAMES[method]}, {threads} thread{'s' if threads > 1 else ''}", style)
    ax.axhline(1000 / 12, color="#333333", linewidth=1, linestyle=":", label="12 Hz")
    ax.set_xlabel(f"cameras, {bench['width']}x{bench['height']}, 2 m sideways")
    ax.set_title("against the number of cameras (wall time)", loc="left")

    ax = axes[2]
    for method in ("sweep", "embree_tiles"):
        for camera, style in (("CAM_FRONT", "-"), ("CAM_FRONT_LEFT", "--")):
            rows = [r for r in bench["shifts"] if r["method"] == method and r["camera"] == camera and r["along"] == "sideways"]
            line(ax, [r["metres"] for r in rows], rows, *LOOK[method], NAMES[method] + (", side camera" if style == "--" else ""), style)
        rows = [r for r in bench["shifts"] if r["method"] == method and r["camera"] == "CAM_FRONT" and r["along"] == "forward"]
        line(ax, [r["metres"] for r in rows], rows, LOOK[method][0], "x", NAMES[method] + ", forward", ":")
    ax.set_xscale("log", base=2)
    ax.set_xticks(sorted({r["metres"] for r in bench["shifts"]}))
    ax.xaxis.set_major_formatter(ticker.FuncFormatter(lambda v, _: f"{v:g}"))
    ax.set_xlabel(f"shift in metres, {bench['width']}x{bench['height']}")
    ax.set_title("against the shift", loc="left")
    for ax in axes:
        ax.set_yscale("log")
        ax.yaxis.set_major_formatter(ticker.FuncFormatter(milliseconds))
        ax.legend(loc="upper center", bbox_to_anchor=(.5, -.13), ncol=2, fontsize=8.5)
    axes[0].set_ylabel("core time per frame")
    figure.text(.5, .015, caption(bench), ha="center", fontsize=8, color="#444444")
    figure.subplots_adjust(left=.06, right=.99, top=.93, bottom=.33, wspace=.16)
    return figure


def save(figure, folder, name):
    """Each file whole or not at all."""
    for kind in ("svg", "png"):
        handle, temporary = tempfile.mkstemp(dir=folder, suffix=f".{kind}")
        os.close(handle)
        try:
            figure.savefig(temporary, format=kind, dpi=110, metadata={"Date": None} if kind == "svg" else None)
            os.chmod(temporary, 0o644)
            os.replace(temporary, folder / f"{name}.{kind}")
        except BaseException:
            os.unlink(temporary)
            raise
    plt.close(figure)


def main(arguments):
    parser = argparse.ArgumentParser(description="Charts of `vshift bench`.")
    parser.add_argument("bench", type=Path, help="bench.json")
    parser.add_argument("-o", "--output", type=Path, help="folder; default: that of bench.json")
    options = parser.parse_args(arguments)
    folder = options.output or options.bench.parent
    bench = json.loads(options.bench.read_text())
    with plt.rc_context(STYLE):
        save(draw_accuracy(bench), folder, "speed_accuracy")
        save(draw_cost(bench), folder, "cost")
    tables.write(bench, folder / "tables.md")
    print(f"{folder}: bench.json, bench.csv, tables.md, speed_accuracy and cost as .svg and .png, differences.png")


if __name__ == "__main__":
    main(sys.argv[1:])
