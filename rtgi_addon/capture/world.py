"""The world's light: read from its nodes where it is even, else captured as a picture of all directions."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

import bpy
import numpy as np

from ..core.transforms import Camera
from .images import ImageCache
from .nodes import NodeReader, node_tree
from .views import full_sphere, world_axes


@dataclass(frozen=True)
class WorldReading:
    """What the nodes of a world tell.

    `kind` "map" has to be captured: its radiance differs by direction, or by something that was not understood.
    `radiance` is (3,) float32 W/(m2 sr) of a "constant" world and zeros otherwise. `warnings` name the world.
    """

    kind: Literal["black", "constant", "map"]
    radiance: np.ndarray = field(default_factory=lambda: np.zeros(3, np.float32))
    warnings: tuple[str, ...] = ()


def _radiance(values: NodeReader, socket: bpy.types.NodeSocket) -> np.ndarray | None:
    """(1, 3) radiance that arrives at a shader socket; None where it is not known. Follows mixes and sums."""

    def read(output: bpy.types.NodeSocket) -> np.ndarray | None:
        node = output.node
        if node.type in {"BACKGROUND", "EMISSION"}:
            strength = values.scalar(node, "Strength")
            # a background of strength 0 is black whatever its colour is made of
            return np.zeros((1, 3), np.float32) if not strength.any() else values.colour(node, "Color") * strength
        if node.type in {"MIX_SHADER", "ADD_SHADER"}:
            parts = [_radiance(values, values.socket(node, name)) for name in ("Shader", "Shader_001")]
            if parts[0] is None or parts[1] is None:
                return None
            if node.type == "ADD_SHADER":
                return parts[0] + parts[1]
            share = np.clip(values.scalar(node, "Fac"), 0, 1)
            return parts[0] * (1 - share) + parts[1] * share
        return None

    if not socket.is_linked:
        return np.zeros((1, 3), np.float32)
    return values.follow(socket, read)


def read_world_constant(depsgraph: bpy.types.Depsgraph) -> WorldReading:
    """What the evaluated scene's world sends from infinity, as far as its nodes tell without looking in each direction."""
    world = depsgraph.scene_eval.world
    if world is None:
        return WorldReading("black")
    tree = node_tree(world)
    if tree is None:
        radiance = np.array(world.color, np.float32)
        return WorldReading("constant", radiance) if radiance.any() else WorldReading("black")
    output = tree.get_output_node("CYCLES")
    if output is None:
        return WorldReading("black")
    inputs = {socket.identifier: socket for socket in output.inputs}
    name, warnings = world.name_full, []
    hidden = [kind for kind in ("diffuse", "glossy") if not getattr(world.cycles_visibility, kind)]
    if hidden:
        warnings.append(f"world {name!r}: its ray visibility is ignored; {' and '.join(hidden)} rays see it")
    if inputs["Volume"].is_linked:
        warnings.append(f"world {name!r}: its volume is left out")
    values = NodeReader(ImageCache())
    radiance = _radiance(values, inputs["Surface"])
    if "LIGHT_PATH" in values.found:
        warnings.append(f"world {name!r}: it differs by the kind of ray; what the camera sees of it lights the scene too")
    if radiance is None or not values.is_constant:
        return WorldReading("map", warnings=tuple(warnings))
    radiance = np.maximum(radiance[0], 0)
    return WorldReading("constant" if radiance.any() else "black", radiance, tuple(warnings))


def sky_suns(world: bpy.types.World | None) -> list[tuple[np.ndarray, float]]:
    """Where Sky Textures of a world show a sun's disc: unit vector, and angular diameter in rad. A map may miss it.

    What a texture's input turns is left out.
    """
    tree = node_tree(world) if world is not None else None
    if tree is None:
        return []
    return [(np.array([math.cos(node.sun_elevation) * math.sin(node.sun_rotation),
                       math.cos(node.sun_elevation) * math.cos(node.sun_rotation), math.sin(node.sun_elevation)]),
             node.sun_size)
            for node in tree.nodes if node.type == "TEX_SKY" and getattr(node, "sun_disc", False)
            and node.sky_type not in {"PREETHAM", "HOSEK_WILKIE"} and not any(socket.is_linked for socket in node.inputs)]


def in_world_axes(radiance: np.ndarray, camera: Camera) -> np.ndarray:
    """A picture of all directions as `core.frame.World` lays it out, (H, W, 3) float32.

    Parameters
    ----------
    radiance : (H, W, 3) float32, row 0 at the top: an equirectangular view of the full sphere.
    camera : Camera
        The view. One that looks along +Y with +Z up is laid out right already and returns `radiance` itself; any other is
        looked up in between its pixels, across the seam.
    """
    height, width = radiance.shape[:2]
    wanted = full_sphere(width, height, world_axes())
    direction_ws = wanted.rays_vs()[1] @ wanted.world_from_view[:3, :3].T
    column, row, _ = camera.project(direction_ws + camera.position_ws)
    columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    if np.allclose(column, columns, atol=1e-6 * width) and np.allclose(row, rows, atol=1e-6 * height):
        return radiance
    x, y = column - 0.5, np.clip(row - 0.5, 0, height - 1)
    left, top = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    share_x, share_y = (x - left)[..., None], (y - top)[..., None]
    below, right = np.minimum(top + 1, height - 1), (left + 1) % width
    left = left % width
    out = ((radiance[top, left] * (1 - share_x) + radiance[top, right] * share_x) * (1 - share_y)
           + (radiance[below, left] * (1 - share_x) + radiance[below, right] * share_x) * share_y)
    return out.astype(np.float32)
