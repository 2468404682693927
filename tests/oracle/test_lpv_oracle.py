"""The kernels of light propagation volumes against their float64 forms, and the pass against the sum over all texels."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from rtgi_addon.core.frame import LightKind
from rtgi_addon.core.radiometry import texel_flux
from rtgi_addon.core.synthetic import ROOM_HIGH, ROOM_LOW, cast_view, make_room_frame
from rtgi_addon.core.techniques import LpvParams
from rtgi_addon.kernels import harmonics, ordinates
from rtgi_addon.kernels.bvh import build_bvh
from rtgi_addon.kernels.light_grid import LightGrid, open_grid
from rtgi_addon.passes.base import Context, Transport
from rtgi_addon.passes.lpv import compute_lpv
from rtgi_addon.passes.rsm import texel_table
from tests.oracle import lpv_oracle as oracle
from tests.oracle import rsm_oracle

FLOAT32 = 2e-5          # of the brightest: tens of float32 roundings and the oracle's own quadrature of the patches
SHAPE = (4, 5, 3)
NOTHING = build_bvh(np.zeros((0, 3, 3), np.float32))


def walled(rng, shape=SHAPE):
    """A grid with links that are open, closed or half open at random; those that lead out are open."""
    grid = open_grid(np.array([0.3, -0.2, 0.1]), 0.7, shape)
    for axis in range(3):
        inner = [slice(None)] * 3
        inner[axis] = slice(0, shape[axis] - 1)
        grid.links[(axis, *inner)] = rng.choice([0.0, 0.5, 1.0], grid.links[(axis, *inner)].shape, p=[0.3, 0.2, 0.5])
    return grid


def split(flux, shape, n):
    """(6, 3, n n, *shape) of the kernel's (6, cells, 3 n n), which is by quadrant, then colour."""
    by_quadrant = flux.reshape(6, *shape, 4, 3, n * n // 4)
    return np.moveaxis(by_quadrant.swapaxes(4, 5).reshape(6, *shape, 3, n * n), (4, 5), (1, 2))


# ---- directions ----
@pytest.mark.parametrize("n", [2, 4, 6])
def test_patches_of_directions_equal_their_integrals(n):
    direction, solid_angle = ordinates.ordinates(n)
    expected = oracle.face_set(n)
    # both are midpoint sums, of 32 and 64 points an edge
    assert np.allclose(direction, expected[0], atol=1e-4) and np.allclose(solid_angle, expected[1], rtol=1e-3)


@pytest.mark.parametrize("n", [2, 4, 6, 8])
def test_shares_of_a_step_equal_three_points_of_a_mean_and_a_variance(n):
    local, shares = ordinates.ordinates(n)[0], ordinates.step_weights(n)
    for d in range(n * n):
        for side in range(2):
            expected = np.zeros(5)
            for offset, share in oracle.side_shares(local[d], side).items():
                expected[offset + 2] = share
            assert np.allclose(shares[side, :5, d], expected, atol=1e-12)


@pytest.mark.parametrize("n", [2, 4])
@pytest.mark.parametrize("walls", [False, True])
def test_sweep_equals_light_that_is_moved_cell_by_cell(rng, n, walls):
    grid = walled(rng) if walls else open_grid(np.zeros(3), 1.0, SHAPE)
    flux = ordinates.empty_flux(n, SHAPE)
    flux[:] = rng.random(flux.shape) * (rng.random(flux.shape) < 0.2)
    before = split(flux.copy(), SHAPE, n).astype(np.float64)
    ordinates.sweep(flux, grid, n)
    after = split(flux, SHAPE, n)
    local = ordinates.ordinates(n)[0]
    for group, (axis, sign) in enumerate(oracle.AXES):
        for d in range(n * n):
            expected, left, ended = oracle.swept(before[group, 0, d], grid.links, local[d], axis, sign)
            assert np.allclose(after[group, 0, d], expected, atol=FLOAT32 * expected.max())
            assert math.isclose(left + ended, before[group, 0, d].sum(), rel_tol=1e-12)
            assert walls == (ended > 0)


@pytest.mark.parametrize("n", [2, 4])
def test_injected_light_equals_rays_to_the_next_plane(rng, n):
    shape, grid = (9, 8, 10), open_grid(np.array([-1.0, 2.0, 0.5]), 0.25, (9, 8, 10))
    for _ in range(6):
        place = rng.uniform(2.5, 5.5, 3)
        normal = rng.normal(size=3)
        normal /= np.linalg.norm(normal)
        table = np.zeros((17, 1), np.float32)
        table[0:3, 0], table[3:6, 0] = grid.low + (place + 0.5) * 0.25, normal
        table[6:9, 0], table[15] = (1.0, 2.0, 0.5), 2
        flux = ordinates.empty_flux(n, shape)
        ordinates.inject(flux, n, table, grid, NOTHING, 1e-5)
        expected = oracle.injected(place, normal, 1.0, n, shape)
        actual = split(flux, shape, n)
        # a ray that passes a centre by 1e-6 of a cell may be given to either side of it
        for colour, power in enumerate((1.0, 2.0, 0.5)):
            assert np.allclose(actual[:, colour], power * expected, atol=2e-4 * power * expected.max())
        assert flux.sum(dtype=np.float64) == pytest.approx(3.5, rel=1e-6)


@pytest.mark.parametrize("n", [2, 4])
def test_irradiance_follows_each_quadrant_back_to_the_planes_around_the_point(rng, n):
    shape, grid = (8, 9, 7), open_grid(np.array([-1.0, 0.5, 2.0]), 0.5, (8, 9, 7))
    flux = ordinates.empty_flux(n, shape)
    flux[:] = rng.random(flux.shape)
    light = split(flux, shape, n).astype(np.float64)
    place = rng.uniform(2, 4, (12, 3))
    normal = rng.normal(size=(12, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    actual = ordinates.irradiance(grid.low + (place + 0.5) * 0.5, normal, flux, grid, n, NOTHING, 1e-5)
    for colour in range(3):
        expected = [oracle.irradiance_at(light[:, colour], p, m, n, 0.5) for p, m in zip(place, normal, strict=True)]
        # the oracle's patches are by other midpoints
        assert np.allclose(actual[:, colour], expected, rtol=1e-3)


# ---- harmonics ----
@pytest.mark.parametrize("clamp", [False, True])
@pytest.mark.parametrize("walls", [False, True])
def test_a_step_of_harmonics_equals_the_paper(rng, clamp, walls):
    grid = walled(rng) if walls else open_grid(np.zeros(3), 1.0, SHAPE)
    state = rng.normal(size=(3, 4, *SHAPE)).astype(np.float32)
    state[:, :, 0, 0] = 0                                        # a row without light, which is passed over
    total, steps, _ = harmonics.propagate(state, grid, -np.inf, 1, clamp=clamp)
    assert steps == 1
    for colour in range(3):
        expected = state[colour] + oracle.propagated(state[colour].astype(np.float64), grid.links, clamp)
        assert np.allclose(total[colour], expected, atol=FLOAT32 * np.abs(expected).max())


def test_fuzzy_blockers_hold_back_light_from_the_second_step_on(rng):
    grid = open_grid(np.zeros(3), 1.0, SHAPE)
    state = rng.random((3, 4, *SHAPE)).astype(np.float32)
    fuzzy = (rng.random((3, 4, *SHAPE)) * 0.8).astype(np.float32)
    total, _, _ = harmonics.propagate(state, grid, -np.inf, 2, clamp=True, fuzzy=fuzzy)
    first = oracle.propagated(state[0].astype(np.float64), grid.links, True)
    second = oracle.propagated(first, grid.links, True, fuzzy.astype(np.float64))
    assert np.allclose(total[0], state[0] + first + second, atol=FLOAT32 * total.max())


def test_geometry_volume_of_one_surfel_is_its_area_around_the_nearest_corner():
    grid = open_grid(np.array([1.0, 0.0, -1.0]), 0.5, (4, 4, 4))
    normal, area = np.array([[0.0, 0.6, 0.8]]), np.array([0.05])
    place = grid.low + np.array([[1.0, 1.0, 1.0]]) + 0.1         # nearest to the corner between cells 1 and 2 on all sides
    blocked = harmonics.fuzzy_blockers(grid, [(place, normal, area), (place, normal, area / 2)])
    expected = area[0] / 0.25 * oracle.lobe(-normal[0]) / 4      # a face has four corners
    for axis in range(3):
        held = np.argwhere(blocked[axis, 0])
        assert len(held) == 4 and set(held[:, axis]) == {1}      # between cells 1 and 2, on four faces around the corner
        assert np.allclose(blocked[axis][:, 1, 1, 1], expected, rtol=1e-5)


def test_injected_harmonics_are_cosine_lobes_half_a_cell_off_the_surface():
    grid = open_grid(np.zeros(3), 1.0, (4, 4, 4))
    normal = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    state = harmonics.inject(grid, np.array([[1.5, 1.5, 1.8], [1.5, 1.5, 1.8]]), normal, np.array([[1.0, 2, 3], [1, 0, 0]]))
    # the first is pushed to z = 2.3, the second to 1.3
    assert np.allclose(state[1, :, 1, 1, 2], 2 / math.pi * oracle.lobe(normal[0]), rtol=1e-5)
    assert np.allclose(state[0, :, 1, 1, 1], 1 / math.pi * oracle.lobe(normal[1]), rtol=1e-5)
    assert np.count_nonzero(state[:, 0]) == 4


@pytest.mark.parametrize(("by_sight", "scale"), [(False, 1.0), (True, harmonics.READOUT)])
def test_irradiance_of_harmonics_is_the_lobe_towards_the_surface(rng, by_sight, scale):
    grid = LightGrid(np.zeros(3, np.float32), np.float32(0.5), np.ones((3, 5, 5, 5), np.float32))
    coefficients = np.array([3.0, *rng.uniform(-0.5, 0.5, 3)])
    total = np.broadcast_to(coefficients[None, :, None, None, None], (3, 4, 5, 5, 5)).astype(np.float32)
    normal = rng.normal(size=(5, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    actual = harmonics.irradiance(np.full((5, 3), 1.2), normal, total, grid, NOTHING, 1e-5, by_sight=by_sight, damps=False)
    expected = [4 / 0.25 * scale * coefficients @ oracle.lobe(-m) for m in normal]
    assert np.allclose(actual[:, 2], expected, rtol=1e-4)


# ---- the pass ----
def empty_room(kind):
    """The room without the box in it: convex, so that the sum over texels needs no visibility."""
    room = make_room_frame(48, 36, (kind,), light_radius_m=0.0)
    keep = np.ones(len(room.geometry), bool)
    keep[12:] = False
    geometry = dataclasses.replace(room.geometry, **{name: getattr(room.geometry, name)[keep]
                                                     for name in ("corners_ws", "albedo", "emission", "material")})
    assert np.allclose(geometry.bounds_ws, (ROOM_LOW, ROOM_HIGH))
    eye = dataclasses.replace(room.views[0].camera, width_px=96, height_px=96)
    view = dataclasses.replace(room.views[0], camera=eye, gbuffer=cast_view(eye, geometry),
                               incident_flux=texel_flux(room.lights[0], eye))
    return dataclasses.replace(room, geometry=geometry, gbuffer=cast_view(room.camera, geometry), views=(view,))


# Mean error over the mean light. Directions: what is left of the cell's size, 0.13 m of 4, and of 96 directions. The others
# are here to be seen: the published form is wrong by more than the light itself.
@pytest.mark.parametrize(("mode", "low", "high"), [("ORDINATES", 0.0, 0.08), ("HARMONICS", 0.3, 2.0), ("PAPER", 0.5, 4.0)])
def test_light_in_an_empty_room_against_the_sum_over_all_texels(mode, low, high):
    frame = empty_room(LightKind.SPOT)
    light = compute_lpv(frame, LpvParams(mode=mode, lattice_px=1, glossy_texels=False), Context(), 0).light
    g = frame.gbuffer
    points = g.mask & (np.arange(36)[:, None] % 2 == 0)
    expected = rsm_oracle.irradiance(g.position_ws[points], g.normal_ws[points], texel_table(frame, False))
    actual = light[Transport.BOUNCE_DIFFUSE][points]
    error = np.abs(actual - expected).sum() / expected.sum()
    assert low <= error <= high
    assert mode != "ORDINATES" or actual.sum() == pytest.approx(expected.sum(), rel=0.05)
