"""Parameters, presets and settings agree with each other."""

import dataclasses
import subprocess
import sys

import pytest

from rtgi_addon.core.settings import PRESETS
from rtgi_addon.core.techniques import LABELS, PRESET_PARAMS, TECHNIQUE_PARAMS, default_settings, preset_params
from rtgi_addon.errors import InputError


def test_balanced_preset_equals_the_defaults():
    assert preset_params("BALANCED") == {name: kind() for name, kind in TECHNIQUE_PARAMS.items()}


def test_every_preset_has_parameters_and_all_are_in_range():
    assert set(PRESET_PARAMS) == {p[0] for p in PRESETS}
    for preset in PRESET_PARAMS:
        default_settings(preset).validate()


def test_presets_decide_the_same_fields():
    fields = [{(name, field) for name, changes in p.items() for field in changes} for p in PRESET_PARAMS.values()]
    assert all(f == fields[0] for f in fields)


def test_every_number_has_a_range_and_every_field_a_description():
    for kind in TECHNIQUE_PARAMS.values():
        for field in dataclasses.fields(kind):
            meta = field.metadata
            assert meta["doc"]
            if not isinstance(field.default, (bool, str)):
                assert meta["low"] <= field.default <= meta["high"], f"{kind.__name__}.{field.name}"


def test_registry_and_panels_call_techniques_the_same():
    from rtgi_addon.passes import TECHNIQUES

    assert {name: technique.label for name, technique in TECHNIQUES.items()} == LABELS


def test_a_setting_that_is_hidden_at_times_names_settings_and_values_that_exist():
    for kind in TECHNIQUE_PARAMS.values():
        fields = {field.name: field for field in dataclasses.fields(kind)}
        for field in fields.values():
            for name, values in field.metadata["only"].items():
                known = [c[0] for c in fields[name].metadata["choices"]] or [True, False]
                assert set(values if isinstance(values, tuple) else (values,)) <= set(known), f"{kind.__name__}.{field.name}"


def test_listed_techniques_run_without_the_planner():
    settings = default_settings(techniques=["rsm"])
    assert not settings.use_auto and [k for k, v in settings.enabled.items() if v] == ["direct", "world", "emission", "rsm"]


def test_empty_list_leaves_what_always_runs():
    assert [k for k, v in default_settings(techniques=[]).enabled.items() if v] == ["direct", "world", "emission"]


def test_unknown_technique_is_refused():
    with pytest.raises(InputError, match="no technique is called 'glow'"):
        default_settings(techniques=["glow"])


def test_parameters_and_command_line_load_no_numba():
    code = "import sys, rtgi_addon.core.techniques, rtgi_addon.cli; sys.exit('numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False, timeout=60).returncode == 0
