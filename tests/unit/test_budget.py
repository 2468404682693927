"""A budget: the settings that it chooses, what it says of them, and how a calibration becomes laws and fronts."""

from __future__ import annotations

import dataclasses
import itertools
import json
import math

import pytest

from rtgi_addon import budget
from rtgi_addon.budget import Step, Table, TimeLaw, Work, within_budget
from rtgi_addon.core.techniques import PRESET_PARAMS, TECHNIQUE_PARAMS, default_settings
from rtgi_addon.errors import InputError
from rtgi_addon.planner import Plan
from tools import calibrate

FACTS = {"surface_pixels": 1e5, "triangles": 1e3, "lights": 1, "glossy_share": 1.0}
PLAN = Plan(("direct", "rsm"), (), FACTS)


def steps(name, *values):
    """Steps of a technique from (setting, ms, error)."""
    return tuple(Step({name: setting}, TimeLaw(ms, 1.0), error, 2 * error) for setting, ms, error in values)


TABLE = Table({"direct": steps("soft_shadow_rays", (4, 10, 0.02), (16, 20, 0.01), (64, 100, 0.009)),
               "rsm": steps("rays", (8, 50, 0.11), (16, 100, 0.05), (64, 400, 0.04))}, TimeLaw(30, 1.0), 10.0)


def choose(seconds=0.0, error=0.0, plan=PLAN, spent_ms=100.0, **kwargs):
    settings = dataclasses.replace(default_settings(), target_time_s=seconds, target_error=error)
    return within_budget(plan, settings, spent_ms, table=TABLE, **kwargs)


def chosen(choice):
    return choice.settings.params["direct"].soft_shadow_rays, choice.settings.params["rsm"].rays


def test_without_a_target_nothing_changes():
    settings = default_settings()
    choice = within_budget(PLAN, settings, 100.0, table=TABLE)
    assert choice.settings is settings and choice.plan is PLAN


@pytest.mark.parametrize(("seconds", "wanted"), [
    (0.191, (4, 8)),        # 100 of capture, 30 of the rest, 10 and 50: nothing more fits
    (0.201, (16, 8)),       # a step of direct light takes 10 ms
    (0.241, (4, 16)),       # but the bounce's first step removes 0.0012 a ms, direct light's 0.001
    (0.251, (16, 16)), (0.551, (16, 64)), (0.631, (64, 64)), (99.0, (64, 64))])
def test_a_target_time_buys_the_steps_that_remove_the_most_error_for_their_time(seconds, wanted):
    choice = choose(seconds)
    assert chosen(choice) == wanted
    assert choice.plan.facts["forecast_s"] <= seconds


def test_a_target_time_that_capture_alone_exceeds_says_so_and_runs_the_fastest():
    choice = choose(0.05)
    assert chosen(choice) == (4, 8)
    assert any("cannot be met: capture took 0.10 s" in line for line in choice.plan.budget)


@pytest.mark.parametrize(("error", "wanted"), [(0.2, (4, 8)), (0.11, (4, 16)), (0.061, (16, 16)), (0.055, (16, 64))])
def test_a_target_error_takes_the_fastest_settings_that_reach_it(error, wanted):
    choice = choose(error=error)
    assert chosen(choice) == wanted
    assert choice.plan.facts["forecast_error"] <= error
    assert not any("cannot" in line for line in choice.plan.budget)


def test_a_target_error_below_all_that_was_measured_says_so_and_runs_the_nearest():
    choice = choose(error=0.001)
    assert chosen(choice) == (64, 64)
    assert any("cannot be met by any measured setting" in line for line in choice.plan.budget)


def test_more_time_never_means_more_error():
    errors = [choose(ms / 1e3).plan.facts["forecast_error"] for ms in range(180, 700, 7)]
    assert all(later <= earlier for earlier, later in itertools.pairwise(errors))


def test_a_slow_machine_gets_less_and_a_fast_one_more():
    slow, fast = choose(0.25, speed=3.0), choose(0.25, speed=0.3)
    assert slow.plan.facts["forecast_error"] > choose(0.25).plan.facts["forecast_error"] > fast.plan.facts["forecast_error"]


def test_a_technique_whose_method_was_changed_keeps_its_settings():
    settings = dataclasses.replace(default_settings().with_params("rsm", method="PAPER", rays=5), target_time_s=9.0)
    choice = within_budget(PLAN, settings, 100.0, table=TABLE)
    assert choice.settings.params["rsm"] == settings.params["rsm"]
    assert any("Reflective Shadow Maps keep their own settings" in line for line in choice.plan.budget)


def test_only_what_is_planned_is_paid_for():
    choice = choose(0.25, plan=Plan(("direct",), (), FACTS))
    assert choice.settings.params["direct"].soft_shadow_rays == 64
    assert choice.settings.params["rsm"] == default_settings().params["rsm"]


def test_time_grows_with_the_work():
    law = TimeLaw(10.0, 1.0, 0.5, 1.0, 0.5)
    assert law(Work(1e5, 1e3, 1, 1)) == pytest.approx(10)
    assert law(Work(4e5, 4e3, 3, 1)) == pytest.approx(10 * 4 * 2 * 3)
    assert law(Work(1e5, 1e3, 1, 0.25)) == pytest.approx(5)
    assert law(Work(0, 0, 0, 0)) > 0


@pytest.mark.parametrize(("seconds", "error", "words"), [
    (1.0, 0.1, "not both"), (-1.0, 0.0, "target time must be 0 s or more"), (0.0, 1.5, "less than 100 %"),
    (math.nan, 0.0, "target time must be"), (math.inf, 0.0, "target time must be")])
def test_targets_that_cannot_be_are_refused(seconds, error, words):
    with pytest.raises(InputError, match=words):
        dataclasses.replace(default_settings(), target_time_s=seconds, target_error=error).validate()


def test_frames_that_take_longer_than_forecast_correct_the_next_forecast(monkeypatch):
    monkeypatch.setattr(budget, "_corrections", {})
    monkeypatch.setattr(budget, "_probed", lambda threads: 2.0)
    assert budget.speed_of(2) == 2.0
    choice = choose(0.25)
    budget.learn(choice, [{"name": "direct", "ms": 4 * choice.techniques_ms}, {"name": "write", "ms": 1e6}], 2)
    assert budget.speed_of(2) == pytest.approx(2 * math.sqrt(4))
    assert budget.speed_of(1) == 2.0
    for _ in range(50):
        budget.learn(choice, [{"name": "direct", "ms": 1e9}], 2)
    assert budget.speed_of(2) == 2 * 8


# ---- the table that comes with RTGI ----

def test_every_step_of_the_own_table_is_a_valid_setting_slower_and_nearer_than_the_one_before():
    table, entries = budget.own_table(), json.loads(budget.TABLE.read_text(encoding="utf-8"))["techniques"]
    assert {"direct", "world", "emission", "rsm", "final_gather", "ssr"} <= set(table.steps) <= set(TECHNIQUE_PARAMS)
    for name, ladder in table.steps.items():
        for step in ladder:
            dataclasses.replace(TECHNIQUE_PARAMS[name](), **step.params).validate(name)
            assert step.time.ms > 0 and 0 <= step.error <= step.high_error
        for before, after in itertools.pairwise(entries[name]["steps"]):
            assert after["typical_ms"] > before["typical_ms"] and after["mean_error"] < before["mean_error"]


@pytest.mark.parametrize("preset", PRESET_PARAMS)
@pytest.mark.parametrize("name", ["direct", "world", "emission", "rsm", "final_gather", "ssr"])
def test_presets_are_points_of_the_measured_front(name, preset):
    captured = TECHNIQUE_PARAMS[name].for_capture()
    params = {field: value for field, value in PRESET_PARAMS[preset][name].items() if field not in captured}
    assert params in [step.params for step in budget.own_table().steps[name]]


# ---- how it is made ----

def sample(setting, pixels, triangles, lamps, gloss, ms, error=None):
    return calibrate.Sample("rsm", setting, "scene", pixels, triangles, lamps, gloss, ms, error)


def test_a_law_is_found_again_from_its_own_times():
    laws = [TimeLaw(20.0, 0.8, 0.2, 0.6, 0.3), TimeLaw(50.0, 1.0, 0.2, 0.6, 0.3)]
    samples = [sample(i, p, t, n, g, law(Work(p, t, n, g))) for i, law in enumerate(laws)
               for p, t, n, g in itertools.product((5e4, 2e5, 5e5), (2e3, 1e5), (1, 8), (0.1, 0.9))]
    found = calibrate.fit_laws(samples)
    for number, law in enumerate(laws):
        for field in dataclasses.fields(TimeLaw):
            # what a power is likely to be counts as half a measurement among 24
            assert found[number][field.name] == pytest.approx(getattr(law, field.name), rel=0.02)
    assert calibrate.spread_of(samples, found) == pytest.approx(1.0, abs=0.02)


def test_a_single_size_gives_a_likely_power_of_the_pixels():
    law = calibrate.fit_laws([sample(0, 1e5 + k, 1e3, 1, 1, ms) for k, ms in enumerate((10.0, 30.0, 10.0))])[0]
    assert law["pixels"] == pytest.approx(calibrate.LIKELY_POWER, abs=0.01)


def test_more_work_never_takes_less_time_by_a_law():
    samples = [sample(0, 1e5 * k, 1e3 * k, 1, 1, 10.0 / k) for k in (1, 2, 4)]
    law = calibrate.fit_laws(samples)[0]
    assert min(law[name] for name in ("pixels", "triangles", "lamps", "glossy_share")) >= 0


def test_the_front_is_the_lower_hull():
    points = [(1, 10), (2, 9), (2.5, 4), (4, 5), (5, 3.2), (9, 3.5), (10, 1)]
    assert calibrate.front(points) == [0, 2, 6]     # (5, 3.2) lies above the line from (2.5, 4) to (10, 1)


def test_what_was_captured_does_not_keep_a_technique_from_its_budget():
    settings = dataclasses.replace(default_settings("DRAFT"), target_error=0.02).with_params("rsm", map_texels=12345)
    plan = Plan(("rsm",), facts={"surface_pixels": 2e5, "triangles": 1e3, "lights": 1, "glossy_share": 0.5})
    chosen = within_budget(plan, settings, 100.0).settings.params["rsm"]
    assert chosen != settings.params["rsm"] and chosen.map_texels == 12345
