"""`passes.direct` against its float64 form: every kind of lamp, with and without size, with shadows, map and rays."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from rtgi_addon.core.frame import Light, LightKind
from rtgi_addon.core.synthetic import make_room_frame
from rtgi_addon.core.techniques import DirectParams
from rtgi_addon.kernels.lamps import gain_of_size, unshadowed
from rtgi_addon.kernels.vec3 import f32, vector
from rtgi_addon.passes.base import Context, Transport
from rtgi_addon.passes.direct import compute_direct, pack_lamp
from tests.oracle import direct_oracle
from tests.plane_frames import looking, plane_frame

FLOAT32 = 1e-4          # relative: closed forms in float32, and distances of 2 mm at the room's corners
SOFT_SHARE = 0.01       # relative L1: 256 rays at a pixel of a half shadow, and 330 patches in the oracle
TOLERANCE_IN_LOBES = 0.1    # 64 sets of 16 rays, half vectors in float32, and in the tail the lamp's centre for all of it
EDGE_ON = 0.025         # the map does not see the room's walls, sheets without thickness, from a sun straight above


def direct(frame, **params):
    return compute_direct(frame, DirectParams(**params), Context(), 0).light[Transport.DIRECT_DIFFUSE]


@pytest.mark.parametrize("kind", LightKind)
def test_hard_lamp_agrees_at_every_pixel_where_no_shadow_edge_runs(kind):
    frame = make_room_frame(32, 20, (kind,), 0.0)
    expected = direct_oracle.image(frame, 16)
    got = direct(frame)
    close = np.isclose(got, expected, rtol=2e-3 if kind.is_area else FLOAT32, atol=1e-5 * expected.max())
    # an area light of 10 cm has half shadows too; 0.5 % of the pixels may lie in them
    assert close.all(-1).mean() >= (0.97 if kind.is_area else 0.995)


@pytest.mark.parametrize("kind", LightKind)
def test_soft_lamp_agrees_within_the_noise_of_its_rays(kind):
    frame = make_room_frame(24, 16, (kind,), 0.15)
    expected = direct_oracle.image(frame, 10)
    for exact, limit in ((True, SOFT_SHARE), (False, EDGE_ON if kind is LightKind.SUN else SOFT_SHARE)):
        got = direct(frame, soft_shadow_rays=256, exact_shadows=exact)
        assert np.abs(got - expected).sum() <= limit * expected.sum()


@pytest.mark.parametrize("kind", [LightKind.POINT, LightKind.SPOT, LightKind.SUN])
def test_rays_at_every_pixel_change_nothing_that_the_map_decided(kind):
    frame = make_room_frame(64, 48, (kind,), 0.0)
    np.testing.assert_array_equal(direct(frame), direct(frame, exact_shadows=True))


@pytest.mark.parametrize("kind", [LightKind.RECTANGLE, LightKind.DISK])
def test_gain_of_a_lamps_size_is_all_patches_over_its_centre(kind):
    light = Light("Area", kind, looking((0.1, 0.2, 2.0), (0, 0, 0)), np.ones(3), size_x_m=1.0, size_y_m=0.6)
    # on a wall beside the lamp, on the floor, and on a wall that sees most of it
    place = np.array([(-0.9, 0.0, 1.7), (-0.9, 0.2, 0.5), (0.0, 0.0, 0.3), (1.5, 1.0, 0.0), (0.2, 1.2, 1.2)])
    normal = np.array([(1.0, 0, 0), (1.0, 0, 0), (0, 0, 1.0), (0, 0, 1.0), (0, -1.0, 0)])
    to = light.position_ws - place
    area_m2 = light.size_x_m * light.size_y_m * (1 if kind is LightKind.RECTANGLE else np.pi / 4)
    centre = area_m2 * (to @ light.world_from_light[:3, 2]) * (to * normal).sum(1) / (to * to).sum(1) ** 2
    whole = [direct_oracle.irradiance(light, p, n, None, 64)[0] for p, n in zip(place, normal, strict=True)]
    expected = np.array(whole) / centre
    gain = np.empty(len(place), np.float32)
    gain_of_size(len(place), pack_lamp(light, 1.0), place.astype(np.float32), normal.astype(np.float32), np.float32(4), gain)
    assert expected.max() > 1.2 and expected.min() < 0.95
    # far lamps take four samples, and an ellipse is a polygon of its area
    np.testing.assert_allclose(gain, expected, rtol=0.01)


@pytest.mark.parametrize("kind", [LightKind.RECTANGLE, LightKind.DISK])
@pytest.mark.parametrize("spread_degrees", [20, 60, 120])
def test_narrow_area_light_agrees_with_its_tube_grid(kind, spread_degrees):
    light = Light("Area", kind, looking((0.1, 0.2, 2.0), (0, 0, 0)), np.ones(3), size_x_m=0.6, size_y_m=0.4,
                  spread_rad=np.radians(spread_degrees))
    frame = dataclasses.replace(plane_frame(light, width=15, height=11, half_m=0.5), geometry=None)
    expected = direct_oracle.image(frame, 60)
    got = direct(frame)
    assert expected.any()
    # 64 stratified samples a pixel
    assert np.abs(got - expected).sum() <= 0.04 * expected.sum()
    np.testing.assert_allclose(got.sum(), expected.sum(), rtol=0.01)


def lobe(n, viewer, light, alpha):
    """GGX times the cosine of the light (N, 3), float64, without Fresnel: Walter et al. 2007, Eq. 33; Heitz 2014, Eq. 99."""
    half = light + viewer
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    # 1 - cos^2 by the cross product: there is nothing to cancel
    sine2, cos_v, cos_l = (np.cross(half, n) ** 2).sum(1), n @ viewer, np.maximum(light @ n, 0)
    shape = alpha**2 / (np.pi * (sine2 + alpha**2 * (1 - sine2)) ** 2)
    hides = (cos_l * np.sqrt(cos_v**2 * (1 - alpha**2) + alpha**2)
             + cos_v * np.sqrt(cos_l**2 * (1 - alpha**2) + alpha**2))
    return shape / 2 / hides * cos_l


@pytest.mark.parametrize(("half_m", "roughness"), [
    (0.01, 0.05), (0.03, 0.1), (0.4, 0.25), (0.4, 0.35), (0.15, 0.2), (0.15, 0.25)])
@pytest.mark.parametrize("kind", [LightKind.POINT, LightKind.RECTANGLE])
def test_polished_metal_shows_a_lamp_from_its_middle_to_its_tail(kind, half_m, roughness):
    """Narrow beside the lobe and wide beside it: neither blurred, nor seen as four, nor cut off."""
    light = Light("Lamp", kind, looking((0.0, 0.0, 2.0), (0.0, 0.0, 0.0)), np.ones(3), radius_m=half_m, size_x_m=2 * half_m,
                  size_y_m=2 * half_m)
    lamp, n, alpha = pack_lamp(light, 10.0), np.array([0.0, 0.0, 1.0]), roughness**2
    # viewers whose mirror direction passes the lamp's middle, its rim and 10 to 60 alphas of its tail
    off = np.array([0.0, 0.5, 0.9, 1.1]) * np.arctan(half_m / 2)
    angles = np.concatenate([off, np.arctan(half_m / 2) + alpha * np.array([1.0, 4.0, 10.0, 30.0, 60.0])])
    angles = angles[angles < 1.2]
    d, facing = direct_oracle.patches(light, np.zeros(3), 300)
    towards = d / np.linalg.norm(d, axis=1, keepdims=True)
    shifts = (np.random.default_rng(1).uniform(0, 1, (64, 2)))
    for angle in angles:
        viewer = np.array([-np.sin(angle), 0.0, np.cos(angle)])
        wanted = (facing * lobe(n, viewer, towards, alpha)).sum()
        got = np.mean([unshadowed(lamp, vector(np.zeros(3)), vector(n), vector(viewer), f32(alpha), f32(1), f32(0.8), False,
                                  f32(u), f32(v))[1] for u, v in shifts])
        assert got == pytest.approx(wanted, rel=TOLERANCE_IN_LOBES), (angle, got / wanted)
