"""A grid of cubic cells: which neighbours see each other, and which cells a point of a surface belongs to.

Between the centres of two neighbouring cells runs a link. It is open unless a triangle crosses it: then every closed
wall, however thin or tilted, parts the centres on its two sides, and no light gets through it from cell to cell. A share of
the cell's face that is covered would not do that: a wall at 45 degrees covers half of each of two faces, one behind the
other, and a quarter of the light would pass.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .bvh import is_occluded
from .jit import device_jit, pixel_jit
from .vec3 import ONE, ZERO, Vec3, along, dot, f32, lifted

HALF, TWO = f32(0.5), f32(2)
EDGE = 1e-9                 # slack of the test whether a line meets a triangle: lines through a common edge meet both
RAMP = f32(4)               # a centre counts in full from a quarter of a cell in front of the surface's plane
IN_FRONT = f32(1e-3)        # cells: a centre nearer to the plane is not in front of it


class LightGrid(NamedTuple):
    """Cells of the edge `cell_m`, the first of them at the corner `low` (3,) float32 m, relative to the frame's origin.

    `links` (3, nx, ny, nz) float32: share of the light that passes from the centre of a cell to that of its next one along
    x, y and z; the last ones lead out of the grid and are 1.
    """

    low: np.ndarray
    cell_m: np.float32
    links: np.ndarray


def open_grid(low_ws: np.ndarray, cell_m: float, shape: tuple[int, int, int]) -> LightGrid:
    """A grid of `shape` (nx, ny, nz) cells in which nothing stands."""
    return LightGrid(np.asarray(low_ws, np.float32), f32(cell_m), np.ones((3, *shape), np.float32))


def close_links(grid: LightGrid, corners_ws: np.ndarray, transmittance: np.ndarray) -> None:
    """In place: let no more than `transmittance` (T,) float32 pass where triangles (T, 3, 3) cross links.

    Of several triangles on one link the least transparent counts. Triangles that are not finite or have no area close
    nothing. The same for every order of the triangles.
    """
    _close_links(3, np.ascontiguousarray(corners_ws, np.float32), np.ascontiguousarray(transmittance, np.float32),
                 grid.low.astype(np.float64), float(grid.cell_m), grid.links)


@device_jit
def _lines(a, b, c, number):
    """First and last line of centres that three coordinates span, as float64: they may be far outside of the grid."""
    return max(0.0, math.ceil(min(a, min(b, c)) - EDGE)), min(number - 1.0, max(a, max(b, c)) + EDGE)


@pixel_jit
def _close_links(begin, end, corners, transmittance, low, cell_m, links):
    for a in range(begin, end):
        u, v = (a + 1) % 3, (a + 2) % 3
        size = (links.shape[1], links.shape[2], links.shape[3])
        at = np.zeros(3, np.int64)
        x, y, z = np.empty(3), np.empty(3), np.empty(3)
        for t in range(corners.shape[0]):
            for c in range(3):                   # in cells, whole numbers at the centres
                x[c] = (corners[t, c, u] - low[u]) / cell_m - 0.5
                y[c] = (corners[t, c, v] - low[v]) / cell_m - 0.5
                z[c] = (corners[t, c, a] - low[a]) / cell_m - 0.5
            area = (x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0])
            if not abs(area) > 0.0 or not abs(area) < 1e300:
                continue
            if max(z[0], z[1], z[2]) < 0.0 or min(z[0], z[1], z[2]) > size[a] - 1.0:
                continue
            first_u, last_u = _lines(x[0], x[1], x[2], size[u])
            first_v, last_v = _lines(y[0], y[1], y[2], size[v])
            if not (first_u <= last_u and first_v <= last_v):
                continue
            for p in range(int(first_u), int(last_u) + 1):
                for q in range(int(first_v), int(last_v) + 1):
                    b0 = ((x[1] - p) * (y[2] - q) - (x[2] - p) * (y[1] - q)) / area
                    b1 = ((x[2] - p) * (y[0] - q) - (x[0] - p) * (y[2] - q)) / area
                    b2 = 1.0 - b0 - b1
                    if b0 < -EDGE or b1 < -EDGE or b2 < -EDGE:
                        continue
                    height = b0 * z[0] + b1 * z[1] + b2 * z[2]
                    if height >= 0.0 and height < size[a] - 1.0:
                        at[a], at[u], at[v] = int(height), p, q
                        links[a, at[0], at[1], at[2]] = min(links[a, at[0], at[1], at[2]], transmittance[t])


@device_jit
def trilinear_weights(q, grid, w):
    """Lowest of the 2x2x2 cells around the place q; w[0:8] gets their shares, those outside the grid 0.

    Corner b lies at the offsets b & 1, b >> 1 & 1, b >> 2 of the lowest cell.
    """
    links, inv = grid.links, ONE / grid.cell_m
    nx, ny, nz = links.shape[1], links.shape[2], links.shape[3]
    x = min(max((q.x - grid.low[0]) * inv - HALF, -TWO), f32(nx + 1))
    y = min(max((q.y - grid.low[1]) * inv - HALF, -TWO), f32(ny + 1))
    z = min(max((q.z - grid.low[2]) * inv - HALF, -TWO), f32(nz + 1))
    i, j, k = int(math.floor(x)), int(math.floor(y)), int(math.floor(z))
    fx, fy, fz = x - f32(i), y - f32(j), z - f32(k)
    for b in range(8):
        s, t, r = b & 1, b >> 1 & 1, b >> 2
        is_inside = 0 <= i + s < nx and 0 <= j + t < ny and 0 <= k + r < nz
        w[b] = (fx if s else ONE - fx) * (fy if t else ONE - fy) * (fz if r else ONE - fz) if is_inside else ZERO
    return i, j, k


@device_jit
def corner_weights(p, n, grid, bvh, stack, offset_m, w):
    """Lowest of the 2x2x2 cells that the surface point p, normal n, belongs to; w[0:8] gets their shares, sum 1 or 0.

    The point is pushed off the surface by half a cell and shared out trilinearly among the centres in front of its plane.
    Where two of these do not see each other some wall stands between them, and a ray to each tells which the point sees;
    a point that sees none of them (clutter smaller than a cell) keeps all. Corners as in `trilinear_weights`; `w` is (16,)
    float32 scratch, `stack` as in `is_occluded`.
    """
    links, inv = grid.links, ONE / grid.cell_m
    i, j, k = trilinear_weights(along(p, n, HALF * grid.cell_m), grid, w)
    total = ZERO
    for b in range(8):
        if w[b] > ZERO:
            front = dot(n, _towards_cell(p, grid, i + (b & 1), j + (b >> 1 & 1), k + (b >> 2))) * inv
            w[b] *= min(ONE, max(ZERO, RAMP * front))
            total += w[b]
    if not total > ZERO:
        return i, j, k
    is_walled = False
    for b in range(8):
        if w[b] > ZERO:
            s, t, r = b & 1, b >> 1 & 1, b >> 2
            is_walled = is_walled or (s == 0 and w[b + 1] > ZERO and links[0, i, j + t, k + r] < HALF)
            is_walled = is_walled or (t == 0 and w[b + 2] > ZERO and links[1, i + s, j, k + r] < HALF)
            is_walled = is_walled or (r == 0 and w[b + 4] > ZERO and links[2, i + s, j + t, k] < HALF)
    if is_walled:
        origin, seen = lifted(p, n, offset_m), ZERO
        for b in range(8):
            w[8 + b] = w[b]
            if w[b] > ZERO:
                centre = _towards_cell(origin, grid, i + (b & 1), j + (b >> 1 & 1), k + (b >> 2))
                if is_occluded(bvh, stack, origin, centre):
                    w[b] = ZERO
            seen += w[b]
        if seen > ZERO:
            total = seen
        else:
            for b in range(8):
                w[b] = w[8 + b]
    for b in range(8):
        w[b] /= total
    return i, j, k


@device_jit
def _towards_cell(p, grid, i, j, k):
    """From p to the centre of a cell."""
    return Vec3(grid.low[0] + (f32(i) + HALF) * grid.cell_m - p.x, grid.low[1] + (f32(j) + HALF) * grid.cell_m - p.y,
                grid.low[2] + (f32(k) + HALF) * grid.cell_m - p.z)


@device_jit
def seen_cells(p, n, grid, bvh, stack, offset_m, seen):
    """Lowest of the 4x4x4 cells around the surface point p, normal n; `seen` (64,) bool tells which of them p shines on.

    Those are the cells whose centres lie in front of the surface. Where two neighbours among them do not see each other,
    rays to the inner 2x2x2 decide, and an outer cell is seen through an open link to an inner one. Cell (s, t, r) of the
    block is entry (s 4 + t) 4 + r.
    """
    links, inv = grid.links, ONE / grid.cell_m
    i = _block_start(p.x, grid.low[0], inv, links.shape[1])
    j = _block_start(p.y, grid.low[1], inv, links.shape[2])
    k = _block_start(p.z, grid.low[2], inv, links.shape[3])
    for b in range(64):
        s, t, r = i + (b >> 4), j + (b >> 2 & 3), k + (b & 3)
        seen[b] = (0 <= s < links.shape[1] and 0 <= t < links.shape[2] and 0 <= r < links.shape[3]
                   and dot(n, _towards_cell(p, grid, s, t, r)) * inv > IN_FRONT)
    is_walled = False
    for b in range(64):
        if seen[b]:
            s, t, r = b >> 4, b >> 2 & 3, b & 3
            is_walled = is_walled or (s < 3 and seen[b + 16 if s < 3 else b] and links[0, i + s, j + t, k + r] < HALF)
            is_walled = is_walled or (t < 3 and seen[b + 4 if t < 3 else b] and links[1, i + s, j + t, k + r] < HALF)
            is_walled = is_walled or (r < 3 and seen[b + 1 if r < 3 else b] and links[2, i + s, j + t, k + r] < HALF)
    if is_walled:
        origin = lifted(p, n, offset_m)
        for ring in range(4):                    # cells with so many coordinates at the border of the block
            for b in range(64):
                s, t, r = b >> 4, b >> 2 & 3, b & 3
                if not seen[b] or _at_border(s) + _at_border(t) + _at_border(r) != ring:
                    continue
                if ring == 0:
                    seen[b] = not is_occluded(bvh, stack, origin, _towards_cell(origin, grid, i + s, j + t, k + r))
                else:
                    seen[b] = ((s == 0 and seen[b + 16] and links[0, i, j + t, k + r] >= HALF)
                               or (s == 3 and seen[b - 16] and links[0, i + 2, j + t, k + r] >= HALF)
                               or (t == 0 and seen[b + 4] and links[1, i + s, j, k + r] >= HALF)
                               or (t == 3 and seen[b - 4] and links[1, i + s, j + 2, k + r] >= HALF)
                               or (r == 0 and seen[b + 1] and links[2, i + s, j + t, k] >= HALF)
                               or (r == 3 and seen[b - 1] and links[2, i + s, j + t, k + 2] >= HALF))
    return i, j, k


@device_jit
def _at_border(s):
    return 1 if s == 0 or s == 3 else 0


@device_jit
def _block_start(x, low, inv, number):
    return int(math.floor(min(max((x - low) * inv - HALF, -TWO), f32(number + 1)))) - 1
