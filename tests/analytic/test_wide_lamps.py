"""Light of lamps that are wide beside their distance: where it falls, how much of it, and the area that texels stand for."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from rtgi_addon.core.frame import Frame, Light, LightKind, LightView
from rtgi_addon.core.radiometry import area_of, texel_flux
from rtgi_addon.core.synthetic import box_triangles, cast_view
from rtgi_addon.core.techniques import RsmParams
from rtgi_addon.core.transforms import ViewFormat
from rtgi_addon.kernels.bvh import build_bvh
from rtgi_addon.kernels.jit import kernel_session
from rtgi_addon.light_views import sphere_camera
from rtgi_addon.passes.base import Context, Transport
from rtgi_addon.passes.rsm import compute_rsm
from rtgi_addon.passes.wide_lamps import is_wide, spread_texels
from tests.plane_frames import geometry_of, looking, quad, view_from

RADIANCE = np.array([3.0, 2.0, 1.0])


def lamp_below(ceiling_m, size_x_m, size_y_m, kind=LightKind.RECTANGLE, gap_m=0.1):
    """A lamp that shines up at a ceiling."""
    place = np.array([0.0, 0.0, ceiling_m - gap_m])
    return Light("Lamp", kind, looking(place, place + [0, 0, 1]), RADIANCE, size_x_m=size_x_m, size_y_m=size_y_m)


def room_of(lamp, half_m=2.0, ceiling_m=2.0, texels=32768):
    """A closed room and one lamp in it, with its view."""
    geometry = geometry_of(box_triangles(np.array([-half_m, -half_m, 0]), np.array([half_m, half_m, ceiling_m])))
    geometry = dataclasses.replace(geometry, albedo=np.full_like(geometry.albedo, 0.75))     # as `cast_view` shows it
    camera = view_from((0, 0, ceiling_m - 0.3), (0, 0, 0), 1.0, 40, 40)
    eye = sphere_camera(lamp, ViewFormat(texels))
    view = LightView(0, eye, cast_view(eye, geometry), texel_flux(lamp, eye))
    return Frame(camera, cast_view(camera, geometry), (lamp,), (view,), geometry)


def spread(frame):
    return spread_texels(frame, frame.views[0], build_bvh(frame.geometry.corners_ws))


@pytest.mark.parametrize(("size", "kind"), [((1.5, 0.05), LightKind.RECTANGLE), ((1.0, 1.0), LightKind.RECTANGLE),
                                            ((1.2, 0.6), LightKind.DISK)])
def test_all_of_its_light_arrives_in_a_closed_room(size, kind):
    lamp = lamp_below(2.0, *size, kind)
    flux = spread(room_of(lamp)).flux.reshape(-1, 3).sum(0, dtype=np.float64)
    # texels of a degree, each with the cosine of its middle
    np.testing.assert_allclose(flux, math.pi * area_of(kind, *size) * RADIANCE, rtol=1e-3)


def form_factor(place, half_x, half_y, gap):
    """Irradiance over pi L at points (N, 2) of a plane that faces a rectangle at a distance: the sum over its corners."""
    total = 0.0
    for sign_x in (-1, 1):
        for sign_y in (-1, 1):
            a, b = (half_x + sign_x * place[:, 0]) / gap, (half_y + sign_y * place[:, 1]) / gap
            u, v = np.sqrt(1 + a * a), np.sqrt(1 + b * b)
            total = total + (a / u * np.arctan(b / u) + b / v * np.arctan(a / v)) / (2 * math.pi)
    return total


@pytest.mark.parametrize("size", [(1.5, 0.05), (1.0, 1.0)])
def test_it_falls_on_the_ceiling_as_the_form_factor_says(size):
    gap = 0.1
    wide = spread(room_of(lamp_below(2.0, *size, gap_m=gap)))
    place, on_ceiling = wide.surfaces.position_ws, wide.surfaces.normal_ws[..., 2] < -0.9
    edges = np.linspace(-1, 1, 11)
    got, _, _ = np.histogram2d(place[on_ceiling][:, 0], place[on_ceiling][:, 1], [edges, edges],
                               weights=wide.flux[on_ceiling][:, 0])
    fine = (np.arange(200) + 0.5) / 100 - 1
    x, y = np.meshgrid(fine, fine, indexing="ij")
    there = form_factor(np.stack([x.ravel(), y.ravel()], 1), size[0] / 2, size[1] / 2, gap).reshape(10, 20, 10, 20)
    wanted = math.pi * RADIANCE[0] * there.sum((1, 3)) * 0.01**2
    # some 30 000 texels over 100 squares: a few percent each where there is much light
    assert np.abs(got - wanted).sum() < 0.04 * wanted.sum()
    area, _, _ = np.histogram2d(place[on_ceiling][:, 0], place[on_ceiling][:, 1], [edges, edges],
                                weights=area_on_surface(wide)[on_ceiling])
    bright = wanted > 0.1 * wanted.max()
    assert np.abs(area[bright] / 0.04 - 1).mean() < 0.1       # squares of 0.2 m, each covered once


def area_on_surface(wide):
    """(H, W) m2 that texels stand for."""
    d = wide.origin_ws - wide.surfaces.position_ws
    squared = np.einsum("hwc,hwc->hw", d, d)
    cosine = np.einsum("hwc,hwc->hw", d, wide.surfaces.normal_ws) / np.sqrt(squared)
    return wide.across * squared / np.maximum(cosine, 0.1)


def test_lamps_are_wide_beside_their_distance_only():
    tube, panel = lamp_below(2.0, 1.5, 0.05), lamp_below(2.0, 1.0, 1.0)
    small, far = lamp_below(2.0, 0.02, 0.02), lamp_below(2.0, 0.2, 0.2, gap_m=1.5)
    point = Light("Point", LightKind.POINT, np.eye(4), RADIANCE, radius_m=0.5)
    assert [is_wide(room_of(lamp, texels=2048).views[0], lamp) for lamp in (tube, panel, small, far)] == [
        True, True, False, False]
    assert not is_wide(room_of(tube, texels=2048).views[0], point)


def test_bounce_of_a_tube_is_that_of_its_pieces():
    """A tube of thirty small lamps end to end, none of them wide, gives what the tube gives."""
    length_m, gap_m, pieces = 1.5, 0.2, 30
    tube = lamp_below(2.0, length_m, 0.05, gap_m=gap_m)
    whole = room_of(tube)
    places = (np.arange(pieces) + 0.5) / pieces * length_m - length_m / 2
    lamps, views = [], []
    for k, x in enumerate(places):
        at = tube.world_from_light.copy()
        at[:3, 3] += x * at[:3, 0]
        lamps.append(Light(f"Piece {k}", LightKind.RECTANGLE, at, RADIANCE, size_x_m=length_m / pieces, size_y_m=0.05))
        eye = sphere_camera(lamps[-1], ViewFormat(2048))
        views.append(LightView(k, eye, cast_view(eye, whole.geometry), texel_flux(lamps[-1], eye)))
    parts = Frame(whole.camera, whole.gbuffer, tuple(lamps), tuple(views), whole.geometry)
    assert is_wide(whole.views[0], tube) and not any(is_wide(view, lamps[view.light_index]) for view in views)
    params = RsmParams(lattice_px=2, rays=64)
    with kernel_session(2):
        got, wanted = (compute_rsm(frame, params, Context(), 0).light[Transport.BOUNCE_DIFFUSE] for frame in (whole, parts))
    assert got.sum(dtype=np.float64) == pytest.approx(wanted.sum(dtype=np.float64), rel=0.01)
    # noise of 64 rays at a pixel and the lattice's filter, both times
    assert np.abs(got - wanted).sum() < 0.05 * wanted.sum()


def test_textures_that_the_view_shows_are_on_what_it_shows():
    lamp = lamp_below(2.0, 1.0, 1.0, gap_m=0.5)
    frame = room_of(lamp)
    view = frame.views[0]
    striped = np.where(np.floor(view.gbuffer.position_ws[..., :1] / 0.25) % 2 == 0, 0.8, 0.2).astype(np.float32)
    view.gbuffer.albedo[:] = striped
    wide = spread(frame)
    place = wide.surfaces.position_ws
    wanted = np.where(np.floor(place[..., 0] / 0.25) % 2 == 0, 0.8, 0.2)
    inner = np.abs(place[..., 0] / 0.25 % 1 - 0.5) < 0.3      # away from the stripes' edges by a texel
    shown = inner & (np.abs(place[..., :2]).max(-1) < 0.5)
    assert shown.sum() > 1000 and (np.abs(wide.surfaces.albedo[..., 0] - wanted)[shown] < 1e-6).mean() > 0.98


def test_board_before_the_centre_does_not_stop_the_rest():
    lamp = lamp_below(2.0, 1.0, 1.0, gap_m=0.5)
    frame = room_of(lamp)
    board = quad((0, 0, 1.51), 0.05, 0.05)
    geometry = geometry_of(frame.geometry.corners_ws, board)
    eye = frame.views[0].camera
    view = LightView(0, eye, cast_view(eye, geometry), texel_flux(lamp, eye))
    blocked = Frame(frame.camera, frame.gbuffer, (lamp,), (view,), geometry)
    wide = spread(blocked)
    beyond = wide.surfaces.position_ws[..., 2] != np.float32(1.51)
    # the board is a hundredth of the lamp's area and close before it
    assert wide.flux[beyond].sum() > 0.97 * wide.flux.sum()
    centre = blocked.views[0]
    assert centre.incident_flux[centre.gbuffer.position_ws[..., 2] > 1.6].sum() < 0.3 * wide.flux.sum()
