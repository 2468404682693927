"""Voxel global illumination against slow float64 forms: rays, light pass, levels, cones, the whole gather."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from rtgi_addon.core.frame import Frame, Geometry, LightKind
from rtgi_addon.core.synthetic import box_triangles, make_room_frame
from rtgi_addon.core.techniques import VxgiParams
from rtgi_addon.kernels.vec3 import f32
from rtgi_addon.kernels.voxel_levels import CELLS_ACROSS, HOLDS, STEP, THIN, cast_cones
from rtgi_addon.kernels.voxel_rays import LIFT, cast_voxel_rays
from rtgi_addon.passes.base import Context, Transport
from rtgi_addon.passes.voxel_light import LitVoxels, levels_of, light_voxels
from rtgi_addon.passes.voxel_scene import Grid, VoxelScene, grid_of_frame, voxel_scene
from rtgi_addon.passes.vxgi import compute_vxgi
from tests.oracle import voxel_oracle as oracle
from tests.plane_frames import geometry_of, with_matt_views

RNG = np.random.default_rng(4)
QUANTA = 3e-4               # cells: planes are packed into 16 bits, a crossing at a slant shifts a few times their step


def boxes_scene() -> VoxelScene:
    """Two boxes, one turned, in a grid of 16x12x14 cells; flat faces, whose planes have no seams."""
    turned = box_triangles(np.full(3, -2.3), np.full(3, 2.1))
    angle = 0.6
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1.0]])
    geometry = geometry_of(box_triangles(np.array([1.2, 1.7, 0.4]), np.array([5.6, 4.9, 3.3])),
                           turned @ turn.T + [10.0, 6.5, 7.2])
    return voxel_scene(geometry, Grid((0.0, 0.0, 0.0), 1.0, (16, 12, 14)))


def rays(number: int) -> tuple[np.ndarray, np.ndarray]:
    origin = RNG.uniform((0, 0, 0), (16, 12, 14), (number, 3)).astype(np.float32)
    direction = RNG.normal(size=(number, 3))
    return origin, (direction / np.linalg.norm(direction, axis=1, keepdims=True)).astype(np.float32)


def random_light(scene: VoxelScene) -> LitVoxels:
    radiance = np.zeros((len(scene), 6, 5), np.float32)
    radiance[..., :3] = RNG.uniform(0, 2, (len(scene), 6, 3))
    return LitVoxels(radiance, np.zeros((0, 12), np.float32), np.zeros(3), np.zeros(3))


def test_first_surfaces_are_those_of_every_surface_asked():
    scene = boxes_scene()
    origin, direction = rays(400)
    t, row, side = cast_voxel_rays(scene.walk, origin, direction, np.zeros_like(origin), f32(1e6))
    pairs = zip(origin.astype(float), direction.astype(float), strict=True)
    wanted = [oracle.first_hit(scene.voxels, *ray) for ray in pairs]
    wrong = [i for i, (at, r, s) in enumerate(wanted)
             if (r, s) != (row[i], side[i] if r >= 0 else 0) and abs(at - t[i]) > QUANTA / 0.05]
    assert sum(r >= 0 for _, r, _ in wanted) > 40
    # of 400 rays a few graze an edge, within what packing moves it
    assert len(wrong) <= 4
    same = [i for i, (_, r, _) in enumerate(wanted) if r >= 0 and r == row[i]]
    assert np.median([abs(wanted[i][0] - t[i]) for i in same]) < QUANTA


def flux_over_area(frame: Frame, scene: VoxelScene, spread: int) -> np.ndarray:
    """(V, 6, 3) radiance of the sides: each texel's flux in spread^2 parts over its pixel's footprint, by camera rays."""
    (view,) = frame.views
    g, camera = view.gbuffer, view.camera
    reflected = view.incident_flux.astype(np.float64) * g.albedo
    sums = np.zeros((len(scene), 6, 3))
    columns, rows = camera.pixel_centres()
    step_x, step_y = camera.pixel_size
    eye, rotation = camera.position_ws, camera.world_from_view[:3, :3]
    within = (np.arange(spread) + 0.5) / spread - 0.5
    for i, j in np.argwhere(g.mask):
        n, p = g.normal_ws[i, j].astype(np.float64), g.position_ws[i, j].astype(np.float64)
        axis = int(np.argmax(np.abs(n)))
        for a in within:
            for b in within:
                ray = rotation @ [columns[j] + a * step_x, rows[i] + b * step_y, -1.0]
                point = eye + ray * (n @ (p - eye)) / (n @ ray)
                row = row_at(scene, point)
                row = row if row >= 0 else row_at(scene, p)
                sums[row, 2 * axis + int(n[axis] < 0)] += reflected[i, j] / spread**2
    area = scene.voxels.seen.astype(np.float64)[:, np.arange(6) // 2, None] * scene.grid.cell_m**2
    return np.where(area > 0, sums / (np.pi * np.maximum(area, 1e-30)), 0)


def row_at(scene: VoxelScene, point: np.ndarray) -> int:
    cell = np.floor((point - np.array(scene.grid.origin_ws)) / scene.grid.cell_m).astype(int)
    inside = (cell >= 0).all() and (cell < scene.grid.shape).all()
    return int(scene.voxels.index[tuple(cell)]) if inside else -1


def by_brick(scene: VoxelScene, radiance: np.ndarray) -> np.ndarray:
    """Power over pi of the sides, summed over bricks of 4x4x4 cells."""
    power = radiance * scene.voxels.seen[:, np.arange(6) // 2, None]
    out = np.zeros((*(-(-n // 4) for n in scene.grid.shape), 6, 3))
    np.add.at(out, tuple(scene.voxels.cells.T // 4), power)
    return out


@pytest.mark.parametrize(("width", "parts", "tolerance"), [(64, 4, 0.08), (20, 8, 0.15)])
def test_light_pass_sends_the_texels_flux_over_pi_and_area(width, parts, tolerance):
    # texels of half a voxel, and of one and a half; those at a silhouette have no neighbour to tell their size
    frame = with_matt_views(make_room_frame(width, width * 3 // 4, (LightKind.SPOT,), light_radius_m=0.0))
    scene = voxel_scene(frame.geometry, grid_of_frame(frame, Context(), 24))
    got, wanted = light_voxels(frame, scene, use_glossy=False).radiance[..., :3], flux_over_area(frame, scene, parts)
    assert wanted.max() > 0
    # parts are half a voxel apart, so a voxel gets one more or one less than its neighbour: a brick tells the level
    assert np.abs(by_brick(scene, got) - by_brick(scene, wanted)).sum() < tolerance * by_brick(scene, wanted).sum()
    assert np.isclose(by_brick(scene, got).sum(), by_brick(scene, wanted).sum(), rtol=1e-3)


def test_levels_equal_dense_ones_built_front_to_back():
    scene = boxes_scene()
    lit = random_light(scene)
    levels = levels_of(scene, lit)
    dense = oracle.dense_level0(scene.voxels, lit.radiance)
    for level in range(len(levels.shape)):
        nx, ny, nz = levels.shape[level]
        index = levels.index[levels.first[level]:levels.first[level] + nx * ny * nz].reshape(nx, ny, nz)
        assert dense[0].shape[:3] == (nx, ny, nz)
        assert np.array_equal(index >= 0, dense[0].any(-1))
        assert np.allclose(levels.coverage[index[index >= 0]], dense[0][index >= 0], atol=1e-5)
        assert np.allclose(levels.light[index[index >= 0]], dense[1][index >= 0], atol=1e-5)
        dense = oracle.parents(*dense)


@pytest.mark.parametrize("tangent", [0.02, 0.3, 1.0])
def test_cones_equal_cones_through_dense_levels(tangent):
    scene = boxes_scene()
    lit = random_light(scene)
    levels = [oracle.dense_level0(scene.voxels, lit.radiance)]
    while max(levels[-1][0].shape[:3]) > 1:
        levels.append(oracle.parents(*levels[-1]))
    origin, direction = rays(60)
    got = cast_cones(levels_of(scene, lit), origin, direction, f32(tangent))
    constants = [float(c) for c in (STEP, CELLS_ACROSS, THIN, HOLDS)]
    wanted = np.array([oracle.cone(levels, o.astype(float), d.astype(float), tangent, *constants)
                       for o, d in zip(origin, direction, strict=True)])
    assert np.ptp(wanted[:, 3]) > 0.5
    # float32 places of some hundred samples; near the top of the stretch a difference grows by a sixth
    assert np.abs(got - wanted).max() < 2e-3 and np.median(np.abs(got - wanted)) < 1e-5


def test_bounce_in_a_room_equals_its_integral_over_the_voxels():
    frame = make_room_frame(8, 6, (LightKind.SPOT,), light_radius_m=0.0)
    # views that light the voxels densely; the picture is small because the oracle asks every voxel for every ray
    dense = make_room_frame(96, 72, (LightKind.SPOT,), light_radius_m=0.0)
    frame = dataclasses.replace(frame, views=dense.views)
    params = VxgiParams(resolution=16, lattice_px=1, cones=1024, glossy_voxels=False)
    result = compute_vxgi(frame, params, Context(), 0)
    scene = voxel_scene(frame.geometry, grid_of_frame(frame, Context(), 16))
    lit = light_voxels(frame, scene, use_glossy=False)
    got, wanted = [], []
    for i, j in np.argwhere(frame.gbuffer.mask)[::7]:
        position = scene.grid.to_cells(frame.gbuffer.position_ws[i, j]).astype(float)
        wanted.append(oracle.irradiance(scene.voxels, lit.radiance, position, frame.gbuffer.normal_ws[i, j].astype(float),
                                        1024, float(LIFT)))
        got.append(result.light[Transport.BOUNCE_DIFFUSE][i, j])
    got, wanted = np.array(got), np.array(wanted)
    # 1024 directions each; with twice as many the oracle moves by up to 2 % of the brightest point
    assert np.abs(got - wanted).max() < 0.04 * wanted.max()
    assert np.isclose(got.mean(), wanted.mean(), rtol=0.02)


def test_oracle_itself_sees_a_wall_where_it_stands():
    wall = Geometry(np.array([[[2.3, -9, -9], [2.3, 9, -9], [2.3, 0, 30]]], np.float32), np.ones((1, 3, 3), np.float32),
                    np.zeros((1, 3), np.float32), np.zeros(1, np.int32))
    scene = voxel_scene(wall, Grid((0.0, 0.0, 0.0), 1.0, (4, 4, 4)))
    t, row, side = oracle.first_hit(scene.voxels, np.array([0.5, 1.5, 1.5]), np.array([1.0, 0.0, 0.0]))
    assert np.isclose(t, 1.8) and row >= 0 and side == 1
    assert oracle.first_hit(scene.voxels, np.array([0.5, 1.5, 1.5]), np.array([-1.0, 0.0, 0.0]))[1] == -1
