# SPDX-License-Identifier: Apache-2.0
"""Every example of docs/oiiotool.md is run, and what the page says of it is checked.

A block ```sh or ```python is run in a folder with the files that the page names. `# -> FILES: claims` names files that must be
new and be as claimed (SIZE, channel names or 'N channel', type, 'N subimages'); `# prints: TEXT` is found in the output.
A file that is not claimed must not come. What the pictures show is checked below, by the name of the first file.
"""
import json
import re
import shutil
import sys
import textwrap

import numpy as np
import OpenImageIO as oiio
from support import ROOT, VSHIFT, Case, edit, environment, pixels, run, scene, write_exr

PAGE = ROOT / "docs/oiiotool.md"
FRAMES = (1, 2, 3)


def blocks():
    """(language, text, heading) of each fenced block."""
    heading, found = "", []
    for part in re.finditer(r"(?ms)^## (?P<heading>[^\n]*)$|^```(?P<language>\w*)\n(?P<text>.*?)^```$", PAGE.read_text()):
        heading = part["heading"] or heading
        if part["text"]:
            found.append((part["language"], part["text"], heading))
    return found


def prepare(folder):
    """drive.vshift with six cameras and three frames, background.exr, depth_mm.exr and live.vshift."""
    scene("rig_box", folder)
    (folder / "rig_box.vshift").rename(folder / "drive.vshift")
    shutil.rmtree(folder / "expected")
    first, moved = folder / "frames/0000", folder / "frames/0001"
    shutil.copytree(moved, folder / "frames/0002")
    shutil.copytree(first, folder / "frames/0003")
    shutil.rmtree(moved)
    first.rename(moved)

    def change(recipe):
        recipe["frames"] = [{**recipe["frames"][0], "index": i, "timestamp_s": 0.1 * i} for i in FRAMES]
        for key in ("camera", "frame"):
            recipe.pop(key)
    edit(folder / "drive.vshift", change)

    z = pixels(moved / "CAM_FRONT.exr")[0]["Z"]
    write_exr(folder / "depth_mm.exr", {"Z": 1000 * z})
    live = json.loads((folder / "drive.vshift").read_text())
    live["cameras"] = [{**live["cameras"][0], "depth": "m.exr"}]
    (folder / "live.vshift").write_text(json.dumps(live))
    ramp = np.linspace(0, 1, z.size).reshape(z.shape)
    write_exr(folder / "background.exr", {"R": ramp, "G": 1 - ramp, "B": 0 * ramp + 0.25})


class Examples(Case):
    about_s = 15     # for run_tests.py, which starts long classes first

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        prepare(cls.folder / "good")

    def files(self, folder):
        return {str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()}

    def program(self, verb, *words):
        """The same request by the command line, as {channel: array}."""
        out = self.folder / f"program_{verb}_{'_'.join(words)}.exr"
        if out.exists():
            return pixels(out)[0]
        shift = () if "--shift" in words else ("--shift", "0,1,0")
        result = run([VSHIFT, verb, self.folder / "good/drive.vshift", "--camera", "CAM_FRONT", *shift, *words, "-o", out],
                     env=environment(plugin=False))
        self.assertEqual(result.code, 0, result)
        return pixels(out)[0]

    def claim_holds(self, path, claims):
        image = oiio.ImageInput.open(str(path))
        self.assertIsNotNone(image, f"{path.name}: {oiio.geterror()}")
        specs = []
        while len(specs) < 10 and image.seek_subimage(len(specs), 0):
            specs.append(image.spec())
        image.close()
        count = 1
        for claim in (c.strip() for c in claims.split(",")):
            if found := re.fullmatch(r"(\d+) subimages", claim):
                count = int(found[1])
            for spec in specs:
                if found := re.fullmatch(r"(\d+)x(\d+)", claim):
                    self.assertEqual((spec.width, spec.height), (int(found[1]), int(found[2])), path.name)
                elif found := re.fullmatch(r"(\d+) channel", claim):
                    self.assertEqual(spec.nchannels, int(found[1]), path.name)
                elif claim in ("half", "float", "uint8", "uint16"):
                    self.assertEqual(str(spec.format), claim, path.name)
                elif not claim.endswith("subimages"):
                    self.assertEqual(" ".join(spec.channelnames), claim, path.name)
        self.assertEqual(len(specs), count, f"{path.name}: subimages")

    def test_blocks(self):
        seen = 0
        for number, (language, text, heading) in enumerate(blocks()):
            if language not in ("sh", "python"):
                continue
            with self.subTest(heading, block=number):
                seen += 1
                folder = self.folder / f"block{number}"
                shutil.copytree(self.folder / "good", folder)
                before = self.files(folder)
                words = ["bash", "-euo", "pipefail", "-c", text] if language == "sh" else [sys.executable, "-c", text]
                result = run(words, folder)
                self.assertEqual(result.code, 0, f"\n{textwrap.indent(text, '    ')}{result}")
                claimed = {}
                for kind, rest in re.findall(r"(?m)^# (->|prints:) (.*)$", text):
                    if kind == "prints:":
                        self.assertIn(rest, result.text, result)
                    else:
                        names, claims = rest.split(": ", 1)
                        claimed.update({name: claims for name in names.split()})
                self.assertTrue(claimed or "# prints:" in text, "the page does not say what comes out")
                self.assertEqual(self.files(folder) - before, set(claimed), result)
                for name, claims in claimed.items():
                    self.claim_holds(folder / name, claims)
                check = getattr(self, "shows_" + next(iter(claimed), "nothing").split(".")[0], None)
                if check:
                    check(folder)
        self.assertGreater(seen, 15)

    def test_links(self):
        """Pages and headings that are linked are there."""
        for target in re.findall(r"\]\((?!http)([^)]+)\)", PAGE.read_text()):
            page, _, anchor = target.partition("#")
            text = (PAGE.parent / page).read_text()
            self.assertIn(anchor, [re.sub(r"[^\w-]", "", h.lower().replace(" ", "-")) for h in re.findall(r"(?m)^#+ (.*)$", text)] + [""])

    # -- what the pictures show, by the block's first file ------------------------------------------------

    def shows_lost(self, folder):
        want = self.program("mask", "--frame", "1")["lost"]
        self.assertTrue(0 < want.mean() < 0.5)
        if (folder / "lost.0002.exr").exists():
            second = self.program("mask", "--frame", "2")["lost"]
            self.assertTrue((want != second).any(), "frames that differ")
            for frame, lost in zip(FRAMES, (want, second, want)):
                self.assertTrue((pixels(folder / f"lost.{frame:04d}.exr")[0]["lost"] == lost).all(), f"frame {frame}")
        elif (folder / "lost.png").exists():
            self.assertTrue((pixels(folder / "lost.exr")[0]["lost"] == want).all())
            self.assertTrue((pixels(folder / "mask.exr")[0]["lost"] == want).all())
            self.assertTrue((next(iter(pixels(folder / "lost.png")[0].values())) == want).all())

    def shows_overlay(self, folder):
        lost = self.program("mask")["lost"] > 0
        plate, _ = pixels(folder / "frames/0001/CAM_FRONT.exr")
        got, _ = pixels(folder / "overlay.exr")
        for channel, tint in (("R", 0.6), ("G", 0), ("B", 0)):
            want = np.where(lost, tint + 0.4 * plate[channel], plate[channel])
            self.assertLess(np.abs(got[channel] - want).max(), 2e-3, channel)

    def shows_composite(self, folder):
        warp, background = self.program("warp"), pixels(folder / "background.exr")[0]
        hole = warp["hole"] > 0
        self.assertTrue(hole.any() and not hole.all())
        got, _ = pixels(folder / "composite.exr")
        for channel in "RGB":
            self.assertLess(np.abs(got[channel] - np.where(hole, background[channel], warp[channel])).max(), 1e-6, channel)
        self.assertLess(np.abs(got["A"] - 1).max(), 1e-6)

    def shows_filled(self, folder):
        warp = self.program("warp")
        hole = warp["hole"] > 0
        got, _ = pixels(folder / "filled.exr")
        for channel in "RGB":
            self.assertLess(np.abs(got[channel] - warp[channel])[~hole].max(), 1e-5, channel)
        self.assertGreater(sum(got[c] for c in "RGB")[hole].min(), 0, "every hole is closed")

    def shows_six(self, folder):
        seam = self.program("seam", "--shift", "0,2,0")
        got, _ = pixels(folder / "six.exr")
        for channel in "RGB":
            self.assertTrue((got[channel] == seam[channel]).all(), channel)
        filled = seam["source"] > 0
        self.assertGreater(filled.mean(), 0.02, "neighbours fill something")
        warp = self.program("warp", "--shift", "0,2,0")
        # Beside holes only what something outside the own frame hides, which is nearer.
        hidden = filled & (warp["hole"] == 0)
        rig = self.program("warp", "--shift", "0,2,0", "--from", "rig")
        self.assertTrue((rig["Z"][hidden] < warp["Z"][hidden]).all(), "holes, and what is hidden")
        self.assertLess(hidden.mean(), 0.1)

    def shows_condition(self, folder):
        full, shares = pixels(folder / "condition.exr")[0], pixels(folder / "shares.exr")[0]
        for channel in ("own", "neighbor", "hole"):
            blocks = full[channel].reshape(15, 16, 20, 16).mean((1, 3))
            self.assertLess(np.abs(blocks - shares[channel]).max(), 1e-6, channel)
        self.assertLess(np.abs(sum(shares[c] for c in ("own", "neighbor", "hole")) - 1).max(), 1e-6)

    def shows_m(self, folder):
        """live.exr: the millimetres of frame 1's own depth."""
        self.assertLess((pixels(folder / "live.exr")[0]["lost"] != self.program("mask")["lost"]).mean(), 1e-3)

    def shows_back(self, folder):
        self.assertEqual(pixels(folder / "back.exr")[1].getattribute("vshift.camera"), "CAM_BACK")

    def shows_sheet(self, folder):
        sheet, want = next(iter(pixels(folder / "sheet.png")[0].values())), self.program("mask")["lost"]
        self.assertTrue((sheet[:240, :320] == want).all(), "CAM_FRONT in the upper left")
        self.assertTrue((sheet[:, 320:324] == 0).all() and sheet[244:, 324:644].any())

    def shows_both(self, folder):
        """Lost and occluded of one request: one line of the log, so one computation."""
        result = run(["oiiotool", "--stats", "both.exr"], folder)
        self.assertEqual(result.code, 0, result)
        text = next(text for _, text, _ in blocks() if "both.exr" in text)
        self.assertEqual(len(run(["bash", "-c", text], folder).computed), 1)
