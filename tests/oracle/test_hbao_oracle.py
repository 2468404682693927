"""HBAO's kernels against float64 forms that look like the papers, on small frames of every kind of camera."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from rtgi_addon.core.frame import Frame, World
from rtgi_addon.core.synthetic import make_room_frame
from rtgi_addon.core.techniques import HbaoParams
from rtgi_addon.passes.base import Context, Transport
from rtgi_addon.passes.hbao import bent_normals, compute_hbao
from tests.oracle.ambient_oracle import CAMERAS, published_visibility, room_seen_by, sector_visibility

RADIUS_M, THICKNESS = 0.8, 0.7
# 32 slices of 128 taps each way, or 128 directions: the turn of the lines at steps in depth, and 64 sectors that sample the
# angles, leave up to 0.02 at a pixel
POINT, RMS = 0.02, 0.007


@pytest.fixture(params=CAMERAS)
def frame(request) -> Frame:
    return room_seen_by(request.param)


def points_of(frame: Frame) -> list[tuple[int, int]]:
    """Eight pixels near edges, where visibility varies, and the middle one."""
    normal = frame.gbuffer.normal_ws
    is_edge = (np.abs(normal[:-2, :-2] - normal[2:, 2:]) > 0.1).any(-1) & frame.gbuffer.mask[:-2, :-2]
    near = np.argwhere(is_edge)
    return [tuple(at) for at in near[::len(near) // 8][:8]] + [(12, 16)]


def check(got: np.ndarray, wanted: np.ndarray) -> None:
    error = got - wanted
    assert np.ptp(wanted) > 0.2                  # the points do not all look alike
    assert np.abs(error).max() < POINT and np.sqrt(np.mean(error**2)) < RMS


def test_sectors_equal_the_integral_over_directions(frame):
    params = HbaoParams(radius_m=RADIUS_M, thickness=THICKNESS, slices=32, steps=128, blur=0)
    result = compute_hbao(frame, params, Context(), 1)
    at = points_of(frame)
    wanted = np.array([sector_visibility(frame, i, j, RADIUS_M, THICKNESS * RADIUS_M, 32)[0] for i, j in at])
    check(np.array([result.visibility[i, j] for i, j in at]), wanted)


def test_bent_normal_equals_the_mean_open_direction(frame):
    params = HbaoParams(radius_m=RADIUS_M, thickness=THICKNESS, slices=32, steps=128, blur=0)
    _, bent = bent_normals(frame, params, Context(), 1)
    for i, j in points_of(frame)[::2]:
        wanted = sector_visibility(frame, i, j, RADIUS_M, THICKNESS * RADIUS_M, 32)[1]
        # eight means a slice stand for its directions, whatever part of an eighth is open
        assert np.linalg.norm(bent[i, j] - wanted) < 0.03


@pytest.mark.parametrize("has_falloff", [True, False])
def test_published_horizons_equal_the_papers_sum(frame, has_falloff):
    # what lies beyond a step in depth makes the horizon jump with the direction: 48 directions against 64 are still 0.02 off
    params = HbaoParams(method="PUBLISHED", radius_m=RADIUS_M, bias_rad=0.05, falloff=has_falloff, slices=64, steps=128,
                        blur=0)
    result = compute_hbao(frame, params, Context(), 1)
    at = points_of(frame)
    wanted = np.array([published_visibility(frame, i, j, RADIUS_M, 0.05, has_falloff, 256) for i, j in at])
    check(np.array([result.visibility[i, j] for i, j in at]), wanted)


def test_light_is_open_irradiance_times_visibility():
    frame = make_room_frame(24, 16, kinds=(), world_radiance=0.25)
    result = compute_hbao(frame, HbaoParams(), Context(), 0)
    wanted = np.where(frame.gbuffer.mask, np.pi * 0.25 * result.visibility, 0)
    np.testing.assert_allclose(result.light[Transport.WORLD_DIFFUSE], np.repeat(wanted[..., None], 3, 2), rtol=1e-5)


def test_light_of_a_map_comes_from_where_the_pixel_looks():
    # light from +X alone: irradiance pi L times the cosine squared averages of a map of one bright half
    radiance = np.zeros((8, 16, 3), np.float32)
    radiance[:, 8:] = 1.0                        # longitudes 0 to pi: the half of +X
    frame = dataclasses.replace(make_room_frame(32, 24, kinds=(), world_radiance=1.0), world=World(radiance))
    params = HbaoParams(radius_m=1e-6, blur=0, bent_normals=False)       # nothing lies that near
    result = compute_hbao(frame, params, Context(), 0)
    g = frame.gbuffer
    # half a sky gives pi / 2 (1 + n . x)
    wanted = np.pi / 2 * (1 + g.normal_ws[..., 0])
    assert np.abs(result.light[Transport.WORLD_DIFFUSE][..., 1] - wanted)[g.mask].max() < 0.03 * np.pi
