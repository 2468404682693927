"""Light propagation volumes: the light of lit surfaces goes into a grid of cells and travels from cell to cell.

Three modes share grid, walls and lookup:

ORDINATES keeps the flux of each cell by patches of directions. A texel hands its light to the next plane of cells, and one
sweep carries every patch to the wall or border where it ends. What travels stays on its way, so that it falls off as 1 / r^2
(discrete ordinates [2]_, with a spread that is even over the directions).
HARMONICS keeps an intensity in two bands of spherical harmonics and takes steps from each cell to its six neighbours
through five faces [1]_, without clamping, until little of the flux is left in motion.
PAPER is [1]_: clamped steps of a fixed number, fuzzy blockers from what camera and lamps see, damped lookups.

References
----------
.. [1] Kaplanyan, Dachsbacher. Cascaded Light Propagation Volumes for Real-Time Indirect Illumination. I3D 2010.
   doi:10.1145/1730804.1730821
.. [2] Carlson, Lathrop. Transport Theory: the Method of Discrete Ordinates. In Computing Methods in Reactor Physics, 1968.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..core.frame import Frame, Geometry
from ..core.techniques import LpvParams
from ..kernels import harmonics, ordinates
from ..kernels.bvh import Bvh
from ..kernels.clusters import DIFFUSE, NORMAL, POSITION
from ..kernels.light_grid import LightGrid
from ..kernels.vec3 import f32
from ..kernels.vpl import thin_texels
from .base import Context, PassResult, Technique, Transport
from .lattice import gather_on_lattice
from .light_volume import boxes_of, grid_over, merge_texels, surfels_of
from .rsm import texel_table

MAX_TEXELS = 65536          # texels that go into the grid; an eighth of them changes the light of a scene by 1 %
BLEND_CELLS = 2.0           # over so many cells the light of an inner grid takes over from that of the grid around it


class Volume(NamedTuple):
    """A grid with its light after transport: flux by direction, or the sum of coefficients over all steps."""

    grid: LightGrid
    light: np.ndarray


def _across_a_face(params: LpvParams) -> int:
    """Patches of directions along an edge of a cube's face: an even number."""
    return params.directions + params.directions % 2


def _travelled(frame: Frame, params: LpvParams, table: np.ndarray, bvh: Bvh, offset_m: float,
               context: Context) -> tuple[list[Volume], dict[str, Any]]:
    """Volumes of ORDINATES, the widest first; each takes what comes from outside of it from the one before."""
    n, volumes, kept = _across_a_face(params), [], 0.0
    for level, box in enumerate(boxes_of(frame, table, params.cascades)):
        context.checkpoint("Light into the grid", 0.3 * level)
        grid = grid_over(frame, box, params.resolution, params.blockers)
        flux = ordinates.empty_flux(n, grid.links.shape[1:])
        ordinates.inject(flux, n, merge_texels(table, grid), grid, bvh, offset_m)
        kept = kept or float(flux.sum(dtype=np.float64))
        context.checkpoint("Light through the grid", 0.3 * level + 0.2)
        if volumes:
            ordinates.fill_ghosts(flux, grid, volumes[-1].light, volumes[-1].grid)
        ordinates.sweep(flux, grid, n, ordinates.GHOST if volumes else 0)
        volumes.append(Volume(grid, flux))
    return volumes, {"directions": 6 * n * n, "flux_w": kept}


def _stepped(frame: Frame, params: LpvParams, table: np.ndarray, context: Context) -> tuple[list[Volume], dict[str, Any]]:
    """The one volume of HARMONICS and PAPER."""
    is_published = params.mode == "PAPER"
    box = boxes_of(frame, table)[0]
    grid = grid_over(frame, box, params.resolution, params.blockers and not is_published)
    context.checkpoint("Light into the grid", 0.0)
    state = harmonics.inject(grid, *(np.ascontiguousarray(table[row:row + 3].T) for row in (POSITION, NORMAL, DIFFUSE)))
    fuzzy = None
    if is_published and params.blockers:
        views = [(frame.camera, frame.gbuffer)] + [(view.camera, view.gbuffer) for view in frame.views]
        fuzzy = harmonics.fuzzy_blockers(grid, [surfels_of(*view) for view in views])
    context.checkpoint("Light through the grid", 0.2)
    total, steps, left = harmonics.propagate(
        state, grid, 0.0 if is_published else params.residual, params.iterations if is_published else params.max_iterations,
        clamp=is_published, fuzzy=fuzzy)
    return [Volume(grid, total)], {"steps": steps, "in_motion": left, "flux_w": float(harmonics.flux_of(state).sum())}


def _inner_share(grid: LightGrid, position: np.ndarray) -> np.ndarray:
    """(M,) float32 in [0, 1]: how far the light at (M, 3) places comes from this grid and not from the one around it."""
    place = (position - grid.low) / grid.cell_m
    inside = np.minimum(place, np.array(grid.links.shape[1:], np.float32) - place).min(1)
    return np.clip((inside - ordinates.GHOST - 1) / BLEND_CELLS, 0, 1).astype(np.float32)


def _irradiance(volumes: list[Volume], params: LpvParams, bvh: Bvh, offset_m: float, position: np.ndarray,
                normal: np.ndarray) -> np.ndarray:
    """(M, 3) float32 W/m2 at surface points."""
    if params.mode != "ORDINATES":
        return harmonics.irradiance(position, normal, volumes[0].light, volumes[0].grid, bvh, offset_m,
                                    by_sight=params.mode == "HARMONICS", damps=params.mode == "PAPER" and params.damping)
    share = [_inner_share(volume.grid, position) if level else np.ones(len(position), np.float32)
             for level, volume in enumerate(volumes)]
    out = np.zeros((len(position), 3), np.float32)
    for level, volume in enumerate(volumes):
        is_last = level + 1 == len(volumes)
        wanted = np.flatnonzero((share[level] > 0) & (True if is_last else share[level + 1] < 1))
        here = ordinates.irradiance(position[wanted], normal[wanted], volume.light, volume.grid, _across_a_face(params), bvh,
                                    offset_m)
        s = share[level][wanted, None]
        out[wanted] = out[wanted] * (1 - s) + here * s
    return out


def _volumes(frame: Frame, params: LpvParams, context: Context,
             seed: int) -> tuple[list[Volume], Bvh, float, dict[str, Any]]:
    """The frame's light in its volumes, BVH and ray offset in m, diagnostics. No volumes where nothing is lit or seen."""
    table = texel_table(frame, params.glossy_texels and params.mode == "ORDINATES")
    bvh, offset_m = context.bvh(frame.geometry or Geometry.empty()), f32(frame.ray_offset_m)
    if not table.shape[1] or not frame.gbuffer.mask.any():
        return [], bvh, offset_m, {"texels": 0}
    thin = thin_texels(table, MAX_TEXELS, seed)
    if params.mode == "ORDINATES":
        volumes, diagnostics = _travelled(frame, params, thin, bvh, offset_m, context)
    else:
        volumes, diagnostics = _stepped(frame, params, thin, context)
    reflected = float(table[DIFFUSE:DIFFUSE + 3].sum(dtype=np.float64))
    grids = [{"cells": list(volume.grid.links.shape[1:]), "cell_m": float(volume.grid.cell_m)} for volume in volumes]
    return volumes, bvh, offset_m, {"texels": table.shape[1], "reflected_w": reflected, "grids": grids, **diagnostics}


def compute_lpv(frame: Frame, params: LpvParams, context: Context, seed: int = 0) -> PassResult:
    """One-bounce diffuse irradiance by light propagation volumes.

    Parameters
    ----------
    frame : Frame
        With `views`, and `geometry` for walls.
    params : LpvParams
    context : Context
        Asked for Esc between stages, and for the BVH.
    seed : int
        Which texels stand for all, where there are more than 65536. The same bits on any number of threads.

    Returns
    -------
    PassResult
        BOUNCE_DIFFUSE: (H, W, 3) float32 W/m2. Diagnostics: texels; the grids; flux that the texels reflect diffusely and
        that entered the grid, W; directions, or steps and the share of flux in motion at the end; share of pixels gathered.

    Raises
    ------
    Cancelled
        When the user asked to stop.

    Notes
    -----
    Light is known to a cell: it leaks around and blurs over what is smaller. Points outside the grid get none.
    Linear in the lamps' power; no light gives exactly zero.
    """
    volumes, bvh, offset_m, diagnostics = _volumes(frame, params, context, seed)
    if not volumes:
        return PassResult({Transport.BOUNCE_DIFFUSE: np.zeros_like(frame.gbuffer.albedo)}, diagnostics=diagnostics)

    def gather(position: np.ndarray, normal: np.ndarray, *_: object) -> np.ndarray:
        return _irradiance(volumes, params, bvh, offset_m, position, normal)

    light, spread = gather_on_lattice(frame, gather, params.lattice_px, seed, context, "Light from the grid", noisy=False)
    return PassResult({Transport.BOUNCE_DIFFUSE: light}, diagnostics={**diagnostics, **spread})


def light_slice(frame: Frame, params: LpvParams, context: Context, axis: int = 2, share: float = 0.5,
                seed: int = 0) -> np.ndarray:
    """A picture of the widest light volume: mean radiance W/(m2 sr) of the cells in one layer, (rows, columns, 3) float32.

    `axis` 0, 1 or 2 is x, y or z, across which the grid is cut at `share` in [0, 1] of its length. Seen along the axis, with
    the higher of the other two axes upwards in the picture; z is up where it is one of them. Cells that cannot be left on
    any side are inside of something and black. One black cell for a frame without light.
    """
    volumes = _volumes(frame, params, context, seed)[0]
    if not volumes:
        return np.zeros((1, 1, 3), np.float32)
    grid, light = volumes[0]
    shape = grid.links.shape[1:]
    area = float(grid.cell_m) ** 2
    if params.mode == "ORDINATES":
        mean = ordinates.mean_radiance(light, _across_a_face(params), area).reshape(*shape, 3)
    else:
        mean = np.moveaxis(light[:, 0], 0, -1) * np.float32(2 * np.sqrt(np.pi) / (4 * np.pi) / area)
    layer = np.take(mean, min(int(share * shape[axis]), shape[axis] - 1), axis)
    return np.ascontiguousarray(layer.swapaxes(0, 1)[::-1])


TECHNIQUE = Technique("lpv", "Light Propagation Volumes", LpvParams, compute_lpv, frozenset({Transport.BOUNCE_DIFFUSE}),
                      needs_geometry=True, needs_views=True)
