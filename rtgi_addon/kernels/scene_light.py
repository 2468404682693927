"""What a ray through the scene's triangles sees: the hit's light after lamps, world and emissive surfaces have reached it.

Where the camera sees the hit, the picture tells its light. Elsewhere the triangle's own colours are lit: one shadow ray
goes to a place on a lamp drawn by what the lamps would give, and one ray, drawn by the cosine, into the world and to
emissive surfaces.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .brdf import INV_PI, fit_lobe, ggx_lobe, lobe_albedos
from .bvh import STACK, closest_hit, triangle_normal, visibility
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
    arrives = ONE
    if around.shadows[chosen] != 0:
        start = begun(lifted(p, n, offset_m), way, offset_m)
        arrives = visibility(bvh, stack, start, sub(add(p, way), start))
    return scaled(light, arrives * total / kept)


@device_jit
def _colours_at(around, albedos, t, a, b, cosine):
    """(albedo, Glossy Color towards a direction at `cosine` to the normal, roughness) of triangle t at (a, b) in it."""
    c, at = ONE - a - b, around.albedo[t]
    albedo = Vec3(c * at[0, 0] + a * at[1, 0] + b * at[2, 0], c * at[0, 1] + a * at[1, 1] + b * at[2, 1],
                  c * at[0, 2] + a * at[1, 2] + b * at[2, 2])
    substance = around.substance[around.material[t]]
    flat, rise = lobe_albedos(albedos, cosine, substance[3] * substance[3])
    rise = min(rise / max(flat, f32(1e-3)), f32(0.9))
    reflectance = substance[4] + (ONE - substance[4]) * rise
    return albedo, scaled(Vec3(substance[0], substance[1], substance[2]), reflectance), substance[3]


@device_jit
def _ask_block(asked, begin, end, index, samples, screen, planes, gloss, bvh, around, rules, seed, rays):
    """Answer the rays begin to end of `asked`; all of it in one function, see `reflect._reflect_block`."""
    width = screen.depth.shape[1]
    stack, light, other = np.empty(STACK, np.int32), np.empty(6, np.float32), np.empty(3, np.float32)
    for k in range(begin, end):
        r = asked[k]
        pixel = index[r // samples]
        q, d = pixel * samples + r % samples, load(rays.direction, r)
        start = load(rays.start, r)
        t, slot, a, b = rules.reach_m, -1, ZERO, ZERO
        if rays.answer[r] == ASK:
            t, slot, a, b = closest_hit(bvh, stack, start, d, rules.reach_m)
        for c in range(6):
            light[c] = ZERO
        if slot < 0:
            is_blurred = gloss.roughness[pixel // width, pixel % width] > BLURRED
            sky = around.blurred_sky if is_blurred else around.sky
            row, column = sky_texel(d, sky.shape[0], sky.shape[1])
            for c in range(3):
                light[3 + c] = sky[row, column, c]
        else:
            p, n, share = along(start, d, t), triangle_normal(bvh, slot), ZERO
            if dot(n, d) > ZERO:
                n = scaled(n, -ONE)
            across, down, depth = to_screen(screen, p)
            # only where the camera looks at the same side as the ray
            if (is_inside(screen, across, down) and (depth > ZERO or screen.projection == ORTHOGRAPHIC)
                    and dot(n, view_vector(screen, p)) > ZERO):
                h = height_at(screen, depth)
                slope_x, slope_y = plane_slopes(screen, turn_to_view(screen, n), across, down, h)
                if lit_there(screen, planes, gloss, across, down, h, slope_x, slope_y, light):
                    share = edge_fade(screen, across, down, rules.fade_px)
            if share < ONE:
                source = bvh.source[slot]
                albedo, specular, roughness = _colours_at(around, gloss.albedos, source, a, b, -dot(n, d))
                sent = light_of_lamps(bvh, around, stack, p, n, scaled(d, -ONE), albedo, specular, roughness, gloss.albedos,
                                      rules.offset_m, uniform(q, 11, seed), uniform(q, 12, seed), uniform(q, 13, seed))
                other[0], other[1], other[2] = sent.x, sent.y, sent.z
                if around.lights_up:
                    tangent, bitangent = tangent_frame(n)
                    up = to_world(cosine_hemisphere(uniform(q, 14, seed), uniform(q, 15, seed)), tangent, bitangent, n)
                    begin_up = begun(lifted(p, n, rules.offset_m), up, rules.offset_m)
                    _, above, _, _ = closest_hit(bvh, stack, begin_up, up, rules.reach_m)
                    row, column = sky_texel(up, around.blurred_sky.shape[0], around.blurred_sky.shape[1])
                    for c in range(3):
                        given = around.emission[bvh.source[above], c] if above >= 0 else around.blurred_sky[row, column, c]
                        other[c] += given * (albedo.x if c == 0 else (albedo.y if c == 1 else albedo.z))
                for c in range(3):
                    light[c] = share * light[c] + (ONE - share) * other[c]
                    light[3 + c] = share * light[3 + c] + (ONE - share) * around.emission[source, c]
        known = rays.share[r]
        for c in range(6):
            rays.light[r, c] = known * rays.light[r, c] + (ONE - known) * light[c]
        if known == ZERO:
            rays.length_m[r] = t if slot < 0 else rays.length_m[r] + t


@pixel_jit
def ask_scene(asked, index, samples, screen, planes, gloss, bvh, around, rules, seed, rays):
    """Answer the rays `asked` (K,) of `rays`, those of `reflect_pixels`: what the picture did not give is added."""
    blocks = (len(asked) + BLOCK - 1) // BLOCK
    for block in prange(blocks):
        _ask_block(asked, block * BLOCK, min((block + 1) * BLOCK, len(asked)), index, samples, screen, planes, gloss, bvh,
                   around, rules, seed, rays)
