"""Panels of the Render Properties, and Blender's own panels that stay visible with the engine RTGI."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import bpy

from ..core.techniques import LABELS
from . import props

ENGINE = "RTGI"

# settings of Cycles that RTGI decides itself or that mean nothing to it; the rest of Cycles' panels stay
_HIDDEN_PREFIXES = (
    "CYCLES_RENDER_PT_bake", "CYCLES_RENDER_PT_sampling", "CYCLES_RENDER_PT_light_paths", "CYCLES_RENDER_PT_performance_",
    "CYCLES_RENDER_PT_subdivision", "CYCLES_RENDER_PT_volumes", "CYCLES_RENDER_PT_motion_blur", "CYCLES_RENDER_PT_passes",
    "CYCLES_RENDER_PT_film_pixel_filter", "CYCLES_RENDER_PT_debug", "CYCLES_VIEW3D_PT_", "CYCLES_PT_sampling",
    "CYCLES_OBJECT_PT_motion_blur", "CYCLES_OBJECT_PT_shading_caustics", "CYCLES_OBJECT_PT_shading_gi_approximation",
    "CYCLES_CAMERA_PT_dof", "CYCLES_WORLD_PT_mist", "CYCLES_WORLD_PT_volume", "CYCLES_MATERIAL_PT_volume",
    "CYCLES_MATERIAL_PT_preview", "CYCLES_LIGHT_PT_preview", "CYCLES_WORLD_PT_preview", "CyclesPresetPanel",
)
_KEPT = ("CYCLES_RENDER_PT_performance_threads",)


def shared_panels() -> Iterator[type]:
    """Panels that Blender shows for Cycles and that mean the same for RTGI, other than ours."""
    for panel in bpy.types.Panel.__subclasses__():
        name = panel.__name__
        if "CYCLES" not in getattr(panel, "COMPAT_ENGINES", ()):
            continue
        if name in _KEPT or not name.startswith(_HIDDEN_PREFIXES):
            yield panel


@contextlib.contextmanager
def shown_with_rtgi() -> Iterator[None]:
    """Let the shared panels appear with RTGI too.

    Each panel gets a set of its own: many of Cycles' panels share one, which would let the hidden ones in.
    """
    own_before = {panel: panel.__dict__.get("COMPAT_ENGINES") for panel in shared_panels()}
    sets = {panel: {*panel.COMPAT_ENGINES, ENGINE} for panel in own_before}
    for panel, engines in sets.items():
        panel.COMPAT_ENGINES = engines
    try:
        yield
    finally:
        for panel, engines in own_before.items():
            if engines is None:
                del panel.COMPAT_ENGINES
            else:
                panel.COMPAT_ENGINES = engines


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


class RTGI_PT_quality(_RenderPanel, bpy.types.Panel):
    """Preset and choice of techniques."""

    bl_label = "RTGI"

    def draw(self, context: bpy.types.Context) -> None:
        layout, group = self.layout, context.scene.rtgi
        row = layout.row(align=True)
        row.prop(group, "preset", expand=True)
        if props.differs_from_preset(group):
            row = layout.row()
            row.label(text="Changed since the preset was chosen")
            row.operator("rtgi.reset_to_preset", icon="LOOP_BACK")
        column = layout.column()
        column.use_property_split, column.use_property_decorate = True, False
        column.prop(group, "use_auto")
        column.prop(group, "seed")


class RTGI_PT_direct(_RenderPanel, bpy.types.Panel):
    """Direct light of lamps."""

    bl_label = LABELS["direct"]
    bl_parent_id = "RTGI_PT_quality"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        layout.use_property_split, layout.use_property_decorate = True, False
        direct = context.scene.rtgi.direct
        layout.prop(direct, "soft_shadow_rays")
        layout.prop(direct, "exact_shadows")


class RTGI_PT_world(_RenderPanel, bpy.types.Panel):
    """Direct light of the world."""

    bl_label = LABELS["world"]
    bl_parent_id = "RTGI_PT_quality"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        layout.use_property_split, layout.use_property_decorate = True, False
        world = context.scene.rtgi.world
        layout.prop(world, "rays")
        layout.prop(world, "lattice_px")


class RTGI_PT_rsm(_RenderPanel, bpy.types.Panel):
    """The bounce by reflective shadow maps."""

    bl_label = LABELS["rsm"]
    bl_parent_id = "RTGI_PT_quality"

    # which settings each method reads
    SETTINGS_OF = {"VISIBLE": ("rays", "lattice_px", "clusters", "glossy_texels"),
                   "ALL": ("samples",),
                   "PAPER": ("samples", "radius", "weighting")}

    def draw_header(self, context: bpy.types.Context) -> None:
        self.layout.prop(context.scene.rtgi, "use_rsm", text="")

    def draw(self, context: bpy.types.Context) -> None:
        layout, group = self.layout, context.scene.rtgi
        layout.use_property_split, layout.use_property_decorate = True, False
        layout.active = group.use_rsm
        layout.prop(group.rsm, "method")
        for name in self.SETTINGS_OF[group.rsm.method]:
            layout.prop(group.rsm, name)


def last_render_lines(report: dict) -> Iterator[tuple[str, str]]:
    """(icon, text) lines that sum up the report of a render: total, plan, stages, warnings."""
    yield "TIME", f"{report['total_ms'] / 1000:.2f} s, and {report['jit_ms'] / 1000:.2f} s compiling"
    for stage in report["stages"]:
        yield "NONE", f"{stage['name']}: {stage['ms']:.0f} ms"
    for line in plan_lines(report["plan"]):
        yield "DOT", line
    for warning in report["warnings"]:
        yield "ERROR", warning


def plan_lines(plan: dict) -> Iterator[str]:
    """The plan of a report in words: what ran, then what was left out and why."""
    for run in plan["runs"]:
        yield f"{run['label']} ran"
    for item in plan["left_out"]:
        yield f"{item['what']} left out: {item['why']}"


class RTGI_PT_last_render(_RenderPanel, bpy.types.Panel):
    """What the last render did, how long it took and what it could not model."""

    bl_label = "Last Render"
    bl_parent_id = "RTGI_PT_quality"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, _context: bpy.types.Context) -> None:
        from ..engine import last_result

        column = self.layout.column(align=True)
        result = last_result()
        if result is None:
            column.label(text="Nothing was rendered yet")
            return
        for icon, text in last_render_lines(result.report):
            column.label(text=text, icon=icon)


CLASSES = (RTGI_OT_reset_to_preset, RTGI_PT_quality, RTGI_PT_direct, RTGI_PT_world, RTGI_PT_rsm, RTGI_PT_last_render)
