"""Voxel global illumination: lit voxels, their hierarchy, and cones from the pixels.

The light pass puts the lamps' reflected light on the sides of the voxels (`voxel_light`). The camera pass [1, section 7]
splits the hemisphere of a pixel into N cones of equal cosine-weighed solid angle, and the irradiance is
    E = pi / N * sum_i (radiance that fills cone i)
A cone is followed as an exact ray through the voxels' surfaces for its first `exact_voxels` cells and as a cone through the
levels from there. With 0 this is the method as published; by default a cone is exact as far as the grid goes, because what
the levels blur is light as well as walls.

Where surfaces emit light, half of the rays are aimed at them. A glossy pixel takes one cone around its mirror direction, as
wide as its lobe.

References
----------
.. [1] Crassin, Neyret, Sainz, Green, Eisemann. Interactive Indirect Illumination Using Voxel Cone Tracing. Computer
   Graphics Forum 30(7), 2011. doi:10.1111/j.1467-8659.2011.02063.x
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..core.frame import Frame
from ..core.radiometry import brightest
from ..core.techniques import VxgiParams
from ..core.transforms import Projection
from ..kernels.sampling import PLACE_BITS, PLACE_MASK
from ..kernels.vec3 import f32
from ..kernels.voxel_gather import gather_reflections, gather_voxels
from ..kernels.voxel_levels import Levels
from .base import Context, PassResult, Technique, Transport
from .lattice import gather_on_lattice
from .sky_light import shrink_map
from .voxel_light import LitVoxels, aim_at, dark_voxels, emissive_voxels, levels_of, light_voxels
from .voxel_scene import VoxelScene, grid_of_frame, solid_cells
from .voxel_view import voxel_pictures

AIMED_SHARE = 0.5           # of the rays of a gather that looks for emissive surfaces: small lamps are rarely met by chance
INTERLEAVE = 8              # lattice points along each edge of a block that share one low-discrepancy sequence
# tangent of a glossy cone's half angle over GGX's alpha: of 0.35, 0.7, 1 and 1.5 the least error on four of five scenes
GLOSSY_SPREAD = 1.5
NO_TARGETS = (np.zeros(0, np.int32), np.zeros(0))
BLACK_SKY = np.zeros((1, 1, 3), np.float32)


def compute_vxgi(frame: Frame, params: VxgiParams, context: Context, seed: int = 0) -> PassResult:
    """Light that reaches the pixels from lit voxels.

    Parameters
    ----------
    frame : Frame
        With `views` and `geometry`.
    params : VxgiParams
    context : Context
        Asked for Esc between tiles, for the BVH that finds the grid's bounds, and for the voxels of unchanged triangles.
    seed : int
        The same seed gives bitwise the same image on any number of threads.

    Returns
    -------
    PassResult
        BOUNCE_DIFFUSE: (H, W, 3) float32 W/m2; EMISSION_DIFFUSE where surfaces in the grid emit light; WORLD_DIFFUSE with
        `world_light`, in place of what came before; BOUNCE_GLOSSY (radiance, colour included) with `glossy`.

    Raises
    ------
    Cancelled
        When the user asked to stop.

    Notes
    -----
    Linear in the lights' power; no light gives exactly zero. Light varies over a voxel's side only by its glossy lobe.
    Ignores surfaces outside the grid, transparency, and bounces after the first.
    """
    context.checkpoint("Voxels", 0.0)
    scene = context.voxels(frame.geometry, grid_of_frame(frame, context, params.resolution))
    if not len(scene):
        return PassResult({Transport.BOUNCE_DIFFUSE: np.zeros_like(frame.gbuffer.albedo)}, diagnostics={"voxels": 0})
    lit = light_voxels(frame, scene, params.glossy_voxels)
    solid = solid_cells(frame, scene) if params.solid else None
    takes_over, light = frozenset(), {}

    def diffuse(source: LitVoxels, sky: np.ndarray, number: int, is_aimed: bool = False) -> tuple[np.ndarray, dict]:
        return _diffuse(frame, params, scene, source, solid, sky, is_aimed, context, 7 * seed + 2 * number + 5)

    light[Transport.BOUNCE_DIFFUSE], diagnostics = diffuse(lit, BLACK_SKY, 0)
    emitted = emissive_voxels(scene)
    if not emitted.is_black:
        light[Transport.EMISSION_DIFFUSE], _ = diffuse(emitted, BLACK_SKY, 1, is_aimed=True)
    if params.world_light and not frame.world.is_black:
        light[Transport.WORLD_DIFFUSE], _ = diffuse(dark_voxels(scene), shrink_map(frame.world.radiance), 2)
        takes_over = frozenset({Transport.WORLD_DIFFUSE})
    levels = levels_of(scene, lit, solid) if params.glossy or params.pictures else None
    if params.glossy:
        context.checkpoint("Reflections", 0.9)
        light[Transport.BOUNCE_GLOSSY] = _glossy(frame, scene, lit, levels)
    pictures = voxel_pictures(frame, scene, lit, levels) if params.pictures else {}
    return PassResult(light, diagnostics={**_facts(scene, lit), **diagnostics}, takes_over=takes_over, pictures=pictures)


def _facts(scene: VoxelScene, lit: LitVoxels) -> dict[str, Any]:
    total = float(lit.flux_w.sum())
    return {"voxels": len(scene), "grid": list(scene.grid.shape), "voxel_m": scene.grid.cell_m, "lobes": len(lit.lobes),
            "lost_flux_share": float(lit.lost_w.sum()) / total if total > 0 else 0.0}


def _diffuse(frame: Frame, params: VxgiParams, scene: VoxelScene, lit: LitVoxels, solid: np.ndarray | None, sky: np.ndarray,
             is_aimed: bool, context: Context, seed: int) -> tuple[np.ndarray, dict[str, float]]:
    """(H, W, 3) float32 W/m2 that cones from the lattice bring, and diagnostics."""
    is_exact = params.exact_voxels >= float(np.linalg.norm(scene.grid.shape))
    levels = _no_levels() if is_exact else levels_of(scene, lit, solid)
    targets, cdf = aim_at(scene, lit) if is_aimed and is_exact else NO_TARGETS
    aimed = int(AIMED_SHARE * params.cones) if len(targets) else 0

    def gather(position: np.ndarray, normal: np.ndarray, _: np.ndarray, places: np.ndarray, salt: int) -> np.ndarray:
        row, column = (places >> PLACE_BITS) % INTERLEAVE, (places & PLACE_MASK) % INTERLEAVE
        return gather_voxels(scene.grid.to_cells(position), normal, row * INTERLEAVE + column, scene.walk,
                             scene.voxels.cells, levels, lit.radiance, lit.lobes, sky, targets, cdf, params.cones, aimed,
                             f32(params.exact_voxels), salt)

    return gather_on_lattice(frame, gather, params.lattice_px, seed, context, "Cones")


def _no_levels() -> Levels:
    """A hierarchy for cones that never read it."""
    return Levels(np.zeros(1, np.int32), np.zeros(1, np.int64), np.ones((1, 3), np.int64), np.zeros((1, 3), np.float32),
                  np.zeros((1, 6, 3), np.float32))


def _glossy(frame: Frame, scene: VoxelScene, lit: LitVoxels, levels: Levels) -> np.ndarray:
    """(H, W, 3) float32 radiance that leaves the glossy pixels, colour included: one cone each."""
    g, camera = frame.gbuffer, frame.camera
    out = np.zeros_like(g.albedo)
    shiny = g.mask & (brightest(g.specular) > 0)
    position = g.position_ws[shiny]
    if camera.projection is Projection.ORTHOGRAPHIC:
        to_viewer = np.broadcast_to(camera.world_from_view[:3, 2], position.shape)
    else:
        to_viewer = camera.position_ws - position
        to_viewer = to_viewer / np.maximum(np.linalg.norm(to_viewer, axis=1, keepdims=True), 1e-30)
    to_viewer = np.ascontiguousarray(to_viewer, np.float32)
    radiance = gather_reflections(scene.grid.to_cells(position), g.normal_ws[shiny], to_viewer, g.roughness[shiny],
                                  scene.walk, levels, lit.radiance, lit.lobes, f32(GLOSSY_SPREAD))
    out[shiny] = radiance * g.specular[shiny]
    return out


TECHNIQUE = Technique("vxgi", "Voxel Global Illumination", VxgiParams, compute_vxgi,
                      frozenset({Transport.BOUNCE_DIFFUSE, Transport.EMISSION_DIFFUSE}), needs_geometry=True,
                      needs_views=True)
