"""Reflective shadow maps: every lit texel of a light's view is a small lamp.

A texel p that reflects the flux Phi_p W gives a receiver x with normal n the irradiance
    E(x) = Phi_p / pi * max(0, n_p . (x - x_p)) max(0, n . (x_p - x)) / |x - x_p|^4                         [1], Eq. 1
The fourth power because both dot products take the unnormalised difference; the 1 / pi because a Lambertian texel of flux
Phi has intensity Phi / pi cos(theta) (the paper counts it in its flux). To that comes the texel's glossy lobe: a lit surface
sends both, and without it 7 to 31 % of the bounce is missing in scenes with gloss.

Methods: VISIBLE draws texels from clusters by what they would give and traces a shadow ray to each, and follows the light of
mirrors as photons (`caustics`); ALL sums every texel, or an even share, without visibility; PAPER is [1] as printed, polar
samples around the pixel's place in the map.

References
----------
.. [1] Dachsbacher, Stamminger. Reflective Shadow Maps. I3D 2005. doi:10.1145/1053427.1053460
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ..core.frame import Frame, GBuffer, Light, LightKind, LightView
from ..core.radiometry import brightest, texel_solid_angle
from ..core.techniques import RsmParams
from ..kernels.brdf import albedo_table, mean_albedo_table
from ..kernels.bvh import Bvh
from ..kernels.clusters import DIFFUSE, GLOSSY, NORMAL, POSITION, ROWS, cluster_texels, fill_texels
from ..kernels.gather import gather_visible
from ..kernels.lamps import gain_of_size
from ..kernels.texel_parts import PARTS
from ..kernels.vec3 import f32, vector
from ..kernels.vpl import gather_all, gather_polar, thin_texels
from .base import Context, PassResult, Technique, Transport
from .caustics import SHARPEST, add_caustics, photons_for
from .direct import pack_lamp
from .lattice import gather_in_tiles, gather_on_lattice
from .screen import is_shown
from .surroundings import reach_out_m
from .uneven_texels import look_through
from .wide_lamps import is_wide, spread_texels

MAX_TEXELS = 65536          # texels that clusters are made of; more only make the sums over near clusters slower
MOST_GAIN = f32(4)          # of a lamp's size: at grazing places its centre gives nearly nothing
MIN_DISTANCE2 = 1e-8        # of the scene's size squared: keeps 1 / r^2 finite on the texel itself


def is_reflecting(g: GBuffer, flux: np.ndarray, light: Light, use_glossy: bool, sharpest: float = 0.0) -> np.ndarray:
    """(H, W) bool: texels that send `flux` (H, W, 3) back, other than by lobes of an alpha below `sharpest`."""
    colour = light.diffuse_factor * g.albedo
    if use_glossy:
        colour = colour + light.glossy_factor * g.specular * (g.roughness**2 >= sharpest)[..., None]
    return np.einsum("hwc,hwc->hw", flux, colour) > 0


def _flux_of(view: LightView, light: Light) -> np.ndarray:
    """(H, W, 3) W: `incident_flux` as the whole of an area lamp sends it, not its centre alone, to places near it.

    Not of a lamp with a narrow spread: its centre lights a cone, and the whole of it a tube, which the view does not show.
    """
    lamp = pack_lamp(light, 1.0)
    if not light.kind.is_area or lamp.spread_gain > 0:
        return view.incident_flux
    g, gain = view.gbuffer, np.empty(view.gbuffer.shape, np.float32)
    gain_of_size(gain.size, lamp, g.position_ws.reshape(-1, 3), g.normal_ws.reshape(-1, 3), MOST_GAIN, gain.reshape(-1))
    return view.incident_flux * gain[..., None]


def _fluxes_of(frame: Frame) -> list[np.ndarray]:
    return [_flux_of(view, frame.lights[view.light_index]) for view in frame.views]


def texel_table(frame: Frame, use_glossy: bool = True) -> np.ndarray:
    """(17, N) float32 table of all views' texels that reflect light (rows: `kernels.clusters`), in the order of capture."""
    return texels_and_radii(frame, _fluxes_of(frame), use_glossy)[0]


class _Texels(NamedTuple):
    """Texels of one lamp, (H, W): `is_wanted` bool, their flux (H, W, 3) W, and solid angle in sr or a sun's area in m2.

    faces_ws (H, W, 3): normals of their triangles, or shading normals again where those are not known. origin_ws (H, W, 3):
    where their light comes from; not used of a sun.
    """

    light: Light
    surfaces: GBuffer
    faces_ws: np.ndarray
    is_wanted: np.ndarray
    flux: np.ndarray
    across: np.ndarray
    origin_ws: np.ndarray


def _texels_of(frame: Frame, view: LightView, flux: np.ndarray, use_glossy: bool, sharpest: float,
               bvh: Bvh | None, reach_m: float) -> list[_Texels]:
    """The texels of a view that reflect, and with a BVH in place of uneven ones the parts of them that do.

    With a BVH the light of a wide lamp starts all over it.
    """
    g, light = view.gbuffer, frame.lights[view.light_index]
    if bvh is not None and is_wide(view, light):
        wide = spread_texels(frame, view, bvh)
        wanted = is_reflecting(wide.surfaces, wide.flux, light, use_glossy, sharpest)
        return [_Texels(light, wide.surfaces, wide.surfaces.normal_ws, wanted, wide.flux, wide.across, wide.origin_ws)]
    is_sun = light.kind is LightKind.SUN
    across = np.full((1, 1), np.prod(view.camera.pixel_size)) if is_sun else texel_solid_angle(view.camera)
    across = np.broadcast_to(across, g.shape).astype(np.float32)
    reflects = is_reflecting(g, flux, light, use_glossy, sharpest)
    origin_ws = np.empty_like(g.position_ws)
    origin_ws[:] = light.position_ws
    if bvh is None:
        return [_Texels(light, g, g.normal_ws, reflects, flux, across, origin_ws)]
    d = g.position_ws - view.camera.position_ws.astype(np.float32)
    size_m = np.sqrt(across if is_sun else across * np.einsum("hwc,hwc->hw", d, d))
    # also where the middle reflects nothing: the rest of a texel may
    found = look_through(view, brightest(flux) > 0, size_m, bvh, reach_m)
    flux_of_parts = np.float32(1 / PARTS) * flux.reshape(-1, 3)[None, found.whole]
    wanted = is_reflecting(found.parts, flux_of_parts, light, use_glossy, sharpest)
    return [_Texels(light, g, found.faces_ws, reflects & ~found.is_split, flux, across, origin_ws),
            _Texels(light, found.parts, found.part_faces_ws, wanted, flux_of_parts,
                    np.float32(1 / PARTS) * across.ravel()[None, found.whole], origin_ws.reshape(-1, 3)[None, found.whole])]


def texels_and_radii(frame: Frame, fluxes: Sequence[np.ndarray], use_glossy: bool, sharpest: float = 0.0,
                     bvh: Bvh | None = None) -> tuple[np.ndarray, np.ndarray]:
    """(`texel_table`, (N,) float32 m: radius of the disk that has the area of each texel on the surface that it falls on).

    `fluxes` (H, W, 3) W: what arrives at the texels of each view. Lobes of an alpha below `sharpest` are left out. With
    `bvh` texels send from their triangles, whatever way shading normals turn, and one that holds more than one surface is
    split, see `uneven_texels`.
    """
    reach_m = reach_out_m(frame, bvh) if bvh is not None else 0.0
    texels = [part for view, flux in zip(frame.views, fluxes, strict=True)
              for part in _texels_of(frame, view, flux, use_glossy, sharpest, bvh, reach_m)]
    number = sum(int(np.count_nonzero(part.is_wanted)) for part in texels)
    table, radius_m, offset = np.empty((ROWS, number), np.float32), np.empty(number, np.float32), 0
    for light, g, faces_ws, reflects, flux, across, origin_ws in texels:
        count, is_sun = np.count_nonzero(reflects, axis=1), light.kind is LightKind.SUN
        fill_texels(len(reflects), table, offset + np.cumsum(count) - count, reflects, g.position_ws, g.normal_ws, faces_ws,
                    g.albedo, g.specular, g.roughness, g.f0, flux, origin_ws, vector(-light.direction_ws),
                    is_sun, albedo_table(), mean_albedo_table(), use_glossy,
                    f32(sharpest), across, radius_m)
        # as in Cycles: what a lamp's influence takes from a lobe is missing at every surface that it lights
        mine = slice(offset, offset + int(count.sum()))
        for row, factor in ((DIFFUSE, light.diffuse_factor), (GLOSSY, light.glossy_factor)):
            if factor != 1:
                table[row:row + 3, mine] *= np.float32(factor)
        offset = mine.stop
    return table, radius_m


def _visible(frame: Frame, params: RsmParams, context: Context, seed: int) -> PassResult:
    bvh, fluxes, irradiance = context.bvh(frame.geometry), _fluxes_of(frame), np.zeros_like(frame.gbuffer.albedo)
    photons = photons_for(frame, params.photons) if params.glossy_texels else 0
    table, radius_m = texels_and_radii(frame, fluxes, params.glossy_texels, SHARPEST if photons else 0.0, bvh)
    diagnostics: dict[str, Any] = {"texels": table.shape[1], "photons": 0}
    if table.shape[1]:
        irradiance, found = _gather_visible(frame, params, context, seed, table, radius_m, bvh)
        diagnostics |= found
    if photons:
        diagnostics["photons"] = add_caustics(irradiance, frame, fluxes, photons, bvh, context, seed)
    return PassResult({Transport.BOUNCE_DIFFUSE: irradiance}, diagnostics=diagnostics, near_left_m=context.near_m)


def _gather_visible(frame: Frame, params: RsmParams, context: Context, seed: int, table: np.ndarray,
                    radius_m: np.ndarray, bvh: Bvh) -> tuple[np.ndarray, dict[str, Any]]:
    """(irradiance (H, W, 3) W/m2, diagnostics) of the texels of `table` through visibility rays."""
    if table.shape[1] > MAX_TEXELS:
        each = table.shape[1] / MAX_TEXELS       # texels that one stands for, with flux and area
        table = thin_texels(np.concatenate([table, radius_m[None] * np.float32(math.sqrt(each))]), MAX_TEXELS, seed)
        table, radius_m = table[:ROWS], table[ROWS]
    context.checkpoint("Cluster lit texels", 0.0)
    fade = None
    if context.near_m > 0:                       # whoever asked brings the near light of texels that the camera sees
        shown = is_shown(frame, table[POSITION:POSITION + 3].T, table[NORMAL:NORMAL + 3].T)
        fade = shown * f32(1 / context.near_m**2)
    clusters = cluster_texels(table, params.clusters, frame.scale_m, fade, radius_m)
    offset_m, eps2 = f32(frame.ray_offset_m), f32(MIN_DISTANCE2 * frame.scale_m**2)

    def gather(position: np.ndarray, normal: np.ndarray, _: np.ndarray, places: np.ndarray, salt: int) -> np.ndarray:
        return gather_visible(position, normal, places, clusters, eps2, bvh, params.rays, offset_m, salt)

    irradiance, diagnostics = gather_on_lattice(frame, gather, params.lattice_px, 2 * seed + 1, context, "Gather the bounce")
    return irradiance, {"clusters": clusters.table.shape[1], **diagnostics}


def _all_texels(frame: Frame, params: RsmParams, context: Context, seed: int) -> PassResult:
    table = texel_table(frame, params.glossy_texels)
    n_texels = table.shape[1]
    table = thin_texels(table, params.samples, seed)
    eps2 = f32(MIN_DISTANCE2 * frame.scale_m**2)

    def gather(position: np.ndarray, normal: np.ndarray, _: int) -> np.ndarray:
        return gather_all(position, normal, table, eps2)

    g, out = frame.gbuffer, np.zeros_like(frame.gbuffer.albedo)
    out[g.mask] = gather_in_tiles(gather, (g.position_ws[g.mask], g.normal_ws[g.mask]), seed, context, "Gather all texels")
    return PassResult({Transport.BOUNCE_DIFFUSE: out}, diagnostics={"texels": n_texels, "summed": table.shape[1]})


def _polar_from(frame: Frame, view: LightView, params: RsmParams, context: Context, seed: int) -> np.ndarray:
    g, surface = view.gbuffer, frame.gbuffer.mask
    position, normal = frame.gbuffer.position_ws[surface], frame.gbuffer.normal_ws[surface]
    column, row, _ = view.camera.project(position.astype(np.float64))
    # behind a spot there is no place in its map: such a pixel takes the map's centre
    column = np.nan_to_num(column, nan=view.camera.width_px / 2).astype(np.float32)
    row = np.nan_to_num(row, nan=view.camera.height_px / 2).astype(np.float32)
    reflected = view.incident_flux * g.albedo * np.float32(frame.lights[view.light_index].diffuse_factor)
    radius_px = params.radius * view.camera.width_px
    is_point = frame.lights[view.light_index].kind is LightKind.POINT
    wraps = is_point and view.camera.right - view.camera.left > 2 * np.pi - 1e-3

    def gather(p: np.ndarray, n: np.ndarray, columns: np.ndarray, rows: np.ndarray, salt: int) -> np.ndarray:
        return gather_polar(p, n, columns, rows, g.position_ws, g.normal_ws, reflected, f32(radius_px),
                            params.samples, params.weighting == "PUBLISHED", wraps, salt)

    out = np.zeros_like(frame.gbuffer.albedo)
    out[surface] = gather_in_tiles(gather, (position, normal, column, row), seed, context, "Sample the map")
    return out


def _published(frame: Frame, params: RsmParams, context: Context, seed: int) -> PassResult:
    total = np.zeros_like(frame.gbuffer.albedo)
    for view in frame.views:
        total += _polar_from(frame, view, params, context, seed)
    return PassResult({Transport.BOUNCE_DIFFUSE: total}, diagnostics={"samples": params.samples * len(frame.views)})


_METHODS = {"VISIBLE": _visible, "ALL": _all_texels, "PAPER": _published}


def compute_rsm(frame: Frame, params: RsmParams, context: Context, seed: int = 0) -> PassResult:
    """One-bounce diffuse irradiance from reflective shadow maps.

    Parameters
    ----------
    frame : Frame
        With `views`, and `geometry` for the method VISIBLE.
    params : RsmParams
    context : Context
        Asked for Esc between tiles, and for the BVH.
    seed : int
        The same seed gives bitwise the same image on any number of threads.

    Returns
    -------
    PassResult
        BOUNCE_DIFFUSE: (H, W, 3) float32 W/m2. Diagnostics: texels, clusters, share of pixels gathered, and
        photons that met a surface.

    Raises
    ------
    Cancelled
        When the user asked to stop.

    Notes
    -----
    Linear in the lights' power; no light gives exactly zero. Half shadows do not enter: what a lamp's centre sees is lit.
    Those of lamps that are wide beside their distance do (`wide_lamps`).
    Light that arrives at a texel after more than one segment is not there: this is one bounce.
    """
    return _METHODS[params.method](frame, params, context, seed)


TECHNIQUE = Technique("rsm", "Reflective Shadow Maps", RsmParams, compute_rsm, frozenset({Transport.BOUNCE_DIFFUSE}),
                      needs_geometry=True, needs_views=True)
