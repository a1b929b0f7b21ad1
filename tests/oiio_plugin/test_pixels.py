# SPDX-License-Identifier: Apache-2.0
"""The same pixels and the same metadata as the command line's EXR, to the bit."""
import street
from support import CHANNELS, VSHIFT, Case, environment, pixels, probe, run, scene

# scene, verb, request
MINIMAL = (
    ("box", "mask", "shift=0,1,0"),
    ("fence", "holes", "shift=0,-0.625,0&yaw_deg=3"),
    ("grazing_road_kerb", "warp", "shift=0,1,0"),
    ("random", "warp", "shift=0.5,-2,0.1&from=rig"),
    ("rig_box", "mask", "camera=CAM_BACK_LEFT&shift=0,2,0&yaw_deg=-10&from=rig&frame=1&clear_m=0.5"),
    ("rig_box", "holes", "camera=CAM_FRONT&shift=0,2,0&from=rig"),
    ("rig_box", "holes", "camera=CAM_FRONT&shift=0,2,0&method=embree"),
    ("rig_box", "warp", "camera=CAM_FRONT&shift=0,2,0&edge=keep"),
    ("rig_box", "seam", "camera=CAM_FRONT&shift=0,2,0&match=exposure"),
    ("rig_box", "seam", "camera=CAM_FRONT_LEFT&shift=0,-1,0&view=recorded&noise_exposure=0.5&noise_depth_scale=0.05&noise_pose_deg=0.5&noise_seed=3"),
    ("rig_box", "condition", "camera=CAM_FRONT&shift=0,2,0&stride=16"),
    ("rig_box", "condition", "camera=CAM_FRONT&shift=0,2,0&view=shifted&arm=splat"),
    ("rig_box", "condition", "camera=CAM_FRONT&shift=0,2,0&arm=literal"),
    ("rig_box", "condition", "camera=CAM_FRONT&shift=0,2,0&arm=double_warp"),
)
LARGE = (
    ("mask", "camera=CAM_FRONT&shift=0,2,0"),
    ("holes", "camera=CAM_LEFT&shift=0.5,-1,0"),
    ("warp", "camera=CAM_FRONT&shift=0,1,0&yaw_deg=2"),
    ("seam", "camera=CAM_FRONT&shift=0,2,0"),
    ("condition", "camera=CAM_FRONT&shift=0,2,0"),
)


class Agree(Case):
    def program(self, folder, recipe, verb, request, out):
        options = [word for pair in request.split("&") for word in ("--" + pair.split("=")[0], pair.split("=")[1])]
        result = run([VSHIFT, verb, recipe, *options, "-o", out], folder, environment(plugin=False))
        self.assertEqual(result.code, 0, result)

    def agrees(self, number, folder, recipe, verb, request):
        """Through oiiotool; returns the name and the program's file."""
        name, wanted, got = f"{recipe}?{request}&out={verb}", f"{number}_program.exr", f"{number}_tool.exr"
        self.program(folder, recipe, verb, request, wanted)
        self.ran("oiiotool", name, "-o", got, folder=folder)
        want, _ = pixels(folder / wanted)
        have, spec = pixels(folder / got)
        self.assertEqual(tuple(have), CHANNELS[verb])
        self.assertEqual(str(spec.format), "float")
        for channel in want:
            self.assertEqual(have[channel].tobytes(), want[channel].tobytes(), channel)
        self.assertTrue(any(0 < plane.mean() < 1 for plane in want.values()), "the example shows nothing")
        return name, wanted


class Minimal(Agree):
    about_s = 15     # for run_tests.py, which starts long classes first

    def test_scenes(self):
        names, files = [], []
        for number, (which, verb, request) in enumerate(MINIMAL):
            with self.subTest(which, request=request):
                folder = self.folder / which
                if not folder.exists():
                    scene(which, folder)
                name, wanted = self.agrees(number, folder, f"{which}.vshift", verb, request)
                self.same_pixels(wanted, name, folder)    # idiff opens the recipe itself
                names.append(f"{which}/{name}")
                files.append(f"{which}/{wanted}")
        images, _ = probe(names + files, self.folder)
        for name, got, want in zip(names, images, images[len(names):]):
            with self.subTest(name):
                self.metadata_agrees(got, want)

    def metadata_agrees(self, got, want):
        """What the API gives: the same pixels, channels and attributes."""
        self.assertEqual(got["format"], "vshift")
        got, want = got["subimages"][0], want["subimages"][0]
        self.assertEqual(got["sha256"], want["sha256"])
        self.assertEqual(got["channels"], want["channels"])
        self.assertEqual(got["tile"], 0, "scanlines")
        ours = {k: v for k, v in want["attributes"].items() if k.startswith("vshift.")}
        self.assertGreater(len(ours), 10)
        self.assertEqual({k: v for k, v in got["attributes"].items() if k.startswith("vshift.")}, ours)

    def test_other_answer_differs(self):
        """The comparison itself: another shift is told apart."""
        scene("box", self.folder / "apart")
        result = run(["idiff", "-fail", "0", "-warn", "0", "box.vshift?shift=0,1,0", "box.vshift?shift=0,1.1,0"],
                     self.folder / "apart")
        self.assertNotEqual(result.code, 0, result)
        self.assertIn("FAILURE", result.out, result)


class Large(Agree):
    about_s = 15

    def test_1600x900(self):
        street.write(self.folder)
        for number, (verb, request) in enumerate(LARGE):
            with self.subTest(verb, request=request):
                _, wanted = self.agrees(number, self.folder, "street.vshift", verb, request)
                self.same_pixels(wanted, f"{number}_tool.exr")
