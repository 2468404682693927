"""Filters for reflections: as wide as the lobe is blurred, never across planes, normals or roughnesses.

Moving a pixel by x along its surface moves what it reflects, at the distance t, by about x (1 + t / D), with D the distance
of the viewer; a lobe of GGX alpha blurs what is there over about alpha t. So neighbours within

    sigma = reach alpha / (1 / t + 1 / D)

show nearly the same blurred picture: none in a mirror, few where something stands on the surface (a reflection is sharp at
its foot), many far from it. A normal that differs by e turns the mirror direction by 2 e, which is weighed against alpha.
Pixels lie on lattices of step 1, 2, 4...: rough surfaces are traced at every fourth pixel only.
"""

from __future__ import annotations

import math

import numpy as np

from .jit import device_jit, pixel_jit, prange
from .vec3 import ONE, ZERO, dot, f32, load_pixel, sub

LEAST_ALPHA2 = f32(1e-6)    # of the weights: a mirror takes nothing but itself
# columns of a pixel: light of hit surfaces by colour, light of emissive surfaces and the world by colour, then
SHARE, NEARNESS = 6, 7      # how much of the lobe is known, and the mean of 1 / length of its rays in 1/m
FILTERED = 7                # what is filtered: all but NEARNESS
WEAK = f32(0.05)            # below this weight a pixel found no like neighbour on the lattice
FARTHEST = f32(-7)          # exponent of the weight e^-7 below which a neighbour is not looked at
LEAST_SIGMA = f32(0.15)     # a filter narrower than this share of the plane's tolerance, a quarter of a pixel, does nothing


@device_jit
def _likeness(p, n, alpha, q, m, other, rcp_tolerance):
    """Weight in [0, 1] of a neighbour at q, normal m, GGX alpha `other`: nearness to the plane, likeness of the two."""
    cosine = dot(n, m)
    if cosine <= ZERO:
        return ZERO
    turned = f32(4) * (ONE - cosine) / (alpha * alpha + LEAST_ALPHA2)
    rougher = (other - alpha) / (f32(0.3) * alpha + f32(0.01))
    return math.exp(-abs(dot(n, sub(q, p))) * rcp_tolerance - turned - rougher * rougher)


@device_jit
def _mean_nearness(results, traced, i, j, s):
    """Mean of 1 / length of the rays of the 3x3 traced pixels around (i, j): one ray alone is no measure of it."""
    near, count = ZERO, ZERO
    for u in range(max(i - s, 0), min(i + s + 1, traced.shape[0]), s):
        for v in range(max(j - s, 0), min(j + s + 1, traced.shape[1]), s):
            if traced[u, v]:
                near += results[u, v, NEARNESS]
                count += ONE
    return near / count


@pixel_jit
def smooth_reflections(results, traced, step, position, normal, roughness, distance, rcp_tolerance, radius, reach):
    """(H, W, FILTERED) float32 for traced pixels: mean of the like neighbours within the blur of the lobe.

    `distance` (H, W) m to the viewer, +inf for parallel rays; `radius` in steps.
    """
    height, width = traced.shape
    out = np.zeros((height, width, FILTERED), np.float32)
    for i in prange(height):
        for j in range(width):
            if not traced[i, j]:
                continue
            for c in range(FILTERED):
                out[i, j, c] = results[i, j, c]
            p, n, s = load_pixel(position, i, j), load_pixel(normal, i, j), step[i, j]
            alpha = roughness[i, j] * roughness[i, j]
            near = _mean_nearness(results, traced, i, j, s)
            sigma = reach * alpha / max(near + ONE / distance[i, j], f32(1e-20))
            if sigma * rcp_tolerance[i, j] < LEAST_SIGMA:
                continue
            sharp, total = -f32(0.5) / (sigma * sigma), ONE
            for u in range(max(i - radius * s, i % s), min(i + radius * s + 1, height), s):
                for v in range(max(j - radius * s, j % s), min(j + radius * s + 1, width), s):
                    if not traced[u, v] or (u == i and v == j):
                        continue
                    q = load_pixel(position, u, v)
                    d = sub(q, p)
                    far = dot(d, d) * sharp
                    if far < FARTHEST:
                        continue
                    k = _likeness(p, n, alpha, q, load_pixel(normal, u, v), roughness[u, v] * roughness[u, v],
                                  rcp_tolerance[i, j]) * math.exp(far)
                    total += k
                    for c in range(FILTERED):
                        out[i, j, c] += k * results[u, v, c]
            for c in range(FILTERED):
                out[i, j, c] /= total
    return out


@pixel_jit
def spread_reflections(smooth, traced, step, position, normal, roughness, rcp_tolerance, weak):
    """Fill the pixels of `smooth` that were not traced from the four to sixteen around them that were; in place.

    `weak` (H, W) bool becomes True where no like neighbour was found. Pixels of step 0 do not reflect.
    """
    height, width = traced.shape
    for i in prange(height):
        for j in range(width):
            s = step[i, j]
            if s <= 1 or traced[i, j]:
                continue
            p, n = load_pixel(position, i, j), load_pixel(normal, i, j)
            alpha = roughness[i, j] * roughness[i, j]
            first_i, first_j, total = (i // s - 1) * s, (j // s - 1) * s, ZERO
            for u in range(first_i, first_i + 4 * s, s):
                for v in range(first_j, first_j + 4 * s, s):
                    if u < 0 or v < 0 or u >= height or v >= width or not traced[u, v]:
                        continue
                    tent = max(f32(2 * s) - f32(abs(u - i)), ZERO) * max(f32(2 * s) - f32(abs(v - j)), ZERO) / f32(s * s)
                    k = tent * tent * _likeness(p, n, alpha, load_pixel(position, u, v), load_pixel(normal, u, v),
                                                roughness[u, v] * roughness[u, v], rcp_tolerance[i, j])
                    total += k
                    for c in range(FILTERED):
                        smooth[i, j, c] += k * smooth[u, v, c]
            weak[i, j] = not total >= WEAK
            for c in range(FILTERED):
                smooth[i, j, c] /= max(total, f32(1e-30))
