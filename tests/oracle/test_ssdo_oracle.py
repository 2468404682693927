"""Directional occlusion against its integrals in float64, and its published form against the paper's loop."""

from __future__ import annotations

import numpy as np
import pytest

from rtgi_addon.core.frame import LightKind, World
from rtgi_addon.core.synthetic import make_room_frame
from rtgi_addon.core.techniques import SsdoParams
from rtgi_addon.kernels.ssdo import gather_samples
from rtgi_addon.passes.base import Context, Transport
from rtgi_addon.passes.screen import screen_of
from rtgi_addon.passes.ssdo import NO_SKY, compute_ssdo

from .ssdo_oracle import corner_frame, hemisphere, published_light, seen_light

RADIUS_M = 4.0              # more than the corner is wide


def at_some(frame, step: int = 7):
    """Every `step`-th pixel of the surface in both directions, but those beside a crease."""
    g = frame.gbuffer
    off_crease = np.sort(np.abs(g.position_ws), axis=-1)[..., 1] > 0.06
    return [(i, j) for i in range(2, g.shape[0], step) for j in range(2, g.shape[1], step)
            if g.mask[i, j] and off_crease[i, j]]


def context_with(light) -> Context:
    context = Context()
    context.light = {Transport.DIRECT_DIFFUSE: light}
    return context


def with_sky(frame, radiance):
    return type(frame)(**{**frame.__dict__, "world": World(np.asarray(radiance, np.float32).reshape(1, 1, 3))})


@pytest.mark.parametrize("kind", ["perspective", "orthographic", "shifted"])
def test_sectors_equal_the_integral_where_the_screen_shows_all(kind):
    frame, light = corner_frame(kind)
    # 16 slices of 16 steps leave 1 % of noise; the bounce is asked for without a world, whose own bounce would be in it
    params = SsdoParams(radius_m=RADIUS_M, slices=16, steps=16, lattice_px=1, blur=0)
    near = compute_ssdo(frame, params, context_with(light)).light[Transport.NEAR_DIFFUSE]
    world = compute_ssdo(with_sky(frame, (1, 1, 1)), params, Context()).light[Transport.WORLD_DIFFUSE]
    pixels = at_some(frame)
    wanted = [seen_light(frame, light * 0.5 / np.pi, pixel, RADIUS_M) for pixel in pixels]
    got_near, got_world = np.array([near[p] for p in pixels]), np.array([world[p] for p in pixels])
    want_near, want_world = np.array([w[0] for w in wanted]), np.pi * np.array([[w[1]] * 3 for w in wanted])
    assert len(pixels) > 25
    # pixels are 4 cm wide here, which is 3 % of the walls' height: where a wall ends is known to a part of a pixel
    assert np.sqrt(np.mean((got_near - want_near) ** 2)) < 0.04 * want_near.mean()
    assert abs(got_near.mean() / want_near.mean() - 1) < 0.03
    assert np.sqrt(np.mean((got_world - want_world) ** 2)) < 0.03 * want_world.mean()
    assert abs(got_world.mean() / want_world.mean() - 1) < 0.02


def test_published_form_equals_the_papers_sums():
    frame = make_room_frame(20, 14, (LightKind.POINT,))
    rng = np.random.default_rng(3)
    radiance = rng.uniform(0, 1, (*frame.gbuffer.shape, 3)).astype(np.float32)
    ids = np.flatnonzero(frame.gbuffer.mask)
    out = np.zeros((9, len(ids)), np.float32)
    gather_samples(len(ids), screen_of(frame), ids, np.arange(len(ids)), radiance.reshape(-1, 3), NO_SKY, np.float32(1.0),
                   np.float32(0), 24, 7, out)
    compared = 0
    for k in range(0, len(ids), 3):
        bounce, world, edge = published_light(frame, radiance.astype(float), divmod(int(ids[k]), 20), 1.0, 24, 7)
        if edge > 1e-4:                          # nearer to an edge float32 may take the neighbour
            compared += 1
            assert np.allclose(out[:3, k], bounce, rtol=2e-3, atol=1e-4)
            assert np.isclose(out[3, k], world, rtol=1e-4, atol=1e-5)
    assert compared > 50


def wall_factor(height: float, width: float, distance: float) -> float:
    """Form factor of an upright rectangle from a point of the floor before its lower corner (Howell's B-4)."""
    slant = np.hypot(height, distance)
    return (np.arctan(width / distance) - distance / slant * np.arctan(width / slant)) / (2 * np.pi)


def test_oracle_itself_leaves_open_what_two_walls_leave():
    frame, _ = corner_frame("perspective")
    g = frame.gbuffer
    for pixel in [p for p in at_some(frame) if g.normal_ws[p][2] > 0.5]:
        x, y, _ = g.position_ws[pixel].astype(float)
        closed = (wall_factor(1.2, x, y) + wall_factor(1.2, 2 - x, y) + wall_factor(1.2, y, x) + wall_factor(1.2, 2 - y, x))
        _, opened = seen_light(frame, np.zeros((*g.shape, 3)), pixel, RADIUS_M)
        assert abs(opened - (1 - closed)) < 5e-3                  # 4608 directions


def test_hemisphere_of_the_oracle_has_the_right_mean_cosine():
    direction, measure = hemisphere(np.array([0.6, 0.0, 0.8]))
    assert np.allclose(measure * len(direction), np.pi)
    assert np.allclose((direction * measure).sum(0), 2 * np.pi / 3 * np.array([0.6, 0.0, 0.8]), atol=1e-3)
