"""Light through panes of a known opacity: every pass that traces rays lets through exactly what they leave."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from rtgi_addon.core.frame import Cutouts, Light, LightKind, Material, World
from rtgi_addon.core.synthetic import cast_view
from rtgi_addon.core.techniques import DirectParams, WorldParams
from rtgi_addon.kernels.bvh import build_bvh
from rtgi_addon.kernels.clusters import cluster_texels
from rtgi_addon.kernels.gather import gather_visible
from rtgi_addon.light_views import cast_view as cast_light_view
from rtgi_addon.passes.base import Context, Transport
from rtgi_addon.passes.direct import compute_direct
from rtgi_addon.passes.surroundings import surroundings_of
from rtgi_addon.passes.world import compute_world
from tests.plane_frames import frame_of, geometry_of, looking, quad, view_from

FLOAT32 = 2e-5          # a dozen roundings
DOWN = looking((0.0, 0.0, 2.0), (0.0, 0.0, 0.0))
FLOOR = quad((0, 0, 0), 8, 8)
LEVEL = 77              # of 255: an opacity of 0.302


def with_pane(geometry, triangles, level, is_veil=True):
    """`geometry` with an even opacity of `level` / 255 on the given triangles."""
    n = len(triangles)
    row = np.full(len(geometry), -1, np.int32)
    row[triangles] = np.arange(n)
    cutouts = Cutouts(row, np.zeros((n, 3, 2), np.float32), np.full(n, level / 255, np.float32), np.full(n, is_veil),
                      np.tile(np.int32([0, 1, 1]), (n, 1)), np.uint8([level]))
    return dataclasses.replace(geometry, cutouts=cutouts)


def diffuse(frame, **params):
    return compute_direct(frame, DirectParams(**params), Context(), 0).light[Transport.DIRECT_DIFFUSE][..., 0]


def pane_frame(kind, level, map_px, map_sees_it, **shape):
    """A pane of 0.6 m hangs 1 m above the floor, under a lamp at 2 m; the camera sees the floor alone.

    The lamp's view shows the pane as if it were solid, or not at all: both are what Cycles' views do.
    """
    light = Light("Lamp", kind, DOWN, np.ones(3), **shape)
    camera = view_from((0, 0, 3), (0, 0, 0), 0.5, 64, 64)
    floor, both = geometry_of(FLOOR), geometry_of(FLOOR, quad((0.1, 0, 1), 0.3, 0.3))
    frame = frame_of(both if map_sees_it else floor, cast_view(camera, floor), camera, light, map_px=map_px)
    return dataclasses.replace(frame, geometry=with_pane(both, [2, 3], level))


@pytest.mark.parametrize("kind", [LightKind.SPOT, LightKind.POINT, LightKind.SUN])
@pytest.mark.parametrize(("map_px", "map_sees_it"), [(0, True), (64, True), (64, False)])
def test_behind_a_pane_arrives_what_its_opacity_leaves(kind, map_px, map_sees_it):
    frame = pane_frame(kind, LEVEL, map_px, map_sees_it)
    bare = diffuse(dataclasses.replace(frame, geometry=None, views=()))
    p = frame.gbuffer.position_ws
    # through the pane at half the height of the lamp, or straight down from the sun
    grows = 1 if kind is LightKind.SUN else 2
    inside = (np.abs(p[..., 0] - 0.1 * grows) < 0.3 * grows) & (np.abs(p[..., 1]) < 0.3 * grows)
    np.testing.assert_allclose(diffuse(frame), np.where(inside, 1 - LEVEL / 255, 1) * bare, rtol=FLOAT32)


@pytest.mark.parametrize("kind", [LightKind.SPOT, LightKind.POINT, LightKind.SUN])
@pytest.mark.parametrize("map_sees_it", [True, False])
def test_well_inside_the_shadow_of_a_pane_a_soft_lamp_has_no_noise(kind, map_sees_it):
    frame = pane_frame(kind, LEVEL, 64, map_sees_it, radius_m=0.05, angle_rad=0.05)
    bare = diffuse(dataclasses.replace(frame, geometry=None, views=()))
    p = frame.gbuffer.position_ws
    inside = (np.abs(p[..., 0] - 0.15) < 0.15) & (np.abs(p[..., 1]) < 0.15)
    assert inside.sum() > 20
    np.testing.assert_allclose(diffuse(frame)[inside], (1 - LEVEL / 255) * bare[inside], rtol=FLOAT32)


def test_a_pane_of_full_opacity_is_a_wall_to_the_last_bit():
    frame = pane_frame(LightKind.SPOT, 255, 64, True, radius_m=0.05)
    wall = dataclasses.replace(frame, geometry=dataclasses.replace(frame.geometry, cutouts=None))
    np.testing.assert_array_equal(diffuse(frame), diffuse(wall))


def test_world_light_under_a_sheet_is_what_its_opacity_leaves():
    sheet = quad((0, 0, 0.001), 8, 8)
    camera = view_from((0, 0, 3), (0, 0, 0), 0.1, 12, 8)
    seen = cast_view(camera, geometry_of(FLOOR))
    frame = frame_of(with_pane(geometry_of(FLOOR, sheet), [2, 3], LEVEL), seen, camera)
    frame = dataclasses.replace(frame, world=World(np.full((1, 1, 3), 2.0, np.float32)))
    result = compute_world(frame, WorldParams(rays=16), Context(), 0)
    np.testing.assert_allclose(result.light[Transport.WORLD_DIFFUSE], 2 * np.pi * (1 - LEVEL / 255), rtol=FLOAT32)
    np.testing.assert_allclose(result.visibility, 1 - LEVEL / 255, rtol=FLOAT32)


def test_the_bounce_through_a_pane_is_what_its_opacity_leaves(rng):
    table = np.zeros((17, 50), np.float32)
    table[:3] = rng.uniform(-1, 1, (3, 50))
    table[2], table[5], table[15] = -1, 1, 2                    # below the pane, facing up, without a lobe
    table[6:9] = rng.uniform(0, 1, (3, 50))
    position = rng.uniform(-1, 1, (30, 3)).astype(np.float32)
    position[:, 2] = 1
    normal = np.tile(np.float32([0, 0, -1]), (30, 1))
    pane = geometry_of(quad((0, 0, 0), 50, 50))
    grouped = cluster_texels(table, 16, 4.0)

    def gathered(bvh):
        return gather_visible(position, normal, np.arange(30), grouped, np.float32(0), bvh, 64, np.float32(1e-4), 1)[:, :3]

    free = gathered(build_bvh(np.zeros((0, 3, 3), np.float32)))
    behind = gathered(build_bvh(pane.corners_ws, with_pane(pane, [0, 1], LEVEL).cutouts))
    assert free.any()
    np.testing.assert_allclose(behind, (1 - LEVEL / 255) * free, rtol=FLOAT32)


def test_a_view_by_rays_meets_a_pane_as_often_as_it_is_opaque_and_sees_its_true_albedo():
    pane = quad((0, 0, 1), 8, 8)
    geometry = with_pane(geometry_of(FLOOR, pane), [2, 3], LEVEL)
    geometry.albedo[2:] *= LEVEL / 255                          # as capture gives it: what is not there is black
    light = Light("Spot", LightKind.SPOT, DOWN, np.ones(3), spot_size_rad=1.5)
    camera = view_from((0, 0, 3), (0, 0, 0), 0.5, 8, 8)
    frame = frame_of(geometry, cast_view(camera, geometry), camera, light)
    frame = dataclasses.replace(frame, materials=(Material("grey", specular=(0, 0, 0)),))
    eye = view_from((0, 0, 2), (0, 0, 0), 0.9, 64, 64)
    seen = cast_light_view(light, eye, frame, build_bvh(geometry.corners_ws, geometry.cutouts),
                           surroundings_of(frame, geometry))
    on_pane = seen.position_ws[..., 2] > 0.5
    # four standard deviations of 4096 draws
    assert on_pane.mean() == pytest.approx(LEVEL / 255, abs=4 * np.sqrt(0.3 * 0.7 / 4096))
    np.testing.assert_allclose(seen.albedo, 0.5, rtol=1e-5)
