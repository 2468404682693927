"""Rays through what the camera sees: by every pixel that they cross, by a pyramid that skips, or in even steps.

A ray is a straight line in (column, row, height), see `depth_pyramid`. In each pixel that it crosses it is

- clear, where it stays nearer to the camera than the pixel's plane,
- a hit, where it goes through the plane, or enters the pixel no more than the surface's thickness behind it,
- hidden, where it enters behind that: the camera does not see what is there.

While a ray is clear nothing can stand in its way, since the camera looks through the place where it is. So a ray that was
clear up to its hit is right without any guess of thickness, and where it becomes hidden or leaves the picture, the part
before need not be traced again. `march` can stop there, or go on as the published methods do and take a surface's thickness
for what it is told.

`march` with `top` 0 visits every crossed pixel (Amanatides and Woo 1987). With higher levels of the pyramid it visits a
cell instead of the pixels in it where the ray is clear of (or hidden behind) all of them (Uludag 2014). Its answers are
the same to the last bit, because

- the state is the pixel, two integers, and the ray's parameter s where it enters, which is always one of the numbers that
  `_crossing` gives for a whole column or row, whatever the level;
- s -> h is monotonic in floating point as well, so the heights of a cell's stretch bound those of the pixels in it;
- a pixel's test begins with its own bounds, which are what the pyramid holds.

The state is float64: at the edges of cells float32 leaves stripes, and the cost is the same.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .depth_pyramid import HEIGHT, HIGH, LOW, SLACK, SLOPE_X, SLOPE_Y
from .jit import device_jit, inline_jit
from .shadow import ORTHOGRAPHIC

HIT, HIDDEN, LEFT, ENDED = 1, 2, 3, 4
NEAR_SHARE = 1e-3           # of the origin's depth: where rays towards a perspective camera end
NO_CROSSING = 1e200         # 1 / 0 without an infinity, which times 0 would be NaN


class ScreenRay(NamedTuple):
    """A ray as a line in the picture, float64: column x + s dx, row y + s dy, height h + s dh for s in [0, 1].

    `length_m` is its length in m at s = 1 and `end` the height there; `is_parallel` tells an orthographic view.
    """

    x: float
    y: float
    h: float
    dx: float
    dy: float
    dh: float
    length_m: float
    end: float
    is_parallel: bool


@inline_jit
def ray_in_picture(s, o, u, reach_m):
    """The ScreenRay from view-space point o, in front of the camera, along unit vector u; it ends after `reach_m`.

    A ray towards the camera ends at the camera's plane, or a little before it.
    """
    ox, oy, depth = np.float64(o.x), np.float64(o.y), -np.float64(o.z)
    ux, uy, rise = np.float64(u.x), np.float64(u.y), -np.float64(u.z)
    left, top, step_x, step_y = np.float64(s.left), np.float64(s.top), np.float64(s.step_x), np.float64(s.step_y)
    length_m = np.float64(reach_m)
    if rise < 0.0:
        length_m = min(length_m, (1.0 - NEAR_SHARE) * max(depth, 0.0) / -rise)
    if s.projection == ORTHOGRAPHIC:
        x, y = (ox - left) / step_x, (top - oy) / step_y
        return ScreenRay(x, y, -depth, length_m * ux / step_x, -length_m * uy / step_y, -length_m * rise, length_m,
                         -depth - length_m * rise, True)
    depth = max(depth, 1e-30)
    h, end = 1.0 / depth, 1.0 / (depth + length_m * rise)
    x, y = (ox * h - left) / step_x, (top - oy * h) / step_y
    x1, y1 = ((ox + length_m * ux) * end - left) / step_x, (top - (oy + length_m * uy) * end) / step_y
    return ScreenRay(x, y, h, x1 - x, y1 - y, end - h, length_m, end, False)


@device_jit
def distance_at(ray, s):
    """Length of the ray in m from its origin to parameter s: perspective views shorten it by 1 / depth."""
    if ray.is_parallel:
        return s * ray.length_m
    return s * ray.length_m * ray.end / (ray.h + s * ray.dh)


@device_jit
def _inverse(x):
    return 1.0 / x if abs(x) > 1.0 / NO_CROSSING else NO_CROSSING


@device_jit
def _crossing(edge, start, inverse):
    """Parameter at which the ray crosses a whole column or row."""
    return (np.float64(edge) - start) * inverse


@device_jit
def _above_plane(planes, i, j, ray, s):
    """Height of the ray above the plane of pixel (i, j) at parameter s."""
    x, y = ray.x + s * ray.dx - (j + 0.5), ray.y + s * ray.dy - (i + 0.5)
    return ray.h + s * ray.dh - (planes[i, j, HEIGHT] + planes[i, j, SLOPE_X] * x + planes[i, j, SLOPE_Y] * y)


@inline_jit
def _meet_pixel(planes, i, j, ray, enters, leaves):
    """(HIT, HIDDEN or 0 for clear, parameter of the hit) in a pixel whose bounds did not settle it."""
    before, after = _above_plane(planes, i, j, ray, enters), _above_plane(planes, i, j, ray, leaves)
    if before > 0.0 and after > 0.0:
        return 0, leaves
    if before > 0.0:
        return HIT, enters + (leaves - enters) * before / (before - after)
    if after <= 0.0 and before >= -planes[i, j, SLACK]:
        return HIT, enters
    return HIDDEN, enters


@inline_jit
def march(pyramid, ray, i, j, top, stops_hidden):
    """(HIT, HIDDEN, LEFT or ENDED; row, column, s, steps): what becomes of a ray that starts in pixel (i, j).

    The pixel itself is not asked: a surface does not reflect itself. `top` is the highest level of the pyramid that is
    used. With `stops_hidden` the ray ends where the camera loses sight of it, at HIDDEN; without, hidden stretches are
    passed. LEFT tells that the ray left the picture at s, in the pixel given, ENDED that it was clear to its end (no pixel).
    """
    planes, bounds, first, columns = pyramid.planes, pyramid.bounds, pyramid.first, pyramid.columns
    height, width = planes.shape[0], planes.shape[1]
    inverse_x, inverse_y = _inverse(ray.dx), _inverse(ray.dy)
    goes_right, goes_down = inverse_x > 0.0, inverse_y > 0.0
    s, level, steps = 0.0, 0, 0
    while True:
        steps += 1
        cell_i, cell_j = i >> level, j >> level
        edge_x = min((cell_j + 1) << level, width) if goes_right else cell_j << level
        edge_y = min((cell_i + 1) << level, height) if goes_down else cell_i << level
        at_x, at_y = _crossing(edge_x, ray.x, inverse_x), _crossing(edge_y, ray.y, inverse_y)
        leaves = max(min(min(at_x, at_y), 1.0), s)
        if steps > 1:
            h0, h1 = ray.h + s * ray.dh, ray.h + leaves * ray.dh
            k = first[level] + cell_i * columns[level] + cell_j
            is_clear = min(h0, h1) > bounds[k, HIGH]
            if not is_clear and not stops_hidden:
                is_clear = max(h0, h1) < bounds[k, LOW]
            if not is_clear:
                if level > 0:
                    level -= 1
                    continue
                answer, at = _meet_pixel(planes, i, j, ray, s, leaves)
                if answer == HIT or (answer == HIDDEN and stops_hidden):
                    return answer, i, j, at, steps
        if leaves >= 1.0:
            return ENDED, -1, -1, 1.0, steps
        s = leaves
        # a corner is passed by the column first, on every level
        if at_x <= at_y:
            edge = edge_x
            if level > 0:
                last = edge_y - 1 if goes_down else edge_y
                i = _row_at(ray.y, ray.y + s * ray.dy, inverse_y, i, last, s, False)
            j = edge_x if goes_right else edge_x - 1
            if j < 0 or j >= width:
                return LEFT, i, j + (1 if j < 0 else -1), s, steps
        else:
            edge = edge_y
            if level > 0:
                last = edge_x - 1 if goes_right else edge_x
                j = _row_at(ray.x, ray.x + s * ray.dx, inverse_x, j, last, s, True)
            i = edge_y if goes_down else edge_y - 1
            if i < 0 or i >= height:
                return LEFT, i + (1 if i < 0 else -1), j, s, steps
        # within the same cell of the next level there is no more to skip than before
        if level < top and ((edge >> level) & 1) == 0:
            level += 1


@device_jit
def _row_at(start, place, inverse, row, last, s, takes_corner):
    """Row (or column) of the ray at s, between the row where it was and `last`, as single steps would have found it.

    Those cross every edge whose parameter is less than s, and with `takes_corner` one whose parameter is s. `place`
    may be off by rounding, so the edges beside it are asked.
    """
    if inverse > 0.0:
        k = min(max(int(math.floor(place)), row), last)
        while k < last and _is_crossed(_crossing(k + 1, start, inverse), s, takes_corner):
            k += 1
        while k > row and not _is_crossed(_crossing(k, start, inverse), s, takes_corner):
            k -= 1
        return k
    k = max(min(int(math.floor(place)), row), last)
    while k > last and _is_crossed(_crossing(k, start, inverse), s, takes_corner):
        k -= 1
    while k < row and not _is_crossed(_crossing(k + 1, start, inverse), s, takes_corner):
        k += 1
    return k


@device_jit
def _is_crossed(at, s, takes_corner):
    return at < s or (takes_corner and at == s)


@device_jit
def march_evenly(pyramid, ray, i, j, step_px, stops_hidden):
    """As `march`, in even steps of `step_px` pixels along the longer axis: what lies between two steps is not seen."""
    planes, bounds = pyramid.planes, pyramid.bounds
    height, width = planes.shape[0], planes.shape[1]
    longest = max(abs(ray.dx), abs(ray.dy))
    ds = min(step_px / longest, 1.0) if longest > 0.0 else 1.0
    before, steps = 0.0, 0
    while True:
        steps += 1
        s = min(before + ds, 1.0)
        x, y = ray.x + s * ray.dx, ray.y + s * ray.dy
        if not (x >= 0.0 and y >= 0.0 and x < width and y < height):
            return LEFT, i, j, before, steps
        at_i, at_j = int(y), int(x)
        if at_i != i or at_j != j:
            i, j = at_i, at_j
            k = i * width + j
            h0, h1 = ray.h + before * ray.dh, ray.h + s * ray.dh
            if not min(h0, h1) > bounds[k, HIGH] and (stops_hidden or not max(h0, h1) < bounds[k, LOW]):
                answer, at = _meet_pixel(planes, i, j, ray, before, s)
                if answer == HIT or (answer == HIDDEN and stops_hidden):
                    return answer, i, j, at, steps
        if s >= 1.0:
            return ENDED, -1, -1, s, steps
        before = s
