# SPDX-License-Identifier: GPL-3.0-or-later
"""vshift: exact occlusion masks and ground truth for novel-view synthesis in driving.

Operators are thin: each calls one plain function of a module beside this file. Modules are imported
when first used, so that `vshift.manifest` and `vshift.rig` also work in a Python without Blender.
"""
bl_info = {
    "name": "vshift",
    "author": "The vshift engineers",
    "version": (0, 1, 0),
    "blender": (3, 4, 0),
    "location": "View3D > Sidebar > vshift",
    "description": "Streets with exact occlusion truth for shifted cameras",
    "category": "Render",
}

try:
    import bpy
except ImportError:
    bpy = None


def _fail(operator, error):
    operator.report({"ERROR"}, str(error))
    return {"CANCELLED"}


def _options(operator, **more):
    from pathlib import Path

    from . import set_builder
    return set_builder.Options(out=Path(bpy.path.abspath(operator.directory or "//vshift_set")), seed=operator.seed,
                               detail=operator.detail, **more)


if bpy is not None:
    from bpy.props import EnumProperty, IntProperty, StringProperty

    class VSHIFT_OT_build_street(bpy.types.Operator):
        """Builds the seeded street in a new scene"""
        bl_idname, bl_label, bl_options = "vshift.build_street", "Build street", {"REGISTER", "UNDO"}
        seed: IntProperty(name="Seed", default=1, min=0)
        detail: IntProperty(name="Detail", default=1, min=0, max=3)
        directory: StringProperty(options={"HIDDEN"})

        def execute(self, context):
            from . import set_builder
            try:
                street = set_builder.build_street(_options(self))
            except Exception as e:  # noqa: BLE001  reported to the user
                return _fail(self, e)
            self.report({"INFO"}, f"street {street.geometry_hash()[:12]}, {street.triangle_count()} triangles")
            return {"FINISHED"}

    class VSHIFT_OT_add_rig(bpy.types.Operator):
        """Adds the six cameras of the rig, the ego's origin at the world's"""
        bl_idname, bl_label, bl_options = "vshift.add_rig", "Add rig", {"REGISTER", "UNDO"}
        width: IntProperty(name="Width", default=1600, min=8, max=16384)
        height: IntProperty(name="Height", default=900, min=8, max=16384)

        def execute(self, context):
            from . import rig
            rig.add_rig(self.width, self.height)
            return {"FINISHED"}

    class _SetOperator:
        seed: IntProperty(name="Seed", default=1, min=0)
        detail: IntProperty(name="Detail", default=1, min=0, max=3)
        directory: StringProperty(name="Folder of the set", subtype="DIR_PATH")
        frames: IntProperty(name="Frames", default=1, min=1)
        width: IntProperty(name="Width", default=400, min=8, max=16384)
        height: IntProperty(name="Height", default=225, min=8, max=16384)
        on_collision: EnumProperty(name="On collision", items=[("refuse", "Refuse", ""), ("move", "Move", "")])

        def build(self, **more):
            from . import set_builder
            try:
                counts = set_builder.build_set(_options(self, frames=self.frames, width=self.width, height=self.height,
                                                        on_collision=self.on_collision, **more))
            except Exception as e:  # noqa: BLE001
                return _fail(self, e)
            self.report({"INFO"}, f"{counts['done']} done, {counts['refused']} refused, {counts['planned']} left")
            return {"FINISHED"}

    class VSHIFT_OT_render_set(bpy.types.Operator, _SetOperator):
        """Renders recorded and shifted views with truth into a folder (long: headless run.py is made for it)"""
        bl_idname, bl_label = "vshift.render_set", "Render set"
        samples: IntProperty(name="Samples", default=8, min=1)

        def execute(self, context):
            return self.build(samples=self.samples, what="all")

    class VSHIFT_OT_truth(bpy.types.Operator, _SetOperator):
        """Writes mesh, depth and truth classes by rays, without rendering"""
        bl_idname, bl_label = "vshift.truth", "Write truth"

        def execute(self, context):
            return self.build(samples=1, smooth=False, what="rays")

    class VSHIFT_PT_panel(bpy.types.Panel):
        bl_label, bl_category, bl_space_type, bl_region_type = "vshift", "vshift", "VIEW_3D", "UI"

        def draw(self, context):
            for name in ("build_street", "add_rig", "render_set", "truth"):
                self.layout.operator(f"vshift.{name}")

    _CLASSES = (VSHIFT_OT_build_street, VSHIFT_OT_add_rig, VSHIFT_OT_render_set, VSHIFT_OT_truth, VSHIFT_PT_panel)


def register():
    for c in _CLASSES:
        bpy.utils.register_class(c)


def unregister():
    for c in reversed(_CLASSES):
        bpy.utils.unregister_class(c)
