"""Texels of a lamp's view that hold more than one surface, as four smaller ones each.

A texel is known by what the lamp sees through its middle. Where a wall meets a pilaster, or one thing stands before another,
part of its light falls elsewhere: on a surface that may face the very places that the middle's turns away from. Four rays
of the lamp through the triangles, one for each quarter, tell where. Colours are those of the neighbouring texel that shows
the same surface.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from ..core.frame import GBuffer, LightView
from ..core.transforms import normalized
from ..kernels.bvh import Bvh
from ..kernels.pilot import cast_rays
from ..kernels.vec3 import f32

OFF_PX = 0.5                # distance from a texel's plane, in texels, from which a neighbour shows another surface; 0.25 to
                            # 1 err alike
TURNED = 0.9                # cosine of two normals below which two texels show a crease, where they are
CREASE_PX = 0.1             # so far off one's plane: a bump map turns normals on one plane
BEFORE = 0.5                # of the least depth around: where a quarter's ray starts
UNLIKE_NORMAL, UNLIKE_PLACE = 2.0, 0.1      # beside a texel off its plane: a turn of 60 degrees, ten texels along it
_AROUND = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)]


def _shifted(values: np.ndarray, i: int, j: int) -> np.ndarray:
    """`values` (H, W, ...) at (row + i, column + j); at the edge those of the edge."""
    rows, columns = (np.clip(np.arange(n) + k, 0, n - 1) for n, k in zip(values.shape[:2], (i, j), strict=True))
    return values[rows[:, None], columns]


def is_uneven(g: GBuffer, size_m: np.ndarray) -> np.ndarray:
    """(H, W) bool: texels of a view beside one that shows another surface. `size_m` (H, W): width of a texel there."""
    out, mask = np.zeros(g.shape, np.bool_), g.mask
    for i, j in ((0, 1), (1, 0), (0, -1), (-1, 0)):
        position, normal, is_there = (_shifted(values, i, j) for values in (g.position_ws, g.normal_ws, mask))
        d = position - g.position_ws
        off, off_there = (np.abs(np.einsum("hwc,hwc->hw", d, n)) for n in (g.normal_ws, normal))
        cosine = np.einsum("hwc,hwc->hw", g.normal_ws, normal)
        is_crease = (cosine < TURNED) & (np.maximum(off, off_there) > CREASE_PX * size_m)
        out |= mask & (~is_there | is_crease | (np.minimum(off, off_there) > OFF_PX * size_m))
    return out


def split_texels(view: LightView, is_split: np.ndarray, size_m: np.ndarray, bvh: Bvh,
                 reach_m: float) -> tuple[GBuffer, np.ndarray]:
    """What the quarters of the texels `is_split` (H, W) show: (surfaces (1, M), texel that each is a quarter of (M,)).

    Quarters that show nothing are not among them. `reach_m` leads from the lamp out of the scene.
    """
    g, camera = view.gbuffer, view.camera
    row, column = np.nonzero(is_split)
    # of the view in twice the resolution
    rows = np.concatenate([2 * row + k for k in (0, 0, 1, 1)])
    columns = np.concatenate([2 * column + k for k in (0, 1, 0, 1)])
    fine = dataclasses.replace(camera, width_px=2 * camera.width_px, height_px=2 * camera.height_px)
    origin, direction = (rays[rows, columns] @ camera.world_from_view[:3, :3].T for rays in fine.rays_vs())
    before = np.tile(BEFORE * np.minimum.reduce([_shifted(g.depth, i, j) for i, j in _AROUND])[row, column], 4)
    start = (origin + camera.position_ws + before[:, None] * direction).astype(np.float32)
    direction = direction.astype(np.float32)
    depth, slot, _, _ = cast_rays(start, direction, bvh, f32(0), f32(reach_m))
    met = slot >= 0
    row, column, start, direction, depth = (a[met] for a in (np.tile(row, 4), np.tile(column, 4), start, direction, depth))
    place = start + depth[:, None] * direction
    edges = bvh.corners[slot[met]].reshape(-1, 3, 3)
    face = normalized(np.cross(edges[:, 1], edges[:, 2]))
    face *= np.where(np.einsum("mc,mc->m", face, direction) > 0, np.float32(-1), np.float32(1))[:, None]
    like = _texel_of(g, row, column, place, face, size_m)
    normal = g.normal_ws.reshape(-1, 3)[like]
    normal = np.where((np.einsum("mc,mc->m", face, normal) > TURNED)[:, None], normal, face)
    colours = (values.reshape(g.depth.size, -1)[like].reshape(1, len(like), *values.shape[2:])
               for values in (g.albedo, g.specular, g.roughness, g.emission, g.f0))
    surfaces = GBuffer((before[met] + depth).astype(np.float32)[None], place[None], normal[None], *colours)
    return surfaces, row * g.shape[1] + column


def _texel_of(g: GBuffer, row: np.ndarray, column: np.ndarray, place: np.ndarray, face: np.ndarray,
              size_m: np.ndarray) -> np.ndarray:
    """(M,) flat index of the texel, of the nine around (row, column), that shows most likely the surface at a place."""
    least, like = np.full(len(row), np.inf), row * g.shape[1] + column
    for i, j in _AROUND:
        r, c = np.clip(row + i, 0, g.shape[0] - 1), np.clip(column + j, 0, g.shape[1] - 1)
        d, normal, width = place - g.position_ws[r, c], g.normal_ws[r, c], np.maximum(size_m[r, c], 1e-30)
        unlike = (np.abs(np.einsum("mc,mc->m", d, normal)) + UNLIKE_PLACE * np.sqrt(np.einsum("mc,mc->m", d, d))) / width
        unlike += UNLIKE_NORMAL * (1 - np.einsum("mc,mc->m", face, normal))
        is_better = g.mask[r, c] & (unlike < least)
        least, like = np.where(is_better, unlike, least), np.where(is_better, r * g.shape[1] + c, like)
    return like
