#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""benchmark/run.py SET [key=value ...] [-- snakemake options]: builds, answers, scores and reports a set.

Keys are those of config.yaml; a set keeps the settings it was begun with, but frames and shifts may grow.
May be killed at any moment and started again. No lock of Snakemake's stays
behind (--nolock): two runs of one set are kept apart by the lock of the set's manifest. Exit codes: 0 done,
3 bad usage, 4 a step failed (its own message stands above), 130 interrupted.
"""
import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
MANIFEST = HERE.parent / "blender_addon" / "vshift" / "manifest.py"


def remove_stale_stamps(set_dir):
    """Stamps say that a step was done; those of steps whose files have gone or changed since are removed."""
    done = set_dir / ".done"
    if not done.is_dir():
        return
    check = subprocess.run([sys.executable, MANIFEST, "verify", set_dir], capture_output=True, text=True)
    if check.returncode == 0:
        return
    for line in check.stderr.splitlines():
        print(f"benchmark: {line}; the step runs again", file=sys.stderr)
    shutil.rmtree(done)      # cheap: every step skips what its manifest items say is there
    for result in ("scores/scores.json", "report.html"):
        (set_dir / result).unlink(missing_ok=True)


def main(words):
    if not words or words[0].startswith("-"):
        print("run.py: -: usage: got no set, expected SET [key=value ...] [-- snakemake options]", file=sys.stderr)
        return 3
    cut = words.index("--") if "--" in words else len(words)
    pairs, extra = words[1:cut], words[cut + 1:]
    known = {line.split(":")[0] for line in (HERE / "config.yaml").read_text().splitlines() if line[:1].isalpha()}
    for pair in pairs:
        key, equals, _ = pair.partition("=")
        if not equals or key not in known:
            print(f"run.py: -: {key}: got '{pair}', expected one of {', '.join(sorted(known))} with =value", file=sys.stderr)
            return 3
    set_dir = Path(words[0]).resolve()
    set_dir.mkdir(parents=True, exist_ok=True)
    remove_stale_stamps(set_dir)
    snakemake = shutil.which("snakemake")
    if not snakemake:
        print("run.py: -: snakemake: got none, expected it on the PATH (package snakemake)", file=sys.stderr)
        return 3
    pairs.append(f"python={sys.executable}")
    config = [f"set={json.dumps(str(set_dir))}"] + [_quoted(p) for p in pairs]
    command = [snakemake, "-s", str(HERE / "Snakefile"), "--directory", str(set_dir), "--nolock", "--rerun-incomplete",
               "--rerun-triggers", "mtime", "params", "--cores", "1", "--quiet", "rules", *extra, "--config", *config]
    child = subprocess.Popen(command, start_new_session=True)
    stopped = []

    def forward(number, _frame):
        """To the whole group: Snakemake alone would wait for the running step to end."""
        stopped.append(number)
        os.killpg(child.pid, signal.SIGTERM)

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, forward)
    code = child.wait()
    return 130 if stopped else (0 if code == 0 else 4)


def _quoted(pair):
    """key=value with text values as JSON strings, as Snakemake reads its --config as YAML."""
    key, _, value = pair.partition("=")
    if value[:1] in "[{":
        return pair
    try:
        float(value)
        return pair
    except ValueError:
        return f"{key}={json.dumps(value)}"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
