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
from typing import NamedTuple

import numpy as np

from .filters import falloff
from .jit import borrowed, device_jit, inline_jit, pixel_jit, scratch
from .reflect import NEARNESS, SHARE
from .screen import seen_vs
from .shadow import ORTHOGRAPHIC
from .vec3 import ONE, ZERO, Vec3, dot, f32, length, load_pixel, sub

FILTERED = 8                # columns of a pixel that are filtered: all but the nearness
PLANE_TOLERANCE_PX = f32(1.6)       # how far off the tangent plane, in widths of a step, a neighbour still counts e^-1
LEAST_ALPHA2 = f32(1e-6)    # of the weights: a mirror takes nothing but itself
WEAK = f32(0.05)            # below this weight a pixel found no like neighbour on the lattice
UNREST = f32(0.5)           # standard deviation of the neighbours over their mean from which a sharp pixel is traced itself
APART = f32(1)              # sigma in steps below which a pixel is sharp: its neighbours lie farther apart
WIDE = f32(1e30)
FARTHEST = f32(12)          # squared distance in sigmas from which a neighbour is not looked at: its weight is 1/400
LEAST_SIGMA = f32(0.25)     # a filter narrower than this share of a step does nothing


@device_jit
def _width_m(s, i, j):
    """Width of pixel (i, j) in m where it meets its surface, facing the camera."""
    step = math.sqrt(s.step_x * s.step_y)
    return step if s.projection == ORTHOGRAPHIC else step * s.depth[i, j]


class _Own(NamedTuple):
    """What a pixel compares its neighbours with: position, normal, alpha, and one over the scales of their differences."""

    p: Vec3
    n: Vec3
    alpha: np.float32
    rcp_off: np.float32
    rcp_turned: np.float32
    rcp_rougher: np.float32


@inline_jit
def _own(s, roughness, i, j, step_m):
    alpha = roughness[i, j] * roughness[i, j]
    return _Own(load_pixel(s.position_ws, i, j), load_pixel(s.normal_ws, i, j), alpha, ONE / (PLANE_TOLERANCE_PX * step_m),
                f32(4) / (alpha * alpha + LEAST_ALPHA2), ONE / (f32(0.3) * alpha + f32(0.01)))


@inline_jit
def _difference(own, s, roughness, u, v):
    """How unlike pixel (u, v) is, 0 and more: distance to the plane, difference of normal and roughness."""
    cosine = dot(own.n, load_pixel(s.normal_ws, u, v))
    if not cosine > ZERO:
        return WIDE
    off = abs(dot(own.n, sub(load_pixel(s.position_ws, u, v), own.p))) * own.rcp_off
    rougher = (roughness[u, v] * roughness[u, v] - own.alpha) * own.rcp_rougher
    return off + (ONE - cosine) * own.rcp_turned + rougher * rougher


@pixel_jit
def _blur_of_pixels(begin, end, results, screen, roughness, step, traced, reach, out):
    screen, = borrowed((screen,))
    height, width = traced.shape
    for i in range(begin, end):
        for j in range(width):
            if not traced[i, j]:
                continue
            s, near = step[i, j], ZERO
            for u in range(max(i - s, i % s), min(i + s + 1, height), s):
                for v in range(max(j - s, j % s), min(j + s + 1, width), s):
                    if traced[u, v]:
                        near = max(near, results[u, v, NEARNESS])
            if screen.projection != ORTHOGRAPHIC:
                near += ONE / length(seen_vs(screen, i, j))
            out[i, j] = reach * roughness[i, j] * roughness[i, j] / max(near, f32(1e-20))


def blur_of_pixels(results, screen, roughness, step, traced, reach):
    """(H, W) float32 m: sigma of each traced pixel, by the nearest that its 3x3 traced neighbours see (see the module)."""
    height, width = traced.shape
    out = np.zeros((height, width), np.float32)
    _blur_of_pixels(height, results, screen, roughness, step, traced, reach, out)
    return out


@pixel_jit
def _smooth_reflections(begin, end, results, blur, wanted, screen, roughness, step, traced, radius, out):
    screen, = borrowed((screen,))
    height, width = traced.shape
    sums = scratch(FILTERED, np.float32)
    for i in range(begin, end):
        for j in range(width):
            if not wanted[i, j]:
                continue
            for c in range(FILTERED):
                sums[c] = out[i, j, c] = results[i, j, c]
            s = step[i, j]
            step_m = _width_m(screen, i, j) * f32(s)
            if blur[i, j] < LEAST_SIGMA * step_m:
                continue
            own, total = _own(screen, roughness, i, j, step_m), ONE
            for u in range(max(i - radius * s, i % s), min(i + radius * s + 1, height), s):
                for v in range(max(j - radius * s, j % s), min(j + radius * s + 1, width), s):
                    if not traced[u, v] or (u == i and v == j):
                        continue
                    d, sigma = sub(load_pixel(screen.position_ws, u, v), own.p), min(blur[i, j], blur[u, v])
                    if not dot(d, d) < FARTHEST * sigma * sigma:
                        continue
                    k = falloff(_difference(own, screen, roughness, u, v) + f32(0.5) * dot(d, d) / (sigma * sigma))
                    total += k
                    for c in range(FILTERED):
                        sums[c] += k * results[u, v, c]
            for c in range(FILTERED):
                out[i, j, c] = sums[c] / total


def smooth_reflections(results, blur, wanted, screen, roughness, step, traced, radius):
    """(H, W, FILTERED) float32 for the `wanted` of the traced pixels: mean of the like neighbours within the lobe's blur.

    `radius` is in steps. Of two pixels the smaller blur decides, so that what stands near does not run into what is far.
    """
    height, width = traced.shape
    out = np.zeros((height, width, FILTERED), np.float32)
    _smooth_reflections(height, results, blur, wanted, screen, roughness, step, traced, radius, out)
    return out


@pixel_jit
def spread_reflections(begin, end, smooth, blur, screen, roughness, step, traced, weak):
    """Fill the pixels of `smooth` that were not traced from the sixteen around them that may have been; in place.

    `weak` (H, W) bool becomes True where that fails: where no like neighbour was found, and where neighbours differ although
    the lobe blurs less than they lie apart, as at the foot of what is reflected. Pixels of step 0 do not reflect.
    """
    screen, = borrowed((screen,))
    height, width = traced.shape
    sums = scratch(FILTERED, np.float32)
    for i in range(begin, end):
        for j in range(width):
            s = step[i, j]
            if s <= 1 or traced[i, j]:
                continue
            for c in range(FILTERED):
                sums[c] = ZERO
            step_m = _width_m(screen, i, j) * f32(s)
            own, rcp_step = _own(screen, roughness, i, j, step_m), ONE / f32(s)
            first_i, first_j, total, mean, squares, sharpest = (i // s - 1) * s, (j // s - 1) * s, ZERO, ZERO, ZERO, WIDE
            for u in range(first_i, first_i + 4 * s, s):
                for v in range(first_j, first_j + 4 * s, s):
                    if u < 0 or v < 0 or u >= height or v >= width or not traced[u, v]:
                        continue
                    tent = (f32(2) - f32(abs(u - i)) * rcp_step) * (f32(2) - f32(abs(v - j)) * rcp_step)
                    k = tent * tent * falloff(_difference(own, screen, roughness, u, v))
                    total += k
                    x = ZERO
                    for c in range(FILTERED):
                        sums[c] += k * smooth[u, v, c]
                        x += smooth[u, v, c] if c < SHARE else ZERO
                    mean += k * x
                    squares += k * x * x
                    sharpest = min(sharpest, blur[u, v])
            is_sharp = sharpest < APART * step_m
            weak[i, j] = not total >= WEAK or (is_sharp and squares * total > (ONE + UNREST * UNREST) * mean * mean)
            for c in range(FILTERED):
                smooth[i, j, c] = sums[c] / max(total, f32(1e-30))
