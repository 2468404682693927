"""Where shadow rays of coarse smooth-shaded meshes begin, against closed forms on the unit ball."""

from __future__ import annotations

import numpy as np
import pytest

from rtgi_addon.core.frame import NORMAL_STEPS
from rtgi_addon.kernels.bvh import build_bvh
from rtgi_addon.kernels.terminator import LOW, lifted_share, smooth_lift
from rtgi_addon.kernels.vec3 import f32, vector

CORNERS = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]) @ np.diag([0.3, 0.3, 1.0]) + [0, 0, 2]
BALL = CORNERS / np.linalg.norm(CORNERS, axis=1, keepdims=True)     # three places of the unit ball, some ten degrees apart


def outwards():
    n = np.cross(BALL[1] - BALL[0], BALL[2] - BALL[0])
    return n / np.linalg.norm(n)


def lift_at(weights, side=1.0, normals=BALL):
    """(3,) of the place with these weights of the three corners."""
    bvh = build_bvh(BALL[None].astype(np.float32))
    steps = np.rint(normals[None] * NORMAL_STEPS).astype(np.int16)
    return np.array(smooth_lift(bvh, steps, 0, f32(weights[1]), f32(weights[2]), vector(side * outwards())))


def test_corners_lie_on_the_smooth_surface_already():
    for corner in np.eye(3):
        np.testing.assert_allclose(lift_at(corner), 0, atol=1e-6)


@pytest.mark.parametrize(("first", "second"), [(0, 1), (1, 2), (2, 0)])
def test_middle_of_an_edge_rises_to_where_the_tangent_planes_of_its_ends_meet(first, second):
    weights = np.zeros(3)
    weights[[first, second]] = 0.5
    half_chord = np.linalg.norm(BALL[first] - BALL[second]) / 2
    # sin^2 / cos over the chord, for half the angle between the ends; the interpolated normal is as short as its cosine
    meeting = half_chord**2 / np.sqrt(1 - half_chord**2)
    assert np.linalg.norm(lift_at(weights)) == pytest.approx(meeting, rel=2 * half_chord**2)
    assert lift_at(weights) @ (weights @ BALL) > 0


def test_flat_triangles_and_normals_that_turn_away_are_not_lifted():
    middle = np.full(3, 1 / 3)
    assert not lift_at(middle, normals=np.zeros((3, 3))).any()
    assert not lift_at(middle, normals=-BALL).any()


def test_hollow_side_is_lifted_inwards_clear_of_its_neighbours():
    middle = np.full(3, 1 / 3)
    assert lift_at(middle, side=-1.0) @ outwards() < 0


@pytest.mark.parametrize(("elevation", "share"), [(0.2, 0.0), (float(LOW) / 2, 0.5), (-0.05, 1.0)])
def test_rays_to_low_lamps_are_lifted(elevation, share):
    lift, side = vector((0, 0, 0.01)), vector((0, 0, 1))
    unit = vector((np.sqrt(1 - elevation**2), 0, elevation))
    shading = vector((0.5, 0, np.sqrt(0.75)))     # stands well above the lamp's horizon
    assert lifted_share(lift, shading, side, unit) == pytest.approx(share, abs=1e-5)


def test_what_has_no_lift_is_dark_below_its_plane():
    none, up = vector((0, 0, 0)), vector((0, 0, 1))
    assert lifted_share(none, up, up, vector((1, 0, 0.0))) < 0
    assert lifted_share(none, up, up, vector((0.6, 0, 0.8))) == 0
