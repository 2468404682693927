"""Everything that RTGI registers in Blender, and its exact undoing."""

from __future__ import annotations

from contextlib import ExitStack

_registered: ExitStack | None = None


def _run_command(argv: list[str]) -> int:
    from ..cli import main

    return main(argv)


def register() -> None:
    """Register settings, panels, preferences, engine and command; a second call does nothing.

    What fails half-way is undone before the error goes on.
    """
    global _registered
    if _registered is not None:
        return
    import bpy

    from .. import engine
    from ..core import cache_root
    from . import panels, preferences, presets, props, session, tasks, views

    with ExitStack() as undo:
        cache_root.set_cache_root(preferences.extension_cache())
        undo.callback(cache_root.set_cache_root, None)
        undo.callback(tasks.stop)
        for cls in (*props.CLASSES, *session.CLASSES, *tasks.CLASSES, *preferences.CLASSES, *presets.CLASSES,
                    *views.CLASSES, *panels.classes()):
            bpy.utils.register_class(cls)
            undo.callback(bpy.utils.unregister_class, cls)
        bpy.types.Scene.rtgi = bpy.props.PointerProperty(type=props.SCENE_GROUP, name="RTGI")
        undo.callback(delattr, bpy.types.Scene, "rtgi")
        bpy.types.WindowManager.rtgi = bpy.props.PointerProperty(type=session.RTGI_session, name="RTGI")
        undo.callback(delattr, bpy.types.WindowManager, "rtgi")
        engine.register()
        undo.callback(engine.unregister)
        undo.enter_context(panels.shown_with_rtgi())
        command = bpy.utils.register_cli_command("rtgi", _run_command)
        undo.callback(bpy.utils.unregister_cli_command, command)
        _registered = undo.pop_all()


def unregister() -> None:
    """Take back all that `register` did, in reverse order; a second call does nothing."""
    global _registered
    if _registered is not None:
        _registered.close()
        _registered = None
