# SPDX-License-Identifier: Apache-2.0
"""Tests of the report: what is on the page, that figures are pooled from counts, that broken sets are refused.

    /usr/bin/python3 tests/report/test_report.py
"""
import base64
import contextlib
import html.parser
import io
import json
import math
import os
import re
import shutil
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
sys.path[:0] = [str(HERE), str(ROOT / "benchmark")]

import fake_set  # noqa: E402
import numpy as np  # noqa: E402
from PIL import Image  # noqa: E402
from report import make_report, pictures, pool  # noqa: E402

PROGRAM = ROOT / "benchmark" / "report" / "make_report.py"
SHIFTS = ((0, 1, 0), (0, -2, 0))
CAMERAS = ("CAM_FRONT", "CAM_FRONT_LEFT")
VOID = {"meta", "img", "input", "br", "hr", "link", "use", "path", "source"}


class Page(html.parser.HTMLParser):
    """Collects links, texts, figures and the page's data; complains about tags that do not match."""

    def __init__(self, text):
        super().__init__()
        self.links, self.open, self.problems, self.figures, self.ids, self.texts = [], [], [], {}, [], []
        self.figure = None
        self.data = ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        attrs = dict(attrs)
        self.links += [attrs[k] for k in ("src", "href", "xlink:href") if k in attrs]
        if "id" in attrs:
            self.ids.append(attrs["id"])
        if "data-figure" in attrs:
            self.figure = attrs["data-figure"]
        if tag not in VOID:
            self.open.append((tag, attrs))

    def handle_startendtag(self, tag, attrs):
        self.links += [v for k, v in attrs if k in ("src", "href", "xlink:href")]

    def handle_endtag(self, tag):
        if tag in VOID:
            return
        if not self.open or self.open[-1][0] != tag:
            self.problems.append(f"</{tag}> after {self.open[-1:]}")
        else:
            self.open.pop()

    def handle_data(self, text):
        if self.open and self.open[-1][1].get("id") == "data":
            self.data += text
            return
        self.texts.append(text)
        if self.figure and self.open and self.open[-1][0] == "b":
            self.figures[self.figure] = text
            self.figure = None


def make(*words, **environment):
    """Runs the program; returns (exit code, stdout, stderr)."""
    done = subprocess.run(["/usr/bin/python3", str(PROGRAM), *map(str, words)], capture_output=True, text=True,
                          env={**os.environ, **environment}, timeout=60)
    return done.returncode, done.stdout, done.stderr


class ReportTest(unittest.TestCase):
    """One fake set of 1 frame, 2 cameras, 2 shifts, with one refused view, made once and copied to be broken."""

    @classmethod
    def setUpClass(cls):
        cls.temp = Path(tempfile.mkdtemp(prefix="vshift_report_"))
        cls.set = fake_set.make_set(cls.temp / "set", cameras=2, shifts=SHIFTS, width=96, height=54, refuse=((1, 1),))
        cls.scores = json.loads((cls.set / "scores/scores.json").read_text())
        cls.strip = cls.temp / "strip.png"
        cls.code, cls.out, cls.err = make(cls.set, "-o", cls.temp / "report.html", "--strip", cls.strip)
        cls.text = (cls.temp / "report.html").read_text() if cls.code == 0 else ""
        cls.page = Page(cls.text)
        cls.data = json.loads(cls.page.data or "{}")

    @classmethod
    def tearDownClass(cls):
        shutil.rmtree(cls.temp)

    def test_done_and_parses(self):
        self.assertEqual((self.code, self.err), (0, ""))
        self.assertEqual(self.page.problems, [])
        self.assertEqual(self.page.open, [])
        self.assertEqual(len(self.page.ids), len(set(self.page.ids)), "ids used twice")
        self.assertLess(len(self.text), 15e6)

    def test_opens_offline(self):
        for link in self.page.links:
            self.assertRegex(link, r"^(#|data:)")
        self.assertNotRegex(self.text, r"(?i)(src|href)\s*=\s*[\"']?\s*(https?:)?//")
        self.assertNotRegex(self.text, r"@import|url\(\s*[\"']?(https?:)?//")
        self.assertNotIn(str(self.temp), self.text, "a machine path on the page")

    def test_every_camera_and_shift(self):
        self.assertEqual(self.data["cameras"], list(CAMERAS))
        self.assertEqual([s["label"] for s in self.data["shifts"]], ["1 m left", "2 m right"])
        table = " ".join(self.page.texts)
        for word in (*CAMERAS, "1 m left", "2 m right", *(s["name"] for s in self.data["shifts"])):
            self.assertIn(word, table)
        views = self.data["views"]["0"]
        for camera in CAMERAS:
            self.assertIsNotNone(views[camera]["recorded"])
            for i, shift in enumerate(self.data["shifts"]):
                view = views[f"{camera}|{shift['name']}"]
                if (i, camera) == (1, CAMERAS[1]):
                    self.assertIn("refused: the camera lands in car_012", view["why"])
                    continue
                for method in ("self", "rig"):
                    for key in ("mask", "warp", "hole", "holes", "error_scene", "error_shell", "difference"):
                        self.assertLess(view[method][key], len(self.data["images"]))
        self.assertIn("the camera lands in car_012 (clearance 0.12 m < 0.30 m)", table)

    def test_pictures_decode(self):
        for text in self.data["images"]:
            head, content = text.split(",", 1)
            image = Image.open(io.BytesIO(base64.b64decode(content)))
            image.load()
            self.assertEqual(image.size, (96, 54))
            self.assertIn(image.format.lower(), head)

    def test_pooled_from_counts(self):
        for method in ("self", "rig"):
            for against in ("scene", "shell"):
                rows = [r for r in self.scores["masks"] if (r["method"], r["class"], r["against"]) == (method, "lost", against)]
                tp, fp, fn = (sum(r[k] for r in rows) for k in ("true_positive", "false_positive", "false_negative"))
                self.assertEqual(self.page.figures[f"{method}-f1-{against}"], f"{2 * tp / (2 * tp + fp + fn):.3f}")
            rows = [r for r in self.scores["certificates"] if r["method"] == method]
            total = {k: sum(r[k] for r in rows) for k in rows[0] if isinstance(rows[0][k], int)}
            wrong = 1e6 * (total["occluded_wrong"] + total["visible_wrong"]) / (total["occluded"] + total["visible_certain"])
            self.assertEqual(self.page.figures[f"{method}-wrong"].replace("\u202f", ""), f"{wrong:.0f}")
            self.assertEqual(self.page.figures[f"{method}-unknown"], f"{100 * total['unknown'] / total['pixels']:.1f} %")
            rows = [r for r in self.scores["warps"] if (r["method"], r["region"]) == (method, "seen")]
            mse = sum(r["pixels"] * 10 ** (-r["psnr_db"] / 10) for r in rows) / sum(r["pixels"] for r in rows)
            self.assertEqual(self.page.figures[f"{method}-psnr"], f"{-10 * math.log10(mse):.1f} dB")

    def test_pool_by_hand(self):
        row = {"false_positive": 1, "false_negative": 3, "true_negative": 90, "boundary_f1": {"1": .5, "2": .6, "4": None}}
        p = pool.pool_masks([{**row, "true_positive": 6}, {**row, "true_positive": 0}])
        self.assertEqual((p["true_positive"], p["iou"], p["precision"], p["recall"], p["f1"]), (6, 6 / 14, 6 / 8, 6 / 12, 12 / 20))
        self.assertEqual((p["boundary_f1"]["1"], p["boundary_f1"]["4"]), (.5, None))
        both = pool.pool_warps([{"pixels": 1, "psnr_db": None, "equal": True, "ssim": 1.0}, {"pixels": 3, "psnr_db": 20.0, "ssim": .6},
                                {"pixels": 0, "psnr_db": None, "ssim": None}])
        self.assertAlmostEqual(both["psnr_db"], -10 * math.log10(.0075))
        self.assertAlmostEqual(both["ssim"], .7)
        self.assertTrue(pool.pool_warps([{"pixels": 1, "psnr_db": None, "equal": True, "ssim": 1.0}])["equal"])

    def test_error_classes_by_hand(self):
        lost, unknown, truth = (np.array([row], bool) for row in ([1, 1, 0, 0, 0, 0], [0, 0, 0, 1, 1, 0], [1, 0, 1, 1, 0, 0]))
        self.assertEqual(pictures.error_index(lost, unknown, truth).tolist(), [[1, 2, 3, 4, 5, 0]])
        self.assertEqual(pictures.spread([3, 5, 7, 9, 11]), [3, 11, 7, 5, 9])
        self.assertEqual(pictures.srgb8(np.array([0, .0031308, .5, 1, 9, np.nan])).tolist(), [0, 10, 188, 255, 255, 0])

    def test_error_counts_equal_scores(self):
        for r in self.scores["masks"]:
            if r["class"] == "lost":
                c = self.data["views"]["0"][f"{r['camera']}|{r['shift']}"][r["method"]]["counts_" + r["against"]]
                self.assertEqual((c["tp"], c["fp"], c["fn"] + c["ul"]), (r["true_positive"], r["false_positive"], r["false_negative"]))

    def test_strip_is_a_png(self):
        image = Image.open(self.strip)
        image.load()
        self.assertEqual((image.format, image.size[0]), ("PNG", 1600))

    def refused(self, change, message, code=3, words=()):
        """A copy of the set, changed, must be refused in one line, and its old report must stay."""
        broken = self.temp / "broken"
        shutil.copytree(self.set, broken)
        try:
            (broken / "report.html").write_text("old")
            change(broken)
            with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(io.StringIO()) as err:
                got = make_report.main([str(w) for w in (broken, *words)])
            out, err = out.getvalue(), err.getvalue()
            self.assertEqual((got, out), (code, ""), err)
            self.assertEqual(len(err.splitlines()), 1, err)
            self.assertTrue(err.startswith("vshift: "), err)
            self.assertRegex(err.removeprefix("vshift: "), message)
            self.assertEqual((broken / "report.html").read_text(), "old")
            self.assertEqual([p.name for p in broken.iterdir() if p.name.endswith(".part")], [])
        finally:
            shutil.rmtree(broken)

    def test_broken_manifest(self):
        def edit(rule):
            def change(folder):
                data = json.loads((folder / "manifest.json").read_text())
                rule(data)
                (folder / "manifest.json").write_text(json.dumps(data))
            return change
        self.refused(lambda f: (f / "manifest.json").write_text('{"vshift_manifest": 1,'), r"^manifest.json: json: got .*, expected valid JSON")
        code, out, err = make(self.temp / "nowhere")
        self.assertEqual((code, out, err.count("\n")), (3, "", 1))
        self.refused(lambda f: (f / "manifest.json").unlink(), r"^manifest.json: file: got nothing, expected", 4)
        self.refused(edit(lambda d: d.pop("street")), r"^manifest.json: street: got nothing, expected")
        self.refused(edit(lambda d: d["shifts"][0].update(name="../up")), r"^manifest.json: shifts\[0\].name: got \"../up\", expected")

    def test_missing_scores(self):
        self.refused(lambda f: (f / "scores/scores.json").unlink(), r"^scores/scores.json: file: got nothing, expected", 4)
        self.refused(lambda f: (f / "scores/scores.json").write_text(json.dumps({**self.scores, "masks": [{**self.scores["masks"][0], "camera": "CAM_X"}]})),
                     r"^scores/scores.json: masks\[0\].camera: got \"CAM_X\", expected one of CAM_FRONT")

    def test_broken_pictures(self):
        relative = f"masks/self/{fake_set.shift_name(SHIFTS[0])}/0000/CAM_FRONT.exr"

        def cut(folder, honest):
            content = (folder / relative).read_bytes()[:700]
            (folder / relative).write_bytes(content)
            if honest:  # not listed in the manifest: only the decoder can tell
                data = json.loads((folder / "manifest.json").read_text())
                del data["items"][relative]
                (folder / "manifest.json").write_text(json.dumps(data))
        where = "^" + re.escape(relative)
        self.refused(lambda f: cut(f, False), where + r": sha256: got ")
        self.refused(lambda f: cut(f, True), where + r": (image|pixels): got ")
        self.refused(lambda f: (f / relative).unlink(), where + r": file: got nothing", 4)

    def test_write_failure_and_usage(self):
        self.refused(lambda f: None, r"^x.html: file: got .*, expected to write", 4, ("-o", self.temp / "no" / "x.html"))
        self.refused(lambda f: None, r"unrecognized arguments", 3, ("--frob",))
        self.refused(lambda f: None, r"--strip-camera: got \"CAM_X\"", 3, ("--strip", self.temp / "s.png", "--strip-camera", "CAM_X"))


class Foliage(unittest.TestCase):
    def test_scored_apart(self):
        """Every third row of the made-up truth shows leaves; the counts are numpy's."""
        with tempfile.TemporaryDirectory() as folder:
            folder = fake_set.make_set(folder, cameras=1, shifts=((0, 1, 0),), width=96, height=54)
            vshift = os.environ.get("VSHIFT_BIN", str(ROOT / "build" / "bin" / "vshift"))
            subprocess.run([vshift, "score", str(folder / "set.vshift")], check=True, capture_output=True)
            rows = json.loads((folder / "scores/scores.json").read_text())["mask_regions"]
            self.assertEqual(len(rows), 8)  # two methods, scene and shell, foliage and the rest
            where = f"{fake_set.shift_name((0, 1, 0))}/0000/CAM_FRONT.exr"
            truth = fake_set.read_exr(folder / "truth" / where)
            for row in rows:
                got = fake_set.read_exr(folder / "masks" / row["method"] / where)["occluded"] > .5
                want = truth["occluded" if row["against"] == "scene" else "shell_" + row["method"]] > .5
                region = ((truth["foliage"] > .5) == (row["region"] == "foliage")) & (truth["outside"] < .5)
                self.assertEqual(row["pixels"], region.sum())
                self.assertEqual([row["true_positive"], row["false_positive"], row["false_negative"]],
                                 [(got & want & region).sum(), (got & ~want & region).sum(), (~got & want & region).sum()])
            self.assertGreater(sum(r["true_positive"] for r in rows if r["region"] == "foliage"), 0)
            self.assertEqual(make(folder, "-o", folder / "r.html")[0], 0)
            text = (folder / "r.html").read_text()
            table = text[text.index('id="table-regions-of-masks"'):]
            shown = re.findall(r'<tr class="parent">(.*?)</tr>', table[:table.index("</table>")])
            self.assertEqual(len(shown), 8)
            for row in rows:  # one view each, so a row's own F1
                name = ">own camera<" if row["method"] == "self" else ">whole rig<"
                found = [r for r in shown if f'>{row["region"]}<' in r and f'>{row["against"]}<' in r and name.strip("<>") in r]
                self.assertEqual(len(found), 1)
                self.assertIn(f'>{row["f1"]:.3f}<', found[0])


if __name__ == "__main__":
    unittest.main()
