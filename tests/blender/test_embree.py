"""Rays through Blender's Embree are those through our own tree, and a scene of triangles is freed with its BVH."""

import gc

import numpy as np
import pytest

from rtgi_addon.core.frame import Cutouts
from rtgi_addon.kernels import embree
from rtgi_addon.kernels.bvh import STACK, build_bvh, closest_hit, is_occluded, visibility
from rtgi_addon.kernels.jit import device_jit
from rtgi_addon.kernels.vec3 import load


@device_jit
def _trace(bvh, origin, direction, reach):
    number = len(origin)
    out, hit, stack = np.empty((number, 3), np.float32), np.empty((number, 2), np.int32), np.empty(STACK, np.int32)
    for i in range(number):
        o, d = load(origin, i), load(direction, i)
        out[i, 0], hit[i, 0], out[i, 1], out[i, 2] = closest_hit(bvh, stack, o, d, reach)
        hit[i, 1] = is_occluded(bvh, stack, o, d)
    return out, hit


@device_jit
def _shares(bvh, origin, direction):
    out, stack = np.empty(len(origin), np.float32), np.empty(STACK, np.int32)
    for i in range(len(origin)):
        out[i] = visibility(bvh, stack, load(origin, i), load(direction, i))
    return out


@pytest.fixture
def both(bpy_session, rng):
    """The same triangle soup through Embree and through our own tree, and rays into it."""
    centre = rng.uniform(-3, 3, (900, 1, 3))
    corners = (centre + rng.normal(0, 0.4, (900, 3, 3))).astype(np.float32)
    corners[17] = np.nan
    corners[18] = corners[18, :1]                # no area
    origin, direction = rng.uniform(-4, 4, (5000, 3)), rng.normal(0, 2, (5000, 3))
    direction[:100, 0] = direction[50:150, 1] = 0.0
    with_embree, own = build_bvh(corners), build_bvh(corners, use_embree=False)
    assert with_embree.rays.all() and not own.rays.any()
    return [(bvh, _trace(bvh, origin.astype(np.float32), direction.astype(np.float32), np.float32(5)))
            for bvh in (with_embree, own)]


def test_both_find_the_same_triangles(both):
    source = [np.where(hit[:, 0] >= 0, bvh.source[hit[:, 0]], -1) for bvh, (_, hit) in both]
    (_, (_, embree_hit)), (_, (_, own_hit)) = both
    # of 5000 rays one or two may pass so near to an edge that the two tests round differently
    assert (source[0] != source[1]).sum() <= 2
    assert (embree_hit[:, 1] != own_hit[:, 1]).sum() <= 2
    assert 500 < (source[0] >= 0).sum() < 4900   # the soup neither misses nor swallows everything


def test_both_give_the_same_place_on_the_triangle(both):
    (_, (embree_out, embree_hit)), (_, (own_out, own_hit)) = both
    met = (embree_hit[:, 0] >= 0) & (own_hit[:, 0] >= 0) & (np.abs(embree_out[:, 0] - own_out[:, 0]) < 0.01)
    # two float32 tests of a triangle seen at a grazing angle agree to a few thousand ulps
    np.testing.assert_allclose(embree_out[met], own_out[met], atol=2e-3)
    assert met.sum() > 0.99 * (own_hit[:, 0] >= 0).sum()


def test_both_let_the_same_light_through_cutouts(bpy_session, rng):
    corners = (rng.uniform(-1, 1, (60, 1, 3)) + rng.normal(0, 0.8, (60, 3, 3))).astype(np.float32)
    row = np.where(np.arange(60) % 3 == 0, -1, np.cumsum(np.arange(60) % 3 != 0) - 1).astype(np.int32)
    cutouts = Cutouts(row, rng.uniform(0, 2, (40, 3, 2)).astype(np.float32), np.ones(40, np.float32), np.zeros(40, bool),
                      np.tile(np.int32([0, 4, 4]), (40, 1)), rng.integers(0, 256, 16).astype(np.uint8))
    origin, direction = (rng.normal(0, 2, (2000, 3)).astype(np.float32) for _ in range(2))
    shares = [_shares(build_bvh(corners, cutouts, use_embree), origin, direction) for use_embree in (True, False)]
    # a ray in a thousand may pass so near to an edge that the two tests of a triangle round differently
    assert (np.abs(shares[0] - shares[1]) > 1e-3).sum() <= 2
    for kind in (shares[0] == 0, shares[0] == 1, (shares[0] > 0) & (shares[0] < 1)):
        assert kind.sum() > 50                   # rays of every fate


def test_no_triangles_meet_no_ray(bpy_session):
    bvh = build_bvh(np.zeros((0, 3, 3), np.float32))
    assert bvh.rays.all()
    out, hit = _trace(bvh, np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32), np.float32(9))
    assert hit.tolist() == [[-1, 0]]


def test_a_scene_is_freed_with_its_bvh(bpy_session, monkeypatch):
    freed = []
    library = embree._shared().library

    class Watched:
        def __getattr__(self, name):
            return freed.append if name == "rtcReleaseScene" else getattr(library, name)

    monkeypatch.setattr(embree._shared(), "library", Watched())
    bvh = build_bvh(np.eye(3, dtype=np.float32)[None])
    scene = bvh.rays[0]
    assert not freed
    del bvh
    gc.collect()
    assert freed == [scene]
    library.rtcReleaseScene(int(scene))
