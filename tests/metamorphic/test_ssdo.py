"""Laws that hold exactly for directional occlusion, and inputs that must not break it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rtgi_addon.core.frame import Frame, GBuffer, LightKind, World
from rtgi_addon.core.synthetic import make_room_frame
from rtgi_addon.core.techniques import SsdoParams
from rtgi_addon.core.transforms import Camera, Projection
from rtgi_addon.errors import Cancelled
from rtgi_addon.kernels.jit import kernel_session
from rtgi_addon.passes.base import Context, Transport
from rtgi_addon.passes.ssdo import compute_ssdo
from tests.moved_frames import moved

FORMS = ("SECTORS", "SAMPLES")
NEAR, WORLD = Transport.NEAR_DIFFUSE, Transport.WORLD_DIFFUSE


@pytest.fixture(scope="module")
def room():
    return make_room_frame(36, 27, (LightKind.POINT,), world_radiance=0.5)


@pytest.fixture(scope="module")
def lamp_light(room):
    """(H, W, 3) W/m2 of no particular lamp."""
    return np.random.default_rng(4).uniform(0, 2, room.gbuffer.albedo.shape).astype(np.float32)


def with_sky(frame: Frame, radiance) -> Frame:
    return dataclasses.replace(frame, world=World(np.asarray(radiance, np.float32)))


def black_world(frame: Frame) -> Frame:
    return with_sky(frame, np.zeros((1, 1, 3)))


def coloured_sky(factor: float = 1.0) -> np.ndarray:
    return np.random.default_rng(8).uniform(0, 1, (8, 16, 3)) * factor


def light(frame: Frame, direct=None, seed: int = 3, **params) -> dict[Transport, np.ndarray]:
    context = Context()
    context.light = {} if direct is None else {Transport.DIRECT_DIFFUSE: direct}
    return compute_ssdo(frame, SsdoParams(**{"radius_m": 2.0, "samples": 16, **params}), context, seed).light


# ---- linearity ----
@pytest.mark.parametrize("form", FORMS)
def test_the_bounce_is_linear_in_the_lamps_light(room, lamp_light, form):
    dark = black_world(room)
    assert np.array_equal(light(dark, 4 * lamp_light, form=form)[NEAR], 4 * light(dark, lamp_light, form=form)[NEAR])


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("sky", ["constant", "map"])
def test_all_light_is_linear_in_the_world(room, form, sky):
    radiance = coloured_sky() if sky == "map" else np.full((1, 1, 3), 0.25)
    one, four = (light(with_sky(room, k * radiance), form=form) for k in (1, 4))
    # a map's light is divided by its own sum and multiplied by that of its table: the last digits differ
    assert np.allclose(four[WORLD], 4 * one[WORLD], rtol=1e-5)
    assert np.allclose(four[NEAR], 4 * one[NEAR], rtol=1e-5, atol=1e-7)
    assert one[NEAR].any()                                        # the world's light bounces too


@pytest.mark.parametrize("form", FORMS)
def test_lamps_and_world_add_up(room, lamp_light, form):
    both, world = light(room, lamp_light, form=form), light(room, form=form)
    lamps = light(black_world(room), lamp_light, form=form)
    assert np.allclose(both[NEAR], lamps[NEAR] + world[NEAR], rtol=1e-4, atol=1e-6)
    assert np.array_equal(both[WORLD], world[WORLD])


@pytest.mark.parametrize("form", FORMS)
def test_no_light_gives_exactly_zero(room, form):
    none = light(black_world(room), form=form)
    assert not none[NEAR].any() and not none[WORLD].any()


@pytest.mark.parametrize("form", FORMS)
def test_black_surfaces_send_nothing_on(room, lamp_light, form):
    g = room.gbuffer
    black = dataclasses.replace(room, gbuffer=dataclasses.replace(g, albedo=np.zeros_like(g.albedo)))
    assert not light(black, lamp_light, form=form)[NEAR].any()


def test_colours_do_not_mix(room, lamp_light):
    red = lamp_light * np.array([1, 0, 0], np.float32)
    got, all_of_it = light(black_world(room), red)[NEAR], light(black_world(room), lamp_light)[NEAR]
    assert np.array_equal(got[..., 0], all_of_it[..., 0]) and not got[..., 1:].any()


def test_energy_of_the_bounce_is_below_that_of_a_sphere_of_the_brightest(room, lamp_light):
    brightest = (lamp_light * room.gbuffer.albedo).max()
    assert light(black_world(room), lamp_light, blur=0)[NEAR].max() <= brightest * (1 + 1e-5)


def test_beside_a_bounce_that_is_whole_only_the_worlds_light_bounces(room, lamp_light):
    context = Context()
    context.light = {Transport.DIRECT_DIFFUSE: lamp_light, Transport.BOUNCE_DIFFUSE: lamp_light}
    got = compute_ssdo(room, SsdoParams(radius_m=2.0, samples=16), context, 3).light
    assert all(np.array_equal(got[t], light(room)[t]) for t in (NEAR, WORLD))
    assert not compute_ssdo(black_world(room), SsdoParams(radius_m=2.0), context, 3).light[NEAR].any()
    context.to_come = frozenset({Transport.WORLD_BOUNCE_DIFFUSE})       # and not even that beside final gathering
    assert not compute_ssdo(room, SsdoParams(radius_m=2.0), context, 3).light[NEAR].any()


# ---- geometry ----
def nearly_all(a: np.ndarray, b: np.ndarray) -> bool:
    """Rounding moves a tap to the next pixel, or a sector over its edge, once in a while."""
    return bool(np.mean(np.isclose(a, b, rtol=2e-2, atol=2e-3 * b.mean())) > 0.97) and abs(a.mean() / b.mean() - 1) < 5e-3


@pytest.mark.parametrize("form", FORMS)
def test_rigid_motion_changes_nothing(room, lamp_light, form):
    turn, _ = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    there = moved(room, turn, np.array([3.0, -2.0, 1.0]))
    before, after = (light(frame, lamp_light, form=form, samples=256) for frame in (room, there))
    # the published form turns its samples with an arbitrary tangent, so only their mean stays
    if form == "SECTORS":
        assert nearly_all(after[NEAR], before[NEAR]) and nearly_all(after[WORLD], before[WORLD])
    assert abs(after[NEAR].mean() / before[NEAR].mean() - 1) < 0.05


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_a_scene_of_another_size_gets_the_same_light(room, lamp_light, scale, form):
    there = moved(room, np.eye(3), scale=scale)
    for radius in (2.0, 0.0):                                     # one that is given, and one taken from the scene's size
        before = light(room, lamp_light, form=form, radius_m=radius)
        after = light(there, lamp_light, form=form, radius_m=radius * scale)
        assert nearly_all(after[NEAR], before[NEAR]) and nearly_all(after[WORLD], before[WORLD])


@pytest.mark.parametrize("form", FORMS)
def test_a_smaller_radius_lets_more_of_the_world_in_and_less_of_the_bounce(room, lamp_light, form):
    small, large = (light(room, lamp_light, form=form, radius_m=r, blur=0) for r in (0.3, 3.0))
    assert small[WORLD].mean() > large[WORLD].mean() * 1.02
    if form == "SECTORS":                                         # a published patch grows with the radius
        assert light(black_world(room), lamp_light, radius_m=0.3)[NEAR].mean() < light(
            black_world(room), lamp_light, radius_m=3.0)[NEAR].mean()


def test_more_slices_and_steps_change_noise_and_not_the_mean():
    room = make_room_frame(96, 72, (), world_radiance=0.5)
    few, many = (light(room, np.ones_like(room.gbuffer.albedo), slices=n, steps=2 * n, lattice_px=1) for n in (4, 16))
    # steps of 8 are wide beside the box and join what is not one sheet: 5 % more bounce than steps of 32
    assert abs(few[NEAR].mean() / many[NEAR].mean() - 1) < 0.07
    assert abs(few[WORLD].mean() / many[WORLD].mean() - 1) < 0.03


# ---- numbers ----
@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("lattice_px", [1, 2])
def test_the_same_bits_on_one_and_two_threads(room, lamp_light, form, lattice_px):
    results = []
    for threads in (1, 2):
        with kernel_session(threads):
            results.append(light(with_sky(room, coloured_sky()), lamp_light, form=form, lattice_px=lattice_px))
    assert results[0][NEAR].any() and all(np.array_equal(results[0][t], results[1][t]) for t in (NEAR, WORLD))


@pytest.mark.parametrize("form", FORMS)
def test_a_seed_repeats_its_picture_and_another_gives_another(room, lamp_light, form):
    first, again, other = (light(room, lamp_light, seed, form=form)[NEAR] for seed in (1, 1, 2))
    assert np.array_equal(first, again) and not np.array_equal(first, other)


def test_pixels_without_a_surface_stay_black(room, lamp_light):
    depth = room.gbuffer.depth.copy()
    depth[:9, :9] = np.inf
    frame = dataclasses.replace(room, gbuffer=dataclasses.replace(room.gbuffer, depth=depth))
    for form in FORMS:
        for image in light(frame, lamp_light, form=form).values():
            assert not image[:9, :9].any() and image[9:].any()


def test_esc_stops_it(room):
    with pytest.raises(Cancelled):
        compute_ssdo(room, SsdoParams(), Context(is_cancelled=lambda: True), 0)


# ---- odd inputs ----
def wild_frame(rng: np.random.Generator, height: int, width: int, projection: Projection, low: float, high: float) -> Frame:
    """Depths between two bounds, normals of any direction, roughness and colours at their ends, holes; nothing fits."""
    camera = Camera(projection, np.eye(4), width, height, -1.0, 0.7, -0.4, 0.9)
    depth = np.exp(rng.uniform(np.log(low), np.log(high), (height, width))).astype(np.float32)
    depth[rng.random((height, width)) < 0.1] = np.inf
    normal = rng.normal(size=(height, width, 3))
    normal[rng.random((height, width)) < 0.3] = [1, 0, 0]         # edge on, or nearly
    normal[rng.random((height, width)) < 0.1] = [0, 0, -1]        # away from the viewer
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    colour = rng.choice([0.0, 1.0], (height, width, 3)).astype(np.float32)
    seen = GBuffer(depth, camera.positions_ws(depth), normal.astype(np.float32), colour, 1 - colour, colour[..., 0],
                   np.zeros_like(colour))
    return Frame(camera, seen, world=World(rng.uniform(0, 2, (4, 8, 3)).astype(np.float32)))


@given(seed=st.integers(0, 2**16), size=st.sampled_from([(1, 1), (7, 5), (1, 9), (13, 8)]), form=st.sampled_from(FORMS),
       projection=st.sampled_from([Projection.PERSPECTIVE, Projection.ORTHOGRAPHIC]),
       span=st.sampled_from([(1e-3, 1e6), (0.5, 2.0), (1e-6, 1e-3), (1e5, 1e6)]),
       radius=st.sampled_from([0.0, 1e-3, 1.0, 1e6]),
       lattice_px=st.sampled_from([1, 2, 8]), thickness=st.sampled_from([0.0, 1.0]))
def test_any_picture_gives_finite_light_that_is_never_negative(
        seed, size, form, projection, span, radius, lattice_px, thickness):
    rng = np.random.default_rng(seed)
    frame = wild_frame(rng, *size, projection, *span)
    direct = rng.choice([0.0, 1e-6, 1e6], (*size, 3)).astype(np.float32)
    result = light(frame, direct, form=form, radius_m=radius, lattice_px=lattice_px, thickness=thickness)
    for image in result.values():
        assert image.shape == (*size, 3) and image.dtype == np.float32
        assert np.isfinite(image).all() and (image >= 0).all()


@pytest.mark.parametrize("form", FORMS)
def test_a_picture_of_background_only_is_black(form):
    frame = wild_frame(np.random.default_rng(1), 5, 7, Projection.PERSPECTIVE, 1.0, 2.0)
    empty = np.full((5, 7), np.inf, np.float32)
    frame = dataclasses.replace(frame, gbuffer=dataclasses.replace(frame.gbuffer, depth=empty))
    result = compute_ssdo(frame, SsdoParams(form=form), Context(), 0)
    assert not any(image.any() for image in result.light.values()) and (result.visibility == 1).all()


@pytest.mark.parametrize("form", FORMS)
def test_a_camera_inside_an_object_or_cutting_one_renders(form):
    """Depths at the near plane beside far ones: the walls of a box around the camera, a hair away."""
    room = make_room_frame(20, 15, (), world_radiance=1.0, has_ceiling=True)
    g = room.gbuffer
    depth = g.depth.copy()
    depth[4:8] = 1e-6
    near = dataclasses.replace(g, depth=depth, position_ws=room.camera.positions_ws(depth))
    for gbuffer in (near, dataclasses.replace(near, normal_ws=-g.normal_ws)):
        for image in light(dataclasses.replace(room, gbuffer=gbuffer), np.ones_like(g.albedo), form=form).values():
            assert np.isfinite(image).all() and (image >= 0).all()
