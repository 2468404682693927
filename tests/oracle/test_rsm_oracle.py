"""The kernels of reflective shadow maps against their float64 form on random and on room frames."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from rtgi_addon.core.frame import LightKind
from rtgi_addon.core.synthetic import make_room_frame
from rtgi_addon.core.techniques import RsmParams
from rtgi_addon.kernels import vpl
from rtgi_addon.kernels.bvh import build_bvh
from rtgi_addon.kernels.clusters import cluster_texels
from rtgi_addon.kernels.gather import gather_visible
from rtgi_addon.kernels.sampling import r2_sequence, uniform
from rtgi_addon.passes import rsm
from rtgi_addon.passes.base import Context, Transport
from rtgi_addon.passes.rsm import MIN_DISTANCE2, compute_rsm, texel_table, texels_and_radii
from tests.oracle import rsm_oracle
from tests.plane_frames import with_matt_views

FLOAT32 = 2e-5          # hundreds of float32 roundings in a sum of positive terms
SHARP_LOBE = 2e-4       # float32 cancels digits of 1 - cos^2 at the peak of a lobe
WEAK = 1e-6             # of the brightest point: terms near a horizon lose digits, and this is what remains of them


def unit(rng, n):
    v = rng.normal(size=(n, 3))
    return (v / np.linalg.norm(v, axis=1, keepdims=True)).astype(np.float32)


def random_table(rng, n, glossy_share=0.0):
    table = np.zeros((17, n), np.float32)
    table[0:3], table[3:6] = rng.uniform(-1, 1, (3, n)), unit(rng, n).T
    table[6:9] = rng.random((3, n))
    to_light = unit(rng, n)
    to_light *= np.sign(np.sum(to_light * table[3:6].T, axis=1, keepdims=True))      # lit from the front
    table[9:12], table[15], table[16] = to_light.T, 2, 0.04
    glossy = rng.random(n) < glossy_share
    table[12:15, glossy] = rng.random((3, glossy.sum()))
    table[15, glossy], table[16, glossy] = rng.uniform(0.01, 1, glossy.sum()), rng.uniform(0.02, 1, glossy.sum())
    return table


def random_points(rng, n):
    return rng.uniform(-1, 1, (n, 3)).astype(np.float32), unit(rng, n)


def assert_close(actual, expected, relative):
    assert np.all(np.abs(actual - expected) <= relative * expected + WEAK * expected.max())


@pytest.mark.parametrize("texels", [1, 511, 512, 513, 1500])
@pytest.mark.parametrize("points", [1, 2, 33])
def test_sum_over_diffuse_texels_equals_the_paper(rng, texels, points):
    table, (position, normal) = random_table(rng, texels), random_points(rng, points)
    expected = rsm_oracle.irradiance(position, normal, table)
    assert_close(vpl.gather_all(position, normal, table, 0.0), expected, FLOAT32 * 5)     # r^-4 takes 4 roundings of r


def test_sum_over_glossy_and_diffuse_texels_equals_the_paper(rng):
    table, (position, normal) = random_table(rng, 700, glossy_share=0.5), random_points(rng, 40)
    expected = rsm_oracle.irradiance(position, normal, table)
    assert_close(vpl.gather_all(position, normal, table, 0.0), expected, SHARP_LOBE)


def test_distance_offset_enters_the_diffuse_sum_as_in_the_paper_form(rng):
    table, (position, normal) = random_table(rng, 300), random_points(rng, 20)
    expected = rsm_oracle.irradiance(position, normal, table, eps2=0.05)
    actual = vpl.gather_all(position, normal, table, 0.05)
    assert_close(actual, expected, FLOAT32 * 5)
    assert np.all(actual <= vpl.gather_all(position, normal, table, 0.0) * (1 + FLOAT32))


def test_a_thinned_table_gives_the_full_sum_on_average(rng):
    table, (position, normal) = random_table(rng, 1000, glossy_share=0.3), random_points(rng, 10)
    full = rsm_oracle.irradiance(position, normal, table, eps2=0.05)
    runs = np.array([vpl.gather_all(position, normal, vpl.thin_texels(table, 130, seed), 0.05) for seed in range(400)])
    error_of_mean = runs.std(0) / np.sqrt(len(runs))
    # 30 numbers, each normal with the measured spread: 4.5 sigma fails once in 5000 for an unbiased method
    assert np.all(np.abs(runs.mean(0) - full) < 4.5 * error_of_mean)
    assert error_of_mean.max() < 0.05 * full.max()              # the bound above means something


def test_a_thinned_table_has_the_asked_number_of_texels(rng):
    table = random_table(rng, 100)
    assert vpl.thin_texels(table, 30, 0).shape == (17, 30)
    assert vpl.thin_texels(table, 100, 0) is table


# ---- polar sampling ----
def polar_numbers(samples, seed):
    shift = uniform(seed, 0, vpl.SHIFT_STREAM), uniform(seed, 1, vpl.SHIFT_STREAM)
    return np.array([r2_sequence(i, *shift) for i in range(samples)], np.float64)


@pytest.mark.parametrize("published", [False, True])
@pytest.mark.parametrize("wrap", [False, True])
def test_polar_samples_give_what_the_paper_form_gives(rng, published, wrap):
    height, width, radius = 12, 20, 11.0                        # larger than half the width: the wrap has to stop
    map_position = rng.uniform(-1, 1, (height, width, 3)).astype(np.float32)
    map_normal = unit(rng, height * width).reshape(height, width, 3)
    map_flux = rng.random((height, width, 3)).astype(np.float32)
    position, normal = random_points(rng, 60)
    column, row = rng.uniform(-4, 24, 60).astype(np.float32), rng.uniform(-4, 16, 60).astype(np.float32)
    xi = polar_numbers(64, 5)
    actual = vpl.gather_polar(position, normal, column, row, map_position, map_normal, map_flux, radius, 64, published, wrap,
                              5)
    compared = 0
    for i in range(60):
        expected, edge = rsm_oracle.irradiance_polar(
            position[i].astype(np.float64), normal[i].astype(np.float64), np.array([column[i], row[i]], np.float64),
            map_position, map_normal, map_flux, radius, xi, published, wrap)
        if edge > 2e-5:                                         # else rounding may put a sample into the next texel
            assert np.all(np.abs(actual[i] - expected) <= 2e-4 * expected + WEAK * actual.max())
            compared += 1
    assert compared > 45


def disk_share_of_texels(centre, radius, height, width):
    """(H, W) share of each texel that lies in the disk, by 64 x 64 points a texel."""
    fine = (np.arange(64) + 0.5) / 64
    y = (np.arange(height)[:, None] + fine).reshape(-1, 1) - centre[1]
    x = (np.arange(width)[:, None] + fine).reshape(1, -1) - centre[0]
    return (x**2 + y**2 < radius**2).reshape(height, 64, width, 64).mean((1, 3))


def test_unbiased_polar_samples_sum_the_texels_of_the_disk_on_average(rng):
    height, width, centre, radius = 9, 9, (4.3, 3.8), 3.1
    map_position = rng.uniform(-1, 1, (height, width, 3)).astype(np.float32)
    map_normal = unit(rng, height * width).reshape(height, width, 3)
    map_flux = rng.random((height, width, 3)).astype(np.float32)
    position, normal = np.array([[0.0, 0.0, 3.0]], np.float32), np.array([[0.0, 0.0, -1.0]], np.float32)
    table = np.zeros((17, height * width))
    share = disk_share_of_texels(centre, radius, height, width)
    table[0:3], table[3:6] = map_position.reshape(-1, 3).T, map_normal.reshape(-1, 3).T
    table[6:9], table[15] = (map_flux * share[..., None]).reshape(-1, 3).T, 2
    expected = rsm_oracle.irradiance(position, normal, table)
    column, row = np.array([centre[0]]), np.array([centre[1]])
    runs = np.array([vpl.gather_polar(position, normal, column, row, map_position, map_normal, map_flux, radius, 400, False,
                                      False, seed) for seed in range(300)])
    error_of_mean = runs.std(0) / np.sqrt(len(runs))
    # 0.1 % for the sampled shares of the disk's edge
    assert np.all(np.abs(runs.mean(0) - expected) < 4.5 * error_of_mean + 1e-3 * expected)
    assert np.all(error_of_mean < 0.01 * expected)


# ---- with visibility ----
@pytest.fixture(scope="module")
def room():
    """A room with a box, a spot and a glossy floor; its texels; what each pixel gets by brute force."""
    frame = make_room_frame(16, 12, (LightKind.SPOT,))
    table = texel_table(frame)
    g = frame.gbuffer
    position, normal = g.position_ws[g.mask], g.normal_ws[g.mask]
    eps2, offset = MIN_DISTANCE2 * frame.scale_m**2, frame.ray_offset_m
    exact = rsm_oracle.irradiance(position, normal, table, eps2, frame.geometry.corners_ws, offset)
    return frame, table, position, normal, eps2, offset, exact


def visible(room, clusters, rays, seed=1):
    frame, table, position, normal, eps2, offset, _ = room
    grouped = cluster_texels(table, clusters, frame.scale_m)
    ids = np.arange(len(position))
    return gather_visible(position, normal, ids, grouped, np.float32(eps2), build_bvh(frame.geometry.corners_ws), rays,
                          np.float32(offset), seed)[:, :3]


def test_the_room_has_points_in_full_and_in_no_view_of_lit_texels(room):
    frame, table, position, normal, eps2, _, exact = room
    unshadowed = rsm_oracle.irradiance(position, normal, table, eps2)
    share = exact.sum(1) / np.maximum(unshadowed.sum(1), 1e-9)
    assert share.min() < 0.6 and share.max() > 0.9999
    assert (table[15] < 2).any()


def test_visible_gather_with_a_texel_a_cluster_equals_brute_force(room):
    exact = room[-1]
    actual = visible(room, clusters=10**6, rays=4096)
    # stratified: an error of at most a few rays of 8192 a boundary between seen and hidden texels
    assert np.abs(actual - exact).sum() / exact.sum() < 0.01
    assert abs(actual.sum() / exact.sum() - 1) < 0.002


@pytest.mark.parametrize("clusters", [16, 64, 256])
def test_visible_gather_of_clusters_equals_brute_force_on_average(room, clusters):
    exact = room[-1]
    actual = visible(room, clusters, rays=4096)
    assert abs(actual.sum() / exact.sum() - 1) < 0.01           # the bound on a single ray costs below 1 %
    assert np.abs(actual - exact).sum() / exact.sum() < 0.03


def test_few_rays_are_right_on_average(room):
    exact = room[-1]
    runs = np.array([visible(room, 64, rays=16, seed=seed).sum(0) for seed in range(40)])
    error_of_mean = runs.std(0) / np.sqrt(len(runs))
    # 0.5 %: what the bound on a single ray may take
    assert np.all(np.abs(runs.mean(0) - exact.sum(0)) < 4 * error_of_mean + 0.005 * exact.sum(0))
    assert np.all(error_of_mean < 0.01 * exact.sum(0))


def test_a_wall_between_texel_and_point_makes_exactly_zero(rng):
    table = random_table(rng, 50)
    table[2] = -1 - np.abs(table[2])
    position, normal = random_points(rng, 30)
    position[:, 2] = 1 + np.abs(position[:, 2])
    wall = np.array([[[-99, -99, 0], [99, -99, 0], [0, 199, 0]]], np.float32)
    ids, grouped = np.arange(30), cluster_texels(table, 16, 4.0)
    lit = gather_visible(position, normal, ids, grouped, np.float32(0), build_bvh(wall + 99), 64, np.float32(1e-4), 1)
    dark = gather_visible(position, normal, ids, grouped, np.float32(0), build_bvh(wall), 64, np.float32(1e-4), 1)
    assert lit[:, :3].any() and not dark[:, :3].any()


@pytest.fixture
def texels_as_points(monkeypatch):
    """The pass takes texels whole and near ones as points, as the sums of the oracle do."""
    monkeypatch.setattr(rsm, "texels_and_radii",
                        lambda *args: (made := texels_and_radii(*args[:4]))[:1] + (0 * made[1],))


def test_the_pass_at_every_pixel_equals_brute_force(room, texels_as_points):
    frame, exact = room[0], room[-1]
    params = RsmParams(lattice_px=1, rays=1024, clusters=256)
    light = compute_rsm(frame, params, Context(), 3).light[Transport.BOUNCE_DIFFUSE]
    assert np.abs(light[frame.gbuffer.mask] - exact).sum() / exact.sum() < 0.03


def test_near_texels_give_what_a_finer_view_gives(room, request):
    """Texels of a view of 12 pixels are half a metre wide; what the lamp hits within them comes near the view of 96."""
    params = RsmParams(lattice_px=1, rays=256, clusters=256, photons=0)

    def bounce(view_px):
        frame = dataclasses.replace(make_room_frame(16, 12), views=make_room_frame(16, view_px).views)
        return compute_rsm(frame, params, Context(), 3).light[Transport.BOUNCE_DIFFUSE].astype(np.float64)

    fine, coarse = bounce(96), bounce(12)
    request.getfixturevalue("texels_as_points")
    points = bounce(12)
    assert np.abs(coarse - fine).sum() < 0.8 * np.abs(points - fine).sum()


def test_all_texels_equal_brute_force_without_visibility(room):
    frame, table, position, normal, eps2, _, _ = room
    params = RsmParams(method="ALL", samples=16384)
    light = compute_rsm(frame, params, Context(), 0).light[Transport.BOUNCE_DIFFUSE]
    assert_close(light[frame.gbuffer.mask], rsm_oracle.irradiance(position, normal, table, eps2), SHARP_LOBE)


@pytest.mark.parametrize("kind", [LightKind.SPOT, LightKind.POINT, LightKind.SUN])
def test_polar_samples_over_the_whole_map_come_near_the_sum_over_diffuse_texels(kind):
    """In a room the disk of radius one map width holds most of the map: the published sampling ends at the same light."""
    frame = with_matt_views(make_room_frame(16, 12, (kind,)))
    whole = compute_rsm(frame, RsmParams(method="ALL", samples=16384, glossy_texels=False), Context(), 0)
    polar = compute_rsm(frame, RsmParams(method="PAPER", samples=16384, radius=1.0), Context(), 0)
    a, b = whole.light[Transport.BOUNCE_DIFFUSE], polar.light[Transport.BOUNCE_DIFFUSE]
    assert 0.75 < b.sum() / a.sum() < 1.02                      # corners of the map lie outside of most disks


def test_views_add_up(room):
    """Superposition through the pass: two lamps give the sum of each alone."""
    frame = make_room_frame(12, 9, (LightKind.SPOT, LightKind.POINT))
    params = RsmParams(method="ALL", samples=16384)
    both = compute_rsm(frame, params, Context(), 0).light[Transport.BOUNCE_DIFFUSE]
    alone = [compute_rsm(dataclasses.replace(frame, views=(view,)), params, Context(), 0).light[Transport.BOUNCE_DIFFUSE]
             for view in frame.views]
    assert np.allclose(both, alone[0] + alone[1], rtol=1e-5, atol=1e-6 * both.max())
