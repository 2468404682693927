"""The camera's view as kernels take it: pixels, view space and world to each other, for every flat projection.

Shift, border and overscan are nothing but edges of the image plane, and perspective and orthographic views differ in three
places: where a pixel's ray starts, how wide a pixel is at a depth, and where the viewer stands. All of it is in this file,
so that no technique has to know what camera it works for.

View space looks along -Z with +Y up. Pixel (i, j), row and column, has its centre at column j + 0.5, row i + 0.5. `depth` is
planar, +inf where nothing is seen.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .jit import device_jit
from .sampling import uniform
from .shadow import ORTHOGRAPHIC
from .vec3 import ONE, ZERO, Vec3, dot, f32, length, load_pixel, moved_by, normalized_or, sub, turned_back_by, turned_by

HALF = f32(0.5)
TINY = f32(1e-30)           # keeps a division by a depth of 0 finite


class Screen(NamedTuple):
    """The camera's view.

    projection: `kernels.shadow.PERSPECTIVE` or ORTHOGRAPHIC; view_from_world (3, 4) float32; left, top: edges of the image
    plane at distance 1 (in m for an orthographic view); step_x, step_y: size of a pixel on it; depth (H, W) float32 m, +inf
    for nothing; position_ws, normal_ws (H, W, 3) float32.
    """

    projection: int
    view_from_world: np.ndarray
    left: np.float32
    top: np.float32
    step_x: np.float32
    step_y: np.float32
    depth: np.ndarray
    position_ws: np.ndarray
    normal_ws: np.ndarray


def build_screen(projection: int, view_from_world: np.ndarray, left: float, top: float, step_x: float, step_y: float,
                 depth: np.ndarray, position_ws: np.ndarray, normal_ws: np.ndarray) -> Screen:
    """A Screen with the types and the memory layout that kernels expect; `view_from_world` may be (4, 4) or (3, 4)."""
    matrix = np.ascontiguousarray(view_from_world[:3], np.float32)
    images = (np.ascontiguousarray(image, np.float32) for image in (depth, position_ws, normal_ws))
    return Screen(projection, matrix, f32(left), f32(top), f32(step_x), f32(step_y), *images)


@device_jit
def to_view(s, p):
    """World point p in view space."""
    return moved_by(s.view_from_world, p)


@device_jit
def turn_to_view(s, d):
    """World direction d in view space."""
    return turned_by(s.view_from_world, d)


@device_jit
def turn_to_world(s, d):
    """View-space direction d in the world."""
    return turned_back_by(s.view_from_world, d)


@device_jit
def point_vs(s, column, row, depth):
    """View-space point that a (fractional) column and row sees at a planar depth."""
    x, y = s.left + column * s.step_x, s.top - row * s.step_y
    if s.projection == ORTHOGRAPHIC:
        return Vec3(x, y, -depth)
    return Vec3(x * depth, y * depth, -depth)


@device_jit
def seen_vs(s, i, j):
    """View-space point at the centre of pixel (i, j); not finite where nothing is seen."""
    return point_vs(s, f32(j) + HALF, f32(i) + HALF, s.depth[i, j])


@device_jit
def seen_normal_vs(s, i, j):
    """View-space normal of pixel (i, j)."""
    return turned_by(s.view_from_world, load_pixel(s.normal_ws, i, j))


@device_jit
def view_to_screen(s, q):
    """(column, row, depth) of a view-space point; behind a perspective viewer depth is <= 0 and column and row are 0."""
    depth = -q.z
    if s.projection == ORTHOGRAPHIC:
        return (q.x - s.left) / s.step_x, (s.top - q.y) / s.step_y, depth
    if not depth > ZERO:
        return ZERO, ZERO, depth
    inv = ONE / depth
    return (q.x * inv - s.left) / s.step_x, (s.top - q.y * inv) / s.step_y, depth


@device_jit
def to_screen(s, p):
    """(column, row, depth) of a world point; behind a perspective viewer depth is <= 0 and column and row are 0."""
    return view_to_screen(s, moved_by(s.view_from_world, p))


@device_jit
def to_viewer_vs(s, q):
    """Unit vector in view space from point q to the viewer: towards the eye, or +Z for an orthographic view."""
    if s.projection == ORTHOGRAPHIC:
        return Vec3(ZERO, ZERO, ONE)
    return normalized_or(Vec3(-q.x, -q.y, -q.z), Vec3(ZERO, ZERO, ONE))


@device_jit
def view_vector(s, p):
    """Unit vector in the world from point p to the viewer."""
    return turned_back_by(s.view_from_world, to_viewer_vs(s, moved_by(s.view_from_world, p)))


@device_jit
def pixel_radius(s, depth, radius_m):
    """Pixels that a length of `radius_m`, facing the camera, covers at a depth; by the mean of a pixel's two edges."""
    step = math.sqrt(s.step_x * s.step_y)
    if s.projection == ORTHOGRAPHIC:
        return radius_m / step
    return radius_m / (max(depth, TINY) * step)


@device_jit
def is_inside(s, column, row):
    """Whether a (fractional) column and row lies in the picture; False for NaN."""
    return column >= ZERO and row >= ZERO and column < f32(s.depth.shape[1]) and row < f32(s.depth.shape[0])


@device_jit
def height_above_plane(p, n, q):
    """(height of q over the plane of p with unit normal n, distance from p to q), in m: their ratio is sine of elevation."""
    d = sub(q, p)
    return dot(n, d), length(d)


@device_jit
def pixel_hash(s, i, j, seed, k):
    """Number in [0, 1) of pixel (i, j), a seed and an index k; white noise."""
    return uniform(i * s.depth.shape[1] + j, seed, k)
