"""Scenes under other light, as the tools that measure techniques use them: what is lit, and that nothing is left behind."""

from __future__ import annotations

import math

import numpy as np
import pytest

pytestmark = pytest.mark.blender


@pytest.fixture
def box(bpy_session):
    """The Cornell box of the samples, whose one lamp is a square."""
    from sample_scenes.build import build_scene

    return build_scene("cornell_box")


def contents(bpy) -> tuple:
    """How many of everything there is, and what is hidden."""
    kinds = (bpy.data.objects, bpy.data.meshes, bpy.data.materials, bpy.data.worlds)
    return (*map(len, kinds), [o.hide_render for o in bpy.context.scene.objects], bpy.context.scene.world)


@pytest.mark.parametrize("light", ["", "own_sky", "even_sky", "shining_panels"])
def test_scene_is_as_before_after_other_light_and_after_an_error_under_it(bpy_session, box, light):
    from tools.scene_frames import lit_by

    before = contents(bpy_session)
    with pytest.raises(KeyError, match="stop"), lit_by(box, light):
        raise KeyError("stop")
    assert contents(bpy_session) == before


def test_even_sky_has_radiance_one_and_no_lamps(box):
    from tools.scene_frames import captured, under_even_sky

    with under_even_sky(box):
        frame, _ = captured(box, (48, 32))
    assert frame.lights == () and np.array_equal(frame.world.radiance, np.ones((1, 1, 3), np.float32))


def test_panels_have_the_radiance_of_the_lamps(box):
    from tools.scene_frames import captured, panel_lamps, with_panels

    (lamp,) = panel_lamps(box)
    expected = np.array(lamp.data.color) * lamp.data.energy / (math.pi * lamp.data.size**2)
    with with_panels(box):
        frame, _ = captured(box, (48, 32))
    assert frame.lights == ()
    # a float32 strength times a float32 colour
    np.testing.assert_allclose(frame.geometry.emission.max(0), expected, rtol=1e-5)


def test_jpeg_is_the_picture_upright(bpy_session, tmp_path):
    from tools.scene_frames import write_jpeg

    pixels = np.zeros((16, 32, 3), np.uint8)
    pixels[:8] = (200, 40, 40)
    write_jpeg(tmp_path / "a.jpg", pixels)
    image = bpy_session.data.images.load(str(tmp_path / "a.jpg"))
    read = np.array(image.pixels[:]).reshape(16, 32, 4)[::-1, :, :3] * 255
    bpy_session.data.images.remove(image)
    # JPEG's own error: a few of 255 on even colour
    assert np.abs(read[:6] - pixels[:6]).max() < 6 and np.abs(read[-6:] - pixels[-6:]).max() < 6
