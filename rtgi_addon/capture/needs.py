"""Which passes a scene's frames need of Cycles; asked often, so it looks at sockets only."""

from __future__ import annotations

from dataclasses import dataclass

import bpy

from .nodes import node_tree
from .versions import HAS_ROUGHNESS_PASS, pass_name

ROUGHNESS_PASS = "Denoising Roughness"


@dataclass(frozen=True)
class Needs:
    """Which passes the frame needs beyond depth, normal and diffuse colour."""

    glossy: bool = True
    emission: bool = False
    environment: bool = False
    material_index: bool = False

    def passes(self) -> list[tuple[str, str, str]]:
        """(name, channels, kind) for `RenderEngine.register_pass`, by the running Blender's names."""
        wanted = [("Depth", "Z", "VALUE"), ("Normal", "XYZ", "VECTOR"), ("Diffuse Color", "RGB", "COLOR")]
        if self.glossy:
            wanted.append(("Glossy Color", "RGB", "COLOR"))
            if HAS_ROUGHNESS_PASS:
                wanted.append((ROUGHNESS_PASS, "X", "VALUE"))
        if self.emission:
            wanted.append(("Emission", "RGB", "COLOR"))
        if self.environment:
            wanted.append(("Environment", "RGB", "COLOR"))
        if self.material_index:
            wanted.append(("Material Index", "X", "VALUE"))
        return [(pass_name(name), channels, kind) for name, channels, kind in wanted]


def _is_off(node: bpy.types.Node, name: str) -> bool:
    """Whether a numeric or colour input is unlinked and zero."""
    socket = node.inputs.get(name)
    if socket is None or socket.is_linked:
        return socket is None
    value = socket.default_value
    return not (any(value[:3]) if hasattr(value, "__len__") else value)


def _may_emit(material: bpy.types.Material) -> bool:
    tree = node_tree(material)
    for node in tree.nodes if tree else ():
        if node.type == "GROUP" or (node.type == "EMISSION" and not _is_off(node, "Strength")):
            return True
        if node.type == "BSDF_PRINCIPLED" and not (_is_off(node, "Emission Strength") or _is_off(node, "Emission Color")):
            return True
    return False


def _may_shine(world: bpy.types.World | None) -> bool:
    if world is None:
        return False
    tree = node_tree(world)
    if tree is None:
        return any(world.color)
    return any(node.type in {"GROUP", "EMISSION"} or (
        node.type == "BACKGROUND" and not (_is_off(node, "Strength") or _is_off(node, "Color"))) for node in tree.nodes)


def read_needs(scene: bpy.types.Scene) -> Needs:
    """Passes beyond depth, normal and diffuse colour that `scene` may need; asking for one too many costs only time."""
    materials = {slot.material for source in scene.objects for slot in source.material_slots if slot.material}
    instanced = any(source.instance_type == "COLLECTION" for source in scene.objects)
    emission = any(map(_may_emit, bpy.data.materials if instanced else materials))
    return Needs(glossy=True, emission=emission, environment=_may_shine(scene.world), material_index=not HAS_ROUGHNESS_PASS)
