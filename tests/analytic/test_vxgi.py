"""Voxel global illumination against closed forms: furnaces, walls, a disk that shines, energy."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from rtgi_addon.core.frame import Cutouts, Geometry, LightKind
from rtgi_addon.core.synthetic import box_triangles, make_room_frame
from rtgi_addon.core.techniques import VxgiParams
from rtgi_addon.kernels.clusters import DIFFUSE
from rtgi_addon.kernels.vec3 import f32
from rtgi_addon.kernels.voxel_levels import cast_cones
from rtgi_addon.passes.base import Context, Transport
from rtgi_addon.passes.rsm import texel_table
from rtgi_addon.passes.voxel_light import levels_of, light_voxels, side_areas
from rtgi_addon.passes.voxel_scene import Grid, coverage_of, grid_of_frame, solid_cells, voxel_scene
from rtgi_addon.passes.vxgi import compute_vxgi
from tests.plane_frames import geometry_of, plane_frame, quad
from tests.voxel_rooms import EXACT, gathered, lit, medium, room

FURNACE = 0.02              # T29
WALL = 0.98                 # T30: opacity that a wall of one voxel keeps
SPHERE = np.array([(math.sqrt(1 - z * z) * math.cos(k * 2.4), math.sqrt(1 - z * z) * math.sin(k * 2.4), z)
                   for k, z in enumerate(np.linspace(-0.98, 0.98, 24))])
BOX = box_triangles(np.array([1.3, 1.6, 1.2]), np.array([22.7, 18.4, 14.6]))
METHODS = {"exact rays": EXACT, "cones": 0.0, "rays, then cones": 6.0}


def turned(triangles: np.ndarray, angle_rad: float, about: tuple[float, float]) -> np.ndarray:
    """Triangles turned about a line along z."""
    c, s, pivot = math.cos(angle_rad), math.sin(angle_rad), np.array([*about, 0.0])
    return (triangles - pivot) @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]]) + pivot


@pytest.mark.parametrize("method", METHODS)
def test_furnace_gives_one_for_every_normal(method):
    scene = room((24, 20, 16), BOX)
    got = gathered(scene, lit(scene), np.tile([11.0, 9.0, 8.0], (len(SPHERE), 1)), SPHERE, METHODS[method])
    assert np.abs(got - 1).max() < FURNACE


@pytest.mark.parametrize("method", METHODS)
def test_furnace_gives_one_on_its_walls(method):
    scene = room((24, 20, 16), BOX)
    points = np.array([(1.3, 9, 8), (22.7, 5, 3), (12, 1.6, 7), (12, 18.4, 7), (6, 6, 1.2), (6, 6, 14.6)])
    normals = np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1.0)])
    assert np.abs(gathered(scene, lit(scene), points, normals, METHODS[method]) - 1).max() < FURNACE


def test_furnace_gives_one_in_its_corners_to_a_thousandth():
    # exact rays hit what surrounds them also a hundredth of a voxel from an edge; none leaks between two walls
    box = BOX + [4.0, 6.0, 0.0]
    scene = room((32, 32, 16), turned(box, 0.3, (16, 16)))
    corner = turned(np.array([[(5.3, 7.6, 1.2), (26.7, 24.4, 14.6), (5.3, 24.4, 1.2)]]), 0.3, (16, 16))[0]
    middle = np.array([16.0, 16.0, 8.0])
    points = corner + 0.02 * (middle - corner) / np.linalg.norm(middle - corner, axis=1, keepdims=True)
    normals = np.tile([0.0, 0.0, 1.0], (3, 1)) * np.sign(8 - points[:, 2:])
    assert np.abs(gathered(scene, lit(scene), points, normals, cones=4096) - 1).max() < 1e-3


@pytest.mark.parametrize("method", METHODS)
def test_an_empty_grid_lets_all_of_the_sky_in(method):
    scene = room((8, 8, 8), quad((90.0, 90.0, 90.0), 1.0, 1.0))
    got = gathered(scene, lit(scene), np.tile([4.0, 4.0, 4.0], (len(SPHERE), 1)), SPHERE, METHODS[method], sky=1.0)
    assert np.abs(got - 1).max() < 1e-4


def test_half_of_the_sky_is_open_beside_a_high_wall():
    # V = 1/2 (1 + d / sqrt(d^2 + h^2)) for an endless wall of height h; 120 cells of width leave 1 % of it open
    wall = quad((0.0, 0.0, 0.0), 60.0, 60.0)[..., [2, 0, 1]] + [4.5, 64.0, 0.0]
    scene = room((32, 128, 64), wall)
    for distance in (0.3, 2.0, 6.0):
        point = np.array([[4.5 + distance, 64.0, 0.5]])
        got = gathered(scene, lit(scene, 0.0), point, np.array([[0, 0, 1.0]]), cones=4096, sky=1.0)[0]
        assert abs(got - 0.5 * (1 + distance / math.hypot(distance, 59.5))) < 0.01


@pytest.mark.parametrize("distance", [3, 6, 12, 24, 48, 96])
@pytest.mark.parametrize("tangent", [0.1, 0.3, 0.577])
@pytest.mark.parametrize("turn_rad", [0.0, 0.3, 0.7])
def test_a_wall_of_one_voxel_holds_at_every_distance(distance, tangent, turn_rad):
    wall = turned(quad((0.0, 0.0, 0.0), 300.0, 300.0)[..., [2, 0, 1]] + [100.3, 64.0, 64.0], turn_rad, (100.3, 64.0))
    scene = room((128, 128, 128), wall)
    for slant in (0.0, 0.4):
        d = np.array([math.cos(turn_rad + slant), math.sin(turn_rad + slant), 0.0])
        start = np.array([100.3, 64.0, 64.0]) - distance * d
        visibility = cast_cones(levels_of(scene, lit(scene)), start[None].astype(np.float32), d[None].astype(np.float32),
                                f32(tangent))[0, 3]
        # a cone that reaches beyond the grid's border finds no wall there
        if abs(start[1] - 64) + distance * tangent < 60:
            assert 1 - visibility >= WALL


@pytest.mark.parametrize("distance", [2, 7, 20, 60, 110])
def test_an_endless_shining_wall_has_its_radiance_at_every_distance(distance):
    scene = room((128, 64, 64), quad((0.0, 0.0, 0.0), 300.0, 300.0)[..., [2, 0, 1]] + [120.6, 32.0, 32.0])
    got = cast_cones(levels_of(scene, lit(scene, 3.0)), np.array([[120.6 - distance, 32.0, 32.0]], np.float32),
                     np.array([[1.0, 0.0, 0.0]], np.float32), f32(0.2))[0]
    assert abs(got[0] / 3.0 - 1) < FURNACE


@pytest.mark.parametrize("coverage", [0.01, 0.02])
def test_what_a_medium_lets_through_does_not_depend_on_levels_and_steps(coverage):
    # 16 layers of a share c each hide 16 c: coverages add up. Cones of other widths read other levels with other steps
    scene = medium((64, 64, 64), 40, 56, coverage)
    levels, d = levels_of(scene, lit(scene)), np.array([[0.0, 0.0, 1.0]], np.float32)
    for tangent in (0.01, 0.05, 0.1, 0.2):
        for start in (20.0, 20.37, 26.8):
            got = cast_cones(levels, np.array([[32.3, 31.8, start]], np.float32), d, f32(tangent))[0, 3]
            # where a cone goes from one level to the next, weights of its samples add up to 0.9 to 1.1
            assert abs((1 - got) / (16 * coverage) - 1) < 0.1


def test_no_light_comes_through_a_wall_thinner_than_a_voxel():
    # two rooms of 20x20x20 cells side by side, 0.3 of a cell between them, turned against the grid; all in one is lit
    one = box_triangles(np.full(3, 10.0), np.array([30.0, 30.0, 30.0]))
    other = box_triangles(np.array([30.3, 10.0, 10.0]), np.array([50.3, 30.0, 30.0]))
    scene = room((64, 64, 40), turned(np.concatenate([one, other]), 0.31, (32, 32)))
    voxels = scene.voxels
    # a side is lit if a point in front of it lies in the first room
    front = np.repeat(voxels.cells[:, None] + 0.5, 6, axis=1).astype(float)
    for side in range(6):
        front[:, side] += (1 if side % 2 == 0 else -1) * voxels.planes[:, side // 2, :3]
    place = turned(front.reshape(-1, 1, 3), -0.31, (32, 32)).reshape(front.shape)
    radiance = ((place > 9.5) & (place < [30.1, 30.5, 30.5])).all(-1) & (voxels.masks[:, [0, 0, 1, 1, 2, 2]] > 0)
    light = lit(scene, radiance)
    normal = np.array([math.cos(0.31), math.sin(0.31), 0.0])

    def seen(points: list[tuple[float, float, float]], n: np.ndarray) -> np.ndarray:
        places = turned(np.array([points]), 0.31, (32, 32))[0]
        return gathered(scene, light, places, np.tile(n, (len(points), 1)), cones=1024)

    for n in (normal, -normal):
        assert seen([(20.0, 20.0, 20.0), (29.0, 28.0, 28.0), (11.0, 20.0, 12.0)], n).min() > 0.97
        # what comes is from voxels whose floor lies in both rooms: a point a voxel off such a strip has most of it
        assert seen([(31.0, 20.0, 20.0), (40.0, 20.0, 20.0), (45.0, 29.9, 10.0)], n).max() < 0.01
        assert seen([(31.0, 12.0, 11.0), (32.0, 28.0, 29.0)], n).max() < 0.04
    assert seen([(30.3, 20.0, 20.0), (30.3, 10.2, 20.0)], normal).max() < 0.01


def shining_disk(radius: float, height: float, radiance: float) -> Geometry:
    """A floor of 8 m and a disk over it that shines: 48 triangles, as large as the circle."""
    angle = np.linspace(0, 2 * np.pi, 49)
    rim = np.stack([np.cos(angle), np.sin(angle), np.zeros(49)], 1) * radius
    rim /= math.sqrt(math.sin(2 * np.pi / 48) * 24 / np.pi)
    disk = np.array([[np.zeros(3), rim[i], rim[i + 1]] for i in range(48)]) + [0, 0, height]
    floor = quad((0, 0, 0), 4.0, 4.0)
    geometry = geometry_of(floor, disk)
    emission = np.zeros((len(geometry), 3), np.float32)
    emission[2:] = radiance
    return dataclasses.replace(geometry, emission=emission)


@pytest.mark.parametrize(("radius", "height"), [(1.0, 1.0), (0.5, 1.2), (0.08, 1.0)])
def test_light_of_a_disk_that_shines_is_its_form_factor(radius, height):
    # T1, under the middle: E = pi L R^2 / (R^2 + h^2); offset: T2. The last disk is as wide as one voxel.
    frame = plane_frame(width=17, height=17, half_m=1.0)
    frame = dataclasses.replace(frame, geometry=shining_disk(radius, height, 2.0))
    result = compute_vxgi(frame, VxgiParams(resolution=64, lattice_px=1, cones=1024), Context(), 0)
    assert not result.light[Transport.BOUNCE_DIFFUSE].any()
    got = result.light[Transport.EMISSION_DIFFUSE][..., 1]
    s = np.linalg.norm(frame.gbuffer.position_ws[..., :2], axis=-1).astype(float)
    wanted = math.pi * 2.0 * 0.5 * (1 + (radius**2 - height**2 - s**2)
                                    / np.sqrt((height**2 + s**2 + radius**2) ** 2 - 4 * radius**2 * s**2))
    assert abs(got.mean() / wanted.mean() - 1) < FURNACE
    assert np.sqrt(np.mean((got - wanted) ** 2)) < 0.05 * wanted.max()


def test_a_veil_lets_through_what_is_not_there_of_it():
    # a sheet of which 30 % are there over a black floor: 0.7 of the sky comes through, and 0.3 of what the sheet sends
    sheet = quad((8.0, 8.0, 6.4), 40.0, 40.0)
    cutouts = Cutouts(np.array([0, 1], np.int32), np.zeros((2, 3, 2), np.float32), np.full(2, 0.3, np.float32),
                      np.ones(2, bool), np.tile(np.int32([0, 1, 1]), (2, 1)), np.array([76], np.uint8))
    geometry = dataclasses.replace(geometry_of(sheet), cutouts=cutouts)
    scene = voxel_scene(geometry, Grid((0.0, 0.0, 0.0), 1.0, (16, 16, 8)))
    assert np.allclose(coverage_of(scene.voxels)[:, :, 6, 2], 0.3, atol=2e-3)
    # up to the grid's side the sheet is 8 cells wide to each side and 1.4 off
    point, up = np.array([[8.0, 8.0, 5.0]]), np.array([[0.0, 0.0, 1.0]])
    open_share = gathered(scene, lit(scene, 0.0), point, up, cones=4096, sky=1.0)[0]
    sent = gathered(scene, lit(scene, 1.0), point, up, cones=4096)[0]
    assert abs(open_share - 0.7) < 0.03 and abs(sent - 0.3) < 0.03      # a draw of 4096 rays, and 3 % pass by the sheet


@pytest.mark.parametrize("use_glossy", [False, True])
def test_light_pass_keeps_the_flux(use_glossy):
    frame = make_room_frame(64, 48, (LightKind.SPOT, LightKind.POINT), light_radius_m=0.0)
    scene = voxel_scene(frame.geometry, grid_of_frame(frame, Context(), 48))
    light = light_voxels(frame, scene, use_glossy)
    sent = math.pi * (light.radiance[..., :3].reshape(-1, 3) * side_areas(scene)[:, None]).sum(0, dtype=np.float64)
    caught = texel_table(frame, use_glossy)[DIFFUSE:DIFFUSE + 3].sum(1, dtype=np.float64)
    # what slivers of surfaces would have to send too brightly is left out, and counted
    assert (light.lost_w < 2e-3 * light.flux_w).all() and (len(light.lobes) > 0) == use_glossy
    if use_glossy:
        assert np.allclose(sent, caught, rtol=2e-3)
    else:
        assert np.allclose(sent + light.lost_w, caught, rtol=1e-4)      # float32 sums


def test_solid_cells_are_those_inside_bodies():
    frame = make_room_frame(48, 36)
    scene = voxel_scene(frame.geometry, grid_of_frame(frame, Context(), 48))
    solid = solid_cells(frame, scene)
    inside = np.argwhere(solid)
    centre = np.array(scene.grid.origin_ws) + (inside + 0.5) * scene.grid.cell_m
    # the box in the room, and nothing of the room
    assert len(inside) > 500
    assert (centre > np.array([-1.0, 0.2, 0.0])).all() and (centre < np.array([-0.1, 1.1, 1.4])).all()
