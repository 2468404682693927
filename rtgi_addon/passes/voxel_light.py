"""Light in the voxels: what each side of their surfaces sends, and the hierarchy over it.

The light pass of voxel cone tracing [1, section 5]: every texel of the light views, a small lamp as in reflective shadow
maps, adds its reflected flux to the sides of the voxel surfaces that it lies on. A side of area A that reflects the flux Phi
sends
    L = Phi / (pi A)
in all directions, up to a multiple of the brightest of its texels; its glossy lobe is kept beside it, one for each light
view. So the flux that the views caught is the flux that the voxels send, up to slivers of surfaces. The hierarchy joins
eight children to one, apart for each of six directions [1, section 4].

References
----------
.. [1] Crassin, Neyret, Sainz, Green, Eisemann. Interactive Indirect Illumination Using Voxel Cone Tracing. Computer
   Graphics Forum 30(7), 2011. doi:10.1111/j.1467-8659.2011.02063.x
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from ..core.frame import Frame
from ..kernels.clusters import DIFFUSE, GLOSSY
from ..kernels.vec3 import f32
from ..kernels.voxel_gather import L_ALPHA2, L_LAST, L_NORMAL, L_TO_LIGHT, LOBE_COLUMNS, SIDE_COLUMNS
from ..kernels.voxel_levels import Levels, fill_level0, fill_parents, mark_parents
from ..kernels.voxel_texels import LOBE_SUMS, add_texels, find_sides, measure_texels
from .rsm import is_reflecting, texel_table
from .voxel_scene import VoxelScene

LEEWAY = 8                  # a side may send this many times what its brightest texel does; slivers gathered hundreds
GOOD_SCORE = 0.5            # alignment less distance in cells at which a texel's own cell is not doubted


@dataclass(frozen=True)
class LitVoxels:
    """What the sides of the voxels send.

    radiance (V, 6, SIDE_COLUMNS) float32 and lobes (G, LOBE_COLUMNS) float32 as in `kernels.voxel_gather`; flux_w (3,)
    float64: what was to be sent; lost_w (3,) float64: the part of it that lay on no voxel, or on a side without area or with
    less than it takes to send it.
    """

    radiance: np.ndarray
    lobes: np.ndarray
    flux_w: np.ndarray
    lost_w: np.ndarray

    @property
    def is_black(self) -> bool:
        return not self.radiance[..., :3].any() and not len(self.lobes)


def side_areas(scene: VoxelScene) -> np.ndarray:
    """(6 V,) float32 m2: area of each side that rays meet."""
    return np.repeat(scene.voxels.seen.ravel(), 2) * np.float32(scene.grid.cell_m**2)


def light_voxels(frame: Frame, scene: VoxelScene, use_glossy: bool = True) -> LitVoxels:
    """The light pass: light of the lamps, reflected once, on every side of the voxels.

    Holds exactly: the flux that the sides send is what the texels on them reflect, up to rounding; linear in the lamps'
    power. Ignores that the lamps light one part of a voxel's side and not another.
    """
    number, area_m2 = 6 * len(scene), side_areas(scene)
    is_hidden = area_m2 <= 0                     # slivers that no ray meets: their light goes nowhere
    diffuse, of_side, lobes = np.zeros((number, 3), np.float32), [], []
    sent_w, most_w_m2 = np.zeros(number, np.float32), np.zeros(number, np.float32)
    flux_w, lost_w = np.zeros(3), np.zeros(3)
    shape, origin, rcp_cell = np.array(scene.grid.shape), np.array(scene.grid.origin_ws), 1.0 / scene.grid.cell_m
    for index, view in enumerate(frame.views):
        table = texel_table(dataclasses.replace(frame, views=frame.views[index:index + 1]), use_glossy)
        texels = np.flatnonzero(is_reflecting(view.gbuffer, view.incident_flux, frame.lights[view.light_index], use_glossy))
        edges, parts = measure_texels(view.gbuffer.position_ws, view.gbuffer.normal_ws, texels, f32(rcp_cell))
        first = np.concatenate([[0], np.cumsum(parts.prod(1))])
        sides = find_sides(scene.walk, shape, table, edges, parts, first, origin, rcp_cell, f32(GOOD_SCORE))
        sums = np.zeros((number if use_glossy else 0, LOBE_SUMS), np.float32)
        brightest = np.zeros(number, np.float32)
        lost_w += add_texels(table, sides, first, edges, diffuse, sums, brightest)
        most_w_m2 += brightest
        lost_w += sums[is_hidden[:len(sums)], :3].sum(0, dtype=np.float64)
        sums[is_hidden[:len(sums)]] = 0
        glossy = np.flatnonzero(sums[:, -1])
        sent_w[glossy] += sums[glossy, -1]
        of_side.append(glossy)
        lobes.append(_mean_lobes(sums[glossy], area_m2[glossy]))
        flux_w += table[DIFFUSE:DIFFUSE + 3].sum(1, dtype=np.float64) + table[GLOSSY:GLOSSY + 3].sum(1, dtype=np.float64)
    radiance = np.zeros((len(scene), 6, SIDE_COLUMNS), np.float32)
    flat = radiance.reshape(-1, SIDE_COLUMNS)
    lost_w += diffuse[is_hidden].sum(0, dtype=np.float64)
    sent_w += diffuse.mean(1)
    # a surface of which a voxel holds a sliver sends no more from there than from beside it
    kept = np.minimum(LEEWAY * most_w_m2 * area_m2 / np.maximum(sent_w, 1e-30), 1).astype(np.float32)
    for sides, of_them in zip(of_side, lobes, strict=True):
        lost_w += ((1 - kept[sides]) * area_m2[sides]) @ of_them[:, :3].astype(np.float64)
        of_them[:, :3] *= kept[sides, None]
    lit = np.flatnonzero(diffuse.any(1) & ~is_hidden)
    lost_w += (1 - kept[lit]) @ diffuse[lit].astype(np.float64)
    flat[lit, :3] = kept[lit, None] * diffuse[lit] / (np.float32(np.pi) * area_m2[lit, None])
    return LitVoxels(radiance, _list_lobes(flat, of_side, lobes), flux_w, lost_w)


def _mean_lobes(sums: np.ndarray, area_m2: np.ndarray) -> np.ndarray:
    """(n, LOBE_COLUMNS) lobes from the sums of `add_texels`: colour by area, unit vectors, means of the rest."""
    out = np.zeros((len(sums), LOBE_COLUMNS), np.float32)
    out[:, :3] = sums[:, :3] / area_m2[:, None]
    for at in (L_NORMAL, L_TO_LIGHT):
        length = np.linalg.norm(sums[:, at:at + 3], axis=1, keepdims=True)
        out[:, at:at + 3] = sums[:, at:at + 3] / np.maximum(length, 1e-30)
    out[:, L_ALPHA2:L_ALPHA2 + 2] = sums[:, L_ALPHA2:L_ALPHA2 + 2] / sums[:, -1:]
    return out


def _list_lobes(flat: np.ndarray, of_side: list[np.ndarray], lobes: list[np.ndarray]) -> np.ndarray:
    """All lobes, those of one side behind each other and the last of them marked; their place into column 3 of `flat`."""
    side = np.concatenate([np.zeros(0, np.int64), *of_side])
    order = np.argsort(side, kind="stable")
    side, out = side[order], np.concatenate([np.zeros((0, LOBE_COLUMNS), np.float32), *lobes])[order]
    if len(side):
        is_last = np.append(side[1:] != side[:-1], True)
        out[:, L_LAST] = is_last
        begins = np.flatnonzero(np.append(True, is_last[:-1]))
        flat[side[begins], 3] = begins + 1
    return out


def emissive_voxels(scene: VoxelScene) -> LitVoxels:
    """The light of emissive surfaces, from both of their sides; their flux is kept where rays meet more than their area."""
    radiance = np.zeros((len(scene), 6, SIDE_COLUMNS), np.float32)
    share = scene.voxels.areas / np.maximum(scene.voxels.seen, 1e-9)
    radiance[..., :3] = np.repeat(scene.voxels.emission * share[..., None], 2, axis=1)
    flux = np.pi * (radiance[..., :3].reshape(-1, 3) * side_areas(scene)[:, None]).sum(0, dtype=np.float64)
    return LitVoxels(radiance, np.zeros((0, LOBE_COLUMNS), np.float32), flux, np.zeros(3))


def dark_voxels(scene: VoxelScene) -> LitVoxels:
    """Voxels that send nothing, and only stand in the way."""
    radiance, no_lobes = np.zeros((len(scene), 6, SIDE_COLUMNS), np.float32), np.zeros((0, LOBE_COLUMNS), np.float32)
    return LitVoxels(radiance, no_lobes, np.zeros(3), np.zeros(3))


def aim_at(scene: VoxelScene, lit: LitVoxels) -> tuple[np.ndarray, np.ndarray]:
    """(targets (S,) int32, cdf (S,) float64): the sides that send light without a lobe, drawn in proportion to it.

    Writes the density of the draw into `lit.radiance`.
    """
    flat, area = lit.radiance.reshape(-1, SIDE_COLUMNS), np.repeat(scene.voxels.seen.ravel(), 2)
    power = flat[:, :3].sum(1, dtype=np.float64) * area
    targets = np.flatnonzero(power > 0)
    if not len(targets):
        return targets.astype(np.int32), np.zeros(0)
    mass = power[targets] / power[targets].sum()
    flat[targets, 4] = mass / area[targets]
    cdf = np.cumsum(mass)
    cdf[-1] = 1.0
    return targets.astype(np.int32), cdf


def levels_of(scene: VoxelScene, lit: LitVoxels, solid: np.ndarray | None = None) -> Levels:
    """The hierarchy over lit voxels; cells of `solid` (nx, ny, nz) bool that hold no surface are opaque and black."""
    number, index = len(scene), scene.voxels.index
    filled = 0
    if solid is not None:
        index = index.copy()
        filled = int(solid.sum())
        index[solid] = np.arange(number, number + filled)
    indices, parts = [index], []
    total = number + filled
    while max(indices[-1].shape) > 1:
        parents = np.full([-(-n // 2) for n in indices[-1].shape], -1, np.int32)
        mark_parents(indices[-1], parents)
        cells = np.argwhere(parents >= 0).astype(np.int32)
        parents[tuple(cells.T)] = np.arange(total, total + len(cells), dtype=np.int32)
        total += len(cells)
        indices.append(parents)
        parts.append(cells)
    coverage, light = np.zeros((total, 3), np.float32), np.zeros((total, 6, 3), np.float32)
    coverage[number:number + filled] = 1
    sides = scene.voxels
    fill_level0(number, sides.planes, sides.areas, sides.seen, _without_direction(scene, lit), coverage, light)
    base = number + filled
    for cells, children in zip(parts, indices[:-1], strict=True):
        fill_parents(len(cells), cells, children, base, coverage, light)
        base += len(cells)
    first = np.concatenate([[0], np.cumsum([i.size for i in indices[:-1]])]).astype(np.int64)
    return Levels(np.concatenate([i.ravel() for i in indices]), first, np.array([i.shape for i in indices], np.int64),
                  coverage, light)


def _without_direction(scene: VoxelScene, lit: LitVoxels) -> np.ndarray:
    """(V, 6, 3) float32 radiance with the lobes' colours as if they went in all directions: a level has no lobes."""
    radiance = lit.radiance[..., :3].copy()
    if len(lit.lobes):
        flat, start = radiance.reshape(-1, 3), lit.radiance.reshape(-1, SIDE_COLUMNS)[:, 3]
        side = np.flatnonzero(start)
        sums = np.add.reduceat(lit.lobes[:, :3], start[side].astype(np.int64) - 1, axis=0)
        flat[side] += sums / np.float32(np.pi)
    return radiance
