# SPDX-License-Identifier: GPL-3.0-or-later
"""Puts a generated street (scenes/street) into Blender: meshes, materials, light, look.

    build(street)            # into the current scene
    set_time(street, t_s)    # moves the cars and people

Works on Blender 3.4, 4.3 and 5.2. Meshes are shared between instances; there are
no modifiers, so what is rendered is what the street's parts say.
"""
import importlib
import math

import bpy
import numpy as np
from mathutils import Matrix

from . import street_materials
from .street_nodes import Graph

# Direction to the sun in the world frame: behind the ego and a little left, so
# that the right fronts lie in the light and the left ones in open shade.
SUN_DIRECTION = (-0.62, 0.36, 0.58)
SUN_STRENGTH, SUN_COLOUR, SUN_ANGLE_RAD = 6.2, (1.0, 0.89, 0.73), 0.020
SKY_STRENGTH = 1.50            # as light; cameras and mirrors see SEEN_SKY of it
SEEN_SKY = 0.66


def build(street, scene=None):
    """Makes every object of the street, its materials, sun, sky and render look."""
    scene = scene or bpy.context.scene
    library = importlib.import_module(type(street).__module__.rpartition(".")[0])
    images = _images(street, library.__name__)
    collection = bpy.data.collections.new("street")
    scene.collection.children.link(collection)
    materials, meshes = {}, {}
    for number, i in enumerate(street.instances):
        key = tuple(i.parts)
        if key not in meshes:
            meshes[key] = _mesh(street, key, i.name, materials, images)
        o = bpy.data.objects.new(i.name, meshes[key])
        o.color = tuple(i.colour or (0.5, 0.5, 0.5)) + (1.0,)
        o["category"] = i.category
        o["mover"] = i.mover or ""
        o["instance"] = number
        o.matrix_world = Matrix(i.matrix.tolist())
        collection.objects.link(o)
    _light(scene, collection)
    look(scene)
    street.blender_collection = collection.name
    set_time(street, 0.0)


def set_time(street, t_s):
    """Moves the objects of moving things to where they are at t_s; build(street) must have run."""
    poses = {k: m.world_from_mover(t_s) for k, m in street.movers.items()}
    for o in bpy.data.collections[street.blender_collection].objects:
        if o.get("mover"):
            i = street.instances[o["instance"]]
            o.matrix_world = Matrix((poses[i.mover] @ i.matrix).tolist())


# ------------------------------------------------------------------ meshes
def _mesh(street, key, name, materials, images):
    """One mesh of several parts, a material slot each."""
    parts = [street.parts[k] for k in key]
    me = bpy.data.meshes.new(name)
    offset, vertices, corners, totals, slots, smooth, uvs = 0, [], [], [], [], [], []
    for slot, p in enumerate(parts):
        if p.material not in materials:
            materials[p.material] = street_materials.make(p.material, images)
        me.materials.append(materials[p.material])
        f = p.faces
        flat = f.ravel()
        flat = flat[flat >= 0]
        vertices.append(p.vertices)
        corners.append(flat + offset)
        totals.append(np.where(f[:, 3] >= 0, 4, 3))
        slots.append(np.full(len(f), slot))
        smooth.append(np.full(len(f), p.smooth))
        uvs.append((p.uv if p.uv is not None else np.zeros((len(p.vertices), 2), np.float32))[flat])
        offset += len(p.vertices)
    v, c, n = np.concatenate(vertices), np.concatenate(corners), np.concatenate(totals)
    me.vertices.add(len(v))
    me.vertices.foreach_set("co", np.ascontiguousarray(v, np.float32).ravel())
    me.loops.add(len(c))
    me.loops.foreach_set("vertex_index", c.astype(np.int32))
    me.polygons.add(len(n))
    me.polygons.foreach_set("loop_start", np.concatenate([[0], np.cumsum(n)[:-1]]).astype(np.int32))
    if bpy.app.version < (4, 1):
        me.polygons.foreach_set("loop_total", n.astype(np.int32))
    me.polygons.foreach_set("material_index", np.concatenate(slots).astype(np.int32))
    me.polygons.foreach_set("use_smooth", np.concatenate(smooth))
    if any(p.uv is not None for p in parts):
        me.uv_layers.new(name="UVMap", do_init=False).data.foreach_set("uv", np.concatenate(uvs).astype(np.float32).ravel())
    me.update(calc_edges=True)
    return me


# ------------------------------------------------------------------ images
def _image(name, pixels, srgb):
    """A packed image from (H, W, 4) floats, row 0 at the bottom."""
    h, w = pixels.shape[:2]
    im = bpy.data.images.new(name, w, h, alpha=True, float_buffer=not srgb)
    im.colorspace_settings.name = "sRGB" if srgb else "Non-Color"
    im.alpha_mode = "CHANNEL_PACKED"
    im.pixels.foreach_set(np.ascontiguousarray(pixels, np.float32).ravel())
    im.update()
    im.pack()
    return im


def _images(street, library):
    signs = importlib.import_module(library + ".signs")
    paint = importlib.import_module(library + ".paint")
    atlas = signs.paint_atlas(street.seed)[::-1]
    atlas = np.concatenate([atlas, np.ones(atlas.shape[:2] + (1,), np.float32)], 2)
    road = [(_image("road_paint%d" % k, m.paint, False), _image("road_wear%d" % k, m.wear, False), (m.x0, m.y0, m.x1, m.y1))
            for k, m in enumerate(paint.road_maps(street))]
    return {"atlas": _image("street_signs", atlas, True), "road": road}


# ------------------------------------------------------------------ light and look
def _light(scene, collection):
    sun = bpy.data.lights.new("sun", "SUN")
    sun.energy, sun.color, sun.angle = SUN_STRENGTH, SUN_COLOUR, SUN_ANGLE_RAD
    o = bpy.data.objects.new("sun", sun)
    x, y, z = SUN_DIRECTION
    o.rotation_euler = (math.atan2(math.hypot(x, y), z), 0.0, math.atan2(y, x) + math.pi / 2)
    collection.objects.link(o)
    world = bpy.data.worlds.new("street_sky")
    scene.world = world
    world.use_nodes = True
    g = Graph(world.node_tree)
    d = g.node("ShaderNodeTexCoord").outputs["Generated"]
    x, y, z = g.xyz(d)
    # A gradient of our own: the same on every Blender, and smooth enough for few samples.
    h = g.ramp(z, 0.0, 0.9)
    k = g.math("POWER", h, 0.45)
    sky = g.mix(k, (0.78, 0.83, 0.88), (0.15, 0.36, 0.80))
    glow = g.ramp(_dot(g, d, SUN_DIRECTION), 0.2, 1.0)
    sky = g.mix(g.mul(glow, .35), sky, (1.0, 0.90, 0.74))
    # Clouds on a flat layer above; only cameras and mirrors see them, diffuse light stays smooth.
    up = g.math("MAXIMUM", z, 0.03)
    flat = g.vector(g.math("DIVIDE", x, g.add(up, .12)), g.math("DIVIDE", y, g.add(up, .12)), 0.0)
    n = g.noise(flat, 0.85, 5, .55)
    cover = g.mul(g.ramp(n, .47, .68), g.ramp(z, .02, .14))
    shade = g.mix(g.ramp(n, .55, .80), (.93, .93, .94), (.74, .77, .82))
    clouds = g.mix(g.mul(cover, .80), sky, shade)
    path = g.node("ShaderNodeLightPath")
    seen = g.math("MAXIMUM", path.outputs["Is Camera Ray"], path.outputs["Is Glossy Ray"])
    colour = g.mix(seen, sky, g.scale(clouds, SEEN_SKY))
    ground = g.math("LESS_THAN", z, -0.002)
    colour = g.mix(ground, colour, (.12, .115, .11))
    b = g.node("ShaderNodeBackground", {"Color": colour, "Strength": SKY_STRENGTH})
    out = g.node("ShaderNodeOutputWorld")
    g.tree.links.new(b.outputs[0], out.inputs["Surface"])
    if hasattr(world, "cycles"):
        world.cycles.sampling_method = "MANUAL"
        world.cycles.sample_map_resolution = 256


def _dot(g, a, b):
    n = g.node("ShaderNodeVectorMath", operation="DOT_PRODUCT")
    g.plug(n.inputs[0], a)
    l = math.sqrt(sum(v * v for v in b))
    g.plug(n.inputs[1], tuple(v / l for v in b))
    return n.outputs["Value"]


def look(scene):
    """Render settings of the look, the same for every camera: few bounces, clamped, no caustics, no tone curve."""
    scene.render.engine = "CYCLES"
    c = scene.cycles
    c.device = "CPU"
    c.max_bounces, c.diffuse_bounces, c.glossy_bounces, c.transmission_bounces, c.volume_bounces = 5, 3, 2, 0, 0
    c.caustics_reflective = c.caustics_refractive = False
    c.sample_clamp_indirect, c.sample_clamp_direct = 3.0, 0.0
    c.blur_glossy = 1.0
    c.use_denoising = False
    c.use_adaptive_sampling = False
    scene.render.use_motion_blur = False
    scene.render.dither_intensity = 0.0
    v = scene.view_settings
    v.view_transform = "Standard"
    v.look = "None"
    v.exposure, v.gamma = 0.06, 1.0
