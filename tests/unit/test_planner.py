"""Which techniques run: what the frame does not need is left out, and no light has two owners."""

import dataclasses

import numpy as np
import pytest

from rtgi_addon import planner
from rtgi_addon.composite import merge
from rtgi_addon.core.frame import LightKind
from rtgi_addon.core.synthetic import make_room_frame
from rtgi_addon.core.techniques import default_settings
from rtgi_addon.errors import InputError
from rtgi_addon.passes.base import PassResult, Transport


@pytest.fixture(scope="module")
def frame():
    return make_room_frame(24, 16, (LightKind.POINT,), world_radiance=0.5)


def test_no_transport_has_two_owners_when_the_planner_chooses(frame):
    plan = planner.plan_frame(frame, default_settings(), planner.CapturePlan())
    supplied = [t for name in plan.techniques for t in planner.TECHNIQUES[name].transports]
    assert len(supplied) == len(set(supplied))


def test_a_black_world_and_no_lamp_leave_everything_out(frame):
    dark = dataclasses.replace(make_room_frame(24, 16, ()), views=())
    plan = planner.plan_frame(dark, default_settings(), planner.CapturePlan())
    assert {"direct", "world", "rsm", "vxgi"}.isdisjoint(plan.techniques)
    assert ("World Light", "the world is black") in plan.left_out


def test_what_shines_by_itself_is_asked_for_its_light_and_its_bounce(frame):
    dark = dataclasses.replace(make_room_frame(24, 16, ()))
    plan = planner.plan_frame(dark, default_settings(), planner.CapturePlan())
    assert not {"emission", "final_gather"} & set(plan.techniques)
    assert ("Emissive Surfaces", "no surface shines") in plan.left_out
    geometry = dataclasses.replace(dark.geometry, emission=np.ones_like(dark.geometry.emission))
    plan = planner.plan_frame(dataclasses.replace(dark, geometry=geometry), default_settings(), planner.CapturePlan())
    assert {"emission", "final_gather"} <= set(plan.techniques) and "vxgi" not in plan.techniques


def test_the_planner_leaves_directional_occlusion_to_those_who_ask_for_it(frame):
    dark = dataclasses.replace(make_room_frame(24, 16, (LightKind.POINT,)))
    for seen in (frame, dark):
        assert "ssdo" not in planner.plan_frame(seen, default_settings(), planner.CapturePlan()).techniques
    plan = planner.plan_frame(frame, default_settings(techniques=["ssdo"]), planner.CapturePlan())
    assert "ssdo" in plan.techniques and "world" not in plan.techniques


def _light(value, **kwargs):
    return PassResult({Transport.BOUNCE_GLOSSY: np.full((1, 1, 3), value, np.float32)}, **kwargs)


def test_two_owners_of_one_transport_are_refused():
    with pytest.raises(InputError, match="a and b both supply the bounce glossy light"):
        merge([("a", _light(1)), ("b", _light(2))])


def test_light_that_was_taken_over_counts_once():
    taken = _light(3, takes_over=frozenset({Transport.BOUNCE_GLOSSY}))
    assert merge([("a", _light(1)), ("b", taken)])[Transport.BOUNCE_GLOSSY].max() == 3


def test_lamps_views_hold_what_the_techniques_that_look_into_them_ask_for():
    facts = planner.SceneFacts((), "black", False, False)

    def texels(settings):
        return planner.plan_capture(facts, settings, np.zeros(3), 1.0).view_texels

    auto = default_settings().with_params("rsm", map_texels=1000).with_params("vxgi", map_texels=5000)
    assert texels(auto) == 1000                  # in Auto it is RSM that brings the bounce, and the others do not run
    without = dataclasses.replace(auto, enabled={**auto.enabled, "rsm": False})
    assert texels(without) == 5000
    both = default_settings(techniques=["rsm", "vxgi"]).with_params("rsm", map_texels=1000)
    assert texels(both.with_params("vxgi", map_texels=5000)) == 5000
    assert texels(default_settings(techniques=["ssr"])) == planner.SHADOW_TEXELS


def test_the_plan_says_that_lamps_stand_for_what_shines():
    frame = make_room_frame(8, 8, (LightKind.POINT,))
    lamp = dataclasses.replace(frame.lights[0], is_surface=True)
    plan = planner.plan_frame(dataclasses.replace(frame, lights=(lamp,)), default_settings(), planner.CapturePlan())
    assert ("Emissive Surfaces", "what shines is lit with as lamps") in plan.left_out
    assert ("Final Gathering", "the world is black, and what shines is lit with as lamps") in plan.left_out


def test_beside_what_casts_no_shadow_all_views_are_cast_and_the_plan_says_so():
    lamps = make_room_frame(8, 8, (LightKind.POINT, LightKind.RECTANGLE)).lights
    plain, without = (planner.plan_capture(planner.SceneFacts(lamps, "black", False, False, shadowless), default_settings(),
                                           np.zeros(3), 1.0) for shadowless in (False, True))
    assert plain.cycles_views == (0, 1) and plain.cast_views == ()
    assert without.cycles_views == () and without.cast_views == (0, 1)
    assert any(what == "Cycles views of lamps" and "cast no shadow" in why for what, why in without.left_out)
