"""A hall with a polished floor and metal balls from mirror to matt: the glossy bounce.

Walls and columns reflect in the floor, sharper near their feet and softer away from them, and the balls, left to right, show
the same hall at five roughnesses. Screen-space reflections lose what is hidden or behind the camera; a diffuse-only method
leaves the balls black.
"""

from __future__ import annotations

import bpy

from . import kit, patterns

COLUMN = [(0.0, 0.0), (0.42, 0.0), (0.42, 0.12), (0.34, 0.2), (0.27, 0.28), (0.25, 0.6), (0.24, 2.2), (0.22, 3.3)]
COLUMN += [(0.26, 3.38), (0.34, 3.5), (0.42, 3.56), (0.42, 3.7)]
ROUGHNESS = (0.02, 0.12, 0.25, 0.4, 0.6)


def build(scene: bpy.types.Scene) -> None:
    """Floor, walls, two rows of columns, five balls; one warm and one cold spot."""
    tiles = kit.texture("tiles", patterns.checker((0.78, 0.74, 0.68), (0.26, 0.24, 0.25)))
    floor = kit.material("polished tiles", roughness=0.12, texture=tiles)
    plaster = kit.material("plaster", (0.74, 0.68, 0.6), roughness=0.7)
    marble = kit.material("marble", (0.8, 0.77, 0.72), roughness=0.3)
    red = kit.material("red hanging", (0.62, 0.06, 0.05), roughness=0.9)

    kit.plane("floor", (8, 16), (0, 2, 0), floor, tile_m=1.6)
    kit.plane("ceiling", (8, 16), (0, 2, 4.2), plaster, rotation_deg=(180, 0, 0))
    kit.plane("left wall", (4.2, 16), (-4, 2, 2.1), plaster, rotation_deg=(0, 90, 0))
    kit.plane("right wall", (4.2, 16), (4, 2, 2.1), plaster, rotation_deg=(0, -90, 0))
    kit.plane("back wall", (8, 4.2), (0, 8, 2.1), plaster, rotation_deg=(90, 0, 0))
    kit.box("hanging", (2.6, 0.04, 3.0), (0, 7.9, 0.7), red, bevel_m=0.01)
    kit.text("motto", "LVX", 0.9, (0, 7.82, 1.9), kit.material("gilt", (0.95, 0.7, 0.3), roughness=0.3, metallic=1.0))
    for x in (-2.6, 2.6):
        kit.row(kit.lathe("columns", COLUMN, marble, location=(x, -2.0, 0)), 5, (0, 2.3, 0))
        kit.box("beam", (0.8, 16, 0.5), (x, 2, 3.7), plaster, bevel_m=0.03)

    colours = ((0.95, 0.93, 0.9), (0.95, 0.7, 0.35), (0.92, 0.92, 0.95), (0.9, 0.5, 0.35), (0.85, 0.85, 0.88))
    for i, (roughness, colour) in enumerate(zip(ROUGHNESS, colours, strict=True)):
        metal = kit.material(f"metal of roughness {roughness}", colour, roughness, metallic=1.0)
        kit.sphere(f"ball {i}", 0.42, (-2.0 + i, 0.35 + 0.35 * (i % 2), 0), metal)

    wide = {"spot_size": 1.5, "spot_blend": 0.6, "shadow_soft_size": 0.1}
    kit.lamp("warm spot", "SPOT", 2600, (-1.2, -4.6, 3.7), (1.6, 5.0, 1.2), (1.0, 0.78, 0.52), **wide)
    kit.lamp("cold spot", "SPOT", 1500, (1.9, 6.9, 3.6), (-3.6, 2.0, 0.6), (0.55, 0.75, 1.0), **wide)
    kit.camera((0, -4.3, 1.35), (0, 2.0, 1.25), lens_mm=28)
