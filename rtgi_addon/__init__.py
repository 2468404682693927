"""RTGI: real-time global illumination techniques as a Blender render engine, measured against Cycles one-bounce."""

from __future__ import annotations

__version__ = "0.1.0"


def register() -> None:
    """Register the engine, its settings, panels and the command line in the running Blender."""
    from . import ui

    ui.register()


def unregister() -> None:
    """Undo `register`; nothing is left behind."""
    from . import ui

    ui.unregister()
