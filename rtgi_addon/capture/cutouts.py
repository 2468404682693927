"""Opacity of materials that let light straight through, as small maps for rays to look into.

What a shadow ray is told of a material (`nodes.SHADOW_PATH`) is evaluated, once, at the texels of a map over its texture
coordinates. Where the textures repeat with whole coordinates one map serves every mesh; else each mesh has its own over the
part that it uses. An opacity that depends on other things than one layer of coordinates is a mean for each triangle.
The colour of a Transparent BSDF counts as its grey.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import bpy
import numpy as np

from ..core.frame import Cutouts
from .images import ImageCache
from .materials import SurfaceReader
from .nodes import SHADOW_PATH, Points, spread_evenly

_MOST_PX = 512              # longest edge of a map: a quarter of a megabyte
_PLAIN_PX = 256             # edge where no image tells how fine it has to be
_PROBES = 1024              # triples of points at which a material is asked what its opacity depends on
_TELLS = 1 / 128            # a smaller difference of opacity is rounding of a byte
_FAR = 1e4                  # texture coordinates are cut off this many maps away from a triangle's first corner
_VEIL = 0.25                # share of a map's texels with something there from which it is a veil; outlines are soft too
_PARTLY = 0.05              # opacities so far from nothing and from all let part of the light through
_EDGE_PX = 1e-3             # a triangle that reaches less than this into a texel does not show it

# maps of one texel
EVEN = tuple(np.array([[value]], np.uint8) for value in range(256))


def _bytes(opacity: np.ndarray) -> np.ndarray:
    return np.round(np.clip(opacity, 0, 1) * 255).astype(np.uint8)


class _Grid:
    """The middles of `height` x `width` texels over a rectangle of texture coordinates, the same in every layer."""

    def __init__(self, low: Sequence[float], high: Sequence[float], height: int, width: int):
        self.shape = height, width
        # three neighbours make a triangle, which sets the blur; the last texel fills a row up to whole triangles
        column = np.minimum(np.arange(-(-width // 3) * 3), width - 1)
        x = low[0] + (column + 0.5) * ((high[0] - low[0]) / width)
        y = low[1] + (np.arange(height) + 0.5) * ((high[1] - low[1]) / height)
        flat = np.stack([*(v.ravel() for v in np.meshgrid(x, y)), np.zeros(len(x) * len(y))], 1)
        self._uv = flat.astype(np.float32)

    def uv(self, name: str) -> np.ndarray | None:
        return self._uv

    def attribute(self, name: str) -> np.ndarray | None:
        return None

    def spread(self, number: int) -> np.ndarray | None:
        return None

    def image(self, values: np.ndarray) -> np.ndarray:
        """(height, width) of values (n,) at the points, n = 1 for an even one."""
        height, width = self.shape
        return np.broadcast_to(values, len(self._uv)).reshape(height, -1)[:, :width]


class _Probe:
    """Points somewhere, in each layer elsewhere; `renew` moves one layer and leaves the others."""

    def __init__(self) -> None:
        self._random = np.random.default_rng(0)      # fixed numbers, so that a scene reads the same each time
        self._values: dict[tuple[str, str], np.ndarray] = {}

    def renew(self, need: tuple[str, str]) -> None:
        width = 3 if need[0] == "uv" else 4
        # triangles so small that textures are not blurred
        values = np.repeat(self._random.uniform(0, 1, (_PROBES, width)), 3, axis=0)
        self._values[need] = values.astype(np.float32)

    def move(self, need: tuple[str, str], by: Sequence[float]) -> None:
        self._values[need] = self._values[need] + np.float32([*by, 0.0])

    def _of(self, need: tuple[str, str]) -> np.ndarray:
        if need not in self._values:
            self.renew(need)
        return self._values[need]

    def uv(self, name: str) -> np.ndarray | None:
        return self._of(("uv", name))

    def attribute(self, name: str) -> np.ndarray | None:
        return self._of(("attribute", name))

    def spread(self, number: int) -> np.ndarray | None:
        return np.repeat(spread_evenly(_PROBES, number), 3, axis=0)


@dataclass(frozen=True)
class Opacity:
    """What a material's opacity depends on.

    Attributes
    ----------
    layer : str or None
        The layer of texture coordinates that its map lies over; None without a map.
    texels : (H, W) uint8 or None
        The map over the unit square if it repeats, or one texel for an even opacity. None where every mesh needs its own.
    size_px : (int, int)
        Width and height of the map of a unit square.
    is_told_apart : bool
        Whether a Light Path node may tell shadow rays something else than views.
    """

    layer: str | None
    texels: np.ndarray | None
    size_px: tuple[int, int]
    is_told_apart: bool

    def is_veil(self, texels: np.ndarray) -> bool:
        """Whether a map of this material is one, as `core.frame.Cutouts.is_veil`."""
        there = texels > _PARTLY * 255
        partly = there & (texels < (1 - _PARTLY) * 255)
        return bool(self.is_told_apart or partly.sum() > _VEIL * there.sum())


def shadow_trace(material: bpy.types.Material | None, images: ImageCache) -> tuple:
    """All that the opacity of a material depends on besides points."""
    reader = SurfaceReader(images, None, SHADOW_PATH)
    reader.material(material)
    return (material is not None and material.use_transparent_shadow, *reader.values.trace)


def _opacity_at(material: bpy.types.Material, images: ImageCache, points: Points) -> np.ndarray:
    """(n,) opacity at points, n = 1 for an even one."""
    return 1 - SurfaceReader(images, points, SHADOW_PATH).material(material).transparent.mean(1)


def _bake(material: bpy.types.Material, images: ImageCache, low: Sequence[float], high: Sequence[float],
          size_px: tuple[int, int]) -> np.ndarray:
    grid = _Grid(low, high, size_px[1], size_px[0])
    return _bytes(grid.image(_opacity_at(material, images, grid)))


def read_opacity(material: bpy.types.Material | None, images: ImageCache) -> Opacity | None:
    """How much of an evaluated material a shadow ray meets; None for one that stops all light."""
    if material is None or not material.use_transparent_shadow:
        return None
    probe = _Probe()
    reader = SurfaceReader(images, probe, SHADOW_PATH)
    there = 1 - reader.material(material).transparent.mean(1)
    if there.min() > 1 - _TELLS:
        return None
    apart = "LIGHT_PATH" in reader.values.found
    matters = []
    for need in sorted(reader.values.needs):
        probe.renew(need)
        again = _opacity_at(material, images, probe)
        if np.abs(again - there).max() > _TELLS:
            matters.append(need)
        there = again
    if not matters:
        return Opacity(None, EVEN[int(_bytes(there.mean()))], (1, 1), apart)
    if len(matters) > 1 or matters[0][0] != "uv":
        return Opacity(None, None, (1, 1), apart)
    width, height = reader.values.image_px
    if not width or "MAPPING" in reader.values.found:
        width = height = max(width, height, _PLAIN_PX)
    size_px = min(width, _MOST_PX), min(height, _MOST_PX)
    layer = matters[0][1]
    for by in ((1, 0), (0, 1)):
        probe.move(matters[0], by)
        # float32 coordinates move a point by a ten-thousandth of a texel
        if np.quantile(np.abs(_opacity_at(material, images, probe) - there), 0.99) > 2 * _TELLS:
            return Opacity(layer, None, size_px, apart)
    return Opacity(layer, _bake(material, images, (0, 0), (1, 1), size_px), size_px, apart)


def box_means(texels: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """(n,) float64 mean, over 255, of a repeated map (H, W) uint8 in the texels that boxes touch.

    `low` and `high` (n, 2) are the boxes' corners (x, y) in lengths of the map's edges. By the table of sums of Crow (1984).
    """
    height, width = texels.shape
    sums = np.zeros((height + 1, width + 1), np.int64)
    np.cumsum(np.cumsum(texels, 0, dtype=np.int64), 1, out=sums[1:, 1:])

    def below(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Sum of all texels left of x and under y, texels."""
        (tiles_x, x), (tiles_y, y) = np.divmod(x, width), np.divmod(y, height)
        return tiles_x * tiles_y * sums[-1, -1] + tiles_x * sums[y, -1] + tiles_y * sums[-1, x] + sums[y, x]

    size = np.array([width, height])
    x0, y0 = np.floor(low * size + _EDGE_PX).astype(np.int64).T
    x1, y1 = np.ceil(high * size - _EDGE_PX).astype(np.int64).T
    x1, y1 = np.maximum(x1, x0 + 1), np.maximum(y1, y0 + 1)
    total = below(x1, y1) - below(x0, y1) - below(x1, y0) + below(x0, y0)
    return total / (255.0 * (x1 - x0) * (y1 - y0))


@dataclass(frozen=True)
class MeshCutouts:
    """`core.frame.Cutouts` of one mesh, with maps as arrays of their own: `maps[k]` and `veils[k]` for `map_of` == k."""

    row: np.ndarray
    uv: np.ndarray
    coverage: np.ndarray
    map_of: np.ndarray
    maps: list[np.ndarray]
    veils: list[bool]


class CutoutBuilder:
    """Collects the cutouts of one mesh of T triangles, material by material."""

    def __init__(self, count: int, images: ImageCache):
        self._count, self._images = count, images
        self._chosen: list[np.ndarray] = []
        self._uv: list[np.ndarray] = []
        self._coverage: list[np.ndarray] = []
        self._map_of: list[np.ndarray] = []
        self._maps: list[np.ndarray] = []
        self._veils: list[bool] = []

    def _add(self, opacity: Opacity, chosen: np.ndarray, coverage: np.ndarray, uv: np.ndarray, map_of: np.ndarray,
             maps: Sequence[np.ndarray]) -> None:
        self._chosen.append(chosen)
        self._coverage.append(coverage)
        self._uv.append(uv)
        self._map_of.append(map_of + len(self._maps))
        self._maps += maps
        self._veils += [opacity.is_veil(texels) for texels in maps]

    def add(self, chosen: np.ndarray, material: bpy.types.Material, opacity: Opacity, coverage: np.ndarray | float,
            layer: Callable[[str, str], np.ndarray | None]) -> np.ndarray:
        """Take the triangles `chosen` (n,) of a material; (n,) bool: of which something is there.

        `coverage` (n,) or a number is the share seen; `layer` the mesh's.
        """
        coverage = np.broadcast_to(np.asarray(coverage, np.float32), len(chosen))
        values = None if opacity.layer is None else layer("uv", opacity.layer)
        if values is None:
            is_even = opacity.texels is not None and opacity.layer is None
            level = np.full(len(chosen), opacity.texels[0, 0]) if is_even else _bytes(coverage)
            used, map_of = np.unique(level, return_inverse=True)
            self._add(opacity, chosen, coverage, np.zeros((len(chosen), 3, 2), np.float32), map_of.astype(np.int32),
                      [EVEN[k] for k in used])
            return level > 0
        uv = values.reshape(-1, 3, 4)[chosen, :, :2].astype(np.float64)
        uv = np.where(np.isfinite(uv).all((1, 2), keepdims=True), uv, 0)
        texels = opacity.texels
        if texels is None:
            low, high = uv.min((0, 1)), uv.max((0, 1))
            extent = np.maximum(high - low, 1e-6)
            size_px = tuple(int(np.clip(np.ceil(e * n), 1, _MOST_PX)) for e, n in zip(extent, opacity.size_px, strict=True))
            texels = _bake(material, self._images, low, low + extent, size_px)
            uv = (uv - low) / extent
        else:
            # whole maps away is the same place, and small numbers keep their digits
            uv -= np.floor(uv[:, :1])
        uv = np.clip(uv, -_FAR, _FAR)
        there = box_means(texels, uv.min(1), uv.max(1))
        holed = there < 1
        self._add(opacity, chosen[holed], coverage[holed], uv[holed].astype(np.float32),
                  np.zeros(int(holed.sum()), np.int32), [texels])
        return there > 0

    def build(self, keep: np.ndarray) -> MeshCutouts | None:
        """Of the triangles that `keep` (T,) leaves; None where all of those are opaque."""
        if not self._chosen or not any(map(len, self._chosen)):
            return None
        chosen = np.concatenate(self._chosen)
        left = keep[chosen]
        if not left.any():
            return None
        row = np.full(self._count, -1, np.int32)
        row[chosen[left]] = np.arange(int(left.sum()), dtype=np.int32)
        return MeshCutouts(row[keep], np.concatenate(self._uv)[left], np.concatenate(self._coverage)[left],
                           np.concatenate(self._map_of)[left], self._maps, self._veils)


def join_cutouts(counts: Sequence[int], meshes: Sequence[MeshCutouts | None], most_layers: int) -> Cutouts | None:
    """The cutouts of meshes of `counts` triangles one after the other; None where every triangle is opaque."""
    if all(mesh is None for mesh in meshes):
        return None
    row = np.full(sum(counts), -1, np.int32)
    starts: dict[int, int] = {}                  # equal maps are one array, and are written once
    used: list[np.ndarray] = []
    places, veils, start, rows, texels = [], [], 0, 0, 0
    for count, mesh in zip(counts, meshes, strict=True):
        if mesh is not None:
            row[start:start + count] = np.where(mesh.row >= 0, mesh.row + rows, -1)
            for texel in mesh.maps:
                if id(texel) not in starts:
                    starts[id(texel)] = texels
                    used.append(texel)
                    texels += texel.size
            place = np.array([(starts[id(t)], *t.shape) for t in mesh.maps], np.int32)
            places.append(place[mesh.map_of])
            veils.append(np.array(mesh.veils)[mesh.map_of])
            rows += len(mesh.uv)
        start += count
    present = [mesh for mesh in meshes if mesh is not None]
    return Cutouts(row, np.concatenate([mesh.uv for mesh in present]),
                   np.concatenate([mesh.coverage for mesh in present]), np.concatenate(veils),
                   np.concatenate(places), np.concatenate([texel.ravel() for texel in used]),
                   most_layers)
