"""The camera's view in kernels: against `core.transforms`, for shifted perspective and orthographic cameras alike."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rtgi_addon.core.frame import Frame, GBuffer
from rtgi_addon.core.transforms import Camera, Projection, normalized
from rtgi_addon.kernels import screen as s
from rtgi_addon.kernels.sampling import dither, place_id
from rtgi_addon.kernels.vec3 import Vec3, f32, vector
from rtgi_addon.passes.screen import TILE_PX, Tile, classify_tiles, screen_of, tiles_with

FLAT = [Projection.PERSPECTIVE, Projection.ORTHOGRAPHIC]
HEIGHT, WIDTH = 9, 13
EDGES = (-0.3, 0.8, -0.9, 0.2)      # shifted far off the axis, pixels that are not square
FLOAT32 = 2e-5                      # a few roundings of coordinates of some metres


def turned():
    x, z = normalized(np.array([1.0, 2.0, -0.5])), np.array([0.2, 0.1, 0.9])
    z = normalized(z - x * (x @ z))
    out = np.eye(4)
    out[:3, 0], out[:3, 1], out[:3, 2], out[:3, 3] = x, np.cross(z, x), z, (1.0, -2.0, 0.5)
    return out


def frame_of(projection, depth, specular=0.0, roughness=1.0):
    camera = Camera(projection, turned(), depth.shape[1], depth.shape[0], *EDGES)
    position = camera.positions_ws(depth)
    normal = np.broadcast_to(np.float32([0, 0, 1]), position.shape).copy()
    colour = np.zeros_like(position)
    return Frame(camera, GBuffer(depth.astype(np.float32), position, normal, colour, colour + np.float32(specular),
                                 np.full(depth.shape, roughness, np.float32), colour))


@pytest.fixture(params=FLAT, ids=lambda p: p.value)
def seen(request, rng):
    """(frame, its Screen) of random depths."""
    frame = frame_of(request.param, rng.uniform(0.5, 9.0, (HEIGHT, WIDTH)))
    return frame, screen_of(frame)


def test_seen_points_project_to_their_pixels_centres(seen):
    frame, screen = seen
    for i in range(HEIGHT):
        for j in range(WIDTH):
            got = s.to_screen(screen, vector(frame.gbuffer.position_ws[i, j]))
            np.testing.assert_allclose(got[:2], (j + 0.5, i + 0.5), atol=1e-3)
            assert math.isclose(got[2], frame.gbuffer.depth[i, j], rel_tol=FLOAT32)


def test_projection_equals_that_of_the_camera(seen, rng):
    frame, screen = seen
    for p in frame.camera.position_ws - 3 * frame.camera.world_from_view[:3, 2] + rng.uniform(-1, 1, (20, 3)):
        np.testing.assert_allclose(s.to_screen(screen, vector(p)), frame.camera.project(p), rtol=1e-3, atol=1e-3)


def test_view_space_point_of_a_pixel_is_its_position(seen):
    frame, screen = seen
    matrix = frame.camera.view_from_world
    for i, j in ((0, 0), (4, 7), (8, 12)):
        wanted = matrix[:3, :3] @ frame.gbuffer.position_ws[i, j] + matrix[:3, 3]
        np.testing.assert_allclose(s.seen_vs(screen, i, j), wanted, atol=FLOAT32 * 10)


def test_directions_turn_to_the_view_and_back(seen):
    frame, screen = seen
    d = vector(normalized(np.array([0.3, -0.5, 0.8])))
    there = s.turn_to_view(screen, d)
    np.testing.assert_allclose(there, frame.camera.view_from_world[:3, :3] @ np.array(d), atol=1e-6)
    np.testing.assert_allclose(s.turn_to_world(screen, there), d, atol=1e-6)


def test_view_vector_points_to_the_viewer():
    depth = np.full((HEIGHT, WIDTH), 4.0)
    frame = frame_of(Projection.PERSPECTIVE, depth)
    p = frame.gbuffer.position_ws[2, 11]
    wanted = normalized(frame.camera.position_ws - p)
    np.testing.assert_allclose(s.view_vector(screen_of(frame), vector(p)), wanted, atol=1e-5)
    frame = frame_of(Projection.ORTHOGRAPHIC, depth)
    got = s.view_vector(screen_of(frame), vector(frame.gbuffer.position_ws[2, 11]))
    np.testing.assert_allclose(got, frame.camera.world_from_view[:3, 2], atol=1e-6)


def test_points_behind_an_eye_have_no_pixel():
    screen = screen_of(frame_of(Projection.PERSPECTIVE, np.ones((HEIGHT, WIDTH))))
    assert s.view_to_screen(screen, Vec3(f32(0.1), f32(0.2), f32(1.0))) == (0, 0, -1)
    assert s.view_to_screen(screen, Vec3(f32(0.1), f32(0.2), f32(0.0)))[:2] == (0, 0)


def test_length_covers_as_many_pixels_as_its_ends_are_apart(seen):
    # a diagonal of the image plane: the mean of the edges is geometric
    frame, screen = seen
    depth, size = f32(2.5), f32(0.01)
    centre = s.point_vs(screen, f32(6), f32(4), depth)
    step_x, step_y = frame.camera.pixel_size
    column = s.view_to_screen(screen, Vec3(centre.x + size, centre.y, centre.z))[0] - f32(6)
    row = f32(4) - s.view_to_screen(screen, Vec3(centre.x, centre.y + size, centre.z))[1]
    assert math.isclose(s.pixel_radius(screen, depth, size), math.sqrt(column * row), rel_tol=1e-3)
    assert math.isclose(column * step_x, row * step_y, rel_tol=1e-3)


def test_pixel_radius_at_no_distance_is_finite_and_huge():
    screen = screen_of(frame_of(Projection.PERSPECTIVE, np.ones((HEIGHT, WIDTH))))
    assert 1e20 < s.pixel_radius(screen, f32(0), f32(1)) < np.inf


@pytest.mark.parametrize(("column", "row", "wanted"), [
    (0.0, 0.0, True), (12.99, 8.99, True), (13.0, 4.0, False), (4.0, 9.0, False), (-1e-3, 4.0, False), (4.0, -1e-3, False),
    (np.nan, 4.0, False), (4.0, np.inf, False)])
def test_frame_ends_at_its_outer_pixels_edges(column, row, wanted):
    screen = screen_of(frame_of(Projection.PERSPECTIVE, np.ones((HEIGHT, WIDTH))))
    assert s.is_inside(screen, f32(column), f32(row)) == wanted


def test_height_above_a_plane_is_signed():
    p, n = vector(np.array([1.0, 2.0, 3.0])), vector(np.array([0.0, 0.0, 1.0]))
    assert s.height_above_plane(p, n, vector(np.array([4.0, 6.0, 3.0]))) == (0, 5)
    assert s.height_above_plane(p, n, vector(np.array([1.0, 2.0, 1.0]))) == (-2, 2)


def test_noise_depends_on_pixel_seed_and_index_only():
    screen = screen_of(frame_of(Projection.PERSPECTIVE, np.ones((HEIGHT, WIDTH))))
    for noise in (lambda i, j, seed, k: s.pixel_hash(screen, i, j, seed, k),
                  lambda i, j, seed, k: dither(place_id(i, j), seed, k)):
        base = noise(3, 4, 5, 6)
        assert base == noise(3, 4, 5, 6)
        assert len({base, noise(4, 4, 5, 6), noise(3, 5, 5, 6), noise(3, 4, 6, 6), noise(3, 4, 5, 7)}) == 5


def test_tiles_tell_sky_mirrors_rough_gloss_and_world_light():
    depth = np.full((2 * TILE_PX + 1, 2 * TILE_PX + 3), np.inf)
    depth[TILE_PX:, :TILE_PX] = 2.0
    depth[-1, -1] = 3.0
    g = frame_of(Projection.PERSPECTIVE, depth, specular=0.5, roughness=0.5).gbuffer
    g.roughness[-1, -1] = 0.0
    light = np.zeros((*depth.shape, 3), np.float32)
    light[TILE_PX, 0, 1] = 1.0
    light[0, 0] = 1.0               # of the sky: no surface, no work
    tiles = classify_tiles(g, light)
    rough = Tile.SURFACE | Tile.ROUGH
    np.testing.assert_array_equal(tiles, [[0, 0, 0], [rough | Tile.WORLD_LIGHT, 0, 0],
                                          [rough, 0, Tile.SURFACE | Tile.MIRROR]])
    np.testing.assert_array_equal(tiles_with(tiles, Tile.SURFACE), [[8, 0], [16, 0], [16, 16]])
    np.testing.assert_array_equal(tiles_with(tiles, Tile.WORLD_LIGHT), [[8, 0]])
    assert tiles_with(classify_tiles(g), Tile.WORLD_LIGHT).shape == (0, 2)
