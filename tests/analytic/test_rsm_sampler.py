"""The published polar sampling as an integrator over a disk of the map: what its two weights integrate."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rtgi_addon.kernels.vpl import gather_polar

RADIUS_PX, SIZE_PX = 100.0, 261
# 1600 points of a sequence of low discrepancy over texels of 1 / 100 of the radius
QUADRATURE = 5e-3


def mean_over_disk(value, published, samples=1600, centre=(130.4, 130.6), radius=RADIUS_PX, seed=0, rotate=False):
    """Mean of value(distance) over the disk as the sampling sees it.

    All texels lie in one place, 1 m straight above the receiver, so that each sample gives its flux / pi and nothing of
    the geometry is left: the sum is (mean of the flux over the disk) (number of texels in it) / pi.
    """
    position = np.zeros((SIZE_PX, SIZE_PX, 3), np.float32)
    position[..., 2] = 1
    normal = np.zeros_like(position)
    normal[..., 2] = -1
    x, y = np.meshgrid(np.arange(SIZE_PX) + 0.5 - centre[0], np.arange(SIZE_PX) + 0.5 - centre[1])
    flux = np.repeat(value(np.hypot(x, y))[..., None], 3, 2)
    e = gather_polar(np.zeros((1, 3)), np.array([[0.0, 0, 1]]), np.array([centre[0]]), np.array([centre[1]]), position,
                     normal, flux, radius, samples, published, False, seed, rotate=rotate)
    return float(e[0, 0]) * math.pi / (math.pi * radius**2)


@pytest.mark.parametrize("published", [False, True])
def test_weights_sum_to_the_texels_of_the_disk(published):
    assert mean_over_disk(np.ones_like, published) == pytest.approx(1, rel=QUADRATURE)


def test_unbiased_weight_integrates_the_distance_to_two_thirds():
    assert mean_over_disk(lambda r: r, False) == pytest.approx(2 / 3 * RADIUS_PX, rel=QUADRATURE)


def test_published_weight_integrates_the_distance_to_three_quarters():
    assert mean_over_disk(lambda r: r, True) == pytest.approx(3 / 4 * RADIUS_PX, rel=QUADRATURE)


@pytest.mark.parametrize("power", [0.5, 2, 3])
def test_both_weights_integrate_powers_of_the_distance_as_their_densities_say(power):
    """Mean of r^p over a disk is 2 / (p + 2); with one more power of r in the weight it is 3 / (p + 3)."""
    value = lambda r: (r / RADIUS_PX) ** power  # noqa: E731
    assert mean_over_disk(value, False) == pytest.approx(2 / (power + 2), rel=2 * QUADRATURE)
    assert mean_over_disk(value, True) == pytest.approx(3 / (power + 3), rel=2 * QUADRATURE)


@pytest.mark.parametrize("seed", range(4))
def test_four_hundred_samples_are_within_two_percent(seed):
    assert mean_over_disk(lambda r: r, False, samples=400, seed=seed) == pytest.approx(2 / 3 * RADIUS_PX, rel=0.02)


def test_turning_the_pattern_keeps_the_integral():
    assert mean_over_disk(lambda r: r, False, rotate=True) == pytest.approx(2 / 3 * RADIUS_PX, rel=QUADRATURE)


def test_samples_outside_the_map_give_nothing():
    corner = mean_over_disk(np.ones_like, False, samples=6400, centre=(0.0, 0.0))
    assert corner == pytest.approx(1 / 4, rel=2 * QUADRATURE)


def corner_share(published, radius, samples=4000):
    """Light on a wall point at height 0.2 beside a lit floor of 1 m2 with the map seen from above, over the exact."""
    n, z = 256, 0.2
    c = (np.arange(n) + 0.5) / n
    x, y = np.meshgrid(c, c)
    position = np.stack([x, y, np.zeros_like(x)], -1)
    normal = np.zeros_like(position)
    normal[..., 2] = 1
    flux = np.full((n, n, 3), 1 / n**2)
    e = gather_polar(np.array([[0.0, 0.5, z]]), np.array([[1.0, 0, 0]]), np.array([0.0]), np.array([n / 2]), position,
                     normal, flux, radius * n, samples, published, False, 0)[0, 0]
    root = math.hypot(1.0, z)
    exact = 2 * (math.atan(0.5 / z) - z / root * math.atan(0.5 / root)) / (2 * math.pi)
    return e / exact


def test_unbiased_samples_over_the_whole_map_are_right_in_a_corner():
    assert corner_share(False, 1.2) == pytest.approx(1, rel=0.02)


def test_published_samples_are_dark_in_a_corner():
    assert corner_share(True, 1.2) < 0.75


def test_a_small_disk_of_samples_leaves_light_out():
    assert corner_share(False, 0.2) < 0.75
