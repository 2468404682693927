"""Direct light against closed forms: each lamp above a plane, shadows of a square, grazing light at all scales."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from rtgi_addon.core.frame import Frame, Light, LightKind, LightView
from rtgi_addon.core.radiometry import texel_flux
from rtgi_addon.core.synthetic import cast_view
from rtgi_addon.core.techniques import DirectParams
from rtgi_addon.core.transforms import ViewFormat
from rtgi_addon.light_views import sphere_camera
from rtgi_addon.passes.base import Context, Transport
from rtgi_addon.passes.direct import compute_direct
from tests.mirror_frames import coarse_ball, shaded_smooth
from tests.plane_frames import frame_of, geometry_of, looking, plane_frame, quad, view_from

FLOAT32 = 2e-5          # a dozen roundings
DOWN = looking((0.0, 0.0, 2.0), (0.0, 0.0, 0.0))
WHITE = np.ones(3)
CENTRE = (16, 16)       # pixel of a plane frame that looks at (0, 0, 0)


def diffuse(frame, **params):
    return compute_direct(frame, DirectParams(**params), Context(), 0).light[Transport.DIRECT_DIFFUSE]


def glossy(frame, **params):
    return compute_direct(frame, DirectParams(**params), Context(), 0).light[Transport.DIRECT_GLOSSY]


def polished(frame, specular, roughness, f0=0.0):
    """`frame` with one glossy lobe everywhere."""
    shape, seen = frame.gbuffer.shape, frame.gbuffer
    return dataclasses.replace(frame, gbuffer=dataclasses.replace(
        seen, specular=np.full((*shape, 3), specular, np.float32), roughness=np.full(shape, roughness, np.float32),
        f0=np.full(shape, f0, np.float32)))


def test_point_light_gives_intensity_times_cosine_over_distance_squared():
    frame = plane_frame(Light("Point", LightKind.POINT, DOWN, 5 * WHITE))
    p = frame.gbuffer.position_ws.astype(float)
    to = np.array([0, 0, 2.0]) - p
    r = np.linalg.norm(to, axis=-1)
    np.testing.assert_allclose(diffuse(frame), np.repeat((5 * to[..., 2] / r**3)[..., None], 3, -1), rtol=FLOAT32)


def test_sun_gives_irradiance_times_cosine_everywhere():
    tilted = looking((1.0, 0.0, 1.0), (0.0, 0.0, 0.0))
    frame = plane_frame(Light("Sun", LightKind.SUN, tilted, 3 * WHITE, angle_rad=0.01))
    np.testing.assert_allclose(diffuse(frame), 3 * np.sqrt(0.5), rtol=1e-4)     # the disk widens the cosine by angle^2 / 8


def test_rectangle_above_its_centre_gives_the_form_factor_of_a_parallel_rectangle():
    light = Light("Area", LightKind.RECTANGLE, DOWN, 7 * WHITE, size_x_m=1.0, size_y_m=3.0)
    a, b = 0.5 / 2, 1.5 / 2
    # four corners of the configuration factor of a parallel rectangle (Howell, C-4)
    u, v = np.hypot(1, a), np.hypot(1, b)
    factor = 4 / (2 * np.pi) * (a / u * np.arctan(b / u) + b / v * np.arctan(a / v))
    np.testing.assert_allclose(diffuse(plane_frame(light))[CENTRE], 7 * np.pi * factor, rtol=FLOAT32)


def test_round_area_light_above_its_centre_gives_the_sine_squared_of_its_cone():
    light = Light("Area", LightKind.DISK, DOWN, 7 * WHITE, size_x_m=2.0, size_y_m=2.0)
    # pi L sin^2; the polygon of 16 sides and equal area is off by less than 0.1 %
    np.testing.assert_allclose(diffuse(plane_frame(light))[CENTRE], 7 * np.pi * 1 / (1 + 4), rtol=1e-3)


def test_area_light_gives_nothing_behind_its_back():
    light = Light("Area", LightKind.RECTANGLE, looking((0, 0, 2.0), (0, 0, 3.0)), 7 * WHITE, size_x_m=1.0, size_y_m=1.0)
    assert not diffuse(plane_frame(light)).any()


def test_area_light_that_stands_upright_is_cut_at_the_horizon():
    # a vertical square whose lower half is under the floor's plane lights the floor as its upper half does alone
    up = (0, 0, 1.0)
    whole = Light("Area", LightKind.RECTANGLE, looking((0, 3.0, 0), (0, 0, 0), up), WHITE, size_x_m=2.0, size_y_m=2.0)
    upper = dataclasses.replace(whole, world_from_light=looking((0, 3.0, 0.5), (0, 0, 0.5), up), size_y_m=1.0)
    got = [diffuse(dataclasses.replace(plane_frame(light), geometry=None))[CENTRE] for light in (whole, upper)]
    np.testing.assert_allclose(got[0], got[1], rtol=1e-4)


def test_sphere_light_gives_intensity_over_distance_squared_at_any_radius():
    # a sphere of even radiance seen from outside lights a facing plane as its centre does
    light = Light("Point", LightKind.POINT, DOWN, 5 * WHITE, radius_m=0.8, is_sphere=True)
    np.testing.assert_allclose(diffuse(plane_frame(light))[CENTRE], 5 / 4, rtol=2e-3)   # four-point rule


def test_disk_that_turns_to_the_receiver_gives_slightly_less_than_a_point():
    light = Light("Point", LightKind.POINT, DOWN, 5 * WHITE, radius_m=0.4)
    # pi L sin^2 of its cone, with L = I / (pi r^2)
    np.testing.assert_allclose(diffuse(plane_frame(light))[CENTRE], 5 / (4 + 0.16), rtol=1e-3)


@pytest.mark.parametrize("radius_m", [0.002, 0.012, 0.05, 0.19])
@pytest.mark.parametrize("is_sphere", [False, True])
@pytest.mark.parametrize("specular", [0.0, 0.04, 0.9])
def test_small_round_lamp_gives_its_closed_form_at_every_pixel_whatever_the_lobe(radius_m, is_sphere, specular):
    light = Light("Point", LightKind.POINT, DOWN, 5 * WHITE, radius_m=radius_m, is_sphere=is_sphere)
    frame = polished(plane_frame(light), specular, 0.6)
    to = np.array([0, 0, 2.0]) - frame.gbuffer.position_ws.astype(float)
    r = np.linalg.norm(to, axis=-1)
    # a disk that faces the point has pi L sin^2 of its cone times the cosine of its centre, L = I / (pi radius^2)
    wanted = 5 * to[..., 2] / r / (r**2 + (0 if is_sphere else radius_m**2))
    np.testing.assert_allclose(diffuse(dataclasses.replace(frame, geometry=None))[..., 0], wanted, rtol=2 * FLOAT32)


def test_sun_that_half_sets_leaves_the_part_of_its_disk_above_the_horizon():
    light = Light("Sun", LightKind.SUN, looking((1.0, 0, 0), (0, 0, 0), (0, 0, 1.0)), WHITE, angle_rad=0.2)
    frame = dataclasses.replace(plane_frame(light), geometry=None)
    # the mean sine of elevation of half a cone over the whole; a narrow cone is a disk of radius 0.1: 2 / (3 pi) 0.1
    np.testing.assert_allclose(diffuse(frame)[CENTRE], 2 / (3 * np.pi) * 0.1, rtol=2e-3)


@pytest.mark.parametrize("blend", [0.0, 0.3, 1.0])
def test_spot_falls_off_as_the_smoothstep_of_the_cosine(blend):
    light = Light("Spot", LightKind.SPOT, DOWN, 5 * WHITE, spot_size_rad=np.radians(60), spot_blend=blend)
    frame = plane_frame(light)
    to = np.array([0, 0, 2.0]) - frame.gbuffer.position_ws.astype(float)
    r = np.linalg.norm(to, axis=-1)
    edge = np.cos(np.radians(30))
    t = np.clip((to[..., 2] / r - edge) / max((1 - edge) * blend, 1e-6), 0, 1)
    expected = 5 * t * t * (3 - 2 * t) * to[..., 2] / r**3
    # near the edge the falloff grows as t^2 and a rounding of the cosine shows
    np.testing.assert_allclose(diffuse(frame)[..., 0], expected, rtol=FLOAT32, atol=2e-6)


def shadow_frame(kind, map_px, **shape):
    """A square of 0.6 m hangs 1 m above the floor, under a lamp at 2 m; only the floor's pixels are looked at."""
    floor, blocker = quad((0, 0, 0), 8, 8), quad((0.1, 0, 1), 0.3, 0.3)
    light = Light("Lamp", kind, DOWN, WHITE, **shape)
    camera = view_from((0, 0, 3), (0, 0, 0), 0.5, 64, 64)
    both = geometry_of(floor, blocker)
    seen = cast_view(camera, geometry_of(floor))
    return frame_of(both, seen, camera, light, map_px=map_px)


@pytest.mark.parametrize("map_px", [0, 16, 64])
def test_hard_shadow_of_a_square_is_exact_at_every_pixel(map_px):
    frame = shadow_frame(LightKind.SPOT, map_px, spot_size_rad=2.5)
    p = frame.gbuffer.position_ws
    # from 2 m through the square at 1 m: its shadow on the floor has twice its size and offset
    inside = (np.abs(p[..., 0] - 0.2) < 0.6) & (np.abs(p[..., 1]) < 0.6)
    np.testing.assert_array_equal(diffuse(frame)[..., 0] == 0, inside)


@pytest.mark.parametrize("map_px", [0, 48])
def test_half_shadow_of_a_square_grows_linearly_with_the_sun_disk_uncovered(map_px):
    frame = shadow_frame(LightKind.SUN, map_px, angle_rad=0.3)
    p = frame.gbuffer.position_ws
    row = np.abs(p[..., 1]) < 0.05
    # along the middle row only the edges x = -0.2 and x = 0.4 matter; the sun's disk is 0.15 m wide at 1 m
    a = np.clip(np.maximum(p[..., 0] - 0.4, -0.2 - p[..., 0]) / np.tan(0.15), -1, 1)
    share = 0.5 + (a * np.sqrt(1 - a * a) + np.arcsin(a)) / np.pi
    bare = diffuse(dataclasses.replace(frame, geometry=None, views=()))
    got = diffuse(frame, soft_shadow_rays=1024)[..., 0] / bare[..., 0]
    # 1024 stratified rays: 1/2 % of noise; two rays beside agreeing neighbours miss up to 2 % at the half shadow's edges
    np.testing.assert_allclose(got[row], share[row], atol=0.025)


def test_half_shadow_of_a_long_lamp_passes_under_what_its_centre_sees():
    """A table under a lamp of five metres: light of the lamp's ends reaches what the table hides from its centre."""
    floor, table = quad((0, 0, 0), 8, 8), quad((0.1, 0, 0.3), 0.8, 0.6)
    light = Light("Lamp", LightKind.RECTANGLE, DOWN, WHITE, size_x_m=5.0, size_y_m=0.35)
    both, camera = geometry_of(floor, table), view_from((0, 0, 3), (0, 0, 0), 0.5, 96, 96)
    eye = sphere_camera(light, ViewFormat(32768))
    view = LightView(0, eye, cast_view(eye, both), texel_flux(light, eye))
    frame = Frame(camera, cast_view(camera, geometry_of(floor)), (light,), (view,), both)
    wanted, got = (diffuse(frame, soft_shadow_rays=256, exact_shadows=exact)[..., 0] for exact in (True, False))
    assert wanted.min() < 0.3 * wanted.max()
    # 256 stratified rays both times, and what neighbours settle; the map's word for it was off by a twelfth
    assert np.abs(got - wanted).sum() < 0.02 * wanted.sum()
    assert got.sum() == pytest.approx(wanted.sum(), rel=0.005)


def test_coarse_smooth_ball_is_lit_wherever_its_shading_normal_sees_the_sun():
    ball, normals = coarse_ball((0.0, 0.0, 0.0), 1.0, 10)
    smooth = shaded_smooth(geometry_of(ball), normals)
    camera = view_from((0, 3, 0), (0, 0, 0), 0.4, 96, 96, up=(0.0, 0.0, 1.0))
    seen = cast_view(camera, smooth)
    radial = seen.position_ws / np.maximum(np.linalg.norm(seen.position_ws, axis=-1, keepdims=True), 1e-9)
    seen = dataclasses.replace(seen, normal_ws=radial.astype(np.float32))
    sun = Light("Sun", LightKind.SUN, looking((1.0, 0.6, 0.4), (0.0, 0.0, 0.0)), WHITE, angle_rad=0.0)
    sees_sun = seen.mask & (seen.normal_ws @ -sun.direction_ws > 0.1)
    lit, facets = (compute_direct(Frame(camera, seen, (sun,), (), geometry), DirectParams(), Context()).visibility[sees_sun]
                   for geometry in (smooth, dataclasses.replace(smooth, normals_ws=None)))
    assert (lit == 1).all()
    assert facets.mean() < 0.995                 # flat triangles turn away from the sun before the ball does


def test_half_shadow_on_a_matt_surface_seen_straight_on_is_finite():
    """Without a lobe there is no reflectance at normal incidence to divide by."""
    floor, table = quad((0, 0, 0), 2, 2), quad((0.5, 0, 1), 0.5, 2)
    light = Light("Lamp", LightKind.RECTANGLE, DOWN, WHITE, size_x_m=1.0, size_y_m=1.0)
    camera = view_from((0, 0, 0.9), (0, 0, 0), 0.02, 9, 9)
    frame = Frame(camera, cast_view(camera, geometry_of(floor)), (light,), (), geometry_of(floor, table))
    result = compute_direct(frame, DirectParams(), Context())
    assert result.visibility.min() > 0 and result.visibility.max() < 1
    assert all(np.isfinite(light).all() for light in result.light.values())


def test_light_through_a_gap_that_shows_a_sliver_of_the_lamp_arrives():
    """A screen with a gap that lets a twentieth of the lamp through: no few rays to chosen places find it."""
    floor = quad((0, 0, 0), 2, 2)
    left, right = (quad((sign * 2.0125, 0, 1), 2, 3) for sign in (-1, 1))
    light = Light("Lamp", LightKind.RECTANGLE, DOWN, WHITE, size_x_m=1.0, size_y_m=1.0)
    both, camera = geometry_of(floor, left, right), view_from((0, 0, 0.9), (0, 0, 0), 0.5, 48, 48)
    frame = Frame(camera, cast_view(camera, geometry_of(floor)), (light,), (), both)
    wanted, got = (diffuse(frame, soft_shadow_rays=256, exact_shadows=exact)[..., 0] for exact in (True, False))
    assert 0 < wanted.max() < 0.1 * diffuse(dataclasses.replace(frame, geometry=None)).max()
    # where each of four neighbours has the same share by 256 rays, that share is 0 or 1, and two rays hold it
    assert got.sum() == pytest.approx(wanted.sum(), rel=0.01)


def test_tail_of_a_narrow_lobe_shows_a_thin_lamp_without_grain():
    light = Light("Lamp", LightKind.RECTANGLE, DOWN, WHITE, size_x_m=5.0, size_y_m=0.05)
    frame = plane_frame(light)
    g = frame.gbuffer
    g.roughness[:], g.specular[:] = 0.2, 0.5
    one, other = (compute_direct(frame, DirectParams(), Context(), seed).light[Transport.DIRECT_GLOSSY][..., 0]
                  for seed in (0, 1))
    tail = (one + other > 1e-3 * (one + other).max()) & (one + other < 0.1 * (one + other).max())
    assert tail.sum() > 30
    # with rays of the lobe alone, most of which miss the lamp, it was more than a half
    assert np.median(np.abs(one - other)[tail] / (one + other)[tail]) < 0.15


@pytest.mark.parametrize("kind", [LightKind.POINT, LightKind.SPOT, LightKind.SUN])
@pytest.mark.parametrize("map_px", [0, 64])
def test_lamp_without_shadow_shines_through(kind, map_px):
    frame = shadow_frame(kind, map_px)
    frame = dataclasses.replace(frame, lights=(dataclasses.replace(frame.lights[0], casts_shadow=False),))
    assert (diffuse(frame)[..., 0] > 0).all()


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e4])
@pytest.mark.parametrize("map_px", [0, 96])
@pytest.mark.parametrize("elevation_degrees", [1.0, 5.0, 40.0])
def test_plane_in_grazing_light_shows_no_acne(scale, map_px, elevation_degrees):
    floor = geometry_of(quad((0.0, 0.0, 0.0), scale, scale))
    e = np.radians(elevation_degrees)
    lamp = looking(scale * np.array([np.cos(e), 0.1, np.sin(e)]), (0, 0, 0), (0, 0, 1.0))
    light = Light("Sun", LightKind.SUN, lamp, WHITE)
    camera = view_from(scale * np.array([-1.5, 0.2, 0.3]), (0, 0, 0), 0.5, 64, 36, (0, 0, 1.0))
    frame = frame_of(floor, cast_view(camera, floor), camera, light, map_px=map_px, map_half=1.5 * scale)
    seen = frame.gbuffer.mask
    np.testing.assert_allclose(diffuse(frame)[seen], np.dot(lamp[:3, 2], [0, 0, 1]), rtol=1e-4)


@pytest.mark.parametrize("where", [(1e3, -2e3, 50.0), (2e4, 1e4, 0.0)])
def test_plane_far_from_the_origin_shows_no_acne(where):
    where = np.array(where)
    floor = geometry_of(quad(tuple(where), 5, 5))
    light = Light("Point", LightKind.POINT, looking(where + [1, 1, 2.0], where), WHITE)
    camera = view_from(where + np.array([-3, 0.2, 1.0]), where, 0.5, 48, 27, (0, 0, 1.0))
    frame = frame_of(floor, cast_view(camera, floor), camera, light)
    lit, bare = diffuse(frame), diffuse(dataclasses.replace(frame, geometry=None))
    np.testing.assert_array_equal(lit, bare)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e4])
def test_shadow_touches_the_foot_of_what_casts_it(scale):
    # a wall stands on the floor; light from its far side leaves the floor dark right up to the wall
    floor = quad((0, 0, 0), scale, scale)
    wall = scale * np.array([[[0, -1, 0], [0, 1, 0], [0, 1, 1]], [[0, -1, 0], [0, 1, 1], [0, -1, 1.0]]])
    both = geometry_of(floor, wall)
    light = Light("Sun", LightKind.SUN, looking((1.0, 0, 1.0), (0, 0, 0)), WHITE)
    camera = view_from(scale * np.array([-0.01, 0.0, 0.05]), scale * np.array([-0.01, 0, 0]), 0.2, 64, 64)
    frame = frame_of(both, cast_view(camera, geometry_of(floor)), camera, light)
    x = frame.gbuffer.position_ws[..., 0]
    assert (diffuse(frame)[x < -1e-4 * scale] == 0).all()


def test_glossy_lobe_of_a_broad_highlight_carries_the_known_reflectance():
    # summed over all directions of the light the lobe gives the reflectance: a furnace of many suns
    from rtgi_addon.core.transforms import normalized

    frame = plane_frame(width=3, height=3)
    steps, suns = 20, []
    for i in range(steps):
        for j in range(2 * steps):
            z, phi = (i + 0.5) / steps, (j + 0.5) / steps * np.pi
            r = np.sqrt(1 - z * z)
            d = normalized(np.array([r * np.cos(phi), r * np.sin(phi), z]))
            place = looking(d, (0, 0, 0), (0.3, 0.1, 0.9))
            suns.append(Light(f"Sun{i}.{j}", LightKind.SUN, place, WHITE * np.pi / steps**2))
    furnace = dataclasses.replace(polished(frame, 0.6, 0.7), lights=tuple(suns), geometry=None)
    np.testing.assert_allclose(glossy(furnace)[1, 1], 0.6, rtol=0.03)      # 800 suns and a table of 32 cells


def test_surface_without_gloss_sends_none():
    frame = plane_frame(Light("Point", LightKind.POINT, DOWN, WHITE))
    assert not glossy(frame).any()


@pytest.mark.parametrize(("kind", "shape"), [
    (LightKind.RECTANGLE, {"size_x_m": 1.6, "size_y_m": 0.9}), (LightKind.DISK, {"size_x_m": 0.6, "size_y_m": 0.6}),
    (LightKind.POINT, {"radius_m": 0.25}), (LightKind.POINT, {"radius_m": 0.25, "is_sphere": True}),
    (LightKind.SUN, {"angle_rad": 0.3})])
def test_mirror_shows_the_lamps_own_radiance_inside_its_outline_and_nothing_beside_it(kind, shape):
    # the camera looks straight down beside the lamp, and each pixel's mirror direction meets the lamp or does not
    light = Light("Lamp", kind, DOWN, 7 * WHITE, **shape)
    frame = polished(plane_frame(light), 1.0, 0.01)
    shown = glossy(frame)[..., 0]
    radius = shape.get("radius_m", 0)
    radiance = {LightKind.POINT: 7 / (np.pi * radius**2) if radius else 0,
                LightKind.SUN: 7 / (np.pi * np.sin(0.15) ** 2)}.get(kind, 7.0)
    lit = shown > 0.5 * radiance
    assert 4 < lit.sum() < lit.size / 2
    np.testing.assert_allclose(shown[lit], radiance, rtol=2e-3)
    np.testing.assert_allclose(shown[~lit], 0, atol=1e-3 * radiance)


def test_lobe_of_a_known_material_is_that_of_its_reflectance_at_normal_incidence():
    bare = plane_frame(Light("Point", LightKind.POINT, DOWN, 5 * WHITE, radius_m=0.1))
    told, flat, rising = (glossy(polished(bare, 0.3, 0.5, f0))[CENTRE][0] for f0 in (0.0, 1.0, 0.02))
    # straight back a surface without Fresnel sends what its colour says; one of 2 % sends less, and more at grazing
    assert flat > rising > 0
    assert told == pytest.approx(glossy(polished(bare, 0.3, 0.5, 0.3))[CENTRE][0], rel=0.03)    # 0.3 at normal incidence
