"""Pictures of the voxels: what the camera would see of them, what a wide cone sees, and cuts through the grid.

They are for looking at. Radiance is in W/(m2 sr), as in the picture itself.
"""

from __future__ import annotations

import numpy as np

from ..core.frame import Frame
from ..kernels.vec3 import f32
from ..kernels.voxel_levels import Levels, cast_cones
from ..kernels.voxel_rays import cast_voxel_rays
from .voxel_light import LitVoxels
from .voxel_scene import VoxelScene

CONE_TANGENT = 0.1          # half angle of 6 degrees: a cell of level 3 is as wide as such a cone 80 voxels away
FAR = f32(1e30)


def voxel_pictures(frame: Frame, scene: VoxelScene, lit: LitVoxels, levels: Levels) -> dict[str, np.ndarray]:
    """(H, W, 3) float32 each: "albedo" and "light" of the voxel surface at each pixel; "cones", one through the levels."""
    origin_vs, direction_vs = frame.camera.rays_vs()
    rotation, shape = frame.camera.world_from_view[:3, :3], origin_vs.shape
    origin = scene.grid.to_cells(origin_vs.reshape(-1, 3) @ rotation.T + frame.camera.position_ws)
    direction = direction_vs.reshape(-1, 3) @ rotation.T
    direction = (direction / np.linalg.norm(direction, axis=1, keepdims=True)).astype(np.float32)
    _, row, side = cast_voxel_rays(scene.walk, origin, direction, np.zeros_like(origin), FAR)
    seen = row >= 0
    albedo, light = np.zeros(origin.shape, np.float32), np.zeros(origin.shape, np.float32)
    albedo[seen] = scene.voxels.albedo[row[seen], side[seen] >> 1]
    light[seen] = lit.radiance[row[seen], side[seen], :3]
    cones = cast_cones(levels, origin, direction, f32(CONE_TANGENT))[:, :3]
    return {name: np.ascontiguousarray(image.reshape(shape)) for name, image in
            (("albedo", albedo), ("light", light), ("cones", cones))}


def slice_picture(scene: VoxelScene, lit: LitVoxels, axis: int, at: int) -> np.ndarray:
    """(rows, columns, 3) float32: mean radiance of the six sides of the voxels in layer `at` along `axis`; black if empty.

    Columns go along the next of the axes x, y, z, x, .., rows along the one after it, from the top down.
    """
    index = np.take(scene.voxels.index, at, axis=axis)
    if axis == 1:
        index = index.T                          # (z, x)
    out = np.zeros((*index.shape, 3), np.float32)
    out[index >= 0] = lit.radiance[index[index >= 0], :, :3].mean(1)
    return np.ascontiguousarray(out.transpose(1, 0, 2)[::-1])
