"""Lamps of the evaluated scene to `core.frame.Light`, and the evaluated copies put out while Cycles renders views."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator

import bpy
import numpy as np

from ..core import radiometry
from ..core.frame import Light, LightKind
from .nodes import node_tree

_AREA_KINDS = {"SQUARE": LightKind.RECTANGLE, "RECTANGLE": LightKind.RECTANGLE, "DISK": LightKind.DISK,
               "ELLIPSE": LightKind.DISK}


def rigid(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The (4, 4) rotation and translation in `matrix`, and its (3,) scales; a mirrored axis becomes a negative x scale."""
    scale = np.linalg.norm(matrix[:3, :3], axis=0)
    out = np.eye(4)
    out[:3, :3] = matrix[:3, :3] / np.where(scale > 0, scale, 1)
    out[:3, 3] = matrix[:3, 3]
    if np.linalg.det(out[:3, :3]) < 0:
        out[:3, 0], scale[0] = -out[:3, 0], -scale[0]
    # shear or a zero axis leaves columns that are not at right angles: keep z, which the lamp shines along
    z = out[:3, 2] / max(np.linalg.norm(out[:3, 2]), 1e-30) if np.any(out[:3, 2]) else np.array([0.0, 0.0, 1.0])
    x = np.cross(out[:3, 1], z)
    if np.linalg.norm(x) < 1e-6:
        x = np.cross([0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [1.0, 0.0, 0.0], z)
    x /= np.linalg.norm(x)
    out[:3, 0], out[:3, 1], out[:3, 2] = x, np.cross(z, x), z
    return out, scale


def _node_factor(lamp: bpy.types.Light) -> np.ndarray:
    """(3,) what a plain Emission node at the lamp's output multiplies; 1 for anything this cannot read."""
    tree = node_tree(lamp)
    output = tree and next((n for n in tree.nodes if n.type == "OUTPUT_LIGHT" and n.is_active_output), None)
    if not output or not output.inputs["Surface"].links:
        return np.ones(3)
    node = output.inputs["Surface"].links[0].from_node
    if node.type != "EMISSION" or node.inputs["Color"].links or node.inputs["Strength"].links:
        return np.ones(3)
    return np.array(node.inputs["Color"].default_value[:3]) * node.inputs["Strength"].default_value


def _strength(lamp: bpy.types.Light) -> np.ndarray:
    """(3,) power by colour in Blender's own unit of the lamp's kind."""
    colour = np.array(lamp.color, np.float64)
    if getattr(lamp, "use_temperature", False):
        colour = colour * np.array(lamp.temperature_color)
    return colour * lamp.energy * 2.0 ** getattr(lamp, "exposure", 0.0) * _node_factor(lamp)


def read_light(instance: bpy.types.DepsgraphObjectInstance, origin_ws: np.ndarray) -> Light | None:
    """The lamp of one evaluated instance in SI units; None for one that gives no light or is a portal."""
    source = instance.object
    lamp = source.data
    strength = _strength(lamp)
    if not np.isfinite(strength).all() or not (strength > 0).any():
        return None
    matrix, scale = rigid(np.array(instance.matrix_world, np.float64))
    matrix[:3, 3] -= origin_ws
    normalize = getattr(lamp, "normalize", True)
    common = {"name": source.name, "world_from_light": matrix, "casts_shadow": lamp.use_shadow,
              "diffuse_factor": float(source.visible_diffuse), "glossy_factor": float(source.visible_glossy)}
    if lamp.type == "SUN":
        unit = radiometry.sun_irradiance(1.0, lamp.angle, normalize)
        return Light(kind=LightKind.SUN, power=strength * unit, angle_rad=lamp.angle, **common)
    if lamp.type == "AREA":
        if lamp.cycles.is_portal:
            return None
        size_x = abs(scale[0]) * lamp.size
        size_y = abs(scale[1]) * (lamp.size_y if lamp.shape in {"RECTANGLE", "ELLIPSE"} else lamp.size)
        area = radiometry.area_of(_AREA_KINDS[lamp.shape], size_x, size_y)
        if area <= 0:
            return None
        unit = radiometry.area_radiance(1.0, area, normalize)
        return Light(kind=_AREA_KINDS[lamp.shape], power=strength * unit, size_x_m=size_x, size_y_m=size_y,
                     spread_rad=lamp.spread, **common)
    unit = radiometry.point_intensity(1.0, lamp.shadow_soft_size, normalize)
    common["is_sphere"] = not lamp.use_soft_falloff
    if lamp.type == "SPOT":
        return Light(kind=LightKind.SPOT, power=strength * unit, radius_m=lamp.shadow_soft_size,
                     spot_size_rad=min(lamp.spot_size, math.pi - 1e-4), spot_blend=lamp.spot_blend, **common)
    return Light(kind=LightKind.POINT, power=strength * unit, radius_m=lamp.shadow_soft_size, **common)


def read_lights(depsgraph: bpy.types.Depsgraph, origin_ws: np.ndarray) -> tuple[Light, ...]:
    """Every lamp that shines in the evaluated scene, instances included."""
    lights = (read_light(i, origin_ws) for i in depsgraph.object_instances if i.object.type == "LIGHT")
    return tuple(light for light in lights if light is not None)


@contextlib.contextmanager
def lights_out(depsgraph: bpy.types.Depsgraph) -> Iterator[None]:
    """Evaluated lamps, world light and mesh lights off, so that Cycles shades no light in a view: a G-buffer needs none.

    Only evaluated copies are written, and each gets its value back. What is seen of the world and of emission stays.
    """
    saved = []

    def put(owner: object, name: str, value: object) -> None:
        saved.append((owner, name, getattr(owner, name)))
        setattr(owner, name, value)

    try:
        for datablock in depsgraph.ids:
            if isinstance(datablock, bpy.types.Light):
                put(datablock, "energy", 0.0)
            elif isinstance(datablock, bpy.types.World):
                put(datablock.cycles, "sampling_method", "NONE")
                for ray in ("diffuse", "glossy", "transmission", "scatter"):
                    put(datablock.cycles_visibility, ray, False)
            elif isinstance(datablock, bpy.types.Material):
                put(datablock.cycles, "emission_sampling", "NONE")
        yield
    finally:
        for owner, name, value in reversed(saved):
            setattr(owner, name, value)
