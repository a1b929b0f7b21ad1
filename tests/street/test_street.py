# SPDX-License-Identifier: CC0-1.0
"""The street's geometry: same on every machine, sane, and free for the recorded drive.

    python3 -m unittest discover -s tests/street
"""
import json
import os
import subprocess
import sys
import unittest
from pathlib import Path

import numpy as np

SCENES = Path(__file__).resolve().parents[2] / "scenes"
sys.path.insert(0, str(SCENES))

from street import DETAIL_LEVELS, ego_gap, generate  # noqa: E402

GOLDEN = {
    0: "fa87571cad06c45ef3b6c459450e5060a35417ead454e850a0f60103573e43c2",
    1: "6b19f3e73ead16fd167ff1a620b93d097c14cf8d4df0293335b9b9dcf5c33655",
    2: "78142c112608973cef516e91f2d5b5bcebf57593d55afe39df01c59a6f38ccaa",
    3: "e308e9ca76cad936391a40bbcce0fdcf9c06f2ae0f62f0705e3882cbede5777e",
}
TRIANGLE_LIMIT = {0: 60_000, 1: 600_000, 2: 1_500_000, 3: 4_000_000}
_made = {}


def street(seed=1, detail=2):
    if (seed, detail) not in _made:
        _made[seed, detail] = generate(seed=seed, detail=detail)
    return _made[seed, detail]


class Repeatable(unittest.TestCase):
    def test_two_processes_agree(self):
        env = dict(os.environ, PYTHONPATH=str(SCENES))
        got = []
        for salt in ("1", "2"):
            run = subprocess.run([sys.executable, "-m", "street", "--seed", "5", "--detail", "1"], check=True, capture_output=True,
                                 env=dict(env, PYTHONHASHSEED=salt))
            got.append(json.loads(run.stdout)["geometry_hash"])
        self.assertEqual(got[0], got[1])

    def test_golden(self):
        for detail, expected in GOLDEN.items():
            self.assertEqual(street(1, detail).geometry_hash(), expected, "seed 1, detail %d" % detail)

    def test_seeds_differ(self):
        self.assertEqual(len({street(s, 1).geometry_hash() for s in (1, 2, 3, 4)}), 4)


class Shape(unittest.TestCase):
    def test_detail_rises(self):
        n = [street(1, d).triangle_count() for d in sorted(DETAIL_LEVELS)]
        self.assertEqual(n, sorted(n))
        for d, limit in TRIANGLE_LIMIT.items():
            self.assertGreater(n[d], n[d - 1] * 1.3 if d else 0)
            self.assertLessEqual(n[d], limit, "detail %d" % d)

    def test_same_placement_at_every_level(self):
        def placed(s):
            return {i.name: np.round(i.matrix, 4).tolist() for i in s.instances if i.category in ("car", "person", "tree", "building", "furniture")}
        a = placed(street(1, 0))
        for d in (1, 2, 3):
            self.assertEqual(a, placed(street(1, d)), "detail %d" % d)
        self.assertEqual(street(1, 0).movers, street(1, 2).movers)

    def test_faces(self):
        for d in sorted(DETAIL_LEVELS):
            for name, p in street(1, d).parts.items():
                v, f = p.vertices, p.faces
                self.assertEqual(v.dtype, np.float32, name)
                self.assertEqual(f.dtype, np.int32, name)
                self.assertTrue(np.isfinite(v).all(), name)
                self.assertTrue((f[:, :3] >= 0).all() and f.max() < len(v) and f.min() >= -1, name)
                if p.uv is not None:
                    self.assertEqual(p.uv.shape, (len(v), 2), name)
                    self.assertTrue(np.isfinite(p.uv).all(), name)
                q = v[np.where(f < 0, f[:, :1], f)].astype(float)
                a = np.cross(q[:, 1] - q[:, 0], q[:, 2] - q[:, 0])
                b = np.cross(q[:, 2] - q[:, 0], q[:, 3] - q[:, 0])
                area = np.sqrt((a * a).sum(1)) + np.where(f[:, 3] >= 0, np.sqrt((b * b).sum(1)), 0)
                self.assertGreater(area.min(), 1e-9, name)

    def test_bounds(self):
        s = street(1, 2)
        for i in s.instances:
            m = i.matrix if i.mover is None else s.movers[i.mover].world_from_mover(0.0) @ i.matrix
            for k in i.parts:
                v = s.parts[k].vertices @ m[:3, :3].T + m[:3, 3]
                self.assertTrue((np.abs(v) < [320, 160, 40]).all(), i.name)
                self.assertGreater(v[:, 2].min(), -0.6, i.name)

    def test_closed_solids_look_outward(self):
        """Signed volume of cars, people and furniture is positive: faces are counter-clockwise from outside."""
        s = street(1, 2)
        for i in s.instances:
            if i.category not in ("car", "person", "bicycle", "signal", "fence"):
                continue
            volume = 0.0
            for k in i.parts:
                p = s.parts[k]
                v, f = p.vertices.astype(float) - p.vertices.mean(0) * 0, p.faces
                for t in (f[:, :3], f[f[:, 3] >= 0][:, [0, 2, 3]]):
                    volume += np.einsum("ij,ij->i", v[t[:, 0]], np.cross(v[t[:, 1]], v[t[:, 2]])).sum() / 6
            self.assertGreater(volume, 0.0, i.name)

    def test_instances_name_known_parts_and_movers(self):
        s = street(1, 2)
        names = [i.name for i in s.instances]
        self.assertEqual(len(names), len(set(names)))
        for i in s.instances:
            self.assertTrue(set(i.parts) <= set(s.parts), i.name)
            self.assertTrue(i.mover is None or i.mover in s.movers, i.name)


class Drive(unittest.TestCase):
    def test_recorded_drive_is_free(self):
        for seed in range(1, 9):
            s = street(seed, 0)
            for t in np.arange(0.0, 10.01, 0.1):
                gap, name = ego_gap(s, t)
                self.assertGreaterEqual(gap, 0.6, "seed %d, t %.1f s: %s" % (seed, t, name))

    def test_small_shifts_are_mostly_free_and_large_ones_not_always(self):
        free = {y: [] for y in (-4, -2, -1, 1, 2, 4)}
        for seed in range(1, 5):
            s = street(seed, 0)
            for t in np.arange(0.0, 10.01, 0.5):
                for y in free:
                    free[y].append(ego_gap(s, t, (0.0, float(y), 0.0))[0] > 0.2)
        for y in (-2, -1, 1, 2):
            self.assertGreater(np.mean(free[y]), 0.8, "shift %d m" % y)
        self.assertLess(min(np.mean(free[-4]), np.mean(free[4])), 1.0)

    def test_nothing_moving_collides(self):
        for seed in range(1, 5):
            s = street(seed, 0)
            from street.scene import box_gap
            moving = sorted({o.name for o in s.solids if o.mover and o.category == "car"})
            for t in np.arange(0.0, 10.01, 0.5):
                boxes = {n: (c, h, y) for n, _, (c, h, y) in s.obstacles(t)}
                for k, a in enumerate(moving):
                    for b in boxes:
                        if b in moving[:k + 1] or b == a:
                            continue
                        self.assertGreater(box_gap(*boxes[a], *boxes[b]), 0.0, "seed %d, t %.1f: %s and %s" % (seed, t, a, b))

    def test_bad_arguments_are_refused(self):
        for bad in ({"detail": 4}, {"length_m": 10.0}, {"traffic": -1.0}):
            with self.assertRaises(ValueError):
                generate(**bad)


if __name__ == "__main__":
    unittest.main()
