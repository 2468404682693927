"""The camera's view for kernels, and tiles of pixels by what they hold, so that techniques skip those without work."""

from __future__ import annotations

import dataclasses
import enum

import numpy as np

from ..core.frame import Frame, GBuffer
from ..core.radiometry import brightest
from ..core.transforms import Projection, normalized
from ..kernels import shadow
from ..kernels.bvh import Bvh
from ..kernels.pilot import cast_rays
from ..kernels.screen import Screen, build_screen
from ..kernels.vec3 import f32

PROJECTION_CODES = {Projection.PERSPECTIVE: shadow.PERSPECTIVE, Projection.ORTHOGRAPHIC: shadow.ORTHOGRAPHIC,
                    Projection.EQUIRECTANGULAR: shadow.EQUIRECTANGULAR}
TILE_PX = 8                 # edge of a tile: a cache line of float32 is 16 wide, and skies end at curves
SHOWN_PX = 1.0              # height over a pixel's tangent plane, in its footprints, at which a point is another surface
SHOWN_COSINE = 0.5          # of the angle between two normals of one surface: bumps and edges of a pixel, not its back
NEAR_SHARE = 1e-5           # of the scene's size: what rays of the overscan pass over before the eye, like a near clip
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


def is_shown(frame: Frame, position_ws: np.ndarray, normal_ws: np.ndarray) -> np.ndarray:
    """(N,) bool: points (N, 3) that lie on what the camera sees at their pixel, and face it as that surface does."""
    g = frame.gbuffer
    column, row, _ = frame.camera.project(position_ws.astype(np.float64))
    is_in = (column >= 0) & (column < g.shape[1]) & (row >= 0) & (row < g.shape[0])    # False for NaN, behind the eye
    i, j = np.where(is_in, row, 0).astype(np.int64), np.where(is_in, column, 0).astype(np.int64)
    depth, normal = g.depth[i, j], g.normal_ws[i, j]
    step_x, step_y = frame.camera.pixel_size
    footprint = max(step_x, step_y) * (1 if frame.camera.projection is Projection.ORTHOGRAPHIC else depth)
    off = np.abs(((position_ws - g.position_ws[i, j]) * normal).sum(-1))
    return is_in & np.isfinite(depth) & (off < SHOWN_PX * footprint) & ((normal * normal_ws).sum(-1) > SHOWN_COSINE)


def coarse_screen(screen: Screen, step: int) -> Screen:
    """The lattice of every `step`-th pixel, from step // 2 on, as a screen of its own."""
    first = step // 2
    shift = first + 0.5 - 0.5 * step        # the lattice's first pixel is `step` wide around the centre of pixel `first`
    images = (np.ascontiguousarray(image[first::step, first::step])
              for image in (screen.depth, screen.position_ws, screen.normal_ws))
    return Screen(screen.projection, screen.view_from_world, f32(screen.left + shift * screen.step_x),
                  f32(screen.top - shift * screen.step_y), f32(step * screen.step_x), f32(step * screen.step_y), *images)


def wide_screen(frame: Frame, margin_px: int, bvh: Bvh) -> Screen:
    """The camera's view, `margin_px` pixels wider on every side: overscan, by rays through the scene's triangles.

    Pixel (i, j) of the frame is pixel (i + margin_px, j + margin_px) here, unchanged. Around it stand geometric normals
    on the viewer's side; materials that a ray would pass are met like any other.
    """
    camera, g = frame.camera, frame.gbuffer
    step_x, step_y = camera.pixel_size
    wide = dataclasses.replace(
        camera, width_px=camera.width_px + 2 * margin_px, height_px=camera.height_px + 2 * margin_px,
        left=camera.left - margin_px * step_x, right=camera.right + margin_px * step_x,
        bottom=camera.bottom - margin_px * step_y, top=camera.top + margin_px * step_y)
    inner = (slice(margin_px, -margin_px), slice(margin_px, -margin_px))
    around = np.ones((wide.height_px, wide.width_px), bool)
    around[inner] = False
    origin_vs, direction_vs = (rays[around] for rays in wide.rays_vs())
    rotation = wide.world_from_view[:3, :3]
    origin = (origin_vs @ rotation.T + wide.position_ws).astype(np.float32)
    direction = (direction_vs @ rotation.T).astype(np.float32)
    low, high = frame.geometry.bounds_ws
    near = NEAR_SHARE * frame.scale_m
    reach = float(np.linalg.norm(np.maximum(np.abs(low - wide.position_ws), np.abs(high - wide.position_ws)))) + near
    distance, slot, _, _ = cast_rays(origin, direction, bvh, f32(near), f32(reach))
    corners = frame.geometry.corners_ws[bvh.source[slot]] if len(bvh.source) else np.zeros((len(slot), 3, 3), np.float32)
    face = normalized(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    face[(face * direction).sum(-1) > 0] *= -1
    depth, normal = (np.empty(around.shape + tail, np.float32) for tail in ((), (3,)))
    depth[inner], normal[inner] = g.depth, g.normal_ws
    depth[around], normal[around] = distance, np.where(slot[:, None] < 0, np.float32([0, 0, 1]), face)
    position = wide.positions_ws(depth)
    position[inner] = g.position_ws
    return build_screen(PROJECTION_CODES[wide.projection], wide.view_from_world, wide.left, wide.top, step_x, step_y,
                        depth, position, normal)


def classify_tiles(gbuffer: GBuffer, world_irradiance: np.ndarray | None = None,
                   mirror_roughness: float = MIRROR_ROUGHNESS) -> np.ndarray:
    """(ceil(H / TILE_PX), ceil(W / TILE_PX)) uint8 of `Tile` bits.

    `world_irradiance` (H, W, 3) W/m2 is what an open surface of each pixel's normal would get; without it no tile has
    WORLD_LIGHT.
    """
    mask = gbuffer.mask
    is_glossy = mask & (brightest(gbuffer.specular) > 0)
    is_sharp = gbuffer.roughness < mirror_roughness
    kinds = mask * np.uint8(Tile.SURFACE)
    kinds |= (is_glossy & is_sharp) * np.uint8(Tile.MIRROR)
    kinds |= (is_glossy & ~is_sharp) * np.uint8(Tile.ROUGH)
    if world_irradiance is not None:
        kinds |= (mask & (brightest(world_irradiance) > 0)) * np.uint8(Tile.WORLD_LIGHT)
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
