"""Gathering where it pays: at a lattice of pixels, smoothed, spread to all pixels, and again where that fails."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ..core.frame import Frame
from ..core.transforms import Camera, Projection
from ..kernels.filters import pilot_means, regress_lattice, smooth_marked, spread_lattice
from ..kernels.sampling import place_ids
from ..kernels.vec3 import f32
from .base import Context

# A gather function takes points (M, 3), normals (M, 3), their pixels (M,), places in the lattice (M,) as `place_ids` and a
# seed, and returns (M, 5) as the kernels do: light by colour, unshadowed mean, variance of the mean; or (M, 3) light alone,
# which is then smoothed by plane and normal only.
Gather = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray, int], np.ndarray]

PLANE_TOLERANCE_PX = 1.6    # how far off the tangent plane, in footprints of a lattice cell, a neighbour still counts e^-1
UNREST = 1.0                # standard deviation over mean of the lattice's light at which a pixel is gathered on its own;
                            # 0.6 costs 10 to 20 % more of RSM's time for at most 0.1 point of the picture's error
RADIUS = 4                  # of the regression's window, in lattice points: wider blurs corners, narrower leaves blotches
CONTRAST = 2.0              # standard deviations of noise by which a neighbour's mean may differ before it counts e^-1
RIDGE = 0.2                 # how firmly slopes are held to 0; 0.02 to 1 differ by less than 2 % of the error
TILE_POINTS = 16384         # points between two looks at Esc


def pixel_footprint_m(camera: Camera, depth: np.ndarray) -> np.ndarray:
    """(H, W) float32 m: width of a pixel where it meets the surface, facing the camera; 0 where nothing is seen."""
    step_x, step_y = camera.pixel_size
    step = float(np.sqrt(abs(step_x * step_y)))
    if camera.projection is Projection.ORTHOGRAPHIC:
        return np.where(np.isfinite(depth), np.float32(step), np.float32(0))
    return np.where(np.isfinite(depth), depth * np.float32(step), np.float32(0))


def gather_in_tiles(gather: Callable[..., np.ndarray], points: Sequence[np.ndarray], seed: int, context: Context, text: str,
                    columns: int = 3) -> np.ndarray:
    """The first `columns` columns of `gather` over arrays of M `points`, in tiles, so that Esc is seen between them."""
    number = len(points[0])
    out = np.zeros((number, columns), np.float32)
    for first in range(0, number, TILE_POINTS):
        context.checkpoint(text, first / number)
        tile = slice(first, first + TILE_POINTS)
        out[tile] = gather(*(array[tile] for array in points), seed)[:, :columns]
    return out


def gather_on_lattice(frame: Frame, gather: Gather, step_px: int, seed: int, context: Context, text: str,
                      noisy: bool = True) -> tuple[np.ndarray, dict[str, float]]:
    """(H, W, 3) float32 irradiance of `gather` for every surface pixel, and diagnostics.

    Every `step_px`-th pixel is gathered, the lattice smoothed once and spread to the pixels by plane and normal; pixels
    that find no like neighbour are gathered on their own. What is not `noisy` is spread as it is, and `gather` may return
    (M, 3).
    """
    g = frame.gbuffer
    mask = g.mask
    pixels, places = np.arange(mask.size, dtype=np.int64).reshape(mask.shape), place_ids(mask.shape)
    if step_px == 1:
        out = np.zeros((*mask.shape, 3), np.float32)
        out[mask] = gather_in_tiles(gather, [a[mask] for a in (g.position_ws, g.normal_ws, pixels, places)], seed, context,
                                    text)
        return out, {"gathered_share": 1.0}
    at = (slice(step_px // 2, None, step_px), slice(step_px // 2, None, step_px))
    if not mask[at].any():
        at = (slice(0, None, 1), slice(0, None, 1))      # an image smaller than the lattice, or one with slivers only
        step_px = 1
    position_l, normal_l, mask_l = (np.ascontiguousarray(a[at]) for a in (g.position_ws, g.normal_ws, mask))
    columns = 5 if noisy else 3
    lattice = np.zeros((*mask_l.shape, columns), np.float32)
    points = [a[mask_l] for a in (position_l, normal_l, pixels[at], place_ids(mask_l.shape))]
    lattice[mask_l] = gather_in_tiles(gather, points, seed, context, text, columns)
    tolerance = PLANE_TOLERANCE_PX * step_px * pixel_footprint_m(frame.camera, g.depth)
    rcp_tolerance = (1 / np.maximum(tolerance, 1e-30)).astype(np.float32)
    context.checkpoint("Filter", 0.0)
    smooth = lattice
    if noisy:
        rcp_l = np.ascontiguousarray(rcp_tolerance[at])
        pilot = pilot_means(lattice, position_l, normal_l, mask_l, rcp_l)
        smooth = regress_lattice(lattice, pilot, position_l, normal_l, mask_l, rcp_l, RADIUS, f32(CONTRAST), f32(RIDGE))
    out, weak = spread_lattice(smooth, position_l, normal_l, mask_l, g.position_ws, g.normal_ws, mask, rcp_tolerance,
                               step_px, f32(UNREST))
    if weak.any():
        points = [a[weak] for a in (g.position_ws, g.normal_ws, pixels, places)]
        out[weak] = gather_in_tiles(gather, points, seed + 1, context, text)
        if noisy:
            smooth_marked(out, weak, g.position_ws, g.normal_ws, mask, rcp_tolerance)
    surface = max(int(mask.sum()), 1)
    return out, {"gathered_share": float((mask_l.sum() + weak.sum()) / surface), "weak_share": float(weak.sum() / surface)}
