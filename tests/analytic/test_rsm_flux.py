"""The flux of a light's texels adds up to what the light sends into the view."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rtgi_addon.core.frame import Light, LightKind
from rtgi_addon.core.radiometry import texel_flux
from rtgi_addon.core.transforms import Camera, Projection

# texels take the solid angle of their middles: the midpoint rule with 256 texels is off by below 1 / 256^2
MIDPOINT = 2e-5
POWER = np.array([2.0, 1.0, 0.5])


def light(kind, **changes):
    return Light("lamp", kind, np.eye(4), POWER, **changes)


def perspective(half, width=256, height=256, world_from_view=None):
    return Camera(Projection.PERSPECTIVE, np.eye(4) if world_from_view is None else world_from_view, width, height,
                  -half, half, -half, half)


def total(lamp, camera):
    return texel_flux(lamp, camera).astype(np.float64).sum((0, 1))


@pytest.mark.parametrize("half_angle_deg", [10, 30, 45, 60])
def test_square_frustum_takes_intensity_times_its_solid_angle(half_angle_deg):
    half_angle = math.radians(half_angle_deg)
    solid_angle = 4 * math.asin(math.sin(half_angle) ** 2)
    actual = total(light(LightKind.POINT), perspective(math.tan(half_angle)))
    assert actual == pytest.approx(POWER * solid_angle, rel=MIDPOINT)


def test_frustum_of_a_right_angle_takes_a_sixth_of_all():
    assert total(light(LightKind.POINT), perspective(1.0)) == pytest.approx(POWER * 4 * math.pi / 6, rel=MIDPOINT)


def test_middle_texel_takes_more_than_the_corner_texel_by_the_cube_of_the_secant():
    flux = texel_flux(light(LightKind.POINT), perspective(1.0, 255, 255))[..., 0]
    assert flux[127, 127] / flux[0, 0] == pytest.approx(3**1.5, rel=0.012)     # the texel's middle is not the corner


def test_oblong_texels_count_by_their_area():
    camera = Camera(Projection.PERSPECTIVE, np.eye(4), 400, 90, -1, 1, -1, 1)
    assert total(light(LightKind.POINT), camera) == pytest.approx(POWER * 4 * math.pi / 6, rel=2e-4)


@pytest.mark.parametrize(("width", "height"), [(64, 32), (33, 7), (1, 1)])
def test_all_round_view_takes_the_whole_sphere(width, height):
    camera = Camera(Projection.EQUIRECTANGULAR, np.eye(4), width, height, -math.pi, math.pi, -math.pi / 2, math.pi / 2)
    assert total(light(LightKind.POINT), camera) == pytest.approx(POWER * 4 * math.pi, rel=1e-6)


@pytest.mark.parametrize("tilt_deg", [0, 25, 70])
def test_sun_texels_take_irradiance_times_map_area_for_any_tilt(tilt_deg):
    tilt = math.radians(tilt_deg)
    turned = np.eye(4)
    turned[:3, :3] = [[1, 0, 0], [0, math.cos(tilt), -math.sin(tilt)], [0, math.sin(tilt), math.cos(tilt)]]
    camera = Camera(Projection.ORTHOGRAPHIC, turned, 60, 40, -3.0, 1.5, -2.0, 1.0)
    assert total(light(LightKind.SUN), camera) == pytest.approx(POWER * 4.5 * 3.0, rel=1e-6)


def test_sun_on_a_tilted_plane_gives_radiosity_by_the_cosine():
    """Flux E A of a texel over the surface A / cos that it covers: E cos, as it must be."""
    lamp, tilt = light(LightKind.SUN), math.radians(60)
    camera = Camera(Projection.ORTHOGRAPHIC, np.eye(4), 50, 50, -1, 1, -1, 1)
    surface_m2 = (2 / 50) ** 2 / math.cos(tilt)
    assert texel_flux(lamp, camera)[10, 10] / surface_m2 == pytest.approx(POWER * math.cos(tilt), rel=1e-6)


@pytest.mark.parametrize("cone_deg", [30, 75, 110])
def test_spot_without_blend_takes_the_solid_angle_of_its_cone(cone_deg):
    half = math.radians(cone_deg) / 2
    lamp = light(LightKind.SPOT, spot_size_rad=2 * half, spot_blend=0.0)
    actual = total(lamp, perspective(math.tan(half), 512, 512))
    # whole texels are in or out along a circle of 1600 texels
    assert actual == pytest.approx(POWER * 2 * math.pi * (1 - math.cos(half)), rel=2e-3)


def test_spot_with_full_blend_takes_half_the_solid_angle():
    """Smoothstep of the cosine is odd around its middle, and the solid angle is even in the cosine: one half exactly."""
    half = math.radians(40)
    lamp = light(LightKind.SPOT, spot_size_rad=2 * half, spot_blend=1.0)
    actual = total(lamp, perspective(math.tan(half), 512, 512))
    assert actual == pytest.approx(POWER * math.pi * (1 - math.cos(half)), rel=1e-4)


def test_nothing_falls_outside_of_a_spots_cone():
    half = math.radians(20)
    flux = texel_flux(light(LightKind.SPOT, spot_size_rad=2 * half, spot_blend=0.3), perspective(math.tan(half), 64, 64))
    assert not flux[0, 0].any() and flux[32, 32].all()


@pytest.mark.parametrize(("kind", "area"), [(LightKind.RECTANGLE, 0.06), (LightKind.DISK, 0.06 * math.pi / 4)])
def test_area_light_sends_pi_l_a_into_its_hemisphere(kind, area):
    lamp = light(kind, size_x_m=0.2, size_y_m=0.3)
    camera = Camera(Projection.EQUIRECTANGULAR, np.eye(4), 256, 256, -math.pi, math.pi, -math.pi / 2, math.pi / 2)
    assert total(lamp, camera) == pytest.approx(POWER * math.pi * area, rel=1e-4)


def test_area_light_keeps_its_power_when_its_spread_narrows():
    lamp = light(LightKind.RECTANGLE, size_x_m=1.0, size_y_m=1.0, spread_rad=math.radians(60))
    actual = total(lamp, perspective(math.tan(math.radians(30)), 512, 512))
    assert actual == pytest.approx(POWER * math.pi, rel=1e-3)


def test_area_light_sends_nothing_backwards():
    camera = Camera(Projection.EQUIRECTANGULAR, np.eye(4), 64, 32, -math.pi, math.pi, -math.pi / 2, math.pi / 2)
    flux = texel_flux(light(LightKind.DISK, size_x_m=1.0, size_y_m=1.0), camera)
    assert flux[16, 32].all() and not flux[16, 0].any()
