"""Voxel global illumination: lit voxels, their hierarchy, and cones from the pixels.

Light pass [1, section 5]: every texel of the light views, a small lamp as in reflective shadow maps, adds its reflected flux
to the side of the voxel surface that it lies on. A side of area A that reflects the flux Phi sends the radiance
    L = Phi / (pi A)
in all directions, and its glossy lobe on top; so the flux that the views caught is the flux that the voxels send.

Camera pass [1, section 7]: N cones share the hemisphere by cosine, and the irradiance is
    E = pi / N * sum_i (radiance that fills cone i)
Here a cone is followed as an exact ray through the voxels' surfaces for its first `exact_voxels` cells, and goes on as a cone
through the levels from there.

References
----------
.. [1] Crassin, Neyret, Sainz, Green, Eisemann. Interactive Indirect Illumination Using Voxel Cone Tracing. Computer
   Graphics Forum 30(7), 2011. doi:10.1111/j.1467-8659.2011.02063.x
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..core.frame import Frame
from ..core.techniques import VxgiParams
from ..kernels.clusters import DIFFUSE, GLOSSY
from ..kernels.vec3 import f32
from ..kernels.voxel_gather import L_LAST, LOBE_COLUMNS, gather_voxels
from ..kernels.voxel_levels import Levels, fill_level0, fill_parents, mark_parents
from ..kernels.voxel_rays import LOBE_SUMS, add_texels, find_sides
from .base import Context, PassResult, Technique, Transport
from .lattice import gather_on_lattice
from .rsm import texel_table
from .voxel_scene import VoxelScene, grid_of_frame, voxel_scene

GOOD_SCORE = 0.5            # alignment less distance in cells at which a texel's own cell is not doubted
BLACK_SKY = np.zeros((1, 1, 3), np.float32)


@dataclass(frozen=True)
class LitVoxels:
    """What the sides of the voxels send: radiance (V, 6, 4) float32 and lobes (G, LOBE_COLUMNS) float32 as in
    `kernels.voxel_gather`, flux_w (3,) caught by the views, lost_w (3,) of it that no voxel took."""

    radiance: np.ndarray
    lobes: np.ndarray
    flux_w: np.ndarray
    lost_w: np.ndarray


def light_voxels(frame: Frame, scene: VoxelScene, use_glossy: bool = True) -> LitVoxels:
    """The light pass: reflected light of the lamps on every side of the voxels.

    Holds exactly: the flux that the sides send is what the texels on them reflect, up to rounding.
    """
    number = 6 * len(scene)
    table = texel_table(frame, use_glossy)
    sides = find_sides(scene.walk, table, np.asarray(scene.grid.origin_ws, np.float64), 1.0 / scene.grid.cell_m,
                       f32(GOOD_SCORE))
    diffuse = np.zeros((number, 3), np.float32)
    area_m2 = np.repeat(scene.voxels.areas.ravel(), 2) * np.float32(scene.grid.cell_m**2)
    found, of_side = [], []
    for first, last in _runs(frame, table, use_glossy):
        sums = np.zeros((number if use_glossy else 0, LOBE_SUMS), np.float32)
        add_texels(table, sides, first, last, diffuse, sums)
        lit = np.flatnonzero(sums[:, -1])
        found.append(_lobes(sums[lit], area_m2[lit]))
        of_side.append(lit)
    radiance = np.zeros((len(scene), 6, 4), np.float32)
    flat = radiance.reshape(-1, 4)
    lit = np.flatnonzero(diffuse.any(1))
    flat[lit, :3] = diffuse[lit] / (np.float32(np.pi) * area_m2[lit, None])
    lobes = np.zeros((0, LOBE_COLUMNS), np.float32)
    if found:
        side = np.concatenate(of_side)
        order = np.argsort(side, kind="stable")
        side, lobes = side[order], np.concatenate(found)[order]
        ends = np.append(side[1:] != side[:-1], True) if len(side) else np.zeros(0, bool)
        lobes[:, L_LAST] = ends
        begins = np.flatnonzero(np.append(True, ends[:-1])) if len(side) else np.zeros(0, int)
        flat[side[begins], 3] = begins + 1
    flux = table[DIFFUSE:DIFFUSE + 3] + table[GLOSSY:GLOSSY + 3]
    return LitVoxels(radiance, lobes, flux.sum(1, dtype=np.float64), flux[:, sides < 0].sum(1, dtype=np.float64))


def _runs(frame, table, use_glossy):
    from .rsm import _reflecting

    offset = 0
    for view in frame.views:
        count = int(np.count_nonzero(_reflecting(view, use_glossy)))
        yield offset, offset + count
        offset += count


def _lobes(sums: np.ndarray, area_m2: np.ndarray) -> np.ndarray:
    """(n, LOBE_COLUMNS) lobes of the sums of `add_texels`: colour by area, means of the rest, unit vectors."""
    out = np.zeros((len(sums), LOBE_COLUMNS), np.float32)
    out[:, :3] = sums[:, :3] / area_m2[:, None]
    for at in (3, 6):
        v = sums[:, at:at + 3]
        out[:, at:at + 3] = v / np.maximum(np.linalg.norm(v, axis=1, keepdims=True), 1e-30)
    out[:, 9:11] = sums[:, 9:11] / sums[:, 11:12]
    return out


def emissive_voxels(scene: VoxelScene) -> LitVoxels:
    """The light of emissive surfaces on both of their sides."""
    radiance = np.zeros((len(scene), 6, 4), np.float32)
    radiance[..., :3] = np.repeat(scene.voxels.emission, 2, axis=1)
    return LitVoxels(radiance, np.zeros((0, LOBE_COLUMNS), np.float32), np.zeros(3), np.zeros(3))


def levels_of(scene: VoxelScene, radiance: np.ndarray) -> Levels:
    """The hierarchy over lit voxels; `radiance` (V, 6, 3 or more) by side."""
    indices, parts = [scene.voxels.index], [np.zeros((0, 3), np.int32)]
    while max(indices[-1].shape) > 1:
        parents = np.full([-(-n // 2) for n in indices[-1].shape], -1, np.int32)
        mark_parents(indices[-1], parents)
        cells = np.argwhere(parents >= 0).astype(np.int32)
        base = len(scene) + sum(len(p) for p in parts)
        parents[tuple(cells.T)] = np.arange(base, base + len(cells), dtype=np.int32)
        indices.append(parents)
        parts.append(cells)
    total = len(scene) + sum(len(p) for p in parts)
    coverage, light = np.zeros((total, 3), np.float32), np.zeros((total, 6, 3), np.float32)
    fill_level0(scene.voxels.planes, scene.voxels.areas, radiance, coverage, light)
    base = len(scene)
    for cells, children in zip(parts[1:], indices[:-1], strict=True):
        fill_parents(cells, children, base, coverage, light)
        base += len(cells)
    first = np.concatenate([[0], np.cumsum([i.size for i in indices[:-1]])]).astype(np.int64)
    return Levels(np.concatenate([i.ravel() for i in indices]), first, np.array([i.shape for i in indices], np.int64),
                  coverage, light)


def compute_vxgi(frame: Frame, params: VxgiParams, context: Context, seed: int = 0) -> PassResult:
    """One-bounce diffuse irradiance from lit voxels."""
    g = frame.gbuffer
    context.checkpoint("Voxels", 0.0)
    scene = voxel_scene(frame.geometry, grid_of_frame(frame, context, params.resolution))
    lit = light_voxels(frame, scene, params.glossy_voxels)
    levels = levels_of(scene, lit.radiance)

    def gather(position: np.ndarray, normal: np.ndarray, ids: np.ndarray, salt: int) -> np.ndarray:
        return gather_voxels(scene.grid.to_cells(position), normal, ids, scene.walk, levels, lit.radiance, lit.lobes,
                             BLACK_SKY, params.cones, f32(params.exact_voxels), salt)

    irradiance, diagnostics = gather_on_lattice(frame, gather, params.lattice_px, 2 * seed + 5, context, "Cones")
    return PassResult({Transport.BOUNCE_DIFFUSE: irradiance}, diagnostics={
        "voxels": len(scene), "grid": list(scene.grid.shape), "cell_m": scene.grid.cell_m, **diagnostics})


TECHNIQUE = Technique("vxgi", "Voxel Global Illumination", VxgiParams, compute_vxgi,
                      frozenset({Transport.BOUNCE_DIFFUSE, Transport.EMISSION_DIFFUSE}), needs_geometry=True,
                      needs_views=True)
