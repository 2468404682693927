"""Emissive meshes that are lamps: which shapes are found, where their lamps stand and what they give, and what is none."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from rtgi_addon.core.emitters import find_shapes
from rtgi_addon.core.frame import Cutouts, Geometry, LightKind, Material
from rtgi_addon.core.radiometry import find_emitters
from rtgi_addon.emitter_lamps import part_emitters
from rtgi_addon.kernels.bvh import build_bvh
from rtgi_addon.kernels.jit import kernel_session
from tests.plane_frames import geometry_of, quad

RADIANCE = np.float32([4, 2, 1])
MATERIALS = (Material("Tube"),)


def turn(angles=(0.4, -0.7, 1.1)):
    """A rotation about all three axes."""
    out = np.eye(3)
    for axis, angle in enumerate(angles):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        step = np.eye(3)
        step[i, i] = step[j, j] = math.cos(angle)
        step[i, j], step[j, i] = -math.sin(angle), math.sin(angle)
        out = step @ out
    return out


def placed(triangles, rotation=None, place=(0, 0, 0)):
    """Triangles turned and moved, corner by corner, as a mesh is: those that share a place still do to the last bit."""
    corners, index = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
    return (corners @ (turn() if rotation is None else rotation).T + np.array(place))[index].reshape(triangles.shape)


def shining(*meshes, dark=()):
    """Geometry whose `meshes` shine, in front of `dark` ones."""
    geometry = geometry_of(*meshes, *dark)
    emission = geometry.emission.copy()
    emission[:sum(map(len, meshes))] = RADIANCE
    return dataclasses.replace(geometry, emission=emission)


def grid(n, size_x, size_y):
    """(2 n^2, 3, 3) a rectangle on z = 0 in n x n parts."""
    x, y = np.meshgrid(np.linspace(-size_x / 2, size_x / 2, n + 1), np.linspace(-size_y / 2, size_y / 2, n + 1))
    p = np.stack([x, y, 0 * x], -1)
    a, b, c, d = p[:-1, :-1], p[:-1, 1:], p[1:, 1:], p[1:, :-1]
    return np.concatenate([np.stack([a, b, c], -2).reshape(-1, 3, 3), np.stack([a, c, d], -2).reshape(-1, 3, 3)])


def fan(n, half_x, half_y, has_middle):
    """(n or n - 2, 3, 3) a polygon in an ellipse on z = 0."""
    angle = 2 * np.pi * np.arange(n) / n
    rim = np.stack([half_x * np.cos(angle), half_y * np.sin(angle), 0 * angle], 1)
    if has_middle:
        return np.stack([np.zeros((n, 3)), rim, np.roll(rim, -1, 0)], 1)
    return np.stack([np.repeat(rim[:1], n - 2, 0), rim[1:-1], rim[2:]], 1)


def ball(rings, parts, radius=1.0):
    """(T, 3, 3) a sphere of rings and parts, as Blender's UV sphere."""
    theta, phi = np.pi * np.arange(rings + 1) / rings, 2 * np.pi * (np.arange(parts) / parts)
    p = radius * np.stack([np.sin(theta)[:, None] * np.cos(phi), np.sin(theta)[:, None] * np.sin(phi),
                           np.broadcast_to(np.cos(theta)[:, None], (rings + 1, parts))], -1)
    p[0], p[-1] = (0, 0, radius), (0, 0, -radius)
    q = np.roll(p, -1, 1)
    lower = np.stack([p[:-1], p[1:], q[1:]], -2)[:-1].reshape(-1, 3, 3)
    upper = np.stack([p[:-1], q[1:], q[:-1]], -2)[1:].reshape(-1, 3, 3)
    return np.concatenate([lower, upper])


def box(size):
    """(12, 3, 3) the faces of a box, with shared corners."""
    half = np.array(size) / 2
    faces = []
    for axis in range(3):
        for sign in (-1, 1):
            p = grid(1, 1, 1)
            at = np.empty_like(p)
            at[..., axis] = sign * half[axis]
            at[..., (axis + 1) % 3], at[..., (axis + 2) % 3] = (2 * p[..., k] * half[(axis + 1 + k) % 3] for k in (0, 1))
            faces.append(at)
    return np.concatenate(faces)


@pytest.mark.parametrize("n", [1, 2, 7])
@pytest.mark.parametrize("size", [(1.0, 1.0), (2.0, 0.05), (0.01, 0.02)])
def test_rectangle_of_any_subdivision_is_found_wherever_it_lies(n, size):
    place, rotation = np.array([3.0, -1.0, 2.0]), turn()
    shape, = find_shapes(shining(placed(grid(n, *size), rotation, place)))
    assert shape.kind is LightKind.RECTANGLE and len(shape.triangles) == 2 * n * n
    # three metres away a corner is off by 2e-7 m
    assert sorted((shape.size_x_m, shape.size_y_m)) == pytest.approx(sorted(size), rel=1e-4)
    np.testing.assert_allclose(shape.centre_ws, place, atol=1e-6)
    assert abs(shape.axes[2] @ rotation[:, 2]) == pytest.approx(1, abs=1e-6)
    long = rotation[:, 0] if size[0] > size[1] else rotation[:, 1]
    if size[0] != size[1]:
        assert abs(shape.axes[0 if shape.size_x_m > shape.size_y_m else 1] @ long) == pytest.approx(1, abs=1e-6)
    np.testing.assert_array_equal(shape.radiance, RADIANCE)


@pytest.mark.parametrize("has_middle", [True, False])
@pytest.mark.parametrize(("n", "half"), [(16, (1.0, 1.0)), (32, (0.3, 0.3)), (64, (2.0, 0.5))])
def test_disk_has_the_area_of_its_polygon(n, half, has_middle):
    triangles = fan(n, *half, has_middle)
    shape, = find_shapes(shining(placed(triangles)))
    assert shape.kind is LightKind.DISK
    across = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    area_m2, sizes = 0.5 * np.linalg.norm(across, axis=1).sum(), sorted((shape.size_x_m, shape.size_y_m))
    assert math.pi / 4 * sizes[0] * sizes[1] == pytest.approx(area_m2, rel=1e-5)
    assert sizes[1] / sizes[0] == pytest.approx(half[0] / half[1], rel=1e-4)


@pytest.mark.parametrize(("rings", "parts"), [(8, 16), (16, 32), (32, 64)])
def test_ball_becomes_a_sphere_of_the_flux_of_its_triangles(rings, parts):
    geometry = shining(placed(ball(rings, parts, 0.2), place=(1, 2, 3)), dark=(quad((0, 0, 0), 3, 3),))
    rest, (lamp,) = part_emitters(geometry, MATERIALS, build_bvh(geometry.corners_ws))
    assert lamp.kind is LightKind.POINT and lamp.is_sphere and lamp.is_surface and lamp.name.startswith("Tube")
    # outside of every corner, so that shadow rays end before the triangles, by a ten-thousandth of its size
    assert 0.2 < lamp.radius_m < 0.2 * 1.001
    np.testing.assert_allclose(lamp.position_ws, [1, 2, 3], atol=1e-6)
    flux = math.pi * find_emitters(geometry).power.sum() * RADIANCE / RADIANCE.mean()
    np.testing.assert_allclose(4 * math.pi * lamp.power, flux, rtol=1e-5)
    assert not rest.emission.any() and geometry.emission.any()


def test_a_panel_that_hangs_free_is_two_lamps_back_to_back():
    geometry = shining(quad((0, 0, 2), 0.5, 0.25), dark=(quad((0, 0, 0), 3, 3), quad((0, 0, 3), 3, 3)))
    rest, lamps = part_emitters(geometry, MATERIALS, build_bvh(geometry.corners_ws))
    assert [lamp.kind for lamp in lamps] == [LightKind.RECTANGLE] * 2 and len({lamp.name for lamp in lamps}) == 2
    for lamp in lamps:
        up = lamp.direction_ws[2]
        np.testing.assert_allclose(np.abs(up), 1, atol=1e-6)
        assert np.linalg.det(lamp.world_from_light[:3, :3]) == pytest.approx(1)
        assert 0 < (lamp.position_ws[2] - 2) * up < 1e-3      # before the side that it shines from
        np.testing.assert_array_equal(lamp.power, RADIANCE)
    assert lamps[0].direction_ws @ lamps[1].direction_ws == pytest.approx(-1)
    assert not rest.emission.any()
    assert rest.corners_ws is geometry.corners_ws             # so that the tree is the same


@pytest.mark.parametrize("gap", [1e-4, 5e-3])
def test_the_side_on_a_wall_is_no_lamp(gap):
    geometry = shining(quad((0, 0, 3 - gap), 0.5, 0.5), dark=(quad((0, 0, 0), 3, 3), quad((0, 0, 3), 3, 3)))
    _, (lamp,) = part_emitters(geometry, MATERIALS, build_bvh(geometry.corners_ws))
    np.testing.assert_allclose(lamp.direction_ws, [0, 0, -1], atol=1e-6)


def test_faces_of_a_box_shine_outwards_only():
    geometry = shining(box((1.0, 0.8, 0.6)))
    _, lamps = part_emitters(geometry, MATERIALS, build_bvh(geometry.corners_ws))
    assert len(lamps) == 6
    for lamp in lamps:
        assert lamp.direction_ws @ lamp.position_ws > 0.29


def test_a_dome_around_a_scene_is_no_lamp():
    assert find_shapes(shining(ball(16, 32, 10.0), dark=(quad((0, 0, 0), 3, 3),))) == []


def test_walls_that_shine_light_what_stands_between_them():
    geometry = shining(box((4.0, 4.0, 3.0)), dark=(quad((0, 0, 0), 0.7, 0.7),))
    _, lamps = part_emitters(geometry, MATERIALS, build_bvh(geometry.corners_ws))
    inwards = [lamp for lamp in lamps if lamp.direction_ws @ lamp.position_ws < 0]
    assert len(inwards) == 6


def without_a_corner():
    return grid(4, 1, 1)[1:]


def bent():
    triangles = grid(12, 1, 1)
    triangles[..., 2] = triangles[..., 0] ** 2
    return triangles


@pytest.mark.parametrize("triangles", [without_a_corner(), bent(), fan(6, 1, 1, True), fan(3, 1, 1, False),
                                       ball(8, 16) * np.array([1, 1, 1.2]), ball(16, 32)[200:],
                                       np.concatenate([grid(1, 1, 1), grid(1, 1, 1)])])
def test_other_shapes_are_none(triangles):
    geometry = shining(triangles)
    assert [shape for shape in find_shapes(geometry) if len(shape.triangles) == len(triangles)] == []


def test_uneven_emission_and_cutouts_are_none():
    geometry = shining(grid(1, 1, 1))
    uneven = dataclasses.replace(geometry, emission=geometry.emission * np.float32([[1], [1.01]]))
    assert find_shapes(uneven) == []
    cutouts = Cutouts(np.zeros(2, np.int32), np.zeros((1, 3, 2), np.float32), np.ones(1, np.float32), np.zeros(1, bool),
                      np.array([[0, 1, 1]], np.int32), np.full(1, 128, np.uint8))
    assert find_shapes(dataclasses.replace(geometry, cutouts=cutouts)) == []
    assert len(find_shapes(geometry)) == 1


def test_of_many_small_ones_none_is_a_lamp_and_a_strong_one_among_them_is():
    small = [grid(1, 0.1, 0.1) + np.array([0.2 * k, 0, 0]) for k in range(30)]
    assert find_shapes(shining(*small)) == []
    shape, = find_shapes(shining(grid(1, 1, 1) + np.array([0, 0, 1]), *small))
    assert shape.size_x_m == pytest.approx(1)


def test_panels_side_by_side_in_one_plane_are_two():
    first, second = find_shapes(shining(grid(1, 1, 1), grid(1, 1, 1) + np.array([2, 0, 0])))
    assert abs(first.centre_ws[0] - second.centre_ws[0]) == pytest.approx(2)


def test_what_is_not_finite_and_what_has_no_area_shines_as_nothing():
    broken = grid(1, 1, 1)
    broken[0, 0, 0] = np.nan
    assert find_shapes(shining(broken)) == []
    assert find_shapes(shining(np.zeros((4, 3, 3)))) == []
    assert find_shapes(geometry_of(grid(1, 1, 1))) == [] and find_shapes(Geometry.empty()) == []
    shape, = find_shapes(shining(grid(1, 1, 1), broken + np.array([0, 0, 1])))
    assert len(shape.triangles) == 2


def test_nothing_changes_without_a_shape():
    geometry = shining(bent())
    with kernel_session(1):
        same, lamps = part_emitters(geometry, MATERIALS, build_bvh(geometry.corners_ws))
    assert same is geometry and lamps == ()
