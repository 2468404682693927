"""How much of the sky a depth image leaves open at each pixel: cosine-correct sectors, and horizons as published.

A kernel takes 64 pixels, a tile of 8x8, through each step together: its inner loops run over these lanes, without branches,
on rows of one scratch array, so that they vectorise. Rows lie at offsets that are known when the kernel is compiled. With a
two-dimensional array the compiler would have to prove at run time that rows do not overlap; it gives up, and a tap costs
30 ns instead of 4.
"""

from __future__ import annotations

import functools
import math

import numpy as np

from .fastmath import PI, TWO_PI, fast_sin, fraction
from .jit import borrowed, device_jit, inline_jit, pixel_jit, select
from .sampling import dither, place_id
from .screen import TINY, point_vs, seen_normal_vs, to_viewer_vs, turn_to_world
from .shadow import ORTHOGRAPHIC
from .slices import (
    BEYOND_PX,
    QUARTER,
    SECTORS,
    TWO,
    Slice,
    bits_below,
    bits_by_byte,
    count_bits,
    exit_px,
    reach_px,
    rear,
    screen_step,
    share_below,
    slice_of,
)
from .vec3 import ONE, ZERO, Vec3, along, dot, f32, length, scaled, tangent_frame

LANES = 64                  # pixels that go through each step together
HALF, EIGHTH = f32(0.5), f32(1 / 8)
LOBE = f32(2 / 3)           # length of the mean direction of a cosine lobe
FAR = f32(1e18)             # stands for a depth where nothing is seen: its square is still a float32
GOLDEN, SILVER = f32(0.618034), f32(0.754878)   # steps of the sequences that spread jitter over a pixel's slices
GRAZING = f32(1e-3)         # cosine between a pixel's ray and the tangent plane below which their meeting place is not used
RIM = f32(1e-4)             # pixels that a tap may lie outside the outermost pixel centres, for rounding
SURFACE = f32(1e-5)         # of a sample's depth: what a float32 depth cannot tell from lying on the surface

# rows of the scratch array: vectors, then a Slice and the direction of its line, then numbers, then one more vector
_P, _VIEWER, _NORMAL, _SIDE, _BENT = (LANES * 3 * k for k in range(5))
_SLICE, _LINE = LANES * 15, LANES * 22
(_COLUMN, _ROW, _DISTANCE, _TURN, _JITTER, _SHIFT, _WEIGHT, _RATE, _COLUMNS, _ROWS, _REACH, _KNOWN, _HIT_COLUMN, _HIT_ROW,
 _DEPTH, _LOW, _HIGH, _LIGHT, _OPEN, _IS_IN, _PART, _NEXT_DEPTH) = (LANES * k for k in range(24, 46))
_ALL = LANES * 46
_ROW_COUNT = 49
# of the scratch array of integers: the two pixels that a tap lies between
_AT, _BESIDE = 0, LANES
NOWHERE = Vec3(ZERO, ZERO, ZERO)


@device_jit
def _vector(w, row, x):
    return Vec3(w[row + x], w[row + LANES + x], w[row + 2 * LANES + x])


@device_jit
def _put(w, row, x, v):
    w[row + x] = v.x
    w[row + LANES + x] = v.y
    w[row + 2 * LANES + x] = v.z


@device_jit
def _begin(s, w, group, width, step, margin, seed):
    """Rows that hold for all slices of a group of pixels."""
    across, first = np.uint32(width), np.uint32(step // 2 + margin)
    for x in range(LANES):
        row = np.uint32(group[x]) // across
        column = np.uint32(group[x]) - row * across
        i, j = row * np.uint32(step) + first, column * np.uint32(step) + first
        depth = s.depth[i, j]
        p = point_vs(s, f32(j) + HALF, f32(i) + HALF, depth if depth < FAR else ONE)     # any number does for the sky
        _put(w, _P, x, p)
        _put(w, _VIEWER, x, to_viewer_vs(s, p))
        _put(w, _NORMAL, x, seen_normal_vs(s, i, j))
        w[_COLUMN + x], w[_ROW + x], w[_DISTANCE + x] = f32(j) + HALF, f32(i) + HALF, length(p)
        place = place_id(row, column)
        w[_TURN + x], w[_JITTER + x] = dither(place, seed, 0), dither(place, seed, 1)
        w[_SHIFT + x] = dither(place, seed, 2)
        w[_LIGHT + x], w[_OPEN + x] = ZERO, ZERO
        _put(w, _BENT, x, NOWHERE)
        _put(w, _ALL, x, NOWHERE)


@device_jit
def _begin_slice(s, w, k, slices):
    """Rows of slice k: its side, its Slice, its line on the screen."""
    for x in range(LANES):
        # phi - pi / 2 lies in [-pi / 2, pi / 2], where its cosine is not negative
        sine = fast_sin(PI * ((f32(k) + w[_TURN + x]) / f32(slices) - HALF))
        cosine = math.sqrt(max(ONE - sine * sine, ZERO))
        p, viewer = _vector(w, _P, x), _vector(w, _VIEWER, x)
        first, second = tangent_frame(viewer)
        side = Vec3(cosine * second.x - sine * first.x, cosine * second.y - sine * first.y,
                    cosine * second.z - sine * first.z)
        a, weight = slice_of(viewer, side, _vector(w, _NORMAL, x))
        columns, rows = screen_step(s, p, side)
        rate = max(math.sqrt(columns * columns + rows * rows), TINY)
        _put(w, _SIDE, x, side)
        w[_SLICE + x], w[_SLICE + LANES + x], w[_SLICE + 2 * LANES + x] = a.n_v, a.n_s, a.rcp_n2
        w[_SLICE + 3 * LANES + x], w[_SLICE + 4 * LANES + x] = a.cos_g, a.sin_g
        w[_SLICE + 5 * LANES + x], w[_SLICE + 6 * LANES + x] = a.start, a.rcp_open
        w[_WEIGHT + x], w[_KNOWN + x], w[_RATE + x] = weight, ZERO, rate
        w[_LINE + x], w[_LINE + LANES + x] = columns / rate, rows / rate


@device_jit
def _begin_side(s, w, way, radius):
    """Rows of one side of a slice: how far to go, and how much of that lies in the picture."""
    height, width = f32(s.depth.shape[0]), f32(s.depth.shape[1])
    for x in range(LANES):
        side = scaled(_vector(w, _SIDE, x), way)
        column, row, columns, rows = w[_COLUMN + x], w[_ROW + x], way * w[_LINE + x], way * w[_LINE + LANES + x]
        reach = reach_px(s, column, row, w[_DISTANCE + x], _vector(w, _VIEWER, x), side, radius, w[_RATE + x])
        end = exit_px(height, width, column, row, columns, rows)
        # half of the share of the taps that the picture holds: the inverse of their spacing in _tap
        w[_KNOWN + x] += HALF * (math.sqrt(QUARTER + TWO * min(ONE, end / max(reach, TINY))) - HALF)
        w[_COLUMNS + x], w[_ROWS + x], w[_REACH + x] = columns, rows, min(reach, end)


@inline_jit
def _tap(s, flat, w, c, t, k, steps, is_dense):
    """Rows of tap t of `steps`: where it lies, whether in reach, and the depths of the two pixels it lies between.

    Taps are even, or three times as dense near the point as at the rim. On seven scenes that left 0.2 to 1.5 dB less error
    than the squares of even steps, and as much as even steps near contacts. A tap is moved along its line to the nearest
    column or row of pixel centres, whichever the line crosses more of.
    """
    height, width = f32(s.depth.shape[0]), f32(s.depth.shape[1])
    across, one, nothing = np.int32(s.depth.shape[1]), np.int32(1), np.int32(0)
    for x in range(LANES):
        on = (f32(t) + fraction(w[_JITTER + x] + f32(k) * GOLDEN)) / f32(steps)
        reach, columns, rows = w[_REACH + x], w[_COLUMNS + x], w[_ROWS + x]
        px = ONE + (reach - ONE) * (on * (ONE + on) * HALF if is_dense else on)
        is_across = abs(columns) >= abs(rows)
        per_px = max(max(abs(columns), abs(rows)), HALF)
        # the order of min and max turns NaN into 0
        moved = max(ONE, f32(np.int32(max(ZERO, min(px, BEYOND_PX)) * per_px + HALF))) / per_px
        column, row = w[_COLUMN + x] - HALF + columns * moved, w[_ROW + x] - HALF + rows * moved
        is_in = (column if px <= reach else -ONE) > -RIM
        is_in = (width - column if is_in else ZERO) > ONE - RIM
        is_in = (row if is_in else -ONE) > -RIM
        is_in = (height - row if is_in else ZERO) > ONE - RIM
        at_column = f32(np.int32(max(ZERO, min(column + (HALF if is_across else ZERO), width - ONE))))
        at_row = f32(np.int32(max(ZERO, min(row + (ZERO if is_across else HALF), height - ONE))))
        w[_HIT_COLUMN + x], w[_HIT_ROW + x], w[_IS_IN + x] = column, row, select(is_in, ONE, ZERO)
        w[_PART + x] = max(ZERO, min(row - at_row if is_across else column - at_column, ONE))
        at = select(is_in, np.int32(at_row) * across + np.int32(at_column), nothing)
        down, right = select(at_row < height - ONE, across, nothing), select(at_column < width - ONE, one, nothing)
        c[_AT + x], c[_BESIDE + x] = at, at + select(is_in, select(is_across, down, right), nothing)
    for x in range(LANES):
        w[_DEPTH + x], w[_NEXT_DEPTH + x] = flat[np.uint32(c[_AT + x])], flat[np.uint32(c[_BESIDE + x])]


@device_jit
def _to_tap(s, w, x, is_parallel, left, top, step_x, step_y):
    """View-space offset from the pixel's point to what is seen at the tap.

    Between two pixels lies the straight line through what they see, so that planes are met exactly on the slice: points at
    pixel centres stand beside it, and a union of sectors takes the darkest of their errors.
    """
    part, near, far = w[_PART + x], min(w[_DEPTH + x], FAR), min(w[_NEXT_DEPTH + x], FAR)
    depth = near * (ONE - part) + far * part if is_parallel else near * far / max(far * (ONE - part) + near * part, TINY)
    scale = ONE if is_parallel else depth
    return Vec3((left + (w[_HIT_COLUMN + x] + HALF) * step_x) * scale - w[_P + x],
                (top - (w[_HIT_ROW + x] + HALF) * step_y) * scale - w[_P + LANES + x], -depth - w[_P + 2 * LANES + x])


@device_jit
def _mark(s, w, way, k, radius, thickness):
    """Rows of the first sector that a tap closes and of the one after the last, as `slices.sectors` counts them."""
    is_parallel, end = s.projection == ORTHOGRAPHIC, max(way, ZERO)
    left, top, step_x, step_y = s.left, s.top, s.step_x, s.step_y
    for x in range(LANES):
        viewer, side = _vector(w, _VIEWER, x), _vector(w, _SIDE, x)
        a = Slice(w[_SLICE + x], w[_SLICE + LANES + x], w[_SLICE + 2 * LANES + x], w[_SLICE + 3 * LANES + x],
                  w[_SLICE + 4 * LANES + x], w[_SLICE + 5 * LANES + x], w[_SLICE + 6 * LANES + x])
        distance, shift = w[_DISTANCE + x], fraction(w[_SHIFT + x] + f32(k) * SILVER)
        d = _to_tap(s, w, x, is_parallel, left, top, step_x, step_y)
        is_near = (dot(d, d) if w[_IS_IN + x] > ZERO else FAR) < radius * radius
        v, b = dot(d, viewer), dot(d, side)
        front = share_below(a, v, b, end)
        v, b = rear(v, b, distance, is_parallel, thickness, radius)
        back = share_below(a, v, b, end)
        w[_LOW + x] = f32(SECTORS) * min(front, back) + shift if is_near else ZERO
        w[_HIGH + x] = f32(SECTORS) * max(front, back) + shift if is_near else ZERO


@device_jit
def _bend(w, closed, directions):
    """Adds the open directions of a finished slice to the rows of the bent normal, and all of its to those of `_ALL`."""
    last = f32(directions.shape[0] - 1)
    for x in range(LANES):
        at = min(max((w[_SLICE + 4 * LANES + x] + ONE) * HALF, ZERO), ONE) * last     # by the sine of the normal's angle
        k = min(np.int32(at), np.int32(last) - np.int32(1))
        part = at - f32(k)
        v, b, all_v, all_b = ZERO, ZERO, ZERO, ZERO
        counts = bits_by_byte(~closed[x])
        for q in range(8):
            open_share = f32((counts >> np.uint64(8 * q)) & np.uint64(0xFF)) * f32(1 / SECTORS)
            q_v = directions[k, q, 0] + part * (directions[k + 1, q, 0] - directions[k, q, 0])
            q_b = directions[k, q, 1] + part * (directions[k + 1, q, 1] - directions[k, q, 1])
            v, b, all_v, all_b = v + open_share * q_v, b + open_share * q_b, all_v + EIGHTH * q_v, all_b + EIGHTH * q_b
        weight = w[_WEIGHT + x] * w[_KNOWN + x]
        for c in range(3):
            w[_BENT + c * LANES + x] += weight * (v * w[_VIEWER + c * LANES + x] + b * w[_SIDE + c * LANES + x])
            w[_ALL + c * LANES + x] += weight * (all_v * w[_VIEWER + c * LANES + x] + all_b * w[_SIDE + c * LANES + x])


@pixel_jit
def _sector_visibility(begin, end, s, groups, height, width, step, margin, radius, thickness, slices, steps, directions,
                       seed, out):
    s, = borrowed((s,))
    planes = out.reshape(4, height * width)
    flat = s.depth.reshape(-1)
    for m in range(begin, end):
        w, c, closed = np.empty(_ROW_COUNT * LANES, np.float32), np.empty(2 * LANES, np.int32), np.empty(LANES, np.uint64)
        group = groups[m]
        _begin(s, w, group, width, step, margin, seed)
        for k in range(slices):
            _begin_slice(s, w, k, slices)
            for x in range(LANES):
                closed[x] = 0
            for sign in range(2):
                way = ONE if sign == 1 else -ONE
                _begin_side(s, w, way, radius)
                for t in range(steps):
                    _tap(s, flat, w, c, t, k, steps, True)
                    _mark(s, w, way, k, radius, thickness)
                    for x in range(LANES):
                        closed[x] |= bits_below(np.int32(w[_HIGH + x])) & ~bits_below(np.int32(w[_LOW + x]))
            for x in range(LANES):
                weight = w[_WEIGHT + x] * w[_KNOWN + x]
                w[_OPEN + x] += weight
                w[_LIGHT + x] += weight * (ONE - f32(count_bits(closed[x])) * f32(1 / SECTORS))
            if directions.shape[0] > 0:
                _bend(w, closed, directions)
        for x in range(LANES):
            rcp = ONE / max(w[_OPEN + x], TINY)
            light = w[_LIGHT + x] * rcp
            planes[0, group[x]] = light
            if directions.shape[0] > 0:
                # open slices would add up to 2/3 of the normal if there were many and the picture held all of their taps
                bent, whole = _vector(w, _BENT, x), _vector(w, _ALL, x)
                bent = along(scaled(bent, rcp), whole, -light * rcp)
                bent = turn_to_world(s, along(bent, _vector(w, _NORMAL, x), light * LOBE))
                planes[1, group[x]], planes[2, group[x]], planes[3, group[x]] = bent.x, bent.y, bent.z


def sector_visibility(s, groups, height, width, step, margin, radius, thickness, slices, steps, directions, seed):
    """Cosine-weighted visibility within `radius` m by 64 sectors a slice: (4, height, width) float32.

    Plane 0 is V in [0, 1], planes 1 to 3 the mean open direction in the world times V (zero without `directions`).

    s : Screen, `margin` pixels wider on every side than the picture.
    groups : (n, LANES) int32, flat indices of lattice points; what is in none of them gets V = 1.
    height, width, step : size of the lattice and pixels between its points.
    thickness : metres of solid that stand behind what the camera sees.
    slices, steps : planes around the viewer's direction, and taps to each side of them.
    directions : `sector_directions()`, or an array of length 0 to leave the bent normals out.

    Taps past the picture's edge are not taken; a slice counts by the share of its taps that lie inside.
    """
    out = np.zeros((4, height, width), np.float32)
    out[0] = ONE
    _sector_visibility(groups.shape[0], s, groups, height, width, step, margin, radius, thickness, slices, steps, directions,
                       seed, out)
    return out


@functools.cache
def sector_directions(rows: int = 33) -> np.ndarray:
    """(rows, 8, 2) float32: mean (v, s) of the directions in each eighth of a slice's sectors, weighted as the slice is.

    Row r belongs to the sine 2 r / (rows - 1) - 1 of the projected normal's angle. Between rows a linear blend is off by
    less than 0.01.
    """
    out = np.empty((rows, 8, 2))
    for r, sine in enumerate(np.linspace(-1, 1, rows)):
        g = np.arcsin(sine)
        t = np.linspace(g - np.pi / 2, g + np.pi / 2, 4097)
        t = (t[1:] + t[:-1]) / 2
        density = np.cos(t - g) * np.abs(np.sin(t))
        part = np.minimum((np.cumsum(density) / density.sum() * 8).astype(int), 7)
        mass = np.bincount(part, density, 8)
        out[r] = np.stack([np.bincount(part, density * axis, 8) / mass for axis in (np.cos(t), np.sin(t))], -1)
    return out.astype(np.float32)


@device_jit
def _begin_direction(s, w, k, directions, radius, bias):
    """Rows of published direction k: its line on the screen, how far to go, and the sine of the biased tangent."""
    height, width = f32(s.depth.shape[0]), f32(s.depth.shape[1])
    is_parallel, sin_bias, cos_bias = s.projection == ORTHOGRAPHIC, math.sin(bias), math.cos(bias)
    for x in range(LANES):
        turn = (f32(k) + w[_TURN + x]) / f32(directions)
        flip = -ONE if turn >= HALF else ONE
        sine = fast_sin(PI * (TWO * turn - (f32(1.5) if turn >= HALF else HALF)))
        cosine = math.sqrt(max(ONE - sine * sine, ZERO))
        across, up = -flip * sine, flip * cosine            # unit direction on the image plane
        n, p = _vector(w, _NORMAL, x), _vector(w, _P, x)
        depth = -p.z
        inv = ONE if is_parallel else ONE / max(depth, TINY)
        columns, rows = across * inv / s.step_x, -up * inv / s.step_y
        rate = max(math.sqrt(columns * columns + rows * rows), TINY)
        columns, rows, reach = columns / rate, rows / rate, radius * rate
        end = exit_px(height, width, w[_COLUMN + x], w[_ROW + x], columns, rows)
        # where the tangent plane goes as the picture's point moves along the line
        ray_x, ray_y = (ZERO, ZERO) if is_parallel else (p.x * inv, p.y * inv)
        away = (n.x * across + n.y * up) / max(n.z - n.x * ray_x - n.y * ray_y, GRAZING)
        t_x, t_y, t_z = across + away * ray_x, up + away * ray_y, -away
        w[_COLUMNS + x], w[_ROWS + x], w[_REACH + x] = columns, rows, min(reach, end)
        w[_KNOWN + x] = min(ONE, end / max(reach, TINY))
        flat = math.sqrt(t_x * t_x + t_y * t_y)
        w[_LOW + x] = (t_z * cos_bias + flat * sin_bias) / math.sqrt(t_x * t_x + t_y * t_y + t_z * t_z)
        w[_HIGH + x] = ZERO


@device_jit
def _raise_horizon(s, w, radius, has_falloff):
    """Rows of the sine of the horizon so far, and of what it has closed, after one more tap."""
    is_parallel, rcp_r2 = s.projection == ORTHOGRAPHIC, ONE / (radius * radius)
    left, top, step_x, step_y = s.left, s.top, s.step_x, s.step_y
    for x in range(LANES):
        horizon, closed = w[_LOW + x], w[_HIGH + x]
        d = _to_tap(s, w, x, is_parallel, left, top, step_x, step_y)
        r2 = dot(d, d) if w[_IS_IN + x] > ZERO else FAR
        sine, falloff = d.z / math.sqrt(max(r2, TINY)), max(ONE - r2 * rcp_r2, ZERO)
        rise = max(sine - horizon, ZERO) if falloff > ZERO else ZERO
        w[_LOW + x] = horizon + rise
        w[_HIGH + x] = closed + rise * (falloff if has_falloff else ONE)


@pixel_jit
def _published_visibility(begin, end, s, groups, height, width, step, margin, radius, bias, has_falloff, directions, steps,
                          seed, out):
    s, = borrowed((s,))
    plane = out.reshape(height * width)
    flat = s.depth.reshape(-1)
    for m in range(begin, end):
        w, c, group = np.empty(_ROW_COUNT * LANES, np.float32), np.empty(2 * LANES, np.int32), groups[m]
        _begin(s, w, group, width, step, margin, seed)
        for k in range(directions):
            _begin_direction(s, w, k, directions, radius, bias)
            for t in range(steps):
                _tap(s, flat, w, c, t, k, steps, False)
                _raise_horizon(s, w, radius, has_falloff)
            for x in range(LANES):
                w[_OPEN + x] += w[_KNOWN + x]
                w[_LIGHT + x] += w[_KNOWN + x] * (ONE - w[_HIGH + x])
        for x in range(LANES):
            plane[group[x]] = min(max(w[_LIGHT + x] / max(w[_OPEN + x], TINY), ZERO), ONE)


def published_visibility(s, groups, height, width, step, margin, radius, bias, has_falloff, directions, steps, seed):
    """Visibility by horizons as Bavoil et al. (2008) published it: (1, height, width) float32, uniform in solid angle.

    V = 1 - 1 / directions * sum over directions and taps of (sin h_i - sin h_{i-1}) W_i, with h_0 the tangent's elevation
    over the view's XY plane plus `bias` rad, and W = 1 - r^2 / radius^2, or 1 without `has_falloff`. Arguments and edges as
    for `sector_visibility`; taps lie at even steps.
    """
    out = np.ones((1, height, width), np.float32)
    _published_visibility(groups.shape[0], s, groups, height, width, step, margin, radius, bias, has_falloff, directions,
                          steps, seed, out)
    return out


@pixel_jit
def _depth_and_facing(begin, end, s, out):
    s, = borrowed((s,))
    scale = ZERO if s.projection == ORTHOGRAPHIC else ONE
    for i in range(begin, end):
        for j in range(s.depth.shape[1]):
            n = seen_normal_vs(s, i, j)
            ray_x, ray_y = scale * (s.left + (f32(j) + HALF) * s.step_x), scale * (s.top - (f32(i) + HALF) * s.step_y)
            out[i, j, 0], out[i, j, 1] = s.depth[i, j], max(n.z - n.x * ray_x - n.y * ray_y, GRAZING)


@pixel_jit
def _sphere_visibility(begin, end, s, table, groups, height, width, step, margin, radius, samples, is_oriented, seed, out):
    s, = borrowed((s,))
    plane = out.reshape(height * width)
    is_parallel, deepest = s.projection == ORTHOGRAPHIC, radius if is_oriented else FAR
    tall, wide = f32(s.depth.shape[0]), f32(s.depth.shape[1])
    left, top, step_x, step_y = s.left, s.top, s.step_x, s.step_y
    for m in range(begin, end):
        w, c, group = np.empty(_ROW_COUNT * LANES, np.float32), np.empty(LANES, np.int32), groups[m]
        _begin(s, w, group, width, step, margin, seed)
        for x in range(LANES):
            z = ONE - TWO * w[_TURN + x]
            r = math.sqrt(max(ONE - z * z, ZERO))
            phi = TWO_PI * w[_JITTER + x]
            w[_SIDE + x], w[_SIDE + LANES + x], w[_SIDE + 2 * LANES + x] = r * math.cos(phi), r * math.sin(phi), z
            w[_WEIGHT + x] = ZERO
        for t in range(samples.shape[0]):
            q = Vec3(samples[t, 0], samples[t, 1], samples[t, 2])
            for x in range(LANES):
                p, mirror, n = _vector(w, _P, x), _vector(w, _SIDE, x), _vector(w, _NORMAL, x)
                d = along(q, mirror, -TWO * dot(q, mirror))
                height_m = dot(d, n)
                d = scaled(d, -radius if is_oriented and height_m < ZERO else radius)
                z = -p.z - d.z
                inv = ONE if is_parallel else ONE / max(z, TINY)
                column, row = ((p.x + d.x) * inv - left) / step_x, (top - (p.y + d.y) * inv) / step_y
                is_in = (column if z > ZERO or is_parallel else -ONE) >= ZERO
                is_in = (column if is_in else wide) < wide
                is_in = (row if is_in else -ONE) >= ZERO
                is_in = (row if is_in else tall) < tall
                column = f32(np.int32(max(ZERO, min(column, wide - ONE))))
                row = f32(np.int32(max(ZERO, min(row, tall - ONE))))
                # the depth at which the pixel centre's ray is as high over the tangent plane as the sample
                ray_x, ray_y = left + (column + HALF) * step_x, top - (row + HALF) * step_y
                level = dot(p, n) + abs(height_m) * radius
                across = ray_x * n.x + ray_y * n.y
                over = across - level if is_parallel else level
                there = over / (max(n.z, GRAZING) if is_parallel else min(across - n.z, -GRAZING))
                c[_AT + x] = np.int32(row) * np.int32(s.depth.shape[1]) + np.int32(column)
                w[_KNOWN + x] = ONE if is_in else ZERO
                w[_REACH + x] = there if is_oriented else z
            for x in range(LANES):
                at = np.uint32(c[_AT + x])
                w[_DEPTH + x] = table[at, 0]
                if is_oriented:
                    w[_WEIGHT + x] = table[at, 1]
            for x in range(LANES):
                there, known = w[_REACH + x], w[_KNOWN + x]
                before = there - w[_DEPTH + x]
                hidden = known if before > SURFACE * there else ZERO
                hidden = hidden if before * w[_WEIGHT + x] < deepest else ZERO
                w[_OPEN + x] += known
                w[_LIGHT + x] += known - hidden
        for x in range(LANES):
            share = w[_LIGHT + x] / w[_OPEN + x] if w[_OPEN + x] > ZERO else ONE
            plane[group[x]] = share if is_oriented else min(ONE, TWO * share)


def sphere_visibility(s, groups, height, width, step, margin, radius, samples, is_oriented, seed):
    """Share of a ball around each point that the depth image does not hide: (1, height, width) float32.

    `samples` (n, 3) float32 are points of the unit ball, mirrored at a plane of its own for each pixel. Without
    `is_oriented` all of them count, and V = min(1, 2 x the visible share) (Mittring 2007). With it they are turned to the
    normal's side, and a sample farther than `radius` under the surface that is seen before it is not hidden by it.
    """
    out = np.ones((1, height, width), np.float32)
    table = s.depth.reshape(-1, 1)
    if is_oriented:
        table = np.empty((*s.depth.shape, 2), np.float32)
        _depth_and_facing(s.depth.shape[0], s, table)
        table = table.reshape(-1, 2)
    _sphere_visibility(groups.shape[0], s, table, groups, height, width, step, margin, radius, samples, is_oriented, seed,
                       out)
    return out
