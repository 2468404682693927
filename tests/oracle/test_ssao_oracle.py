"""SSAO's points against a float64 count of many random ones."""

from __future__ import annotations

import numpy as np
import pytest

from rtgi_addon.core.techniques import SsaoParams
from rtgi_addon.passes.base import Context
from rtgi_addon.passes.ssao import ball_points, compute_ssao
from tests.oracle.ambient_oracle import CAMERAS, ball_visibility, room_seen_by

RADIUS_M = 0.7
# 16 mirror images of 1024 even points against 100,000 random ones, whose doubled share has a deviation of 0.003; what one
# set of even points has less of that, it has more at the edges of low pixels: 0.013 at most over 100 pixels
TOLERANCE = 0.02


def random_points(rng: np.random.Generator, number: int) -> np.ndarray:
    """(number, 3) points of the unit ball, by rejection."""
    points = rng.uniform(-1, 1, (3 * number, 3))
    return points[np.linalg.norm(points, axis=1) <= 1][:number]


@pytest.mark.parametrize("camera", CAMERAS)
def test_published_form_equals_a_count_of_random_points(camera, rng):
    frame = room_seen_by(camera)
    params = SsaoParams(method="SPHERE", radius_m=RADIUS_M, samples=1024, blur=0)
    got = np.mean([compute_ssao(frame, params, Context(), seed).visibility for seed in range(16)], 0)
    points = random_points(rng, 100000)
    at = [(i, j) for i in range(1, 24, 4) for j in range(1, 32, 5) if frame.gbuffer.mask[i, j]]
    wanted = np.array([ball_visibility(frame, i, j, RADIUS_M, points) for i, j in at])
    assert len(at) > 20 and np.ptp(wanted) > 0.3
    assert np.abs(np.array([got[i, j] for i, j in at]) - wanted).max() < TOLERANCE


def test_points_fill_the_ball_evenly():
    points = ball_points(4096).astype(float)
    radius = np.linalg.norm(points, axis=1)
    assert radius.max() <= 1
    # volume inside radius r is r^3; means of coordinates and squares are 0 and 1/5
    for r in (0.3, 0.6, 0.9):
        assert abs(np.mean(radius < r) - r**3) < 0.01
    assert np.abs(points.mean(0)).max() < 0.01 and np.abs((points**2).mean(0) - 0.2).max() < 0.01
