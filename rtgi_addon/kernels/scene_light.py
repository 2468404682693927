"""What a ray through the scene's triangles sees: the hit's light after lamps, world and emissive surfaces have reached it.

Where the camera sees the hit, the picture tells its light. Elsewhere the triangle's own colours are lit, by the normals at
its corners where it is shaded smooth: one shadow ray goes to a place on a lamp drawn by what the lamps would give, and one
ray, drawn by the cosine, into the world and to emissive surfaces. In both cases one more ray, drawn from the hit's own lobe,
tells what of these it mirrors.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .brdf import HALF, INV_PI, fit_lobe, fresnel, ggx_lobe, lobe_albedos, lobe_density, rise_of, sample_lobe
from .bvh import STACK, closest_hit, triangle_normal, visibility
from .depth_pyramid import height_at, plane_slopes
from .jit import borrowed, inline_jit, pixel_jit, scratch
from .lamps import LEAST_ALPHA
from .lit_hits import LEAST_REFLECTANCE, edge_fade, gloss_of_lamps, light_of_lamps, lit_there, softened
from .reflect import AIMED_ALPHA, ASK, LEAST_COSINE, Lobe, lobe_at
from .sampling import cosine_hemisphere, r2_sequence, uniform
from .screen import is_inside, to_screen, turn_to_view, view_vector
from .shadow import ORTHOGRAPHIC
from .shines import Shines, aim_at, aimed_at_sky, aimed_density, has_aim
from .sky import sky_texel
from .terminator import smooth_lift
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
    sub,
    tangent_frame,
    to_world,
)

SHARP = f32(0.03)           # alpha of a lobe below which each pixel is traced by itself, by few rays; a hit is lit by
SHARP_LOOKUPS = 4           # this many shadow rays then
DIM = f32(0.25)             # Glossy Color below which a hit's lobe asks for what shines by a share of the rays
UP_TO = f32(0.9999)         # of the way to an emissive triangle: a ray must not meet it
CANDIDATES = 4              # places of which one is aimed at, drawn by what they would give
RARE = f32(0.05)            # lobe over density below which an aimed ray is cast by chance
BLURRED = f32(0.3)          # roughness from which the world's blurred map, 2.8 degrees a texel, serves a ray


class Surroundings(NamedTuple):
    """The scene beyond the picture.

    albedo (T, 3, 3) and emission (T, 3) of the triangles, material (T,) int32; normals (T, 3, 3) int16, see
    `core.frame.Geometry`, without a length where all triangles are flat; substance (M, 6) float32 of the materials: see
    `passes.surroundings.substance_table`. sky and blurred_sky (h, w, 3): the world's radiance; lights_up: whether world or
    emissive surfaces light anything; shines: what rays may be aimed at.
    """

    albedo: np.ndarray
    emission: np.ndarray
    material: np.ndarray
    normals: np.ndarray
    substance: np.ndarray
    sky: np.ndarray
    blurred_sky: np.ndarray
    lights_up: bool
    shines: Shines


@inline_jit
def colours_at(around, albedos, t, a, b, cosine):
    """(albedo, glossy reflectance towards a direction at `cosine` to the normal, roughness, F0) of triangle t at (a, b)."""
    c, at = ONE - a - b, around.albedo[t]
    albedo = Vec3(c * at[0, 0] + a * at[1, 0] + b * at[2, 0], c * at[0, 1] + a * at[1, 1] + b * at[2, 1],
                  c * at[0, 2] + a * at[1, 2] + b * at[2, 2])
    substance = around.substance[around.material[t]]
    flat, rise = lobe_albedos(albedos, cosine, substance[3] * substance[3])
    rise = rise_of(min(rise / max(flat, f32(1e-3)), f32(0.9)), substance[4])
    reflectance = (substance[4] + (ONE - substance[4]) * rise) * (ONE if substance[5] > ZERO else flat)
    return albedo, scaled(Vec3(substance[0], substance[1], substance[2]), reflectance), substance[3], substance[4]


@inline_jit
def normal_at(around, t, a, b, plane, side, to_ray):
    """Unit shading normal of triangle t at (a, b) in it, facing the ray; `plane`, the triangle's own, for a flat one.

    `side` is -1 where `plane` has been turned against the winding. A normal that has turned away from its own triangle says
    nothing; one that has turned away from the ray alone, as they do along a coarse outline, is bent just as far as it takes.
    """
    if around.normals.shape[0] == 0:
        return plane
    c, at = side * (ONE - a - b), around.normals[t]
    a, b = side * a, side * b
    n = Vec3(c * f32(at[0, 0]) + a * f32(at[1, 0]) + b * f32(at[2, 0]),
             c * f32(at[0, 1]) + a * f32(at[1, 1]) + b * f32(at[2, 1]),
             c * f32(at[0, 2]) + a * f32(at[1, 2]) + b * f32(at[2, 2]))
    if not dot(n, plane) > ZERO:
        return plane
    n = normalized_or(n, plane)
    facing = dot(n, to_ray)
    return n if facing >= LEAST_COSINE else normalized_or(along(n, to_ray, LEAST_COSINE - facing), plane)


@inline_jit
def _shining(bvh, around, slot, d, t, sky):
    """(radiance, density 1/sr of aiming there) of what a ray along d met after t m, or of the world for a slot of -1."""
    if slot < 0:
        row, column = sky_texel(d, sky.shape[0], sky.shape[1])
        return load_pixel(sky, row, column), aimed_at_sky(around.shines, d)
    radiance = load(around.emission, bvh.source[slot])
    if not max(radiance.x, max(radiance.y, radiance.z)) > ZERO:
        return radiance, ZERO
    return radiance, aimed_density(around.shines, radiance, t, abs(dot(triangle_normal(bvh, slot), d)))


@inline_jit
def _shown_emission(own, seen, share):
    """Emission of a hit whose triangle emits `own` and whose place in the picture `seen`, which is known to a `share`.

    The picture tells how a texture varies. Pixels may miss a narrow emitter, or show it beside what does not shine.
    """
    if not max(own.x, max(own.y, own.z)) > ZERO or not max(seen.x, max(seen.y, seen.z)) > ZERO:
        return own
    return add(scaled(seen, share), scaled(own, ONE - share))


@inline_jit
def _shines(bvh, around, stack, p, plane, d, sky, offset_m, reach_m):
    """`_shining` of what p, on a triangle of normal `plane`, sees in direction d."""
    t, slot, _, _ = closest_hit(bvh, stack, begun(lifted(p, plane, offset_m), d, offset_m), d, reach_m)
    return _shining(bvh, around, slot, d, t, sky)


@inline_jit
def _from_above(bvh, around, stack, p, n, plane, albedo, offset_m, reach_m, u, v, pick):
    """Radiance that a matt surface sends back of what shines, by one ray: by the cosine, or every second one aimed there."""
    aims = has_aim(around.shines)
    if aims and pick < HALF:
        way, d, aimed, given = aim_at(around.shines, p, around.blurred_sky, reach_m, u, v, f32(2) * pick)
        cosine = dot(n, d)
        if not aimed > ZERO or not min(cosine, dot(plane, d)) > ZERO:
            return Vec3(ZERO, ZERO, ZERO)
        start = begun(lifted(p, plane, offset_m), d, offset_m)
        weight = cosine * INV_PI / (HALF * (aimed + cosine * INV_PI))
        weight *= visibility(bvh, stack, start, scaled(sub(add(p, way), start), UP_TO))
        return Vec3(weight * given.x * albedo.x, weight * given.y * albedo.y, weight * given.z * albedo.z)
    tangent, bitangent = tangent_frame(n)
    d = to_world(cosine_hemisphere(u, v), tangent, bitangent, n)
    if dot(plane, d) < ZERO:                     # Cycles drops these as well
        return Vec3(ZERO, ZERO, ZERO)
    given, aimed = _shines(bvh, around, stack, p, plane, d, around.blurred_sky, offset_m, reach_m)
    if aims:
        cosine = dot(n, d) * INV_PI
        albedo = scaled(albedo, cosine / max(HALF * (aimed + cosine), f32(1e-20)))
    return Vec3(given.x * albedo.x, given.y * albedo.y, given.z * albedo.z)


@inline_jit
def _aim_lobe(around, p, lobe, sky, reach_m, q, first, seed):
    """(vector to a place of what shines, its colour over its light, light, lobe over density) as a lobe at p sees it.

    Of CANDIDATES places one is drawn in proportion to what they would give (Talbot, Cline and Egbert 2005, "Importance
    Resampling for Global Illumination"): most of what shines lies beside the lobe. Colour times light counts beside that of
    the lobe's own rays; both are 0 where no candidate can be seen. Random numbers `first` and on of q are used.
    """
    chosen, total, likely, way = Vec3(ZERO, ZERO, ZERO), ZERO, ZERO, p
    for c in range(CANDIDATES):
        at = first + 4 * c
        to, d, aimed, given = aim_at(around.shines, p, sky, reach_m, uniform(q, at, seed), uniform(q, at + 1, seed),
                                     uniform(q, at + 2, seed))
        if not aimed > ZERO or not min(dot(d, lobe.plane), dot(d, lobe.normal)) > ZERO:
            continue
        gives = lobe.gain * ggx_lobe(lobe.normal, lobe.viewer, d, lobe.alpha * lobe.alpha, lobe.f0)
        gives /= aimed + lobe_density(lobe.normal, lobe.viewer, d, lobe.alpha)
        bright = gives * (given.x + given.y + given.z)
        total += bright
        if bright > ZERO and uniform(q, at + 3, seed) * total < bright:
            chosen, likely, way = scaled(given, gives / bright), gives, to
    return way, chosen, total / f32(CANDIDATES), likely


@inline_jit
def _from_lobe(bvh, around, stack, p, n, plane, towards, specular, roughness, f0, albedos, offset_m, reach_m, u, v, pick, q,
               seed):
    """Radiance that a glossy lobe sends `towards` of what shines, by one ray, every second one aimed there; of dim lobes by
    fewer: `pick` decides."""
    reflectance, cosine = max(specular.x, max(specular.y, specular.z)), dot(n, towards)
    chance = min(reflectance * f32(1 / DIM), ONE)
    if not reflectance > LEAST_REFLECTANCE or not cosine > ZERO or pick >= chance:
        return Vec3(ZERO, ZERO, ZERO)
    alpha, gain = roughness * roughness, ONE
    if alpha >= LEAST_ALPHA:
        f0, gain = fit_lobe(reflectance, cosine, alpha, albedos, f0)
    sky, weight = around.blurred_sky if roughness > BLURRED else around.sky, ONE / chance
    aims = has_aim(around.shines) and alpha >= LEAST_ALPHA
    if aims:
        weight *= f32(2)
        if pick < HALF * chance:
            way, given, light, _ = _aim_lobe(around, p, Lobe(n, plane, towards, alpha, f0, gain), sky, reach_m, q, 40, seed)
            if not light > ZERO:
                return Vec3(ZERO, ZERO, ZERO)
            start = begun(lifted(p, plane, offset_m), way, offset_m)
            weight *= light * visibility(bvh, stack, start, scaled(sub(add(p, way), start), UP_TO))
            return Vec3(weight * given.x * specular.x, weight * given.y * specular.y, weight * given.z * specular.z)
    d, lobe_weight = sample_lobe(n, towards, alpha, u, v)
    if dot(plane, d) < ZERO:
        return Vec3(ZERO, ZERO, ZERO)
    weight *= lobe_weight
    if alpha >= LEAST_ALPHA:
        weight *= gain * fresnel(max(dot(normalized_or(add(towards, d), n), towards), ZERO), f0) / fresnel(cosine, f0)
    given, aimed = _shines(bvh, around, stack, p, plane, d, sky, offset_m, reach_m)
    if aims:
        density = lobe_density(n, towards, d, alpha)
        weight *= density / max(density + aimed, f32(1e-20))
    return Vec3(weight * given.x * specular.x, weight * given.y * specular.y, weight * given.z * specular.z)


@pixel_jit
def ask_scene(begin, end, asked, index, samples, screen, planes, gloss, lights, bvh, around, rules, seed, rays):
    """Answer the rays `asked` (K,) of `rays`, those of `draw_rays`: what the picture did not give is added."""
    screen, gloss, lights, bvh, around, rules, rays = borrowed((screen, gloss, lights, bvh, around, rules, rays))
    width = screen.depth.shape[1]
    stack, light = scratch(STACK, np.int32), scratch(6, np.float32)
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
            p, plane, side, share = along(start, d, t), triangle_normal(bvh, slot), ONE, ZERO
            if dot(plane, d) > ZERO:
                plane, side = scaled(plane, -ONE), -ONE
            across, down, depth = to_screen(screen, p)
            # only where the camera looks at the same side as the ray
            if (is_inside(screen, across, down) and (depth > ZERO or screen.projection == ORTHOGRAPHIC)
                    and dot(plane, view_vector(screen, p)) > ZERO):
                h = height_at(screen, depth)
                slope_x, slope_y = plane_slopes(screen, turn_to_view(screen, plane), across, down, h)
                if lit_there(screen, planes, gloss, across, down, h, slope_x, slope_y, light):
                    share = edge_fade(screen, across, down, rules.fade_px)
                    i, j = int(down), int(across)
                    sent = gloss_of_lamps(
                        lights, p, load_pixel(screen.normal_ws, i, j), scaled(d, -ONE), view_vector(screen, p),
                        load_pixel(gloss.specular, i, j), gloss.roughness[i, j], receiver, gloss.f0[i, j],
                        gloss.irradiance[i, j], gloss.albedos, uniform(q, 11, seed), uniform(q, 12, seed))
                    for c in range(3):
                        light[c] += sent[c]
            source, to_ray = bvh.source[slot], scaled(d, -ONE)
            n = normal_at(around, source, a, b, plane, side, to_ray)
            albedo, specular, roughness, f0 = colours_at(around, gloss.albedos, source, a, b, dot(n, to_ray))
            lift = Vec3(ZERO, ZERO, ZERO)
            if around.normals.shape[0] > 0 and share < ONE and lights.kinds.shape[0] > 0:
                lift = smooth_lift(bvh, around.normals, slot, a, b, plane)
            matt, glossy = Vec3(ZERO, ZERO, ZERO), Vec3(ZERO, ZERO, ZERO)
            # nothing is averaged over what a mirror shows, so that it shows the noise of half shadows
            lookups = SHARP_LOOKUPS if receiver * receiver < SHARP else 1
            for look in range(lookups):
                if share < ONE:
                    u, v = r2_sequence(look, uniform(q, 11, seed), uniform(q, 12, seed))
                    pick = (uniform(q, 13, seed) + f32(look)) / f32(lookups)
                    matt = add(matt, light_of_lamps(bvh, lights, stack, p, n, plane, lift, to_ray, albedo, specular,
                                                    roughness, receiver, f0, gloss.albedos, rules.offset_m, u, v, pick))
                if around.lights_up:
                    u, v = r2_sequence(look, uniform(q, 14, seed), uniform(q, 15, seed))
                    if share < ONE:
                        pick = (uniform(q, 17, seed) + f32(look)) / f32(lookups)
                        matt = add(matt, _from_above(bvh, around, stack, p, n, plane, albedo, rules.offset_m, rules.reach_m,
                                                     u, v, pick))
                    pick = (uniform(q, 16, seed) + f32(look)) / f32(lookups)
                    glossy = add(glossy, _from_lobe(bvh, around, stack, p, n, plane, to_ray, specular,
                                                    softened(roughness, receiver), f0, gloss.albedos, rules.offset_m,
                                                    rules.reach_m, u, v, pick, q, seed + look))
            matt, glossy = scaled(matt, (ONE - share) / f32(lookups)), scaled(glossy, ONE / f32(lookups))
            own = load(around.emission, source)
            shown = _shown_emission(own, Vec3(light[3], light[4], light[5]), share)
            for c in range(3):
                given = (matt.x + glossy.x) if c == 0 else ((matt.y + glossy.y) if c == 1 else (matt.z + glossy.z))
                light[c] = share * light[c] + given
            light[3], light[4], light[5] = shown
        known = rays.share[r]
        if rays.density[r] > ZERO:
            _, aimed = _shining(bvh, around, slot, d, rays.length_m[r] + t, around.blurred_sky)
            for c in range(3, 6):
                light[c] *= rays.density[r] / (rays.density[r] + aimed)
        for c in range(6):
            rays.light[r, c] = known * rays.light[r, c] + (ONE - known) * light[c]
        if known == ZERO:
            rays.length_m[r] = t if slot < 0 else rays.length_m[r] + t


@pixel_jit
def aim_lobes(begin, end, index, samples, screen, planes, gloss, bvh, around, rules, seed, rays):
    """Aim one ray for each of `samples` of the pixels of `index` (M,) at what shines; into `rays.aimed`."""
    screen, gloss, bvh, around, rules, rays = borrowed((screen, gloss, bvh, around, rules, rays))
    width, stack = screen.depth.shape[1], scratch(STACK, np.int32)
    for m in range(begin, end):
        i, j = index[m] // width, index[m] % width
        lobe = lobe_at(screen, planes, gloss, i, j)
        if lobe.alpha < AIMED_ALPHA:
            continue
        sky = around.blurred_sky if gloss.roughness[i, j] > BLURRED else around.sky
        p = load_pixel(screen.position_ws, i, j)
        origin = lifted(p, lobe.plane, rules.offset_m)
        for k in range(samples):
            q = index[m] * samples + k
            way, colour, light, likely = _aim_lobe(around, p, lobe, sky, rules.reach_m, q, 18, seed)
            chance = min(likely / RARE, ONE)
            if not uniform(q, 17, seed) < chance:
                continue
            start = begun(origin, way, rules.offset_m)
            light *= visibility(bvh, stack, start, scaled(sub(add(p, way), start), UP_TO)) / chance
            r = m * samples + k
            rays.aimed[r, 0], rays.aimed[r, 1], rays.aimed[r, 2] = scaled(colour, light)
