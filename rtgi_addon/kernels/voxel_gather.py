"""Light at points from lit voxels: cones that are exact rays for their first part."""

from __future__ import annotations

import math

import numpy as np

from .brdf import INV_PI, ggx_lobe
from .jit import borrowed, device_jit, inline_jit, pixel_jit
from .sampling import cosine_hemisphere, r2_sequence, uniform
from .sky import find_first, sky_texel
from .vec3 import ONE, ZERO, Vec3, along, dot, f32, length, load, normalized_or, scaled, sub, tangent_frame, to_world
from .voxel_levels import blurred, trace_cone
from .voxel_rays import LIFT, first_surface, mask_covers, slot_box, slot_mask, slot_plane

PI = f32(math.pi)
CONE_LIFT = f32(1.5)        # cells that a cone without an exact part starts above its surface, out of its own voxels' reach
LEAST_COSINE = f32(0.05)    # of a direction that leaves a lobe's surface: bounds its radiance at grazing
GOLDEN = f32(0.6180339887)
NEAR_TARGET = f32(0.1)      # cells before and behind its target within which an aimed ray may end: seams, rounded boxes
SIDE_COLUMNS = 5            # of what a side sends: see `seen_radiance`
# columns of the lobe table
L_COLOUR, L_NORMAL, L_TO_LIGHT, L_ALPHA2, L_F0, L_LAST, LOBE_COLUMNS = 0, 3, 6, 9, 10, 11, 12


@inline_jit
def seen_radiance(radiance, lobes, row, side, d):
    """(red, green, blue) W/(m2 sr) that side `side` of voxel `row` sends against a ray along d.

    radiance (V, 6, SIDE_COLUMNS): Lambertian part, 1 + row of the side's first glossy lobe in `lobes`, 0 for none, and the
    density per cell squared with which aimed rays choose its points. A side's lobes follow each other, the last is marked.
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


@inline_jit
def _aim(rows, cells, target, u, v):
    """A point in cells on side `target` (6 row + side), even over its surface, from numbers in [0, 1)."""
    row, slot = target // 6, (target % 6) >> 1
    plane, offset = slot_plane(rows, row, slot)
    low, high = slot_box(rows, row, slot)
    mask = slot_mask(rows, row, slot)
    p = Vec3(ZERO, ZERO, ZERO)
    for _ in range(4):                           # a mask of one square in a wide box is rare, and its square near enough
        if slot == 0:
            y, z = low.y + (high.y - low.y) * u, low.z + (high.z - low.z) * v
            p = Vec3((offset - plane.y * y - plane.z * z) / plane.x, y, z)
        elif slot == 1:
            z, x = low.z + (high.z - low.z) * u, low.x + (high.x - low.x) * v
            p = Vec3(x, (offset - plane.z * z - plane.x * x) / plane.y, z)
        else:
            x, y = low.x + (high.x - low.x) * u, low.y + (high.y - low.y) * v
            p = Vec3(x, y, (offset - plane.x * x - plane.y * y) / plane.z)
        if mask_covers(mask, slot, p):
            break
        u, v = (u * f32(7.31) + v) % ONE, (v * f32(5.17) + u) % ONE
    return Vec3(f32(cells[row, 0]) + min(max(p.x, ZERO), ONE), f32(cells[row, 1]) + min(max(p.y, ZERO), ONE),
                f32(cells[row, 2]) + min(max(p.z, ZERO), ONE))


@inline_jit
def _balanced(rows, radiance, row, side, d, n, t, by_cosine, aimed):
    """Cosine over the density with which `by_cosine` cosine rays and `aimed` aimed ones find what lies t along d."""
    plane, _ = slot_plane(rows, row, side >> 1)
    cosine = dot(d, n)
    density = by_cosine * cosine * INV_PI
    density += aimed * radiance[row, side, 4] * t * t / max(abs(dot(plane, d)), f32(1e-4))
    return cosine / max(density, f32(1e-20))


@inline_jit
def _aimed_ray(rows, cells, targets, cdf, share, u, v, o, n):
    """(unit direction, distance in cells) from o to a point on the side that the running sum has at `share`.

    The distance is 0 where the point is behind the horizon, or o behind the side.
    """
    target = np.int64(targets[find_first(cdf, share)])
    goal = sub(_aim(rows, cells, target, u, v), o)
    distance = length(goal)
    if not distance > f32(1e-4) or dot(goal, n) <= ZERO:
        return n, ZERO
    d = scaled(goal, ONE / distance)
    plane, _ = slot_plane(rows, target // 6, (target % 6) >> 1)
    return d, distance if (dot(plane, d) > ZERO) == ((target & 1) == 1) else ZERO


@device_jit
def _shines(sky):
    """Is there light in any texel of a map (H, W, 3)?"""
    for i in range(sky.shape[0]):
        for j in range(sky.shape[1]):
            if sky[i, j, 0] + sky[i, j, 1] + sky[i, j, 2] > ZERO:
                return True
    return False


@pixel_jit
def _gather_voxels(begin, end, position, normal, turn, walk, cells, levels, radiance, lobes, sky, targets, cdf, cones, aimed,
                   exact, seed, out):
    walk, cells, levels, radiance, lobes, sky, targets, cdf = borrowed(
        (walk, cells, levels, radiance, lobes, sky, targets, cdf))
    by_cosine = f32(cones - aimed)
    narrow = max(ONE - ONE / f32(cones), f32(0.5))          # cosine of the half angle of an even share of the hemisphere
    tangent = math.sqrt(ONE - narrow * narrow) / narrow
    shift_u, shift_v, shift_w = uniform(0, seed, 0), uniform(0, seed, 1), uniform(0, seed, 2)
    rows, is_dark = walk.rows, not _shines(sky)
    for m in range(begin, end):
        p, n = load(position, m), load(normal, m)
        if not math.isfinite(p.x + p.y + p.z):
            continue
        u_axis, v_axis = tangent_frame(n)
        o = along(p, n, LIFT if exact > ZERO else CONE_LIFT)
        first_share = (shift_w + f32(turn[m]) * GOLDEN) % ONE
        red, green, blue, squares = ZERO, ZERO, ZERO, ZERO
        for j in range(cones):
            u, v = r2_sequence(turn[m] * cones + j, shift_u, shift_v)
            reach, at_least = exact, ZERO
            if j >= aimed:
                d = to_world(cosine_hemisphere(u, v), u_axis, v_axis, n)
            else:
                d, distance = _aimed_ray(rows, cells, targets, cdf, (f32(j) + first_share) / f32(aimed), u, v, o, n)
                if distance == ZERO:
                    continue
                reach, at_least = distance + NEAR_TARGET, distance - NEAR_TARGET
            t, row, side = ZERO, np.int64(-1), 0
            if exact > ZERO:
                t, row, side = first_surface(walk, o, d, n, reach)
            weight = PI / f32(cones)
            if row >= 0:
                if t < at_least:
                    continue
                r, g, b = seen_radiance(radiance, lobes, row, side, d)
                if aimed > 0:
                    weight = _balanced(rows, radiance, row, side, d, n, t, by_cosine, f32(aimed))
            elif aimed > 0 or (is_dark and t < exact):
                continue
            else:
                r, g, b, visibility = ZERO, ZERO, ZERO, ONE
                if t >= exact:
                    r, g, b, visibility = trace_cone(levels, o, d, t, tangent, f32(1e30))
                if visibility > ZERO and not is_dark:
                    x, y = sky_texel(d, sky.shape[0], sky.shape[1])
                    r, g, b = r + visibility * sky[x, y, 0], g + visibility * sky[x, y, 1], b + visibility * sky[x, y, 2]
            red, green, blue = red + weight * r, green + weight * g, blue + weight * b
            squares += (weight * (r + g + b)) ** 2
        out[m, 0], out[m, 1], out[m, 2], out[m, 3] = red, green, blue, ONE
        out[m, 4] = max(f32(1 / 9) * (squares - (red + green + blue) ** 2 / f32(cones)), ZERO)


def gather_voxels(position, normal, turn, walk, cells, levels, radiance, lobes, sky, targets, cdf, cones, aimed, exact,
                  seed):
    """Irradiance from lit voxels at points (M, 3), in cells, as (M, 5) float32.

    Columns: irradiance by colour, W/m2; 1, since there is no unshadowed light to compare it with; variance of the mean over
    the colours. The cones share the hemisphere by cosine, each as wide as its share. `turn` (M,) tells which run of
    one low-discrepancy sequence a point takes: neighbours take runs that complement each other. `aimed` of the rays go to
    the sides `targets` (S,), drawn by the running sum `cdf`; both sorts are weighed by the balance heuristic (Veach
    1997, Eq. 9.8), by the density of the points that they find.
    """
    number = position.shape[0]
    out = np.zeros((number, 5), np.float32)
    _gather_voxels(number, position, normal, turn, walk, cells, levels, radiance, lobes, sky, targets, cdf, cones, aimed,
                   exact, seed, out)
    return out


@pixel_jit
def _gather_reflections(begin, end, position, normal, to_viewer, roughness, walk, levels, radiance, lobes, spread, out):
    walk, levels, radiance, lobes = borrowed((walk, levels, radiance, lobes))
    for m in range(begin, end):
        p, n, v = load(position, m), load(normal, m), load(to_viewer, m)
        if not math.isfinite(p.x + p.y + p.z):
            continue
        alpha = roughness[m] * roughness[m]
        mirror = sub(scaled(n, f32(2) * dot(n, v)), v)
        lean = (ONE - alpha) * (math.sqrt(max(ONE - alpha, ZERO)) + alpha)
        d = normalized_or(along(scaled(n, ONE - lean), mirror, lean), n)
        if dot(d, n) <= ZERO:
            continue
        o = along(p, n, LIFT)
        t, row, side = first_surface(walk, o, d, n, f32(1e30))
        if row < 0:
            continue
        red, green, blue = seen_radiance(radiance, lobes, row, side, d)
        width = f32(2) * t * spread * alpha
        if width > ONE:
            cover, r, g, b = blurred(levels, along(o, d, t), d, width)
            share = min(width - ONE, ONE) if cover > ZERO else ZERO
            rcp = ONE / max(cover, f32(1e-20))
            red, green, blue = (red + share * (r * rcp - red), green + share * (g * rcp - green),
                                blue + share * (b * rcp - blue))
        out[m, 0], out[m, 1], out[m, 2] = red, green, blue


def gather_reflections(position, normal, to_viewer, roughness, walk, levels, radiance, lobes, spread):
    """(M, 3) float32 radiance W/(m2 sr) that one cone brings to each point (M, 3), in cells, for its glossy lobe.

    to_viewer (M, 3) unit vectors, roughness (M,). The cone follows the lobe's middle, which leans towards the normal as
    roughness grows (Lagarde and de Rousiers 2014, Listing 21), and its half angle has the tangent `spread` times GGX's
    alpha. A ray finds where it ends, and the levels tell what lies there across the cone's width: a cone that is traced
    through the levels as a whole brings light from behind walls (living room: 40 % more error).
    """
    out = np.zeros((position.shape[0], 3), np.float32)
    _gather_reflections(position.shape[0], position, normal, to_viewer, roughness, walk, levels, radiance, lobes, spread,
                        out)
    return out
