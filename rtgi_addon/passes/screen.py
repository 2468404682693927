"""The camera's view for kernels, and tiles of pixels by what they hold, so that techniques skip those without work."""

from __future__ import annotations

import enum

import numpy as np

from ..core.frame import Frame, GBuffer
from ..core.transforms import Projection
from ..kernels import shadow
from ..kernels.screen import Screen, build_screen

PROJECTION_CODES = {Projection.PERSPECTIVE: shadow.PERSPECTIVE, Projection.ORTHOGRAPHIC: shadow.ORTHOGRAPHIC,
                    Projection.EQUIRECTANGULAR: shadow.EQUIRECTANGULAR}
TILE_PX = 8                 # edge of a tile: a cache line of float32 is 16 wide, and skies end at curves
MIRROR_ROUGHNESS = 0.1      # below it the GGX lobe is narrower than 2 degrees: one ray a pixel is enough


class Tile(enum.IntFlag):
    """What a tile holds at least one pixel of; a tile of sky has none of these."""

    SURFACE = 1
    MIRROR = 2          # glossy, sharp
    ROUGH = 4           # glossy, not sharp
    WORLD_LIGHT = 8     # a surface that the world would light if nothing stood in the way


def screen_of(frame: Frame) -> Screen:
    """The camera's view of a frame as kernels take it."""
    camera, g = frame.camera, frame.gbuffer
    return build_screen(PROJECTION_CODES[camera.projection], camera.view_from_world, camera.left, camera.top,
                        *camera.pixel_size, g.depth, g.position_ws, g.normal_ws)


def classify_tiles(gbuffer: GBuffer, world_irradiance: np.ndarray | None = None,
                   mirror_roughness: float = MIRROR_ROUGHNESS) -> np.ndarray:
    """(ceil(H / TILE_PX), ceil(W / TILE_PX)) uint8 of `Tile` bits.

    `world_irradiance` (H, W, 3) W/m2 is what an open surface of each pixel's normal would get; without it no tile has
    WORLD_LIGHT.
    """
    mask = gbuffer.mask
    is_glossy = mask & (gbuffer.specular.max(-1) > 0)
    is_sharp = gbuffer.roughness < mirror_roughness
    kinds = mask * np.uint8(Tile.SURFACE)
    kinds |= (is_glossy & is_sharp) * np.uint8(Tile.MIRROR)
    kinds |= (is_glossy & ~is_sharp) * np.uint8(Tile.ROUGH)
    if world_irradiance is not None:
        kinds |= (mask & (world_irradiance.max(-1) > 0)) * np.uint8(Tile.WORLD_LIGHT)
    return _by_tile(kinds)


def _by_tile(bits: np.ndarray) -> np.ndarray:
    by_row = np.bitwise_or.reduceat(bits, np.arange(0, bits.shape[0], TILE_PX), 0)
    return np.bitwise_or.reduceat(by_row, np.arange(0, bits.shape[1], TILE_PX), 1)


def tiles_with(tiles: np.ndarray, wanted: Tile) -> np.ndarray:
    """(n, 2) int32: row and column of the first pixel of every tile that has one of the bits `wanted`, row by row."""
    return np.ascontiguousarray(np.argwhere(tiles & int(wanted)) * TILE_PX, np.int32)


def lane_groups(wanted: np.ndarray) -> np.ndarray:
    """(n, TILE_PX^2) int32: flat indices of the pixels of every tile that holds one of the `wanted` (H, W) bool pixels.

    A tile over the edge repeats its pixels at the edge. The order spreads any run of tiles over the picture, so that threads
    which share the list out in runs get equal work.
    """
    height, width = wanted.shape
    tiles = tiles_with(_by_tile(wanted.view(np.uint8)), Tile.SURFACE)
    tiles = tiles[np.argsort(np.arange(len(tiles)) * 0.6180339887498949 % 1.0)]
    lane = np.arange(TILE_PX * TILE_PX, dtype=np.int32)
    rows = np.minimum(tiles[:, :1] + lane // TILE_PX, np.int32(height - 1))
    return rows * np.int32(width) + np.minimum(tiles[:, 1:] + lane % TILE_PX, np.int32(width - 1))
