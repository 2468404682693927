"""Light at points from lit voxels: cones that are exact rays for their first part."""

from __future__ import annotations

import math

import numpy as np

from .brdf import ggx_lobe
from .jit import device_jit, pixel_jit, prange
from .sampling import cosine_hemisphere, r2_sequence, uniform
from .sky import sky_texel
from .vec3 import ONE, ZERO, Vec3, along, dot, f32, load, scaled, tangent_frame, to_world
from .voxel_levels import trace_cone
from .voxel_rays import LIFT, first_surface

PI = f32(math.pi)
CONE_LIFT = f32(1.5)        # cells that a cone without an exact part starts above its surface, out of its own voxels' reach
LEAST_COSINE = f32(0.05)    # of a direction that leaves a lobe's surface: bounds its radiance at grazing
HALF_VOXEL = f32(0.5)
# columns of the lobe table
L_COLOUR, L_NORMAL, L_TO_LIGHT, L_ALPHA2, L_F0, L_LAST, LOBE_COLUMNS = 0, 3, 6, 9, 10, 11, 12


@device_jit
def seen_radiance(radiance, lobes, row, side, d):
    """(red, green, blue) W/(m2 sr) that side `side` of voxel `row` sends against a ray along d.

    radiance (V, 6, 4): Lambertian part, and 1 + row of the side's first glossy lobe in `lobes`, 0 for none; a side's lobes
    follow each other, the last one is marked.
    """
    red, green, blue = radiance[row, side, 0], radiance[row, side, 1], radiance[row, side, 2]
    k = int(radiance[row, side, 3]) - 1
    while k >= 0:
        m, back = Vec3(lobes[k, L_NORMAL], lobes[k, L_NORMAL + 1], lobes[k, L_NORMAL + 2]), scaled(d, -ONE)
        cosine = dot(m, back)
        if cosine > ZERO:
            w = Vec3(lobes[k, L_TO_LIGHT], lobes[k, L_TO_LIGHT + 1], lobes[k, L_TO_LIGHT + 2])
            gain = ggx_lobe(m, w, back, lobes[k, L_ALPHA2], lobes[k, L_F0]) / max(cosine, LEAST_COSINE)
            red, green, blue = red + gain * lobes[k, 0], green + gain * lobes[k, 1], blue + gain * lobes[k, 2]
        k = k + 1 if lobes[k, L_LAST] == ZERO else -1
    return red, green, blue


@device_jit
def cone_radiance(walk, levels, radiance, lobes, sky, p, n, d, exact, tangent):
    """(red, green, blue) W/(m2 sr) that arrives at p, in cells, along -d: a ray for `exact` cells, then a cone, then the sky."""
    if exact > ZERO:
        o, t = along(p, n, LIFT), exact
        t, row, side = first_surface(walk, o, d, n, exact)
        if row >= 0:
            return seen_radiance(radiance, lobes, row, side, d)
        red, green, blue, visibility = ZERO, ZERO, ZERO, ONE
        if t >= exact:
            red, green, blue, visibility = trace_cone(levels, o, d, t, tangent, f32(1e30))
    else:
        red, green, blue, visibility = trace_cone(levels, along(p, n, CONE_LIFT), d, ZERO, tangent, f32(1e30))
    if visibility > ZERO:
        i, j = sky_texel(d, sky.shape[0], sky.shape[1])
        red, green, blue = red + visibility * sky[i, j, 0], green + visibility * sky[i, j, 1], blue + visibility * sky[i, j, 2]
    return red, green, blue


@pixel_jit
def gather_voxels(position, normal, ids, walk, levels, radiance, lobes, sky, cones, exact, seed):
    """Irradiance from lit voxels at points (M, 3), in cells, as (M, 5) float32.

    Columns: irradiance by colour, W/m2; 1, since there is no unshadowed light to compare it with; variance of the mean over
    the colours. The cones share the hemisphere by cosine, each as wide as its share, and are turned from point to point.
    """
    number = position.shape[0]
    out = np.zeros((number, 5), np.float32)
    weight = PI / f32(cones)
    narrow = max(ONE - ONE / f32(cones), f32(0.5))          # cosine of the half angle of an even share of the hemisphere
    tangent = math.sqrt(ONE - narrow * narrow) / narrow
    for m in prange(number):
        p, n = load(position, m), load(normal, m)
        u_axis, v_axis = tangent_frame(n)
        shift_u, shift_v = uniform(ids[m], seed, 0), uniform(ids[m], seed, 1)
        red, green, blue, squares = ZERO, ZERO, ZERO, ZERO
        for j in range(cones):
            u, v = r2_sequence(j, shift_u, shift_v)
            d = to_world(cosine_hemisphere(u, v), u_axis, v_axis, n)
            r, g, b = cone_radiance(walk, levels, radiance, lobes, sky, p, n, d, exact, tangent)
            red, green, blue = red + weight * r, green + weight * g, blue + weight * b
            squares += (weight * (r + g + b)) ** 2
        out[m, 0], out[m, 1], out[m, 2], out[m, 3] = red, green, blue, ONE
        out[m, 4] = max(f32(1 / 9) * (squares - (red + green + blue) ** 2 / f32(cones)), ZERO)
    return out


@pixel_jit
def gather_reflections(position, normal, direction, tangent, walk, levels, radiance, lobes, sky, out):
    """Radiance (M, 3) W/(m2 sr) that one cone along each reflected `direction` (M, 3) brings, in place.

    `tangent` (M,) is that of the cone's half angle: it is an exact ray while it is narrower than a voxel.
    """
    for m in prange(position.shape[0]):
        exact = HALF_VOXEL / max(tangent[m], f32(1e-4))
        out[m, 0], out[m, 1], out[m, 2] = cone_radiance(walk, levels, radiance, lobes, sky, load(position, m),
                                                        load(normal, m), load(direction, m), exact, tangent[m])
