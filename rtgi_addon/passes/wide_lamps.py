"""What a lamp that is wide beside its distance lights: rays from all over it, where its view shows what its centre sees.

A tube under a ceiling, a panel close to a wall or a ceiling that shines light much that their centre does not see. A texel
of a view is the light that leaves the lamp in one direction, from whatever place on it. Here each texel's ray starts at a
place of its own, so that those of any block start all over the lamp.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..core.frame import Frame, GBuffer, Light, LightKind, LightView
from ..core.radiometry import area_of, mean_of, texel_flux, texel_solid_angle
from ..kernels.bvh import Bvh
from ..kernels.clusters import LEAST_COSINE
from ..kernels.lamps import irradiance_at
from .direct import pack_lamp
from .surroundings import reach_out_m, seen_by_rays, surroundings_of

NEAR = 1.5                  # lengths of a lamp
NEAR_SHARE = 0.25           # of its light that falls nearer than that, from which it is wide
MOST_ACROSS = 1.0           # sr: where the whole lamp gives hardly anything
SAME_DEPTH = 0.02           # relative difference of depths up to which a view shows a place
EVEN_X, EVEN_Y = (0.7548776662466927, 0.5698402909980532), (0.361991, 0.442725)     # as in `kernels.sampling.dither`


class WideTexels(NamedTuple):
    """Of a wide lamp's view, (H, W): the surfaces that its texels' light falls on, the places on the lamp where it starts
    (H, W, 3), the flux (H, W, 3) W that arrives, and the solid angle in sr that the part of the surface which a texel stands
    for has from there."""

    surfaces: GBuffer
    origin_ws: np.ndarray
    flux: np.ndarray
    across: np.ndarray


def is_wide(view: LightView, light: Light) -> bool:
    """Whether much of an area lamp's light falls on places that are about as near as the lamp is long."""
    if not light.kind.is_area:
        return False
    offset = view.gbuffer.position_ws - light.position_ws.astype(np.float32)
    is_near = np.einsum("hwc,hwc->hw", offset, offset) < (NEAR * max(light.size_x_m, light.size_y_m)) ** 2
    flux = mean_of(view.incident_flux)           # 0 where nothing is seen
    return float(flux[is_near].sum(dtype=np.float64)) > NEAR_SHARE * float(flux.sum(dtype=np.float64))


def _starts_on(light: Light, shape: tuple[int, int]) -> np.ndarray:
    """(H, W, 3) places on a lamp, evenly spread over every block of texels."""
    rows, columns = np.mgrid[:shape[0], :shape[1]]
    x, y = ((rows * down + columns * right) % 1 for down, right in (EVEN_X, EVEN_Y))
    if light.kind is LightKind.DISK:
        x, y = 0.5 * np.sqrt(x) * np.cos(2 * np.pi * y), 0.5 * np.sqrt(x) * np.sin(2 * np.pi * y)
    else:
        x, y = x - 0.5, y - 0.5
    return np.stack([x * light.size_x_m, y * light.size_y_m], -1) @ light.world_from_light[:3, :2].T + light.position_ws


def spread_texels(frame: Frame, view: LightView, bvh: Bvh) -> WideTexels:
    """Follow the light of a view's lamp from all over the lamp, instead of from its centre."""
    camera, light = view.camera, frame.lights[view.light_index]
    origin_ws, ways = _starts_on(light, view.gbuffer.shape), camera.rays_vs()[1]
    ways /= np.linalg.norm(ways, axis=-1, keepdims=True)
    ways_ws, solid_angle = ways @ camera.world_from_view[:3, :3].T, texel_solid_angle(camera)
    surfaces = seen_by_rays(origin_ws, ways_ws, frame, bvh, surroundings_of(frame, frame.geometry),
                            (frame.ray_offset_m, reach_out_m(frame, bvh)))      # it may lie in a ceiling's plane
    _take_colours(surfaces, view)
    lit = np.zeros(surfaces.shape, np.float32)
    irradiance_at(lit.size, pack_lamp(light, 1.0), surfaces.position_ws.reshape(-1, 3), surfaces.normal_ws.reshape(-1, 3),
                  lit.reshape(-1))
    # a texel stands for as much of the surface as its flux lights as brightly as the whole lamp does
    sent = area_of(light.kind, light.size_x_m, light.size_y_m) * solid_angle * np.maximum(-ways[..., 2], 0)
    cosine = np.maximum(-np.einsum("hwc,hwc->hw", ways_ws, surfaces.normal_ws), LEAST_COSINE)
    squared_m2 = np.where(surfaces.mask, surfaces.depth, 0).astype(np.float64) ** 2
    across = sent * cosine / np.maximum(squared_m2 * lit, 1e-30)
    flux = texel_flux(light, camera) * surfaces.mask[..., None]
    return WideTexels(surfaces, origin_ws.astype(np.float32), flux, np.minimum(across, MOST_ACROSS).astype(np.float32))


def _take_colours(surfaces: GBuffer, view: LightView) -> None:
    """Colours of a lamp's own view, which shows textures, in the places that it shows; in place."""
    g = view.gbuffer
    column, row, depth = view.camera.project(surfaces.position_ws.astype(np.float64))
    column, row = np.floor(np.nan_to_num(column, nan=-1)), np.floor(np.nan_to_num(row, nan=-1))
    height, width = g.shape
    inside = surfaces.mask & (row >= 0) & (row < height) & (column >= 0) & (column < width)
    i, j = row[inside].astype(np.int64), column[inside].astype(np.int64)
    shown = np.abs(g.depth[i, j] - depth[inside]) < SAME_DEPTH * depth[inside]
    shown &= np.einsum("nc,nc->n", g.normal_ws[i, j], surfaces.normal_ws[inside]) > 0.5
    inside[inside] = shown
    for name in ("albedo", "specular", "roughness", "f0"):
        getattr(surfaces, name)[inside] = getattr(g, name)[i[shown], j[shown]]
