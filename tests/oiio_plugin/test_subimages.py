# SPDX-License-Identifier: Apache-2.0
"""All cameras of a rig as named subimages, in oiiotool, iinfo and the API."""
import re

from support import MASK, Case, edit, environment, pixels, probe, run, scene

CAMERAS = ["CAM_FRONT", "CAM_FRONT_LEFT", "CAM_FRONT_RIGHT", "CAM_BACK", "CAM_BACK_LEFT", "CAM_BACK_RIGHT"]


class Rig(Case):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        recipe = scene("rig_box", cls.folder, "--width", "160", "--height", "120")
        edit(recipe, lambda data: data.pop("camera"))

    def test_names(self):
        """No camera, and *: one subimage for each, in the recipe's order, each the same as the camera asked for alone."""
        names = ["rig_box.vshift", "rig_box.vshift?camera=*"] + [f"rig_box.vshift?camera={c}" for c in CAMERAS]
        (plain, star, *single), _ = probe(names, self.folder)
        for image in (plain, star):
            self.assertEqual([s["attributes"]["oiio:subimagename"] for s in image["subimages"]], CAMERAS)
            self.assertEqual([s["attributes"]["vshift.camera"] for s in image["subimages"]], CAMERAS)
        self.assertEqual([len(s["subimages"]) for s in single], [1] * 6)
        hashes = [s["subimages"][0]["sha256"] for s in single]
        self.assertEqual([s["sha256"] for s in star["subimages"]], hashes)
        self.assertEqual(len(set(hashes)), 6, "six cameras see six things")

    def test_recipe_names_a_camera(self):
        """The recipe's camera is the answer without a query; * asks for all of them all the same."""
        edit(self.folder / "rig_box.vshift", lambda data: data.update(camera="CAM_BACK"))
        self.addCleanup(edit, self.folder / "rig_box.vshift", lambda data: data.pop("camera"))
        (own, star), _ = probe(["rig_box.vshift?shift=0,1,0", "rig_box.vshift?camera=*"], self.folder, pixels=False)
        self.assertEqual([s["attributes"]["vshift.camera"] for s in own["subimages"]], ["CAM_BACK"])
        self.assertEqual([s["attributes"]["vshift.camera"] for s in star["subimages"]], CAMERAS)

    def test_one_by_number(self):
        for number in (0, 4):
            self.ran("oiiotool", "rig_box.vshift?camera=*", "--subimage", number, "-o", "one.exr")
            spec = pixels(self.folder / "one.exr")[1]
            self.assertEqual(spec.getattribute("vshift.camera"), CAMERAS[number])
            self.same_pixels("one.exr", f"rig_box.vshift?camera={CAMERAS[number]}")

    def test_one_by_name(self):
        self.ran("oiiotool", "rig_box.vshift", "--subimage", "CAM_BACK", "-o", "one.exr")
        self.same_pixels("one.exr", "rig_box.vshift?camera=CAM_BACK")

    def test_no_such_number(self):
        result = run(["oiiotool", "rig_box.vshift?camera=*", "--subimage", "6", "-o", "six.exr"], self.folder)
        self.assertEqual(result.code, 1, result)
        self.assertFalse((self.folder / "six.exr").exists())

    def test_all_written(self):
        self.ran("oiiotool", "-a", "rig_box.vshift?shift=0,1,0", "-o", "all.exr")
        (got, want), _ = probe(["all.exr", "rig_box.vshift?shift=0,1,0"], self.folder)
        self.assertEqual(got["format"], "openexr")
        self.assertEqual([s["attributes"]["oiio:subimagename"] for s in got["subimages"]], CAMERAS)
        for key in ("sha256", "channels", "width", "height"):
            self.assertEqual([s[key] for s in got["subimages"]], [s[key] for s in want["subimages"]], key)

    def test_iinfo(self):
        result = self.ran("iinfo", "-v", "-a", "rig_box.vshift?shift=0,1,0.25&yaw_deg=5&frame=1")
        self.assertIn("6 subimages", result.out)
        parts = re.split(r"(?m)^ *subimage +\d+:", result.out)[1:]
        self.assertEqual(len(parts), 6, result)
        for camera, part in zip(CAMERAS, parts):
            for line in (f'vshift.camera: "{camera}"', f'oiio:subimagename: "{camera}"', 'vshift.shift_m: "0 1 0.25"',
                         'vshift.yaw_deg: "5"', 'vshift.frame: "1"', 'vshift.intrinsic: "80 0 80 0 80 60 0 0 1"',
                         'vshift.invalid_px: "0"', 'vshift.out: "mask"', "vshift.worldToCamera: ", "worldtocamera: ",
                         "channel list: " + ", ".join(MASK)):
                self.assertIn(line, part)

    def test_matrix(self):
        """worldtocamera holds the numbers of vshift.worldToCamera in OpenImageIO's order: points are rows, so it is transposed."""
        (image,), _ = probe(["rig_box.vshift?frame=1"], self.folder, pixels=False)
        for part in image["subimages"]:
            rows = [float(v) for v in part["attributes"]["vshift.worldToCamera"].split()]
            columns = [rows[4 * (i % 4) + i // 4] for i in range(16)]
            for got, want in zip(part["attributes"]["worldtocamera"], columns, strict=True):
                self.assertAlmostEqual(got, want, places=5)
        self.assertEqual(len({str(p["attributes"]["worldtocamera"]) for p in image["subimages"]}), 6)

    def test_one_depth_missing(self):
        """The answer is whole or not at all, whichever camera was asked for first."""
        depth = self.folder / "frames/0000/CAM_BACK.exr"
        kept = depth.rename(depth.with_suffix(".kept"))
        self.addCleanup(kept.rename, depth)
        for words in ((), ("-a",)):
            for name in ("rig_box.vshift", "rig_box.vshift?camera=*"):
                with self.subTest(name, words=words):
                    result = run(["oiiotool", *words, name, "-o", "part.exr"], self.folder)
                    self.assertEqual(result.code, 1, result)
                    self.assertIn("CAM_BACK.exr", result.err, result)
                    self.assertFalse((self.folder / "part.exr").exists())
        self.ran("oiiotool", "rig_box.vshift?camera=CAM_FRONT", "-o", "front.exr")

    def test_computed_once_in_all(self):
        """Six answers for six cameras, however often oiiotool opens the name."""
        result = run(["oiiotool", "-a", "rig_box.vshift?camera=*", "-o", "all.exr"], self.folder, environment(VSHIFT_LOG=1))
        self.assertEqual(result.code, 0, result)
        self.assertEqual(len(result.computed), len(set(result.computed)), result)
        for camera in CAMERAS:
            self.assertEqual(sum(bool(re.search(rf"\b{camera}\b", line)) for line in result.computed), 1, result)
