"""What texels of a lamp's view show: triangles under smooth shading, and parts of texels that hold more than one surface."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from rtgi_addon.core.frame import LightKind
from rtgi_addon.core.radiometry import texel_solid_angle
from rtgi_addon.core.synthetic import cast_view, make_room_frame
from rtgi_addon.core.techniques import RsmParams
from rtgi_addon.kernels.bvh import build_bvh
from rtgi_addon.kernels.clusters import DIFFUSE, NORMAL, POSITION
from rtgi_addon.kernels.texel_parts import PARTS
from rtgi_addon.passes import rsm
from rtgi_addon.passes.base import Context, Transport
from rtgi_addon.passes.rsm import compute_rsm, texels_and_radii
from rtgi_addon.passes.uneven_texels import look_through

KINDS = [LightKind.SPOT, LightKind.POINT, LightKind.SUN]
CLOSE = 8                   # parts of a texel's edge by which it is looked at closely


def _look(frame, is_lit=True):
    view = frame.views[0]
    g, camera = view.gbuffer, view.camera
    if frame.lights[0].kind is LightKind.SUN:
        size = np.full(g.shape, np.sqrt(np.prod(camera.pixel_size)))
    else:
        size = np.sqrt(texel_solid_angle(camera)) * np.linalg.norm(g.position_ws - camera.position_ws, axis=-1)
    bvh = build_bvh(frame.geometry.corners_ws)
    return look_through(view, g.mask & is_lit, size.astype(np.float32), bvh, 100.0)


def _split(kind, is_lit=True):
    """(frame, view, texels that are split, surfaces of their parts, texel of each) of a room seen by a lamp in 24 texels."""
    frame = make_room_frame(8, 24, (kind,))
    found = _look(frame, is_lit)
    return frame, frame.views[0], found.is_split, found.parts, found.whole


def _finer(view, frame, times):
    camera = view.camera
    fine = dataclasses.replace(camera, width_px=times * camera.width_px, height_px=times * camera.height_px)
    return cast_view(fine, frame.geometry)


@pytest.mark.parametrize("kind", KINDS)
def test_texels_with_two_surfaces_are_split_and_few_others(kind):
    frame, view, is_split, _, _ = _split(kind)
    height, width = view.gbuffer.shape
    fine = _finer(view, frame, CLOSE)
    # walls and boxes are parallel to the axes: no two of their planes have these three numbers in common
    plane = 10 * fine.normal_ws + np.einsum("hwc,hwc->hw", fine.normal_ws, fine.position_ws)[..., None]
    plane = plane.reshape(height, CLOSE, width, CLOSE, 3)
    has_edge = (plane.max((1, 3)) - plane.min((1, 3))).max(-1) > 1e-3
    assert has_edge.any() and not has_edge.all()
    # an edge that cuts off no more than a texel's corner shows in the neighbour across it alone
    assert (has_edge & ~is_split & view.gbuffer.mask).sum() <= 0.05 * has_edge.sum()
    # beside a texel with an edge lies one without, which shows the other surface
    assert is_split.sum() <= 3 * has_edge.sum()


@pytest.mark.parametrize("kind", KINDS)
def test_parts_show_what_a_view_of_twice_the_size_shows(kind):
    frame, view, is_split, surfaces, texel = _split(kind)
    assert len(texel) == PARTS * is_split.sum()                               # the room is closed
    fine, width = _finer(view, frame, 2), view.gbuffer.shape[1]
    row, column = texel // width, texel % width
    assert is_split[row, column].all()
    there = np.stack([fine.position_ws[2 * row + i, 2 * column + j] for i in (0, 1) for j in (0, 1)])
    distance = np.linalg.norm(there - surfaces.position_ws[0], axis=-1)
    which = distance.argmin(0)
    # a thousandth of a texel aside is 5 mm where a wall is seen flat, and at a silhouette it may be beyond
    assert (distance.min(0) < 2e-3 * frame.scale_m).mean() > 0.99
    assert len(np.unique(4 * texel + which)) > 0.99 * len(texel)              # each part is another quarter of its texel
    i, j = which // 2, which % 2
    normal, albedo = (values[2 * row + i, 2 * column + j] for values in (fine.normal_ws, fine.albedo))
    assert ((surfaces.normal_ws[0] * normal).sum(1) > 0.999).mean() > 0.99    # on the very edge two triangles lie
    # the colour is a neighbour's: a side too narrow for any texel's middle has none
    assert (np.abs(surfaces.albedo[0] - albedo).max(1) < 1e-6).mean() > 0.97


def test_no_flux_is_lost_or_made():
    frame, view, *_ = _split(LightKind.SPOT)
    even = dataclasses.replace(view.gbuffer, albedo=np.full_like(view.gbuffer.albedo, 0.5),
                               specular=np.zeros_like(view.gbuffer.specular))
    frame = dataclasses.replace(frame, views=(dataclasses.replace(view, gbuffer=even),))
    fluxes, bvh = [view.incident_flux], build_bvh(frame.geometry.corners_ws)
    whole, split = (texels_and_radii(frame, fluxes, False, 0.0, tree)[0][DIFFUSE:DIFFUSE + 3] for tree in (None, bvh))
    assert split.shape[1] > whole.shape[1]
    np.testing.assert_allclose(split.sum(1, dtype=np.float64), whole.sum(1, dtype=np.float64), rtol=1e-5)


def test_what_is_not_lit_is_left_as_it_is():
    _, _, is_split, surfaces, texel = _split(LightKind.SPOT, is_lit=False)
    assert not is_split.any() and len(texel) == 0 and surfaces.shape == (1, 0)


def test_the_bounce_of_a_coarse_view_comes_nearer_to_that_of_a_fine_one(monkeypatch):
    params = RsmParams(lattice_px=1, rays=256, clusters=256, photons=0)

    def bounce(view_px):
        frame = dataclasses.replace(make_room_frame(16, 12), views=make_room_frame(16, view_px).views)
        return compute_rsm(frame, params, Context(), 3).light[Transport.BOUNCE_DIFFUSE].astype(np.float64)

    fine, split = bounce(96), bounce(16)
    monkeypatch.setattr(rsm, "texels_and_radii", lambda *args: texels_and_radii(*args[:4]))
    whole = bounce(16)
    assert np.abs(split - fine).sum() < 0.9 * np.abs(whole - fine).sum()


def _smooth(frame, tilt):
    """The frame with the shading normals of its lamp's view tilted by `tilt` (3,) before they are unit vectors again."""
    view = frame.views[0]
    normal = view.gbuffer.normal_ws + np.float32(tilt)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    view = dataclasses.replace(view, gbuffer=dataclasses.replace(view.gbuffer, normal_ws=normal.astype(np.float32)))
    return dataclasses.replace(frame, views=(view,))


@pytest.mark.parametrize("kind", KINDS)
def test_faces_are_those_of_the_triangles_however_normals_are_shaded(kind):
    frame = make_room_frame(8, 24, (kind,))
    flat = frame.views[0].gbuffer
    found = _look(_smooth(frame, (0.1, 0.2, 0.3)))
    # on an edge two triangles meet in one place
    assert (np.abs(found.faces_ws - flat.normal_ws).max(-1)[flat.mask] < 1e-5).mean() > 0.98
    there = found.parts.normal_ws[0] * 1.0
    tilted = found.part_faces_ws[0] + np.float32([0.1, 0.2, 0.3])
    tilted /= np.linalg.norm(tilted, axis=-1, keepdims=True)
    # a part is tilted as its texel's neighbour; the tilts of unit vectors differ where faces do
    assert ((there * tilted).sum(-1) > 0.97).mean() > 0.95


def test_a_smooth_surface_is_lit_by_its_shading_normal_and_sends_from_its_triangle():
    frame = make_room_frame(8, 24, (LightKind.SPOT,))
    view = frame.views[0]
    # a lobe takes more of the light at some angles than at others
    matt = dataclasses.replace(view.gbuffer, specular=np.zeros_like(view.gbuffer.specular))
    frame = dataclasses.replace(frame, views=(dataclasses.replace(view, gbuffer=matt),))
    smooth = _smooth(frame, (0.0, 0.3, 0.2))
    view, light, bvh = smooth.views[0], frame.lights[0], build_bvh(frame.geometry.corners_ws)
    flat_table, table = (texels_and_radii(f, [view.incident_flux], False, 0.0, bvh)[0].T for f in (frame, smooth))
    at = {tuple(row[POSITION:POSITION + 3]): row for row in flat_table}
    whole = view.gbuffer.mask & ~_look(smooth).is_split & ~_look(frame).is_split
    compared = 0
    for place, shading, face in zip(view.gbuffer.position_ws[whole], view.gbuffer.normal_ws[whole],
                                    frame.views[0].gbuffer.normal_ws[whole], strict=True):
        to_light = light.position_ws - place
        to_light /= np.linalg.norm(to_light)
        shaded, faced = shading @ to_light, face @ to_light
        if tuple(place) not in at or faced < 0.2 or not 0 < shaded < 3.5 * faced:
            continue
        row = table[(table[:, POSITION:POSITION + 3] == place).all(1)]
        assert len(row) == 1
        colour = slice(DIFFUSE, DIFFUSE + 3)
        np.testing.assert_allclose(row[0, colour], at[tuple(place)][colour] * shaded / faced, rtol=1e-4)
        np.testing.assert_allclose(row[0, NORMAL:NORMAL + 3], face, atol=1e-5)
        compared += 1
    assert compared > 100
