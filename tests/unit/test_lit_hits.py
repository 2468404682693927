"""The glossy light of a hit: towards the camera it is what the picture shows, and shadows are those of the picture."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from rtgi_addon.core.frame import Light, LightKind
from rtgi_addon.core.techniques import DirectParams
from rtgi_addon.kernels.brdf import albedo_table, relative_reflectance
from rtgi_addon.kernels.bvh import STACK
from rtgi_addon.kernels.lit_hits import gloss_of_lamps, light_of_lamps, softened
from rtgi_addon.kernels.vec3 import f32, vector
from rtgi_addon.passes.base import Context, Transport
from rtgi_addon.passes.direct import compute_direct
from rtgi_addon.passes.surroundings import pack_lights
from tests.mirror_frames import glossy, on_floor, room_from_above

FLOAT32 = 1e-3          # a dozen roundings, and the same table interpolated at another place


@pytest.fixture(scope="module", params=[LightKind.SPOT, LightKind.POINT, LightKind.SUN])
def frame(request):
    room = room_from_above(24, 18, (request.param,), light_radius_m=0.0, has_ceiling=False)
    return glossy(room, on_floor(room), 0.4, 0.06)


def towards_camera(frame, p):
    d = frame.camera.position_ws - p
    return vector(d / np.linalg.norm(d))


def pixels(frame, light):
    """Lit pixels of the floor."""
    return np.argwhere(on_floor(frame) & (light.mean(-1) > 0))[::17]


def sent(frame, i, j, towards, irradiance):
    g = frame.gbuffer
    return gloss_of_lamps(pack_lights(frame.lights, 100.0), vector(g.position_ws[i, j]), vector(g.normal_ws[i, j]), towards,
                          towards_camera(frame, g.position_ws[i, j]), vector(g.specular[i, j]), g.roughness[i, j],
                          f32(0), g.f0[i, j], f32(irradiance), albedo_table(), f32(0.5), f32(0.5))


def test_towards_the_camera_it_is_the_direct_glossy_light(frame):
    light = compute_direct(frame, DirectParams(), Context(), 0).light
    arrived, shown = light[Transport.DIRECT_DIFFUSE], light[Transport.DIRECT_GLOSSY]
    lit = pixels(frame, arrived)
    assert len(lit) > 5
    for i, j in lit:
        got = sent(frame, i, j, towards_camera(frame, frame.gbuffer.position_ws[i, j]), arrived[i, j].mean())
        np.testing.assert_allclose(got, shown[i, j], rtol=FLOAT32, atol=1e-7)


def test_half_the_light_gives_half_the_gloss_and_none_none(frame):
    arrived = compute_direct(frame, DirectParams(), Context(), 0).light[Transport.DIRECT_DIFFUSE]
    i, j = pixels(frame, arrived)[0]
    towards = vector(np.array([0.6, 0.0, 0.8]))
    whole, half, none = (np.array(sent(frame, i, j, towards, share * arrived[i, j].mean())) for share in (0.999, 0.4995, 0))
    np.testing.assert_allclose(half, whole / 2, rtol=FLOAT32)
    assert whole.any() and not none.any()


def test_other_directions_are_as_the_triangles_lit_anew(frame):
    # one lamp, no shadow: the same lobe with the colour that a dielectric has in that direction
    arrived = compute_direct(frame, DirectParams(), Context(), 0).light[Transport.DIRECT_DIFFUSE]
    bare = dataclasses.replace(frame, lights=tuple(dataclasses.replace(x, casts_shadow=False) for x in frame.lights))
    bvh, stack, g = Context().bvh(frame.geometry), np.empty(STACK, np.int32), frame.gbuffer
    i, j = pixels(frame, arrived)[0]
    p, n, black = vector(g.position_ws[i, j]), vector(g.normal_ws[i, j]), vector(np.zeros(3))
    for direction in ((0.6, 0.0, 0.8), (-0.8, 0.2, 0.4)):
        towards = vector(np.array(direction) / np.linalg.norm(direction))
        mine = np.array(sent(frame, i, j, towards, 1e9))
        lamps = pack_lights(bare.lights, 100.0)
        anew = np.array([light_of_lamps(bvh, lamps, stack, p, n, n, black, towards, black, vector(np.full(3, s)),
                                        g.roughness[i, j], f32(0), f32(0), albedo_table(), f32(1e-5), *[f32(0.5)] * 3)
                         for s in (0.02, 0.06, 0.12)])
        # between a reflectance of a third and of twice the one towards the camera: it follows the angle, not the lobe
        assert (mine > anew[0]).all() and (mine < anew[2]).all()


def test_highlights_widen_with_the_lobe_that_shows_them_and_a_mirror_shows_them_as_they_are():
    assert softened(f32(0.2), f32(0)) == pytest.approx(0.2, rel=1e-6)
    for own, receiver in ((0.02, 0.3), (0.2, 0.5), (0.9, 1.0)):
        alpha = softened(f32(own), f32(receiver)) ** 2
        # the squared widths add: the highlight's own and a quarter of the lobe's
        assert alpha**2 == pytest.approx(own**4 + 0.25 * receiver**4, rel=1e-5)


@pytest.mark.parametrize("cos_lamp", [1.0, 0.6])
@pytest.mark.parametrize("receiver", [0.5, 0.9])
def test_a_softened_highlight_sends_out_what_the_surface_reflects_of_the_lamp(frame, receiver, cos_lamp):
    # a smooth dielectric under a sun: the flux over all directions, which rays of a rough surface take in
    roughness, f0, table, n = f32(0.1), f32(0.04), albedo_table(), vector(np.array([0.0, 0.0, 1.0]))
    axes = np.eye(4)
    axes[:3, 2] = np.sqrt(1 - cos_lamp**2), 0, cos_lamp
    axes[:3, 0] = cos_lamp, 0, -axes[0, 2]
    sun = Light("sun", LightKind.SUN, axes, np.ones(3), angle_rad=0.01, casts_shadow=False)
    lamps, black, sent_out = pack_lights((sun,), 100.0), vector(np.zeros(3)), 0.0
    bvh, stack, steps = Context().bvh(frame.geometry), np.empty(STACK, np.int32), 64
    for cosine in (np.arange(steps) + 0.5) / steps:
        colour = vector(np.full(3, relative_reflectance(f32(cosine), roughness**2, f0, table)))
        for phi in (np.arange(2 * steps) + 0.5) / steps * math.pi:
            sine = math.sqrt(1 - cosine**2)
            towards = vector(np.array([sine * math.cos(phi), sine * math.sin(phi), cosine]))
            light = light_of_lamps(bvh, lamps, stack, black, n, n, black, towards, black, colour, roughness, f32(receiver),
                                   f0, table, f32(1e-5), *[f32(0.5)] * 3)
            sent_out += light[0] * cosine * math.pi / steps**2
    # the lobe keeps energy towards rays and not towards lamps, the table has cells; with the reflectance at the ray alone a
    # receiver of 0.9 took in 1.24 and 1.32 times as much
    assert sent_out / cos_lamp == pytest.approx(relative_reflectance(f32(cos_lamp), roughness**2, f0, table), rel=0.12)
