#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""What oiiotool with the plugin costs over the program: whole processes for one mask at 1600x900, run in pairs, in turn.

    /usr/bin/python3 benchmark/plugin_overhead.py [--recipe FILE --camera NAME] [--shift 0,2,0] [--pairs 11] [--json FILE]

Without --recipe a street with analytic depth is written for the run. The two images must be the same to the bit. Both
write the same file: an EXR of five float channels, ZIP. Exit code 2 when the ratio exceeds --at-most.
"""
import argparse
import json
import os
import platform
import re
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests/oiio_plugin"))

from support import VSHIFT, environment  # noqa: E402


def timed(words, folder, env):
    """Wall and processor seconds of a whole process, which must succeed."""
    before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    result = subprocess.run(words, cwd=folder, env=env, capture_output=True, text=True)
    wall, after = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
    if result.returncode != 0:
        sys.exit(f"plugin_overhead.py: {' '.join(words)}: got exit {result.returncode}: {result.stderr.strip()}, expected 0")
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def summary(values):
    low, middle, high = statistics.quantiles(values, n=4)
    return {"median": middle, "quartiles": [low, high], "min": min(values), "max": max(values), "values": values}


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--recipe", type=Path)
    parser.add_argument("--camera", default="CAM_FRONT")
    parser.add_argument("--shift", default="0,2,0")
    parser.add_argument("--pairs", type=int, default=11)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--at-most", type=float, default=1.15)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="vshift_overhead_") as folder:
        if asked.recipe:
            recipe = asked.recipe.resolve()
        else:
            import street
            recipe = street.write(Path(folder))
        request = f"camera={asked.camera}&shift={asked.shift}"
        ways = {"vshift": [VSHIFT, "mask", str(recipe), "--camera", asked.camera, "--shift", asked.shift, "-o", "program.exr"],
                "oiiotool": ["oiiotool", f"{recipe}?{request}", "-o", "plugin.exr"],
                "oiiotool alone": ["oiiotool", "program.exr", "-o", "copy.exr"]}
        env = environment()
        times = {way: [] for way in ways}
        for number in range(asked.pairs + 1):
            order = list(ways)[:2][::1 if number % 2 else -1] if number else list(ways)[:2]
            for way in (*order, "oiiotool alone"):
                took = timed(ways[way], folder, env)
                if number:      # the first round warms the caches of files
                    times[way].append(took)
        same = subprocess.run(["idiff", "-q", "-fail", "0", "-warn", "0", "program.exr", "plugin.exr"], cwd=folder, env=env)
        if same.returncode != 0:
            sys.exit("plugin_overhead.py: plugin.exr: got other pixels than program.exr, expected the same")
    pairs = [tool[0] / program[0] for tool, program in zip(times["oiiotool"], times["vshift"])]
    version = subprocess.run(["oiiotool", "--version"], capture_output=True, text=True).stdout.strip()
    model = re.search(r"model name\s*: (.*)", Path("/proc/cpuinfo").read_text())
    result = {"request": request, "pairs": asked.pairs, "cores": len(os.sched_getaffinity(0)),
              "cpu": model[1] if model else platform.machine(), "oiio": version, "at_most": asked.at_most,
              "wall_s": {way: summary([wall for wall, _ in t]) for way, t in times.items()},
              "cpu_s": {way: statistics.median(cpu for _, cpu in t) for way, t in times.items()},
              "ratio": summary(pairs)}
    print(f"{'':16}{'wall s, median':>16}{'quartiles':>16}{'CPU s':>8}")
    for way, s in result["wall_s"].items():
        print(f"{way:16}{s['median']:16.3f}{s['quartiles'][0]:9.3f}-{s['quartiles'][1]:.3f}{result['cpu_s'][way]:8.2f}")
    ratio = result["ratio"]
    print(f"oiiotool / vshift, median of {asked.pairs} pairs: {ratio['median']:.3f} "
          f"(quartiles {ratio['quartiles'][0]:.3f}-{ratio['quartiles'][1]:.3f}), {result['cores']} cores, OpenImageIO {version}")
    if asked.json:
        asked.json.write_text(json.dumps(result, indent=1) + "\n")
    return 0 if ratio["median"] <= asked.at_most else 2


if __name__ == "__main__":
    sys.exit(main())
