# SPDX-License-Identifier: Apache-2.0
"""The box before a wall through oiiotool: rectangles to the pixel, worked out here from focal length, depths and shift."""
import numpy as np
from support import MASK, Case, edit, pixels, scene

F, WIDTH, HEIGHT = 320, 320, 240              # pixels
Z_BOX, Z_WALL = 4.0, 10.0                     # metres
BOX = (120, 100, 160, 140)                    # left, top, right, bottom of the box, pixels


class BoxBeforeWall(Case):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        scene("box", cls.folder)

    def trimmed(self, channel, shift):
        name = f"{channel}.exr"
        self.ran("oiiotool", f"box.vshift?shift={shift}", "--ch", channel, "--trim", "-o", name)
        planes, spec = pixels(self.folder / name)
        self.assertEqual((spec.full_width, spec.full_height), (WIDTH, HEIGHT))
        self.assertTrue((planes[channel] == 1).all(), "a hole in the rectangle")
        return spec.x, spec.y, spec.width, spec.height

    def test_scene_is_the_one_worked_out(self):
        z = pixels(self.folder / "frames/0000/CAM_FRONT.exr")[0]["Z"]
        expected = np.full((HEIGHT, WIDTH), Z_WALL)
        expected[BOX[1]:BOX[3], BOX[0]:BOX[2]] = Z_BOX
        self.assertTrue(np.allclose(z, expected, atol=1e-5))

    def test_occluded(self):
        """A wall point at x px and the shifted centre meet the box's plane at x - f t (1/4 - 1/10): the shadow moves by that."""
        for left_m, up_m in ((1, 0), (-1, 0), (2, 0), (0, 1), (-1.25, -0.5)):
            with self.subTest(left_m=left_m, up_m=up_m):
                px_per_m = F * (1 / Z_BOX - 1 / Z_WALL)
                x, y = BOX[0] + left_m * px_per_m, BOX[1] + up_m * px_per_m
                expected = tuple(round(v) for v in (x, y, BOX[2] - BOX[0], BOX[3] - BOX[1]))
                self.assertTrue(0 < x < WIDTH - 40 and 0 < y < HEIGHT - 40, "the example is wrong")
                self.assertEqual(self.trimmed("occluded", f"0,{left_m},{up_m}"), expected)

    def test_outside(self):
        """The wall moves by f t / 10 across the picture; what passes the edge is outside."""
        for left_m in (1, -0.5):
            with self.subTest(left_m=left_m):
                strip = round(F * abs(left_m) / Z_WALL)
                expected = (WIDTH - strip if left_m > 0 else 0, 0, strip, HEIGHT)
                self.assertEqual(self.trimmed("outside", f"0,{left_m},0"), expected)

    def test_zero_shift(self):
        self.ran("oiiotool", "box.vshift?shift=0,0,0", "-o", "zero.exr")
        planes, _ = pixels(self.folder / "zero.exr")
        self.assertEqual(tuple(planes), MASK)
        for name, plane in planes.items():
            self.assertEqual(np.count_nonzero(plane), 0, name)

    def test_recipe_alone(self):
        """No query: the recipe's own request, which is a shift of 1 m to the left."""
        self.ran("oiiotool", "box.vshift", "--ch", "occluded", "--trim", "-o", "own.exr")
        spec = pixels(self.folder / "own.exr")[1]
        self.assertEqual((spec.x, spec.y, spec.width, spec.height), (168, 100, 40, 40))
        edit(self.folder / "box.vshift", lambda recipe: recipe.update(out="holes"))
        self.addCleanup(edit, self.folder / "box.vshift", lambda recipe: recipe.update(out="mask"))
        self.ran("oiiotool", "box.vshift", "-o", "own.exr")
        self.assertEqual(set(pixels(self.folder / "own.exr")[0]), {"hole", "disoccluded", "outside"})


class Lost(Case):
    def test_lost_is_the_maximum(self):
        """By oiiotool --max and idiff, where both classes are there and overlap."""
        scene("rig_box", self.folder)
        name = "rig_box.vshift?camera=CAM_FRONT_LEFT&shift=0,2,0"
        self.ran("oiiotool", name, "-o", "all.exr")
        planes, _ = pixels(self.folder / "all.exr")
        occluded, outside = planes["occluded"] > 0, planes["outside"] > 0
        for what, there in (("occluded", occluded & ~outside), ("outside", outside & ~occluded), ("both", outside & occluded)):
            self.assertTrue(there.any(), f"the example has no {what}")
        self.ran("oiiotool", name, "--ch", "occluded", "--chnames", "lost", name, "--ch", "outside", "--chnames", "lost",
                 "--max", "-o", "max.exr")
        self.ran("oiiotool", name, "--ch", "lost", "-o", "lost.exr")
        self.same_pixels("lost.exr", "max.exr")
