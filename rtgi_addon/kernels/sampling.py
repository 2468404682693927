"""Numbers that look random but are functions of (pixel, sample, seed): the same for every order and number of threads.

And the weight by which two techniques share the senders around a point, `near_weight`.
"""

from __future__ import annotations

import math

import numpy as np

from .fastmath import on_circle
from .jit import device_jit
from .vec3 import ONE, ZERO, Vec3, f32

PLACE_BITS = 20
PLACE_MASK = (1 << PLACE_BITS) - 1
_LOW = np.uint64(0xFFFFFFFF)


@device_jit
def uniform(a, b, c):
    """Hash of three integers to [0, 1); integer arithmetic only (constants of the lowbias32 family)."""
    h = (np.uint64(a) * np.uint64(0x9E3779B1) + np.uint64(b) * np.uint64(0x85EBCA77)
         + np.uint64(c) * np.uint64(0xC2B2AE3D)) & _LOW
    h = ((h ^ (h >> np.uint64(15))) * np.uint64(0x2C1B3C6D)) & _LOW
    h = ((h ^ (h >> np.uint64(12))) * np.uint64(0x297A2D39)) & _LOW
    return f32((h ^ (h >> np.uint64(15))) >> np.uint64(8)) * f32(1 / 16777216)


def place_ids(shape: tuple[int, int]) -> np.ndarray:
    """(H, W) int64 `place_id` of the places of a grid."""
    return (np.arange(shape[0], dtype=np.int64)[:, None] << PLACE_BITS) + np.arange(shape[1])


@device_jit
def place_id(row, column):
    """A grid's place as one number, which `dither` takes."""
    return (np.int64(row) << PLACE_BITS) + np.int64(column)


@device_jit
def dither(place, seed, k):
    """Number in [0, 1) of a grid's place whose gaps its neighbours' numbers fill; a hash of `seed` and k shifts it.

    Numbers of a block of n places lie about 1 / n apart, so what they are spent on has little noise once a filter has
    averaged over the block. k mod 3 chooses one of three patterns: 0 and 2 are the plane's R2 sequence (Roberts 2018) laid
    over the grid, and pairs of 0 and 1 fill the square: those constants keep the pairs of any block of 4 to 8 a side
    farthest apart.
    """
    i, j = np.float64(place >> PLACE_BITS), np.float64(place & PLACE_MASK)
    pattern = k % 3
    if pattern == 0:
        value = i * 0.5698402909980532 + j * 0.7548776662466927
    elif pattern == 1:
        value = i * 0.361991 + j * 0.442725
    else:
        value = i * 0.7548776662466927 + j * 0.5698402909980532
    value += np.float64(uniform(seed, k, 0x5EED))
    return min(f32(value - math.floor(value)), f32(0.99999994))


@device_jit
def r2_sequence(i, shift_u, shift_v):
    """Point i of the two-dimensional R2 sequence (Roberts 2018), shifted by a number of [0, 1) an axis."""
    u, v = np.float64(i) * 0.7548776662466927 + np.float64(shift_u), np.float64(i) * 0.5698402909980532 + np.float64(shift_v)
    return min(f32(u - math.floor(u)), f32(0.99999994)), min(f32(v - math.floor(v)), f32(0.99999994))


@device_jit
def disk(u, v):
    """Point of the unit disk from [0, 1)^2, by Shirley and Chiu's concentric map: neighbours stay neighbours."""
    a, b = f32(2) * u - ONE, f32(2) * v - ONE
    if a == ZERO and b == ZERO:
        return ZERO, ZERO
    if abs(a) > abs(b):
        r, turn = a, f32(0.125) * (b / a)
    else:
        r, turn = b, f32(0.25) - f32(0.125) * (a / b)
    x, y = on_circle(turn)
    return r * x, r * y


@device_jit
def cosine_hemisphere(u, v):
    """Direction of the tangent frame with density cos(theta) / pi."""
    x, y = disk(u, v)
    return Vec3(x, y, math.sqrt(max(ZERO, ONE - x * x - y * y)))


@device_jit
def uniform_sphere(u, v):
    """Unit vector with density 1 / (4 pi)."""
    z = ONE - f32(2) * u
    r = math.sqrt(max(ZERO, ONE - z * z))
    x, y = on_circle(v)
    return Vec3(r * x, r * y, z)


@device_jit
def near_weight(distance2, fade):
    """1 for senders nearer than half of a distance, 0 beyond it, smooth between; `fade` is 1 / distance^2, 0 gives 1.

    The near owner of a bounce takes this share of a sender's light, the far one the rest, so that nothing counts twice.
    """
    z = min(max((distance2 * fade - f32(0.25)) * f32(4 / 3), ZERO), ONE)
    return ONE - z * z * (f32(3) - f32(2) * z)
