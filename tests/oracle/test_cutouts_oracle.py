"""Triangles that let light through: the BVH's lookups and products against every triangle asked in float64."""

from __future__ import annotations

import numpy as np
import pytest

from rtgi_addon.core.frame import Cutouts
from rtgi_addon.kernels.bvh import (
    STACK,
    build_bvh,
    closest_hit,
    closest_triangle,
    is_occluded,
    opacity,
    visibility,
    with_cutouts,
)
from rtgi_addon.kernels.vec3 import Vec3, f32
from tests.oracle import cutouts_oracle


def vec(a):
    return Vec3(*(f32(x) for x in a))


def seen(bvh, start, vector):
    return visibility(bvh, np.empty(STACK, np.int32), vec(start), vec(vector))


def hit(bvh, start, vector):
    return closest_hit(bvh, np.empty(STACK, np.int32), vec(start), vec(vector), f32(1e30))


def some_cutouts(rng, n, opaque_share=0.3, maps=((4, 6), (1, 1), (7, 3))):
    """Cutouts of `n` triangles over random maps, some triangles opaque."""
    there = rng.uniform(size=n) >= opaque_share
    rows = int(there.sum())
    row = np.full(n, -1, np.int32)
    row[there] = rng.permutation(rows)
    sizes = np.array([h * w for h, w in maps])
    table = np.array([(start, *shape) for start, shape in zip(np.cumsum(sizes) - sizes, maps, strict=True)], np.int32)
    texels = rng.integers(0, 256, sizes.sum()).astype(np.uint8)
    return Cutouts(row, rng.uniform(-2, 2, (rows, 3, 2)).astype(np.float32), np.full(rows, 0.5, np.float32),
                   np.zeros(rows, bool), table[rng.integers(0, len(maps), rows)], texels)


def soup(rng, n, size=0.8):
    return (rng.uniform(-1, 1, (n, 1, 3)) + rng.uniform(-size, size, (n, 3, 3))).astype(np.float32)


WALL = np.array([[[-1, -1, 0], [3, -1, 0], [-1, 3, 0]]], np.float32)


def panes(*levels):
    """(corners, cutouts) of parallel triangles, 0.1 m apart, of even opacities `levels` in 255ths."""
    corners = np.concatenate([WALL + np.float32([0, 0, 0.1 * k]) for k in range(len(levels))])
    n = len(levels)
    place = np.stack([np.arange(n), np.ones(n), np.ones(n)], 1).astype(np.int32)
    return corners, Cutouts(np.arange(n, dtype=np.int32), np.zeros((n, 3, 2), np.float32), np.float32(levels) / 255,
                            np.ones(n, bool), place, np.array(levels, np.uint8))


def test_opacity_is_the_bilinear_value_of_the_repeated_map(rng):
    cutouts = some_cutouts(rng, 30)
    bvh = build_bvh(soup(rng, 30), cutouts)
    for slot in range(30):
        for u, v in rng.uniform(0, 0.5, (20, 2)):
            expected = cutouts_oracle.opacity(cutouts, bvh.source[slot], float(f32(u)), float(f32(v)))
            # places of up to 12 texels in float32, on a slope of at most one map's range a texel
            assert opacity(bvh.veil, slot, f32(u), f32(v)) == pytest.approx(expected, abs=1e-5)


def test_visibility_is_the_product_over_every_triangle_asked(rng):
    corners, cutouts = soup(rng, 60), some_cutouts(rng, 60, opaque_share=0.1)
    bvh = build_bvh(corners, cutouts)
    starts, vectors = rng.uniform(-1.5, 1.5, (400, 3)).astype(np.float32), rng.normal(size=(400, 3)).astype(np.float32)
    expected = np.array([cutouts_oracle.visibility(s.astype(float), v.astype(float), corners, cutouts)
                         for s, v in zip(starts, vectors, strict=True)])
    got = np.array([seen(bvh, s, v) for s, v in zip(starts, vectors, strict=True)])
    assert ((expected > 0.01) & (expected < 0.99)).mean() > 0.2
    # 1/512 is taken as nothing; of 400 rays, two may meet an edge within rounding
    assert (np.abs(got - expected) <= 1 / 512 + 1e-4).mean() >= 1 - 0.005


def test_the_share_behind_panes_is_the_product_whatever_their_order(rng):
    levels = [51, 128, 204, 10]
    expected = np.prod(1 - np.array(levels) / 255)
    for order in (levels, levels[::-1]):
        corners, cutouts = panes(*order)
        for direction in (1, -1):
            assert seen(build_bvh(corners, cutouts), (0, 0, 0.15 - 2 * direction), (0, 0, 4 * direction)) == pytest.approx(
                expected, rel=1e-5)


def test_a_map_of_255_blocks_and_one_of_0_is_not_there():
    corners, cutouts = panes(0, 255)
    bvh = build_bvh(corners, cutouts)
    assert seen(bvh, (0, 0, -1), (0, 0, 1.05)) == 1 and seen(bvh, (0, 0, -1), (0, 0, 3)) == 0
    assert bvh.source[hit(bvh, (0, 0, -1), (0, 0, 1))[1]] == 1


@pytest.mark.parametrize(("layers", "share"), [(8, 1), (9, 0)])
def test_behind_more_layers_than_the_limit_it_is_dark(layers, share):
    bvh = build_bvh(*panes(*[0] * layers))
    assert seen(bvh, (0, 0, -1), (0, 0, 5)) == seen(bvh, (0, 0, 4), (0, 0, -5)) == share


def test_without_cutouts_every_triangle_blocks(rng):
    corners = soup(rng, 40)
    plain = build_bvh(corners)
    none = with_cutouts(plain, None)
    assert len(none.veil) == 0
    for start, vector in rng.normal(size=(100, 2, 3)).astype(np.float32):
        t, _ = min([(t, k) for t, k, _, _ in cutouts_oracle.meetings(start.astype(float), vector.astype(float), corners)],
                   default=(np.inf, -1))
        if abs(t - 1) > 1e-3:
            assert seen(plain, start, vector) == seen(none, start, vector) == (1 if t > 1 else 0)


def test_the_closest_triangle_is_met_where_nothing_is_there():
    bvh = build_bvh(*panes(0, 255))
    found = closest_triangle(bvh, np.empty(STACK, np.int32), vec((0, 0, -1)), vec((0, 0, 1)), f32(1e30))
    assert bvh.source[found[1]] == 0


def test_closest_hits_meet_a_pane_as_often_as_it_is_opaque(rng):
    corners, cutouts = panes(77, 255)
    bvh = build_bvh(corners, cutouts)
    starts = np.concatenate([rng.uniform(-0.5, 0.5, (4000, 2)), np.full((4000, 1), -1)], 1)
    first = np.array([bvh.source[hit(bvh, s, (0, 0, 1))[1]] == 0 for s in starts])
    # four standard deviations of 4000 draws
    assert first.mean() == pytest.approx(77 / 255, abs=4 * np.sqrt(0.3 * 0.7 / 4000))
    again = np.array([bvh.source[hit(bvh, s, (0, 0, 1))[1]] == 0 for s in starts])
    np.testing.assert_array_equal(first, again)


def test_segments_count_as_free_as_often_as_light_gets_through(rng):
    bvh = build_bvh(*panes(77, 128))
    starts = np.concatenate([rng.uniform(-0.5, 0.5, (4000, 2)), np.full((4000, 1), -1)], 1)
    free = [not is_occluded(bvh, np.empty(STACK, np.int32), vec(s), vec((0, 0, 3))) for s in starts]
    share = (1 - 77 / 255) * (1 - 128 / 255)
    assert np.mean(free) == pytest.approx(share, abs=4 * np.sqrt(share * (1 - share) / 4000))


def test_a_nan_of_a_triangle_leaves_the_others_their_rows(rng):
    corners, cutouts = panes(255, 0, 255)
    corners[0, 1, 2] = np.nan
    bvh = build_bvh(corners, cutouts)
    assert seen(bvh, (0, 0, -1), (0, 0, 1.15)) == 1 and seen(bvh, (0, 0, -1), (0, 0, 3)) == 0
