"""Rays through surface voxels: an exact walk from cell to cell, and the first surface that a ray meets.

The walk (Amanatides and Woo 1987) leaps over empty bricks of 4x4x4 cells, whose bits fit the cache. In a voxel the ray is
met with the planes of its slots and the masks on them, so a flat wall blocks where it stands and not where its cells do: a
ray may start on it and leave without an offset of a cell, and two walls that meet are told apart. Planes of adjacent
voxels of a curved surface do not join; a ray that is before the one and behind the next has gone through the seam, and is
stopped there.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .jit import borrowed, device_jit, inline_jit, pixel_jit
from .sampling import uniform
from .vec3 import ONE, ZERO, Vec3, along, dot, f32, load, sub
from .voxels import BOX_STEPS, MASK_SIDE

BRICK = 4                   # cells along the edge of a brick: 64 bits, and 32 bricks across 128 cells fit the cache
LIFT = f32(0.01)            # cells that a ray's start is lifted off its surface: above the rounding of float32 positions
# a plane that a ray crosses from behind within so many cells, and that it started so near to, is that of the uneven surface
# that the ray stands on
OWN_REACH, OWN_DEPTH = f32(1.5), f32(0.3)
SLACK = f32(1e-4)           # cells that a plane's crossing may lie outside its cell by rounding
DEEPEST_SEAM = f32(0.3)     # cells that two planes of one surface may be apart where their voxels meet
SEAM = f32(0.1)             # cells that a seam between two planes may lie outside the boxes of their surfaces
FAR = f32(1e20)
UNIT, HALF_UNIT = f32(32767), f32(16383)                # an offset may be up to the voxel's diagonal, 1.73
RCP_UNIT, RCP_HALF_UNIT, BOX_STEP = f32(1 / 32767), f32(1 / 16383), f32(1 / BOX_STEPS)
SLOT_WORDS, W_OFFSET, W_MASK, W_BOX, W_OPACITY, ROW_WORDS = 8, 3, 4, 5, 24, 32


class VoxelWalk(NamedTuple):
    """What rays need of the voxels, packed: a cache line a voxel; lengths are in cells.

    bits (bx, by, bz) uint64: a bit for each of a brick's 4x4x4 cells, x fastest; first (bx, by, bz) int32: row of a brick's
    first voxel, or 0 less the distance in bricks to the nearest that holds one. rows (V, 32) int16: by slot eight numbers,
    the plane's normal in steps of 1 / UNIT, its offset in steps of 1 / HALF_UNIT, the mask, the slot's box as three pairs
    of bytes (lowest, highest); from W_OPACITY on the opacity of the slots in steps of 1 / BOX_STEPS.
    """

    bits: np.ndarray
    first: np.ndarray
    rows: np.ndarray


@device_jit
def fill_bricks(cells, bits, first):
    """Set the bits of occupied cells (V, 3), which come brick by brick, and the first row of each brick; in place."""
    for row in range(cells.shape[0]):
        x, y, z = np.int64(cells[row, 0]), np.int64(cells[row, 1]), np.int64(cells[row, 2])
        if bits[x >> 2, y >> 2, z >> 2] == np.uint64(0):
            first[x >> 2, y >> 2, z >> 2] = row
        bits[x >> 2, y >> 2, z >> 2] |= np.uint64(1) << np.uint64((x & 3) | ((y & 3) << 2) | ((z & 3) << 4))


@device_jit
def fill_clearance(bits, first):
    """Write 0 less the distance in bricks to the nearest occupied one to the empty bricks of `first`, in place.

    The largest of the three differences counts; two passes over half of the neighbours each are exact for it (Rosenfeld
    and Pfaltz 1966).
    """
    nx, ny, nz = bits.shape
    most = nx + ny + nz
    for turn in range(2):
        for i in range(nx):
            for j in range(ny):
                for k in range(nz):
                    x, y, z = (i, j, k) if turn == 0 else (nx - 1 - i, ny - 1 - j, nz - 1 - k)
                    if bits[x, y, z] != np.uint64(0):
                        continue
                    least = most if turn == 0 else -first[x, y, z]
                    for c in range(13):          # the neighbours that come before this one in the order of the pass
                        a, b, e = c // 9, c // 3 % 3, c % 3
                        u, v, w = (x + a - 1, y + b - 1, z + e - 1) if turn == 0 else (x + 1 - a, y + 1 - b, z + 1 - e)
                        if 0 <= u < nx and 0 <= v < ny and 0 <= w < nz:
                            near = 0 if bits[u, v, w] != np.uint64(0) else -first[u, v, w]
                            least = min(least, near + 1)
                    first[x, y, z] = -least


@device_jit
def count_ones(word):
    """Ones in 64 bits."""
    w = np.uint64(word)
    w = w - ((w >> np.uint64(1)) & np.uint64(0x5555555555555555))
    w = (w & np.uint64(0x3333333333333333)) + ((w >> np.uint64(2)) & np.uint64(0x3333333333333333))
    w = (w + (w >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    w = w + (w >> np.uint64(8))
    w = w + (w >> np.uint64(16))
    return np.int64((w + (w >> np.uint64(32))) & np.uint64(0x7F))


@device_jit
def row_of(bits_of, first, x, y, z):
    """Row of the voxel in cell (x, y, z) inside the grid, -1 where it is empty."""
    bits = bits_of[x >> 2, y >> 2, z >> 2]
    bit = np.uint64((x & 3) | ((y & 3) << 2) | ((z & 3) << 4))
    if (bits >> bit) & np.uint64(1) == np.uint64(0):
        return np.int64(-1)
    return np.int64(first[x >> 2, y >> 2, z >> 2]) + count_ones(bits & ((np.uint64(1) << bit) - np.uint64(1)))


@device_jit
def _reciprocal(x):
    return ONE / x if abs(x) > f32(1e-12) else (FAR if x >= ZERO else -FAR)


@device_jit
def slot_mask(rows, row, slot):
    """The mask of a slot, 0 for an empty one."""
    return np.int64(rows[row, SLOT_WORDS * slot + W_MASK]) & 0xFFFF


@device_jit
def slot_plane(rows, row, slot):
    """(normal, offset) of a slot's plane, counted from the voxel's lowest corner."""
    at = SLOT_WORDS * slot
    return (Vec3(f32(rows[row, at]) * RCP_UNIT, f32(rows[row, at + 1]) * RCP_UNIT, f32(rows[row, at + 2]) * RCP_UNIT),
            f32(rows[row, at + W_OFFSET]) * RCP_HALF_UNIT)


@device_jit
def slot_box(rows, row, slot):
    """Lowest and highest corner of a slot's surfaces, from the voxel's lowest corner."""
    at = SLOT_WORDS * slot + W_BOX
    x, y, z = np.int64(rows[row, at]), np.int64(rows[row, at + 1]), np.int64(rows[row, at + 2])
    return (Vec3(f32(x & 0xFF) * BOX_STEP, f32(y & 0xFF) * BOX_STEP, f32(z & 0xFF) * BOX_STEP),
            Vec3(f32((x >> 8) & 0xFF) * BOX_STEP, f32((y >> 8) & 0xFF) * BOX_STEP, f32((z >> 8) & 0xFF) * BOX_STEP))


@device_jit
def mask_covers(mask, slot, p):
    """Does a slot's mask hold the square around p, in cells from the voxel's lowest corner?"""
    u, v = (p.y, p.z) if slot == 0 else ((p.z, p.x) if slot == 1 else (p.x, p.y))
    column = min(max(int(u * f32(MASK_SIDE)), 0), MASK_SIDE - 1)
    line = min(max(int(v * f32(MASK_SIDE)), 0), MASK_SIDE - 1)
    return (mask >> (line * MASK_SIDE + column)) & 1 == 1


@device_jit
def _is_within(word, x, slack):
    w = np.int64(word)
    return (f32(w & 0xFF) * BOX_STEP - slack <= x) and (x <= f32((w >> 8) & 0xFF) * BOX_STEP + slack)


@device_jit
def _covers(rows, row, slot, p, slack):
    """Do a slot's surfaces reach the point p of its plane, in cells from the voxel's lowest corner, give or take `slack`?"""
    at = SLOT_WORDS * slot + W_BOX
    if not (_is_within(rows[row, at], p.x, slack) and _is_within(rows[row, at + 1], p.y, slack)
            and _is_within(rows[row, at + 2], p.z, slack)):
        return False
    return mask_covers(slot_mask(rows, row, slot), slot, p)


@device_jit
def _is_there(rows, row, slot, t):
    """Does a ray that meets a slot at t meet what is there of it, and not a hole? Drawn by the opacity."""
    opacity = rows[row, W_OPACITY + slot]
    return opacity >= BOX_STEPS or uniform(row, int(t * f32(4096)), slot) * f32(BOX_STEPS) < f32(opacity)


@inline_jit
def meet_voxel(rows, row, corner, before, before_corner, o, d, n, t_in, t_out):
    """(t, side) of the first surface of voxel `row` that the ray o + t d meets between t_in and t_out; t is FAR for none.

    `corner` is the voxel's lowest corner; `before` the row of the voxel that the ray has just left, -1 for none. `n` is the
    normal of the surface that the ray started on; zero for a ray that starts in the open. `side` is 2 slot for the
    side that the slot's normal points to, 2 slot + 1 for the other.
    """
    local = sub(o, corner)
    best, side = FAR, 0
    for slot in range(3):
        if slot_mask(rows, row, slot) == 0:
            continue
        plane, offset = slot_plane(rows, row, slot)
        height, slope = dot(plane, local) - offset, dot(plane, d)
        steep = abs(slope)
        if height * slope < ZERO and abs(height) <= steep * (t_out + SLACK) and abs(height) >= steep * (t_in - SLACK):
            t = abs(height) / steep
            is_own = abs(height) < OWN_DEPTH and t < OWN_REACH and slope * dot(plane, n) > ZERO
            is_hit = not is_own and t < best and _covers(rows, row, slot, along(local, d, t), SLACK)
            if is_hit and _is_there(rows, row, slot, t):
                best, side = t, 2 * slot + (1 if slope > ZERO else 0)
            continue
        now = height + slope * t_in
        if before >= 0 and t_in > ZERO and abs(now) < DEEPEST_SEAM and slot_mask(rows, before, slot) != 0:
            other, offset = slot_plane(rows, before, slot)
            there = along(sub(o, before_corner), d, t_in)
            was = dot(other, there) - offset
            if (was * now < ZERO and dot(other, plane) > f32(0.5) and t_in < best
                    and not (abs(height) < OWN_DEPTH and t_in < OWN_REACH and slope * dot(plane, n) > ZERO)
                    and (_covers(rows, row, slot, along(local, d, t_in), SEAM) or _covers(rows, before, slot, there, SEAM))):
                best, side = t_in, 2 * slot + (0 if was > ZERO else 1)
    return best, side


@inline_jit
def first_surface(walk, o, d, n, reach):
    """(t, row, side) of the first surface along o + t d, for t below `reach`; row is -1 where there is none.

    o in cells from the grid's lowest corner, d a unit vector; n as in `meet_voxel`. Without a hit t is where the ray ended:
    `reach`, or the border of the grid.
    """
    nx, ny, nz = BRICK * walk.bits.shape[0], BRICK * walk.bits.shape[1], BRICK * walk.bits.shape[2]
    inv = Vec3(_reciprocal(d.x), _reciprocal(d.y), _reciprocal(d.z))
    a, b = -o.x * inv.x, (f32(nx) - o.x) * inv.x
    t, end = min(a, b), max(a, b)
    a, b = -o.y * inv.y, (f32(ny) - o.y) * inv.y
    t, end = max(t, min(a, b)), min(end, max(a, b))
    a, b = -o.z * inv.z, (f32(nz) - o.z) * inv.z
    t, end = max(max(t, min(a, b)), ZERO), min(min(end, max(a, b)), reach)
    if not t <= end:
        return max(end, ZERO), np.int64(-1), 0
    bricks, first, rows = walk.bits, walk.first, walk.rows
    p = along(o, d, t)
    x, y, z = min(max(int(p.x), 0), nx - 1) >> 2, min(max(int(p.y), 0), ny - 1) >> 2, min(max(int(p.z), 0), nz - 1) >> 2
    forth_x, forth_y, forth_z = int(d.x >= ZERO), int(d.y >= ZERO), int(d.z >= ZERO)
    step_x, step_y, step_z = 2 * forth_x - 1, 2 * forth_y - 1, 2 * forth_z - 1
    cell_x, cell_y, cell_z = abs(inv.x), abs(inv.y), abs(inv.z)
    next_x = (f32((x + forth_x) * BRICK) - o.x) * inv.x
    next_y = (f32((y + forth_y) * BRICK) - o.y) * inv.y
    next_z = (f32((z + forth_z) * BRICK) - o.z) * inv.z
    before, before_corner = np.int64(-1), o
    while True:
        bits = bricks[x, y, z]
        if bits == np.uint64(0):
            before = np.int64(-1)
            clear = -first[x, y, z] - 1          # bricks around this one that are empty too: go to the last of them
            if clear > 0:
                ax, ay, az = (next_x + f32(clear * BRICK) * cell_x, next_y + f32(clear * BRICK) * cell_y,
                              next_z + f32(clear * BRICK) * cell_z)
                t = min(ax, min(ay, az))
                if t >= end:
                    return end, np.int64(-1), 0
                p = along(o, d, t)
                low_x, low_y, low_z = x - clear, y - clear, z - clear
                if ax <= ay and ax <= az:
                    x += step_x * clear
                    y, z = min(max(int(p.y) >> 2, low_y), y + clear), min(max(int(p.z) >> 2, low_z), z + clear)
                elif ay <= az:
                    y += step_y * clear
                    x, z = min(max(int(p.x) >> 2, low_x), x + clear), min(max(int(p.z) >> 2, low_z), z + clear)
                else:
                    z += step_z * clear
                    x, y = min(max(int(p.x) >> 2, low_x), x + clear), min(max(int(p.y) >> 2, low_y), y + clear)
                next_x = (f32((x + forth_x) * BRICK) - o.x) * inv.x
                next_y = (f32((y + forth_y) * BRICK) - o.y) * inv.y
                next_z = (f32((z + forth_z) * BRICK) - o.z) * inv.z
        else:
            p = along(o, d, t)
            cx, cy, cz = int(p.x) - BRICK * x, int(p.y) - BRICK * y, int(p.z) - BRICK * z
            cx, cy, cz = min(max(cx, 0), 3), min(max(cy, 0), 3), min(max(cz, 0), 3)
            to_x = (f32(BRICK * x + cx + forth_x) - o.x) * inv.x
            to_y = (f32(BRICK * y + cy + forth_y) - o.y) * inv.y
            to_z = (f32(BRICK * z + cz + forth_z) - o.z) * inv.z
            inside = t
            while True:
                t_out = min(to_x, min(to_y, to_z))
                bit = np.uint64(cx | (cy << 2) | (cz << 4))
                if (bits >> bit) & np.uint64(1) != np.uint64(0):
                    row = np.int64(first[x, y, z]) + count_ones(bits & ((np.uint64(1) << bit) - np.uint64(1)))
                    corner = Vec3(f32(BRICK * x + cx), f32(BRICK * y + cy), f32(BRICK * z + cz))
                    hit, side = meet_voxel(rows, row, corner, before, before_corner, o, d, n, inside, t_out)
                    if hit < end:
                        return hit, row, side
                    before, before_corner = row, corner
                else:
                    before = np.int64(-1)
                inside = max(inside, t_out)
                if to_x <= to_y and to_x <= to_z:
                    cx += step_x
                    to_x += cell_x
                    if cx & ~3:
                        break
                elif to_y <= to_z:
                    cy += step_y
                    to_y += cell_y
                    if cy & ~3:
                        break
                else:
                    cz += step_z
                    to_z += cell_z
                    if cz & ~3:
                        break
        t = max(t, min(next_x, min(next_y, next_z)))
        if t >= end:
            return end, np.int64(-1), 0
        if next_x <= next_y and next_x <= next_z:
            x += step_x
            next_x += f32(BRICK) * cell_x
        elif next_y <= next_z:
            y += step_y
            next_y += f32(BRICK) * cell_y
        else:
            z += step_z
            next_z += f32(BRICK) * cell_z
        if x < 0 or y < 0 or z < 0 or x >= bricks.shape[0] or y >= bricks.shape[1] or z >= bricks.shape[2]:
            return end, np.int64(-1), 0


@pixel_jit
def _cast_voxel_rays(begin, end, walk, origin, direction, normal, reach, ts, rows, sides):
    walk, = borrowed((walk,))
    for i in range(begin, end):
        n = load(normal, i)
        t, row, side = first_surface(walk, along(load(origin, i), n, LIFT), load(direction, i), n, reach)
        ts[i], rows[i], sides[i] = t, row, side


def cast_voxel_rays(walk, origin, direction, normal, reach):
    """First surface along (N, 3) rays in cells: (t (N,) float32, row (N,) int32 or -1, side (N,) int32)."""
    number = origin.shape[0]
    ts, rows, sides = np.empty(number, np.float32), np.empty(number, np.int32), np.empty(number, np.int32)
    _cast_voxel_rays(number, walk, origin, direction, normal, reach, ts, rows, sides)
    return ts, rows, sides
