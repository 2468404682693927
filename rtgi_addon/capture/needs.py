"""Which passes a scene's frames need of Cycles; asked often, so it looks at sockets only."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import bpy

from .nodes import node_tree
from .versions import HAS_ROUGHNESS_PASS, pass_name

ROUGHNESS_PASS = "Denoising Roughness"
SCATTERING_NODES = ("BSDF_PRINCIPLED", "BSDF_GLOSSY", "BSDF_ANISOTROPIC", "BSDF_METALLIC")


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


def _lobes(tree: bpy.types.NodeTree) -> Iterator[tuple]:
    """What tells a glossy lobe's reflectance: at normal incidence, of each node that has one and is no metal for sure, and
    whether it scatters but once."""
    for node in tree.nodes:
        if node.type == "GROUP" and node.node_tree is not None:
            yield from _lobes(node.node_tree)
        elif node.type in SCATTERING_NODES and node.distribution != "MULTI_GGX":
            yield ("single scattering",)
        elif node.type in {"BSDF_GLOSSY", "BSDF_ANISOTROPIC"}:
            yield ("without Fresnel",)
        elif node.type in {"BSDF_GLASS", "BSDF_PRINCIPLED"} and not _is_metal(node):
            sockets = [node.inputs[name] for name in ("IOR", "Specular IOR Level") if name in node.inputs]
            yield tuple("linked" if s.is_linked else round(s.default_value, 3) for s in sockets)


def _is_metal(node: bpy.types.Node) -> bool:
    metallic = node.inputs.get("Metallic")
    return metallic is not None and not metallic.is_linked and metallic.default_value >= 1


def _may_differ(materials: Iterable[bpy.types.Material]) -> bool:
    """Whether pixels need their material's number, since a lobe is no dielectric of index 1.5, as colours alone suppose."""
    return any(lobe != (1.5, 0.5) for m in materials if node_tree(m) for lobe in _lobes(node_tree(m)))


def _may_let_through(material: bpy.types.Material) -> bool:
    tree = node_tree(material)
    return any(node.type in {"GROUP", "BSDF_TRANSPARENT"} or (
        node.type == "BSDF_PRINCIPLED" and (node.inputs["Alpha"].is_linked or node.inputs["Alpha"].default_value < 1))
        for node in (tree.nodes if tree else ()))


def read_needs(scene: bpy.types.Scene) -> Needs:
    """Passes beyond depth, normal and diffuse colour that `scene` may need; asking for one too many costs only time."""
    materials = {slot.material for source in scene.objects for slot in source.material_slots if slot.material}
    instanced = any(source.instance_type == "COLLECTION" for source in scene.objects)
    used = bpy.data.materials if instanced else materials
    # the roughness pass adds up what lies behind each other in surfaces that let light through
    index = not HAS_ROUGHNESS_PASS or _may_differ(used) or any(map(_may_let_through, used))
    return Needs(glossy=True, emission=any(map(_may_emit, used)), environment=_may_shine(scene.world), material_index=index)
