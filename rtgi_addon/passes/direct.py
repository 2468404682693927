"""Direct light of lamps: unshadowed light in closed form times visibility from shadow maps and rays.

For each lamp two kernels run. The first computes at every pixel what would arrive with nothing in between, and asks the
lamp's own view whether anything is (`kernels.shadow`): lit and dark pixels are done. The few left over, along the edges
of shadows, are put into a list, and the second kernel traces rays from them through the scene's triangles: one ray to a
lamp without size, else four to its rim and, where those disagree, a stratified set over its shape. The share of the light
that arrives, in proportion to what each ray would carry, multiplies the closed form, so noise is left in half shadows only.

Deviations from Cycles: materials with transparency cast full shadows; Cycles' push of shadow rays off smooth-shaded,
coarse meshes ("shadow terminator") is not modelled.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..core.frame import Frame, Light, LightKind, LightView
from ..core.techniques import DirectParams
from ..core.transforms import Projection
from ..kernels import lamps, shadow
from ..kernels.brdf import albedo_table, fit_lobe
from ..kernels.bvh import STACK, Bvh, is_occluded
from ..kernels.jit import device_jit, pixel_jit, prange
from ..kernels.lamps import Lamp
from ..kernels.sampling import r2_sequence, uniform
from ..kernels.vec3 import ONE, ZERO, Vec3, along, dot, f32, length, load, normalized_or, sub
from .base import Context, PassResult, Technique, Transport

NONE, MAP, RAYS = 0, 1, 2   # how a light's shadows are found
PILOTS = 4                  # rays to the rim of a lamp that decide whether a pixel lies in half shadow
BIG_PILOTS = 8              # more of them, inside the shape, for lamps that look large
BIG = f32(0.1)              # half size over distance from which a lamp looks large
BLOCK = 32                  # pixels that one thread traces in a row
TILE_PIXELS = 1 << 17       # pixels between two looks at Esc
POSITION_ERROR = f32(2e-6)  # of the distance to the viewer and of the coordinates
OFFSET = f32(1.5e-6)        # of the coordinates: rounding of a ray's start on its triangle
SPAN = f32(1e-4)            # of the viewer's distance: how far from its position a pixel's triangle is looked for
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])

_PROJECTIONS = {Projection.PERSPECTIVE: shadow.PERSPECTIVE, Projection.ORTHOGRAPHIC: shadow.ORTHOGRAPHIC,
                Projection.EQUIRECTANGULAR: shadow.EQUIRECTANGULAR}


def compute_direct(frame: Frame, params: DirectParams, context: Context, seed: int = 0) -> PassResult:
    """Light of all lamps at the camera's pixels.

    Parameters
    ----------
    frame : Frame
        `lights`, with `views` for those that have a map and `geometry` for rays; each may be missing. Without geometry
        the maps alone decide, and a light without either is not shadowed.
    params : DirectParams
    context : Context
    seed : int
        Moves the samples in half shadows.

    Returns
    -------
    PassResult
        DIRECT_DIFFUSE irradiance W/m2 and DIRECT_GLOSSY radiance W/(m2 sr) towards the camera, colour included;
        `visibility` is the share of the unshadowed irradiance's luminance that arrives, 1 where none could.
        diagnostics: `asked_pixels`, how many pixels were left to rays, by light.

    Notes
    -----
    Holds exactly: linear in each light's power; zero for no light; the same bits for any number of threads.
    """
    height, width = frame.gbuffer.shape
    count = height * width
    pixels = _pack_pixels(frame)
    surface = np.flatnonzero(frame.gbuffer.mask)
    out = _Sums(np.zeros((count, 3), np.float32), np.zeros((count, 3), np.float32), np.zeros(count, np.float32),
                np.zeros(count, np.float32))
    has_rays = frame.geometry is not None
    bvh = context.bvh(frame.geometry) if has_rays else None
    far_m = _length_out_of(bvh)
    views = {view.light_index: view for view in frame.views}
    state = np.zeros(count, np.uint8)
    starts = _Starts(np.empty((count, 3), np.float32), np.empty((count, 3), np.float32), np.zeros(count, np.uint8))
    asked: dict[str, int] = {}
    tiles = max(1, -(-len(surface) // TILE_PIXELS))
    for index, light in enumerate(frame.lights):
        if not np.any(light.power > 0) or (light.diffuse_factor <= 0 and light.glossy_factor <= 0):
            continue
        test = _test_of(light, index in views, has_rays, params)
        shadow_map = pack_shadow_map(views.get(index) if test == MAP else None, light)
        colours = np.concatenate([light.power * light.diffuse_factor, light.power * light.glossy_factor,
                                  [LUMINANCE @ light.power]]).astype(np.float32)
        common = (pack_lamp(light, far_m), colours, pixels, seed * 7919 + index)
        asked[light.name] = 0
        for tile in range(tiles):
            context.checkpoint("Direct light", (index + tile / tiles) / len(frame.lights))
            part = surface[tile * len(surface) // tiles:(tile + 1) * len(surface) // tiles]
            _light_pixels(part, *common, shadow_map, test, out, state)
            left = part[state[part] == shadow.ASK]
            asked[light.name] += len(left)
            if has_rays and len(left):
                _trace_pixels(left, *common, shadow_map, starts, bvh, params.soft_shadow_rays, out)
            elif len(left):
                _ask_map(left, *common, shadow_map, out)
    with np.errstate(divide="ignore", invalid="ignore"):
        visibility = np.where(out.could > 0, np.clip(out.does / out.could, 0, 1), 1).astype(np.float32)
    return PassResult({Transport.DIRECT_DIFFUSE: out.diffuse.reshape(height, width, 3),
                       Transport.DIRECT_GLOSSY: out.glossy.reshape(height, width, 3)},
                      visibility.reshape(height, width), {"asked_pixels": asked})


class _Pixels(NamedTuple):
    """The camera's pixels as kernels take them: (N, 3) and (N,) float32.

    f0 and gain describe the glossy lobe. `eye` (1, 3) is the camera's position, or for parallel rays the direction to it;
    `eye_span` is the largest coordinate of the camera's position.
    """

    position: np.ndarray
    normal: np.ndarray
    specular: np.ndarray
    roughness: np.ndarray
    f0: np.ndarray
    gain: np.ndarray
    eye: np.ndarray
    eye_span: np.float32
    is_parallel: bool


class _Starts(NamedTuple):
    """Where shadow rays of a pixel start, (N, 3), and its triangle's normal on the viewer's side; `known` once found."""

    place: np.ndarray
    side: np.ndarray
    known: np.ndarray


class _Sums(NamedTuple):
    """What the kernels add to: (N, 3) irradiance and glossy radiance, (N,) luminance that could arrive and that does."""

    diffuse: np.ndarray
    glossy: np.ndarray
    could: np.ndarray
    does: np.ndarray


def _pack_pixels(frame: Frame) -> _Pixels:
    g, camera = frame.gbuffer, frame.camera
    position, normal, specular = (np.ascontiguousarray(a.reshape(-1, 3), np.float32)
                                  for a in (g.position_ws, g.normal_ws, g.specular))
    roughness = np.ascontiguousarray(g.roughness.ravel(), np.float32)
    is_parallel = camera.projection is Projection.ORTHOGRAPHIC
    eye = camera.world_from_view[:3, 2] if is_parallel else camera.position_ws
    pixels = _Pixels(position, normal, specular, roughness, np.zeros_like(roughness), np.zeros_like(roughness),
                     np.float32([eye]), f32(np.abs(camera.position_ws).max()), is_parallel)
    if specular.any():
        _describe_lobes(pixels, albedo_table())
    return pixels


def _length_out_of(bvh: Bvh | None) -> float:
    """A length in m that leads out of the scene from everywhere in it; 1 without triangles."""
    if bvh is None or not len(bvh.corners):
        return 1.0
    low, high = bvh.boxes[0, :, :3].min(0), bvh.boxes[0, :, 3:].max(0)
    return 2.0 * float(np.linalg.norm(high - low))


def _test_of(light: Light, has_view: bool, has_rays: bool, params: DirectParams) -> int:
    """Which shadow test a light's pixels take."""
    if not light.casts_shadow or not (has_view or has_rays):
        return NONE
    return RAYS if has_rays and (params.exact_shadows or not has_view) else MAP


def pack_lamp(light: Light, far_m: float) -> Lamp:
    """`light` as kernels take it; shadow rays towards a sun are `far_m` long."""
    half_x = half_y = light.radius_m
    spot_edge = spot_scale = tan_spread = spread_gain = 0.0
    kind = lamps.SPHERE_LAMP if light.is_sphere else lamps.DISK_LAMP
    if light.kind is LightKind.SUN:
        kind, half_x = lamps.SUN_LAMP, math.tan(min(light.angle_rad, math.pi - 0.02) / 2)
        half_y = half_x
    elif light.kind.is_area:
        kind = lamps.RECTANGLE_LAMP if light.kind is LightKind.RECTANGLE else lamps.ELLIPSE_LAMP
        half_x, half_y = light.size_x_m / 2, light.size_y_m / 2
        if light.spread_rad < math.pi - 1e-4:
            half = max(light.spread_rad / 2, math.radians(0.5))
            tan_spread, spread_gain = math.tan(half), 1 / (math.tan(half) - half)
    elif light.kind is LightKind.SPOT:
        spot_edge = math.cos(light.spot_size_rad / 2)
        spot_scale = 1 / max((1 - spot_edge) * light.spot_blend, 1e-6)
    places = np.stack([light.position_ws, light.direction_ws, *light.world_from_light[:3, :2].T]).astype(np.float32)
    numbers = (f32(x) for x in (half_x, half_y, spot_edge, spot_scale, tan_spread, spread_gain, far_m))
    return Lamp(kind, places, *numbers)


def pack_shadow_map(view: LightView | None, light: Light) -> shadow.ShadowMap:
    """The map of `view`; one that never answers for None."""
    if view is None:
        return shadow.no_shadow_map()
    source = light.radius_m
    if light.kind is LightKind.SUN:
        source = math.tan(min(light.angle_rad, math.pi - 0.02) / 2)
    elif light.kind.is_area:
        source = math.hypot(light.size_x_m, light.size_y_m) / 2
    camera = view.camera
    return shadow.build_shadow_map(_PROJECTIONS[camera.projection], camera.view_from_world, camera.left, camera.top,
                                   *camera.pixel_size, view.gbuffer.depth, source)


@device_jit
def _viewer(pixels, p):
    """(unit vector from p to the viewer, its length in m or 0)."""
    if pixels.is_parallel:
        return load(pixels.eye, 0), ZERO
    to = sub(load(pixels.eye, 0), p)
    return normalized_or(to, Vec3(ZERO, ZERO, ONE)), length(to)


@device_jit
def _error_of(pixels, p, distance):
    """How far in m position p may be off its surface: what a depth pass in float32 leaves."""
    return POSITION_ERROR * (distance + pixels.eye_span + max(abs(p.x), max(abs(p.y), abs(p.z))))


@device_jit
def _describe_lobe(q, pixels, albedos):
    reflectance = max(pixels.specular[q, 0], max(pixels.specular[q, 1], pixels.specular[q, 2]))
    if reflectance > ZERO:
        p, n = load(pixels.position, q), load(pixels.normal, q)
        viewer, _ = _viewer(pixels, p)
        cosine = max(dot(n, viewer), ZERO)
        pixels.f0[q], pixels.gain[q] = fit_lobe(reflectance, cosine, pixels.roughness[q] * pixels.roughness[q], albedos)


@pixel_jit
def _describe_lobes(pixels, albedos):
    """Fill f0 and gain of every glossy pixel."""
    for q in prange(len(pixels.roughness)):
        _describe_lobe(q, pixels, albedos)


@device_jit
def _arriving(q, lamp, pixels, p, n, viewer, salt):
    """Unshadowed (irradiance, glossy radiance before colour) of unit strength at pixel q."""
    is_glossy = pixels.specular[q, 0] + pixels.specular[q, 1] + pixels.specular[q, 2] > ZERO
    alpha = pixels.roughness[q] * pixels.roughness[q]
    diffuse, lobe = lamps.unshadowed(lamp, p, n, viewer, alpha, pixels.f0[q], is_glossy, uniform(q, 0, salt),
                                     uniform(q, 1, salt))
    return diffuse, lobe * pixels.gain[q]


@device_jit
def _add(q, diffuse, glossy, colours, pixels, out):
    for c in range(3):
        out.diffuse[q, c] += colours[c] * diffuse
        out.glossy[q, c] += colours[3 + c] * pixels.specular[q, c] * glossy
    out.does[q] += colours[6] * diffuse


@device_jit
def _light_at_pixel(q, lamp, colours, pixels, salt, shadow_map, test, out):
    """Add the unshadowed light if nothing stands between; returns what the map says: LIT, DARK or ASK."""
    p, n = load(pixels.position, q), load(pixels.normal, q)
    viewer, distance = _viewer(pixels, p)
    diffuse, glossy = _arriving(q, lamp, pixels, p, n, viewer, salt)
    if diffuse <= ZERO and glossy <= ZERO:
        return shadow.DARK
    out.could[q] += colours[6] * diffuse
    answer = shadow.LIT if test == NONE else shadow.ASK
    if test == MAP:
        answer = shadow.classify(shadow_map, p, _error_of(pixels, p, distance))
    if answer == shadow.LIT:
        _add(q, diffuse, glossy, colours, pixels, out)
    return answer


@pixel_jit
def _light_pixels(index, lamp, colours, pixels, salt, shadow_map, test, out, state):
    """`_light_at_pixel` for the pixels of `index`; its answers into `state`."""
    for k in prange(len(index)):
        state[index[k]] = _light_at_pixel(index[k], lamp, colours, pixels, salt, shadow_map, test, out)


@device_jit
def _ray_start(bvh, stack, p, n, viewer, distance, error):
    """(start of shadow rays, geometric normal on the viewer's side)."""
    span = max(SPAN * distance, f32(16) * error)
    found, o, side = shadow.find_surface(bvh, stack, p, viewer, span)
    if not found:
        return along(p, n, f32(2) * error), n
    size = max(abs(o.x), max(abs(o.y), abs(o.z)))
    return along(o, side, OFFSET * size + f32(0.05) * error), side


@device_jit
def _is_seen(bvh, stack, start, side, p, d):
    """Does the vector d from p to a lamp arrive? A lamp behind the triangle's own plane is hidden by it."""
    if dot(side, d) <= ZERO:
        return False
    target = Vec3(p.x + d.x - start.x, p.y + d.y - start.y, p.z + d.z - start.z)
    return not is_occluded(bvh, stack, start, target)


@device_jit
def _seen_shares(lamp, bvh, stack, p, n, viewer, start, side, alpha, f0, rays, shift_u, shift_v):
    """(share of the irradiance, share of the glossy light) that arrives at p."""
    size = lamp.half_x if lamp.kind == lamps.SUN_LAMP else max(lamp.half_x, lamp.half_y) / max(
        length(sub(load(lamp.places, lamps.POSITION), p)), f32(1e-20))
    if size == ZERO:
        d, _ = lamps.lamp_at(lamp, p, ZERO, ZERO)
        seen = ONE if _is_seen(bvh, stack, start, side, p, d) else ZERO
        return seen, seen
    count, pilots = 0, PILOTS
    for i in range(pilots):
        x, y = lamps.rim_point(lamp, i, shift_u)
        d, _ = lamps.lamp_at(lamp, p, x, y)
        if _is_seen(bvh, stack, start, side, p, d):
            count += 1
        if 0 < count <= i:
            break
    if size > BIG and (count == 0 or count == pilots):
        for i in range(BIG_PILOTS):
            u, v = r2_sequence(i, shift_v, shift_u)
            d, _ = lamps.lamp_sample(lamp, p, u, v)
            if _is_seen(bvh, stack, start, side, p, d):
                count += 1
        pilots += BIG_PILOTS
    if count == 0:
        return ZERO, ZERO
    if count == pilots:
        return ONE, ONE
    widened = max(max(alpha, f32(0.3) * min(size, ONE)), lamps.LEAST_ALPHA)
    diffuse_all, diffuse_seen, glossy_all, glossy_seen = ZERO, ZERO, ZERO, ZERO
    for i in range(rays):
        u, v = r2_sequence(i, shift_u, shift_v)
        d, weight = lamps.lamp_sample(lamp, p, u, v)
        unit = normalized_or(d, n)
        diffuse = weight * max(dot(n, unit), ZERO)
        if diffuse > ZERO:
            glossy = weight * lamps.ggx_lobe(n, viewer, unit, widened * widened, f0)
            diffuse_all += diffuse
            glossy_all += glossy
            if _is_seen(bvh, stack, start, side, p, d):
                diffuse_seen += diffuse
                glossy_seen += glossy
    share = diffuse_seen / diffuse_all if diffuse_all > ZERO else ZERO
    return share, (glossy_seen / glossy_all if glossy_all > ZERO else share)


@device_jit
def _trace_at_pixel(q, lamp, colours, pixels, salt, shadow_map, starts, bvh, stack, rays, out):
    p, n = load(pixels.position, q), load(pixels.normal, q)
    viewer, distance = _viewer(pixels, p)
    diffuse, glossy = _arriving(q, lamp, pixels, p, n, viewer, salt)
    error = _error_of(pixels, p, distance)
    if starts.known[q] == 0:
        start, side = _ray_start(bvh, stack, p, n, viewer, distance, error)
        starts.place[q, 0], starts.place[q, 1], starts.place[q, 2] = start
        starts.side[q, 0], starts.side[q, 1], starts.side[q, 2] = side
        starts.known[q] = 1
    start, side = load(starts.place, q), load(starts.side, q)
    share, glossy_share = ONE, ONE
    answer = shadow.look_around(shadow_map, p, side, error) if lamp.half_x > ZERO else shadow.ASK
    if answer == shadow.ASK:
        alpha = pixels.roughness[q] * pixels.roughness[q]
        share, glossy_share = _seen_shares(lamp, bvh, stack, p, n, viewer, start, side, alpha, pixels.f0[q], rays,
                                           uniform(q, 2, salt), uniform(q, 3, salt))
    if answer != shadow.DARK:
        _add(q, diffuse * share, glossy * glossy_share, colours, pixels, out)


@pixel_jit
def _trace_pixels(index, lamp, colours, pixels, salt, shadow_map, starts, bvh, rays, out):
    """Add the light that a second look at the map, and rays, find at the pixels of `index`."""
    blocks = (len(index) + BLOCK - 1) // BLOCK
    for block in prange(blocks):
        stack = np.empty(STACK, np.int32)
        for k in range(block * BLOCK, min((block + 1) * BLOCK, len(index))):
            _trace_at_pixel(index[k], lamp, colours, pixels, salt, shadow_map, starts, bvh, stack, rays, out)


@device_jit
def _ask_map_at_pixel(q, lamp, colours, pixels, salt, shadow_map, out):
    p, n = load(pixels.position, q), load(pixels.normal, q)
    viewer, distance = _viewer(pixels, p)
    diffuse, glossy = _arriving(q, lamp, pixels, p, n, viewer, salt)
    share = shadow.map_visibility(shadow_map, p, _error_of(pixels, p, distance))
    _add(q, diffuse * share, glossy * share, colours, pixels, out)


@pixel_jit
def _ask_map(index, lamp, colours, pixels, salt, shadow_map, out):
    """Add the light of the pixels of `index` by the map's own four texels: what is left where no rays can be traced."""
    for k in prange(len(index)):
        _ask_map_at_pixel(index[k], lamp, colours, pixels, salt, shadow_map, out)


TECHNIQUE = Technique("direct", "Direct light", DirectParams, compute_direct,
                      frozenset({Transport.DIRECT_DIFFUSE, Transport.DIRECT_GLOSSY}), needs_geometry=True, needs_views=True)
