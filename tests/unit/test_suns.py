"""Suns of a world's map as lamps: their light, size and place, what is left of the map, and what is no sun."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rtgi_addon.core.frame import LightKind
from rtgi_addon.core.radiometry import texel_directions
from rtgi_addon.core.suns import CLOSE_PX, part_suns
from rtgi_addon.core.transforms import ViewFormat

FORM = ViewFormat(CLOSE_PX**2)
SKY = np.array([0.3, 0.5, 0.9])


def unit(*vector):
    return np.array(vector, np.float64) / np.linalg.norm(vector)


def radiance_of(ways, suns):
    """(..., 3) of an even sky with disks (direction, angular diameter in rad, radiance (3,))."""
    out = np.broadcast_to(SKY, (*ways.shape[:-1], 3)).copy()
    for towards, angle, radiance in suns:
        out[ways @ towards > math.cos(angle / 2)] = radiance
    return out.astype(np.float32)


def parted(suns, shape=(256, 512), known=()):
    def look(camera):
        rays = camera.rays_vs()[1]
        return radiance_of(rays / np.linalg.norm(rays, axis=-1, keepdims=True) @ camera.world_from_view[:3, :3].T, suns)

    direction, _ = texel_directions(*shape)
    whole = radiance_of(direction, suns)
    return whole, *part_suns(whole, look, FORM, "sun", known)


@pytest.mark.parametrize("angle_deg", [0.53, 2.0, 6.0])
@pytest.mark.parametrize("towards", [unit(0.3, -0.5, 0.8), unit(-1, 0.1, 0.05), unit(0, 0, 1), unit(0.2, 0.1, -1)])
def test_a_disk_becomes_a_lamp_of_its_light_size_and_place(towards, angle_deg):
    angle, bright = math.radians(angle_deg), np.array([9.0, 7.0, 5.0]) * 1e3 / angle_deg**2
    _, rest, suns = parted([(towards, angle, bright)], known=[(towards, angle)])
    assert len(suns) == 1 and suns[0].kind is LightKind.SUN and suns[0].name == "sun"
    # a disk of 80 pixels across is off by its ragged edge, some tenths of a percent
    solid_angle = 2 * math.pi * (1 - math.cos(angle / 2))
    np.testing.assert_allclose(suns[0].power, (bright - SKY) * solid_angle, rtol=0.01)
    assert suns[0].angle_rad == pytest.approx(angle, rel=0.01)
    assert np.linalg.norm(suns[0].direction_ws + towards) < 0.02 * angle
    np.testing.assert_allclose(rest, np.broadcast_to(np.float32(SKY), rest.shape), rtol=1e-6)


def test_the_brightest_texel_leads_to_a_sun_that_nobody_knows_of():
    towards, angle = unit(0.4, 0.6, 0.5), math.radians(3)
    whole, rest, suns = parted([(towards, angle, np.full(3, 3000.0))])
    assert len(suns) == 1 and suns[0].angle_rad == pytest.approx(angle, rel=0.01)
    assert whole.max() > 1000 and rest.max() < 1


def test_a_sun_between_the_texels_of_a_coarse_map_is_found_where_the_sky_says():
    towards = unit(0.31, 0.52, 0.47)
    sun = (towards, math.radians(0.5), np.full(3, 1e5))
    whole, rest, suns = parted([sun], (16, 32), known=[sun[:2]])
    assert whole.max() < 1                                                   # no texel's middle shows it
    assert len(suns) == 1 and suns[0].angle_rad == pytest.approx(math.radians(0.5), rel=0.01)
    assert parted([sun], (16, 32))[2] == ()


def test_two_suns_are_two_lamps():
    first, second = unit(0.5, 0.5, 0.5), unit(-0.5, 0.3, 0.4)
    _, rest, suns = parted([(first, math.radians(2), np.full(3, 4000.0)), (second, math.radians(3), np.full(3, 1500.0))])
    assert len(suns) == 2 and rest.max() < 1
    assert -suns[0].direction_ws @ first > 0.9999 and -suns[1].direction_ws @ second > 0.9999


@pytest.mark.parametrize(("angle_deg", "bright"), [
    (30, 200.0),            # a window or a soft box
    (3, 4.0),               # hardly brighter than the sky
    (0.9, 100.0),           # bright, but it gives one part in a hundred of the light
])
def test_what_is_wide_or_faint_stays_in_the_map(angle_deg, bright):
    whole, rest, suns = parted([(unit(0.2, 0.4, 0.6), math.radians(angle_deg), np.full(3, bright))])
    assert suns == () and rest is whole


def test_an_even_and_a_black_world_have_no_sun():
    assert parted([])[2] == ()
    black = np.zeros((8, 16, 3), np.float32)
    rest, suns = part_suns(black, lambda camera: np.zeros((camera.height_px, camera.width_px, 3)), FORM, "sun",
                           [(unit(0, 0, 1), 0.01)])
    assert suns == () and rest is black


@pytest.mark.parametrize("texels", [1, 4, 36])
def test_views_of_few_pixels_find_no_sun_or_a_rough_one(texels):
    bright = unit(0.3, -0.5, 0.8), math.radians(4), np.full(3, 2000.0)

    def look(camera):
        rays = camera.rays_vs()[1]
        return radiance_of(rays / np.linalg.norm(rays, axis=-1, keepdims=True) @ camera.world_from_view[:3, :3].T, [bright])

    direction, _ = texel_directions(16, 32)
    radiance = radiance_of(direction, [bright])
    rest, suns = part_suns(radiance, look, ViewFormat(texels), "sun", [bright[:2]])
    assert np.isfinite(rest).all() and all(np.isfinite(sun.power).all() for sun in suns)


def test_light_is_neither_lost_nor_made():
    towards, angle = unit(0.3, -0.5, 0.6), math.radians(4)
    whole, rest, suns = parted([(towards, angle, np.full(3, 2000.0))], (512, 1024))
    _, solid_angle = texel_directions(512, 1024)
    before, after = ((m * solid_angle[..., None]).sum((0, 1), dtype=np.float64) for m in (whole, rest))
    # the map's disk is eleven texels across: its edge is off by a few percent
    np.testing.assert_allclose(after + suns[0].power, before, rtol=0.03)
