# SPDX-License-Identifier: Apache-2.0
"""The report's part on filled views: the ablation, scores by region, consistency, the fill chart, and pictures."""
import math
import random
import re

from report import pool

SOURCES = {"self": "own camera", "rig": "whole rig, nearest surface", "seam": "whole rig, seam"}
FILLS = {"background": "background side (ours)", "pushpull": "push-pull (OpenImageIO)", "telea": "Telea (OpenCV)",
         "ns": "Navier-Stokes (OpenCV)"}
COLOUR = {"background": "#d55e00", "pushpull": "#0a7fc2", "telea": "#009e73", "ns": "#cc79a7"}
OTHER = "#6b5b3e"
MARK = {"self": "o", "rig": "s", "seam": "D"}
REGIONS = {"lost": "not seen by the own camera", "neighbour": "seen by a neighbour alone", "hole": "seen by nobody",
           "hole_disoccluded": "… behind an edge", "hole_outside": "… out of frame", "own": "seen by the own camera",
           "seam_band": "3 px round a seam", "visible": "seen by anybody", "all": "whole view"}
PICTURE_ARMS = 6


def split(arm):
    """Where an arm's colours are from, and what filled the rest: 'seam-telea' is ('seam', 'telea')."""
    source, _, fill = arm.partition("-")
    return source, fill


def arm_name(arm):
    """An arm in words."""
    source, fill = split(arm)
    return f"{SOURCES.get(source, source)} + {FILLS.get(fill, fill)}" if fill else arm


def order(arm):
    source, fill = split(arm)
    return ([*SOURCES].index(source) if source in SOURCES else 9, [*FILLS].index(fill) if fill in FILLS else 9, arm)


def arms(scores):
    """Arms with scores, own camera first, our fill first."""
    return sorted({r["arm"] for r in scores.get("image_summary", [])}, key=order)


def rows(scores, **wanted):
    return pool.select(scores.get("image_summary", []), **wanted)


def distances(scores):
    """Pools of both signs of a shift, near to far: ['1 m', '2 m']."""
    names = {r["shift"] for r in scores.get("image_summary", []) if r["shift"].endswith(" m")}
    return sorted(names, key=lambda n: float(n.split()[0]))


def one(scores, **wanted):
    found = rows(scores, camera="all", **wanted)
    return found[0] if found else None


def tables(scores):
    """The rows of the page's tables, or None where nothing was filled."""
    names, steps = arms(scores), distances(scores)
    if not names:
        return None
    best = {(region, step): max((r["psnr_db"] for a in names if (r := one(scores, arm=a, shift=step, region=region)) and r["psnr_db"] is not None), default=None)
            for region in REGIONS for step in steps}
    ablation = [{"arm": arm, "name": arm_name(arm), "source": split(arm)[0],
                 "cells": [{"lost": one(scores, arm=arm, shift=s, region="lost"), "hole": one(scores, arm=arm, shift=s, region="hole"),
                            "best_lost": best["lost", s], "best_hole": best["hole", s]} for s in steps]} for arm in names]
    regions = [{"region": region, "words": words, "rows": [(arm_name(a), r) for a in picture_arms(scores) if (r := one(scores, arm=a, shift="all", region=region))]}
               for region, words in REGIONS.items()]
    consistency = [{"name": arm_name(arm), "temporal": {r["region"]: r for r in pool.select(scores.get("temporal", []), arm=arm, shift="all")},
                    "overlap": {r["region"]: r for r in pool.select(scores.get("overlap", []), arm=arm, shift="all")}} for arm in names]
    return {"steps": steps, "ablation": ablation, "regions": [r for r in regions if r["rows"]],
            "consistency": consistency, "frames": max(r["frames"] for r in scores["image_summary"])}


def metres(shift):
    """How far a shift's name goes: 2.0 of x+0.00_y-2.00_z+0.00_yaw+0.00."""
    return math.hypot(*(float(v) for v in re.fullmatch(r"x(.*)_y(.*)_z(.*)_yaw.*", shift).groups()))


def bootstrap(sums, seed=1, rounds=2000):
    """95 % interval of sum / weight over pairs drawn with replacement; None of fewer than two."""
    if len(sums) < 2:
        return None
    draw_one, means = random.Random(seed), []
    for _ in range(rounds):
        drawn = [draw_one.choice(sums) for _ in sums]
        means.append(pool.ratio(sum(s for s, _ in drawn), sum(w for _, w in drawn)))
    means.sort()
    return means[round(.025 * (rounds - 1))], means[round(.975 * (rounds - 1))]


def pooled(sets):
    """Scores of several sets as those of one, pooled by pixel count over all cameras; intervals over the frames of all sets.

    Times are CPU times: the medians of the set whose run was least disturbed.
    """
    pools = {}
    for number, scores in enumerate(sets):
        for r in scores["images"]:
            if r["psnr_db"] is None and not r.get("equal"):
                continue
            error = 0.0 if r.get("equal") else r["pixels"] * 10 ** (-r["psnr_db"] / 10)
            for shift in (f"{metres(r['shift']):g} m", "all"):
                frames = pools.setdefault((r["arm"], shift, r["region"]), {})
                sums = frames.setdefault((number, r["frame"]), [0, 0.0, 0.0, 0.0, 0])
                for i, value in enumerate((r["pixels"], error, r["flip"] * r["pixels"], r["ssim"] * r["pixels"], 1)):
                    sums[i] += value
    summary = []
    for (arm, shift, region), frames in sorted(pools.items()):
        n, error, flip, ssim, views = (sum(f[i] for f in frames.values()) for i in range(5))
        spread = bootstrap([(f[1], f[0]) for f in frames.values()])
        summary.append({"arm": arm, "shift": shift, "camera": "all", "region": region, "frames": len(frames), "views": views, "pixels": n,
                        "psnr_db": -10 * math.log10(error / n) if error else None, "flip": flip / n, "ssim": ssim / n,
                        "psnr_db_95": [-10 * math.log10(e) for e in reversed(spread)] if spread and spread[0] > 0 else None,
                        "flip_95": bootstrap([(f[2], f[0]) for f in frames.values()])})
    out = {"image_summary": summary, "images": [], "fill_times": []}
    for arm in sorted({t["arm"] for s in sets for t in s["fill_times"]}):
        times = [t for s in sets for t in s["fill_times"] if t["arm"] == arm]
        told = {key: [t[key] for t in times if t.get(key) is not None] for key in ("fill_cpu_ms", "warp_cpu_ms")}
        out["fill_times"].append({"arm": arm, "views": sum(t["views"] for t in times), **{k: min(v, default=None) for k, v in told.items()}})
    for table in ("temporal", "overlap"):
        out[table] = []
        for key in sorted({(r["arm"], r["shift"], r["region"]) for s in sets for r in s[table]}):
            found = [r for s in sets for r in pool.select(s[table], arm=key[0], shift=key[1], region=key[2])]
            n = sum(r["pixels"] for r in found)
            out[table].append({"arm": key[0], "shift": key[1], "region": key[2], "pixels": n,
                               **{k: sum(r[k] * r["pixels"] for r in found) / n for k in ("difference", "truth_difference")}})
    return out


def markdown(scores):
    """The table of docs/measured.md."""
    def db(arm, shift, region, spread=False):
        r = one(scores, arm=arm, shift=shift, region=region)
        if not r or r["psnr_db"] is None:
            return ""
        low_high = r.get("psnr_db_95") if spread else None
        return f"{r['psnr_db']:.1f}" + (f" ({low_high[0]:.1f}-{low_high[1]:.1f})" if low_high else "")
    steps = distances(scores)
    lines = ["| colors, fill | " + " | ".join(f"lost, {s}" for s in steps) + " | hole, all shifts | hole behind an edge | hole out of frame | neighbour alone |",
             "|---" * (len(steps) + 5) + "|"]
    for arm in arms(scores):
        cells = [db(arm, s, "lost") for s in steps] + [db(arm, "all", "hole", True)]
        cells += [db(arm, "all", region) for region in ("hole_disoccluded", "hole_outside", "neighbour")]
        lines.append(f"| {arm_name(arm)} | " + " | ".join(cells) + " |")
    for table, words in (("temporal", "warping error"), ("overlap", "overlap of cameras")):
        for arm in arms(scores):
            for r in pool.select(scores.get(table, []), arm=arm, shift="all", region="lost"):
                lines.append(f"{words}, lost, {arm}: {1000 * r['difference']:.1f} thousandths, true renders {1000 * r['truth_difference']:.1f}")
    return "\n".join(lines)


def draw(plt, scores, region="hole"):
    """CPU milliseconds a view against PSNR and against FLIP in the region, an arm a marker; 95 % intervals. None without times."""
    times = {t["arm"]: t["fill_cpu_ms"] for t in scores.get("fill_times", []) if t.get("fill_cpu_ms")}
    names = [a for a in arms(scores) if a in times and one(scores, arm=a, shift="all", region=region)]
    if not names:
        return None
    figure, axes = plt.subplots(1, 2, figsize=(12.6, 4.2))
    for ax, key, words in zip(axes, ("psnr_db", "flip"), ("PSNR in the holes, dB (more is better)", "FLIP in the holes (less is better)")):
        for arm in names:
            source, fill = split(arm)
            row = one(scores, arm=arm, shift="all", region=region)
            low, high = row[key + "_95"] or (row[key], row[key])
            ax.errorbar(times[arm], row[key], yerr=[[row[key] - low], [high - row[key]]], fmt=MARK.get(source, "^"),
                        color=COLOUR.get(fill, OTHER), markersize=9, capsize=3, elinewidth=1.1,
                        markerfacecolor=COLOUR.get(fill, OTHER) if source == "seam" else "none", markeredgewidth=1.6,
                        label=arm_name(arm))
        ax.set_xscale("log")
        ax.set_xlabel("fill, median CPU milliseconds a view")
        ax.set_title(words, loc="left")
        ax.margins(x=.12, y=.12)
        ticks = [t for t in (1, 2, 3, 5, 10, 20, 30, 50, 100, 200, 500, 1000) if ax.get_xlim()[0] <= t <= ax.get_xlim()[1]]
        ax.set_xticks(ticks, [f"{t:g}" for t in ticks])
        ax.minorticks_off()
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", bbox_to_anchor=(.5, 1.0), ncol=3)
    figure.tight_layout()
    return figure


def picture_arms(scores):
    """Arms whose pictures the page holds: our fill of each source and the best peer, and networks first of all."""
    names = arms(scores)
    wanted = [a for a in names if split(a)[1] not in FILLS] + [a for a in names if split(a)[1] == "background"]
    wanted += [a for a in ("seam-telea", "rig-telea", "self-telea") if a in names][:1]
    return sorted(wanted[:PICTURE_ARMS], key=order)


def view_scores(scores, shift, frame, camera):
    """PSNR per arm of one view: {arm: {region: dB}}."""
    out = {}
    for r in pool.select(scores.get("images", []), shift=shift, frame=frame, camera=camera):
        if r["region"] in ("all", "lost", "hole"):
            out.setdefault(r["arm"], {})[r["region"]] = r["psnr_db"]
    return out
