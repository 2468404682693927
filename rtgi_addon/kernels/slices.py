"""Half planes through the viewer's direction: what a depth image can tell about the directions above a point.

All directions above a point x with normal n are cut into slices, planes that hold the direction v to the viewer. A slice
with side s (unit, at a right angle to v) holds the directions cos(t) v + sin(t) s, and what the camera sees of it lies on
one straight line of the picture. With n_p the part of n in the plane and g its angle from v, the visibility, weighted by the
cosine, is

    V = 1 / pi int_0^pi |n_p| int_{g - pi/2}^{g + pi/2} visible(t) cos(t - g) |sin(t)| dt dphi

(Jimenez et al. 2016, Eq. 3 to 7). An open slice gives w = |n_p| (cos g + g sin g), whose mean over phi is exactly 1 if the
slices lie evenly around v, not around the screen's axis. Angles are turned into shares of w by the integral's running sum
(Salm 2024), so that 64 sectors of equal share, one bit each, count cosine-weighted visibility without a weight; Therrien et
al. (2023) leave the sectors even in angle, which is another quantity.

The functions have no branches and take numbers instead of rows of arrays, so that a loop over lanes of pixels vectorises.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .fastmath import PI, fast_atan2
from .jit import device_jit
from .screen import TINY
from .shadow import ORTHOGRAPHIC
from .vec3 import ONE, ZERO, dot, f32

SECTORS = 64
QUARTER, TWO = f32(0.25), f32(2)
NOT_IN_PLANE = f32(1e-4)    # part of a normal in the slice's plane below which its angle there means nothing
NEAR_PLANE = f32(0.02)      # cosine to the eye's axis below which a direction is taken to leave any picture
BEYOND_PX = f32(1e6)
LEVEL2 = f32(1e-6)          # squared sine of the elevation below which a direction lies on the surface: 1e-6 of its light
_FULL = ~np.uint64(0)


class Slice(NamedTuple):
    """What turns angles of one slice into shares of its open weight.

    n_v, n_s: the normal's parts along the viewer's direction and the side; rcp_n2: 1 / (n_v^2 + n_s^2); cos_g, sin_g: the
    projected normal; start: the running integral at the end on the negative side; rcp_open: 1 / its whole.
    """

    n_v: np.float32
    n_s: np.float32
    rcp_n2: np.float32
    cos_g: np.float32
    sin_g: np.float32
    start: np.float32
    rcp_open: np.float32


@device_jit
def slice_of(viewer, side, normal):
    """(Slice, weight w) of a point with this unit normal; a normal turned away from the viewer counts as edge on."""
    n_v, n_s = max(dot(normal, viewer), ZERO), dot(normal, side)
    size = max(math.sqrt(n_v * n_v + n_s * n_s), NOT_IN_PLANE)
    cos_g, sin_g = n_v / size, n_s / size
    g = fast_atan2(sin_g, cos_g)
    start = -QUARTER * (TWO * cos_g + (TWO * g - PI) * sin_g)
    whole = max(cos_g + g * sin_g, NOT_IN_PLANE)
    return Slice(n_v, n_s, ONE / (size * size), cos_g, sin_g, start, ONE / whole), size * whole


@device_jit
def share_below(a, v, s, end):
    """Share in [0, 1] of an open slice between its end on the negative side and the direction (v, s), which has any length.

    On or below the surface it is `end`: 1 for what was looked for on the positive side, 0 on the negative one.
    """
    inv2, t = ONE / max(v * v + s * s, TINY), fast_atan2(s, v)
    f = QUARTER * (a.cos_g - ((v * v - s * s) * a.cos_g + TWO * v * s * a.sin_g) * inv2 + TWO * t * a.sin_g)
    f = f if t >= ZERO else -f
    f = min(max((f - a.start) * a.rcp_open, ZERO), ONE)
    height = v * a.n_v + s * a.n_s
    return f if height * abs(height) * a.rcp_n2 * inv2 > LEVEL2 else end


@device_jit
def into_slice(a, viewer, side, normal, d):
    """(v, s): the offset d of a point beside the slice's plane moved into it along the surface, so that its height stays.

    Pixel centres lie beside the slice's line. Without the move, a tilted plane would rise above itself.
    """
    v, s = dot(d, viewer), dot(d, side)
    across = (dot(d, normal) - v * a.n_v - s * a.n_s) * a.rcp_n2
    return v + across * a.n_v, s + across * a.n_s


@device_jit
def rear(v, s, distance, is_parallel, thickness, radius):
    """(v, s) of the rear of a sheet whose front is there: `thickness` m on along the viewer's ray, not past `radius` m.

    `distance` is from the slice's point to the eye; `is_parallel` for an orthographic view.
    """
    ray_v, ray_s = v - distance, s
    inv = ONE / math.sqrt(max(ray_v * ray_v + ray_s * ray_s, TINY))
    ray_v = -ONE if is_parallel else ray_v * inv
    ray_s = ZERO if is_parallel else ray_s * inv
    b = v * ray_v + s * ray_s
    on = min(thickness, math.sqrt(max(b * b + radius * radius - v * v - s * s, ZERO)) - b)
    return v + on * ray_v, s + on * ray_s


@device_jit
def bits_below(count):
    """uint64 with the lowest `count` (0 to 64) bits set; in two shifts, as a shift by 64 is not defined.

    `count` is an int32: few processors turn many float32 at once into any other integers.
    """
    half = count >> np.int32(1)
    return ~((_FULL << np.uint64(half)) << np.uint64(count - half))


@device_jit
def sectors(low, high, shift):
    """uint64 with a bit for each sector between two shares of a slice; `shift` in [0, 1) places the samples in the sectors.

    Bit k is set where the share (k + 1 - shift) / 64 lies in between: the mean over shifts is exact, and so are unions.
    """
    first, last = np.int32(f32(SECTORS) * low + shift), np.int32(f32(SECTORS) * high + shift)
    return bits_below(last) & ~bits_below(first)


@device_jit
def bits_by_byte(mask):
    """uint64 whose eight bytes hold the numbers of set bits of the bytes of `mask`."""
    x = mask - ((mask >> np.uint64(1)) & np.uint64(0x5555555555555555))
    x = (x & np.uint64(0x3333333333333333)) + ((x >> np.uint64(2)) & np.uint64(0x3333333333333333))
    return (x + (x >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)


@device_jit
def count_bits(mask):
    """Number of set bits of a uint64."""
    return np.int32((bits_by_byte(mask) * np.uint64(0x0101010101010101)) >> np.uint64(56))


@device_jit
def screen_step(s, p, side):
    """(columns, rows) that a view-space point p moves by on the screen for a metre along the view-space direction `side`."""
    is_parallel = s.projection == ORTHOGRAPHIC
    inv = ONE if is_parallel else ONE / max(-p.z, TINY)
    slope = ZERO if is_parallel else side.z * inv
    return (side.x + p.x * slope) * inv / s.step_x, -(side.y + p.y * slope) * inv / s.step_y


@device_jit
def reach_px(s, column, row, distance, viewer, side, radius, rate):
    """Pixels from (column, row) to the rim of a sphere around the point seen there, along the slice's line towards `side`.

    The rim is where a ray from the eye touches the sphere; one that comes near the eye's own plane reaches past any picture.
    `rate` is pixels for a metre along `side`, all that an orthographic view needs.
    """
    sine = min(radius / max(distance, TINY), f32(0.999))
    cosine = math.sqrt(ONE - sine * sine)
    x, y = sine * side.x - cosine * viewer.x, sine * side.y - cosine * viewer.y
    z = cosine * viewer.z - sine * side.z
    inv = ONE / max(z, NEAR_PLANE)
    columns, rows = (x * inv - s.left) / s.step_x - column, (s.top - y * inv) / s.step_y - row
    far = math.sqrt(columns * columns + rows * rows) if z > NEAR_PLANE else BEYOND_PX
    return radius * rate if s.projection == ORTHOGRAPHIC else far


@device_jit
def exit_px(height, width, column, row, columns, rows):
    """Pixels from (column, row) to the picture's edge along the unit screen direction (columns, rows)."""
    across = (width - column if columns > ZERO else column) / max(abs(columns), f32(1e-9))
    down = (height - row if rows > ZERO else row) / max(abs(rows), f32(1e-9))
    return min(across, down)
