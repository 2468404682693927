"""Photons: light of lamps followed off mirror-like surfaces to where it falls, which is what caustics are made of.

A sharp lobe sends its light to a place that no point on the receiver would draw, but from the lamp's side it is one ray:
through the texel of the lamp's view, off the lobe, to the surface that it meets (Arvo 1986; Jensen 1996). There it leaves
its flux. The irradiance of a pixel is the flux of the photons around it over their area. Each photon has a disk of its own
(the sample point estimator, Silverman 1986) that holds so many others that their noise is `NOISE` of the bounce beside
them: small where light is focused, so that edges stay sharp, and where it is too faint to matter. Disks keep a photon's
flux, and a pixel is in about as many of them as a disk holds photons, so that the cost follows the lit pixels.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .brdf import fit_lobe, fresnel, sample_lobe
from .bvh import STACK, closest_hit, triangle_normal
from .jit import borrowed, device_jit, inline_jit, pixel_jit, scratch
from .lamps import lamp_at, lamp_place
from .reflect import LEAST_COSINE, MIRROR_ALPHA
from .sampling import dither, place_id, r2_sequence
from .screen import HALF, pixel_radius, to_screen
from .shadow import ORTHOGRAPHIC
from .vec3 import ONE, ZERO, Vec3, add, along, begun, dot, f32, length, lifted, load, load_pixel, normalized_or, scaled, sub

NEIGHBOURS = 100            # photons in a disk at most: 50 leave half as much noise again, 200 blur edges
FEWEST = 12                 # and at least
NOISE = 0.05                # standard deviation over the bounce
COUNTED = 8                 # photons that are looked for: their distance tells the density well enough
TILE = 8                    # rows of the picture in a band, which one thread sums at a time, and pixels in its tiles
SAME_SIDE = f32(0.5)        # cosine of two normals of one surface
FLAT = f32(0.5)             # height over a photon's plane, in radii of its disk, at which a pixel is another surface
SMOOTH = f32(0.9)           # cosine of the normals of two texels between which a surface is bent, not broken
MOST_TILT = f32(4)          # of a bumped normal over the surface's own towards the light
MORTON_BITS = 20            # an axis
LEAF = 16                   # photons in a run of the search tree


class Photons(NamedTuple):
    """Where light of sharp lobes falls: N photons.

    position (N, 3) m; normal (N, 3) unit, of the triangle, on the side where the light comes from; heading (N, 3) unit,
    along which it comes; flux (N, 3) W; radius2 (N,) m2 of each photon's disk.
    """

    position: np.ndarray
    normal: np.ndarray
    heading: np.ndarray
    flux: np.ndarray
    radius2: np.ndarray


def make_photons(number: int) -> Photons:
    """Room for `number` photons."""
    return Photons(*(np.zeros((number, 3), np.float32) for _ in range(4)), np.zeros(number, np.float32))


class Mirrors(NamedTuple):
    """One lamp's view as photons start from it.

    Images (H, W, ...) as in `core.frame.GBuffer`, and `flux` (H, W, 3) W that arrives. owner (H, W) int32: flat index of the
    texel whose surface a texel's photons look for, itself or a neighbour beyond an edge, -1 for none. origin, direction
    (H + 1, W + 1, 3): rays through the corners of the texels. material (H, W) int32: see `find_materials`, and of_triangle
    (T,) int32 that of each triangle. albedos: `brdf.albedo_table()`.
    """

    position_ws: np.ndarray
    normal_ws: np.ndarray
    specular: np.ndarray
    roughness: np.ndarray
    f0: np.ndarray
    flux: np.ndarray
    owner: np.ndarray
    origin: np.ndarray
    direction: np.ndarray
    material: np.ndarray
    of_triangle: np.ndarray
    albedos: np.ndarray


@pixel_jit
def count_photons(begin, end, expected, seed, count):
    """Whole numbers (H, W) int32 of the mean `expected` (H, W), whose remainders neighbours even out; row by row."""
    for i in range(begin, end):
        for j in range(expected.shape[1]):
            count[i, j] = int(expected[i, j] + dither(place_id(i, j), seed, 0))


@inline_jit
def _step(m, i, j, k, l, p, n):
    """(is it one surface, change of position, change of normal) from texel (i, j) to (k, l)."""
    none = Vec3(ZERO, ZERO, ZERO)
    if k < 0 or l < 0 or k >= m.roughness.shape[0] or l >= m.roughness.shape[1]:
        return False, none, none
    other = load_pixel(m.normal_ws, k, l)
    to = sub(load_pixel(m.position_ws, k, l), p)
    if not (dot(n, other) > SMOOTH and abs(dot(n, to)) < HALF * length(to)):
        return False, none, none
    return True, to, sub(other, n)


@inline_jit
def _slope(m, i, j, down, right, p, n):
    """`_step` to a neighbour, or back from the opposite one where the surface ends in between."""
    is_one, moved, bent = _step(m, i, j, i + down, j + right, p, n)
    if not is_one:
        _, moved, bent = _step(m, i, j, i - down, j - right, p, n)
        moved, bent = scaled(moved, -ONE), scaled(bent, -ONE)
    return moved, bent


@inline_jit
def _corner_mean(rays, i, j, x, y):
    """What `rays` (H + 1, W + 1, 3) hold at the corners of texel (i, j), at place (x, y) of [0, 1]^2 in it."""
    top = add(scaled(load_pixel(rays, i, j), ONE - x), scaled(load_pixel(rays, i, j + 1), x))
    low = add(scaled(load_pixel(rays, i + 1, j), ONE - x), scaled(load_pixel(rays, i + 1, j + 1), x))
    return add(scaled(top, ONE - y), scaled(low, y))


@inline_jit
def _ray_to(m, i, j, x, y, likely):
    """(origin, direction, distance, miss): the view's ray through place (x, y) of texel (i, j), and where it passes a point.

    `distance` along the ray is where the point is nearest, `miss` how far from it the ray is there.
    """
    origin = _corner_mean(m.origin, i, j, x, y)
    to = sub(likely, origin)
    direction = normalized_or(_corner_mean(m.direction, i, j, x, y), to)
    distance = dot(to, direction)
    return origin, direction, distance, length(along(to, direction, -distance))


@inline_jit
def _meet_near(bvh, stack, origin, direction, distance, reach):
    """(slot of the triangle that a ray meets within `reach` of `distance`, -1 for none, point)."""
    start = along(origin, direction, max(distance - reach, ZERO))
    t, slot, _, _ = closest_hit(bvh, stack, start, direction, f32(2) * reach)
    return slot, along(start, direction, t)


@pixel_jit
def find_materials(begin, end, texel, m, bvh, least_m):
    """Write to `m.material` that of the triangle which each of the texels `texel` (K,) shows; -1 where there is none."""
    m, bvh = borrowed((m, bvh))
    stack, width = scratch(STACK, np.int32), m.roughness.shape[1]
    for k in range(begin, end):
        i, j = texel[k] // width, texel[k] % width
        p = load_pixel(m.position_ws, i, j)
        origin, direction, distance, miss = _ray_to(m, i, j, HALF, HALF, p)
        slot, _ = _meet_near(bvh, stack, origin, direction, distance, miss + least_m)
        m.material[i, j] = m.of_triangle[bvh.source[slot]] if slot >= 0 else -1


@inline_jit
def _lit_place(m, bvh, stack, i, j, x, y, least_m):
    """(is there one, point, normal) of the mirror that the lamp sees at place (x, y) of texel (i, j).

    The point is the triangle's, so that edges are sharp; the normal is the view's, bent as its neighbours are.
    """
    width = m.roughness.shape[1]
    own_i, own_j = m.owner[i, j] // width, m.owner[i, j] % width
    p, n = load_pixel(m.position_ws, own_i, own_j), load_pixel(m.normal_ws, own_i, own_j)
    right, down = f32(j - own_j) + x - HALF, f32(i - own_i) + y - HALF
    across, bent_across = _slope(m, own_i, own_j, 0, 1 if right >= ZERO else -1, p, n)
    below, bent_below = _slope(m, own_i, own_j, 1 if down >= ZERO else -1, 0, p, n)
    moved = add(scaled(across, abs(right)), scaled(below, abs(down)))
    bent = add(scaled(bent_across, abs(right)), scaled(bent_below, abs(down)))
    origin, direction, distance, miss = _ray_to(m, i, j, x, y, add(p, moved))
    slot, place = _meet_near(bvh, stack, origin, direction, distance, length(moved) + f32(2) * miss + least_m)
    is_it = slot >= 0 and m.of_triangle[bvh.source[slot]] == m.material[own_i, own_j]
    return is_it, place, normalized_or(add(n, bent), n)


@inline_jit
def _towards_lamp(lamp, p, n, u, v):
    """Unit vector from p to a place on the lamp, to its middle where that place sends p nothing."""
    x, y, share = lamp_place(lamp, p, u, v)
    to, weight = lamp_at(lamp, p, x, y)
    unit = normalized_or(to, n)
    if not (dot(n, unit) > LEAST_COSINE and share > ZERO and weight > ZERO):
        to, _ = lamp_at(lamp, p, ZERO, ZERO)
        unit = normalized_or(to, n)
    return unit


@inline_jit
def _reflected(m, i, j, n, unit, u, v):
    """(direction, weight) drawn from the lobe of texel (i, j) for light along -unit; weight 0 where it goes nowhere."""
    cosine, alpha = dot(n, unit), m.roughness[i, j] * m.roughness[i, j]
    if not cosine > LEAST_COSINE:
        return n, ZERO
    if alpha < MIRROR_ALPHA:
        return sub(scaled(n, f32(2) * cosine), unit), ONE
    reflectance = (m.specular[i, j, 0] + m.specular[i, j, 1] + m.specular[i, j, 2]) * f32(1 / 3)
    f0, gain = fit_lobe(reflectance, cosine, alpha, m.albedos, m.f0[i, j])
    d, weight = sample_lobe(n, unit, alpha, u, v)
    return d, weight * gain * fresnel(max(dot(normalized_or(add(unit, d), n), unit), ZERO), f0) / fresnel(cosine, f0)


@pixel_jit
def shoot_photons(begin, end, texel, ordinal, expected, m, lamp, bvh, offset_m, least_m, reach_m, seed, photons, landed):
    """Follow photon k of range(K), the `ordinal[k]`-th of the flat index `texel[k]`; landed (K,) tells which met a surface.

    `expected` (H, W) photons share a texel's flux. Within a texel they start spread out, and they come from all of the lamp.
    `photons` are written but for `radius2`.
    """
    m, lamp, bvh, photons = borrowed((m, lamp, bvh, photons))
    stack, width = scratch(STACK, np.int32), m.roughness.shape[1]
    for k in range(begin, end):
        i, j = texel[k] // width, texel[k] % width
        place, number = place_id(i, j), ordinal[k]
        x, y = r2_sequence(number, dither(place, seed, 0), dither(place, seed, 1))
        landed[k], p, n = _lit_place(m, bvh, stack, i, j, x, y, least_m)
        if not landed[k]:
            continue
        landed[k] = False
        # of each number a pattern of its own: neighbours' fill each other's gaps, and a texel's own are independent
        pattern = seed + 2 * number + 1
        unit = _towards_lamp(lamp, p, n, dither(place, pattern, 0), dither(place, pattern, 1))
        own_i, own_j = m.owner[i, j] // width, m.owner[i, j] % width
        u, v = dither(place, pattern + 1, 0), dither(place, pattern + 1, 1)
        d, weight = _reflected(m, own_i, own_j, n, unit, u, v)
        if not (weight > ZERO and dot(d, n) > ZERO):
            continue
        start = begun(lifted(p, n, offset_m), d, offset_m)
        t, slot, _, _ = closest_hit(bvh, stack, start, d, reach_m)
        if slot < 0:
            continue
        hit, normal = along(start, d, t), triangle_normal(bvh, slot)
        if dot(normal, d) > ZERO:
            normal = scaled(normal, -ONE)
        landed[k] = True
        photons.position[k, 0], photons.position[k, 1], photons.position[k, 2] = hit.x, hit.y, hit.z
        photons.normal[k, 0], photons.normal[k, 1], photons.normal[k, 2] = normal.x, normal.y, normal.z
        photons.heading[k, 0], photons.heading[k, 1], photons.heading[k, 2] = d.x, d.y, d.z
        for c in range(3):
            photons.flux[k, c] = weight / expected[i, j] * m.flux[i, j, c] * m.specular[own_i, own_j, c]


# ---- the disks ----

@device_jit
def _spread_bits(x):
    """The lowest 20 bits of x with two zeros between each."""
    x = np.uint64(x) & np.uint64(0xFFFFF)
    x = (x | x << np.uint64(32)) & np.uint64(0x001F00000000FFFF)
    x = (x | x << np.uint64(16)) & np.uint64(0x001F0000FF0000FF)
    x = (x | x << np.uint64(8)) & np.uint64(0x100F00F00F00F00F)
    x = (x | x << np.uint64(4)) & np.uint64(0x10C30C30C30C30C3)
    return (x | x << np.uint64(2)) & np.uint64(0x1249249249249249)


@pixel_jit
def _morton_codes(begin, end, position, low, scale, codes):
    for k in range(begin, end):
        codes[k] = 0
        for a in range(3):
            x = int((position[k, a] - low[a]) * scale * f32(1 << MORTON_BITS))
            codes[k] |= _spread_bits(x) << np.uint64(a)


@device_jit
def _boxes_over(order, photons, leaves):
    """(2 leaves, 6) float32: lowest and highest corner of a binary tree over runs of LEAF photons of `order`.

    Node q has the children 2 q and 2 q + 1, leaf q - leaves holds the photons of the run of that number.
    """
    boxes = np.empty((2 * leaves, 6), np.float32)
    boxes[:, :3], boxes[:, 3:] = f32(3e38), f32(-3e38)
    for at in range(len(order)):
        q = leaves + at // LEAF
        for a in range(3):
            x = photons.position[order[at], a]
            boxes[q, a], boxes[q, 3 + a] = min(boxes[q, a], x), max(boxes[q, 3 + a], x)
    for q in range(leaves - 1, 0, -1):
        for a in range(3):
            boxes[q, a] = min(boxes[2 * q, a], boxes[2 * q + 1, a])
            boxes[q, 3 + a] = max(boxes[2 * q, 3 + a], boxes[2 * q + 1, 3 + a])
    return boxes


@inline_jit
def _box_distance2(boxes, q, p):
    """Squared distance of p from box q of (N, 6)."""
    x = max(max(boxes[q, 0] - p.x, p.x - boxes[q, 3]), ZERO)
    y = max(max(boxes[q, 1] - p.y, p.y - boxes[q, 4]), ZERO)
    z = max(max(boxes[q, 2] - p.z, p.z - boxes[q, 5]), ZERO)
    return x * x + y * y + z * z


@inline_jit
def _nearest(at, order, boxes, leaves, photons, best, stack):
    """Squared distance from photon `order[at]` to the len(best)-th like one; `best` holds the most that it may be."""
    k, last = order[at], len(best) - 1
    p, n = load(photons.position, k), load(photons.normal, k)
    # its own run first, which leaves little of the tree to look at
    own, is_own_done = leaves + at // LEAF, False
    stack[0], stack[1], depth = 1, own, 2
    while depth > 0:
        depth -= 1
        q = stack[depth]
        if (q == own and is_own_done) or _box_distance2(boxes, q, p) >= best[last]:
            continue
        is_own_done = is_own_done or q == own
        if q < leaves:
            # the nearer child on top
            is_first = _box_distance2(boxes, 2 * q, p) <= _box_distance2(boxes, 2 * q + 1, p)
            stack[depth], stack[depth + 1] = (2 * q + 1, 2 * q) if is_first else (2 * q, 2 * q + 1)
            depth += 2
            continue
        first = (q - leaves) * LEAF
        for other in range(first, min(first + LEAF, len(order))):
            d = sub(load(photons.position, order[other]), p)
            d2 = dot(d, d)
            if other == at or d2 >= best[last] or dot(n, load(photons.normal, order[other])) < SAME_SIDE:
                continue
            slot = last
            while slot > 0 and best[slot - 1] > d2:
                best[slot] = best[slot - 1]
                slot -= 1
            best[slot] = d2
    return best[last]


@pixel_jit
def _find_radii(begin, end, order, boxes, leaves, photons, nearest, level, most2):
    """Write `radius2`, at most `most2`, for runs of photons from the distance to the nearest-th with a like normal.

    Photons that are nearer than that to the one before share its distance. `level` W/m2: what one photon a disk may give.
    """
    photons, = borrowed((photons,))
    best, stack = np.empty(nearest, np.float32), np.empty(64, np.int64)
    for run in range(begin, end):
        asked, distance2 = -1, ZERO
        for at in range(run * LEAF, min(run * LEAF + LEAF, len(order))):
            k = order[at]
            d = sub(load(photons.position, k), load(photons.position, asked)) if asked >= 0 else Vec3(ZERO, ZERO, ZERO)
            if asked < 0 or dot(d, d) >= distance2:
                best[:] = most2
                asked, distance2 = k, _nearest(at, order, boxes, leaves, photons, best, stack)
            flux = (photons.flux[k, 0] + photons.flux[k, 1] + photons.flux[k, 2]) * f32(1 / 3)
            # n photons of E W/m2 are off by E / sqrt(n)
            above = flux * f32(nearest / math.pi) / max(distance2 * level, f32(1e-30))
            number = min(max(above * above, f32(FEWEST)), f32(NEIGHBOURS))
            photons.radius2[k] = min(distance2 * number / f32(nearest), most2)


def spread_photons(photons: Photons, irradiance: float, most_m: float, least_m: float) -> None:
    """Write `radius2`, no disk larger than `most_m` or smaller than `least_m`, beside other light of `irradiance` W/m2.

    The distance to the `COUNTED`-th nearest photon tells how dense they are. Photons are sorted along a Morton curve, whose
    runs have tight boxes.
    """
    low = photons.position.min(0)
    scale = f32(0.999) / max(f32((photons.position.max(0) - low).max()), f32(1e-30))
    codes = np.empty(len(photons.position), np.uint64)
    _morton_codes(len(codes), photons.position, low, scale, codes)
    order = np.argsort(codes)
    leaves = 1 << max(int(len(order) - 1) // LEAF, 0).bit_length()
    boxes = _boxes_over(order, photons, leaves)
    _find_radii(-(-len(order) // LEAF), order, boxes, leaves, photons, COUNTED, f32(NOISE * irradiance), f32(most_m**2))
    np.maximum(photons.radius2, np.float32(least_m**2), out=photons.radius2)


# ---- the picture ----

@pixel_jit
def _box_photons(begin, end, photons, screen, boxes):
    """First and last row and column of the picture that each disk may reach; an empty range of rows for none."""
    photons, screen = borrowed((photons, screen))
    height, width = screen.depth.shape
    for k in range(begin, end):
        boxes[k, 0], boxes[k, 1], boxes[k, 2], boxes[k, 3] = 0, -1, 0, width - 1
        radius = math.sqrt(photons.radius2[k])
        column, row, depth = to_screen(screen, load(photons.position, k))
        if screen.projection != ORTHOGRAPHIC and depth <= radius * f32(1.01):
            if depth > -radius:                  # around the eye: anywhere
                boxes[k, 1] = height - 1
            continue
        # a ball off the axis looks longer than one on it
        x, y = (column + HALF) * screen.step_x + screen.left, screen.top - (row + HALF) * screen.step_y
        long = ONE if screen.projection == ORTHOGRAPHIC else math.sqrt(ONE + x * x + y * y)
        nearest = depth if screen.projection == ORTHOGRAPHIC else depth - radius
        reach = pixel_radius(screen, nearest, radius) * long
        reach_x = reach * math.sqrt(screen.step_y / screen.step_x) + ONE
        reach_y = reach * math.sqrt(screen.step_x / screen.step_y) + ONE
        boxes[k, 0], boxes[k, 1] = int(max(row - reach_y, ZERO)), int(min(row + reach_y, f32(height - 1)))
        boxes[k, 2], boxes[k, 3] = int(max(column - reach_x, ZERO)), int(min(column + reach_x, f32(width - 1)))
        if row + reach_y < ZERO or column + reach_x < ZERO or row - reach_y > f32(height) or column - reach_x > f32(width):
            boxes[k, 1] = -1


@device_jit
def _list_by_band(boxes, first, listed):
    """Photons of each band of rows, `listed[first[b]:first[b + 1]]`; with an empty list it only counts."""
    cursor = first[:-1].copy()
    for k in range(len(boxes)):
        for band in range(boxes[k, 0] // TILE, boxes[k, 1] // TILE + 1 if boxes[k, 1] >= 0 else 0):
            if len(listed):
                listed[cursor[band]] = k
            else:
                first[band + 1] += 1
            cursor[band] += 1


@pixel_jit
def _bound_tiles(begin, end, screen, bounds):
    """Lowest and highest corner (bands, tiles, 6) of what the pixels of each tile see."""
    screen, = borrowed((screen,))
    height, width = screen.depth.shape
    for band in range(begin, end):
        for tile in range(bounds.shape[1]):
            bounds[band, tile, :3], bounds[band, tile, 3:] = f32(3e38), f32(-3e38)
        for i in range(band * TILE, min((band + 1) * TILE, height)):
            for j in range(width):
                if screen.depth[i, j] < f32(3e38):
                    for a in range(3):
                        x, tile = screen.position_ws[i, j, a], j // TILE
                        bounds[band, tile, a] = min(bounds[band, tile, a], x)
                        bounds[band, tile, 3 + a] = max(bounds[band, tile, 3 + a], x)


@pixel_jit
def _sum_bands(begin, end, first, listed, boxes, bounds, photons, screen, out):
    """Add the photons of bands of rows to the irradiance `out` (H, W, 3)."""
    photons, screen = borrowed((photons, screen))
    for band in range(begin, end):
        last_row = min((band + 1) * TILE, out.shape[0]) - 1
        for at in range(first[band], first[band + 1]):
            k = listed[at]
            p, n, heading = load(photons.position, k), load(photons.normal, k), load(photons.heading, k)
            rcp2 = ONE / photons.radius2[k]
            facing = max(-dot(n, heading), LEAST_COSINE)
            peak = f32(2 / math.pi) * rcp2 / facing
            for tile in range(boxes[k, 2] // TILE, boxes[k, 3] // TILE + 1):
                if _box_distance2(bounds[band], tile, p) >= photons.radius2[k]:
                    continue                     # most disks in a box of the picture lie before or behind what is seen
                for i in range(max(boxes[k, 0], band * TILE), min(boxes[k, 1], last_row) + 1):
                    for j in range(max(boxes[k, 2], tile * TILE), min(boxes[k, 3], (tile + 1) * TILE - 1) + 1):
                        d = sub(load_pixel(screen.position_ws, i, j), p)
                        d2, height = dot(d, d) * rcp2, dot(d, n)
                        if not d2 < ONE or height * height * rcp2 > FLAT * FLAT or not screen.depth[i, j] < f32(3e38):
                            continue
                        shading = load_pixel(screen.normal_ws, i, j)
                        towards = -dot(shading, heading)
                        if towards <= ZERO or dot(shading, n) < SAME_SIDE:
                            continue
                        weight = peak * (ONE - d2) * min(towards, MOST_TILT * facing)
                        for c in range(3):
                            out[i, j, c] += weight * photons.flux[k, c]


def add_photons(photons: Photons, screen, out: np.ndarray) -> None:
    """Add the photons' irradiance to `out` (H, W, 3) W/m2, the pixels of `screen` (`kernels.screen.Screen`).

    The same bits on any number of threads: each band of rows sums its photons in their order.
    """
    bands = -(-out.shape[0] // TILE)
    boxes, first = np.empty((len(photons.flux), 4), np.int32), np.zeros(bands + 1, np.int64)
    _box_photons(len(boxes), photons, screen, boxes)
    _list_by_band(boxes, first, np.empty(0, np.int32))
    np.cumsum(first, out=first)
    listed = np.empty(first[-1], np.int32)
    _list_by_band(boxes, first, listed)
    bounds = np.empty((bands, -(-out.shape[1] // TILE), 6), np.float32)
    _bound_tiles(bands, screen, bounds)
    _sum_bands(bands, first, listed, boxes, bounds, photons, screen, out)
