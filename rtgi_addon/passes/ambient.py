"""World light by a visibility that the screen tells: what `ssao` and `hbao` share.

Visibility is gathered at every pixel or on a lattice, smoothed and spread along tangent planes, and multiplies what the
world would give to an open surface of the pixel's normal, or of its mean open direction.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..core.frame import Frame
from ..core.radiometry import brightest
from ..kernels.octahedron import look_up
from ..kernels.planes import smooth_planes, spread_planes
from ..kernels.screen import Screen
from ..kernels.sky import light_through
from ..kernels.vec3 import f32
from .base import Context, PassResult, Transport
from .screen import coarse_screen, lane_groups, screen_of, wide_screen
from .sky_light import irradiance_table

# A gather function takes a Screen, groups of lattice points (n, 64), the lattice's height and width, its step in pixels
# and the screen's margin in pixels, and returns planes (C, h, w): the visibility, and behind it the bent normal or
# nothing.
Gather = Callable[[Screen, np.ndarray, int, int, int, int], np.ndarray]

# of the scene's size, for a radius of 0. Larger ones see more of what the sky's light has to pass, and lose more of it off
# screen: against visibility up to any distance, 0.2 to 0.5 left the least error on four scenes under an open sky
RADIUS_SHARE = 0.2
BLUR_TOLERANCE_PX = 0.6     # height over a tangent plane at which a neighbour stops to count, in footprints of a pixel
SPREAD_TOLERANCE_PX = 1.0   # the same for lattice points, in footprints of a lattice cell


def radius_of(radius_m: float, frame: Frame) -> float:
    """The radius in m that a parameter asks for; 0 is RADIUS_SHARE of the scene's size."""
    return radius_m if radius_m > 0 else RADIUS_SHARE * frame.scale_m


def screen_visibility(frame: Frame, gather: Gather, wanted: np.ndarray, context: Context, text: str, lattice_px: int = 1,
                      blur: int = 0, overscan: float = 0.0) -> np.ndarray:
    """(C, H, W) float32 planes of `gather` for every surface pixel; 1, and 0 behind it, where nothing is seen.

    `wanted` (H, W) bool are the pixels whose visibility matters; tiles without one are skipped. `blur` is the radius of the
    smoothing in gathered points; `overscan` the share of the picture's shorter edge by which the scene's triangles widen it.
    """
    screen = screen_of(frame)
    height, width = frame.gbuffer.shape
    step = lattice_px if min(height, width) > lattice_px // 2 else 1
    coarse = coarse_screen(screen, step) if step > 1 else screen
    asked = np.ascontiguousarray(wanted[step // 2::step, step // 2::step])
    margin, wide = 0, screen
    if overscan > 0 and frame.geometry is not None and len(frame.geometry):
        context.checkpoint("Overscan", 0.0)
        margin = max(int(round(overscan * min(height, width))), 1)
        wide = wide_screen(frame, margin, context.bvh(frame.geometry))
    context.checkpoint(text, 0.0)
    values = gather(wide, lane_groups(asked), *asked.shape, step, margin)
    context.checkpoint("Filter", 0.8)
    if blur > 0:
        values = smooth_planes(coarse, values, blur, f32(BLUR_TOLERANCE_PX))
    if step > 1:
        values = spread_planes(screen, coarse, values, step, f32(SPREAD_TOLERANCE_PX))
    return values


def ambient_light(frame: Frame, gather: Gather, context: Context, text: str, radius_m: float, lattice_px: int, blur: int,
                  overscan: float, has_bounces: bool) -> PassResult:
    """World light times the visibility of `gather`, as `compute_ssao` and `compute_hbao` return it."""
    g = frame.gbuffer
    diagnostics = {"radius_m": float(radius_m)}
    if frame.world.is_black or not g.mask.any():
        return PassResult({Transport.WORLD_DIFFUSE: np.zeros_like(g.albedo)}, np.ones(g.shape, np.float32), diagnostics)
    table, mask = irradiance_table(frame.world), g.mask
    lit = mask if table.min() > 0 else mask & (brightest(look_up(table, g.normal_ws, mask)) > 0)
    values = screen_visibility(frame, gather, lit, context, text, lattice_px, blur, overscan)
    light, visibility = light_through(table, values, g.normal_ws, mask, g.albedo, has_bounces)
    return PassResult({Transport.WORLD_DIFFUSE: light}, visibility, diagnostics)
