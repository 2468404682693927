"""Where the grids of a light volume lie, and the light of a frame's lit surfaces as it goes into them."""

from __future__ import annotations

import numpy as np

from ..core.frame import Frame, GBuffer
from ..core.transforms import Camera, Projection
from ..kernels.clusters import ALPHA2, DIFFUSE, F0, GLOSSY, NO_LOBE, NORMAL, POSITION, ROWS, TO_LIGHT
from ..kernels.light_grid import LightGrid, close_links, open_grid
from .lattice import pixel_footprint_m

LEFT_OUT = 0.005            # share of the pixels, and of the light, that may lie beyond each side of the grid
MARGIN = 1.3                # cells between the outermost surfaces and the border: a surface needs cells in front of it, and
                            # a whole or half number would put walls on the planes of centres
LEAST_CELLS = 4             # across a grid: a lone plane is a grid of this height
MOST_STRETCHED = 4          # longest edge of a grid over that of a cube of as many cells: a corridor gets no finer than that
BOX_SAMPLES = 8192          # pixels, and texels, that the box is made from: 40 lie beyond each side
NORMAL_STEPS = 3            # a normal's components are told apart in steps of a third when texels are merged
FINER = 0.35                # an inner grid is made if its cells are at most this share of those around it: on two captures
                            # of Sponza, 0.27 took the error from 33.4 to 31.5 %, and 0.33 from 28.8 to 29.4
SAMPLE = 32                 # resolution at which the cells of two grids are compared
STEEPEST = 0.1              # cosine at which a pixel's share of a surface stops to grow


def _quantiles(values: np.ndarray, weight: np.ndarray | None, share: float) -> tuple[np.ndarray, np.ndarray]:
    """(3,), (3,): by axis the bounds that leave out `share` of the weight on each side of (N, 3) values."""
    low, high = np.empty(3), np.empty(3)
    for axis in range(3):
        order = np.argsort(values[:, axis], kind="stable")
        run = np.arange(1, len(order) + 1) / len(order) if weight is None else np.cumsum(weight[order], dtype=np.float64)
        first, last = np.searchsorted(run, [share * run[-1], (1 - share) * run[-1]])
        low[axis], high[axis] = values[order[first], axis], values[order[min(last, len(order) - 1)], axis]
    return low, high


def _cells_across(extent: np.ndarray, cell_m: float) -> np.ndarray:
    return np.maximum(np.ceil(extent / cell_m + 2 * MARGIN - 1e-3), LEAST_CELLS)


def _cell_size(extent: np.ndarray, resolution: int) -> float:
    """The smallest cells, m, with which a box of `extent` (3,) m takes no more than resolution^3 of them."""
    longest = max(float(extent.max()), 1e-30)
    few, many = longest, longest / max(MOST_STRETCHED * resolution - 2 * MARGIN, 1.0)
    for _ in range(24):
        middle = (few * many) ** 0.5
        few, many = (few, middle) if _cells_across(extent, middle).prod() > resolution**3 else (middle, many)
    return few


def boxes_of(frame: Frame, table: np.ndarray, most: int = 1) -> list[tuple[np.ndarray, np.ndarray]]:
    """Boxes (lowest, highest corner) of one to `most` grids, the widest first.

    The first holds what the camera sees and the texels (17, N) that light it, weighed by what they may give there: a
    sunlit plain that runs to the horizon does not stretch it. The next hold the nearer half of the pixels, the nearer
    quarter and so on, as long as their cells come out much smaller.
    """
    g = frame.gbuffer
    pixels = np.flatnonzero(g.mask)
    pixels = pixels[:: max(1, len(pixels) // BOX_SAMPLES)]
    seen, depth = g.position_ws.reshape(-1, 3)[pixels], g.depth.ravel()[pixels]
    low, high = _quantiles(seen, None, LEFT_OUT)
    middle, reach2 = (low + high) / 2, max(float(((high - low) ** 2).sum()) / 4, 1e-12 * frame.scale_m**2)
    texels = table[:, :: max(1, table.shape[1] // BOX_SAMPLES)]
    flux = texels[DIFFUSE:DIFFUSE + 3].sum(0) + texels[GLOSSY:GLOSSY + 3].sum(0)
    lit = texels[POSITION:POSITION + 3].T
    gives = flux / (1 + ((lit - middle) ** 2).sum(1) / reach2)
    if gives.any():
        lit_low, lit_high = _quantiles(lit, gives, LEFT_OUT)
        low, high = np.minimum(low, lit_low), np.maximum(high, lit_high)
    boxes = [(low, high)]
    for level in range(1, most):
        near_low, near_high = _quantiles(seen[depth <= np.quantile(depth, 0.5**level)], None, LEFT_OUT)
        around = boxes[-1]
        near_low, near_high = np.maximum(near_low, around[0]), np.minimum(near_high, around[1])
        if _cell_size(near_high - near_low, SAMPLE) > FINER * _cell_size(around[1] - around[0], SAMPLE):
            break
        boxes.append((near_low, near_high))
    return boxes


def grid_over(frame: Frame, box: tuple[np.ndarray, np.ndarray], resolution: int, is_blocked: bool) -> LightGrid:
    """Cubic cells over a box and its margin, at most resolution^3 of them; walls of the frame's triangles.

    The least transparent triangle on a link counts, by its mean opacity.
    """
    low, high = box
    extent = np.maximum(high - low, 1e-6 * frame.scale_m)
    cell_m = _cell_size(extent, resolution)
    across = _cells_across(extent, cell_m).astype(int)
    middle = (low + high) / 2
    # where a side is widened to LEAST_CELLS the box stays off the middle, which would lie between centres
    start = np.where(across > LEAST_CELLS, low - MARGIN * cell_m, middle - (across / 2 + 0.2) * cell_m)
    grid = open_grid(start, cell_m, tuple(int(n) for n in across))
    geometry = frame.geometry
    if is_blocked and geometry is not None and len(geometry):
        close_links(grid, geometry.corners_ws, 1 - geometry.coverage(np.arange(len(geometry))))
    return grid


def merge_texels(table: np.ndarray, grid: LightGrid) -> np.ndarray:
    """The texels (17, N) of each cell with like normals as one: flux is summed, all else its mean by flux.

    A glossy lobe grows wider by what the merged normals and directions to the lamp differ, as in `clusters`.
    """
    shape = np.array(grid.links.shape[1:])
    cell = np.clip(np.floor((table[POSITION:POSITION + 3].T - grid.low) / grid.cell_m), -1, shape).astype(np.int64) + 1
    turn = np.rint(table[NORMAL:NORMAL + 3].T * NORMAL_STEPS).astype(np.int64) + NORMAL_STEPS
    key = (cell[:, 0] * (shape[1] + 2) + cell[:, 1]) * (shape[2] + 2) + cell[:, 2]
    for a in range(3):
        key = key * (2 * NORMAL_STEPS + 1) + turn[:, a]
    _, group = np.unique(key, return_inverse=True)
    number = int(group.max(initial=-1)) + 1
    diffuse = table[DIFFUSE:DIFFUSE + 3].sum(0, dtype=np.float64)
    glossy = np.where(table[ALPHA2] < NO_LOBE, table[GLOSSY:GLOSSY + 3].sum(0, dtype=np.float64), 0.0)

    def summed(weight: np.ndarray, row: int | None = None) -> np.ndarray:
        return np.bincount(group, weight if row is None else weight * table[row], number)

    def means(first: int) -> np.ndarray:
        whole = np.maximum(summed(diffuse + glossy), 1e-300)
        return np.stack([summed(diffuse + glossy, first + a) for a in range(3)]) / whole

    out = np.zeros((ROWS, number), np.float32)
    normal, to_light = means(NORMAL), means(TO_LIGHT)
    n_length, l_length = (np.maximum(np.linalg.norm(v, axis=0), 1e-9) for v in (normal, to_light))
    out[POSITION:POSITION + 3] = means(POSITION)
    out[NORMAL:NORMAL + 3], out[TO_LIGHT:TO_LIGHT + 3] = normal / n_length, to_light / l_length
    for a in range(3):
        out[DIFFUSE + a] = np.bincount(group, table[DIFFUSE + a], number)
        out[GLOSSY + a] = np.bincount(group, np.where(glossy > 0, table[GLOSSY + a], 0), number)
    shine, spread = summed(glossy), np.maximum(2 * (2 - n_length - l_length), 0)    # rounding may make a mean longer than 1
    inv = 1 / np.maximum(shine, 1e-300)
    out[ALPHA2] = np.where(shine > 0, np.minimum(summed(glossy, ALPHA2) * inv + spread, 1), NO_LOBE)
    out[F0] = summed(glossy, F0) * inv
    return out


def surfels_of(camera: Camera, gbuffer: GBuffer) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(position (N, 3) m, normal (N, 3), area (N,) m2) of the surfaces that a view sees, one for each of its pixels."""
    mask = gbuffer.mask
    position, normal = gbuffer.position_ws[mask], gbuffer.normal_ws[mask]
    width = pixel_footprint_m(camera, gbuffer.depth)
    if camera.projection is Projection.EQUIRECTANGULAR:
        width = width * np.sqrt(np.abs(np.cos(camera.pixel_centres()[1])))[:, None].astype(np.float32)
    if camera.projection is Projection.ORTHOGRAPHIC:
        to_eye = np.broadcast_to(camera.world_from_view[:3, 2], normal.shape)
    else:
        to_eye = camera.position_ws - position
        to_eye = to_eye / np.maximum(np.linalg.norm(to_eye, axis=1, keepdims=True), 1e-30)
    cosine = np.abs(np.einsum("ij,ij->i", normal, to_eye))
    return position, normal, (width[mask] ** 2 / np.maximum(cosine, STEEPEST)).astype(np.float32)
