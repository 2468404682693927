"""Slow float64 forms of the voxel kernels: every surface asked in turn, dense levels, one cone at a time."""

from __future__ import annotations

import numpy as np

from rtgi_addon.kernels.voxels import BOX_STEPS, Voxels

GRAIN = 1 / BOX_STEPS       # boxes are kept in these steps, rounded outwards


def first_hit(voxels: Voxels, origin: np.ndarray, direction: np.ndarray) -> tuple[float, int, int]:
    """(t, row, side) of the nearest voxel surface along a ray in cells: planes, cut by cell, box and mask; (inf, -1, 0)."""
    best = (np.inf, -1, 0)
    for slot in range(3):
        u, v = (slot + 1) % 3, (slot + 2) % 3
        n, offset = voxels.planes[:, slot, :3].astype(np.float64), voxels.planes[:, slot, 3].astype(np.float64)
        local = origin - voxels.cells
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (offset - (n * local).sum(1)) / (n @ direction)
        t = np.where(np.isfinite(t), t, -1.0)
        p = local + t[:, None] * direction
        low, high = voxels.boxes[:, slot, :3] / BOX_STEPS, voxels.boxes[:, slot, 3:] / BOX_STEPS
        inside = ((p >= low - 1e-4) & (p <= high + 1e-4) & (p >= -1e-4) & (p <= 1 + 1e-4)).all(1) & (t > 0)
        inside &= voxels.masks[:, slot] > 0
        square = np.clip(p[:, v] * 4, 0, 3).astype(int) * 4 + np.clip(p[:, u] * 4, 0, 3).astype(int)
        inside &= (voxels.masks[:, slot].astype(int) >> square) & 1 == 1
        if inside.any():
            row = int(np.flatnonzero(inside)[np.argmin(t[inside])])
            if t[row] < best[0]:
                best = float(t[row]), row, 2 * slot + int(n[row] @ direction > 0)
    return best


def irradiance(voxels: Voxels, radiance: np.ndarray, position: np.ndarray, normal: np.ndarray, number: int,
               lift: float) -> np.ndarray:
    """(3,) W/m2 at a point in cells: first hits' radiance over a Fibonacci lattice of directions, even by cosine.

    (A grid of polar angles lines up with walls along the axes: 24x24 directions are wrong by a fifth there.)
    """
    tangent = np.cross(normal, [0.0, 0.0, 1.0] if abs(normal[2]) < 0.9 else [1.0, 0.0, 0.0])
    tangent /= np.linalg.norm(tangent)
    bitangent = np.cross(normal, tangent)
    total = np.zeros(3)
    for k in range(number):
        a, phi = (k + 0.5) / number, k * np.pi * (3 - np.sqrt(5))
        d = np.sqrt(a) * (np.cos(phi) * tangent + np.sin(phi) * bitangent) + np.sqrt(1 - a) * normal
        _, row, side = first_hit(voxels, position + lift * normal, d)
        if row >= 0:
            total += radiance[row, side, :3]
    return np.pi * total / number


def dense_level0(voxels: Voxels, radiance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Coverage (nx, ny, nz, 3) and light (nx, ny, nz, 6, 3) of every cell, light times coverage by side of the viewer."""
    shape = voxels.index.shape
    coverage, light = np.zeros((*shape, 3)), np.zeros((*shape, 6, 3))
    for row, cell in enumerate(map(tuple, voxels.cells)):
        for axis in range(3):
            shares = voxels.seen[row].astype(np.float64) * voxels.planes[row, :, axis]
            total = np.abs(voxels.areas[row].astype(np.float64) * voxels.planes[row, :, axis]).sum()
            for viewer in range(2):
                for slot in range(3):
                    # the viewer on the + side of the axis sees the side whose normal leads there
                    side = 2 * slot + (viewer if shares[slot] >= 0 else 1 - viewer)
                    light[cell][2 * axis + viewer] += abs(shares[slot]) * radiance[row, side, :3] / max(total, 1.0)
            coverage[cell][axis] = min(total, 1.0)
    return coverage, light


def parents(coverage: np.ndarray, light: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The next level: eight children to one, front to back along each axis, mean over the four lines."""
    pad = [(0, n % 2) for n in coverage.shape[:3]]
    coverage, light = np.pad(coverage, [*pad, (0, 0)]), np.pad(light, [*pad, (0, 0), (0, 0)])
    shape = tuple(n // 2 for n in coverage.shape[:3])
    out_coverage, out_light = np.zeros((*shape, 3)), np.zeros((*shape, 6, 3))
    for axis in range(3):
        low = [slice(None)] * 3
        low[axis] = slice(0, None, 2)
        high = list(low)
        high[axis] = slice(1, None, 2)
        a, b = coverage[(*low, axis)], coverage[(*high, axis)]
        both = np.minimum(a + b, 1.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            a_behind = np.where(a > 0, (both - b) / a, 0.0)[..., None]
            b_behind = np.where(b > 0, (both - a) / b, 0.0)[..., None]
        seen = [light[(*high, 2 * axis)] + a_behind * light[(*low, 2 * axis)],
                light[(*low, 2 * axis + 1)] + b_behind * light[(*high, 2 * axis + 1)]]
        out_coverage[..., axis] = _mean_of_four(both, axis)
        for viewer in range(2):
            out_light[..., 2 * axis + viewer, :] = _mean_of_four(seen[viewer], axis)
    return out_coverage, out_light


def _mean_of_four(values: np.ndarray, axis: int) -> np.ndarray:
    """Means over pairs along the two axes other than `axis`."""
    for other in (a for a in range(3) if a != axis):
        even, odd = [slice(None)] * values.ndim, [slice(None)] * values.ndim
        even[other], odd[other] = slice(0, None, 2), slice(1, None, 2)
        values = (values[tuple(even)] + values[tuple(odd)]) / 2
    return values


def cone(levels: list[tuple[np.ndarray, np.ndarray]], origin: np.ndarray, direction: np.ndarray, tangent: float, step: float,
         cells_across: float, thin: float, holds: float) -> np.ndarray:
    """(4,) radiance and visibility of a cone through dense levels: two levels a sample, coverages add up."""
    t, cover, colour = 0.0, 0.0, np.zeros(3)
    reach = 4 * sum(levels[0][0].shape[:3])
    while cover < 1 and t < reach:
        length = step * max(2 * t * tangent / cells_across, 1.0)
        middle = t + length / 2
        wanted = float(np.clip(np.log2(max(2 * middle * tangent / cells_across, 1.0)), 0, len(levels) - 1))
        a, c = 0.0, np.zeros(3)
        for level, share in ((int(wanted), 1 - wanted % 1), (int(wanted) + 1, wanted % 1)):
            if share > 0:
                add, light = _around(*levels[level], (origin + middle * direction) / 2.0**level - 0.5, direction)
                a, c = a + share * length / 2.0**level * add, c + share * length / 2.0**level * light
        if a > 0:
            colour += min(1.0, (1 - cover) / a) * c
            cover = min(cover + a, 1.0)
        t += length
    full = cover if cover <= thin else min(cover + (cover - thin) * (1 - holds) / (holds - thin), 1.0)
    return np.append(colour * (full / cover if cover > 0 else 1.0), 1 - full)


def _around(coverage: np.ndarray, light: np.ndarray, q: np.ndarray, direction: np.ndarray) -> tuple[float, np.ndarray]:
    """Coverage and light of a level along `direction`, interpolated between the eight cells around q."""
    base = np.floor(q).astype(int)
    total, colour = 0.0, np.zeros(3)
    for corner in np.ndindex(2, 2, 2):
        cell = base + corner
        if (cell >= 0).all() and (cell < coverage.shape[:3]).all():
            weight = np.prod(np.where(corner, q - base, 1 - (q - base)))
            for axis in range(3):
                share = weight * abs(direction[axis])
                total += share * coverage[tuple(cell)][axis]
                colour += share * light[tuple(cell)][2 * axis + int(direction[axis] > 0)]
    return total, colour
