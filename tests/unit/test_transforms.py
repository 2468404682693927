"""Cameras: pixels to positions and back for every projection, with shifted edges; row 0 at the top."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rtgi_addon.core.transforms import Camera, Projection, direction_from_longitude, normalized

EDGES = {
    Projection.PERSPECTIVE: (-0.3, 0.8, -0.9, 0.2),
    Projection.ORTHOGRAPHIC: (-3.0, 5.0, 1.0, 4.0),
    Projection.EQUIRECTANGULAR: (-math.pi, math.pi, -math.pi / 2, math.pi / 2),
}
ROUND_TRIP_PX = 1e-3    # positions are float32, and a pixel near a pole is narrow


def turned(position=(1.0, -2.0, 0.5)):
    x, z = normalized(np.array([1.0, 2.0, -0.5])), np.array([0.2, 0.1, 0.9])
    z = normalized(z - x * (x @ z))
    out = np.eye(4)
    out[:3, 0], out[:3, 1], out[:3, 2], out[:3, 3] = x, np.cross(z, x), z, position
    return out


def camera(projection, matrix=None, width=13, height=9):
    return Camera(projection, np.eye(4) if matrix is None else matrix, width, height, *EDGES[projection])


@pytest.mark.parametrize("projection", Projection)
def test_positions_project_back_to_their_pixels(projection, rng):
    eye = camera(projection, turned())
    depth = rng.uniform(0.5, 20, (9, 13))
    column, row, far = eye.project(eye.positions_ws(depth).astype(float))
    np.testing.assert_allclose(column, np.broadcast_to(np.arange(13) + 0.5, (9, 13)), atol=ROUND_TRIP_PX)
    np.testing.assert_allclose(row, np.broadcast_to(np.arange(9)[:, None] + 0.5, (9, 13)), atol=ROUND_TRIP_PX)
    np.testing.assert_allclose(far, depth, rtol=1e-5)


@pytest.mark.parametrize("projection", Projection)
def test_row_zero_is_at_the_top_and_column_zero_at_the_left(projection):
    p = camera(projection).positions_ws(np.ones((9, 13)))
    assert p[0, 6, 1] > p[8, 6, 1]
    middle = slice(5, 8)        # an equirectangular view turns back behind the viewer
    assert (np.diff(p[4, middle, 0]) > 0).all()


def test_perspective_depth_is_planar():
    p = camera(Projection.PERSPECTIVE).positions_ws(np.full((9, 13), 4.0))
    np.testing.assert_allclose(p[..., 2], -4, rtol=1e-6)


def test_equirectangular_depth_is_the_ray_length():
    p = camera(Projection.EQUIRECTANGULAR).positions_ws(np.full((9, 13), 4.0))
    np.testing.assert_allclose(np.linalg.norm(p, axis=-1), 4, rtol=1e-6)


def test_points_behind_a_perspective_view_have_no_pixel():
    column, row, depth = camera(Projection.PERSPECTIVE).project(np.array([0.0, 0.0, 1.0]))
    assert depth <= 0 and np.isnan(column) and np.isnan(row)


def test_nothing_seen_gives_position_zero():
    depth = np.full((9, 13), np.inf)
    assert not camera(Projection.PERSPECTIVE, turned()).positions_ws(depth).any()


@pytest.mark.parametrize("projection", Projection)
def test_inverse_matrix_undoes_the_matrix(projection):
    eye = camera(projection, turned((3.0, 4.0, -7.0)))
    np.testing.assert_allclose(eye.view_from_world @ eye.world_from_view, np.eye(4), atol=1e-12)


def test_pixel_size_counts_the_edges():
    assert camera(Projection.ORTHOGRAPHIC).pixel_size == pytest.approx((8 / 13, 3 / 9))


@pytest.mark.parametrize(("longitude", "latitude", "expected"), [
    (0, 0, (0, 0, -1)), (math.pi / 2, 0, (1, 0, 0)), (0, math.pi / 2, (0, 1, 0)), (math.pi, 0, (0, 0, 1))])
def test_longitude_grows_towards_x_and_latitude_towards_y(longitude, latitude, expected):
    np.testing.assert_allclose(direction_from_longitude(np.float64(longitude), np.float64(latitude)), expected, atol=1e-12)


def test_vectors_without_length_take_the_fallback():
    got = normalized(np.array([[0.0, 0, 0], [0, 3, 4], [np.nan, 0, 0]]))
    np.testing.assert_allclose(got, [[0, 0, 1], [0, 0.6, 0.8], [0, 0, 1]])


@pytest.mark.parametrize("projection", Projection)
@pytest.mark.parametrize("size", [0.1, 2.0, 8.0])
def test_boxes_hold_every_point_of_the_hulls_that_the_view_sees(projection, size, rng):
    eye = camera(projection, turned())
    corners = rng.uniform(-6, 6, (200, 1, 3)) + rng.uniform(-size, size, (200, 3, 3))
    box, nearest = eye.boxes_around(corners)
    weight = rng.dirichlet(np.ones(3), 400)
    column, row, depth = eye.project(np.einsum("pc,ncx->npx", weight, corners))
    if projection is Projection.EQUIRECTANGULAR:        # a box may go on beyond a full turn
        left, right = box[:, :1] - 1e-6, box[:, 1:2] + 1e-6
        held = [(column + turn >= left) & (column + turn <= right) for turn in (-13, 0, 13)]
        held = np.any(held, axis=0)
    else:
        held = (column >= box[:, :1] - 1e-6) & (column <= box[:, 1:2] + 1e-6)
    held &= (row >= box[:, 2:3] - 1e-6) & (row <= box[:, 3:] + 1e-6)
    inside = (depth > 0) & (column >= 0) & (column < 13) & (row >= 0) & (row < 9)
    assert inside.any() and held[inside].all()
    assert (depth >= nearest[:, None] - 1e-9)[inside].all()


@pytest.mark.parametrize("projection", [Projection.PERSPECTIVE, Projection.ORTHOGRAPHIC])
def test_boxes_of_flat_views_are_tight(projection):
    eye = camera(projection)
    corners = np.array([[[0.1, 0.2, -2.0], [0.5, -0.3, -1.0], [0.2, 0.1, -4.0]]])
    column, row, depth = eye.project(corners[0])
    box, nearest = eye.boxes_around(corners)
    np.testing.assert_allclose(box[0], [column.min(), column.max(), row.min(), row.max()])
    assert nearest[0] == depth.min()


def test_a_hull_behind_a_perspective_view_has_no_box():
    box, _ = camera(Projection.PERSPECTIVE).boxes_around(np.array([[[0, 0, 1.0], [1, 0, 2], [0, 1, 3]]]))
    assert box[0, 1] < box[0, 0] and box[0, 3] < box[0, 2]


@pytest.mark.parametrize("projection", [Projection.PERSPECTIVE, Projection.EQUIRECTANGULAR])
def test_a_hull_around_the_viewer_takes_the_whole_image(projection):
    corners = np.array([[[-1.0, -1, 1], [1, -1, 1], [0, 3, -3]]])
    box, _ = camera(projection).boxes_around(corners)
    np.testing.assert_array_equal(box, [[0, 13, 0, 9]])
