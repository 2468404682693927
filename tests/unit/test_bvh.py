"""The BVH against every triangle asked in turn, and on the shapes that break trees."""

from __future__ import annotations

import numpy as np
import pytest

from rtgi_addon.core.synthetic import nearest_hit
from rtgi_addon.kernels.bvh import STACK, build_bvh, closest_hit, is_occluded, triangle_normal
from rtgi_addon.kernels.vec3 import Vec3, f32


def tree(corners):
    """Our own tree, also where Blender's Embree is loaded."""
    return build_bvh(corners, use_embree=False)


def vec(a):
    return Vec3(*(f32(x) for x in a))


def soup(rng, n, size=0.3):
    return (rng.uniform(-1, 1, (n, 1, 3)) + rng.uniform(-size, size, (n, 3, 3))).astype(np.float32)


def hits(bvh, origins, directions, reach=1e30):
    stack = np.empty(STACK, np.int32)
    out = [closest_hit(bvh, stack, vec(o), vec(d), f32(reach)) for o, d in zip(origins, directions, strict=True)]
    source = [bvh.source[slot] if slot >= 0 else -1 for _, slot, _, _ in out]
    return np.array([t if slot >= 0 else np.inf for t, slot, _, _ in out]), np.array(source)


def blocked(bvh, start, vector):
    return is_occluded(bvh, np.empty(STACK, np.int32), vec(start), vec(vector))


@pytest.mark.parametrize("n", [1, 2, 5, 8, 9, 300])
def test_closest_hits_are_those_of_every_triangle_asked(rng, n):
    corners = soup(rng, n)
    origins, directions = rng.uniform(-2, 2, (400, 3)).astype(np.float32), rng.normal(size=(400, 3)).astype(np.float32)
    expected, triangle = nearest_hit(origins.astype(float), directions.astype(float), corners)
    t, source = hits(tree(corners), origins, directions)
    same = (source == triangle) & np.isclose(t, expected, rtol=1e-3)
    assert same.mean() >= 1 - 0.005       # of 400 rays, two may meet an edge within rounding


def test_occlusion_is_a_hit_within_the_segment(rng):
    corners = soup(rng, 200)
    bvh = tree(corners)
    starts, vectors = rng.uniform(-2, 2, (400, 3)).astype(np.float32), rng.normal(size=(400, 3)).astype(np.float32)
    t, _ = nearest_hit(starts.astype(float), vectors.astype(float), corners)
    got = np.array([blocked(bvh, s, v) for s, v in zip(starts, vectors, strict=True)])
    sure = np.abs(t - 1) > 1e-3
    assert (got == (t < 1))[sure].mean() >= 1 - 0.005


def test_empty_scene_blocks_nothing():
    bvh = tree(np.zeros((0, 3, 3), np.float32))
    assert not blocked(bvh, (0, 0, 0), (0, 0, 5)) and hits(bvh, [(0, 0, 0)], [(0, 0, 1)])[1][0] == -1


def test_triangles_with_nan_or_infinity_are_left_out(rng):
    corners = soup(rng, 20)
    corners[3, 1, 2], corners[7, 0, 0] = np.nan, np.inf
    bvh = tree(corners)
    assert len(bvh.source) == 18 and not {3, 7} & set(bvh.source.tolist())


def test_triangles_without_area_are_never_hit():
    corners = np.zeros((10, 3, 3), np.float32)
    corners[:5, :, 0] = [0, 1, 2]
    bvh = tree(corners)
    assert not blocked(bvh, (0.5, 0, 1), (0, 0, -2)) and not blocked(bvh, (0, 0, 1), (0, 0, -2))


def test_identical_triangles_build_a_tree_and_are_hit():
    corners = np.repeat(np.array([[[-1, -1, 0], [1, -1, 0], [0, 1, 0]]], np.float32), 1000, 0)
    assert blocked(tree(corners), (0, 0, 1), (0, 0, -2))


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [-1, 1])
def test_rays_along_an_axis_meet_flat_boxes(axis, sign):
    # a wall of 32 x 32 quads lies in a plane of constant coordinate: its boxes have no thickness
    u, v = (axis + 1) % 3, (axis + 2) % 3
    steps = np.arange(32) / 16 - 1
    corners = []
    for a in steps:
        for b in steps:
            quad = np.zeros((4, 3))
            quad[:, u], quad[:, v] = [a, a + 1 / 16, a + 1 / 16, a], [b, b, b + 1 / 16, b + 1 / 16]
            corners += [quad[[0, 1, 2]], quad[[0, 2, 3]]]
    bvh = tree(np.array(corners, np.float32))
    start, vector = np.zeros(3), np.zeros(3)
    vector[axis] = 2 * sign
    for a in np.linspace(-0.97, 0.97, 13):
        start[u], start[v], start[axis] = a, 0.37 * a, -sign
        assert blocked(bvh, start, vector)


def test_rays_inside_the_plane_of_a_wall_do_not_hit_it():
    corners = np.array([[[-1, -1, 0], [1, -1, 0], [0, 1, 0]]], np.float32)
    assert not blocked(tree(corners), (-3, 0, 0), (6, 0, 0))


def test_triangles_block_from_both_sides():
    bvh = tree(np.array([[[-1, -1, 0], [1, -1, 0], [0, 1, 0]]], np.float32))
    assert blocked(bvh, (0, 0, 1), (0, 0, -2)) and blocked(bvh, (0, 0, -1), (0, 0, 2))


def test_segment_ends_before_the_surface_that_it_aims_at():
    bvh = tree(np.array([[[-1, -1, 0], [1, -1, 0], [0, 1, 0]]], np.float32))
    assert not blocked(bvh, (0, 0, 1), (0, 0, -1)) and blocked(bvh, (0, 0, 1), (0, 0, -1.001))


def test_reach_cuts_hits_off():
    bvh = tree(np.array([[[-1, -1, 0], [1, -1, 0], [0, 1, 0]]], np.float32))
    assert hits(bvh, [(0, 0, 1)], [(0, 0, -1)], 0.5)[1][0] == -1


def test_normal_follows_the_winding():
    bvh = tree(np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]], np.float32))
    assert triangle_normal(bvh, 0) == pytest.approx((0, 0, 1), abs=1e-7)     # its length by a reciprocal: one ulp


def test_normal_without_area_is_up():
    assert triangle_normal(tree(np.zeros((1, 3, 3), np.float32)), 0) == (0, 0, 1)


def test_every_triangle_is_in_exactly_one_leaf(rng):
    bvh = tree(soup(rng, 777))
    np.testing.assert_array_equal(np.sort(bvh.source), np.arange(777))
    leaves = -bvh.kids[bvh.kids < 0].astype(np.int64) - 1
    slots = np.concatenate([np.arange(c >> 3, (c >> 3) + (c & 7)) for c in leaves])
    np.testing.assert_array_equal(np.sort(slots), np.arange(777))


def test_boxes_hold_their_triangles(rng):
    bvh = tree(soup(rng, 500))
    for n, side in np.argwhere(bvh.kids < 0):
        code = -int(bvh.kids[n, side]) - 1
        c = bvh.corners[code >> 3:(code >> 3) + (code & 7)]
        points = np.concatenate([c[:, :3], c[:, :3] + c[:, 3:6], c[:, :3] + c[:, 6:9]])
        if len(points):
            box = bvh.boxes[n, side]
            assert (points >= box[:3] - 1e-6).all() and (points <= box[3:] + 1e-6).all()
