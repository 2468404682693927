"""Sums over texels against closed-form form factors: an emitter of radiosity 1 W/m2 gives the irradiance F.

Emitters are cut into patches that are handed over as texels of flux = area, as a light's view would see them. Formulas:
Howell's catalogue of configuration factors, sections B and C.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from rtgi_addon.kernels.vpl import gather_all

# patches are points at their middles: the error of the midpoint rule, (size / distance)^2 / 6 for the sizes used here
MIDPOINT = 5e-4
# squares near, points beyond four sizes: the seam costs up to 0.5 %, as the docstring of gather_all states
NEAR_FIELD = 5e-3


def texels(position, normal, area):
    """(16, N) table of diffuse patches (N, 3) with normals (N, 3) and areas (N,) m2, radiosity 1 W/m2."""
    table = np.zeros((17, len(position)), np.float32)
    table[0:3], table[3:6], table[6:9] = position.T, np.broadcast_to(normal, position.shape).T, area
    table[15], table[16] = 2, 0.04
    return table


def disk(radius, height, rings=300, spokes=300):
    """Disk of `radius` around the z axis at `height`, facing down, in rings of equal width."""
    r, angle = np.meshgrid((np.arange(rings) + 0.5) / rings * radius, (np.arange(spokes) + 0.5) / spokes * 2 * math.pi)
    r, angle = r.ravel(), angle.ravel()
    position = np.stack([r * np.cos(angle), r * np.sin(angle), np.full_like(r, height)], 1)
    return texels(position, [0, 0, -1], r * radius / rings * 2 * math.pi / spokes)


def rectangle(corner, edge_u, edge_v, normal, n_u=250, n_v=250):
    """Rectangle from `corner` along two edges, facing `normal`."""
    corner, edge_u, edge_v = (np.asarray(a, float) for a in (corner, edge_u, edge_v))
    u, v = np.meshgrid((np.arange(n_u) + 0.5) / n_u, (np.arange(n_v) + 0.5) / n_v)
    position = corner + u.reshape(-1, 1) * edge_u + v.reshape(-1, 1) * edge_v
    area = np.linalg.norm(np.cross(edge_u, edge_v)) / (n_u * n_v)
    return texels(position, normal, np.full(len(position), area))


def sphere(centre, radius, outward=True, bands=250, columns=500):
    """Sphere in patches of equal area."""
    z, angle = np.meshgrid((np.arange(bands) + 0.5) / bands * 2 - 1, (np.arange(columns) + 0.5) / columns * 2 * math.pi)
    z, angle = z.ravel(), angle.ravel()
    ring = np.sqrt(1 - z * z)
    direction = np.stack([ring * np.cos(angle), ring * np.sin(angle), z], 1)
    area = np.full(len(z), 4 * math.pi * radius**2 / len(z))
    return texels(np.asarray(centre) + radius * direction, direction if outward else -direction, area)


def irradiance_at(position, normal, table, area=None):
    position, normal = np.atleast_2d(np.asarray(position, float)), np.atleast_2d(np.asarray(normal, float))
    return gather_all(position, normal / np.linalg.norm(normal, axis=1, keepdims=True), table, 0.0, area_m2=area)[:, 0]


# ---- disks ----
@pytest.mark.parametrize("tilt_deg", [0, 20, 44])
@pytest.mark.parametrize("height", [0.5, 1.0, 2.5])
def test_disk_over_a_tilted_element_on_its_axis(height, tilt_deg):
    tilt, radius = math.radians(tilt_deg * min(1.0, height)), 1.0        # the disk stays above the element's horizon
    expected = math.cos(tilt) * radius**2 / (radius**2 + height**2)
    actual = irradiance_at([0, 0, 0], [math.sin(tilt), 0, math.cos(tilt)], disk(radius, height))
    assert actual == pytest.approx(expected, rel=MIDPOINT)


def test_equal_disk_and_height_give_one_half():
    assert irradiance_at([0, 0, 0], [0, 0, 1], disk(1.0, 1.0)) == pytest.approx(0.5, rel=MIDPOINT)


@pytest.mark.parametrize(("radius", "height", "offset"), [(1.0, 0.6, 0.9), (1.0, 0.6, 2), (0.6, 0.6, 0.9), (1.0, 2.0, 0.3)])
def test_disk_parallel_to_an_element_off_its_axis(radius, height, offset):
    total = height**2 + offset**2 + radius**2
    expected = 0.5 * (1 + (radius**2 - height**2 - offset**2) / math.sqrt(total**2 - 4 * radius**2 * offset**2))
    actual = irradiance_at([offset, 0, 0], [0, 0, 1], disk(radius, height))
    assert actual == pytest.approx(expected, rel=MIDPOINT)
    if (radius, height, offset) == (1.0, 0.6, 0.9):
        assert expected == pytest.approx(0.429867, abs=1e-6)


@pytest.mark.parametrize(("radius", "height", "offset"), [(0.6, 0.6, 0.9), (0.5, 1.5, 0.7)])
def test_disk_perpendicular_to_an_element_that_faces_its_axis(radius, height, offset):
    total = height**2 + offset**2 + radius**2
    expected = height / (2 * offset) * (total / math.sqrt(total**2 - 4 * radius**2 * offset**2) - 1)
    actual = irradiance_at([offset, 0, 0], [-1, 0, 0], disk(radius, height))
    assert actual == pytest.approx(expected, rel=MIDPOINT)
    if offset == 0.9:
        assert expected == pytest.approx(0.137258, abs=1e-6)


# ---- rectangles ----
def parallel_rectangle(a, b, c):
    x, y = a / c, b / c
    root_x, root_y = math.sqrt(1 + x * x), math.sqrt(1 + y * y)
    return (x / root_x * math.atan(y / root_x) + y / root_y * math.atan(x / root_y)) / (2 * math.pi)


def perpendicular_rectangle(a, b, c):
    root = math.hypot(a, c)
    return (math.atan(b / c) - c / root * math.atan(b / root)) / (2 * math.pi)


@pytest.mark.parametrize(("a", "b", "c"), [(1.3, 0.7, 0.5), (1.0, 1.0, 1.0), (3.0, 0.4, 0.8)])
def test_rectangle_parallel_to_an_element_under_its_corner(a, b, c):
    table = rectangle([0, 0, c], [a, 0, 0], [0, b, 0], [0, 0, -1])
    assert irradiance_at([0, 0, 0], [0, 0, 1], table) == pytest.approx(parallel_rectangle(a, b, c), rel=MIDPOINT)
    if a == 1.3:
        assert parallel_rectangle(a, b, c) == pytest.approx(0.196905, abs=1e-6)


@pytest.mark.parametrize(("a", "b", "c"), [(1.3, 0.7, 0.5), (1.0, 2.0, 0.3)])
def test_rectangle_perpendicular_to_an_element_at_its_edge(a, b, c):
    wall = rectangle([c, 0, 0], [0, 0, a], [0, b, 0], [-1, 0, 0])
    assert irradiance_at([0, 0, 0], [0, 0, 1], wall) == pytest.approx(perpendicular_rectangle(a, b, c), rel=MIDPOINT)
    if a == 1.3:
        assert perpendicular_rectangle(a, b, c) == pytest.approx(0.124677, abs=1e-6)


@pytest.mark.parametrize(("height", "distance"), [(0.8, 0.5), (2.0, 1.0), (0.5, 1.5)])
def test_infinite_wall_beside_a_floor(height, distance):
    edges = np.sinh(np.linspace(-9, 9, 1501)) * distance                 # fine near, to 4000 distances each way
    y, size = (edges[1:] + edges[:-1]) / 2, np.diff(edges)
    z = (np.arange(200) + 0.5) / 200 * height
    y_all, z_all = (a.ravel() for a in np.meshgrid(y, z))
    position = np.stack([np.full(y_all.shape, distance), y_all, z_all], 1)
    wall = texels(position, [-1, 0, 0], np.tile(size, 200) * height / 200)
    expected = 0.5 * (1 - distance / math.hypot(distance, height))
    assert irradiance_at([0, 0, 0], [0, 0, 1], wall) == pytest.approx(expected, rel=MIDPOINT)
    if height == 0.8:
        assert expected == pytest.approx(0.235001, abs=1e-6)


# ---- closed rooms ----
def box_walls(size, texel_m):
    """The six inner walls of a box from 0 to `size` in square texels: (table, area, wall number)."""
    size = np.asarray(size, float)
    tables, areas, numbers = [], [], []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        for side in (0, 1):
            corner, edge_u, edge_v, normal = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
            corner[axis], edge_u[u], edge_v[v], normal[axis] = side * size[axis], size[u], size[v], 1 - 2 * side
            n_u, n_v = round(size[u] / texel_m), round(size[v] / texel_m)
            tables.append(rectangle(corner, edge_u, edge_v, normal, n_u, n_v))
            areas.append(np.full(n_u * n_v, texel_m**2))
            numbers.append(np.full(n_u * n_v, 2 * axis + side))
    return np.concatenate(tables, 1), np.concatenate(areas), np.concatenate(numbers)


def wall_to_wall(table, area, wall, emitter, receiver):
    """Mean irradiance on one wall from another of radiosity 1: the factor F from receiver to emitter."""
    source, points = table[:, wall == emitter], table[:, wall == receiver]
    return irradiance_at(points[0:3].T, points[3:6].T, source, area[wall == emitter]).mean()


def test_faces_of_a_cube_have_their_form_factors_and_close():
    table, area, wall = box_walls([1, 1, 1], 1 / 24)
    opposed, adjacent = wall_to_wall(table, area, wall, 0, 1), wall_to_wall(table, area, wall, 0, 2)
    # 1.5 %: the mean over 24 x 24 receivers of a function with a kink at the common edge, beside the near field's 0.25 %
    assert opposed == pytest.approx(0.199825, rel=2e-3)
    assert adjacent == pytest.approx(0.200044, rel=0.015)
    assert opposed + 4 * adjacent == pytest.approx(1, rel=0.012)


def test_closed_box_of_even_radiosity_is_a_furnace(rng):
    table, area, _ = box_walls([2.0, 3.0, 1.5], 0.05)
    direction = rng.normal(size=(200, 3))
    inside = rng.uniform(0.02, 0.98, (200, 3)) * [2.0, 3.0, 1.5]         # also nearer to a wall than a texel's size
    assert irradiance_at(inside, direction, table, area) == pytest.approx(np.ones(200), rel=0.012)


def test_points_on_the_walls_of_the_furnace_see_it_too(rng):
    table, area, _ = box_walls([1.0, 1.0, 1.0], 1 / 40)
    u, v = rng.uniform(0.01, 0.99, (2, 100))
    floor = np.stack([u, v, np.zeros(100)], 1)
    assert irradiance_at(floor, np.tile([0, 0, 1.0], (100, 1)), table, area) == pytest.approx(np.ones(100), rel=0.012)


@pytest.mark.parametrize(("i", "j"), [(0, 1), (0, 2), (2, 5), (4, 3)])
def test_walls_of_a_box_are_reciprocal(i, j):
    size = [1.0, 2.0, 0.6]
    table, area, wall = box_walls(size, 0.05)
    area_i, area_j = area[wall == i].sum(), area[wall == j].sum()
    to_j, to_i = wall_to_wall(table, area, wall, j, i), wall_to_wall(table, area, wall, i, j)
    # both are the same double sum, but for which of two neighbours is the square and which the point
    assert area_i * to_j == pytest.approx(area_j * to_i, rel=0.01)


# ---- spheres ----
def test_lit_cap_inside_a_sphere_gives_the_same_everywhere(rng):
    """E = rho E0 A / (4 pi R^2) wherever one looks: true of the 4th power with bare differences, of no other."""
    radius, reflected = 2.0, 0.6
    table = sphere([0, 0, 0], radius, outward=False)
    cap = table[:, table[2] > radius * 0.7]
    cap[6:9] *= reflected
    direction = rng.normal(size=(300, 3))
    direction = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    points = direction[direction[:, 2] < 0.6]                            # outside the cap, where patches are near
    expected = cap[6].sum(dtype=np.float64) / (4 * math.pi * radius**2)
    actual = irradiance_at(radius * points, -points, cap)
    assert actual == pytest.approx(np.full(len(points), expected), rel=MIDPOINT)


@pytest.mark.parametrize("x", [0.5, 1.3, 4.0])
def test_sphere_resting_on_a_plane(x):
    radius = 1.0
    actual = irradiance_at([x, 0, 0], [0, 0, 1], sphere([0, 0, radius], radius))
    expected = radius**3 / (x * x + radius * radius) ** 1.5
    # patches whose normal turns from the point are cut whole: half a patch at the outline
    assert actual == pytest.approx(expected, rel=3e-3)
    if x == 1.3:
        assert expected == pytest.approx(0.226658, abs=1e-6)


@pytest.mark.parametrize("tilt_deg", [0, 30, 60])
def test_free_sphere_above_the_horizon(tilt_deg):
    tilt, distance = math.radians(tilt_deg), 3.0
    ball = sphere([distance * math.sin(tilt), 0, distance * math.cos(tilt)], 1.0)
    assert irradiance_at([0, 0, 0], [0, 0, 1], ball) == pytest.approx(math.cos(tilt) / distance**2, rel=3e-3)


# ---- near field ----
def plane_of_texels(n):
    position = np.stack([a.ravel() for a in np.meshgrid(np.arange(n) - n / 2 + 0.5, np.arange(n) - n / 2 + 0.5)]
                        + [np.zeros(n * n)], 1)
    return texels(position, [0, 0, 1], np.ones(n * n))


def over_the_plane(n, height):
    half = n / 2
    return 4 * parallel_rectangle(half, half, height)


@pytest.mark.parametrize("height", [0.01, 0.1, 0.25, 0.5, 1.0, 2.0, 4.0])
def test_square_texels_are_right_at_any_height_over_them(rng, height):
    table = plane_of_texels(201)
    points = np.concatenate([rng.uniform(-0.5, 0.5, (32, 2)), np.full((32, 1), height)], 1)
    actual = irradiance_at(points, np.tile([0, 0, -1.0], (32, 1)), table, np.ones(table.shape[1]))
    assert actual == pytest.approx(np.full(32, over_the_plane(201, height)), rel=NEAR_FIELD)


def test_point_texels_are_wrong_by_half_a_quarter_texel_above_them(rng):
    table = plane_of_texels(201)
    points = np.concatenate([rng.uniform(-0.5, 0.5, (64, 2)), np.full((64, 1), 0.25)], 1)
    error = irradiance_at(points, np.tile([0, 0, -1.0], (64, 1)), table) / over_the_plane(201, 0.25) - 1
    assert np.sqrt(np.mean(error**2)) > 0.5


@pytest.mark.parametrize(("height", "lost"), [(0.25, 0.65), (0.5, 0.36), (1.0, 0.13)])
def test_guarded_texels_are_smooth_and_dark_by_the_documented_share(height, lost):
    table = plane_of_texels(201)
    x, y = (a.ravel() for a in np.meshgrid((np.arange(8) + 0.5) / 8 - 0.5, (np.arange(8) + 0.5) / 8 - 0.5))
    points = np.stack([x, y, np.full(64, height)], 1)
    share = gather_all(points, np.tile([0, 0, -1.0], (64, 1)), table, 0.0, area_m2=np.ones(table.shape[1]),
                       near_field="GUARD")[:, 0] / over_the_plane(201, height)
    assert 1 - share.mean() == pytest.approx(lost, abs=0.01)


@pytest.mark.parametrize("height", [0.1, 0.25, 0.5, 1.0, 2.0])
def test_square_texels_are_right_in_a_corner(rng, height):
    n = 201
    points = np.stack([np.full(32, -n / 2), rng.uniform(-0.5, 0.5, 32), np.full(32, height)], 1)
    actual = irradiance_at(points, np.tile([1.0, 0, 0], (32, 1)), plane_of_texels(n), np.ones(n * n))
    expected = [perpendicular_rectangle(n, n / 2 - y, height) + perpendicular_rectangle(n, n / 2 + y, height)
                for y in points[:, 1]]
    assert actual == pytest.approx(np.array(expected), rel=NEAR_FIELD)


@pytest.mark.parametrize("tilt_deg", [10, 45, 90, 135, 170])
def test_square_texels_are_cut_at_the_horizon(rng, tilt_deg):
    """A plane seen by an element tilted by t against it fills (1 + cos t) / 2 of its view, however near."""
    tilt = math.radians(tilt_deg)
    normal = np.tile([math.sin(tilt), 0, -math.cos(tilt)], (16, 1))
    points = np.concatenate([rng.uniform(-0.5, 0.5, (16, 2)), np.full((16, 1), 0.3)], 1)
    actual = irradiance_at(points, normal, plane_of_texels(401), np.ones(401 * 401))
    # 0.004: the edge of the plane at 200 texels takes 0.3 / 200 of a view along the horizon
    assert actual == pytest.approx(np.full(16, (1 + math.cos(tilt)) / 2), abs=0.004)


def test_the_back_of_a_square_texel_is_dark():
    table = plane_of_texels(3)
    assert not irradiance_at([0, 0, -0.2], [0, 0, 1], table, np.ones(9)).any()
