# SPDX-License-Identifier: Apache-2.0
"""Pooled figures: counts added up first, ratios taken once. Nothing here averages ratios, but for
boundary F1, SSIM (no counts exist for them), and says so where it does."""
import math

METHOD_NAME = {"self": "own camera", "rig": "whole rig"}
COUNTS = ("true_positive", "false_positive", "false_negative", "true_negative")


def select(rows, **wanted):
    """The rows whose fields equal `wanted`; a field given as None is not asked about."""
    return [r for r in rows if all(v is None or r[k] == v for k, v in wanted.items())]


def ratio(a, b, empty=1.0):
    """a / b, or `empty` for nothing out of nothing."""
    return a / b if b else empty


def pool_masks(rows):
    """Counts of many views added up, and their ratios. None without rows.

    Boundary F1 has no counts in scores.json: it is the mean over the views that have any pixel of
    the class in mask or truth.
    """
    if not rows:
        return None
    c = {k: sum(r[k] for r in rows) for k in COUNTS}
    tp, fp, fn = c["true_positive"], c["false_positive"], c["false_negative"]
    out = dict(c, views=len(rows), iou=ratio(tp, tp + fp + fn), precision=ratio(tp, tp + fp),
               recall=ratio(tp, tp + fn), f1=ratio(2 * tp, 2 * tp + fp + fn), boundary_f1={})
    busy = [r for r in rows if r["true_positive"] + r["false_positive"] + r["false_negative"] > 0]
    for px in ("1", "2", "4"):
        values = [r["boundary_f1"][px] for r in busy if r["boundary_f1"].get(px) is not None]
        out["boundary_f1"][px] = sum(values) / len(values) if values else None
    return out


def pool_regions(rows):
    """`occluded` within one kind of pixels, counts added up; the boundary's F1 is the mean over the views that have any."""
    if not rows:
        return None
    pixels, tp, fp, fn = (sum(r[k] for r in rows) for k in ("pixels", *COUNTS[:3]))
    busy = [r["boundary_f1"] for r in rows if sum(r[k] for k in COUNTS[:3]) and r["boundary_f1"] is not None]
    return {"views": len(rows), "pixels": pixels, "occluded": tp + fn, "f1": ratio(2 * tp, 2 * tp + fp + fn),
            "precision": ratio(tp, tp + fp), "recall": ratio(tp, tp + fn), "boundary_f1": sum(busy) / len(busy) if busy else None}


def pool_certificates(rows):
    """Certificate counts added up; wrong per million pixels called certain, and the shares not called."""
    if not rows:
        return None
    keys = ("pixels", "occluded", "occluded_wrong", "visible_certain", "visible_wrong", "visible_unseen", "unknown", "invalid")
    c = {k: sum(r[k] for r in rows) for k in keys}
    certain = c["occluded"] + c["visible_certain"]
    wrong = c["occluded_wrong"] + c["visible_wrong"]
    return dict(c, certain=certain, wrong=wrong, wrong_per_million=ratio(1e6 * wrong, certain, 0.0),
                unknown_share=ratio(c["unknown"], c["pixels"], 0.0), unseen_share=ratio(c["visible_unseen"], c["pixels"], 0.0))


def pool_warps(rows):
    """PSNR of the pixel-weighted mean squared error, SSIM as a pixel-weighted mean. Empty regions do not count."""
    squares = pixels = ssim_sum = ssim_pixels = 0.0
    for row in rows:
        n = row["pixels"]
        if row["psnr_db"] is not None or row.get("equal"):
            squares += 0.0 if row["psnr_db"] is None else n * 10 ** (-row["psnr_db"] / 10)
            pixels += n
        if row["ssim"] is not None:
            ssim_sum, ssim_pixels = ssim_sum + n * row["ssim"], ssim_pixels + n
    if not pixels:
        return None
    equal = squares == 0
    return {"pixels": int(pixels), "views": len(rows), "equal": equal,
            "psnr_db": None if equal else -10 * math.log10(squares / pixels),
            "ssim": ssim_sum / ssim_pixels if ssim_pixels else None}


def class_shares(scores, method, shift):
    """Shares of all pixels by what the method said: visible, unseen, unknown, occluded, outside; or None."""
    cert = pool_certificates(select(scores["certificates"], method=method, shift=shift))
    out = pool_masks(select(scores["masks"], method=method, shift=shift, **{"class": "outside", "against": "scene"}))
    if not cert or not out or not cert["pixels"]:
        return None
    outside = out["true_positive"] + out["false_positive"]
    n = max(cert["pixels"], cert["occluded"] + outside + cert["unknown"] + cert["visible_unseen"])
    shares = {k: v / n for k, v in (("occluded", cert["occluded"]), ("outside", outside), ("unknown", cert["unknown"]),
                                    ("unseen", cert["visible_unseen"]))}
    return {"visible": max(0.0, 1 - sum(shares.values())), **shares}


def ceiling(scores, method, **where):
    """What share of the truly occluded pixels even perfect knowledge of the recording could find; or None."""
    truth = {}
    for against in ("scene", "shell"):
        p = pool_masks(select(scores["masks"], method=method, against=against, **where, **{"class": "occluded"}))
        if not p:
            return None
        truth[against] = p["true_positive"] + p["false_negative"]
    return min(1.0, ratio(truth["shell"], truth["scene"]))


def median(values):
    """The middle value, or None of nothing."""
    values = sorted(values)
    n = len(values)
    return None if not n else (values[(n - 1) // 2] + values[n // 2]) / 2


def stage_times(scores):
    """Median milliseconds a view per method and verb: list of dicts with read_ms, lift_ms, build_ms, cast_ms."""
    out = []
    for method, verb in sorted({(r["method"], r["out"]) for r in scores["times"]}, key=lambda k: (k[0] != "self", k[1])):
        rows = select(scores["times"], method=method, out=verb)
        stages = {k: median([r[k] for r in rows if r.get(k) is not None]) or 0.0 for k in ("read_ms", "lift_ms", "build_ms", "cast_ms")}
        out.append({"method": method, "out": verb, "views": len(rows), **stages, "total_ms": sum(stages.values())})
    return out


def shift_label(shift, short=False):
    """A shift in words: '2 m left', '1 m forward, yaw +5°'."""
    words = []
    for value, (plus, minus) in zip(shift["shift"], (("forward", "back"), ("left", "right"), ("up", "down"))):
        if value:
            words.append(f"{abs(value):g} m {plus if value > 0 else minus}")
    yaw = shift.get("yaw_deg", 0)
    if yaw:
        words.append(f"yaw {yaw:+g}°")
    return (", ".join(words) or "no shift") if not short else (" ".join(words) or "0 m")


def along_one_axis(shifts):
    """Signed metres per shift name when all shifts lie along one axis without yaw (left, forward, up are plus); else None."""
    axes = {i for s in shifts for i in range(3) if s["shift"][i]}
    if len(axes) != 1 or any(s.get("yaw_deg") for s in shifts):
        return None
    axis = axes.pop()
    return {s["name"]: float(s["shift"][axis]) for s in shifts}, ("forward", "left", "up")[axis]
