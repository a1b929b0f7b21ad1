# SPDX-License-Identifier: Apache-2.0
"""Paths, scenes and the runner of the plugin's tests.

VSHIFT_BIN, VSHIFT_SCENES and VSHIFT_PLUGIN_DIR name other builds than the one in build/. With VSHIFT_ASAN_PLUGIN_DIR the
same tests load the plugin from there under the address sanitizer: any report of it fails the test, and so does a leak
with a frame in the plugin; leaks of the host alone are not ours and pass.
"""
import dataclasses
import functools
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import unittest
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
PLUGIN = "vshift.imageio.so"


def path_from(variable, default):
    return Path(os.environ.get(variable) or ROOT / default).resolve()


VSHIFT = str(path_from("VSHIFT_BIN", "build/bin/vshift"))
SCENES = str(path_from("VSHIFT_SCENES", "build/bin/vshift-scenes"))
ASAN = bool(os.environ.get("VSHIFT_ASAN_PLUGIN_DIR"))
PLUGIN_DIR = path_from("VSHIFT_ASAN_PLUGIN_DIR" if ASAN else "VSHIFT_PLUGIN_DIR", "build/lib")
TIME_LIMIT_S = 120 if ASAN else 30
MASK = ("lost", "occluded", "outside", "unknown", "unseen")
HOLES = ("disoccluded", "hole", "outside")   # in the order of an EXR
WARP = ("R", "G", "B", "Z", "hole")
SEAM = ("R", "G", "B", "source")
CONDITION = ("R", "G", "B", "hole", "neighbor", "own")
CHANNELS = {"mask": MASK, "holes": HOLES, "warp": WARP, "seam": SEAM, "condition": CONDITION}


# -- running ----------------------------------------------------------------------------------------

@dataclasses.dataclass
class Result:
    code: object  # the exit code, negative for a signal, 'timeout' past the limit
    out: str
    err: str
    seconds: float
    words: list

    @property
    def text(self):
        return self.out + self.err

    @property
    def computed(self):
        """Lines of VSHIFT_LOG=1: one for each answer that was computed."""
        return [line for line in self.err.splitlines() if line.startswith("vshift: computed ")]

    def __str__(self):
        words = " ".join(str(w)[:200] for w in self.words)
        return f"\n  {words}\n  exit {self.code} after {self.seconds:.1f} s\n  stdout: {self.out[-600:]!r}\n  stderr: {self.err[-1500:]!r}"


@functools.lru_cache(None)
def sanitizer():
    """What a host that is not sanitized must load first: the plugin's sanitizer and, for its sake, the C++ library."""
    linked = subprocess.run(["ldd", PLUGIN_DIR / PLUGIN], capture_output=True, text=True).stdout
    return ":".join(re.search(rf"{name}\S* => (\S+)", linked)[1] for name in ("libasan", r"libstdc\+\+"))


def environment(plugin=True, **changes):
    """The caller's, with the plugin to be found or not, and our own switches only where a test sets them."""
    env = {k: v for k, v in os.environ.items() if k not in ("OIIO_LIBRARY_PATH", "VSHIFT_LOG", "VSHIFT_CACHE_MB")}
    env.update(LC_ALL="C.UTF-8", PATH=f"{Path(VSHIFT).parent}:{env['PATH']}")
    if plugin:
        env["OIIO_LIBRARY_PATH"] = str(PLUGIN_DIR)
        if ASAN:
            env.update(LD_PRELOAD=sanitizer(), ASAN_OPTIONS="detect_leaks=1", LSAN_OPTIONS="exitcode=0",
                       UBSAN_OPTIONS="print_stacktrace=1")
    return {**env, **{k: str(v) for k, v in changes.items()}}


def run(words, folder=None, env=None, limit_s=TIME_LIMIT_S):
    begin = time.monotonic()
    child = subprocess.Popen([str(w) for w in words], cwd=folder, env=env or environment(), stdin=subprocess.DEVNULL,
                             stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True)
    try:
        out, err = child.communicate(timeout=limit_s)
        code = child.returncode
    except subprocess.TimeoutExpired:
        child.kill()
        out, err = child.communicate()
        code = "timeout"
    out, err = out.decode("utf-8", "replace"), err.decode("utf-8", "replace")
    return Result(code, out, without_host_leaks(err) if ASAN else err, time.monotonic() - begin, list(words))


def without_host_leaks(err):
    """stderr without leak reports of the host alone; raises on everything else that a sanitizer says.

    A record that starts in the plugin's create function is the host's: OpenImageIO 2.4's Python never frees an input, of
    any format. Indirect leaks hang on a direct one.
    """
    head, *leaks = re.split(r"(?m)^=+\n==\d+==ERROR: LeakSanitizer.*\n", err)
    records = [r for leak in leaks for r in leak.split("\n\n") if "Direct leak of" in r]
    ours = [r for r in records if re.search("vshift|oiio_plugin/|embree_core/", r) and "vshift_input_imageio_create" not in r]
    if ours or "AddressSanitizer" in head or "runtime error:" in head:
        raise AssertionError("sanitizer: " + (ours[0] if ours else head)[:4000])
    return head


def probe(names, folder, env=None, **options):
    """What the API gives for each name, from one child process: see probe.py."""
    result = run([sys.executable, HERE / "probe.py", json.dumps({"names": [str(n) for n in names], **options})], folder, env)
    if result.code != 0:
        raise AssertionError(f"probe failed{result}")
    return json.loads(result.out), result


def python(script, folder, env=None, *words):
    """A script of a test in a process of its own, so that the plugin is loaded there."""
    return run([sys.executable, "-c", script, *words], folder, env)


# -- files ------------------------------------------------------------------------------------------

def pixels(path):
    """{channel: HxW array} and the spec of a plain file, read without the plugin."""
    image = oiio.ImageInput.open(str(path))
    if image is None:
        raise AssertionError(f"{path}: {oiio.geterror()}")
    spec, data = image.spec(), image.read_image("float")
    image.close()
    return {name: data[:, :, i] for i, name in enumerate(spec.channelnames)}, spec


def write_exr(path, channels):
    path.parent.mkdir(parents=True, exist_ok=True)
    planes = np.stack([np.asarray(p, np.float32) for p in channels.values()], axis=-1)
    spec = oiio.ImageSpec(planes.shape[1], planes.shape[0], planes.shape[2], "float")
    spec.channelnames = tuple(channels)
    out = oiio.ImageOutput.create(str(path))
    assert out and out.open(str(path), spec) and out.write_image(planes) and out.close(), oiio.geterror()


def scene(name, folder, *options):
    """A minimal scene in a folder: NAME.vshift, its frames and what is expected of it."""
    made = run([SCENES, name, "-o", folder, *options], env=environment(plugin=False))
    assert made.code == 0, made
    return Path(folder) / f"{name}.vshift"


def edit(recipe, change):
    """Rewrites a recipe by a function of its JSON."""
    data = json.loads(recipe.read_text())
    change(data)
    recipe.write_text(json.dumps(data))


class Case(unittest.TestCase):
    """A folder of its own; commands run in it."""

    @classmethod
    def setUpClass(cls):
        cls.folder = Path(tempfile.mkdtemp(prefix="vshift_oiio_"))
        cls.addClassCleanup(shutil.rmtree, cls.folder)

    def ran(self, *words, folder=None, **changes):
        """Runs a command that must succeed and say nothing of errors."""
        result = run(words, folder or self.folder, environment(**changes))
        self.assertEqual(result.code, 0, result)
        self.assertNotIn("ERROR", result.text, result)
        return result

    def same_pixels(self, a, b, folder=None):
        """idiff, with no tolerance."""
        result = run(["idiff", "-a", "-fail", "0", "-warn", "0", a, b], folder or self.folder)
        self.assertEqual(result.code, 0, result)
        self.assertIn("PASS", result.out, result)
