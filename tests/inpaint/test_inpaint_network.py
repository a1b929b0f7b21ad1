# SPDX-License-Identifier: Apache-2.0
"""vshift inpaint --method network as a user runs it, with a tiny model that the test trains."""
import json
import os
import subprocess
import tempfile
import unittest
from pathlib import Path

import numpy as np

VSHIFT = os.environ["VSHIFT_BIN"]
SCENES = str(Path(VSHIFT).with_name("vshift-scenes"))
HAS_NETWORK = os.environ["VSHIFT_HAS_TORCH"] == "ON"
MODELS = Path(__file__).resolve().parents[2] / "inpaint/models"
SHORT_TRAINING = ["--streets", 1, "--frames", 1, "--width", 96, "--crop", 48, "--batch", 2, "--steps", 20, "--learning-rate", "5e-3",
                  "--threads", 1]
VIEW = ["--camera", "CAM_FRONT", "--shift", "0,2,0"]


def run(*words, **settings):
    return subprocess.run([VSHIFT, *map(str, words)], env={**os.environ, **settings}, capture_output=True, text=True, timeout=120)


class InpaintNetwork(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.scratch = tempfile.TemporaryDirectory()
        cls.addClassCleanup(cls.scratch.cleanup)
        cls.folder = Path(cls.scratch.name)
        subprocess.run([SCENES, "analytic_street", "--seed", "5", "--width", "160", "-o", str(cls.folder / "street")], check=True,
                       capture_output=True)
        cls.recipe = next((cls.folder / "street").glob("*.vshift"))
        cls.model = cls.folder / "tiny.safetensors"
        if HAS_NETWORK:
            (cls.folder / "tiny.json").write_text('{"unet": {"widths": [4, 8], "freq_dim": 4}}')
            done = run("train", "-o", cls.model, "--config", cls.folder / "tiny.json", *SHORT_TRAINING)
            assert done.returncode == 0, done.stderr

    def inpaint(self, *words, **settings):
        return run("inpaint", self.recipe, *words, **settings)

    def image(self, name, *words):
        done = self.inpaint(*VIEW, *words, "-o", self.folder / name)
        self.assertEqual(done.returncode, 0, done.stderr)
        return np.load(self.folder / name)

    def refused(self, code, part, *words, **settings):
        done = self.inpaint(*VIEW, "-o", self.folder / "refused.npy", *words, **settings)
        self.assertEqual(done.returncode, code, done.stderr)
        self.assertEqual(len(done.stderr.strip().splitlines()), 1, done.stderr)
        self.assertIn(part, done.stderr)
        self.assertFalse((self.folder / "refused.npy").exists())

    @unittest.skipUnless(HAS_NETWORK, "built without LibTorch")
    def test_known_pixels_come_back(self):
        for source in ([], ["--seam"]):
            network = self.image("network.npy", "--method", "network", "--model", self.model, *source)
            classical = self.image("classical.npy", *source)
            hole = network[..., 3] > 0.5
            self.assertTrue(100 < hole.sum() < hole.size / 2)
            self.assertTrue(np.isfinite(network).all())
            self.assertEqual(network[~hole].tobytes(), classical[~hole].tobytes())
            differs = (network[..., :3] != classical[..., :3]).any(-1)
            self.assertGreater(differs[hole].mean(), 0.9)
            self.assertLess(np.abs(network - classical)[hole].max(), 0.9)  # it begins at the fill

    @unittest.skipUnless(HAS_NETWORK, "built without LibTorch")
    def test_the_seam_says_which_pixels_a_neighbour_gave(self):
        model = self.folder / "neighbors.safetensors"
        done = run("train", "-o", model, "--config", self.folder / "tiny.json", "--arm", "seam", *SHORT_TRAINING)
        self.assertEqual(done.returncode, 0, done.stderr)
        done = run("seam", self.recipe, *VIEW, "-o", self.folder / "seam.npy")
        self.assertEqual(done.returncode, 0, done.stderr)
        source = np.load(self.folder / "seam.npy")[..., 3]
        own = [c["name"] for c in json.loads(self.recipe.read_text())["cameras"]].index("CAM_FRONT")
        given = (source >= 0) & (source != own)
        self.assertGreater(given.sum(), 100)
        classical = self.image("seam_classical.npy", "--seam")
        for file, changes in ((model, True), (self.model, False)):  # trained with neighbours, and without
            network = self.image("seam_network.npy", "--method", "network", "--model", file, "--seam")
            differs = (network[..., :3] != classical[..., :3]).any(-1)
            self.assertFalse(differs[source == own].any())
            self.assertGreater(differs[source < 0].mean(), 0.9)
            if changes:
                self.assertGreater(differs[given].mean(), 0.9)
            else:
                self.assertFalse(differs[given].any())

    @unittest.skipUnless(HAS_NETWORK, "built without LibTorch")
    def test_a_view_is_the_same_whatever_came_before(self):
        network = ["--method", "network", "--model", self.model]
        alone, again = self.image("a.npy", *network).tobytes(), self.image("b.npy", *network).tobytes()
        self.assertEqual(alone, again)
        done = self.inpaint("--camera", "*", "--shift", "0,2,0", "--method", "background,network", "--model", self.model,
                            "--out-dir", self.folder / "many")
        self.assertEqual(done.returncode, 0, done.stderr)
        arms = {p.name: sorted(p.rglob("*.exr")) for p in (self.folder / "many").iterdir()}
        self.assertEqual(sorted(arms), ["self-background", "self-network"])
        self.assertEqual(len(arms["self-background"]), len(arms["self-network"]))
        done = self.inpaint(*VIEW, *network, "-o", self.folder / "one.exr")
        of_many = next(p for p in arms["self-network"] if p.stem == "CAM_FRONT")
        self.assertEqual((self.folder / "one.exr").read_bytes(), of_many.read_bytes())

    @unittest.skipUnless(HAS_NETWORK, "built without LibTorch")
    def test_the_shipped_flow_has_texture_where_the_regression_has_none(self):
        def network(name, *words):
            return self.image("shipped.npy", "--method", "network", "--model", MODELS / f"{name}.safetensors", *words)

        def energy(image):  # squared differences to the right, in holes
            return (np.diff(image[..., :3], axis=1)[hole[:, 1:]] ** 2).sum()

        classical, mean = self.image("classical.npy"), network("rays_regression")
        hole = mean[..., 3] > 0.5
        made = [network("pixel_unet_flow", "--euler-steps", steps) for steps in (1, 2)]
        for image in made:
            self.assertEqual(image[~hole].tobytes(), classical[~hole].tobytes())
            self.assertGreater(energy(image), 1.2 * energy(mean))
        self.assertNotEqual(made[0].tobytes(), made[1].tobytes())

    @unittest.skipUnless(HAS_NETWORK, "built without LibTorch")
    def test_refuses_files(self):
        pickle, other, cut = (self.folder / n for n in ("model.pth", "text.safetensors", "cut.safetensors"))
        pickle.write_bytes(b"\x80\x02}q\x01.")
        other.write_text("no model")
        cut.write_bytes(self.model.read_bytes()[:-100])
        for file, code, part in ((pickle, 3, "pickle"), (other, 3, "text.safetensors"), (cut, 3, "cut.safetensors"),
                                 (self.folder / "none.safetensors", 4, "none.safetensors"), (self.recipe, 3, self.recipe.name)):
            self.refused(code, part, "--method", "network", "--model", file)

    def test_refuses_usage(self):
        self.refused(3, "--model", "--method", "network")
        self.refused(3, "--method network", "--model", self.model)
        self.refused(3, "nearest: network", "--method", "netwrk", "--model", self.model)
        self.refused(4, "libtorch-dev", "--method", "network", "--model", self.model,
                     VSHIFT_INPAINT_LIBRARY="/nowhere/libvshift_inpaint.so")

    def test_torch_and_openimageio_are_loaded_only_when_asked_for(self):
        def libraries(*words, output="libraries.exr"):
            done = run(*words, *VIEW, "-o", self.folder / output, LD_DEBUG="files")
            self.assertEqual(done.returncode, 0, done.stderr[-300:])
            return done.stderr
        for words in (["mask", self.recipe], ["inpaint", self.recipe]):
            loaded = libraries(*words)
            self.assertIn("libembree", loaded)
            self.assertNotIn("libtorch", loaded)
            self.assertNotIn("libOpenImageIO", loaded)
        self.assertIn("libOpenImageIO", libraries("holes", self.recipe, output="libraries.png"))
        if HAS_NETWORK:
            self.assertIn("libtorch", libraries("inpaint", self.recipe, "--method", "network", "--model", self.model))


if __name__ == "__main__":
    unittest.main(verbosity=2)
