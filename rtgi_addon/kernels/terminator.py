"""Where shadow rays of coarse smooth-shaded meshes begin: above the surface that their normals tell.

Such a mesh turns its triangles away from a lamp before its shading normals do, and stands in its own way beside the edge of
light, the "shadow terminator". As in Cycles, rays to lamps that stand low over the triangle begin above it (Hanika 2021,
"Hacking the Shadow Terminator").
"""

from __future__ import annotations

from .brdf import HALF
from .bvh import triangle_normal
from .jit import inline_jit
from .vec3 import ONE, ZERO, Vec3, add, dot, f32, normalized_or, scaled, sub

LOW = f32(0.1)              # cosine of a lamp over a triangle from which its shadow rays are lifted: Cycles' default
NOWHERE = Vec3(ZERO, ZERO, ZERO)


@inline_jit
def _corner_normal(normals, t, corner, sign):
    n = Vec3(f32(normals[t, corner, 0]), f32(normals[t, corner, 1]), f32(normals[t, corner, 2]))
    return normalized_or(scaled(n, sign), NOWHERE)


@inline_jit
def _rise(first, second, to_corner, n):
    """How far a corner's tangent plane, moved up to clear the triangle, lies above a point of it.

    first, second: edges from the corner; to_corner: from the point; n: the corner's normal.
    """
    return max(dot(to_corner, n) + max(max(dot(first, n), dot(second, n)), ZERO), ZERO)


@inline_jit
def smooth_lift(bvh, normals, slot, a, b, side):
    """Vector from place (a, b) of a triangle to above the smooth surface that its corners' normals tell, towards `side`.

    It ends where the lowest of the tangent planes at the corners is, which clears the surface, and at least half way up a
    parabola over the edges. `normals`: `core.frame.Geometry.normals_ws`. 0 for a flat triangle.
    """
    t, c = bvh.source[slot], bvh.corners
    sign = ONE if dot(triangle_normal(bvh, slot), side) > ZERO else -ONE
    n0, n1 = _corner_normal(normals, t, 0, sign), _corner_normal(normals, t, 1, sign)
    n2 = _corner_normal(normals, t, 2, sign)
    edge_1, edge_2 = Vec3(c[slot, 3], c[slot, 4], c[slot, 5]), Vec3(c[slot, 6], c[slot, 7], c[slot, 8])
    u = ONE - a - b
    n = add(scaled(n0, u), add(scaled(n1, a), scaled(n2, b)))
    if not dot(n, side) > ZERO:
        return NOWHERE
    across = sub(edge_2, edge_1)
    by_0, by_1, by_2 = dot(sub(n1, n0), edge_1), dot(sub(n2, n1), across), dot(sub(n2, n0), edge_2)   # each edge's bend
    bend = by_2 * u * (ONE - u) + (by_0 - by_1 - by_2) * u * a + by_1 * a * (ONE - a)
    back = scaled(add(scaled(edge_1, a), scaled(edge_2, b)), -ONE)
    planes = min(min(_rise(edge_1, edge_2, back, n0), _rise(scaled(edge_1, -ONE), across, add(back, edge_1), n1)),
                 _rise(scaled(edge_2, -ONE), scaled(across, -ONE), add(back, edge_2), n2))
    return scaled(n, max(planes, HALF * bend))


@inline_jit
def lifted_share(lift, n, side, unit):
    """Share of `lift` by which a ray along the unit vector begins above the triangle, 1 where the lamp stands low; negative
    where the triangle, of normal `side`, hides the lamp from itself. n is the shading normal."""
    by_plane = dot(side, unit)
    if dot(lift, lift) > ZERO:
        by_shading = dot(n, unit)
        amount = ONE - by_plane / LOW if by_shading >= LOW else f32(2) - (by_plane + by_shading) / LOW
        if amount > ZERO:
            return min(amount, ONE)
    return ZERO if by_plane > ZERO else -ONE
