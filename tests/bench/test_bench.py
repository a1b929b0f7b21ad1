# SPDX-License-Identifier: Apache-2.0
"""A tiny `vshift bench --quick`: its fields, that they are plausible, its charts, and its errors.

    VSHIFT_BIN=build/bin/vshift /usr/bin/python3 tests/bench/test_bench.py
"""
import csv
import json
import os
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
VSHIFT = os.environ.get("VSHIFT_BIN", str(ROOT / "build" / "bin" / "vshift"))
OURS = ("sweep", "embree_tiles", "embree_0.1", "embree_0.02", "embree")
PEERS = ("splat_1", "splat_3", "ztest_true", "brute_force")


def scores(value, name=""):
    """Every F1, precision and recall of a nested row."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from scores(inner, key)
    elif isinstance(value, (int, float)) and (name.endswith("f1") or name in ("precision", "recall")):
        yield value


class TestBench(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory()
        cls.out = Path(cls.folder.name) / "new" / "bench"
        run = subprocess.run([VSHIFT, "bench", "--quick", "--width", "160", "-o", str(cls.out)], capture_output=True,
                             text=True, timeout=300)
        if run.returncode != 0:
            raise AssertionError(run.stderr)
        cls.bench = json.loads((cls.out / "bench.json").read_text())

    @classmethod
    def tearDownClass(cls):
        cls.folder.cleanup()

    def rows(self, section, **wanted):
        return [r for r in self.bench[section] if all(r.get(k) == v for k, v in wanted.items())]

    def test_says_what_it_ran_on(self):
        self.assertEqual((self.bench["width"], self.bench["height"], self.bench["quick"]), (160, 90, True))
        for key in ("cpu", "cores", "load_before", "load_after"):
            self.assertIn(key, self.bench["machine"])
        self.assertGreater(self.bench["seconds"], 0)

    def test_every_method_is_timed(self):
        for method in ("copy",) + OURS + PEERS:
            for row in self.rows("timing", method=method):
                self.assertGreater(row["cpu_ms"]["median"], 0, method)
                self.assertLessEqual(row["cpu_ms"]["q1"], row["cpu_ms"]["q3"])
            self.assertTrue(self.rows("timing", method=method, threads=1), method)
        for row in self.rows("timing", method="embree"):
            self.assertEqual(set(row["stages_wall_ms"]), {"lift", "build", "cast"})
        self.assertTrue(self.bench["torch"] == "measured" or self.bench["torch"].startswith("not measured: "))
        self.assertEqual(bool(self.rows("timing", method="torch_splat")), self.bench["torch"] == "measured")
        self.assertEqual(self.bench["blender"], "measured")
        self.assertEqual(len(self.rows("timing", method="ray_cast")), 2)

    def test_blender_asks_the_true_scene(self):
        for row in self.rows("accuracy", method="ray_cast"):
            self.assertGreater(row["scene"]["f1"], .98, row["camera"])

    def test_nothing_beats_the_copy_loop(self):
        for bound in self.rows("timing", method="copy", threads=1):
            for row in self.rows("timing", threads=1, camera=bound["camera"], shift=bound["shift"]):
                if row["method"] != "copy":
                    self.assertLess(bound["cpu_ms"]["least"], row["cpu_ms"]["least"], row["method"])

    def test_scores_are_scores(self):
        found = list(scores({"rows": None, **{str(i): r for i, r in enumerate(self.bench["accuracy"] + self.bench["rig"])}}))
        self.assertGreater(len(found), 100)
        for value in found:
            self.assertTrue(0 <= value <= 1, value)

    def test_no_shift_hides_nothing(self):
        for method in OURS:
            (row,) = self.rows("accuracy", method=method, shift="0,0,0")
            self.assertEqual(row["shell_everywhere"]["f1"], 1, method)
            self.assertEqual(row["certificate"]["unknown_share"], 0, method)

    def test_ours_beat_the_splats_on_exact_depth(self):
        pooled = {r["method"]: r["shell"]["pooled_f1"] for r in self.bench["summary"] if "shell" in r}
        for ours in OURS:
            for peer in ("splat_1", "splat_3"):
                self.assertGreater(pooled[ours], pooled[peer], (ours, peer))

    def test_shares_of_the_certificate(self):
        for row in self.bench["accuracy"]:
            if row["method"] in OURS:
                for key in ("certain_share", "wrong_share", "unknown_share", "unseen_share"):
                    self.assertTrue(0 <= row["certificate"][key] <= 1)

    def test_carving_does_not_add_unknowns(self):
        for row in self.bench["rig"]:
            for alone in self.rows("accuracy", method="embree_0.02", camera=row["camera"], shift=row["shift"]):
                self.assertLessEqual(row["certificate"]["unknown_share"] + row["certificate"]["unseen_share"],
                                     alone["certificate"]["unknown_share"] + alone["certificate"]["unseen_share"] + 1e-9)

    def test_same_bytes_for_any_number_of_threads(self):
        self.assertTrue(all(r["equal"] for r in self.bench["bytes_equal"]))
        if self.bench["machine"]["cores"] > 1:
            self.assertTrue(self.bench["bytes_equal"])

    def test_agreement_noise_and_steady_state(self):
        for row in self.bench["agreement"]:
            self.assertTrue(0 <= row["differing_share"] < (5e-4 if row["method"] == "embree_tiles" else .1), row)
        self.assertTrue({r["method"] for r in self.bench["noise"]} >= {"sweep", "embree_tiles", "splat_1", "splat_3"})
        for row in self.bench["noise"]:
            self.assertTrue(0 <= row["flicker"] <= 2)
        steady = self.bench["steady"]
        self.assertLessEqual(steady["wall_ms_p50"], steady["wall_ms_p99"])
        self.assertLess(steady["resident_after_bytes"], steady["resident_before_bytes"] + (64 << 20))

    def test_costs(self):
        self.assertEqual(len({r["cameras"] for r in self.bench["cameras"]}), 6)
        self.assertGreater(len({r["width"] for r in self.bench["resolution"]}), 1)
        self.assertGreater(len({r["metres"] for r in self.bench["shifts"]}), 1)

    def test_files(self):
        for name, start in (("speed_accuracy.svg", b"<?xml"), ("cost.svg", b"<?xml"), ("speed_accuracy.png", b"\x89PNG"),
                            ("cost.png", b"\x89PNG")):
            self.assertTrue((self.out / name).read_bytes().startswith(start), name)
        self.assertEqual({p.name for p in self.out.iterdir()}, {"bench.json", "bench.csv", "speed_accuracy.svg", "speed_accuracy.png",
                                                                "cost.svg", "cost.png", "tables.md", "differences.png"})
        self.assertIn("| mono | mono |", (self.out / "tables.md").read_text())
        with (self.out / "bench.csv").open() as lines:
            table = list(csv.DictReader(lines))
        for row in table:
            self.assertIsNone(row.get(None), row)
            row["value"] in ("true", "false") or float(row["value"])
        self.assertTrue({"timing", "accuracy", "rig", "noise", "steady"} <= {row["section"] for row in table})

    def test_wrong_width(self):
        for width in ("-16", "50", "161", "100000"):
            run = subprocess.run([VSHIFT, "bench", "--quick", "--width", width, "-o", str(self.out)], capture_output=True, text=True)
            self.assertEqual(run.returncode, 3, run.stderr)
            self.assertEqual(len(run.stderr.strip().splitlines()), 1, run.stderr)


if __name__ == "__main__":
    unittest.main(argv=[sys.argv[0]] + sys.argv[1:])
