"""Filters between a lattice of gather points and the pixels, aware of planes and normals. They work on irradiance only."""

from __future__ import annotations

import math

import numpy as np

from .jit import pixel_jit, prange
from .vec3 import ZERO, dot, f32, load_pixel

WEAK = f32(0.05)            # below this weight a pixel found no like neighbour on the lattice
TWO = f32(2)


@pixel_jit
def spread_lattice(values, position_l, normal_l, mask_l, position, normal, mask, rcp_tolerance, step):
    """Values (h, w, 3) of a lattice (every `step`-th pixel, first at step // 2) to pixels; step 1 smooths the lattice.

    Returns ((H, W, 3) float32, (H, W) bool): the filtered values, and the surface pixels that found no neighbour of like
    plane and normal and must be gathered on their own. Weights: a squared tent of 4x4 points, the 16th power of the
    normals' cosine, exp(-distance from the pixel's tangent plane * rcp_tolerance (H, W) 1/m).
    """
    height, width = mask.shape
    out, weak = np.zeros((height, width, 3), np.float32), np.zeros((height, width), np.bool_)
    for i in prange(height):
        for j in range(width):
            if not mask[i, j]:
                continue
            fi, fj = f32(i - step // 2) / f32(step), f32(j - step // 2) / f32(step)
            i0, j0 = int(math.floor(fi)), int(math.floor(fj))
            p, n = load_pixel(position, i, j), load_pixel(normal, i, j)
            total, red, green, blue = ZERO, ZERO, ZERO, ZERO
            for u in range(max(i0 - 1, 0), min(i0 + 3, mask_l.shape[0])):
                for v in range(max(j0 - 1, 0), min(j0 + 3, mask_l.shape[1])):
                    cosine = dot(n, load_pixel(normal_l, u, v))
                    if not mask_l[u, v] or cosine <= ZERO:
                        continue
                    plane = abs(n.x * (position_l[u, v, 0] - p.x) + n.y * (position_l[u, v, 1] - p.y)
                                + n.z * (position_l[u, v, 2] - p.z)) * rcp_tolerance[i, j]
                    tent = max(ZERO, TWO - abs(fi - f32(u))) * max(ZERO, TWO - abs(fj - f32(v)))
                    c2 = cosine * cosine
                    c4 = c2 * c2
                    c8 = c4 * c4
                    k = tent * tent * c8 * c8 * math.exp(-plane)
                    total += k
                    red += k * values[u, v, 0]
                    green += k * values[u, v, 1]
                    blue += k * values[u, v, 2]
            weak[i, j] = total < WEAK
            if total > ZERO:
                out[i, j, 0], out[i, j, 1], out[i, j, 2] = red / total, green / total, blue / total
    return out, weak
