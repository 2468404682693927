"""Frames as files: what is saved comes back."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from rtgi_addon import frameio
from rtgi_addon.core.frame import Cutouts, Frame, LightKind
from rtgi_addon.core.synthetic import make_room_frame
from rtgi_addon.errors import InputError


def assert_same(a, b):
    """Equal types, numbers, arrays (their types too) and dataclasses of those."""
    if dataclasses.is_dataclass(a):
        for f in dataclasses.fields(a):
            assert_same(getattr(a, f.name), getattr(b, f.name))
    elif isinstance(a, np.ndarray):
        assert a.dtype == b.dtype
        np.testing.assert_array_equal(a, b)
    elif isinstance(a, tuple):
        assert len(a) == len(b)
        for x, y in zip(a, b, strict=True):
            assert_same(x, y)
    else:
        assert a == b


@pytest.fixture
def frame() -> Frame:
    whole = make_room_frame(8, 6, (LightKind.SPOT, LightKind.POINT), world_radiance=0.25)
    return dataclasses.replace(whole, warnings=("object 'Chair': something",), origin_ws=np.array([1e6, 0.5, -3.0]))


def test_a_frame_comes_back_as_it_was(frame, tmp_path):
    frameio.save_frame(tmp_path / "frame.npz", frame)
    assert_same(frame, frameio.load_frame(tmp_path / "frame.npz"))


def test_cutouts_come_back(frame, tmp_path, rng):
    row = np.full(len(frame.geometry), -1, np.int32)
    row[[3, 5]] = [1, 0]
    cutouts = Cutouts(row, rng.uniform(size=(2, 3, 2)).astype(np.float32), np.float32([0.5, 1]), np.array([True, False]),
                      np.array([[0, 2, 3], [6, 1, 1]], np.int32), np.arange(7, dtype=np.uint8), 3)
    frame = dataclasses.replace(frame, geometry=dataclasses.replace(frame.geometry, cutouts=cutouts))
    frameio.save_frame(tmp_path / "frame.npz", frame)
    assert_same(frame, frameio.load_frame(tmp_path / "frame.npz"))


def test_shading_normals_come_back(frame, tmp_path, rng):
    normals = rng.integers(-32767, 32768, (len(frame.geometry), 3, 3)).astype(np.int16)
    frame = dataclasses.replace(frame, geometry=dataclasses.replace(frame.geometry, normals_ws=normals))
    frameio.save_frame(tmp_path / "frame.npz", frame)
    assert_same(frame, frameio.load_frame(tmp_path / "frame.npz"))


def test_a_frame_without_geometry_comes_back_without(frame, tmp_path):
    frame = dataclasses.replace(frame, geometry=None)
    frameio.save_frame(tmp_path / "frame.npz", frame)
    assert_same(frame, frameio.load_frame(tmp_path / "frame.npz"))


@pytest.mark.parametrize("content", [b"", b"not a zip at all"])
def test_another_file_is_refused_in_one_line(tmp_path, content):
    path = tmp_path / "frame.npz"
    path.write_bytes(content)
    with pytest.raises(InputError, match="is not a frame saved by RTGI"):
        frameio.load_frame(path)
    with pytest.raises(InputError, match="there is no file"):
        frameio.load_frame(tmp_path / "none.npz")
