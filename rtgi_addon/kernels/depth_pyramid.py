"""What the camera sees as a small plane in every pixel, and a pyramid of their bounds that rays skip empty space by.

Heights: h = 1 / depth for a perspective view and h = -depth for an orthographic one, so that larger is nearer to the camera
in both. On a plane, and along a ray, h is an affine function of the place in the picture (exactly), which is why nothing
here interpolates depth itself. A pixel's surface is the plane

    h(x, y) = h_centre + slope_x (x - x_centre) + slope_y (y - y_centre)

over its square. A slope is the median of the steps to the two neighbours and of what the pixel's normal tells: beside a
silhouette one of the steps is a jump, and under a bump map the normal is wrong, but two of the three agree.

Level 0 of the pyramid holds the highest and the lowest h of each pixel's plane, the lowest less the surface's thickness. A
cell of level n + 1 holds the bounds of up to four cells of level n; sizes are rounded up, so the last row and column of an
odd level has its parent too.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .jit import borrowed, device_jit, pixel_jit
from .screen import HALF, Screen, seen_normal_vs
from .shadow import ORTHOGRAPHIC
from .vec3 import ONE, ZERO, f32

NOTHING = f32(1e30)         # no height lies beyond it: the bounds of a pixel that sees nothing are -NOTHING and NOTHING
HEIGHT, SLOPE_X, SLOPE_Y, SLACK = 0, 1, 2, 3
HIGH, LOW = 0, 1


class DepthPyramid(NamedTuple):
    """Planes and bounds of a view, as kernels take them.

    planes (H, W, 4) float32: height at the centre, slopes to the right and down in 1/px, and SLACK, how far behind the
    plane, as a height, a ray still meets the surface. bounds (N, 2) float32: HIGH and LOW of each cell, the levels one after
    another; level n has rows[n] x columns[n] cells from index first[n] on.
    """

    planes: np.ndarray
    bounds: np.ndarray
    first: np.ndarray
    rows: np.ndarray
    columns: np.ndarray


def build_pyramid(screen: Screen, slack_px: float, thickness_m: float = 0.0, has_levels: bool = True) -> DepthPyramid:
    """The pyramid of a view; level 0 alone for those who look at single pixels only.

    A surface is as thick as `slack_px` pixels are wide where it lies, or `thickness_m` where that is more.
    """
    height, width = screen.depth.shape
    first, rows, columns = (of_level[:None if has_levels else 1] for of_level in pyramid_layout(height, width))
    planes, bounds = np.empty((height, width, 4), np.float32), np.empty((int(first[-1] + rows[-1] * columns[-1]), 2),
                                                                                   np.float32)
    _lay_planes(screen.depth.shape[0], screen, f32(slack_px), f32(thickness_m), planes, bounds)
    if has_levels:
        fill_pyramid(bounds, first, rows, columns)
    return DepthPyramid(planes, bounds, first, rows, columns)


def pyramid_layout(height: int, width: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(first, rows, columns) (L,) int64 of the levels of a (height, width) picture; the last one is a single cell."""
    rows, columns = [height], [width]
    while rows[-1] > 1 or columns[-1] > 1:
        rows.append((rows[-1] + 1) // 2)
        columns.append((columns[-1] + 1) // 2)
    cells = np.array(rows) * np.array(columns)
    return np.cumsum(cells) - cells, np.array(rows), np.array(columns)


@device_jit
def fill_pyramid(bounds, first, rows, columns):
    """Fill the levels above 0 of `bounds` (N, 2), HIGH by the highest and LOW by the lowest of the cells below."""
    for level in range(1, rows.shape[0]):
        below, wide, high = first[level - 1], columns[level - 1], rows[level - 1]
        for i in range(rows[level]):
            top, bottom = below + 2 * i * wide, below + min(2 * i + 1, high - 1) * wide
            for j in range(columns[level]):
                left, right = 2 * j, min(2 * j + 1, wide - 1)
                k = first[level] + i * columns[level] + j
                bounds[k, HIGH] = max(max(bounds[top + left, HIGH], bounds[top + right, HIGH]),
                                      max(bounds[bottom + left, HIGH], bounds[bottom + right, HIGH]))
                bounds[k, LOW] = min(min(bounds[top + left, LOW], bounds[top + right, LOW]),
                                     min(bounds[bottom + left, LOW], bounds[bottom + right, LOW]))


@device_jit
def height_at(s, depth):
    """Height of a finite planar depth."""
    return -depth if s.projection == ORTHOGRAPHIC else ONE / depth


@device_jit
def slack_at(s, h, slack_px, thickness_m):
    """How far below height h a surface ends that is `slack_px` pixel widths thick, or `thickness_m` where that is more."""
    step = max(s.step_x, s.step_y)
    if s.projection == ORTHOGRAPHIC:
        return max(slack_px * step, thickness_m)
    thickness = max(slack_px * step / h, thickness_m)
    return h * (thickness * h / (ONE + thickness * h))


@device_jit
def _median(a, b, c):
    return max(min(a, b), min(max(a, b), c))


@device_jit
def _height_or(s, i, j, otherwise):
    """Height of pixel (i, j), -NOTHING for one that sees nothing and `otherwise` outside the picture."""
    if i < 0 or j < 0 or i >= s.depth.shape[0] or j >= s.depth.shape[1]:
        return otherwise
    depth = s.depth[i, j]
    return height_at(s, depth) if depth < NOTHING else -NOTHING


@device_jit
def plane_slopes(s, n, column, row, h):
    """Slopes, to the right and down in height a pixel, of the plane with view-space normal n that is seen at a place.

    0 for a plane that is seen edge-on.
    """
    x, y = s.left + column * s.step_x, s.top - row * s.step_y
    # n . point is the same on the whole plane; per unit of depth in a perspective view
    over = n.z if s.projection == ORTHOGRAPHIC else n.x * x + n.y * y - n.z
    scale = ONE if s.projection == ORTHOGRAPHIC else -h
    if not abs(over) > f32(1e-4):
        return ZERO, ZERO
    return -scale * n.x * s.step_x / over, scale * n.y * s.step_y / over


@device_jit
def width_at(s, h):
    """How much height changes over a depth that is as long as a pixel is wide, at height h."""
    step = max(s.step_x, s.step_y)
    return step if s.projection == ORTHOGRAPHIC else h * step


@device_jit
def _slopes(s, i, j, h):
    """Slopes of the plane at pixel (i, j): see the module."""
    told_x, told_y = plane_slopes(s, seen_normal_vs(s, i, j), f32(j) + HALF, f32(i) + HALF, h)
    slope_x = _median(h - _height_or(s, i, j - 1, h - told_x), _height_or(s, i, j + 1, h + told_x) - h, told_x)
    slope_y = _median(h - _height_or(s, i - 1, j, h - told_y), _height_or(s, i + 1, j, h + told_y) - h, told_y)
    return slope_x, slope_y


@pixel_jit
def _lay_planes(begin, end, s, slack_px, thickness_m, planes, bounds):
    """Fill `planes`, and level 0 of `bounds`."""
    s, = borrowed((s,))
    rows, columns = s.depth.shape
    for i in range(begin, end):
        for j in range(columns):
            k, depth = i * columns + j, s.depth[i, j]
            if not depth < NOTHING:
                planes[i, j, HEIGHT], planes[i, j, SLOPE_X], planes[i, j, SLOPE_Y], planes[i, j, SLACK] = -NOTHING, 0, 0, 0
                bounds[k, HIGH], bounds[k, LOW] = -NOTHING, NOTHING
                continue
            h = height_at(s, depth)
            slope_x, slope_y = _slopes(s, i, j, h)
            slack = slack_at(s, h, slack_px, thickness_m)
            reach = HALF * (abs(slope_x) + abs(slope_y))
            planes[i, j, HEIGHT], planes[i, j, SLACK] = h, slack
            planes[i, j, SLOPE_X], planes[i, j, SLOPE_Y] = slope_x, slope_y
            bounds[k, HIGH], bounds[k, LOW] = h + reach, h - reach - slack
