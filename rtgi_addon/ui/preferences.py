"""The add-on's preferences: where kernels are kept, how many threads they take, and a button that compiles them."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..core.cache_root import cache_root

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


class RTGI_OT_warm_up(bpy.types.Operator):
    """Compile every kernel now, so that the first render does not have to wait for it"""

    bl_idname = "rtgi.warm_up"
    bl_label = "Warm Up Kernels"
    bl_options = {"REGISTER"}

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        from ..warmup import warm_up

        self._steps, self._seconds = warm_up(preferred_threads()), 0.0
        self._timer = context.window_manager.event_timer_add(0.05, window=context.window)
        context.window_manager.modal_handler_add(self)
        context.workspace.status_text_set("RTGI: compiling kernels (Esc stops)")
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if event.type == "ESC":
            self._finish(context)
            return {"CANCELLED"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        step = next(self._steps, None)
        if step is None:
            self._finish(context)
            self.report({"INFO"}, f"RTGI: kernels are ready after {self._seconds:.1f} s")
            return {"FINISHED"}
        self._seconds += step.seconds
        context.workspace.status_text_set(f"RTGI: {step.name} compiled in {step.seconds:.1f} s (Esc stops)")
        return {"RUNNING_MODAL"}

    def _finish(self, context: bpy.types.Context) -> None:
        context.window_manager.event_timer_remove(self._timer)
        context.workspace.status_text_set(None)

    def execute(self, _context: bpy.types.Context) -> set[str]:
        from ..warmup import warm_up

        seconds = sum(step.seconds for step in warm_up(preferred_threads()))
        self.report({"INFO"}, f"RTGI: kernels are ready after {seconds:.1f} s")
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
        row = layout.row()
        row.label(text=f"Compiled kernels: {cache_root()}")
        row.operator("rtgi.warm_up", icon="FILE_REFRESH")


CLASSES = (RTGI_OT_warm_up, RTGI_preferences)
