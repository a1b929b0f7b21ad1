# SPDX-License-Identifier: Apache-2.0
"""vshift depth as a user runs it: from pictures without depth to a shifted view, with a tiny model that the test trains."""
import json
import os
import subprocess
import tempfile
import unittest
from pathlib import Path

import numpy as np

VSHIFT = os.environ["VSHIFT_BIN"]
BUILT = Path(VSHIFT).parent
HAS_NETWORK = os.environ["VSHIFT_HAS_TORCH"] == "ON"


def run(*words):
    return subprocess.run([VSHIFT, *map(str, words)], capture_output=True, text=True, timeout=120)


class Depth(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.scratch = tempfile.TemporaryDirectory()
        cls.addClassCleanup(cls.scratch.cleanup)
        cls.folder = Path(cls.scratch.name)
        subprocess.run([str(BUILT / "vshift-scenes"), "analytic_street", "--seed", "5", "--width", "96", "--frames", "2", "-o",
                        str(cls.folder / "street")], check=True, capture_output=True)
        street = next((cls.folder / "street").glob("*.vshift"))
        recipe = json.loads(street.read_text())
        for camera in recipe["cameras"]:
            for key in ("depth", "depth_channel", "depth_source"):
                camera.pop(key, None)
        cls.recipe = street.with_name("pictures.vshift")  # nothing but pictures
        cls.recipe.write_text(json.dumps(recipe))
        cls.model = cls.folder / "tiny.safetensors"
        if HAS_NETWORK:
            (cls.folder / "tiny.json").write_text('{"unet": {"widths": [8, 12], "freq_dim": 4}}')
            done = run("train", "--kind", "depth", "-o", cls.model, "--config", cls.folder / "tiny.json", "--streets", 1, "--frames", 1,
                       "--width", 96, "--batch", 2, "--steps", 40, "--learning-rate", "5e-3", "--ema", .9, "--threads", 1, "--judge", 101)
            assert done.returncode == 0, done.stderr
            subprocess.run([str(BUILT / "vshift_network_tests"), "[models]"], env={**os.environ, "VSHIFT_MODELS": str(cls.folder)},
                           check=True, capture_output=True)

    def refused(self, code, part, *words):
        done = run("depth", self.recipe, "-o", self.recipe.with_name("refused.vshift"), *words)
        self.assertEqual(done.returncode, code, done.stderr)
        self.assertEqual(len(done.stderr.strip().splitlines()), 1, done.stderr)
        self.assertIn(part, done.stderr)
        self.assertFalse(self.recipe.with_name("refused.vshift").exists())

    def test_no_depth_is_said_so(self):
        done = run("mask", self.recipe, "--camera", "CAM_FRONT", "--shift", "0,1,0", "-o", self.folder / "x.exr")
        self.assertEqual(done.returncode, 3)
        self.assertIn("CAM_FRONT: depth: got nothing, expected a depth map (vshift depth", done.stderr)
        self.assertEqual(run("check", self.recipe).returncode, 0)

    @unittest.skipUnless(HAS_NETWORK, "built without LibTorch")
    def test_from_pictures_to_a_shifted_view(self):
        mono = self.recipe.with_name("mono.vshift")
        done = run("depth", self.recipe, "--depth-model", self.model, "-o", mono)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertEqual(len(list(self.recipe.with_name("mono").rglob("*.exr"))), 12)
        self.assertEqual(run("check", mono).returncode, 0)
        cameras = json.loads(mono.read_text())["cameras"]
        self.assertEqual({c["depth_source"] for c in cameras}, {"mono"})
        done = run("inpaint", mono, "--camera", "CAM_FRONT", "--frame", 1, "--shift", "0,2,0", "-o", self.folder / "view.npy")
        self.assertEqual(done.returncode, 0, done.stderr)
        view = np.load(self.folder / "view.npy")
        self.assertTrue(np.isfinite(view).all())
        self.assertTrue(0 < view[..., 3].mean() < 0.7)
        # It knows how high it stands: the road before the car has a road's depth within a fifth.
        done = run("warp", mono, "--camera", "CAM_FRONT", "--shift", "0,0,0", "--channels", "Z", "-o", self.folder / "z.npy")
        self.assertEqual(done.returncode, 0, done.stderr)
        z = np.load(self.folder / "z.npy")
        camera = next(c for c in cameras if c["name"] == "CAM_FRONT")
        k = np.array(camera["intrinsic"])
        road = camera["translation"][2] * k[1, 1] / (51.5 - k[1, 2])
        self.assertLess(abs(np.median(z[51, 30:66]) / road - 1), 0.2)

    @unittest.skipUnless(HAS_NETWORK, "built without LibTorch")
    def test_the_judge_says_how_wrong_it_is(self):
        said = json.loads(self.model.with_suffix(".judge.json").read_text())
        self.assertEqual(said["streets"], [101])
        depth, masks = said["depth"], {(m["shift_m"], m["depth"]): m for m in said["masks"]}
        self.assertTrue(0 < depth["abs_rel"] < 2 and 0 < depth["delta1"] < 1 and 0.3 < depth["scale"] < 3, depth)
        for shift in (1, 2, 4):
            self.assertGreater(masks[shift, "exact"]["f1"], 0.6)
            self.assertLess(masks[shift, "mono"]["f1"], masks[shift, "exact"]["f1"])

    @unittest.skipUnless(HAS_NETWORK, "built without LibTorch")
    def test_programs_need_trust(self):
        script = self.folder / "seven.pt"
        self.refused(3, "--trust-model", "--depth-model", script)
        mono = self.recipe.with_name("seven.vshift")
        done = run("depth", self.recipe, "--depth-model", script, "--trust-model", "-o", mono)
        self.assertEqual(done.returncode, 0, done.stderr)
        done = run("warp", mono, "--camera", "CAM_FRONT", "--shift", "0,0,0", "--channels", "Z", "-o", self.folder / "seven.npy")
        self.assertEqual(done.returncode, 0, done.stderr)
        z = np.load(self.folder / "seven.npy")
        self.assertTrue((np.abs(z[2:-2, 2:-2] - 7) < 1e-3).all())
        self.refused(3, "expected forward(colors [1, 3, H, W])", "--depth-model", self.folder / "nothing.pt", "--trust-model")
        broken = self.folder / "broken.pt"
        broken.write_bytes(script.read_bytes()[:400])
        self.refused(3, "TorchScript module", "--depth-model", broken, "--trust-model")
        # One of ours for another task is no estimator of depth; a pickle is nothing.
        self.refused(3, "config", "--depth-model", self.folder / "pixels.safetensors")
        pickle = self.folder / "x.pth"
        pickle.write_bytes(b"\x80\x02}q\x01.")
        self.refused(3, "pickle", "--depth-model", pickle, "--trust-model")

    def test_refuses_places(self):
        for output, part in ((self.folder / "elsewhere.vshift", "in the recipe's folder"), (self.recipe, "the recipe itself"),
                             (self.recipe.with_name("x.json"), "a .vshift file")):
            done = run("depth", self.recipe, "-o", output)
            self.assertEqual(done.returncode, 3, done.stderr)
            self.assertIn(part, done.stderr)


if __name__ == "__main__":
    unittest.main(verbosity=2)
