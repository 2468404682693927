"""Light on grids in float64, cell by cell: slow, and written as light moves, not as the kernels gather it.

Grids of light are [x, y, z]; links[a, x, y, z] lets light pass from a cell to its next one along axis a.
"""

from __future__ import annotations

import itertools
import math

import numpy as np

AXES = [(axis, sign) for axis in range(3) for sign in (1, -1)]


# ---- directions ----
def patch(n: int, row: int, column: int, samples: int = 64) -> tuple[np.ndarray, float]:
    """(mean direction, solid angle) of a patch of a cube's face around +z, by midpoints."""
    edge = np.tan(np.linspace(-math.pi / 4, math.pi / 4, n + 1))
    (x0, x1), (y0, y1) = edge[row:row + 2], edge[column:column + 2]
    x, y = np.meshgrid(x0 + (x1 - x0) * (np.arange(samples) + 0.5) / samples,
                       y0 + (y1 - y0) * (np.arange(samples) + 0.5) / samples, indexing="ij")
    r = np.sqrt(1 + x * x + y * y)
    weight = (x1 - x0) * (y1 - y0) / samples**2 / r**3
    mean = np.array([(x / r * weight).sum(), (y / r * weight).sum(), (1 / r * weight).sum()])
    return mean / np.linalg.norm(mean), float(weight.sum())


def face_set(n: int) -> tuple[np.ndarray, np.ndarray]:
    """All patches of a face, by quadrants: low rows and columns first, then low rows and high columns."""
    half = n // 2
    places = [(half * i + row, half * j + column) for i, j in itertools.product(range(2), repeat=2)
              for row, column in itertools.product(range(half), repeat=2)]
    patches = [patch(n, row, column) for row, column in places]
    return np.array([d for d, _ in patches]), np.array([w for _, w in patches])


def turned(local: np.ndarray, axis: int, sign: int) -> np.ndarray:
    """A direction of the face around +z as one of the face around an axis."""
    out = np.empty(3)
    out[(axis + 1) % 3], out[(axis + 2) % 3], out[axis] = local[0], local[1], sign * local[2]
    return out


def side_shares(local: np.ndarray, side: int) -> dict[int, float]:
    """Offset in cells: share of the flux that a step along the axis moves by it. Three points with a mean and a variance."""
    slope = local[side] / local[2]
    nearest = math.floor(slope + 0.5)
    rest = slope - nearest
    variance = 0.25 * (1 - 0.35 * 27 * np.prod(local) ** 2) / (local[2] * (1 - local[side] ** 2))
    variance = min(max(variance, abs(rest) * (1 - abs(rest))), 1 - rest * rest)
    return {nearest - 1: (variance + rest * rest - rest) / 2, nearest: 1 - variance - rest * rest,
            nearest + 1: (variance + rest * rest + rest) / 2}


def passes(links: np.ndarray, axis: int, cell: tuple[int, ...], offset: int) -> float:
    """What gets from a cell to another one `offset` cells on along an axis; 1 beyond the border."""
    out, at = 1.0, list(cell)
    for _ in range(abs(offset)):
        lower = at[axis] if offset > 0 else at[axis] - 1
        if not (0 <= lower < links.shape[1 + axis] - 1):
            return out
        at[axis] = lower
        out *= links[(axis, *at)]
        at[axis] = lower + 1 if offset > 0 else lower
    return out


def moved_to_a_side(plane: dict, links: np.ndarray, axis: int, shares: dict[int, float]) -> tuple[dict, float, float]:
    """(cells' flux, left by the border, ended at walls) of a plane of cells whose flux spreads along one side."""
    out, left, ended = {}, 0.0, 0.0
    both_ways = min(shares.get(-1, 0.0), shares.get(1, 0.0))
    number = links.shape[1 + axis]
    for cell, flux in plane.items():
        for offset, share in shares.items():
            open_share = passes(links, axis, cell, offset)
            target = list(cell)
            target[axis] += offset
            if not 0 <= target[axis] < number:
                left += flux * share * open_share
            else:
                out[tuple(target)] = out.get(tuple(target), 0.0) + flux * share * open_share
            ended += flux * share * (1 - open_share)
        for offset in (-1, 1):                   # what both sides of a closed link would swap stays where it is
            if 0 <= cell[axis] + offset < number:
                stays = flux * both_ways * (1 - passes(links, axis, cell, offset))
                out[cell] = out.get(cell, 0.0) + stays
                ended -= stays
    return out, left, ended


def swept(source: np.ndarray, links: np.ndarray, local: np.ndarray, axis: int, sign: int) -> tuple[np.ndarray, float, float]:
    """(flux that passes each cell, flux that left the grid, flux that ended at walls) of one direction's sources."""
    shape, flux = source.shape, source.astype(np.float64).copy()
    order = range(shape[axis]) if sign > 0 else range(shape[axis] - 1, -1, -1)
    left = ended = 0.0
    for place in order:
        plane = {cell: flux[cell] for cell in np.ndindex(*shape) if cell[axis] == place and flux[cell]}
        for side in (0, 1):
            plane, gone, stopped = moved_to_a_side(plane, links, (axis + 1 + side) % 3, side_shares(local, side))
            left, ended = left + gone, ended + stopped
        for cell, value in plane.items():
            target = list(cell)
            target[axis] += sign
            if not 0 <= target[axis] < shape[axis]:
                left += value
                continue
            through = passes(links, axis, cell, sign)
            flux[tuple(target)] += value * through
            ended += value * (1 - through)
    return flux, left, ended


def injected(position: np.ndarray, normal: np.ndarray, power: float, n: int, shape: tuple[int, ...]) -> np.ndarray:
    """(6, n n, *shape) flux of one Lambertian texel at a place in cells (centres at whole numbers) in an empty grid.

    Each direction goes on to the next plane of centres and is shared out bilinearly among those in front of the texel's
    plane; a centre nearer to it than a quarter of a cell counts less.
    """
    local, solid_angle = face_set(n)
    out = np.zeros((6, n * n, *shape))
    lobe = np.array([[max(0.0, turned(d, axis, sign) @ normal) * w for d, w in zip(local, solid_angle, strict=True)]
                     for axis, sign in AXES])
    lobe *= power / lobe.sum()
    for group, (axis, sign) in enumerate(AXES):
        plane = math.ceil(position[axis]) if sign > 0 else math.floor(position[axis])
        if abs(plane - position[axis]) < 0.01:
            plane += sign
        for d in range(n * n):
            if lobe[group, d] == 0:
                continue
            direction = turned(local[d], axis, sign)
            met = position + direction * (plane - position[axis]) / direction[axis]
            sides = [(axis + 1) % 3, (axis + 2) % 3]
            weights = {}
            for corner in itertools.product((0, 1), repeat=2):
                cell, weight = [0, 0, 0], 1.0
                cell[axis] = plane
                for side, c in zip(sides, corner, strict=True):
                    cell[side] = math.floor(met[side]) + c
                    weight *= 1 - abs(met[side] - cell[side])
                front = normal @ (np.array(cell) - position)
                if front > 1e-3:
                    weights[tuple(cell)] = max(weight, 1e-4) * min(1.0, 4 * front)
            for cell, weight in weights.items():
                out[(group, d, *cell)] += lobe[group, d] * weight / sum(weights.values())
    return out


def irradiance_at(flux: np.ndarray, position: np.ndarray, normal: np.ndarray, n: int, cell_m: float) -> float:
    """W/m2 on a surface at a place in cells, in an empty grid with flux (6, n n, *shape) W.

    Each quadrant of directions is followed, by its mean slope, to the planes before and behind the place.
    """
    local, solid_angle = face_set(n)
    total = even = 0.0
    quarter = n * n // 4
    for group, (axis, sign) in enumerate(AXES):
        sides = [(axis + 1) % 3, (axis + 2) % 3]
        for quadrant in range(4):
            lanes = np.arange(quadrant * quarter, (quadrant + 1) * quarter)
            slope = np.average(local[lanes, :2] / local[lanes, 2:], axis=0, weights=solid_angle[lanes])
            cosine = np.array([max(0.0, -turned(local[d], axis, sign) @ normal) for d in lanes])
            weights = {}
            for plane in (math.floor(position[axis]), math.floor(position[axis]) + 1):
                way = sign * (position[axis] - plane)
                came = [position[side] - way * slope[s] for s, side in enumerate(sides)]
                for corner in itertools.product((0, 1), repeat=2):
                    cell, weight = [0, 0, 0], 1 - abs(way)
                    cell[axis] = plane
                    share = 1.0
                    for s, side in enumerate(sides):
                        cell[side] = math.floor(came[s]) + corner[s]
                        share *= 1 - abs(came[s] - cell[side])
                    front = normal @ (np.array(cell) - position)
                    if front > 1e-3:
                        weights[tuple(cell)] = weight * max(share, 1e-4) * min(1.0, 4 * front)
            if weights and cosine.any():
                whole = sum(weights.values())
                for cell, weight in weights.items():
                    total += weight / whole * (cosine * flux[(group, lanes, *cell)] / local[lanes, 2]).sum() / cell_m**2
                even += (cosine * solid_angle[lanes]).sum()
    return total * math.pi / even


# ---- harmonics ----
def y(d: np.ndarray) -> np.ndarray:
    """Spherical harmonics of bands 0 and 1, the second in the order x, y, z."""
    return np.array([1 / math.sqrt(4 * math.pi), *(math.sqrt(3 / (4 * math.pi)) * np.asarray(d))])


def lobe(d: np.ndarray) -> np.ndarray:
    """Coefficients of max(0, d . w), integrated over the sphere by midpoints in the angles around d."""
    cos_t = (np.arange(4000) + 0.5) / 4000
    dc = cos_t.mean() * 2 * math.pi / math.sqrt(4 * math.pi)
    linear = (cos_t**2).mean() * 2 * math.pi * math.sqrt(3 / (4 * math.pi))
    return np.array([dc, *(linear * np.asarray(d, float))])


def solid_angle_of_square(distance: float, samples: int = 800) -> float:
    """Solid angle of a square of edge 1 seen from its axis."""
    place = (np.arange(samples) + 0.5) / samples - 0.5
    r2 = distance**2 + place[:, None] ** 2 + place[None] ** 2
    return float((distance / r2**1.5).mean())


def propagated(state: np.ndarray, links: np.ndarray, clamp: bool, blocked: np.ndarray | None = None) -> np.ndarray:
    """One step of (4, nx, ny, nz) coefficients: to each neighbour's five faces, reprojected (Kaplanyan, Dachsbacher 2010).

    `blocked` (3, 4, nx, ny, nz) are coefficients on the face towards the next cell of how much is stopped by direction.
    """
    out = np.zeros(state.shape)
    front = solid_angle_of_square(1.5)
    side = (4 * math.pi / 6 - front) / 4
    for cell in np.ndindex(*state.shape[1:]):
        for axis, sign in AXES:
            target = list(cell)
            target[axis] += sign
            if not 0 <= target[axis] < state.shape[1 + axis]:
                continue
            lower = cell if sign > 0 else tuple(target)
            ahead = sign * np.eye(3)[axis]
            for face_axis, face_sign in AXES:
                face = face_sign * np.eye(3)[face_axis]
                if face @ ahead < 0:
                    continue
                # the far face's middle lies 3/2 edges ahead; a side face's 1 ahead and 1/2 to the side
                towards = ahead if face @ ahead > 0 else (ahead + face / 2) / math.sqrt(1.25)
                intensity = state[(slice(None), *cell)] @ y(towards) * links[(axis, *lower)]
                if clamp:
                    intensity = max(intensity, 0.0)
                if blocked is not None:
                    intensity *= 1 - min(1.0, max(0.0, blocked[(axis, slice(None), *lower)] @ y(towards)))
                flux = (front if face @ ahead > 0 else side) * intensity
                out[(slice(None), *target)] += flux / math.pi * lobe(face)
    return out
