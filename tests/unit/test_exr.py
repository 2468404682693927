"""EXR files keep every bit, and broken ones are refused."""

import io
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rtgi_addon.core import exr
from rtgi_addon.errors import InputError


def written(channels) -> bytes:
    file = io.BytesIO()
    exr.write(file, channels)
    return file.getvalue()


@given(height=st.integers(1, 40), width=st.integers(1, 20), seed=st.integers(0, 100))
def test_pixels_come_back_bit_for_bit(height, width, seed):
    bits = np.random.default_rng(seed).integers(0, 2**32, (height, width), np.uint32).view(np.float32)
    smooth = np.tile(np.linspace(0, 1, width, dtype=np.float32), (height, 1))
    read = exr.parse(written({"noise.R": bits, "A": smooth}))
    assert list(read) == ["A", "noise.R"]
    assert read["noise.R"].tobytes() == bits.tobytes() and np.array_equal(read["A"], smooth)


def test_smooth_picture_is_compressed():
    assert len(written({"Y": np.zeros((64, 64), np.float32)})) < 64 * 64


def test_long_channel_names_are_announced_in_the_head():
    name = "a layer with a name of more than thirty-one letters.R"
    data = written({name: np.ones((2, 2), np.float32)})
    assert struct.unpack_from("<i", data, 4)[0] & 0x400 and name in exr.parse(data)


def test_channels_of_different_sizes_are_refused():
    with pytest.raises(InputError, match="of one size"):
        written({"a": np.zeros((2, 2), np.float32), "b": np.zeros((2, 3), np.float32)})


@pytest.mark.parametrize("share", [0.0, 0.01, 0.2, 0.5, 0.99])
def test_file_that_is_cut_short_is_refused(share, rng):
    data = written({"Y": rng.random((20, 20), np.float32)})
    with pytest.raises(InputError):
        exr.parse(data[:int(share * len(data))])


def test_other_files_are_refused():
    with pytest.raises(InputError, match="no EXR file"):
        exr.parse(b"\x89PNG\r\n\x1a\n" + bytes(100))


def test_tiles_are_refused_in_words():
    data = bytearray(written({"Y": np.ones((2, 2), np.float32)}))
    struct.pack_into("<i", data, 4, 2 | 0x200)
    with pytest.raises(InputError, match="tiles"):
        exr.parse(bytes(data))
