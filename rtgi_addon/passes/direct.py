"""Direct light of lamps: unshadowed light in closed form times visibility from shadow maps and rays.

For each lamp two kernels run. The first computes at every pixel what would arrive with nothing in between, and asks the
lamp's own view whether anything is (`kernels.shadow`): lit and dark pixels are done. Those left over, along the edges of
shadows, are put into a list. For them the second kernel finds the pixel's triangle, looks at the map once more with its
plane, and where that does not settle it traces rays through the scene's triangles: one ray to a lamp without size, else a
stratified set over its shape. The share of the light that arrives, in proportion to what each ray would carry, multiplies
the closed form, so noise is left in half shadows only. Pixels in even rows and columns go first; the others ask them, and
where these agree two rays to the lamp's rim are enough.

Where a lamp stands low over a triangle of a smooth-shaded, coarse mesh, rays begin above the surface that its normals tell.

Deviations from Cycles: an object's own "Shadow Terminator" offsets are taken as the default.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..core.frame import Frame, Geometry, Light, LightKind, LightView
from ..core.techniques import DirectParams
from ..core.transforms import Projection
from ..kernels import lamps, shadow
from ..kernels.brdf import INV_PI, albedo_table, fit_lobe
from ..kernels.bvh import STACK, Bvh, visibility
from ..kernels.jit import borrowed, inline_jit, pixel_jit, scratch
from ..kernels.lamps import Lamp
from ..kernels.sampling import r2_sequence, uniform
from ..kernels.terminator import lifted_share, smooth_lift
from ..kernels.vec3 import ONE, ZERO, Vec3, along, begun, dot, f32, length, load, normalized_or, sub
from .base import Context, PassResult, Technique, Transport
from .screen import PROJECTION_CODES

NONE, MAP, RAYS = 0, 1, 2   # how a light's shadows are found
TILE_PIXELS = 1 << 17       # pixels between two looks at Esc
TILE_RAYS = 1 << 21         # and rays at most: some half a second's
POSITION_ERROR = f32(2e-6)  # of the distance to the viewer and of the coordinates
OFFSET = f32(1.5e-6)        # of the coordinates: rounding of a ray's start on its triangle
SKIP = f32(1e-6)            # of the largest coordinate: what a shadow ray does not look at before its start
SPAN = f32(1e-4)            # of the viewer's distance: how far from its position a pixel's triangle is looked for
NEGLIGIBLE_SHARE = f32(3e-4)    # of what other lamps could give: a lamp that cannot give more is left out, see `ROUGH`
ROUGH = f32(0.35)           # roughness from which no highlight outshines what a lamp gives to the diffuse lobe
WITHOUT_BOUND = f32(1e30)
# of what all lamps could give, at pixels that show no highlight of this one:
FAINT_SHARE = f32(5e-3)     # for less the map's own four texels tell the shadow, not rays
MINOR_SHARE = f32(0.1)      # for less one ray tells it, with noise in half shadows
MIDDLE_SHARE = f32(0.3)     # for less half as many rays do
# A pixel asks those beside it that were traced before, where they show the same smooth surface:
LIKE_NORMAL = f32(0.9)      # cosine between the normals, at least
LIKE_PLANE = f32(0.1)       # distance from the tangent plane over distance, at most
EVEN_SPREAD = f32(0.2)      # and their mean will do in half shadow where they lie no farther apart than this
SMALL_LAMP = f32(0.05)      # half size over distance of a lamp whose samples need not all be asked where the first agree
UNKNOWN = f32(-1)
SHARE_OF = np.float32([UNKNOWN, 1, 0, UNKNOWN])     # by the map's answer: none, LIT, DARK, ASK
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


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
    is_smooth = has_rays and frame.geometry.normals_ws is not None
    starts = _Starts(*np.zeros((3, count, 3), np.float32), np.zeros(count, np.uint8),
                     frame.geometry.normals_ws if is_smooth else np.zeros((0, 3, 3), np.int16))
    shares = _Shares(*np.full((2, count), UNKNOWN))
    sources = [_source(index, light, views.get(index), frame, has_rays, params, far_m, seed)
               for index, light in enumerate(frame.lights)
               if np.any(light.power > 0) and (light.diffuse_factor > 0 or light.glossy_factor > 0)]
    asked = {source.name: 0 for source in sources}
    tiles = max(1, -(-len(surface) // TILE_PIXELS))
    for tile in range(tiles):
        part = surface[tile * len(surface) // tiles:(tile + 1) * len(surface) // tiles]
        middle = pixels.position[part[len(part) // 2]] if len(part) else np.zeros(3)
        found = []
        for number, source in enumerate(sorted(sources, key=lambda source: -source.bound_at(middle))):
            context.checkpoint("Direct Light", (tile + 0.3 * number / len(sources)) / tiles)
            bare, state = _Bare(*np.zeros((2, len(part)), np.float32)), np.zeros(len(part), np.uint8)
            _light_pixels(len(part), part, source.lamp, source.colours, pixels, source.salt, source.shadow_map, source.test,
                          f32(source.strength), bare, out, state)
            found.append((source, bare, state))
        for number, (source, bare, state) in enumerate(found):
            left = np.flatnonzero(state == shadow.ASK)
            share = (tile + 0.3 + 0.7 * number / len(sources)) / tiles
            if source.test == MAP and has_rays:
                is_faint = source.colours[6] * bare.diffuse[left] < FAINT_SHARE * out.could[part[left]]
                is_faint &= bare.glossy[left] * pixels.reflectance[part[left]] <= bare.diffuse[left] * INV_PI
                faint, left = left[is_faint], left[~is_faint]
                _ask_map(len(faint), part, faint, source.colours, pixels, source.shadow_map, bare, out)
            asked[source.name] += len(left)
            if not has_rays:
                _ask_map(len(left), part, left, source.colours, pixels, source.shadow_map, bare, out)
                continue
            shares.diffuse[part] = shares.glossy[part] = SHARE_OF[state]
            is_first = (part[left] // pixels.width | part[left] % pixels.width) % 2 == 0
            step = max(TILE_RAYS // params.soft_shadow_rays, 1)
            for some in (left[is_first], left[~is_first]):
                for first in range(0, len(some), step):
                    context.checkpoint("Direct Light", share)
                    few = some[first:first + step]
                    _trace_pixels(len(few), part, few, source.lamp, source.colours, pixels, source.salt, source.shadow_map,
                                  bare, starts, bvh, params.soft_shadow_rays, params.exact_shadows, shares, out)
        shares.diffuse[part] = UNKNOWN
    with np.errstate(divide="ignore", invalid="ignore"):
        visibility = np.where(out.could > 0, np.clip(out.does / out.could, 0, 1), 1).astype(np.float32)
    return PassResult({Transport.DIRECT_DIFFUSE: out.diffuse.reshape(height, width, 3),
                       Transport.DIRECT_GLOSSY: out.glossy.reshape(height, width, 3)},
                      visibility.reshape(height, width), {"asked_pixels": asked})


class _Pixels(NamedTuple):
    """The camera's pixels as kernels take them: (N, 3) and (N,) float32.

    `eye` (1, 3) is the camera's position, or for parallel rays the direction to it; `eye_span` is the largest coordinate of
    the camera's position, `width` the picture's. reflectance, f0 and gain: of the glossy lobe, see `brdf.fit_lobe`;
    reflectance is 0 without one.
    """

    position: np.ndarray
    normal: np.ndarray
    specular: np.ndarray
    roughness: np.ndarray
    reflectance: np.ndarray
    f0: np.ndarray
    gain: np.ndarray
    eye: np.ndarray
    eye_span: np.float32
    is_parallel: bool
    width: int


class _Source(NamedTuple):
    """A lamp of the frame, ready for the kernels.

    colours: power for diffuse and for glossy lobes, and luminance of the power; test: which shadow test its pixels take;
    strength: what irradiance times squared distance cannot exceed, in luminance; infinite where nothing bounds it.
    """

    name: str
    lamp: Lamp
    colours: np.ndarray
    shadow_map: shadow.ShadowMap
    test: int
    strength: float
    salt: int

    def bound_at(self, place_ws: np.ndarray) -> float:
        """About the most irradiance that it gives there."""
        if not math.isfinite(self.strength):
            return self.strength
        return self.strength / max(float(((self.lamp.places[lamps.POSITION] - place_ws) ** 2).sum()), 1e-12)


def _source(index: int, light: Light, view: LightView | None, frame: Frame, has_rays: bool, params: DirectParams,
            far_m: float, seed: int) -> _Source:
    test = _test_of(light, view is not None, has_rays, params)
    colours = np.concatenate([light.power * light.diffuse_factor, light.power * light.glossy_factor,
                              [LUMINANCE @ light.power]]).astype(np.float32)
    lamp, strength = pack_lamp(light, far_m), float(colours[6])
    if light.kind is LightKind.SUN or lamp.spread_gain > 0:
        strength = math.inf
    elif light.kind.is_area:
        strength *= light.size_x_m * light.size_y_m
    return _Source(light.name, lamp, colours, pack_shadow_map(view if test == MAP else None, light, frame.geometry), test,
                   strength, seed * 7919 + index)


class _Bare(NamedTuple):
    """What one lamp would send with nothing in between, (K,) each: irradiance, and glossy radiance before its colour."""

    diffuse: np.ndarray
    glossy: np.ndarray


class _Starts(NamedTuple):
    """Where shadow rays of a pixel start, (N, 3), and its triangle's normal on the viewer's side; `known` once found.

    lift (N, 3): see `terminator.smooth_lift`. normals: `core.frame.Geometry.normals_ws`,
    without a length where all triangles are flat.
    """

    place: np.ndarray
    side: np.ndarray
    lift: np.ndarray
    known: np.ndarray
    normals: np.ndarray


class _Shares(NamedTuple):
    """Shares (N,) of one lamp's light that arrive; UNKNOWN where nothing has told yet."""

    diffuse: np.ndarray
    glossy: np.ndarray


class _Sums(NamedTuple):
    """What the kernels add to: (N, 3) irradiance and glossy radiance, (N,) luminance that could arrive and that does."""

    diffuse: np.ndarray
    glossy: np.ndarray
    could: np.ndarray
    does: np.ndarray


def _pack_pixels(frame: Frame) -> _Pixels:
    g, camera = frame.gbuffer, frame.camera
    width = g.shape[1]
    position, normal, specular = (np.ascontiguousarray(a.reshape(-1, 3), np.float32)
                                  for a in (g.position_ws, g.normal_ws, g.specular))
    is_parallel = camera.projection is Projection.ORTHOGRAPHIC
    eye = camera.world_from_view[:3, 2] if is_parallel else camera.position_ws
    roughness = np.ascontiguousarray(g.roughness.ravel(), np.float32)
    pixels = _Pixels(position, normal, specular, roughness, np.empty(len(position), np.float32),
                     g.f0.ravel().astype(np.float32), np.ones(len(position), np.float32), np.float32([eye]),
                     f32(np.abs(camera.position_ws).max()), is_parallel, width)
    _fit_lobes(len(position), pixels, albedo_table())
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
        kind, half_x = lamps.SUN_LAMP, math.sin(min(light.angle_rad, math.pi - 0.02) / 2)
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


def pack_shadow_map(view: LightView | None, light: Light, geometry: Geometry | None = None) -> shadow.ShadowMap:
    """The map of `view`; one that never answers for None. Where `geometry` lets part of the light through, it asks."""
    if view is None:
        return shadow.no_shadow_map()
    source = light.radius_m
    if light.kind is LightKind.SUN:
        source = math.tan(min(light.angle_rad, math.pi - 0.02) / 2)
    elif light.kind.is_area:
        source = math.hypot(light.size_x_m, light.size_y_m) / 2
    camera, veils = view.camera, shadow.NO_VEILS
    if geometry is not None and geometry.cutouts is not None:
        row = geometry.cutouts.row
        corners = geometry.corners_ws[np.flatnonzero((row >= 0) & geometry.cutouts.is_veil[np.maximum(row, 0)])]
        corners = corners[np.isfinite(corners).all((1, 2))]
        veils = np.column_stack(camera.boxes_around(corners))
    return shadow.build_shadow_map(PROJECTION_CODES[camera.projection], camera.view_from_world, camera.left, camera.top,
                                   *camera.pixel_size, view.gbuffer.depth, source, veils)


@inline_jit
def _viewer(pixels, p):
    """(unit vector from p to the viewer, its length in m or 0)."""
    if pixels.is_parallel:
        return load(pixels.eye, 0), ZERO
    to = sub(load(pixels.eye, 0), p)
    return normalized_or(to, Vec3(ZERO, ZERO, ONE)), length(to)


@inline_jit
def _error_of(pixels, p, distance):
    """How far in m position p may be off its surface: what a depth pass in float32 leaves."""
    return POSITION_ERROR * (distance + pixels.eye_span + max(abs(p.x), max(abs(p.y), abs(p.z))))


@pixel_jit
def _fit_lobes(begin, end, pixels, albedos):
    """Put each pixel's lobe into `reflectance`, `f0`, which holds what materials know of it, and `gain`."""
    pixels, = borrowed((pixels,))
    for q in range(begin, end):
        pixels.reflectance[q] = max(pixels.specular[q, 0], max(pixels.specular[q, 1], pixels.specular[q, 2]))
        if pixels.reflectance[q] > ZERO:
            n = load(pixels.normal, q)
            viewer, _ = _viewer(pixels, load(pixels.position, q))
            alpha = pixels.roughness[q] * pixels.roughness[q]
            pixels.f0[q], pixels.gain[q] = fit_lobe(pixels.reflectance[q], max(dot(n, viewer), ZERO), alpha, albedos,
                                                    pixels.f0[q])


@inline_jit
def _add(q, diffuse, glossy, colours, pixels, out):
    for c in range(3):
        out.diffuse[q, c] += colours[c] * diffuse
        out.glossy[q, c] += colours[3 + c] * pixels.specular[q, c] * glossy
    out.does[q] += colours[6] * diffuse


@inline_jit
def _light_at_pixel(k, q, lamp, colours, pixels, salt, shadow_map, test, strength, bare, out):
    """Find the unshadowed light and add it if nothing stands between; returns what the map says: LIT, DARK or ASK."""
    p, n = load(pixels.position, q), load(pixels.normal, q)
    if not lamps.may_reach(lamp, p, n):
        return shadow.DARK
    is_faint = False
    if strength < WITHOUT_BOUND:
        beyond = length(sub(load(lamp.places, lamps.POSITION), p)) - f32(1.5) * max(lamp.half_x, lamp.half_y)
        if beyond > ZERO and (pixels.roughness[q] >= ROUGH or pixels.reflectance[q] == ZERO):
            is_faint = strength < FAINT_SHARE * out.could[q] * beyond * beyond
            if strength < NEGLIGIBLE_SHARE * out.could[q] * beyond * beyond:
                return shadow.DARK
    viewer, distance = _viewer(pixels, p)
    alpha, reflectance = pixels.roughness[q] * pixels.roughness[q], pixels.reflectance[q]
    diffuse, glossy = lamps.unshadowed(lamp, p, n, viewer, alpha, pixels.f0[q], reflectance, is_faint, uniform(q, 0, salt),
                                       uniform(q, 1, salt))
    glossy *= pixels.gain[q]
    if diffuse <= ZERO and glossy <= ZERO:
        return shadow.DARK
    bare.diffuse[k], bare.glossy[k] = diffuse, glossy
    out.could[q] += colours[6] * diffuse
    answer = shadow.LIT if test == NONE else shadow.ASK
    if test == MAP:
        answer = shadow.classify(shadow_map, p, _error_of(pixels, p, distance))
    if answer == shadow.LIT:
        _add(q, diffuse, glossy, colours, pixels, out)
    return answer


@pixel_jit
def _light_pixels(begin, end, index, lamp, colours, pixels, salt, shadow_map, test, strength, bare, out, state):
    """`_light_at_pixel` for the pixels of `index` (K,); its answers into `state` (K,)."""
    lamp, colours, pixels, shadow_map, bare, out = borrowed((lamp, colours, pixels, shadow_map, bare, out))
    for k in range(begin, end):
        state[k] = _light_at_pixel(k, index[k], lamp, colours, pixels, salt, shadow_map, test, strength, bare, out)


@inline_jit
def _find_start(q, p, n, viewer, distance, error, starts, bvh, stack):
    """Enter pixel q into `starts`."""
    span = max(SPAN * distance, f32(16) * error)
    slot, o, side, a, b = shadow.find_surface(bvh, stack, p, viewer, span)
    place = along(p, n, f32(2) * error)
    if slot < 0:
        side = n
    else:
        size = max(abs(o.x), max(abs(o.y), abs(o.z)))
        place = along(o, side, OFFSET * size + f32(0.05) * error)
        if starts.normals.shape[0] > 0:
            starts.lift[q, 0], starts.lift[q, 1], starts.lift[q, 2] = smooth_lift(bvh, starts.normals, slot, a, b, side)
    starts.place[q, 0], starts.place[q, 1], starts.place[q, 2] = place
    starts.side[q, 0], starts.side[q, 1], starts.side[q, 2] = side
    starts.known[q] = 1


@inline_jit
def _seen(q, starts, bvh, stack, p, n, d):
    """Share of light that gets along the vector d from a lamp to p, whose shading normal is n."""
    lift = load(starts.lift, q)
    share = lifted_share(lift, n, load(starts.side, q), normalized_or(d, n))
    if share < ZERO:
        return ZERO
    start = along(load(starts.place, q), lift, share)
    # in a crease rounding may put the start behind the other surface: begin a few units in the last place along the ray
    size = max(abs(p.x), max(abs(p.y), abs(p.z)))
    begin = begun(start, d, SKIP * size)
    return visibility(bvh, stack, begin, Vec3(p.x + d.x - begin.x, p.y + d.y - begin.y, p.z + d.z - begin.z))


@inline_jit
def _is_alike(pixels, q, r):
    """Do pixels q and r show the same smooth surface?"""
    n, d = load(pixels.normal, q), sub(load(pixels.position, r), load(pixels.position, q))
    return dot(n, load(pixels.normal, r)) > LIKE_NORMAL and abs(dot(n, d)) <= LIKE_PLANE * length(d)


@inline_jit
def _shares_beside(q, pixels, shares):
    """(lowest share, highest, mean share of the irradiance, of the glossy light) of the pixels beside q that go first.

    They are two or four. The lowest is negative where q is such a pixel itself, or one of them is not known or shows another
    surface.
    """
    row, column = q // pixels.width, q % pixels.width
    odd_row, odd_column = row & 1, column & 1
    low, high, diffuse, glossy = ONE, ZERO, ZERO, ZERO
    if odd_row + odd_column == 0 or column + odd_column >= pixels.width:
        return -ONE, ZERO, ZERO, ZERO
    for i in range(odd_row + 1):
        for j in range(odd_column + 1):
            r = (row - odd_row + 2 * i) * pixels.width + column - odd_column + 2 * j
            if r >= len(shares.diffuse) or shares.diffuse[r] == UNKNOWN or not _is_alike(pixels, q, r):
                return -ONE, ZERO, ZERO, ZERO
            low, high = min(low, shares.diffuse[r]), max(high, shares.diffuse[r])
            diffuse, glossy = diffuse + shares.diffuse[r], glossy + shares.glossy[r]
    count = f32((odd_row + 1) * (odd_column + 1))
    return low, high, diffuse / count, glossy / count


@inline_jit
def _still_holds(q, lamp, starts, bvh, stack, p, n, share, first, turn):
    """Does as much light as `share` get through from opposite points of the lamp's rim, or from one of them if it is small?

    `first`, 0 or 1, says which they are.
    """
    across = 3 if lamp.kind == lamps.RECTANGLE_LAMP else 2
    for i in range(2 if lamps.apparent_size(lamp, p) > SMALL_LAMP else 1):
        x, y = lamps.rim_point(lamp, first ^ (across * i), turn)
        d, _ = lamps.lamp_at(lamp, p, x, y)
        if _seen(q, starts, bvh, stack, p, n, d) != share:
            return False
    return True


@inline_jit
def _seen_shares(q, lamp, starts, bvh, stack, p, n, viewer, alpha, f0, rays, is_exact, shift_u, shift_v):
    """(share of the irradiance, share of the glossy light) that arrives at p, each ray in proportion to what it carries.

    Where half of the rays to a small lamp agree the others are not asked, unless it `is_exact`.
    """
    size = lamps.apparent_size(lamp, p)
    if size == ZERO:
        d, _ = lamps.lamp_at(lamp, p, ZERO, ZERO)
        share = _seen(q, starts, bvh, stack, p, n, d)
        return share, share
    alpha = max(max(alpha, f32(0.3) * min(size, ONE)), lamps.LEAST_ALPHA)
    diffuse_all, diffuse_seen, glossy_all, glossy_seen = ZERO, ZERO, ZERO, ZERO
    half = rays if is_exact or size > SMALL_LAMP else (rays + 1) // 2
    for i in range(rays):
        if i == half and not ZERO < diffuse_seen < diffuse_all:
            break
        u, v = r2_sequence(i, shift_u, shift_v)
        x, y, share = lamps.lamp_place(lamp, p, u, v)
        d, weight = lamps.lamp_at(lamp, p, x, y)
        unit = normalized_or(d, n)
        diffuse = weight * share * max(dot(n, unit), ZERO)
        if diffuse > ZERO:
            seen = _seen(q, starts, bvh, stack, p, n, d)
            glossy = weight * share * lamps.ggx_lobe(n, viewer, unit, alpha * alpha, f0) if f0 > ZERO else ZERO   # no lobe
            diffuse_all, glossy_all = diffuse_all + diffuse, glossy_all + glossy
            diffuse_seen, glossy_seen = diffuse_seen + seen * diffuse, glossy_seen + seen * glossy
    share = diffuse_seen / diffuse_all if diffuse_all > ZERO else ZERO
    return share, (glossy_seen / glossy_all if glossy_all > ZERO else share)


@inline_jit
def _own_shares(q, lamp, pixels, salt, shadow_map, starts, bvh, stack, rays, is_exact, is_minor, expected):
    """(share of the irradiance, share of the glossy light) that a second look at the map, or rays, find at pixel q."""
    p, n = load(pixels.position, q), load(pixels.normal, q)
    viewer, distance = _viewer(pixels, p)
    error = _error_of(pixels, p, distance)
    if starts.known[q] == 0:
        _find_start(q, p, n, viewer, distance, error, starts, bvh, stack)
    shift_u, shift_v = uniform(q, 2, salt), uniform(q, 3, salt)
    if is_minor:
        x, y, _ = lamps.lamp_place(lamp, p, shift_u, shift_v)
        d, _ = lamps.lamp_at(lamp, p, x, y)
        share = _seen(q, starts, bvh, stack, p, n, d)
        return share, share
    answer = shadow.look_around(shadow_map, p, load(starts.side, q), error) if lamp.half_x > ZERO else shadow.ASK
    if answer != shadow.ASK:
        share = ONE if answer == shadow.LIT else ZERO
        return share, share
    first = q + q // pixels.width & 1
    if expected >= ZERO and _still_holds(q, lamp, starts, bvh, stack, p, n, expected, first, shift_u):
        return expected, expected
    alpha = pixels.roughness[q] * pixels.roughness[q]
    return _seen_shares(q, lamp, starts, bvh, stack, p, n, viewer, alpha, pixels.f0[q], rays, is_exact, shift_u,
                        shift_v)


@inline_jit
def _trace_at_pixel(k, q, lamp, colours, pixels, salt, shadow_map, bare, starts, bvh, stack, rays, is_exact, shares, out):
    is_minor, low, high, share, glossy_share = False, -ONE, ONE, ZERO, ZERO
    if not is_exact and bare.glossy[k] * pixels.reflectance[q] <= bare.diffuse[k] * INV_PI:     # no highlight
        is_minor = colours[6] * bare.diffuse[k] < MINOR_SHARE * out.could[q]
        if not is_minor and colours[6] * bare.diffuse[k] < MIDDLE_SHARE * out.could[q]:
            rays = max(rays // 2, 1)
        low, high, share, glossy_share = _shares_beside(q, pixels, shares)
    # four of one kind may hide a thin shadow between them; a lamp that gives little is not worth the look
    if not (low > ZERO and high < ONE and high - low <= EVEN_SPREAD or is_minor and low == high):
        expected = share if low == high else -ONE
        share, glossy_share = _own_shares(q, lamp, pixels, salt, shadow_map, starts, bvh, stack, rays, is_exact, is_minor,
                                          expected)
    shares.diffuse[q], shares.glossy[q] = share, glossy_share
    _add(q, bare.diffuse[k] * share, bare.glossy[k] * glossy_share, colours, pixels, out)


@pixel_jit
def _trace_pixels(begin, end, index, left, lamp, colours, pixels, salt, shadow_map, bare, starts, bvh, rays, is_exact,
                  shares, out):
    """Add the light that a second look at the map, rays, or pixels beside find at the pixels `left` (M,) of `index` (K,)."""
    lamp, colours, pixels, shadow_map, bare, starts, bvh, shares, out = borrowed(
        (lamp, colours, pixels, shadow_map, bare, starts, bvh, shares, out))
    stack = scratch(STACK, np.int32)
    for m in range(begin, end):
        k = left[m]
        _trace_at_pixel(k, index[k], lamp, colours, pixels, salt, shadow_map, bare, starts, bvh, stack, rays, is_exact,
                        shares, out)


@pixel_jit
def _ask_map(begin, end, index, left, colours, pixels, shadow_map, bare, out):
    """Add the light of the pixels `left` (M,) of `index` (K,) by the map's own four texels."""
    colours, pixels, shadow_map, bare, out = borrowed((colours, pixels, shadow_map, bare, out))
    for m in range(begin, end):
        k, q = left[m], index[left[m]]
        p = load(pixels.position, q)
        _, distance = _viewer(pixels, p)
        share = shadow.map_visibility(shadow_map, p, _error_of(pixels, p, distance))
        _add(q, bare.diffuse[k] * share, bare.glossy[k] * share, colours, pixels, out)


TECHNIQUE = Technique("direct", "Direct Light", DirectParams, compute_direct,
                      frozenset({Transport.DIRECT_DIFFUSE, Transport.DIRECT_GLOSSY}), needs_geometry=True, needs_views=True)
