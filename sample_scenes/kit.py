"""What the sample scenes are made of: materials, shapes, lamps, cameras and worlds, in metres, degrees and watts.

Every function adds to the current scene and returns what it made. Colours are linear Rec.709. Shapes stand on their
`location`: it is the middle of their base. UV coordinates are metres over `tile_m`, so a texture keeps its real size on
every shape.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable, Sequence

import bmesh
import bpy
import numpy as np
from mathutils import Vector

Vector3 = Sequence[float]
WHITE = (0.73, 0.73, 0.73)


def set_defaults(scene: bpy.types.Scene) -> None:
    """What all sample scenes share: 960x540, metres, one view transform, a black world, one bounce for Cycles too."""
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 960, 540, 100
    scene.unit_settings.system, scene.unit_settings.length_unit = "METRIC", "METERS"
    scene.view_settings.view_transform = "AgX"
    scene.view_settings.look = "AgX - Medium High Contrast"
    scene.frame_start = scene.frame_end = 1
    scene.render.engine = "CYCLES"
    scene.cycles.samples = 64
    scene.cycles.max_bounces = scene.cycles.diffuse_bounces = scene.cycles.glossy_bounces = 1
    with contextlib.suppress(TypeError):  # an engine that is not registered is no value of this setting
        scene.render.engine = "RTGI"
    world((0.0, 0.0, 0.0))


# Materials and textures


def material(
    name: str, colour: Vector3 = WHITE, roughness: float = 0.6, metallic: float = 0.0, texture: bpy.types.Image | None = None
) -> bpy.types.Material:
    """A Principled BSDF; `texture` takes the place of the colour."""
    made = bpy.data.materials.new(name)
    made.diffuse_color = (*colour, 1.0)
    tree = _empty_tree(made)
    surface, output = tree.nodes.new("ShaderNodeBsdfPrincipled"), tree.nodes.new("ShaderNodeOutputMaterial")
    surface.inputs["Base Color"].default_value = (*colour, 1.0)
    surface.inputs["Roughness"].default_value = roughness
    surface.inputs["Metallic"].default_value = metallic
    tree.links.new(surface.outputs["BSDF"], output.inputs["Surface"])
    if texture:
        image = tree.nodes.new("ShaderNodeTexImage")
        image.image = texture
        tree.links.new(image.outputs["Color"], surface.inputs["Base Color"])
    return made


def texture(name: str, pixels: np.ndarray, is_float: bool = False) -> bpy.types.Image:
    """An image from (H, W, 3) values, row 0 at the top, packed into the file.

    Values are sRGB-encoded in [0, 1], or scene-linear without limit if `is_float`.
    """
    height, width, _ = pixels.shape
    image = bpy.data.images.new(name, width, height, alpha=False, float_buffer=is_float)
    rgba = np.ones((height, width, 4), np.float32)
    rgba[..., :3] = pixels[::-1]  # Blender's row 0 is at the bottom
    image.pixels.foreach_set(rgba.ravel())
    image.pack()
    return image


def world(colour: Vector3, strength: float = 1.0, environment: bpy.types.Image | None = None) -> bpy.types.World:
    """The scene's world: one colour, or an equirectangular image."""
    scene = bpy.context.scene
    scene.world = scene.world or bpy.data.worlds.new("World")
    tree = _empty_tree(scene.world)
    background, output = tree.nodes.new("ShaderNodeBackground"), tree.nodes.new("ShaderNodeOutputWorld")
    background.inputs["Color"].default_value = (*colour, 1.0)
    background.inputs["Strength"].default_value = strength
    tree.links.new(background.outputs["Background"], output.inputs["Surface"])
    if environment:
        image = tree.nodes.new("ShaderNodeTexEnvironment")
        image.image = environment
        tree.links.new(image.outputs["Color"], background.inputs["Color"])
    return scene.world


def _empty_tree(owner: bpy.types.Material | bpy.types.World) -> bpy.types.NodeTree:
    if owner.node_tree is None:  # Blender 4.5 makes the tree on request, Blender 5 always has one
        owner.use_nodes = True
    owner.node_tree.nodes.clear()
    return owner.node_tree


# Shapes


def add(
    name: str,
    data: bpy.types.ID | None,
    location: Vector3 = (0.0, 0.0, 0.0),
    rotation_deg: Vector3 = (0.0, 0.0, 0.0),
    collection: bpy.types.Collection | None = None,
) -> bpy.types.Object:
    """An object with `data`, in `collection` or directly in the scene."""
    made = bpy.data.objects.new(name, data)
    made.location = location
    made.rotation_euler = [math.radians(angle) for angle in rotation_deg]
    (collection or bpy.context.scene.collection).objects.link(made)
    return made


def mesh(
    name: str,
    vertices: Sequence[Vector3],
    faces: Sequence[Sequence[int]],
    material: bpy.types.Material,
    tile_m: float = 1.0,
    **placement,
) -> bpy.types.Object:
    """A mesh object; each face takes its UV from the two axes that it faces least, in metres over `tile_m`."""
    data = bpy.data.meshes.new(name)
    data.from_pydata(vertices, [], faces)
    data.materials.append(material)
    uv = data.uv_layers.new(name="metres").data
    for face in data.polygons:
        facing = max(range(3), key=lambda axis, face=face: abs(face.normal[axis]))
        u, v = (axis for axis in range(3) if axis != facing)
        for corner in face.loop_indices:
            point = data.vertices[data.loops[corner].vertex_index].co
            uv[corner].uv = point[u] / tile_m, point[v] / tile_m
    return add(name, data, **placement)


def boxes(name: str, parts: Iterable[tuple[Vector3, Vector3]], material: bpy.types.Material, **options) -> bpy.types.Object:
    """Boxes in one mesh; each part is (size, location) with the location in the middle of the box's base."""
    vertices, faces = [], []
    for (size_x, size_y, size_z), (x, y, z) in parts:
        first = len(vertices)
        vertices += [
            (x + i * size_x / 2, y + j * size_y / 2, z + k * size_z) for k in (0, 1) for j in (-1, 1) for i in (-1, 1)
        ]
        sides = (0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (1, 3, 7, 5), (3, 2, 6, 7), (2, 0, 4, 6)
        faces += [tuple(first + corner for corner in side) for side in sides]
    bevel_m = options.pop("bevel_m", 0.0)
    made = mesh(name, vertices, faces, material, **options)
    if bevel_m:
        modifier(made, "BEVEL", width=bevel_m, segments=2)
    return made


def box(name: str, size: Vector3, location: Vector3, material: bpy.types.Material, **options) -> bpy.types.Object:
    """One box that stands on `location`. Options are those of `boxes` and `mesh`."""
    return boxes(name, [(size, (0.0, 0.0, 0.0))], material, location=location, **options)


def plane(name: str, size: Sequence[float], location: Vector3, material: bpy.types.Material, **options) -> bpy.types.Object:
    """A rectangle that faces up, unless `rotation_deg` turns it."""
    x, y = size[0] / 2, size[1] / 2
    vertices = [(-x, -y, 0.0), (x, -y, 0.0), (x, y, 0.0), (-x, y, 0.0)]
    return mesh(name, vertices, [(0, 1, 2, 3)], material, location=location, **options)


def sphere(name: str, radius_m: float, location: Vector3, material: bpy.types.Material, **placement) -> bpy.types.Object:
    """A smooth sphere that rests on `location`."""
    shape = bmesh.new()
    bmesh.ops.create_uvsphere(shape, u_segments=48, v_segments=24, radius=radius_m)
    bmesh.ops.translate(shape, vec=(0.0, 0.0, radius_m), verts=shape.verts)
    return _from_bmesh(name, shape, material, location=location, **placement)


def monkey(name: str, location: Vector3, material: bpy.types.Material, **placement) -> bpy.types.Object:
    """Blender's own test head, two units wide, subdivided."""
    shape = bmesh.new()
    bmesh.ops.create_monkey(shape)
    made = _from_bmesh(name, shape, material, location=location, **placement)
    modifier(made, "SUBSURF", levels=2, render_levels=2)
    return made


def _from_bmesh(name: str, shape: bmesh.types.BMesh, material: bpy.types.Material, **placement) -> bpy.types.Object:
    data = bpy.data.meshes.new(name)
    shape.to_mesh(data)
    shape.free()
    data.materials.append(material)
    data.shade_smooth()
    return add(name, data, **placement)


def lathe(
    name: str, profile: Sequence[tuple[float, float]], material: bpy.types.Material, steps: int = 32, **placement
) -> bpy.types.Object:
    """A profile of (radius, height) in metres, from the bottom up, turned round the vertical axis."""
    data = bpy.data.meshes.new(name)
    data.from_pydata(
        [(radius, 0.0, height) for radius, height in profile], [(i, i + 1) for i in range(len(profile) - 1)], []
    )
    data.materials.append(material)
    made = add(name, data, **placement)
    modifier(made, "SCREW", steps=steps, render_steps=steps, use_merge_vertices=True, use_normal_calculate=True)
    modifier(made, "EDGE_SPLIT", split_angle=math.radians(35))
    return made


def arch(
    name: str,
    size: Vector3,
    opening: tuple[float, float],
    material: bpy.types.Material,
    segments: int = 20,
    **options,
) -> bpy.types.Object:
    """A wall in x and z with a round-arched opening.

    `size` is the wall's width, thickness and height; `opening` is the opening's width and the height where its round begins.
    """
    (width, thickness, height), (span, spring) = size, opening
    radius = span / 2
    angles = [math.pi * (1 - i / segments) for i in range(segments + 1)]
    round_part = [(radius * math.cos(a), 0.0, spring + radius * math.sin(a)) for a in angles]
    outer = [(radius, 0.0, 0.0), (width / 2, 0.0, 0.0), (width / 2, 0.0, height)]
    outer += [(-width / 2, 0.0, height), (-width / 2, 0.0, 0.0), (-radius, 0.0, 0.0)]
    outline = [*round_part, *outer]
    made = mesh(name, outline, [tuple(reversed(range(len(outline))))], material, **options)
    modifier(made, "SOLIDIFY", thickness=thickness, offset=0.0)
    return made


def text(
    name: str,
    words: str,
    height_m: float,
    location: Vector3,
    material: bpy.types.Material,
    rotation_deg: Vector3 = (90.0, 0.0, 0.0),
) -> bpy.types.Object:
    """Solid letters, centred, upright unless turned otherwise."""
    data = bpy.data.curves.new(name, "FONT")
    data.body, data.size, data.align_x = words, height_m, "CENTER"
    data.extrude, data.bevel_depth, data.bevel_resolution = 0.12 * height_m, 0.015 * height_m, 1
    data.materials.append(material)
    return add(name, data, location, rotation_deg)


def modifier(target: bpy.types.Object, kind: str, **settings) -> bpy.types.Modifier:
    """A modifier of `kind` with the given settings."""
    made = target.modifiers.new(kind.title(), kind)
    for name, value in settings.items():
        setattr(made, name, value)
    return made


def row(target: bpy.types.Object, count: int, step_m: Vector3) -> bpy.types.Object:
    """Repeat an object `count` times by an Array modifier."""
    modifier(
        target, "ARRAY", count=count, use_relative_offset=False, use_constant_offset=True, constant_offset_displace=step_m
    )
    return target


def group(name: str) -> bpy.types.Collection:
    """A collection that is not in the scene: it shows only where `instance` puts it."""
    return bpy.data.collections.new(name)


def instance(
    collection: bpy.types.Collection, location: Vector3, turn_deg: float = 0.0, scale: float = 1.0
) -> bpy.types.Object:
    """One copy of a collection, turned about the vertical axis."""
    made = add(f"{collection.name} at {location[0]:.1f} {location[1]:.1f}", None, location, (0.0, 0.0, turn_deg))
    made.instance_type, made.instance_collection = "COLLECTION", collection
    made.scale = scale, scale, scale
    return made


# Lamps and camera


def lamp(
    name: str,
    kind: str,
    power: float,
    location: Vector3,
    target: Vector3 | None = None,
    colour: Vector3 = (1.0, 1.0, 1.0),
    **settings,
) -> bpy.types.Object:
    """A lamp of `kind` POINT, SPOT, AREA (power in W) or SUN (W/m2) that shines at `target`; the camera does not see it."""
    data = bpy.data.lights.new(name, kind)
    data.energy, data.color = power, colour
    for setting, value in settings.items():
        setattr(data, setting, value)
    made = add(name, data, location)
    made.visible_camera = False
    if target is not None:
        _aim(made, target)
    return made


def camera(location: Vector3, target: Vector3, lens_mm: float = 35.0, **settings) -> bpy.types.Object:
    """The scene's camera."""
    scene = bpy.context.scene
    data = bpy.data.cameras.new("Camera")
    data.lens = lens_mm
    for setting, value in settings.items():
        setattr(data, setting, value)
    scene.camera = add("Camera", data, location)
    _aim(scene.camera, target)
    return scene.camera


def _aim(thing: bpy.types.Object, target: Vector3) -> None:
    direction = Vector(target) - Vector(thing.location)
    thing.rotation_euler = direction.to_track_quat("-Z", "Y").to_euler()
