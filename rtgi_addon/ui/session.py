"""What the panels remember for the time of this session and no file keeps: `window_manager.rtgi`."""

from __future__ import annotations

from typing import Any

import bpy

from .. import engine

_values: dict[str, Any] = {"samples": 64, "keeps_reference": False}
_items: list[tuple[str, str, str, int]] = []     # Blender does not keep a callback's texts alive


def _remembered(name: str) -> dict[str, Any]:
    """`get` and `set` of a property whose value is kept here instead of in the file."""
    return {"get": lambda _group: _values[name], "set": lambda _group, value: _values.__setitem__(name, value)}


def _view_items(_group: Any, _context: Any) -> list[tuple[str, str, str, int]]:
    found = [(name, name.capitalize(), about, number) for number, (name, about) in enumerate(engine.views().items())]
    if found != _items:
        _items[:] = found
    return _items


def _get_view(_group: Any) -> int:
    names = list(engine.views())
    return names.index(engine.shown_view()) if engine.shown_view() in names else 0


def _set_view(_group: Any, number: int) -> None:
    engine.show_view(list(engine.views())[number])


class RTGI_session(bpy.types.PropertyGroup):
    """State of the panels."""

    view: bpy.props.EnumProperty(
        name="View",
        description='What the image "RTGI" shows: the picture, or one kind of light that went into it; linear values '
                    "without the scene's view transform",
        items=_view_items, get=_get_view, set=_set_view)
    samples: bpy.props.IntProperty(
        name="Samples", min=1, max=65536, soft_max=1024, **_remembered("samples"),
        description="Samples a pixel of each of the two halves of Cycles' picture; their difference is its noise. "
                    "Time grows with their number")
    keeps_reference: bpy.props.BoolProperty(
        name="Keep Reference", **_remembered("keeps_reference"),
        description="Compare with the last comparison's picture of Cycles instead of rendering it anew; right as long as "
                    "only settings of RTGI were changed")


CLASSES = (RTGI_session,)


def redraw() -> None:
    """Let the editors that show something of RTGI be drawn again."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type in {"PROPERTIES", "PREFERENCES"}:
                area.tag_redraw()
