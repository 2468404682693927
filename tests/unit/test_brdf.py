"""The glossy lobe: Fresnel, normalisation, reciprocity, and the fit to a known reflectance."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rtgi_addon.kernels.brdf import (
    F0,
    GAIN_STEPS,
    albedo_table,
    fit_lobe,
    fresnel,
    ggx_lobe,
    lobe_albedos,
    matt_share,
    mean_albedo_table,
    reflected_share,
    sample_lobe,
)
from rtgi_addon.kernels.vec3 import Vec3, f32

UP = Vec3(f32(0), f32(0), f32(1))


def tilted(cosine, phi=0.0):
    sine = math.sqrt(max(0.0, 1 - cosine * cosine))
    return Vec3(f32(sine * math.cos(phi)), f32(sine * math.sin(phi)), f32(cosine))


def hemispherical(cos_fixed, alpha, f0, steps=400):
    """Integral of the lobe over `other`: midpoints on a grid that is finer towards the mirror direction."""
    fixed, total = tilted(cos_fixed), 0.0
    for i in range(steps):
        cos_o = (i + 0.5) / steps
        for j in range(steps // 2):
            phi = math.pi * (1 - ((j + 0.5) / (steps // 2)) ** 2)
            width = 2 * math.pi * (j + 0.5) / (steps // 2) ** 2
            total += ggx_lobe(UP, fixed, tilted(cos_o, phi), f32(alpha * alpha), f32(f0)) * width / steps * 2
    return total


@pytest.mark.parametrize(("degrees", "expected"), [(0, 0.04), (60, 0.0892), (90, 1.0)])
def test_fresnel_of_glass_has_the_textbook_values(degrees, expected):
    assert fresnel(f32(math.cos(math.radians(degrees))), F0) == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize("index", [1.33, 1.45, 1.6, 1.8])
@pytest.mark.parametrize("degrees", [30, 50, 60, 70, 80])
def test_fresnel_of_other_indices_is_near_the_equations(index, degrees):
    c, f0 = math.cos(math.radians(degrees)), ((index - 1) / (index + 1)) ** 2
    g = math.sqrt(index**2 - 1 + c * c)
    exact = 0.5 * ((g - c) / (g + c)) ** 2 * (1 + ((c * (g + c) - 1) / (c * (g - c) + 1)) ** 2)
    assert fresnel(f32(c), f32(f0)) == pytest.approx(exact, rel=0.03)


def test_fresnel_vanishes_for_polarised_light_at_brewsters_angle_only_by_half():
    # at 56.3 degrees the parallel part is 0: reflectance is half of ((n^2 - 1) / (n^2 + 1))^2
    assert fresnel(f32(1 / math.sqrt(1 + 1.5**2)), F0) == pytest.approx(0.5 * (1.25 / 3.25) ** 2, rel=1e-4)


def test_perfect_metal_reflects_everything_at_every_angle():
    assert [fresnel(f32(c), f32(1)) for c in (0.0, 0.3, 1.0)] == [1.0, 1.0, 1.0]


@pytest.mark.parametrize("reflectance", [0.05, 0.3, 0.9])
@pytest.mark.parametrize("alpha", [0.2, 0.5, 0.95])
@pytest.mark.parametrize("cosine", [0.25, 0.6, 0.95])
def test_lobe_times_gain_integrates_to_one(reflectance, alpha, cosine):
    f0, gain = fit_lobe(f32(reflectance), f32(cosine), f32(alpha), albedo_table())
    # linear interpolation in 32 cells, and the grid of the test
    assert gain * hemispherical(cosine, alpha, f0) == pytest.approx(1.0, rel=0.02)


@pytest.mark.parametrize("cosine", [0.3, 0.7, 1.0])
def test_mirror_needs_no_gain(cosine):
    # a perfect mirror reflects its Fresnel reflectance towards its one direction, and the lobe is relative to that;
    # the first cell of the table is an alpha of 1/64
    assert fit_lobe(f32(1), f32(cosine), f32(0), albedo_table())[1] == pytest.approx(1.0, rel=0.02)


def test_lobe_is_reciprocal_without_fresnel():
    a, b, alpha2 = tilted(0.4), tilted(0.8, 2.0), f32(0.09)
    assert ggx_lobe(UP, a, b, alpha2, f32(1)) / b.z == pytest.approx(ggx_lobe(UP, b, a, alpha2, f32(1)) / a.z, rel=1e-5)


def test_lobe_is_zero_below_the_horizon():
    assert ggx_lobe(UP, tilted(0.5), tilted(-0.1), f32(0.1), F0) == 0


def test_sharp_lobe_peaks_in_the_mirror_direction():
    values = [ggx_lobe(UP, tilted(0.6), tilted(0.6, math.pi + d), f32(1e-3), F0) for d in (-0.1, 0.0, 0.1)]
    assert values[1] > 10 * max(values[0], values[2])


@pytest.mark.parametrize("cosine", [0.15, 0.5, 1.0])
def test_what_reflects_like_a_dielectric_is_one(cosine):
    reflectance = fresnel(f32(cosine), F0)
    assert fit_lobe(reflectance, f32(cosine), f32(0.02), albedo_table())[0] == pytest.approx(0.04, abs=0.01)


@pytest.mark.parametrize("f0", [0.3, 0.6, 0.95])
def test_metal_keeps_its_reflectance_at_normal_incidence(f0):
    assert fit_lobe(f32(f0), f32(1), f32(0.1), albedo_table())[0] == pytest.approx(f0, rel=0.01)


def dielectric_reflectance(cosine, alpha):
    flat, rise = lobe_albedos(albedo_table(), f32(cosine), f32(alpha))
    return F0 * flat + (1 - F0) * rise


@pytest.mark.parametrize("alpha", [0.05, 0.25, 0.9])
def test_what_lies_under_a_dielectric_sends_out_in_the_mean_what_the_lobe_leaves(alpha):
    cosines = (np.arange(GAIN_STEPS) + 0.5) / GAIN_STEPS
    left = [1 - dielectric_reflectance(c, alpha) for c in cosines]
    mean = 2 * np.mean(np.array(left) * cosines)
    for cosine, seen in list(zip(cosines, left, strict=True))[4::9]:      # below, fit_lobe's bound of r decides
        share = matt_share(f32(1 - seen), f32(cosine), f32(alpha), F0, albedo_table(), mean_albedo_table())
        assert share * seen == pytest.approx(mean, rel=2e-3)              # a table in float32, interpolated


def test_nothing_lies_under_a_metal():
    assert matt_share(f32(0.7), f32(0.4), f32(0.2), f32(0.65), albedo_table(), mean_albedo_table()) == 1


def test_table_is_finite_and_no_surface_reflects_more_than_it_gets():
    table = albedo_table()
    # single scattering loses light; 1 % for the rule's own error at grazing
    assert np.isfinite(table).all() and (table >= 0).all() and table.max() <= 1.01


@pytest.mark.parametrize("cosine", [0.25, 0.9])
def test_single_scattering_loses_what_the_microfacets_hide(cosine):
    # a perfect reflector's colour is 1, and what it reflects is the integral of its lobe
    alpha, table = 0.6, albedo_table()
    lost = hemispherical(cosine, alpha, 1.0)
    assert lost < 0.95
    assert reflected_share(f32(1), f32(cosine), f32(alpha), f32(1), False, table) == pytest.approx(lost, rel=0.01)
    assert reflected_share(f32(1), f32(cosine), f32(alpha), f32(1), True, table) == pytest.approx(1, rel=1e-5)


def mean_over_visible_normals(cosine, alpha, f0, steps=400):
    """Fresnel's reflectance over the normals that `fixed` sees: of those that reflect upwards all, else 0 of its rise."""
    fixed, total, seen = np.array(tilted(cosine)), 0.0, 0.0
    for theta in (np.arange(steps) + 0.5) / steps * math.pi / 2:
        phi = (np.arange(steps) + 0.5) / steps * 2 * math.pi
        h = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.full(steps, np.cos(theta))], 1)
        toward = np.maximum(h @ fixed, 0)
        # GGX times cosine, of the visible part: Heitz 2018, Eq. 3, up to a factor that normalises it
        density = alpha**2 / ((np.cos(theta) ** 2 * (alpha**2 - 1) + 1) ** 2) * toward * np.sin(theta)
        rises = np.array([(float(fresnel(f32(c), F0)) - 0.04) / 0.96 for c in toward])
        seen += density.sum()
        total += (density * rises * (2 * toward * h[:, 2] - cosine > 0)).sum()
    return f0 + (1 - f0) * total / seen


@pytest.mark.parametrize(("cosine", "alpha"), [(0.25, 0.25), (0.45, 0.25), (0.45, 0.64), (0.95, 0.64)])
def test_what_glossy_color_tells_of_a_dielectric_is_turned_into_what_it_reflects(cosine, alpha):
    told = mean_over_visible_normals(cosine, alpha, 0.04)
    reflected = hemispherical(cosine, alpha, 0.04) * fresnel(f32(cosine), F0)
    share = reflected_share(f32(told), f32(cosine), f32(alpha), F0, False, albedo_table())
    assert share * told == pytest.approx(reflected, rel=0.015)       # cells of the table, and 32 x 32 nodes


def drawn(cosine, alpha, steps=96):
    """Directions (N, 3) drawn from the lobe on an even grid of numbers, and their weights (N,)."""
    out = [sample_lobe(UP, tilted(cosine), f32(alpha), f32((i + 0.5) / steps), f32((j + 0.5) / steps))
           for i in range(steps) for j in range(steps)]
    return np.array([d for d, _ in out]), np.array([w for _, w in out])


@pytest.mark.parametrize("alpha", [0.05, 0.3, 0.98])
@pytest.mark.parametrize("cosine", [0.2, 0.6, 0.98])
def test_mean_weight_of_drawn_directions_is_the_lobes_albedo(cosine, alpha):
    direction, weight = drawn(cosine, alpha)
    assert (direction[:, 2] > 0).all() and (weight >= 0).all() and weight.max() < 1.02
    # without Fresnel the lobe's integral is that of a perfect reflector
    assert weight.mean() == pytest.approx(hemispherical(cosine, alpha, 1.0), rel=0.02)


@pytest.mark.parametrize(("cosine", "alpha"), [(0.3, 0.5), (0.8, 0.25)])
def test_drawn_directions_have_the_lobes_mean_direction(cosine, alpha):
    # the moments of the lobe by a grid over the half sphere against those of the weighted draws
    steps, total, mean = 400, 0.0, np.zeros(3)
    for c in (np.arange(steps) + 0.5) / steps:
        for phi in (np.arange(steps) + 0.5) / steps * 2 * math.pi:
            d = tilted(c, phi)
            lobe = ggx_lobe(UP, tilted(cosine), d, f32(alpha * alpha), f32(1))
            total, mean = total + lobe, mean + lobe * np.array(d)
    direction, weight = drawn(cosine, alpha)
    assert np.allclose(weight @ direction / weight.sum(), mean / total, atol=0.005)


def test_lobe_without_roughness_is_drawn_as_the_mirror_direction():
    direction, weight = drawn(0.6, 0.0, 8)
    assert np.allclose(direction, tilted(0.6, math.pi), atol=1e-6) and np.allclose(weight, 1)
