"""Pictures to files: float32 EXR through the OpenImageIO that Blender brings, PNG through the scene's view transform."""

from __future__ import annotations

import contextlib
import os
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .errors import InputError


def openimageio() -> Any:
    """The module OpenImageIO; the bpy package keeps it in a folder that is not on Python's path."""
    try:
        import OpenImageIO
    except ImportError:
        import bpy

        place = Path(bpy.utils.resource_path("LOCAL"), "python", "lib",
                     f"python{sys.version_info.major}.{sys.version_info.minor}", "site-packages")
        sys.path.append(str(place))
        try:
            import OpenImageIO
        finally:
            sys.path.remove(str(place))
    return OpenImageIO


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
    """Write (H, W) float32 images, row 0 at the top, as the channels of one EXR; InputError if it cannot be written."""
    oiio = openimageio()
    pixels = np.ascontiguousarray(np.stack(list(channels.values()), -1), np.float32)
    height, width, count = pixels.shape
    spec = oiio.ImageSpec(width, height, count, "float")
    spec.channelnames = tuple(channels)
    spec.attribute("compression", "zip")
    with replacing(path) as partial:
        out = oiio.ImageOutput.create(str(partial))
        done = out is not None and out.open(str(partial), spec) and out.write_image(pixels) and out.close()
        if not done:
            raise InputError(f"cannot write {path}: {out.geterror() if out is not None else oiio.geterror()}")


def read_exr(path: Path) -> dict[str, np.ndarray]:
    """The channels of an EXR's parts by name, (H, W) float32 each, row 0 at the top; InputError if it cannot be read."""
    oiio = openimageio()
    file = oiio.ImageInput.open(str(path))
    if file is None:
        raise InputError(f"cannot read {path}: {oiio.geterror()}")
    channels: dict[str, np.ndarray] = {}
    part = 0
    while file.seek_subimage(part, 0):
        pixels = file.read_image(part, 0, 0, file.spec().nchannels, "float")
        channels.update({name: pixels[..., i] for i, name in enumerate(file.spec().channelnames)})
        part += 1
    file.close()
    return channels


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
