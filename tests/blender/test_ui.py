"""Properties, panels, preferences and registration."""

import dataclasses
import subprocess
import sys
import types
from pathlib import Path

import numpy as np
import pytest

from rtgi_addon.core.techniques import ALWAYS_ON, PRESET_PARAMS, TECHNIQUE_PARAMS, default_settings, optional_techniques

pytestmark = pytest.mark.blender


class FakeLayout:
    """Stands in for a panel's layout and notes what is drawn; a property or an operator that does not exist raises."""

    operator_context = ""

    def __init__(self, bpy, drawn=None):
        self.__dict__.update(bpy=bpy, drawn=[] if drawn is None else drawn)

    def prop(self, owner, name, **_words):
        getattr(owner, name)
        self.drawn.append(name)

    def label(self, text="", **_words):
        self.drawn.append(text)

    def operator(self, name, **_words):
        module, _, function = name.partition(".")
        getattr(getattr(self.bpy.ops, module), function).get_rna_type()
        self.drawn.append(name)
        return types.SimpleNamespace()

    def popover(self, panel, **_words):
        assert hasattr(self.bpy.types, panel)
        self.drawn.append(panel)

    def progress(self, text="", **_words):
        self.drawn.append(text)

    def row(self, **_words):
        return FakeLayout(self.bpy, self.drawn)

    column = split = row


def drawn_by(bpy, panel, what="draw"):
    """Names of what `panel` puts on screen now."""
    layout = FakeLayout(bpy)
    drawn = types.SimpleNamespace(layout=layout, technique=getattr(panel, "technique", ""))
    getattr(panel, what)(drawn, bpy.context)
    return layout.drawn


@pytest.fixture
def no_render(bpy_session, monkeypatch):
    """As if nothing had been rendered yet in this session."""
    from rtgi_addon import engine

    monkeypatch.setattr(engine, "_last_result", None)


def test_fresh_scene_has_the_default_settings(empty_scene):
    from rtgi_addon.ui.props import settings_from_scene

    assert settings_from_scene(empty_scene) == default_settings()


@pytest.mark.parametrize("preset", list(PRESET_PARAMS))
def test_settings_survive_the_way_to_the_scene_and_back(empty_scene, preset):
    from rtgi_addon.ui.props import settings_from_scene, settings_to_scene

    settings = default_settings(preset, ["rsm"]).with_params("rsm", method="PAPER", radius=0.123, rays=7)
    settings_to_scene(settings, empty_scene)
    assert settings_from_scene(empty_scene) == settings


@pytest.mark.parametrize("target", [{"target_time_s": 0.7}, {"target_error": 0.025}, {}])
def test_a_target_survives_the_way_to_the_scene_and_back(empty_scene, target):
    from rtgi_addon.ui.props import settings_from_scene, settings_to_scene

    settings_to_scene(dataclasses.replace(default_settings(), target_time_s=3.0), empty_scene)
    settings = dataclasses.replace(default_settings(), **target)
    settings_to_scene(settings, empty_scene)
    assert settings_from_scene(empty_scene) == settings


def test_every_parameter_carries_its_range_and_description(empty_scene):
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


def test_rsm_panel_shows_only_what_the_method_reads(bpy_session, empty_scene, no_render):
    from rtgi_addon.ui.panels import TECHNIQUE_PANELS

    panel = TECHNIQUE_PANELS["rsm"]
    assert drawn_by(bpy_session, panel) == ["method", "lattice_px", "rays", "clusters", "glossy_texels", "photons",
                                              "map_texels"]
    empty_scene.rtgi.rsm.method = "PAPER"
    assert drawn_by(bpy_session, panel) == ["method", "samples", "radius", "weighting", "map_texels"]


def test_every_parameter_is_shown_under_some_choice(bpy_session, empty_scene, no_render):
    from rtgi_addon.ui.panels import TECHNIQUE_PANELS

    for name, kind in TECHNIQUE_PARAMS.items():
        fields, shown = dataclasses.fields(kind), set()
        for chooser in [f for f in fields if f.metadata["choices"]] or [None]:
            for choice in [c[0] for c in chooser.metadata["choices"]] if chooser else [None]:
                if chooser:
                    setattr(getattr(empty_scene.rtgi, name), chooser.name, choice)
                shown |= set(drawn_by(bpy_session, TECHNIQUE_PANELS[name]))
        assert shown == {f.name for f in fields}


def test_techniques_that_can_be_switched_off_have_a_check_mark_in_their_header(bpy_session, empty_scene):
    from rtgi_addon.ui.panels import TECHNIQUE_PANELS

    for name in optional_techniques():
        assert drawn_by(bpy_session, TECHNIQUE_PANELS[name], "draw_header") == [f"use_{name}"]
    assert not any(hasattr(TECHNIQUE_PANELS[name], "draw_header") for name in ALWAYS_ON)


def test_every_panel_draws(bpy_session, empty_scene):
    from rtgi_addon.ui import panels

    for panel in (c for c in panels.CLASSES if issubclass(c, bpy_session.types.Panel) and c is not panels.RTGI_PT_times):
        assert drawn_by(bpy_session, panel), panel.__name__


def test_panels_after_a_render_say_what_ran_what_was_left_out_and_how_long_it_took(bpy_session, small_scene):
    from rtgi_addon.ui import panels

    bpy_session.ops.render.render()
    plan = " ".join(drawn_by(bpy_session, panels.RTGI_PT_last_render))
    assert "Direct Light ran" in plan and "World Light left out: the world is black" in plan
    times = drawn_by(bpy_session, panels.RTGI_PT_times)
    assert {"Camera view", "Direct Light", "BVH", "Sum"} <= set(times) and any(text.endswith(" ms") for text in times)
    assert any(text.startswith("Last render: ") for text in drawn_by(bpy_session, panels.TECHNIQUE_PANELS["rsm"]))
    assert "the world is black" in " ".join(drawn_by(bpy_session, panels.TECHNIQUE_PANELS["world"]))


def test_panel_offers_the_reset_only_after_a_change_by_hand(bpy_session, empty_scene):
    from rtgi_addon.ui.panels import RTGI_PT_quality

    assert "rtgi.reset_to_preset" not in drawn_by(bpy_session, RTGI_PT_quality)
    empty_scene.rtgi.rsm.rays = 3
    assert "rtgi.reset_to_preset" in drawn_by(bpy_session, RTGI_PT_quality)


def test_image_shows_the_chosen_view_of_the_last_render(bpy_session, small_scene):
    from rtgi_addon import engine

    def mean():
        image = bpy_session.data.images["RTGI"]
        pixels = np.empty(len(image.pixels), np.float32)
        image.pixels.foreach_get(pixels)
        return pixels.reshape(36, 64, 4)[::-1, :, :3]

    bpy_session.ops.render.render()
    choice, result = bpy_session.context.window_manager.rtgi, engine.last_result()
    try:
        light = {transport.value: values for transport, values in result.transports.items()}
        choice.view = "bounce diffuse"
        assert np.array_equal(mean(), light["bounce diffuse"])
        choice.view = "visibility"
        assert np.array_equal(mean()[..., 0], result.visibility)
    finally:
        choice.view = "composite"
    assert np.array_equal(mean(), result.combined[..., :3])


def test_presets_of_the_users_own_bring_all_settings_back(bpy_session, empty_scene):
    from rtgi_addon.ui.props import settings_from_scene, settings_to_scene

    own = default_settings("QUALITY", ["rsm"]).with_params("rsm", method="PAPER", rays=7, samples=33)
    settings_to_scene(own, empty_scene)
    bpy_session.ops.rtgi.preset_add(name="Night shots")
    settings_to_scene(default_settings(), empty_scene)
    (folder,) = bpy_session.utils.preset_paths("rtgi/render")
    (path,) = Path(folder).glob("*.py")
    bpy_session.ops.script.execute_preset(filepath=str(path), menu_idname="RTGI_PT_presets")
    assert settings_from_scene(empty_scene) == own
    bpy_session.ops.rtgi.preset_add(name="Night_shots", remove_name=True)
    assert not path.exists()


def test_lamp_panels_of_cycles_appear_with_rtgi_and_its_sampling_does_not(bpy_session):
    types = bpy_session.types
    assert "RTGI" in types.CYCLES_LIGHT_PT_light.COMPAT_ENGINES
    assert "RTGI" in types.CYCLES_WORLD_PT_surface.COMPAT_ENGINES
    assert "RTGI" not in types.CYCLES_RENDER_PT_sampling.COMPAT_ENGINES
    assert "RTGI" not in types.CYCLES_RENDER_PT_light_paths.COMPAT_ENGINES


def is_shown(bpy, panel, engine="RTGI"):
    """Whether a panel would be shown with an engine, wherever all that it asks for is there."""
    scene, lamp = bpy.context.scene, bpy.data.lights.new("asked", "POINT")
    mesh = bpy.data.objects.new("asked", bpy.data.meshes.new("asked"))
    world, material = bpy.data.worlds.new("asked"), bpy.data.materials.new("asked")
    try:
        context = types.SimpleNamespace(engine=engine, scene=scene, world=world, material=material, object=mesh, light=lamp,
                                        active_object=mesh, camera=bpy.data.cameras.new("asked"),
                                        view_layer=scene.view_layers[0])
        kind = getattr(bpy.types, panel)
        return engine in getattr(kind, "COMPAT_ENGINES", {engine}) and bool(getattr(kind, "poll", lambda _: True)(context))
    finally:
        bpy.data.batch_remove([lamp, mesh.data, world, material, context.camera])


@pytest.mark.parametrize("panel", [
    "RENDER_PT_format", "RENDER_PT_frame_range", "RENDER_PT_output", "RENDER_PT_color_management", "RTGI_PT_film",
    "RTGI_PT_film_transparency", "RTGI_PT_simplify", "RTGI_PT_performance_threads", "RTGI_PT_performance_final_render",
    "CYCLES_WORLD_PT_surface", "CYCLES_WORLD_PT_ray_visibility", "CYCLES_MATERIAL_PT_surface",
    "CYCLES_MATERIAL_PT_settings_surface", "CYCLES_PT_context_material", "CYCLES_LIGHT_PT_light", "CYCLES_LIGHT_PT_nodes",
    "VIEWLAYER_PT_layer", "CYCLES_RENDER_PT_passes", "CYCLES_RENDER_PT_passes_data", "CYCLES_RENDER_PT_passes_crypto",
    "CYCLES_OBJECT_PT_visibility", "DATA_PT_lens"])
def test_panels_that_mean_the_same_for_rtgi_are_there(bpy_session, empty_scene, panel):
    assert is_shown(bpy_session, panel)


@pytest.mark.parametrize("panel", [
    "CYCLES_RENDER_PT_film", "CYCLES_RENDER_PT_sampling", "CYCLES_RENDER_PT_light_paths", "CYCLES_CAMERA_PT_dof",
    "CYCLES_WORLD_PT_volume", "CYCLES_WORLD_PT_settings", "CYCLES_MATERIAL_PT_volume", "CYCLES_MATERIAL_PT_settings_volume",
    "CYCLES_OBJECT_PT_motion_blur"])
def test_panels_that_mean_nothing_to_rtgi_or_would_be_there_twice_are_not(bpy_session, empty_scene, panel):
    assert not is_shown(bpy_session, panel)


@pytest.mark.parametrize("panel", ["CYCLES_WORLD_PT_surface", "CYCLES_RENDER_PT_film", "CYCLES_CAMERA_PT_dof"])
def test_panels_of_cycles_stay_with_cycles_and_with_no_third_engine(bpy_session, empty_scene, panel):
    is_shown(bpy_session, panel)
    assert is_shown(bpy_session, panel, "CYCLES") and not is_shown(bpy_session, panel, "BLENDER_WORKBENCH")


def test_panels_of_rtgi_come_before_those_of_cycles_in_the_tab_render(bpy_session):
    # Blender sorts by `bl_order`, then by registration: all that is shared there comes later by its order, or was made ours
    from rtgi_addon.ui.panels import shared_panels

    tops = [p for p in shared_panels() if getattr(p, "bl_context", "") == "render" and not getattr(p, "bl_parent_id", "")]
    assert tops and all(p.bl_order > 0 for p in tops)


def test_a_panel_of_cycles_that_is_shown_again_draws_what_others_added_to_it(bpy_session, empty_scene):
    types_, drawn = bpy_session.types, []

    def add(panel, context):
        drawn.append(panel)

    types_.CYCLES_RENDER_PT_film.append(add)
    try:
        drawn_by(bpy_session, types_.RTGI_PT_film)
    finally:
        types_.CYCLES_RENDER_PT_film.remove(add)
    assert drawn


SCRIPT_TWICE = """
import os, sys, bpy
def shown():
    return {p.__name__: (frozenset(p.COMPAT_ENGINES), "COMPAT_ENGINES" in vars(p), vars(p).get("poll"))
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


SCRIPT_WITHOUT_CYCLES = """
import os, sys, bpy, addon_utils
addon_utils.disable("cycles")
import rtgi_addon
rtgi_addon.register()
assert hasattr(bpy.context.scene, "rtgi") and hasattr(bpy.types, "RTGI_PT_light_passes")
rtgi_addon.unregister()
addon_utils.enable("cycles")
rtgi_addon.register()
assert bpy.types.RTGI_PT_light_passes.bl_parent_id == "CYCLES_RENDER_PT_passes"
print("clean")
sys.stdout.flush()
os._exit(0)
"""


def test_add_on_can_be_switched_on_before_cycles(request):
    done = subprocess.run([sys.executable, "-c", SCRIPT_WITHOUT_CYCLES], capture_output=True, text=True, timeout=120,
                          check=False, cwd=request.config.rootpath)
    assert "clean" in done.stdout, done.stderr
