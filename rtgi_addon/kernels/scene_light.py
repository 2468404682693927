"""What a ray through the scene's triangles sees: the hit's light after lamps, world and emissive surfaces have reached it.

Where the camera sees the hit, the picture tells its light. Elsewhere the triangle's own colours are lit: one shadow ray
goes to a place on a lamp drawn by what the lamps would give, and one ray, drawn by the cosine, into the world and to
emissive surfaces.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .brdf import INV_PI, fit_lobe, ggx_lobe, lobe_albedos
from .bvh import STACK, closest_hit, is_occluded, triangle_normal
from .depth_pyramid import height_at, plane_slopes
from .jit import device_jit, pixel_jit, prange
from .lamps import LEAST_ALPHA, Lamp, lamp_at, lamp_place
from .reflect import ASK, edge_fade, lit_there
from .sampling import cosine_hemisphere, uniform
from .screen import is_inside, to_screen, turn_to_view, view_vector
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

BLURRED = f32(0.3)          # roughness from which the world's blurred map, 2.8 degrees a texel, serves a ray
BLOCK = 64                  # rays that one thread follows in a row


class Surroundings(NamedTuple):
    """The scene beyond the picture.

    albedo (T, 3, 3) and emission (T, 3) of the triangles, material (T,) int32; substance (M, 5) float32 of the materials:
    colour of the glossy lobe, roughness, F0 (see `passes.ssr.substance_table`). Lamps: kinds (L,) int64, places (L, 4, 3),
    shapes (L, 7) as in `lamps.Lamp`, powers (L, 6) float32 for diffuse and glossy lobes, shadows (L,) uint8. sky and
    blurred_sky (h, w, 3): the world's radiance; lights_up: whether world or emissive surfaces light anything.
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


@device_jit
def _lamp(around, k):
    shape = around.shapes[k]
    return Lamp(around.kinds[k], around.places[k], shape[0], shape[1], shape[2], shape[3], shape[4], shape[5], shape[6])


@device_jit
def _given(around, k, albedo, diffuse, specular, glossy):
    """Radiance from lamp k by its share for the diffuse lobe and for the glossy one."""
    w = around.powers[k]
    return Vec3(w[0] * albedo.x * diffuse + w[3] * specular.x * glossy,
                w[1] * albedo.y * diffuse + w[4] * specular.y * glossy,
                w[2] * albedo.z * diffuse + w[5] * specular.z * glossy)


@device_jit
def light_of_lamps(bvh, around, stack, p, n, towards, albedo, specular, roughness, albedos, offset_m, u, v, pick):
    """Radiance that point p, normal n, sends along `towards` of the lamps' light: one shadow ray, to a lamp drawn by share.

    (u, v) is the place on the lamp, `pick` draws the lamp; all in [0, 1).
    """
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
        glossy = weight * gain * ggx_lobe(n, towards, unit, alpha * alpha, f0) if gain > ZERO else ZERO
        given = _given(around, k, albedo, INV_PI * weight * cosine, specular, glossy)
        amount = given.x + given.y + given.z
        if not amount > ZERO:
            continue
        total += amount
        share = amount / total
        if pick < share:
            chosen, kept, light, way, pick = k, amount, given, d, pick / share
        else:
            pick = (pick - share) / (ONE - share)
    if chosen < 0:
        return light
    if around.shadows[chosen] != 0:
        start = begun(lifted(p, n, offset_m), way, offset_m)
        if is_occluded(bvh, stack, start, sub(add(p, way), start)):
            return Vec3(ZERO, ZERO, ZERO)
    return scaled(light, total / kept)


@device_jit
def _light_triangle(bvh, around, stack, p, d, slot, a, b, albedos, offset_m, reach_m, r, salt, light):
    """Light that the triangle in `slot`, met at p along d, sends back, and what it emits, into `light` (6,).

    (a, b) are the hit's barycentric coordinates; r and salt decide the random numbers.
    """
    n = triangle_normal(bvh, slot)
    if dot(n, d) > ZERO:
        n = scaled(n, -ONE)
    t, c = bvh.source[slot], ONE - a - b
    at = around.albedo[t]
    albedo = Vec3(c * at[0, 0] + a * at[1, 0] + b * at[2, 0], c * at[0, 1] + a * at[1, 1] + b * at[2, 1],
                  c * at[0, 2] + a * at[1, 2] + b * at[2, 2])
    substance = around.substance[around.material[t]]
    flat, rise = lobe_albedos(albedos, -dot(n, d), substance[3] * substance[3])
    rise = min(rise / max(flat, f32(1e-3)), f32(0.9))
    specular = scaled(Vec3(substance[0], substance[1], substance[2]), substance[4] + (ONE - substance[4]) * rise)
    sent = light_of_lamps(bvh, around, stack, p, n, scaled(d, -ONE), albedo, specular, substance[3], albedos, offset_m,
                          uniform(r, 11, salt), uniform(r, 12, salt), uniform(r, 13, salt))
    light[0], light[1], light[2] = sent.x, sent.y, sent.z
    if around.lights_up:
        tangent, bitangent = tangent_frame(n)
        up = to_world(cosine_hemisphere(uniform(r, 14, salt), uniform(r, 15, salt)), tangent, bitangent, n)
        _, other, _, _ = closest_hit(bvh, stack, begun(lifted(p, n, offset_m), up, offset_m), up, reach_m)
        row, column = sky_texel(up, around.blurred_sky.shape[0], around.blurred_sky.shape[1])
        for k in range(3):
            given = around.emission[bvh.source[other], k] if other >= 0 else around.blurred_sky[row, column, k]
            light[k] += given * (albedo.x if k == 0 else (albedo.y if k == 1 else albedo.z))
    for k in range(3):
        light[3 + k] = around.emission[t, k]


@device_jit
def _ask(r, q, is_blurred, screen, planes, gloss, bvh, around, rules, seed, stack, light, other, rays):
    """Answer ray r: the part of its light that the picture did not give; q decides the random numbers.

    `light` and `other` are (6,) scratch.
    """
    d = load(rays.direction, r)
    t, slot, a, b = rules.reach_m, -1, ZERO, ZERO
    if rays.answer[r] == ASK:
        start = load(rays.start, r)
        t, slot, a, b = closest_hit(bvh, stack, start, d, rules.reach_m)
    for c in range(6):
        light[c] = ZERO
    if slot < 0:
        sky = around.blurred_sky if is_blurred else around.sky
        row, column = sky_texel(d, sky.shape[0], sky.shape[1])
        for c in range(3):
            light[3 + c] = sky[row, column, c]
    else:
        p, share = along(start, d, t), ZERO
        column, row, depth = to_screen(screen, p)
        if is_inside(screen, column, row) and (depth > ZERO or screen.projection == ORTHOGRAPHIC):
            n, h = triangle_normal(bvh, slot), height_at(screen, depth)
            slope_x, slope_y = plane_slopes(screen, turn_to_view(screen, n), column, row, h)
            # the camera and the ray look at the same side
            if dot(n, view_vector(screen, p)) * dot(n, d) < ZERO and lit_there(
                    screen, planes, gloss.leaving, column, row, h, slope_x, slope_y, light):
                share = edge_fade(screen, column, row, rules.fade_px)
        if share < ONE:
            _light_triangle(bvh, around, stack, p, d, slot, a, b, gloss.albedos, rules.offset_m, rules.reach_m, q, seed,
                            other)
            for c in range(6):
                light[c] = share * light[c] + (ONE - share) * other[c]
    known = rays.share[r]
    for c in range(6):
        rays.light[r, c] = known * rays.light[r, c] + (ONE - known) * light[c]
    if known == ZERO:
        rays.length_m[r] = t if slot < 0 else rays.length_m[r] + t


@pixel_jit
def ask_scene(asked, index, samples, screen, planes, gloss, bvh, around, rules, seed, rays):
    """Answer the rays `asked` (K,) of `rays`, those of `reflect_pixels`: what the picture did not give is added."""
    blocks, width = (len(asked) + BLOCK - 1) // BLOCK, screen.depth.shape[1]
    for block in prange(blocks):
        stack, light, other = np.empty(STACK, np.int32), np.empty(6, np.float32), np.empty(6, np.float32)
        for k in range(block * BLOCK, min((block + 1) * BLOCK, len(asked))):
            r = asked[k]
            pixel = index[r // samples]
            is_blurred = gloss.roughness[pixel // width, pixel % width] > BLURRED
            _ask(r, pixel * samples + r % samples, is_blurred, screen, planes, gloss, bvh, around, rules, seed, stack, light,
                 other, rays)
