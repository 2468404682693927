"""Reflections: rays drawn from the glossy lobe, followed through the picture and, where it ends, through the triangles.

Each ray asks the picture first (`screen_rays`). A hit there brings home what the hit pixel sends out, textures and shadows
included. Where the picture cannot answer, because the ray goes behind something or out of the frame, a ray through the scene's
triangles goes on from there; its hit takes the picture's light where the camera sees it, and is lit by the lamps where not. What
meets nothing takes the world.

A pixel's result is the mean of the light over its lobe, sum(w L) / sum(w) with w the lobe over its density, so that even light
comes back as it is, to the last digit. The colour of the lobe is multiplied later.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .brdf import INV_PI, fit_lobe, fresnel, ggx_lobe, lobe_albedos, sample_lobe
from .bvh import STACK, closest_hit, is_occluded, triangle_normal
from .depth_pyramid import HEIGHT, SLACK, SLOPE_X, SLOPE_Y, DepthPyramid, height_at
from .jit import device_jit, pixel_jit, prange
from .lamps import LEAST_ALPHA, Lamp, lamp_at, lamp_place
from .sampling import cosine_hemisphere, r2_sequence, uniform
from .screen import HALF, Screen, is_inside, seen_vs, to_screen, turn_to_view, turn_to_world, view_vector
from .screen_rays import ENDED, HIT, distance_at, march, march_evenly, ray_in_picture
from .shadow import ORTHOGRAPHIC
from .sky import sky_texel
from .vec3 import (
    ONE,
    ZERO,
    Vec3,
    add,
    along,
    begun,
    dot,
    f32,
    lifted,
    load,
    normalized_or,
    scaled,
    sub,
    tangent_frame,
    to_world,
)

RAYS, WORLD, ELSEWHERE = 0, 1, 2      # who answers for a ray that the picture cannot answer for
BLOCK = 16                  # pixels that one thread follows in a row
BACK_PX = 1.5               # pixels by which a ray through the triangles starts before the picture lost it
SEEN_PX = f32(2)            # slacks by which a point may lie off a pixel's plane and still be what the pixel sees
LEAST_COSINE = f32(0.02)    # of viewer and normal: below it the normal is turned towards the viewer
COLOURS = 6                 # of a pixel's results: light of hit surfaces, then light of emissive surfaces and the world
MEANS, SHARE, NEARNESS, VARIANCE = 0, 6, 7, 8
RESULTS = 9
TALLY_RAYS, TALLY_STEPS, TALLY_HITS, TALLY_ASKED = 0, 1, 2, 3


class Gloss(NamedTuple):
    """What the camera's pixels send out and how they reflect.

    leaving (H, W, 6) float32 W/(m2 sr): light that leaves each pixel after direct light has reached it, then its own emission;
    specular (H, W, 3), roughness (H, W) float32; albedos: `brdf.albedo_table()`, and whole_albedos the one that keeps energy.
    """

    leaving: np.ndarray
    specular: np.ndarray
    roughness: np.ndarray
    albedos: np.ndarray
    whole_albedos: np.ndarray
    keeps_energy: bool


class Picture(NamedTuple):
    """All of what the camera sees; made inside kernels, which take no tuples of tuples."""

    screen: Screen
    pyramid: DepthPyramid
    leaving: np.ndarray
    specular: np.ndarray
    roughness: np.ndarray
    albedos: np.ndarray
    whole_albedos: np.ndarray
    keeps_energy: bool


class Surroundings(NamedTuple):
    """The scene beyond the picture.

    albedo (T, 3, 3) and emission (T, 3) of the triangles, material (T,) int32; substance (M, 4) float32: specular and
    roughness of the materials. Lamps: kinds (L,) int64, places (L, 4, 3), shapes (L, 7) as in `lamps.Lamp`, powers (L, 6)
    float32 for diffuse and glossy lobes, shadows (L,) uint8. sky (h, w, 3) and blurred_sky: the world's radiance; lights_up:
    whether world or emissive surfaces light anything.
    """

    albedo: np.ndarray
    emission: np.ndarray
    material: np.ndarray
    substance: np.ndarray
    kinds: np.ndarray
    places: np.ndarray
    shapes: np.ndarray
    powers: np.ndarray
    shadows: np.ndarray
    sky: np.ndarray
    blurred_sky: np.ndarray
    lights_up: bool


class Rules(NamedTuple):
    """How rays are followed.

    top: highest level of the pyramid that is used, 0 for every pixel, -1 for even steps of `step_px`; stops_hidden: see
    `screen_rays.march`; asks_all: every ray goes through the triangles; fallback: RAYS, WORLD or ELSEWHERE; fade_px: width of
    the frame's edge over which hits fade into the fallback; offset_m; reach_m: length that leads out of the picture and the
    scene.
    """

    top: int
    step_px: float
    stops_hidden: bool
    asks_all: bool
    fallback: int
    fade_px: np.float32
    offset_m: np.float32
    reach_m: np.float32


@device_jit
def plane_normal(s, planes, i, j):
    """Unit normal in the world of the plane that pixel (i, j) sees, on the viewer's side."""
    across, down = planes[i, j, SLOPE_X] / s.step_x, -planes[i, j, SLOPE_Y] / s.step_y
    if s.projection == ORTHOGRAPHIC:
        n = Vec3(-across, -down, ONE)
    else:
        # the plane is n . point = c with h = (n.x x + n.y y - n.z) / c at image place (x, y), and c < 0 on the viewer's side
        x, y = s.left + (f32(j) + HALF) * s.step_x, s.top - (f32(i) + HALF) * s.step_y
        n = Vec3(-across, -down, planes[i, j, HEIGHT] - across * x - down * y)
    return normalized_or(turn_to_world(s, n), Vec3(ZERO, ZERO, ONE))


@device_jit
def _usable_normal(n, plane, viewer):
    """Normal n, turned so that viewer and mirror direction are above the surface, as Cycles turns it.

    Bump maps and smooth shading may put the mirror direction below the plane; the result lies between n and the plane's
    normal such that the mirror direction just clears it.
    """
    facing = dot(n, viewer)
    if facing < LEAST_COSINE:
        n = normalized_or(along(n, viewer, LEAST_COSINE - facing), viewer)
        facing = dot(n, viewer)
    up = max(dot(viewer, plane), ZERO)
    least = min(f32(0.9) * up, f32(0.01))
    if f32(2) * facing * dot(n, plane) - up >= least:
        return n
    side = normalized_or(along(n, plane, -dot(n, plane)), n)
    # in the plane of side and plane normal: n = (sin f, cos f), and the mirror direction rises by r cos(2 f - angle of viewer)
    across = dot(viewer, side)
    r = max(math.sqrt(across * across + up * up), f32(1e-6))
    f = HALF * (math.atan2(across, up) + math.acos(min(least / r, ONE)))
    return add(scaled(side, math.sin(f)), scaled(plane, math.cos(f)))


@device_jit
def _sky(around, d, is_blurred):
    sky = around.blurred_sky if is_blurred else around.sky
    row, column = sky_texel(d, sky.shape[0], sky.shape[1])
    return Vec3(sky[row, column, 0], sky[row, column, 1], sky[row, column, 2])


@device_jit
def _lamp(around, k):
    shape = around.shapes[k]
    return Lamp(around.kinds[k], around.places[k], shape[0], shape[1], shape[2], shape[3], shape[4], shape[5], shape[6])


@device_jit
def _times(a, b):
    return Vec3(a.x * b.x, a.y * b.y, a.z * b.z)


@device_jit
def _mean(a):
    return (a.x + a.y + a.z) * f32(1 / 3)


@device_jit
def _light_of_lamps(bvh, around, stack, p, n, towards, albedo, specular, roughness, albedos, offset_m, u, v, pick):
    """Radiance that point p, normal n, sends along `towards` of the lamps' light: one shadow ray, to a lamp drawn by share."""
    reflectance = max(specular.x, max(specular.y, specular.z))
    alpha, f0, gain = max(roughness * roughness, LEAST_ALPHA), ZERO, ZERO
    if reflectance > f32(1e-3):
        f0, gain = fit_lobe(reflectance, max(dot(n, towards), ZERO), alpha, albedos)
    total, kept, chosen = ZERO, ZERO, -1
    light, way = Vec3(ZERO, ZERO, ZERO), Vec3(ZERO, ZERO, ZERO)
    for k in range(around.kinds.shape[0]):
        lamp = _lamp(around, k)
        x, y, share = lamp_place(lamp, p, u, v)
        d, weight = lamp_at(lamp, p, x, y)
        unit = normalized_or(d, n)
        cosine = dot(n, unit)
        weight *= share
        if not weight > ZERO or not cosine > ZERO:
            continue
        given = scaled(_times(albedo, load(around.powers[:, :3], k)), INV_PI * weight * cosine)
        if gain > ZERO:
            lobe = weight * gain * ggx_lobe(n, towards, unit, alpha * alpha, f0)
            given = add(given, scaled(_times(specular, load(around.powers[:, 3:], k)), lobe))
        amount = _mean(given)
        if not amount > ZERO:
            continue
        total += amount
        share = amount / total
        if pick < share:
            chosen, kept, light, way = k, amount, given, d
            pick = pick / share
        else:
            pick = (pick - share) / (ONE - share)
    if chosen < 0:
        return Vec3(ZERO, ZERO, ZERO)
    if around.shadows[chosen] != 0:
        start = begun(lifted(p, n, offset_m), way, offset_m)
        if is_occluded(bvh, stack, start, sub(add(p, way), start)):
            return Vec3(ZERO, ZERO, ZERO)
    return scaled(light, total / kept)


@device_jit
def _light_of_triangle(bvh, around, stack, p, d, slot, a, b, albedos, offset_m, reach_m, q, salt):
    """(radiance that the triangle in `slot`, met at p along d, sends back of direct light, radiance that it emits).

    (a, b) are the hit's barycentric coordinates; q and salt decide the random numbers.
    """
    n = triangle_normal(bvh, slot)
    if dot(n, d) > ZERO:
        n = scaled(n, -ONE)
    t = bvh.source[slot]
    corner = around.albedo[t]
    c = ONE - a - b
    albedo = Vec3(c * corner[0, 0] + a * corner[1, 0] + b * corner[2, 0], c * corner[0, 1] + a * corner[1, 1] + b * corner[2, 1],
                  c * corner[0, 2] + a * corner[1, 2] + b * corner[2, 2])
    substance, towards = around.substance[around.material[t]], scaled(d, -ONE)
    flat, rise = lobe_albedos(albedos, -dot(n, d), substance[3] * substance[3])
    rise = min(rise / max(flat, f32(1e-3)), f32(0.9))
    specular = scaled(Vec3(substance[0], substance[1], substance[2]), substance[4] + (ONE - substance[4]) * rise)
    light = _light_of_lamps(bvh, around, stack, p, n, towards, albedo, specular, substance[3], albedos, offset_m,
                            uniform(q, 11, salt), uniform(q, 12, salt), uniform(q, 13, salt))
    if around.lights_up:
        tangent, bitangent = tangent_frame(n)
        up = to_world(cosine_hemisphere(uniform(q, 14, salt), uniform(q, 15, salt)), tangent, bitangent, n)
        start = begun(lifted(p, n, offset_m), up, offset_m)
        _, other, _, _ = closest_hit(bvh, stack, start, up, reach_m)
        if other >= 0:
            light = add(light, _times(albedo, load(around.emission, bvh.source[other])))
        else:
            light = add(light, _times(albedo, _sky(around, up, True)))
    return light, load(around.emission, t)


@device_jit
def _lit_there(picture, column, row, h):
    """(found, leaving light, emission) of the picture at a place whose height is h: of the four pixels around, like surfaces."""
    planes, leaving = picture.pyramid.planes, picture.leaving
    height, width = planes.shape[0], planes.shape[1]
    left, top = int(math.floor(column - HALF)), int(math.floor(row - HALF))
    fx, fy = column - HALF - f32(left), row - HALF - f32(top)
    light, own, total = Vec3(ZERO, ZERO, ZERO), Vec3(ZERO, ZERO, ZERO), ZERO
    for y in range(max(top, 0), min(top + 2, height)):
        for x in range(max(left, 0), min(left + 2, width)):
            at = planes[y, x]
            off = h - at[HEIGHT] - at[SLOPE_X] * (column - f32(x) - HALF) - at[SLOPE_Y] * (row - f32(y) - HALF)
            if not abs(off) <= SEEN_PX * at[SLACK]:
                continue
            w = (fx if x > left else ONE - fx) * (fy if y > top else ONE - fy) + f32(1e-6)
            total += w
            light = along(light, Vec3(leaving[y, x, 0], leaving[y, x, 1], leaving[y, x, 2]), w)
            own = along(own, Vec3(leaving[y, x, 3], leaving[y, x, 4], leaving[y, x, 5]), w)
    if total > ZERO:
        return True, scaled(light, ONE / total), scaled(own, ONE / total)
    return False, light, own


@device_jit
def _fade(s, column, row, fade_px):
    """1 inside the picture, smoothly 0 at its edge over `fade_px`."""
    if fade_px <= ZERO:
        return ONE
    height, width = s.depth.shape
    t = min(min(column, f32(width) - column), min(row, f32(height) - row)) / fade_px
    t = min(max(t, ZERO), ONE)
    return t * t * (f32(3) - f32(2) * t)


@device_jit
def _beyond(picture, bvh, around, rules, stack, origin, d, start_m, is_blurred, q, salt):
    """(light of surfaces, light of emission and world, length in m): what the triangles say of a ray, from `start_m` on."""
    s = picture.screen
    start = along(origin, d, start_m)
    t, slot, a, b = closest_hit(bvh, stack, start, d, rules.reach_m)
    if slot < 0:
        return Vec3(ZERO, ZERO, ZERO), _sky(around, d, is_blurred), rules.reach_m
    p = along(start, d, t)
    share, light, own = ZERO, Vec3(ZERO, ZERO, ZERO), Vec3(ZERO, ZERO, ZERO)
    column, row, depth = to_screen(s, p)
    if is_inside(s, column, row) and (depth > ZERO or s.projection == ORTHOGRAPHIC):
        n, viewer = triangle_normal(bvh, slot), view_vector(s, p)
        if dot(n, viewer) * dot(n, d) < ZERO:    # the camera and the ray look at the same side
            found, light, own = _lit_there(picture, column, row, height_at(s, depth))
            share = _fade(s, column, row, rules.fade_px) if found else ZERO
    if share < ONE:
        other, other_own = _light_of_triangle(bvh, around, stack, p, d, slot, a, b, picture.albedos, rules.offset_m, rules.reach_m,
                                              q, salt)
        light, own = along(scaled(light, share), other, ONE - share), along(scaled(own, share), other_own, ONE - share)
    return light, own, start_m + t


@device_jit
def _follow(picture, bvh, around, rules, stack, i, j, plane, d, is_blurred, q, salt):
    """What one ray from pixel (i, j) along unit vector d brings.

    (light of surfaces, light of emission and world, share that is known, length in m, steps, hits, asked).
    """
    s, pyramid = picture.screen, picture.pyramid
    u, reach = turn_to_view(s, d), np.float64(rules.reach_m)
    ray = ray_in_picture(s, seen_vs(s, i, j), u, reach)
    origin = lifted(Vec3(s.position_ws[i, j, 0], s.position_ws[i, j, 1], s.position_ws[i, j, 2]), plane, rules.offset_m)
    black = Vec3(ZERO, ZERO, ZERO)
    if rules.asks_all:
        light, own, length_m = _beyond(picture, bvh, around, rules, stack, begun(origin, d, rules.offset_m), d, ZERO, is_blurred, q,
                                       salt)
        return light, own, ONE, length_m, 0, 0, 1
    if rules.top < 0:
        answer, at_i, at_j, at, steps = march_evenly(pyramid, ray, i, j, rules.step_px, rules.stops_hidden)
    else:
        answer, at_i, at_j, at, steps = march(pyramid, ray, i, j, rules.top, rules.stops_hidden)
    share, light, own, length_m, hits = ZERO, black, black, rules.reach_m, 0
    if answer == HIT:
        column, row, h = f32(ray.x + at * ray.dx), f32(ray.y + at * ray.dy), f32(ray.h + at * ray.dh)
        found, light, own = _lit_there(picture, column, row, h)
        if not found:
            there = picture.leaving[at_i, at_j]
            light, own = Vec3(there[0], there[1], there[2]), Vec3(there[3], there[4], there[5])
        share, length_m, hits = _fade(s, column, row, rules.fade_px), f32(distance_at(ray, at)), 1
        if share >= ONE:
            return light, own, ONE, length_m, steps, hits, 0
    if rules.fallback == RAYS:
        if answer == ENDED and u.z <= ZERO:      # clear to the farthest thing that the camera sees
            return black, _sky(around, d, is_blurred), ONE, length_m, steps, 0, 0
        longest = max(abs(ray.dx), abs(ray.dy))
        begin = f32(distance_at(ray, max(at - BACK_PX / longest, 0.0))) if longest > 0.0 else ZERO
        other, other_own, length_m = _beyond(picture, bvh, around, rules, stack, begun(origin, d, rules.offset_m), d, begin,
                                             is_blurred, q, salt)
    elif rules.fallback == WORLD:
        other, other_own = black, _sky(around, d, is_blurred)
    else:
        return scaled(light, share), scaled(own, share), share, length_m, steps, hits, 0
    light, own = along(scaled(light, share), other, ONE - share), along(scaled(own, share), other_own, ONE - share)
    return light, own, ONE, length_m, steps, hits, 1


@device_jit
def _reflect_pixel(i, j, samples, picture, bvh, around, rules, stack, seed, results, tally):
    """Fill the results of pixel (i, j) and its line of the tally."""
    s = picture.screen
    q = i * s.depth.shape[1] + j
    viewer = view_vector(s, Vec3(s.position_ws[i, j, 0], s.position_ws[i, j, 1], s.position_ws[i, j, 2]))
    plane = plane_normal(s, picture.pyramid.planes, i, j)
    n = _usable_normal(Vec3(s.normal_ws[i, j, 0], s.normal_ws[i, j, 1], s.normal_ws[i, j, 2]), plane, viewer)
    alpha = picture.roughness[i, j] * picture.roughness[i, j]
    reflectance = max(picture.specular[i, j, 0], max(picture.specular[i, j, 1], picture.specular[i, j, 2]))
    cosine = max(dot(n, viewer), LEAST_COSINE)
    f0, _ = fit_lobe(reflectance, cosine, alpha, picture.albedos)
    # pixels of a block of 4x4 share one shifted sequence, so that a filter over them sees it whole
    block, place = (i >> 2) * 65536 + (j >> 2), _place_in_block(i, j)
    shift_u, shift_v = uniform(block, seed, 1), uniform(block, seed, 2)
    light, own, weights, near, known, squares = Vec3(ZERO, ZERO, ZERO), Vec3(ZERO, ZERO, ZERO), ZERO, ZERO, ZERO, ZERO
    for k in range(samples):
        u, v = r2_sequence(k * 16 + place, shift_u, shift_v)
        d, weight = sample_lobe(n, viewer, alpha, u, v)
        h = normalized_or(add(viewer, d), n)
        weight *= fresnel(max(dot(h, viewer), ZERO), f0)
        weights += weight
        if dot(d, plane) <= ZERO:                # below the surface: Cycles lets such light be lost
            known += weight
            continue
        one, one_own, share, length_m, steps, hits, asked = _follow(picture, bvh, around, rules, stack, i, j, plane, d,
                                                                    alpha > f32(0.1), q * 64 + k, seed)
        light, own = along(light, one, weight), along(own, one_own, weight)
        known += weight * share
        near += weight / max(length_m, rules.offset_m)
        amount = _mean(one) + _mean(one_own)
        squares += weight * amount * amount
        tally[TALLY_RAYS] += 1
        tally[TALLY_STEPS] += steps
        tally[TALLY_HITS] += hits
        tally[TALLY_ASKED] += asked
    scale = ONE / max(weights, f32(1e-20))
    if not picture.keeps_energy:                 # Glossy Color tells nothing of what microfacets hide from each other
        flat, _ = lobe_albedos(picture.whole_albedos, cosine, alpha)
        scale = scale * min(flat, ONE)
    light, own = scaled(light, scale), scaled(own, scale)
    mean = _mean(light) + _mean(own)
    results[i, j, 0], results[i, j, 1], results[i, j, 2] = light
    results[i, j, 3], results[i, j, 4], results[i, j, 5] = own
    results[i, j, SHARE], results[i, j, NEARNESS] = known * scale, near * scale
    results[i, j, VARIANCE] = max(squares * scale - mean * mean, ZERO) / f32(max(samples - 1, 1))


@device_jit
def _place_in_block(i, j):
    """Number of a pixel in its block of 4x4 along a Morton curve: neighbours take neighbouring points of the sequence."""
    return (j & 1) | ((i & 1) << 1) | ((j & 2) << 1) | ((i & 2) << 2)


@device_jit
def _reflect_block(index, first, last, samples, screen, pyramid, gloss, bvh, around, rules, seed, results, tally):
    picture = Picture(screen, pyramid, gloss.leaving, gloss.specular, gloss.roughness, gloss.albedos, gloss.whole_albedos, gloss.keeps_energy)
    stack, width = np.empty(STACK, np.int32), results.shape[1]
    for k in range(first, last):
        _reflect_pixel(index[k] // width, index[k] % width, samples, picture, bvh, around, rules, stack, seed, results, tally[k])


@pixel_jit
def reflect_pixels(index, samples, screen, pyramid, gloss, bvh, around, rules, seed, results, tally):
    """Reflect the pixels of `index` (M,) with `samples` rays each.

    results (H, W, RESULTS) float32: MEANS are the mean over the lobe of the light of surfaces and of emission and world,
    SHARE the share of it that is known, NEARNESS the mean of 1 / length of the rays in 1/m, VARIANCE that of the mean's
    brightness. tally (M, 4) int32: rays, steps, hits in the picture, rays that the fallback answered.
    """
    blocks = (len(index) + BLOCK - 1) // BLOCK
    for block in prange(blocks):
        _reflect_block(index, block * BLOCK, min((block + 1) * BLOCK, len(index)), samples, screen, pyramid, gloss, bvh, around,
                       rules, seed, results, tally)
