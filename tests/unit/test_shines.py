"""Rays aimed at what shines: their density is that of their directions, and with the others they count nothing twice."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from rtgi_addon.core.frame import Geometry, Material, World
from rtgi_addon.core.radiometry import texel_directions
from rtgi_addon.core.techniques import FinalGatherParams, SsrParams
from rtgi_addon.kernels import shines as shines_kernel
from rtgi_addon.kernels.bvh import STACK, build_bvh
from rtgi_addon.kernels.sampling import cosine_hemisphere
from rtgi_addon.kernels.scene_light import _from_above
from rtgi_addon.kernels.shines import aim_at
from rtgi_addon.kernels.vec3 import f32, vector
from rtgi_addon.passes import ssr, surroundings
from rtgi_addon.passes.base import Context, Transport
from rtgi_addon.passes.final_gather import compute_final_gather
from rtgi_addon.passes.ssr import compute_ssr
from rtgi_addon.passes.surroundings import shines_of, surroundings_of
from tests.mirror_frames import camera_at, glossy, on_floor, scene_frame, wall

NO_SKY = np.zeros((1, 1, 3), np.float32)


def geometry_of(corners, emission):
    """Flat triangles (T, 3, 3) that shine with radiance (T,)."""
    corners, emission = np.float32(corners), np.float32(emission)
    return Geometry(corners_ws=corners, albedo=np.full((len(corners), 3, 3), 0.5, np.float32),
                    emission=np.repeat(emission[:, None], 3, 1), material=np.zeros(len(corners), np.int32))


def aimed(shines, sky, count, place=(0.0, 0.0, 0.0)):
    """(densities, radiances (count, 3), directions (count, 3)) of rays from a place."""
    random = np.random.default_rng(3)
    found = [aim_at(shines, vector(np.array(place)), sky, f32(100), f32(u), f32(v), f32(pick))
             for u, v, pick in random.uniform(0, 1, (count, 3))]
    return np.array([f[2] for f in found]), np.array([f[3] for f in found]), np.array([f[1] for f in found])


def test_one_over_the_density_adds_up_to_the_solid_angle_of_emitters():
    # a square of 2 x 2 m, 1 m away, covers a sixth of the sphere; it shines unevenly, which moves the rays, not their sum
    square = np.array([[[-1, -1, 1], [1, -1, 1], [1, 1, 1]], [[-1, -1, 1], [1, 1, 1], [-1, 1, 1]]])
    hall = np.array([[[-9, -9, -9], [9, -9, 9], [9, 9, 9]]])
    density, radiance, direction = aimed(shines_of(geometry_of(np.concatenate([square, hall]), (1.0, 5.0, 0.0)), NO_SKY),
                                         NO_SKY, 20000)
    assert (density > 0).all() and np.abs(direction[:, :2] / direction[:, 2:]).max() <= 1 + 1e-5
    # the standard error of the mean is below a percent
    assert (1 / density).mean() == pytest.approx(4 * np.pi / 6, rel=0.03)
    assert (radiance[:, 0] / density).mean() == pytest.approx((1 + 5) / 2 * 4 * np.pi / 6, rel=0.03)


def test_the_bright_part_of_a_sky_is_aimed_at_by_its_light():
    direction, solid_angle = texel_directions(32, 64)
    sky = np.full((32, 64, 3), 0.1, np.float32)
    sky[direction @ np.array([0.6, 0.0, 0.8]) > 0.99] = 40
    found = shines_of(Geometry.empty(), sky)
    density, radiance, _ = aimed(found, sky, 5000)
    assert found.sky_share == 1
    # the density is as the radiance: each ray tells the whole
    np.testing.assert_allclose(radiance[:, 0] / density, (sky[..., 0] * solid_angle).sum(), rtol=1e-3)


def test_even_skies_dark_scenes_and_walls_that_shine_are_not_aimed_at():
    shining = geometry_of(wall((-4, 4), 2.5, (0, 3)), (1.0, 1.0))
    for sky in (NO_SKY, np.full((32, 64, 3), 2.0, np.float32)):
        for geometry in (Geometry.empty(), shining):
            assert not shines_kernel.has_aim(shines_of(geometry, sky))


def floor_before_a_tube(roughness, world=None, height_m=0.05):
    """A glossy floor, 24 x 16 pixels, before a wall with a narrow bright strip on it."""
    floor = np.array([[[-4, -4, 0], [4, -4, 0], [4, 4, 0]], [[-4, -4, 0], [4, 4, 0], [-4, 4, 0]]])
    back, tube = wall((-4, 4), 2.5, (0, 3)), wall((-0.8, 0.8), 2.49, (1.0, 1.0 + height_m))
    geometry = geometry_of(np.concatenate([floor, back, tube]), [0] * 4 + [80] * 2)
    camera = camera_at((0.0, -2.0, 1.4), (0.0, 1.0, 0.2), 24, 16, half=0.5)
    frame = scene_frame(camera, geometry)
    frame = glossy(frame, on_floor(frame), roughness)
    return frame if world is None else dataclasses.replace(frame, world=world)


def sunny_world():
    direction, _ = texel_directions(64, 128)
    radiance = np.full((64, 128, 3), 0.2, np.float32)
    radiance[direction @ np.array([0.0, -0.6, 0.8]) > np.cos(0.06)] = 300
    return World(radiance)


def assert_less_noise_and_the_same_mean(plain, aimed, less):
    """Of runs (R, N) and (R, N) with different seeds: `aimed` is noisier nowhere near as much, and not off in the mean."""
    noise, noise_aimed = (runs.std(0).mean() for runs in (plain, aimed))
    assert noise_aimed < less * noise
    # four standard errors of the means of whole pictures
    error = np.hypot(*(runs.mean(1).std() / np.sqrt(len(runs)) for runs in (plain, aimed)))
    assert error < 0.03 * plain.mean()
    assert aimed.mean() == pytest.approx(plain.mean(), abs=4 * error)


@pytest.mark.parametrize("world", [None, "sunny"])
@pytest.mark.parametrize("roughness", [0.2, 0.5])
def test_aimed_rays_change_the_noise_of_reflections_and_not_their_mean(roughness, world, monkeypatch):
    frame = floor_before_a_tube(roughness, sunny_world() if world else None)
    floor = on_floor(frame)

    def shown(seed):
        light = compute_ssr(frame, SsrParams(samples=64, lattice_px=1), Context(), seed).light
        return light[Transport.WORLD_GLOSSY][floor].mean(-1).astype(np.float64)

    aimed_runs = np.array([shown(seed) for seed in range(40)])
    monkeypatch.setattr(ssr, "has_aim", lambda shines: False)
    plain_runs = np.array([shown(seed) for seed in range(200)])
    assert_less_noise_and_the_same_mean(plain_runs, aimed_runs, 0.8)


def test_a_tube_that_falls_between_the_pixels_is_reflected(monkeypatch):
    frame = floor_before_a_tube(0.3)
    floor = on_floor(frame)
    assert not frame.gbuffer.emission.any()                                  # the strip is a tenth of a pixel high
    monkeypatch.setattr(ssr, "has_aim", lambda shines: False)
    light = [compute_ssr(frame, SsrParams(samples=64, lattice_px=1), Context(), seed).light[Transport.WORLD_GLOSSY][floor]
             for seed in range(20)]
    # 80 W/(m2 sr) over more than a thousandth of the lobes
    assert np.mean(light) > 0.1


@pytest.mark.parametrize("between", ["matt", "polished"])
def test_aimed_rays_change_the_noise_of_the_bounce_and_not_its_mean(monkeypatch, between):
    frame = floor_before_a_tube(0.5, height_m=0.4)
    if between == "polished":                    # the lobes of the surfaces between are aimed
        polished = Material(between, (0.0, 0.0, 0.0), (0.8, 0.8, 0.8), 0.3)
        black = dataclasses.replace(frame.geometry, albedo=np.zeros_like(frame.geometry.albedo))
        frame = dataclasses.replace(frame, geometry=black, materials=(polished,))

    def gathered(seed):
        light = compute_final_gather(frame, FinalGatherParams(rays=128, lattice_px=1), Context(), seed).light
        return light[Transport.WORLD_BOUNCE_DIFFUSE][frame.gbuffer.mask].mean(-1).astype(np.float64)

    aimed_runs = np.array([gathered(seed) for seed in range(100)])
    none = surroundings.shines_of(Geometry.empty(), NO_SKY)
    monkeypatch.setattr(surroundings, "shines_of", lambda geometry, sky: none)
    plain_runs = np.array([gathered(seed) for seed in range(400)])
    assert_less_noise_and_the_same_mean(plain_runs, aimed_runs, 0.8)


def test_a_ray_along_the_surface_that_meets_nothing_brings_nothing():
    """Its cosine is 0, and nobody would have aimed there: 0 / 0 is none of light."""
    grazing = [v for v in np.linspace(0, 1, 64, False) if cosine_hemisphere(f32(0), f32(v)).z == 0]
    frame = floor_before_a_tube(0.5)
    around, up = surroundings_of(frame, frame.geometry), vector(np.array([0.0, 0.0, 1.0]))
    assert grazing and shines_kernel.has_aim(around.shines)
    for v in grazing:
        light = _from_above(build_bvh(frame.geometry.corners_ws), around, np.empty(STACK, np.int32),
                            vector(np.array([0.0, 0.0, 10.0])), up, up, vector(np.full(3, 0.5)), f32(1e-5), f32(100), f32(0),
                            f32(v), f32(0.75))
        assert tuple(light) == (0, 0, 0)
