# SPDX-License-Identifier: Apache-2.0
"""A whole set goes through warp, seam and condition frame by frame: the peak of memory does not grow with the frames.

    /usr/bin/python3 tests/streams/test_streams.py
"""
import json
import os
import shutil
import subprocess
import tempfile
import unittest
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
VSHIFT = os.environ.get("VSHIFT_BIN", str(ROOT / "build/bin/vshift"))
SCENES = os.environ.get("VSHIFT_SCENES", str(ROOT / "build/bin/vshift-scenes"))
FEW, MANY = 4, 30


class Streams(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.folder = Path(tempfile.mkdtemp())
        cls.addClassCleanup(shutil.rmtree, cls.folder)
        subprocess.run([SCENES, "analytic_street", "--width", "240", "--samples", "1", "-o", cls.folder], check=True,
                       stdout=subprocess.DEVNULL)
        recipe = json.loads((cls.folder / "analytic_street.vshift").read_text())
        for camera in recipe["cameras"]:  # the same files in every frame
            for key in ("image", "depth"):
                camera[key] = camera[key].replace("%04d", "0000")
        first = recipe["frames"][0]
        for count in (FEW, MANY):
            recipe["frames"] = [dict(first, index=i, timestamp_s=0.1 * i) for i in range(count)]
            (cls.folder / f"{count}.vshift").write_text(json.dumps(recipe))

    def peak_mb(self, verb, count, *words):
        """Of the process, when it was done."""
        out = self.folder / f"{verb}_{count}"
        process = subprocess.Popen([VSHIFT, verb, self.folder / f"{count}.vshift", "--camera", "CAM_FRONT", "--shift",
                                    "0,2,0", "--all-frames", "--out-dir", out, *words], stderr=subprocess.PIPE)
        said = process.stderr.read().decode()
        process.stderr.close()
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        self.assertEqual(process.returncode, 0, said)
        self.assertEqual(len(list(out.rglob("*.exr"))), count)
        return used.ru_maxrss / 1024

    def test_memory_does_not_grow_with_frames(self):
        for verb, words in (("seam", ()), ("condition", ()), ("warp", ("--from", "rig"))):
            with self.subTest(verb=verb, words=words):
                few, many = self.peak_mb(verb, FEW, *words), self.peak_mb(verb, MANY, *words)
                print(f"{verb} {' '.join(words)}: peak {few:.1f} MB after {FEW} frames, {many:.1f} MB after {MANY}")
                self.assertLess(many, 1.05 * few)
                shutil.rmtree(self.folder / f"{verb}_{FEW}")
                shutil.rmtree(self.folder / f"{verb}_{MANY}")


if __name__ == "__main__":
    unittest.main(verbosity=2)
