"""Light on a grid along a set of fixed directions: injection, one sweep that carries it to the end, irradiance.

Each face of a cube is cut into n x n patches of directions (Carlson and Lathrop's discrete ordinates, with the 48-fold
symmetry of the grid). Light of a patch moves plane by plane along the axis of its face; in each step it shifts sideways by
the patch's slope and spreads by a quadratic B-spline. What a sweep carries is flux: a cell passes on all that it has, so
flux is neither made nor lost between a source and the wall or border where it ends.
"""

from __future__ import annotations

import functools
import math

import numpy as np

from .brdf import albedo_table, fresnel, ggx_lobe, lobe_albedos, lobe_reflectance
from .bvh import STACK, Bvh
from .clusters import ALPHA2, DIFFUSE, F0, GLOSSY, NO_LOBE, NORMAL, POSITION, TO_LIGHT
from .jit import borrowed, device_jit, pixel_jit, scratch
from .light_grid import RAMP, LightGrid, seen_cells, trilinear_weights
from .vec3 import ONE, ZERO, Vec3, dot, f32, load, load_column

HALF = f32(0.5)

SPREAD = 0.25               # variance (cells squared) that a step along an axis adds to each side: the least that is even
                            # for every slope, so that light does not gather in the directions where it spreads least
DIAGONAL = 0.35             # how much less light spreads along the cube's diagonals, where a step is long: fitted to 1/r^2
TAPS = 5                    # a step moves light by -2 to 2 cells to the side
GHOST = 2                   # so that much of a grid's border is told by the coarser grid around it
LEAST_SHARE = f32(1e-4)     # of a centre that is seen: where it is the only one, it takes all
NEXT_PLANE = f32(0.01)      # cells: the centres of a plane nearer to the texel may not count as in front of it
ON_PLANE = f32(2e-3)        # cells: a point nearer to a plane of centres lies on it, twice what counts as in front of it
SUBDIVISION = 32            # midpoints an edge of a patch in the integrals over its directions


@functools.cache
def ordinates(n: int) -> tuple[np.ndarray, np.ndarray]:
    """(directions (n n, 3), solid angles (n n,)) float64 of one face of the cube: its sides' components and its axis's.

    `n` is even. A direction is the mean over its patch; patches are cut at equal angles and come by quadrants: both sides
    negative, the second positive, the first, both. Solid angles sum to 4 pi / 6.
    """
    edge = np.tan(np.linspace(-1, 1, n + 1) * math.pi / 4)
    middle = (np.arange(n * SUBDIVISION) + 0.5) / SUBDIVISION
    place = edge[:-1].repeat(SUBDIVISION) + np.diff(edge).repeat(SUBDIVISION) * (middle - np.floor(middle))
    x, y = np.meshgrid(place, place, indexing="ij")
    area = np.outer(np.diff(edge).repeat(SUBDIVISION), np.diff(edge).repeat(SUBDIVISION)) / SUBDIVISION**2
    r2 = 1 + x * x + y * y
    solid_angle = area / r2**1.5
    vectors = np.stack([x, y, np.ones_like(x)], -1) / np.sqrt(r2)[..., None] * solid_angle[..., None]

    def over_patches(a: np.ndarray) -> np.ndarray:
        patches = a.reshape(n, SUBDIVISION, n, SUBDIVISION, *a.shape[2:]).sum((1, 3))
        quadrants = patches.reshape(2, n // 2, 2, n // 2, *a.shape[2:]).swapaxes(1, 2)
        return quadrants.reshape(n * n, *a.shape[2:])

    weight, direction = over_patches(solid_angle), over_patches(vectors)
    return (direction / np.linalg.norm(direction, axis=1, keepdims=True), weight * (4 * math.pi / 6 / weight.sum()))


def directions_ws(n: int) -> np.ndarray:
    """(6, 3, n n) float32 unit directions in which light moves: groups +x, -x, +y, -y, +z, -z; components first."""
    local, _ = ordinates(n)
    out = np.empty((6, 3, n * n), np.float32)
    for group in range(6):
        axis, sign = group // 2, 1 - 2 * (group % 2)
        out[group, (axis + 1) % 3], out[group, (axis + 2) % 3] = local[:, 0], local[:, 1]
        out[group, axis] = sign * local[:, 2]
    return out


def step_weights(n: int) -> np.ndarray:
    """(2, TAPS + 1, n n) float64: shares of a patch's flux that a step moves by -2 to 2 cells, to each of the two sides.

    The last row is the share that moves both ways by one cell.

    With slope m and b = round(m), f = m - b the shares of b - 1, b and b + 1 have the mean m and the variance v:
    (v + f f - f) / 2, 1 - v - f f, (v + f f + f) / 2. Spreading is to be the same in all directions seen across the
    direction d, v = SPREAD / (d_axis (1 - d_side^2)) a step; none is negative for |f| (1 - |f|) <= v <= 1 - f f.
    """
    d, _ = ordinates(n)
    out = np.zeros((2, TAPS + 1, n * n))
    less = 1 - DIAGONAL * 27 * (d[:, 0] * d[:, 1] * d[:, 2]) ** 2
    for side in range(2):
        m = d[:, side] / d[:, 2]
        b = np.floor(m + 0.5)
        f = m - b
        v = np.clip(less * SPREAD / (d[:, 2] * (1 - d[:, side] ** 2)), np.abs(f) * (1 - np.abs(f)), 1 - f * f)
        at = b.astype(int) + 2
        lane = np.arange(n * n)
        for offset, share in ((-1, (v + f * f - f) / 2), (0, 1 - v - f * f), (1, (v + f * f + f) / 2)):
            out[side, at + offset, lane] = share
        out[side, TAPS] = np.minimum(out[side, 1], out[side, 3])
    return out


def empty_flux(n: int, shape: tuple[int, int, int]) -> np.ndarray:
    """(6, nx ny nz, 3 n n) float32 zeros: flux W by group of directions and cell; then by quadrant, colour and direction."""
    return np.zeros((6, math.prod(shape), 3 * n * n), np.float32)


# ---- injection ----
@device_jit
def _cosine_lobe(lobe, n, direction, solid_angle):
    """Shares of a Lambertian surface's flux by direction; they add up to 1."""
    whole = ZERO
    for g in range(6):
        for d in range(solid_angle.shape[0]):
            cosine = n.x * direction[g, 0, d] + n.y * direction[g, 1, d] + n.z * direction[g, 2, d]
            lobe[g, d] = max(cosine, ZERO) * solid_angle[d]
            whole += lobe[g, d]
    for g in range(6):
        for d in range(solid_angle.shape[0]):
            lobe[g, d] /= max(whole, f32(1e-6))


@device_jit
def _glossy_lobe(lobe, n, to_light, alpha2, f0, direction, solid_angle, albedos, least_alpha):
    """Shares by direction of what a glossy texel table entry reflects; they add up to 1 / the gain that is in its flux."""
    cos_light = min(max(dot(n, to_light), f32(0.02)), f32(0.999))
    flat, rise = lobe_albedos(albedos, cos_light, math.sqrt(min(alpha2, ONE)))
    reflected = lobe_reflectance(flat, rise, f0) / fresnel(cos_light, f0)
    wide, whole = min(max(alpha2, least_alpha * least_alpha), ONE), ZERO
    for g in range(6):
        for d in range(solid_angle.shape[0]):
            out = Vec3(direction[g, 0, d], direction[g, 1, d], direction[g, 2, d])
            lobe[g, d] = ggx_lobe(n, to_light, out, wide, f0) * solid_angle[d] if dot(n, out) > ZERO else ZERO
            whole += lobe[g, d]
    for g in range(6):
        for d in range(solid_angle.shape[0]):
            lobe[g, d] *= reflected / max(whole, f32(1e-6))


@pixel_jit
def _prepare(begin, end, table, grid, bvh, offset_m, direction, solid_angle, albedos, least_alpha, diffuse, glossy, corner,
             seen):
    grid, bvh = borrowed((grid, bvh))
    stack = scratch(STACK, np.int32)
    for t in range(begin, end):
        n = load_column(table, NORMAL, t)
        corner[t, 0], corner[t, 1], corner[t, 2] = seen_cells(load_column(table, POSITION, t), n, grid, bvh, stack,
                                                              offset_m, seen[t])
        _cosine_lobe(diffuse[t], n, direction, solid_angle)
        if table[ALPHA2, t] < NO_LOBE:
            _glossy_lobe(glossy[t], n, load_column(table, TO_LIGHT, t), table[ALPHA2, t], table[F0, t], direction,
                         solid_angle, albedos, least_alpha)


@pixel_jit
def _inject(begin, end, flux, table, grid, local, diffuse, glossy, corner, seen):
    shape = (grid.links.shape[1], grid.links.shape[2], grid.links.shape[3])
    stride, step = (shape[1] * shape[2], shape[2], 1), (16, 4, 1)
    inv = ONE / grid.cell_m
    lanes, quadrant = local.shape[0], local.shape[0] // 4
    for g in range(begin, end):                          # each group has its own part of the flux: adding up is no race
        a, sign = g // 2, 1 - 2 * (g % 2)
        u, v = (a + 1) % 3, (a + 2) % 3
        for t in range(table.shape[1]):
            x_a = (table[POSITION + a, t] - grid.low[a]) * inv - HALF
            x_u = (table[POSITION + u, t] - grid.low[u]) * inv - HALF
            x_v = (table[POSITION + v, t] - grid.low[v]) * inv - HALF
            n_a, n_u, n_v = table[NORMAL + a, t], table[NORMAL + u, t], table[NORMAL + v, t]
            plane = int(math.ceil(x_a)) if sign > 0 else int(math.floor(x_a))
            if abs(f32(plane) - x_a) < NEXT_PLANE:
                plane += sign
            if plane < 0 or plane >= shape[a]:
                continue
            way = abs(f32(plane) - x_a)
            has_gloss = table[ALPHA2, t] < NO_LOBE
            for d in range(lanes):
                power = diffuse[t, g, d] + (glossy[t, g, d] if has_gloss else ZERO)
                if power <= ZERO:
                    continue
                p_u, p_v = x_u + way * local[d, 0] / local[d, 2], x_v + way * local[d, 1] / local[d, 2]
                c_u, c_v = int(math.floor(p_u)), int(math.floor(p_v))
                b_a, b_u, b_v = plane - corner[t, a], c_u - corner[t, u], c_v - corner[t, v]
                if b_a < 0 or b_a > 3 or b_u < 0 or b_u > 2 or b_v < 0 or b_v > 2:
                    continue                     # a texel beside the grid
                b = b_a * step[a] + b_u * step[u] + b_v * step[v]
                f_u, f_v = p_u - f32(c_u), p_v - f32(c_v)
                front = n_a * (f32(plane) - x_a) + n_u * (f32(c_u) - x_u) + n_v * (f32(c_v) - x_v)
                w00 = _share(seen[t, b], (ONE - f_u) * (ONE - f_v), front)
                w10 = _share(seen[t, b + step[u]], f_u * (ONE - f_v), front + n_u)
                w01 = _share(seen[t, b + step[v]], (ONE - f_u) * f_v, front + n_v)
                w11 = _share(seen[t, b + step[u] + step[v]], f_u * f_v, front + n_u + n_v)
                whole = w00 + w10 + w01 + w11
                if whole <= ZERO:
                    continue
                c = plane * stride[a] + c_u * stride[u] + c_v * stride[v]
                for colour in range(3):
                    power = table[DIFFUSE + colour, t] * diffuse[t, g, d]
                    if has_gloss:
                        power += table[GLOSSY + colour, t] * glossy[t, g, d]
                    power, to = power / whole, (d // quadrant * 3 + colour) * quadrant + d % quadrant
                    if w00 > ZERO:
                        flux[g, c, to] += power * w00
                    if w10 > ZERO:
                        flux[g, c + stride[u], to] += power * w10
                    if w01 > ZERO:
                        flux[g, c + stride[v], to] += power * w01
                    if w11 > ZERO:
                        flux[g, c + stride[u] + stride[v], to] += power * w11


@device_jit
def _share(is_seen, weight, front):
    return max(weight, LEAST_SHARE) * min(ONE, RAMP * front) if is_seen else ZERO


def inject(flux: np.ndarray, n: int, table: np.ndarray, grid: LightGrid, bvh: Bvh, offset_m: float) -> None:
    """In place: add the light of a texel table (17, N, rows as in `clusters`).

    Light leaves a texel where it lies and is handed to the next plane of cell centres that it meets, bilinearly among those
    centres that the texel sees. Pushing texels half a cell off their surface, as published, brings all surfaces nearer to
    each other. What sees no centre ends there: something stands within a cell of it. A Lambertian lobe keeps its flux
    exactly; glossy lobes sharper than a patch of directions are widened to it, their flux is what the texel reflects.
    """
    local, solid_angle = ordinates(n)
    table, number = np.ascontiguousarray(table, np.float32), table.shape[1]
    solid_angle = solid_angle.astype(np.float32)
    diffuse, glossy = np.empty((number, 6, n * n), np.float32), np.empty((number, 6, n * n), np.float32)
    corner, seen = np.empty((number, 3), np.int64), np.empty((number, 64), np.bool_)
    _prepare(table.shape[1], table, grid, bvh, f32(offset_m), directions_ws(n), solid_angle, albedo_table(),
             f32(math.pi / (4 * n)), diffuse, glossy, corner, seen)
    _inject(6, flux, table, grid, local.astype(np.float32), diffuse, glossy, corner, seen)


# ---- sweep ----
@pixel_jit
def _sweep(begin, end, flux, links, step, ghost):
    shape = (links.shape[1], links.shape[2], links.shape[3])
    stride = (shape[1] * shape[2], shape[2], 1)
    open_to = links.reshape(3, -1)
    for group in range(begin, end):
        a = group // 2
        u, v = (a + 1) % 3, (a + 2) % 3
        n_a, n_u, n_v, d_a, d_u, d_v = shape[a], shape[u], shape[v], stride[a], stride[u], stride[v]
        f = flux[group]
        shifted = np.empty((n_u * n_v, f.shape[1]), np.float32)
        for p in range(max(ghost, 1), n_a - ghost):
            if group % 2 == 0:
                here, before = p * d_a, (p - 1) * d_a
            else:
                here, before = (n_a - 1 - p) * d_a, (n_a - p) * d_a
            for i in range(ghost, n_u - ghost):
                for j in range(n_v):
                    c = before + i * d_u + j * d_v
                    shifted[i * n_v + j, :] = ZERO
                    _move(f, c, d_u, i, n_u, open_to[u], c, d_u, step[0], ONE, shifted, i * n_v + j)
            for i in range(ghost, n_u - ghost):
                for j in range(ghost, n_v - ghost):
                    place = i * d_u + j * d_v
                    gate = open_to[a, min(here, before) + place]     # the link belongs to the lower of the two cells
                    if gate > ZERO:
                        _move(shifted, i * n_v + j, 1, j, n_v, open_to[v], before + place, d_v, step[1], gate, f,
                              here + place)


@device_jit
def _move(source, c, stride, i, number, links, link, link_stride, step, gate, target, at):
    """Add what a cell gets when flux moves along one side: from itself and two cells on either hand, each by open links.

    `c` is the cell in `source` and i its place of `number` along the side; `link` is its place among the links.
    """
    l1 = links[link - link_stride] if i > 0 else ZERO
    l2 = l1 * links[link - 2 * link_stride] if i > 1 else ZERO
    r1 = links[link] if i < number - 1 else ZERO
    r2 = r1 * links[link + link_stride] if i < number - 2 else ZERO
    # spreading sends the same share both ways through a link; where it is closed that share stays
    closed = gate * ((ONE - l1 if i > 0 else ZERO) + (ONE - r1 if i < number - 1 else ZERO))
    l1, l2, r1, r2 = gate * l1, gate * l2, gate * r1, gate * r2
    here, to = source[c], target[at]
    a, b = source[c - stride if i > 0 else c], source[c - 2 * stride if i > 1 else c]
    x, y = source[c + stride if i < number - 1 else c], source[c + 2 * stride if i < number - 2 else c]
    w_2, w_1, w0, w1, w2, both = step[0], step[1], step[2], step[3], step[4], step[5]
    for d in range(here.shape[0]):
        to[d] += ((gate * w0[d] + closed * both[d]) * here[d] + w1[d] * l1 * a[d] + w2[d] * l2 * b[d]
                  + w_1[d] * r1 * x[d] + w_2[d] * r2 * y[d])


def sweep(flux: np.ndarray, grid: LightGrid, n: int, ghost: int = 0) -> None:
    """In place: carry injected flux through the grid until all of it has met a closed link or left by the border.

    Afterwards a cell holds all flux that passed it. At a closed link light ends; only the share that spreading would send
    back and forth through it stays where it is, so that a wall takes what arrives at it and no more. The `ghost` outermost
    layers of cells are not touched: what they hold (`fill_ghosts`) flows in.
    """
    step = step_weights(n).reshape(2, TAPS + 1, 4, 1, -1).repeat(3, 3).reshape(2, TAPS + 1, -1)
    _sweep(6, flux, grid.links, step.astype(np.float32), ghost)


@pixel_jit
def _fill_ghosts(begin, end, flux, grid, outer_flux, outer, ghost):
    nx, ny, nz = grid.links.shape[1], grid.links.shape[2], grid.links.shape[3]
    my, mz = outer.links.shape[2], outer.links.shape[3]
    ratio = grid.cell_m / outer.cell_m
    for i in range(begin, end):
        w = np.empty(8, np.float32)
        for j in range(ny):
            for k in range(nz):
                if min(i, nx - 1 - i) >= ghost and min(j, ny - 1 - j) >= ghost and min(k, nz - 1 - k) >= ghost:
                    continue
                place = Vec3(grid.low[0] + (f32(i) + HALF) * grid.cell_m, grid.low[1] + (f32(j) + HALF) * grid.cell_m,
                             grid.low[2] + (f32(k) + HALF) * grid.cell_m)
                p, q, r = trilinear_weights(place, outer, w)
                to = (i * ny + j) * nz + k
                for g in range(6):
                    for d in range(flux.shape[2]):
                        flux[g, to, d] = ZERO
                    for b in range(8):
                        if w[b] > ZERO:
                            source = outer_flux[g, ((p + (b & 1)) * my + q + (b >> 1 & 1)) * mz + r + (b >> 2)]
                            share = w[b] * ratio * ratio
                            for d in range(flux.shape[2]):
                                flux[g, to, d] += share * source[d]


def fill_ghosts(flux: np.ndarray, grid: LightGrid, outer_flux: np.ndarray, outer: LightGrid) -> None:
    """In place: give the two outermost layers of cells the radiance that a swept, coarser grid around this one has there."""
    _fill_ghosts(grid.links.shape[1], flux, grid, outer_flux, outer, GHOST)


# ---- irradiance ----
@device_jit
def _add_quadrant(light, x, n, corner, seen, grid, flux, g, first, lobe, mean, slope_u, slope_v):
    """Add to `light` what arrives at the place x (cells) in one quadrant of a group, kept from `first` on.

    The quadrant is followed back to the planes of centres before and behind x, where its flux lies between four cells. Those
    that x does not see do not count; returns whether any did. `mean` is scratch.
    """
    a, sign = g // 2, 1 - 2 * (g % 2)
    u, v = (a + 1) % 3, (a + 2) % 3
    ny, nz = grid.links.shape[2], grid.links.shape[3]
    stride, step = (ny * nz, nz, 1), (16, 4, 1)
    count = lobe.shape[0]
    for d in range(3 * count):
        mean[d] = ZERO
    # a surface that lies on a plane of centres has none of them in front: it is told by the plane before
    before = int(math.floor(x[a] - ON_PLANE)) if sign > 0 else int(math.ceil(x[a] + ON_PLANE))
    whole = ZERO
    for behind in range(2):
        plane = before + sign * behind
        way = f32(sign) * (x[a] - f32(plane))    # along the axis from the plane to x
        p_u, p_v = x[u] - way * slope_u, x[v] - way * slope_v
        c_u, c_v = int(math.floor(p_u)), int(math.floor(p_v))
        b_a, b_u, b_v = plane - corner[a], c_u - corner[u], c_v - corner[v]
        if b_a < 0 or b_a > 3 or b_u < 0 or b_u > 2 or b_v < 0 or b_v > 2:
            continue
        b = b_a * step[a] + b_u * step[u] + b_v * step[v]
        f_u, f_v = p_u - f32(c_u), p_v - f32(c_v)
        front = n[a] * (f32(plane) - x[a]) + n[u] * (f32(c_u) - x[u]) + n[v] * (f32(c_v) - x[v])
        if front + max(n[u], ZERO) + max(n[v], ZERO) <= ZERO:
            continue                             # all four lie behind the surface
        for q in range(4):
            s, t = q & 1, q >> 1
            w = max(ONE - abs(way), LEAST_SHARE) * _share(seen[b + s * step[u] + t * step[v]], (f_u if s else ONE - f_u)
                                          * (f_v if t else ONE - f_v), front + f32(s) * n[u] + f32(t) * n[v])
            if w > ZERO:
                row = flux[g, plane * stride[a] + (c_u + s) * stride[u] + (c_v + t) * stride[v], first:first + 3 * count]
                whole += w
                for d in range(3 * count):
                    mean[d] += w * row[d]
    if whole <= ZERO:
        return False
    for d in range(count):
        share = lobe[d] / whole
        light[0] += share * mean[d]
        light[1] += share * mean[count + d]
        light[2] += share * mean[2 * count + d]
    return True


@pixel_jit
def _irradiance(begin, end, position, normal, flux, grid, bvh, offset_m, direction, solid_angle, axis_cosine, slope, out):
    grid, bvh = borrowed((grid, bvh))
    quadrant = solid_angle.shape[0] // 4
    inv = ONE / grid.cell_m
    stack, seen, light = scratch(STACK, np.int32), np.empty(64, np.bool_), np.empty(3, np.float32)
    x, n, corner = np.empty(3, np.float32), np.empty(3, np.float32), np.empty(3, np.int64)
    lobe, mean = np.empty(quadrant, np.float32), np.empty(3 * quadrant, np.float32)
    for m in range(begin, end):
        p = load(position, m)
        corner[0], corner[1], corner[2] = seen_cells(p, load(normal, m), grid, bvh, stack, offset_m, seen)
        for a in range(3):
            x[a], n[a], light[a] = (position[m, a] - grid.low[a]) * inv - HALF, normal[m, a], ZERO
        whole = ZERO
        for g in range(6):
            for q in range(4):
                here = ZERO
                for d in range(quadrant):
                    e = q * quadrant + d
                    along = n[0] * direction[g, 0, e] + n[1] * direction[g, 1, e] + n[2] * direction[g, 2, e]
                    cosine = max(-along, ZERO)
                    lobe[d] = cosine / axis_cosine[e]
                    here += cosine * solid_angle[e]
                if here > ZERO and _add_quadrant(light, x, n, corner, seen, grid, flux, g, 3 * q * quadrant, lobe,
                                                 mean, slope[q, 0], slope[q, 1]):
                    whole += here
        if whole > ZERO:
            for a in range(3):
                out[m, a] = light[a] * inv * inv * f32(math.pi) / whole


def irradiance(position: np.ndarray, normal: np.ndarray, flux: np.ndarray, grid: LightGrid, n: int, bvh: Bvh,
               offset_m: float) -> np.ndarray:
    """(M, 3) float32 W/m2 at surface points (M, 3) with unit normals (M, 3) after a sweep; 0 outside the grid.

    Radiance along d in a cell is flux / (solid angle x cell's area x d_axis). Light is read where it came from: each
    quadrant of a group at its own place in the planes of cells around the point, without a push off the surface. The sum
    over cosine x solid angle is scaled to pi for even radiance, whatever the normal and however many directions the point
    sees.
    """
    local, weight = ordinates(n)
    slope = (local[:, :2] / local[:, 2:] * weight[:, None]).reshape(4, -1, 2).sum(1) / weight.reshape(4, -1).sum(1)[:, None]
    out = np.zeros((len(position), 3), np.float32)
    _irradiance(len(position), np.ascontiguousarray(position, np.float32), np.ascontiguousarray(normal, np.float32), flux,
                grid, bvh, f32(offset_m), directions_ws(n), weight.astype(np.float32), local[:, 2].astype(np.float32),
                slope.astype(np.float32), out)
    return out


def mean_radiance(flux: np.ndarray, n: int, cell_area_m2: float) -> np.ndarray:
    """(cells, 3) float32 W/(m2 sr): radiance of each cell after a sweep, the mean over all directions."""
    per_flux = 1 / (ordinates(n)[0][:, 2] * 4 * math.pi * cell_area_m2)
    light = flux.reshape(6, -1, 4, 3, n * n // 4).sum(0)
    return np.einsum("mqcd,qd->mc", light, per_flux.reshape(4, -1)).astype(np.float32)
