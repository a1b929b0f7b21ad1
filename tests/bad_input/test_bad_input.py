#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Bad inputs: the exit code, one error line, and nothing written. Run it as a program, or one class of it:

    /usr/bin/python3 tests/bad_input/test_bad_input.py [-v] [Table | DepthContent | Sets | Stops | FullDisk | Library]

VSHIFT_BIN and VSHIFT_LIBRARY name another program and library than those in build/; VSHIFT_SPACE_LIMIT (bytes, 0 for
none) another limit of address space.
"""
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import unittest
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

import numpy as np  # noqa: E402
import OpenImageIO as oiio  # noqa: E402

import c_abi  # noqa: E402
from base_case import CAMERAS, FRAMES, HEIGHT, SHIFTS, VSHIFT, WIDTH, Base, exr, run, scene_depth, shift_name, start  # noqa: E402
from rows import MANY, TABLE  # noqa: E402

OLD = b"what was there before"
MASK_CHANNELS = ("lost", "occluded", "outside", "unknown", "unseen")
EVERYTHING = MANY + " --all-shifts"
ITEMS = len(FRAMES) * len(SHIFTS) * len(CAMERAS)


def setUpModule():
    global root, base
    root = Path(tempfile.mkdtemp(prefix="vshift_bad_input_"))
    base = Base(root / "base").write()


def tearDownModule():
    shutil.rmtree(root)


def fresh():
    """A copy of the base that is about to be spoiled."""
    return base.copy_to(tempfile.mkdtemp(dir=root))


def pixels(path):
    """{channel: HxW array} of a whole image; raises when it is not whole."""
    image = oiio.ImageInput.open(str(path))
    if image is None:
        raise OSError(oiio.geterror())
    names, data = image.spec().channelnames, image.read_image("float")
    error = image.geterror()
    image.close()
    if data is None or error:
        raise OSError(f"{path}: {error}")
    return {name: data[:, :, i] for i, name in enumerate(names)}


def error_lines(err):
    return [line for line in err.splitlines() if line.startswith("vshift: ") and not line.startswith("vshift: warning: ")]


class Table(unittest.TestCase):
    def test_good(self):
        """The base itself is fine: each verb and each ending does its work."""
        b = fresh()
        for words in ("mask r.vshift -o out/m.exr", "holes r.vshift -o out/h.exr", "warp r.vshift -o out/w.exr",
                      "mask r.vshift -o out/m.npy", "mask r.vshift -o out/m.pfm --channels lost",
                      "mask r.vshift -o out/m.png --channels lost"):
            with self.subTest(words):
                self.assertEqual(run(words, b.folder), (0, "", ""))
                self.assertTrue((b / words.split()[3]).stat().st_size > 100)
        lost = pixels(b / "out/m.exr")["lost"]
        self.assertTrue(0 < lost.sum() < lost.size)

    def one(self, position):
        group, name, spoil, words, _, _ = TABLE[position]
        b = fresh()
        if position % 2:  # in turn: an output that is there stays, and one that is not does not come
            (b / "out/m.exr").write_bytes(OLD)
        spoil(b)
        before = b.tree()
        code, out, err = run(words, b.folder)
        after = b.tree()
        shutil.rmtree(b.folder)
        changed = sorted(k for k in before.keys() | after.keys() if before.get(k) != after.get(k))
        return code, out, err, changed

    def test_rows(self):
        self.assertEqual(len({row[:2] for row in TABLE}), len(TABLE), "two rows of one name")
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            results = list(pool.map(self.one, range(len(TABLE))))
        for (group, name, _, words, expected, regex), (code, out, err, changed) in zip(TABLE, results):
            with self.subTest(f"{group}: {name}"):
                said = f"\n  vshift {words}\n  exit {code}, stderr: {err[-400:]!r}"
                self.assertIn(code, expected if isinstance(expected, tuple) else (expected,), said)
                self.assertRegex(err, r"\A[^\n]*\n\Z", "not one line" + said)
                self.assertRegex(err, r"\Avshift: (?:" + regex + ")", said)
                self.assertFalse(re.search(r"[\x00-\x09\x0b-\x1f\x7f]", err), "control characters" + said)
                if "check" not in words:  # check says how far it came
                    self.assertEqual(out, "", said)
                self.assertEqual(changed, [], "files changed" + said)


class DepthContent(unittest.TestCase):
    """Odd depth is no error: such pixels are unknown, sky is handled by direction."""

    def masks(self, z):
        b = fresh()
        height, width = z.shape
        b.recipe["cameras"][0].update(width=width, height=height, intrinsic=[[width, 0, width / 2], [0, width, height / 2], [0, 0, 1]])
        b.save()
        exr(b.depth, {"Z": z})
        self.assertEqual(run("mask r.vshift -o out/m.exr", b.folder), (0, "", ""))
        return {channel: plane.astype(bool) for channel, plane in pixels(b / "out/m.exr").items()}

    def assert_only(self, masks, **share):
        """The named channels hold this share of the pixels, the others nothing."""
        self.assertEqual({c: masks[c].mean() for c in MASK_CHANNELS}, {c: share.get(c, 0.0) for c in MASK_CHANNELS})

    def test_no_measurement(self):
        for value in (np.nan, 0.0, -0.0, -5.0, -np.inf, -np.float32(3e38)):
            with self.subTest(value=value):
                self.assert_only(self.masks(np.full((HEIGHT, WIDTH), value)), unknown=1.0)

    def test_sky(self):
        """A sideways shift leaves every sky direction in view: nothing is lost. Unseen is where the ray,
        2 m away from V at (-1, 0, 0), has not yet come into the recorded frustum."""
        masks = self.masks(np.full((HEIGHT, WIDTH), np.inf))
        unseen = masks.pop("unseen")
        self.assertFalse(any(plane.any() for plane in masks.values()))
        x, y = np.meshgrid((np.arange(WIDTH) + 0.5 - WIDTH / 2) / WIDTH, (np.arange(HEIGHT) + 0.5 - HEIGHT / 2) / WIDTH)
        scale = 2 / np.sqrt(x * x + y * y + 1)
        away = np.abs((x * scale - 1) / scale) > 0.5  # y / z stays what it is
        np.testing.assert_array_equal(unseen, away)

    def test_mixed(self):
        z = scene_depth(WIDTH, HEIGHT)
        z[:3], z[5, 7], z[9, 20] = np.nan, 0, -1
        masks = self.masks(z)
        self.assertTrue(masks["unknown"][~(z > 0)].all())
        self.assertFalse(masks["lost"][~(z > 0)].any())
        self.assertTrue(masks["outside"].any())

    def test_one_pixel(self):
        self.assert_only(self.masks(np.full((1, 1), np.nan)), unknown=1.0)
        one = self.masks(np.full((1, 1), 10.0))
        self.assertEqual((one["occluded"].any(), one["unknown"].any(), one["outside"].any()), (False, False, False))

    def test_one_row_and_column(self):
        for shape in ((1, 64), (36, 1)):
            with self.subTest(shape=shape):
                self.assert_only(self.masks(np.full(shape, np.nan)), unknown=1.0)

    def test_extreme(self):
        """The smallest and the largest floats, side by side: an answer, whatever it is."""
        z = np.full((HEIGHT, WIDTH), np.float32(3e38))
        z[:, ::2] = np.float32(1e-38)
        z[::2, 1] = np.float32(1e-45)
        self.masks(z)


class Sets(unittest.TestCase):
    def test_planned_only(self):
        b = fresh()
        b.manifest()
        code, out, err = run("check r.vshift", b.folder)
        self.assertEqual((code, err), (0, ""))
        self.assertIn("0 done, 4 planned, 0 refused, 0 faults", out)

    def test_changed_file(self):
        b = fresh()
        b.manifest()
        self.assertEqual(run(EVERYTHING, b.folder), (0, "", ""))
        self.assertEqual(run("check r.vshift", b.folder)[0], 0)
        victim = b / f"masks/self/{shift_name(SHIFTS[1])}/0001/B.exr"
        data = bytearray(victim.read_bytes())
        data[-5] ^= 1
        victim.write_bytes(data)
        code, _, err = run("check r.vshift", b.folder)
        self.assertEqual((code, len(error_lines(err))), (3, 1), err)
        self.assertRegex(err, r"vshift: .*masks/self/.*/0001/B\.exr: sha256: got .*, expected [0-9a-f]{12}")
        self.assertEqual(run(EVERYTHING, b.folder), (0, "", ""))  # and it is made again
        self.assertEqual(run("check r.vshift", b.folder)[0], 0)

    def test_another_request(self):
        """What lies there from another request, or from other depth, is made again; the same is not."""
        b = fresh()
        b.manifest()
        made = lambda: {f: f.stat().st_mtime_ns for f in sorted((b / "masks/self").rglob("*.exr"))}
        self.assertEqual(run(EVERYTHING, b.folder), (0, "", ""))
        first = made()
        self.assertEqual(run(EVERYTHING, b.folder), (0, "", ""))
        self.assertEqual(made(), first)
        self.assertEqual(run(EVERYTHING + " --clear-m 1", b.folder), (0, "", ""))
        second = made()
        self.assertTrue(all(second[f] > first[f] for f in first), "an old answer was left")
        depth = next(p for p in sorted(b.folder.rglob("*")) if p.is_file() and p.suffix in (".exr", ".npy", ".pfm")
                     and "masks" not in p.parts)
        os.utime(depth)
        self.assertEqual(run(EVERYTHING + " --clear-m 1", b.folder), (0, "", ""))
        self.assertNotEqual(made(), second)

    def test_odd_run_json(self):
        """A run.json of another making is no reason to fail a run: its rows are not ours."""
        b = fresh()
        b.manifest()
        self.assertEqual(run(EVERYTHING, b.folder), (0, "", ""))
        (b / "masks/self/run.json").write_text('[{"camera": 5, "frame": "x", "shift": []}, 7, null]')
        self.assertEqual(run(EVERYTHING, b.folder), (0, "", ""))
        json.loads((b / "masks/self/run.json").read_text())

    def test_name_without_utf8(self):
        """A file's name is bytes; a pair's scores are JSON all the same."""
        b = fresh()
        name = os.fsencode(b.folder) + b"/\xff.exr"
        shutil.copy(b.depth, name)
        code, out, err = run(["score", "--got", b"\xff.exr", "--truth", b"\xff.exr"], b.folder)
        self.assertEqual((code, err), (0, ""))
        self.assertTrue(json.loads(out)["equal"])


class Stops(unittest.TestCase):
    def big(self, name):
        """A set whose items take a while."""
        folder = root / name
        folder.mkdir()
        b = Base(folder, 480, 270).write()
        b.manifest()
        return b

    def whole_so_far(self, b, leftovers=False):
        """Every EXR is whole, the manifest parses and what it calls done is; returns the number of EXRs."""
        made = list((b / "masks").rglob("*.exr"))
        for path in made:
            self.assertEqual(set(pixels(path)), set(MASK_CHANNELS))
        self.assertEqual(json.loads((b / "manifest.json").read_text())["vshift_manifest"], 1)
        others = {p.name for p in b.folder.rglob("*") if p.is_file() and p.suffix not in (".exr", ".json", ".vshift")} - {".manifest.lock"}
        if leftovers:  # SIGKILL leaves no time to clean up
            others = {name for name in others if not re.fullmatch(r"\.vshift-\d+-\d+\.tmp", name)}
        self.assertEqual(others, set())
        return len(made)

    def test_interrupt_and_terminate(self):
        b = self.big("interrupted")
        for number in (signal.SIGINT, signal.SIGTERM):
            with self.subTest(number.name):
                shutil.rmtree(b / "masks", ignore_errors=True)
                b.manifest()
                child = start(EVERYTHING.split(), b.folder)
                while not list(b.folder.glob("masks/self/*/*/*.exr")) and child.poll() is None:
                    time.sleep(0.001)
                child.send_signal(number)
                out, err = child.communicate(timeout=10)
                self.assertEqual((child.returncode, out), (130, b""), err)
                self.assertEqual(len(error_lines(err.decode())), 1, err)
                self.assertRegex(err.decode(), "vshift: interrupted: got .*, expected")
                self.assertLess(self.whole_so_far(b), ITEMS)
        self.assertEqual(run(EVERYTHING, b.folder)[0], 0)
        self.assertEqual(self.whole_so_far(b), ITEMS)

    def test_interrupt_while_waiting(self):
        """Another program holds the set's lock: a signal still ends the run as a signal does."""
        b = self.big("waiting")
        lock = subprocess.Popen(["flock", b / ".manifest.lock", "sleep", "20"])
        try:
            child = start(EVERYTHING.split(), b.folder)
            while not list(b.folder.glob("masks/self/*/*/*.exr")) and child.poll() is None:
                time.sleep(0.001)
            time.sleep(0.3)  # it stands at the lock now
            child.send_signal(signal.SIGINT)
            err = child.communicate(timeout=10)[1].decode()
            self.assertEqual((child.returncode, len(error_lines(err))), (130, 1), err)
            self.whole_so_far(b)
        finally:
            lock.kill()
            lock.wait()

    def kill_often(self, seed):
        """10 kills of a set of 12 at random moments after a random number of masks, then a rerun that completes it; returns
        how many came in time."""
        b = fresh()
        b.manifest()
        began = time.monotonic()
        self.assertEqual(run(EVERYTHING, b.folder), (0, "", ""))
        item_s = (time.monotonic() - began) / ITEMS
        shutil.rmtree(b / "masks")
        b.manifest()
        moments, in_time = random.Random(seed), 0

        def made():
            return len(list(b.folder.glob("masks/self/*/*/*.exr")))

        for _ in range(10):
            enough = moments.randrange(made(), ITEMS)
            child = start(EVERYTHING.split(), b.folder)
            while made() < enough and child.poll() is None:
                time.sleep(0.001)
            time.sleep(moments.uniform(0, 1) * item_s)
            child.kill()
            child.communicate()
            in_time += child.returncode == -signal.SIGKILL
            if self.whole_so_far(b, leftovers=True) == ITEMS:
                shutil.rmtree(b / "masks")  # all is there: begin again
                b.manifest()
        self.assertEqual(run(EVERYTHING, b.folder), (0, "", ""))
        self.assertEqual(self.whole_so_far(b), ITEMS)  # the rerun also sweeps what the kills left
        items = json.loads((b / "manifest.json").read_text())["items"]
        self.assertEqual(sum(i["status"] == "done" for i in items.values()), ITEMS + 1)  # and run.json
        self.assertEqual(run("check r.vshift", b.folder)[0], 0)
        return in_time

    def test_kill_loop(self):
        with ThreadPoolExecutor(2) as pool:
            self.assertGreater(sum(pool.map(self.kill_often, (1, 2))), 5)


class FullDisk(unittest.TestCase):
    def test_full_disk(self):
        b = fresh()
        disk = b / "disk"
        disk.mkdir()
        mounted = os.geteuid() == 0 and subprocess.run(["mount", "-t", "tmpfs", "-o", "size=16k", "tmpfs", disk],
                                                       capture_output=True).returncode == 0
        if not mounted:
            print("skipped: full disk (may not mount a tmpfs here)", file=sys.stderr)
            self.skipTest("may not mount a tmpfs here")
        try:
            (disk / "m.npy").write_bytes(OLD)
            for name in ("m.npy", "new.npy"):  # 46 kB
                code, out, err = run(f"mask r.vshift -o disk/{name}", b.folder)
                self.assertEqual((code, out), (4, ""), err)
                self.assertRegex(err, rf"\Avshift: disk/{name}: writing: got No space left on device, expected [^\n]*\n\Z")
            self.assertEqual([p.name for p in disk.iterdir()], ["m.npy"])
            self.assertEqual((disk / "m.npy").read_bytes(), OLD)
        finally:
            subprocess.run(["umount", disk], check=True)


class Library(unittest.TestCase):
    """The C ABI through ctypes, each case in a process of its own."""

    def test_cases(self):
        for name, expected, call in c_abi.CASES:
            with self.subTest(name):
                code, message = c_abi.in_child(call)
                self.assertIn(code, expected if isinstance(expected, tuple) else (expected,), message)
                if code:
                    self.assertRegex(message, r"\A[^\n]*: got [^\n]*, expected [^\n]*\Z")


if __name__ == "__main__":
    if not Path(VSHIFT).is_file():
        sys.exit(f"test_bad_input: {VSHIFT}: got no program, expected one (build first, or set VSHIFT_BIN)")
    unittest.main()
