"""Pixels whose place lies in two triangles at once, as `tools.doubled_surfaces` finds them."""

from __future__ import annotations

import numpy as np

from rtgi_addon.core.frame import Light, LightKind
from rtgi_addon.core.synthetic import cast_view
from tests.plane_frames import frame_of, geometry_of, looking, quad, view_from
from tools.doubled_surfaces import doubled_pixels


def test_only_pixels_in_two_triangles_are_doubled():
    lamp = Light("Lamp", LightKind.POINT, looking((0, 0, 2.0), (0, 0, 0)), np.ones(3))
    camera = view_from((0, 0, 3), (0, 0, 0), 0.3, 32, 32)
    floor, patch, below = quad((0, 0, 0), 2, 2), quad((0.3, 0, 0), 0.4, 0.4), quad((0, 0, -0.01), 2, 2)
    both = geometry_of(floor, patch, below)
    frame = frame_of(both, cast_view(camera, both), camera, lamp)
    p = frame.gbuffer.position_ws
    inside = (np.abs(p[..., 0] - 0.3) < 0.4) & (np.abs(p[..., 1]) < 0.4)
    assert 0 < inside.sum() < inside.size
    found = doubled_pixels(frame)
    # the diagonal between a quad's two triangles belongs to neither
    assert (found <= inside).all()
    assert found.sum() >= inside.sum() - 2 * 32
