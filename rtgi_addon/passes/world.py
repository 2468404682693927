"""Light of the world's background that reaches a pixel without a bounce: world irradiance times ray-traced visibility."""

from __future__ import annotations

import numpy as np

from ..core.frame import Frame, World
from ..core.radiometry import mean_of
from ..core.techniques import WorldParams
from ..kernels.sky import GUIDE_COLUMNS, GUIDE_ROWS, Guide, gather_sky, no_guide
from ..kernels.vec3 import f32
from .base import Context, PassResult, Technique, Transport
from .lattice import gather_on_lattice
from .sky_light import open_irradiance, shrink_map, sky_distribution

MAP_SHARE = 0.5             # share of the rays drawn by the map's brightness, when it is not constant
# Where little of the sky is seen, as in a room with a window, the first rays tell where, and guide half of the others:
PILOTS = 4                  # one ray in so many goes first
LEAST_RAYS = 16             # fewer would leave too few of either sort
GUIDE_PX = 32               # edge of the squares of pixels that have a guide in common
CLOSED = 0.3                # share of an open sky's light below which they may have one
LEAST_SEEN = 4              # rays that arrived in such a square, at least
NARROW = 0.06               # share of the sphere, as an even light of equal spread, above which guides do not pay
PILOT_SHARE = np.float32(0.05)      # of the mean that the first rays make up where others are guided: they are noisy


def compute_world(frame: Frame, params: WorldParams, context: Context, seed: int = 0) -> PassResult:
    """Irradiance from the world with visibility through the scene's triangles.

    Parameters
    ----------
    frame : Frame
        With `geometry`, and a `world` (a constant, or an equirectangular map of radiance W/(m2 sr)).
    params : WorldParams
    context : Context
    seed : int

    Returns
    -------
    PassResult
        WORLD_DIFFUSE: (H, W, 3) float32 W/m2; visibility (H, W): share of the world's light that arrives, cosine-weighted.

    Raises
    ------
    Cancelled
        When the user asked to stop.

    Notes
    -----
    Ignores the glossy reflection of the world and its bounce. Exact for a constant world over an open plane.
    """
    g = frame.gbuffer
    if frame.world.is_black:
        return PassResult({Transport.WORLD_DIFFUSE: np.zeros_like(g.albedo)}, np.ones(g.shape, np.float32))
    sky = World(shrink_map(frame.world.radiance))
    cdf, density = sky_distribution(sky.radiance)
    bvh = context.bvh(frame.geometry)
    low, high = frame.geometry.bounds_ws
    reach = float(np.linalg.norm(high - low)) + float(np.abs(g.position_ws).max(initial=0)) * 2 + 1.0

    rays, map_share = params.rays, f32(0.0 if sky.is_constant else MAP_SHARE)
    pilots = rays // PILOTS if rays >= LEAST_RAYS else 0

    def gather(position: np.ndarray, normal: np.ndarray, ids: np.ndarray, places: np.ndarray, salt: int) -> np.ndarray:
        out = np.zeros((len(ids), 5), np.float32)
        cells, values = np.full((len(ids), pilots), -1, np.int16), np.zeros((len(ids), pilots), np.float32)

        def send(first: int, last: int, guide: Guide) -> None:
            gather_sky(position, normal, places, sky.radiance, cdf, density, bvh, rays, map_share, first, last, guide,
                       f32(frame.ray_offset_m), f32(reach), salt, out, cells, values)

        send(0, pilots, no_guide(len(ids)))
        guide = _guide_of(out, cells, values, *np.divmod(ids, g.shape[1]))
        is_guided = guide.of >= 0
        early, out[is_guided] = out[is_guided] * np.float32(rays / max(pilots, 1)), 0
        send(pilots, rays, guide)
        number = np.where(is_guided, rays - pilots, rays)
        out[:, 4] = np.maximum(out[:, 4] - mean_of(out[:, :3]) ** 2 / number, 0)
        out[is_guided] *= np.float32([1 - PILOT_SHARE] * 4 + [(1 - PILOT_SHARE) ** 2])
        out[is_guided, :4] += PILOT_SHARE * early[:, :4]
        return out

    irradiance, diagnostics = gather_on_lattice(frame, gather, params.lattice_px, 2 * seed + 3, context, "World light")
    return PassResult({Transport.WORLD_DIFFUSE: irradiance}, _visibility(irradiance, sky, g.normal_ws, g.mask), diagnostics)


def _guide_of(out: np.ndarray, cells: np.ndarray, values: np.ndarray, row: np.ndarray, column: np.ndarray) -> Guide:
    """Where the sky is seen from squares of the picture, by the rays that arrived at the points (M,) in and around them.

    `out` (M, 5), `cells` and `values` (M, K) are of `gather_sky`. Squares that see much of the sky, or none, have no guide,
    nor do those that see it here and there: where one point sees it others do not.
    """
    # a call has a band of a large picture: only the squares of that are counted
    row, column = row // GUIDE_PX, column // GUIDE_PX
    row = row - (row.min() if len(row) else 0)
    across, down = int(column.max(initial=0)) + 1, int(row.max(initial=0)) + 1
    square, kinds = row * across + column, GUIDE_ROWS * GUIDE_COLUMNS

    def sums(weights: np.ndarray) -> np.ndarray:
        return np.bincount(square, weights, across * down)

    arrived, number = cells >= 0, sums((cells >= 0).sum(1))
    with np.errstate(divide="ignore", invalid="ignore"):
        is_guided = (sums(mean_of(out[:, :3])) < CLOSED * sums(out[:, 3])) & (number >= LEAST_SEEN)
    chosen = np.flatnonzero(is_guided)
    if not len(chosen):
        return no_guide(len(row))
    flat = (square[:, None] * kinds + cells)[arrived]
    light = np.bincount(flat, values[arrived], across * down * kinds).reshape(down, across, kinds)
    padded = np.pad(light, ((1, 1), (1, 1), (0, 0)))
    around = sum(padded[i:i + down, j:j + across] for i in range(3) for j in range(3)).reshape(-1, kinds)[chosen]
    share = around / around.sum(1, keepdims=True)
    is_narrow = (share**2).sum(1) * kinds > 1 / NARROW
    chosen, share = chosen[is_narrow], share[is_narrow]
    cdf = np.cumsum(share, 1)
    cdf[:, -1] = 1.0
    group = np.full(across * down, -1, np.int32)
    group[chosen] = np.arange(len(chosen))
    return Guide(group[square], cdf, (share * (kinds / (4 * np.pi))).astype(np.float32))


def _visibility(irradiance: np.ndarray, sky: World, normal_ws: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """(H, W) float32: irradiance over what an open surface of the same normal would get, in [0, 1]."""
    with np.errstate(divide="ignore", invalid="ignore"):
        share = mean_of(irradiance) / mean_of(open_irradiance(sky, normal_ws, mask))
    return np.where(mask, np.clip(np.nan_to_num(share, nan=1.0, posinf=1.0), 0, 1), 1).astype(np.float32)


TECHNIQUE = Technique("world", "World Light", WorldParams, compute_world, frozenset({Transport.WORLD_DIFFUSE}),
                      needs_geometry=True)
