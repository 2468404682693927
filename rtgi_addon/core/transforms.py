"""Pixels, views and world: the one place that knows how a camera maps to an image.

Conventions: row 0 is the top of the image; matrices are named destination_from_source and act on column vectors; the
view space looks along -Z with +Y up, as Blender's cameras and lamps do; `depth` is the planar distance along -Z for
perspective and orthographic views and the ray length for equirectangular ones.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

import numpy as np


class Projection(enum.Enum):
    """How a view maps directions to pixels."""

    PERSPECTIVE = "PERSPECTIVE"
    ORTHOGRAPHIC = "ORTHOGRAPHIC"
    EQUIRECTANGULAR = "EQUIRECTANGULAR"


@dataclass(frozen=True)
class Camera:
    """A view of the scene: the main camera's, or a light's.

    Attributes
    ----------
    projection : Projection
    world_from_view : (4, 4) float64
        Rigid: rotation and translation in metres, relative to the frame's origin; no scale.
    width_px, height_px : int
    left, right, bottom, top : float
        Edges of the image plane: at 1 m distance for PERSPECTIVE (tangents), in metres for ORTHOGRAPHIC, longitude and
        latitude in radians for EQUIRECTANGULAR. A shifted lens, a border and overscan are all in these four numbers.
    """

    projection: Projection
    world_from_view: np.ndarray
    width_px: int
    height_px: int
    left: float
    right: float
    bottom: float
    top: float

    @property
    def view_from_world(self) -> np.ndarray:
        """(4, 4) float64 inverse of `world_from_view`."""
        rotation = self.world_from_view[:3, :3]
        out = np.eye(4)
        out[:3, :3] = rotation.T
        out[:3, 3] = -rotation.T @ self.world_from_view[:3, 3]
        return out

    @property
    def position_ws(self) -> np.ndarray:
        """(3,) float64 m, relative to the frame's origin."""
        return self.world_from_view[:3, 3]

    @property
    def pixel_size(self) -> tuple[float, float]:
        """Width and height of a pixel on the image plane, in the units of its edges."""
        return (self.right - self.left) / self.width_px, (self.top - self.bottom) / self.height_px

    def pixel_centres(self) -> tuple[np.ndarray, np.ndarray]:
        """Image plane coordinates of the pixel centres: x (W,) rising to the right, y (H,) falling from the top."""
        step_x, step_y = self.pixel_size
        return (self.left + (np.arange(self.width_px) + 0.5) * step_x,
                self.top - (np.arange(self.height_px) + 0.5) * step_y)

    def rays_vs(self) -> tuple[np.ndarray, np.ndarray]:
        """Origins and directions (H, W, 3) float64 in view space such that origin + depth * direction is the point seen."""
        x, y = np.meshgrid(*self.pixel_centres())
        zero, one = np.zeros_like(x), np.ones_like(x)
        if self.projection is Projection.PERSPECTIVE:
            return np.zeros(x.shape + (3,)), np.stack([x, y, -one], -1)
        if self.projection is Projection.ORTHOGRAPHIC:
            return np.stack([x, y, zero], -1), np.stack([zero, zero, -one], -1)
        return np.zeros(x.shape + (3,)), direction_from_longitude(x, y)

    def positions_ws(self, depth: np.ndarray) -> np.ndarray:
        """Points seen, (H, W, 3) float32 m, from `depth` (H, W) m; where depth is not finite the point is 0."""
        finite = np.isfinite(depth)
        depth = np.where(finite, depth, 0.0).astype(np.float32)
        out = np.empty((*depth.shape, 3), np.float32)
        rotation, place = self.world_from_view[:3, :3], self.position_ws
        if self.projection is Projection.EQUIRECTANGULAR:
            _, direction_vs = self.rays_vs()
            np.add(depth[..., None] * (direction_vs @ rotation.T), place, out=out, casting="same_kind")
        else:
            # an axis at a time: a fifth of the time of matrices in float64, and as exact as the depth
            x, y = self.pixel_centres()
            is_perspective = self.projection is Projection.PERSPECTIVE
            for axis, (right, up, back) in enumerate(rotation):
                across, along = (right * x).astype(np.float32)[None], (up * y).astype(np.float32)[:, None]
                if is_perspective:
                    np.multiply(across + (along - np.float32(back)), depth, out=out[..., axis])
                    out[..., axis] += np.float32(place[axis])
                else:
                    np.multiply(depth, np.float32(-back), out=out[..., axis])
                    out[..., axis] += across + (along + np.float32(place[axis]))
        out[~finite] = 0
        return out

    def project(self, position_ws: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Column, row (pixel centres at +0.5) and depth of points (..., 3); behind a perspective view depth is <= 0."""
        view = self.view_from_world
        p = position_ws @ view[:3, :3].T + view[:3, 3]
        if self.projection is Projection.PERSPECTIVE:
            depth = -p[..., 2]
            safe = np.where(depth > 0, depth, np.nan)
            x, y = p[..., 0] / safe, p[..., 1] / safe
        elif self.projection is Projection.ORTHOGRAPHIC:
            depth, x, y = -p[..., 2], p[..., 0], p[..., 1]
        else:
            depth = np.linalg.norm(p, axis=-1)
            x = np.arctan2(p[..., 0], -p[..., 2])
            y = np.arcsin(np.clip(p[..., 1] / np.maximum(depth, 1e-30), -1, 1))
        step_x, step_y = self.pixel_size
        return (x - self.left) / step_x, (self.top - y) / step_y, depth

    def boxes_around(self, corners_ws: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Boxes of pixels that hold all that this view sees of the convex hulls of corners (n, k, 3).

        Returns (n, 4) lowest and highest column, lowest and highest row (as `project`; beyond the image too, and beyond a
        full turn's edge instead of across it) and (n,) a depth m that no point of the hull falls below. A hull that
        lies behind a perspective view has a box of negative size; one that surrounds the view has the whole image.
        """
        view = self.view_from_world
        p = corners_ws.astype(np.float64) @ view[:3, :3].T + view[:3, 3]
        whole = np.array([0.0, self.width_px, 0.0, self.height_px])
        step_x, step_y = self.pixel_size
        if self.projection is Projection.EQUIRECTANGULAR:
            # the cone of directions around a hull, and the parallels and meridians that touch it
            centre = p.mean(1)
            distance, size = np.linalg.norm(centre, axis=-1), np.linalg.norm(p - centre[:, None], axis=-1).max(1)
            nearest = np.maximum(distance - size, 0)
            half = np.arcsin(np.minimum(size / np.maximum(distance, 1e-30), 1))
            longitude, latitude = np.arctan2(centre[:, 0], -centre[:, 2]), np.arcsin(
                np.clip(centre[:, 1] / np.maximum(distance, 1e-30), -1, 1))
            sine = np.sin(half) / np.maximum(np.cos(latitude), 1e-30)
            width = np.where(sine < 1, np.arcsin(np.minimum(sine, 1)), np.pi)
            x, y = np.stack([longitude - width, longitude + width], 1), np.stack([latitude + half, latitude - half], 1)
            out = np.concatenate([(x - self.left) / step_x, (self.top - y) / step_y], 1)
            return np.where((nearest > 0)[:, None], out, whole), nearest
        column, row, depth = self.project(corners_ws)
        with np.errstate(invalid="ignore"):
            out = np.stack([column.min(1), column.max(1), row.min(1), row.max(1)], 1)
        nearest = depth.min(1)
        if self.projection is Projection.PERSPECTIVE:
            out = np.where((depth > 0).all(1)[:, None], out, whole)
            out = np.where((depth > 0).any(1)[:, None], out, [0.0, -1.0, 0.0, -1.0])
            nearest = np.maximum(nearest, 0)
        return out, nearest


@dataclass(frozen=True)
class ViewFormat:
    """What size a lamp's view may have.

    About `texels` texels. A flat view's are `texel_aspect` times as wide as high, and it is at most `limit_px` (width,
    height) large; an equirectangular view is `panorama_px` large. None leaves it to the number of texels.
    """

    texels: int
    limit_px: tuple[int, int] | None = None
    texel_aspect: float = 1.0
    panorama_px: tuple[int, int] | None = None

    def flat_px(self, aspect: float) -> tuple[int, int]:
        """Width and height in px of a flat view that shows `aspect` times as much across as it does upwards."""
        wide = math.sqrt(aspect / self.texel_aspect)
        width, height = math.sqrt(self.texels) * wide, math.sqrt(self.texels) / wide
        scale = min(1.0, self.limit_px[0] / width, self.limit_px[1] / height) if self.limit_px else 1.0
        return max(1, round(width * scale)), max(1, round(height * scale))

    def panorama(self, aspect: float) -> tuple[int, int]:
        """Width and height in px of an equirectangular view of `aspect` times as much longitude as latitude."""
        high = math.sqrt(self.texels / aspect)
        return self.panorama_px or (max(1, round(high * aspect)), max(1, round(high)))


def direction_from_longitude(longitude_rad: np.ndarray, latitude_rad: np.ndarray) -> np.ndarray:
    """Unit directions (..., 3) in view space: longitude 0 looks along -Z and grows towards +X, latitude towards +Y."""
    cos_latitude = np.cos(latitude_rad)
    return np.stack([cos_latitude * np.sin(longitude_rad), np.sin(latitude_rad), -cos_latitude * np.cos(longitude_rad)], -1)


def normalized(vectors: np.ndarray, fallback: tuple[float, ...] = (0.0, 0.0, 1.0)) -> np.ndarray:
    """Unit vectors along the last axis; `fallback` where the length is 0 or not finite."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    good = np.isfinite(length) & (length > 0)
    return np.where(good, vectors / np.where(good, length, 1), np.asarray(fallback, vectors.dtype))
