"""The power law through measured times."""

import math

import pytest

from rtgi_addon.compare.fit import fit_power_law

EXACT = 1e-9                # logarithms and sums of a few float64
WORK = [1.0, 2.0, 4.0, 8.0, 16.0, 32.0]


@pytest.mark.parametrize("exponent", [-1.0, 0.0, 0.5, 1.0, 2.0])
def test_exact_power_law_comes_back(exponent):
    law = fit_power_law(WORK, [3.0 * work**exponent for work in WORK])
    assert law.exponent == pytest.approx(exponent, abs=EXACT) and law.factor == pytest.approx(3.0, rel=EXACT)
    assert law.standard_error == pytest.approx(0.0, abs=EXACT)
    assert law(100.0) == pytest.approx(3.0 * 100.0**exponent, rel=EXACT)


def test_more_noise_widens_the_error():
    def error(noise):
        return fit_power_law(WORK, [work * math.exp(noise * (-1) ** i) for i, work in enumerate(WORK)]).standard_error

    assert 0 < error(0.01) < error(0.1)


def test_error_of_alternating_noise_is_the_textbook_value():
    # x = 0, 1, 2, 3 in units of log 2; y = x + (e, -e, -e, e), which no line can follow: misses 4 e^2, spread 5 log(2)^2
    e = 0.2
    law = fit_power_law([1, 2, 4, 8], [math.exp(y) for y in (e, math.log(2) - e, 2 * math.log(2) - e, 3 * math.log(2) + e)])
    assert law.exponent == pytest.approx(1.0, abs=EXACT)
    assert law.standard_error == pytest.approx(math.sqrt(4 * e**2 / 2 / 5) / math.log(2), rel=EXACT)


def test_fixed_cost_bends_the_line_and_widens_the_error():
    law = fit_power_law(WORK, [5.0 + work for work in WORK])
    assert 0 < law.exponent < 1 and law.standard_error > 0.01


def test_two_points_have_no_error():
    law = fit_power_law([1, 4], [2.0, 4.0])
    assert law.exponent == pytest.approx(0.5, abs=EXACT) and law.standard_error is None and str(law) == "0.50"


@pytest.mark.parametrize(("work", "times"), [([2], [1.0]), ([2, 2], [1.0, 1.1]), ([1, 2], [0.0, 1.0])])
def test_no_law_is_made_up(work, times):
    assert fit_power_law(work, times) is None
