# SPDX-License-Identifier: GPL-3.0-or-later
"""python3 tests/blender/test_resume.py: a set killed with SIGKILL at several moments ends like one that was not.

Plain Python; starts Blender over the small street at 64x36. $BLENDER names another Blender.
"""
import importlib.util
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import unittest
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
spec = importlib.util.spec_from_file_location("manifest", ROOT / "blender_addon" / "vshift" / "manifest.py")
manifest = importlib.util.module_from_spec(spec)
spec.loader.exec_module(manifest)


def command(folder):
    return [os.environ.get("BLENDER", "blender"), "-b", "--factory-startup", "--python-exit-code", "3", "-P",
            str(ROOT / "tests/blender/run_small.py"), "--", "set", "--out", str(folder), "--width", "64", "--height", "36",
            "--samples", "1", "--shifts", "0,1,0;0,4,0;0,-1,0"]


def run(folder, stop_after=None, delay_s=0.0, sig=signal.SIGKILL):
    """Runs the set; after `stop_after` progress lines and delay_s sends sig. (exit code, names made)."""
    child = subprocess.Popen(command(folder), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    made = []
    for line in child.stderr:
        words = line.split()
        if len(words) > 3 and words[0] == "vshift:" and "/" in words[1] and words[1][0].isdigit():
            made.append(words[2])
            if len(made) == stop_after:
                time.sleep(delay_s)
                child.send_signal(sig)
    child.stderr.close()
    return child.wait(), made


def files(folder):
    return {p.relative_to(folder).as_posix() for p in Path(folder).rglob("*") if p.is_file()} - {".manifest.lock"}


class Resume(unittest.TestCase):
    def test_killed_and_resumed(self):
        root = Path(tempfile.mkdtemp(prefix="vshift_resume_"))
        try:
            code, whole = run(root / "whole")
            self.assertEqual(code, 0)
            all_made, in_time = [], 0
            # after so many finished items, and a little later: inside a write, a hash or a render
            for stop, delay in ((1, 0.0), (3, 0.004), (5, 0.02), (7, 0.05), (2, 0.011)):
                code, made = run(root / "killed", stop, delay)
                self.assertIn(code, (-signal.SIGKILL, 0))
                in_time += code != 0
                all_made += made
                data = manifest.load(root / "killed")
                for name, item in data["items"].items():
                    if item["status"] == "done":
                        self.assertTrue(manifest.is_done(root / "killed", data, name), name)
            self.assertGreaterEqual(in_time, 3, "kills that came before the set was done")
            code, made = run(root / "killed")
            self.assertEqual(code, 0)
            all_made += made
            self.assertEqual(len(all_made), len(set(all_made)), "an item was made twice")
            self.assertLessEqual(set(all_made), set(whole))
            self.assertEqual(files(root / "killed"), files(root / "whole"), "torn or temporary files stayed")
            a, b = (manifest.load(root / n)["items"] for n in ("whole", "killed"))
            self.assertEqual({n: i.get("sha256") for n, i in a.items()}, {n: i.get("sha256") for n, i in b.items()})
            self.assertEqual({n: i["status"] for n, i in a.items()}, {n: i["status"] for n, i in b.items()})
        finally:
            shutil.rmtree(root, ignore_errors=True)

    def test_terminated(self):
        root = Path(tempfile.mkdtemp(prefix="vshift_resume_"))
        try:
            code, made = run(root, 2, 0.0, signal.SIGTERM)
            self.assertEqual(code, 130)
            self.assertFalse((root / ".tmp").exists())
            data = manifest.load(root)
            self.assertGreaterEqual(sum(manifest.is_done(root, data, n) for n in data["items"]), len(made))
            self.assertGreater(len(manifest.left(data)), 0, "the signal came too late to mean anything")
        finally:
            shutil.rmtree(root, ignore_errors=True)

    def test_a_changed_file_is_made_again(self):
        root = Path(tempfile.mkdtemp(prefix="vshift_resume_"))
        try:
            self.assertEqual(run(root)[0], 0)
            victim = "frames/0000/CAM_BACK.exr"
            (root / victim).write_bytes(b"torn")
            self.assertEqual(manifest.main(["verify", str(root)]), 4)
            code, made = run(root)
            self.assertEqual((code, made), (0, [victim]))
            self.assertEqual(manifest.main(["verify", str(root)]), 0)
        finally:
            shutil.rmtree(root, ignore_errors=True)


if __name__ == "__main__":
    sys.exit(0 if unittest.main(exit=False, verbosity=2).result.wasSuccessful() else 1)
