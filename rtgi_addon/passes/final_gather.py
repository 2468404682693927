"""The bounce of light that no lamp sends: of the world and of emissive surfaces, by final gathering.

Rays leave each gather point by the cosine. Where one meets what the camera sees, the picture tells the matt surface's light
there, without noise; elsewhere one ray more, from the hit, finds the world or an emissive surface, and so does one from the
hit's glossy lobe (`kernels.scene_light`).
"""

from __future__ import annotations

import math

import numpy as np

from ..core.frame import Frame
from ..core.techniques import FinalGatherParams
from ..kernels.brdf import albedo_table
from ..kernels.depth_pyramid import build_pyramid
from ..kernels.lit_hits import Gloss
from ..kernels.reflect import Rules, aim_rays, make_rays
from ..kernels.scene_light import ask_scene
from ..kernels.vec3 import f32
from .base import Context, PassResult, Technique, Transport
from .lattice import gather_on_lattice
from .screen import screen_of
from .surroundings import leave_surfaces, pack_lights, reach_out_m, surroundings_of

RECEIVER = 0.7              # roughness of the lobe that a matt surface counts as where hits soften their highlights for it:
                            # 1 sends a fifth of a mirror's light the wrong way, this a seventh, less leaves specks


def compute_final_gather(frame: Frame, params: FinalGatherParams, context: Context, seed: int = 0) -> PassResult:
    """One-bounce diffuse irradiance of the light of the world and of emissive surfaces.

    Parameters
    ----------
    frame : Frame
        With `geometry`.
    params : FinalGatherParams
    context : Context
        `light` holds what earlier techniques found of the world's and the emissive surfaces' light at the camera's pixels.
    seed : int

    Returns
    -------
    PassResult
        WORLD_BOUNCE_DIFFUSE: (H, W, 3) float32 W/m2. Diagnostics: share of the pixels gathered.

    Raises
    ------
    Cancelled
        When the user asked to stop.

    Notes
    -----
    Holds exactly: linear in light; zero for none; the same bits on any number of threads. What mirrors throw is met by few
    rays and noisy.
    """
    g = frame.gbuffer
    if frame.geometry is None or not (frame.geometry.emission.any() or not frame.world.is_black):
        return PassResult({Transport.WORLD_BOUNCE_DIFFUSE: np.zeros_like(g.albedo)})
    screen, bvh, reach_m = screen_of(frame), context.bvh(frame.geometry), reach_out_m(frame, context.bvh(frame.geometry))
    planes = build_pyramid(screen, 0.5, has_levels=False).planes
    black, geometry = np.zeros_like(g.albedo), frame.geometry
    leaving = leave_surfaces(frame, context, (Transport.WORLD_DIFFUSE, Transport.EMISSION_DIFFUSE))
    around = surroundings_of(frame, geometry)
    nothing = np.zeros(g.shape, np.float32)
    matt = np.full_like(g.roughness, RECEIVER)
    gloss = Gloss(leaving, black, nothing, black, matt, nothing, albedo_table())
    rules = Rules(0, 1.0, True, True, False, f32(0), f32(frame.ray_offset_m), f32(reach_m))
    lights = pack_lights((), reach_m)

    def gather(position: np.ndarray, normal: np.ndarray, ids: np.ndarray, places: np.ndarray, salt: int) -> np.ndarray:
        rays = make_rays(len(ids) * params.rays)
        aim_rays(len(ids), position, normal, places, params.rays, rules.offset_m, salt, rays)
        asked = np.arange(len(rays.answer))
        ask_scene(len(asked), asked, ids, params.rays, screen, planes, gloss, lights, bvh, around, rules, salt, rays)
        light = rays.light[:, :3].reshape(len(ids), params.rays, 3) * np.float32(math.pi)
        out = np.ones((len(ids), 5), np.float32)     # nothing is known of the unshadowed light
        out[:, :3] = light.mean(1)
        out[:, 4] = light.mean(2).var(1) / params.rays
        return out

    irradiance, diagnostics = gather_on_lattice(frame, gather, params.lattice_px, 2 * seed + 7, context, "Final gather")
    return PassResult({Transport.WORLD_BOUNCE_DIFFUSE: irradiance}, diagnostics=diagnostics)


TECHNIQUE = Technique("final_gather", "Final Gathering", FinalGatherParams, compute_final_gather,
                      frozenset({Transport.WORLD_BOUNCE_DIFFUSE}), needs_geometry=True)
