"""The pictures of techniques: their scenes exist, their files are there and small."""

from __future__ import annotations

import pytest

from rtgi_addon.compare.halves import PARTS
from rtgi_addon.core.techniques import TECHNIQUE_PARAMS
from sample_scenes import SCENES
from tools.technique_pictures import MOST_BYTES, PICTURES, ROOT


@pytest.mark.parametrize("name", PICTURES)
def test_picture_is_of_a_sample_scene_and_of_light_that_is_compared(name):
    picture = PICTURES[name]
    assert picture.scene in SCENES and picture.part in PARTS
    assert {row.technique for row in picture.rows} <= set(TECHNIQUE_PARAMS)


@pytest.mark.parametrize("name", PICTURES)
def test_picture_is_there_and_small(name):
    # made by: python -m tools.technique_pictures
    assert 0 < (ROOT / "docs" / "images" / f"{name}.jpg").stat().st_size <= MOST_BYTES
