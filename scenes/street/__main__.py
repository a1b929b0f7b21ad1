# SPDX-License-Identifier: CC0-1.0
"""python3 -m street --seed 1 --detail 2: counts per category and the geometry hash as JSON."""
import argparse
import json
import time

from . import generate


def main():
    a = argparse.ArgumentParser(prog="street", description=__doc__)
    a.add_argument("--seed", type=int, default=1)
    a.add_argument("--detail", type=int, default=2, choices=(0, 1, 2, 3))
    a.add_argument("--length_m", type=float, default=240.0)
    a.add_argument("--traffic", type=float, default=1.0)
    o = a.parse_args()
    start = time.perf_counter()
    s = generate(seed=o.seed, detail=o.detail, length_m=o.length_m, traffic=o.traffic)
    print(json.dumps({
        "seed": o.seed, "detail": o.detail, "length_m": o.length_m, "traffic": o.traffic,
        "categories": s.counts(), "parts": len(s.parts), "instances": len(s.instances), "movers": len(s.movers),
        "triangles": s.triangle_count(), "generate_s": round(time.perf_counter() - start, 2),
        "geometry_hash": s.geometry_hash()}, indent=1))


if __name__ == "__main__":
    main()
