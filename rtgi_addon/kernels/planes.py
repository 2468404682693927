"""Filters over the picture that stay on a pixel's tangent plane: depth alone tells what lies on it.

A neighbour counts by 1 - (h / t)^2, h its height over the tangent plane and t a tolerance in footprints of a pixel. What
lies a whole tolerance off does not count at all, so nothing crosses a step in depth, and a plane is averaged exactly
however it is tilted. Rows are filtered as a whole for each offset, which leaves loops over contiguous numbers.
"""

from __future__ import annotations

import math

import numpy as np

from .jit import borrowed, device_jit, inline_jit, pixel_jit
from .screen import HALF, TINY, seen_normal_vs
from .shadow import ORTHOGRAPHIC
from .vec3 import ONE, ZERO, f32

FAR = f32(1e18)             # stands for a depth where nothing is seen
ENOUGH = f32(0.05)          # weight of the four nearest lattice points below which twelve more are asked


@inline_jit
def _tangent_planes(s, i, first, every, tolerance_px, plane):
    """Rows of `plane` (6, n) for n pixels of row i, every so many from `first` on.

    View-space normal, tangent plane's offset, 1 / tolerance in m, image plane x.
    """
    step = math.sqrt(s.step_x * s.step_y) * tolerance_px
    y = s.top - (f32(i) + HALF) * s.step_y
    for k in range(plane.shape[1]):
        j = first + k * every
        depth = min(s.depth[i, j], FAR)
        x = s.left + (f32(j) + HALF) * s.step_x
        n = seen_normal_vs(s, i, j)
        scale = ONE if s.projection == ORTHOGRAPHIC else depth
        plane[0, k], plane[1, k], plane[2, k] = n.x, n.y, n.z
        plane[3, k] = (n.x * x + n.y * y) * scale - n.z * depth
        plane[4, k], plane[5, k] = ONE / max(step * scale, TINY), x


# Loops over slices from 0 on: numba lets indices be negative, and where it cannot rule that out nothing vectorises.
@device_jit
def _weigh(plane, xs, y, depth, is_parallel, most, out):
    """Weights in [0, most] of neighbours at image plane coordinates (xs, y) and a depth, into the first numbers of `out`."""
    n_x, n_y, n_z, offset, rcp_tolerance = plane[0], plane[1], plane[2], plane[3], plane[4]
    for j in range(depth.shape[0]):
        d = min(depth[j], FAR)
        scale = ONE if is_parallel else d
        h = ((n_x[j] * xs[j] + n_y[j] * y) * scale - n_z[j] * d - offset[j]) * rcp_tolerance[j]
        out[j] = most * max(ZERO, ONE - h * h)


@device_jit
def _add(sums, weight, values):
    """sums += weight * values"""
    for j in range(sums.shape[0]):
        sums[j] += weight[j] * values[j]


@pixel_jit
def _smooth_planes(begin, end, s, values, radius, tolerance_px, out):
    s, = borrowed((s,))
    channels, height, width = values.shape
    is_parallel = s.projection == ORTHOGRAPHIC
    for i in range(begin, end):
        plane, weight, total = np.empty((6, width), np.float32), np.empty(width, np.float32), np.zeros(width, np.float32)
        sums = np.zeros((channels, width), np.float32)
        _tangent_planes(s, i, 0, 1, tolerance_px, plane)
        xs, ones = plane[5], np.ones(width, np.float32)
        for u in range(max(i - radius, 0), min(i + radius + 1, height)):
            y, depth = s.top - (f32(u) + HALF) * s.step_y, s.depth[u]
            for dv in range(-radius, radius + 1):
                first, last = max(0, -dv), min(width, width - dv)
                _weigh(plane[:, first:last], xs[first + dv:last + dv], y, depth[first + dv:last + dv], is_parallel, ONE,
                       weight)
                for c in range(channels):
                    _add(sums[c, first:last], weight, values[c, u, first + dv:last + dv])
                _add(total[first:last], weight, ones)
        for c in range(channels):
            for j in range(width):
                if s.depth[i, j] < FAR and total[j] > ZERO:
                    out[c, i, j] = sums[c, j] / total[j]


def smooth_planes(s, values, radius, tolerance_px):
    """Means of `values` (C, H, W) float32 over the (2 radius + 1)^2 neighbours on each pixel's tangent plane.

    `s` is a Screen of the same size. Where nothing is seen the values stay.
    """
    channels, height, width = values.shape
    out = values.copy()
    _smooth_planes(height, s, values, radius, tolerance_px, out)
    return out


@inline_jit
def _spread_to_pixel(coarse, values, plane, k, fi, fj, sums):
    """Value at lattice coordinates (fi, fj) into `sums` (C,), from up to sixteen points; plane[:, k] is the pixel's own.

    Returns the weight to divide it by.
    """
    channels, h, w = values.shape
    is_parallel = coarse.projection == ORTHOGRAPHIC
    i0, j0 = int(math.floor(fi)), int(math.floor(fj))
    total, best, best_off = ZERO, -1, FAR
    for c in range(channels):
        sums[c] = ZERO
    for ring in range(2):
        for u in range(max(i0 - ring, 0), min(i0 + 2 + ring, h)):
            for v in range(max(j0 - ring, 0), min(j0 + 2 + ring, w)):
                if ring == 1 and i0 <= u <= i0 + 1 and j0 <= v <= j0 + 1:
                    continue
                x, y = coarse.left + (f32(v) + HALF) * coarse.step_x, coarse.top - (f32(u) + HALF) * coarse.step_y
                depth = min(coarse.depth[u, v], FAR)
                scale = ONE if is_parallel else depth
                off = abs((plane[0, k] * x + plane[1, k] * y) * scale - plane[2, k] * depth - plane[3, k]) * plane[4, k]
                if depth < FAR and (best < 0 or off < best_off):
                    best, best_off = u * w + v, off
                reach = f32(1 + ring)
                weight = max(ZERO, reach - abs(fi - f32(u))) * max(ZERO, reach - abs(fj - f32(v)))
                weight *= max(ZERO, ONE - off * off)
                total += weight
                for c in range(channels):
                    sums[c] += weight * values[c, u, v]
        if total > ENOUGH:
            return total
    if not total > ZERO:
        total = ONE
        for c in range(channels):
            sums[c] = values[c, best // w, best % w] if best >= 0 else (ONE if c == 0 else ZERO)
    return total


@pixel_jit
def _spread_planes(begin, end, s, coarse, values, step, tolerance_px, out):
    s, coarse = borrowed((s, coarse))
    channels, h, w = values.shape
    height, width = s.depth.shape
    is_parallel, first = s.projection == ORTHOGRAPHIC, step // 2
    longest = (width - 1) // step + 1
    room, weight, single = np.empty((6, longest), np.float32), np.empty(longest, np.float32), np.empty(channels, np.float32)
    sums, total = np.empty((channels, longest), np.float32), np.empty(longest, np.float32)
    xs, ones = np.empty(w, np.float32), np.ones(longest, np.float32)
    for v in range(w):
        xs[v] = coarse.left + (f32(v) + HALF) * coarse.step_x
    for i in range(begin, end):
        fi = f32(i - first) / f32(step)
        i0 = int(math.floor(fi))
        # pixels that lie alike between lattice points lie beside a whole row of them
        for start in range(min(step, width)):
            number, before = (width - 1 - start) // step + 1, -1 if start < first else 0
            part = f32(start - first) / f32(step) - f32(before)
            plane = room[:, :number]
            _tangent_planes(s, i, start, step, tolerance_px * f32(step), plane)
            total[:] = ZERO
            sums[:] = ZERO
            for u in range(max(i0, 0), min(i0 + 2, h)):
                y, depth = coarse.top - (f32(u) + HALF) * coarse.step_y, coarse.depth[u]
                for side in range(2):
                    v = before + side
                    low, high = max(0, -v), min(number, w - v)
                    tent = (ONE - abs(fi - f32(u))) * (part if side == 1 else ONE - part)
                    _weigh(plane[:, low:high], xs[low + v:high + v], y, depth[low + v:high + v], is_parallel, tent, weight)
                    for c in range(channels):
                        _add(sums[c, low:high], weight, values[c, u, low + v:high + v])
                    _add(total[low:high], weight, ones)
            for k in range(number):
                j = start + k * step
                if not s.depth[i, j] < FAR:
                    for c in range(channels):
                        out[c, i, j] = ONE if c == 0 else ZERO
                elif total[k] > ENOUGH:
                    for c in range(channels):
                        out[c, i, j] = sums[c, k] / total[k]
                else:
                    rest = _spread_to_pixel(coarse, values, plane, k, fi, f32(k + before) + part, single)
                    for c in range(channels):
                        out[c, i, j] = single[c] / rest


def spread_planes(s, coarse, values, step, tolerance_px):
    """Values (C, h, w) of a lattice, every `step`-th pixel from step // 2 on, at the pixels of `s`: (C, H, W) float32.

    `coarse` is the Screen of the lattice. The four nearest points count by their nearness and by the tangent plane; where
    they do not lie on it, the twelve around them are asked, and where none does, the one that lies least off counts alone.
    """
    channels, h, w = values.shape
    height, width = s.depth.shape
    out = np.zeros((channels, height, width), np.float32)
    _spread_planes(height, s, coarse, values, step, tolerance_px, out)
    return out
