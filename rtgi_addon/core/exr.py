"""OpenEXR files of scan lines, read and written with numpy: some builds of Blender bring no library for it.

Written are float32 channels in one part, compressed by ZIP. Read are 16-bit and 32-bit channels in one or more parts,
uncompressed or compressed by ZIP, ZIPS or RLE: what Blender writes with these codecs. Rows run from top to bottom.

References
----------
.. [1] OpenEXR File Layout, openexr.com, sections "Header", "Chunk", "Predefined Attribute Types".
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np

from ..errors import InputError

_MAGIC, _VERSION, _TILED, _DEEP, _MULTIPART = 20000630, 2, 0x200, 0x800, 0x1000
_LONG_NAMES = 0x400
_TYPES = (np.dtype("<u4"), np.dtype("<f2"), np.dtype("<f4"))
_FLOAT = 2
_NONE, _RLE, _ZIPS, _ZIP = 0, 1, 2, 3
_ROWS_OF = {_NONE: 1, _RLE: 1, _ZIPS: 1, _ZIP: 16}
_SHORT_NAME = 31            # longer names need a flag in the file's head


# ---- the codec's byte order: low and high halves apart, differences between neighbours ----

def _scramble(raw: bytes) -> bytes:
    data = np.frombuffer(raw, np.uint8)
    apart = np.concatenate([data[0::2], data[1::2]]).astype(np.int16)
    apart[1:] -= apart[:-1].copy() - 128
    return (apart & 255).astype(np.uint8).tobytes()


def _unscramble(packed: bytes) -> bytes:
    data = np.frombuffer(packed, np.uint8).astype(np.int64)
    data[1:] -= 128
    apart = (np.cumsum(data) & 255).astype(np.uint8)
    out = np.empty_like(apart)
    half = (len(apart) + 1) // 2
    out[0::2], out[1::2] = apart[:half], apart[half:]
    return out.tobytes()


def _expand_runs(packed: bytes) -> bytes:
    out, at = bytearray(), 0
    while at < len(packed):
        count = struct.unpack_from("b", packed, at)[0]
        if count < 0:
            out += packed[at + 1:at + 1 - count]
            at += 1 - count
        else:
            out += packed[at + 1:at + 2] * (count + 1)
            at += 2
    return bytes(out)


# ---- writing ----

def _attribute(name: str, kind: str, value: bytes) -> bytes:
    return name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(value)) + value


def write(file: BinaryIO, channels: Mapping[str, np.ndarray]) -> None:
    """Write (H, W) float32 images of one size, row 0 at the top, as the channels of one part.

    Raises
    ------
    InputError
        No channel, or channels of different sizes.
    """
    shapes = {values.shape for values in channels.values()}
    if len(shapes) != 1 or len(next(iter(shapes))) != 2:
        raise InputError(f"an EXR needs channels (H, W) of one size, got {sorted(shapes)}")
    height, width = shapes.pop()
    names = sorted(channels, key=str.encode)
    listed = b"".join(n.encode() + b"\0" + struct.pack("<iB3xii", _FLOAT, 0, 1, 1) for n in names) + b"\0"
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    header = b"".join((
        _attribute("channels", "chlist", listed), _attribute("compression", "compression", bytes([_ZIP])),
        _attribute("dataWindow", "box2i", window), _attribute("displayWindow", "box2i", window),
        _attribute("lineOrder", "lineOrder", b"\0"), _attribute("pixelAspectRatio", "float", struct.pack("<f", 1)),
        _attribute("screenWindowCenter", "v2f", struct.pack("<2f", 0, 0)),
        _attribute("screenWindowWidth", "float", struct.pack("<f", 1)), b"\0"))
    flags = _LONG_NAMES if max(len(n.encode()) for n in names) > _SHORT_NAME else 0
    # one array (row, channel, column): the order of the file
    lines = np.stack([np.asarray(channels[n], "<f4") for n in names], 1)
    chunks = []
    for top in range(0, height, _ROWS_OF[_ZIP]):
        raw = lines[top:top + _ROWS_OF[_ZIP]].tobytes()
        packed = zlib.compress(_scramble(raw), 4)
        chunks.append(struct.pack("<ii", top, min(len(packed), len(raw))) + (packed if len(packed) < len(raw) else raw))
    head = struct.pack("<ii", _MAGIC, _VERSION | flags) + header
    place = len(head) + 8 * len(chunks)
    offsets = place + np.concatenate([[0], np.cumsum([len(c) for c in chunks])[:-1]])
    file.write(head + offsets.astype("<u8").tobytes() + b"".join(chunks))


# ---- reading ----

@dataclass(frozen=True)
class _Part:
    """A part's header: channels by name with their type, codec, and the window of its pixels."""

    channels: dict[str, np.dtype]
    codec: int
    left: int
    top: int
    width: int
    height: int

    @property
    def chunk_count(self) -> int:
        return -(-self.height // _ROWS_OF[self.codec])


def _text(data: bytes, at: int) -> tuple[str, int]:
    end = data.index(b"\0", at)
    return data[at:end].decode("utf-8", "replace"), end + 1


def _read_channels(value: bytes) -> dict[str, np.dtype]:
    out, at = {}, 0
    while value[at]:
        name, at = _text(value, at)
        kind, x_step, y_step = struct.unpack_from("<i4xii", value, at)
        if (x_step, y_step) != (1, 1):
            raise InputError(f"channel {name} has fewer pixels than the others, which RTGI does not read")
        out[name], at = _TYPES[kind], at + 16
    return out


def _read_part(data: bytes, at: int) -> tuple[_Part, int]:
    values = {}
    while data[at]:
        name, at = _text(data, at)
        _, at = _text(data, at)
        size = struct.unpack_from("<i", data, at)[0]
        values[name] = data[at + 4:at + 4 + size]
        at += 4 + size
    codec = values["compression"][0]
    if codec not in _ROWS_OF:
        raise InputError("it is compressed by a codec that RTGI does not read; save it with ZIP, RLE or none")
    left, top, right, bottom = struct.unpack("<4i", values["dataWindow"])
    return _Part(_read_channels(values["channels"]), codec, left, top, right - left + 1, bottom - top + 1), at + 1


def _unpack(part: _Part, packed: bytes, size: int) -> bytes:
    if len(packed) == size:                      # what does not shrink is stored as it is
        return packed
    if part.codec == _RLE:
        return _unscramble(_expand_runs(packed))
    return _unscramble(zlib.decompress(packed))


def parse(data: bytes) -> dict[str, np.ndarray]:
    """The channels of all parts of an EXR's bytes: (H, W) each by name, row 0 at the top.

    A part's channels carry the names as they stand in the file; where parts share a name the last one stays.

    Raises
    ------
    InputError
        The bytes are no EXR, are cut short, or use tiles, deep pixels or another codec.
    """
    try:
        magic, version = struct.unpack_from("<ii", data)
        if magic != _MAGIC:
            raise InputError("it is no EXR file")
        if version & (_TILED | _DEEP):
            raise InputError("it has tiles or deep pixels, which RTGI does not read")
        many = bool(version & _MULTIPART)
        part, at = _read_part(data, 8)
        parts = [part]
        while many and data[at]:
            part, at = _read_part(data, at)
            parts.append(part)
        at += many
        out: dict[str, np.ndarray] = {}
        for part in parts:
            out.update(_read_pixels(part, data, np.frombuffer(data, "<u8", part.chunk_count, at), 4 if many else 0))
            at += 8 * part.chunk_count
        return out
    except (IndexError, KeyError, ValueError, struct.error, zlib.error) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"it is cut short or broken ({error})") from error


def _read_pixels(part: _Part, data: bytes, offsets: np.ndarray, skip: int) -> dict[str, np.ndarray]:
    images = {name: np.zeros((part.height, part.width), kind) for name, kind in part.channels.items()}
    row_bytes = part.width * sum(kind.itemsize for kind in part.channels.values())
    for offset in offsets.tolist():
        line, size = struct.unpack_from("<ii", data, offset + skip)
        start = offset + skip + 8
        first = line - part.top
        rows = min(_ROWS_OF[part.codec], part.height - first)
        raw = _unpack(part, data[start:start + size], rows * row_bytes)
        at = 0
        for row in range(first, first + rows):
            for name, kind in part.channels.items():
                images[name][row] = np.frombuffer(raw, kind, part.width, at)
                at += part.width * kind.itemsize
    return images
