"""Values of shader node trees, computed with numpy at many surface points at once or, without points, as means.

`NodeReader` walks a tree backwards from a socket, as Cycles does. It knows the nodes that decide a surface's colour in
most scenes; what it does not know gives the value typed into the socket that the link hides. Everything it read is in
`trace`, so two readings with equal traces give equal results.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Protocol

import bpy
import numpy as np

from .images import ImageCache

# share of each channel in a colour's grey: Rec.709, Blender's default working space
_LUMA = np.array([0.2126, 0.7152, 0.0722], np.float32)


def _bell(width: float) -> Callable[[np.ndarray], np.ndarray]:
    """Quantiles of a logistic distribution around 1/2, as sums of octaves have nearly; `width` is the standard deviation."""
    return lambda u: np.clip(0.5 + width * math.sqrt(3) / math.pi * np.log(u / (1 - u)), 0, 1)


# procedural textures whose pattern is not computed: the share u of a surface is below this value; their mean is near 1/2
_PATTERNS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "TEX_NOISE": _bell(0.08), "TEX_GABOR": _bell(0.1), "TEX_MAGIC": _bell(0.17),
    "TEX_WAVE": lambda u: 0.5 - 0.5 * np.cos(math.pi * u),                  # a sine
    "TEX_GRADIENT": lambda u: u, "TEX_WHITE_NOISE": lambda u: u,
    "TEX_VORONOI": lambda u: np.cbrt(-0.2 * np.log1p(-u)),          # distance to the nearest of scattered points
}

_COLOURED = {"TEX_NOISE", "TEX_MAGIC", "TEX_WHITE_NOISE", "TEX_VORONOI"}    # their channels vary by themselves

# how a surface acts on the light that bounces, which is what rays and voxels ask for; and what stops light on its way
BOUNCED_PATH = {"Is Diffuse Ray": 1.0, "Is Reflection Ray": 1.0, "Ray Depth": 1.0, "Diffuse Depth": 1.0}
SHADOW_PATH = {"Is Shadow Ray": 1.0}


class Points(Protocol):
    """Surface points, three for each triangle, at which a tree is evaluated."""

    def uv(self, name: str) -> np.ndarray | None:
        """(N, 3) float32 texture coordinates of a layer, "" for the one that renders; None where the mesh has none."""

    def attribute(self, name: str) -> np.ndarray | None:
        """(N, 4) float32 RGBA of a named attribute, "" for the colour that renders; None where the mesh has none."""

    def spread(self, number: int) -> np.ndarray | None:
        """(N, 1) numbers spread evenly over (0, 1) in an order of their own for each `number`: what stands for the places
        of a pattern. None where its mean has to do."""


def spread_evenly(count: int, number: int) -> np.ndarray:
    """(count, 1) float64 middles of even parts of (0, 1), in another order for each `number`: see `Points.spread`."""
    return ((np.random.default_rng(number).permutation(count) + 0.5) / count)[:, None]


def node_tree(datablock: bpy.types.ID) -> bpy.types.NodeTree | None:
    """The tree that shades a material, world or light; None where it is switched off (possible before Blender 5.0)."""
    if bpy.app.version < (5, 0, 0) and not datablock.use_nodes:
        return None
    return datablock.node_tree


def _grey(colour: np.ndarray) -> np.ndarray:
    if colour.shape[1] == 1:
        return colour
    return colour[:, :1] * _LUMA[0] + colour[:, 1:2] * _LUMA[1] + colour[:, 2:] * _LUMA[2]


def _wide(value: np.ndarray) -> np.ndarray:
    return value if value.shape[1] == 3 else np.repeat(value, 3, axis=1)


def _safe_divide(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.where(b != 0, a / np.where(b != 0, b, 1), 0)


def _safe_modulo(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.where(b != 0, np.fmod(a, np.where(b != 0, b, 1)), 0)


def _safe_power(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    with np.errstate(all="ignore"):
        return np.nan_to_num(np.power(a, b), posinf=0.0, neginf=0.0)


_MATH: dict[str, Callable[..., np.ndarray]] = {
    "ADD": lambda a, b, c: a + b, "SUBTRACT": lambda a, b, c: a - b, "MULTIPLY": lambda a, b, c: a * b,
    "DIVIDE": lambda a, b, c: _safe_divide(a, b), "MULTIPLY_ADD": lambda a, b, c: a * b + c,
    "POWER": lambda a, b, c: _safe_power(a, b), "SQRT": lambda a, b, c: np.sqrt(np.maximum(a, 0)),
    "ABSOLUTE": lambda a, b, c: np.abs(a), "MINIMUM": lambda a, b, c: np.minimum(a, b),
    "MAXIMUM": lambda a, b, c: np.maximum(a, b), "LESS_THAN": lambda a, b, c: (a < b).astype(np.float32),
    "GREATER_THAN": lambda a, b, c: (a > b).astype(np.float32), "ROUND": lambda a, b, c: np.floor(a + 0.5),
    "FLOOR": lambda a, b, c: np.floor(a), "CEIL": lambda a, b, c: np.ceil(a), "TRUNC": lambda a, b, c: np.trunc(a),
    "FRACT": lambda a, b, c: a - np.floor(a), "MODULO": lambda a, b, c: _safe_modulo(a, b),
    "SIGN": lambda a, b, c: np.sign(a), "SINE": lambda a, b, c: np.sin(a), "COSINE": lambda a, b, c: np.cos(a),
    "EXPONENT": lambda a, b, c: np.exp(np.minimum(a, 80)),
}

_STEPS = {"LESS_THAN", "GREATER_THAN", "ROUND", "FLOOR", "CEIL", "TRUNC", "FRACT", "MODULO", "SIGN", "POWER"}

_VECTOR_MATH: dict[str, Callable[..., np.ndarray]] = {
    name: _MATH[name] for name in ("ADD", "SUBTRACT", "MULTIPLY", "DIVIDE", "MULTIPLY_ADD", "ABSOLUTE", "MINIMUM", "MAXIMUM",
                                   "FLOOR", "CEIL", "FRACT", "MODULO")}

_BLEND: dict[str, Callable[[np.ndarray, np.ndarray], np.ndarray]] = {
    "MIX": lambda a, b: b, "ADD": lambda a, b: a + b, "SUBTRACT": lambda a, b: a - b, "MULTIPLY": lambda a, b: a * b,
    "DIVIDE": _safe_divide, "SCREEN": lambda a, b: 1 - (1 - a) * (1 - b), "DIFFERENCE": lambda a, b: np.abs(a - b),
    "DARKEN": np.minimum, "LIGHTEN": np.maximum,
    "OVERLAY": lambda a, b: np.where(a < 0.5, 2 * a * b, 1 - 2 * (1 - a) * (1 - b)),
    "LINEAR_LIGHT": lambda a, b: a + 2 * b - 1, "EXCLUSION": lambda a, b: a + b - 2 * a * b,
}


def _rgb_to_hsv(rgb: np.ndarray) -> np.ndarray:
    value, low = rgb.max(1), rgb.min(1)
    span = value - low
    safe = np.where(span > 0, span, 1)
    r, g, b = ((value[:, None] - rgb) / safe[:, None]).T
    hue = np.where(rgb[:, 0] == value, b - g, np.where(rgb[:, 1] == value, 2 + r - b, 4 + g - r)) / 6 % 1
    return np.stack([np.where(span > 0, hue, 0), np.where(value > 0, span / np.where(value > 0, value, 1), 0), value], 1)


def _hsv_to_rgb(hsv: np.ndarray) -> np.ndarray:
    hue, saturation, value = (hsv[:, k:k + 1] for k in range(3))
    ramp = np.clip(np.abs((hue * 6 + np.array([0, 4, 2])) % 6 - 3) - 1, 0, 1)
    return (value * (1 + saturation * (ramp - 1))).astype(np.float32)


def _euler(angles: np.ndarray) -> np.ndarray:
    """(3, 3) rotation about x, then y, then z."""
    (sx, sy, sz), (cx, cy, cz) = np.sin(angles), np.cos(angles)
    return (np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]]) @ np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
            @ np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]]))


class NodeReader:
    """Reads values from one datablock's node tree.

    Values are float32 arrays (1 or N, 1 or 3): a number or a colour or vector, at one or at each of the points.

    Parameters
    ----------
    images : ImageCache
    points : Points or None
        Where the tree is evaluated; None gives means over textures and the typed-in values for attributes.
    light_path : dict
        What the Light Path node says, 0 for what is not in it: BOUNCED_PATH or SHADOW_PATH.

    Attributes
    ----------
    trace : list
        All that the values depend on besides the points.
    needs : set of (kind, name)
        Point data the tree asks for: ("uv", layer) and ("attribute", name).
    is_constant : bool
        False once a texture, an attribute or an unknown node was met.
    is_stepped : bool
        True once a node was met whose mean is not its value at the mean input: thresholds and ramps.
    has_patterns : bool
        True once a procedural texture was met, of which values are known but not where.
    found : set of str
        Node types met, for warnings.
    image_px : (int, int)
        Largest width and height of the images met, as they are sampled.
    """

    def __init__(self, images: ImageCache, points: Points | None = None, light_path: dict[str, float] = BOUNCED_PATH):
        self.images, self.points, self.light_path = images, points, light_path
        self.trace: list[Any] = []
        self.needs: set[tuple[str, str]] = set()
        self.is_constant = True
        self.is_stepped = self.has_patterns = False
        self._patterns = 0
        self.found: set[str] = set()
        self.image_px = (0, 0)
        self._groups: list[bpy.types.Node] = []
        self._known: dict[tuple, np.ndarray | None] = {}

    # sockets and links

    @staticmethod
    def socket(node: bpy.types.Node, identifier: str) -> bpy.types.NodeSocket | None:
        """The input with this identifier; None where this Blender's node has none."""
        for socket in node.inputs:
            if socket.identifier == identifier:
                return socket
        return None

    def scalar(self, node: bpy.types.Node, identifier: str, missing: float = 0.0) -> np.ndarray:
        """(n, 1) value of an input; `missing` where the node has no such input."""
        socket = self.socket(node, identifier)
        return np.full((1, 1), missing, np.float32) if socket is None else _grey(self.read(socket))

    def colour(self, node: bpy.types.Node, identifier: str, missing: float = 0.0) -> np.ndarray:
        """(n, 3) value of an input; `missing` in all channels where the node has no such input."""
        socket = self.socket(node, identifier)
        return np.full((1, 3), missing, np.float32) if socket is None else _wide(self.read(socket))

    def read(self, socket: bpy.types.NodeSocket) -> np.ndarray:
        """(n, 1) or (n, 3) value that arrives at an input socket."""
        value = self.follow(socket, self._output)
        if value is None:
            return self._typed_in(socket)
        if socket.type in {"VALUE", "INT", "BOOLEAN"} and value.shape[1] == 3:
            return _grey(value)
        return value

    def follow(self, socket: bpy.types.NodeSocket, read: Callable[[bpy.types.NodeSocket], Any]) -> Any:
        """`read(output socket)` of what is linked to an input, seen through reroutes, groups and muted nodes.

        None if nothing is linked.
        """
        links = socket.links if socket.is_linked else ()
        if not links or links[0].is_muted or not links[0].is_valid:
            return None
        output = links[0].from_socket
        node = links[0].from_node
        if node.mute:
            inner = [link.from_socket for link in node.internal_links if link.to_socket == output]
            return self.follow(inner[0], read) if inner else None
        if node.type == "REROUTE":
            return self.follow(node.inputs[0], read)
        if node.type == "GROUP":
            inside = node.node_tree.nodes if node.node_tree else ()
            ends = [n for n in inside if n.type == "GROUP_OUTPUT" and n.is_active_output]
            inner = self.socket(ends[0], output.identifier) if ends else None
            if not inner:
                return None
            self._groups.append(node)
            try:
                found = self.follow(inner, read)
                return self._typed_in(inner) if found is None and inner.type != "SHADER" else found
            finally:
                self._groups.pop()
        if node.type == "GROUP_INPUT":
            outer = self._groups.pop()
            try:
                entry = self.socket(outer, output.identifier)
                found = self.follow(entry, read)
                return self._typed_in(entry) if found is None and entry.type != "SHADER" else found
            finally:
                self._groups.append(outer)
        return read(output)

    def _typed_in(self, socket: bpy.types.NodeSocket) -> np.ndarray:
        value = getattr(socket, "default_value", 0.0)
        if isinstance(value, str):
            value = 0.0
        value = tuple(value)[:3] if hasattr(value, "__len__") else (float(value),)
        if len(value) not in (1, 3):
            value = (0.0,)
        self.trace.append(value)
        return np.array([value], np.float32)

    def _output(self, output: bpy.types.NodeSocket) -> np.ndarray | None:
        key = (tuple(n.as_pointer() for n in self._groups), output.as_pointer())
        if key not in self._known:
            node = output.node
            self.found.add(node.type)
            self.trace.append((node.type, output.identifier))
            value = self._node(node, output)
            if value is None:
                self.is_constant = False
                self.trace.append("unknown")
            self._known[key] = None if value is None else np.asarray(value, np.float32)
        return self._known[key]

    def _noted(self, *values: Any) -> None:
        self.trace.append(values)

    # one method for each node type

    def _node(self, node: bpy.types.Node, output: bpy.types.NodeSocket) -> np.ndarray | None:
        """Value of an output, or None for a node that is not known."""
        read = getattr(self, "node_" + node.type.lower(), None)
        if read is not None:
            return read(node, output)
        if node.type in _PATTERNS:
            is_coloured = output.type == "RGBA" and node.type in _COLOURED
            # cells of a Voronoi Texture have any colours
            kind = "TEX_WHITE_NOISE" if is_coloured and node.type == "TEX_VORONOI" else node.type
            return self._pattern(_PATTERNS[kind], 3 if is_coloured else 1)
        return None

    def _pattern(self, quantiles: Callable[[np.ndarray], np.ndarray], channels: int = 1) -> np.ndarray:
        """(n, channels) values of a pattern that has these quantiles; their median without points to spread them over."""
        self.is_constant, self.has_patterns = False, True
        self._patterns += channels
        spread = [None if self.points is None else self.points.spread(self._patterns - k) for k in range(channels)]
        return np.concatenate([quantiles(np.full((1, 1), 0.5) if u is None else u) for u in spread], 1).astype(np.float32)

    def node_rgb(self, node, output):
        return self._typed_in(output)

    def node_value(self, node, output):
        return self._typed_in(output)

    def node_tex_image(self, node, output):
        self.is_constant = False
        image = node.image
        if image is None:
            return None
        self._noted(self.images.key(image), node.extension, node.projection)
        pyramid = self.images.pyramid(image)
        if pyramid is None:
            return None
        self.image_px = (max(self.image_px[0], int(pyramid.widths[0])), max(self.image_px[1], int(pyramid.heights[0])))
        texels = pyramid.mean[None]
        uv = None
        if node.projection == "FLAT":
            uv = self._coordinates(node)
        if uv is not None:
            texels = pyramid.sample(uv[:, :2], node.extension)
        alpha = texels[:, 3:]
        if output.identifier == "Alpha":
            return alpha
        # with the alpha in use Cycles takes it out of the colour again
        if any(s.identifier == "Alpha" and s.is_linked for s in node.outputs) and not pyramid.is_packed:
            return np.where(alpha > 1e-4, texels[:, :3] / np.maximum(alpha, 1e-4), 0)
        return texels[:, :3]

    def _coordinates(self, node: bpy.types.Node) -> np.ndarray | None:
        """(N, 3) points where a texture node is looked up; None where they are not known."""
        socket = self.socket(node, "Vector")
        if socket.is_linked:
            vector = self.follow(socket, self._output)
            return vector if vector is not None and len(vector) > 1 else None
        return self._layer("")

    def _layer(self, name: str) -> np.ndarray | None:
        self.needs.add(("uv", name))
        self.is_constant = False
        return self.points.uv(name) if self.points else None

    def node_uvmap(self, node, output):
        self._noted(node.uv_map)
        return self._layer(node.uv_map)

    def node_tex_coord(self, node, output):
        return self._layer("") if output.identifier == "UV" else None

    def node_mapping(self, node, output):
        self._noted(node.vector_type)
        socket = self.socket(node, "Vector")
        vector = self.follow(socket, self._output) if socket.is_linked else self._typed_in(socket)
        location, angles, scale = (self.colour(node, name).mean(0) for name in ("Location", "Rotation", "Scale"))
        if vector is None:
            return None
        rotation = _euler(angles)
        kind = node.vector_type
        if kind == "TEXTURE":
            return _safe_divide((vector - location) @ rotation, scale[None])
        if kind == "NORMAL":
            vector = _safe_divide(vector, scale[None]) @ rotation.T
            return vector / np.maximum(np.linalg.norm(vector, axis=-1, keepdims=True), 1e-20)
        return (vector * scale) @ rotation.T + (location if kind == "POINT" else 0)

    def node_attribute(self, node, output):
        self._noted(node.attribute_type, node.attribute_name)
        if node.attribute_type != "GEOMETRY":
            return None
        return self._named_attribute(node.attribute_name, output.identifier)

    def node_vertex_color(self, node, output):
        self._noted(node.layer_name)
        return self._named_attribute(node.layer_name, output.identifier)

    def _named_attribute(self, name: str, output: str) -> np.ndarray | None:
        self.is_constant = False
        self.needs.add(("attribute", name))
        rgba = self.points.attribute(name) if self.points else None
        if rgba is None:
            return None
        if output == "Alpha":
            return rgba[:, 3:]
        return _grey(rgba[:, :3]) if output == "Fac" else rgba[:, :3]

    def node_mix(self, node, output):
        self._noted(node.data_type, node.blend_type, node.factor_mode, node.clamp_factor, node.clamp_result)
        kind = {"FLOAT": "Float", "VECTOR": "Vector", "RGBA": "Color"}.get(node.data_type)
        if kind is None:
            return None
        uneven = node.data_type == "VECTOR" and node.factor_mode == "NON_UNIFORM"
        factor = self.colour(node, "Factor_Vector") if uneven else self.scalar(node, "Factor_Float")
        if node.clamp_factor:
            factor = np.clip(factor, 0, 1)
        read = self.scalar if kind == "Float" else self.colour
        blend = node.blend_type if kind == "Color" else "MIX"
        mixed = self._blend(blend, factor, read(node, "A_" + kind), read(node, "B_" + kind))
        return np.clip(mixed, 0, 1) if kind == "Color" and node.clamp_result else mixed

    def node_mix_rgb(self, node, output):
        self._noted(node.blend_type, node.use_clamp)
        mixed = self._blend(node.blend_type, np.clip(self.scalar(node, "Fac"), 0, 1), self.colour(node, "Color1"),
                            self.colour(node, "Color2"))
        return np.clip(mixed, 0, 1) if node.use_clamp else mixed

    @staticmethod
    def _blend(kind: str, factor: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        # the blends that trade hue, saturation and value keep the first colour
        return a + factor * (_BLEND[kind](a, b) - a) if kind in _BLEND else a + 0 * factor

    def node_math(self, node, output):
        self._noted(node.operation, node.use_clamp)
        if node.operation not in _MATH:
            return None
        self.is_stepped |= node.operation in _STEPS
        operands = [_grey(self.read(socket)) for socket in node.inputs]
        operands += [np.zeros((1, 1), np.float32)] * (3 - len(operands))
        value = _MATH[node.operation](*operands)
        return np.clip(value, 0, 1) if node.use_clamp else value

    def node_vect_math(self, node, output):
        self._noted(node.operation)
        a, b, c = (self.colour(node, name) for name in ("Vector", "Vector_001", "Vector_002"))
        if node.operation == "SCALE":
            return a * self.scalar(node, "Scale")
        if node.operation == "DOT_PRODUCT":
            return (a * b).sum(1, keepdims=True)
        if node.operation == "LENGTH":
            return np.linalg.norm(a, axis=1, keepdims=True)
        return _VECTOR_MATH[node.operation](a, b, c) if node.operation in _VECTOR_MATH else None

    def node_separate_color(self, node, output):
        self._noted(node.mode)
        colour = self.colour(node, "Color")
        if node.mode == "HSL":
            return None
        if node.mode == "HSV":
            colour = _rgb_to_hsv(colour)
        k = [socket.identifier for socket in node.outputs].index(output.identifier)
        return colour[:, k:k + 1]

    def node_combine_color(self, node, output):
        self._noted(node.mode)
        parts = np.broadcast_arrays(*(_grey(self.read(socket)) for socket in node.inputs))
        if node.mode == "HSL":
            return None
        colour = np.concatenate(parts, 1)
        return _hsv_to_rgb(colour) if node.mode == "HSV" else colour

    def node_sepxyz(self, node, output):
        k = "XYZ".index(output.identifier)
        return self.colour(node, "Vector")[:, k:k + 1]

    def node_combxyz(self, node, output):
        return np.concatenate(np.broadcast_arrays(*(_grey(self.read(socket)) for socket in node.inputs)), 1)

    def node_hue_sat(self, node, output):
        colour = self.colour(node, "Color")
        hue, saturation, value = (self.scalar(node, name) for name in ("Hue", "Saturation", "Value"))
        hsv = _rgb_to_hsv(colour)
        changed = np.concatenate(np.broadcast_arrays(
            (hsv[:, :1] + hue + 0.5) % 1, np.clip(hsv[:, 1:2] * saturation, 0, 1), hsv[:, 2:] * value), 1)
        return np.maximum(colour + self.scalar(node, "Fac") * (_hsv_to_rgb(changed) - colour), 0)

    def node_gamma(self, node, output):
        colour, gamma = self.colour(node, "Color"), self.scalar(node, "Gamma")
        return np.where(colour > 0, _safe_power(np.maximum(colour, 1e-20), gamma), colour)

    def node_brightcontrast(self, node, output):
        contrast = self.scalar(node, "Contrast")
        return np.maximum((1 + contrast) * self.colour(node, "Color") + self.scalar(node, "Bright") - contrast / 2, 0)

    def node_invert(self, node, output):
        colour = self.colour(node, "Color")
        return colour + self.scalar(node, "Fac") * (1 - 2 * colour)

    def node_curve_rgb(self, node, output):
        # the curves themselves are not followed
        self.is_constant = False
        return self.colour(node, "Color")

    def node_rgbtobw(self, node, output):
        return _grey(self.colour(node, "Color"))

    def node_valtorgb(self, node, output):
        ramp = node.color_ramp
        self.is_stepped = True
        self._noted(ramp.color_mode, ramp.interpolation, ramp.hue_interpolation,
                    tuple((element.position, *element.color) for element in ramp.elements))
        factor = np.clip(self.scalar(node, "Fac"), 0, 1)
        if len(factor) == 1:
            found = np.array([ramp.evaluate(float(factor[0, 0]))], np.float32)
        else:
            table = np.array([ramp.evaluate(k / 256) for k in range(257)], np.float32)
            found = table[np.round(factor[:, 0] * 256).astype(np.int64)]
        return found[:, 3:] if output.identifier == "Alpha" else found[:, :3]

    def node_clamp(self, node, output):
        self._noted(node.clamp_type)
        low, high = self.scalar(node, "Min"), self.scalar(node, "Max")
        if node.clamp_type == "RANGE":
            low, high = np.minimum(low, high), np.maximum(low, high)
        return np.minimum(np.maximum(self.scalar(node, "Value"), low), high)

    def node_map_range(self, node, output):
        self._noted(node.data_type, node.interpolation_type, node.clamp)
        if node.data_type != "FLOAT":
            return None
        value, low, high, to_low, to_high = (self.scalar(node, name)
                                             for name in ("Value", "From Min", "From Max", "To Min", "To Max"))
        t = _safe_divide(value - low, high - low)
        self.is_stepped = True
        kind = node.interpolation_type
        if kind == "STEPPED":
            steps = self.scalar(node, "Steps")
            t = np.where(steps > 0, np.floor(t * (steps + 1)) / np.where(steps > 0, steps, 1), 0)
        elif kind in {"SMOOTHSTEP", "SMOOTHERSTEP"}:
            t = np.clip(t, 0, 1)
            t = t * t * (3 - 2 * t) if kind == "SMOOTHSTEP" else t**3 * (t * (6 * t - 15) + 10)
        if node.clamp:
            t = np.clip(t, 0, 1)
        return to_low + t * (to_high - to_low)

    def node_tex_checker(self, node, output):
        second = self._share(0.5)
        if output.identifier == "Fac":
            return second
        return self.colour(node, "Color1") * second + self.colour(node, "Color2") * (1 - second)

    def _share(self, share: float) -> np.ndarray:
        """(n, 1) of a pattern that is 1 on a share of the surface and 0 elsewhere; the share without points."""
        is_there = self._pattern(lambda u: (u > 1 - share).astype(np.float32))
        return is_there if len(is_there) > 1 else np.full((1, 1), share, np.float32)

    def node_tex_brick(self, node, output):
        mortar, width, height = (max(float(self.scalar(node, name).mean()), 1e-6)
                                 for name in ("Mortar Size", "Brick Width", "Row Height"))
        bare = (1 - min(2 * mortar / width, 1)) * (1 - min(2 * mortar / height, 1))
        between = self._share(1 - bare)
        if output.identifier == "Fac":
            return between
        second = self._share(0.5)
        bricks = self.colour(node, "Color1") * (1 - second) + self.colour(node, "Color2") * second
        return bricks * (1 - between) + self.colour(node, "Mortar") * between

    def node_fresnel(self, node, output):
        self.is_constant = False
        return normal_reflectance(self.scalar(node, "IOR"))

    def node_layer_weight(self, node, output):
        self.is_constant = False
        if output.identifier == "Facing":
            return np.zeros((1, 1), np.float32)
        return normal_reflectance(1 / np.maximum(1 - self.scalar(node, "Blend"), 1e-5))

    def node_light_path(self, node, output):
        self.is_constant = False
        return np.full((1, 1), self.light_path.get(output.identifier, 0.0), np.float32)


def normal_reflectance(ior: np.ndarray) -> np.ndarray:
    """Reflectance of a dielectric at normal incidence: ((n - 1) / (n + 1))^2."""
    return ((ior - 1) / np.maximum(ior + 1, 1e-6)) ** 2
