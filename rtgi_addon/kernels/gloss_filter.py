"""Filters for reflections: as wide as the lobe is blurred, never across planes, normals or roughnesses.

Moving a pixel by x along its surface moves what it reflects, at the distance t, by about x (1 + t / D), with D the distance of
the viewer; a lobe of GGX alpha blurs what is there over about alpha t. So neighbours within

    sigma = reach alpha / (1 / t + 1 / D)

show nearly the same blurred picture: none in a mirror, few where something stands on the surface (a reflection is sharp at
its foot), many far from it. A normal that differs by e turns the mirror direction by 2 e, which is weighed against alpha.
Pixels lie on lattices of step 1, 2, 4...: rough surfaces are traced at every fourth pixel only.
"""

from __future__ import annotations

import math

import numpy as np

from .jit import device_jit, pixel_jit, prange
from .reflect import MEANS, NEARNESS, VARIANCE
from .vec3 import ONE, ZERO, dot, f32, load_pixel, sub

LEAST_ALPHA2 = f32(1e-6)    # of the weights: a mirror takes nothing but itself
FILTERED = 7                # columns of a filtered pixel: MEANS and SHARE
WEAK = f32(0.05)            # below this weight a pixel found no like neighbour on the lattice
LEAST_WEIGHT = f32(1e-3)


@device_jit
def _likeness(p, n, alpha, q, m, other, rcp_tolerance):
    """Weight in [0, 1] of a neighbour at q with normal m and lobe width `other`: nearness to the plane, normal, roughness."""
    cosine = dot(n, m)
    if cosine <= ZERO:
        return ZERO
    turned = f32(4) * (ONE - cosine) / (alpha * alpha + LEAST_ALPHA2)
    rougher = (other - alpha) / (f32(0.3) * alpha + f32(0.01))
    return math.exp(-abs(dot(n, sub(q, p))) * rcp_tolerance - turned - rougher * rougher)


@pixel_jit
def pilot_reflections(results, traced, step, position, normal, roughness, rcp_tolerance):
    """(H, W, 3) float32 for traced pixels: mean brightness of the 3x3 like neighbours, its variance, their mean nearness.

    A pixel with one ray knows no variance of its own; there the neighbours' spread tells it.
    """
    height, width = traced.shape
    out = np.zeros((height, width, 3), np.float32)
    for i in prange(height):
        for j in range(width):
            if not traced[i, j]:
                continue
            p, n, s = load_pixel(position, i, j), load_pixel(normal, i, j), step[i, j]
            alpha = roughness[i, j] * roughness[i, j]
            total, mean, variance, near, squares, shares = ZERO, ZERO, ZERO, ZERO, ZERO, ZERO
            for u in range(i - s, i + s + 1, s):
                for v in range(j - s, j + s + 1, s):
                    if u < 0 or v < 0 or u >= height or v >= width or not traced[u, v]:
                        continue
                    k = _likeness(p, n, alpha, load_pixel(position, u, v), load_pixel(normal, u, v),
                                  roughness[u, v] * roughness[u, v], rcp_tolerance[i, j])
                    x = ZERO
                    for c in range(6):
                        x += results[u, v, MEANS + c]
                    total += k
                    shares += k * k
                    mean += k * x
                    squares += k * x * x
                    near += k * results[u, v, NEARNESS]
                    variance += k * k * results[u, v, VARIANCE] * f32(9)
            mean, near = mean / total, near / total
            spread = max(squares / total - mean * mean, ZERO) * shares / (total * total)
            variance = variance / (total * total)
            out[i, j, 0], out[i, j, 1], out[i, j, 2] = mean, variance if variance > ZERO else spread, near
    return out


@pixel_jit
def smooth_reflections(results, pilot, traced, step, position, normal, roughness, distance, rcp_tolerance, radius, reach,
                       contrast):
    """(H, W, FILTERED) float32 for traced pixels: mean of the like neighbours within the blur of the lobe.

    `distance` (H, W) m to the viewer, +inf for parallel rays; `radius` in steps; `contrast` in standard deviations of noise:
    neighbours whose pilot mean differs by more count less.
    """
    height, width = traced.shape
    out = np.zeros((height, width, FILTERED), np.float32)
    for i in prange(height):
        for j in range(width):
            if not traced[i, j]:
                continue
            p, n, s = load_pixel(position, i, j), load_pixel(normal, i, j), step[i, j]
            alpha = roughness[i, j] * roughness[i, j]
            sigma = reach * alpha / max(pilot[i, j, 2] + ONE / distance[i, j], f32(1e-20))
            sharp = -f32(0.5) / max(sigma * sigma, f32(1e-30))
            mine, noise = pilot[i, j, 0], pilot[i, j, 1]
            total = ONE
            for c in range(FILTERED):
                out[i, j, c] = results[i, j, c]
            for u in range(i - radius * s, i + radius * s + 1, s):
                for v in range(j - radius * s, j + radius * s + 1, s):
                    if u < 0 or v < 0 or u >= height or v >= width or not traced[u, v] or (u == i and v == j):
                        continue
                    q = load_pixel(position, u, v)
                    d = sub(q, p)
                    far = dot(d, d) * sharp
                    if far < f32(-7):            # e^-7 is below LEAST_WEIGHT
                        continue
                    k = _likeness(p, n, alpha, q, load_pixel(normal, u, v), roughness[u, v] * roughness[u, v],
                                  rcp_tolerance[i, j]) * math.exp(far)
                    if k < LEAST_WEIGHT:
                        continue
                    difference = pilot[u, v, 0] - mine
                    k *= math.exp(-difference * difference / (contrast * contrast * (pilot[u, v, 1] + noise)
                                                              + f32(1e-4) * mine * mine + f32(1e-30)))
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
