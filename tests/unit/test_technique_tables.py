"""The tables of techniques: every technique and way has a row, and records become the words they should."""

from __future__ import annotations

import dataclasses

import pytest

from rtgi_addon.core.techniques import TECHNIQUE_PARAMS
from tools import technique_tables as tables
from tools.parameter_tables import between_marks


def record(scene: str = "box", **ways: dict[str, float]) -> dict:
    noise = dict.fromkeys((tables.AS_IT_IS, tables.SKY), {"picture": 0.01, "bounce": 0.02, "direct": 0.001})
    return {"scene": scene, "size": [64, 36], "threads": 2, "ways": ways, "noise": noise,
            "everything": {"picture": 0.05, "ms": 80.0}, "unshadowed": {"light": 30.0, "energy": 31.0, "scaled": 0.4}}


def found(light: float = 0.12, energy: float = 0.9) -> dict[str, float]:
    return {"light": light, "energy": energy, "scaled": 0.1, "picture": 0.034, "ms": 8.04}


def way_of(technique: str) -> tables.Way:
    return next(w for w in tables.WAYS if w.technique == technique)


@pytest.mark.parametrize("name", TECHNIQUE_PARAMS)
def test_every_technique_has_a_row_of_its_own(name):
    assert [w for w in tables.WAYS if w.technique == name and not w.detail] != []


@pytest.mark.parametrize("name", ["rsm", "lpv", "ssr", "hbao", "ssao", "ssdo"])
def test_every_choice_of_a_method_has_a_row(name):
    ways = [w for w in tables.WAYS if w.technique == name]
    field = next(f for f in dataclasses.fields(TECHNIQUE_PARAMS[name]) if f.metadata["choices"])
    shown = {w.params.get(field.name, field.default) for w in ways}
    assert {identifier for identifier, _, _ in field.metadata["choices"]} <= shown


def test_no_two_rows_are_kept_under_one_name():
    assert len({w.key for w in tables.WAYS}) == len(tables.WAYS)


@pytest.mark.parametrize("way", tables.WAYS, ids=lambda w: w.key)
def test_parameters_of_a_row_are_valid(way):
    known = {k: v for k, v in way.params.items() if v != tables.WHOLE_SCENE}
    dataclasses.replace(TECHNIQUE_PARAMS[way.technique](), **known).validate(way.technique)


def test_a_scene_without_the_light_has_a_dash():
    way = way_of("rsm")
    text = tables.page([record("box", **{way.key: found()}), record("open")])
    assert f"| {way.label} | 3.40 %, 8.0 ms | - |" in text


def test_direct_light_alone_stands_on_top():
    ways = {w.key: found() for w in tables.WAYS}
    rows = [line for line in tables.page([record("box", **ways)]).splitlines() if line.startswith("| ")]
    assert rows[2].startswith("| Direct light alone ")


def test_errors_that_say_no_more_than_wrong_are_cut():
    way = way_of("ssao")
    assert "| > 1000 % (31), 8.0 ms |" in tables.page([record("box", **{way.key: found(11.0, 31.0)})])


def test_a_technique_without_light_in_any_scene_says_so():
    assert tables.tables_of("emission", [record()]) == "No scene that was measured has this light.\n"


def test_marks_keep_what_is_around_them():
    page = "before\n<!-- x -->\nold\n<!-- /x -->\nafter <!-- y -->\n"
    assert between_marks(page, "x", "new \\1\n") == "before\n<!-- x -->\nnew \\1\n<!-- /x -->\nafter <!-- y -->\n"
