"""Lit voxels in levels, eight children to one, and cones that are traced through them.

Every cell of a level keeps its coverage along x, y, z and the light that it sends to a viewer in each of the six directions,
times coverage. Of two cells behind each other the front one hides the back one, and the four lines of a cell's face are
averaged (Crassin et al. 2011, section on directional voxels), so a wall keeps its coverage at every level.

Coverages of cells that a ray crosses add up, to at most 1: they are parts of one surface side by side, not fog. In a wall
that is cut by the grid at any angle the parts along a line add up to exactly one, whatever the level, the step and the place
of the samples; the usual product of (1 - a) would let a quarter of the light through a wall that is cut in two halves.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .jit import borrowed, device_jit, pixel_jit
from .vec3 import ONE, ZERO, along, f32, load
from .voxels import axis_coverage

STEP = f32(0.5)             # of a cell, between the samples of a cone; half of it changes walls by less than 1 %
CELLS_ACROSS = f32(2)       # of a level in a cone's diameter: two interpolated cells have about the spread of a disk
HALF = f32(0.5)
FAR = f32(1e30)
# a wall seen while the cone goes from level to level may add up to HOLDS: what is above THIN is stretched to reach 1 there
THIN, HOLDS = f32(0.4), f32(0.7)


class Levels(NamedTuple):
    """All levels, as kernels take them; level 0 are the voxels, rows of the tables come level after level.

    index (sum of cells,) int32: row of each cell of each level, -1 where it is empty; first (L,) int64: where a
    level's cells begin in it; shape (L, 3) int64: its cells along x, y, z. coverage (N, 3) float32; light (N, 6, 3)
    float32: radiance times coverage towards a viewer on the side +x, -x, +y, ...
    """

    index: np.ndarray
    first: np.ndarray
    shape: np.ndarray
    coverage: np.ndarray
    light: np.ndarray


@pixel_jit
def fill_level0(begin, end, planes, areas, seen, radiance, coverage, light):
    """Coverage (V, 3) and light (V, 6, 3) of the voxels from their slots, in place.

    Light is the flux of the sides, radiance (V, 6, ..) times the area `seen`; coverage is by the true area.
    """
    for row in range(begin, end):
        for axis in range(3):
            coverage[row, axis] = axis_coverage(planes, areas, row, axis)
            total = ZERO
            for slot in range(3):
                share = seen[row, slot] * planes[row, slot, axis]
                total += areas[row, slot] * abs(planes[row, slot, axis])
                for viewer in range(2):
                    side = 2 * slot + (viewer if share >= ZERO else 1 - viewer)
                    for c in range(3):
                        light[row, 2 * axis + viewer, c] += abs(share) * radiance[row, side, c]
            if total > ONE:
                for viewer in range(2):
                    for c in range(3):
                        light[row, 2 * axis + viewer, c] /= total


@device_jit
def mark_parents(children, parents):
    """Set parents (px, py, pz) int32 to 0 where any of the eight cells of `children` below has a row, in place."""
    nx, ny, nz = children.shape
    for x in range(parents.shape[0]):
        for i in range(2 * x, min(2 * x + 2, nx)):
            for j in range(ny):
                for k in range(nz):
                    if children[i, j, k] >= 0:
                        parents[x, j >> 1, k >> 1] = 0


@pixel_jit
def fill_parents(begin, end, cells, children, base, coverage, light):
    """Coverage and light of the cells (P, 3) of a level, rows `base` on, from the level below; in place."""
    nx, ny, nz = children.shape
    rows = np.empty(8, np.int64)
    for number in range(begin, end):
        row = base + number
        for c in range(8):
            x, y, z = 2 * cells[number, 0] + (c & 1), 2 * cells[number, 1] + ((c >> 1) & 1), 2 * cells[number, 2] + (c >> 2)
            rows[c] = children[x, y, z] if x < nx and y < ny and z < nz else -1
        for axis in range(3):
            bit = 1 << axis
            for line in range(8):
                if line & bit:
                    continue
                low, high = rows[line], rows[line | bit]
                cover_low = coverage[low, axis] if low >= 0 else ZERO
                cover_high = coverage[high, axis] if high >= 0 else ZERO
                both = min(cover_low + cover_high, ONE)
                coverage[row, axis] += f32(0.25) * both
                # the viewer on the + side sees the upper cell first
                behind_high = (both - cover_high) / cover_low if cover_low > ZERO else ZERO
                behind_low = (both - cover_low) / cover_high if cover_high > ZERO else ZERO
                for c in range(3):
                    if low >= 0:
                        light[row, 2 * axis, c] += f32(0.25) * behind_high * light[low, 2 * axis, c]
                        light[row, 2 * axis + 1, c] += f32(0.25) * light[low, 2 * axis + 1, c]
                    if high >= 0:
                        light[row, 2 * axis, c] += f32(0.25) * light[high, 2 * axis, c]
                        light[row, 2 * axis + 1, c] += f32(0.25) * behind_low * light[high, 2 * axis + 1, c]


@device_jit
def _sample(levels, level, p, d):
    """(coverage, red, green, blue) per cell of a level that a ray along d meets around p (in cells of level 0)."""
    size = f32(1 << level)
    qx, qy, qz = p.x / size - HALF, p.y / size - HALF, p.z / size - HALF
    x0, y0, z0 = int(math.floor(qx)), int(math.floor(qy)), int(math.floor(qz))
    fx, fy, fz = qx - f32(x0), qy - f32(y0), qz - f32(z0)
    nx, ny, nz = levels.shape[level, 0], levels.shape[level, 1], levels.shape[level, 2]
    wx, wy, wz = abs(d.x), abs(d.y), abs(d.z)
    sx, sy, sz = (1 if d.x > ZERO else 0), 2 + (1 if d.y > ZERO else 0), 4 + (1 if d.z > ZERO else 0)
    cover, red, green, blue = ZERO, ZERO, ZERO, ZERO
    for i in range(2):
        x = x0 + i
        if x < 0 or x >= nx:
            continue
        for j in range(2):
            y = y0 + j
            if y < 0 or y >= ny:
                continue
            for k in range(2):
                z = z0 + k
                if z < 0 or z >= nz:
                    continue
                row = levels.index[levels.first[level] + (x * ny + y) * nz + z]
                if row < 0:
                    continue
                w = (fx if i else ONE - fx) * (fy if j else ONE - fy) * (fz if k else ONE - fz)
                a, b, c = w * wx, w * wy, w * wz
                cover += a * levels.coverage[row, 0] + b * levels.coverage[row, 1] + c * levels.coverage[row, 2]
                red += a * levels.light[row, sx, 0] + b * levels.light[row, sy, 0] + c * levels.light[row, sz, 0]
                green += a * levels.light[row, sx, 1] + b * levels.light[row, sy, 1] + c * levels.light[row, sz, 1]
                blue += a * levels.light[row, sx, 2] + b * levels.light[row, sy, 2] + c * levels.light[row, sz, 2]
    return cover, red, green, blue


@device_jit
def blurred(levels, p, d, width):
    """(coverage, red, green, blue) around p, in cells, that a cone `width` cells across along d reads: from two levels."""
    top, level = levels.shape.shape[0] - 1, 0
    size = max(width / CELLS_ACROSS, ONE)
    while level < top and size >= f32(2 << level):
        level += 1
    upper = min(max(math.log2(size) - f32(level), ZERO), ONE) if level < top else ZERO
    a, r, g, b = _sample(levels, level, p, d)
    if upper > ZERO:
        more, more_r, more_g, more_b = _sample(levels, level + 1, p, d)
        a, r, g, b = a + upper * (more - a), r + upper * (more_r - r), g + upper * (more_g - g), b + upper * (more_b - b)
    return a, r, g, b


@device_jit
def trace_cone(levels, o, d, start, tangent, reach):
    """(red, green, blue, visibility) of a cone from o along the unit vector d, between t = `start` and `reach` in cells.

    `tangent` is that of the half angle. Radiance W/(m2 sr) of what covers the cone; visibility is the share of it that
    nothing covers.
    """
    t, cover, red, green, blue = start, ZERO, ZERO, ZERO, ZERO
    top = levels.shape.shape[0] - 1
    nx, ny, nz = f32(levels.shape[0, 0]), f32(levels.shape[0, 1]), f32(levels.shape[0, 2])
    while t < reach and cover < ONE:
        step = STEP * max(f32(2) / CELLS_ACROSS * t * tangent, ONE)
        at = t + HALF * step
        # the level whose cells are as many across as asked for lies between `level` and the next
        size, level = max(f32(2) / CELLS_ACROSS * at * tangent, ONE), 0
        while level < top and size >= f32(2 << level):
            level += 1
        upper = min(max(math.log2(size) - f32(level), ZERO), ONE) if level < top else ZERO
        p = along(o, d, at)
        if ((p.x < -size and d.x <= ZERO) or (p.y < -size and d.y <= ZERO) or (p.z < -size and d.z <= ZERO)
                or (p.x > nx + size and d.x >= ZERO) or (p.y > ny + size and d.y >= ZERO)
                or (p.z > nz + size and d.z >= ZERO)):
            break
        a, r, g, b = _sample(levels, level, p, d)
        share = (ONE - upper) * step / f32(1 << level)
        a, r, g, b = a * share, r * share, g * share, b * share
        if upper > ZERO:
            more, more_r, more_g, more_b = _sample(levels, level + 1, p, d)
            share = upper * step / f32(2 << level)
            a, r, g, b = a + share * more, r + share * more_r, g + share * more_g, b + share * more_b
        if a > ZERO:
            share = min(ONE, (ONE - cover) / a)
            red, green, blue = red + share * r, green + share * g, blue + share * b
            cover = min(cover + a, ONE)
        t += step
    if cover > THIN:
        full = min(cover + (cover - THIN) * (ONE - HOLDS) / (HOLDS - THIN), ONE)
        red, green, blue, cover = red * full / cover, green * full / cover, blue * full / cover, full
    return red, green, blue, ONE - cover


@pixel_jit
def _cast_cones(begin, end, levels, origin, direction, tangent, out):
    levels, = borrowed((levels,))
    for i in range(begin, end):
        o, d = load(origin, i), load(direction, i)
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = trace_cone(levels, o, d, ZERO, tangent, FAR)


def cast_cones(levels, origin, direction, tangent):
    """(N, 4) float32: `trace_cone` from (N, 3) points, in cells, along (N, 3) unit vectors; tangent of the half angle."""
    out = np.empty((origin.shape[0], 4), np.float32)
    _cast_cones(origin.shape[0], levels, origin, direction, tangent, out)
    return out


@device_jit
def flood(is_blocked, seeds):
    """(nx, ny, nz) bool: cells that six-neighbour steps through open cells reach from the border or from `seeds` (S, 3)."""
    nx, ny, nz = is_blocked.shape
    reached = np.zeros((nx, ny, nz), np.bool_)
    stack = np.empty((nx * ny * nz + 1, 3), np.int32)
    depth = 0
    for i in range(seeds.shape[0]):
        x, y, z = seeds[i, 0], seeds[i, 1], seeds[i, 2]
        if 0 <= x < nx and 0 <= y < ny and 0 <= z < nz and not is_blocked[x, y, z] and not reached[x, y, z]:
            reached[x, y, z] = True
            stack[depth, 0], stack[depth, 1], stack[depth, 2] = x, y, z
            depth += 1
    for x in range(nx):
        for y in range(ny):
            for z in range(nz):
                is_border = x == 0 or y == 0 or z == 0 or x == nx - 1 or y == ny - 1 or z == nz - 1
                if is_border and not is_blocked[x, y, z] and not reached[x, y, z]:
                    reached[x, y, z] = True
                    stack[depth, 0], stack[depth, 1], stack[depth, 2] = x, y, z
                    depth += 1
    while depth > 0:
        depth -= 1
        at_x, at_y, at_z = stack[depth, 0], stack[depth, 1], stack[depth, 2]
        for k in range(6):
            step = 1 if k & 1 else -1
            x, y, z = at_x + (step if k < 2 else 0), at_y + (step if 2 <= k < 4 else 0), at_z + (step if k >= 4 else 0)
            if 0 <= x < nx and 0 <= y < ny and 0 <= z < nz and not is_blocked[x, y, z] and not reached[x, y, z]:
                reached[x, y, z] = True
                stack[depth, 0], stack[depth, 1], stack[depth, 2] = x, y, z
                depth += 1
    return reached
