"""Functions of a direction as square tables: the octahedral map, which needs no trigonometry and has no poles."""

from __future__ import annotations

import numpy as np

from .jit import device_jit, pixel_jit
from .vec3 import ONE, ZERO, f32, load_pixel

HALF = f32(0.5)


@device_jit
def fold(d):
    """(u, v) in [0, 1] of a direction d of any length but 0: the octahedron |x| + |y| + |z| = 1 unfolded to a square."""
    inv = ONE / max(abs(d.x) + abs(d.y) + abs(d.z), f32(1e-30))
    u, v = d.x * inv, d.y * inv
    out_u, out_v = (ONE - abs(v)) * (ONE if u >= ZERO else -ONE), (ONE - abs(u)) * (ONE if v >= ZERO else -ONE)
    u, v = (out_u, out_v) if d.z < ZERO else (u, v)
    return HALF + HALF * u, HALF + HALF * v


def node_directions(size: int) -> np.ndarray:
    """(size, size, 3) float64 unit directions of the nodes of a table: row by v, column by u, corners included."""
    u, v = np.meshgrid(np.linspace(-1, 1, size), np.linspace(-1, 1, size))
    z = 1 - np.abs(u) - np.abs(v)
    fold_u, fold_v = (1 - np.abs(v)) * np.where(u >= 0, 1, -1), (1 - np.abs(u)) * np.where(v >= 0, 1, -1)
    out = np.stack([np.where(z < 0, fold_u, u), np.where(z < 0, fold_v, v), z], -1)
    return out / np.linalg.norm(out, axis=-1, keepdims=True)


@device_jit
def table_at(table, d):
    """Three numbers of a `table` (n, n, 3) in direction d, linear between its nodes."""
    last = table.shape[0] - 1
    u, v = fold(d)
    x, y = u * f32(last), v * f32(last)
    a, b = int(max(ZERO, min(x, f32(last - 1)))), int(max(ZERO, min(y, f32(last - 1))))     # in this order also for NaN
    fx, fy = x - f32(a), y - f32(b)
    w00, w01, w10, w11 = (ONE - fx) * (ONE - fy), fx * (ONE - fy), (ONE - fx) * fy, fx * fy
    return (w00 * table[b, a, 0] + w01 * table[b, a + 1, 0] + w10 * table[b + 1, a, 0] + w11 * table[b + 1, a + 1, 0],
            w00 * table[b, a, 1] + w01 * table[b, a + 1, 1] + w10 * table[b + 1, a, 1] + w11 * table[b + 1, a + 1, 1],
            w00 * table[b, a, 2] + w01 * table[b, a + 1, 2] + w10 * table[b + 1, a, 2] + w11 * table[b + 1, a + 1, 2])


@pixel_jit
def _look_up(begin, end, table, direction, mask, out):
    height, width = mask.shape
    for i in range(begin, end):
        for j in range(width):
            if mask[i, j]:
                out[i, j, 0], out[i, j, 1], out[i, j, 2] = table_at(table, load_pixel(direction, i, j))


def look_up(table, direction, mask):
    """(H, W, 3) float32: `table` (n, n, 3) at directions (H, W, 3), linear between its nodes; zero outside `mask` (H, W)."""
    height, width = mask.shape
    out = np.zeros((height, width, 3), np.float32)
    _look_up(height, table, direction, mask, out)
    return out


@pixel_jit
def _weighted_sums(begin, end, weights, red, green, blue, out):
    for m in range(begin, end):
        row, sum_red, sum_green, sum_blue = weights[m], ZERO, ZERO, ZERO
        for k in range(row.shape[0]):
            sum_red += row[k] * red[k]
            sum_green += row[k] * green[k]
            sum_blue += row[k] * blue[k]
        out[m, 0], out[m, 1], out[m, 2] = sum_red, sum_green, sum_blue


def table_of(weights, values):
    """(n, n, 3) float32 for `table_at`: at each of its nodes the sum of `values` (..., 3) by `weights` (n^2, K).

    The same as a product of matrices, whose library would start threads of its own: they wait for more work for 50 ms and
    take the processors from the kernels that follow.
    """
    size, planes = round(weights.shape[0] ** 0.5), np.ascontiguousarray(values.reshape(-1, 3).T, np.float32)
    out = np.empty((weights.shape[0], 3), np.float32)
    _weighted_sums(weights.shape[0], weights, planes[0], planes[1], planes[2], out)
    return out.reshape(size, size, 3)
