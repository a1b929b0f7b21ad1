# SPDX-License-Identifier: Apache-2.0
"""The report's charts: matplotlib SVG, inlined, with colours that follow the page's light or dark mode."""
import io
import re

import matplotlib
matplotlib.use("svg")
from matplotlib import pyplot as plt  # noqa: E402

from report import fills, pool  # noqa: E402
from report.pool import METHOD_NAME  # noqa: E402

INK, FAINT, BACK = "#010203", "#040506", "#070809"  # stand-ins that become CSS variables
METHOD_COLOUR = {"self": "#0a7fc2", "rig": "#d55e00"}
CLASS_COLOUR = {"visible": "#8f99a3", "unseen": "#c9ced3", "unknown": "#e3d52f", "occluded": "#d55e00", "outside": "#56b4e9"}
CLASS_NAME = {"visible": "visible, certain", "unseen": "visible, but unseen", "unknown": "unknown",
              "occluded": "occluded", "outside": "outside the frame"}
STAGE_COLOUR = {"read_ms": "#8f99a3", "lift_ms": "#009e73", "build_ms": "#e69f00", "cast_ms": "#0a7fc2"}

STYLE = {"svg.fonttype": "none", "svg.hashsalt": "vshift", "font.size": 10, "axes.edgecolor": FAINT, "axes.labelcolor": INK,
         "text.color": INK, "xtick.color": INK, "ytick.color": INK, "axes.titlecolor": INK, "axes.grid": True,
         "grid.color": FAINT, "grid.linewidth": .6, "axes.axisbelow": True, "axes.spines.top": False,
         "axes.spines.right": False, "legend.frameon": False, "figure.facecolor": "none", "axes.facecolor": "none",
         "axes.titlesize": 10, "axes.titleweight": "bold", "lines.linewidth": 1.8, "lines.markersize": 5}


def svg(figure, number, title):
    """The figure as an <svg> element: own ids, CSS variables for ink, a title for screen readers."""
    out = io.StringIO()
    figure.savefig(out, format="svg", bbox_inches="tight", pad_inches=.05, transparent=True,
                   metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    plt.close(figure)
    text = out.getvalue()
    text = text[text.index("<svg"):]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.S)
    text = re.sub(r'\bid="', f'id="c{number}-', text)
    text = re.sub(r'(href="#|url\(#)', rf"\1c{number}-", text)
    for stand_in, name in ((INK, "--ink"), (FAINT, "--rule"), (BACK, "--card")):
        text = text.replace(stand_in, f"var({name})")
    text = re.sub(r"(font: [0-9a-z. ]*?px )[^;\"]*", r"\1var(--sans)", text)
    text = re.sub(r'<svg [^>]*viewBox="([^"]*)"[^>]*>',
                  lambda m: f'<svg viewBox="{m.group(1)}" role="img" aria-labelledby="c{number}-t"><title id="c{number}-t">{title}</title>', text, count=1)
    return text


def positions(manifest):
    """x of each shift, tick positions, tick labels, axis label, and whether lines may join the points."""
    shifts = manifest["shifts"]
    axis = pool.along_one_axis(shifts)
    if axis:
        x = axis[0]
        order = sorted(x, key=lambda n: x[n])
        return x, [x[n] for n in order], [f"{x[n]:+g}" for n in order], f"shift in metres ({axis[1]} is plus)", order
    x = {s["name"]: i for i, s in enumerate(shifts)}
    return x, list(x.values()), [pool.shift_label(s, True) for s in shifts], "shift", list(x)


def signed_runs(x, order, values):
    """The points in runs that a line may join: never across zero, where nothing was measured."""
    runs = [[], []]
    for name in order:
        if values.get(name) is not None:
            runs[x[name] > 0].append((x[name], values[name]))
    return [list(zip(*r)) for r in runs if r]


def chart_f1(data, number):
    """F1 of lost against the shift: a panel per camera."""
    scores, cameras = data["scores"], data["cameras"]
    x, ticks, labels, axis_label, order = positions(data["manifest"])
    columns = min(3, len(cameras))
    rows = -(-len(cameras) // columns)
    figure, axes = plt.subplots(rows, columns, figsize=(12.6 if columns > 1 else 7, 2.4 * rows + .5), sharex=True, sharey=True, squeeze=False)
    for k, ax in enumerate(axes.flat):
        if k >= len(cameras):
            ax.axis("off")
            continue
        for method in data["methods"]:
            for against, dash in (("shell", "--"), ("scene", "-")):
                values = {}
                for s in order:
                    p = pool.pool_masks(pool.select(scores["masks"], method=method, shift=s, camera=cameras[k], against=against, **{"class": "lost"}))
                    values[s] = p and p["f1"]
                for i, (xs, ys) in enumerate(signed_runs(x, order, values)):
                    ax.plot(xs, ys, dash, marker="o" if against == "scene" else "s", color=METHOD_COLOUR[method],
                            markerfacecolor=METHOD_COLOUR[method] if against == "scene" else BACK,
                            label=f"{METHOD_NAME[method]}, against the {against}" if i == 0 else None)
        ax.set_title(cameras[k], loc="left")
        ax.set_xticks(ticks, labels, **({} if max(map(len, labels)) < 5 else {"rotation": 35, "ha": "right"}))
        if k % columns == 0:
            ax.set_ylabel("F1 of lost")
        if k + columns >= len(cameras):
            ax.set_xlabel(axis_label)
            ax.tick_params(labelbottom=True)
    axes[0][0].set_ylim(top=1.005)
    handles, names = axes[0][0].get_legend_handles_labels()
    if handles:
        figure.legend(handles, names, loc="lower center", bbox_to_anchor=(.5, 1.0), ncol=2)
    figure.tight_layout()
    return svg(figure, number, "F1 of the lost mask against the shift, a panel per camera")


def chart_gap(data, number):
    """Recall a single recording can reach at all, what the method reached, and the rest: per shift and method."""
    scores = data["scores"]
    x, _, labels, axis_label, order = positions(data["manifest"])
    figure, axes = plt.subplots(1, max(1, len(data["methods"])), figsize=(12.6, 3.1), sharey=True, squeeze=False)
    for ax, method in zip(axes.flat, data["methods"]):
        for i, shift in enumerate(order):
            limit = pool.ceiling(scores, method, shift=shift)
            got = pool.pool_masks(pool.select(scores["masks"], method=method, shift=shift, against="scene", **{"class": "occluded"}))
            if limit is None or got is None:
                continue
            found = min(got["recall"], limit)
            ax.bar(i, found, .62, color=METHOD_COLOUR[method], label="found" if i == 0 else None)
            ax.bar(i, limit - found, .62, bottom=found, color="#e69f00", label="knowable, missed" if i == 0 else None)
            ax.bar(i, 1 - limit, .62, bottom=limit, color="none", edgecolor=INK, hatch="////", linewidth=.6,
                   label="not in the recording" if i == 0 else None)
            ax.text(i, 1.02, f"{100 * (1 - limit):.1f} %", ha="center", fontsize=9)
        ax.set_xticks(range(len(order)), labels, **({} if max(map(len, labels)) < 5 else {"rotation": 35, "ha": "right"}))
        ax.set_title(METHOD_NAME[method], loc="left", pad=18)
        ax.set_xlabel(axis_label)
        ax.grid(axis="x", visible=False)
    axes[0][0].set_ylim(0, 1)
    axes[0][0].set_ylabel("share of truly occluded pixels")
    handles, names = axes[0][0].get_legend_handles_labels()
    if handles:
        figure.legend(handles, names, loc="lower center", bbox_to_anchor=(.5, 1.0), ncol=3)
    figure.tight_layout()
    return svg(figure, number, "Truly occluded pixels per shift: found, knowable but missed, and not in the recording")


def chart_classes(data, number):
    """What the mask said of all pixels, per shift and method."""
    _, _, labels, axis_label, order = positions(data["manifest"])
    figure, axes = plt.subplots(1, max(1, len(data["methods"])), figsize=(12.6, 3.1), sharey=True, squeeze=False)
    for ax, method in zip(axes.flat, data["methods"]):
        for i, shift in enumerate(order):
            shares, base = pool.class_shares(data["scores"], method, shift), 0.0
            for name in CLASS_COLOUR if shares else ():
                ax.bar(i, shares[name], .62, bottom=base, color=CLASS_COLOUR[name], label=CLASS_NAME[name] if i == 0 else None)
                base += shares[name]
        ax.set_xticks(range(len(order)), labels, **({} if max(map(len, labels)) < 5 else {"rotation": 35, "ha": "right"}))
        ax.set_title(METHOD_NAME[method], loc="left")
        ax.set_xlabel(axis_label)
        ax.grid(axis="x", visible=False)
    axes[0][0].set_ylabel("share of all pixels")
    axes[0][0].set_ylim(0, 1)
    handles, names = axes[0][0].get_legend_handles_labels()
    if handles:
        figure.legend(handles, names, loc="lower center", bbox_to_anchor=(.5, 1.0), ncol=5)
    figure.tight_layout()
    return svg(figure, number, "Share of pixels by class, per shift and method")


def chart_times(data, number):
    """Median time of each stage, per method and verb. None when nothing was timed."""
    times = pool.stage_times(data["scores"])
    if not times:
        return None
    figure, ax = plt.subplots(figsize=(12.6, .42 * len(times) + .9))
    for i, row in enumerate(times):
        base = 0.0
        for stage, hue in STAGE_COLOUR.items():
            if not any(t[stage] for t in times):
                continue
            ax.barh(i, row[stage], .6, left=base, color=hue, label=stage[:-3] if i == 0 else None)
            base += row[stage]
        ax.text(base, i, f"  {base:.0f} ms", va="center", fontsize=9)
    ax.set_yticks(range(len(times)), [f"{r['out']}, {METHOD_NAME[r['method']]}" for r in times])
    ax.invert_yaxis()
    ax.grid(axis="y", visible=False)
    ax.margins(x=.12)
    ax.set_xlabel("median milliseconds a view")
    ax.legend(loc="lower center", bbox_to_anchor=(.5, 1.0), ncol=3)
    figure.tight_layout()
    return svg(figure, number, "Median time per stage, method and verb")


def charts(data):
    """All charts: list of dicts with title, svg and note."""
    with plt.rc_context(STYLE):
        out = [
            {"title": "F1 against shift", "svg": chart_f1(data, 1),
             "note": "Solid: against the true scene. Dashed, open squares: against the shell, which is all that an infinitely fine "
                     "recording from the same place could know. The gap between the two belongs to the recording; the "
                     "gap from the dashed line to 1 belongs to the method."},
            {"title": "What one recording cannot know", "svg": chart_gap(data, 2),
             "note": "Of all pixels that are truly occluded from the shifted place, the hatched part is hidden by surfaces that "
                     "the recording never saw; its share stands above each bar. No mask made from it can find them; an honest one calls them unknown."},
            {"title": "Pixels by class", "svg": chart_classes(data, 3), "note": "What the mask said of every pixel, pooled over cameras and frames."}]
        figure = fills.draw(plt, data["scores"])
        if figure is not None:
            out.append({"title": "Fills: time against what they are worth", "svg": svg(figure, 5, "Milliseconds of each fill against PSNR and FLIP in the holes"),
                        "note": "Pixels of the shifted view that no camera saw. Bars are 95 % intervals by bootstrap over frames; hollow: "
                                "the own camera's colours around the holes, filled: the seam's."})
        times = chart_times(data, 4)
        if times:
            out.append({"title": "Time per stage", "svg": times,
                        "note": f"Read the depth, lift it to triangles, build the ray-tracing structure, cast the rays (as far as each was timed). "
                                f"Median over views, {data['scores'].get('cores', '?')} cores."})
    return out
