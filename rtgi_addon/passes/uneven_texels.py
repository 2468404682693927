"""The triangles that texels of a lamp's view show, and texels that hold more than one surface, as smaller ones.

A texel is known by what the lamp sees through its middle. Where a wall meets a pilaster, or one thing stands before another,
part of its light falls elsewhere: on a surface that may face the very places that the middle's turns away from. Rays of the
lamp through the triangles, one for each quarter, tell where. Colours are those of the neighbouring texel that shows the
same surface.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..core.frame import GBuffer, LightView
from ..kernels.bvh import Bvh
from ..kernels.texel_parts import look_through_texels
from ..kernels.vec3 import f32
from .screen import PROJECTION_CODES


class Texels(NamedTuple):
    """What a lamp's view shows, as its rays find it in the triangles.

    faces_ws (H, W, 3) float32: unit normals of the texels' triangles, on the lamp's side, where light falls; is_split (H, W)
    bool: texels in parts. Of the M parts that show something: surfaces `parts` (1, M), `part_faces_ws` (1, M, 3), and the
    flat index `whole` (M,) of the texel that each is `1 / kernels.texel_parts.PARTS` of.
    """

    faces_ws: np.ndarray
    is_split: np.ndarray
    parts: GBuffer
    part_faces_ws: np.ndarray
    whole: np.ndarray


def look_through(view: LightView, is_lit: np.ndarray, size_m: np.ndarray, bvh: Bvh, reach_m: float) -> Texels:
    """Find the triangles of the texels that are `is_lit` (H, W), and split those that hold more than one surface.

    `size_m` (H, W) float32 is a texel's width where it meets the surface, facing the lamp. `reach_m` leads from the lamp out
    of the scene.
    """
    g, camera = view.gbuffer, view.camera
    edges = (f32(number) for number in (camera.left, camera.top, *camera.pixel_size))
    seen = look_through_texels(g.depth, g.position_ws, g.normal_ws, is_lit, size_m, PROJECTION_CODES[camera.projection],
                               np.ascontiguousarray(camera.world_from_view[:3], np.float32), *edges, bvh, f32(reach_m))
    part = np.flatnonzero(seen.like.ravel() >= 0)
    like = seen.like.ravel()[part]

    def of_parts(values: np.ndarray) -> np.ndarray:
        return values.reshape(-1, *values.shape[3:])[None, part]

    colours = (values.reshape(g.depth.size, -1)[like].reshape(1, len(like), *values.shape[2:])
               for values in (g.albedo, g.specular, g.roughness, g.emission, g.f0))
    parts = GBuffer(of_parts(seen.depths), of_parts(seen.places), of_parts(seen.normals), *colours)
    return Texels(seen.faces, seen.is_split, parts, of_parts(seen.part_faces), part // seen.like.shape[2])
