"""Shadow maps that know what they do not know.

A light's view is asked for three answers about a point: LIT, DARK, or ASK (trace rays). The map is trusted only where
the surface that it shows is one continuous sheet, and no silhouette is near enough for its half shadow to reach the
point. So a map of a few hundred texels a side gives exact shadows at the cost of rays along the edges alone.

Heights: h = 1 / depth for perspective and equirectangular views, h = -depth for orthographic ones; larger is nearer to
the light. On a plane h is an affine function of the texel (exactly, for the two flat projections), so a jump shows as a
step that no crease between two planes explains. A silhouette of height h_e throws a half shadow of k (h_e - h) texels on
what lies at height h, with k = source radius / texel angle; its largest value over all silhouettes, less their
chessboard distance, comes from two raster scans (Rosenfeld and Pfaltz 1966) and is kept as `reach`.

Half of what this leaves in doubt is settled by `look_around`, once the triangle of the point is known: no texel that the
lamp's outline covers from there rises above the triangle's plane, or every one does.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .bvh import closest_triangle, triangle_normal
from .fastmath import fast_atan2, on_circle
from .jit import device_jit, inline_jit
from .vec3 import ONE, ZERO, Vec3, along, dot, f32, moved_by, scaled, turned_by

PERSPECTIVE, ORTHOGRAPHIC, EQUIRECTANGULAR = 0, 1, 2
LIT, DARK, ASK = 1, 2, 3
BROKEN, VEILED = 1, 2       # what `ShadowMap.broken` says of a texel
CLEAR_PX = f32(3)           # texels by which an occluder must stand clear of a point to be trusted
NOTHING = f32(-1e30)        # height where a view sees nothing, and reach where no silhouette is
TOLERANCE_PX = f32(0.05)    # steps below this share of a texel's footprint are seen as one surface
QUAD_SHARE = f32(0.1)       # and below this share of the height range of the four texels around a point
WINDOW_PX = 10              # larger outlines of the lamp are not worth looking through: rays are cheaper
MARGIN_PX = f32(1.5)        # silhouettes nearer than this make a point ambiguous for any light
SMALL_SINE = f32(0.1)       # up to which it is the angle, but for a fifth of a percent
TURNS = f32(0.5 / math.pi)  # in a radian
POLE = f32(0.1)             # rows of an equirectangular view whose cosine of latitude is smaller are never trusted


NO_VEILS = np.zeros((0, 5))


class ShadowMap(NamedTuple):
    """One light's view, as kernels take it.

    view_from_world (3, 4) float32; left, top: edges of the image plane; step_x, step_y: size of a texel on it;
    height (H, W) float32; reach (H, W) float32 texels (see the module's docstring), and `tallest` (H, W) float32, the height
    of the silhouette that gives it; broken (H, W) uint8, BROKEN beside a jump and VEILED where something may stand that lets
    part of the light through; k: texels of half shadow for a unit of height, see `_spread`.
    """

    projection: int
    view_from_world: np.ndarray
    left: np.float32
    top: np.float32
    step_x: np.float32
    step_y: np.float32
    height: np.ndarray
    reach: np.ndarray
    tallest: np.ndarray
    broken: np.ndarray
    k: np.float32


def build_shadow_map(projection: int, view_from_world: np.ndarray, left: float, top: float, step_x: float, step_y: float,
                     depth: np.ndarray, source: float, veils: np.ndarray = NO_VEILS) -> ShadowMap:
    """A ShadowMap of the `depth` (H, W) m that a light sees, +inf for nothing.

    `source` is the radius of the light's shape in m, or for an orthographic view the tangent of half its angle. `veils` (n,
    5) are boxes in which a depth tells nothing of light that gets through: lowest and highest column, lowest and highest row
    (texels' edges at whole numbers) and the least depth m.
    """
    seen = np.isfinite(depth) & (depth > 0)
    safe = np.where(seen, depth, 1)
    height = np.where(seen, -safe if projection == ORTHOGRAPHIC else 1 / safe, NOTHING).astype(np.float32)
    k = f32(source / min(step_x, step_y))
    row_scale = np.ones(len(height), np.float32)
    if projection == EQUIRECTANGULAR:
        latitude = top - (np.arange(len(height)) + 0.5) * step_y
        row_scale = (1 / np.maximum(np.cos(latitude), POLE)).astype(np.float32)
    is_wrapped = projection == EQUIRECTANGULAR and abs(step_x * height.shape[1] - 2 * math.pi) < 1e-3
    tallest = _find_jumps(height, TOLERANCE_PX * max(step_x, step_y), projection == ORTHOGRAPHIC, is_wrapped)
    broken = (tallest != NOTHING).astype(np.uint8)
    _draw_veils(veils, projection, is_wrapped, tallest, broken)
    spread = k * tallest
    if projection == EQUIRECTANGULAR:
        sine = np.maximum(min(step_x, step_y) * spread, 0)
        spread = np.where(sine < 1, np.arcsin(np.minimum(sine, 1)), math.pi) / min(step_x, step_y)
    reach = np.where(broken > 0, row_scale[:, None] * spread, NOTHING).astype(np.float32)
    for _ in range(2 if is_wrapped else 1):
        _spread_reach(reach, tallest, is_wrapped)
    return ShadowMap(projection, np.ascontiguousarray(view_from_world[:3], np.float32), f32(left), f32(top), f32(step_x),
                     f32(step_y), height, reach, tallest, broken, k)


def _draw_veils(veils: np.ndarray, projection: int, is_wrapped: bool, tallest: np.ndarray, broken: np.ndarray) -> None:
    """Mark the texels of boxes in `broken`, and in `tallest` the height of the highest thing in each."""
    rows, columns = tallest.shape
    # a texel more on each side: a point between two texels asks both
    low = np.floor(veils[:, [0, 2]]).astype(np.int64) - 1
    high = np.ceil(veils[:, [1, 3]]).astype(np.int64) + 1
    height = -veils[:, 4] if projection == ORTHOGRAPHIC else 1 / np.maximum(veils[:, 4], 1e-9)
    for (left, top), (right, bottom), tall in zip(low, high, height.astype(np.float32), strict=True):
        here = slice(max(top, 0), max(bottom, 0))
        if is_wrapped:
            across = np.arange(left, min(right, left + columns)) % columns
        else:
            across = slice(max(left, 0), max(right, 0))
        broken[here, across] = VEILED
        tallest[here, across] = np.maximum(tallest[here, across], tall)


def no_shadow_map() -> ShadowMap:
    """A map of one texel that sees nothing: every point is to be asked for by rays."""
    return ShadowMap(ORTHOGRAPHIC, np.zeros((3, 4), np.float32), ZERO, ZERO, ONE, ONE, np.full((1, 1), NOTHING),
                     np.full((1, 1), NOTHING), np.full((1, 1), NOTHING), np.ones((1, 1), np.uint8), ZERO)


def _shifted(height: np.ndarray, rows: int, columns: int, is_wrapped: bool) -> np.ndarray:
    """`height` at (i + rows, j + columns); NOTHING outside."""
    out = np.roll(height, (-rows, -columns), (0, 1))
    if rows:
        out[slice(-rows, None) if rows > 0 else slice(None, -rows)] = NOTHING
    if columns and not is_wrapped:
        out[:, slice(-columns, None) if columns > 0 else slice(None, -columns)] = NOTHING
    return out


def _find_jumps(height: np.ndarray, slack_scale: float, is_orthographic: bool, is_wrapped: bool) -> np.ndarray:
    """(H, W) float32: the taller side's height beside a gap between two neighbouring texels, NOTHING elsewhere.

    Neither a plane nor a crease explains a step between two texels that lies outside the steps on their far sides.
    """
    top = np.full_like(height, NOTHING)
    for rows, columns in ((0, 1), (1, 0)):
        before, after, last = (_shifted(height, k * rows, k * columns, is_wrapped) for k in (-1, 1, 2))
        gap, left, right = after - height, height - before, last - after
        left = np.where(before != NOTHING, left, np.where(last != NOTHING, right, 0))
        right = np.where(last != NOTHING, right, left)
        slack = np.float32(slack_scale) * (np.float32(1) if is_orthographic else np.maximum(height, after))
        is_jump = (gap < np.minimum(left, right) - slack) | (gap > np.maximum(left, right) + slack)
        seen, seen_after = height != NOTHING, after != NOTHING
        is_jump = np.where(seen & seen_after, is_jump, seen != seen_after)
        if rows:
            is_jump[-1] = False
        elif not is_wrapped:
            is_jump[:, -1] = False
        taller = np.where(is_jump, np.maximum(height, after), NOTHING)
        # the gap after texel (i, j) is the gap before the next one
        np.maximum(top, taller, out=top)
        np.maximum(top, _shifted(taller, -rows, -columns, is_wrapped), out=top)
    return top


@device_jit
def _sweep_row(reach, tallest, i, neighbour, start, step, is_wrapped):
    """Row i takes over from row `neighbour` (none if negative) and from its own texels before, in steps from `start`."""
    columns = reach.shape[1]
    before = (start - step) % columns if is_wrapped else start
    run, top = reach[i, before], tallest[i, before]
    for n in range(columns):
        j = start + n * step
        best, tall = reach[i, j], tallest[i, j]
        if run - ONE > best:
            best, tall = run - ONE, top
        if neighbour >= 0:
            for dj in range(-1, 2):
                c = j + dj
                if c < 0 or c >= columns:
                    c = c % columns if is_wrapped else j
                if reach[neighbour, c] - ONE > best:
                    best, tall = reach[neighbour, c] - ONE, tallest[neighbour, c]
        reach[i, j], tallest[i, j] = best, tall
        run, top = best, tall


@device_jit
def _spread_reach(reach, tallest, is_wrapped):
    """reach(x) = max over y of reach(y) - chessboard distance(x, y), in two scans; wrapped views take the scans twice."""
    rows, columns = reach.shape
    for i in range(rows):
        _sweep_row(reach, tallest, i, i - 1, 0, 1, is_wrapped)
    for i in range(rows - 1, -1, -1):
        _sweep_row(reach, tallest, i, i + 1 if i + 1 < rows else -1, columns - 1, -1, is_wrapped)


@inline_jit
def _spread(m, k, h):
    """Texels that a silhouette's `reach` is less at a point of height h.

    On a plane they are k h. Around a lamp the half shadow of an occluder at distance d ends where a farther point's cone
    around the lamp, a ball of radius R, touches it: asin(R / d) - asin(R / distance of the point). What lies within the ball
    darkens in all directions.
    """
    if m.projection != EQUIRECTANGULAR:
        return k * h
    step = min(m.step_x, m.step_y)
    sine = m.k * step * h
    return k * h if sine < SMALL_SINE else math.asin(min(sine, ONE)) * k / (m.k * step)


@inline_jit
def _project(m, p):
    """Column, row (texel centres at +0) and height of p in map m; height NOTHING behind a perspective view."""
    q = moved_by(m.view_from_world, p)
    x, y, depth = q.x, q.y, -q.z
    if m.projection == PERSPECTIVE:
        if depth <= ZERO:
            return ZERO, ZERO, NOTHING
        height = ONE / depth
        x, y = x * height, y * height
    elif m.projection == ORTHOGRAPHIC:
        height = -depth
    else:
        distance = math.sqrt(x * x + y * y + depth * depth)
        if distance <= ZERO:
            return ZERO, ZERO, NOTHING
        height = ONE / distance
        x, y = fast_atan2(x, depth), fast_atan2(y, math.sqrt(x * x + depth * depth))
    return (x - m.left) / m.step_x - f32(0.5), (m.top - y) / m.step_y - f32(0.5), height


@inline_jit
def _corner(m, i, j):
    """Column index of a texel, wrapped in a full equirectangular view; -1 outside the map."""
    rows, columns = m.height.shape
    if i < 0 or i >= rows:
        return -1
    if m.projection == EQUIRECTANGULAR:
        return j % columns
    return j if 0 <= j < columns else -1


@inline_jit
def classify(m, p, error):
    """LIT, DARK or ASK for point p; `error` bounds the distance in m of p from the true surface."""
    column, row, h = _project(m, p)
    if h == NOTHING or not (abs(column) < f32(1e6) and abs(row) < f32(1e6)):
        return ASK
    i, j = int(math.floor(row)), int(math.floor(column))
    fx, fy = column - f32(j), row - f32(i)
    j0, j1 = _corner(m, i, j), _corner(m, i, j + 1)
    if j0 < 0 or j1 < 0 or i + 1 >= m.height.shape[0]:
        return ASK
    a, b, c, d = m.height[i, j0], m.height[i, j1], m.height[i + 1, j0], m.height[i + 1, j1]
    low, high = min(min(a, b), min(c, d)), max(max(a, b), max(c, d))
    if low == NOTHING or m.broken[i, j0] + m.broken[i, j1] + m.broken[i + 1, j0] + m.broken[i + 1, j1] > 0:
        return ASK
    k, foot = m.k, max(m.step_x, m.step_y)
    if m.projection == EQUIRECTANGULAR:
        cos_latitude, _ = on_circle(TURNS * abs(m.top - (f32(i) + f32(0.5)) * m.step_y))
        if cos_latitude < POLE:
            return ASK
        k = k / cos_latitude
    reach = max(max(m.reach[i, j0], m.reach[i, j1]), max(m.reach[i + 1, j0], m.reach[i + 1, j1]))
    if reach - _spread(m, k, h) + MARGIN_PX > ZERO:
        return ASK
    scale = ONE if m.projection == ORTHOGRAPHIC else high
    slack = QUAD_SHARE * (high - low) + (TOLERANCE_PX * foot + error * scale) * scale
    shown = (a * (ONE - fx) + b * fx) * (ONE - fy) + (c * (ONE - fx) + d * fx) * fy
    if abs(h - shown) <= slack:
        return LIT
    # at the foot of a wall the floor's texels are nearer to the lamp than the wall by as much as a texel is wide
    return DARK if h < low - slack - CLEAR_PX * foot * scale else ASK


@inline_jit
def _plane_height(m, n, over, h, column, row, i, j):
    """Height of the plane through a point (column, row, h) with view-space normal n where texel (i, j) sees it.

    `over` is 1 / (n . point) in view space, or for an orthographic view 1 / n.z.
    """
    x, y = m.left + (f32(j) + f32(0.5)) * m.step_x, m.top - (f32(i) + f32(0.5)) * m.step_y
    if m.projection == ORTHOGRAPHIC:
        return h - (n.x * (f32(j) - column) * m.step_x - n.y * (f32(i) - row) * m.step_y) * over
    if m.projection == PERSPECTIVE:
        return (n.x * x + n.y * y - n.z) * over
    c, s = on_circle(TURNS * y + ONE)
    away, side = on_circle(TURNS * x + ONE)
    return (n.x * c * side + n.y * s - n.z * c * away) * over


@inline_jit
def look_around(m, p, n, error):
    """LIT, DARK or ASK for point p of a triangle with unit normal n, for a lamp that has a size.

    LIT if no texel that the lamp's outline may cover rises above the triangle's plane, DARK if all of them do and stand
    clear of p: at the foot of a wall the floor's texels rise above the wall's plane, and none of them shades it.
    """
    column, row, h = _project(m, p)
    if h == NOTHING or not (abs(column) < f32(1e6) and abs(row) < f32(1e6)):
        return ASK
    i, j = int(math.floor(row)), int(math.floor(column))
    j0, j1 = _corner(m, i, j), _corner(m, i, j + 1)
    if j0 < 0 or j1 < 0 or i + 1 >= m.height.shape[0]:
        return ASK
    k, foot = m.k, max(m.step_x, m.step_y)
    if m.projection == EQUIRECTANGULAR:
        cos_latitude, _ = on_circle(TURNS * abs(m.top - (f32(i) + f32(0.5)) * m.step_y))
        k = k / max(cos_latitude, POLE)
    tallest = max(max(m.tallest[i, j0], m.tallest[i, j1]), max(m.tallest[i + 1, j0], m.tallest[i + 1, j1]))
    if m.projection == EQUIRECTANGULAR and m.k * min(m.step_x, m.step_y) * tallest > SMALL_SINE:
        return ASK                               # light of a wide lamp goes beside and behind what its centre sees
    spread = k * (tallest - h)
    if not spread < f32(WINDOW_PX - 1):
        return ASK
    radius = int(max(spread, ZERO) + ONE)
    n = turned_by(m.view_from_world, n)
    if m.projection == ORTHOGRAPHIC:
        over = n.z
    else:
        over = dot(n, moved_by(m.view_from_world, p))
    if abs(over) <= f32(1e-20):
        return ASK
    over = ONE / over
    above, below, clear = 0, 0, 0
    for y in range(i - radius, i + radius + 2):
        for x in range(j - radius, j + radius + 2):
            c = _corner(m, y, x)
            if c < 0:
                return ASK
            if m.broken[y, c] == VEILED:
                return ASK
            there = m.height[y, c]
            scale = ONE if m.projection == ORTHOGRAPHIC else max(there, h)
            slack = (TOLERANCE_PX * foot + error * scale) * scale
            if there > _plane_height(m, n, over, h, column, row, y, x) + slack:
                above += 1
                clear += there > h + ((f32(radius) + CLEAR_PX) * foot + error * scale) * scale
            else:
                below += 1
            if above > 0 and below > 0:
                return ASK
    if above == 0:
        return LIT
    return DARK if clear == above else ASK


@inline_jit
def map_visibility(m, p, error):
    """Share of the four texels around p that do not hide it: what remains where no rays can be traced; 1 off the map."""
    column, row, h = _project(m, p)
    if h == NOTHING or not (abs(column) < f32(1e6) and abs(row) < f32(1e6)):
        return ONE
    i, j = int(math.floor(row)), int(math.floor(column))
    fx, fy = column - f32(j), row - f32(i)
    total, weights = ZERO, ZERO
    for di in range(2):
        for dj in range(2):
            c = _corner(m, i + di, j + dj)
            if c >= 0:
                w = (fx if dj else ONE - fx) * (fy if di else ONE - fy)
                there = m.height[i + di, c]
                scale = ONE if m.projection == ORTHOGRAPHIC else max(there, h)
                # a texel of slack on a surface inclined by 45 degrees
                slack = (max(m.step_x, m.step_y) + error * scale) * scale
                weights += w
                total += w if there <= h + slack else ZERO
    return total / weights if weights > f32(1e-6) else ONE


@inline_jit
def find_surface(bvh, stack, p, towards_viewer, span):
    """(slot, point, normal on the viewer's side, a, b): the triangle at p, met along the viewer's ray within `span` m of p.

    The slot is below 0 without one; (a, b) is the place in it, see `bvh.closest_hit`.

    Positions that come from a depth pass are off by some ulps of the viewer's distance, and shading normals need not be
    those of the triangle. Shadow rays that start from the triangle itself need only the offset of its own rounding. The
    pixel shows the triangle, so it is there.
    """
    t, slot, a, b = closest_triangle(bvh, stack, along(p, towards_viewer, span), scaled(towards_viewer, -span), f32(2))
    if slot < 0:
        return slot, p, towards_viewer, ZERO, ZERO
    n = triangle_normal(bvh, slot)
    if dot(n, towards_viewer) < ZERO:
        n = Vec3(-n.x, -n.y, -n.z)
    return slot, along(p, towards_viewer, span * (ONE - t)), n, a, b
