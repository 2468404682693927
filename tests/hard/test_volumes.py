"""Light propagation volumes: lobes of two bands are negative on their back, and clamped steps make light of nothing."""

from __future__ import annotations

import pytest

from tests import hard_cases

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.mark.parametrize("steps", [1, 8, 16])
def test_steps_without_clamping_neither_add_nor_lose_light(steps):
    # T25: the negative part of a lobe moves on with its sign; clamped it becomes an eighth more light
    assert hard_cases.growth_of_flux(False, steps) < 1e-6
    assert hard_cases.growth_of_flux(True, steps) == pytest.approx(0.1382, abs=1e-3)


@pytest.mark.parametrize("mode", ["HARMONICS", "PAPER"])
def test_light_in_a_closed_room_settles(mode):
    # what is left in motion after 64 steps of 8 cells
    assert hard_cases.settled(mode) < 1e-3


def test_directions_fall_off_as_they_should_where_the_published_form_does_not():
    # T27: single directions lie within 1.75, harmonics within 2.5
    assert hard_cases.fall_off("ORDINATES") < 1.75
    assert hard_cases.fall_off("HARMONICS") < 2.5
    assert hard_cases.fall_off("PAPER") > 5
