"""What rays meet beyond the picture, and what they take home, as kernels want it: for reflections and final gathering."""

from __future__ import annotations

import math

import numpy as np

from ..core.frame import Frame, GBuffer, Geometry, Light, LightKind, Material
from ..core.radiometry import find_emitters
from ..kernels.brdf import GAIN_STEPS, albedo_table, mean_albedo_table, rise_of
from ..kernels.bvh import Bvh
from ..kernels.lit_hits import Lights
from ..kernels.scene_light import Surroundings
from ..kernels.scene_view import see_triangles
from ..kernels.shines import Shines
from .base import Context, Transport
from .direct import pack_lamp
from .sky_light import shrink_map, sky_distribution

SMALL = 0.3                 # area of emissive triangles over that of the scene's bounds from which they are not aimed at
PEAK = 12                   # times the mean radiance from which a part of the world is aimed at
MAX_SKY = (512, 1024)       # a mirror shows the world at the resolution of its map, up to this


def leave_surfaces(frame: Frame, context: Context, arrived: tuple[Transport, ...]) -> np.ndarray:
    """(H, W, 3) float32 W/(m2 sr): what each pixel's matt surface sends out after the light of `arrived` has reached it."""
    present = [context.light[t] for t in arrived if t in context.light]
    out = frame.gbuffer.albedo * np.float32(1 / math.pi)
    out *= sum(present[1:], start=present[0]) if present else np.float32(0)
    return out


def shining_pixels(frame: Frame) -> np.ndarray:
    """(H, W, 3) float32 W/(m2 sr): the picture's emission without that of surfaces which lamps stand for.

    What these give to glossy surfaces is the lamps' own light.
    """
    g = frame.gbuffer
    out = g.emission
    for light in (light for light in frame.lights if light.is_surface):
        out = out.copy() if out is g.emission else out
        rows, columns = np.nonzero(g.mask & out.any(-1))
        size_m = [2 * light.radius_m] * 3 if light.kind is LightKind.POINT else [light.size_x_m, light.size_y_m, 0]
        half = np.array(size_m) / 2
        local = (g.position_ws[rows, columns] - light.position_ws) @ light.world_from_light[:3, :3]
        is_its = (np.abs(local) < half + 2e-3 * half.max()).all(1)
        out[rows[is_its], columns[is_its]] = 0
    return out


def substance_table(materials: tuple[Material, ...]) -> np.ndarray:
    """(M, 6) float32 of materials at hits: colour, roughness, reflectance F0 at normal incidence, whether energy is kept.

    A material's `specular` is the mean of its Glossy Color over all directions, colour (F0 + (1 - F0) r) with r the mean of
    the rise that Glossy Color tells; towards one direction the lobe reflects as much with its own rise at that angle.
    Where a material does not know its F0, bright ones are metals, see `brdf.fit_lobe`.
    """
    mean_rise, alphas = mean_albedo_table()[:, 2], (np.arange(GAIN_STEPS) + 0.5) / GAIN_STEPS
    rows = []
    for material in materials:
        # colours count what is not there of a surface as black, and a hit is on what is there
        specular = np.array(material.specular) / max(material.alpha, 1e-3)
        brightest = specular.max()
        f0 = material.f0 or 0.04 + min(max((brightest - 0.08) / 0.12, 0), 1) * (brightest - 0.04)
        mean = rise_of(np.float32(np.interp(material.roughness**2, alphas, mean_rise)), np.float32(f0))
        rows.append([*(specular / (f0 + (1 - f0) * mean)), material.roughness, f0, material.keeps_energy])
    return np.array(rows, np.float32).reshape(-1, 6)


def surroundings_of(frame: Frame, geometry: Geometry) -> Surroundings:
    """What rays meet beyond the picture."""
    sky = shrink_map(frame.world.radiance, MAX_SKY)
    blurred = shrink_map(frame.world.radiance)
    material = np.clip(geometry.material, 0, max(len(frame.materials) - 1, 0)).astype(np.int32)
    albedo = geometry.albedo
    if geometry.cutouts is not None:
        albedo = np.minimum(albedo / geometry.coverage(np.arange(len(geometry)))[:, None, None], 1)
    normals = np.zeros((0, 3, 3)) if geometry.normals_ws is None else geometry.normals_ws
    return Surroundings(
        np.ascontiguousarray(albedo, np.float32), np.ascontiguousarray(geometry.emission, np.float32), material,
        np.ascontiguousarray(normals, np.int16), substance_table(frame.materials or (Material("none"),)), sky, blurred,
        bool(sky.any() or geometry.emission.any()), shines_of(geometry, blurred))


def seen_by_rays(origin_ws: np.ndarray, direction_ws: np.ndarray, frame: Frame, bvh: Bvh, around: Surroundings,
                 reach: tuple[float, float]) -> GBuffer:
    """What rays (H, W, 3) through the triangles meet, as a picture; depths, and `reach`, are in lengths of the directions.

    Normals are the triangles', colours as sampled at their corners; emission is left out.
    """
    shape = origin_ws.shape[:2]
    depth, normal = np.full(shape, np.inf, np.float32), np.tile(np.float32([0, 0, 1]), (*shape, 1))
    position, albedo, specular, emission = (np.zeros((*shape, 3), np.float32) for _ in range(4))
    roughness, f0 = np.ones(shape, np.float32), np.zeros(shape, np.float32)
    origin, direction = (np.ascontiguousarray(v, np.float32).reshape(-1, 3) for v in (origin_ws, direction_ws))
    found = (values.reshape(depth.size, *values.shape[2:])
             for values in (depth, position, normal, albedo, specular, roughness, f0))
    see_triangles(depth.size, origin, direction, bvh, around, albedo_table(),
                  mean_albedo_table(), np.float32(reach[0]), np.float32(reach[1]), *found)
    return GBuffer(depth, position, normal, albedo, specular, roughness, emission, f0)


def shines_of(geometry: Geometry, sky: np.ndarray) -> Shines:
    """What rays may be aimed at: emissive triangles and parts of the world `sky` (h, w, 3), where they are small and bright.

    What surrounds a place is met by every ray, and aiming would only add noise.
    """
    corners, across, radiance, power = find_emitters(geometry)
    area = 0.5 * np.linalg.norm(across, axis=1)
    total, (width, depth, height) = float(power.sum()), np.subtract(*geometry.bounds_ws[::-1]).astype(np.float64)
    if not total > 0 or area.sum() > SMALL * 2 * (width * depth + depth * height + height * width):
        total = 0.0
        corners, radiance, power = corners[:0], radiance[:0], power[:0]
    sky_cdf, sky_density = np.zeros(0), np.zeros((0, 0), np.float32)
    if sky.any():
        cdf, density = sky_distribution(sky)
        if float(density.max()) * 4 * math.pi > PEAK:
            sky_cdf, sky_density = cdf, density
    sky_share = 0.0 if not len(sky_cdf) else (0.5 if total > 0 else 1.0)
    return Shines(np.cumsum(power) / max(total, 1e-300), corners.astype(np.float32), radiance.astype(np.float32),
                  np.float32(1 / total if total > 0 else 0), sky_cdf, sky_density, np.float32(sky_share))


def pack_lights(lights: tuple[Light, ...], far_m: float) -> Lights:
    """Lamps as kernels take them; shadow rays towards a sun are `far_m` long."""
    lamps = [pack_lamp(light, far_m) for light in lights]
    powers = [[*(light.power * light.diffuse_factor), *(light.power * light.glossy_factor)] for light in lights]
    return Lights(np.array([lamp.kind for lamp in lamps], np.int64),
                  np.array([lamp.places for lamp in lamps], np.float32).reshape(-1, 4, 3),
                  np.array([lamp[2:] for lamp in lamps], np.float32).reshape(-1, 7),
                  np.array(powers, np.float32).reshape(-1, 6), np.array([light.casts_shadow for light in lights], np.uint8))


def reach_out_m(frame: Frame, bvh: Bvh) -> float:
    """A length in m that leads from every pixel out of all triangles and past the farthest thing seen."""
    seen = frame.gbuffer.position_ws              # 0 where nothing is seen
    far = [seen.max(initial=0), -seen.min(initial=0), np.abs(frame.camera.position_ws).max()]
    if len(bvh.corners):
        far += [np.abs(bvh.boxes[0, :, :3].min(0)).max(), np.abs(bvh.boxes[0, :, 3:].max(0)).max()]
    # twice the diagonal of the cube around the origin that holds them all
    return 2 * 2 * math.sqrt(3) * float(max(far)) + 1e-3 * frame.scale_m
