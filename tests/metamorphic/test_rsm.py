"""Laws that hold exactly for sums over texels and for the pass, and inputs that must not break them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rtgi_addon.core.frame import Frame, LightKind
from rtgi_addon.core.synthetic import make_room_frame
from rtgi_addon.core.techniques import RsmParams
from rtgi_addon.kernels import vpl
from rtgi_addon.kernels.bvh import build_bvh
from rtgi_addon.kernels.clusters import C_ALPHA2, cluster_texels
from rtgi_addon.kernels.gather import gather_visible
from rtgi_addon.kernels.jit import kernel_session
from rtgi_addon.passes.base import Context, Transport
from rtgi_addon.passes.rsm import compute_rsm, texel_table

METHODS = ("VISIBLE", "ALL", "PAPER")
ROUNDING = 2e-5             # sums of float32 in another order or with other digits


def unit(rng, n):
    v = rng.normal(size=(n, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def random_table(rng, n, glossy=True):
    table = np.zeros((17, n), np.float32)
    table[0:3], table[3:6], table[6:9] = rng.uniform(-1, 1, (3, n)), unit(rng, n).T, rng.random((3, n))
    to_light = unit(rng, n)
    table[9:12] = (to_light * np.sign(np.sum(to_light * table[3:6].T, axis=1, keepdims=True))).T
    table[15], table[16] = 2, 0.04
    if glossy:
        table[12:15], table[15] = rng.random((3, n)), rng.uniform(0.05, 1, n)
    return table


def points(rng, n):
    return rng.uniform(-1, 1, (n, 3)).astype(np.float32), unit(rng, n).astype(np.float32)


def random_map(rng, height=12, width=16):
    shape = (height, width, 3)
    return rng.uniform(-1, 1, shape), unit(rng, height * width).reshape(shape), rng.random(shape)


def polar(position, normal, column, row, texel_map, published=False, **changes):
    return vpl.gather_polar(position, normal, column, row, *texel_map, 6.0, 100, published, False, 3, **changes)


def render(frame, method, **changes):
    params = RsmParams(**{"method": method, "samples": 300, "rays": 16, "clusters": 32, "lattice_px": 2, **changes})
    return compute_rsm(frame, params, Context(), 5).light[Transport.BOUNCE_DIFFUSE]


@pytest.fixture(scope="module")
def room():
    return make_room_frame(24, 18, (LightKind.SPOT, LightKind.POINT))


def scaled_flux(frame, factor):
    views = tuple(dataclasses.replace(v, incident_flux=v.incident_flux * np.float32(factor)) for v in frame.views)
    return dataclasses.replace(frame, views=views)


# ---- linearity ----
def test_sum_over_texels_is_linear_in_flux(rng):
    table, (position, normal) = random_table(rng, 900), points(rng, 20)
    brighter = table.copy()
    brighter[6:9] *= 4
    brighter[12:15] *= 4
    assert np.array_equal(vpl.gather_all(position, normal, brighter, 0.0), 4 * vpl.gather_all(position, normal, table, 0.0))


def test_sums_over_parts_of_a_table_add_up(rng):
    table, (position, normal) = random_table(rng, 1100), points(rng, 20)
    whole = vpl.gather_all(position, normal, table, 1e-4)
    parts = vpl.gather_all(position, normal, table[:, :317], 1e-4) + vpl.gather_all(position, normal, table[:, 317:], 1e-4)
    assert np.allclose(whole, parts, rtol=ROUNDING)


def test_colours_do_not_mix(rng):
    table, (position, normal) = random_table(rng, 600), points(rng, 20)
    red = table.copy()
    red[[7, 8, 13, 14]] = 0
    actual = vpl.gather_all(position, normal, red, 0.0)
    assert np.array_equal(actual[:, 0], vpl.gather_all(position, normal, table, 0.0)[:, 0])
    assert not actual[:, 1:].any()


@pytest.mark.parametrize("near_field", ["EXACT", "GUARD"])
def test_texels_of_no_flux_give_exactly_zero(rng, near_field):
    table, (position, normal) = random_table(rng, 600), points(rng, 20)
    table[6:9] = table[12:15] = 0
    assert not vpl.gather_all(position, normal, table, 0.0).any()
    assert not vpl.gather_all(position, normal, table, 0.0, area_m2=np.ones(600), near_field=near_field).any()


@pytest.mark.parametrize("method", METHODS)
def test_the_pass_is_linear_in_the_lights_power(room, method):
    assert np.array_equal(render(scaled_flux(room, 4), method), 4 * render(room, method))


@pytest.mark.parametrize("method", METHODS)
def test_dark_lights_give_exactly_zero(room, method):
    assert not render(scaled_flux(room, 0), method).any()


@pytest.mark.parametrize("method", METHODS)
def test_a_frame_without_views_gives_exactly_zero(room, method):
    assert not render(dataclasses.replace(room, views=()), method).any()


# ---- geometry ----
def rotation(rng):
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


def test_sum_over_texels_is_blind_to_rigid_motion(rng):
    table, (position, normal) = random_table(rng, 700), points(rng, 20)
    turn, shift = rotation(rng), np.array([0.3, -0.5, 0.2])
    moved = table.astype(np.float64)
    moved[0:3] = turn @ moved[0:3] + shift[:, None]
    moved[3:6], moved[9:12] = turn @ moved[3:6], turn @ moved[9:12]
    actual = vpl.gather_all(position @ turn.T + shift, normal @ turn.T, moved, 1e-3)
    expected = vpl.gather_all(position, normal, table, 1e-3)
    # texels a few cm away and horizons lose digits of the coordinates
    assert np.allclose(actual, expected, rtol=1e-3)


@pytest.mark.parametrize("scale", [1e-3, 4.0, 1e4])
def test_scaling_the_scene_with_flux_fixed_divides_by_the_square(rng, scale):
    table, (position, normal) = random_table(rng, 700), points(rng, 20)
    larger = table.copy()
    larger[0:3] *= np.float32(scale)
    actual = vpl.gather_all(position * np.float32(scale), normal, larger, 1e-4 * scale**2)
    assert np.allclose(actual * scale**2, vpl.gather_all(position, normal, table, 1e-4), rtol=1e-3)


@pytest.mark.parametrize("published", [False, True])
@pytest.mark.parametrize("scale", [1e-2, 64.0])
def test_scaling_the_scene_divides_polar_sums_by_the_square(rng, scale, published):
    texel_map, (position, normal) = random_map(rng), points(rng, 20)
    column, row = rng.uniform(0, 16, 20), rng.uniform(0, 12, 20)
    larger = (texel_map[0] * scale, *texel_map[1:])
    actual = polar(position * np.float32(scale), normal, column, row, larger, published, eps2=1e-4 * scale**2)
    expected = polar(position, normal, column, row, texel_map, published, eps2=1e-4)
    assert np.allclose(actual * scale**2, expected, rtol=1e-3)


def test_the_order_of_texels_does_not_matter(rng):
    table, (position, normal) = random_table(rng, 1300), points(rng, 20)
    shuffled = table[:, rng.permutation(1300)]
    assert np.allclose(vpl.gather_all(position, normal, shuffled, 1e-4), vpl.gather_all(position, normal, table, 1e-4),
                       rtol=ROUNDING)


def test_a_round_view_turned_by_whole_columns_gives_the_same(rng):
    texel_map, (position, normal) = random_map(rng), points(rng, 20)
    column, row = rng.uniform(0, 16, 20).astype(np.float32), rng.uniform(0, 12, 20).astype(np.float32)
    turned = [np.roll(a, 5, axis=1) for a in texel_map]
    arguments = 6.0, 100, False, True, 3
    actual = vpl.gather_polar(position, normal, column + 5, row, *turned, *arguments)
    expected = vpl.gather_polar(position, normal, column, row, *texel_map, *arguments)
    # 5 added to a float32 column moves a sample across a texel's edge once in a while
    assert np.mean(np.isclose(actual, expected, rtol=1e-3)) > 0.95


# ---- threads ----
@pytest.mark.parametrize("method", METHODS)
def test_the_pass_is_bitwise_the_same_on_one_and_two_threads(room, method):
    images = []
    for threads in (1, 2):
        with kernel_session(threads):
            images.append(render(room, method))
    assert images[0].any() and np.array_equal(*images)


def test_kernels_are_bitwise_the_same_on_one_and_two_threads(rng):
    table, (position, normal), texel_map = random_table(rng, 800), points(rng, 101), random_map(rng)
    column, row = rng.uniform(0, 16, 101), rng.uniform(0, 12, 101)
    results = []
    for threads in (1, 2):
        with kernel_session(threads):
            results.append((vpl.gather_all(position, normal, table, 0.0),
                            vpl.gather_all(position, normal, table, 0.0, area_m2=np.full(800, 0.01)),
                            polar(position, normal, column, row, texel_map, rotate=True)))
    for one, two in zip(*results, strict=True):
        assert one.any() and np.array_equal(one, two)


def test_texel_tables_are_bitwise_the_same_on_one_and_two_threads(room):
    """Also with lit texels that reflect nothing at the ends of rows, whose columns belong to the next row."""
    views = []
    for view in room.views:
        albedo, specular = view.gbuffer.albedo.copy(), view.gbuffer.specular.copy()
        albedo[:, -3:] = specular[:, -3:] = 0
        views.append(dataclasses.replace(view, gbuffer=dataclasses.replace(view.gbuffer, albedo=albedo, specular=specular)))
    frame = dataclasses.replace(room, views=tuple(views))
    tables = []
    for threads in (1, 2):
        with kernel_session(threads):
            tables.append(texel_table(frame))
    assert np.array_equal(*tables)
    assert np.all(tables[0][6:9].sum(0) + tables[0][12:15].sum(0) > 0)


# ---- odd inputs ----
@given(seed=st.integers(0, 2**16), texels=st.integers(0, 40), count=st.integers(0, 5), coincide=st.booleans(),
       grazing=st.booleans(), scale=st.sampled_from([1e-6, 1e-3, 1.0, 1e3, 1e6]), flux=st.sampled_from([1e-20, 1.0, 1e6]),
       near=st.sampled_from([None, "EXACT", "GUARD"]))
def test_any_table_gives_finite_light_that_is_never_negative(seed, texels, count, coincide, grazing, scale, flux, near):
    rng = np.random.default_rng(seed)
    table, (position, normal) = random_table(rng, texels), points(rng, count)
    if coincide and texels and count:
        table[0:3] = position[rng.integers(0, count, texels)].T
        table[0:3, ::2] += np.float32(1e-7)
    if grazing:
        table[2], table[3:6], position[:, 2], normal[:] = 0, [[0], [0], [1]], 1e-9, [1, 0, 0]
    table[0:3], position = table[0:3] * np.float32(scale), position * np.float32(scale)
    table[6:9] *= np.float32(flux)
    table[12:15] *= np.float32(flux)
    area = None if near is None else np.full(texels, 0.01 * scale**2)
    e = vpl.gather_all(position, normal, table, 0.0, area_m2=area, near_field=near or "EXACT")
    assert e.shape == (count, 3) and e.dtype == np.float32
    assert np.isfinite(e).all() and (e >= 0).all()


@given(seed=st.integers(0, 2**16), height=st.integers(1, 6), width=st.integers(1, 6), samples=st.integers(1, 20),
       radius=st.sampled_from([0.0, 0.4, 3.0, 1e3]), published=st.booleans(), wrap=st.booleans(),
       place=st.sampled_from([0.0, 2.5, -1e9, 1e30, float("nan"), float("inf")]))
def test_any_place_in_a_map_gives_finite_light_never_negative(seed, height, width, samples, radius, published, wrap, place):
    rng = np.random.default_rng(seed)
    texel_map, (position, normal) = random_map(rng, height, width), points(rng, 3)
    texel_map[0][0, 0] = position[0]
    column, row = np.array([place, 0.5, place]), np.array([0.5, place, place])
    e = vpl.gather_polar(position, normal, column, row, *texel_map, radius, samples, published, wrap, seed)
    assert np.isfinite(e).all() and (e >= 0).all()


@given(seed=st.integers(0, 2**16), texels=st.integers(1, 40), clusters=st.integers(1, 40), coincide=st.booleans(),
       same_place=st.booleans())
def test_any_clusters_give_finite_light_that_is_never_negative(seed, texels, clusters, coincide, same_place):
    rng = np.random.default_rng(seed)
    table, (position, normal) = random_table(rng, texels), points(rng, 4)
    if coincide:
        table[0:3, :4] = position.T[:, :texels]
    if same_place:
        table[0:3] = table[0:3, :1]
    grouped = cluster_texels(table, clusters, 2.0)
    bvh = build_bvh(np.zeros((0, 3, 3), np.float32))
    e = gather_visible(position, normal, np.arange(4), grouped, np.float32(1e-8), bvh, 8, np.float32(1e-5), seed)
    assert np.isfinite(e).all() and (e[:, :3] >= 0).all()


def test_clusters_of_mirrors_are_no_smoother_than_mirrors(rng):
    table = random_table(rng, 900)
    table[15] = 0
    # rounding makes half of the unit vectors longer than 1, and a negative roughness has no square root
    assert (cluster_texels(table, 900, 2.0).table[C_ALPHA2] >= 0).all()


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("size", [(1, 1), (5, 1), (1, 7), (3, 2)])
def test_tiny_pictures_render(method, size):
    image = render(make_room_frame(*size), method, lattice_px=4)
    assert image.shape == (size[1], size[0], 3) and np.isfinite(image).all() and (image >= 0).all()


@pytest.mark.parametrize("method", METHODS)
def test_background_stays_black(room, method):
    """Pixels that see nothing get no light, whatever lies in the arrays there."""
    depth = room.gbuffer.depth.copy()
    depth[:5] = np.inf
    frame: Frame = dataclasses.replace(room, gbuffer=dataclasses.replace(room.gbuffer, depth=depth))
    image = render(frame, method)
    assert not image[:5].any() and image[5:].any()


@pytest.mark.parametrize(("factor", "rows", "others"), [("diffuse_factor", slice(6, 9), slice(12, 15)),
                                                        ("glossy_factor", slice(12, 15), slice(6, 9))])
def test_influence_of_a_lamp_scales_its_own_lobe_of_the_texels_only(room, factor, rows, others):
    half = dataclasses.replace(room, lights=tuple(dataclasses.replace(light, **{factor: 0.5}) for light in room.lights))
    whole, less = texel_table(room), texel_table(half)
    assert whole[rows].any() and whole[others].any()
    np.testing.assert_array_equal(less[rows], np.float32(0.5) * whole[rows])
    np.testing.assert_array_equal(less[others], whole[others])


def test_texels_that_a_lamp_has_no_influence_on_are_left_out(room):
    none = dataclasses.replace(room, lights=tuple(dataclasses.replace(light, diffuse_factor=0.0, glossy_factor=0.0)
                                                  for light in room.lights))
    assert texel_table(none).shape[1] == 0
