"""Properties, panels, preferences and registration."""

import subprocess
import sys

import pytest

from rtgi_addon.core.techniques import PRESET_PARAMS, TECHNIQUE_PARAMS, default_settings

pytestmark = pytest.mark.blender


class FakeLayout:
    """Stands in for a panel's layout and notes what is drawn; a property that does not exist raises."""

    def __init__(self, drawn=None):
        self.__dict__["drawn"] = [] if drawn is None else drawn

    def prop(self, owner, name, **_words):
        getattr(owner, name)
        self.drawn.append(name)

    def label(self, text="", **_words):
        self.drawn.append(text)

    def operator(self, name, **_words):
        self.drawn.append(name)

    def row(self, **_words):
        return FakeLayout(self.drawn)

    column = row


def drawn_by(bpy, panel):
    """Names of what `panel` puts on screen now."""
    layout = FakeLayout()
    panel.draw(type("Drawn", (), {"layout": layout, "SETTINGS_OF": getattr(panel, "SETTINGS_OF", None)})(), bpy.context)
    return layout.drawn


def test_fresh_scene_has_the_default_settings(empty_scene):
    from rtgi_addon.ui.props import settings_from_scene

    assert settings_from_scene(empty_scene) == default_settings()


@pytest.mark.parametrize("preset", list(PRESET_PARAMS))
def test_settings_survive_the_way_to_the_scene_and_back(empty_scene, preset):
    from rtgi_addon.ui.props import settings_from_scene, settings_to_scene

    settings = default_settings(preset, ["rsm"]).with_params("rsm", method="PAPER", radius=0.123, rays=7)
    settings_to_scene(settings, empty_scene)
    assert settings_from_scene(empty_scene) == settings


def test_every_parameter_carries_its_range_and_description(empty_scene):
    import dataclasses

    for name, kind in TECHNIQUE_PARAMS.items():
        group = getattr(empty_scene.rtgi, name)
        for field in dataclasses.fields(kind):
            shown = group.bl_rna.properties[field.name]
            assert shown.description == field.metadata["doc"]
            if field.metadata["low"] is not None:
                assert shown.hard_min == pytest.approx(field.metadata["low"])
                assert shown.hard_max == pytest.approx(field.metadata["high"])


def test_choosing_a_preset_sets_its_values(empty_scene):
    empty_scene.rtgi.preset = "DRAFT"
    assert empty_scene.rtgi.rsm.rays == PRESET_PARAMS["DRAFT"]["rsm"]["rays"]


def test_choosing_a_preset_keeps_what_it_does_not_decide(empty_scene):
    empty_scene.rtgi.rsm.samples = 17
    empty_scene.rtgi.preset = "QUALITY"
    assert empty_scene.rtgi.rsm.samples == 17


def test_reset_to_preset_undoes_changes_by_hand(bpy_session, empty_scene):
    empty_scene.rtgi.rsm.rays = 3
    bpy_session.ops.rtgi.reset_to_preset()
    assert empty_scene.rtgi.rsm.rays == PRESET_PARAMS["BALANCED"]["rsm"]["rays"]


def test_settings_are_saved_with_the_file(bpy_session, empty_scene, tmp_path):
    empty_scene.rtgi.rsm.samples = 123
    path = str(tmp_path / "a.blend")
    bpy_session.ops.wm.save_as_mainfile(filepath=path)
    bpy_session.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    bpy_session.ops.wm.open_mainfile(filepath=path)
    assert bpy_session.context.scene.rtgi.rsm.samples == 123


def test_rsm_panel_shows_only_what_the_method_reads(bpy_session, empty_scene):
    from rtgi_addon.ui.panels import RTGI_PT_rsm

    assert drawn_by(bpy_session, RTGI_PT_rsm) == ["method", "rays", "lattice_px", "clusters", "glossy_texels"]
    empty_scene.rtgi.rsm.method = "PAPER"
    assert drawn_by(bpy_session, RTGI_PT_rsm) == ["method", "samples", "radius", "weighting"]


def test_every_panel_draws(bpy_session, empty_scene):
    from rtgi_addon.ui import panels

    for panel in (c for c in panels.CLASSES if issubclass(c, bpy_session.types.Panel)):
        assert drawn_by(bpy_session, panel), panel.__name__


def test_panel_offers_the_reset_only_after_a_change_by_hand(bpy_session, empty_scene):
    from rtgi_addon.ui.panels import RTGI_PT_quality

    assert "rtgi.reset_to_preset" not in drawn_by(bpy_session, RTGI_PT_quality)
    empty_scene.rtgi.rsm.rays = 3
    assert "rtgi.reset_to_preset" in drawn_by(bpy_session, RTGI_PT_quality)


def test_last_render_reads_as_lines():
    from rtgi_addon.ui.panels import last_render_lines

    report = {"total_ms": 1500.0, "jit_ms": 200.0, "stages": [{"name": "rsm", "ms": 120.4}],
              "plan": {"runs": [{"technique": "rsm", "label": "Reflective Shadow Maps"}],
                       "left_out": [{"what": "World Light", "why": "the world is black"}]}, "warnings": ["volumes"]}
    assert [text for _, text in last_render_lines(report)] == [
        "1.50 s, and 0.20 s compiling", "rsm: 120 ms", "Reflective Shadow Maps ran",
        "World Light left out: the world is black", "volumes"]


def test_lamp_panels_of_cycles_appear_with_rtgi_and_its_sampling_does_not(bpy_session):
    types = bpy_session.types
    assert "RTGI" in types.CYCLES_LIGHT_PT_light.COMPAT_ENGINES
    assert "RTGI" in types.CYCLES_WORLD_PT_surface.COMPAT_ENGINES
    assert "RTGI" not in types.CYCLES_RENDER_PT_sampling.COMPAT_ENGINES
    assert "RTGI" not in types.CYCLES_RENDER_PT_light_paths.COMPAT_ENGINES


SCRIPT_TWICE = """
import os, sys, bpy
def shown():
    return {p.__name__: (frozenset(p.COMPAT_ENGINES), "COMPAT_ENGINES" in vars(p))
            for p in bpy.types.Panel.__subclasses__() if hasattr(p, "COMPAT_ENGINES") and "RTGI_" not in p.__name__}
def handlers():
    return {n: len(getattr(bpy.app.handlers, n)) for n in dir(bpy.app.handlers)
            if isinstance(getattr(bpy.app.handlers, n), list)}
before = shown(), handlers(), set(dir(bpy.types))
import rtgi_addon
for _ in range(2):
    rtgi_addon.register(); rtgi_addon.register()
    assert hasattr(bpy.context.scene, "rtgi") and "numba" not in sys.modules, "numba was loaded by registration"
    rtgi_addon.unregister(); rtgi_addon.unregister()
    assert not hasattr(bpy.context.scene, "rtgi")
    assert (shown(), handlers(), set(dir(bpy.types))) == before, "something was left behind"
print("clean")
sys.stdout.flush()
os._exit(0)
"""


def test_registering_twice_is_clean_and_loads_no_numba(request):
    done = subprocess.run([sys.executable, "-c", SCRIPT_TWICE], capture_output=True, text=True, timeout=120, check=False,
                          cwd=request.config.rootpath)
    assert "clean" in done.stdout, done.stderr
