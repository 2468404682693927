"""The voxel scene: which cells hold a triangle, what they keep of it, and shapes that break voxelisers."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from rtgi_addon.core.frame import Geometry
from rtgi_addon.core.synthetic import box_triangles, make_room_frame
from rtgi_addon.kernels.jit import kernel_session
from rtgi_addon.passes.base import Context
from rtgi_addon.passes.voxel_scene import Grid, coverage_of, grid_around, grid_of_frame, reached_box, voxelise
from tests.plane_frames import geometry_of, quad


def soup(rng, n, low=1.0, high=9.0, size=2.0):
    """(n, 3, 3) random triangles around the middle of a grid of ten cells."""
    return (rng.uniform(low, high, (n, 1, 3)) + rng.uniform(-size, size, (n, 3, 3))).astype(np.float32)


def unit_grid(*shape: int) -> Grid:
    return Grid((0.0, 0.0, 0.0), 1.0, shape or (10, 10, 10))


def overlaps(triangle: np.ndarray, cell: np.ndarray, slack: float) -> bool:
    """Separating axes of a triangle and a unit cube (Akenine-Moeller 2001), in float64; `slack` shrinks the cube."""
    centre, half = cell + 0.5, 0.5 - slack
    v = triangle.astype(np.float64) - centre
    edges = np.roll(v, -1, axis=0) - v
    axes = [*np.eye(3), np.cross(edges[0], edges[1]), *(np.cross(e, a) for e in edges for a in np.eye(3))]
    for axis in axes:
        p, reach = v @ axis, half * np.abs(axis).sum()
        if p.min() > reach or p.max() < -reach:
            return False
    return True


def test_occupied_cells_are_those_that_a_triangle_overlaps(rng):
    for triangle in soup(rng, 12):
        voxels = voxelise(geometry_of(triangle[None]), unit_grid())
        for cell in np.ndindex(10, 10, 10):
            found = voxels.index[cell] >= 0
            # a touch within rounding of float32 coordinates up to ten cells may go either way
            if overlaps(triangle, np.array(cell), 1e-5):
                assert found, cell
            elif not overlaps(triangle, np.array(cell), -1e-5):
                assert not found, cell


def test_voxels_are_the_same_bits_on_one_and_two_threads(rng):
    geometry = geometry_of(soup(rng, 300))
    found = []
    for threads in (1, 2):
        with kernel_session(threads):
            found.append(voxelise(geometry, unit_grid(10, 12, 7)))
    for one, two in zip(*found, strict=True):
        assert one.tobytes() == two.tobytes()


@pytest.mark.parametrize("tilt", [(0.0, 0.0), (0.3, -0.7), (0.85, 0.85), (-0.45, 0.1)])
def test_coverage_along_a_column_adds_up_to_one_for_a_wall_of_any_tilt(tilt):
    # the plane z = 7.3 + a x + b y through a grid high enough to hold it: every column along z meets it once
    a, b = tilt
    corner = [(x, y, 7.3 + a * (x - 4) + b * (y - 4)) for x, y in ((-9.0, -9.0), (17, -9), (17, 17), (-9, 17))]
    triangles = np.array([[corner[0], corner[1], corner[2]], [corner[0], corner[2], corner[3]]])
    total = coverage_of(voxelise(geometry_of(triangles), unit_grid(8, 8, 16)))[..., 2].sum(2)
    assert np.allclose(total, 1.0, atol=1e-5)


def test_voxels_of_a_tilted_wall_keep_its_plane_exactly():
    corner = np.array([(0.2, 0.3, 1.1), (9.5, 0.4, 3.2), (9.1, 9.3, 5.0), (0.3, 9.6, 2.9)])
    corner[3] = corner[0] + corner[2] - corner[1]
    voxels = voxelise(geometry_of(corner[[[0, 1, 2], [0, 2, 3]]]), unit_grid())
    n = np.cross(corner[1] - corner[0], corner[2] - corner[0])
    n /= np.linalg.norm(n)
    assert len(voxels.cells) > 100 and (voxels.masks[:, :2] == 0).all()
    # float32 sums of at most two polygons a voxel; a corner of a cell may be cut to a millionth of its area
    assert np.abs(voxels.planes[:, 2, :3] - n).max() < 1e-5
    offset = n @ corner[0] - voxels.cells @ n
    assert np.abs(voxels.planes[:, 2, 3] - offset).max() < 1e-4


def test_mean_albedo_and_emission_follow_the_triangles():
    geometry = geometry_of(quad((2.0, 2.0, 0.5), 2.0, 2.0))
    albedo = np.where(geometry.corners_ws[..., :1] > 2, 1.0, 0.0) * np.ones(3, np.float32)     # rises with x from 0 to 1
    geometry = dataclasses.replace(geometry, albedo=np.ascontiguousarray(albedo, np.float32),
                                   emission=np.full((2, 3), 3.0, np.float32))
    voxels = voxelise(geometry, unit_grid(4, 4, 1))
    assert np.allclose(voxels.albedo[:, 2, 0], (voxels.cells[:, 0] + 0.5) / 4, atol=1e-5)
    assert np.allclose(voxels.emission[:, 2], 3.0)


def test_two_walls_in_one_voxel_keep_their_own_planes():
    floor, wall = quad((0.0, 0.0, 0.25), 8.0, 8.0), quad((0.0, 0.0, 0.0), 8.0, 8.0)[..., [2, 0, 1]] + [0.75, 0, 0]
    voxels = voxelise(geometry_of(floor, wall), unit_grid(1, 1, 1))
    assert np.allclose(voxels.planes[0, 2], (0, 0, 1, 0.25)) and np.allclose(voxels.planes[0, 0], (1, 0, 0, 0.75))
    assert voxels.masks[0].tolist() == [65535, 0, 65535]


def test_a_quarter_turn_permutes_the_voxels(rng):
    triangles = soup(rng, 40)
    turned = np.ascontiguousarray(triangles[..., [1, 0, 2]])
    turned[..., 0] = 10 - turned[..., 0]                       # (x, y) to (10 - y, x)
    plain, other = coverage_of(voxelise(geometry_of(triangles), unit_grid())), coverage_of(
        voxelise(geometry_of(turned), unit_grid()))
    back = np.transpose(other[::-1], (1, 0, 2, 3))[..., [1, 0, 2]]
    # a square of the raster that a triangle's edge touches may be lost by rounding, with a sixteenth of the face
    assert (np.abs(back - plain) > 1e-4).mean() < 2e-3 and np.abs(back - plain).max() < 0.13


def test_unit_of_the_scene_does_not_change_the_voxels(rng):
    triangles = soup(rng, 40)
    plain = voxelise(geometry_of(triangles), unit_grid())
    for scale in (2.0**-10, 2.0**20):                          # powers of two: the same digits
        other = voxelise(geometry_of(triangles * np.float32(scale)), Grid((0.0, 0.0, 0.0), scale, (10, 10, 10)))
        assert all(a.tobytes() == b.tobytes() for a, b in zip(plain, other, strict=True))


def test_broken_triangles_are_left_out(rng):
    good = soup(rng, 20)
    bad = soup(rng, 4)
    bad[0, 1, 2], bad[1, 0, 0], bad[2, 2], bad[3, 1] = np.nan, np.inf, bad[2, 1], bad[3, 0]
    plain, other = voxelise(geometry_of(good), unit_grid()), voxelise(geometry_of(bad[:2], good, bad[2:]), unit_grid())
    assert all(a.tobytes() == b.tobytes() for a, b in zip(plain, other, strict=True))


def test_a_million_triangles_in_one_voxel_are_one_voxel(rng):
    corner = rng.uniform(0.1, 0.9, (1_000_000, 3, 3)).astype(np.float32)
    grey = np.full((len(corner), 3, 3), 0.5, np.float32)
    voxels = voxelise(Geometry(corner, grey, grey[:, 0], np.zeros(len(corner), np.int32)), unit_grid(2, 2, 2))
    assert len(voxels.cells) == 1
    # float32 sums of some 3e5 terms a slot, whose rounding is alike in numerator and denominator
    assert np.allclose(voxels.albedo, 0.5, rtol=0.02) and np.isfinite(voxels.planes).all()


def test_triangles_across_the_grid_are_cut_to_it():
    far = quad((5.0, 5.0, 3.5), 1e6, 1e6)
    voxels = voxelise(geometry_of(far), unit_grid())
    assert len(voxels.cells) == 100 and (voxels.cells[:, 2] == 3).all() and (voxels.masks[:, 2] == 65535).all()


def test_nothing_gives_no_voxels():
    for geometry in (Geometry.empty(), geometry_of(quad((50.0, 50.0, 50.0), 1.0, 1.0))):
        voxels = voxelise(geometry, unit_grid())
        assert not len(voxels.cells) and (voxels.index == -1).all()


def test_a_speck_smaller_than_the_raster_is_kept_with_its_size():
    voxels = voxelise(geometry_of(quad((2.6, 2.6, 2.5), 0.01, 0.01)), unit_grid())
    assert len(voxels.cells) == 1 and bin(voxels.masks[0, 2]).count("1") == 1
    assert np.isclose(voxels.areas[0, 2], 4e-4, rtol=1e-3)
    assert np.abs(voxels.boxes[0, 2] / 255 - (0.59, 0.59, 0.5, 0.61, 0.61, 0.5)).max() < 1.5 / 255


def test_surfaces_behind_each_other_cover_a_face_once():
    voxels = voxelise(geometry_of(quad((0.5, 0.5, 0.2), 0.5, 0.25), quad((0.5, 0.5, 0.8), 0.5, 0.25)), unit_grid(1, 1, 1))
    assert np.isclose(voxels.areas[0, 2], 0.5, atol=1e-3) and np.isclose(coverage_of(voxels)[0, 0, 0, 2], 0.5, atol=1e-3)


def test_triangles_of_one_surface_in_a_voxel_share_its_area(rng):
    # a fan around a point inside the cell: its parts add up, whatever squares of the raster they touch
    corner, middle = np.array([(0.1, 0.1, 0.5), (0.9, 0.1, 0.5), (0.9, 0.9, 0.5), (0.1, 0.9, 0.5)]), (0.43, 0.61, 0.5)
    fan = np.array([[corner[i], corner[(i + 1) % 4], middle] for i in range(4)])
    assert np.isclose(voxelise(geometry_of(fan), unit_grid(1, 1, 1)).areas[0, 2], 0.64, rtol=1e-5)


def test_many_large_triangles_are_taken_in_batches(rng, monkeypatch):
    from rtgi_addon.passes import voxel_scene

    geometry = geometry_of(soup(rng, 60, size=8.0))
    plain = voxelise(geometry, unit_grid())
    monkeypatch.setattr(voxel_scene, "BATCH_ENTRIES", 32)
    assert all(a.tobytes() == b.tobytes() for a, b in zip(plain, voxelise(geometry, unit_grid()), strict=True))


@pytest.mark.parametrize("resolution", [8, 33, 128])
def test_a_grid_holds_its_box_with_cubic_cells(resolution):
    low, high = np.array([-1.0, 2.0, 0.0]), np.array([3.0, 2.5, 1.0])
    grid = grid_around(low, high, resolution)
    assert max(grid.shape) == resolution
    top = np.array(grid.origin_ws) + np.array(grid.shape) * grid.cell_m
    assert (np.array(grid.origin_ws) <= low - 0.4 * grid.cell_m).all() and (top >= high + 0.4 * grid.cell_m).all()


@pytest.mark.parametrize(("low", "high"), [((0, 0, 0), (0, 0, 0)), ((5e5, 5e5, 1), (5e5, 5e5, 1)), ((0, 0, 0), (1e-3, 0, 0)),
                                           ((-1e6, -1e6, 0), (1e6, 1e6, 0))])
def test_a_grid_of_any_box_has_cells(low, high):
    grid = grid_around(np.array(low, float), np.array(high, float), 64)
    assert grid.cell_m > 0 and all(1 <= n <= 64 for n in grid.shape)


def test_a_ground_plane_of_kilometres_does_not_eat_the_grid():
    frame = make_room_frame(32, 24)
    ground = Geometry(np.concatenate([frame.geometry.corners_ws, quad((0, 0, -0.01), 1e4, 1e4).astype(np.float32)]),
                      np.concatenate([frame.geometry.albedo, np.full((2, 3, 3), 0.5, np.float32)]),
                      np.zeros((len(frame.geometry) + 2, 3), np.float32),
                      np.concatenate([frame.geometry.material, np.zeros(2, np.int32)]))
    grid = grid_of_frame(dataclasses.replace(frame, geometry=ground), Context(), 64)
    assert grid.cell_m * 64 < 5.0                             # the room is four metres wide


def test_box_of_an_open_frame_is_what_rays_meet():
    # a cube a hundred metres off, behind a wall: nothing seen, and no ray from there, meets it
    frame = make_room_frame(32, 24)
    far = geometry_of(frame.geometry.corners_ws, box_triangles(np.full(3, 100.0), np.full(3, 101.0)))
    low, high = reached_box(dataclasses.replace(frame, geometry=far), Context())
    assert (high < 5).all() and (low > -5).all()
