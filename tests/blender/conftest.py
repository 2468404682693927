"""Fixtures of the tests that build scenes in Blender."""

from __future__ import annotations

import numpy as np
import pytest


@pytest.fixture
def make_image(bpy_session, empty_scene):
    """Makes a generated image from (H, W, 4) stored numbers, bottom row first."""

    def make(pixels, name="Pixels", is_float=False, is_data=False):
        height, width = pixels.shape[:2]
        image = bpy_session.data.images.new(name, width, height, alpha=True, float_buffer=is_float, is_data=is_data)
        image.pixels.foreach_set(np.ascontiguousarray(pixels, np.float32).ravel())
        image.update()
        return image

    return make
