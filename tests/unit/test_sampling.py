"""Hashes, sequences and warps: range, evenness, density, and the same numbers on every machine."""

from __future__ import annotations

import numpy as np
import pytest

from rtgi_addon.kernels.sampling import (
    cosine_hemisphere,
    disk,
    dither,
    place_id,
    place_ids,
    r2_sequence,
    uniform,
    uniform_sphere,
)
from rtgi_addon.kernels.vec3 import f32

STEPS = 64


def grid():
    centre = (np.arange(STEPS) + 0.5) / STEPS
    return [(f32(u), f32(v)) for u in centre for v in centre]


def hashes(n=4096, a=3):
    return np.array([uniform(a, i, 7) for i in range(n)])


def test_hash_stays_below_one_and_is_a_function_of_its_arguments():
    values = hashes()
    assert ((values >= 0) & (values < 1)).all()
    np.testing.assert_array_equal(values, hashes())


def test_hash_is_even():
    counts, _ = np.histogram(hashes(8192), bins=16, range=(0, 1))
    # chi squared with 15 degrees of freedom stays below 37.7 in 999 of 1000 draws
    assert ((counts - 512) ** 2 / 512).sum() < 37.7


def test_hash_of_neighbours_is_uncorrelated():
    # 4096 draws: the coefficient's deviation is 1/64
    assert abs(np.corrcoef(hashes(a=3), hashes(a=4))[0, 1]) < 4 / 64


BLOCKS = ((0, 0, 0), (37, 1001, 5), (4000, 3, 12))     # first row and column, seed


@pytest.mark.parametrize("pattern", [0, 1, 2])
def test_dither_fills_every_block_evenly(pattern):
    # 16 numbers that are even leave gaps of at most 2 / 16 (white noise: 0.21 in the mean)
    for i, j, seed in BLOCKS:
        values = np.sort([dither(place_id(i + a, j + b), seed, pattern) for a in range(4) for b in range(4)])
        assert (values >= 0).all() and (values < 1).all()
        assert np.diff([*values, values[0] + 1]).max() < 2.2 / 16


def test_pairs_of_dither_fill_the_square():
    # 64 points on a square grid lie 1 / 8 apart; of 64 random ones the nearest two lie 0.011 apart in the mean
    for i, j, seed in BLOCKS:
        places = place_ids((i + 8, j + 8))[i:, j:].ravel()
        pairs = np.array([(dither(p, seed, 0), dither(p, seed, 1)) for p in places])
        apart = np.abs(pairs[:, None] - pairs)
        distance = np.linalg.norm(np.minimum(apart, 1 - apart), axis=-1) + 9 * np.eye(64)
        assert distance.min() > 0.6 / 8


def test_hash_takes_negative_and_large_integers():
    assert all(0 <= uniform(a, 0, 0) < 1 for a in (-1, 2**31, 2**62))


def test_hash_keeps_its_values():
    # golden: a change here changes every picture
    assert [round(float(uniform(a, 1, 2)), 6) for a in (0, 1, 2)] == [0.243806, 0.768766, 0.404954]


@pytest.mark.parametrize("n", [16, 64, 256])
def test_sequence_is_spread_better_than_random(n):
    points = np.array([r2_sequence(i, f32(0.3), f32(0.9)) for i in range(n)])
    assert ((points >= 0) & (points < 1)).all()
    counts, _, _ = np.histogram2d(*points.T, bins=4, range=[[0, 1], [0, 1]])
    # a random set deviates by the root of n / 16
    assert np.abs(counts - n / 16).max() <= max(2, 0.75 * np.sqrt(n / 16))


def test_sequence_far_out_keeps_its_digits():
    points = {tuple(np.round(r2_sequence(10**6 + i, f32(0), f32(0)), 4)) for i in range(100)}
    assert len(points) == 100


def test_disk_is_filled_evenly():
    points = np.array([disk(u, v) for u, v in grid()])
    r = np.hypot(*points.T)
    assert r.max() <= 1 + 1e-6
    # the share within radius r is r^2, to a ring of the grid
    for radius in (0.25, 0.5, 0.75):
        assert (r < radius).mean() == pytest.approx(radius**2, abs=2 / STEPS)
    np.testing.assert_allclose(points.mean(0), 0, atol=1e-3)


def test_centre_of_the_square_is_the_centre_of_the_disk():
    assert disk(f32(0.5), f32(0.5)) == (0, 0)


def test_cosine_hemisphere_has_unit_vectors_of_mean_height_two_thirds():
    d = np.array([cosine_hemisphere(u, v) for u, v in grid()])
    np.testing.assert_allclose(np.linalg.norm(d, axis=1), 1, rtol=1e-5)
    assert d[:, 2].min() >= 0 and d[:, 2].mean() == pytest.approx(2 / 3, abs=2e-3)


def test_uniform_sphere_has_unit_vectors_of_mean_zero_and_variance_a_third():
    d = np.array([uniform_sphere(u, v) for u, v in grid()])
    np.testing.assert_allclose(np.linalg.norm(d, axis=1), 1, rtol=1e-5)
    np.testing.assert_allclose(d.mean(0), 0, atol=1e-3)
    np.testing.assert_allclose((d**2).mean(0), 1 / 3, atol=2e-3)
