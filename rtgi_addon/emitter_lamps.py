"""Emissive rectangles, disks and balls taken out of a scene's shining triangles and lit with as lamps."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from .core.emitters import Shape, find_shapes
from .core.frame import Geometry, Light, LightKind, Material
from .kernels.bvh import Bvh
from .kernels.pilot import cast_rays
from .kernels.vec3 import f32

RAYS = 64                   # that look out of a side
CLOSE = 0.03                # of its longer edge: what stands nearer before it closes a side
OPEN = 0.05                 # share of the rays that get out of an open side
ROOT = 1.1673039782614187   # whose powers make an even sequence in four dimensions (Roberts 2018)


def part_emitters(geometry: Geometry, materials: Sequence[Material], bvh: Bvh) -> tuple[Geometry, tuple[Light, ...]]:
    """A scene whose shapes that lamps have no longer shine, and lamps for them.

    Parameters
    ----------
    geometry : Geometry
    materials : sequence of Material
        Their names are those of the lamps.
    bvh : Bvh
        Of `geometry`.

    Returns
    -------
    geometry : Geometry
        The same object where there is no such shape.
    lamps : tuple of Light
        Two of a panel that hangs free. A side that lies on a wall, or looks into the body whose face the panel is, lights
        nothing and is none.
    """
    lamps: list[Light] = []
    taken = []
    for number, shape in enumerate(find_shapes(geometry), 1):
        material = int(geometry.material[shape.triangles[0]])
        name = f"{materials[material].name if material < len(materials) else 'surface'}, emitter {number}"
        sides = [shape.lamp(True, name)]
        if shape.kind is not LightKind.POINT:
            sides = [side for side in (*sides, shape.lamp(False, f"{name}, back")) if _is_open(side, shape, geometry, bvh)]
        if sides:
            lamps += sides
            taken.append(shape.triangles)
    if not lamps:
        return geometry, ()
    emission = geometry.emission.copy()
    emission[np.concatenate(taken)] = 0
    return dataclasses.replace(geometry, emission=emission), tuple(lamps)


def _is_open(side: Light, shape: Shape, geometry: Geometry, bvh: Bvh) -> bool:
    """Whether light leaves a side: rays from all over the shape that meet neither something close nor its body."""
    index = np.arange(RAYS)
    x, y, u, v = ((index * ROOT**-k + 0.5) % 1 for k in range(1, 5))
    radius, angle = np.sqrt(u), 2 * math.pi * v
    way = np.stack([radius * np.cos(angle), radius * np.sin(angle), -np.sqrt(1 - u)], 1)
    across = 0.9 * np.stack([(x - 0.5) * shape.size_x_m, (y - 0.5) * shape.size_y_m], 1)
    # the lamp's own place may lie within a wall
    hair_m = 1e-6 * shape.span_m + 4e-7 * float(np.abs(shape.centre_ws).max())
    origin = across @ side.world_from_light[:3, :2].T + shape.centre_ws + hair_m * side.direction_ws
    low, high = geometry.bounds_ws
    reach_m = 2 * float(np.linalg.norm(high - low)) + shape.span_m
    distance, slot, _, _ = cast_rays(origin.astype(np.float32), (way @ side.world_from_light[:3, :3].T).astype(np.float32),
                                     bvh, f32(0), f32(reach_m))
    met = bvh.source[np.maximum(slot, 0)]
    is_close = (slot >= 0) & (distance < CLOSE * shape.span_m)
    is_body = (slot >= 0) & geometry.emission[met].any(1) & (
        geometry.material[met] == geometry.material[shape.triangles[0]])
    # a room whose walls shine has something in it
    return bool(np.mean(~is_close) > OPEN and (~is_close & ~is_body).any())
