"""Caustics: lamps' light that mirror-like surfaces throw, by photons from the texels of the lamps' views.

A caustic is part of one bounce. As a small lamp with a sharp lobe a texel would be found by no draw of a gather, so lobes
there are widened (`kernels.clusters.MIN_ALPHA`), and the light of a mirror comes as a blur. Here it is followed instead
(`kernels.photons`).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from ..core.frame import Frame, LightView
from ..core.radiometry import brightest
from ..core.transforms import Camera
from ..kernels.brdf import albedo_table
from ..kernels.bvh import Bvh
from ..kernels.photons import (
    Mirrors,
    Photons,
    add_photons,
    count_photons,
    find_materials,
    make_photons,
    shoot_photons,
    spread_photons,
)
from ..kernels.vec3 import f32
from .base import Context
from .direct import pack_lamp
from .screen import screen_of
from .surroundings import reach_out_m

SHARPEST = 0.05             # alpha (roughness 0.22) below which a texel's lobe is left to photons: wider ones gain nothing
LEAST_SHARE = 2e-3          # of the light that all texels send on: less in mirrors is not worth the photons
LARGE_SHARE = 0.1           # from which on all of them are
MOST_RADIUS = 0.05          # of the scene's size: of a lone photon's disk
LEAST_REACH = 4.0           # ray offsets by which a view's point may lie off its triangle
TILE_PHOTONS = 1 << 16      # between two looks at Esc


def _is_sharp(view: LightView) -> np.ndarray:
    """(H, W) bool: texels whose lobe is left to photons."""
    g = view.gbuffer
    return (g.roughness**2 < SHARPEST) & (brightest(g.specular) > 0)


def mirror_share(frame: Frame) -> float:
    """What lobes that are left to photons send on, over all that the texels of the lamps' views do."""
    sharp = total = 0.0
    for view in frame.views:
        light, g = frame.lights[view.light_index], view.gbuffer
        glossy = light.glossy_factor * (view.incident_flux * g.specular).sum(-1)
        sharp += float(glossy[_is_sharp(view)].sum(dtype=np.float64))
        total += float((glossy + light.diffuse_factor * (view.incident_flux * g.albedo).sum(-1)).sum(dtype=np.float64))
    return sharp / max(total, 1e-300)


def photons_for(frame: Frame, most: int) -> int:
    """How many photons the mirrors of a frame are worth, of at most `most`."""
    if not any(_is_sharp(view).any() for view in frame.views):
        return 0
    share = mirror_share(frame)
    return round(most * min(1.0, math.sqrt(share / LARGE_SHARE))) if share > LEAST_SHARE else 0


def _owners(is_sharp: np.ndarray) -> np.ndarray:
    """(H, W) int32 of `kernels.photons.Mirrors`: a texel's own flat index, beside an edge that of a sharp neighbour.

    A texel is sharp or not by its middle. Photons start all over it, so the texels around an edge have to start some too.
    """
    height, width = is_sharp.shape
    padded = np.full((height + 2, width + 2), -1, np.int32)
    padded[1:-1, 1:-1] = np.where(is_sharp, np.arange(is_sharp.size, dtype=np.int32).reshape(is_sharp.shape), -1)
    owner = padded[1:-1, 1:-1].copy()
    for down, right in ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1)):
        beside = padded[1 + down:height + 1 + down, 1 + right:width + 1 + right]
        np.copyto(owner, beside, where=owner < 0)
    return owner


def _corner_rays(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Origins and directions (H + 1, W + 1, 3) float32 of the rays through the corners of a view's texels."""
    half_x, half_y = (0.5 * step for step in camera.pixel_size)
    corners = dataclasses.replace(
        camera, width_px=camera.width_px + 1, height_px=camera.height_px + 1, left=camera.left - half_x,
        right=camera.right + half_x, bottom=camera.bottom - half_y, top=camera.top + half_y)
    origin, direction = corners.rays_vs()
    rotation = camera.world_from_view[:3, :3]
    return ((origin @ rotation.T + camera.position_ws).astype(np.float32), (direction @ rotation.T).astype(np.float32))


def _mirrors_of(frame: Frame, view: LightView, flux: np.ndarray, bvh: Bvh) -> Mirrors:
    g, is_sharp = view.gbuffer, _is_sharp(view)
    mirrors = Mirrors(g.position_ws, g.normal_ws, g.specular, g.roughness, g.f0, flux.astype(np.float32), _owners(is_sharp),
                      *_corner_rays(view.camera), np.full(g.shape, -1, np.int32), frame.geometry.material,
                      albedo_table())
    texel = np.flatnonzero(is_sharp)
    find_materials(len(texel), texel, mirrors, bvh, f32(LEAST_REACH * frame.ray_offset_m))
    return mirrors


def _sent(mirrors: Mirrors) -> np.ndarray:
    """(H, W) W: mean over the colours of what each texel sends into a sharp lobe, if its owner's surface fills it."""
    specular = mirrors.specular.reshape(-1, 3)[np.maximum(mirrors.owner, 0)]
    return np.where(mirrors.owner >= 0, (mirrors.flux * specular).mean(-1), 0)


def add_caustics(irradiance: np.ndarray, frame: Frame, fluxes: Sequence[np.ndarray], number: int, bvh: Bvh,
                 context: Context, seed: int) -> int:
    """Add to `irradiance` (H, W, 3) W/m2 that of about `number` photons off the mirror-like texels; how many fell somewhere.

    Every photon has about the same flux. `fluxes` (H, W, 3) W: what arrives at the texels of each view.
    """
    reach_m = reach_out_m(frame, bvh)
    lights = [frame.lights[view.light_index] for view in frame.views]
    mirrors = [_mirrors_of(frame, view, light.glossy_factor * flux, bvh)
               for view, light, flux in zip(frame.views, lights, fluxes, strict=True)]
    sent = [_sent(m) for m in mirrors]
    per_flux = number / max(sum(float(s.sum(dtype=np.float64)) for s in sent), 1e-300)
    found: list[Photons] = []
    for index, (light, m, mine) in enumerate(zip(lights, mirrors, sent, strict=True)):
        expected, count = (mine * per_flux).astype(np.float32), np.zeros(mine.shape, np.int32)
        count_photons(len(count), expected, seed + index, count)
        texel = np.repeat(np.arange(count.size), count.ravel())
        ordinal = np.arange(len(texel)) - np.repeat(np.cumsum(count) - count.ravel(), count.ravel())
        lamp = pack_lamp(light, reach_m)
        for first in range(0, len(texel), TILE_PHOTONS):
            context.checkpoint("Follow light off mirrors", 0.0)
            here = texel[first:first + TILE_PHOTONS], ordinal[first:first + TILE_PHOTONS]
            photons, landed = make_photons(len(here[0])), np.zeros(len(here[0]), bool)
            shoot_photons(len(landed), *here, expected, m, lamp, bvh, f32(frame.ray_offset_m),
                          f32(LEAST_REACH * frame.ray_offset_m), f32(reach_m), seed + index, photons, landed)
            found.append(Photons(*(a[landed] for a in photons)))
    if not any(len(photons.flux) for photons in found):      # none at all where few were asked for, or none met a surface
        return 0
    photons = Photons(*(np.concatenate(arrays) for arrays in zip(*found, strict=True)))
    context.checkpoint("Add caustics", 0.0)
    mask = frame.gbuffer.mask
    beside = float(irradiance[mask].mean(dtype=np.float64)) if mask.any() else 0.0
    spread_photons(photons, beside, MOST_RADIUS * frame.scale_m, frame.ray_offset_m)
    add_photons(photons, screen_of(frame), irradiance)
    return len(photons.flux)
