"""The Cornell box: red and green walls bleed on two white boxes.

The first picture of any global illumination. The ceiling gets no direct light, so all that it shows is the bounce; where a
box stands between a place and the floor that lights it, a method without visibility shines through the box. The room is
wider than the square one of 1984, so that it fills the frame.
"""

from __future__ import annotations

import bpy

from . import kit

WIDTH_M, DEPTH_M, HEIGHT_M = 5.0, 4.0, 2.8


def build(scene: bpy.types.Scene) -> None:
    """Five walls, open towards the camera, two boxes and a square lamp under the ceiling."""
    white = kit.material("white", roughness=0.9)
    red = kit.material("red", (0.63, 0.065, 0.05), roughness=0.9)
    green = kit.material("green", (0.14, 0.45, 0.091), roughness=0.9)

    kit.plane("floor", (WIDTH_M, DEPTH_M), (0, 0, 0), white)
    kit.plane("ceiling", (WIDTH_M, DEPTH_M), (0, 0, HEIGHT_M), white, rotation_deg=(180, 0, 0))
    kit.plane("back wall", (WIDTH_M, HEIGHT_M), (0, DEPTH_M / 2, HEIGHT_M / 2), white, rotation_deg=(90, 0, 0))
    kit.plane("left wall", (HEIGHT_M, DEPTH_M), (-WIDTH_M / 2, 0, HEIGHT_M / 2), red, rotation_deg=(0, 90, 0))
    kit.plane("right wall", (HEIGHT_M, DEPTH_M), (WIDTH_M / 2, 0, HEIGHT_M / 2), green, rotation_deg=(0, -90, 0))
    kit.box("tall box", (0.85, 0.85, 1.7), (-1.0, 0.55, 0), white, rotation_deg=(0, 0, 17), bevel_m=0.015)
    kit.box("short box", (0.85, 0.85, 0.85), (0.95, -0.45, 0), white, rotation_deg=(0, 0, -18), bevel_m=0.015)

    kit.lamp("ceiling lamp", "AREA", 160, (0, 0, HEIGHT_M - 0.02), (0, 0, 0), (1.0, 0.85, 0.65), shape="SQUARE", size=0.9)
    kit.camera((0, -DEPTH_M / 2 - 4.8, HEIGHT_M / 2), (0, 0, HEIGHT_M / 2), lens_mm=35)
