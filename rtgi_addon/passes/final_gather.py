"""The bounce of light that no lamp sends: of the world and of emissive surfaces, by final gathering.

Rays leave each gather point by the cosine. Where one meets what the camera sees, the picture tells the light there, without
noise; elsewhere one ray more, from the hit, finds the world or an emissive surface (`kernels.scene_light`).
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from ..core.frame import Frame
from ..core.techniques import FinalGatherParams
from ..kernels.brdf import albedo_table, mean_albedo_table
from ..kernels.depth_pyramid import build_pyramid
from ..kernels.gloss_pixels import mean_colours
from ..kernels.lit_hits import Gloss
from ..kernels.reflect import Rules, aim_rays, make_rays
from ..kernels.scene_light import ask_scene
from ..kernels.vec3 import f32
from .base import Context, PassResult, Technique, Transport
from .lattice import gather_on_lattice
from .screen import screen_of
from .surroundings import leave_surfaces, pack_lights, reach_out_m, surroundings_of


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
    Holds exactly: linear in light; zero for none; the same bits on any number of threads. Takes the glossy lobe of the
    surface between as a matt one. Off the picture small emissive surfaces are met by few rays, so that their bounce is
    noisy there.
    """
    g = frame.gbuffer
    if frame.geometry is None or not (frame.geometry.emission.any() or not frame.world.is_black):
        return PassResult({Transport.WORLD_BOUNCE_DIFFUSE: np.zeros_like(g.albedo)})
    screen, bvh, reach_m = screen_of(frame), context.bvh(frame.geometry), reach_out_m(frame, context.bvh(frame.geometry))
    planes = build_pyramid(screen, 0.5, has_levels=False).planes
    black, geometry = np.zeros_like(g.albedo), frame.geometry
    # what the surface between reflects of its glossy lobe goes the way of the matt one: the energy is right
    lobes = np.zeros_like(g.specular)
    mean_colours(g.shape[0], screen, g.mask, g.roughness, g.f0, g.specular, albedo_table(frame.keeps_energy),
                 mean_albedo_table(frame.keeps_energy), lobes)
    whole = dataclasses.replace(frame, gbuffer=dataclasses.replace(g, albedo=np.minimum(g.albedo + lobes, 1)))
    leaving = leave_surfaces(whole, context, (Transport.WORLD_DIFFUSE, Transport.EMISSION_DIFFUSE))
    around = surroundings_of(frame, geometry)
    specular = np.array([material.specular for material in frame.materials] or [(0, 0, 0)], np.float32)[around.material]
    around = around._replace(albedo=np.minimum(around.albedo + specular[:, None], 1),
                             substance=around.substance * np.float32([0, 0, 0, 1, 1]))
    nothing = np.zeros(g.shape, np.float32)
    matt = np.ones_like(g.roughness)
    gloss = Gloss(leaving, black, nothing, black, matt, nothing, albedo_table(frame.keeps_energy))
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
