"""The image "RTGI" in an Image Editor."""

from __future__ import annotations

import bpy

from .. import engine
from . import pictures


class RTGI_OT_show_view(bpy.types.Operator):
    """Show the image "RTGI" in an Image Editor"""

    bl_idname = "rtgi.show_view"
    bl_label = "Show in Image Editor"
    bl_options = {"INTERNAL"}

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        return engine.last_result() is not None

    def execute(self, _context: bpy.types.Context) -> set[str]:
        engine.show_view(engine.shown_view())
        image = bpy.data.images.get(engine.IMAGE_NAME)
        if image is None:
            return {"CANCELLED"}
        pictures.show(image)
        return {"FINISHED"}


CLASSES = (RTGI_OT_show_view,)
