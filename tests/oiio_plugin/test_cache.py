# SPDX-License-Identifier: Apache-2.0
"""One computation for each answer, however often and from however many threads it is opened; bounded; never stale."""
import json
import os
import re
import unittest

from support import ASAN, Case, environment, pixels, probe, python, scene

LOGGED = {"VSHIFT_LOG": 1}
ANSWER_MB = 320 * 240 * 5 * 4 / 2**20

CHANGE = """
import json, os, shutil, sys, time
import OpenImageIO as oiio
def total():
    image = oiio.ImageInput.open("box.vshift?shift=0,1,0")
    value = None if image is None else float(image.read_image("float")[:, :, 1].sum())
    if image is None: oiio.geterror()
    else: image.close()
    return value
depth, recipe = "frames/0000/CAM_FRONT.exr", "box.vshift"
seen = [total(), total()]
shutil.copy("other.exr", depth)                       # other content and times
seen.append(total())
info = os.stat(depth)
os.utime("first.exr", ns=(info.st_atime_ns, info.st_mtime_ns))
os.replace("first.exr", depth)                        # renamed over: another inode with the same time
seen += [total(), total()]
os.remove(depth)                                      # gone
seen.append(total())
shutil.copy("other.exr", depth)                       # there again
seen.append(total())
data = json.load(open(recipe)); data["cameras"][0]["intrinsic"][0][0] *= 2
json.dump(data, open(recipe, "w"))                    # another recipe of the same name
seen.append(total())
print(json.dumps(seen))
"""

# ImageInput.open holds Python's lock while it works; ImageBuf.read does not, but its constructor looks at the file. So the
# recipe comes between the two. And one name is opened once by OpenImageIO's own cache: the same request is written in
# eight ways (1, 1.0, 1.00 ...), so that eight threads meet in the plugin.
TOGETHER = """
import os, threading, hashlib
import OpenImageIO as oiio
oiio.ImageBuf(oiio.ImageSpec(1, 1, 1, "float")).get_pixels("float")
config = oiio.ImageSpec()
images = [oiio.ImageBuf(f"late.vshift?shift=0,{1 + i % 2}." + "0" * (i + 1) + ",0", 0, 0, config) for i in range(8)]
os.link("box.vshift", "late.vshift")
start, done = threading.Barrier(9), [None] * 8
def work(i):
    start.wait()
    done[i] = images[i].read(0, 0, True)
threads = [threading.Thread(target=work, args=(i,)) for i in range(8)]
for thread in threads: thread.start()
start.wait()
for thread in threads: thread.join()
reasons = [image.geterror() for image in images]  # fetched, or newer versions print them at the end
assert all(done), reasons
print(len({hashlib.sha256(image.get_pixels("float").tobytes()).hexdigest() for image in images}))
"""

GROWTH = """
import sys
import OpenImageIO as oiio
def resident_mb():
    return int(open("/proc/self/statm").read().split()[1]) * 4096 / 2**20
def one(i):
    image = oiio.ImageInput.open(f"box.vshift?shift=0,{i / 100},0")
    assert image, oiio.geterror()
    image.read_image("float"); image.close()
for i in range(10): one(i)
begin = resident_mb()
for i in range(10, int(sys.argv[1])): one(i)
print(resident_mb() - begin)
"""


def figures(line):
    """(A, B) of a log line's 'cache A of B MB'."""
    found = re.search(r"cache ([\d.]+) of ([\d.]+) MB", line)
    return float(found[1]), float(found[2])


class Cache(Case):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        scene("box", cls.folder)

    def probed(self, names, env=None, **options):
        return probe(names, self.folder, environment(**LOGGED, **(env or {})), **options)

    def test_log_line(self):
        """Says what, of what, how long and how full; nothing without VSHIFT_LOG, and never on stdout."""
        result = self.ran("oiiotool", "box.vshift?shift=0,1,0", "-o", "a.exr", **LOGGED)
        self.assertEqual(len(result.computed), 1, result)
        self.assertRegex(result.computed[0], r"^vshift: computed .* of \S*box\.vshift in [\d.]+ ms, cache [\d.]+ of 1024(\.0)? MB$")
        self.assertEqual(result.out, "", result)
        self.assertEqual(self.ran("oiiotool", "box.vshift?shift=0,1,0", "-o", "a.exr").text, "")

    def test_once_in_a_command_line(self):
        """The same name five times, and opened by oiiotool for each as often as it likes."""
        name = "box.vshift?shift=0,1,0"
        result = self.ran("oiiotool", name, "--ch", "lost", name, "--ch", "occluded", name, name, "--stats", name, "-o", "a.exr", **LOGGED)
        self.assertEqual(len(result.computed), 1, result)

    def test_once_however_it_is_written(self):
        """One request in other words is one answer; another request is another."""
        same = ["box.vshift", "box.vshift?", "box.vshift?shift=0,1,0", "box.vshift?shift=0,1.0,0&camera=CAM_FRONT",
                "box.vshift?yaw_deg=0&frame=0&shift=0,1e0,-0"]
        other = ["box.vshift?shift=0,1,0&out=holes", "box.vshift?shift=0,1.001,0", "box.vshift?shift=0,1,0&clear_m=1"]
        images, result = self.probed(same + other)
        self.assertEqual(len(result.computed), 1 + len(other), result)
        self.assertEqual(len({image["subimages"][0]["sha256"] for image in images[:len(same)]}), 1)

    def test_threads(self):
        names = [f"box.vshift?shift=0,{left_m},0" for left_m in (0.5, 1, 1.5)]
        single, result = self.probed(names)
        self.assertEqual(len(result.computed), 3, result)
        for repeat in range(2):
            many, result = self.probed(names, threads=8)
            self.assertEqual(len(result.computed), 3, f"8 threads, run {repeat}{result}")
            for images in many:
                self.assertEqual(images, single)

    def test_threads_at_once(self):
        """Two requests, each from four threads that are all inside the plugin at the same time."""
        for repeat in range(2):
            (self.folder / "late.vshift").unlink(missing_ok=True)
            result = python(TOGETHER, self.folder, environment(**LOGGED))
            self.assertEqual((result.code, result.out.strip()), (0, "2"), result)
            self.assertEqual(len(result.computed), 2, f"run {repeat}{result}")

    def test_threads_and_an_error(self):
        """Eight threads wait for an answer that fails: each gets the reason, none hangs."""
        many, result = self.probed(["box.vshift?shift=0,1,0&frame=3", "box.vshift?shift=0,1,0"], threads=8)
        for bad, good in many:
            self.assertIn("frame: got 3", bad["error"])
            self.assertIn("subimages", good)
        self.assertEqual(len(result.computed), 1, result)

    def test_config(self):
        """Keys as attributes of the open configuration; the query wins; a wrong one is refused as in a query."""
        def opened(name, **config):
            images, result = self.probed([name], config={f"vshift:{k}": v for k, v in config.items()})
            return images[0], result
        (want, other, holes), _ = self.probed([f"box.vshift?{q}" for q in ("shift=0,2,0", "shift=0,1,0", "shift=0,2,0&out=holes")])
        self.assertNotEqual(want, other)
        self.assertEqual(opened("box.vshift", shift="0,2,0")[0], want)
        self.assertEqual(opened("box.vshift", shift="0,2,0", out="holes", camera="CAM_FRONT")[0], holes)
        self.assertEqual(opened("box.vshift?shift=0,2,0", shift="0,1,0")[0], want)
        self.assertIn("three numbers", opened("box.vshift", shift="0,2")[0]["error"])
        self.assertIn("did you mean CAM_FRONT", opened("box.vshift", camera="CAM_FRON")[0]["error"])
        limited, result = opened("box.vshift?shift=0,2,0", cache_mb=64)
        self.assertEqual(limited, want)
        self.assertEqual(figures(result.computed[0])[1], 64, result)

    def test_changed_files(self):
        """Depth overwritten, renamed over, removed, put back, recipe changed: each is noticed within one process."""
        own = self.folder / "changed"
        scene("box", own)
        scene("fence", self.folder / "fence")
        depth = own / "frames/0000/CAM_FRONT.exr"
        os.link(self.folder / "fence/frames/0000/CAM_FRONT.exr", own / "other.exr")
        (own / "first.exr").write_bytes(depth.read_bytes())
        result = python(CHANGE, own, environment(**LOGGED))
        self.assertEqual(result.code, 0, result)
        box, again, fence, box_back, box_kept, gone, there, longer = json.loads(result.out)
        self.assertEqual(box, 40 * 40)
        self.assertEqual([again, box_back, box_kept], [box] * 3, result)
        self.assertTrue(fence > 0 and fence != box, result)
        self.assertEqual((gone, there), (None, fence), result)
        self.assertNotIn(longer, (None, fence), result)
        self.assertIn(len(result.computed), (4, 5), f"box, fence, box, (fence again or remembered), longer{result}")

    def test_bounded(self):
        """Room for three answers: the figure stays within the limit, and what fell out is computed again and right."""
        limit_mb = 5
        names = [f"box.vshift?shift=0,{i / 10},0" for i in range(1, 9)]
        images, result = self.probed(names + names, {"VSHIFT_CACHE_MB": limit_mb})
        used = [figures(line) for line in result.computed]
        self.assertTrue(all(limit == limit_mb for _, limit in used), result)
        self.assertTrue(all(0 < mb <= limit_mb for mb, _ in used), result)
        self.assertGreater(max(mb for mb, _ in used), 2 * ANSWER_MB, f"a cache that keeps{result}")
        self.assertEqual(len(result.computed), 16, f"eight do not fit: each is computed twice{result}")
        self.assertEqual(images[:8], images[8:])
        unbounded, result = self.probed(names + names)
        self.assertEqual(len(result.computed), 8, result)
        self.assertEqual(unbounded, images)

    def test_last_used_stay(self):
        """What was used last is kept: A, B, A, C, A needs no second computation of A where two fit."""
        a, b, c = (f"box.vshift?shift=0,{left_m},0" for left_m in (1, 1.25, 1.5))
        _, result = self.probed([a, b, a, c, a], {"VSHIFT_CACHE_MB": 3})
        self.assertEqual(len(result.computed), 3, result)

    def test_smaller_than_one_answer(self):
        """An answer that the cache cannot keep is right all the same, in oiiotool too."""
        want = self.probed(["box.vshift?shift=0,1,0"] * 2)[0]
        for limit in (1, 0):
            with self.subTest(limit=limit):
                images, result = self.probed(["box.vshift?shift=0,1,0"] * 2, {"VSHIFT_CACHE_MB": limit})
                self.assertEqual(images, want)
                self.assertTrue(all(figures(line)[0] <= limit for line in result.computed), result)
        self.ran("oiiotool", "box.vshift?shift=0,1,0", "--ch", "occluded", "--trim", "-o", "small.exr", VSHIFT_CACHE_MB=0)
        spec = pixels(self.folder / "small.exr")[1]
        self.assertEqual((spec.x, spec.y, spec.width, spec.height), (168, 100, 40, 40))

    def test_odd_limits(self):
        """A limit that is no number is told or ignored, but nothing crashes and the answer is right."""
        want = self.probed(["box.vshift?shift=0,1,0"])[0]
        for limit in ("many", "-1", "1e99"):
            with self.subTest(limit=limit):
                images, result = self.probed(["box.vshift?shift=0,1,0"], {"VSHIFT_CACHE_MB": limit})
                self.assertTrue(images == want or "VSHIFT_CACHE_MB" in result.err, result)

    @unittest.skipIf(ASAN, "a sanitizer keeps freed memory")
    def test_memory(self):
        """35 further answers of 1.5 MB with room for two: the process does not grow by what they hold."""
        result = python(GROWTH, self.folder, environment(VSHIFT_CACHE_MB=4), "45")
        self.assertEqual(result.code, 0, result)
        self.assertLess(float(result.out), 0.4 * 35 * ANSWER_MB, result)
