"""Irradiance at points from lit voxels: cones that are exact rays for their first part."""

from __future__ import annotations

import math

import numpy as np

from .jit import pixel_jit, prange
from .sampling import cosine_hemisphere, r2_sequence, uniform
from .vec3 import ZERO, along, f32, load, tangent_frame, to_world
from .voxel_rays import LIFT, first_surface

PI = f32(math.pi)


@pixel_jit
def gather_voxels(position, normal, ids, walk, radiance, rays, reach, seed):
    """Irradiance from lit voxels at points (M, 3), in cells, as (M, 5) float32."""
    number = position.shape[0]
    out = np.zeros((number, 5), np.float32)
    weight = PI / f32(rays)
    for m in prange(number):
        n = load(normal, m)
        tangent, bitangent = tangent_frame(n)
        origin = along(load(position, m), n, LIFT)
        shift_u, shift_v = uniform(ids[m], seed, 0), uniform(ids[m], seed, 1)
        red, green, blue, squares = ZERO, ZERO, ZERO, ZERO
        for j in range(rays):
            u, v = r2_sequence(j, shift_u, shift_v)
            d = to_world(cosine_hemisphere(u, v), tangent, bitangent, n)
            t, row, side = first_surface(walk, origin, d, n, reach)
            if row >= 0:
                r, g, b = weight * radiance[row, side, 0], weight * radiance[row, side, 1], weight * radiance[row, side, 2]
                red, green, blue = red + r, green + g, blue + b
                squares += (r + g + b) ** 2
        out[m, 0], out[m, 1], out[m, 2], out[m, 3] = red, green, blue, f32(1)
        out[m, 4] = max(f32(1 / 9) * (squares - (red + green + blue) ** 2 / f32(rays)), ZERO)
    return out
