"""Texels of a light's view as virtual point lights, without visibility: the sum over all, and the published sampling.

A texel p of position x_p, unit normal n_p and reflected flux Phi_p (W) gives a point x with unit normal n the irradiance

    E(x, n) = Phi_p / pi  max(0, n_p.(x - x_p))  max(0, n.(x_p - x)) / |x - x_p|^4

(Dachsbacher and Stamminger 2005, Eq. 1). Both dot products take the bare difference, so the 4th power is the inverse
square law. The 1/pi is not in the paper, whose flux is in units of intensity: here Phi_p is in watts, and a Lambertian
texel of Phi_p watts has the intensity Phi_p / pi cos(theta). A glossy texel adds Phi_g lobe(n_p, to light, to x)
cos(theta_x) / r^2.

Tables of texels are as in `clusters`. The near field is Lambert's form factor of a polygon, cut at the horizon (Schroeder
and Hanrahan 1993, Eq. 1, for a differential receiver).
"""

from __future__ import annotations

import math

import numpy as np

from .brdf import ggx_lobe
from .clusters import ALPHA2, DIFFUSE, F0, GLOSSY, NO_LOBE, NORMAL, POSITION, TO_LIGHT
from .jit import device_jit, pixel_jit
from .sampling import r2_sequence, uniform
from .vec3 import ONE, ZERO, Vec3, along, cross, dot, f32, length, load, load_column, load_pixel, scaled, sub, tangent_frame

INV_PI = f32(1 / math.pi)
INV_TWO_PI = f32(0.5 / math.pi)
HALF = f32(0.5)
MIN_DIST_SQ = f32(1e-16)        # (10 nm)^2: the 4th power of the inverse times 1e6 W still fits float32
NEAR_SQ = f32(16)               # texels of size s nearer than 4 s are squares: beyond, points are within 0.5 %
RUN = 512                       # texels summed in float32 before the sum goes to float64
ROTATION_STREAM, JITTER_STREAM, SHIFT_STREAM = 0x5EED, 0x7E8E, 0x51F7


def gather_all(position: np.ndarray, normal: np.ndarray, table: np.ndarray, eps2: float, *,
               area_m2: np.ndarray | None = None, near_field: str = "EXACT") -> np.ndarray:
    """Irradiance from all texels of a table; `thin_texels` makes a table of fewer.

    Parameters
    ----------
    position, normal : (M, 3) float32
        Points in m and their unit normals.
    table : (17, N) float32
        Texels, as in `clusters`.
    eps2 : float m2
        Added to the squared distance; 0 leaves the formula as it is.
    area_m2 : (N,) float32, optional
        Area of the surface that each texel stands for. Without it a texel is a point, and light near texels is spiky: above
        an evenly lit plane the rms error is 1.2 % at the height of one texel, 22 % at half and 97 % at a quarter.
    near_field : "EXACT" or "GUARD"
        What to do with `area_m2`. EXACT takes a texel nearer than four times its size as a square of that area around its
        position (Lambert's form factor, cut at the receiver's horizon): 0.1 % in those cases, 0.5 % at two texels where
        squares and points meet. GUARD divides by pi r^2 + A instead of pi r^2, as for a disk seen on its axis: no
        spikes, but dark by 13 %, 36 % and 65 % in those cases.
        Glossy lobes stay points.

    Returns
    -------
    (M, 3) float32 W/m2, zeros where nothing shines. Bitwise the same for any number of threads.

    Notes
    -----
    Ignores visibility between the point and the texels. Cost M N. Linear in flux; zero flux gives exactly zero.
    """
    position, normal = np.ascontiguousarray(position, np.float32), np.ascontiguousarray(normal, np.float32)
    table = np.ascontiguousarray(table, np.float32)
    area = None if area_m2 is None else np.ascontiguousarray(area_m2, np.float32)
    out = np.zeros((len(position), 3), np.float32)
    if area is None:
        _diffuse_points((len(position) + 1) // 2, position, normal, table, f32(eps2), out)
    else:
        _diffuse_squares(len(position), position, normal, table, area, f32(eps2), near_field == "EXACT", out)
    glossy = table[ALPHA2] < NO_LOBE
    if glossy.any():
        _glossy_points(len(position), position, normal, np.ascontiguousarray(table[:, glossy]), f32(eps2), out)
    return out


def thin_texels(table: np.ndarray, number: int, seed: int) -> np.ndarray:
    """At most `number` texels that stand for a (17, N) table: one of each of `number` equal runs, with the flux of the run.

    The one is drawn by `seed`, each texel with the same chance, so the expectation of every sum over texels stays.
    """
    count = table.shape[1]
    if count <= number:
        return table
    edges = np.arange(number) * (count / number)
    chosen = (edges + _jitter(number, seed) * (count / number)).astype(np.int64)
    thin = np.ascontiguousarray(table[:, np.minimum(chosen, count - 1)])
    for row in (DIFFUSE, GLOSSY):
        thin[row:row + 3] *= np.float32(count / number)
    return thin


@device_jit
def _jitter(number, seed):
    out = np.empty(number)
    for i in range(number):
        out[i] = uniform(i, seed, JITTER_STREAM)
    return out


def gather_polar(position: np.ndarray, normal: np.ndarray, column_px: np.ndarray, row_px: np.ndarray,
                 map_position: np.ndarray, map_normal: np.ndarray, map_flux: np.ndarray, radius_px: float, samples: int,
                 published: bool, wrap: bool, seed: int, *, rotate: bool = False, eps2: float = 0.0) -> np.ndarray:
    """Irradiance from polar samples around each point's projection into the light's view, as published.

    Sample i lies at (column + r xi_1 sin(2 pi xi_2), row + r xi_1 cos(2 pi xi_2)) with r = `radius_px`: dense near the
    projection, one pattern for all points (Dachsbacher and Stamminger 2005, section 3.3).

    Parameters
    ----------
    position, normal : (M, 3) float32
        Points in m and their unit normals.
    column_px, row_px : (M,) float32
        Where the points lie in the light's view, pixel centres at +0.5; NaN (behind the light) gathers nothing.
    map_position, map_normal, map_flux : (H, W, 3) float32
        The light's view: position m, unit normal, reflected diffuse flux W; texels of zero flux shine not.
    radius_px : float > 0
    samples : int >= 1
        400 in the paper.
    published : bool
        True weighs a sample by xi_1^2, scaled so that the weights sum to the disk's pi r^2 texels. The paper's weight is
        not the inverse of the density 1 / (2 pi xi_1 r^2): samples far from the projection count too much, and the mean
        of f = distance over the disk comes out as 3/4 r. False weighs by 2 pi r^2 xi_1 / samples, which is unbiased: 2/3 r.
    wrap : bool
        The view is equirectangular: columns go round; a sample beyond half a turn is left out, being another's twin.
    seed : int
        Shifts the pattern.
    rotate : bool
        Turn the pattern by another angle at each point: noise instead of bands.
    eps2 : float m2
        Added to the squared distance.

    Returns
    -------
    (M, 3) float32 W/m2. Samples outside the map contribute nothing. Bitwise the same for any number of threads.

    Notes
    -----
    Ignores visibility and glossy lobes, and all that lies farther than `radius_px` from the projection.
    """
    pattern = _polar_pattern(samples, float(radius_px), published, seed)
    out = np.zeros((len(position), 3), np.float32)
    arrays = position, normal, column_px, row_px, map_position, map_normal, map_flux
    _polar_points(len(position), *(np.ascontiguousarray(a, np.float32) for a in arrays), pattern, wrap, rotate, seed,
                  f32(eps2), out)
    return out


@device_jit
def _polar_pattern(samples, radius_px, published, seed):
    """(samples, 3) float32: column and row offset in px, and the number of texels that the sample stands for."""
    out = np.empty((samples, 3), np.float32)
    shift_u, shift_v = uniform(seed, 0, SHIFT_STREAM), uniform(seed, 1, SHIFT_STREAM)
    total = 0.0
    for i in range(samples):
        xi_1, xi_2 = r2_sequence(i, shift_u, shift_v)
        angle = 2 * math.pi * xi_2
        out[i, 0] = radius_px * xi_1 * math.sin(angle)
        out[i, 1] = radius_px * xi_1 * math.cos(angle)
        out[i, 2] = xi_1 * xi_1 if published else xi_1
        total += out[i, 2]
    area_px = math.pi * radius_px * radius_px
    scale = area_px / max(total, 1e-30) if published else 2 * area_px / samples
    for i in range(samples):
        out[i, 2] *= scale
    return out


# ---- all texels ----
# The inner loops take rows as slices: `table[row, j]` in a loop from a variable start costs numba a test of the sign of
# both indices, which stops LLVM from making vector code (0.25 against 1.5 G pairs/s a thread, 2.7 with two points a texel).
@pixel_jit
def _diffuse_points(begin, end, position, normal, table, eps2, out):
    for pair in range(begin, end):
        i, k = 2 * pair, min(2 * pair + 1, position.shape[0] - 1)       # the last of an odd number is done twice
        red, green, blue, red_k, green_k, blue_k = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for start in range(0, table.shape[1], RUN):
            run = slice(start, start + RUN)
            r, g, b, r_k, g_k, b_k = _diffuse_run(
                load(position, i), load(normal, i), load(position, k), load(normal, k), table[0, run], table[1, run],
                table[2, run], table[3, run], table[4, run], table[5, run], table[6, run], table[7, run], table[8, run],
                eps2)
            red, green, blue = red + r, green + g, blue + b
            red_k, green_k, blue_k = red_k + r_k, green_k + g_k, blue_k + b_k
        out[i, 0], out[i, 1], out[i, 2] = red, green, blue
        out[k, 0], out[k, 1], out[k, 2] = red_k, green_k, blue_k


@device_jit
def _diffuse_run(x, n, x_k, n_k, px, py, pz, nx, ny, nz, red, green, blue, eps2):
    """Sum over some texels at two points x and x_k; float32 on contiguous rows only."""
    floor = eps2 + MIN_DIST_SQ
    r, g, b, r_k, g_k, b_k = ZERO, ZERO, ZERO, ZERO, ZERO, ZERO
    for j in range(px.shape[0]):
        p, n_p = Vec3(px[j], py[j], pz[j]), Vec3(nx[j], ny[j], nz[j])
        d, d_k = sub(p, x), sub(p, x_k)
        inv, inv_k = ONE / (dot(d, d) + floor), ONE / (dot(d_k, d_k) + floor)
        w = max(dot(n, d), ZERO) * inv * max(-dot(n_p, d), ZERO) * inv
        w_k = max(dot(n_k, d_k), ZERO) * inv_k * max(-dot(n_p, d_k), ZERO) * inv_k
        r, g, b = r + w * red[j], g + w * green[j], b + w * blue[j]
        r_k, g_k, b_k = r_k + w_k * red[j], g_k + w_k * green[j], b_k + w_k * blue[j]
    return r * INV_PI, g * INV_PI, b * INV_PI, r_k * INV_PI, g_k * INV_PI, b_k * INV_PI


@pixel_jit
def _diffuse_squares(begin, end, position, normal, table, area, eps2, exact, out):
    for i in range(begin, end):
        x, n = load(position, i), load(normal, i)
        red, green, blue = 0.0, 0.0, 0.0
        for start in range(0, table.shape[1], RUN):
            run = slice(start, start + RUN)
            r, g, b, near = _far_run(
                x, n, table[0, run], table[1, run], table[2, run], table[3, run], table[4, run], table[5, run],
                table[6, run], table[7, run], table[8, run], area[run], eps2,
                NEAR_SQ if exact else -ONE, ZERO if exact else INV_PI)
            red, green, blue = red + r, green + g, blue + b
            if near > ZERO:
                r, g, b = _near_run(x, n, table, area, start, min(start + RUN, table.shape[1]))
                red, green, blue = red + r, green + g, blue + b
        out[i, 0], out[i, 1], out[i, 2] = red, green, blue


@device_jit
def _far_run(x, n, px, py, pz, nx, ny, nz, red, green, blue, area, eps2, near_sq, guard):
    """As `_diffuse_run`, without texels of squared distance below `near_sq` areas, whose number comes last."""
    floor = eps2 + MIN_DIST_SQ
    r, g, b, near = ZERO, ZERO, ZERO, ZERO
    for j in range(px.shape[0]):
        p, n_p = Vec3(px[j], py[j], pz[j]), Vec3(nx[j], ny[j], nz[j])
        d = sub(p, x)
        dist_sq = dot(d, d)
        is_near = ONE if dist_sq < near_sq * area[j] else ZERO
        inv, inv_guarded = ONE / (dist_sq + floor), ONE / (dist_sq + floor + guard * area[j])
        w = (ONE - is_near) * max(dot(n, d), ZERO) * inv * max(-dot(n_p, d), ZERO) * inv_guarded
        r, g, b, near = r + w * red[j], g + w * green[j], b + w * blue[j], near + is_near
    return r * INV_PI, g * INV_PI, b * INV_PI, near


@device_jit
def _near_run(x, n, table, area, start, end):
    """The texels that `_far_run` left out, as squares."""
    r, g, b = ZERO, ZERO, ZERO
    for j in range(start, end):
        d = sub(load_column(table, POSITION, j), x)
        if dot(d, d) < NEAR_SQ * area[j]:
            w = square_form_factor(d, load_column(table, NORMAL, j), n, math.sqrt(area[j])) / area[j]
            r += w * table[DIFFUSE, j]
            g += w * table[DIFFUSE + 1, j]
            b += w * table[DIFFUSE + 2, j]
    return r, g, b


@device_jit
def square_form_factor(d, n_emitter, n, size):
    """Share of a Lambertian square's radiosity that arrives as irradiance: Lambert's sum over its edges above the horizon.

    `d` leads from the receiver to the square's centre; the square has edges of length `size` along `tangent_frame` of its
    unit normal and shines on that side only; `n` is the receiver's unit normal.
    """
    if dot(n_emitter, d) >= ZERO:
        return ZERO
    u, v = tangent_frame(n_emitter)
    u, v = scaled(u, HALF * size), scaled(v, HALF * size)
    total = ZERO
    leaves, enters = Vec3(ZERO, ZERO, ZERO), Vec3(ZERO, ZERO, ZERO)
    is_cut = False
    a = along(along(d, u, -ONE), v, -ONE)
    for k in range(4):                          # corners --, +-, ++, -+
        b = along(along(d, u, ONE if k < 2 else -ONE), v, ONE if k == 1 or k == 2 else -ONE)
        if k == 3:
            b = along(along(d, u, -ONE), v, -ONE)
        height_a, height_b = dot(n, a), dot(n, b)
        if height_a > ZERO and height_b > ZERO:
            total += _edge_term(a, b, n)
        elif height_a > ZERO or height_b > ZERO:
            m = along(a, sub(b, a), height_a / (height_a - height_b))
            is_cut = True
            if height_a > ZERO:
                leaves = m
                total += _edge_term(a, m, n)
            else:
                enters = m
                total += _edge_term(m, b, n)
        a = b
    if is_cut:
        total += _edge_term(leaves, enters, n)
    return abs(total) * INV_TWO_PI


@device_jit
def _edge_term(a, b, n):
    """Angle between a and b, times the cosine between n and the normal of the plane that they span."""
    c = cross(a, b)
    size = length(c)
    if size > ZERO:
        return math.atan2(size, dot(a, b)) * dot(n, c) / size
    return ZERO


# ---- glossy lobes ----
@pixel_jit
def _glossy_points(begin, end, position, normal, table, eps2, out):
    for i in range(begin, end):
        x, n = load(position, i), load(normal, i)
        red, green, blue = 0.0, 0.0, 0.0
        for j in range(table.shape[1]):
            w = _glossy_weight(x, n, table, j, eps2)
            red, green, blue = red + w * table[GLOSSY, j], green + w * table[GLOSSY + 1, j], blue + w * table[GLOSSY + 2, j]
        out[i, 0] += f32(red)
        out[i, 1] += f32(green)
        out[i, 2] += f32(blue)


@device_jit
def _glossy_weight(x, n, table, j, eps2):
    """Irradiance at x for one watt of glossy flux of texel j, 1/m2."""
    d = sub(load_column(table, POSITION, j), x)
    n_texel = load_column(table, NORMAL, j)
    cos_x, cos_texel = dot(n, d), -dot(n_texel, d)
    if cos_x <= ZERO or cos_texel <= ZERO:
        return ZERO
    dist_sq = dot(d, d) + eps2 + MIN_DIST_SQ
    inv = ONE / math.sqrt(dist_sq)
    lobe = ggx_lobe(n_texel, load_column(table, TO_LIGHT, j), scaled(d, -inv), table[ALPHA2, j], table[F0, j])
    return lobe * cos_x * inv / dist_sq


# ---- the published sampling ----
@pixel_jit
def _polar_points(begin, end, position, normal, column, row, map_position, map_normal, map_flux, pattern, wrap, rotate, seed,
                  eps2, out):
    for i in range(begin, end):
        turn = uniform(i, seed, ROTATION_STREAM) if rotate else ZERO
        e = _polar_at_point(load(position, i), load(normal, i), column[i], row[i], map_position, map_normal, map_flux,
                            pattern, wrap, turn, eps2)
        out[i, 0], out[i, 1], out[i, 2] = e.x, e.y, e.z


@device_jit
def _polar_at_point(x, n, column, row, map_position, map_normal, map_flux, pattern, wrap, turn, eps2):
    height, width = map_flux.shape[0], map_flux.shape[1]
    cos_turn, sin_turn = f32(math.cos(2 * math.pi * turn)), f32(math.sin(2 * math.pi * turn))
    half_turn, floor = HALF * f32(width), eps2 + MIN_DIST_SQ
    r, g, b = ZERO, ZERO, ZERO
    for k in range(pattern.shape[0]):
        step_x = cos_turn * pattern[k, 0] - sin_turn * pattern[k, 1]
        s, t = column + step_x, row + sin_turn * pattern[k, 0] + cos_turn * pattern[k, 1]
        if wrap and abs(step_x) <= half_turn:
            s -= f32(width) * f32(math.floor(s / f32(width)))
        elif wrap:
            continue
        if not (s >= ZERO and t >= ZERO and s < f32(width) and t < f32(height)):
            continue                            # outside the map, or not a number
        j, i = np.uint64(s), np.uint64(t)       # unsigned: no test for indices from the end
        d = sub(load_pixel(map_position, i, j), x)
        inv = ONE / (dot(d, d) + floor)
        w = pattern[k, 2] * max(dot(n, d), ZERO) * inv * max(-dot(load_pixel(map_normal, i, j), d), ZERO) * inv
        r += w * map_flux[i, j, 0]
        g += w * map_flux[i, j, 1]
        b += w * map_flux[i, j, 2]
    return Vec3(r * INV_PI, g * INV_PI, b * INV_PI)
