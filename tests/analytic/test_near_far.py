"""The bounce shared by distance: what directional occlusion brings is what reflective shadow maps leave out for it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from rtgi_addon import pipeline
from rtgi_addon.core.frame import Frame, Light, LightKind
from rtgi_addon.core.synthetic import cast_view
from rtgi_addon.core.techniques import RsmParams, SsdoParams, default_settings
from rtgi_addon.passes.base import Transport
from rtgi_addon.passes.screen import is_shown
from rtgi_addon.planner import Plan
from tests.plane_frames import frame_of, geometry_of, looking, quad, view_from

NEAR, BOUNCE = Transport.NEAR_DIFFUSE, Transport.BOUNCE_DIFFUSE


def corner(sees_wall: bool = True) -> Frame:
    """A floor of 4 m by 4 m and a wall of 4 m by 2 m over its far edge, lit by a sun; the picture holds both, or ends below
    the wall."""
    wall = quad((0, 0, 0), 2, 1)[..., [0, 2, 1]] + np.array([0, 2, 1])
    geometry = geometry_of(quad((0, 0, 0), 2, 2), wall)
    camera = view_from((0, -7, 5), (0, 0.3, 0.6), 0.42, 96, 80, (0, 0, 1))
    if not sees_wall:
        camera = view_from((0, -7, 5), (0, -0.6, 0), 0.25, 96, 40, (0, 0, 1))
    sun = Light("Sun", LightKind.SUN, looking((0, -3, 3), (0, 0, 0), (0, 0, 1)), np.array([3.0, 2.0, 1.0]))
    frame = frame_of(geometry, cast_view(camera, geometry), camera, sun, map_px=192, map_half=3.2)
    assert (frame.gbuffer.normal_ws[..., 1].min() < -0.5) == sees_wall
    return frame


def bounce(frame: Frame, techniques: tuple[str, ...], method: str = "VISIBLE", **ssdo) -> dict[Transport, np.ndarray]:
    settings = default_settings()
    settings.params["rsm"] = RsmParams(method=method, lattice_px=1, rays=256, clusters=256, samples=2048)
    settings.params["ssdo"] = SsdoParams(**{
        "radius_m": 2.0, "lattice_px": 1, "slices": 8, "steps": 16, "blur": 0, "hand_over": True, **ssdo})
    return pipeline.run(frame, Plan(techniques), settings).transports


def test_near_and_far_add_up_to_the_whole_at_every_distance():
    frame = corner()
    whole, parts = bounce(frame, ("direct", "rsm"))[BOUNCE], bounce(frame, ("direct", "rsm", "ssdo"))
    position = frame.gbuffer.position_ws
    from_edge = np.where(frame.gbuffer.mask, np.hypot(position[..., 1] - 2, position[..., 2]), np.inf)
    shares = []
    for low, high in ((0.1, 0.4), (0.4, 0.8), (0.8, 1.2), (1.2, 2.5)):
        band = (from_edge > low) & (from_edge < high)
        near, far, both = (image[band].mean(0) for image in (parts[NEAR], parts[BOUNCE], whole))
        # 1 % of noise in the bands; sectors are off by up to 3 % beside the edge (T40)
        assert np.allclose(near + far, both, rtol=0.02)
        shares.append(near.sum() / both.sum())
    # all of it from within half of the radius, nothing from beyond the radius, and both along the way
    assert shares[0] > 0.85 and shares[3] < 0.15 and sorted(shares, reverse=True) == shares


def test_a_wall_beyond_the_picture_is_left_to_the_far_owner():
    frame = corner(sees_wall=False)
    whole, parts = bounce(frame, ("direct", "rsm"))[BOUNCE], bounce(frame, ("direct", "rsm", "ssdo"))
    assert whole.any() and np.array_equal(parts[BOUNCE], whole) and not parts[NEAR].any()


@pytest.mark.parametrize("change", [{"hand_over": False}, {"method": "ALL"}, {"radius_m": 1e-3}])
def test_an_owner_that_leaves_nothing_out_keeps_its_light_to_itself(change):
    frame = corner()
    method = change.get("method", "VISIBLE")
    whole, parts = bounce(frame, ("direct", "rsm"), method)[BOUNCE], bounce(frame, ("direct", "rsm", "ssdo"), **change)
    assert np.array_equal(parts[BOUNCE], whole) and not parts[NEAR].any()


@pytest.mark.parametrize("kind", ["perspective", "orthographic"])
def test_points_are_shown_where_the_camera_sees_them_and_from_that_side(kind):
    frame = corner()
    if kind == "orthographic":
        eye = dataclasses.replace(frame.camera, projection=type(frame.camera.projection).ORTHOGRAPHIC, left=-3.4, right=3.4,
                                  bottom=-2.8, top=2.8)
        frame = dataclasses.replace(frame, camera=eye, gbuffer=cast_view(eye, frame.geometry))
    g = frame.gbuffer
    # half a pixel aside on each surface: what a lamp's texels are to the camera; not beside edges, where pixels mix
    x, y, z = np.moveaxis(g.position_ws, -1, 0)
    inside = g.mask & (np.abs(x) < 1.8) & (np.hypot(y - 2, z) > 0.2) & (y > -1.8) & (z < 1.8)
    position, normal = g.position_ws[inside] + np.float32([0.02, 0, 0]), g.normal_ws[inside]
    assert len(position) > 500 and is_shown(frame, position, normal).all()
    assert not is_shown(frame, position, -normal).any()
    away = frame.camera.position_ws.astype(np.float32)
    assert not is_shown(frame, position + np.float32(0.1) * (position - away), normal).any()       # behind it
    assert not is_shown(frame, 2 * away - position, normal).any()                                  # behind the eye
    assert not is_shown(frame, position + np.float32([20, 0, 0]), normal).any()                    # beyond the picture
