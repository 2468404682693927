"""Laws that reflections keep exactly, or to rounding, and odd frames that must give a picture."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from rtgi_addon.core.frame import Frame, GBuffer, Geometry, LightKind, Material, World
from rtgi_addon.core.synthetic import make_room_frame
from rtgi_addon.core.techniques import SsrParams, default_settings
from rtgi_addon.core.transforms import Camera, Projection
from rtgi_addon.errors import Cancelled
from rtgi_addon.kernels.gloss_pixels import on_lattice
from rtgi_addon.kernels.jit import kernel_session
from rtgi_addon.passes.base import Context, Transport
from rtgi_addon.passes.ssr import compute_ssr, step_of_pixels
from rtgi_addon.planner import CapturePlan, plan_frame
from tests.mirror_frames import (
    camera_at,
    coarse_ball,
    glossy,
    lit,
    on_floor,
    painted,
    room_from_above,
    scene_frame,
    shaded_smooth,
    wall,
)
from tests.moved_frames import moved, turn
from tests.plane_frames import geometry_of, quad

ROUGHNESS = [0.0, 0.25, 0.6]
GLOSSY = (Transport.BOUNCE_GLOSSY, Transport.WORLD_GLOSSY)
METHODS = ["TRIANGLES", "HIERARCHY", "DDA", "LINEAR"]


def run(frame, context, seed=0, **params):
    return compute_ssr(frame, SsrParams(**params), context, seed)


def bounce(frame, context, seed=0, **params):
    return run(frame, context, seed, **params).light[Transport.BOUNCE_GLOSSY]


@pytest.fixture(scope="module")
def room():
    """A floor whose roughness rises from left to right, under a spot and an even sky."""
    frame = room_from_above(48, 36, (LightKind.SPOT,), light_radius_m=0.0, world_radiance=0.4)
    frame = glossy(frame, on_floor(frame), 0.0, 0.5)
    ramp = np.linspace(0, 1, 48, dtype=np.float32)[None] * np.ones((36, 1), np.float32)
    g = frame.gbuffer
    return dataclasses.replace(frame, gbuffer=dataclasses.replace(g, roughness=np.where(on_floor(frame), ramp, g.roughness)))


def brighter(context: Context, factor: float) -> Context:
    out = Context()
    out.light = {transport: np.float32(factor) * values for transport, values in context.light.items()}
    return out


@pytest.mark.parametrize("method", METHODS)
def test_reflections_are_linear_in_light(room, method):
    context = lit(room)
    twice = dataclasses.replace(room, world=World(2 * room.world.radiance),
                                lights=tuple(dataclasses.replace(x, power=2 * x.power) for x in room.lights))
    a, b = (run(f, c, method=method).light for f, c in ((room, context), (twice, brighter(context, 2))))
    for transport in GLOSSY:
        assert a[transport].any()
        np.testing.assert_array_equal(b[transport], 2 * a[transport])


def test_no_light_gives_exactly_nothing(room):
    dark = dataclasses.replace(room, lights=(), world=World())
    assert not any(image.any() for image in run(dark, Context()).light.values())


def test_only_the_floor_reflects(room):
    result = run(room, lit(room))
    for transport in GLOSSY:
        assert not result.light[transport][~on_floor(room)].any()


def test_hierarchy_and_every_pixel_give_the_same_bits(room):
    context = lit(room)
    for fallback in ("RAYS", "WORLD"):
        a, b = (run(room, context, method=m, fallback=fallback) for m in ("HIERARCHY", "DDA"))
        for transport in GLOSSY:
            np.testing.assert_array_equal(a.light[transport], b.light[transport])
        assert a.diagnostics["steps"] < b.diagnostics["steps"]


def test_rays_through_the_picture_are_those_through_the_triangles(room):
    # what the picture shows is its pixels, what the triangles show is lit anew: shadow edges are a pixel wide here
    context = lit(room)
    a, b = (bounce(room, context, samples=256, edge_fade=0.0, method=method) for method in ("HIERARCHY", "TRIANGLES"))
    assert np.abs(a - b).sum() < 0.03 * b.sum()


def test_threads_do_not_change_a_bit(room):
    context = lit(room)
    for method in ("HIERARCHY", "TRIANGLES"):
        images = []
        for threads in (1, 2):
            with kernel_session(threads):
                images.append(run(room, context, method=method).light)
        for transport in GLOSSY:
            np.testing.assert_array_equal(images[0][transport], images[1][transport])


def test_seed_moves_the_noise_and_not_the_mirror(room):
    context = lit(room)
    a, b = (bounce(room, context, seed, edge_fade=0.0, fallback="WORLD") for seed in (0, 1))
    mirror = on_floor(room) & (room.gbuffer.roughness < 0.02)
    # GGX alpha 4e-4 moves a hit by less than a tenth of a pixel
    assert (a != b).any() and np.allclose(a[mirror], b[mirror], rtol=0.05, atol=1e-3)
    assert abs(a.sum() / b.sum() - 1) < 0.05


@pytest.mark.parametrize("scale", [1e-3, 8.0, 1e4])
def test_scaled_scene_reflects_the_same(room, scale):
    context = lit(room)
    got, expected = bounce(moved(room, np.eye(3), scale=scale), context), bounce(room, context)
    # positions are rounded anew: a ray may pass an edge on the other side, and a pixel be traced by itself
    assert np.isclose(got, expected, rtol=0.02, atol=0.01 * expected.max()).all(-1).mean() > 0.97


def test_moving_everything_changes_nothing(room):
    context = lit(room)
    constant = dataclasses.replace(room, world=World())
    got = bounce(moved(constant, turn((1, 2, 3), 1.1), np.array([3.0, -2.0, 1.0])), context, samples=256)
    expected = bounce(constant, context, samples=256)
    # the lobe's rays are drawn in a frame of tangents that turns too: the noise of 256 rays a block is another
    assert np.abs(got - expected).sum() < 0.06 * expected.sum()


def test_lattice_of_rough_pixels_holds_that_of_smooth_ones(room):
    step, _ = step_of_pixels(room, 4)
    traced = on_lattice(step)
    assert set(np.unique(step)) == {0, 1, 2, 4}
    assert traced[(step == 1)].all() and not traced[step == 0].any()
    assert (traced[::4, ::4] == (step[::4, ::4] > 0)).all()


def test_rougher_light_is_taken_over_where_the_picture_has_none(room):
    context = lit(room)
    cone = np.full_like(room.gbuffer.albedo, 3.0)
    context.light[Transport.BOUNCE_GLOSSY] = cone
    result = run(room, context, fallback="CONES")
    assert result.takes_over == {Transport.BOUNCE_GLOSSY}
    alone = bounce(room, context, fallback="WORLD")
    added = result.light[Transport.BOUNCE_GLOSSY] - alone
    floor = on_floor(room)
    # between nothing, where all rays hit in the picture, and all of the cone's light
    assert added[floor].min() > -1e-3 and added[floor].max() <= 3.0 + 1e-3 and added[floor].max() > 1.0


def test_cones_without_their_light_are_rays(room):
    context = lit(room)
    a, b = (run(room, context, fallback=f) for f in ("CONES", "RAYS"))
    np.testing.assert_array_equal(a.light[Transport.BOUNCE_GLOSSY], b.light[Transport.BOUNCE_GLOSSY])
    assert not a.takes_over


def test_emission_in_a_mirror_is_light_without_a_bounce():
    shine = Material("panel", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 1.0, (2.0, 1.0, 0.5))
    matt = Material("matt", (0.5, 0.5, 0.5), (0.0, 0.0, 0.0), 1.0)
    geometry = geometry_of(quad((0, 0, 0), 20, 20), wall((-9, 9), 2.0, (0, 9)))
    emission = np.repeat([[0, 0, 0], [2.0, 1.0, 0.5]], 2, 0).astype(np.float32)
    geometry = dataclasses.replace(geometry, emission=emission, material=np.int32([0, 0, 1, 1]))
    frame = scene_frame(camera_at((0, -2, 1.0), (0, 1, 0.1), 40, 30), geometry, materials=(matt, shine))
    frame = glossy(frame, on_floor(frame), 0.0, 0.4)
    light = run(frame, Context()).light
    assert not light[Transport.BOUNCE_GLOSSY].any()
    seen = light[Transport.WORLD_GLOSSY][on_floor(frame)]
    # in the picture and, for the rays that leave it, by the triangles
    np.testing.assert_allclose(seen, np.float32([[0.8, 0.4, 0.2]]).repeat(len(seen), 0), rtol=1e-5)


@pytest.mark.parametrize("method", ["TRIANGLES", "HIERARCHY"])
def test_triangles_that_are_all_flat_are_lit_as_without_normals(room, method):
    # by zeros, and by normals that have turned away from their triangles
    context = lit(room)
    expected = run(room, context, method=method).light
    a, b, c = np.moveaxis(room.geometry.corners_ws.astype(np.float64), 1, 0)
    away = np.repeat(np.cross(c - a, b - a)[:, None], 3, 1)
    for normals in (np.zeros_like(away), away / np.linalg.norm(away, axis=-1, keepdims=True)):
        flat = dataclasses.replace(room, geometry=shaded_smooth(room.geometry, normals))
        got = run(flat, context, method=method).light
        for transport in GLOSSY:
            np.testing.assert_array_equal(got[transport], expected[transport])


def test_flat_triangles_keep_their_light_beside_smooth_ones(room):
    # a smooth ball that no ray of the floor meets, and that stands in no light
    ball, normals = coarse_ball((0.0, 0.0, -50.0), 1.0)
    geometry, more = room.geometry, geometry_of(ball)
    both = Geometry(*(np.concatenate([getattr(geometry, name), getattr(more, name)])
                      for name in ("corners_ws", "albedo", "emission", "material")))
    normals = np.concatenate([np.zeros(geometry.corners_ws.shape), normals])
    context = lit(room)
    a, b = (run(dataclasses.replace(room, geometry=g), context).light for g in (both, shaded_smooth(both, normals)))
    for transport in GLOSSY:
        np.testing.assert_array_equal(a[transport], b[transport])


def test_normals_of_triangles_in_any_direction_give_a_picture(rng):
    frame = all_mirrors(make_room_frame(24, 18, tuple(LightKind), world_radiance=0.5), 0.2)
    normals = rng.normal(size=frame.geometry.corners_ws.shape)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    geometry = shaded_smooth(frame.geometry, normals)
    context = lit(frame)
    for around in (geometry, dataclasses.replace(geometry, normals_ws=np.full_like(geometry.normals_ws, -32768))):
        assert is_sound(run(dataclasses.replace(frame, geometry=around), context))


def test_planner_leaves_reflections_out_where_nothing_is_glossy():
    frame = make_room_frame(24, 16)
    g = frame.gbuffer
    matt = dataclasses.replace(frame, gbuffer=dataclasses.replace(g, specular=np.zeros_like(g.albedo)))
    plan = plan_frame(matt, default_settings(), CapturePlan())
    assert "ssr" not in plan.techniques
    assert dict(plan.left_out)["Screen-Space Reflections"] == "no surface in view is glossy"
    assert "ssr" in plan_frame(frame, default_settings(), CapturePlan()).techniques
    dark = dataclasses.replace(frame, lights=(), views=(), world=World())
    assert dict(plan_frame(dark, default_settings(), CapturePlan()).left_out)["Screen-Space Reflections"] == (
        "there is no light to reflect")


def test_cancelled_render_stops():
    frame = make_room_frame(16, 12)
    with pytest.raises(Cancelled):
        compute_ssr(glossy(frame, on_floor(frame), 0.0), SsrParams(), Context(lambda: True), 0)


def is_sound(result) -> bool:
    return all(v.dtype == np.float32 and np.isfinite(v).all() and (v >= 0).all() for v in result.light.values())


def all_mirrors(frame: Frame, roughness: float = 0.0) -> Frame:
    return glossy(frame, frame.gbuffer.mask, roughness)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("size", [(1, 1), (7, 5), (1, 9), (33, 2)])
def test_tiny_pictures_of_mirrors_give_a_picture(size, method):
    for roughness in (0.0, 0.5, 1.0):
        frame = all_mirrors(make_room_frame(*size), roughness)
        for fallback in ("RAYS", "WORLD"):
            result = run(frame, lit(frame), method=method, fallback=fallback)
            assert is_sound(result) and result.light[Transport.BOUNCE_GLOSSY].shape == (size[1], size[0], 3)


@pytest.mark.parametrize("roughness", [0.0, 0.5, 1.0])
def test_room_of_mirrors_gives_a_picture(roughness):
    frame = all_mirrors(make_room_frame(32, 24, tuple(LightKind), world_radiance=0.5), roughness)
    result = run(frame, lit(frame))
    assert is_sound(result) and result.light[Transport.BOUNCE_GLOSSY].any()


def test_frame_that_sees_nothing_stays_black():
    frame = all_mirrors(make_room_frame(16, 12))
    g = frame.gbuffer
    nothing = GBuffer(np.full(g.shape, np.inf, np.float32), np.zeros_like(g.albedo), np.zeros_like(g.albedo) + [0, 0, 1],
                      np.zeros_like(g.albedo), g.specular, g.roughness, g.emission)
    nothing = dataclasses.replace(nothing, normal_ws=nothing.normal_ws.astype(np.float32))
    result = run(dataclasses.replace(frame, gbuffer=nothing), Context())
    assert not any(image.any() for image in result.light.values())


def test_camera_inside_a_box_and_one_whose_near_plane_cuts_it_give_a_picture():
    for place in ((-0.5, 0.6, 0.7), (-0.5, 0.19999, 0.7)):        # inside the room's box, and on its front face
        room = make_room_frame(24, 18)
        camera = camera_at(place, (0.3, 1.9, 0.6), 24, 18)
        frame = all_mirrors(scene_frame(camera, room.geometry, *room.lights, materials=room.materials))
        assert is_sound(run(frame, lit(frame)))


def test_depths_from_a_millimetre_to_a_thousand_kilometres_give_a_picture():
    near, far = wall((-1e-3, -1e-4), 1e-3, (-1e-3, 1e-3)), wall((-2e6, 2e6), 1e6, (-2e6, 2e6))
    geometry = geometry_of(near, quad((0, 5e5, -1.0), 1e6, 5e5), far)
    frame = all_mirrors(scene_frame(camera_at((0, 0, 0), (0, 1, -0.2), 33, 25), geometry))
    for roughness in (0.0, 0.5):
        context = painted(frame, np.ones((25, 33, 3)))
        assert is_sound(run(all_mirrors(frame, roughness), context))


@pytest.mark.parametrize("tilt", [1.0, 1e-2, 1e-4, 1e-7])
def test_grazing_surfaces_give_a_picture(tilt):
    geometry = geometry_of(quad((0, 0, 0), 30, 30), wall((-9, 9), 9.0, (0, 4)))
    frame = scene_frame(camera_at((0, -2, tilt), (0, 9, 0.5), 40, 30), geometry)
    for roughness in ROUGHNESS:
        assert is_sound(run(all_mirrors(frame, roughness), painted(frame, np.ones((30, 40, 3)))))


def test_normals_that_are_zero_turned_away_or_not_finite_give_a_picture():
    frame = all_mirrors(make_room_frame(24, 18), 0.3)
    for normal in ((0, 0, 0), (0, 1, 0), (0, 0, -1), (np.nan, 0, 1)):
        image = np.broadcast_to(np.float32(normal), frame.gbuffer.albedo.shape).copy()
        odd = dataclasses.replace(frame, gbuffer=dataclasses.replace(frame.gbuffer, normal_ws=image))
        assert is_sound(run(odd, lit(frame)))


def test_frame_without_triangles_takes_the_world_for_what_it_does_not_see(room):
    bare = dataclasses.replace(room, geometry=None)
    result = run(bare, lit(bare))
    assert is_sound(result) and result.light[Transport.WORLD_GLOSSY].any()
    with_empty = dataclasses.replace(room, geometry=Geometry.empty())
    assert is_sound(run(with_empty, lit(bare)))


@pytest.mark.parametrize("projection", [Projection.PERSPECTIVE, Projection.ORTHOGRAPHIC])
def test_every_camera_sees_the_same_light_in_a_mirror(projection):
    # a wall that sends out 1 wherever it is looked at, and that fills what the floor reflects
    geometry = geometry_of(quad((0, 0, 0), 30, 30), wall((-30, 30), 4.0, (0, 60)))
    camera: Camera = camera_at((0, -3, 2.0), (0, 2, 0.6), 48, 36, half=0.5 if projection is Projection.PERSPECTIVE else 2.5,
                               projection=projection)
    frame = scene_frame(camera, geometry)
    frame = glossy(frame, on_floor(frame), 0.0)
    shine = np.where(frame.gbuffer.normal_ws[..., 1:2] < -0.9, 1.0, 0.0) * np.ones(3)
    got = bounce(frame, painted(frame, shine), edge_fade=0.0, fallback="WORLD")[on_floor(frame)]
    assert set(np.unique(got.round(3))) <= {0.0, 1.0} and got.mean() > 0.3
