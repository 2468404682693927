"""The scene in voxels: a grid where the frame's light goes, and the surfaces in it, made from the triangles.

`kernels.voxels` tells what a voxel keeps. Here the grid is chosen: a box around what the camera sees and what rays from
there meet, so that a ground plane of ten kilometres does not take the cells away from the chair on it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..core.frame import Frame, Geometry
from ..kernels.pilot import cast_rays
from ..kernels.vec3 import f32
from ..kernels.voxel_levels import flood
from ..kernels.voxel_rays import (
    BRICK,
    HALF_UNIT,
    ROW_WORDS,
    SLOT_WORDS,
    UNIT,
    W_BOX,
    W_MASK,
    W_OFFSET,
    W_OPACITY,
    VoxelWalk,
    fill_bricks,
    fill_clearance,
)
from ..kernels.voxels import (
    BOX_STEPS,
    SUMS,
    Voxels,
    fill_coverage,
    finish_voxels,
    list_cells,
    list_entries,
    slice_spans,
    visit_slices,
)
from .base import Context

PILOT_POINTS, PILOT_RAYS = 2048, 8    # 16384 hits place each border of the box within a few of them
TRIM = 0.005                # share of the points that may lie outside the box at each of its borders
ROOM = 0.05                 # of the box's longest edge, added at each border for what the few pilot rays missed
MARGIN_CELLS = 1.5          # cells around the points: what stands at the box's border lies in the middle of a cell
SEED_CELLS = 1.8            # above a seen surface: a diagonal away, in a cell that its own surface does not occupy
BATCH_ENTRIES = 1 << 23     # pairs of slice and triangle that are listed at a time: 32 MB


@dataclass(frozen=True)
class VoxelScene:
    """Voxels of a frame: the grid, what is in it, and the same for rays."""

    grid: Grid
    voxels: Voxels
    walk: VoxelWalk

    def __len__(self) -> int:
        return len(self.voxels.cells)


@dataclass(frozen=True)
class Grid:
    """Cubic cells over a box: `origin_ws` m is its lowest corner, `shape` the number of cells along x, y, z."""

    origin_ws: tuple[float, float, float]
    cell_m: float
    shape: tuple[int, int, int]

    def to_cells(self, position_ws: np.ndarray) -> np.ndarray:
        """Points (..., 3) m to cells from the lowest corner, float32."""
        return ((position_ws - np.array(self.origin_ws)) / self.cell_m).astype(np.float32)


def grid_around(low_ws: np.ndarray, high_ws: np.ndarray, resolution: int) -> Grid:
    """Grid over a box with at most `resolution` cells along its longest edge; the box's borders lie in cell middles.

    A box without extent becomes one of a few cells of a size that float32 can tell apart there.
    """
    low, high = np.asarray(low_ws, np.float64), np.asarray(high_ws, np.float64)
    longest = float((high - low).max())
    least = 1e-5 * float(max(np.abs(low).max(), np.abs(high).max(), 1e-30))
    cell = max(longest / max(resolution - 2 * MARGIN_CELLS, 1.0), least)
    shape = np.minimum(np.ceil((high - low) / cell - 1e-6).astype(int) + round(2 * MARGIN_CELLS), resolution)
    shape = np.maximum(shape, round(2 * MARGIN_CELLS))
    corner = (low + high) / 2 - shape * cell / 2
    return Grid(tuple(corner.tolist()), float(cell), tuple(shape.tolist()))


def reached_box(frame: Frame, context: Context, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest corner (3,) of what matters to the frame: points seen and what cosine rays from them meet.

    A share of `TRIM` of the points is cut off at each border, some room added, and the box ends where the triangles do.
    """
    g = frame.gbuffer
    low_all, high_all = _finite_bounds(frame.geometry)
    surface = np.flatnonzero(g.mask)
    if not len(surface):
        return low_all, high_all
    chosen = surface[np.linspace(0, len(surface) - 1, min(PILOT_POINTS, len(surface))).astype(np.int64)]
    position, normal = g.position_ws.reshape(-1, 3)[chosen], g.normal_ws.reshape(-1, 3)[chosen]
    rng = np.random.default_rng(seed)
    spread = rng.normal(size=(len(chosen) * PILOT_RAYS, 3))
    spread /= np.linalg.norm(spread, axis=1, keepdims=True)
    start = np.repeat(position, PILOT_RAYS, axis=0)
    # a normal plus a point of the unit sphere has the density of the cosine
    direction = np.ascontiguousarray(np.repeat(normal, PILOT_RAYS, axis=0) + spread, np.float32)
    reach = float(np.linalg.norm(high_all - low_all)) * 2 + 1e-30
    length = np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-6)
    distance, slot, _, _ = cast_rays(start, (direction / length).astype(np.float32), context.bvh(frame.geometry),
                                     f32(1e-4 * frame.scale_m), f32(reach))
    hit = slot >= 0
    points = np.concatenate([position, start[hit] + distance[hit, None] * (direction / length)[hit]])
    low, high = np.quantile(points.astype(np.float64), [TRIM, 1 - TRIM], axis=0)
    room = ROOM * float((high - low).max())
    return np.clip(low - room, low_all, high_all), np.clip(high + room, low_all, high_all)


def _finite_bounds(geometry: Geometry) -> tuple[np.ndarray, np.ndarray]:
    """Bounds (3,) float64 of the triangles whose coordinates are all finite; zeros where there is none."""
    corners = geometry.corners_ws
    finite = np.isfinite(corners).all((1, 2))
    if not finite.any():
        return np.zeros(3), np.zeros(3)
    flat = (corners if finite.all() else corners[finite]).reshape(-1, 3)
    return flat.min(0).astype(np.float64), flat.max(0).astype(np.float64)


def grid_of_frame(frame: Frame, context: Context, resolution: int) -> Grid:
    """The grid of a frame: `resolution` cells along the longest edge of what its light reaches."""
    return grid_around(*reached_box(frame, context), resolution)


def voxelise(geometry: Geometry, grid: Grid) -> Voxels:
    """Surface voxels of the triangles in `grid`.

    Every cell that a triangle meets with some area holds it (conservative and exact); triangles without area, outside the
    grid or with a coordinate that is not finite are left out. Holds exactly: the same bits on any number of threads; a
    quarter turn of triangles and grid about an axis permutes the voxels; so does not the order of the triangles more than
    rounding.
    """
    shape = grid.shape
    corners, origin, rcp_cell = geometry.corners_ws, np.asarray(grid.origin_ws, np.float64), 1.0 / grid.cell_m
    along = int(np.argmax(shape))
    order = np.array([along, *(a for a in range(3) if a != along)])
    present = _opacity(geometry)
    spans = slice_spans(corners, origin, rcp_cell, np.array(shape), along)
    slices = shape[along]
    # slices next to each other are alike, and a thread takes a contiguous run of turns
    turn = np.argsort(np.arange(slices) * 0.6180339887 % 1.0, kind="stable")
    is_occupied = np.zeros(shape, np.bool_)
    index = np.full(shape, -1, np.int32)

    def visit(sums: np.ndarray, extents: np.ndarray, masks: np.ndarray, is_marking: bool) -> None:
        for starts, entries in _batches(spans, slices):
            visit_slices(len(turn), corners, geometry.albedo, geometry.emission, present, origin, rcp_cell, order, starts,
                         entries, turn, is_occupied, index, sums, extents, masks, is_marking)

    visit(np.zeros((0, 3, SUMS), np.float32), np.zeros((0, 3, 6), np.float32), np.zeros((0, 3), np.uint16), True)
    cells = list_cells(is_occupied, index)
    sums, masks = np.zeros((len(cells), 3, SUMS), np.float32), np.zeros((len(cells), 3), np.uint16)
    extents = np.tile(np.float32([1, 1, 1, 0, 0, 0]), (len(cells), 3, 1))
    visit(sums, extents, masks, False)
    planes, albedo, emission = (np.zeros((len(cells), 3, n), np.float32) for n in (4, 3, 3))
    areas, seen, opacity = (np.zeros((len(cells), 3), np.float32) for _ in range(3))
    boxes = np.zeros((len(cells), 3, 6), np.uint8)
    finish_voxels(len(sums), sums, extents, masks, planes, boxes, areas, seen, opacity, albedo, emission)
    return Voxels(index, cells, planes, masks, boxes, areas, seen, opacity, albedo, emission)


def _opacity(geometry: Geometry) -> np.ndarray:
    """(T,) float32: mean opacity of each triangle."""
    out = np.ones(len(geometry), np.float32)
    if geometry.cutouts is not None:
        is_cut = geometry.cutouts.row >= 0
        out[is_cut] = geometry.cutouts.coverage[geometry.cutouts.row[is_cut]]
    return out


def _batches(spans: np.ndarray, slices: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """(starts, entries) of `list_entries` for runs of triangles that together meet at most `BATCH_ENTRIES` slices or so.

    A million triangles that each cross the whole grid would otherwise be listed a hundred million times at once.
    """
    length = np.maximum(spans[:, 1].astype(np.int64) - spans[:, 0] + 1, 0)
    batch = np.cumsum(length) // BATCH_ENTRIES
    edges = [0, *(np.flatnonzero(np.diff(batch)) + 1).tolist(), len(spans)]
    for first, last in zip(edges[:-1], edges[1:], strict=True):
        part, many = spans[first:last], length[first:last] > 0
        count = (np.bincount(part[many, 0], minlength=slices + 1) - np.bincount(part[many, 1] + 1, minlength=slices + 1))
        starts = np.concatenate([[0], np.cumsum(np.cumsum(count)[:slices])]).astype(np.int64)
        yield starts, list_entries(part, first, starts)


def coverage_of(voxels: Voxels) -> np.ndarray:
    """(nx, ny, nz, 3) float32 in [0, 1]: the share of each cell's face that surfaces in it hide, seen along x, y, z.

    A wall that fills a face has 1 along its normal. Coverages of the cells that one surface crosses along an axis add up to
    that of the surface (they are parts of it side by side), so light along the axis is held back by their sum, at most 1.
    """
    out = np.zeros((*voxels.index.shape, 3), np.float32)
    fill_coverage(len(voxels.cells), voxels.cells, voxels.planes, voxels.areas, out)
    return out


def walk_of(voxels: Voxels) -> VoxelWalk:
    """The voxels as rays take them."""
    shape = [-(-n // BRICK) for n in voxels.index.shape]
    bits, first = np.zeros(shape, np.uint64), np.zeros(shape, np.int32)
    fill_bricks(voxels.cells, bits, first)
    fill_clearance(bits, first)
    return VoxelWalk(bits, first, packed_rows(voxels))


def packed_rows(voxels: Voxels) -> np.ndarray:
    """`VoxelWalk.rows` of the voxels."""
    rows = np.zeros((len(voxels.cells), ROW_WORDS), np.int16)
    slots = rows[:, :3 * SLOT_WORDS].reshape(-1, 3, SLOT_WORDS)
    slots[..., :W_OFFSET] = np.rint(voxels.planes[..., :3] * UNIT)
    slots[..., W_OFFSET] = np.rint(voxels.planes[..., 3] * HALF_UNIT)
    slots[..., W_MASK] = voxels.masks.view(np.int16)
    rows[:, W_OPACITY:W_OPACITY + 3] = np.rint(voxels.opacity * BOX_STEPS)
    slots[..., W_BOX:] = (voxels.boxes[..., :3] | voxels.boxes[..., 3:].astype(np.uint16) << 8).view(np.int16)
    return rows


def voxel_scene(geometry: Geometry, grid: Grid) -> VoxelScene:
    """The triangles in `grid`, ready for rays."""
    voxels = voxelise(geometry, grid)
    return VoxelScene(grid, voxels, walk_of(voxels))


def solid_cells(frame: Frame, scene: VoxelScene) -> np.ndarray:
    """(nx, ny, nz) bool: empty cells that surfaces close off from all that the camera sees, from the lamps and from outside.

    The inside of walls and closed bodies. A room is none, even one without a door, if the camera sees into it or a lamp
    stands in it.
    """
    g, blocked = frame.gbuffer, scene.voxels.index >= 0
    seen = g.position_ws[g.mask] + np.float32(SEED_CELLS * scene.grid.cell_m) * g.normal_ws[g.mask]
    lamps = np.array([light.position_ws for light in frame.lights]).reshape(-1, 3)
    seeds = np.concatenate([scene.grid.to_cells(seen), scene.grid.to_cells(lamps), scene.grid.to_cells(
        frame.camera.position_ws[None])])
    seeds = np.floor(np.clip(np.nan_to_num(seeds, nan=-1.0), -1, 1 << 20)).astype(np.int32)
    return ~flood(blocked, np.unique(seeds, axis=0)) & ~blocked
