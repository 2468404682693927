"""The synthetic room is a consistent frame."""

import numpy as np
import pytest

from rtgi_addon.core.frame import LightKind
from rtgi_addon.core.synthetic import BOX_HIGH, BOX_LOW, ROOM_HIGH, ROOM_LOW, box_triangles, make_room_frame, nearest_hit

MILLIMETRE = 1e-3           # float32 positions of a room of 4 m are good to a micrometre; edges need no more


def on_a_face(position: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    inside = ((position > low - MILLIMETRE) & (position < high + MILLIMETRE)).all(-1)
    return inside & ((np.abs(position - low) < MILLIMETRE) | (np.abs(position - high) < MILLIMETRE)).any(-1)


def test_box_has_the_area_of_a_box():
    corners = box_triangles(np.zeros(3), np.array([1.0, 2.0, 3.0]))
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    assert area == pytest.approx(2 * (2 + 3 + 6))


def test_ray_meets_the_nearer_of_two_faces():
    corners = box_triangles(np.array([1.0, -1, -1]), np.array([2.0, 1, 1]))
    depth, triangle = nearest_hit(np.array([[0.0, 0.1, 0.2]]), np.array([[1.0, 0, 0]]), corners)
    assert depth[0] == pytest.approx(1.0) and triangle[0] in (0, 1)


def test_ray_past_everything_meets_nothing():
    corners = box_triangles(np.array([1.0, -1, -1]), np.array([2.0, 1, 1]))
    depth, triangle = nearest_hit(np.array([[0.0, 5, 0]]), np.array([[1.0, 0, 0]]), corners)
    assert np.isinf(depth[0]) and triangle[0] == -1


def test_every_pixel_of_the_closed_room_lies_on_a_wall_or_the_box():
    position = make_room_frame().gbuffer.position_ws
    assert (on_a_face(position, ROOM_LOW, ROOM_HIGH) | on_a_face(position, BOX_LOW, BOX_HIGH)).all()


def test_normals_face_the_viewer():
    frame = make_room_frame()
    towards = frame.camera.position_ws - frame.gbuffer.position_ws
    assert ((frame.gbuffer.normal_ws * towards).sum(-1) > 0).all()


@pytest.mark.parametrize("kind", list(LightKind))
def test_every_kind_of_lamp_has_a_view_that_sees_the_floor(kind):
    view = make_room_frame(kinds=(kind,)).views[0]
    assert (np.abs(view.gbuffer.position_ws[view.gbuffer.mask][:, 2]) < MILLIMETRE).any()


def test_point_lamp_sends_all_its_power_into_its_view():
    frame = make_room_frame(kinds=(LightKind.POINT,))
    # texel solid angles are exact on the sphere; float32 sums of 576 texels
    assert frame.views[0].incident_flux.sum() == pytest.approx(4 * np.pi * frame.lights[0].power.sum(), rel=1e-5)


def test_world_shines_in_only_without_a_ceiling():
    assert make_room_frame().gbuffer.mask.all()
    frame = make_room_frame(world_radiance=0.5)
    assert not frame.gbuffer.mask.all() and not frame.world.is_black
