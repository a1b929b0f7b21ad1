# SPDX-License-Identifier: Apache-2.0
"""Fills, scores and report of a small analytic set, from the command line to the page.

    /usr/bin/python3 tests/report/test_fills.py
"""
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "benchmark"))
from report import fills  # noqa: E402
VSHIFT = os.environ.get("VSHIFT_BIN", str(ROOT / "build/bin/vshift"))
SCENES = os.environ.get("VSHIFT_SCENES", str(ROOT / "build/bin/vshift-scenes"))


def run(*words, code=0):
    done = subprocess.run(list(map(str, words)), capture_output=True, text=True, timeout=300)
    assert done.returncode == code, f"{words}: got {done.returncode}, expected {code}: {done.stderr}"
    return done


def pixels(path):
    image = oiio.ImageInput.open(str(path))
    try:
        names = list(image.spec().channelnames)
        return dict(zip(names, np.moveaxis(np.asarray(image.read_image(0, 0, 0, len(names), oiio.FLOAT)), 2, 0)))
    finally:
        image.close()


class Fills(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.folder = Path(tempfile.mkdtemp())
        cls.addClassCleanup(shutil.rmtree, cls.folder)
        cls.set = cls.folder / "set"
        run(SCENES, "analytic_set", "--width", 96, "--frames", 2, "--samples", 1, "-o", cls.set)
        every = ("--camera", "*", "--all-frames", "--all-shifts")
        recipe = cls.set / "set.vshift"
        run(VSHIFT, "inpaint", recipe, "--method", "background,telea", *every, "--out-dir", cls.set / "fills")
        run(VSHIFT, "inpaint", recipe, "--seam", *every, "--out-dir", cls.set / "fills")
        run(VSHIFT, "mask", recipe, *every, "--out-dir", cls.set / "masks/self")
        # A result that is the truth itself: every score must say so.
        shutil.copytree(cls.set / "shifts", cls.set / "fills/perfect")
        run(VSHIFT, "score", recipe)
        cls.scores = json.loads((cls.set / "scores/scores.json").read_text())

    def summary(self, **wanted):
        found = [r for r in self.scores["image_summary"] if all(r[k] == v for k, v in wanted.items())]
        self.assertEqual(len(found), 1, wanted)
        return found[0]

    def test_a_perfect_result_scores_perfectly(self):
        for region in ("all", "own", "lost", "hole", "seam_band"):
            row = self.summary(arm="perfect", shift="all", camera="all", region=region)
            self.assertIsNone(row["psnr_db"])
            self.assertTrue(row["equal"])
            self.assertAlmostEqual(row["ssim"], 1, places=12)
            self.assertEqual(row["flip"], 0)
            self.assertEqual(row["gradient_error"], 0)
            self.assertAlmostEqual(row["sharpness"], 1, places=12)
        for table in ("temporal", "overlap"):
            rows = [r for r in self.scores[table] if r["arm"] == "perfect"]
            self.assertTrue(rows)
            for row in rows:
                self.assertEqual(row["difference"], row["truth_difference"])
                self.assertEqual(row["error_change"], 0)

    def test_regions_are_counted_from_truth(self):
        """Pixels of each region over all views, counted here from truth.class."""
        classes = np.concatenate([pixels(p)["truth.class"].ravel() for p in (self.set / "shifts").rglob("*.exr")])
        for region, mask in (("all", classes >= 0), ("own", classes == 0), ("neighbour", (classes > 0) & (classes < 3)),
                             ("hole", classes >= 3), ("hole_outside", classes == 4), ("lost", classes > 0)):
            row = self.summary(arm="self-background", shift="all", camera="all", region=region)
            self.assertEqual(row["pixels"], int(mask.sum()), region)

    def test_pooled_psnr_is_the_psnr_of_all_pixels(self):
        def srgb(v):
            v = np.clip(v, 0, 1)
            return np.where(v <= .0031308, 12.92 * v, 1.055 * v ** (1 / 2.4) - .055)
        squares = count = 0
        for truth_file in (self.set / "shifts").rglob("*.exr"):
            truth = pixels(truth_file)
            got = pixels(self.set / "fills/seam-background" / truth_file.relative_to(self.set / "shifts"))
            lost = truth["truth.class"] > 0
            for c in "RGB":
                d = srgb(got[c].astype(float)) - srgb(truth[c].astype(float))
                squares, count = squares + (d[lost] ** 2).sum(), count + lost.sum()
        row = self.summary(arm="seam-background", shift="all", camera="all", region="lost")
        self.assertAlmostEqual(row["psnr_db"], -10 * np.log10(squares / count), places=4)
        low, high = row["psnr_db_95"]
        self.assertLessEqual(low, row["psnr_db"])
        self.assertGreaterEqual(high, row["psnr_db"])

    def test_a_set_pooled_alone_is_itself(self):
        pooled = fills.pooled([self.scores])
        twice = fills.pooled([self.scores, self.scores])
        for arm, shift, region in (("self-telea", "all", "hole"), ("seam-background", "2 m", "lost"), ("self-background", "4 m", "neighbour")):
            row = self.summary(arm=arm, shift=shift, camera="all", region=region)
            for got, times in ((fills.one(pooled, arm=arm, shift=shift, region=region), 1), (fills.one(twice, arm=arm, shift=shift, region=region), 2)):
                self.assertAlmostEqual(got["psnr_db"], row["psnr_db"], places=6)
                self.assertAlmostEqual(got["flip"], row["flip"], places=9)
                self.assertEqual((got["pixels"], got["frames"]), (times * row["pixels"], times * row["frames"]))
        self.assertIn("| own camera + Telea (OpenCV) |", fills.markdown(pooled))

    def test_known_pixels_are_the_warp_bit_for_bit(self):
        words = ("--camera", "CAM_FRONT", "--frame", 1, "--shift", "0,2,0")
        warp, filled = self.folder / "w.exr", self.folder / "f.exr"
        run(VSHIFT, "warp", self.set / "set.vshift", *words, "-o", warp)
        for method in ("background", "pushpull", "telea", "ns"):
            run(VSHIFT, "inpaint", self.set / "set.vshift", *words, "--method", method, "-o", filled)
            a, b = pixels(warp), pixels(filled)
            known = a["hole"] < .5
            self.assertTrue(known.any() and not known.all())
            for c in "RGB":
                self.assertEqual(a[c][known].tobytes(), b[c][known].tobytes())
                self.assertTrue(np.isfinite(b[c]).all())
            self.assertTrue((b["R"][~known] > 0).mean() > .9)

    def test_a_second_run_makes_nothing_anew(self):
        file = self.set / "fills/self-telea/x+0.00_y+1.00_z+0.00_yaw+0.00/0000/CAM_FRONT.exr"
        before = file.stat().st_mtime_ns
        run(VSHIFT, "inpaint", self.set / "set.vshift", "--method", "telea", "--camera", "*", "--all-frames", "--all-shifts", "--out-dir", self.set / "fills")
        self.assertEqual(file.stat().st_mtime_ns, before)
        self.assertEqual(len(json.loads((file.parents[2] / "run.json").read_text())), 2 * 6 * 6)

    def test_bad_usage(self):
        recipe = self.set / "set.vshift"
        for words, said in ((("--method", "tela", "-o", "x.exr"), "nearest: telea"),
                            (("--method", "ns,ns", "--out-dir", "x"), "ns twice"),
                            (("-o", "x.exr", "--out-dir", "x"), "got both"),
                            (("--camera", "*", "-o", "x.exr"), "more than one view"),
                            (("--shift", "0,nan,0", "-o", "x.exr"), "shift")):
            self.assertIn(said, run(VSHIFT, "inpaint", recipe, *words, code=3).stderr)
        for words, said in ((("glas",), "nearest: glass"), (("glass", "--width", 7), "64 to 4096"), (("glass", "--shifts", "9"), "up to 4")):
            self.assertIn(said, run(VSHIFT, "stress", *words, "-o", self.folder / "stress", code=3).stderr)
        self.assertIn("--region", run(VSHIFT, "score", recipe, "--region", "x.exr", code=3).stderr)

    def test_report_shows_the_arms(self):
        page_file = self.folder / "page.html"
        run(VSHIFT, "report", self.set / "set.vshift", "-o", page_file)
        page = page_file.read_text()
        data = json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.S).group(1))
        self.assertIn("seam-background", [a["name"] for a in data["arms"]])
        view = data["views"]["0"]["CAM_FRONT|x+0.00_y+2.00_z+0.00_yaw+0.00"]["fills"]
        self.assertTrue(data["images"][view["seam-background"]["picture"]].startswith("data:image/jpeg"))
        row = self.summary(arm="seam-background", shift="2 m", camera="all", region="lost")
        table = page[page.index('id="table-ablation"'):]
        self.assertIn(f"{row['psnr_db']:.2f}", table[:table.index("</table>")])
        for part in ("table-regions", "table-consistency", "fill-slider"):
            self.assertIn(f'id="{part}"', page)

    def test_report_of_one_frame(self):
        one = self.folder / "one"  # nothing to compare over time
        run(SCENES, "analytic_set", "--width", 64, "--frames", 1, "--samples", 1, "-o", one)
        every = ("--camera", "*", "--all-frames", "--all-shifts")
        run(VSHIFT, "inpaint", one / "set.vshift", *every, "--out-dir", one / "fills")
        run(VSHIFT, "mask", one / "set.vshift", *every, "--out-dir", one / "masks/self")
        run(VSHIFT, "score", one / "set.vshift")
        run(VSHIFT, "report", one / "set.vshift", "-o", self.folder / "one.html")
        self.assertIn('id="table-consistency"', (self.folder / "one.html").read_text())


if __name__ == "__main__":
    unittest.main(verbosity=2)
