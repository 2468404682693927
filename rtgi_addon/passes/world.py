"""Light of the world's background that reaches a pixel without a bounce: world irradiance times ray-traced visibility."""

from __future__ import annotations

import numpy as np

from ..core.frame import Frame, World
from ..core.radiometry import mean_of
from ..core.techniques import WorldParams
from ..kernels.sky import gather_sky
from ..kernels.vec3 import f32
from .base import Context, PassResult, Technique, Transport
from .lattice import gather_on_lattice
from .sky_light import open_irradiance, shrink_map, sky_distribution

MAP_SHARE = 0.5             # share of the rays drawn by the map's brightness, when it is not constant


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

    def gather(position: np.ndarray, normal: np.ndarray, _: np.ndarray, places: np.ndarray, salt: int) -> np.ndarray:
        return gather_sky(position, normal, places, sky.radiance, cdf, density, bvh, params.rays,
                          f32(0.0 if sky.is_constant else MAP_SHARE), f32(frame.ray_offset_m), f32(reach), salt)

    irradiance, diagnostics = gather_on_lattice(frame, gather, params.lattice_px, 2 * seed + 3, context, "World light")
    return PassResult({Transport.WORLD_DIFFUSE: irradiance}, _visibility(irradiance, sky, g.normal_ws, g.mask), diagnostics)


def _visibility(irradiance: np.ndarray, sky: World, normal_ws: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """(H, W) float32: irradiance over what an open surface of the same normal would get, in [0, 1]."""
    with np.errstate(divide="ignore", invalid="ignore"):
        share = mean_of(irradiance) / mean_of(open_irradiance(sky, normal_ws, mask))
    return np.where(mask, np.clip(np.nan_to_num(share, nan=1.0, posinf=1.0), 0, 1), 1).astype(np.float32)


TECHNIQUE = Technique("world", "World Light", WorldParams, compute_world, frozenset({Transport.WORLD_DIFFUSE}),
                      needs_geometry=True)
