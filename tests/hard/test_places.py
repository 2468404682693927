"""Where geometry is hard: corners, grazing angles, thin walls, grids, features of a pixel, background beside foreground.

Bounds are about twice what was measured, where nothing else is said.
"""

from __future__ import annotations

import pytest

from rtgi_addon.core.techniques import LpvParams, RsmParams, VxgiParams
from rtgi_addon.passes.base import Transport
from tests import hard_cases
from tests.hard_cases import BOUNCES, BY_SCENE, WORLDS
from tests.hard_frames import CHEAP, lamp_at, room, run

pytestmark = pytest.mark.usefixtures("one_thread")

IN_CORNER = {"rsm": RsmParams(rays=64, clusters=256, lattice_px=1), "lpv": LpvParams(resolution=16, lattice_px=1),
             "vxgi": VxgiParams(resolution=32, lattice_px=1, cones=128)}
# vxgi: a voxel whose floor lies in both rooms has one side for it, a strip along the wall (measured: 1.4 %)
THROUGH_A_WALL = {"vxgi": 0.03}
CONES = VxgiParams(resolution=32, lattice_px=1, exact_voxels=0)


@pytest.mark.parametrize("name", IN_CORNER)
@pytest.mark.parametrize("reach_m", [0.6, 0.06, 0.006])
def test_light_in_a_corner_has_no_spikes(name, reach_m):
    # from seven texels off the edge to a fourteenth: 1/r^2 of the nearest texel is over 100 times what is right there. A
    # wall's light jumps by 1.3 from texel to texel; nearer than a texel it falls to 0.2 in the mean for rsm
    assert hard_cases.brightest_in_corner(name, IN_CORNER[name], reach_m) < 1.5


def test_square_texels_take_away_the_error_of_points_in_a_corner():
    assert hard_cases.corner_of_texels(False) > 0.5 and hard_cases.corner_of_texels(True) < 0.005


@pytest.mark.parametrize("tilt", [0.1, 1e-3])
@pytest.mark.parametrize("name", ["direct", "emission", "ssr", *WORLDS])
def test_light_of_a_surface_seen_at_a_grazing_angle_is_the_closed_form(name, tilt):
    # hbao: sectors of a slice at the horizon (3e-5); emission: 64 rays into a panel of a fifth of its distance
    assert hard_cases.grazing_error(name, tilt) < {"hbao": 1e-4, "emission": 1e-3}.get(name, 1e-6)


@pytest.mark.parametrize("name", BOUNCES)
@pytest.mark.parametrize("tilt", [0.5, 1e-3])
@pytest.mark.parametrize("turned_rad", [0.0, 0.1, 0.7])
def test_a_lone_plane_gives_itself_nothing(name, tilt, turned_rad):
    assert hard_cases.own_light(name, CHEAP[name], tilt, turned_rad) == 0


def test_published_cones_and_steps_light_the_plane_that_they_start_on():
    # what the exact walk through voxels and the sight of cells take away: the tests above would miss nothing
    assert hard_cases.own_light("vxgi", CONES, turned_rad=0.7) > 1e-3
    assert hard_cases.own_light("lpv", LpvParams(mode="PAPER", resolution=8), turned_rad=0.7) > 0.1


@pytest.mark.parametrize("name", BY_SCENE)
def test_no_light_comes_through_a_wall_without_thickness(name):
    assert hard_cases.leak(name, CHEAP[name]) <= THROUGH_A_WALL.get(name, 0)


def test_published_forms_let_light_through_a_wall():
    assert hard_cases.leak("rsm", RsmParams(method="ALL")) > 0.1
    assert hard_cases.leak("lpv", LpvParams(mode="PAPER", resolution=8, lattice_px=1)) > 0.04
    assert hard_cases.leak("vxgi", VxgiParams(resolution=16, exact_voxels=0, lattice_px=1)) > 0.03


@pytest.mark.parametrize("offset", [0.0, 0.5, 0.31])
def test_walls_on_the_planes_between_cells_and_rays_along_axes_make_no_difference(offset):
    assert hard_cases.furnace_on_cells(1e6, offset) < 1e-5              # float32 sums of 512 rays


@pytest.mark.parametrize("from_corner_m", [1e-1, 1e-2, 1e-3, 1e-4])
def test_a_lamp_in_a_corner_lights_as_the_sum_over_its_texels_does(from_corner_m):
    # texels a tenth of a millimetre from three walls, in reach of the offset of rays
    assert hard_cases.lamp_in_corner(from_corner_m) < 0.01


@pytest.mark.parametrize("name", ["vxgi", "lpv"])
def test_a_lamp_in_a_corner_lights_the_same_once_its_texels_lie_in_one_cell(name):
    params = {"vxgi": VxgiParams(resolution=16, cones=512, lattice_px=2)}.get(name)
    near, nearer = (run(name, lamp_at(room(), (-2 + e, 2 - e, e)), params).light[BOUNCES[name]] for e in (1e-3, 1e-4))
    # 1 cell is 300 and 500 mm; the lamp's light moves by 1 mm in it
    assert nearer.any() and hard_cases.relative(nearer, near) < 0.01


# By rays through the scene a pixel that no neighbour can serve is gathered by itself: what is left is the noise of 256 rays,
# of what shines a few of which meet it (vxgi), of lobes (ssr). What follows the screen spreads from the gather points that
# lie on the strip, at other heights, and averages the slices of fewer.
OF_A_STRIP = {"hbao": 0.2, "ssao": 0.2, "ssdo": 0.2, "vxgi": 0.1, "ssr": 0.1}


@pytest.mark.parametrize("name", [name for name in CHEAP if hasattr(CHEAP[name], "lattice_px")])
@pytest.mark.parametrize("lattice_px", [2, 4])
def test_a_strip_one_pixel_wide_keeps_its_light_between_gather_points(name, lattice_px):
    assert hard_cases.pole_error(name, lattice_px) < OF_A_STRIP.get(name, 0.04)


@pytest.mark.parametrize("name", CHEAP)
def test_background_beside_foreground_is_black_and_takes_nothing_from_it(name):
    frame = room(25, 19)
    holes, is_seen = hard_cases.with_holes(frame)
    whole, got = run(name, frame).light, run(name, holes).light
    surface = is_seen & frame.gbuffer.mask
    for transport, image in got.items():
        assert not image[~is_seen].any()
        if image[surface].mean() > 1e-3:
            # other gather points, and so another draw: the mean stays. On the screen a ninth of what would send light back
            # is gone, and holes part the sheets that taps are joined to (measured: 29 % less of the near bounce)
            bound = 0.4 if transport is Transport.NEAR_DIFFUSE else 0.1
            assert abs(image[surface].mean() / whole[transport][surface].mean() - 1) < bound, transport
