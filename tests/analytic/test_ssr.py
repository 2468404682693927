"""Reflections against what geometry says: mirrors, even light, blur that grows with distance."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from rtgi_addon.core.frame import Frame, Geometry, Light, LightKind, Material, World
from rtgi_addon.core.synthetic import cast_view, make_room_frame, nearest_hit
from rtgi_addon.core.techniques import SsrParams
from rtgi_addon.core.transforms import Camera, Projection
from rtgi_addon.passes.base import Context, Transport
from rtgi_addon.passes.ssr import compute_ssr
from tests.mirror_frames import (
    camera_at,
    coarse_ball,
    glossy,
    lit,
    on_floor,
    painted,
    pixel_places,
    room_from_above,
    scene_frame,
    shaded_smooth,
    wall,
)
from tests.plane_frames import geometry_of, quad

HALF_PIXEL = 0.5
CAMERAS = {"perspective": {}, "shifted": {"shift": (0.25, -0.2)},
           "orthographic": {"projection": Projection.ORTHOGRAPHIC, "half": 2.2}}


def reflected(frame, context, **params):
    return compute_ssr(frame, SsrParams(**params), context, 0).light[Transport.BOUNCE_GLOSSY]


def hall(camera: Camera):
    """A floor, a wall across and one to the side, a slab that stands free."""
    side = wall((-1.0, 1.0), 0.0, (0.0, 2.0))[..., [1, 0, 2]] - [2.0, -2.0, 0.0]
    meshes = (quad((0, 1, 0), 6, 6), wall((-4, 4), 3.0, (0, 2.5)), side, wall((0.2, 0.7), 1.4, (0.0, 0.9)))
    geometry = geometry_of(*meshes)
    return scene_frame(camera, geometry), geometry


def mirrored(camera: Camera) -> Camera:
    """The camera's mirror image in the plane z = 0, left-handed, so that each pixel looks where its mirror ray goes."""
    flip = np.diag([1.0, 1.0, -1.0, 1.0])
    return dataclasses.replace(camera, world_from_view=flip @ camera.world_from_view)


@pytest.mark.parametrize("method", ["HIERARCHY", "DDA"])
@pytest.mark.parametrize("kind", CAMERAS)
def test_mirror_shows_what_the_mirrored_camera_sees_to_half_a_pixel(kind, method):
    camera = camera_at((0.4, -2.5, 1.3), (0.0, 1.5, 0.5), 160, 120, **CAMERAS[kind])
    frame, geometry = hall(camera)
    mirror = on_floor(frame)
    frame = glossy(frame, mirror, 0.0)
    got = reflected(frame, painted(frame, pixel_places(frame)), method=method, edge_fade=0.0, fallback="WORLD",
                    thickness=0.002)

    # what the mirrored camera sees of everything but the floor, as places in the camera's own picture
    above = Geometry(*(a[2:] for a in (geometry.corners_ws, geometry.albedo, geometry.emission, geometry.material)))
    seen = cast_view(mirrored(camera), above, frame.materials)
    column, row, depth = camera.project(seen.position_ws.astype(np.float64))
    inside = seen.mask & mirror & (depth > 0)
    height, width = frame.gbuffer.shape
    inside &= (column > 1) & (row > 1) & (column < width - 1) & (row < height - 1)
    # valid where the camera sees the same point: what it sees there lies on the mirrored point's plane
    at = (np.clip(row, 0, height - 1).astype(int), np.clip(column, 0, width - 1).astype(int))
    there, normal = frame.gbuffer.position_ws[at], frame.gbuffer.normal_ws[at]
    apart = np.abs(((seen.position_ws - there) * normal).sum(-1))
    valid = inside & (apart < 1e-3) & (np.abs((seen.normal_ws * normal).sum(-1)) > 0.99)
    assert valid.sum() > 1500
    near = np.hypot(got[..., 0] - column, got[..., 1] - row)[valid] < HALF_PIXEL
    assert near.mean() >= 0.99


def test_hits_lie_where_the_mirror_ray_meets_the_plane():
    # a wall that fills what is reflected: t = -(n . (o - p)) / (n . d)
    camera = camera_at((0.3, -1.0, 1.2), (0.1, 2.0, 0.4), 96, 64)
    frame = scene_frame(camera, geometry_of(quad((0, 0, 0), 30, 30), wall((-20, 20), 3.0, (0, 30))))
    frame = glossy(frame, on_floor(frame), 0.0)
    got = reflected(frame, painted(frame, pixel_places(frame)), edge_fade=0.0, fallback="WORLD")
    floor = on_floor(frame)
    p = frame.gbuffer.position_ws[floor].astype(np.float64)
    d = p - camera.position_ws
    d[:, 2] *= -1
    hit = p + d * ((3.0 - p[:, 1]) / d[:, 1])[:, None]
    column, row, _ = camera.project(hit)
    # not between a pixel of the floor and one of the wall, where the nearest of the wall stands for the place
    foot = np.argmax(on_floor(frame)[:, 48])
    inside = (row > 1) & (row < foot - 1) & (column > 1) & (column < 95)
    error = np.hypot(got[floor][:, 0] - column, got[floor][:, 1] - row)[inside]
    assert inside.sum() > 500 and np.quantile(error, 0.99) < 0.02     # the plane of a pixel is exact on a plane


@pytest.mark.parametrize("roughness", [0.0, 0.1, 0.3, 0.6, 1.0])
def test_even_world_comes_back_as_glossy_color_times_its_radiance(roughness):
    frame = scene_frame(camera_at((0, -2, 1.0), (0, 1, 0.0), 40, 30), geometry_of(quad((0, 1, 0), 50, 50)))
    world = World(np.full((1, 1, 3), 2.0, np.float32))
    frame = dataclasses.replace(glossy(frame, on_floor(frame), roughness, 0.3), world=world)
    result = compute_ssr(frame, SsrParams(), Context(), 0)
    floor = on_floor(frame)
    # a few roundings of float32; at the edge of a sum of 16 rays
    np.testing.assert_allclose(result.light[Transport.WORLD_GLOSSY][floor], 0.6, rtol=1e-5)
    assert not result.light[Transport.BOUNCE_GLOSSY].any()


def edge_width(roughness: float, distance_m: float) -> float:
    """Width in m, on the floor at a distance from a wall, over which the reflection of the wall's side edge rises."""
    camera = camera_at((0.0, -2.5, 1.0), (0.0, 2.0, 0.6), 160, 120, half=0.7)
    frame = scene_frame(camera, geometry_of(quad((0, 0, 0), 40, 40), wall((-20, 0), 2.0, (0, 1.6))))
    floor = on_floor(frame)
    shine = np.where((frame.gbuffer.normal_ws[..., 1] < -0.9)[..., None], 1.0, 0.0) * np.ones(3)
    got = reflected(glossy(frame, floor, roughness), painted(frame, shine), samples=1024, fallback="WORLD")[..., 0]
    p = frame.gbuffer.position_ws
    row = np.argmin(np.abs(np.where(floor, p[..., 1], 99.0).mean(1) - (2.0 - distance_m)))
    x, y = p[row, :, 0], got[row]
    x, y = x[x > -1.0], y[x > -1.0]               # from the wall's middle on, over its edge at 0
    share = y / y[:5].mean()
    last, first = np.interp([0.25, 0.75], share[::-1], x[::-1])
    return float(last - first)


def test_reflection_hardens_towards_the_contact():
    near, far = edge_width(0.3, 0.2), edge_width(0.3, 1.6)
    assert far > 2.5 * near               # eight times the distance; near the wall a pixel, 1.8 cm, is most of the width


def test_rougher_floor_blurs_more_and_a_mirror_not_at_all():
    mirror, polished, rough = (edge_width(r, 1.2) for r in (0.0, 0.2, 0.4))
    assert mirror < 0.02                  # one pixel of the floor is 1.7 cm wide there
    assert 3 * mirror < polished and 2 * polished < rough


def test_highlight_on_a_rough_floor_is_longer_than_wide():
    # a small bright square on a wall; on the floor its blurred image stretches towards the viewer
    camera = camera_at((0.0, -3.0, 0.7), (0.0, 1.0, 0.2), 160, 120, half=0.5)
    frame = scene_frame(camera, geometry_of(quad((0, 0, 0), 40, 40), wall((-20, 20), 2.0, (0, 20))))
    p, floor = frame.gbuffer.position_ws, on_floor(frame)
    spot = (np.abs(p[..., 0]) < 0.06) & (np.abs(p[..., 2] - 0.35) < 0.06) & ~floor
    got = reflected(glossy(frame, floor, 0.35), painted(frame, spot[..., None] * np.ones(3)), samples=2048,
                    fallback="WORLD")[..., 0].astype(np.float64)
    weight = np.where(floor, got, 0)
    footprint = np.where(floor, np.linalg.norm(p - camera.position_ws, axis=-1) ** 3, 0)       # area of a pixel on the floor
    weight = weight * footprint
    mean = [(weight * p[..., k]).sum() / weight.sum() for k in (0, 1)]
    across, along = (np.sqrt((weight * (p[..., k] - mean[k]) ** 2).sum() / weight.sum()) for k in (0, 1))
    assert along > 1.5 * across


def test_ray_that_leaves_the_frame_is_lit_by_the_scene_and_not_black():
    frame = room_from_above(48, 36)               # the frame cuts the walls that the floor reflects
    floor = on_floor(frame)
    frame = glossy(frame, floor, 0.0)
    context = lit(frame)
    exact = reflected(frame, context, method="TRIANGLES")[floor]
    with_rays, alone = (reflected(frame, context, method="HIERARCHY", fallback=f)[floor] for f in ("RAYS", "WORLD"))
    assert alone.sum() < 0.85 * exact.sum()
    assert abs(with_rays.sum() / exact.sum() - 1) < 0.02
    assert (with_rays.max(-1) > 0).mean() > 0.9 * (exact.max(-1) > 0).mean()


def test_hits_fade_smoothly_into_what_lies_beyond_the_frame():
    # the picture says 1, the triangles, lit by no lamp, say 0: the seam is spread over the edge of the frame
    camera = camera_at((0.0, -2.0, 1.0), (0.0, 1.0, -0.1), 96, 96, half=0.5)
    frame = scene_frame(camera, geometry_of(quad((0, 0, 0), 40, 40), wall((-20, 20), 2.0, (0, 20))))
    frame = glossy(frame, on_floor(frame), 0.0)
    steps = []
    for fade in (0.0, 0.25):
        column = reflected(frame, painted(frame, np.ones((96, 96, 3))), edge_fade=fade)[:, 48, 0]
        column = column[on_floor(frame)[:, 48]]
        assert column.max() > 0.99 and column.min() < 0.01
        steps.append(np.abs(np.diff(column)).max())
    assert steps[0] > 0.9 and steps[1] < 0.3


def test_mirror_in_a_room_equals_rays_through_its_triangles():
    # each pixel's mirror ray, traced in float64, and the direct light of the pixel that shows its hit
    frame = make_room_frame(64, 48)
    floor = on_floor(frame)
    frame = glossy(frame, floor, 0.0)
    context = lit(frame)
    got = reflected(frame, context, edge_fade=0.0)
    p = frame.gbuffer.position_ws[floor].astype(np.float64)
    d = p - frame.camera.position_ws
    d[:, 2] *= -1
    t, _ = nearest_hit(p + [0, 0, 1e-6], d, frame.geometry.corners_ws)
    column, row, _ = frame.camera.project(p + t[:, None] * d)
    inside = (column > 1) & (row > 1) & (column < 63) & (row < 47)
    light = context.light[Transport.DIRECT_DIFFUSE] * frame.gbuffer.albedo / np.pi
    expected = light[row[inside].astype(int), column[inside].astype(int)]
    error = np.abs(got[floor][inside] - expected).sum(-1)
    # nearest pixels against interpolated ones: shadow edges and creases differ, nothing else
    assert np.median(error) < 0.02 * expected.sum(-1).mean() and error.mean() < 0.1 * expected.sum(-1).mean()


@pytest.mark.parametrize("roughness", [0.0, 0.2, 0.5])
def test_mirror_in_a_mirror_shows_the_world(roughness):
    # a mirror floor before a wide, high metal wall under an even world: whatever the wall's lobe, what it turns upwards
    # is the world's radiance, and what it turns downwards meets the floor, which sends no light of its own
    camera = camera_at((0, -2, 1.0), (0, 1, 0.0), 40, 30)
    meshes = (quad((0, 0, 0), 30, 30), wall((-200, 200), 3.0, (0, 200)))
    geometry = geometry_of(*meshes)
    geometry = dataclasses.replace(geometry, material=np.repeat(np.int32([0, 1]), [len(mesh) for mesh in meshes]),
                                   albedo=np.zeros_like(geometry.albedo))
    materials = (Material("floor", (0, 0, 0), (1, 1, 1), 0.0), Material("wall", (0, 0, 0), (1, 1, 1), roughness))
    frame = dataclasses.replace(scene_frame(camera, geometry, materials=materials),
                                world=World(np.full((1, 1, 3), 2.0, np.float32)))
    floor = on_floor(frame)
    light = compute_ssr(frame, SsrParams(), Context(), 0).light[Transport.BOUNCE_GLOSSY][floor]
    if roughness == 0:
        np.testing.assert_allclose(light, 2.0, rtol=1e-4)        # one ray each, and float32
    else:
        # what the widest lobe turns downwards is less than half of it
        assert (0.55 if roughness > 0.3 else 0.95) < light.mean() / 2 < 1.01


def test_dim_lobes_bring_the_world_in_the_mean_by_fewer_rays():
    camera = camera_at((0, -2, 1.0), (0, 1, 0.0), 120, 90)
    meshes = (quad((0, 0, 0), 30, 30), wall((-200, 200), 3.0, (0, 200)))
    geometry = geometry_of(*meshes)
    geometry = dataclasses.replace(geometry, material=np.repeat(np.int32([0, 1]), [len(mesh) for mesh in meshes]),
                                   albedo=np.zeros_like(geometry.albedo))
    f0, world = 0.06, World(np.ones((1, 1, 3), np.float32))
    materials = (Material("floor", (0, 0, 0), (1, 1, 1), 0.0), Material("wall", (0, 0, 0), (f0, f0, f0), 0.1, f0=f0))
    frame = dataclasses.replace(scene_frame(camera, geometry, materials=materials), world=world)
    floor = on_floor(frame)
    light = compute_ssr(frame, SsrParams(), Context(), 0).light[Transport.BOUNCE_GLOSSY][floor].mean(-1)
    d = frame.gbuffer.position_ws[floor].astype(np.float64) - camera.position_ws
    cosine = d[:, 1] / np.linalg.norm(d, axis=1)     # of the ray and the wall
    # Schlick's reflectance of a nearly sharp lobe, to the table's few percent and the scatter of 1 in 2 rays
    # `specular` is the material's mean over all directions, in which the rise towards grazing has its share
    mean_rise = 2 / 42                               # of 2 (1 - c)^5 c over the cosines
    expected = (f0 + (1 - f0) * (1 - cosine) ** 5) * f0 / (f0 + (1 - f0) * mean_rise)
    assert light.mean() == pytest.approx(expected.mean(), rel=0.1)


def ball_over_a_mirror(power: float = 1.0, **lamp) -> tuple[Frame, np.ndarray]:
    """A floor, above it and out of the picture a ball of 16 by 8 facets, by a sun from the side; normals at the corners."""
    ball, normals = coarse_ball((0.0, 1.0, 2.2), 0.9)
    geometry = geometry_of(quad((0, 0, 0), 6, 6), ball)
    camera = camera_at((0.0, -2.5, 1.6), (0.0, -0.6, 0.0), 64, 48, half=0.45)
    down = np.array([[1.0, 0, 0, 0], [0, 0.6, -0.8, 0], [0, 0.8, 0.6, 0], [0, 0, 0, 1]])      # along -Z: (0, 0.8, -0.6)
    sun = Light("Sun", LightKind.SUN, down, np.full(3, power), **lamp)
    frame = scene_frame(camera, geometry, sun)
    return glossy(frame, on_floor(frame), 0.0), np.concatenate([np.zeros((2, 3, 3)), normals])


def mirrored_hits(frame: Frame) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Of the floor's mirror rays in float64: which meet the ball (N,) bool, and of these the triangle, barycentric weights
    (n, 3) of its corners and the unit direction of the ray."""
    p = frame.gbuffer.position_ws[on_floor(frame)].astype(np.float64)
    d = p - frame.camera.position_ws
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    d[:, 2] *= -1
    corners = frame.geometry.corners_ws.astype(np.float64)
    t, triangle = nearest_hit(p + [0, 0, 1e-6], d, corners)
    on_ball = triangle >= 2
    place, (a, b, c) = (p + np.where(on_ball, t, 0)[:, None] * d)[on_ball], np.moveaxis(corners[triangle[on_ball]], 1, 0)
    whole = np.cross(b - a, c - a)
    shares = [np.einsum("ij,ij->i", np.cross(y - place, z - place), whole) for y, z in ((b, c), (c, a), (a, b))]
    return on_ball, triangle[on_ball], np.stack(shares, 1) / np.square(whole).sum(1, keepdims=True), d[on_ball]


def test_a_mirror_shows_a_smooth_ball_lit_by_its_shading_normals():
    # a sun that casts no shadow: albedo / pi * E * (n . l), of each mirror ray's hit in float64
    frame, normals = ball_over_a_mirror(casts_shadow=False)
    smooth = dataclasses.replace(frame, geometry=shaded_smooth(frame.geometry, normals))
    on_ball, triangle, weights, d = mirrored_hits(frame)
    n = np.einsum("ic,icv->iv", weights, normals[triangle])
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    facing = -(n * d).sum(1) > 0.02
    expected = 0.5 / np.pi * np.maximum(n @ -frame.lights[0].direction_ws, 0)
    got, flat = (reflected(f, Context())[on_floor(frame)][on_ball, 0] for f in (smooth, frame))
    assert facing.sum() > 400 and facing.mean() > 0.98
    # normals in 16 bits and the places of hits in float32
    np.testing.assert_allclose(got[facing], expected[facing], atol=2e-4 * expected.max())
    assert np.abs(flat - expected)[facing].mean() > 0.05 * expected.mean()


def test_a_ball_turned_inside_out_is_the_same_from_outside():
    # the winding the other way round, and normals with it, as of a mirrored object
    frame, normals = ball_over_a_mirror()
    smooth = dataclasses.replace(frame, geometry=shaded_smooth(frame.geometry, normals))
    turned = shaded_smooth(dataclasses.replace(frame.geometry, corners_ws=np.ascontiguousarray(
        frame.geometry.corners_ws[:, ::-1])), -normals[:, ::-1])
    a, b = (reflected(f, Context()) for f in (smooth, dataclasses.replace(frame, geometry=turned)))
    # a ray may pass an edge between two triangles on the other side
    assert a.any() and np.isclose(a, b, atol=1e-4 * a.max()).all(-1).mean() > 0.995


def test_light_from_below_a_sheet_does_not_reach_it_though_its_normals_lean_to_the_lamp():
    # a sheet of 32 by 32 squares that faces the mirror, lit from behind; its normals lean towards the lamp
    frame, _ = ball_over_a_mirror()
    steps = -3 + (np.arange(32) + 0.5) * 6 / 32
    sheet = np.concatenate([quad((x, 1.0 + y, 2.2), 3 / 32, 3 / 32) for x in steps for y in steps])
    lean = np.broadcast_to(np.array([0.0, -0.995, -0.0999]), (2 + len(sheet), 3, 3)).copy()
    lean[:2] = 0
    geometry = shaded_smooth(geometry_of(quad((0, 0, 0), 6, 6), sheet[:, ::-1]), lean)
    frame = dataclasses.replace(frame, geometry=geometry)
    assert (lean[2, 0] @ -frame.lights[0].direction_ws) > 0.5
    bare = dataclasses.replace(frame, lights=tuple(dataclasses.replace(x, casts_shadow=False) for x in frame.lights))
    # rays that begin above a smooth-shaded triangle meet the next one, but for those at the sheet's edge, a row of 32 or two
    assert reflected(frame, Context()).sum() < 0.07 * reflected(bare, Context()).sum()


def test_an_even_sky_lights_a_smooth_ball_as_a_flat_one():
    # whatever the normals, half of a surface's surroundings is sky, less what its rays lose below the facets
    frame, normals = ball_over_a_mirror(power=0.0)
    frame = dataclasses.replace(frame, world=World(np.ones((1, 1, 3), np.float32)))
    ball = np.arange(len(normals)) >= 2
    geometry = dataclasses.replace(frame.geometry, albedo=np.where(ball[:, None, None], frame.geometry.albedo, 0))
    smooth = shaded_smooth(geometry, normals)
    on_ball, *_ = mirrored_hits(frame)
    flat, got = (reflected(dataclasses.replace(frame, geometry=g), Context())[on_floor(frame)][on_ball].mean()
                 for g in (geometry, smooth))
    assert 0.95 * flat < got < 1.02 * flat
