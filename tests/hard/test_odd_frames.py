"""What breaks renderers, on every technique: broken numbers, frames of a pixel, scenes of nothing, power over 21 decades."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from rtgi_addon.core.mending import mend_frame
from rtgi_addon.passes import TECHNIQUES
from tests.hard_frames import CHEAP, ODD_FRAMES, powered, room, run, spoilt

# broken frames, and small ones
pytestmark = [pytest.mark.filterwarnings("ignore::RuntimeWarning"), pytest.mark.usefixtures("one_thread")]

ROUNDING = 2e-5             # sums of float32 whose terms have other digits


def test_every_technique_is_tried():
    assert set(CHEAP) == set(TECHNIQUES)


@pytest.mark.parametrize("name", CHEAP)
@pytest.mark.parametrize("odd", ODD_FRAMES)
def test_an_odd_frame_gives_a_finite_picture(odd, name):
    light = run(name, ODD_FRAMES[odd]()).light
    assert light and all(np.isfinite(image).all() and (image >= 0).all() for image in light.values())


@pytest.mark.parametrize("factor", [1e-11, 1e10])       # of a lamp of 100 W: from 1e-9 to 1e12 W
@pytest.mark.parametrize("name", CHEAP)
def test_light_is_linear_in_power_over_21_decades(name, factor):
    plain, other = run(name, room()).light, run(name, powered(room(), factor)).light
    for transport, image in plain.items():
        difference = np.abs(other[transport].astype(float) / factor - image).mean()
        assert difference <= ROUNDING * max(float(image.mean()), 1e-30), transport


def test_a_sound_frame_comes_back_as_it_is():
    frame = room()
    assert mend_frame(frame) is frame


@pytest.mark.parametrize("image", ["depth", "position_ws", "normal_ws", "albedo", "specular", "roughness", "emission"])
def test_a_broken_pixel_is_named_and_its_neighbours_stay(image):
    frame = room()
    mended = mend_frame(spoilt(frame, image, float("nan")))
    assert len(mended.warnings) == 1 and "Camera view" in mended.warnings[0]
    whole = np.ones(frame.gbuffer.depth.size, bool)
    whole[::5] = False
    for field in dataclasses.fields(frame.gbuffer):
        before, after = (getattr(f.gbuffer, field.name).reshape(whole.size, -1)[whole] for f in (frame, mended))
        np.testing.assert_array_equal(after, before)
