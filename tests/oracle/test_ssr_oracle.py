"""`passes.ssr` against its float64 form: in the picture, beyond it, and by rays alone."""

from __future__ import annotations

import numpy as np
import pytest

from rtgi_addon.core.frame import LightKind
from rtgi_addon.core.techniques import SsrParams
from rtgi_addon.passes import ssr
from rtgi_addon.passes.base import Transport
from rtgi_addon.passes.ssr import compute_ssr
from tests.mirror_frames import glossy, lit, on_floor, room_from_above
from tests.oracle import ssr_oracle

# 1024 rays a pixel and 2304 directions in the oracle leave 1 %; shadow edges in a picture of 48x36 are a pixel wide
BEYOND, IN_PICTURE = 0.02, 0.05


@pytest.fixture(scope="module")
def room():
    return room_from_above(48, 36, (LightKind.SPOT,), light_radius_m=0.0)


def errors(frame, **params):
    """Relative L1 of every 41st glossy pixel against the oracle, and the ratio of their sums."""
    got = compute_ssr(frame, SsrParams(**params), lit(frame), 1).light[Transport.BOUNCE_GLOSSY]
    pixels = np.argwhere(on_floor(frame))[::41]
    expected = np.array([ssr_oracle.reflected(frame, i, j) for i, j in pixels])
    mine = got[tuple(pixels.T)]
    assert len(pixels) > 20 and expected.sum() > 0
    return np.abs(mine - expected).sum() / expected.sum(), mine.sum() / expected.sum()


@pytest.mark.parametrize("roughness", [0.1, 0.3, 0.5, 0.8])
def test_rays_through_the_triangles_equal_the_integral(room, roughness, monkeypatch):
    monkeypatch.setattr(ssr, "FILTER_REACH", 0.0)
    frame = glossy(room, on_floor(room), roughness, 0.06)
    error, energy = errors(frame, method="TRIANGLES", edge_fade=0.5, samples=16384, lattice_px=1)
    assert error < IN_PICTURE and abs(energy - 1) < BEYOND


@pytest.mark.parametrize("roughness", [0.1, 0.3, 0.5])
def test_rays_through_the_picture_equal_the_integral(room, roughness, monkeypatch):
    monkeypatch.setattr(ssr, "FILTER_REACH", 0.0)
    frame = glossy(room, on_floor(room), roughness, 0.06)
    error, energy = errors(frame, samples=16384, lattice_px=1)
    assert error < IN_PICTURE and abs(energy - 1) < IN_PICTURE


@pytest.mark.parametrize("roughness", [0.3, 0.5])
def test_few_rays_and_the_filter_come_close_to_the_integral(room, roughness):
    frame = glossy(room, on_floor(room), roughness, 0.06)
    error, energy = errors(frame)
    # 16 rays for 16 pixels, filtered: noise of a fifth at a pixel, a fifth of that in the sum of two dozen
    assert error < 0.25 and abs(energy - 1) < 0.1


def test_oracle_itself_returns_even_light():
    n, v = np.array([0.0, 0.0, 1.0]), np.array([0.6, 0.0, 0.8])
    for alpha in (0.04, 0.3, 1.0):
        d, weight = ssr_oracle.directions(n, v, alpha, 24)
        assert np.allclose(np.linalg.norm(d, axis=1), 1) and weight.sum() > 0
        mirror = np.array([-0.6, 0.0, 0.8])
        mean = weight @ d / weight.sum()
        # narrow lobes look along the mirror direction
        assert mean @ mirror > (0.98 if alpha < 0.1 else 0.5)
