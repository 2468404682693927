"""The world as the passes see it: small maps, and what an open surface of each normal gets from them."""

from __future__ import annotations

import functools

import numpy as np

from ..core.frame import World
from ..core.radiometry import texel_directions
from ..kernels.octahedron import look_up, node_directions, table_of
from ..kernels.sky import mean_parts

MAP_SIZE = (64, 128)        # rows and columns of a gathered map: 2.8 degrees, finer than a cosine needs
TABLE_MAP_SIZE = (32, 64)   # of the map that the table of irradiance is summed from
NODES = 33                  # edge of that table: 6 degrees between nodes


def shrink_map(radiance: np.ndarray, size: tuple[int, int] = MAP_SIZE) -> np.ndarray:
    """(h, w, 3) float32 means over equal parts of an equirectangular map, weighed by solid angle; never enlarged.

    Energy is kept: the sum of radiance times solid angle is the same before and after.
    """
    height, width = radiance.shape[:2]
    rows, columns = min(size[0], height), min(size[1], width)
    latitude = np.pi / 2 - np.pi * np.arange(height + 1) / height
    weight = np.sin(latitude[:-1]) - np.sin(latitude[1:])
    # part k begins at the first index i with i * parts // number == k
    first_row, first_column = -(-np.arange(rows + 1) * height // rows), -(-np.arange(columns + 1) * width // columns)
    return mean_parts(radiance, weight, first_row, first_column)


def sky_distribution(radiance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(cdf (H W,) float64, density (H, W) float32 1/sr) that draw a map's directions in proportion to brightness."""
    height, width = radiance.shape[:2]
    latitude = np.pi / 2 - np.pi * np.arange(height + 1) / height
    solid_angle = ((np.sin(latitude[:-1]) - np.sin(latitude[1:])) * 2 * np.pi / width)[:, None] * np.ones((1, width))
    brightness = radiance.sum(-1, dtype=np.float64)
    mass = brightness * solid_angle
    total = mass.sum()
    if not total > 0:
        return np.linspace(0, 1, height * width + 1)[1:], np.zeros((height, width), np.float32)
    cdf = np.cumsum(mass.ravel()) / total
    cdf[-1] = 1.0
    return cdf, (brightness / total).astype(np.float32)


def irradiance_table(world: World) -> np.ndarray:
    """(n, n, 3) float32 W/m2 that an open surface gets, by its normal, for `kernels.octahedron.look_up`.

    Exact for a constant world. For a map the sum over its texels stands at each node, and lines lie between: off by 0.3 %
    rms where nine spherical harmonics, the usual choice, are off by 2 % (a sky with a hazy sun).
    """
    if world.is_constant:
        return np.tile((np.pi * world.radiance[0, 0]).astype(np.float32), (2, 2, 1))
    radiance = shrink_map(world.radiance, TABLE_MAP_SIZE)
    return table_of(_node_cosines(*radiance.shape[:2]), radiance)


@functools.lru_cache(2)
def _node_cosines(height: int, width: int) -> np.ndarray:
    """(NODES^2, height width) float32: cosine times solid angle of a map's texels for each node; 9 MB, 20 ms to make."""
    direction, solid_angle = texel_directions(height, width)
    cosine = node_directions(NODES).reshape(-1, 3).astype(np.float32) @ direction.reshape(-1, 3).T.astype(np.float32)
    return np.maximum(cosine, 0) * solid_angle.reshape(1, -1).astype(np.float32)


def open_irradiance(world: World, normal_ws: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """(H, W, 3) float32 W/m2 that surfaces of normals (H, W, 3) would get with nothing in the way; zero outside `mask`."""
    return look_up(irradiance_table(world), np.ascontiguousarray(normal_ws, np.float32), mask)
