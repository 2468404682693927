"""Textures as numpy arrays: (H, W, 3) float32, row 0 at the top.

Values are sRGB-encoded in [0, 1] unless said otherwise. All but `painting` and `sky` tile.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

Colour = Sequence[float]


def noise(shape: tuple[int, int], roughness: float = 1.2, stretch: float = 1.0, seed: int = 0) -> np.ndarray:
    """(H, W) periodic noise, about [-1, 1], with a spectrum of frequency**-roughness; `stretch` draws it out along x."""
    height, width = shape
    frequency = np.hypot(np.fft.fftfreq(height)[:, None] * height, np.fft.rfftfreq(width)[None, :] * width * stretch)
    frequency[0, 0] = np.inf
    white = np.random.default_rng(seed).standard_normal(shape)
    smooth = np.fft.irfft2(np.fft.rfft2(white) * frequency**-roughness, s=shape)
    return (smooth / (2.5 * smooth.std())).astype(np.float32)


def checker(light: Colour, dark: Colour, count: int = 2, size_px: int = 256) -> np.ndarray:
    """`count` by `count` squares with a faint grain."""
    cell = np.arange(size_px) * count // size_px
    is_dark = (cell[:, None] + cell[None, :]) % 2 == 1
    return _shade(np.where(is_dark[..., None], dark, light), 1 + 0.05 * noise((size_px, size_px)))


def stone(colour: Colour, joint: Colour, rows: int = 4, columns: int = 2, size_px: int = 512, seed: int = 0) -> np.ndarray:
    """Blocks in running bond, each of its own shade, with joints."""
    y, x = np.mgrid[0:size_px, 0:size_px] / size_px
    row = np.floor(y * rows).astype(int)
    shifted = (x * columns + 0.5 * (row % 2)) % columns
    block = row * columns + np.floor(shifted).astype(int)
    shades = 1 + 0.12 * np.random.default_rng(seed).uniform(-1, 1, rows * columns)
    edge_rows = np.abs((y * rows) % 1 - 0.5) > 0.5 - 0.006 * rows
    edge_columns = np.abs(shifted % 1 - 0.5) > 0.5 - 0.006 * columns
    is_joint = (edge_rows | edge_columns)[..., None]
    blocks = _shade(
        np.broadcast_to(colour, (size_px, size_px, 3)), shades[block] * (1 + 0.1 * noise((size_px, size_px), 0.9, seed=seed))
    )
    return np.where(is_joint, np.float32(joint), blocks)


def planks(colour: Colour, rows: int = 8, size_px: int = 512, seed: int = 0) -> np.ndarray:
    """Floor boards along x, with grain."""
    row = np.arange(size_px) * rows // size_px
    shades = 1 + 0.18 * np.random.default_rng(seed).uniform(-1, 1, rows)
    gap = np.where((np.arange(size_px) * rows) % size_px < 0.03 * size_px, 0.45, 1.0)
    grain = 1 + 0.14 * noise((size_px, size_px), 0.9, stretch=14.0, seed=seed)
    return _shade(np.broadcast_to(colour, (size_px, size_px, 3)), (shades[row] * gap)[:, None] * grain)


def stripes(colours: Sequence[Colour], size_px: int = 256) -> np.ndarray:
    """Bands across x, as on a rug, with a woven grain."""
    band = np.arange(size_px) * len(colours) // size_px
    woven = 1 + 0.08 * np.random.default_rng(1).uniform(-1, 1, (size_px, size_px))
    return _shade(np.broadcast_to(np.array(colours)[band], (size_px, size_px, 3)), woven)


def painting(size_px: int = 256, seed: int = 0) -> np.ndarray:
    """An abstract picture: overlapping discs of warm and cold colours."""
    random = np.random.default_rng(seed)
    y, x = np.mgrid[0:size_px, 0:size_px] / size_px
    picture = np.full((size_px, size_px, 3), (0.93, 0.88, 0.76))
    for colour in ((0.85, 0.25, 0.15), (0.1, 0.35, 0.55), (0.95, 0.7, 0.15), (0.12, 0.5, 0.4), (0.2, 0.15, 0.2)) * 2:
        centre_y, centre_x, radius = random.uniform(0.1, 0.9), random.uniform(0.1, 0.9), random.uniform(0.06, 0.24)
        inside = np.hypot(y - centre_y, x - centre_x) < radius
        picture[inside] = 0.25 * picture[inside] + 0.75 * np.array(colour)
    return picture.astype(np.float32)


def sky(sun_azimuth_deg: float, sun_elevation_deg: float, width_px: int = 512) -> np.ndarray:
    """An evening sky as an equirectangular panorama, scene-linear, with a wide glow round the place of the sun.

    Blender's convention: the middle of the image lies along +x, azimuth grows towards +y (to the left), the top row is the
    zenith.
    """
    height = width_px // 2
    elevation = np.pi * (0.5 - (np.arange(height) + 0.5) / height)[:, None]
    azimuth = np.pi * (1 - 2 * (np.arange(width_px) + 0.5) / width_px)[None, :]
    sun_azimuth, sun_elevation = np.radians([sun_azimuth_deg, sun_elevation_deg])
    cosine = np.sin(elevation) * np.sin(sun_elevation)
    cosine = cosine + np.cos(elevation) * np.cos(sun_elevation) * np.cos(azimuth - sun_azimuth)
    up = np.clip(np.sin(elevation), 0, 1)[..., None] ** 0.45 * np.ones((1, width_px, 1))
    dome = (1 - up) * np.array([0.75, 0.55, 0.45]) + up * np.array([0.10, 0.22, 0.55])
    glow = np.exp(np.clip(cosine - 1, -2, 0) / 0.02)[..., None] * np.array([9.0, 5.0, 2.0])
    halo = np.exp(np.clip(cosine - 1, -2, 0) / 0.25)[..., None] * np.array([0.9, 0.45, 0.2])
    clouds = (
        np.clip(noise((height, width_px), 1.6, stretch=0.5, seed=5), 0, 1)[..., None] * (1 - up) * np.array([0.5, 0.4, 0.4])
    )
    ground = np.array([0.10, 0.085, 0.07])
    return np.where((elevation > 0)[..., None], dome + glow + halo + clouds, ground).astype(np.float32)


def _shade(colours: np.ndarray, factor: np.ndarray) -> np.ndarray:
    return np.clip(colours * factor[..., None], 0, 1).astype(np.float32)
