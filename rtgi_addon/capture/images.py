"""Textures as small linear pyramids: read once from Blender, averaged down, then sampled at many points with numpy.

A pyramid serves geometry that rays and voxels meet, which needs the right mean over a triangle and no fine detail; the
views sample textures in full through Cycles.
"""

from __future__ import annotations

import os
import zlib
from dataclasses import dataclass

import bpy
import numpy as np

_BASE_PX = 256        # longest edge of the finest level
_CUT_PX = 512         # and of an image with an alpha, which rays look into: the outline of a leaf is sharp
_READ_PX = 1024       # larger images are read at every n-th pixel before averaging: 16 or more texels still enter a mean
_KEY_BYTES = 65536    # of a packed file's either end: compressed streams of different pictures differ there


def srgb_to_linear(encoded: np.ndarray) -> np.ndarray:
    """IEC 61966-2-1 decoding, float32; values above 1 follow the same curve."""
    encoded = np.maximum(encoded, 0)
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4).astype(np.float32)


_DECODED_BYTES = srgb_to_linear(np.arange(256) / 255)


def _box_mean(pixels: np.ndarray, factor: int) -> np.ndarray:
    """Means over square boxes of (H, W, C), sizes rounded up; the last texels fill boxes at the edge."""
    for axis in (0, 1):
        size = pixels.shape[axis]
        if factor > 1 and size > 1:
            fill = -size % factor
            if fill:
                last = pixels[-1:] if axis == 0 else pixels[:, -1:]
                pixels = np.concatenate([pixels] + [last] * fill, axis=axis)
            pieces = [pixels[k::factor] if axis == 0 else pixels[:, k::factor] for k in range(factor)]
            pixels = sum(pieces[1:], pieces[0]) / np.float32(factor)
    return pixels


@dataclass(frozen=True)
class Pyramid:
    """An image at halving resolutions.

    Attributes
    ----------
    texels : (P, 4) float32
        Linear colour times coverage, and coverage, of all levels one after the other; row 0 of a level is the bottom.
    starts, heights, widths : (L,) int64
        Where each level begins in `texels`, and its size; level 0 is the finest.
    is_packed : bool
        Alpha is a channel of its own and does not cover the colour.
    """

    texels: np.ndarray
    starts: np.ndarray
    heights: np.ndarray
    widths: np.ndarray
    is_packed: bool = False

    @staticmethod
    def build(pixels: np.ndarray, is_packed: bool = False) -> Pyramid:
        """From (H, W, 4) float32 linear colour times coverage, bottom row first."""
        most_px = _CUT_PX if pixels[..., 3].min() < 1 else _BASE_PX
        levels = [_box_mean(pixels, -(-max(pixels.shape[:2]) // most_px))]
        while levels[-1].shape[0] > 1 or levels[-1].shape[1] > 1:
            levels.append(_box_mean(levels[-1], 2))
        # the coarsest level is the mean of all texels, without those that filled boxes at an edge
        levels[-1] = levels[0].mean((0, 1), dtype=np.float64).astype(np.float32).reshape(1, 1, 4)
        heights, widths = (np.array([level.shape[axis] for level in levels]) for axis in (0, 1))
        starts = np.concatenate([[0], np.cumsum(heights * widths)[:-1]])
        return Pyramid(np.concatenate([level.reshape(-1, 4) for level in levels]), starts, heights, widths, is_packed)

    @property
    def mean(self) -> np.ndarray:
        """(4,) float32 mean of colour times coverage, and of coverage."""
        return self.texels[-1]

    def _corner(self, x: np.ndarray, y: np.ndarray, start: np.ndarray, width: np.ndarray, height: np.ndarray,
                extension: str) -> np.ndarray:
        if extension == "REPEAT":
            return self.texels[start + (y % height) * width + x % width]
        if extension == "MIRROR":
            x, y = x % (2 * width), y % (2 * height)
            x, y = np.minimum(x, 2 * width - 1 - x), np.minimum(y, 2 * height - 1 - y)
            return self.texels[start + y * width + x]
        inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        found = self.texels[start + np.clip(y, 0, height - 1) * width + np.clip(x, 0, width - 1)]
        return np.where(inside[:, None], found, 0) if extension == "CLIP" else found

    def sample(self, uv: np.ndarray, extension: str = "REPEAT") -> np.ndarray:
        """(N, 4) float32 at the points `uv` (N, 2), N = 3 T: the samples of T triangles, blurred to the triangle's size.

        The level is the one whose two texels, which bilinear filtering spans, are at most the longest edge between the
        three samples. `extension` is the Image Texture node's. Where `uv` is not finite the image's mean is given.
        """
        finite = np.isfinite(uv).all(-1)
        uv = np.where(finite[:, None], uv, 0).astype(np.float64)
        corners = uv.reshape(-1, 3, 2) * [self.widths[0], self.heights[0]]
        edge_px = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1).max(-1)
        level = np.floor(np.log2(np.maximum(edge_px / 2, 1))).astype(np.int64)
        level = np.repeat(np.minimum(level, len(self.starts) - 1), 3)
        start, width, height = self.starts[level], self.widths[level], self.heights[level]
        if extension == "REPEAT":
            uv = uv - np.floor(uv)
        place = np.clip(uv, -1e4, 1e4) * np.stack([width, height], -1) - 0.5
        low = np.floor(place)
        x, y = low.astype(np.int64).T
        right, up = (place - low).astype(np.float32).T[:, :, None]
        args = (start, width, height, extension)
        out = (self._corner(x, y, *args) * (1 - right) + self._corner(x + 1, y, *args) * right) * (1 - up)
        out += (self._corner(x, y + 1, *args) * (1 - right) + self._corner(x + 1, y + 1, *args) * right) * up
        return np.where(finite[:, None], out, self.mean)


def _is_linear(image: bpy.types.Image) -> bool:
    """Whether the stored numbers are linear: float images (Blender converts them on loading), data and linear spaces."""
    space = image.colorspace_settings
    return image.is_float or space.is_data or space.name.startswith(("Linear", "Non-Color", "Raw"))


def read_pyramid(image: bpy.types.Image) -> Pyramid | None:
    """The pyramid of a datablock's pixels; None where it has none (a missing file, a viewer)."""
    width, height = image.size
    if width < 1 or height < 1 or image.source == "VIEWER":
        return None
    channels = image.channels
    flat = np.empty(width * height * channels, np.float32)
    if len(image.pixels) != len(flat):
        return None
    image.pixels.foreach_get(flat)
    stride = max(1, max(width, height) // _READ_PX)
    pixels = np.nan_to_num(flat.reshape(height, width, channels)[::stride, ::stride], posinf=0.0, neginf=0.0)
    colour = pixels[..., :3] if channels >= 3 else np.repeat(pixels[..., :1], 3, axis=-1)
    if not _is_linear(image):
        # only byte images get here, so the table is exact
        colour = _DECODED_BYTES[np.clip(colour * 255 + 0.5, 0, 255).astype(np.uint8)]
    alpha = pixels[..., 3:4] if channels == 4 and image.alpha_mode != "NONE" else np.ones_like(colour[..., :1])
    is_packed = image.alpha_mode == "CHANNEL_PACKED"
    # float buffers hold premultiplied colour, byte buffers straight colour
    if not image.is_float and not is_packed:
        colour = colour * alpha
    return Pyramid.build(np.concatenate([colour, alpha], -1), is_packed)


def image_key(image: bpy.types.Image, frame: int) -> tuple:
    """What a pyramid depends on, without reading a pixel; equal keys mean equal pixels unless the image is painted on."""
    source, packed = image.source, image.packed_file
    key: tuple = (image.name_full, source, image.filepath, tuple(image.size), image.channels, image.is_float,
                  image.colorspace_settings.name, image.alpha_mode)
    if source == "GENERATED":
        key += (image.generated_type, tuple(image.generated_color))
    elif packed is not None:
        data = packed.data
        key += (len(data), zlib.crc32(data[:_KEY_BYTES]), zlib.crc32(data[-_KEY_BYTES:]))
    else:
        path = bpy.path.abspath(image.filepath, library=image.library)
        try:
            status = os.stat(path)
            key += (status.st_mtime_ns, status.st_size)
        except OSError:
            key += ("missing",)
    return key + ((frame,) if source in {"SEQUENCE", "MOVIE"} else ())


class ImageCache:
    """Pyramids of the images of a scene, kept between frames; images with unsaved strokes are read anew each frame."""

    def __init__(self) -> None:
        self._pyramids: dict[tuple, Pyramid | None] = {}
        self._frame = 0
        self._strokes = 0
        self._keys: dict[str, tuple] = {}

    def begin(self, frame: int) -> None:
        """Start reading a frame: what changed outside is noticed now, and not again before the next frame."""
        live = set(self._keys.values())
        self._pyramids = {key: pyramid for key, pyramid in self._pyramids.items() if key in live}
        self._frame = frame
        self._strokes += 1
        self._keys = {}

    def key(self, image: bpy.types.Image) -> tuple:
        """A key that changes whenever the pixels may have changed."""
        name = image.name_full
        if name not in self._keys:
            key = image_key(image, self._frame)
            self._keys[name] = key + (("painted", self._strokes) if image.is_dirty else ())
        return self._keys[name]

    def pyramid(self, image: bpy.types.Image) -> Pyramid | None:
        """The image's pyramid, read at most once for each state of the image."""
        key = self.key(image)
        if key not in self._pyramids:
            self._pyramids[key] = read_pyramid(image)
        return self._pyramids[key]
