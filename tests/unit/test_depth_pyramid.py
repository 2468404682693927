"""Planes of pixels and the pyramid over their bounds: exact on planes, odd sizes, every camera."""

from __future__ import annotations

import numpy as np
import pytest

from rtgi_addon.core.synthetic import cast_view, make_room_frame
from rtgi_addon.core.transforms import Camera, Projection
from rtgi_addon.kernels.depth_pyramid import (
    HEIGHT,
    HIGH,
    LOW,
    NOTHING,
    SLACK,
    SLOPE_X,
    SLOPE_Y,
    build_pyramid,
    fill_pyramid,
    pyramid_layout,
)
from rtgi_addon.kernels.shadow import ORTHOGRAPHIC
from rtgi_addon.passes.screen import screen_of
from tests.plane_frames import frame_of, geometry_of, looking, quad

FLOAT32 = 3e-6          # of the height: depths are rounded to float32, and slopes are differences of them


def camera_of(projection: Projection, shift: float, width: int = 24, height: int = 17) -> Camera:
    """Looks down at the floor, askew; `shift` moves the image plane."""
    half = 0.5 if projection is Projection.PERSPECTIVE else 1.5
    return Camera(projection, looking((0.3, -2.0, 2.0), (0.1, 0.2, 0.0), (0.2, 0.1, 1.0)), width, height, shift - half,
                  shift + half, -half * height / width, half * height / width)


def floor_pyramid(projection, shift=0.0):
    camera = camera_of(projection, shift)
    geometry = geometry_of(quad((0, 0, 0), 50, 50))
    screen = screen_of(frame_of(geometry, cast_view(camera, geometry), camera))
    return screen, build_pyramid(screen, 1.0)


@pytest.mark.parametrize("shift", [0.0, 0.4])
@pytest.mark.parametrize("projection", [Projection.PERSPECTIVE, Projection.ORTHOGRAPHIC])
def test_planes_of_pixels_on_a_floor_are_one_plane(projection, shift):
    screen, pyramid = floor_pyramid(projection, shift)
    planes = pyramid.planes.astype(np.float64)
    height = -screen.depth if screen.projection == ORTHOGRAPHIC else 1 / screen.depth
    assert np.allclose(planes[..., HEIGHT], height, rtol=1e-6)
    ahead = planes[:, :-1, HEIGHT] + planes[:, :-1, SLOPE_X]
    below = planes[:-1, :, HEIGHT] + planes[:-1, :, SLOPE_Y]
    scale = np.abs(height).max()
    assert np.abs(ahead - planes[:, 1:, HEIGHT]).max() < FLOAT32 * scale
    assert np.abs(below - planes[1:, :, HEIGHT]).max() < FLOAT32 * scale


def test_slope_beside_a_silhouette_is_that_of_the_pixels_own_surface():
    frame = make_room_frame(48, 36)
    pyramid, g = build_pyramid(screen_of(frame), 1.0), frame.gbuffer
    _, direction = frame.camera.rays_vs()
    normal_vs = g.normal_ws @ frame.camera.world_from_view[:3, :3]
    # the room is made of planes: from the exact normal, h = n . (x, y, -1) / (n . point)
    over = np.einsum("hwc,hwc->hw", normal_vs, direction) * g.depth
    step_x, step_y = frame.camera.pixel_size
    expected = np.stack([normal_vs[..., 0] * step_x, -normal_vs[..., 1] * step_y], -1) / over[..., None]
    got = pyramid.planes[..., [SLOPE_X, SLOPE_Y]]
    close = (np.abs(got - expected) < FLOAT32 * (1 / g.depth).max()).all(-1)
    # the box's top is one row of pixels, seen edge-on between steps of one sign on both sides: it takes the smaller step
    assert close.mean() > 0.98


def test_bump_mapped_normals_do_not_bend_the_planes(rng):
    screen, straight = floor_pyramid(Projection.PERSPECTIVE)
    bumpy = screen.normal_ws + rng.normal(0, 0.4, screen.normal_ws.shape).astype(np.float32)
    bent = build_pyramid(screen._replace(normal_ws=bumpy / np.linalg.norm(bumpy, axis=-1, keepdims=True)), 1.0)
    inner = (slice(1, -1), slice(1, -1))        # pixels at the picture's edge have one neighbour only
    scale = straight.planes[..., HEIGHT].max()
    assert np.abs(bent.planes[inner] - straight.planes[inner]).max() < FLOAT32 * scale


@pytest.mark.parametrize("shape", [(1, 1), (7, 5), (16, 16), (17, 33), (2, 9)])
def test_every_cell_bounds_the_pixels_below_it(rng, shape):
    first, rows, columns = pyramid_layout(*shape)
    bounds = np.zeros((int(first[-1]) + 1, 2), np.float32)
    base = rng.normal(size=(*shape, 2)).astype(np.float32)
    bounds[:shape[0] * shape[1]] = base.reshape(-1, 2)
    fill_pyramid(bounds, first, rows, columns)
    assert (rows[-1], columns[-1]) == (1, 1)
    for level in range(len(first)):
        for i in range(rows[level]):
            for j in range(columns[level]):
                below = base[i << level:(i + 1) << level, j << level:(j + 1) << level]
                cell = bounds[first[level] + i * columns[level] + j]
                assert cell[HIGH] == below[..., HIGH].max() and cell[LOW] == below[..., LOW].min()


def test_pixels_that_see_nothing_stop_no_ray_and_hide_none():
    frame = make_room_frame(16, 12)
    depth = np.full(frame.gbuffer.shape, np.inf, np.float32)
    pyramid = build_pyramid(screen_of(frame)._replace(depth=depth), 1.0)
    assert (pyramid.bounds[:, HIGH] == -NOTHING).all() and (pyramid.bounds[:, LOW] == NOTHING).all()


@pytest.mark.parametrize("projection", [Projection.PERSPECTIVE, Projection.ORTHOGRAPHIC])
def test_slack_is_a_thickness_in_pixels_or_in_metres(projection):
    screen, thin = floor_pyramid(projection)
    thick = build_pyramid(screen, 1.0, 0.25)
    depth = screen.depth.astype(np.float64)
    width_m = screen.step_x * (depth if projection is Projection.PERSPECTIVE else 1)
    for pyramid, thickness in ((thin, width_m), (thick, 0.25)):
        far = depth + thickness
        expected = 1 / depth - 1 / far if projection is Projection.PERSPECTIVE else thickness * np.ones_like(depth)
        assert np.allclose(pyramid.planes[..., SLACK], expected, rtol=1e-4)
