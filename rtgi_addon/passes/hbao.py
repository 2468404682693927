"""Horizon-based ambient occlusion: world light times a visibility that marches over the depth image find.

Cosine-correct sectors (`COSINE`): slices around the direction to the viewer (Jimenez et al. 2016, "Practical Real-Time
Strategies for Accurate Indirect Occlusion"), each with 64 sectors that what the camera sees closes, with a thickness
behind it (Therrien et al. 2023, "Screen Space Indirect Lighting with Visibility Bitmask"); the sectors are even in the
cosine-weighted measure of their slice (Salm 2024), so that V is the ray-traced visibility wherever the screen shows what
matters. The equations are in `kernels.slices`.

As published (`PUBLISHED`): horizons over the view's XY plane in several directions (Bavoil, Sainz and Dimitrov 2008,
"Image-Space Horizon-Based Ambient Occlusion"), with tangent bias, falloff, and a delta for every sample:

    V = 1 - 1 / (2 pi) sum over directions and samples of (sin h_i - sin h_{i-1}) W(r_i) dtheta,  W = 1 - r^2 / R^2

It counts solid angle, not cosine: a wall that rises to elevation f hides f / pi of it, and (1 - cos f) / 2 of the light.

Deviations: slices lie evenly around the viewer's direction instead of the screen's axis, which reads 1 on an open plane
up to the picture's edge (screen-even slices: 0.93 to 1.13 at 50 degrees); weights of the slices are divided out; no
fitted powers.
"""

from __future__ import annotations

import numpy as np

from ..core.frame import Frame
from ..core.techniques import HbaoParams
from ..kernels.horizons import published_visibility, sector_directions, sector_visibility
from ..kernels.screen import Screen
from ..kernels.vec3 import f32
from .ambient import Gather, ambient_light, radius_of, screen_visibility
from .base import Context, PassResult, Technique, Transport

_NO_DIRECTIONS = np.zeros((0, 8, 2), np.float32)


def compute_hbao(frame: Frame, params: HbaoParams, context: Context, seed: int = 0) -> PassResult:
    """World light by HBAO.

    Parameters
    ----------
    frame : Frame
        With a world; `geometry` is used for the overscan only.
    params : HbaoParams
    context : Context
    seed : int
        Of the turn of the slices, the places of the samples and of the sectors.

    Returns
    -------
    PassResult
        WORLD_DIFFUSE (H, W, 3) float32 W/m2, and the visibility (H, W), cosine-weighted for `COSINE`.

    Raises
    ------
    Cancelled
        When the user asked to stop.

    Notes
    ----- Ignores what lies off screen, hidden behind what the camera sees, or farther than the radius. Exact for an open
    plane; with `multi_bounce` also for surfaces in a sphere of even reflectance.
    """
    radius = radius_of(params.radius_m, frame)
    gather = _gather(params, radius, params.bent_normals and not frame.world.is_constant, seed)
    return ambient_light(frame, gather, context, "HBAO", radius, params.lattice_px, params.blur, params.overscan,
                         params.multi_bounce)


def bent_normals(frame: Frame, params: HbaoParams, context: Context, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """(visibility (H, W), mean open direction (H, W, 3)) float32 by sectors, whatever the world is.

    The direction is in world space and as long as it is narrow: |b| is 2/3 V on an open plane, V for a pinhole, 0 where
    nothing is open or seen.
    """
    gather = _gather(params, radius_of(params.radius_m, frame), True, seed)
    planes = screen_visibility(frame, gather, frame.gbuffer.mask, context, "HBAO", params.lattice_px, params.blur,
                               params.overscan)
    return planes[0], np.ascontiguousarray(np.moveaxis(planes[1:], 0, -1))


def _gather(params: HbaoParams, radius: float, is_bent: bool, seed: int) -> Gather:
    def by_sectors(screen: Screen, groups: np.ndarray, height: int, width: int, step: int, margin: int) -> np.ndarray:
        planes = sector_visibility(
            screen, groups, height, width, step, margin, f32(radius), f32(params.thickness * radius), params.slices,
            params.steps, sector_directions() if is_bent else _NO_DIRECTIONS, seed)
        return planes if is_bent else planes[:1]

    def by_horizons(screen: Screen, groups: np.ndarray, height: int, width: int, step: int, margin: int) -> np.ndarray:
        return published_visibility(screen, groups, height, width, step, margin, f32(radius), f32(params.bias_rad),
                                    params.falloff, 2 * params.slices, params.steps, seed)

    return by_sectors if params.method == "COSINE" else by_horizons


TECHNIQUE = Technique("hbao", "Ambient Occlusion (HBAO)", HbaoParams, compute_hbao, frozenset({Transport.WORLD_DIFFUSE}))
