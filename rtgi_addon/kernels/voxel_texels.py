"""From texels of light views to the sides of voxels: where their flux goes, and the sums of it.

A texel is spread over its footprint on the surface: where texels are larger than voxels, their middles alone would leave
holes between bright spots.
"""

from __future__ import annotations

import math

import numpy as np

from .clusters import ALPHA2, DIFFUSE, F0, GLOSSY, NO_LOBE, NORMAL, POSITION, TO_LIGHT
from .jit import borrowed, device_jit, pixel_jit
from .vec3 import ONE, ZERO, Vec3, cross, dot, f32, length, load_column, load_pixel, scaled, sub
from .voxel_rays import FAR, row_of, slot_mask, slot_plane

LOBE_SUMS = 12
PARTS_A_VOXEL = f32(2)      # parts of a texel along a voxel's edge; 3 give no less error
MOST_PARTS = 8              # parts of a texel along an edge: where it is larger than four voxels its light stays in spots


@device_jit
def _slot_score(rows, row, corner, p, n):
    """(how well a slot of voxel `row` fits a surface at p of normal n, its side); alignment less distance, -9 for none."""
    best, side = f32(-9), -1
    for slot in range(3):
        if slot_mask(rows, row, slot) != 0:
            plane, offset = slot_plane(rows, row, slot)
            cosine = dot(plane, n)
            score = abs(cosine) - abs(dot(plane, sub(p, corner)) - offset)
            if score > best:
                best, side = score, 2 * slot + (0 if cosine >= ZERO else 1)
    return best, side


@device_jit
def _edge(position, normal, i, j, down, right):
    """Vector in m from texel (i, j) of (H, W, 3) images to the next one `down` or `right`; 0 where no neighbour is like it.

    Of the two neighbours the nearer one counts, as long as it lies along the surface and not behind it.
    """
    height, width = position.shape[0], position.shape[1]
    p, n = load_pixel(position, i, j), load_pixel(normal, i, j)
    best, least = Vec3(ZERO, ZERO, ZERO), FAR
    for sign in range(-1, 2, 2):
        u, v = i + sign * down, j + sign * right
        if 0 <= u < height and 0 <= v < width:
            d = sub(load_pixel(position, u, v), p)
            size2 = dot(d, d)
            is_along = dot(n, load_pixel(normal, u, v)) > f32(0.8) and abs(dot(n, d)) < f32(0.3) * math.sqrt(size2)
            if is_along and size2 < least:
                best, least = scaled(d, f32(sign)), size2
    return best


@pixel_jit
def _measure_texels(begin, end, position, normal, ids, rcp_cell, edges, parts):
    width = position.shape[1]
    for k in range(begin, end):
        for axis in range(2):
            d = _edge(position, normal, ids[k] // width, ids[k] % width, axis, 1 - axis)
            edges[k, 3 * axis], edges[k, 3 * axis + 1], edges[k, 3 * axis + 2] = d.x, d.y, d.z
            parts[k, axis] = min(max(int(math.ceil(PARTS_A_VOXEL * length(d) * rcp_cell)), 1), MOST_PARTS)


def measure_texels(position, normal, ids, rcp_cell):
    """Edges of texels on their surfaces, (K, 6) float32 m, and into how many parts each edge is cut, (K, 2) int32.

    `ids` (K,) are flat indices of texels of the (H, W, 3) images.
    """
    number = len(ids)
    edges, parts = np.zeros((number, 6), np.float32), np.ones((number, 2), np.int32)
    _measure_texels(number, position, normal, ids, rcp_cell, edges, parts)
    return edges, parts


@pixel_jit
def _find_sides(begin, end, walk, shape, table, edges, parts, first, origin, rcp_cell, good_score, out):
    walk, = borrowed((walk,))
    for k in range(begin, end):
        n, count_u, count_v = load_column(table, NORMAL, k), parts[k, 0], parts[k, 1]
        middle = np.int64(-2)
        for part in range(count_u * count_v):
            a = (f32(part // count_v) + f32(0.5)) / f32(count_u) - f32(0.5)
            b = (f32(part % count_v) + f32(0.5)) / f32(count_v) - f32(0.5)
            side = _side_at(walk, shape, _in_cells(table, edges, k, a, b, origin, rcp_cell), n, good_score)
            if side < 0 and count_u * count_v > 1:
                if middle == -2:
                    middle = _side_at(walk, shape, _in_cells(table, edges, k, ZERO, ZERO, origin, rcp_cell), n, good_score)
                side = middle
            out[first[k] + part] = side


def find_sides(walk, shape, table, edges, parts, first, origin, rcp_cell, good_score):
    """(S,) int32: 6 row + side of the surface that each part of each texel lies on; -1 for none.

    table: texels as in `kernels.clusters`, positions in metres; edges, parts: as `measure_texels` gives; first (K,): where a
    texel's parts begin; shape (3,) and origin (3,) float64 m of the grid. A part that finds no surface, beyond an edge, goes
    where its texel's middle goes.
    """
    number = table.shape[1]
    out = np.empty(first[-1] if number > 0 else 0, np.int32)
    _find_sides(number, walk, shape, table, edges, parts, first, origin, rcp_cell, good_score, out)
    return out


@device_jit
def _in_cells(table, edges, k, a, b, origin, rcp_cell):
    """The point a, b texel edges off the middle of texel k, in cells."""
    return Vec3(f32((table[POSITION, k] + a * edges[k, 0] + b * edges[k, 3] - origin[0]) * rcp_cell),
                f32((table[POSITION + 1, k] + a * edges[k, 1] + b * edges[k, 4] - origin[1]) * rcp_cell),
                f32((table[POSITION + 2, k] + a * edges[k, 2] + b * edges[k, 5] - origin[2]) * rcp_cell))


@device_jit
def _side_at(walk, shape, p, n, good_score):
    """6 row + side of the surface at p, in cells, with normal n; -1 for none.

    A point whose own cell holds no surface like its own, by rounding or because its object has no triangles there, goes to
    the best of the 27 cells around.
    """
    nx, ny, nz = shape[0], shape[1], shape[2]
    found = np.int64(-1)
    if not (p.x >= -ONE and p.y >= -ONE and p.z >= -ONE):
        return found
    if not (p.x <= f32(nx + 1) and p.y <= f32(ny + 1) and p.z <= f32(nz + 1)):
        return found
    x, y, z = int(math.floor(p.x)), int(math.floor(p.y)), int(math.floor(p.z))
    best, rows = f32(-8), walk.rows
    if 0 <= x < nx and 0 <= y < ny and 0 <= z < nz:
        row = row_of(walk.bits, walk.first, x, y, z)
        if row >= 0:
            best, side = _slot_score(rows, row, Vec3(f32(x), f32(y), f32(z)), p, n)
            found = 6 * row + side if side >= 0 else np.int64(-1)
    if best >= good_score:
        return found
    for a in range(max(x - 1, 0), min(x + 2, nx)):
        for b in range(max(y - 1, 0), min(y + 2, ny)):
            for c in range(max(z - 1, 0), min(z + 2, nz)):
                row = row_of(walk.bits, walk.first, a, b, c)
                if row >= 0:
                    score, side = _slot_score(rows, row, Vec3(f32(a), f32(b), f32(c)), p, n)
                    if score > best:
                        best, found = score, 6 * row + side
    return found


@device_jit
def add_texels(table, sides, first, edges, diffuse, lobes, brightest):
    """Add the flux of texels to the sides that their parts lie on, in place, on one thread and in their order.

    first (K + 1,): where a texel's parts begin in `sides`; edges: as `measure_texels` gives. diffuse (6 V, 3) float32:
    Lambertian flux; lobes (6 V, LOBE_SUMS) float32: glossy flux by colour and, weighed by its mean, normal, direction to the
    light, alpha squared, F0 and 1; brightest (6 V,) float32: W/m2 of the texel that sends the most, mean of the colours.
    Returns the flux (3,) float64 that found no side.
    """
    lost = np.zeros(3, np.float64)
    for i in range(table.shape[1]):
        share = f32(1) / f32(first[i + 1] - first[i])
        is_glossy = table[ALPHA2, i] < NO_LOBE
        g = share * (table[GLOSSY, i] + table[GLOSSY + 1, i] + table[GLOSSY + 2, i]) * f32(1 / 3)
        d = (table[DIFFUSE, i] + table[DIFFUSE + 1, i] + table[DIFFUSE + 2, i]) * f32(1 / 3)
        area = length(cross(Vec3(edges[i, 0], edges[i, 1], edges[i, 2]), Vec3(edges[i, 3], edges[i, 4], edges[i, 5])))
        sent = (d + (g / share if is_glossy and len(lobes) > 0 else ZERO)) / max(area, f32(1e-30))
        for part in range(first[i], first[i + 1]):
            side = sides[part]
            if side < 0:
                for a in range(3):
                    lost[a] += share * (table[DIFFUSE + a, i] + table[GLOSSY + a, i])
                continue
            brightest[side] = max(brightest[side], sent)
            for a in range(3):
                diffuse[side, a] += share * table[DIFFUSE + a, i]
            if is_glossy:
                for a in range(3):
                    lobes[side, a] += share * table[GLOSSY + a, i]
                    lobes[side, 3 + a] += g * table[NORMAL + a, i]
                    lobes[side, 6 + a] += g * table[TO_LIGHT + a, i]
                lobes[side, 9] += g * table[ALPHA2, i]
                lobes[side, 10] += g * table[F0, i]
                lobes[side, 11] += g
    return lost
