"""Voxel scenes made by hand, with light put on their sides: what tests of voxel global illumination look at."""

from __future__ import annotations

import numpy as np

from rtgi_addon.kernels.vec3 import f32
from rtgi_addon.kernels.voxel_gather import LOBE_COLUMNS, SIDE_COLUMNS, gather_voxels
from rtgi_addon.kernels.voxels import Voxels
from rtgi_addon.passes.voxel_light import LitVoxels, levels_of
from rtgi_addon.passes.voxel_scene import Grid, VoxelScene, voxel_scene, walk_of
from tests.plane_frames import geometry_of

EXACT = 1e6                 # cells: farther than any grid
BLACK = np.zeros((1, 1, 3), np.float32)


def room(shape: tuple[int, int, int], *meshes: np.ndarray) -> VoxelScene:
    """Triangles, in cells, in a grid of unit cells."""
    return voxel_scene(geometry_of(*meshes), Grid((0.0, 0.0, 0.0), 1.0, shape))


def medium(shape: tuple[int, int, int], low: int, high: int, coverage: float) -> VoxelScene:
    """Layers low <= z < high of voxels that each hide the share `coverage` of their face along z, nothing along x and y."""
    index = np.full(shape, -1, np.int32)
    cells = np.argwhere(np.broadcast_to((np.arange(shape[2]) >= low) & (np.arange(shape[2]) < high), shape)).astype(np.int32)
    index[tuple(cells.T)] = np.arange(len(cells))
    planes, masks = np.zeros((len(cells), 3, 4), np.float32), np.zeros((len(cells), 3), np.uint16)
    planes[:, 2, 2:] = 1.0, 0.5
    masks[:, 2] = 65535
    areas = np.zeros((len(cells), 3), np.float32)
    areas[:, 2] = coverage
    boxes = np.tile(np.uint8([0, 0, 0, 255, 255, 255]), (len(cells), 3, 1))
    colours = np.zeros((len(cells), 3, 3), np.float32)
    voxels = Voxels(index, cells, planes, masks, boxes, areas, areas, np.ones_like(areas), colours, colours)
    return VoxelScene(Grid((0.0, 0.0, 0.0), 1.0, shape), voxels, walk_of(voxels))


def lit(scene: VoxelScene, radiance: float | np.ndarray = 1.0) -> LitVoxels:
    """Every side sends the same radiance, or each its own of (V, 6)."""
    out = np.zeros((len(scene), 6, SIDE_COLUMNS), np.float32)
    out[..., :3] = np.broadcast_to(np.asarray(radiance, np.float32), (len(scene), 6))[..., None]
    return LitVoxels(out, np.zeros((0, LOBE_COLUMNS), np.float32), np.zeros(3), np.zeros(3))


def gathered(scene: VoxelScene, light: LitVoxels, position: np.ndarray, normal: np.ndarray, exact: float = EXACT,
             cones: int = 512, sky: float = 0.0) -> np.ndarray:
    """(M,) irradiance over pi (one colour) at points in cells; `sky` is the radiance of the world."""
    position, normal = np.ascontiguousarray(position, np.float32), np.ascontiguousarray(normal, np.float32)
    out = gather_voxels(position, normal, np.arange(len(position)), scene.walk, scene.voxels.cells, levels_of(scene, light),
                        light.radiance, light.lobes, BLACK + np.float32(sky), np.zeros(0, np.int32), np.zeros(0), cones, 0,
                        f32(exact), 0)
    return out[:, 0] / np.float32(np.pi)
