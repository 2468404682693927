"""Rooms that a sweep makes on the fly, for amounts of work that no scene has: so many lamps, so many triangles.

Ten metres wide, three metres high, grey, open towards the camera. All else stays the same while the number grows: the lamps
share the same power, the spheres keep their size and place.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import bmesh
import bpy

POWER_W = 400.0             # of all lamps together: a wall of the room is then about middle grey
SPHERES = (4, 4)            # columns and rows
_GREY = (0.7, 0.7, 0.7)


def room_of_lamps(count: int) -> None:
    """Replace what Blender holds by the room under `count` points of light, with five boxes that throw shadows."""
    _empty_room()
    for i in range(5):
        _box(f"Box {i}", (0.9, 0.9, 0.6 + 0.3 * i), (2.0 * i - 4.0, 1.0 + (i % 2), 0.0))
    columns = math.ceil(math.sqrt(2 * count))
    for i in range(count):
        rows = math.ceil(count / columns)
        x, y = (i % columns + 0.5) / columns, (i // columns + 0.5) / rows
        _lamp(f"Lamp {i}", POWER_W / count, (10 * x - 5, 4 * y - 1, 2.6))


def room_of_triangles(count: int) -> None:
    """Replace what Blender holds by the room with sixteen spheres of `count` triangles in all, each a mesh of its own.

    `count` is 16 20 4^k, as spheres grow from an icosahedron. The room's ten triangles are not counted.
    """
    _empty_room()
    columns, rows = SPHERES
    shape = bmesh.new()
    level = round(math.log(count / (20 * columns * rows), 4))
    bmesh.ops.create_icosphere(shape, subdivisions=level + 1, radius=0.55)
    for i in range(columns * rows):
        data = bpy.data.meshes.new(f"Sphere {i}")
        shape.to_mesh(data)
        data.shade_smooth()
        _add(data.name, data, (2.2 * (i % columns) - 3.3, 1.2 * (i // columns) - 1.0, 0.55))
    shape.free()
    _lamp("Lamp", POWER_W, (1.0, -1.0, 2.6))


ROOMS = {"lights": room_of_lamps, "triangles": room_of_triangles}


def _empty_room() -> None:
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    x, y, z = 5.0, 4.0, 3.0
    corners = [(-x, -y, 0), (x, -y, 0), (x, y, 0), (-x, y, 0), (-x, -y, z), (x, -y, z), (x, y, z), (-x, y, z)]
    _mesh("Room", corners, [(0, 1, 2, 3), (7, 6, 5, 4), (3, 2, 6, 7), (0, 3, 7, 4), (2, 1, 5, 6)])
    camera = _add("Camera", bpy.data.cameras.new("Camera"), (0.0, -9.0, 1.9))
    camera.rotation_euler = math.radians(86), 0.0, 0.0
    bpy.context.scene.camera = camera


def _add(name: str, data: bpy.types.ID, location: Sequence[float]) -> bpy.types.Object:
    made = bpy.data.objects.new(name, data)
    made.location = location
    bpy.context.scene.collection.objects.link(made)
    return made


def _mesh(name: str, corners: Sequence[Sequence[float]], faces: Sequence[Sequence[int]]) -> None:
    data = bpy.data.meshes.new(name)
    data.from_pydata(corners, [], faces)
    material = bpy.data.materials.new(name)
    if material.node_tree is None:               # Blender 4.5 makes the tree on request, Blender 5 always has one
        material.use_nodes = True
    material.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (*_GREY, 1.0)
    data.materials.append(material)
    _add(name, data, (0.0, 0.0, 0.0))


def _box(name: str, size: Sequence[float], base: Sequence[float]) -> None:
    corners = [(base[0] + i * size[0] / 2, base[1] + j * size[1] / 2, base[2] + k * size[2])
               for k in (0, 1) for j in (-1, 1) for i in (-1, 1)]
    _mesh(name, corners, [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (1, 3, 7, 5), (3, 2, 6, 7), (2, 0, 4, 6)])


def _lamp(name: str, power_w: float, location: Sequence[float]) -> None:
    data = bpy.data.lights.new(name, "POINT")
    data.energy, data.shadow_soft_size = power_w, 0.05
    _add(name, data, location)
