"""What surfaces send towards a ray that meets them: light that the picture shows, and light of the lamps.

A matt surface sends the same light everywhere, so that what the picture shows of it serves every ray. Its glossy lobe is
another one in each direction: it is summed anew over the lamps, and how much of their light arrives is told by how much of
what they could give arrives in the picture.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .brdf import INV_PI, fit_lobe, fresnel, ggx_lobe, lobe_albedos, relative_reflectance
from .bvh import visibility
from .depth_pyramid import HEIGHT, SLOPE_X, SLOPE_Y, width_at
from .jit import device_jit, inline_jit
from .lamps import LEAST_ALPHA, Lamp, lamp_at, lamp_place
from .screen import HALF
from .terminator import lifted_share
from .vec3 import ONE, ZERO, Vec3, add, along, begun, dot, f32, lifted, normalized_or, scaled, sub

LEAST_REFLECTANCE = f32(1e-3)   # a surface that reflects less has no lobe
SOFTENING = f32(0.5)        # of a reflecting lobe's width that goes to the highlights that it shows: 0.25 to 1 err alike


class Gloss(NamedTuple):
    """What the camera's pixels send out and how they reflect.

    leaving (H, W, 3) float32 W/(m2 sr): light that leaves each pixel's matt surface after direct light has reached it;
    emission (H, W, 3): its own; irradiance (H, W) W/m2: what arrives from lamps, mean of the colours; specular (H, W, 3),
    roughness and f0 (H, W) float32, see `core.frame.GBuffer`; albedos: `brdf.albedo_table()`.
    """

    leaving: np.ndarray
    emission: np.ndarray
    irradiance: np.ndarray
    specular: np.ndarray
    roughness: np.ndarray
    f0: np.ndarray
    albedos: np.ndarray


class Lights(NamedTuple):
    """All lamps: kinds (L,) int64, places (L, 4, 3), shapes (L, 7) as in `lamps.Lamp`, powers (L, 6) float32 for diffuse and
    glossy lobes, shadows (L,) uint8."""

    kinds: np.ndarray
    places: np.ndarray
    shapes: np.ndarray
    powers: np.ndarray
    shadows: np.ndarray


@inline_jit
def lit_there(s, planes, gloss, column, row, h, slope_x, slope_y, light):
    """Light that the picture shows at a place of height h into `light` (6,); False where no pixel shows that surface.

    Of the four pixels around those are interpolated that show the surface, whose slopes are known: their planes and it agree
    to a pixel's width, at the place and at the pixel. At the foot of a wall the floor passes through the same place.
    """
    height, width = planes.shape[0], planes.shape[1]
    left, top = int(math.floor(column - HALF)), int(math.floor(row - HALF))
    fx, fy = column - HALF - f32(left), row - HALF - f32(top)
    least, total = width_at(s, h), ZERO
    for c in range(6):
        light[c] = ZERO
    for y in range(max(top, 0), min(top + 2, height)):
        for x in range(max(left, 0), min(left + 2, width)):
            dx, dy = f32(x) + HALF - column, f32(y) + HALF - row
            there = planes[y, x, HEIGHT] - h - slope_x * dx - slope_y * dy
            tilt = abs(planes[y, x, SLOPE_X] - slope_x) + abs(planes[y, x, SLOPE_Y] - slope_y)
            here = planes[y, x, HEIGHT] - h - planes[y, x, SLOPE_X] * dx - planes[y, x, SLOPE_Y] * dy
            if not max(max(abs(there), abs(here)), tilt) <= least:
                continue
            # a place at the very centre of a neighbour may have nothing else to go by
            w = (fx if x > left else ONE - fx) * (fy if y > top else ONE - fy) + f32(1e-6)
            total += w
            for c in range(3):
                light[c] += w * gloss.leaving[y, x, c]
                light[3 + c] += w * gloss.emission[y, x, c]
    if not total > ZERO:
        return False
    for c in range(6):
        light[c] /= total
    return True


@device_jit
def edge_fade(s, column, row, fade_px):
    """1 inside the picture, smoothly 0 at its edge over `fade_px`."""
    if fade_px <= ZERO:
        return ONE
    height, width = s.depth.shape
    t = min(min(column, f32(width) - column), min(row, f32(height) - row)) / fade_px
    t = min(max(t, ZERO), ONE)
    return t * t * (f32(3) - f32(2) * t)


@device_jit
def softened(roughness, receiver):
    """Roughness at which a hit of `roughness` shows lamps to a ray of the lobe of a receiver's roughness.

    A few rays of a wide lobe meet a sharp highlight as a few bright specks. Widening the highlight by a part of the lobe
    adds little to what the lobe blurs anyway (Kaplanyan and Dachsbacher 2013, "Path Space Regularization").
    """
    own, other = roughness * roughness, SOFTENING * receiver * receiver
    return math.sqrt(math.sqrt(own * own + other * other))


@inline_jit
def _alpha(roughness):
    return max(roughness * roughness, LEAST_ALPHA)


@inline_jit
def _lamp(lights, k):
    shape = lights.shapes[k]
    return Lamp(lights.kinds[k], lights.places[k], shape[0], shape[1], shape[2], shape[3], shape[4], shape[5], shape[6])


@device_jit
def _given(lights, k, albedo, diffuse, specular, glossy):
    """Radiance from lamp k by its share for the diffuse lobe and for the glossy one."""
    w = lights.powers[k]
    return Vec3(w[0] * albedo.x * diffuse + w[3] * specular.x * glossy,
                w[1] * albedo.y * diffuse + w[4] * specular.y * glossy,
                w[2] * albedo.z * diffuse + w[5] * specular.z * glossy)


@inline_jit
def _soft_gain(cos_colour, cos_ray, alpha, soft, f0, albedos):
    """What `ggx_lobe` of alpha `soft` is multiplied by in place of a lobe of `alpha` whose colour is seen at `cos_colour`.

    Together with `_soft_share` of each lamp.
    """
    flat, _ = lobe_albedos(albedos, cos_ray, soft)
    at_ray = fresnel(max(cos_ray, f32(0.02)), f0)
    return at_ray / max(relative_reflectance(cos_colour, alpha, f0, albedos) * flat, f32(0.02) * at_ray)


@inline_jit
def _soft_share(cos_lamp, alpha, soft, f0, albedos):
    """What a lobe of `alpha` reflects of a lamp's light over what one of alpha `soft` does.

    A softened lobe shows a lamp where the true one does not, so the reflectance may not be the ray's: a smooth floor under a
    lamp threw up to a third more than it got, at rays that graze it. With the lamp's it throws what it gets.
    """
    if soft == alpha:
        return ONE
    return relative_reflectance(cos_lamp, alpha, f0, albedos) / relative_reflectance(cos_lamp, soft, f0, albedos)


@inline_jit
def light_of_lamps(bvh, lights, stack, p, n, plane, lift, towards, albedo, specular, roughness, receiver, known_f0, albedos,
                   offset_m, u, v, pick):
    """Radiance that point p, normal n, sends along `towards` of the lamps' light: one shadow ray, to a lamp drawn by share.

    Its lobe is `softened` for a `receiver` of that roughness. `plane` is the triangle's normal: what lies below it is in the
    surface's own shadow, wherever n points, but for `lift` (`terminator.smooth_lift`). (u, v) is the place on the lamp,
    `pick` draws the lamp; all in [0, 1).
    """
    reflectance = max(specular.x, max(specular.y, specular.z))
    alpha, soft, f0, gain = _alpha(roughness), _alpha(softened(roughness, receiver)), ZERO, ZERO
    if reflectance > LEAST_REFLECTANCE:
        cos_ray = max(dot(n, towards), ZERO)
        f0, _ = fit_lobe(reflectance, cos_ray, alpha, albedos, known_f0)
        gain = _soft_gain(cos_ray, cos_ray, alpha, soft, f0, albedos)
    total, kept, chosen = ZERO, ZERO, -1
    light, way = Vec3(ZERO, ZERO, ZERO), Vec3(ZERO, ZERO, ZERO)
    for k in range(lights.kinds.shape[0]):
        lamp = _lamp(lights, k)
        x, y, share = lamp_place(lamp, p, u, v)
        d, weight = lamp_at(lamp, p, x, y)
        unit = normalized_or(d, n)
        cosine = dot(n, unit)
        weight *= share
        if not weight > ZERO or not cosine > ZERO or (
                lights.shadows[k] != 0 and lifted_share(lift, n, plane, unit) < ZERO):
            continue
        glossy = ZERO
        if gain > ZERO:
            glossy = weight * gain * ggx_lobe(n, towards, unit, soft * soft, f0)
            glossy *= _soft_share(cosine, alpha, soft, f0, albedos) if glossy > ZERO else ONE
        given = _given(lights, k, albedo, INV_PI * weight * cosine, specular, glossy)
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
    if lights.shadows[chosen] != 0:
        share = lifted_share(lift, n, plane, normalized_or(way, n))
        start = begun(along(lifted(p, plane, offset_m), lift, share), way, offset_m)
        arrives = visibility(bvh, stack, start, sub(add(p, way), start))
    return scaled(light, arrives * total / kept)


@inline_jit
def gloss_of_lamps(lights, p, n, towards, viewer, specular, roughness, receiver, known_f0, irradiance, albedos, u, v):
    """Radiance that the glossy lobe of a surface in the picture sends along `towards` of the lamps' light.

    The lobe is `softened` for a `receiver` of that roughness. `specular` is what it reflects towards `viewer`; what it would
    be towards the ray follows from the rise of Fresnel's reflectance. `irradiance` W/m2 is what arrives of the lamps' light,
    mean of the colours: all lamps are shadowed alike.
    """
    reflectance = max(specular.x, max(specular.y, specular.z))
    cosine, alpha, soft = dot(n, towards), _alpha(roughness), _alpha(softened(roughness, receiver))
    if not reflectance > LEAST_REFLECTANCE or not irradiance > ZERO or not cosine > ZERO:
        return Vec3(ZERO, ZERO, ZERO)
    cos_viewer = max(dot(n, viewer), ZERO)
    f0, _ = fit_lobe(reflectance, cos_viewer, alpha, albedos, known_f0)
    gain = _soft_gain(cos_viewer, cosine, alpha, soft, f0, albedos)
    could, sent = ZERO, Vec3(ZERO, ZERO, ZERO)
    for k in range(lights.kinds.shape[0]):
        lamp = _lamp(lights, k)
        x, y, share = lamp_place(lamp, p, u, v)
        d, weight = lamp_at(lamp, p, x, y)
        unit = normalized_or(d, n)
        weight *= share
        if not weight > ZERO or not dot(n, unit) > ZERO:
            continue
        w = lights.powers[k]
        could += weight * dot(n, unit) * (w[0] + w[1] + w[2]) * f32(1 / 3)
        lobe = weight * gain * ggx_lobe(n, towards, unit, soft * soft, f0)
        lobe *= _soft_share(dot(n, unit), alpha, soft, f0, albedos) if lobe > ZERO else ONE
        sent = Vec3(sent.x + w[3] * lobe, sent.y + w[4] * lobe, sent.z + w[5] * lobe)
    share = min(irradiance / max(could, f32(1e-30)), ONE)
    return Vec3(share * specular.x * sent.x, share * specular.y * sent.y, share * specular.z * sent.z)
