# SPDX-License-Identifier: Apache-2.0
"""Masks of a scored set per camera and shift, foliage apart, as a Markdown table on standard output.

    blender -b --factory-startup --python-exit-code 3 -P blender_addon/run.py -- truth --out SET
    vshift mask SET/set.vshift --camera '*' --all-frames --all-shifts --from self --out-dir SET/masks/self
    vshift score SET/set.vshift
    /usr/bin/python3 benchmark/charts/street_masks.py SET
"""
import json
import sys
from pathlib import Path

from tables import f1, grouped, mean, table


def counts(rows):
    return sum(r["true_positive"] for r in rows), sum(r["false_positive"] + r["false_negative"] for r in rows)


def line(name, rows):
    """F1 over the pixels of all rows; the boundary's is their mean."""
    def pick(against, *regions):
        return [r for r in rows if r["against"] == against and r["region"] in regions]

    def score(found):
        return f"{f1(counts(found)):.3f}"

    rest, foliage = pick("shell", "rest"), pick("shell", "foliage")
    pixels = sum(r["pixels"] for r in rest) + sum(r["pixels"] for r in foliage)
    return (*name, score(rest), f"{mean(r['boundary_f1'] for r in rest):.3f}", score(foliage),
            f"{sum(r['pixels'] for r in foliage) / pixels:.0%}", score(rest + foliage), score(pick("scene", "rest")),
            score(pick("scene", "rest", "foliage")))


def main(folder):
    rows = json.loads((folder / "scores" / "scores.json").read_text())["mask_regions"]
    head = ("from", "camera", "shift", "F1 shell", "boundary F1", "F1 shell, foliage", "pixels of foliage", "F1 shell, all",
            "F1 scene", "F1 scene, all")

    def name_of(shift_m):
        return ",".join(f"{v:g}" for v in shift_m)

    out = [line((method, camera, name_of(group[0]["shift_m"])), group)
           for (method, camera, _), group in grouped(rows, "method", "camera", "shift").items()]
    out += [line((f"**{method}**", "**all**", f"**±{distance:g} m**"), group)
            for (method, distance), group in grouped([{**r, "distance": max(map(abs, r["shift_m"]))} for r in rows],
                                                     "method", "distance").items()]
    out += [line((f"**{method}**", "**all**", "**all**"), group) for (method,), group in grouped(rows, "method").items()]
    print(table(head, out))


main(Path(sys.argv[1]))
