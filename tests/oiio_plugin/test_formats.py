# SPDX-License-Identifier: Apache-2.0
"""The plugin is found where the path says, and only there; files of other kinds fare as they do without it."""
import statistics
import unittest

from support import ASAN, PLUGIN_DIR, Case, environment, probe, python, run, scene

LIST_FORMATS = "import OpenImageIO as o; print(o.get_string_attribute('format_list'))"


class Found(Case):
    def test_list_formats(self):
        with_path = self.ran("oiiotool", "--list-formats")
        self.assertRegex(with_path.text, r"\bvshift\b", with_path)
        without = run(["oiiotool", "--list-formats"], self.folder, environment(plugin=False))
        self.assertEqual(without.code, 0, without)
        self.assertNotRegex(without.text, r"\bvshift\b", without)
        self.assertRegex(without.text, r"\bopenexr\b", "the list itself")

    def test_python(self):
        self.assertIn("vshift", python(LIST_FORMATS, self.folder).out.strip().split(","))
        self.assertNotIn("vshift", python(LIST_FORMATS, self.folder, environment(plugin=False)).out.strip().split(","))

    def test_nothing_to_write(self):
        """A reader only: a .vshift output is refused and no recipe overwritten."""
        recipe = scene("box", self.folder / "writing", "--width", "32", "--height", "24")
        before = recipe.read_bytes()
        result = run(["oiiotool", "box.vshift", "-o", "box.vshift"], recipe.parent)
        self.assertEqual(result.code, 1, result)
        self.assertEqual(recipe.read_bytes(), before)

    def test_path_with_spaces(self):
        recipe = scene("box", self.folder / "a b=c", "--width", "32", "--height", "24")
        self.ran("oiiotool", f"{recipe}?shift=0,1,0", "-o", "spaces.exr")

    def test_two_folders_on_the_path(self):
        env = environment(OIIO_LIBRARY_PATH=f"{PLUGIN_DIR}:{self.folder}")
        self.assertRegex(run(["oiiotool", "--list-formats"], self.folder, env).text, r"\bvshift\b")


class OtherKinds(Case):
    """Junk under other names goes to OpenImageIO, with its message and at its speed."""

    # name: content. All go through the API, those of TOOLS through the programs as well.
    TOOLS = ("junk.xyz", "missing.exr?camera=A")
    FILES = {"junk.jpg": b"\x12\x93junk" * 300, "junk.xyz": b"\x00\x01\xfe" * 500, "empty.xyz": b"", "empty.exr": b"",
             "recipe.json": b'{"vshift": 1}', "x.vshift.tif": b'{"vshift": 1}'}
    MISSING = ("missing.jpg", "missing.xyz", "missing.exr?camera=A")

    def setUp(self):
        for name, data in self.FILES.items():
            (self.folder / name).write_bytes(data)

    def test_same_message(self):
        names = [*self.FILES, *self.MISSING]
        ours, theirs = (probe(names, self.folder, environment(plugin=plugin))[0] for plugin in (True, False))
        for name, our, their in zip(names, ours, theirs):
            self.assertIn("error", our, name)
            self.assertEqual(our, their, name)
        for name in self.TOOLS:
            for tool in (["oiiotool", name, "-o", "out.exr"], ["iinfo", name]):
                with self.subTest(name, tool=tool[0]):
                    ours, theirs = run(tool, self.folder), run(tool, self.folder, environment(plugin=False))
                    self.assertEqual((ours.code, ours.out, ours.err), (theirs.code, theirs.out, theirs.err))
                    self.assertNotEqual(ours.code, 0, ours)
                    self.assertNotIn("vshift: ", ours.err)
                    self.assertFalse((self.folder / "out.exr").exists())

    @unittest.skipIf(ASAN, "speed is not judged under a sanitizer")
    def test_same_speed(self):
        """One process that tries junk 40 times; the bound is generous, a plugin that computes or waits goes far beyond it."""
        script = ("import OpenImageIO as o, sys, time\n"
                  "o.ImageInput.open(sys.argv[1]); t = time.perf_counter()\n"
                  "for _ in range(40):\n"
                  "    assert o.ImageInput.open(sys.argv[1]) is None; o.geterror()\n"
                  "print(time.perf_counter() - t)")

        def seconds(plugin):
            return [float(python(script, self.folder, environment(plugin=plugin), "junk.xyz").out) for _ in range(3)]
        ours, theirs = statistics.median(seconds(True)), statistics.median(seconds(False))
        self.assertLess(ours, 2 * theirs + 0.2, f"40 opens of junk: {ours:.3f} s with the plugin, {theirs:.3f} s without")
