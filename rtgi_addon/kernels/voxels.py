"""Triangles to surface voxels: exact clipping, a plane and a 4x4 mask for each axis, no races.

Every triangle is cut along the planes of the grid (Sutherland and Hodgman 1974), slice by slice, row by row, so that a voxel
holds exactly those triangles that meet it, with the area that lies in it. A slice of the grid belongs to one thread, which
takes the triangles in their order: the same bits come out on any number of threads.

In a voxel, triangles are sorted by the axis that their normal is nearest to, into three slots. A slot keeps the mean plane
of its triangles, their mean albedo and emission, the box around them, and a mask of 4x4 squares that tells which part of the
voxel's face they touch, seen along the axis. A flat wall is therefore kept exactly, wherever it stands in its voxels; two
walls that meet in a voxel keep their own planes and end where they meet; a narrow strip is as wide as it is.

Arithmetic is in float64: a triangle of a ground plane may be a hundred thousand voxels long.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .jit import device_jit, pixel_jit
from .vec3 import f32

MASK_SIDE = 4               # squares of a voxel's face along each edge
FULL = 65535                # a mask with all 16 squares
QUARTER, HALF = f32(1 / MASK_SIDE), f32(0.5)
BOX_STEPS = 255             # steps of a voxel's edge in which the boxes of its slots are kept
MOST_CORNERS = 12           # a triangle cut by six planes has at most nine
NO_AREA = 1e-10             # twice the area over the longest edge squared of a triangle that is a line to float32
LEAST_AREA = 1e-9           # cells squared: what rounding may leave of a triangle that only touches a cell
# columns of the running sums of a slot
S_AREA, S_NORMAL, S_CENTRE, S_ALBEDO, S_EMISSION, S_OPACITY, SUMS = 0, 1, 4, 7, 10, 13, 14


class Voxels(NamedTuple):
    """Voxels that hold surface, as kernels take them; lengths are in cells.

    index (nx, ny, nz) int32: row of the tables below, -1 where the cell is empty.
    cells (V, 3) int32: x, y, z of each voxel, brick by brick (`list_cells`).
    planes (V, 3, 4) float32: by slot, the unit normal (its component along the slot's axis is positive) and the offset
    n . p of the mean plane, p counted from the cell's lowest corner.
    masks (V, 3) uint16: by slot, bit 4 row + column for each of the 4x4 squares that the surfaces touch, seen along
    the slot's axis; columns along the next axis (x, y, z, x, ..), rows along the one after it; 0 for an empty slot.
    boxes (V, 3, 6) uint8: by slot, lowest and highest corner of its surfaces in steps of 1 / BOX_STEPS.
    areas (V, 3) float32: by slot, area of its surfaces in cells squared, surfaces behind each other counted once, holes of
    cut-outs taken off; seen (V, 3) float32: the area that rays meet, which mask and box make a little larger at the edges of
    surfaces; opacity (V, 3) float32 in [0, 1]: by slot, share of its surfaces that is there.
    albedo (V, 3, 3), emission (V, 3, 3) float32: mean of the slot's surfaces, reflectance and W/(m2 sr) of either side.
    """

    index: np.ndarray
    cells: np.ndarray
    planes: np.ndarray
    masks: np.ndarray
    boxes: np.ndarray
    areas: np.ndarray
    seen: np.ndarray
    opacity: np.ndarray
    albedo: np.ndarray
    emission: np.ndarray


@device_jit
def _first_cell(x):
    return int(math.floor(x))


@device_jit
def _last_cell(low, high):
    """Last cell of an interval; one that ends on a border, or lies in it, does not reach into the cell behind."""
    return max(int(math.floor(low)), int(math.ceil(high)) - 1)


@device_jit
def _cut(poly, source, target, count, axis, bound, sign):
    """Part of a convex polygon with sign * coordinate >= sign * bound; returns its number of corners."""
    out = 0
    for i in range(count):
        j = i + 1 if i + 1 < count else 0
        p, q = sign * (poly[source, i, axis] - bound), sign * (poly[source, j, axis] - bound)
        if p >= 0:
            for a in range(3):
                poly[target, out, a] = poly[source, i, a]
            out += 1
        if (p > 0 and q < 0) or (p < 0 and q > 0):
            t = p / (p - q)
            for a in range(3):
                poly[target, out, a] = poly[source, i, a] + t * (poly[source, j, a] - poly[source, i, a])
            poly[target, out, axis] = bound
            out += 1
    return out


@device_jit
def _between(poly, source, target, count, axis, low):
    """Part of polygon `source` with low <= coordinate <= low + 1, to `target`; slot 3 is scratch."""
    count = _cut(poly, source, 3, count, axis, low, 1.0)
    return _cut(poly, 3, target, count, axis, low + 1.0, -1.0)


@device_jit
def _extent(poly, level, count, axis):
    low, high = poly[level, 0, axis], poly[level, 0, axis]
    for i in range(1, count):
        low, high = min(low, poly[level, i, axis]), max(high, poly[level, i, axis])
    return low, high


@device_jit
def _load(corners, t, origin, rcp_cell, poly):
    """Triangle t into level 0 of `poly`, in cells; False if a coordinate is not finite."""
    is_finite = True
    for i in range(3):
        for a in range(3):
            x = (np.float64(corners[t, i, a]) - origin[a]) * rcp_cell
            poly[0, i, a] = x
            is_finite = is_finite and math.isfinite(x)
    return is_finite


@pixel_jit
def _slice_spans(begin, end, corners, origin, rcp_cell, shape, axis, spans):
    poly = np.empty((1, 3, 3), np.float64)
    for t in range(begin, end):
        spans[t, 0], spans[t, 1] = 1, 0
        if not _load(corners, t, origin, rcp_cell, poly):
            continue
        is_inside = True
        for a in range(3):
            low, high = _extent(poly, 0, 3, a)
            is_inside = is_inside and high >= 0 and low < shape[a]
        nx, ny, nz = _area_vector(poly, 0, 1, 2)
        if is_inside and math.sqrt(nx * nx + ny * ny + nz * nz) > NO_AREA * _longest2(poly):
            low, high = _extent(poly, 0, 3, axis)
            low, high = max(low, 0.0), min(high, np.float64(shape[axis]))
            spans[t, 0], spans[t, 1] = _first_cell(low), min(_last_cell(low, high), shape[axis] - 1)


def slice_spans(corners, origin, rcp_cell, shape, axis):
    """(T, 2) int32: first and last slice along `axis` that each triangle meets; first > last for those left out.

    Left out are triangles outside the grid, without area, or with a coordinate that is not finite.
    """
    number = corners.shape[0]
    spans = np.empty((number, 2), np.int32)
    _slice_spans(number, corners, origin, rcp_cell, shape, axis, spans)
    return spans


@device_jit
def list_entries(spans, first, starts):
    """Triangles of each slice, in order: `starts` (n + 1,) is the running count; `first` the number of triangle 0."""
    entries = np.empty(starts[-1], np.int32)
    at = starts[:-1].copy()
    for t in range(spans.shape[0]):
        for s in range(spans[t, 0], spans[t, 1] + 1):
            entries[at[s]] = first + t
            at[s] += 1
    return entries


@device_jit
def _area_vector(poly, level, i, j):
    """Twice the area times the normal of corners 0, i, j."""
    x, y, z = poly[level, 0, 0], poly[level, 0, 1], poly[level, 0, 2]
    ax, ay, az = poly[level, i, 0] - x, poly[level, i, 1] - y, poly[level, i, 2] - z
    bx, by, bz = poly[level, j, 0] - x, poly[level, j, 1] - y, poly[level, j, 2] - z
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@device_jit
def _longest2(poly):
    """Square of the longest edge of the triangle in level 0."""
    longest = 0.0
    for i in range(3):
        j, sum2 = (i + 1) % 3, 0.0
        for a in range(3):
            sum2 += (poly[0, j, a] - poly[0, i, a]) ** 2
        longest = max(longest, sum2)
    return longest


@device_jit
def _mask_of(poly, level, count, u, v, cell_u, cell_v):
    """Squares of the 4x4 raster that a convex polygon touches, seen along the third axis."""
    mask = 0
    for row in range(MASK_SIDE):
        bottom, top = cell_v + row / MASK_SIDE, cell_v + (row + 1) / MASK_SIDE
        low, high = 1e30, -1e30
        for i in range(count):
            j = i + 1 if i + 1 < count else 0
            p, q = poly[level, i, v], poly[level, j, v]
            if max(p, q) < bottom or min(p, q) > top:
                continue
            slope = (poly[level, j, u] - poly[level, i, u]) / (q - p) if p != q else 0.0
            one = poly[level, i, u] + (min(max(p, bottom), top) - p) * slope
            two = poly[level, j, u] + (min(max(q, bottom), top) - q) * slope
            low, high = min(low, min(one, two)), max(high, max(one, two))
        if low <= high:
            first, last = _first_cell((low - cell_u) * MASK_SIDE), _last_cell((low - cell_u) * MASK_SIDE,
                                                                            (high - cell_u) * MASK_SIDE)
            for column in range(max(first, 0), min(last, MASK_SIDE - 1) + 1):
                mask |= 1 << (row * MASK_SIDE + column)
    return mask


@device_jit
def _add_polygon(poly, level, count, albedo, emission, opacity, t, n, axis, cell, row, sums, boxes, masks):
    """Add a polygon inside one cell to slot `axis` of voxel `row`; n (3,) is the unit normal with n[axis] > 0."""
    area = 0.0
    cx, cy, cz = 0.0, 0.0, 0.0
    for i in range(1, count - 1):
        x, y, z = _area_vector(poly, level, i, i + 1)
        part = 0.5 * abs(x * n[0] + y * n[1] + z * n[2])
        area += part
        cx += part * (poly[level, 0, 0] + poly[level, i, 0] + poly[level, i + 1, 0])
        cy += part * (poly[level, 0, 1] + poly[level, i, 1] + poly[level, i + 1, 1])
        cz += part * (poly[level, 0, 2] + poly[level, i, 2] + poly[level, i + 1, 2])
    if not area > LEAST_AREA:
        return
    cx, cy, cz = cx / (3 * area), cy / (3 * area), cz / (3 * area)
    # barycentric coordinates of the centroid, in the plane where the triangle is largest
    u, v = (axis + 1) % 3, (axis + 2) % 3
    cu, cv = (cy, cz) if axis == 0 else ((cz, cx) if axis == 1 else (cx, cy))
    e1u, e1v = poly[0, 1, u] - poly[0, 0, u], poly[0, 1, v] - poly[0, 0, v]
    e2u, e2v = poly[0, 2, u] - poly[0, 0, u], poly[0, 2, v] - poly[0, 0, v]
    du, dv = cu - poly[0, 0, u], cv - poly[0, 0, v]
    rcp = 1.0 / (e1u * e2v - e1v * e2u)
    b1, b2 = min(max((du * e2v - dv * e2u) * rcp, 0.0), 1.0), min(max((e1u * dv - e1v * du) * rcp, 0.0), 1.0)
    b0 = max(1.0 - b1 - b2, 0.0)
    s = sums[row, axis]
    s[S_AREA] += f32(area)
    s[S_OPACITY] += f32(area * opacity[t])
    s[S_CENTRE] += f32(area * (cx - cell[0]))
    s[S_CENTRE + 1] += f32(area * (cy - cell[1]))
    s[S_CENTRE + 2] += f32(area * (cz - cell[2]))
    for a in range(3):
        s[S_NORMAL + a] += f32(area * n[a])
        colour = b0 * albedo[t, 0, a] + b1 * albedo[t, 1, a] + b2 * albedo[t, 2, a]
        s[S_ALBEDO + a] += f32(area * colour)
        s[S_EMISSION + a] += f32(area * emission[t, a])
    for a in range(3):
        low, high = _extent(poly, level, count, a)
        boxes[row, axis, a] = min(boxes[row, axis, a], f32(low - cell[a]))
        boxes[row, axis, a + 3] = max(boxes[row, axis, a + 3], f32(high - cell[a]))
    if masks[row, axis] != FULL:
        masks[row, axis] |= np.uint16(_mask_of(poly, level, count, u, v, np.float64(cell[u]), np.float64(cell[v])))


@pixel_jit
def visit_slices(begin, end, corners, albedo, emission, opacity, origin, rcp_cell, order, starts, entries, turn, is_occupied,
                 index, sums, boxes, masks, is_marking):
    """Cut the listed triangles along the grid: mark the cells that they meet, or add them to the voxels there.

    opacity (T,) float32; order (3,): the axis of the slices, then the two within a slice. `turn` (n,) is the order in which
    slices are taken, spread so that threads share the work. Marking writes `is_occupied` (nx, ny, nz) bool, adding `sums`
    (V, 3, SUMS) and `boxes` (V, 3, 6) float32 and `masks` (V, 3) uint16 by `index`.
    """
    along, across, inner = order[0], order[1], order[2]
    rows, columns = is_occupied.shape[across], is_occupied.shape[inner]
    for k in range(begin, end):
        slice_ = turn[k]
        poly = np.empty((5, MOST_CORNERS, 3), np.float64)
        n, cell = np.empty(3, np.float64), np.empty(3, np.int64)
        cell[along] = slice_
        for e in range(starts[slice_], starts[slice_ + 1]):
            t = entries[e]
            _load(corners, t, origin, rcp_cell, poly)
            x, y, z = _area_vector(poly, 0, 1, 2)
            n[0], n[1], n[2] = x, y, z
            axis = 0 if abs(x) >= max(abs(y), abs(z)) else (1 if abs(y) >= abs(z) else 2)
            size = math.copysign(math.sqrt(x * x + y * y + z * z), n[axis])
            for a in range(3):
                n[a] /= size
            in_slice = _between(poly, 0, 1, 3, along, np.float64(slice_))
            if in_slice == 0:
                continue
            low, high = _extent(poly, 1, in_slice, across)
            for r in range(max(_first_cell(low), 0), min(_last_cell(low, high), rows - 1) + 1):
                cell[across] = r
                in_row = _between(poly, 1, 2, in_slice, across, np.float64(r))
                if in_row == 0:
                    continue
                left, right = _extent(poly, 2, in_row, inner)
                for c in range(max(_first_cell(left), 0), min(_last_cell(left, right), columns - 1) + 1):
                    cell[inner] = c
                    if is_marking:
                        is_occupied[cell[0], cell[1], cell[2]] = True
                        continue
                    in_cell = _between(poly, 2, 4, in_row, inner, np.float64(c))
                    if in_cell >= 3:
                        row = index[cell[0], cell[1], cell[2]]
                        _add_polygon(poly, 4, in_cell, albedo, emission, opacity, t, n, axis, cell, row, sums, boxes, masks)


@device_jit
def list_cells(is_occupied, index):
    """(V, 3) int32 occupied cells, brick by brick of 4x4x4, x fastest in a brick; their rows into `index`, in place.

    A brick's voxels lie together in memory, and a cell's row is its brick's first row plus the occupied cells before it.
    """
    nx, ny, nz = is_occupied.shape
    cells = np.empty((is_occupied.sum(), 3), np.int32)
    row = 0
    for bx in range(0, nx, 4):
        for by in range(0, ny, 4):
            for bz in range(0, nz, 4):
                for z in range(bz, min(bz + 4, nz)):
                    for y in range(by, min(by + 4, ny)):
                        for x in range(bx, min(bx + 4, nx)):
                            if is_occupied[x, y, z]:
                                cells[row, 0], cells[row, 1], cells[row, 2] = x, y, z
                                index[x, y, z] = row
                                row += 1
    return cells


@device_jit
def _touched_share(mask, u0, v0, u1, v1):
    """Area of a mask's squares inside the rectangle from (u0, v0) to (u1, v1), in faces of the voxel."""
    share = f32(0)
    for line in range(MASK_SIDE):
        bottom, top = max(f32(line) * QUARTER, v0), min(f32(line + 1) * QUARTER, v1)
        for column in range(MASK_SIDE):
            if (mask >> (line * MASK_SIDE + column)) & 1:
                left, right = max(f32(column) * QUARTER, u0), min(f32(column + 1) * QUARTER, u1)
                share += max(right - left, f32(0)) * max(top - bottom, f32(0))
    return share


@device_jit
def _seen_area(mask, box, plane, axis):
    """Area of a plane that rays meet in a voxel: where a square of its mask is set and its place is in its box.

    Each square is cut to the box; where the plane leaves the box within it, 16 points tell how much of it is left.
    """
    u, v, step = (axis + 1) % 3, (axis + 2) % 3, f32(1 / BOX_STEPS)
    low_u, high_u, low_v, high_v = f32(box[u]) * step, f32(box[u + 3]) * step, f32(box[v]) * step, f32(box[v + 3]) * step
    low, high = f32(box[axis]) * step, f32(box[axis + 3]) * step
    total = f32(0)
    for square in range(MASK_SIDE * MASK_SIDE):
        if (mask >> square) & 1 == 0:
            continue
        left, right = f32(square % MASK_SIDE) * QUARTER, f32(square % MASK_SIDE + 1) * QUARTER
        bottom, top = f32(square // MASK_SIDE) * QUARTER, f32(square // MASK_SIDE + 1) * QUARTER
        left, right, bottom, top = max(left, low_u), min(right, high_u), max(bottom, low_v), min(top, high_v)
        if right <= left or top <= bottom:
            continue
        height = (plane[3] - HALF * (plane[u] * (left + right) + plane[v] * (bottom + top))) / plane[axis]
        rise = HALF * (abs(plane[u]) * (right - left) + abs(plane[v]) * (top - bottom)) / plane[axis]
        if height - rise > high or height + rise < low:
            continue
        share = f32(1)
        if height - rise < low or height + rise > high:
            share = f32(0)
            for point in range(16):
                x, y = f32(point & 3) * QUARTER - f32(0.375), f32(point >> 2) * QUARTER - f32(0.375)
                at = height - (plane[u] * x * (right - left) + plane[v] * y * (top - bottom)) / plane[axis]
                share += f32(1 / 16) if low <= at <= high else f32(0)
        total += (right - left) * (top - bottom) * share
    return total / plane[axis]


@pixel_jit
def finish_voxels(begin, end, sums, extents, masks, planes, boxes, areas, seen, opacity, albedo, emission):
    """Means of the sums into planes, opacity, albedo and emission, extents (V, 3, 6) float32 into boxes and areas; in place.

    The area is that of the triangles, or of the squares that they touch inside their box if that is less: two sheets behind
    each other count once.
    """
    for row in range(begin, end):
        for axis in range(3):
            s, e = sums[row, axis], extents[row, axis]
            area = s[S_AREA]
            if not area > 0:
                masks[row, axis] = 0
                continue
            rcp = f32(1) / area
            x, y, z = s[S_NORMAL], s[S_NORMAL + 1], s[S_NORMAL + 2]
            inv = f32(1) / math.sqrt(x * x + y * y + z * z)
            x, y, z = x * inv, y * inv, z * inv
            planes[row, axis, 0], planes[row, axis, 1], planes[row, axis, 2] = x, y, z
            planes[row, axis, 3] = (x * s[S_CENTRE] + y * s[S_CENTRE + 1] + z * s[S_CENTRE + 2]) * rcp
            u, v = (axis + 1) % 3, (axis + 2) % 3
            touched = _touched_share(np.int64(masks[row, axis]), e[u], e[v], e[u + 3], e[v + 3])
            opacity[row, axis] = min(s[S_OPACITY] * rcp, f32(1))
            areas[row, axis] = opacity[row, axis] * min(area, touched / planes[row, axis, axis])
            for a in range(3):
                albedo[row, axis, a], emission[row, axis, a] = s[S_ALBEDO + a] * rcp, s[S_EMISSION + a] * rcp
                # half a step outwards: a ray may meet the surface on a border of the voxel, give or take rounding
                low, high = math.floor(e[a] * BOX_STEPS - 0.5), math.ceil(e[a + 3] * BOX_STEPS + 0.5)
                boxes[row, axis, a], boxes[row, axis, a + 3] = max(int(low), 0), min(int(high), BOX_STEPS)
            # a sliver in the corner of a voxel may lie between the points
            met = _seen_area(np.int64(masks[row, axis]), boxes[row, axis], planes[row, axis], axis)
            seen[row, axis] = opacity[row, axis] * max(met, f32(1e-4))


@device_jit
def axis_coverage(planes, areas, row, axis):
    """Share in [0, 1] of a voxel's face that its surfaces hide, seen along `axis`; slots add up, as a corner's walls do."""
    total = f32(0)
    for slot in range(3):
        total += areas[row, slot] * abs(planes[row, slot, axis])
    return min(total, f32(1))


@pixel_jit
def fill_coverage(begin, end, cells, planes, areas, out):
    """Coverage along x, y, z of every voxel into the dense (nx, ny, nz, 3) float32 `out`, in place."""
    for row in range(begin, end):
        for axis in range(3):
            out[cells[row, 0], cells[row, 1], cells[row, 2], axis] = axis_coverage(planes, areas, row, axis)
