"""What a ray through the scene's triangles sees: the hit's light after lamps, world and emissive surfaces have reached it.

Where the camera sees the hit, the picture tells its light. Elsewhere the triangle's own colours are lit: one shadow ray
goes to a place on a lamp drawn by what the lamps would give, and one ray, drawn by the cosine, into the world and to
emissive surfaces.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .brdf import lobe_albedos
from .bvh import STACK, closest_hit, triangle_normal
from .depth_pyramid import height_at, plane_slopes
from .jit import borrowed, device_jit, pixel_jit
from .lit_hits import edge_fade, gloss_of_lamps, light_of_lamps, lit_there, softened
from .reflect import ASK
from .sampling import cosine_hemisphere, uniform
from .screen import is_inside, to_screen, turn_to_view, view_vector
from .shadow import ORTHOGRAPHIC
from .sky import sky_texel
from .vec3 import ONE, ZERO, Vec3, along, begun, dot, f32, lifted, load, load_pixel, scaled, tangent_frame, to_world

BLURRED = f32(0.3)          # roughness from which the world's blurred map, 2.8 degrees a texel, serves a ray


class Surroundings(NamedTuple):
    """The scene beyond the picture.

    albedo (T, 3, 3) and emission (T, 3) of the triangles, material (T,) int32; substance (M, 5) float32 of the materials:
    colour of the glossy lobe, roughness, F0 (see `passes.surroundings.substance_table`). sky and blurred_sky (h, w, 3): the
    world's radiance; lights_up: whether world or emissive surfaces light anything.
    """

    albedo: np.ndarray
    emission: np.ndarray
    material: np.ndarray
    substance: np.ndarray
    sky: np.ndarray
    blurred_sky: np.ndarray
    lights_up: bool


@device_jit
def colours_at(around, albedos, t, a, b, cosine):
    """(albedo, Glossy Color towards a direction at `cosine` to the normal, roughness, F0) of triangle t at (a, b) in it."""
    c, at = ONE - a - b, around.albedo[t]
    albedo = Vec3(c * at[0, 0] + a * at[1, 0] + b * at[2, 0], c * at[0, 1] + a * at[1, 1] + b * at[2, 1],
                  c * at[0, 2] + a * at[1, 2] + b * at[2, 2])
    substance = around.substance[around.material[t]]
    flat, rise = lobe_albedos(albedos, cosine, substance[3] * substance[3])
    rise = min(rise / max(flat, f32(1e-3)), f32(0.9))
    reflectance = substance[4] + (ONE - substance[4]) * rise
    return albedo, scaled(Vec3(substance[0], substance[1], substance[2]), reflectance), substance[3], substance[4]


@pixel_jit
def ask_scene(begin, end, asked, index, samples, screen, planes, gloss, lights, bvh, around, rules, seed, rays):
    """Answer the rays `asked` (K,) of `rays`, those of `draw_rays`: what the picture did not give is added."""
    screen, gloss, lights, bvh, around, rules, rays = borrowed((screen, gloss, lights, bvh, around, rules, rays))
    width = screen.depth.shape[1]
    stack, light, other = np.empty(STACK, np.int32), np.empty(6, np.float32), np.empty(3, np.float32)
    for k in range(begin, end):
        r = asked[k]
        pixel = index[r // samples]
        q, d = pixel * samples + r % samples, load(rays.direction, r)
        start, receiver = load(rays.start, r), gloss.roughness[pixel // width, pixel % width]
        t, slot, a, b = rules.reach_m, -1, ZERO, ZERO
        if rays.answer[r] == ASK:
            t, slot, a, b = closest_hit(bvh, stack, start, d, rules.reach_m)
        for c in range(6):
            light[c] = ZERO
        if slot < 0:
            sky = around.blurred_sky if receiver > BLURRED else around.sky
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
                    i, j = int(down), int(across)
                    sent = gloss_of_lamps(
                        lights, p, load_pixel(screen.normal_ws, i, j), scaled(d, -ONE), view_vector(screen, p),
                        load_pixel(gloss.specular, i, j), softened(gloss.roughness[i, j], receiver), gloss.f0[i, j],
                        gloss.irradiance[i, j], gloss.albedos,
                        uniform(q, 11, seed), uniform(q, 12, seed))
                    for c in range(3):
                        light[c] += sent[c]
            if share < ONE:
                source = bvh.source[slot]
                albedo, specular, roughness, f0 = colours_at(around, gloss.albedos, source, a, b, -dot(n, d))
                sent = light_of_lamps(bvh, lights, stack, p, n, scaled(d, -ONE), albedo, specular,
                                      softened(roughness, receiver), f0, gloss.albedos, rules.offset_m,
                                      uniform(q, 11, seed), uniform(q, 12, seed), uniform(q, 13, seed))
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
