"""Rays of the world guided through windows: less noise, the same mean, and nothing changed where the sky is open."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from rtgi_addon.core.frame import Geometry, World
from rtgi_addon.core.techniques import WorldParams
from rtgi_addon.kernels.sky import GUIDE_COLUMNS, GUIDE_ROWS
from rtgi_addon.passes import world
from rtgi_addon.passes.base import Context, Transport
from rtgi_addon.passes.world import compute_world
from tests.mirror_frames import camera_at, scene_frame


def rectangle(origin, across, up):
    origin, across, up = (np.array(v, np.float64) for v in (origin, across, up))
    corners = np.array([origin, origin + across, origin + across + up, origin + up])
    return corners[[[0, 1, 2], [0, 2, 3]]]


def room(window_m):
    """Some of the dark side of a room of 4 x 4 x 3 m, whose wall at x = 2 has a square window in its middle."""
    low, high = 1.5 - window_m / 2, 1.5 + window_m / 2
    walls = [rectangle((-2, -2, 0), (4, 0, 0), (0, 4, 0)), rectangle((-2, -2, 3), (4, 0, 0), (0, 4, 0)),
             rectangle((-2, 2, 0), (4, 0, 0), (0, 0, 3)), rectangle((-2, -2, 0), (4, 0, 0), (0, 0, 3)),
             rectangle((-2, -2, 0), (0, 4, 0), (0, 0, 3)), rectangle((2, -2, 0), (0, 4, 0), (0, 0, low)),
             rectangle((2, -2, high), (0, 4, 0), (0, 0, 3 - high)),
             rectangle((2, -2, low), (0, 2 - window_m / 2, 0), (0, 0, window_m)),
             rectangle((2, window_m / 2, low), (0, 2 - window_m / 2, 0), (0, 0, window_m))]
    corners = np.concatenate(walls).astype(np.float32)
    geometry = Geometry(corners, np.full((len(corners), 3, 3), 0.5, np.float32), np.zeros((len(corners), 3), np.float32),
                        np.zeros(len(corners), np.int32))
    return scene_frame(camera_at((1.0, -1.8, 1.6), (-1.2, 1.5, 0.8), 48, 32, half=0.2), geometry)


def hazy_sky():
    """(16, 32, 3): a horizon twice as bright as the zenith."""
    rows = np.linspace(0.5, 1.0, 16, dtype=np.float32)[:, None, None]
    return World(np.broadcast_to(rows, (16, 32, 3)).copy())


def runs(frame, seeds, rays=16):
    """(seeds, pixels) irradiance, mean of the colours."""
    light = (compute_world(frame, WorldParams(rays=rays, lattice_px=1), Context(), seed).light for seed in range(seeds))
    return np.array([one[Transport.WORLD_DIFFUSE][frame.gbuffer.mask].mean(-1) for one in light], np.float64)


@pytest.mark.parametrize("sky", [World(np.ones((1, 1, 3), np.float32)), hazy_sky()], ids=["even", "hazy"])
def test_guided_rays_have_less_noise_and_the_same_mean(sky, monkeypatch):
    frame = dataclasses.replace(room(0.8), world=sky)
    guided = runs(frame, 60)
    monkeypatch.setattr(world, "LEAST_RAYS", 10**6)
    plain = runs(frame, 200)
    assert guided.std(0).mean() < 0.75 * plain.std(0).mean()
    error = np.hypot(*(r.mean(1).std() / np.sqrt(len(r)) for r in (guided, plain)))
    assert error < 0.01 * plain.mean()
    assert guided.mean() == pytest.approx(plain.mean(), abs=4 * error)


def test_under_an_open_sky_nothing_changes(monkeypatch):
    frame = dataclasses.replace(room(0.8), world=hazy_sky())
    open_air = dataclasses.replace(frame, geometry=Geometry(*(getattr(frame.geometry, name)[:2] for name in (
        "corners_ws", "albedo", "emission", "material"))))
    first = runs(open_air, 1)
    monkeypatch.setattr(world, "LEAST_RAYS", 10**6)
    np.testing.assert_allclose(first, runs(open_air, 1), rtol=1e-5)           # the sums' order


def test_directions_of_a_guide_have_its_density(monkeypatch):
    kept = []
    of = world._guide_of
    monkeypatch.setattr(world, "_guide_of", lambda *args: kept.append(of(*args)) or kept[-1])
    runs(dataclasses.replace(room(0.8), world=hazy_sky()), 1)
    guide = kept[0]
    assert len(guide.cdf) and (guide.of >= 0).any()
    # cells are of one size: the density's mean over them, times the sphere, is 1
    np.testing.assert_allclose(guide.density.mean(1) * 4 * np.pi, 1, rtol=1e-5)
    share = np.diff(guide.cdf, axis=1, prepend=0)
    np.testing.assert_allclose(share * GUIDE_ROWS * GUIDE_COLUMNS / (4 * np.pi), guide.density, atol=1e-4)
