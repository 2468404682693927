"""Three numbers with names: measured to cost nothing in numba against hand-written scalars."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .jit import device_jit

f32 = np.float32
ZERO, ONE = f32(0), f32(1)


class Vec3(NamedTuple):
    """A point, vector or normal of float32."""

    x: np.float32
    y: np.float32
    z: np.float32


def vector(values: np.ndarray) -> Vec3:
    """A (3,) array as the kernels' vector; not for use inside kernels."""
    return Vec3(*(f32(v) for v in values))


@device_jit
def load(a, i):
    """Row i of an (N, 3) array."""
    return Vec3(a[i, 0], a[i, 1], a[i, 2])


@device_jit
def load_column(a, row, i):
    """Rows row to row + 2 of column i of an (R, N) table."""
    return Vec3(a[row, i], a[row + 1, i], a[row + 2, i])


@device_jit
def load_pixel(a, i, j):
    """Pixel (i, j) of an (H, W, 3) image."""
    return Vec3(a[i, j, 0], a[i, j, 1], a[i, j, 2])


@device_jit
def add(a, b):
    """a + b"""
    return Vec3(a.x + b.x, a.y + b.y, a.z + b.z)


@device_jit
def sub(a, b):
    """a - b"""
    return Vec3(a.x - b.x, a.y - b.y, a.z - b.z)


@device_jit
def scaled(a, s):
    """s a, for a scalar s"""
    return Vec3(a.x * s, a.y * s, a.z * s)


@device_jit
def along(o, d, t):
    """o + t d"""
    return Vec3(o.x + t * d.x, o.y + t * d.y, o.z + t * d.z)


@device_jit
def lifted(p, n, offset_m):
    """p moved along n by `offset_m`, or by eight units in the last place of its coordinates where those are larger."""
    return along(p, n, max(offset_m, f32(1e-6) * max(abs(p.x), max(abs(p.y), abs(p.z)))))


@device_jit
def begun(o, d, offset_m):
    """The start o of a ray along d moved on by `offset_m`: in a crease rounding may put o behind the other surface."""
    return along(o, d, offset_m / max(math.sqrt(dot(d, d)), f32(1e-30)))


@device_jit
def dot(a, b):
    """Scalar product."""
    return a.x * b.x + a.y * b.y + a.z * b.z


@device_jit
def cross(a, b):
    """Vector product, right-handed."""
    return Vec3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x)


@device_jit
def length(a):
    """|a|, in the unit of a."""
    return math.sqrt(dot(a, a))


@device_jit
def normalized_or(a, fallback):
    """a / |a|, or `fallback` where |a| is 0 or not finite."""
    n = dot(a, a)
    if n > ZERO and n < f32(3e38):
        return scaled(a, ONE / math.sqrt(n))
    return fallback


@device_jit
def tangent_frame(n):
    """Two unit vectors that make a right-handed frame with the unit normal n (Duff et al. 2017, without branches)."""
    sign = ONE if n.z >= ZERO else -ONE
    a = -ONE / (sign + n.z)
    b = n.x * n.y * a
    return (Vec3(ONE + sign * n.x * n.x * a, sign * b, -sign * n.x),
            Vec3(b, sign + n.y * n.y * a, -n.y))


@device_jit
def to_world(local, tangent, bitangent, normal):
    """A vector of the tangent frame in world space."""
    return Vec3(local.x * tangent.x + local.y * bitangent.x + local.z * normal.x,
                local.x * tangent.y + local.y * bitangent.y + local.z * normal.y,
                local.x * tangent.z + local.y * bitangent.z + local.z * normal.z)


@device_jit
def moved_by(m, p):
    """Point p through a (3, 4) or (4, 4) matrix."""
    return Vec3(m[0, 0] * p.x + m[0, 1] * p.y + m[0, 2] * p.z + m[0, 3],
                m[1, 0] * p.x + m[1, 1] * p.y + m[1, 2] * p.z + m[1, 3],
                m[2, 0] * p.x + m[2, 1] * p.y + m[2, 2] * p.z + m[2, 3])


@device_jit
def turned_by(m, d):
    """Direction d through the rotation of a matrix."""
    return Vec3(m[0, 0] * d.x + m[0, 1] * d.y + m[0, 2] * d.z, m[1, 0] * d.x + m[1, 1] * d.y + m[1, 2] * d.z,
                m[2, 0] * d.x + m[2, 1] * d.y + m[2, 2] * d.z)


@device_jit
def turned_back_by(m, d):
    """Direction d through the inverse of the rotation of a matrix."""
    return Vec3(m[0, 0] * d.x + m[1, 0] * d.y + m[2, 0] * d.z, m[0, 1] * d.x + m[1, 1] * d.y + m[2, 1] * d.z,
                m[0, 2] * d.x + m[1, 2] * d.y + m[2, 2] * d.z)
