"""What lamps of every shape send to a point: sampled over the shape, and summed without shadows.

A lamp of unit strength; its colour and power multiply later. `lamp_at` gives the vector from a point to a place on the
lamp and a weight such that the mean of weight x cos(receiver) over the shape is the irradiance. The shapes follow
Cycles: a point or spot is a disk that turns towards the receiver (Blender's "soft falloff"), or a sphere; a sun is a
cone of directions; rectangles and ellipses shine on one side, narrowed by a grid of tubes if they have a spread.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .brdf import fresnel, ggx_lobe, lobe_density, sample_lobe
from .fastmath import on_circle
from .jit import borrowed, device_jit, pixel_jit
from .sampling import disk, r2_sequence
from .vec3 import ONE, ZERO, Vec3, cross, dot, f32, length, load, normalized_or, scaled, sub, tangent_frame

POSITION, DIRECTION, AXIS_X, AXIS_Y = 0, 1, 2, 3
DISK_LAMP, SPHERE_LAMP, SUN_LAMP, RECTANGLE_LAMP, ELLIPSE_LAMP = 0, 1, 2, 3, 4
PI, INV_PI = f32(math.pi), f32(1 / math.pi)
HALF = f32(0.5)
NEAR = f32(0.1)             # half size over distance above which an area light is summed in closed form
WIDE = f32(0.3)             # half size over distance above which a lamp that sets behind the surface is no flat disk
TINY = f32(0.004)           # half size over distance below which the centre stands for the shape
SMALL = f32(0.008)          # the same where no sharp lobe sees the shape: what it misses goes with the square
ROUND = f32(0.1)            # the same of points and suns, whose irradiance the centre gives exactly
GAUSS = f32(0.57735027)     # node of the two-point Gauss rule on [-1, 1]
POLYGON = 16                # sides of the polygon that stands for an ellipse; of equal area, 0.03 % at most
AREA_SAMPLES = 64           # of the sums that have no closed form
FEW_AREA_SAMPLES = 16
LEAST_ALPHA = f32(0.006)    # sharper lobes are below float32's resolution of the half vector
SHARP = f32(0.75)           # alpha over apparent half size below which rays of the lobe tell what it reflects of a lamp:
                            # four places of the lamp would show as four lamps
SHARP_RAYS = 16
MIRROR_ALPHA = f32(1e-3)    # one ray tells
MINOR_LOBE = f32(0.02)      # of the light of a white matt surface: less of it need not be known to a tenth
METALS = f32(0.3)           # reflectance from which a surface may have nothing but its lobe
RIM = f32(0.96)             # of the half size: where rays to the rim go
TAIL = f32(24)              # alphas from its mirror direction beyond which a lobe holds less than a fiftieth of a percent,
                            # and a lamp's centre tells what it gives there


class Lamp(NamedTuple):
    """A lamp as kernels take it; lengths in m, vectors unit.

    places: (4, 3) float32, rows POSITION, DIRECTION (along which it shines), AXIS_X, AXIS_Y. half_x, half_y: half sizes (a
    radius for points and spots, the sine of half the angle for a sun). spot_edge, spot_scale: cosine where a spot's
    cone ends and 1 / (its soft edge); without a cone spot_scale is 0. tan_spread and spread_gain: see
    `radiometry.spread_factor`; spread_gain is 0 for a Lambertian light.
    """

    kind: int
    places: np.ndarray
    half_x: np.float32
    half_y: np.float32
    spot_edge: np.float32
    spot_scale: np.float32
    tan_spread: np.float32
    spread_gain: np.float32
    far: np.float32         # length in m of a shadow ray to a sun


@device_jit
def _plus(a, x, s, y, t):
    return Vec3(a.x + x.x * s + y.x * t, a.y + x.y * s + y.y * t, a.z + x.z * s + y.z * t)


@device_jit
def _spot_share(lamp, unit):
    """Share of the axis intensity along `unit`, which points from the receiver to the lamp: smoothstep of the cosine."""
    if lamp.spot_scale == ZERO:
        return ONE
    t = min(max((-dot(load(lamp.places, DIRECTION), unit) - lamp.spot_edge) * lamp.spot_scale, ZERO), ONE)
    return t * t * (f32(3) - f32(2) * t)


@device_jit
def _area_weight(lamp, d, area):
    """Radiance to irradiance for a patch of `area` m2 of a one-sided light at `d` from the receiver."""
    distance_sq = dot(d, d)
    cos_light = -dot(load(lamp.places, DIRECTION), d) / math.sqrt(max(distance_sq, f32(1e-30)))
    if cos_light <= f32(1e-6):
        return ZERO
    share = ONE
    if lamp.spread_gain > ZERO:
        tangent = math.sqrt(max(ZERO, ONE - cos_light * cos_light)) / cos_light
        share = max(lamp.tan_spread - tangent, ZERO) * lamp.spread_gain
    return share * area * cos_light / max(distance_sq, f32(1e-30))


@device_jit
def lamp_at(lamp, p, x, y):
    """(vector from p to the lamp's point (x, y), weight): (x, y) in the unit disk, or in [-1, 1]^2 for a rectangle."""
    to = sub(load(lamp.places, POSITION), p)
    if lamp.kind == SUN_LAMP:
        # even over the cone's projection along its axis: even radiance, whatever the angle
        rise = math.sqrt(max(ONE - (x * x + y * y) * lamp.half_x * lamp.half_x, f32(1e-4)))
        towards = scaled(load(lamp.places, DIRECTION), -rise)
        d = _plus(towards, load(lamp.places, AXIS_X), x * lamp.half_x, load(lamp.places, AXIS_Y), y * lamp.half_x)
        return scaled(d, lamp.far), ONE / rise
    if lamp.kind >= RECTANGLE_LAMP:
        area = f32(4) * lamp.half_x * lamp.half_y * (ONE if lamp.kind == RECTANGLE_LAMP else f32(math.pi / 4))
        d = _plus(to, load(lamp.places, AXIS_X), x * lamp.half_x, load(lamp.places, AXIS_Y), y * lamp.half_y)
        return d, _area_weight(lamp, d, area)
    distance_sq = max(dot(to, to), f32(1e-30))
    distance = math.sqrt(distance_sq)
    axis = scaled(to, ONE / distance)
    r = lamp.half_x
    if r == ZERO:
        return to, _spot_share(lamp, axis) / distance_sq
    t, b = tangent_frame(axis)
    if lamp.kind == DISK_LAMP:
        d = _plus(to, t, x * r, b, y * r)
        d_sq = max(dot(d, d), f32(1e-30))
        d_length = math.sqrt(d_sq)
        return d, _spot_share(lamp, scaled(d, ONE / d_length)) * distance / (d_length * d_sq)
    # a sphere: (x, y) fills its cone of directions evenly; inside it the cone is the half space of the centre
    sin_sq = min(r * r / distance_sq, ONE)
    widest = sin_sq / (ONE + math.sqrt(ONE - sin_sq))          # 1 - cos of the cone's half angle, without cancellation
    rho_sq = min(x * x + y * y, ONE)
    drop = rho_sq * widest
    side = math.sqrt(max(f32(2) - drop, ZERO) * widest)        # sin(theta) / rho
    unit = _plus(scaled(axis, ONE - drop), t, x * side, b, y * side)
    cosine = ONE - drop
    reach = distance * cosine - math.sqrt(max(r * r - distance_sq * (ONE - cosine * cosine), ZERO))
    return scaled(unit, max(reach, f32(1e-6) * distance)), _spot_share(lamp, unit) * f32(2) * widest / (r * r)


@device_jit
def lamp_place(lamp, p, u, v):
    """(x, y, share) for `lamp_at` from (u, v) in [0, 1)^2, evenly over the shape; `share` multiplies the weight.

    With a narrow spread only the part that p can see is used: a circle around the point of the lamp's plane that is
    nearest to p, or the rectangle around what the lamp and that circle share.
    """
    if lamp.kind != RECTANGLE_LAMP and lamp.spread_gain == ZERO:
        x, y = disk(u, v)
        return x, y, ONE
    low_x, high_x, low_y, high_y, share = -ONE, ONE, -ONE, ONE, ONE
    if lamp.spread_gain > ZERO:
        to = sub(p, load(lamp.places, POSITION))
        reach = dot(to, load(lamp.places, DIRECTION)) * lamp.tan_spread
        foot_x, foot_y = dot(to, load(lamp.places, AXIS_X)) / lamp.half_x, dot(to, load(lamp.places, AXIS_Y)) / lamp.half_y
        reach_x, reach_y = reach / lamp.half_x, reach / lamp.half_y
        low_x, high_x = max(foot_x - reach_x, -ONE), min(foot_x + reach_x, ONE)
        low_y, high_y = max(foot_y - reach_y, -ONE), min(foot_y + reach_y, ONE)
        if low_x >= high_x or low_y >= high_y:
            return ZERO, ZERO, ZERO
        whole = f32(1.999)
        if lamp.kind == ELLIPSE_LAMP and high_x - low_x > whole and high_y - low_y > whole:
            x, y = disk(u, v)
            return x, y, ONE
        if high_x - low_x > whole * reach_x and high_y - low_y > whole * reach_y:
            x, y = disk(u, v)                    # the circle that p sees lies within the rectangle around the shape
            x, y = foot_x + x * reach_x, foot_y + y * reach_y
            share = reach_x * reach_y * f32(math.pi / 4)
        else:
            share = (high_x - low_x) * (high_y - low_y) / f32(4)
            x, y = low_x + u * (high_x - low_x), low_y + v * (high_y - low_y)
    else:
        x, y = low_x + u * (high_x - low_x), low_y + v * (high_y - low_y)
    if lamp.kind == ELLIPSE_LAMP:
        share = share * f32(4 / math.pi) if x * x + y * y <= ONE else ZERO
    return x, y, share


@device_jit
def rim_point(lamp, i, turn):
    """(x, y) of place i of four around the rim for `lamp_at`: the corners of a rectangle."""
    if lamp.kind == RECTANGLE_LAMP:
        return RIM * (ONE if i & 1 else -ONE), RIM * (ONE if i & 2 else -ONE)
    x, y = on_circle(f32(0.25) * (f32(i) + turn))
    return RIM * x, RIM * y


@device_jit
def _arc(a, b, n):
    """An edge's part of Lambert's sum: the angle it spans times the cosine of its plane's normal to n."""
    c = cross(a, b)
    size = length(c)
    if size <= ZERO:
        return ZERO
    return math.atan2(size, dot(a, b)) * dot(c, n) / size


@device_jit
def _polygon_irradiance(lamp, p, n):
    """Irradiance from a Lambertian rectangle or ellipse of radiance 1: Lambert's sum over its edges above the horizon."""
    sides = 4 if lamp.kind == RECTANGLE_LAMP else POLYGON
    # circumradius of the regular polygon with the disk's area
    wide = f32(math.sqrt(2)) if lamp.kind == RECTANGLE_LAMP else f32(
        math.sqrt(math.pi / (POLYGON / 2 * math.sin(2 * math.pi / POLYGON))))
    to = sub(load(lamp.places, POSITION), p)
    total = ZERO
    leaving, entering, is_cut = to, to, False
    turn = f32(2 * math.pi) / f32(sides)
    axis_x = scaled(load(lamp.places, AXIS_X), lamp.half_x * wide)
    axis_y = scaled(load(lamp.places, AXIS_Y), lamp.half_y * wide)
    a = _plus(to, axis_x, math.cos(HALF * turn), axis_y, math.sin(HALF * turn))
    height_a = dot(a, n)
    for i in range(sides):
        angle = (f32(i) + f32(1.5)) * turn
        b = _plus(to, axis_x, math.cos(angle), axis_y, math.sin(angle))
        height_b = dot(b, n)
        start, end = a, b
        if (height_a > ZERO) != (height_b > ZERO):
            t = height_a / (height_a - height_b)
            cut = Vec3(a.x + t * (b.x - a.x), a.y + t * (b.y - a.y), a.z + t * (b.z - a.z))
            is_cut = True
            if height_a > ZERO:
                end, leaving = cut, cut
            else:
                start, entering = cut, cut
        if height_a > ZERO or height_b > ZERO:
            total += _arc(start, end, n)
        a, height_a = b, height_b
    if is_cut:
        total += _arc(leaving, entering, n)
    return HALF * abs(total)


@device_jit
def _part_above(height, size):
    """Mean of max(height + size x, 0) over the unit disk for |height| <= size: a lamp that sets behind the surface."""
    a = height / size
    root = math.sqrt(max(ONE - a * a, ZERO))
    return size * (a * (PI - math.acos(a)) + root * (f32(2) + a * a) / f32(3)) / PI


@device_jit
def apparent_size(lamp, p):
    """Half size of the lamp over its distance from p, as seen face on."""
    if lamp.kind == SUN_LAMP:
        return lamp.half_x
    return max(lamp.half_x, lamp.half_y) / max(length(sub(load(lamp.places, POSITION), p)), f32(1e-20))


@device_jit
def radiance_along(lamp, p, d):
    """Radiance that arrives at p along the unit vector d, which points away from p; 0 beside the lamp."""
    towards = load(lamp.places, DIRECTION)
    if lamp.kind == SUN_LAMP:
        rise = -dot(towards, d)
        inside = rise > ZERO and ONE - rise * rise <= lamp.half_x * lamp.half_x
        return INV_PI / (lamp.half_x * lamp.half_x) if inside else ZERO
    to = sub(load(lamp.places, POSITION), p)
    if lamp.kind >= RECTANGLE_LAMP:
        facing = -dot(towards, d)
        distance = -dot(towards, to)
        if facing <= f32(1e-6) or distance <= ZERO:
            return ZERO
        off = sub(scaled(d, distance / facing), to)
        x, y = dot(off, load(lamp.places, AXIS_X)) / lamp.half_x, dot(off, load(lamp.places, AXIS_Y)) / lamp.half_y
        if not (max(abs(x), abs(y)) <= ONE if lamp.kind == RECTANGLE_LAMP else x * x + y * y <= ONE):
            return ZERO
        share = ONE
        if lamp.spread_gain > ZERO:
            share = max(lamp.tan_spread - math.sqrt(max(ZERO, ONE - facing * facing)) / facing, ZERO) * lamp.spread_gain
        return share
    distance_sq, along_axis = dot(to, to), dot(to, d)
    if along_axis <= ZERO:
        return ZERO
    r_sq, miss_sq = lamp.half_x * lamp.half_x, max(distance_sq - along_axis * along_axis, ZERO)
    if lamp.kind == DISK_LAMP:                   # how far the ray passes the centre, in the disk's plane
        miss_sq *= distance_sq / (along_axis * along_axis)
    return _spot_share(lamp, d) * INV_PI / r_sq if miss_sq <= r_sq else ZERO


@device_jit
def _weight_along(lamp, p, d):
    """What `lamp_at` weighs the place with that a ray from p along the unit vector d meets; of a lamp that it does meet."""
    if lamp.kind == SUN_LAMP:
        return ONE / max(-dot(load(lamp.places, DIRECTION), d), f32(1e-6))
    to = sub(load(lamp.places, POSITION), p)
    if lamp.kind >= RECTANGLE_LAMP:
        towards = load(lamp.places, DIRECTION)
        area = f32(4) * lamp.half_x * lamp.half_y * (ONE if lamp.kind == RECTANGLE_LAMP else f32(math.pi / 4))
        return _area_weight(lamp, scaled(d, dot(towards, to) / dot(towards, d)), area)
    distance_sq = max(dot(to, to), f32(1e-30))
    if lamp.kind == DISK_LAMP:
        reach = distance_sq / dot(to, d)
        return _spot_share(lamp, d) * math.sqrt(distance_sq) / (reach * reach * reach)
    sin_sq = min(lamp.half_x * lamp.half_x / distance_sq, ONE)
    return _spot_share(lamp, d) * f32(2) * sin_sq / ((ONE + math.sqrt(ONE - sin_sq)) * lamp.half_x * lamp.half_x)


@device_jit
def _from_centre(lamp, p, n, viewer, alpha, f0, is_glossy):
    """(irradiance, integral of radiance x glossy lobe) as if the lamp's centre sent all of its light."""
    d, weight = lamp_at(lamp, p, ZERO, ZERO)
    unit = normalized_or(d, n)
    cosine = dot(n, unit)
    if not weight > ZERO or not cosine > ZERO:
        return ZERO, ZERO
    return weight * cosine, weight * ggx_lobe(n, viewer, unit, alpha * alpha, f0) if is_glossy else ZERO


@device_jit
def _reflected(lamp, p, n, viewer, axis, size, alpha, f0, shift_u, shift_v):
    """Integral of radiance x glossy lobe of a lobe that is narrow beside the lamp.

    By rays of the lobe, which tell what of the lamp lies in its middle, and places on the lamp, which tell what its tail
    takes, weighted by the balance heuristic (Veach and Guibas 1995). Far out in the tail, where a bright lamp glows too, the
    lamp's centre tells it.
    """
    mirror = sub(scaled(n, f32(2) * dot(n, viewer)), viewer)
    beyond = length(sub(mirror, axis)) - TAIL * alpha
    if dot(n, viewer) <= ZERO:
        return ZERO
    if beyond > f32(1.5) * size:
        return _from_centre(lamp, p, n, viewer, alpha, f0, True)[1]
    total, rays = ZERO, SHARP_RAYS if alpha > MIRROR_ALPHA else 1
    has_places = alpha > MIRROR_ALPHA and lamp.spread_gain == ZERO
    u = v = ZERO
    at_viewer = fresnel(max(dot(n, viewer), f32(0.02)), f0)
    for i in range(rays):
        d, weight = mirror, ONE
        if alpha > MIRROR_ALPHA:
            u, v = r2_sequence(i, shift_u, shift_v)
            d, weight = sample_lobe(n, viewer, alpha, u, v)
        radiance = radiance_along(lamp, p, d)
        if radiance > ZERO:
            half = normalized_or(Vec3(d.x + viewer.x, d.y + viewer.y, d.z + viewer.z), n)
            given = weight * fresnel(max(dot(half, viewer), ZERO), f0) / at_viewer * radiance
            if has_places:
                density = lobe_density(n, viewer, d, alpha)
                given *= density / (density + radiance / _weight_along(lamp, p, d))
            total += given
        if has_places:
            x, y, _ = lamp_place(lamp, p, u, v)
            d, weight = lamp_at(lamp, p, x, y)
            unit = normalized_or(d, n)
            radiance = radiance_along(lamp, p, unit) if weight > ZERO and dot(n, unit) > ZERO else ZERO
            if radiance > ZERO:
                density = radiance / weight
                given = weight * ggx_lobe(n, viewer, unit, alpha * alpha, f0)
                total += given * density / (density + lobe_density(n, viewer, unit, alpha))
    return total / f32(rays)


@device_jit
def may_reach(lamp, p, n):
    """False where a lamp surely sends nothing: behind the surface, behind the lamp, outside a spot's cone. Cheap."""
    direction = load(lamp.places, DIRECTION)
    if lamp.kind == SUN_LAMP:
        return dot(n, direction) < lamp.half_x
    to, reach = sub(load(lamp.places, POSITION), p), f32(1.5) * max(lamp.half_x, lamp.half_y)
    if dot(n, to) < -reach:
        return False
    along_axis = -dot(direction, to)
    if lamp.kind >= RECTANGLE_LAMP:
        return along_axis > ZERO
    return lamp.spot_scale == ZERO or along_axis > lamp.spot_edge * length(to) - f32(1.5) * reach


@pixel_jit
def gain_of_size(begin, end, lamp, position, normal, most, out):
    """What a lamp sends to points (N, 3) with unit normals (N, 3) over what its centre alone would, at most `most`: (N,)."""
    lamp, = borrowed((lamp,))
    for k in range(begin, end):
        p, n = load(position, k), load(normal, k)
        centre, _ = _from_centre(lamp, p, n, n, ONE, ONE, False)
        whole, _ = unshadowed(lamp, p, n, n, ONE, ONE, ZERO, False, HALF, HALF)
        out[k] = min(whole / centre, most) if centre > ZERO else ONE


@pixel_jit
def irradiance_at(begin, end, lamp, position, normal, out):
    """Irradiance W/m2 (N,) of a lamp of unit strength at points (N, 3) with unit normals (N, 3), nothing in between."""
    lamp, = borrowed((lamp,))
    for k in range(begin, end):
        n = load(normal, k)
        out[k], _ = unshadowed(lamp, load(position, k), n, n, ONE, ONE, ZERO, False, HALF, HALF)


@device_jit
def unshadowed(lamp, p, n, viewer, alpha, f0, reflectance, is_faint, shift_u, shift_v):
    """(irradiance, integral of radiance x glossy lobe) at p from a lamp of unit strength, nothing standing between.

    One sample serves a lamp that looks tiny, four a small one, and many an area light that looks large or is narrow; the
    lobe is widened by the part of the lamp that a sample stands for. Large Lambertian areas have a closed form, and so have
    spheres, suns and disks that face the point, above the horizon: the centre's irradiance, for a disk over 1 + size^2
    (offsets cancel, and the mean of (1 + s^2)^-2 over it is that). A lobe that is narrow beside the lamp shows its shape.
    `reflectance` is what a colour multiplies the lobe with, 0 for none. Of a lamp that `is_faint` beside others the centre
    stands for all, and so it does in a lobe that adds little to matt light.
    """
    size = apparent_size(lamp, p)
    is_area = lamp.kind >= RECTANGLE_LAMP
    towards = scaled(load(lamp.places, DIRECTION), -ONE)
    axis = towards
    if lamp.kind != SUN_LAMP:
        to = sub(load(lamp.places, POSITION), p)
        if is_area and dot(to, towards) <= ZERO:
            return ZERO, ZERO
        axis = normalized_or(to, n)
    height = dot(n, axis)
    if height < -size and not is_area:
        return ZERO, ZERO
    # every part is above the horizon, and none is brighter than the others
    is_whole = height > size and not is_area and size < (ROUND if lamp.spot_scale == ZERO else SMALL)
    share_of_centre = ONE
    if lamp.kind == DISK_LAMP:
        share_of_centre = ONE / (ONE + size * size)
    elif lamp.kind == SPHERE_LAMP:               # pi L sin^2 of its cone over pi L 2 (1 - cos)
        share_of_centre = HALF + HALF * math.sqrt(max(ONE - size * size, ZERO))
    is_glossy = reflectance > ZERO
    wide_alpha = max(max(alpha, HALF * min(size, ONE)), LEAST_ALPHA)
    if is_faint:
        return _from_centre(lamp, p, n, viewer, wide_alpha, f0, is_glossy)
    glossy = ZERO
    narrow = SHARP * min(size, f32(0.2) if is_area else WIDE)
    if is_glossy and (alpha < narrow or alpha < LEAST_ALPHA and alpha < f32(2) * size):
        glossy = _reflected(lamp, p, n, viewer, axis, size, alpha, f0, shift_u, shift_v)
        is_glossy = False
    elif is_glossy and height > size and size < HALF and reflectance < METALS:
        diffuse, glossy = _from_centre(lamp, p, n, viewer, wide_alpha, f0, True)
        is_glossy = reflectance * glossy > MINOR_LOBE * INV_PI * diffuse
        if is_whole and not (is_glossy and alpha < f32(6) * size):
            return share_of_centre * diffuse, share_of_centre * glossy
    count, widening = 4, f32(0.25) * size
    is_closed = is_area and lamp.spread_gain == ZERO and (size > NEAR or abs(height) < f32(2) * size)
    sets = not is_area and abs(height) < size
    if is_closed or lamp.spread_gain > ZERO or (sets and size > WIDE):
        count, widening = AREA_SAMPLES, f32(0.12) * min(size, ONE)
        if is_closed and not is_glossy:
            count = 0
        elif is_closed and alpha >= f32(0.25) * min(size, ONE):      # only the lobe asks, and it is wider than its parts
            count = FEW_AREA_SAMPLES
    elif not sets and (size < TINY and not is_area or (is_whole or size < SMALL and height > size)
                       and not (is_glossy and alpha < f32(6) * size)):
        count, widening = 1, HALF * size
    alpha = max(max(alpha, widening), LEAST_ALPHA)
    node = GAUSS if lamp.kind == RECTANGLE_LAMP else HALF
    diffuse, carried = ZERO, ZERO
    if is_glossy:
        glossy = ZERO
    for i in range(count):
        x, y, share = ZERO, ZERO, ONE
        if count >= FEW_AREA_SAMPLES:
            u, v = r2_sequence(i, shift_u, shift_v)
            x, y, share = lamp_place(lamp, p, u, v)
        elif count == 4:
            x, y = node if i & 1 else -node, node if i & 2 else -node
        d, weight = lamp_at(lamp, p, x, y)
        weight *= (share_of_centre if count == 1 else share) / f32(count)
        if weight > ZERO:
            unit = normalized_or(d, n)
            carried += weight
            diffuse += weight * max(dot(n, unit), ZERO)
            if is_glossy:
                glossy += weight * ggx_lobe(n, viewer, unit, alpha * alpha, f0)
    if is_closed:
        diffuse = _polygon_irradiance(lamp, p, n)
    elif sets and size <= WIDE:
        diffuse = carried * _part_above(height, size)
        if lamp.kind == DISK_LAMP:               # its rim is farther; 3/5 is the mean square radius of half a disk
            diffuse /= math.sqrt(ONE + f32(0.6) * size * size)
    return diffuse, glossy
