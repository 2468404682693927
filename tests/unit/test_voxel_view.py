"""Pictures of the voxels: cuts through the grid, and their way into the layers of --passes."""

from __future__ import annotations

import numpy as np
import pytest

from rtgi_addon.cli import pass_channels
from rtgi_addon.passes.voxel_view import slice_picture
from rtgi_addon.pipeline import Result
from tests.plane_frames import quad
from tests.voxel_rooms import lit, room


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_cut_shows_its_layer_from_the_top_down(axis):
    # one voxel at (1, 2, 3) of a grid of 5x6x7 cells; columns go along the next axis, rows along the one after it
    scene = room((5, 6, 7), quad((1.5, 2.5, 3.5), 0.2, 0.2))
    picture = slice_picture(scene, lit(scene, 2.0), axis, (1, 2, 3)[axis])
    shape = {0: (7, 6), 1: (5, 7), 2: (6, 5)}[axis]
    assert picture.shape == (*shape, 3) and picture.max() == 2.0
    up = {0: 3, 1: 1, 2: 2}[axis]                # place along the rows' axis, counted from below
    across = {0: 2, 1: 3, 2: 1}[axis]
    assert [tuple(p) for p in np.argwhere(picture[..., 0] > 0)] == [(shape[0] - 1 - up, across)]
    assert not slice_picture(scene, lit(scene, 2.0), axis, 0).any()


def test_pictures_become_layers_of_the_passes():
    image = np.arange(12, dtype=np.float32).reshape(2, 2, 3)
    result = Result(np.zeros((2, 2, 4), np.float32), {}, np.ones((2, 2), np.float32), {}, {"vxgi light": image})
    channels = pass_channels(result)
    assert all(np.array_equal(channels[f"vxgi light.{c}"], image[..., i]) for i, c in enumerate("RGB"))
