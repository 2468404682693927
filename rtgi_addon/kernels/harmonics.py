"""Light on a grid in spherical harmonics of two bands, as light propagation volumes keep it.

A cell holds an intensity I(w) = sum_q c_q Y_q(w) (W/sr, four coefficients a colour) with Y = (C0, C1 x, C1 y, C1 z). In a
step each cell takes from its six neighbours what goes through the five of its own faces that the neighbour sees: the flux
Omega_f I(w_f) of a face of solid angle Omega_f around the direction w_f from the neighbour's centre is sent on as a cosine
lobe along that face's normal [1]_.

The flux of a cell is 2 sqrt(pi) c_0. Since 6 (Omega_front + 4 Omega_side) = 4 pi, a step without clamping keeps the sum of
all flux; clamping negative intensities to 0 adds 13.8 % to a cosine lobe in the first step.

References
----------
.. [1] Kaplanyan, Dachsbacher. Cascaded Light Propagation Volumes for Real-Time Indirect Illumination. I3D 2010.
"""

from __future__ import annotations

import math

import numpy as np

from .bvh import STACK, Bvh
from .jit import borrowed, device_jit, pixel_jit, scratch
from .light_grid import HALF, LightGrid, corner_weights, trilinear_weights
from .vec3 import ONE, ZERO, along, f32, load

C0, C1 = 1 / (2 * math.sqrt(math.pi)), math.sqrt(3 / math.pi) / 2
LOBE0, LOBE1 = math.sqrt(math.pi) / 2, math.sqrt(math.pi / 3)       # a clamped cosine along n is (LOBE0, LOBE1 n)
# the far face of a neighbour, a square of edge 1 seen from 1.5 edges away, and each of its four side faces, which share the
# rest of 4 pi / 6; the widely copied 0.4234413544 for SIDE is wrong in the fifth digit
FRONT = 4 * math.atan(0.25 / (1.5 * math.sqrt(1.5**2 + 0.5)))
SIDE = (4 * math.pi / 6 - FRONT) / 4

# what the sum of all steps without clamping is to be scaled by, so that light falls off as 1 / r^2: see docs/passes/lpv.md
READOUT = 1 / 4.8


def cosine_lobe(direction: np.ndarray) -> np.ndarray:
    """(..., 4) float64 coefficients of max(0, d . w) for unit directions d (..., 3)."""
    d = np.asarray(direction, np.float64)
    return np.concatenate([np.full(d.shape[:-1] + (1,), LOBE0), LOBE1 * d], -1)


def basis(direction: np.ndarray) -> np.ndarray:
    """(..., 4) float64 values of Y at unit directions (..., 3)."""
    d = np.asarray(direction, np.float64)
    return np.concatenate([np.full(d.shape[:-1] + (1,), C0), C1 * d], -1)


def face_table() -> np.ndarray:
    """(6, 5, 2, 4) float32: for steps along +x, -x, .. -z and the five faces, Y(w_f) and Omega_f / pi times the lobe.

    The far face's lobe takes what rounding to float32 adds to or takes from a step's flux: 6e-8, or 1e-6 in 16 steps.
    """
    out = np.empty((6, 5, 2, 4), np.float32)
    axes = [sign * np.eye(3)[a] for a in range(3) for sign in (1, -1)]
    for step, d in enumerate(axes):
        faces = [(d, d, FRONT)] + [((2 * d + e) / math.sqrt(5), e, SIDE) for e in axes if abs(e @ d) < 0.5]
        for f, (towards, normal, solid_angle) in enumerate(faces):
            out[step, f, 0], out[step, f, 1] = basis(towards), solid_angle / math.pi * cosine_lobe(normal)
    exact = out.astype(np.float64)
    kept = (exact[:, :, 0, 0] * exact[:, :, 1, 0]).sum()
    out[:, 0, 1, 0] -= ((kept - 1) / exact[:, 0, 0, 0].sum()).astype(np.float32)
    return out


def flux_of(state: np.ndarray) -> np.ndarray:
    """(3,) float64 W by colour of a state (3, 4, nx, ny, nz)."""
    return state[:, 0].sum((1, 2, 3), dtype=np.float64) * 2 * math.sqrt(math.pi)


# ---- injection ----
def inject(grid: LightGrid, position: np.ndarray, normal: np.ndarray, flux: np.ndarray) -> np.ndarray:
    """State (3, 4, nx, ny, nz) float32 of Lambertian texels at (N, 3) of `flux` (N, 3) W.

    Each is pushed half a cell off its surface and lands in one cell. Texels outside the grid are left out.
    """
    shape = grid.links.shape[1:]
    cell, is_inside = cells_of(grid, position + normal * np.float32(0.5) * grid.cell_m)
    lobe = cosine_lobe(normal[is_inside]) / math.pi
    out = np.empty((3, 4, math.prod(shape)), np.float32)
    for c in range(3):
        for q in range(4):
            out[c, q] = np.bincount(cell, flux[is_inside, c] * lobe[:, q], out.shape[2])
    return out.reshape(3, 4, *shape)


def cells_of(grid: LightGrid, position: np.ndarray, shape: tuple[int, ...] | None = None) -> tuple[np.ndarray, np.ndarray]:
    """(cell numbers (M,), is inside (N,) bool) of places (N, 3); the numbers are of those inside only."""
    shape = shape or grid.links.shape[1:]
    place = np.floor((position - grid.low) / grid.cell_m)
    is_inside = ((place >= 0) & (place < shape)).all(1)
    x, y, z = place[is_inside].astype(np.int64).T
    return (x * shape[1] + y) * shape[2] + z, is_inside


def fuzzy_blockers(grid: LightGrid, surfaces: list[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> np.ndarray:
    """(3, 4, nx, ny, nz) float32 on the faces towards the next cells along x, y and z: B(w), the chance that light ends.

    The geometry volume of [1]_: nodes at the cells' corners, half a cell off the grid of light. A surfel of normal n and
    area A (of `surfaces`: position (N, 3), normal (N, 3), area (N,) m2, one entry for each view) blocks A max(0, -n . w) /
    s^2 of what meets its front. Of several views of the same surface the one that fills a node most counts; a face takes
    the mean of its four corners.
    """
    shape = grid.links.shape[1:]
    nodes = tuple(n + 1 for n in shape)
    best, most = np.zeros((4, math.prod(nodes))), np.zeros(math.prod(nodes))
    for position, normal, area in surfaces:
        cell, is_inside = cells_of(grid, position + np.float32(0.5) * grid.cell_m, nodes)
        lobe = cosine_lobe(-normal[is_inside]) * (area[is_inside] / float(grid.cell_m) ** 2)[:, None]
        view = np.stack([np.bincount(cell, lobe[:, q], len(most)) for q in range(4)])
        fuller = view[0] > most
        best[:, fuller], most[fuller] = view[:, fuller], view[0, fuller]
    corner = best.reshape(4, *nodes)
    out = np.empty((3, 4, *shape), np.float32)
    for axis in range(3):
        u, v = (axis + 1) % 3 + 1, (axis + 2) % 3 + 1
        face = np.take(corner, range(1, nodes[axis]), axis + 1)
        for side in (u, v):
            n = face.shape[side]
            face = (np.take(face, range(n - 1), side) + np.take(face, range(1, n), side)) / 2
        out[axis] = face
    return out


# ---- propagation ----
@pixel_jit
def _propagate(begin, end, state, links, fuzzy, use_fuzzy, clamp, table, active, out, out_active, total):
    """One step: `out` from `state`, and `total` more by it. Rows along z without light around them cost nothing."""
    nx, ny, nz = links.shape[1], links.shape[2], links.shape[3]
    for row in range(begin, end):
        i, j = row // ny, row % ny
        out_active[i, j] = False
        for c in range(3):
            for q in range(4):
                out[c, q, i, j, :] = ZERO
        for step in range(6):
            axis, sign = step // 2, 1 - 2 * (step % 2)
            si, sj, sk = i, j, 0
            if axis == 0:
                si -= sign
            elif axis == 1:
                sj -= sign
            else:
                sk = sign
            if si < 0 or si >= nx or sj < 0 or sj >= ny or not active[si, sj]:
                continue
            out_active[i, j] = True
            first, last = max(0, sk), nz + min(0, sk)
            li, lj, lk = (si, sj, -1 if axis == 2 else 0) if sign > 0 else (i, j, 0)
            link = links[axis, li, lj]
            for c in range(3):
                a0, a1, a2, a3 = state[c, 0, si, sj], state[c, 1, si, sj], state[c, 2, si, sj], state[c, 3, si, sj]
                b0, b1, b2, b3 = out[c, 0, i, j], out[c, 1, i, j], out[c, 2, i, j], out[c, 3, i, j]
                u, v = (li, lj) if use_fuzzy else (0, 0)
                g0, g1, g2, g3 = fuzzy[axis, 0, u, v], fuzzy[axis, 1, u, v], fuzzy[axis, 2, u, v], fuzzy[axis, 3, u, v]
                for f in range(5):
                    y0, y1, y2, y3 = table[step, f, 0, 0], table[step, f, 0, 1], table[step, f, 0, 2], table[step, f, 0, 3]
                    m0, m1, m2, m3 = table[step, f, 1, 0], table[step, f, 1, 1], table[step, f, 1, 2], table[step, f, 1, 3]
                    for k in range(first, last):
                        s = k - sk
                        value = (y0 * a0[s] + y1 * a1[s] + y2 * a2[s] + y3 * a3[s]) * link[k + lk]
                        if clamp:
                            value = max(value, ZERO)
                        if use_fuzzy:
                            g = k + lk
                            value *= ONE - min(ONE, max(ZERO, y0 * g0[g] + y1 * g1[g] + y2 * g2[g] + y3 * g3[g]))
                        b0[k] += m0 * value
                        b1[k] += m1 * value
                        b2[k] += m2 * value
                        b3[k] += m3 * value
        if out_active[i, j]:
            for c in range(3):
                for q in range(4):
                    for k in range(nz):
                        total[c, q, i, j, k] += out[c, q, i, j, k]


def propagate(state: np.ndarray, grid: LightGrid, residual: float, most: int, *, clamp: bool = False,
              fuzzy: np.ndarray | None = None) -> tuple[np.ndarray, int, float]:
    """Carry light on until no more than the share `residual` of its flux is in motion, for at most `most` steps.

    Parameters
    ----------
    state : (3, 4, nx, ny, nz) float32
        As injected.
    grid : LightGrid
        Its links share what passes; all open for the published form.
    clamp : bool
        Take negative intensities as 0, as published: more flux comes out than went in.
    fuzzy : (3, 4, nx, ny, nz) float32, optional
        From `fuzzy_blockers`; not in the first step, in which surfaces would block their own light.

    Returns
    -------
    (sum of all states, the injected one among them; steps; share of flux still in motion).
    """
    total, out = state.copy(), np.empty_like(state)
    active = (state != 0).any((0, 1, 4))
    out_active, table = np.empty_like(active), face_table()
    blockers = np.zeros((3, 4, 1, 1, 1), np.float32) if fuzzy is None else fuzzy
    injected = float(flux_of(state).sum())
    left, steps = 1.0, 0
    while steps < most and left > residual and injected > 0:
        _propagate(active.size, state, grid.links, blockers, fuzzy is not None and steps > 0, clamp, table, active, out,
                   out_active, total)
        state, out = out, state if steps else np.empty_like(state)       # what the caller injected stays as it is
        active, out_active = out_active, active
        steps += 1
        left = float(flux_of(state).sum()) / injected
    return total, steps, left


# ---- irradiance ----
@device_jit
def _interpolated(total, i, j, k, w, a, c):
    """Coefficients of colour c at the corners' weights, into c[0:4]."""
    for q in range(4):
        c[q] = ZERO
    for b in range(8):
        if w[b] > ZERO:
            for q in range(4):
                c[q] += w[b] * total[a, q, i + (b & 1), j + (b >> 1 & 1), k + (b >> 2)]


@pixel_jit
def _irradiance(begin, end, position, normal, total, grid, bvh, offset_m, by_sight, damps, scale, out):
    grid, bvh = borrowed((grid, bvh))
    w, back, stack = np.empty(16, np.float32), np.empty(8, np.float32), scratch(STACK, np.int32)
    here, behind = np.empty(4, np.float32), np.empty(4, np.float32)
    for m in range(begin, end):
        p, n = load(position, m), load(normal, m)
        if by_sight:
            i, j, k = corner_weights(p, n, grid, bvh, stack, offset_m, w)
        else:
            i, j, k = trilinear_weights(along(p, n, HALF * grid.cell_m), grid, w)
        x, y, z = trilinear_weights(along(p, n, -HALF * grid.cell_m), grid, back)
        for a in range(3):
            _interpolated(total, i, j, k, w, a, here)
            value = f32(LOBE0) * here[0] - f32(LOBE1) * (n.x * here[1] + n.y * here[2] + n.z * here[3])
            if damps:
                _interpolated(total, x, y, z, back, a, behind)
                value *= _damping(here, behind)
            out[m, a] = scale * max(value, ZERO)


@device_jit
def _damping(here, behind):
    """Cosine between the light's direction and its change from behind the surface to its front: 0 if it came through."""
    product, of_light, of_change = 0.0, 0.0, 0.0         # squares of faint light are below float32
    for q in range(1, 4):
        light = np.float64(here[q])
        change = light - behind[q]
        product += light * change
        of_light += light * light
        of_change += change * change
    both = of_light * of_change
    return f32(max(product, 0.0) / math.sqrt(both)) if both > 1e-200 else ONE


def irradiance(position: np.ndarray, normal: np.ndarray, total: np.ndarray, grid: LightGrid, bvh: Bvh, offset_m: float, *,
               by_sight: bool, damps: bool) -> np.ndarray:
    """(M, 3) float32 W/m2 at surface points (M, 3) with unit normals (M, 3), never negative; 0 outside the grid.

    The intensity around a point is taken to come from half a cell away: E = 4 / s^2 sum_q c_q lobe_q(-n) [1]_. `by_sight`
    shares a point out by `corner_weights` and scales by READOUT; else plain trilinear interpolation half a cell off the
    surface, and, with `damps`, darkened where light changes against its own direction between the two sides of the surface.
    """
    out = np.zeros((len(position), 3), np.float32)
    scale = 4 / float(grid.cell_m) ** 2 * (READOUT if by_sight else 1.0)
    _irradiance(len(position), np.ascontiguousarray(position, np.float32), np.ascontiguousarray(normal, np.float32), total,
                grid, bvh, f32(offset_m), by_sight, damps, f32(scale), out)
    return out
