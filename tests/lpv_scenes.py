"""Emitters and walls on grids, made by hand: what tests of light propagation volumes look at."""

from __future__ import annotations

import math

import numpy as np

from rtgi_addon.kernels import harmonics, ordinates
from rtgi_addon.kernels.bvh import build_bvh
from rtgi_addon.kernels.light_grid import LightGrid, close_links, open_grid

NOTHING = np.zeros((0, 3, 3), np.float32)


def texels(position: np.ndarray, normal: np.ndarray, flux: np.ndarray | float) -> np.ndarray:
    """(17, N) table of matt texels at (N, 3) with normals (N, 3) or (3,), and flux (N,) W the same in all colours."""
    position = np.atleast_2d(position)
    table = np.zeros((17, len(position)), np.float32)
    table[0:3], table[3:6], table[6:9] = position.T, np.broadcast_to(normal, position.shape).T, flux
    table[15], table[16] = 2, 0.04
    return table


def unit(v: tuple[float, ...]) -> np.ndarray:
    """v / |v|"""
    return np.asarray(v, float) / np.linalg.norm(v)


def rectangle(centre: np.ndarray, edge_u: np.ndarray, edge_v: np.ndarray) -> np.ndarray:
    """(2, 3, 3) two triangles of a parallelogram."""
    a, b = np.asarray(edge_u, float) / 2, np.asarray(edge_v, float) / 2
    corner = np.array([-a - b, a - b, a + b, -a + b]) + centre
    return corner[[[0, 1, 2], [0, 2, 3]]]


def plane_of_texels(centre: np.ndarray, edge_u: np.ndarray, edge_v: np.ndarray, n: int) -> np.ndarray:
    """Table of n x n texels on a rectangle that shines 1 W/m2 along edge_u x edge_v."""
    edge_u, edge_v = np.asarray(edge_u, float), np.asarray(edge_v, float)
    u, v = (a.ravel()[:, None] for a in np.meshgrid((np.arange(n) + 0.5) / n - 0.5, (np.arange(n) + 0.5) / n - 0.5))
    area = np.cross(edge_u, edge_v)
    return texels(np.asarray(centre) + u * edge_u + v * edge_v, area / np.linalg.norm(area), np.linalg.norm(area) / n**2)


def lit_grid(table: np.ndarray, grid: LightGrid, n: int = 4, walls: np.ndarray = NOTHING) -> tuple[np.ndarray, object]:
    """(flux after a sweep of n x n directions a face, BVH of the walls); closes the grid's links where walls cross them."""
    walls = np.asarray(walls, np.float32)
    bvh = build_bvh(walls)
    close_links(grid, walls, np.zeros(len(walls), np.float32))
    flux = ordinates.empty_flux(n, grid.links.shape[1:])
    ordinates.inject(flux, n, table, grid, bvh, 1e-5)
    ordinates.sweep(flux, grid, n)
    return flux, bvh


def cube(number: int) -> LightGrid:
    """An open grid of number^3 cells of 1 m, the middle of its middle cell at the origin where number is odd."""
    return open_grid(np.full(3, -number / 2), 1.0, (number,) * 3)


def harmonic_source(number: int, direction: tuple[float, ...] | None) -> np.ndarray:
    """State of 1 W in the middle cell: Lambertian along a direction, or even in all directions."""
    state = np.zeros((3, 4, number, number, number), np.float32)
    middle = (slice(None), slice(None), *(number // 2,) * 3)
    state[middle] = [harmonics.C0, 0, 0, 0] if direction is None else harmonics.cosine_lobe(unit(direction)) / math.pi
    return state
