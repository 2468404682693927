"""Panels of the Render Properties, and Blender's own panels that stay visible with the engine RTGI."""

from __future__ import annotations

import contextlib
import dataclasses
import textwrap
from collections.abc import Callable, Iterator
from typing import Any

import bpy

from ..core.cache_root import cache_root
from ..core.params import is_read
from ..core.techniques import ALWAYS_ON, LABELS, TECHNIQUE_PARAMS
from . import presets, props, tasks

ENGINE = "RTGI"

# settings of Cycles that RTGI decides itself or that mean nothing to it; the rest of Cycles' panels stay
_HIDDEN_PREFIXES = (
    "CYCLES_RENDER_PT_bake", "CYCLES_RENDER_PT_sampling", "CYCLES_RENDER_PT_light_paths", "CYCLES_RENDER_PT_performance_",
    "CYCLES_RENDER_PT_subdivision", "CYCLES_RENDER_PT_volumes", "CYCLES_RENDER_PT_motion_blur", "CYCLES_RENDER_PT_curves",
    "CYCLES_RENDER_PT_passes_light",             # ours has those that RTGI fills; this also hides the light groups
    "CYCLES_OBJECT_PT_lightgroup", "CYCLES_WORLD_PT_settings", "CYCLES_MATERIAL_PT_settings_volume",
    "CYCLES_RENDER_PT_film_pixel_filter", "CYCLES_RENDER_PT_debug", "CYCLES_VIEW3D_PT_", "CYCLES_PT_sampling",
    "CYCLES_OBJECT_PT_motion_blur", "CYCLES_OBJECT_PT_shading_caustics", "CYCLES_OBJECT_PT_shading_gi_approximation",
    "CYCLES_CAMERA_PT_dof", "CYCLES_WORLD_PT_mist", "CYCLES_WORLD_PT_volume", "CYCLES_MATERIAL_PT_volume",
    "CYCLES_MATERIAL_PT_preview", "CYCLES_LIGHT_PT_preview", "CYCLES_WORLD_PT_preview", "CyclesPresetPanel",
)
# Blender shows panels in the order of registration, and `bl_order` goes no lower than Cycles' own 0: these would stand above
# ours. They follow as panels of ours that draw what Cycles' draw; a parent before its children
_FOLLOWING = ("simplify", "simplify_viewport", "simplify_render", "simplify_culling", "film", "film_transparency",
              "performance", "performance_threads", "performance_final_render")
_PASSES = "CYCLES_RENDER_PT_passes"


def shared_panels() -> Iterator[type]:
    """Panels that Blender shows for Cycles and that mean the same for RTGI, other than ours."""
    for panel in bpy.types.Panel.__subclasses__():
        name = panel.__name__
        if "CYCLES" not in getattr(panel, "COMPAT_ENGINES", ()):
            continue
        if name.removeprefix("CYCLES_RENDER_PT_") not in _FOLLOWING and not name.startswith(_HIDDEN_PREFIXES):
            yield panel


def classes() -> Iterator[type]:
    """All that is to be registered, in this order: ours, and Cycles' panels of the Render tab once more."""
    # without its parent a panel cannot be registered, and Cycles may be off, or come later in the list of add-ons
    RTGI_PT_light_passes.bl_parent_id = _PASSES if hasattr(bpy.types, _PASSES) else ""
    yield from CLASSES
    for name in _FOLLOWING:
        panel = getattr(bpy.types, f"CYCLES_RENDER_PT_{name}", None)
        if panel is not None:
            # no subclass: Blender warns at each redraw about classes that derive from registered ones
            words = {part: value for part, value in vars(panel).items()
                     if part in ("bl_label", "bl_options", "draw_header", "draw_header_preset", "__doc__")}
            words |= {"__module__": __name__, "COMPAT_ENGINES": {ENGINE}, "draw": _drawn_by(panel)}
            if hasattr(panel, "bl_parent_id"):
                words["bl_parent_id"] = panel.bl_parent_id.replace("CYCLES_RENDER_", "RTGI_")
            yield type(f"RTGI_PT_{name}", panel.__bases__, words)


def _drawn_by(panel: type) -> Callable[[Any, bpy.types.Context], None]:
    """What draws `panel` when it is drawn: other add-ons may have added to it by then."""
    return lambda self, context: panel.draw(self, context)


def _polled_like_cycles(panel: type, base: type) -> classmethod:
    """`poll` of a panel of Cycles that lets RTGI pass where it asks its base class, and not itself, for the engines."""
    asked = panel.poll.__func__

    def poll(cls: type, context: bpy.types.Context) -> bool:
        if context.engine != ENGINE:
            return asked(cls, context)
        # for the time of the call: Cycles' hidden panels ask the same class
        base.COMPAT_ENGINES.add(ENGINE)
        try:
            return asked(cls, context)
        finally:
            base.COMPAT_ENGINES.discard(ENGINE)

    return classmethod(poll)


@contextlib.contextmanager
def shown_with_rtgi() -> Iterator[None]:
    """Let the shared panels appear with RTGI too.

    Each panel gets a set of its own: many of Cycles' panels share one, which would let the hidden ones in.
    """
    before, changes = {}, {}
    for panel in shared_panels():
        changes[panel] = {"COMPAT_ENGINES": {*panel.COMPAT_ENGINES, ENGINE}}
        base = next((kind for kind in panel.__mro__ if kind.__name__ == "CyclesButtonsPanel"), None)
        if base is not None and panel.poll.__func__ is not base.poll.__func__:
            changes[panel]["poll"] = _polled_like_cycles(panel, base)
        before[panel] = {name: vars(panel).get(name) for name in changes[panel]}
    for panel, words in changes.items():
        for name, value in words.items():
            setattr(panel, name, value)
    try:
        yield
    finally:
        for panel, words in before.items():
            for name, value in words.items():
                if value is None:
                    delattr(panel, name)
                else:
                    setattr(panel, name, value)


class _RenderPanel:
    """What every panel of RTGI in the Render Properties has in common."""

    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "render"
    COMPAT_ENGINES = {ENGINE}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return context.engine in cls.COMPAT_ENGINES


class RTGI_OT_reset_to_preset(bpy.types.Operator):
    """Set gather points, rays and clusters back to what the preset says"""

    bl_idname = "rtgi.reset_to_preset"
    bl_label = "Reset to Preset"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        props.apply_preset(context.scene.rtgi)
        return {"FINISHED"}


STAGE_LABELS = {"bvh": "BVH", **LABELS}
WIDE_PX = 380               # a panel as wide as this has room for all columns of the comparison
_found_kernels = False


def has_kernels() -> bool:
    """Whether any kernel was ever compiled here; asked at each redraw, so a yes is remembered."""
    global _found_kernels
    _found_kernels = _found_kernels or next(cache_root().rglob("*.nbi"), None) is not None
    return _found_kernels


def last_report() -> dict[str, Any] | None:
    """Report of the newest render, or None."""
    from ..engine import last_result

    result = last_result()
    return result.report if result is not None else None


def panel_width(context: bpy.types.Context) -> float:
    """Width in px, at scale 1, of the region that is drawn; 0 without a window."""
    return context.region.width / max(context.preferences.system.ui_scale, 0.1) if context.region is not None else 0.0


def draw_text(layout: Any, context: bpy.types.Context, text: str, icon: str = "NONE") -> None:
    """A text over as many lines as the panel's width asks for; labels do not wrap by themselves."""
    # letters of Blender's font take 6.2 px on average, margins and icon 70 px
    letters = max(int((panel_width(context) - 70) / 6.2), 24)
    column = layout.column(align=True)
    column.scale_y = 0.8
    for number, line in enumerate(textwrap.wrap(text, letters)):
        column.label(text=line, icon=icon if number == 0 else "BLANK1" if icon != "NONE" else "NONE")


class RTGI_PT_quality(_RenderPanel, bpy.types.Panel):
    """Preset and choice of techniques."""

    bl_label = "RTGI"

    def draw_header_preset(self, _context: bpy.types.Context) -> None:
        presets.RTGI_PT_presets.draw_panel_header(self.layout)

    def draw(self, context: bpy.types.Context) -> None:
        layout, group = self.layout, context.scene.rtgi
        row = layout.row(align=True)
        row.active = group.budget == "NONE"
        row.prop(group, "preset", expand=True)
        if props.differs_from_preset(group):
            row = layout.row()
            row.label(text="Changed")
            row.operator("rtgi.reset_to_preset", icon="LOOP_BACK")
        column = layout.column()
        column.use_property_split, column.use_property_decorate = True, False
        column.prop(group, "budget")
        if group.budget != "NONE":
            column.prop(group, "target_time_s" if group.budget == "TIME" else "target_error_percent")
        column.prop(group, "use_auto")
        column.prop(group, "seed")
        if not tasks.draw_running(layout, tasks.RTGI_OT_warm_up.bl_label) and not has_kernels():
            draw_text(layout, context, "The first render compiles kernels: a minute, and never again", "INFO")
            layout.operator("rtgi.warm_up", icon="FILE_REFRESH")


def technique_note(report: dict[str, Any], name: str) -> str:
    """What became of a technique in the render of `report`: its time, or why it was left out; "" if nothing is known."""
    if name in [run["technique"] for run in report["plan"]["runs"]]:
        return "Last render: " + "".join(f"{stage['ms']:.0f} ms" for stage in report["stages"] if stage["name"] == name)
    return next((f"Left out of the last render: {item['why']}" for item in report["plan"]["left_out"]
                 if item["what"] == LABELS[name]), "")


class _TechniquePanel(_RenderPanel):
    """Settings of one technique: those that it reads as it is set now."""

    bl_parent_id = "RTGI_PT_quality"
    bl_options = {"DEFAULT_CLOSED"}
    technique = ""

    def draw(self, context: bpy.types.Context) -> None:
        layout, name = self.layout, self.technique
        layout.use_property_split, layout.use_property_decorate = True, False
        column, group = layout.column(), getattr(context.scene.rtgi, name)
        column.active = props.is_enabled(context.scene.rtgi, name)
        for field in dataclasses.fields(TECHNIQUE_PARAMS[name]):
            if is_read(field, group):
                column.prop(group, field.name)
        report = last_report()
        if report is not None and (note := technique_note(report, name)):
            draw_text(layout, context, note, "INFO")


class _ToggledPanel(_TechniquePanel):
    """A technique with a check mark in its header."""

    def draw_header(self, context: bpy.types.Context) -> None:
        self.layout.prop(context.scene.rtgi, f"use_{self.technique}", text="")


def _technique_panel(name: str) -> type:
    base = _TechniquePanel if name in ALWAYS_ON else _ToggledPanel
    return type(f"RTGI_PT_{name}", (base, bpy.types.Panel), {
        "__doc__": TECHNIQUE_PARAMS[name].__doc__, "__module__": __name__, "bl_label": LABELS[name], "technique": name})


TECHNIQUE_PANELS = {name: _technique_panel(name) for name in TECHNIQUE_PARAMS}


def plan_lines(plan: dict) -> Iterator[str]:
    """The plan of a report in words: what ran, what was left out and why, and what a budget chose."""
    for run in plan["runs"]:
        yield f"{run['label']} ran"
    for item in plan["left_out"]:
        yield f"{item['what']} left out: {item['why']}"
    yield from plan["budget"]


class RTGI_PT_last_render(_RenderPanel, bpy.types.Panel):
    """What the last render did, how long it took and what it could not model."""

    bl_label = "Last Render"
    bl_options = {"DEFAULT_CLOSED"}

    def draw_header_preset(self, _context: bpy.types.Context) -> None:
        """Its time, and a sign if there are warnings: the panel is closed at first."""
        if (report := last_report()) is not None:
            self.layout.label(text=f"{report['total_ms'] / 1000:.2f} s", icon="ERROR" if report["warnings"] else "NONE")

    def draw(self, context: bpy.types.Context) -> None:
        layout, report = self.layout, last_report()
        if report is None:
            layout.label(text="Nothing was rendered yet")
            return
        row = layout.row()
        row.use_property_split, row.use_property_decorate = True, False
        row.prop(context.window_manager.rtgi, "view")
        row.operator("rtgi.show_view", text="", icon="IMAGE_DATA")
        for warning in report["warnings"]:
            draw_text(layout, context, warning, "ERROR")
        for line in plan_lines(report["plan"]):
            draw_text(layout, context, line, "DOT")


class RTGI_PT_times(_RenderPanel, bpy.types.Panel):
    """Milliseconds of each stage of the last render."""

    bl_label = "Times"
    bl_parent_id = "RTGI_PT_last_render"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return super().poll(context) and last_report() is not None

    def draw(self, _context: bpy.types.Context) -> None:
        report = last_report()
        if report is None:
            return
        column = self.layout.column(align=True)
        column.scale_y = 0.8
        for name, value in time_lines(report):
            row = column.split(factor=0.6)
            row.label(text=name)
            right = row.row()
            right.alignment = "RIGHT"
            right.label(text=value)


def time_lines(report: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """(stage, time) of a report, the sum and what was compiled last."""
    for stage in report["stages"]:
        yield STAGE_LABELS.get(stage["name"], stage["name"].capitalize()), f"{stage['ms']:.0f} ms"
    yield "Sum", f"{report['total_ms'] / 1000:.2f} s"
    yield "Compiling, besides", f"{report['jit_ms'] / 1000:.2f} s"


class RTGI_PT_compare(_RenderPanel, bpy.types.Panel):
    """Errors and times beside Cycles at one bounce."""

    bl_label = "Compare with Cycles"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        layout, session, found = self.layout, context.window_manager.rtgi, tasks.last_comparison()
        if not tasks.draw_running(layout, tasks.RTGI_OT_compare.bl_label):
            column = layout.column()
            column.use_property_split, column.use_property_decorate = True, False
            keeps = found is not None and bool(found.reference) and session.keeps_reference
            row = column.row()
            row.active = not keeps
            row.prop(session, "samples")
            if found is not None and found.reference:
                column.prop(session, "keeps_reference")
            words = layout.operator("rtgi.compare", icon="SPLIT_HORIZONTAL")
            words.samples, words.reference = session.samples, found.reference if keeps else ""
        if found is None:
            return
        draw_text(layout, context, f"{found.title}: times, and errors against Cycles")
        shown = range(1, len(tasks.HEAD)) if panel_width(context) > WIDE_PX else tasks.NARROW_COLUMNS
        table = layout.split(factor=0.4)
        names, rest = table.column(align=True), table.row()
        for column, number in ((names, 0), *((rest.column(align=True), number) for number in shown)):
            column.scale_y = 0.8
            for cells in (tasks.HEAD, *found.rows):
                cell = column.row()
                cell.alignment = "RIGHT" if number else "LEFT"
                cell.label(text=cells[number])
        layout.operator("rtgi.show_comparison", icon="IMAGE_DATA")


class RTGI_PT_light_passes(_RenderPanel, bpy.types.Panel):
    """Passes of the view layer that hold light, as far as RTGI fills them."""

    bl_label = "Light"
    bl_context = "view_layer"
    bl_parent_id = _PASSES

    def draw(self, context: bpy.types.Context) -> None:
        from ..engine import OUTPUT_PASSES

        layout, layer = self.layout, context.view_layer
        layout.use_property_split, layout.use_property_decorate = True, False
        for kind in ("diffuse", "glossy"):
            column = layout.column(heading=kind.capitalize(), align=True)
            for part in ("direct", "indirect", "color"):
                column.prop(layer, f"use_pass_{kind}_{part}", text=part.capitalize())
        column = layout.column(heading="Other", align=True)
        column.prop(layer, "use_pass_emit", text="Emission")
        column.prop(layer, "use_pass_environment")
        draw_text(layout, context, "Always there: " + ", ".join(name for name, _ in OUTPUT_PASSES), "INFO")


CLASSES = (RTGI_OT_reset_to_preset, RTGI_PT_quality, *TECHNIQUE_PANELS.values(), RTGI_PT_last_render, RTGI_PT_times,
           RTGI_PT_compare, RTGI_PT_light_passes)
