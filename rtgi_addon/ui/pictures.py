"""Pictures in the Image Editor: image datablocks that no file keeps, since nothing uses them."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np


def from_file(name: str, path: Path) -> bpy.types.Image:
    """The generated image `name` with the pixels of a picture file; the file itself is not referred to."""
    loaded = bpy.data.images.load(str(path))
    try:
        width, height = loaded.size
        pixels = np.empty(width * height * 4, np.float32)
        loaded.pixels.foreach_get(pixels)
    finally:
        bpy.data.images.remove(loaded)
    image = bpy.data.images.get(name)
    if image is not None and image.source == "GENERATED" and not image.is_float:
        if tuple(image.size) != (width, height):
            image.scale(width, height)
    else:
        image = bpy.data.images.new(name, width, height, alpha=False)
    image.pixels.foreach_set(pixels)
    image.update()
    return image


def show(image: bpy.types.Image) -> None:
    """Show `image` in the largest Image Editor that is open, else in a window of its own."""
    manager = bpy.context.window_manager
    editors = [area for window in manager.windows for area in window.screen.areas if area.type == "IMAGE_EDITOR"]
    if not editors and manager.windows and not bpy.app.background:
        before = set(manager.windows)
        with bpy.context.temp_override(window=manager.windows[0]):
            bpy.ops.wm.window_new()
        for window in set(manager.windows) - before:
            area = max(window.screen.areas, key=lambda area: area.width * area.height)
            area.type = "IMAGE_EDITOR"
            editors.append(area)
    if editors:
        area = max(editors, key=lambda area: area.width * area.height)
        area.spaces.active.image = image
        area.tag_redraw()
        region = next((region for region in area.regions if region.type == "WINDOW"), None)
        window = next((window for window in manager.windows if area in list(window.screen.areas)), None)
        if region is not None and window is not None and not bpy.app.background:
            with bpy.context.temp_override(window=window, area=area, region=region):
                bpy.ops.image.view_all(fit_view=True)
