"""Speed against error: the front, the crossings, and what is said of them."""

import pytest

from rtgi_addon.compare import pareto
from rtgi_addon.compare.pareto import Point

EXACT = 1e-12               # logarithms of a few float64
# error falls with the root of time: 8 % / sqrt(samples)
CYCLES = [Point(f"Cycles {n}", 0.5 * n, 0.08 / n**0.5, "Cycles") for n in (1, 4, 16)]
OWN = Point("RTGI", 0.5, 0.03)
ALL = [OWN, Point("direct only", 0.3, 0.2), Point("slow", 9.0, 0.09), *CYCLES]


def test_front_holds_what_nothing_beats_in_both():
    assert [p.name for p in pareto.pareto_front(ALL)] == ["direct only", "RTGI", "Cycles 16"]


def test_of_equal_points_one_is_on_the_front():
    assert pareto.pareto_front([OWN, Point("twin", OWN.seconds, OWN.error)]) == [OWN]


def test_time_for_an_error_follows_the_power_law_between_samples():
    # 0.08 / sqrt(2 t) = 0.03
    assert pareto.seconds_for_error(CYCLES, 0.03) == pytest.approx((0.08 / 0.03) ** 2 / 2, rel=EXACT)


def test_error_at_a_time_follows_the_power_law_between_samples():
    assert pareto.error_at_seconds(CYCLES, 1.0) == pytest.approx(0.08 / 2**0.5, rel=EXACT)


def test_a_point_of_the_curve_is_met_exactly():
    assert pareto.seconds_for_error(CYCLES, 0.04) == pytest.approx(2.0, rel=EXACT)
    assert pareto.error_at_seconds(CYCLES, 2.0) == pytest.approx(0.04, rel=EXACT)


def test_points_of_a_curve_that_took_equally_long_are_no_error():
    assert pareto.error_at_seconds([Point("a", 1.0, 0.1), Point("b", 1.0, 0.05)], 1.0) == 0.1


@pytest.mark.parametrize("error", [0.09, 0.001])
def test_no_time_is_made_up_beyond_the_curve(error):
    assert pareto.seconds_for_error(CYCLES, error) is None


@pytest.mark.parametrize("seconds", [0.4, 8.1])
def test_no_error_is_made_up_beyond_the_curve(seconds):
    assert pareto.error_at_seconds(CYCLES, seconds) is None


def test_words_name_the_front_and_how_much_longer_cycles_takes():
    front, cycles = pareto.words(OWN, ALL)
    assert "direct only (0.3 s, 20 %), RTGI (0.5 s, 3 %), Cycles 16 (8 s, 2 %)" in front
    assert "after 3.6 s, 7.1 times its 0.5 s; in RTGI's time it is at 8 %." in cycles


def test_words_say_who_beats_a_render_that_is_not_on_the_front():
    assert "slow is not on it: RTGI is faster and nearer." in pareto.words(ALL[2], ALL)


@pytest.mark.parametrize(("own", "said"), [
    (Point("RTGI", 5.0, 0.03), "after 3.6 s, sooner than RTGI (5 s)"),
    (Point("RTGI", 0.1, 0.1), "is below RTGI's error of 10 % from its first picture on, Cycles 1 at 0.5 s"),
    (Point("RTGI", 0.6, 0.1), "is faster and nearer than RTGI from its first picture on"),
    (Point("RTGI", 0.5, 0.001), "does not come down to RTGI's error of 0.1 % in what was measured: Cycles 16 takes 8 s")])
def test_every_place_of_a_curve_has_its_words(own, said):
    assert said in pareto.crossing(own, CYCLES, "Cycles")


def test_curve_that_is_never_as_near_has_no_crossing_point():
    assert pareto.crossing_point(Point("RTGI", 0.5, 0.001), CYCLES, "Cycles") is None
    assert pareto.crossing_point(CYCLES[1], CYCLES, "Cycles") is None
