"""Filters between a lattice of gather points and the pixels, aware of planes and normals. They work on irradiance only."""

from __future__ import annotations

import math

import numpy as np

from .jit import device_jit, inline_jit, pixel_jit, scratch
from .vec3 import ONE, ZERO, dot, f32, load_pixel, sub, tangent_frame

WEAK = f32(0.05)            # below this weight a pixel found no like neighbour on the lattice
TWO = f32(2)


@inline_jit
def falloff(x):
    """e^-x for x >= 0 as (1 - x / 8)^8, within 0.03 and 0 from 8 on; the library's exp took a third of the filters' time."""
    a = max(ONE - x * f32(0.125), ZERO)
    a *= a
    a *= a
    return a * a


@pixel_jit
def _spread_lattice(begin, end, values, position_l, normal_l, mask_l, position, normal, mask, rcp_tolerance, step, unrest,
                    out, weak):
    height, width = mask.shape
    for i in range(begin, end):
        for j in range(width):
            if not mask[i, j]:
                continue
            fi, fj = f32(i - step // 2) / f32(step), f32(j - step // 2) / f32(step)
            i0, j0 = int(math.floor(fi)), int(math.floor(fj))
            p, n = load_pixel(position, i, j), load_pixel(normal, i, j)
            total, red, green, blue, squares = ZERO, ZERO, ZERO, ZERO, ZERO
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
                    k = tent * tent * c8 * c8 * falloff(plane)
                    total += k
                    red += k * values[u, v, 0]
                    green += k * values[u, v, 1]
                    blue += k * values[u, v, 2]
                    squares += k * (values[u, v, 0] + values[u, v, 1] + values[u, v, 2]) ** 2
            first = red + green + blue
            weak[i, j] = total < WEAK or squares * total > (ONE + unrest * unrest) * first * first
            if total > ZERO:
                out[i, j, 0], out[i, j, 1], out[i, j, 2] = red / total, green / total, blue / total


def spread_lattice(values, position_l, normal_l, mask_l, position, normal, mask, rcp_tolerance, step, unrest):
    """Values (h, w, 3) of a lattice (every `step`-th pixel, first at step // 2) to pixels; step 1 smooths the lattice.

    Returns ((H, W, 3) float32, (H, W) bool): the filtered values, and the surface pixels that must be gathered on their
    own: they found no neighbour of like plane and normal, or their neighbours' light differs by more than `unrest` (standard
    deviation over mean). Weights: a squared tent of 4x4 points, the 16th power of the
    normals' cosine, a falloff like exp(-distance from the pixel's tangent plane * rcp_tolerance (H, W) 1/m).
    """
    height, width = mask.shape
    out, weak = np.zeros((height, width, 3), np.float32), np.zeros((height, width), np.bool_)
    _spread_lattice(height, values, position_l, normal_l, mask_l, position, normal, mask, rcp_tolerance, step, unrest, out,
                    weak)
    return out, weak


@device_jit
def _likeness(p, n, q, m, rcp_tolerance):
    """Weight in [0, 1] of a neighbour at q, normal m: 16th power of the normals' cosine, nearness to the tangent plane."""
    cosine = dot(n, m)
    if cosine <= ZERO:
        return ZERO
    c2 = cosine * cosine
    c4 = c2 * c2
    c8 = c4 * c4
    return c8 * c8 * falloff(abs(dot(n, sub(q, p))) * rcp_tolerance)


@pixel_jit
def _pilot_means(begin, end, light, position, normal, mask, rcp_tolerance, out):
    height, width = mask.shape
    for i in range(begin, end):
        for j in range(width):
            if not mask[i, j]:
                continue
            p, n = load_pixel(position, i, j), load_pixel(normal, i, j)
            total, mean, variance = ZERO, ZERO, ZERO
            for u in range(max(i - 1, 0), min(i + 2, height)):
                for v in range(max(j - 1, 0), min(j + 2, width)):
                    if mask[u, v]:
                        k = _likeness(p, n, load_pixel(position, u, v), load_pixel(normal, u, v), rcp_tolerance[i, j])
                        total += k
                        mean += k * (light[u, v, 0] + light[u, v, 1] + light[u, v, 2]) * f32(1 / 3)
                        variance += k * k * light[u, v, 4]
            out[i, j, 0], out[i, j, 1] = mean / total, variance / (total * total)


def pilot_means(light, position, normal, mask, rcp_tolerance):
    """(h, w, 2) float32: mean light (over colours) of the 3x3 like neighbours of each lattice point, and its variance."""
    height, width = mask.shape
    out = np.zeros((height, width, 2), np.float32)
    _pilot_means(height, light, position, normal, mask, rcp_tolerance, out)
    return out


@device_jit
def _solve_intercept(a, b, ridge):
    """First unknown (3 right sides) of the 4x4 normal equations a x = b, row after row; `ridge` holds the slopes near 0.

    In place.
    """
    for k in range(1, 4):
        a[5 * k] += ridge * a[0]
    for k in range(3, 0, -1):                    # eliminate the slopes, last first: what is left is the intercept
        inv = ONE / a[5 * k]
        for r in range(k):
            factor = a[4 * r + k] * inv
            for c in range(k):
                a[4 * r + c] -= factor * a[4 * k + c]
            for c in range(3):
                b[3 * r + c] -= factor * b[3 * k + c]
    inv = ONE / a[0]
    return b[0] * inv, b[1] * inv, b[2] * inv


@pixel_jit
def _regress_lattice(begin, end, light, pilot, position, normal, mask, rcp_tolerance, radius, contrast, ridge, out):
    height, width = mask.shape
    for i in range(begin, end):
        a, b, f = scratch(16, np.float32), scratch(12, np.float32), scratch(4, np.float32)
        for j in range(width):
            if not mask[i, j]:
                continue
            p, n = load_pixel(position, i, j), load_pixel(normal, i, j)
            tangent, bitangent = tangent_frame(n)
            unshadowed = light[i, j, 3]
            inv_unshadowed = ONE / max(unshadowed, f32(1e-30))
            for r in range(16):
                a[r] = ZERO
            for r in range(12):
                b[r] = ZERO
            for u in range(max(i - radius, 0), min(i + radius + 1, height)):
                for v in range(max(j - radius, 0), min(j + radius + 1, width)):
                    r2 = f32((u - i) * (u - i) + (v - j) * (v - j)) / f32((radius + 1) * (radius + 1))
                    if not mask[u, v] or r2 >= ONE:
                        continue
                    q = load_pixel(position, u, v)
                    k = _likeness(p, n, q, load_pixel(normal, u, v), rcp_tolerance[i, j])
                    if k < f32(1e-3):
                        continue
                    difference = pilot[u, v, 0] - pilot[i, j, 0]
                    noise = pilot[u, v, 1] + pilot[i, j, 1]
                    k *= falloff(difference * difference / (contrast * contrast * noise + f32(1e-4) * pilot[i, j, 0] ** 2
                                                            + f32(1e-30)))
                    k *= ONE - r2
                    d = sub(q, p)
                    f[0], f[1] = ONE, dot(d, tangent) * rcp_tolerance[i, j]
                    f[2] = dot(d, bitangent) * rcp_tolerance[i, j]
                    f[3] = max(min(light[u, v, 3] * inv_unshadowed - ONE, f32(4)), -ONE)
                    for r in range(4):
                        for c in range(r, 4):
                            a[4 * r + c] += k * f[r] * f[c]
                        for c in range(3):
                            b[3 * r + c] += k * f[r] * light[u, v, c]
            for r in range(4):
                for c in range(r):
                    a[4 * r + c] = a[4 * c + r]
            red, green, blue = _solve_intercept(a, b, ridge)
            out[i, j, 0], out[i, j, 1], out[i, j, 2] = max(red, ZERO), max(green, ZERO), max(blue, ZERO)


def regress_lattice(light, pilot, position, normal, mask, rcp_tolerance, radius, contrast, ridge):
    """Light (h, w, 5) of a lattice freed of noise: at each point the intercept of a weighted linear fit, (h, w, 3) float32.

    The fit runs over the like neighbours within `radius` in the two directions of the surface and in the unshadowed light,
    which is known without noise: where visibility is even, light follows it into corners, and where it is not, the
    slope says so (regression with a control variate; the linear form of Bitterli et al. 2016). Neighbours
    whose pilot mean differs by more than its noise count less, by `contrast` standard deviations.
    """
    height, width = mask.shape
    out = np.zeros((height, width, 3), np.float32)
    _regress_lattice(height, light, pilot, position, normal, mask, rcp_tolerance, radius, contrast, ridge, out)
    return out


@pixel_jit
def _smooth_marked(begin, end, light, marked, position, normal, mask, rcp_tolerance, before):
    height, width = mask.shape
    for i in range(begin, end):
        for j in range(width):
            if not marked[i, j]:
                continue
            p, n = load_pixel(position, i, j), load_pixel(normal, i, j)
            total, red, green, blue = ZERO, ZERO, ZERO, ZERO
            for u in range(max(i - 2, 0), min(i + 3, height)):
                for v in range(max(j - 2, 0), min(j + 3, width)):
                    if mask[u, v]:
                        k = _likeness(p, n, load_pixel(position, u, v), load_pixel(normal, u, v), rcp_tolerance[i, j])
                        total += k
                        red += k * before[u, v, 0]
                        green += k * before[u, v, 1]
                        blue += k * before[u, v, 2]
            if total > ZERO:
                light[i, j, 0], light[i, j, 1], light[i, j, 2] = red / total, green / total, blue / total


def smooth_marked(light, marked, position, normal, mask, rcp_tolerance):
    """In place: the `marked` pixels of (H, W, 3) light become the mean of their 5x5 neighbours of like plane and normal.

    They were gathered one by one, each with noise of its own, and lie in a row along a crease.
    """
    height, width = mask.shape
    before = light.copy()
    _smooth_marked(height, light, marked, position, normal, mask, rcp_tolerance, before)
