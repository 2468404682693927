"""The targets' table: what is met, what is not, and what is blamed."""

from __future__ import annotations

import pytest

from rtgi_addon.compare import targets


def row(seconds, block=None, **stages_ms):
    found = {"seconds": seconds, "stages_ms": stages_ms}
    if block is not None:
        found["errors"] = {"picture": {"block": block}, "direct": {"of_picture": 0.01}, "bounce": {"of_picture": 0.03},
                           "glossy bounce": {"of_picture": 0.002}}
    return found


def record(balanced, **more):
    return {"scene": "box", "rtgi": {"BALANCED": balanced, **more.get("rtgi", {})}, "cycles": more.get("cycles", {})}


def peer(seconds, block):
    return {"seconds": seconds, "errors": {"picture": {"block": block}}}


def cell(text, target):
    head, _, line = [line for line in text.splitlines() if line.startswith("|")]
    names = [name.strip() for name in head.strip("|").split("|")]
    return line.strip("|").split("|")[names.index(target)].strip()


def test_a_target_that_is_met_is_a_plain_number():
    found = targets.table([record(row(0.3, 0.02), cycles={"1": peer(1.0, 0.05), "4": peer(1.5, 0.03)})])
    assert cell(found, "Balanced: time over a third of Cycles 1's") == "0.90"
    assert cell(found, "Balanced: error over Cycles 4's") == "0.67"


def test_what_is_too_slow_names_the_slowest_stages_with_their_shares():
    slow = row(1.0, None, rsm=500.0, direct=300.0, ssr=100.0)
    found = targets.table([record(slow, cycles={"1": peer(1.5, 0.05)})])
    assert cell(found, "Balanced: time over a third of Cycles 1's") == "**2.00** rsm 50 %, direct 30 %"


def test_what_is_too_far_off_names_the_kinds_of_light_that_are():
    found = targets.table([record(row(1.0, 0.06), cycles={"4": peer(1.5, 0.03)})])
    assert cell(found, "Balanced: error over Cycles 4's") == "**2.00** bounce 3.00 %, direct 1.00 %"


def test_techniques_are_held_against_capture_and_draft_against_the_cameras_part_of_it():
    stages = {"camera view": 100.0, "light views": 50.0, "rsm": 300.0, "write": 40.0}
    found = targets.table([record(row(1.0, None, **stages), rtgi={"DRAFT": row(0.2, None, **stages)})])
    assert cell(found, "Balanced: techniques over capture") == "**2.00** rsm 100 %, direct 0 %"
    assert cell(found, "Draft: time over 2.5 times the camera's capture") == "0.80"


def test_what_was_not_measured_is_left_out():
    found = targets.table([record(row(1.0))])
    assert "Cycles 1" not in found.splitlines()[2] and "Quality" not in found.splitlines()[2]


@pytest.mark.parametrize("value", [1.0, 0.999])
def test_the_bar_itself_is_met(value):
    assert targets.Verdict(value, "").is_met and not targets.Verdict(1.001, "").is_met
