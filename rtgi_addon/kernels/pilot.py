"""Rays cast ahead of a view: what lights the picture, and views of the scene through its triangles alone."""

from __future__ import annotations

import numpy as np

from .bvh import STACK, closest_hit, is_occluded, triangle_normal
from .jit import borrowed, pixel_jit, scratch
from .sampling import cosine_hemisphere, r2_sequence, uniform
from .vec3 import ONE, along, dot, f32, lifted, load, scaled, tangent_frame, to_world


@pixel_jit
def _lit_hits(begin, end, position, normal, bvh, to_sun, rays, offset_m, reach_m, seed, out, lit):
    bvh, = borrowed((bvh,))
    stack = scratch(STACK, np.int32)
    for m in range(begin, end):
        n = load(normal, m)
        tangent, bitangent = tangent_frame(n)
        origin = lifted(load(position, m), n, offset_m)
        shift_u, shift_v = uniform(m, seed, 0), uniform(m, seed, 1)
        for j in range(rays):
            u, v = r2_sequence(j, shift_u, shift_v)
            d = to_world(cosine_hemisphere(u, v), tangent, bitangent, n)
            t, slot, _, _ = closest_hit(bvh, stack, origin, d, reach_m)
            if slot < 0:
                continue
            face = triangle_normal(bvh, slot)
            if dot(face, d) > f32(0):
                face = scaled(face, -ONE)
            if dot(face, to_sun) <= f32(0):
                continue
            hit = lifted(along(origin, d, t), face, offset_m)
            if not is_occluded(bvh, stack, hit, scaled(to_sun, reach_m)):
                k = m * rays + j
                lit[k] = True
                out[k, 0], out[k, 1], out[k, 2] = hit.x, hit.y, hit.z


def lit_hits(position, normal, bvh, to_sun, rays, offset_m, reach_m, seed):
    """Points seen from (M, 3) points along `rays` cosine-distributed rays each that lie in direction `to_sun`'s light.

    Returns ((M * rays, 3) float32 m, (M * rays,) bool).
    """
    number = position.shape[0]
    out, lit = np.zeros((number * rays, 3), np.float32), np.zeros(number * rays, np.bool_)
    _lit_hits(number, position, normal, bvh, to_sun, rays, offset_m, reach_m, seed, out, lit)
    return out, lit


@pixel_jit
def _cast_rays(begin, end, origin, direction, bvh, near, reach, distance, slots, us, vs):
    bvh, = borrowed((bvh,))
    stack = scratch(STACK, np.int32)
    for i in range(begin, end):
        d = load(direction, i)
        start = along(load(origin, i), d, near)
        t, slot, u, v = closest_hit(bvh, stack, start, d, reach)
        if slot >= 0:
            distance[i], slots[i], us[i], vs[i] = t + near, slot, u, v


def cast_rays(origin, direction, bvh, near, reach):
    """Nearest triangle along (N, 3) rays: (distance in lengths of the direction (N,) float32, slot (N,) int32 or -1,
    barycentric u and v (N,) float32)."""
    number = origin.shape[0]
    distance, slots = np.full(number, np.inf, np.float32), np.full(number, -1, np.int32)
    us, vs = np.zeros(number, np.float32), np.zeros(number, np.float32)
    _cast_rays(number, origin, direction, bvh, near, reach, distance, slots, us, vs)
    return distance, slots, us, vs
