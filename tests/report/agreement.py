# SPDX-License-Identifier: Apache-2.0
"""Our image scores against independent implementations: scikit-image (SSIM, PSNR), NVIDIA's flip-evaluator, numpy
(gradients) and an MS-SSIM written here on scipy's filters. Each is compared where it can be imported, else skipped.

    /usr/bin/python3 tests/report/agreement.py
    pip install --target DIR flip-evaluator scikit-image; PYTHONPATH=DIR /usr/bin/python3 tests/report/agreement.py
"""
import importlib
import json
import os
import subprocess
import tempfile
import unittest
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

ROOT = Path(__file__).resolve().parents[2]
VSHIFT = os.environ.get("VSHIFT_BIN", str(ROOT / "build/bin/vshift"))
LUMA = np.array([0.2126, 0.7152, 0.0722])


def module(name):
    """The module, or a skipped test that says what is missing."""
    try:
        return importlib.import_module(name)
    except ImportError as e:
        raise unittest.SkipTest(f"{name} cannot be imported ({e}): nothing to compare with") from e


def write(path, rgb):
    spec = oiio.ImageSpec(rgb.shape[1], rgb.shape[0], rgb.shape[2], "float")
    spec.channelnames = ("R", "G", "B") if rgb.shape[2] == 3 else ("Y",)
    out = oiio.ImageOutput.create(str(path))
    assert out and out.open(str(path), spec) and out.write_image(np.ascontiguousarray(rgb, np.float32)) and out.close()


def linear(srgb):
    return np.where(srgb <= .04045, srgb / 12.92, ((srgb + .055) / 1.055) ** 2.4)


def street(seed, width=320, height=200):
    """A picture with edges, flats and texture, in display values; and a spoiled copy."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:height, 0:width]
    image = np.stack([.4 + .3 * np.sin(x / 37 + c) * np.cos(y / 23 - c) for c in range(3)], -1)
    for _ in range(25):
        x0, y0, w, h = rng.integers(0, width), rng.integers(0, height), rng.integers(5, 70), rng.integers(5, 60)
        image[y0:y0 + h, x0:x0 + w] = rng.uniform(0, 1, 3)
    image += rng.normal(0, .03, image.shape)
    image = image.clip(0, 1)
    other = .9 * np.roll(image, (1, 2), (0, 1)) + .1 * image.mean((0, 1)) + rng.normal(0, .02, image.shape)
    other[60:120, 100:180] = other[60:120, 100:180].mean((0, 1))
    return image.clip(0, 1), other.clip(0, 1)


class Agreement(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = Path(folder.name)

    def ours(self, truth, got, border=0):
        """What vshift score says, and the display values it saw; `border` pixels at the edge are left out."""
        for name, image in (("truth", truth), ("got", got)):
            write(self.folder / f"{name}.exr", linear(image))
        words = [VSHIFT, "score", "--got", self.folder / "got.exr", "--truth", self.folder / "truth.exr"]
        if border:
            inside = np.zeros(truth.shape[:2] + (1,), np.float32)
            inside[border:-border, border:-border] = 1
            write(self.folder / "inside.exr", inside)
            words += ["--region", self.folder / "inside.exr"]
        return json.loads(subprocess.run(list(map(str, words)), check=True, capture_output=True, text=True).stdout)

    def both(self, score, border=0):
        """Largest difference over five pictures between our score and `score(truth, got)`."""
        worst = 0
        for seed in range(5):
            truth, got = street(seed)
            mine, theirs = score(self.ours(truth, got, border), truth, got)
            worst = max(worst, abs(mine - theirs))
        print(f"{self.id().split('.')[-1]}: largest difference {worst:.2e}")
        return worst

    def test_psnr(self):
        metrics = module("skimage.metrics")
        self.assertLess(self.both(lambda ours, t, g: (ours["psnr_db"], metrics.peak_signal_noise_ratio(t, g, data_range=1))), 1e-6)

    def test_ssim(self):
        metrics = module("skimage.metrics")  # it leaves out the 5 pixels at the border where windows are cut

        def score(ours, t, g):
            return ours["ssim"], metrics.structural_similarity(t @ LUMA, g @ LUMA, data_range=1, gaussian_weights=True,
                                                               sigma=1.5, use_sample_covariance=False)
        self.assertLess(self.both(score, border=5), 1e-7)

    def test_gradient_error(self):
        def score(ours, t, g):
            d = np.gradient(t @ LUMA - g @ LUMA)
            return ours["gradient_error"], np.hypot(*d).mean()
        self.assertLess(self.both(score), 1e-6)

    def test_ms_ssim(self):
        ndimage = module("scipy.ndimage")
        power = [.0448, .2856, .3001, .2363, .1333]

        def blur(a):  # windows cut at the border: weights outside count nothing
            def b(v):
                return ndimage.gaussian_filter(v, 1.5, truncate=5 / 1.5, mode="constant")
            return b(a) / b(np.ones_like(a))

        def score(ours, t, g):
            a, b, product = t @ LUMA, g @ LUMA, 1
            for s, p in enumerate(power):
                ma, mb = blur(a), blur(b)
                va, vb, cov = blur(a * a) - ma * ma, blur(b * b) - mb * mb, blur(a * b) - ma * mb
                m = (2 * cov + .03 ** 2) / (va + vb + .03 ** 2)
                if s == 4:
                    m = m * (2 * ma * mb + .01 ** 2) / (ma * ma + mb * mb + .01 ** 2)
                product *= max(m.mean(), 0) ** p
                a, b = (v[:v.shape[0] // 2 * 2, :v.shape[1] // 2 * 2].reshape(v.shape[0] // 2, 2, v.shape[1] // 2, 2).mean((1, 3)) for v in (a, b))
            return ours["ms_ssim"], product
        self.assertLess(self.both(score), 1e-7)

    def test_flip(self):
        flip = module("flip_evaluator")

        def score(ours, t, g):
            _, mean, _ = flip.evaluate(t.astype(np.float32), g.astype(np.float32), "LDR", inputsRGB=True,
                                       parameters={"ppd": 3840 * np.pi / 180})
            return ours["flip"], mean
        self.assertLess(self.both(score), 1e-5)


if __name__ == "__main__":
    unittest.main(verbosity=2)
