"""Laws that direct light keeps exactly, or to rounding: power, superposition, motion, scale, threads, seeds."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from rtgi_addon.core.frame import LightKind
from rtgi_addon.core.synthetic import cast_view, make_room_frame
from rtgi_addon.core.techniques import DirectParams
from rtgi_addon.errors import Cancelled
from rtgi_addon.kernels.jit import kernel_session
from rtgi_addon.passes.base import Context, Transport
from rtgi_addon.passes.direct import compute_direct
from tests.moved_frames import moved, turn

FLOAT32 = 2e-5          # a few roundings of sums and products
MOVED = 5e-4            # positions rounded anew at coordinates of some metres, at pixels near a lamp


def run(frame, **params):
    return compute_direct(frame, DirectParams(**params), Context(), 0)


def diffuse(frame, **params):
    return run(frame, **params).light[Transport.DIRECT_DIFFUSE]


def with_lights(frame, *lights):
    return dataclasses.replace(frame, lights=lights)


@pytest.mark.parametrize("transport", [Transport.DIRECT_DIFFUSE, Transport.DIRECT_GLOSSY])
@pytest.mark.parametrize("kind", LightKind)
def test_light_is_linear_in_power(kind, transport):
    frame = make_room_frame(24, 16, (kind,))
    twice = with_lights(frame, dataclasses.replace(frame.lights[0], power=2 * frame.lights[0].power))
    np.testing.assert_array_equal(run(twice).light[transport], 2 * run(frame).light[transport])


def test_lights_add_up():
    kinds = (LightKind.SPOT, LightKind.POINT)
    both = make_room_frame(24, 16, kinds, 0.0, has_ceiling=True)
    parts = [make_room_frame(24, 16, (kind,), 0.0, has_ceiling=True) for kind in kinds]
    np.testing.assert_allclose(diffuse(both), sum(diffuse(p) for p in parts), rtol=FLOAT32)


def test_many_lamps_are_as_exact_as_many_rays_make_them():
    # sixteen lamps a metre apart: each gives a pixel some percent, so that one ray or the map tells most shadows
    frame = make_room_frame(48, 36, (LightKind.POINT,) * 16, 0.03, has_ceiling=True)
    lights, views = [], []
    for k, (light, view) in enumerate(zip(frame.lights, frame.views, strict=True)):
        place = np.eye(4)
        place[:3, 3] = (k % 4 - 1.5) * 0.9, (k // 4 - 1.5) * 0.8, 2.2
        moved = dataclasses.replace(light, name=f"lamp {k}", world_from_light=place)
        camera = dataclasses.replace(view.camera, world_from_view=place)
        lights.append(moved)
        views.append(dataclasses.replace(view, camera=camera, gbuffer=cast_view(camera, frame.geometry)))
    frame = dataclasses.replace(frame, lights=tuple(lights), views=tuple(views))
    got, wanted = diffuse(frame), diffuse(frame, exact_shadows=True, soft_shadow_rays=256)
    # one ray's noise stands in half shadows, some percent of the pixels, and there it is some percent of the light
    assert np.abs(got - wanted).sum() < 0.01 * wanted.sum()
    assert abs(got.sum() / wanted.sum() - 1) < 0.003


@pytest.mark.parametrize("factor", ["diffuse_factor", "glossy_factor"])
def test_influence_of_a_lamp_scales_its_own_lobe_only(factor):
    frame = make_room_frame(24, 16)
    half = with_lights(frame, dataclasses.replace(frame.lights[0], **{factor: 0.5}))
    before, after = run(frame).light, run(half).light
    for transport in before:
        expected = 0.5 if (transport is Transport.DIRECT_DIFFUSE) == (factor == "diffuse_factor") else 1.0
        np.testing.assert_array_equal(after[transport], np.float32(expected) * before[transport])


def test_no_light_gives_exactly_nothing_and_full_visibility():
    result = run(with_lights(make_room_frame(16, 12)))
    assert not any(image.any() for image in result.light.values()) and (result.visibility == 1).all()


def test_black_light_gives_exactly_nothing():
    frame = make_room_frame(16, 12)
    assert not diffuse(with_lights(frame, dataclasses.replace(frame.lights[0], power=np.zeros(3)))).any()


@pytest.mark.parametrize("kind", LightKind)
@pytest.mark.parametrize("scale", [1.0, 1e-3, 1e4])
def test_moving_and_scaling_everything_changes_nothing(kind, scale):
    frame = make_room_frame(32, 24, (kind,), 0.0)
    other = diffuse(moved(frame, turn((1, 2, 3), 1.1), scale * np.array([3.0, -2.0, 1.0]), scale))
    same = np.isclose(other, diffuse(frame), rtol=MOVED, atol=1e-6).all(-1)
    assert same.mean() >= 0.995         # a pixel on the very edge of a shadow may fall to the other side


@pytest.mark.parametrize("kind", LightKind)
def test_threads_do_not_change_a_bit(kind):
    frame = make_room_frame(40, 24, (kind,), 0.1)
    images = []
    for threads in (1, 2):
        with kernel_session(threads):
            images.append(run(frame))
    for transport in images[0].light:
        np.testing.assert_array_equal(images[0].light[transport], images[1].light[transport])
    np.testing.assert_array_equal(images[0].visibility, images[1].visibility)


def test_seed_moves_only_half_shadows():
    frame = make_room_frame(48, 32, (LightKind.SPOT,), 0.1)
    a, b = (compute_direct(frame, DirectParams(), Context(), seed) for seed in (0, 1))
    changed = (a.light[Transport.DIRECT_DIFFUSE] != b.light[Transport.DIRECT_DIFFUSE]).any(-1)
    # the rim of a half shadow may also come out lit or dark
    either = np.minimum(a.visibility, b.visibility)[changed]
    assert changed.any() and (either < 1).all() and (np.maximum(a.visibility, b.visibility)[changed] > 0).all()


def test_visibility_is_the_share_that_arrives():
    frame = make_room_frame(32, 24, (LightKind.SPOT,), 0.1)
    bare = diffuse(dataclasses.replace(frame, geometry=None, views=()))[..., 0]
    result = run(frame)
    arrived = result.light[Transport.DIRECT_DIFFUSE][..., 0]
    np.testing.assert_allclose(result.visibility * bare, arrived, rtol=1e-4, atol=1e-7)


def test_map_alone_comes_close_where_there_is_no_geometry_to_trace():
    frame = make_room_frame(64, 48, (LightKind.SPOT,), 0.0)
    exact, alone = diffuse(frame), diffuse(dataclasses.replace(frame, geometry=None))
    # a map of 48 texels: errors stay within a texel of shadow edges, a tenth of the picture
    assert np.abs(exact - alone).sum() <= 0.1 * exact.sum()


def test_cancelled_render_stops_at_the_next_light():
    with pytest.raises(Cancelled):
        compute_direct(make_room_frame(16, 12), DirectParams(), Context(lambda: True), 0)


def test_frame_that_sees_nothing_stays_black():
    frame = make_room_frame(16, 12)
    empty = dataclasses.replace(frame.gbuffer, depth=np.full_like(frame.gbuffer.depth, np.inf))
    result = run(dataclasses.replace(frame, gbuffer=empty))
    assert not any(image.any() for image in result.light.values())


def test_result_is_float32_and_finite():
    frame = make_room_frame(24, 16, tuple(LightKind), 0.3)
    for image in run(frame).light.values():
        assert image.dtype == np.float32 and np.isfinite(image).all() and (image >= 0).all()
