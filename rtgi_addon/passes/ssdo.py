"""Screen-space directional occlusion: the world's light by direction, and the first bounce from what the camera sees nearby.

For a pixel x with normal n, what the screen shows within a radius splits the hemisphere: open directions bring the world's
radiance, blocked ones the radiance of the surface that blocks them,

    E_world(x) = integral over open w of L_world(w) (n . w) dw
    E_near(x)  = integral over blocked w of L(y(x, w)) (n . w) dw,   L(y) = albedo(y) / pi * E(y)             [1], Eq. 1, 2

As published (`SAMPLES`): N points in the hemisphere, each a random share of the radius away; a point under the surface that
the screen shows there is blocked. Open points bring L_world (n . w) 2 pi / N, blocked ones L A cos cos / d^2 with
A = pi r^2 / N.

Sectors (`SECTORS`): slices of the hemisphere around the viewer's direction, each with 64 sectors of equal cosine-weighted
measure (`kernels.slices`), that taps along the slice's line on the screen cover from near to far [2]. Every newly covered
sector brings the radiance of the tap that covers it. Radiance does not change on its way and the solid angle is in the
sector's measure, so the emitter's cosine must not come in a second time: facing is a yes or no. There is no 1 / d^2, and
so no singularity to clamp.

Deviations from [2]: slices are drawn by their weight, taps that are one sheet of surface are joined, edges of sheets are
sought by halving the step, and the thickness counts behind edges only (`kernels.ssdo`). From [1]: d is not clamped to 1 but
to the distance at which a patch fills the hemisphere, which does not depend on the unit of length.

References
----------
.. [1] Ritschel, Grosch, Seidel. Approximating Dynamic Global Illumination in Image Space. I3D 2009.
   doi:10.1145/1507149.1507161
.. [2] Therrien, Levesque, Gilet. Screen Space Indirect Lighting with Visibility Bitmask. 2023. arXiv:2301.11376
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np

from ..core.frame import Frame, World
from ..core.radiometry import texel_directions
from ..core.techniques import SsdoParams
from ..kernels.octahedron import node_directions, table_of
from ..kernels.planes import smooth_planes, spread_planes
from ..kernels.screen import Screen
from ..kernels.ssdo import LANES, gather_samples, gather_sectors, sent_out, tap_table, to_pixels, world_through
from ..kernels.vec3 import f32
from .base import Context, PassResult, Technique, Transport
from .screen import coarse_screen, screen_of
from .sky_light import irradiance_table, shrink_map

RADIUS_SHARE = 0.2          # of the scene's size, for a radius of 0: half of the bounce in view of four scenes is nearer
BLUR_TOLERANCE_PX = 0.6     # height over a tangent plane at which a neighbour stops to count, in footprints of a pixel
SPREAD_TOLERANCE_PX = 1.0   # the same for lattice points, in footprints of a lattice cell
TILE_PIXELS = 65536         # between two looks at Esc
FIRST_LATTICE_PX = 4        # of the world's light on the emitters, which reaches the picture after a bounce only
SKY_NODES = 33              # edge of the table of the world's radiance: 6 degrees, a quarter of what a slice tells apart
SKY_MAP_SIZE = (32, 64)
NO_SKY = np.zeros((0, 0, 3), np.float32)


class _Taps(NamedTuple):
    """The picture as the kernels ask it; `table` is `tap_table()`."""

    screen: Screen
    table: np.ndarray


def radiance_table(world: World) -> np.ndarray:
    """(n, n, 3) float32 W/(m2 sr): the world for `kernels.octahedron.table_at`; empty for a constant or black one.

    Each node is the mean of the map around it, by a tent as wide as the nodes lie apart; the whole sphere's flux is kept.
    """
    if world.is_constant or world.is_black:
        return NO_SKY
    radiance = shrink_map(world.radiance, SKY_MAP_SIZE)
    return table_of(_node_weights(*radiance.shape[:2]), radiance)


@functools.lru_cache(2)
def _node_weights(height: int, width: int) -> np.ndarray:
    """(SKY_NODES^2, height width) float32: share of each texel of a map in each node; 9 MB."""
    direction, solid_angle = texel_directions(height, width)
    nodes = node_directions(SKY_NODES).reshape(-1, 3).astype(np.float32)
    weight = nodes @ direction.reshape(-1, 3).T.astype(np.float32)
    # the chord stands for the angle: they differ by 0.1 % where the tent ends
    np.sqrt(np.maximum(2 - 2 * weight, 0), out=weight)
    np.maximum(1 - weight * np.float32((SKY_NODES - 1) / np.pi), 0, out=weight)
    weight *= solid_angle.ravel().astype(np.float32)
    weight /= np.maximum(weight.sum(1, keepdims=True), np.float32(1e-30))
    return weight


def radius_of(frame: Frame, params: SsdoParams) -> float:
    """m: how far taps go."""
    return params.radius_m or RADIUS_SHARE * frame.scale_m


def _shares(planes: np.ndarray) -> np.ndarray:
    """Share of the world's light that arrives, from a kernel's planes and in place: one, or one for each colour of a map."""
    if len(planes) == 1:
        return np.multiply(planes, f32(1 / np.pi), out=planes)
    arrives, whole = planes[:3], np.maximum(planes[3:], f32(1e-20), out=planes[3:])
    return np.minimum(np.divide(arrives, whole, out=arrives), f32(1), out=arrives)


def _gathered(frame: Frame, taps: _Taps, params: SsdoParams, radiance: np.ndarray | None, sky: np.ndarray, radius: float,
              fade: float, step: int, seed: int, context: Context, text: str) -> tuple[np.ndarray, np.ndarray]:
    """At every pixel, gathered at every `step`-th, smoothed and spread: the bounce (3, H, W), and of the world's light
    `_shares` (1 or 3, H, W). Without `radiance` the bounce is empty.
    """
    mask = frame.gbuffer.mask
    if not mask[step // 2::step, step // 2::step].any():
        step = 1                                 # an image smaller than the lattice, or one with slivers only
    at = (slice(step // 2, None, step), slice(step // 2, None, step))
    asked = np.ascontiguousarray(mask[at])
    slots = np.flatnonzero(asked)
    row, column = np.divmod(slots, asked.shape[1])
    ids = (row * step + step // 2) * mask.shape[1] + column * step + step // 2
    values, source = np.zeros((9 if len(sky) else 4, asked.size), np.float32), radiance
    if source is None:
        source = np.zeros((mask.size, 3), np.float32)
    for begin in range(0, len(ids), TILE_PIXELS):
        context.checkpoint(text, begin / len(ids))
        tile = slice(begin, begin + TILE_PIXELS)
        if params.form == "SECTORS":
            runs = -(-len(ids[tile]) // LANES)
            gather_sectors(runs, taps.screen, taps.table, ids[tile], slots[tile], source, sky, f32(radius),
                           f32(params.thickness * radius), f32(fade), params.slices, params.steps, seed, values)
        else:
            gather_samples(len(ids[tile]), taps.screen, ids[tile], slots[tile], source, sky, f32(radius), f32(fade),
                           params.samples, seed, values)
    context.checkpoint("Filter", 0.9)
    bounce = 3 if radiance is not None else 0
    planes = values.reshape(-1, *asked.shape)[3 - bounce:]
    coarse = coarse_screen(taps.screen, step) if step > 1 else taps.screen
    if params.blur > 0:
        planes = smooth_planes(coarse, planes, params.blur, f32(BLUR_TOLERANCE_PX))
    planes = planes[:bounce + len(_shares(planes[bounce:]))]
    if step > 1:
        planes = spread_planes(taps.screen, coarse, planes, step, f32(SPREAD_TOLERANCE_PX))
    return planes[:bounce], planes[bounce:]


def _open_table(world: World) -> np.ndarray:
    """(n, n, 3) float32 W/m2 that an open surface gets from the world, by its normal; (1, 1, 3) of an even or black one."""
    if world.is_constant or world.is_black:
        return (np.pi * world.radiance[:1, :1]).astype(np.float32)
    return irradiance_table(world)


def _near_m(frame: Frame, params: SsdoParams) -> float:
    return radius_of(frame, params) if params.hand_over else 0.0


def compute_ssdo(frame: Frame, params: SsdoParams, context: Context, seed: int = 0) -> PassResult:
    """World light by direction and the near bounce, from what the camera sees.

    Parameters
    ----------
    frame : Frame
        With a world; triangles are not asked.
    params : SsdoParams
    context : Context
        `light` holds the direct light of lamps, which the bounce is made of. Where another technique supplies the whole
        bounce of lamps (`light`) or of the world (`to_come`), that light does not bounce here.
    seed : int
        Of slices, taps and samples.

    Returns
    -------
    PassResult
        WORLD_DIFFUSE and NEAR_DIFFUSE: (H, W, 3) float32 W/m2; visibility (H, W): share of the world's light that arrives.

    Raises
    ------
    Cancelled
        When the user asked to stop.

    Notes
    -----
    Ignores what lies off screen, behind what the camera sees, or farther than the radius; the glossy lobe of emitters; light
    of emissive surfaces. Exact for an open plane under any world; linear in the lamps' power and the world's.
    """
    g = frame.gbuffer
    if not g.mask.any():
        black = np.zeros_like(g.albedo)
        return PassResult({Transport.WORLD_DIFFUSE: black, Transport.NEAR_DIFFUSE: black.copy()},
                          np.ones(g.shape, np.float32))
    taps = _Taps(screen_of(frame), tap_table(g.normal_ws, g.depth))
    radius, sky, table = radius_of(frame, params), radiance_table(frame.world), _open_table(frame.world)
    is_shared = context.near_left_m > 0
    lamps, world = np.zeros_like(g.albedo), NO_SKY
    if is_shared or Transport.BOUNCE_DIFFUSE not in context.light:      # whoever supplies all of the bounce has the near one
        lamps = context.light.get(Transport.DIRECT_DIFFUSE, lamps)
    if not frame.world.is_black and Transport.WORLD_BOUNCE_DIFFUSE not in context.to_come:
        _, shares = _gathered(frame, taps, params, None, sky, radius, 0.0, FIRST_LATTICE_PX, seed + 1, context,
                              "World light of emitters")
        world, _ = world_through(table, shares, g.normal_ws, g.mask)
    radiance = sent_out(lamps, world, g.albedo)
    fade = 1 / context.near_left_m**2 if is_shared else 0.0
    near, shares = _gathered(frame, taps, params, radiance.reshape(-1, 3), sky, radius, fade, params.lattice_px, seed,
                             context, "Directional occlusion")
    world, visibility = world_through(table, shares, g.normal_ws, g.mask)
    bounce = to_pixels(near, g.mask)
    return PassResult({Transport.WORLD_DIFFUSE: world, Transport.NEAR_DIFFUSE: bounce}, visibility,
                      {"radius_m": float(radius), "shares_bounce": is_shared})


TECHNIQUE = Technique("ssdo", "Directional Occlusion (SSDO)", SsdoParams, compute_ssdo,
                      frozenset({Transport.WORLD_DIFFUSE, Transport.NEAR_DIFFUSE}), near_m=_near_m)
