"""Rays through the picture: the hierarchy marches as every pixel does, to the last bit, and that as one would by hand."""

from __future__ import annotations

import math
from types import SimpleNamespace

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import example, given

from rtgi_addon.core.synthetic import make_room_frame
from rtgi_addon.core.transforms import Projection
from rtgi_addon.kernels.depth_pyramid import (
    HEIGHT,
    HIGH,
    LOW,
    NOTHING,
    SLACK,
    SLOPE_X,
    SLOPE_Y,
    DepthPyramid,
    build_pyramid,
    fill_pyramid,
    pyramid_layout,
)
from rtgi_addon.kernels.screen import seen_vs, turn_to_view
from rtgi_addon.kernels.screen_rays import (
    ENDED,
    HIDDEN,
    HIT,
    LEFT,
    ScreenRay,
    distance_at,
    march,
    march_evenly,
    ray_in_picture,
)
from rtgi_addon.kernels.vec3 import vector
from rtgi_addon.passes.screen import screen_of
from tests.unit.test_depth_pyramid import camera_of


def pyramid_of(height: np.ndarray, slope: np.ndarray, slack: float) -> DepthPyramid:
    """A pyramid over given heights (H, W), -NOTHING for nothing, and slopes (H, W, 2)."""
    rows, columns = height.shape
    first, level_rows, level_columns = pyramid_layout(rows, columns)
    planes, bounds = np.zeros((rows, columns, 4), np.float32), np.empty((int(first[-1]) + 1, 2), np.float32)
    seen = height > -NOTHING
    planes[..., HEIGHT] = height
    planes[..., [SLOPE_X, SLOPE_Y]] = np.where(seen[..., None], slope, 0)
    planes[..., SLACK] = np.where(seen, slack, 0)
    reach = np.abs(planes[..., SLOPE_X]) / 2 + np.abs(planes[..., SLOPE_Y]) / 2
    bounds[:rows * columns, HIGH] = np.where(seen, planes[..., HEIGHT] + reach, -NOTHING).ravel()
    bounds[:rows * columns, LOW] = np.where(seen, planes[..., HEIGHT] - reach - planes[..., SLACK], NOTHING).ravel()
    fill_pyramid(bounds, first, level_rows, level_columns)
    return DepthPyramid(planes, bounds, first, level_rows, level_columns)


def line(x, y, h, dx, dy, dh) -> ScreenRay:
    return ScreenRay(float(x), float(y), float(h), float(dx), float(dy), float(dh), 1.0, 1.0, True)


def crossed_pixels(ray, i, j, rows, columns):
    """Pixels that a ray crosses after its first, with the stretch [enter, leave]: by all its crossings, sorted."""
    crossings = []
    for k in range(columns + 1):
        if ray.dx and (k - ray.x) / ray.dx > 0:
            crossings.append(((k - ray.x) / ray.dx, 0, int(math.copysign(1, ray.dx))))
    for k in range(rows + 1):
        if ray.dy and (k - ray.y) / ray.dy > 0:
            crossings.append(((k - ray.y) / ray.dy, 1, int(math.copysign(1, ray.dy))))
    crossings.sort()
    for number, (at, axis, sign) in enumerate(crossings):
        if at > 1:
            return
        i, j = (i, j + sign) if axis == 0 else (i + sign, j)
        if not (0 <= i < rows and 0 <= j < columns):
            return
        yield i, j, at, min(crossings[number + 1][0], 1.0) if number + 1 < len(crossings) else 1.0


def marched_by_hand(pyramid, ray, i, j, stops_hidden):
    """(answer, pixel) in float64, as slow as the definition: HIT, HIDDEN or neither (0)."""
    planes = pyramid.planes.astype(np.float64)
    for at_i, at_j, enters, leaves in crossed_pixels(ray, i, j, *planes.shape[:2]):
        height, slope_x, slope_y, slack = planes[at_i, at_j]
        before, after = (ray.h + s * ray.dh - height - slope_x * (ray.x + s * ray.dx - at_j - 0.5)
                         - slope_y * (ray.y + s * ray.dy - at_i - 0.5) for s in (enters, leaves))
        if before > 0 and after > 0:
            continue
        if before > 0 or (after <= 0 and before >= -slack):
            return HIT, (at_i, at_j)
        if stops_hidden:
            return HIDDEN, (at_i, at_j)
    return 0, None


@st.composite
def marches(draw):
    """A height field with holes, steps and slopes, and a ray in it: also along axes, diagonals, from edges of cells."""
    rows, columns = draw(st.integers(1, 33)), draw(st.integers(1, 33))
    rng = np.random.default_rng(draw(st.integers(0, 2**31)))
    height = rng.integers(0, draw(st.sampled_from([2, 8, 1000])), (rows, columns)) / 8.0
    height[rng.random((rows, columns)) < draw(st.sampled_from([0.0, 0.2, 0.8]))] = -NOTHING
    slope = rng.normal(0, draw(st.sampled_from([0.0, 0.1, 3.0])), (rows, columns, 2))
    i, j = draw(st.integers(0, rows - 1)), draw(st.integers(0, columns - 1))
    tame = st.floats(-1, 1).map(lambda v: v if abs(v) > 1e-99 else 0.0)      # no subnormal numbers: 1 / v must exist
    along = st.sampled_from([0.0, 1.0, -1.0, 0.5, 1e-12, -3.7]) | tame
    dx, dy = draw(along) * 40, draw(along) * 40
    # a start on the edge of a cell belongs to the pixel that the ray moves into
    in_x, in_y = draw(st.sampled_from([0.5, 0.0, 0.25])), draw(st.sampled_from([0.5, 0.0, 0.25]))
    x, y = j + (in_x if dx >= 0 else 1 - in_x), i + (in_y if dy >= 0 else 1 - in_y)
    h, dh = draw(st.sampled_from([0.0, 1.0, 3.0])), draw(st.sampled_from([0.0, -2.0, 5.0]) | st.floats(-20, 20))
    ray = line(x, y, h, dx, dy, dh)
    return SimpleNamespace(pyramid=pyramid_of(height, slope, draw(st.sampled_from([0.0, 0.3, 5.0]))), ray=ray, i=i, j=j)


DOWN_A_COLUMN = SimpleNamespace(pyramid=pyramid_of(np.tile(np.float32([0, 0, 5, 0, 0]), (9, 1)).T, np.zeros((5, 9, 2)), 0.1),
                                ray=line(4.0, 0.0, 3, 0, 40, 0), i=0, j=4)


@given(marches())
@example(DOWN_A_COLUMN)
@pytest.mark.parametrize("stops_hidden", [True, False])
def test_hierarchy_answers_as_every_pixel_does_to_the_last_bit(stops_hidden, case):
    top = len(case.pyramid.first) - 1
    expected = march(case.pyramid, case.ray, case.i, case.j, 0, stops_hidden)
    for level in {1, 2, top}:
        assert march(case.pyramid, case.ray, case.i, case.j, min(level, top), stops_hidden)[:4] == expected[:4]


@given(marches())
@example(DOWN_A_COLUMN)
@pytest.mark.parametrize("stops_hidden", [True, False])
def test_every_pixel_is_asked_as_by_hand(stops_hidden, case):
    got = march(case.pyramid, case.ray, case.i, case.j, 0, stops_hidden)
    answer, pixel = marched_by_hand(case.pyramid, case.ray, case.i, case.j, stops_hidden)
    if answer == 0:
        assert got[0] in (LEFT, ENDED)
    else:
        assert (got[0], got[1:3]) == (answer, pixel)


def test_many_rays_over_random_fields_agree(rng):
    # beside the property test, 40,000 rays from the centres of pixels, as reflections start
    steps = np.zeros(2, np.int64)
    for shape in ((31, 57), (64, 40), (5, 3)):
        smooth = np.cumsum(np.cumsum(rng.normal(size=shape), 0), 1) * 0.02 + 1
        pyramid = pyramid_of(smooth.astype(np.float32), np.zeros((*shape, 2)), 0.05)
        top = len(pyramid.first) - 1
        for _ in range(13000):
            i, j = int(rng.integers(shape[0])), int(rng.integers(shape[1]))
            d = rng.normal(0, 60, 2) * rng.choice([0, 1, 1, 1], 2)
            ray = line(j + 0.5, i + 0.5, smooth[i, j], *d, rng.normal(0, 8))
            single, skipping = (march(pyramid, ray, i, j, level, True) for level in (0, top))
            assert skipping[:4] == single[:4]
            steps += single[4], skipping[4]
    assert steps.min() > 0


def test_hierarchy_takes_a_third_of_the_steps_over_open_ground():
    pyramid = pyramid_of(np.full((540, 960), 1.0, np.float32), np.zeros((540, 960, 2)), 0.01)
    rays = [line(x + 0.5, 500.5, 1.2, dx, -480, -0.21) for x in range(100, 860, 40) for dx in (-90, 0, 55)]
    single, skipping = (sum(march(pyramid, ray, 500, int(ray.x), top, True)[4] for ray in rays) for top in (0, 9))
    assert 3 * skipping <= single


def test_ray_without_direction_in_the_picture_ends_where_it_is():
    pyramid = pyramid_of(np.ones((5, 5), np.float32), np.zeros((5, 5, 2)), 0.1)
    for top in (0, 2):
        assert march(pyramid, line(2.5, 2.5, 1.0, 0, 0, 1.0), 2, 2, top, True)[0] == ENDED


def test_hidden_stretch_is_passed_only_where_it_may_be():
    # a pillar in front of a floor far behind, the ray between the two
    height = np.full((1, 9), 1.0, np.float32)
    height[0, 3:5] = 5.0
    pyramid = pyramid_of(height, np.zeros((1, 9, 2)), 0.5)
    ray = line(0.5, 0.5, 2.0, 20, 0, -2.5)
    assert march(pyramid, ray, 0, 0, 3, True)[:3] == (HIDDEN, 0, 3)
    answer, _, column, s, _ = march(pyramid, ray, 0, 0, 3, False)
    assert answer == HIT and column == 8 and math.isclose(ray.h + s * ray.dh, 1.0)


def test_even_steps_miss_what_lies_between_two_of_them():
    height = np.zeros((1, 40), np.float32)
    height[0, 18] = 5.0
    pyramid = pyramid_of(height, np.zeros((1, 40, 2)), 10.0)
    ray = line(0.5, 0.5, 1.0, 60, 0, 0.0)
    assert march(pyramid, ray, 0, 0, 0, False)[:3] == (HIT, 0, 18)
    assert march_evenly(pyramid, ray, 0, 0, 1.0, False)[:3] == (HIT, 0, 18)
    assert march_evenly(pyramid, ray, 0, 0, 4.0, False)[0] == LEFT


@pytest.mark.parametrize("projection", [Projection.PERSPECTIVE, Projection.ORTHOGRAPHIC])
def test_heights_and_lengths_are_linear_along_the_projected_ray(projection, rng):
    # the exact points of a ray against its line in the picture; 1e-6 is a few roundings of float32 inputs
    frame = make_room_frame(24, 17)
    camera = camera_of(projection, 0.3)
    screen = screen_of(type(frame)(camera, frame.gbuffer))
    for _ in range(200):
        depth = rng.uniform(0.5, 5)
        q = np.array([rng.uniform(-1, 1), rng.uniform(-1, 1), -depth])
        d = rng.normal(size=3)
        d /= np.linalg.norm(d)
        ray = ray_in_picture(screen, vector(q), vector(d), 50.0)
        q, d = (np.array(vector(v), np.float64) for v in (q, d))
        for s in (0.0, 0.3, 0.9):
            point = q + distance_at(ray, s) * d
            world = point @ camera.world_from_view[:3, :3].T + camera.position_ws
            column, row, planar = camera.project(world)
            height = 1 / planar if projection is Projection.PERSPECTIVE else -planar
            scale = max(abs(ray.h), abs(ray.h + ray.dh))
            assert math.isclose(ray.h + s * ray.dh, height, rel_tol=1e-6, abs_tol=1e-6 * scale)
            extent = max(abs(ray.dx), abs(ray.dy), 24)
            assert math.isclose(ray.x + s * ray.dx, column, abs_tol=1e-6 * extent)
            assert math.isclose(ray.y + s * ray.dy, row, abs_tol=1e-6 * extent)


def test_ray_towards_the_camera_ends_before_its_plane():
    frame = make_room_frame(24, 17)
    screen = screen_of(frame)
    ray = ray_in_picture(screen, seen_vs(screen, 8, 12), turn_to_view(screen, vector([0.0, -1.0, 0.0])), 1e6)
    depth = float(frame.gbuffer.depth[8, 12])
    assert math.isclose(1 / (ray.h + ray.dh), 1e-3 * depth, rel_tol=1e-3) and ray.length_m < depth


def test_room_is_crossed_alike_by_all_levels():
    frame = make_room_frame(61, 45)
    screen = screen_of(frame)
    pyramid, rng = build_pyramid(screen, 0.5), np.random.default_rng(4)
    for i in range(0, 45, 2):
        for j in range(0, 61, 3):
            d = rng.normal(size=3)
            ray = ray_in_picture(screen, seen_vs(screen, i, j), vector(d / np.linalg.norm(d)), 100.0)
            answers = {march(pyramid, ray, i, j, top, True)[:4] for top in (0, 1, 3, 6)}
            assert len(answers) == 1
