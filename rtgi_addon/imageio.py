"""Pictures to files and back: float32 EXR, and PNG through the scene's view transform."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .core import exr
from .errors import InputError


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A name to write to that becomes `path` at the end, so that an interrupted write never looks finished."""
    handle, name = tempfile.mkstemp(prefix=".rtgi_", suffix=path.suffix, dir=path.parent)
    os.close(handle)
    partial = Path(name)
    try:
        yield partial
        umask = os.umask(0)
        os.umask(umask)
        partial.chmod(0o666 & ~umask)            # mkstemp makes files that only their owner may read
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def write_exr(path: Path, channels: Mapping[str, np.ndarray]) -> None:
    """Write (H, W) float32 images, row 0 at the top, as the channels of one EXR; OSError if it cannot be written."""
    with replacing(path) as partial, partial.open("wb") as file:
        exr.write(file, channels)


def read_exr(path: Path) -> dict[str, np.ndarray]:
    """The channels of an EXR's parts by name, (H, W) each, row 0 at the top; InputError if it cannot be read."""
    try:
        return exr.parse(path.read_bytes())
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}") from error
    except InputError as error:
        raise InputError(f"cannot read {path}: {error}") from error


def read_png(path: Path) -> np.ndarray:
    """(H, W, 4) uint8 of a PNG of 8 bits, row 0 at the top, exactly as stored; InputError if it cannot be read."""
    import bpy

    try:
        image = bpy.data.images.load(str(path))
    except RuntimeError as error:
        raise InputError(f"cannot read {path}: {error}") from error
    try:
        width, height = image.size
        pixels = np.empty(width * height * 4, np.float32)
        image.pixels.foreach_get(pixels)
    finally:
        bpy.data.images.remove(image)
    return np.rint(pixels.reshape(height, width, 4)[::-1] * 255).astype(np.uint8)


def write_composite_exr(path: Path, combined: np.ndarray) -> None:
    """Write the linear composite (H, W, 4) float32 as R, G, B, A."""
    write_exr(path, {name: combined[..., i] for i, name in enumerate("RGBA")})


def write_png(path: Path, combined: np.ndarray, scene: Any) -> None:
    """Write the composite (H, W, 4) through the scene's view transform and exposure; alpha only for a transparent film.

    The scene's image settings are borrowed and given back.
    """
    import bpy

    height, width = combined.shape[:2]
    image = bpy.data.images.new("RTGI output", width, height, alpha=True, float_buffer=True)
    settings = scene.render.image_settings
    wanted = {"file_format": "PNG", "color_mode": "RGBA" if scene.render.film_transparent else "RGB", "color_depth": "8"}
    if hasattr(settings, "media_type"):          # Blender 5 asks for the kind of file first
        wanted = {"media_type": "IMAGE", **wanted}
    before = {name: getattr(settings, name) for name in wanted}
    try:
        image.pixels.foreach_set(np.ascontiguousarray(combined[::-1], np.float32).ravel())
        for name, value in wanted.items():
            setattr(settings, name, value)
        with replacing(path) as partial:
            image.save_render(str(partial), scene=scene)
    except RuntimeError as error:
        raise InputError(f"cannot write {path}: {error}") from error
    finally:
        for name, value in before.items():
            setattr(settings, name, value)
        bpy.data.images.remove(image)
