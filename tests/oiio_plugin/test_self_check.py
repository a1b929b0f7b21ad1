# SPDX-License-Identifier: Apache-2.0
"""`vshift check --plugin` on a healthy installation and on spoilt ones: each must name what is wrong."""
import os
import re
import shutil
import unittest

from support import ASAN, PLUGIN, PLUGIN_DIR, Case, environment, run, VSHIFT

STEPS = ["where", "file", "built for", "libraries", "oiiotool", "loads", "answers"]
OIIOTOOL = shutil.which("oiiotool")


@unittest.skipIf(ASAN, "the check starts a host that is not sanitized")
class SelfCheck(Case):
    def check(self, *given, code=0, fails=(), last="answers", **changes):
        """The lines of one check. Steps come in order, `fails` are those that fail, `last` is where it ends."""
        temporary = self.folder / "tmp"
        temporary.mkdir(exist_ok=True)
        result = run([VSHIFT, "check", *given], self.folder, environment(plugin=False, TMPDIR=temporary, **changes))
        self.assertEqual(result.code, code, result)
        lines = result.out.splitlines()
        self.assertEqual([re.match(r"(?:ok  |FAIL) ([a-z ]+): ", line)[1] for line in lines],
                         STEPS[:STEPS.index(last) + 1], result)
        bad = [line for line in lines if line.startswith("FAIL ")]
        self.assertEqual([line[5:].split(":")[0] for line in bad], list(fails), result)
        for line in bad:
            self.assertRegex(line, "^FAIL .*: got .*, expected .*: do ")
        self.assertEqual(result.err.splitlines(), [f"vshift: plugin: {line[5:]}" for line in bad[:1]], result)
        self.assertEqual(os.listdir(temporary), [], "the temporary folder is removed")
        return "\n".join(bad or lines)

    def copy(self, name="copy", change=None):
        """A folder of its own with the plugin, its bytes changed."""
        folder = self.folder / name
        folder.mkdir(exist_ok=True)
        data = (PLUGIN_DIR / PLUGIN).read_bytes()
        (folder / PLUGIN).write_bytes(change(data) if change else data)
        return folder

    def check_copy(self, name, change, **expected):
        return self.check("--plugin", OIIO_LIBRARY_PATH=self.copy(name, change), **expected)

    def oiiotool(self, script):
        """A folder with an oiiotool that does `script`, first on PATH."""
        folder = self.folder / f"bin{len(list(self.folder.iterdir()))}"
        folder.mkdir()
        (folder / "oiiotool").write_text(f"#!/bin/sh\n{script}\nexec {OIIOTOOL} \"$@\"\n")
        (folder / "oiiotool").chmod(0o755)
        return f"{folder}:{os.environ['PATH']}"

    def test_healthy(self):
        self.check("--plugin", OIIO_LIBRARY_PATH=PLUGIN_DIR)
        self.check("--plugin", PLUGIN_DIR, OIIO_LIBRARY_PATH=PLUGIN_DIR)
        self.check("--plugin", PLUGIN_DIR / PLUGIN, OIIO_LIBRARY_PATH=f"/nowhere:{PLUGIN_DIR}")

    def test_path_not_set(self):
        folder = self.copy("it's a folder")
        for changes in ({}, {"OIIO_LIBRARY_PATH": "/nowhere"}):
            text = self.check("--plugin", folder, code=3, fails=["where"], **changes)
            # The line that it prints mends it.
            export = text[text.index("do export ") + 3:]
            words = ["sh", "-c", f'{export}; exec "$0" check --plugin', VSHIFT]
            result = run(words, self.folder, environment(plugin=False, **changes))
            self.assertEqual(result.code, 0, result)
            self.assertIn(str(folder), result.out)

    def test_two_plugins(self):
        a, b = self.copy("a"), self.copy("b")
        text = self.check("--plugin", a, OIIO_LIBRARY_PATH=f"{a}:{b}")
        self.assertIn(f"wins over {b}/{PLUGIN}", text)
        text = self.check("--plugin", a, OIIO_LIBRARY_PATH=f"{b}:{a}", code=3, fails=["where"])
        self.assertIn(f"got {b}/{PLUGIN} first", text)

    def test_missing(self):
        for given in (self.folder / "none", self.folder):
            self.check("--plugin", given, code=4, fails=["where"], last="where", OIIO_LIBRARY_PATH=self.folder)

    def test_not_a_plugin(self):
        spoilt = {"text": lambda _: b"not a library\n", "empty": lambda _: b"", "cut": lambda d: d[:len(d) * 3 // 4],
                  "short": lambda d: d[:-1], "head": lambda d: d[:70],
                  "machine": lambda d: d[:18] + b"\xf3\0" + d[20:]}
        for name, change in spoilt.items():
            with self.subTest(name):
                self.check_copy(name, change, code=3, fails=["file"], last="file")
        folder = self.folder / "fifo"
        folder.mkdir()
        os.mkfifo(folder / PLUGIN)
        self.check("--plugin", code=4, fails=["file"], last="file", OIIO_LIBRARY_PATH=folder)
        shutil.copy(PLUGIN_DIR / PLUGIN, self.folder / "renamed.so")
        text = self.check("--plugin", self.folder / "renamed.so", code=3, fails=["where", "file"], last="file")
        self.assertIn(PLUGIN, text)
        text = self.check_copy("other", lambda d: d.replace(b"built for OpenImageIO", b"made  for OpenImageIO"), code=3,
                               fails=["built for"], last="built for")

    def patched(self, pattern, replace):
        def change(data):
            new, count = re.subn(pattern, replace, data)
            self.assertGreater(count, 0, pattern)
            self.assertEqual(len(new), len(data))
            return new
        return change

    def test_missing_library(self):
        other = self.patched(rb"libOpenImageIO\.so\.\d\.\d", b"libOpenImageIO.so.9.9")
        text = self.check_copy("needed", other, code=3, fails=["libraries"], last="oiiotool")
        self.assertIn("got missing libOpenImageIO.so.9.9, expected ", text)
        self.assertIn("build the plugin against the OpenImageIO at hand", text)
        other = self.patched(rb"libtbb\.so\.", b"libtbb.no.")
        self.assertIn("got missing libtbb.no.", self.check_copy("tbb", other, code=3, fails=["libraries"], last="oiiotool"))

        other = self.patched(rb"GLIBCXX_3\.4\.2\d", b"GLIBCXX_9.9.99")
        text = self.check_copy("newer", other, code=3, fails=["libraries"], last="oiiotool")
        self.assertIn("version `GLIBCXX_9.9.99' not found", text)
        other = self.patched(rb"10ImageInput4spec", b"10ImageInputXspec")
        text = self.check_copy("symbol", other, code=3, fails=["libraries"], last="oiiotool")
        self.assertIn("got missing symbol: ", text)
        self.assertIn("10ImageInputXspec", text)

    def test_other_versions(self):
        other = self.patched(rb"(built for OpenImageIO )\d\.\d", rb"\g<1>7.8")
        text = self.check_copy("minor", other, code=3, fails=["oiiotool"], last="oiiotool")
        host = re.search(r"got OpenImageIO (\d+\.\d+\.\d+) ", text)
        self.assertTrue(host, text)
        self.assertIn("expected 7.8 ", text)
        older = self.patched(rb"(vshift\.imageio )\d(\.\d+\.\d+ built for)", rb"\g<1>9\2")
        self.assertIn("got vshift 9.", self.check_copy("older", older, code=3, fails=["built for"]))

    def test_oiiotool(self):
        path = {"OIIO_LIBRARY_PATH": PLUGIN_DIR, "code": 3}
        self.assertIn("none on PATH", self.check("--plugin", PATH=self.folder, fails=["oiiotool"], last="oiiotool", **path))
        mute = self.oiiotool('echo sorry; exit 7')
        self.assertIn("exit status 7, saying 'sorry'",
                      self.check("--plugin", PATH=mute, fails=["oiiotool"], last="oiiotool", **path))
        crash = self.oiiotool('[ "$1" = --list-formats ] && kill -SEGV $$')
        self.assertIn("signal 11", self.check("--plugin", PATH=crash, fails=["loads"], last="loads", **path))
        blind = self.oiiotool('[ "$1" = --list-formats ] && OIIO_LIBRARY_PATH=')
        self.assertIn("without vshift", self.check("--plugin", PATH=blind, fails=["loads"], last="loads", **path))
        none = self.oiiotool('case "$1" in *shift=*) exit 0;; esac')
        self.check("--plugin", PATH=none, fails=["answers"], **{**path, "code": 4})
        wrong = self.oiiotool(f'case "$1" in *shift=*) exec {OIIOTOOL} "$1" --mulc 0.5 -d float -o mask.exr;; esac')
        self.assertRegex(self.check("--plugin", PATH=wrong, fails=["answers"], **path), r"\d+ of \d+ values that differ")

    def test_usage(self):
        for words in ([], ["a.vshift", "--plugin"], ["--plugin", "a", "b"]):
            result = run([VSHIFT, "check", *words], self.folder)
            self.assertEqual((result.code, result.out), (3, ""), result)
            self.assertRegex(result.err, r"^vshift: usage: check: got (both|neither) .*\n$")
        self.assertIn("--plugin", run([VSHIFT, "check", "--help"]).out)


if __name__ == "__main__":
    unittest.main()
