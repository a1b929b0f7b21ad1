# SPDX-License-Identifier: Apache-2.0
"""vshift inpaint over a whole drive with models that look back: what a run gives does not depend on how it was cut."""
import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

VSHIFT = os.environ["VSHIFT_BIN"]
BUILT = Path(VSHIFT).parent


@unittest.skipUnless(os.environ["VSHIFT_HAS_TORCH"] == "ON", "built without LibTorch")
class Streams(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.scratch = tempfile.TemporaryDirectory()
        cls.addClassCleanup(cls.scratch.cleanup)
        cls.folder = Path(cls.scratch.name)
        tests = os.environ.get("VSHIFT_NETWORK_TESTS", str(BUILT / "vshift_network_tests"))
        subprocess.run([tests, "[models]"], env={**os.environ, "VSHIFT_MODELS": str(cls.folder)}, check=True, capture_output=True)
        subprocess.run([str(BUILT / "vshift-scenes"), "analytic_set", "--frames", "7", "--width", "64", "--height", "36", "--seed", "3",
                        "-o", str(cls.folder / "set")], check=True, capture_output=True)

    def inpaint(self, street, model, *words):
        done = subprocess.run([VSHIFT, "inpaint", str(street / "set.vshift"), "--camera", "CAM_FRONT", "--all-frames", "--shift", "0,2,0",
                               "--method", "network", "--model", str(self.folder / model), "--out-dir", str(street / "fills"), *words],
                              capture_output=True, text=True, timeout=120)
        self.assertEqual(done.returncode, 0, done.stderr)
        return done

    def street(self, name):
        to = self.folder / name
        shutil.copytree(self.folder / "set", to)
        return to

    @staticmethod
    def results(street):
        return {str(p.relative_to(street)): hashlib.sha256(p.read_bytes()).hexdigest() for p in sorted((street / "fills").rglob("*.exr"))}

    def test_a_run_that_was_cut_ends_as_an_undisturbed_one(self):
        for model in ("pixels.safetensors", "latents.safetensors"):  # one frame a piece; 1, 4, 4 ...
            with self.subTest(model=model):
                street = self.street("cut-" + model)
                self.inpaint(street, model)
                whole = self.results(street)
                self.assertEqual(len(whole), 7)
                files = sorted(whole)
                for lost in ([0], [2, 5], range(3, 7)):
                    for i in lost:
                        (street / files[i]).unlink()
                    kept = {f: (street / f).stat().st_mtime_ns for f in files if (street / f).exists()}
                    self.inpaint(street, model)
                    self.assertEqual(self.results(street), whole, f"after frames {list(lost)} were lost")
                    for f, time in kept.items():
                        self.assertEqual((street / f).stat().st_mtime_ns, time, f"{f} was there and was written again")

    def test_a_long_drive_needs_no_more_memory(self):
        recipe = json.loads((self.folder / "set" / "set.vshift").read_text())
        camera = next(c for c in recipe["cameras"] if c["name"] == "CAM_FRONT")
        recipe["cameras"] = [{**camera, "image": camera["image"].replace("%04d", "0000"), "depth": camera["depth"].replace("%04d", "0000")}]
        peaks = []
        for frames in (13, 97):
            recipe["frames"] = [{"index": i, "rotation": [1, 0, 0, 0], "translation": [0, 0, 0]} for i in range(frames)]
            drive = self.folder / "set" / f"drive{frames}.vshift"
            drive.write_text(json.dumps(recipe))
            out = self.folder / f"drive{frames}"
            process = subprocess.Popen([VSHIFT, "inpaint", str(drive), "--all-frames", "--shift", "0,2,0", "--method", "network", "--model",
                                        str(self.folder / "latents.safetensors"), "--out-dir", str(out)], stderr=subprocess.DEVNULL)
            _, process.returncode, usage = os.wait4(process.pid, 0)
            self.assertEqual(process.returncode, 0)
            self.assertEqual(len(list(out.rglob("*.exr"))), frames)
            peaks.append(usage.ru_maxrss / 1024)
        print(f"peak memory of 13 and 97 frames: {peaks[0]:.0f} and {peaks[1]:.0f} MB", file=sys.stderr)
        self.assertLess(peaks[1], 1.1 * peaks[0])

    def test_the_past_counts(self):
        # What a frame was made from includes the frames before it; and it shows in the pixels.
        street = self.street("past")
        self.inpaint(street, "pixels.safetensors")
        before = self.results(street)
        first = sorted(before)[0]
        second_picture = street / "frames" / "0001" / "CAM_FRONT.exr"
        picture = street / "frames" / "0000" / "CAM_FRONT.exr"
        shutil.copy(second_picture, picture)
        manifest = json.loads((street / "manifest.json").read_text())
        manifest["items"]["frames/0000/CAM_FRONT.exr"] = {**manifest["items"]["frames/0001/CAM_FRONT.exr"]}
        (street / "manifest.json").write_text(json.dumps(manifest))
        self.inpaint(street, "pixels.safetensors")
        after = self.results(street)
        changed = [f for f in before if before[f] != after[f]]
        self.assertIn(first, changed)
        self.assertIn(sorted(before)[1], changed)  # looks back
        self.assertIn(sorted(before)[2], changed)


if __name__ == "__main__":
    unittest.main(verbosity=2)
