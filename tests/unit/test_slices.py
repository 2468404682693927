"""Slices: weights, running integral, sheets and bit masks against float64 integrals and plain Python."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rtgi_addon.core.transforms import Camera, Projection, normalized
from rtgi_addon.kernels import shadow
from rtgi_addon.kernels.screen import build_screen, point_vs, to_viewer_vs, view_to_screen
from rtgi_addon.kernels.slices import (
    bits_below,
    bits_by_byte,
    count_bits,
    exit_px,
    into_slice,
    reach_px,
    rear,
    screen_step,
    sectors,
    share_below,
    slice_of,
)
from rtgi_addon.kernels.vec3 import f32, vector

POLYNOMIAL = 5e-5       # of fast_atan2, twice, and float32


def axes(phi, viewer=(0.0, 0.0, 1.0)):
    """(viewer, side) of the slice at angle phi around a direction to the viewer."""
    v = normalized(np.asarray(viewer, float))
    first = normalized(np.cross((0.3, 1.0, 0.2), v))
    side = math.cos(phi) * first + math.sin(phi) * np.cross(v, first)
    return v, side


def slice_for(normal, phi, viewer=(0.0, 0.0, 1.0)):
    v, side = axes(phi, viewer)
    return (v, side, *slice_of(vector(v), vector(side), vector(normal)))


@pytest.mark.parametrize("tilt_deg", [0, 30, 60, 80])
def test_open_slices_weigh_one_in_the_mean_around_the_viewer(tilt_deg):
    tilt = math.radians(tilt_deg)
    normal = np.array([math.sin(tilt), 0.0, math.cos(tilt)])
    weights = [slice_for(normal, math.pi * (k + 0.5) / 64)[3] for k in range(64)]
    # 64 even angles leave less than 1e-4 of the integral for tilts up to 80 degrees
    assert abs(np.mean(weights) - 1) < 2e-4


@pytest.mark.parametrize(("g_deg", "t_deg"), [(0, 10), (0, -70), (40, 100), (40, -20), (-65, -120), (-65, 15), (20, 0)])
def test_share_below_is_the_running_integral_of_the_slice(g_deg, t_deg):
    g, t = math.radians(g_deg), math.radians(t_deg)
    v, side, a, _ = slice_for(math.cos(g) * axes(0)[0] + math.sin(g) * axes(0)[1], 0.0)
    angle = np.linspace(g - np.pi / 2, g + np.pi / 2, 200001)
    density = np.cos(angle - g) * np.abs(np.sin(angle))
    wanted = density[angle <= t].sum() / density.sum()
    for length in (1e-3, 1.0, 1e3):
        got = share_below(a, f32(length * math.cos(t)), f32(length * math.sin(t)), f32(0))
        assert abs(got - wanted) < POLYNOMIAL


def test_direction_below_the_surface_gives_the_end_of_its_side():
    a = slice_for(axes(0)[0], 0.0)[2]
    assert share_below(a, f32(-0.1), f32(1), f32(1)) == 1 and share_below(a, f32(-0.1), f32(-1), f32(0)) == 0


def test_point_beside_the_slice_keeps_its_height_over_the_surface(rng):
    for _ in range(20):
        v, side, a, _ = slice_for(normal := normalized(rng.normal(size=3) * (1, 1, 0.3) + (0, 0, 1)), rng.uniform(0, 3))
        d = rng.normal(size=3)
        got_v, got_s = into_slice(a, vector(v), vector(side), vector(normal), vector(d))
        assert abs(got_v * (normal @ v) + got_s * (normal @ side) - d @ normal) < 1e-5


def test_point_of_the_slice_is_left_where_it_is():
    normal = normalized(np.array([0.4, -0.3, 0.8]))
    v, side, a, _ = slice_for(normal, 0.7)
    got = into_slice(a, vector(v), vector(side), vector(normal), vector(0.8 * v - 0.5 * side))
    np.testing.assert_allclose(got, (0.8, -0.5), atol=1e-6)


def test_rear_lies_on_the_viewers_ray_and_inside_the_sphere():
    # eye 5 m up the v axis; front at (1, 2): the ray on from there is (1 - 5, 2) / sqrt(20)
    ray = np.array([-4.0, 2.0]) / math.sqrt(20)
    got = rear(f32(1), f32(2), f32(5), False, f32(0.5), f32(100))
    np.testing.assert_allclose(got, np.array([1, 2]) + 0.5 * ray, atol=1e-6)
    np.testing.assert_allclose(rear(f32(1), f32(2), f32(5), True, f32(0.5), f32(100)), (0.5, 2), atol=1e-6)
    assert abs(math.hypot(*rear(f32(1), f32(2), f32(5), False, f32(50), f32(3))) - 3) < 1e-5


@pytest.mark.parametrize("count", range(65))
def test_bits_below_a_count(count):
    assert int(bits_below(np.int32(count))) == (1 << count) - 1
    assert count_bits(np.uint64(bits_below(np.int32(count)))) == count


def test_bits_are_counted_by_byte(rng):
    for mask in rng.integers(0, 2**63, 50):
        counts = int(bits_by_byte(np.uint64(mask))).to_bytes(8, "little")
        assert list(counts) == [b.bit_count() for b in int(mask).to_bytes(8, "little")]
        assert count_bits(np.uint64(mask)) == int(mask).bit_count()


@pytest.mark.parametrize(("low", "high"), [(0.0, 1.0), (0.2, 0.2), (0.1234, 0.8765), (0.5, 0.503), (0.0, 0.001)])
def test_sectors_count_the_exact_width_in_the_mean_over_shifts(low, high):
    shifts = (np.arange(256) + 0.5) / 256
    mean = np.mean([count_bits(np.uint64(sectors(f32(low), f32(high), f32(u)))) for u in shifts]) / 64
    assert abs(mean - (high - low)) < 1 / (64 * 256) + 1e-6


def test_sectors_of_two_parts_join_without_gap_and_overlap():
    for u in (0.0, 0.3, 0.99):
        parts = [sectors(f32(a), f32(b), f32(u)) for a, b in ((0.1, 0.37), (0.37, 0.9))]
        assert parts[0] | parts[1] == sectors(f32(0.1), f32(0.9), f32(u)) and not parts[0] & parts[1]


def screen_for(projection):
    camera = Camera(projection, np.eye(4), 64, 48, -0.5, 0.9, -0.4, 0.6)
    image = np.zeros((48, 64, 3), np.float32)
    code = shadow.ORTHOGRAPHIC if projection is Projection.ORTHOGRAPHIC else shadow.PERSPECTIVE
    return build_screen(code, np.eye(4), camera.left, camera.top, *camera.pixel_size, np.full((48, 64), 3.0), image, image)


@pytest.mark.parametrize("projection", [Projection.PERSPECTIVE, Projection.ORTHOGRAPHIC])
def test_side_of_a_slice_moves_along_its_line_on_the_screen(projection):
    s = screen_for(projection)
    p = vector(point_vs(s, f32(40), f32(11), f32(3)))
    side = vector(normalized(np.array([0.5, -0.3, 0.6])))
    columns, rows = screen_step(s, p, side)
    moved = vector(np.array(p) + 1e-3 * np.array(side))
    column, row, _ = view_to_screen(s, moved)
    # a thousandth of a metre leaves float32 three digits of the difference
    np.testing.assert_allclose((column - 40, row - 11), (1e-3 * columns, 1e-3 * rows), rtol=1e-2)


@pytest.mark.parametrize("projection", [Projection.PERSPECTIVE, Projection.ORTHOGRAPHIC])
def test_reach_is_the_farthest_pixel_of_the_sphere_in_the_slice(projection):
    s, radius = screen_for(projection), 0.8
    p = vector(point_vs(s, f32(40), f32(11), f32(3)))
    viewer = vector(to_viewer_vs(s, p))
    side = normalized(np.cross(np.array(viewer), (0.2, 1.0, 0.1)))
    columns, rows = screen_step(s, p, vector(side))
    got = reach_px(s, f32(40), f32(11), f32(np.linalg.norm(p)), viewer, vector(side), f32(radius),
                   f32(math.hypot(columns, rows)))
    around = np.linspace(0, np.pi, 20001)       # the half of the circle on the side of `side`
    circle = np.array(p) + radius * (np.cos(around)[:, None] * np.array(viewer) + np.sin(around)[:, None] * side)
    px = [math.hypot(c - 40, r - 11) for c, r, _ in (view_to_screen(s, vector(q)) for q in circle[::20])]
    assert abs(got - max(px)) < 0.02


def test_sphere_around_the_eye_reaches_past_any_picture():
    s = screen_for(Projection.PERSPECTIVE)
    p = vector(point_vs(s, f32(40), f32(11), f32(3)))
    viewer, side = vector(to_viewer_vs(s, p)), vector((1.0, 0.0, 0.0))
    assert reach_px(s, f32(40), f32(11), f32(np.linalg.norm(p)), viewer, side, f32(50), f32(1)) > 64 + 48


@pytest.mark.parametrize(("direction", "wanted"), [
    ((1, 0), 54), ((-1, 0), 10), ((0, 1), 40), ((0, -1), 8), ((0.6, 0.8), 50)])
def test_exit_is_the_distance_to_the_pictures_edge(direction, wanted):
    assert abs(exit_px(f32(48), f32(64), f32(10), f32(8), f32(direction[0]), f32(direction[1])) - wanted) < 1e-4
