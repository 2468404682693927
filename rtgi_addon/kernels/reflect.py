"""Reflections in the picture: rays drawn from the glossy lobe and followed through what the camera sees.

A hit brings home what the hit pixel sends out, textures and shadows included. A ray that the picture cannot answer, because
it goes behind something or out of the frame, is left to `scene_light` from the place where the picture lost it.

A pixel's result is the mean of the light over its lobe, sum(w L) / sum(w) with w the lobe over its density, so that even
light comes back as it is, to the last digit. Both sums are kept until they have been filtered: of one ray alone the
quotient would be L, whatever w, and too bright by 17 % for rough surfaces at grazing view. The colour of the lobe is
multiplied later.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .brdf import fit_lobe, fresnel, lobe_density, sample_lobe
from .depth_pyramid import HEIGHT, SLOPE_X, SLOPE_Y
from .jit import borrowed, device_jit, pixel_jit
from .lit_hits import edge_fade, gloss_of_lamps, lit_there
from .sampling import cosine_hemisphere, dither, r2_sequence, uniform
from .screen import HALF, seen_vs, turn_to_view, turn_to_world, view_vector
from .screen_rays import ENDED, HIT, distance_at, march, march_evenly, ray_in_picture
from .shadow import ORTHOGRAPHIC
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
    load_pixel,
    normalized_or,
    scaled,
    tangent_frame,
    to_world,
)

KNOWN, SKY, ASK = 0, 1, 2             # what a ray still needs: nothing, the world, the triangles
BACK_PX = 1.5               # pixels by which a ray through the triangles starts before the picture lost it
# columns of a pixel's results, after the light of hit surfaces and that of emissive surfaces and the world by colour:
SHARE, WEIGHT, NEARNESS = 6, 7, 8     # how much of the lobe is known, its sum (all before are divided by it at the end), and
                                      # the mean of 1 / length of its rays in 1/m
MIRROR_ALPHA = f32(1e-4)    # roughness 0.01: the lobe is a tenth of a pixel wide
AIMED_ALPHA = f32(2.5e-3)   # roughness 0.05: sharper lobes meet what shines, or nothing shows
LEAST_COSINE = f32(0.02)    # of viewer and normal: below it the normal is turned towards the viewer


class Rules(NamedTuple):
    """How rays are followed.

    top: highest level of the pyramid that is used, 0 for every pixel, -1 for even steps of `step_px`; stops_hidden: see
    `screen_rays.march`; asks: what the picture leaves goes to the triangles, else it is the world's; aims: lobes
    aim at what shines too; fade_px: width of the
    frame's edge over which hits fade; offset_m: off surfaces; reach_m: leads out of picture and scene.
    """

    top: int
    step_px: float
    stops_hidden: bool
    asks: bool
    aims: bool
    fade_px: np.float32
    offset_m: np.float32
    reach_m: np.float32


class Rays(NamedTuple):
    """Rays of a list of pixels, R of them, and what they bring.

    start, direction (R, 3) float32 m: where the picture lost the ray, unit vector; weight (R,): lobe over density, 1 in the
    mean; density (R,) 1/sr of drawing the direction, 0 where nothing is aimed at what shines (`shines`); answer (R,) uint8:
    KNOWN, SKY or ASK; share (R,): how much of `light` (R, 6) the picture gave, the rest being still to come; aimed (R, 3):
    light of what shines by a ray aimed there, weight included; length_m (R,) from the pixel to the hit, or to `start` as
    long as there is none; steps (R,) int32.
    """

    start: np.ndarray
    direction: np.ndarray
    weight: np.ndarray
    density: np.ndarray
    answer: np.ndarray
    share: np.ndarray
    light: np.ndarray
    aimed: np.ndarray
    length_m: np.ndarray
    steps: np.ndarray


def make_rays(count: int) -> Rays:
    """Room for `count` rays."""
    return Rays(np.zeros((count, 3), np.float32), np.zeros((count, 3), np.float32), np.zeros(count, np.float32),
                np.zeros(count, np.float32), np.zeros(count, np.uint8), np.zeros(count, np.float32),
                np.zeros((count, 6), np.float32), np.zeros((count, 3), np.float32), np.zeros(count, np.float32),
                np.zeros(count, np.int32))


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
def usable_normal(n, plane, viewer):
    """Normal n, turned so that viewer and mirror direction are above the surface, as Cycles turns it.

    Bump maps and smooth shading may put the mirror direction below the plane; the result lies between n and the plane's
    normal such that the mirror direction just clears it.
    """
    facing = dot(n, viewer)
    if not facing >= LEAST_COSINE:
        n = normalized_or(along(n, viewer, LEAST_COSINE - facing), viewer)     # the viewer's, for a normal of NaN
        facing = dot(n, viewer)
    up = max(dot(viewer, plane), ZERO)
    least = min(f32(0.9) * up, f32(0.01))
    if f32(2) * facing * dot(n, plane) - up >= least:
        return n
    side = normalized_or(along(n, plane, -dot(n, plane)), n)
    # in the plane of side and plane normal n = (sin f, cos f), and the mirror direction rises by r cos(2 f - viewer's angle)
    across = dot(viewer, side)
    r = max(math.sqrt(across * across + up * up), f32(1e-6))
    f = HALF * (math.atan2(across, up) + math.acos(min(least / r, ONE)))
    return add(scaled(side, math.sin(f)), scaled(plane, math.cos(f)))


@device_jit
def place_in_block(i, j):
    """Number of a pixel in its block of 4x4 along a Morton curve: neighbours take neighbouring points of a sequence."""
    return (j & 1) | ((i & 1) << 1) | ((j & 2) << 1) | ((i & 2) << 2)


class Lobe(NamedTuple):
    """The glossy lobe of a pixel: unit normals of shading and of the pixel's plane, direction to the viewer, GGX alpha,
    reflectance at normal incidence, and the gain that makes the integral of `ggx_lobe` 1."""

    normal: Vec3
    plane: Vec3
    viewer: Vec3
    alpha: np.float32
    f0: np.float32
    gain: np.float32


@device_jit
def lobe_at(s, planes, gloss, i, j):
    """The Lobe of pixel (i, j); a mirror's has neither Fresnel nor gain."""
    viewer, plane = view_vector(s, load_pixel(s.position_ws, i, j)), plane_normal(s, planes, i, j)
    n = usable_normal(load_pixel(s.normal_ws, i, j), plane, viewer)
    alpha, f0, gain = gloss.roughness[i, j] * gloss.roughness[i, j], ONE, ONE
    if alpha >= MIRROR_ALPHA:
        reflectance = max(gloss.specular[i, j, 0], max(gloss.specular[i, j, 1], gloss.specular[i, j, 2]))
        f0, gain = fit_lobe(reflectance, max(dot(n, viewer), LEAST_COSINE), alpha, gloss.albedos, gloss.f0[i, j])
    return Lobe(n, plane, viewer, alpha, f0, gain)


@pixel_jit
def draw_rays(begin, end, index, samples, s, planes, gloss, rules, seed, rays):
    """Draw `samples` rays from the lobe of each pixel of `index` (M,) into `rays`, which must come from `make_rays`.

    Ray m * samples + k is sample k of pixel m.
    """
    s, gloss, rules, rays = borrowed((s, gloss, rules, rays))
    width = s.depth.shape[1]
    for m in range(begin, end):
        i, j = index[m] // width, index[m] % width
        n, plane, viewer, alpha, f0, gain = lobe_at(s, planes, gloss, i, j)
        origin = lifted(load_pixel(s.position_ws, i, j), plane, rules.offset_m)
        mirror = along(scaled(viewer, -ONE), n, f32(2) * dot(n, viewer))
        shift_u, shift_v, place = ZERO, ZERO, 0
        if alpha >= MIRROR_ALPHA:
            gain /= fresnel(max(dot(n, viewer), LEAST_COSINE), f0)
            # pixels of a block of 4x4 share one shifted sequence, so that a filter over them sees it whole
            block, place = (i >> 2) * 65536 + (j >> 2), place_in_block(i, j)
            shift_u, shift_v = uniform(block, seed, 1), uniform(block, seed, 2)
        for k in range(samples):
            r, d, weight = m * samples + k, mirror, ONE
            if alpha >= MIRROR_ALPHA:
                u, v = r2_sequence(k * 16 + place, shift_u, shift_v)
                d, weight = sample_lobe(n, viewer, alpha, u, v)
                weight *= gain * fresnel(max(dot(normalized_or(add(viewer, d), n), viewer), ZERO), f0)
            start = begun(origin, d, rules.offset_m)
            rays.start[r, 0], rays.start[r, 1], rays.start[r, 2] = start.x, start.y, start.z
            rays.direction[r, 0], rays.direction[r, 1], rays.direction[r, 2] = d.x, d.y, d.z
            rays.weight[r], rays.answer[r], rays.length_m[r] = weight, ASK if rules.asks else SKY, ZERO
            if rules.aims and alpha >= AIMED_ALPHA:
                rays.density[r] = lobe_density(n, viewer, d, alpha)
            if not dot(d, plane) > ZERO:         # below the surface: Cycles lets such light be lost
                rays.answer[r], rays.share[r], rays.length_m[r] = KNOWN, ONE, rules.reach_m


@device_jit
def _aim_from(m, position, normal, place, samples, offset_m, seed, rays):
    """Aim the rays of point m, at `place` of its grid."""
    p, n = load(position, m), load(normal, m)
    tangent, bitangent = tangent_frame(n)
    origin, shift_u, shift_v = lifted(p, n, offset_m), dither(place, seed, 0), dither(place, seed, 1)
    for k in range(samples):
        r = m * samples + k
        u, v = r2_sequence(k, shift_u, shift_v)
        d = to_world(cosine_hemisphere(u, v), tangent, bitangent, n)
        start = begun(origin, d, offset_m)
        rays.start[r, 0], rays.start[r, 1], rays.start[r, 2] = start.x, start.y, start.z
        rays.direction[r, 0], rays.direction[r, 1], rays.direction[r, 2] = d.x, d.y, d.z
        rays.weight[r], rays.answer[r] = ONE, ASK


@pixel_jit
def aim_rays(begin, end, position, normal, places, samples, offset_m, seed, rays):
    """Aim `samples` rays by the cosine from each of the points (M, 3) with normals (M, 3), left to the triangles.

    `places` (M,): see `sampling.place_ids`."""
    for m in range(begin, end):
        _aim_from(m, position, normal, places[m], samples, offset_m, seed, rays)


@pixel_jit
def follow_rays(begin, end, index, samples, s, pyramid, gloss, lights, rules, seed, rays):
    """Follow the rays that `draw_rays` drew for the pixels of `index` (M,) through the picture."""
    s, pyramid, gloss, lights, rules, rays = borrowed((s, pyramid, gloss, lights, rules, rays))
    width, reach = s.depth.shape[1], np.float64(rules.reach_m)
    for m in range(begin, end):
        i, j = index[m] // width, index[m] % width
        p, start_vs = load_pixel(s.position_ws, i, j), seen_vs(s, i, j)
        for k in range(samples):
            r = m * samples + k
            if rays.answer[r] == KNOWN:
                continue
            d = load(rays.direction, r)
            ray = ray_in_picture(s, start_vs, turn_to_view(s, d), reach)
            if rules.top < 0:
                what, at_i, at_j, at, rays.steps[r] = march_evenly(pyramid, ray, i, j, rules.step_px, rules.stops_hidden)
            else:
                what, at_i, at_j, at, rays.steps[r] = march(pyramid, ray, i, j, rules.top, rules.stops_hidden)
            share, lost_m, longest = ZERO, ZERO, max(abs(ray.dx), abs(ray.dy))
            if longest > 0.0:
                lost_m = f32(distance_at(ray, max(at - BACK_PX / longest, 0.0)))
            rays.length_m[r] = lost_m
            if what == HIT:
                column, row, h = f32(ray.x + at * ray.dx), f32(ray.y + at * ray.dy), f32(ray.h + at * ray.dh)
                slope_x, slope_y = pyramid.planes[at_i, at_j, SLOPE_X], pyramid.planes[at_i, at_j, SLOPE_Y]
                if not lit_there(s, pyramid.planes, gloss, column, row, h, slope_x, slope_y, rays.light[r]):
                    for c in range(3):
                        rays.light[r, c] = gloss.leaving[at_i, at_j, c]
                        rays.light[r, 3 + c] = gloss.emission[at_i, at_j, c]
                share, length_m = edge_fade(s, column, row, rules.fade_px), f32(distance_at(ray, at))
                hit = along(p, d, length_m)
                sent = gloss_of_lamps(
                    lights, hit, load_pixel(s.normal_ws, at_i, at_j), scaled(d, -ONE), view_vector(s, hit),
                    load_pixel(gloss.specular, at_i, at_j), gloss.roughness[at_i, at_j], gloss.roughness[i, j],
                    gloss.f0[at_i, at_j], gloss.irradiance[at_i, at_j], gloss.albedos, uniform(index[m], k, seed + 1),
                    uniform(index[m], k, seed + 2))
                for c in range(3):
                    rays.light[r, c] += sent[c]
                if share > ZERO:
                    rays.length_m[r] = length_m
            elif what == ENDED and ray.dh <= 0.0:    # clear to behind the farthest thing that the camera sees
                rays.answer[r] = SKY
            if share >= ONE:
                rays.answer[r] = KNOWN
            rays.share[r] = share
            for c in range(3):
                rays.start[r, c] += lost_m * rays.direction[r, c]


@pixel_jit
def collect_rays(begin, end, index, samples, rays, is_open, nearest_m, results):
    """Sum the rays of each pixel of `index` (M,) into its line of `results` (H, W, NEARNESS + 1).

    `is_open`: what the picture did not give is left out, and SHARE tells how much was given. Lengths below `nearest_m` count
    as that.
    """
    rays, = borrowed((rays,))
    width = results.shape[1]
    for m in range(begin, end):
        out = results[index[m] // width, index[m] % width]
        for c in range(NEARNESS + 1):
            out[c] = ZERO
        for r in range(m * samples, (m + 1) * samples):
            known = rays.share[r] if is_open else ONE
            w = rays.weight[r] / f32(samples)
            for c in range(6):
                out[c] += w * (known * rays.light[r, c] if is_open else rays.light[r, c])
            for c in range(3):
                out[3 + c] += rays.aimed[r, c] / f32(samples)
            out[SHARE] += w * known
            out[WEIGHT] += w
            out[NEARNESS] += w / max(rays.length_m[r], nearest_m)
        out[NEARNESS] /= max(out[WEIGHT], f32(1e-20))
