"""Texels of a lamp's view that hold more than one surface, as smaller ones.

A texel is known by what the lamp sees through its middle. Where a wall meets a pilaster, or one thing stands before another,
part of its light falls elsewhere: on a surface that may face the very places that the middle's turns away from. Rays of the
lamp through the triangles, one for each quarter, tell where. Colours are those of the neighbouring texel that shows the
same surface.
"""

from __future__ import annotations

import numpy as np

from ..core.frame import GBuffer, LightView
from ..kernels.bvh import Bvh
from ..kernels.texel_parts import look_through_parts
from ..kernels.vec3 import f32
from .screen import PROJECTION_CODES


def split_uneven(view: LightView, is_lit: np.ndarray, size_m: np.ndarray, bvh: Bvh,
                 reach_m: float) -> tuple[np.ndarray, GBuffer, np.ndarray]:
    """(texels that are split (H, W) bool, surfaces of their parts (1, M), texel that each is a part of (M,)).

    Only texels that are `is_lit` (H, W) are split; `size_m` (H, W) float32 is a texel's width where it meets the surface,
    facing the lamp. Each part has `1 / kernels.texel_parts.PARTS` of the texel; those that show nothing are missing.
    `reach_m` leads from the lamp out of the scene.
    """
    g, camera = view.gbuffer, view.camera
    edges = (f32(number) for number in (camera.left, camera.top, *camera.pixel_size))
    is_split, places, normals, depths, like = look_through_parts(
        g.depth, g.position_ws, g.normal_ws, is_lit, size_m, PROJECTION_CODES[camera.projection],
        np.ascontiguousarray(camera.world_from_view[:3], np.float32), *edges, bvh, f32(reach_m))
    part = np.flatnonzero(like.ravel() >= 0)
    texel = like.ravel()[part]
    colours = (values.reshape(g.depth.size, -1)[texel].reshape(1, len(texel), *values.shape[2:])
               for values in (g.albedo, g.specular, g.roughness, g.emission, g.f0))
    surfaces = GBuffer(depths.ravel()[None, part], places.reshape(-1, 3)[None, part], normals.reshape(-1, 3)[None, part],
                       *colours)
    return is_split, surfaces, part // like.shape[2]
