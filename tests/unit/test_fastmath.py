"""Polynomials for inner loops: their errors are those that the docstrings state."""

from __future__ import annotations

import math

import numpy as np

from rtgi_addon.kernels.fastmath import fast_atan2, fast_sin, fraction, on_circle
from rtgi_addon.kernels.vec3 import f32


def test_atan2_holds_its_error_all_around():
    angles = np.linspace(-np.pi, np.pi, 20001)[1:-1]
    for scale in (1e-6, 1.0, 1e6):
        got = np.array([fast_atan2(f32(scale * math.sin(a)), f32(scale * math.cos(a))) for a in angles])
        assert np.abs(got - angles).max() < 2e-5


def test_atan2_of_the_axes_and_of_nothing():
    wanted = {(0, 0): 0, (0, 1): 0, (1, 0): np.pi / 2, (-1, 0): -np.pi / 2, (0, -1): np.pi}
    for (y, x), angle in wanted.items():
        assert abs(fast_atan2(f32(y), f32(x)) - angle) < 2e-5


def test_sine_holds_its_error_over_half_a_turn():
    angles = np.linspace(-np.pi / 2, np.pi / 2, 10001).astype(np.float32)
    got = np.array([fast_sin(a) for a in angles])
    assert np.abs(got - np.sin(angles.astype(float))).max() < 3e-7


def test_fraction_lies_below_one():
    for x in (0.0, 0.25, 0.99999994, 1.0, 7.75, 12345.5):
        assert fraction(f32(x)) == f32(x) - math.floor(f32(x))


def test_circle_holds_its_error_and_its_radius():
    turns = np.linspace(-0.125, 3, 20001).astype(np.float32)
    got = np.array([on_circle(t) for t in turns])
    angles = 2 * np.pi * turns.astype(float)
    # the argument's own rounding, half a unit in the last place of a turn, stands beside the series' error
    allowed = 1.2e-7 + np.pi * np.spacing(np.maximum(np.abs(turns), 1)).astype(float)
    assert (np.abs(got - np.stack([np.cos(angles), np.sin(angles)], 1)) < allowed[:, None]).all()
    assert np.abs(np.hypot(*got.T) - 1).max() < 3e-7


def test_circle_meets_the_axes():
    for quarter, axis in enumerate(((1, 0), (0, 1), (-1, 0), (0, -1), (1, 0))):
        assert on_circle(f32(0.25 * quarter)) == axis
