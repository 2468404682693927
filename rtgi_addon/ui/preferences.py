"""The add-on's preferences: where kernels are kept, how many threads they take, and a button that compiles them."""

from __future__ import annotations

import contextlib
from pathlib import Path

import bpy

from ..core.cache_root import cache_root, references_root
from . import tasks

# "bl_ext.<repository>.<id>" where Blender installed the extension, whose package holds ours; else our package itself
_PACKAGE = __package__.rpartition(".")[0]
IS_EXTENSION = _PACKAGE.startswith("bl_ext.")
ADDON_ID = _PACKAGE.rpartition(".")[0] if IS_EXTENSION else _PACKAGE


def extension_cache() -> Path | None:
    """The folder that Blender lets this extension write to, or None where it does not run as an extension."""
    return Path(bpy.utils.extension_path_user(ADDON_ID, path="numba_cache")) if IS_EXTENSION else None


def preferred_threads() -> int:
    """Threads set in the preferences; 0 (all) where the add-on was registered by a script and has no preferences."""
    addon = bpy.context.preferences.addons.get(ADDON_ID)
    return addon.preferences.threads if addon and addon.preferences else 0


def cache_size_mb() -> float:
    """Size of all compiled kernels that are kept, also of earlier versions."""
    files = [path for path in cache_root().rglob("*") if path.is_file() and not path.is_relative_to(references_root())]
    return sum(path.stat().st_size for path in files) / 1e6


class RTGI_OT_clear_cache(bpy.types.Operator):
    """Delete the compiled kernels; the next render of a new session compiles them again"""

    bl_idname = "rtgi.clear_cache"
    bl_label = "Clear"
    bl_options = {"REGISTER"}

    def execute(self, _context: bpy.types.Context) -> set[str]:
        # only what numba wrote: the folder may be one that the user named
        for path in [path for ending in ("*.nbi", "*.nbc") for path in cache_root().rglob(ending)]:
            with contextlib.suppress(OSError):   # in use, on Windows
                path.unlink()
        return {"FINISHED"}


class RTGI_preferences(bpy.types.AddonPreferences):
    """Preferences of RTGI."""

    bl_idname = ADDON_ID

    threads: bpy.props.IntProperty(
        name="Threads", default=0, min=0, max=1024, soft_max=64,
        description="Threads of the techniques, 0 for all; a fixed number in the scene's Performance panel stands above")

    def draw(self, _context: bpy.types.Context) -> None:
        layout = self.layout
        layout.use_property_split = True
        layout.prop(self, "threads")
        layout.label(text=f"Compiled kernels: {cache_size_mb():.1f} MB in {cache_root()}")
        if not tasks.draw_running(layout, tasks.RTGI_OT_warm_up.bl_label):
            row = layout.row()
            row.operator("rtgi.warm_up", icon="FILE_REFRESH")
            row.operator("rtgi.clear_cache", icon="TRASH")


CLASSES = (RTGI_OT_clear_cache, RTGI_preferences)
