"""The head of a .blend file, read without Blender: is it one, and which Blender wrote it."""

from __future__ import annotations

import gzip
import re
from pathlib import Path

from .errors import InputError

_ZSTD_MAGIC, _GZIP_MAGIC = b"\x28\xb5\x2f\xfd", b"\x1f\x8b"
_LONGEST_HEAD = 17
# until 4.5 "BLENDER-v405", since 5.0 "BLENDER17-01v0500": length of the head, format, version
_OLD_HEAD = re.compile(rb"BLENDER[-_][vV](\d{3})")
_NEW_HEAD = re.compile(rb"BLENDER\d{2}-\d{2}v(\d{4})")
# Blender 4.5 was made to read what 5.0 writes; any other newer file may lose data on loading
READS_NEWER = {(4, 5): (5, 0)}


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        start = file.read(_LONGEST_HEAD)
    if start.startswith(_ZSTD_MAGIC):
        import zstandard

        try:
            with zstandard.open(path, "rb") as file:
                return file.read(_LONGEST_HEAD)
        except zstandard.ZstdError:
            return b""
    if start.startswith(_GZIP_MAGIC):
        try:
            with gzip.open(path) as file:
                return file.read(_LONGEST_HEAD)
        except (OSError, EOFError):
            return b""
    return start


def blend_version(path: Path) -> tuple[int, int]:
    """(major, minor) of the Blender that wrote the file; InputError if there is none, or if it is no .blend."""
    if not path.exists():
        raise InputError(f"there is no file {path}; check the name and the folder")
    if path.is_dir():
        raise InputError(f"{path} is a folder; name a .blend file")
    try:
        head = _head(path)
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}") from error
    match = _NEW_HEAD.match(head) or _OLD_HEAD.match(head)
    if match is None:
        raise InputError(f"{path} is not a .blend file; save the scene in Blender first")
    return divmod(int(match[1]), 100)


def refuse_newer(path: Path, running: tuple[int, int]) -> str | None:
    """InputError for a file that a newer Blender than `running` wrote; a warning where Blender reads it all the same."""
    written = blend_version(path)
    if written <= running:
        return None
    versions = f"{path} was saved by Blender {written[0]}.{written[1]}, this is {running[0]}.{running[1]}"
    if written <= READS_NEWER.get(running, running):
        return f"{versions}: it loads, but what only the newer one knows is lost"
    raise InputError(f"{versions}; render it with Blender {written[0]}.{written[1]} or later")
