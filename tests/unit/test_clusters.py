"""Picking a texel by its flux: the guide finds what counting finds."""

from __future__ import annotations

import numpy as np

from rtgi_addon.kernels.clusters import DIFFUSE, NORMAL, POSITION, ROWS, cluster_texels, find_by_flux
from rtgi_addon.kernels.jit import device_jit
from rtgi_addon.kernels.vec3 import f32


@device_jit
def _find(running, guide, first, last, shares, out):
    for i in range(len(shares)):
        out[i] = find_by_flux(running, guide, first, last, shares[i])


def _texels(number, seed=3):
    rng = np.random.default_rng(seed)
    table = np.zeros((ROWS, number), np.float32)
    table[POSITION:POSITION + 3] = rng.random((3, number))
    table[NORMAL + 2] = 1
    # fluxes over many powers of ten, and some of nothing at all
    table[DIFFUSE:DIFFUSE + 3] = 10.0 ** rng.uniform(-6, 2, number) * (rng.random(number) > 0.1)
    return table


def test_the_guide_finds_the_texel_at_which_the_flux_passes_the_share():
    clusters = cluster_texels(_texels(3000), 40, 1.0)
    shares = np.linspace(0, 1, 997, endpoint=False).astype(np.float32)
    for first, last in zip(clusters.start, clusters.end, strict=True):
        found = np.empty(len(shares), np.int64)
        _find(clusters.running, clusters.guide, first, last, shares, found)
        run = clusters.running[first:last + 1]
        goal = run[0] + shares.astype(float) * (run[-1] - run[0])
        wanted = first + np.minimum((run[1:, None] <= goal).sum(0), last - first - 1)
        np.testing.assert_array_equal(found, wanted)


def test_a_cluster_of_one_texel_is_that_texel():
    clusters = cluster_texels(_texels(1), 4, 1.0)
    out = np.empty(2, np.int64)
    _find(clusters.running, clusters.guide, 0, 1, np.float32([0, 0.999]), out)
    assert (out == 0).all() and f32(clusters.guide[0]) == 0
