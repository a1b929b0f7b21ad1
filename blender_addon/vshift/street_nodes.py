# SPDX-License-Identifier: GPL-3.0-or-later
"""A small vocabulary for building shader node trees, the same on Blender 3.4 to 5.2."""
import bpy

# Principled inputs were renamed in 4.0; the first name found is used.
_PRINCIPLED = {
    "color": ("Base Color",), "rough": ("Roughness",), "metal": ("Metallic",),
    "spec": ("Specular IOR Level", "Specular"), "coat": ("Coat Weight", "Clearcoat"),
    "coat_rough": ("Coat Roughness", "Clearcoat Roughness"), "sheen": ("Sheen Weight", "Sheen"),
    "emission": ("Emission Color", "Emission"), "emission_strength": ("Emission Strength",), "normal": ("Normal",),
}


AMBIENT = 0.075


class Graph:
    """Wraps one node tree; sockets and plain numbers can be mixed freely as inputs."""

    def __init__(self, tree):
        self.tree = tree
        tree.nodes.clear()
        self._cache = {}

    def node(self, kind, inputs=(), **props):
        n = self.tree.nodes.new(kind)
        for k, v in props.items():
            setattr(n, k, v)
        for k, v in dict(inputs).items():
            self.plug(n.inputs[k], v)
        return n

    def plug(self, socket, value):
        if isinstance(value, bpy.types.NodeSocket):
            self.tree.links.new(value, socket)
        elif isinstance(value, (tuple, list)):
            v = tuple(value)
            have = len(socket.default_value)
            socket.default_value = v + (1.0,) * (have - len(v)) if have > len(v) else v[:have]
        else:
            socket.default_value = value

    def once(self, key, make):
        if key not in self._cache:
            self._cache[key] = make()
        return self._cache[key]

    # -- numbers
    def math(self, op, a, b=0.0, c=0.0, clamp=False):
        n = self.node("ShaderNodeMath", operation=op, use_clamp=clamp)
        for k, v in enumerate((a, b, c)):
            self.plug(n.inputs[k], v)
        return n.outputs[0]

    def add(self, a, b): return self.math("ADD", a, b)
    def sub(self, a, b): return self.math("SUBTRACT", a, b)
    def mul(self, a, b): return self.math("MULTIPLY", a, b)

    def ramp(self, x, a, b, low=0.0, high=1.0):
        """Linear from (a -> low) to (b -> high), clamped."""
        n = self.node("ShaderNodeMapRange", clamp=True)
        for k, v in enumerate((x, a, b, low, high)):
            self.plug(n.inputs[k], v)
        return n.outputs[0]

    def mix_value(self, f, a, b):
        """Numbers: a where f is 0, b where f is 1."""
        n = self.node("ShaderNodeMix", data_type="FLOAT")
        for k, v in ((0, f), (2, a), (3, b)):
            self.plug(n.inputs[k], v)
        return n.outputs[0]

    def share(self, x, a, b):
        """(x - a) / (b - a), not clamped."""
        return self.mul(self.sub(x, float(a)), 1.0 / float(b - a))

    # -- colours
    def mix(self, f, a, b, how="MIX"):
        n = self.node("ShaderNodeMix", data_type="RGBA", blend_type=how)
        for k, v in ((0, f), (6, a), (7, b)):
            self.plug(n.inputs[k], v)
        return n.outputs[2]

    def scale(self, colour, f):
        """Colour times a number."""
        n = self.node("ShaderNodeVectorMath", operation="SCALE")
        self.plug(n.inputs[0], colour)
        self.plug(n.inputs["Scale"], f)
        return n.outputs[0]

    def split(self, colour):
        n = self.node("ShaderNodeSeparateColor")
        self.plug(n.inputs[0], colour)
        return n.outputs[0], n.outputs[1], n.outputs[2]

    def xyz(self, vector):
        n = self.node("ShaderNodeSeparateXYZ")
        self.plug(n.inputs[0], vector)
        return n.outputs[0], n.outputs[1], n.outputs[2]

    def vector(self, x=0.0, y=0.0, z=0.0):
        n = self.node("ShaderNodeCombineXYZ")
        for k, v in enumerate((x, y, z)):
            self.plug(n.inputs[k], v)
        return n.outputs[0]

    # -- sources
    def position(self): return self.once("geo", lambda: self.node("ShaderNodeNewGeometry")).outputs["Position"]
    def normal(self): return self.once("geo", lambda: self.node("ShaderNodeNewGeometry")).outputs["Normal"]
    def local(self): return self.once("tex", lambda: self.node("ShaderNodeTexCoord")).outputs["Object"]
    def uv(self): return self.once("tex", lambda: self.node("ShaderNodeTexCoord")).outputs["UV"]
    def colour(self): return self.once("obj", lambda: self.node("ShaderNodeObjectInfo")).outputs["Color"]
    def random(self): return self.once("obj", lambda: self.node("ShaderNodeObjectInfo")).outputs["Random"]

    def noise(self, vector, scale, detail=1.0, rough=0.5):
        n = self.node("ShaderNodeTexNoise")
        self.plug(n.inputs["Vector"], vector)
        for k, v in (("Scale", scale), ("Detail", detail), ("Roughness", rough)):
            self.plug(n.inputs[k], v)
        return n.outputs[0]

    def stretched(self, vector, x, y, z):
        n = self.node("ShaderNodeVectorMath", operation="MULTIPLY")
        self.plug(n.inputs[0], vector)
        self.plug(n.inputs[1], (x, y, z))
        return n.outputs[0]

    def offset(self, vector, by):
        n = self.node("ShaderNodeVectorMath", operation="ADD")
        self.plug(n.inputs[0], vector)
        self.plug(n.inputs[1], by)
        return n.outputs[0]

    def white(self, w):
        """A random number per whole number w."""
        n = self.node("ShaderNodeTexWhiteNoise", noise_dimensions="1D")
        self.plug(n.inputs["W"], w)
        return n.outputs[0]

    def brick(self, vector, width, height, joint, a, b, mortar, offset=0.5):
        n = self.node("ShaderNodeTexBrick", offset=offset)
        for k, v in (("Vector", vector), ("Color1", a), ("Color2", b), ("Mortar", mortar), ("Scale", 1.0), ("Mortar Size", joint),
                     ("Mortar Smooth", 0.15), ("Bias", 0.0), ("Brick Width", width), ("Row Height", height)):
            self.plug(n.inputs[k], v)
        return n.outputs[0], n.outputs[1]

    def image(self, image, vector, clip=True):
        n = self.node("ShaderNodeTexImage", image=image, extension="CLIP" if clip else "EXTEND")
        self.plug(n.inputs[0], vector)
        return n.outputs[0], n.outputs[1]

    def bump(self, height, strength, distance):
        n = self.node("ShaderNodeBump")
        for k, v in (("Height", height), ("Strength", strength), ("Distance", distance)):
            self.plug(n.inputs[k], v)
        return n.outputs["Normal"]

    # -- out
    def principled(self, **inputs):
        n = self.node("ShaderNodeBsdfPrincipled")
        # A little light of its own stands for many bounces in the street's shade: no noise, no cost.
        if "emission" not in inputs:
            inputs["emission"], inputs["emission_strength"] = inputs["color"], AMBIENT
        for k, v in inputs.items():
            for name in _PRINCIPLED[k]:
                if name in n.inputs:
                    self.plug(n.inputs[name], v)
                    break
        return n.outputs[0]

    def surface(self, shader):
        n = self.node("ShaderNodeOutputMaterial")
        self.tree.links.new(shader, n.inputs["Surface"])
