# SPDX-License-Identifier: GPL-3.0-or-later
"""The addon inside Blender: binding, cameras, sets, refusals and the proof. Run by run_tests.py."""
import io
import json
import sys
import tempfile
import unittest
from pathlib import Path

import bpy
import numpy as np
import small_street
import vshift
from vshift import core, denoise, exr, manifest, mesh_export, progress, proof, rig, set_builder, truth, views
from vshift.core import VshiftError

SHIFTS = [(0.0, 1.0, 0.0, 0.0), (0.0, 4.0, 0.0, 0.0)]


def small_set(folder, **more):
    """Builds a set of the small street at 64x36; returns (status counts, manifest, progress lines)."""
    small_street.install()
    lines = io.StringIO()
    options = set_builder.Options(out=Path(folder), width=64, height=36, samples=1, shifts=SHIFTS, **more)
    counts = set_builder.build_set(options, progress.Progress({}, lines))
    return counts, manifest.load(folder), lines.getvalue()


class Binding(unittest.TestCase):
    def square(self):
        """Two triangles, 2 m square, at x = 5 m, facing the origin."""
        v = np.array([[5, -1, -1], [5, 1, -1], [5, 1, 1], [5, -1, 1]], float)
        return v, np.array([[0, 1, 2], [0, 2, 3]], np.uint32)

    def test_version_and_self_test(self):
        self.assertIn("Embree", core.version())
        self.assertEqual(core.load().vshift_self_test(), 0)

    def test_known_rays(self):
        with core.Scene(*self.square()) as scene:
            distance, triangle = scene.cast_rays([[0, 0, 0.1], [0, 0, 0.1], [0, 3, 0], [1000, 0, 0.1]],
                                                 [[1, 0, 0], [-1, 0, 0], [1, 0, 0], [-1, 0, 0]])
        np.testing.assert_allclose(distance[[0, 3]], [5, 995], rtol=1e-6)
        self.assertTrue(np.isinf(distance[[1, 2]]).all())
        self.assertTrue((triangle[[1, 2]] == -1).all() and (triangle[[0, 3]] >= 0).all())

    def test_known_picture(self):
        # f = 50 px, 5 m away: the square of 2 m covers exactly 20 x 20 pixels
        m = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0]])
        camera = core.Camera(64, 48, 50.0, 50.0, 32.0, 24.0, m)
        with core.Scene(*self.square()) as scene:
            out = scene.cast_camera(camera, normal=True, position=True)
        hit = np.isfinite(out["depth"])
        self.assertEqual(int(hit.sum()), 400)
        np.testing.assert_allclose(out["depth"][hit], 5.0, atol=1e-5)
        np.testing.assert_allclose(out["normal"][hit], np.broadcast_to([-1, 0, 0], (400, 3)), atol=1e-6)
        uv, _ = camera.project(out["position"][hit])
        v, u = np.nonzero(hit)
        np.testing.assert_allclose(uv, np.stack([u + 0.5, v + 0.5], -1), atol=1e-3)

    def test_bad_input_is_refused(self):
        v, t = self.square()
        with self.assertRaisesRegex(VshiftError, "vertices: got shape"):
            core.Scene(v[:, :2], t)
        with self.assertRaisesRegex(VshiftError, "triangles: got float64"):
            core.Scene(v, t.astype(float))
        with self.assertRaises(VshiftError):
            core.Scene(v, t + 2)                       # names a vertex that is not there
        with self.assertRaises(VshiftError):
            core.Scene(np.where(v == 5, np.nan, v), t)

    def test_clearance(self):
        with core.Scene(*self.square()) as scene:
            near, inside = scene.clearance((4.8, 0, 0), 0.5)
            far, _ = scene.clearance((0, 0, 0), 0.5)
        self.assertAlmostEqual(near, 0.2, delta=0.02)
        self.assertFalse(inside)
        self.assertEqual(far, 0.5)


class Rig(unittest.TestCase):
    def test_names_and_recipe(self):
        cameras = rig.make_rig(400, 225)
        self.assertEqual(tuple(c.name for c in cameras), rig.NAMES)
        entry = rig.recipe_camera(cameras[0])
        full = rig.recipe_camera(rig.make_rig()[0])
        self.assertEqual(entry["intrinsic"][0][0] * 4, full["intrinsic"][0][0])
        self.assertEqual(entry["intrinsic"][1][2] * 4, full["intrinsic"][1][2])
        self.assertEqual(rig.shift_name((0, -0.0, 2), 5), "x+0.00_y+0.00_z+2.00_yaw+5.00")

    def test_quaternions(self):
        for c in rig.make_rig():
            r = c.ego_from_cam[:3, :3]
            np.testing.assert_allclose(r @ r.T, np.eye(3), atol=1e-12)
            self.assertAlmostEqual(np.linalg.det(r), 1.0)
        front = rig.make_rig()[0].ego_from_cam[:3, :3]
        np.testing.assert_allclose(front, [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], atol=1e-12)

    def test_shift_moves_then_turns(self):
        c = rig.make_rig()[0]
        moved = rig.view(c, np.eye(4), (0, 1, 0), 90.0)
        np.testing.assert_allclose(moved.centre, [-c.translation_m[1], 1 + c.translation_m[0], c.translation_m[2]],
                                   atol=1e-12)

    def test_intrinsics_in_blender(self):
        """Cycles' Position pass, projected by our K, is the pixel's centre: all cameras, square and oblong pixels."""
        small_street.install()
        street = set_builder.build_street(set_builder.Options(out="."))
        with tempfile.TemporaryDirectory() as temp:
            for width, height in ((160, 90), (160, 120), (100, 40)):
                for c in rig.make_rig(width, height):
                    camera = rig.view(c, street.ego_pose(1.0))
                    views.configure(bpy.context.scene, 1, 0, ("Depth", "Position"), exact_centres=True)
                    passes = views.render_passes(camera, temp, ("Depth", "Position"))
                    hit = np.isfinite(passes["Depth"])
                    uv, z = camera.project(passes["Position"][hit])
                    v, u = np.nonzero(hit)
                    self.assertGreater(len(u), 1000)
                    off = np.hypot(uv[:, 0] - u - 0.5, uv[:, 1] - v - 0.5)
                    self.assertLess(np.percentile(off, 99.9), 0.03, f"{c.name} {width}x{height}")
                    np.testing.assert_allclose(z, passes["Depth"][hit], rtol=2e-3)


class Views(unittest.TestCase):
    def test_pitfalls_are_refused(self):
        set_builder.new_scene()
        ob = rig.camera_object()
        for spoil in (lambda: setattr(ob.data.dof, "use_dof", True),
                      lambda: setattr(bpy.context.scene.render, "use_motion_blur", True),
                      lambda: setattr(bpy.context.scene.cycles, "use_denoising", True)):
            views.configure(bpy.context.scene, 1)
            ob.data.dof.use_dof = False
            views.refuse_pitfalls(bpy.context.scene, ob)
            spoil()
            with self.assertRaises(VshiftError):
                views.refuse_pitfalls(bpy.context.scene, ob)

    def test_a_folder_that_is_gone_is_an_error(self):
        set_builder.new_scene()
        views.configure(bpy.context.scene, 1)
        camera = rig.view(rig.make_rig(16, 9)[0], np.eye(4))
        with tempfile.TemporaryDirectory() as temp:
            blocked = Path(temp) / "file"
            blocked.write_text("")
            with self.assertRaises(VshiftError) as caught:
                views.render_passes(camera, blocked / "below")
        self.assertEqual(caught.exception.code, 4)

    def test_exr_round_trip(self):
        z = np.array([[1.5, np.inf], [0.25, 1e6]], np.float32)
        with tempfile.TemporaryDirectory() as temp:
            path = Path(temp) / "a" / "b.exr"
            exr.write(path, [("R", z, "half"), ("Z", z, "float"), ("truth.class", z > 1, "half")], temp)
            first = path.read_bytes()
            back = exr.read(path)
            exr.write(path, [("R", z, "half"), ("Z", z, "float"), ("truth.class", z > 1, "half")], temp)
            self.assertEqual(first, path.read_bytes())
        np.testing.assert_array_equal(back["Z"], z)
        self.assertEqual(back["R"].max(), 65504.0)
        np.testing.assert_array_equal(back["truth.class"], z > 1)

    def test_smoothing_keeps_a_constant_and_lowers_noise(self):
        rng = np.random.default_rng(1)
        shape = (48, 64)
        passes = {"Normal": np.broadcast_to(np.float32([0, 0, 1]), (*shape, 3)).copy(),
                  "Depth": np.full(shape, 5, np.float32), "DiffInd": np.zeros((*shape, 3), np.float32),
                  "DiffCol": rng.uniform(0.2, 0.8, (*shape, 1)).repeat(3, -1).astype(np.float32)}
        passes["DiffDir"] = np.ones((*shape, 3), np.float32)
        passes["Combined"] = passes["DiffCol"] * passes["DiffDir"]
        np.testing.assert_allclose(denoise.smooth(passes), passes["DiffCol"], atol=1e-5)
        passes["DiffDir"] = passes["DiffDir"] + rng.normal(0, 0.2, (*shape, 1)).astype(np.float32)
        passes["Combined"] = passes["DiffCol"] * passes["DiffDir"]
        before = np.abs(passes["Combined"] - passes["DiffCol"]).mean()
        after = np.abs(denoise.smooth(passes) - passes["DiffCol"]).mean()
        self.assertLess(after, 0.6 * before)


class Mesh(unittest.TestCase):
    def test_instances_modifiers_and_hidden_objects(self):
        set_builder.new_scene()
        scene = bpy.context.scene
        mesh = bpy.data.meshes.new("quad")
        mesh.from_pydata([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [], [[0, 1, 2, 3]])
        group = bpy.data.collections.new("group")
        group.objects.link(bpy.data.objects.new("quad", mesh))
        for i in range(3):
            ob = bpy.data.objects.new(f"placed{i}", None)
            ob.instance_type, ob.instance_collection, ob.location = "COLLECTION", group, (0, 0, i + 1)
            ob["vshift_category"] = "sign"
            scene.collection.objects.link(ob)
        thick = bpy.data.objects.new("array", mesh)
        thick.modifiers.new("array", "ARRAY").count = 4
        hidden = bpy.data.objects.new("hidden", mesh)
        hidden.hide_render = True
        for ob in (thick, hidden):
            scene.collection.objects.link(ob)
        v, t, category, names = mesh_export.world_triangles()
        self.assertEqual(len(t), 2 * 3 + 2 * 4)
        self.assertEqual(sorted(np.unique(v[:, 2]).tolist()), [0, 1, 2, 3])
        self.assertEqual(int((category == names.index("sign")).sum()), 6)


class Foliage(unittest.TestCase):
    def test_pixels_that_show_a_plant(self):
        ground = [(-50, -50, 0), (50, -50, 0), (50, 50, 0), (-50, 50, 0)]
        hedge = [(10, 0, -1), (10, 20, -1), (10, 20, 20), (10, 0, 20)]  # the left half of what looks ahead
        triangles = np.array([(0, 1, 2), (0, 2, 3), (4, 5, 6), (4, 6, 7)], np.uint32)
        plants = truth.foliage(np.array([0, 0, 1, 1], np.uint8), ["ground", "plant"])
        np.testing.assert_array_equal(plants, [False, False, True, True])
        view = rig.view(rig.make_rig(64, 36)[0], np.eye(4))
        with core.Scene(np.array(ground + hedge, float), triangles) as scene:
            shown = truth.shows(scene, view, plants)
        self.assertTrue(shown[:16, :31].all())
        self.assertFalse(shown[:, 33:].any())


class Sets(unittest.TestCase):
    def test_whole_set_and_refused_camera(self):
        with tempfile.TemporaryDirectory() as folder:
            counts, data, lines = small_set(folder)
            self.assertEqual(counts["planned"], 0)
            item = data["items"][f"shifts/{rig.shift_name((0, 4, 0))}/0000/CAM_FRONT.exr"]
            self.assertEqual(item["status"], "refused")
            self.assertIn("van", item["reason"])
            self.assertEqual(data["items"][f"truth/{rig.shift_name((0, 4, 0))}/0000/CAM_FRONT.exr"]["status"], "refused")
            self.assertIn("refused: the camera lands in van", lines)
            self.assertEqual(manifest.main(["verify", folder]), 0)
            self.assertEqual(manifest.main(["status", folder]), 0)

            view = exr.read(Path(folder) / f"shifts/{rig.shift_name((0, 1, 0))}/0000/CAM_FRONT.exr")
            self.assertEqual(set(view), {"R", "G", "B", "Z", "truth.class", "truth.source"})
            self.assertGreater(view["G"].mean(), 0.01)
            self.assertTrue(set(np.unique(view["truth.class"])) <= {0.0, 1.0, 2.0, 3.0, 4.0})
            said = exr.read(Path(folder) / f"truth/{rig.shift_name((0, 1, 0))}/0000/CAM_FRONT.exr")
            self.assertEqual(set(said), {"lost", "occluded", "outside", "sky", "shell_self", "shell_rig", "faces_away", "foliage"})
            self.assertEqual(said["foliage"].max(), 0)  # nothing grows in the small street
            np.testing.assert_array_equal(said["lost"], np.maximum(said["occluded"], said["outside"]))
            recorded = exr.read(Path(folder) / "frames/0000/CAM_FRONT.exr")
            np.testing.assert_array_equal(np.isinf(recorded["Z"]), said["sky"] > 0)
            recipe = json.loads((Path(folder) / "set.vshift").read_text())
            self.assertEqual(len(recipe["cameras"]), 6)
            with np.load(Path(folder) / "scene/mesh_0000.npz") as z:
                self.assertEqual(len(z["triangles"]), 12 * len(small_street.BOXES))
                self.assertEqual(len(z["triangle_category"]), len(z["triangles"]))
            self.assertFalse((Path(folder) / ".tmp").exists())

            _, _, again = small_set(folder)
            self.assertIn("0 of ", again)
            with self.assertRaisesRegex(manifest.ManifestError, "render.samples: got 1 in the set, expected 2"):
                set_builder.build_set(set_builder.Options(out=Path(folder), width=64, height=36, samples=2))

    def test_moved_camera_and_rays_only(self):
        with tempfile.TemporaryDirectory() as folder:
            counts, data, _ = small_set(folder, what="rays", on_collision="move", smooth=False)
            self.assertGreater(counts["moved"], 0)
            item = data["items"][f"shifts/{rig.shift_name((0, 4, 0))}/0000/CAM_FRONT.exr"]
            self.assertEqual((item["status"], item["rendered"]), ("done", False))
            # the van's side is at y = 1.25, the ego's lane at -1.75: 3 m less the clearance of 0.3 m
            self.assertAlmostEqual(item["moved_to"][1], 2.7, delta=0.11)
            view = exr.read(Path(folder) / f"shifts/{rig.shift_name((0, 1, 0))}/0000/CAM_FRONT.exr")
            self.assertEqual(set(view), {"Z", "truth.class", "truth.source"})

    def test_recorded_depth_is_what_the_core_sees(self):
        """Also after things have moved while Cycles kept its data."""
        small_street.install()
        street = set_builder.build_street(set_builder.Options(out="."))
        views.configure_for_set(bpy.context.scene, 2)
        before = None
        for t_s in (0.0, 0.5, 1.0):
            small_street.set_time(street, t_s)
            camera = rig.view(rig.make_rig(160, 90)[1], street.ego_pose(0.0))
            v, t, _, _ = mesh_export.world_triangles()
            with core.Scene(v, t) as scene, tempfile.TemporaryDirectory() as temp:
                _, depth = views.render_view(camera, temp)
                ours = scene.cast_camera(camera)["depth"]
                self.assertTrue(truth.clearance(scene, street, camera, t_s, 0.3) is None)
            np.testing.assert_array_equal(np.isinf(depth), np.isinf(ours))
            hit = np.isfinite(ours)
            off = np.abs(depth[hit] - ours[hit]) > 1e-3 * ours[hit]
            self.assertLess(off.mean(), 2e-3)
            if before is not None:
                self.assertGreater((depth != before).mean(), 0.02, "nothing moved")
            before = depth

    def test_real_street(self):
        for name in ("street", "vshift.street_scene"):
            sys.modules.pop(name, None)
        for name in [n for n in sys.modules if n.startswith("street.")]:
            sys.modules.pop(name)
        if hasattr(vshift, "street_scene"):
            del vshift.street_scene
        with tempfile.TemporaryDirectory() as folder:
            options = set_builder.Options(out=Path(folder), detail=0, width=64, height=36, samples=1, shifts=SHIFTS)
            counts = set_builder.build_set(options, progress.Progress({}, io.StringIO()))
            self.assertEqual(counts["planned"], 0)
            with np.load(Path(folder) / "scene/mesh_0000.npz") as z:
                self.assertGreater(len(z["triangles"]), 1000)
                self.assertGreater(len(z["categories"]), 3)


class Proof(unittest.TestCase):
    def test_every_threshold(self):
        small_street.install()
        figures = proof.run(width=400, height=225)
        self.assertEqual(figures["failed"], [], json.dumps({n: figures["checks"][n] for n in figures["failed"]}))
        self.assertEqual(figures["triangles"], figures["triangles_by_generator"])


class Addon(unittest.TestCase):
    def test_operators(self):
        small_street.install()
        vshift.register()
        try:
            self.assertEqual(bpy.ops.vshift.build_street(detail=0), {"FINISHED"})
            self.assertEqual(bpy.ops.vshift.add_rig(width=400, height=225), {"FINISHED"})
            self.assertEqual(bpy.context.scene.camera.name, "CAM_FRONT")
            with tempfile.TemporaryDirectory() as folder:
                self.assertEqual(bpy.ops.vshift.truth(directory=folder, width=64, height=36), {"FINISHED"})
                self.assertEqual(manifest.main(["verify", folder]), 0)
        finally:
            vshift.unregister()
