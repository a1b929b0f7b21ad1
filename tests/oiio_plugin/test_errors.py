# SPDX-License-Identifier: Apache-2.0
"""What is refused: exit code 1, the reason on the terminal, no output, no signal, soon."""
import json
import os
import random
import re
import shutil
import struct
import tempfile
from pathlib import Path

from support import ASAN, VSHIFT, Case, edit, environment, probe, run, scene

SOON_S = 60 if ASAN else 8
OLD = b"what was there before"

# name, query, what the reason holds. The program is asked some of them too, and its line must come word for word.
REQUESTS = (
    ("bad number", "shift=0,one,0", "shift: got 'one', expected a finite number"),
    ("not a number", "shift=0,nan,0", "shift: got 'nan'"),
    ("infinite", "yaw_deg=inf", "yaw_deg: got 'inf'"),
    ("two numbers", "shift=0,1", "three numbers x,y,z"),
    ("decimal comma", "yaw_deg=1,5", "yaw_deg: got '1,5'"),
    ("trailing junk", "yaw_deg=1x", "yaw_deg: got '1x'"),
    ("empty value", "shift=", "shift: got ''"),
    ("enormous number", "shift=0,1e300,0", "at most 1000000 m"),
    ("beyond double", "shift=0,1e999,0", "shift: got '1e999'"),
    ("enormous frame", "frame=99999999999999999999", "frame: got '99999999999999999999'"),
    ("no such frame", "frame=7", "frame: got 7, expected 0"),
    ("negative frame", "frame=-1", "frame: got '-1'"),
    ("unknown camera", "camera=CAM_FRNT", "did you mean CAM_FRONT?"),
    ("unknown out", "out=masks", "did you mean mask?"),
    ("view of another out", "view=shifted", "view: got 'shifted', expected recorded for out=mask"),
    ("coarser mesh", "tolerance_px=5", "tolerance_px: got '5'"),
    ("unknown method", "method=embre", "did you mean embree?"),
    ("far clear", "clear_m=1e9", "clear_m: got '1e9'"),
    ("unknown arm", "out=condition&arm=splatt", "did you mean splat?"),
    ("arm of another view", "out=condition&arm=splat", "view: got 'recorded', expected shifted for arm=splat"),
    ("stride 0", "out=condition&stride=0", "stride: got '0', expected a whole number from 1 to 256"),
    ("seam from the rig", "out=seam&from=rig", "from: got 'rig' for out=seam, expected self"),
    ("huge noise", "out=seam&noise_pose_m=1e3", "noise_pose_m: got '1e3', expected metres from 0 to 10"),
)
SAID_BY_PROGRAM = ("bad number", "enormous number", "enormous frame", "unknown camera", "view of another out", "far clear")
# Those that only a query can have.
QUERIES = (
    ("unknown key", "shfit=0,1,0", "did you mean shift?"),
    ("duplicate key", "shift=0,1,0&shift=0,2,0", "shift: got the key twice, expected it once"),
    ("no key", "=1", "'=1'"),
    ("key in capitals", "Shift=0,1,0", "did you mean shift?"),
    ("second ?", "shift=0,1,0?frame=0", "'0?frame=0'"),
    ("blank in key", " shift=0,1,0", "did you mean shift?"),
    ("huge", "shift=" + "9" * 1000, "shift: got '999"),
    ("huge key", "x" * 1000 + "=1", "unknown key"),
    ("many keys", "&".join(f"k{i}=1" for i in range(500)), "k0"),
    ("control characters", "shift=0,\x01\x1b[31m,0", "shift: got "),
    ("no UTF-8", "camera=\udcff\udcfe", "camera: got "),
)


def spoil_files(folder):
    """{name: (image, what the reason holds)}: files that are wrong themselves; each in a folder of its own."""
    cases = {}

    def case(name, reason, spoil, image="box.vshift"):
        own = folder / name.replace(" ", "_")
        shutil.copytree(folder / "good", own)
        spoil(own)
        cases[name] = (f"{own.name}/{image}", reason)

    def rewrite(text):
        return lambda own: (own / "box.vshift").write_bytes(text)

    def depth(own):
        return own / "frames/0000/CAM_FRONT.exr"

    case("missing depth", "CAM_FRONT.exr", lambda own: depth(own).unlink())
    case("truncated depth", "CAM_FRONT.exr", lambda own: os.truncate(depth(own), depth(own).stat().st_size // 2))
    case("empty depth", "CAM_FRONT.exr", lambda own: depth(own).write_bytes(b""))
    case("depth is a folder", "CAM_FRONT.exr", lambda own: (depth(own).unlink(), depth(own).mkdir()))
    case("depth is a pipe", "CAM_FRONT.exr", lambda own: (depth(own).unlink(), os.mkfifo(depth(own))))
    case("depth is another recipe", "", lambda own: edit(own / "box.vshift", lambda r: r["cameras"][0].update(depth="box.vshift")))
    case("depth of another size", "CAM_FRONT", lambda own: edit(own / "box.vshift", lambda r: r["cameras"][0].update(width=100)))
    case("no such channel", "Q", lambda own: edit(own / "box.vshift", lambda r: r["cameras"][0].update(depth_channel="Q")))
    case("no picture to warp", "image", lambda own: edit(own / "box.vshift", lambda r: (r.update(out="warp"), r["cameras"][0].pop("image"))))
    case("climbs out", "stays below", lambda own: edit(own / "box.vshift", lambda r: r["cameras"][0].update(depth="../x.exr")))
    case("huge size", "16384", lambda own: edit(own / "box.vshift", lambda r: r["cameras"][0].update(width=10**9)))
    case("unknown key in it", "did you mean cameras?", lambda own: edit(own / "box.vshift", lambda r: r.update(camera_s=1)))
    case("key twice in it", "the key twice", rewrite(b'{"vshift":1,"vshift":1}'))
    case("not JSON", "json", rewrite(b"not a recipe"))
    case("cut off", "json", lambda own: os.truncate(own / "box.vshift", 200))
    case("nested deep", "nesting", rewrite(b"[" * 100000))
    case("no bytes", "json", rewrite(b""))
    case("binary", "json", rewrite(bytes(range(1, 256)) * 40))
    case("zero bytes", "json", rewrite(b"\0" * 4096))
    case("other version", "vshift", lambda own: edit(own / "box.vshift", lambda r: r.update(vshift=2)))
    case("missing recipe", "", lambda own: None, "none.vshift")
    case("folder", "", lambda own: (own / "x.vshift").mkdir(), "x.vshift")
    case("loop of links", "", lambda own: os.symlink("x.vshift", own / "x.vshift"), "x.vshift")
    return cases


class Refused(Case):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        scene("box", cls.folder / "good", "--width", "64", "--height", "48")
        cls.files = spoil_files(cls.folder)

    def refuse(self, name, folder):
        """oiiotool on a name that must be refused; an output that is there stays, and one that is not does not come."""
        out = Path(tempfile.mkdtemp(dir=self.folder))
        (out / "old.exr").write_bytes(OLD)
        result = run(["oiiotool", name, "-o", out / "new.exr", name, "-o", out / "old.exr"], folder, limit_s=SOON_S)
        return result, sorted(p.name for p in out.iterdir()), (out / "old.exr").read_bytes()

    def check(self, result, left, old):
        self.assertEqual(result.code, 1, result)
        self.assertEqual(result.out, "", result)
        self.assertEqual(left, ["old.exr"], result)
        self.assertEqual(old, OLD, result)
        self.assertTrue(result.err.strip(), result)
        ours = "\n".join(line for line in result.err.split("\n") if line.startswith("vshift: "))
        self.assertNotRegex(ours, r"[\x00-\x09\x0b-\x1f\x7f]", "control characters reach the terminal")
        for word in ("terminate called", "Assertion", "internal:"):
            self.assertNotIn(word, result.err, result)

    def test_requests(self):
        """In the words of the program, through oiiotool; the rest through the API alone."""
        good = self.folder / "good"
        images, _ = probe([f"box.vshift?{query}" for _, query, _ in REQUESTS], good)
        for (what, _, reason), image in zip(REQUESTS, images):
            self.assertIn(reason, image.get("error", "no error"), what)
        for what, query, reason in (row for row in REQUESTS if row[0] in SAID_BY_PROGRAM):
            with self.subTest(what):
                result, left, old = self.refuse(f"box.vshift?{query}", good)
                self.check(result, left, old)
                self.assertIn(reason, result.err, result)
                key, value = query.split("=", 1)
                said = run([VSHIFT, "mask", "box.vshift", f"--{key}={value}", "-o", "cli.exr"], good, environment(plugin=False))
                self.assertEqual(said.code, 3, said)
                self.assertIn(said.err, result.err, f"the program says {said.err!r}{result}")

    def test_queries(self):
        for what, query, reason in QUERIES:
            with self.subTest(what):
                result, left, old = self.refuse(f"box.vshift?{query}", self.folder / "good")
                self.check(result, left, old)
                self.assertIn(reason, result.err, result)
                ours = [line for line in result.err.splitlines() if line.startswith("vshift: ")]
                self.assertEqual(len(ours), 1, f"the reason once{result}")
                self.assertIn("box.vshift", ours[0])
                self.assertLess(len(ours[0]), 2000, "one line that can be read")

    def test_no_equals_sign(self):
        """OpenImageIO itself turns down a query with a part that has no =, before it asks any plugin."""
        for query in ("CAM_FRONT", "frame=0&shift"):
            with self.subTest(query):
                self.check(*self.refuse(f"box.vshift?{query}", self.folder / "good"))
        names = [f"good/box.vshift?{query}" for query in ("shift", "CAM_FRONT", "frame=0&shift", "frame=0&&shift=0,1,0", "&")]
        for name, image in zip(names, probe(names, self.folder, pixels=False)[0]):
            self.assertRegex(image["error"], "malformed|key=value", name)

    def test_empty_query(self):
        """A bare ? asks for nothing more than the recipe does."""
        self.ran("oiiotool", "box.vshift?", "-o", "bare.exr", folder=self.folder / "good")
        self.same_pixels("bare.exr", "box.vshift", folder=self.folder / "good")

    def test_files(self):
        """All through the API, every third through oiiotool."""
        images, probed = probe([name for name, _ in self.files.values()], self.folder)
        self.assertLess(probed.seconds, 2 * SOON_S, probed)
        for (what, (name, reason)), image in zip(self.files.items(), images):
            self.assertTrue(image.get("error"), what)
            self.assertIn(reason, image["error"], what)
        for what, (name, reason) in list(self.files.items())[::3]:
            with self.subTest(what):
                result, left, old = self.refuse(name, self.folder)
                self.check(result, left, old)
                self.assertIn(reason, result.err, result)
                self.assertIn(Path(name).name if "vshift" in name else reason, result.err, result)

    def test_reason_in_iinfo_and_api(self):
        """iinfo and the API give the program's line through OpenImageIO itself, of a recipe with a query or without one."""
        names = [f"good/box.vshift?{query}" for _, query, _ in (REQUESTS[0], REQUESTS[12], QUERIES[0], QUERIES[1])]
        reasons = [reason for _, _, reason in (REQUESTS[0], REQUESTS[12], QUERIES[0], QUERIES[1])]
        for what in ("missing depth", "truncated depth", "unknown key in it", "not JSON"):
            names.append(self.files[what][0])
            reasons.append(self.files[what][1])
        images, result = probe(names, self.folder)
        self.assertEqual(len(re.findall("(?m)^vshift: ", result.err)), 4, f"only names with ? say it on the terminal too{result}")
        for name, reason, image in zip(names, reasons, images):
            with self.subTest(name):
                self.assertIn(reason, image.get("error", "no error"))
                self.assertIn("expected", image["error"])
        for name, reason in list(zip(names, reasons))[::3]:
            shown = run(["iinfo", name], self.folder)
            self.assertIn(reason, shown.text, shown)
            self.assertEqual(shown.code, 1, shown)

    def test_said_once(self):
        """The same error of the same name is said once in a process, however often it is tried."""
        name = "good/box.vshift?shift=0,one,0"
        images, result = probe([name] * 5, self.folder)
        self.assertEqual(result.err.count("expected a finite number"), 1, result)
        self.assertEqual(len({image["error"] for image in images}), 1, images)

    def test_no_error_exit(self):
        """oiiotool told to go on after an error goes on."""
        result = run(["oiiotool", "--no-error-exit", "good/box.vshift?shift=1", "--pop", "good/box.vshift", "-o", "on.exr"],
                     self.folder)
        self.assertGreaterEqual(result.code, 0, result)
        self.assertIn("three numbers x,y,z", result.err, result)

    def test_junk_queries(self):
        """Seeded random bytes behind the ?, all in one process: an error each, no crash, soon."""
        engine = random.Random(4)
        letters = "&=,?%#*.;:/\\'\" \t\n0123456789eE+-shiftcamerayw" + "".join(chr(c) for c in range(0x80, 0x100))
        names = ["good/box.vshift?x" + "".join(engine.choices(letters, k=engine.randrange(1, 300))) for _ in range(150)]
        images, result = probe(names, self.folder, pixels=False)
        self.assertLess(result.seconds, SOON_S)
        for name, image in zip(names, images):
            self.assertIn("error", image, name)
            self.assertTrue(image["error"], name)

    def test_spoiled_depths(self):
        """A depth file cut at many places or with bytes changed: an error or an answer, no crash."""
        own = self.folder / "spoiled"
        shutil.copytree(self.folder / "good", own)
        data = (own / "frames/0000/CAM_FRONT.exr").read_bytes()
        recipe = json.loads((own / "box.vshift").read_text())
        engine, names = random.Random(5), []
        for i in range(40):
            spoiled = bytearray(data[:engine.randrange(len(data))] if i % 2 else data)
            for _ in range(3 if spoiled else 0):
                at = engine.randrange(min(len(spoiled), 600))
                spoiled[at:at + 4] = struct.pack("<I", engine.getrandbits(32))[:len(spoiled) - at]
            (own / f"{i}.exr").write_bytes(spoiled)
            recipe["cameras"][0]["depth"] = f"{i}.exr"
            (own / f"{i}.vshift").write_text(json.dumps(recipe))
            names.append(f"spoiled/{i}.vshift")
        images, _ = probe(names, self.folder)
        for name, image in zip(names, images):
            self.assertNotIn("exception", image, name)
        self.assertGreater(sum("error" in image for image in images), 20)
