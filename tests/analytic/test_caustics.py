"""Light that a flat mirror throws is that of the lamp's image behind it: closed form for caustics."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from rtgi_addon.core.frame import Frame, Geometry, Light, LightKind, LightView, Material
from rtgi_addon.core.radiometry import texel_flux
from rtgi_addon.core.synthetic import box_triangles, cast_view
from rtgi_addon.core.techniques import RsmParams
from rtgi_addon.core.transforms import Camera, Projection
from rtgi_addon.kernels.jit import kernel_session
from rtgi_addon.kernels.photons import COUNTED, LEAF, NEIGHBOURS, _boxes_over, _nearest, make_photons
from rtgi_addon.passes.base import Context, Transport
from rtgi_addon.passes.rsm import compute_rsm
from tests.mirror_frames import camera_at
from tests.plane_frames import looking, quad

REFLECTANCE = np.array([0.8, 0.6, 0.4])
WALL_X = 1.5
LAMP = np.array([-2.0, 0.3, 2.0])
MATERIALS = (Material("mirror", (0.0, 0.0, 0.0), tuple(REFLECTANCE), 0.0),
             Material("wall", (0.5, 0.5, 0.5), (0.0, 0.0, 0.0), 1.0))
# standard deviation of photons placed at random: the kernel counts three quarters of a disk's
NOISE = 1 / math.sqrt(0.75 * NEIGHBOURS)
# of the mean over hundreds of pixels, which share photons: some ten disks
MEAN = NOISE / math.sqrt(10)
TOTAL = 0.01                # of a sum over the picture, which has 96 pixels a row: some are half lit


def mirror_and_wall(kind: LightKind, roughness: float = 0.0, **lamp) -> Frame:
    """A mirror of 1 m x 1 m on the floor, a wall behind it that the camera looks at, a lamp before it."""
    upright = np.array([[WALL_X, -4, 0], [WALL_X, 4, 0], [WALL_X, 4, 6], [WALL_X, -4, 6]])[[[0, 1, 2], [0, 2, 3]]]
    corners = np.concatenate([quad((0, 0, 0), 0.5, 0.5), upright]).astype(np.float32)
    geometry = Geometry(corners, np.zeros(corners.shape, np.float32), np.zeros((4, 3), np.float32), np.int32([0, 0, 1, 1]))
    materials = (dataclasses.replace(MATERIALS[0], roughness=roughness), MATERIALS[1])
    light = Light("lamp", kind, looking(LAMP, (0, 0, 0), (0, 0, 1)), np.array([3.0, 2.0, 1.0]), **lamp)
    half, projection = 0.4, Projection.PERSPECTIVE
    if kind is LightKind.SUN:
        half, projection = 1.0, Projection.ORTHOGRAPHIC
    edges, width = (-half, half, -half, half), 160
    if kind is LightKind.POINT:
        edges, projection, width = (-np.pi, np.pi, -np.pi / 2, np.pi / 2), Projection.EQUIRECTANGULAR, 1600
    eye = Camera(projection, light.world_from_light, width, width // 2 if kind is LightKind.POINT else width, *edges)
    view = LightView(0, eye, cast_view(eye, geometry, materials), texel_flux(light, eye))
    camera = camera_at((-3, 0, 1.6), (WALL_X, 0, 1.6), 96, 64, 2.4, Projection.ORTHOGRAPHIC)
    seen = cast_view(camera, geometry, materials)
    return Frame(camera, seen, (light,), (view,), geometry, materials)


def of_the_image(frame: Frame) -> np.ndarray:
    """(H, W, 3) W/m2 that the lamp's image behind the mirror sends through the mirror to each pixel."""
    light, p = frame.lights[0], frame.gbuffer.position_ws.astype(np.float64)
    image = LAMP * [1, 1, -1]
    if light.kind is LightKind.SUN:
        direction = np.broadcast_to(light.direction_ws * [1, 1, -1], p.shape)
        strength = direction[..., 0]
    else:
        direction = p - image
        distance = np.linalg.norm(direction, axis=-1, keepdims=True)
        direction = direction / distance
        strength = direction[..., 0] / distance[..., 0] ** 2
    through = p - direction * (p[..., 2:] / direction[..., 2:])
    is_lit = (np.abs(through[..., :2]) < 0.5).all(-1) & (np.abs(p[..., 0] - WALL_X) < 1e-3) & (direction[..., 2] > 0)
    return np.where(is_lit, strength, 0)[..., None] * light.power * REFLECTANCE


def bounce(frame: Frame, **params) -> np.ndarray:
    return compute_rsm(frame, RsmParams(**params), Context(), 0).light[Transport.BOUNCE_DIFFUSE]


def insides(lit: np.ndarray, margin_px: int) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) bool: pixels whose neighbourhood is lit, and those whose neighbourhood is dark."""
    near = [np.roll(lit, (i, j), (0, 1)) for i in range(-margin_px, margin_px + 1) for j in range(-margin_px, margin_px + 1)]
    return np.logical_and.reduce(near), ~np.logical_or.reduce(near)


@pytest.mark.parametrize("kind", [LightKind.SUN, LightKind.SPOT, LightKind.POINT])
def test_a_flat_mirror_shows_the_image_of_its_lamp(kind):
    frame = mirror_and_wall(kind)
    actual, expected = bounce(frame), of_the_image(frame)
    inner, outer = insides(expected[..., 0] > 0, 3)
    assert inner.sum() > 150
    assert actual[outer].max() == 0
    share = actual[inner] / expected[inner]
    assert share.mean() == pytest.approx(1, abs=MEAN)
    assert share.std() < NOISE
    assert actual.sum((0, 1), dtype=np.float64) == pytest.approx(expected.sum((0, 1)), rel=2 * TOTAL)


def test_a_soft_lamp_blurs_the_edge_and_keeps_the_light():
    hard, soft = (bounce(mirror_and_wall(LightKind.SUN, angle_rad=angle)) for angle in (0.0, 0.2))
    assert soft.sum(dtype=np.float64) == pytest.approx(hard.sum(dtype=np.float64), rel=2 * TOTAL)
    # the sun's image is 0.2 rad wide and 1.4 to 2.8 m away: half shadows of 0.28 m and more, pixels are 0.05 m
    edge = (hard[..., 0] > 0).sum(), (soft[..., 0] > 0).sum()
    assert edge[1] > 1.2 * edge[0]


@pytest.mark.parametrize("roughness", [0.0, 0.1, 0.22])
def test_all_light_of_the_lobe_arrives_in_a_closed_box(roughness):
    """What a mirror in a box sends off is what its walls get, however it is spread."""
    box = box_triangles(np.array([-2.0, -2.0, -0.01]), np.array([2.0, 2.0, 3.0]))
    corners = np.concatenate([quad((0, 0, 0), 0.5, 0.5), box]).astype(np.float32)
    material = np.int32([0, 0] + [1] * 12)
    geometry = Geometry(corners, np.zeros(corners.shape, np.float32), np.zeros((14, 3), np.float32), material)
    materials = (dataclasses.replace(MATERIALS[0], roughness=roughness), dataclasses.replace(MATERIALS[1], albedo=(0, 0, 0)))
    position = np.array([0.0, 0.0, 1.5])
    light = Light("lamp", LightKind.SPOT, looking(position, (0, 0, 0)), np.ones(3))
    eye = Camera(Projection.PERSPECTIVE, light.world_from_light, 128, 128, -0.5, 0.5, -0.5, 0.5)
    view = LightView(0, eye, cast_view(eye, geometry, materials), texel_flux(light, eye))
    # everything comes back to the ceiling or to the walls: an eye at the lamp sees all of both
    camera = Camera(Projection.PERSPECTIVE, looking(np.array([0, 0, 0.02]), (0, 0, 3)), 480, 480, -8, 8, -8, 8)
    frame = Frame(camera, cast_view(camera, geometry, materials), (light,), (view,), geometry, materials)
    tangent = 0.5 / position[2]                  # of half the mirror from the lamp
    sent = 4 * math.asin(tangent**2 / (1 + tangent**2)) * REFLECTANCE
    x, y = camera.pixel_centres()
    p, n = frame.gbuffer.position_ws.astype(np.float64), frame.gbuffer.normal_ws
    solid_angle = (camera.pixel_size[0] * camera.pixel_size[1]) / (1 + x[None]**2 + y[:, None]**2) ** 1.5
    towards = p - camera.position_ws
    distance2 = (towards**2).sum(-1)
    area = solid_angle * distance2 / np.maximum(-(towards * n).sum(-1) / np.sqrt(distance2), 1e-6)
    arrived = (bounce(frame).astype(np.float64) * area[..., None]).sum((0, 1))
    # the table of the lobe's albedos is good to 1 %, and pixels are coarse where they graze the walls
    assert arrived == pytest.approx(sent, rel=3 * TOTAL)


def test_more_photons_draw_a_sharper_edge():
    frame = mirror_and_wall(LightKind.SUN)
    lit = of_the_image(frame)[..., 0] > 0
    few, many = (insides(lit, 1)[1] & (bounce(frame, photons=number)[..., 0] > 0) for number in (2048, 131072))
    # the light that lies more than a pixel beyond the edge
    assert many.sum() < 0.2 * few.sum()


def test_without_photons_the_lobe_is_blurred():
    frame = mirror_and_wall(LightKind.SUN)
    dark = insides(of_the_image(frame)[..., 0] > 0, 3)[1]
    assert bounce(frame, photons=0)[dark].max() > 0


def test_the_same_bits_on_any_number_of_threads():
    frame, found = mirror_and_wall(LightKind.SPOT, roughness=0.1, radius_m=0.1), []
    for threads in (1, 2):
        with kernel_session(threads):
            found.append(bounce(frame))
    assert np.array_equal(*found)


def test_a_scene_without_mirrors_shoots_none():
    frame = mirror_and_wall(LightKind.SUN, roughness=0.5)
    assert compute_rsm(frame, RsmParams(), Context(), 0).diagnostics["photons"] == 0


@pytest.mark.parametrize("number", [3, 16, 17, 500])
def test_the_search_finds_the_nearest_photons(number):
    """Distances by the tree against all distances, in a flat cloud with a dense spot; half of it faces the other way."""
    rng = np.random.default_rng(number)
    found = make_photons(number)
    found.position[:] = rng.random((number, 3)) * [1, 1, 0.01]
    found.position[: number // 2] *= 0.1
    found.normal[:, 2] = np.where(np.arange(number) % 2 > 0, 1, -1)
    order, leaves = rng.permutation(number), 1 << max((number - 1) // LEAF, 0).bit_length()
    boxes, most2 = _boxes_over(order, found, leaves), np.float32(9)
    for at, k in enumerate(order):
        best = np.full(COUNTED, most2)
        actual = _nearest(at, order, boxes, leaves, found, best, np.empty(64, np.int64))
        distance2 = ((found.position.astype(np.float64) - found.position[k]) ** 2).sum(1)
        like = (found.normal[:, 2] == found.normal[k, 2]) & (np.arange(number) != k)
        assert actual == pytest.approx(np.sort([*distance2[like], *[most2] * COUNTED])[COUNTED - 1], rel=1e-5)


@pytest.mark.parametrize("photons", [1, 2, 9])
def test_a_handful_of_photons_is_no_error(photons):
    for kind in (LightKind.SUN, LightKind.POINT):
        light = bounce(mirror_and_wall(kind), photons=photons)
        assert np.isfinite(light).all() and (light >= 0).all()
