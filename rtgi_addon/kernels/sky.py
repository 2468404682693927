"""Light from infinity: rays to a radiance map, drawn by cosine and by the map's own brightness."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .brdf import INV_PI
from .bvh import STACK, visibility
from .fastmath import HALF_PI, PI, TWO_PI, fast_atan2, on_circle
from .jit import borrowed, device_jit, pixel_jit, scratch
from .octahedron import table_at
from .sampling import cosine_hemisphere, dither, r2_sequence
from .vec3 import ONE, ZERO, Vec3, begun, dot, f32, lifted, load, load_pixel, scaled, tangent_frame, to_world

GUIDE_ROWS, GUIDE_COLUMNS = 12, 24      # cells of a guide, 12 degrees across: finer ones learn too slowly


@device_jit
def sky_texel(d, height, width):
    """(row, column) of an equirectangular map (row 0 is +Z, longitude 0 is +Y, growing to +X) in unit direction d."""
    longitude, latitude = fast_atan2(d.x, d.y), fast_atan2(d.z, math.sqrt(d.x * d.x + d.y * d.y))
    column = int((longitude + PI) / TWO_PI * f32(width))
    row = int((HALF_PI - latitude) / PI * f32(height))
    return min(max(row, 0), height - 1), min(max(column, 0), width - 1)


@device_jit
def sky_direction(row, column, u, v, height, width):
    """Unit direction in texel (row, column), even over its solid angle."""
    top, _ = on_circle(f32(0.5) * f32(row) / f32(height))
    bottom, _ = on_circle(f32(0.5) * f32(row + 1) / f32(height))
    z = bottom + (top - bottom) * v
    back, left = on_circle((f32(column) + u) / f32(width))
    r = math.sqrt(max(ZERO, ONE - z * z))
    return Vec3(-r * left, -r * back, z)


@device_jit
def find_first(cdf, u):
    """First index whose running sum exceeds u."""
    lo, hi = 0, cdf.shape[0] - 1
    while lo < hi:
        middle = (lo + hi) >> 1
        if cdf[middle] > u:
            hi = middle
        else:
            lo = middle + 1
    return lo


class Guide(NamedTuple):
    """Where the sky is seen from groups of points, so that rays can be aimed through windows.

    of (M,) int32: group of each point, -1 for those that need none; cdf (G, GUIDE_ROWS * GUIDE_COLUMNS) float64: running
    share of the light that comes through each cell of the sphere; density (G, same) float32 1/sr of the directions.
    """

    of: np.ndarray
    cdf: np.ndarray
    density: np.ndarray


def no_guide(count: int) -> Guide:
    """For points that need none."""
    cells = GUIDE_ROWS * GUIDE_COLUMNS
    return Guide(np.full(count, -1, np.int32), np.zeros((0, cells)), np.zeros((0, cells), np.float32))


@device_jit
def _guide_cell(d):
    """Cell of direction d: rows of even height, so that all cells are of one size."""
    row = int((d.z + ONE) * f32(0.5 * GUIDE_ROWS))
    column = int((fast_atan2(d.y, d.x) + PI) / TWO_PI * f32(GUIDE_COLUMNS))
    return min(max(row, 0), GUIDE_ROWS - 1) * GUIDE_COLUMNS + min(max(column, 0), GUIDE_COLUMNS - 1)


@device_jit
def _guided_direction(cell, u, v):
    """Unit direction in a cell, even over it."""
    z = (f32(cell // GUIDE_COLUMNS) + v) * f32(2 / GUIDE_ROWS) - ONE
    x, y = on_circle((f32(cell % GUIDE_COLUMNS) + u) * f32(1 / GUIDE_COLUMNS))
    r = math.sqrt(max(ZERO, ONE - z * z))
    return Vec3(-r * x, -r * y, z)


@pixel_jit
def _gather_sky(begin, end, position, normal, places, radiance, cdf, density, bvh, rays, map_share, first, last, guide,
                offset_m, reach_m, seed, out, cells, values):
    bvh, guide = borrowed((bvh, guide))
    height, width, count = radiance.shape[0], radiance.shape[1], last - first
    stack = scratch(STACK, np.int32)
    for m in range(begin, end):
        p, n, group = load(position, m), load(normal, m), guide.of[m]
        tangent, bitangent = tangent_frame(n)
        origin = lifted(p, n, offset_m)
        place = places[m]
        shift_u, shift_v, shift_w = dither(place, seed, 0), dither(place, seed, 1), dither(place, seed, 2)
        # of guided points these rays alone are one estimate, of the others all
        guided = count // 2 if group >= 0 else 0
        plain = count - guided if group >= 0 else rays
        by_map = int(f32(plain) * map_share)
        # of each sort as many of the first rays as of the last, so that those are a fair sample
        first_map = 0 if group >= 0 else int(f32(first) * map_share)
        last_map = by_map if group >= 0 else int(f32(last) * map_share)
        mapped, first_cosine = guided + last_map - first_map, 0 if group >= 0 else first - first_map
        red, green, blue, given, squares = ZERO, ZERO, ZERO, ZERO, ZERO
        for k in range(count):
            # the points of a sort follow each other, and none is one that the guide was made by
            i = k if k < guided else (first_map + k - guided if k < mapped else by_map + first_cosine + k - mapped)
            u, v = r2_sequence(i + (rays if group >= 0 else 0), shift_u, shift_v)
            if k < guided:
                d = _guided_direction(find_first(guide.cdf[group], (f32(k) + shift_w) / f32(guided)), u, v)
            elif k < mapped:
                q = find_first(cdf, (f32(i) + shift_w) / f32(by_map))
                d = sky_direction(q // width, q % width, u, v, height, width)
            else:
                d = to_world(cosine_hemisphere(u, v), tangent, bitangent, n)
            cosine = dot(d, n)
            if cosine <= ZERO:
                continue
            row, column = sky_texel(d, height, width)
            pdf = f32(by_map) * density[row, column] + f32(plain - by_map) * cosine * INV_PI
            if group >= 0:
                pdf += f32(guided) * guide.density[group, _guide_cell(d)]
            weight = cosine / pdf
            r, g, b = radiance[row, column, 0], radiance[row, column, 1], radiance[row, column, 2]
            mean = f32(1 / 3) * weight * (r + g + b)
            given += mean
            if mean > ZERO:
                arrives = visibility(bvh, stack, begun(origin, d, offset_m), scaled(d, reach_m))
                weight, mean = weight * arrives, mean * arrives
                red, green, blue = red + weight * r, green + weight * g, blue + weight * b
                squares += mean * mean
                if first == 0 and k < cells.shape[1] and mean > ZERO:
                    cells[m, k], values[m, k] = _guide_cell(d), mean
        out[m, 0], out[m, 1], out[m, 2] = out[m, 0] + red, out[m, 1] + green, out[m, 2] + blue
        out[m, 3], out[m, 4] = out[m, 3] + given, out[m, 4] + squares


def gather_sky(position, normal, places, radiance, cdf, density, bvh, rays, map_share, first, last, guide, offset_m, reach_m,
               seed, out, cells, values) -> None:
    """Add to `out` (M, 5) what rays `first` to `last` of `rays` bring of the sky to points (M, 3).

    Columns: irradiance by colour; what an open point would get from the same rays (mean over colours); the squares of what
    single rays bring. W/m2. Of points with a `guide` these rays are an estimate of their own, half of them guided.

    `radiance` (H, W, 3) W/(m2 sr); `cdf` (H W,) float64 running sum of brightness times solid angle, ending at 1; `density`
    (H, W) float32 1/sr of drawing a direction by it. Of the rays that are not guided the share `map_share` is drawn by the
    map, the rest by cosine; all are weighed by the balance heuristic (Veach 1997, Eq. 9.8). `cells` (M, K) int16 and
    `values` (M, K) get the guide's cell and the light of those of the first K rays that arrive.
    """
    _gather_sky(len(position), position, normal, places, radiance, cdf, density, bvh, rays, map_share, first, last, guide,
                offset_m, reach_m, seed, out, cells, values)


@pixel_jit
def _light_through(begin, end, table, planes, normal, mask, albedo, has_bounces, light, visibility):
    height, width = mask.shape
    for i in range(begin, end):
        for j in range(width):
            if not mask[i, j]:
                continue
            v = min(max(planes[0, i, j], ZERO), ONE)
            d = load_pixel(normal, i, j)
            if planes.shape[0] == 4:
                bent = Vec3(planes[1, i, j], planes[2, i, j], planes[3, i, j])
                d = bent if dot(bent, bent) > ZERO else d
            visibility[i, j] = v
            light[i, j, 0], light[i, j, 1], light[i, j, 2] = table_at(table, d)
            for c in range(3):
                share = v
                if has_bounces:
                    r = min(max(albedo[i, j, c], ZERO), ONE)
                    share = v / max(ONE - r * (ONE - v), f32(1e-6))
                light[i, j, c] *= share


def light_through(table, planes, normal, mask, albedo, has_bounces):
    """Sky light behind a visibility: (irradiance (H, W, 3) W/m2, visibility (H, W)), float32; zero and 1 outside `mask`.

    `table` (n, n, 3) holds what an open surface gets, by its normal. `planes` (C, H, W) are the visibility V and, if C is 4,
    the mean open direction, along which the table is read instead of the normal.

    With `has_bounces` a surface of reflectance r is taken to see itself over the 1 - V that is closed: E = V + r (1 - V) E,
    so V becomes V / (1 - r (1 - V)). This is exact inside a sphere with an opening, where every point sees the rest alike;
    the cubic that Jimenez et al. (2016) fit to renders gives 0.259 instead of 0.357 for V = 0.1, r = 0.8.
    """
    height, width = mask.shape
    light, visibility = np.zeros((height, width, 3), np.float32), np.ones((height, width), np.float32)
    _light_through(height, table, planes, normal, mask, albedo, has_bounces, light, visibility)
    return light, visibility


@pixel_jit
def _mean_parts(begin, end, radiance, weight, first_row, first_column, out):
    for k in range(begin, end):
        whole = 0.0
        for i in range(first_row[k], first_row[k + 1]):
            whole += weight[i]
        for q in range(out.shape[1]):
            red, green, blue = 0.0, 0.0, 0.0
            for i in range(first_row[k], first_row[k + 1]):
                for j in range(first_column[q], first_column[q + 1]):
                    red += weight[i] * radiance[i, j, 0]
                    green += weight[i] * radiance[i, j, 1]
                    blue += weight[i] * radiance[i, j, 2]
            rcp = 1.0 / (whole * (first_column[q + 1] - first_column[q]))
            out[k, q, 0], out[k, q, 1], out[k, q, 2] = red * rcp, green * rcp, blue * rcp


def mean_parts(radiance, weight, first_row, first_column):
    """(h, w, 3) float32: means of `radiance` (H, W, 3) over h x w parts, its rows weighed by `weight` (H,) float64.

    Part (k, q) goes from row `first_row[k]` and column `first_column[q]` to before those of the next; both lists end with
    the number of all rows or columns.
    """
    out = np.empty((len(first_row) - 1, len(first_column) - 1, 3), np.float32)
    _mean_parts(out.shape[0], radiance, weight, first_row, first_column, out)
    return out
