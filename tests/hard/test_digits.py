"""Where numbers are hard: far places, normals of any length, black and white surfaces, spikes, one broken pixel."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from rtgi_addon.core.techniques import EmissionParams, HbaoParams, VxgiParams
from rtgi_addon.passes.base import Transport
from tests import hard_cases
from tests.hard_cases import SEES_COLOUR, WORLDS
from tests.hard_frames import CHEAP, room, run

# broken frames, and small ones
pytestmark = [pytest.mark.filterwarnings("ignore::RuntimeWarning"), pytest.mark.usefixtures("one_thread")]

FAR_FROM_ORIGIN_M = 1000.0  # `engine` has it, and needs Blender
DIGITS = 1e-4               # what positions a kilometre off the origin lose: 6e-5 m of a room of 4 m
# emission: the points that shine are drawn in the order of their place, and another order is another draw (0.9 %);
# final_gather: so is which pixel a ray meets (0.3 %)
DIGITS_OF = {"emission": 0.03, "final_gather": 0.01}


@pytest.mark.parametrize("name", CHEAP)
def test_a_room_a_thousand_kilometres_away_looks_the_same_once_its_origin_is_taken_off(name):
    # as the engine does; that it does is held in tests/blender/test_engine.py. float64 keeps 1e-10 m there
    assert hard_cases.far_away(name, 1e6, True) < DIGITS


@pytest.mark.parametrize("name", CHEAP)
def test_a_room_as_far_out_as_may_keep_its_origin_looks_the_same(name):
    assert hard_cases.far_away(name, FAR_FROM_ORIGIN_M, False) < DIGITS_OF.get(name, DIGITS)


@pytest.mark.parametrize("name", CHEAP)
@pytest.mark.parametrize("factor", [0.5, 3.0])
def test_normals_of_another_length_make_no_difference(name, factor):
    # a length of 1 is put back in float64: no digit differs
    assert hard_cases.stretched_normals(name, factor, True) == 0


@pytest.mark.parametrize("name", CHEAP)
def test_one_bounce_is_linear_in_the_albedo_from_black_to_white(name):
    black, grey, white = (run(name, hard_cases.repainted(room(), a)).light for a in (0.0, 0.5, 1.0))
    for transport, image in grey.items():
        if transport in SEES_COLOUR:
            assert image.any() and not black[transport].any()
            np.testing.assert_allclose(white[transport], 2 * image, rtol=1e-6, atol=1e-6 * float(image.max()))
        else:                       # irradiance holds no colour of its own; nothing is left of gloss
            np.testing.assert_array_equal(white[transport], image)
            np.testing.assert_array_equal(black[transport], image)


def test_bounces_without_end_between_white_surfaces_are_no_more_than_an_open_sky():
    # sum of albedo^k (1 - V)^k at an albedo of 1 is 1 / V: what gets out is all that comes in
    light = run("hbao", hard_cases.repainted(room(), 1.0), HbaoParams(steps=4, multi_bounce=True)).light
    image = light[Transport.WORLD_DIFFUSE]
    assert image.max() <= np.pi * 0.5 * (1 + 1e-5) and image.max() > 0.99 * np.pi * 0.5


@pytest.mark.parametrize("name", WORLDS)
def test_a_sky_that_shines_from_one_texel_lights_a_floor_as_the_sum_says(name):
    # world: four rays of a point lie within the texel (0.7 %). Where one of the four by the cosine meets it too, by a chance
    # of 1 in 200, the point takes a quarter too much, of which the smoothing leaves a fifth; the others take a table
    assert hard_cases.spike_in_the_sky(name, 0.5) < (0.007 if name == "world" else 1e-4)
    assert hard_cases.spike_in_the_sky(name) < (0.05 if name == "world" else 1e-4)


def test_a_square_of_a_millimetre_that_shines_lights_a_floor_as_a_point_does():
    assert hard_cases.tiny_emitter("emission", EmissionParams(rays=16, lattice_px=1)) < 1e-4


@pytest.mark.parametrize("name", ["rsm", "vxgi", "lpv"])
def test_a_texel_a_million_times_as_bright_as_others_is_all_that_counts(name):
    params = VxgiParams(resolution=16, cones=256, lattice_px=2) if name == "vxgi" else None
    # the others, 100 of them, add 1e-4; cones find the one voxel at random (0.5 %)
    assert hard_cases.spike_in_a_view(name, params or CHEAP[name]) < (0.02 if name == "vxgi" else 1e-3)


@pytest.mark.parametrize("name", CHEAP)
@pytest.mark.parametrize("image", ["depth", "position_ws", "normal_ws", "albedo", "specular", "roughness", "emission"])
def test_a_broken_pixel_changes_its_neighbours_by_no_more_than_one_of_background(name, image):
    frame = room()
    depth = frame.gbuffer.depth.copy()
    depth[5, 8] = np.inf
    others = np.ones(depth.shape, bool)
    others[5, 8] = False
    wanted, hole = run(name, frame).light, run(name, dataclasses.replace(
        frame, gbuffer=dataclasses.replace(frame.gbuffer, depth=depth))).light
    black = np.zeros_like(frame.gbuffer.albedo)
    as_hole = max(hard_cases.relative(hole.get(t, black)[others], v[others]) for t, v in wanted.items() if v.any())
    # a colour that is black instead takes away what that pixel sends: a 192nd of the picture, 5 % of which is seen anywhere;
    # final gathering has 384 rays in all, and one of them meets it
    assert hard_cases.beside_broken(name, image, True) <= as_hole + (3e-3 if name == "final_gather" else 1e-3)
