# SPDX-License-Identifier: Apache-2.0
"""What a host can ask of a plugin: no symbols but its own, nothing on stdout, no thread left, no memory error."""
import json
import re
import shutil
import subprocess
import unittest
import xml.etree.ElementTree as xml

from support import ASAN, PLUGIN, PLUGIN_DIR, Case, environment, pixels, python, run, scene

SYMBOLS = {"vshift_imageio_version", "vshift_imageio_library_version", "vshift_input_imageio_create",
           "vshift_input_extensions", "vshift_imageio_built_for"}

THREADS = """
import json, os, sys, time
import OpenImageIO as oiio
def threads():
    return len(os.listdir("/proc/self/task"))
def read(name):
    image = oiio.ImageInput.open(name)
    assert image, oiio.geterror()
    assert image.read_image("float") is not None
    image.close()
read("big.exr"); time.sleep(0.2); host = threads()
for shift in ("0,1,0", "0,2,0"):
    read("box.vshift?shift=" + shift)
for _ in range(40):                      # a worker that is leaving may take a moment
    after = threads()
    if after <= host: break
    time.sleep(0.1)
print(json.dumps([host, after, [open(f"/proc/self/task/{t}/comm").read().strip() for t in os.listdir("/proc/self/task")]]))
"""

FORK = """
import os, OpenImageIO as oiio
def read():
    image = oiio.ImageInput.open("box.vshift?shift=0,1,0")
    return float(image.read_image("float")[:, :, 1].sum())
first = read()
child = os.fork()
if child == 0: os._exit(0 if read() == first else 9)
print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""


class Citizen(Case):
    about_s = 20     # valgrind

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        scene("box", cls.folder, "--width", "64", "--height", "48")

    @unittest.skipIf(ASAN, "a sanitizer adds symbols")
    def test_symbols(self):
        lines = subprocess.run(["nm", "-D", "--defined-only", PLUGIN_DIR / PLUGIN], capture_output=True, text=True, check=True).stdout
        self.assertEqual({line.split()[-1].split("@")[0] for line in lines.splitlines()}, SYMBOLS)

    def test_nothing_missing(self):
        """Every library it needs is there; one that is not makes OpenImageIO drop the plugin without a word."""
        linked = subprocess.run(["ldd", "-r", PLUGIN_DIR / PLUGIN], capture_output=True, text=True)
        said = [line for line in (linked.stdout + linked.stderr).splitlines() if "not found" in line or "undefined symbol" in line]
        self.assertEqual([line for line in said if not (ASAN and re.search("__(asan|ubsan|lsan|sanitizer)", line))], [])

    def test_silent(self):
        """No byte on stdout or stderr when all is well."""
        for words in (["box.vshift?shift=0,1,0"], ["-a", "box.vshift?camera=*"], ["box.vshift?out=warp&from=rig"]):
            with self.subTest(words):
                self.assertEqual(self.ran("oiiotool", *words, "-o", "quiet.exr").text, "")

    def test_error_leaves_stdout_alone(self):
        result = run(["oiiotool", "box.vshift?shift=1", "-o", "none.exr"], self.folder)
        self.assertEqual((result.code, result.out), (1, ""), result)

    def test_threads(self):
        """After close there are the host's threads, as an EXR leaves them, and no other."""
        self.ran("oiiotool", "--pattern", "noise", "1024x1024", "3", "-o", "big.exr")
        result = python(THREADS, self.folder)
        self.assertEqual(result.code, 0, result)
        host, after, _ = json.loads(result.out)
        self.assertLessEqual(after, host, result)

    def test_fork(self):
        """A host that forks after the first answer gets the second one in the child."""
        result = python(FORK, self.folder)
        self.assertEqual((result.code, result.out.strip()), (0, "0"), result)

    def test_locale(self):
        """A host with decimal commas gets the same answer."""
        available = subprocess.run(["locale", "-a"], capture_output=True, text=True).stdout.split()
        commas = next((name for name in available if re.match(r"(de|fr|nl)_", name)), None)
        if not commas:
            self.skipTest("no locale with a decimal comma is installed")
        self.ran("oiiotool", "box.vshift?shift=0,1.5,0", "-o", "dot.exr")
        result = run(["oiiotool", "box.vshift?shift=0,1.5,0", "-o", "comma.exr"], self.folder, {**environment(), "LC_ALL": commas})
        self.assertEqual(result.code, 0, result)
        self.same_pixels("dot.exr", "comma.exr")
        self.assertEqual(*(pixels(self.folder / f"{n}.exr")[1].getattribute("vshift.shift_m") for n in ("dot", "comma")))

    @unittest.skipIf(ASAN, "one checker at a time")
    @unittest.skipUnless(shutil.which("valgrind"), "valgrind is not installed")
    def test_valgrind(self):
        """No error with a frame of the plugin in its stack, and nothing of it definitely lost."""
        report = self.folder / "valgrind.xml"
        result = run(["valgrind", "--xml=yes", f"--xml-file={report}", "--leak-check=full", "--show-leak-kinds=definite",
                      "--num-callers=40", "oiiotool", "box.vshift?shift=0,1,0&out=warp", "--ch", "Z", "-o", "checked.exr"],
                     self.folder, limit_s=300)
        self.assertEqual(result.code, 0, result)
        pixels(self.folder / "checked.exr")
        ours = set()
        for error in xml.parse(report).getroot().iter("error"):
            frames = [f for f in error.iter("frame") if (f.findtext("obj") or "").endswith(PLUGIN)]
            if frames and error.findtext("kind") not in ("Leak_StillReachable", "Leak_IndirectlyLost", "Leak_PossiblyLost"):
                where = " < ".join((f.findtext("fn") or "?")[:60] for f in list(error.iter("frame"))[:6])
                ours.add(f"{error.findtext('kind')}: {error.findtext('what') or error.findtext('xwhat/text')}: {where}")
        self.assertFalse(ours, "\n" + "\n".join(sorted(ours)))


class Descriptors(Case):
    def test_no_file_left_open(self):
        scene("box", self.folder, "--width", "32", "--height", "24")
        script = ("import os, OpenImageIO as o\n"
                  "count = lambda: sorted(os.readlink(f'/proc/self/fd/{d}') for d in os.listdir('/proc/self/fd') if os.path.exists(f'/proc/self/fd/{d}'))\n"
                  "for q in ('0,1,0', 'x', '0,2,0'):\n"
                  "    i = o.ImageInput.open('box.vshift?shift=' + q)\n"
                  "    i and (i.read_image('float'), i.close())\n"
                  "    o.geterror()\n"  # or some versions print it at the end
                  "print([n for n in count() if n.startswith(os.getcwd())])")
        result = python(script, self.folder)
        self.assertEqual((result.code, result.out.strip()), (0, "[]"), result)
