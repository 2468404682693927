"""Small bright things, as places to aim at: emissive triangles and the bright parts of the world.

Rays of a lobe, or of the cosine, meet a neon tube or a sun in the sky seldom, and each hit is a speck. Other rays are aimed
there, and each kind counts by the balance heuristic (Veach 1997, Eq. 9.8): a direction that both kinds draw is weighed by
what both densities add up to, so nothing is counted twice.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .jit import device_jit, inline_jit
from .sky import find_first, sky_direction, sky_texel
from .vec3 import ONE, ZERO, add, cross, dot, f32, load, load_pixel, scaled, sub

GRAZING = f32(1e-6)         # cosine at an emissive triangle below which it is not seen


class Shines(NamedTuple):
    """What rays may be aimed at.

    Of the E emissive triangles: cdf (E,) float64, running share of their radiance times area; corners (E, 3, 3) m; radiance
    (E, 3) W/(m2 sr); rcp_power float32, 1 over that of all: times a radiance it is the density of its places in 1/m2.
    sky_cdf (h w,) float64 running share of the texels' radiance times solid angle, sky_density (h, w) 1/sr of the
    directions. sky_share: chance that a ray is aimed at the sky. Lists are empty where nothing of the kind is worth it.
    """

    cdf: np.ndarray
    corners: np.ndarray
    radiance: np.ndarray
    rcp_power: np.float32
    sky_cdf: np.ndarray
    sky_density: np.ndarray
    sky_share: np.float32


@inline_jit
def has_aim(shines):
    """Is there anything to aim at?"""
    return shines.cdf.shape[0] + shines.sky_cdf.shape[0] > 0


@inline_jit
def aim_at(shines, p, sky, far_m, u, v, pick):
    """(vector from p to the place, unit direction, density 1/sr, radiance) of a ray aimed from p; density 0: not to be seen.

    `sky` (h, w, 3) is the world's radiance, whose places are `far_m` away; (u, v) and `pick` in [0, 1).
    """
    if pick < shines.sky_share:
        height, width = shines.sky_density.shape
        k = find_first(shines.sky_cdf, np.float64(pick / shines.sky_share))
        d = sky_direction(k // width, k % width, u, v, height, width)
        row, column = sky_texel(d, sky.shape[0], sky.shape[1])
        return (scaled(d, far_m), d, shines.sky_share * shines.sky_density[k // width, k % width],
                load_pixel(sky, row, column))
    k = find_first(shines.cdf, np.float64((pick - shines.sky_share) / (ONE - shines.sky_share)))
    if u + v > ONE:
        u, v = ONE - u, ONE - v
    c = shines.corners[k]
    first = load(c, 0)
    along_u, along_v = sub(load(c, 1), first), sub(load(c, 2), first)
    way = sub(add(first, add(scaled(along_u, u), scaled(along_v, v))), p)
    face, r2, radiance = cross(along_u, along_v), dot(way, way), load(shines.radiance, k)
    distance = math.sqrt(r2)
    cosine = abs(dot(face, way)) / max(distance * math.sqrt(dot(face, face)), f32(1e-30))
    if not cosine > GRAZING or not distance > ZERO:
        return way, way, ZERO, radiance
    return way, scaled(way, ONE / distance), aimed_density(shines, radiance, distance, cosine), radiance


@inline_jit
def aimed_density(shines, radiance, distance, cosine):
    """1/sr of aiming at a place of an emissive triangle of that radiance, `distance` m away, seen at `cosine`."""
    if shines.cdf.shape[0] == 0:
        return ZERO
    mean = f32(1 / 3) * (radiance.x + radiance.y + radiance.z)
    return (ONE - shines.sky_share) * mean * shines.rcp_power * distance * distance / max(cosine, GRAZING)


@device_jit
def aimed_at_sky(shines, d):
    """1/sr of aiming at the world in direction d."""
    if shines.sky_cdf.shape[0] == 0:
        return ZERO
    row, column = sky_texel(d, shines.sky_density.shape[0], shines.sky_density.shape[1])
    return shines.sky_share * shines.sky_density[row, column]
