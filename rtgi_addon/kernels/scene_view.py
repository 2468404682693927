"""Views of the scene through its triangles alone: rays for pixels, and the colours of what they meet."""

from __future__ import annotations

import numpy as np

from .brdf import matt_share
from .bvh import STACK, closest_hit, triangle_normal
from .jit import borrowed, pixel_jit, scratch
from .scene_light import colours_at
from .vec3 import ONE, ZERO, along, dot, f32, load, normalized_or, scaled


@pixel_jit
def see_triangles(begin, end, origin, direction, bvh, around, albedos, means, near, reach, distance, position, normal,
                  albedo, specular, roughness, f0):
    """What N rays meet first between `near` and `reach`, in lengths of their directions; what meets nothing stays as it is.

    `origin` (N, 3) m, `direction` (N, 3); `around`: see `scene_light.Surroundings`. Results (N,) or (N, 3) float32:
    `distance` in lengths of the direction, `position` m, unit `normal` of the triangle on the viewer's side, `albedo` and
    `specular` as Cycles' Diffuse and Glossy Color have them towards the viewer, `roughness` and `f0` of the lobe.
    `albedos`, `means`: `brdf.albedo_table()` and `brdf.mean_albedo_table()`.
    """
    bvh, around = borrowed((bvh, around))
    stack = scratch(STACK, np.int32)
    for k in range(begin, end):
        d = load(direction, k)
        start = along(load(origin, k), d, near)
        t, slot, a, b = closest_hit(bvh, stack, start, d, reach)
        if slot < 0:
            continue
        n, p, to_viewer = triangle_normal(bvh, slot), along(start, d, t), normalized_or(scaled(d, -ONE), d)
        if dot(n, d) > ZERO:
            n = scaled(n, -ONE)
        cosine = min(max(dot(n, to_viewer), ZERO), ONE)
        colour, gloss, roughness[k], f0[k] = colours_at(around, albedos, bvh.source[slot], a, b, cosine)
        # what lies under a dielectric's lobe is seen the darker, the flatter it is seen
        reflectance = (gloss.x + gloss.y + gloss.z) * f32(1 / 3)
        colour = scaled(colour, ONE / matt_share(reflectance, cosine, roughness[k] * roughness[k], f0[k], albedos, means))
        distance[k] = t + near
        position[k, 0], position[k, 1], position[k, 2] = p.x, p.y, p.z
        normal[k, 0], normal[k, 1], normal[k, 2] = n.x, n.y, n.z
        albedo[k, 0], albedo[k, 1], albedo[k, 2] = colour.x, colour.y, colour.z
        specular[k, 0], specular[k, 1], specular[k, 2] = gloss.x, gloss.y, gloss.z
