"""Screen-space ambient occlusion: world light times the share of random points around a pixel that the depth image shows.

Points are drawn evenly in a ball of the radius around the surface. One is hidden if the depth image has something before
it (Mittring 2007, "Finding Next Gen"). As published there are no normals: on an open plane half of the ball lies under
the surface, so V = min(1, 2 x the visible share), "no occlusion if more than half is seen". The oriented form turns each
point to the normal's side, which needs no such rule, and ignores what lies farther before a point than the radius.

Deviations: a number of points of any size, mirrored at a random plane a pixel, instead of 16 with a 4x4 pattern of
mirrors; the oriented form compares at the height over the tangent plane, so that an open plane reads exactly 1 however it
is tilted. Either counts volume, not directions: V is no cosine-weighted visibility, and its error against one is in the
docs.
"""

from __future__ import annotations

import numpy as np

from ..core.frame import Frame
from ..core.techniques import SsaoParams
from ..kernels.horizons import sphere_visibility
from ..kernels.screen import Screen
from ..kernels.vec3 import f32
from .ambient import ambient_light, radius_of
from .base import Context, PassResult, Technique, Transport

# fractions of a turn, a diameter and a volume by which one point follows the other: the three-dimensional R sequence
# (Roberts 2018), powers of 1 over the root of x^4 = x + 1
_STEPS = 1.2207440846057596 ** -np.arange(1.0, 4.0)


def ball_points(number: int) -> np.ndarray:
    """(number, 3) float32 points spread evenly over the unit ball."""
    turn, cosine, volume = (0.5 + np.arange(1, number + 1)[:, None] * _STEPS).T % 1.0
    z = 2 * cosine - 1
    r = np.sqrt(1 - z * z)
    direction = np.stack([r * np.cos(2 * np.pi * turn), r * np.sin(2 * np.pi * turn), z], -1)
    return (direction * np.cbrt(volume)[:, None]).astype(np.float32)


def compute_ssao(frame: Frame, params: SsaoParams, context: Context, seed: int = 0) -> PassResult:
    """World light by SSAO.

    Parameters
    ----------
    frame : Frame
        With a world; `geometry` is used for the overscan only.
    params : SsaoParams
    context : Context
    seed : int
        Of the planes that the points are mirrored at.

    Returns
    -------
    PassResult
        WORLD_DIFFUSE (H, W, 3) float32 W/m2, and the visibility (H, W).

    Raises
    ------
    Cancelled
        When the user asked to stop.

    Notes
    -----
    Ignores what lies off screen and behind what the camera sees. Exact for an open plane.
    """
    points, radius = ball_points(params.samples), radius_of(params.radius_m, frame)

    def gather(screen: Screen, groups: np.ndarray, height: int, width: int, step: int, margin: int) -> np.ndarray:
        return sphere_visibility(screen, groups, height, width, step, margin, f32(radius), points,
                                 params.method == "HEMISPHERE", seed)

    return ambient_light(frame, gather, context, "SSAO", radius, params.lattice_px, params.blur, params.overscan, False)


TECHNIQUE = Technique("ssao", "Ambient Occlusion (SSAO)", SsaoParams, compute_ssao, frozenset({Transport.WORLD_DIFFUSE}))
