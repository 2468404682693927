"""What a scene asks for and RTGI does not model: one line each, naming the datablock."""

from __future__ import annotations

from collections.abc import Iterator

import bpy

from .materials import MaterialTable
from .nodes import node_tree


def _object_lines(source: bpy.types.Object) -> Iterator[str]:
    name = f"object {source.original.name_full!r}"
    if source.type == "VOLUME":
        yield f"{name}: volumes are left out"
    elif source.type in {"CURVES", "POINTCLOUD", "GREASEPENCIL"}:
        kind = {"CURVES": "hair strands", "POINTCLOUD": "point clouds", "GREASEPENCIL": "grease pencil strokes"}[source.type]
        yield f"{name}: {kind} show where Cycles draws them, but take no part in shadows and bounces"
    for system in source.particle_systems:
        if system.settings.type == "HAIR" and system.settings.render_type == "PATH":
            yield f"{name}: the hair of particle system {system.name!r} takes no part in shadows and bounces"
    if source.is_shadow_catcher and source.type != "LIGHT":      # lamps may catch shadows by default
        yield f"{name}: it catches no shadows; it is drawn as any other surface"
    linking = source.light_linking
    if linking.receiver_collection is not None or linking.blocker_collection is not None:
        yield f"{name}: light linking is ignored; it acts on everything"


def _lamp_line(lamp: bpy.types.Light) -> str | None:
    tree = node_tree(lamp)
    output = tree.get_output_node("CYCLES") if tree else None
    if output is None or not output.inputs["Surface"].is_linked:
        return None
    node = output.inputs["Surface"].links[0].from_node
    if any(n.type == "TEX_IES" for n in tree.nodes):
        return f"light {lamp.name_full!r}: its IES profile is ignored; it shines evenly"
    if node.type != "EMISSION" or any(node.inputs[name].is_linked for name in ("Color", "Strength")):
        return f"light {lamp.name_full!r}: its node tree is ignored; its power and colour are used"
    return None


def unsupported_warnings(depsgraph: bpy.types.Depsgraph, table: MaterialTable) -> tuple[str, ...]:
    """Every such thing in the evaluated scene once, sorted; those of the materials come with `table`.

    The world's own are in `world.WorldReading`.
    """
    lines = set(table.warnings)
    seen: set[int] = set()
    for instance in depsgraph.object_instances:
        source = instance.object
        address = source.original.as_pointer()
        if address in seen:
            continue
        seen.add(address)
        lines.update(_object_lines(source))
        line = _lamp_line(source.data) if source.type == "LIGHT" else None
        if line:
            lines.add(line)
    scene = depsgraph.scene_eval
    if scene.render.use_motion_blur:
        lines.add(f"scene {scene.name_full!r}: motion blur is ignored; the picture is sharp")
    camera = scene.camera
    if camera is not None and camera.type == "CAMERA" and camera.data.dof.use_dof:
        lines.add(f"camera {camera.name_full!r}: depth of field is ignored; the picture is sharp")
    return tuple(sorted(lines))
