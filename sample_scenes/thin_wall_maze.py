"""Rooms behind walls of two centimetres, one of them completely closed: leaks show.

Light goes from room to room only through the doors. The room in the middle has no door, so every photon in it is an error:
voxels wider than a wall, shadow maps with too much bias and bounces without visibility all leak into it. The camera looks
straight down; its near clip plane cuts the ceiling away, as an architect's plan does, and yet the ceiling holds back light.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

import bpy

from . import kit

Part = tuple[tuple[float, float, float], tuple[float, float, float]]

STEP_M, HEIGHT_M, WALL_M = 0.375, 1.4, 0.02
# Every character is a point of a lattice of `STEP_M`; a letter stands in the middle of its cell and names the cell's floor.
PLAN = """\
+---+---+---+---+---+
|       |           |
| r   r   b   b   b |
|       |           |
+- -+---+---+---+- -+
|       |       |   |
| o   o | x   x | y |
|       |       |   |
+- -+---+---+---+- -+
|           |       |
| w   w   w   g   g |
|           |       |
+---+---+---+---+---+
""".splitlines()
FLOORS = {
    "r": (0.75, 0.1, 0.06),
    "b": (0.08, 0.25, 0.7),
    "o": (0.8, 0.35, 0.06),
    "y": (0.8, 0.6, 0.08),
    "w": (0.75, 0.73, 0.7),
    "g": (0.15, 0.55, 0.12),
    "x": (0.8, 0.8, 0.8),
}
CLOSED_ROOM = "x"


def build(scene: bpy.types.Scene) -> None:
    """Walls and floors from `PLAN`, a ceiling over all, furniture, four point lamps and a camera above."""
    paint = kit.material("wall paint", (0.76, 0.74, 0.72), roughness=0.8)
    width, depth = (len(PLAN[0]) - 1) * STEP_M + WALL_M, (len(PLAN) - 1) * STEP_M + WALL_M
    kit.boxes("walls", walls(), paint)
    kit.box("ceiling", (width, depth, WALL_M), (0, 0, HEIGHT_M), paint)
    for letter, colour in FLOORS.items():
        tiles = [((4 * STEP_M, 4 * STEP_M, WALL_M), (x, y, -WALL_M)) for x, y in cells(letter)]
        kit.boxes(f"floor {letter}", tiles, kit.material(f"floor {letter}", colour, roughness=0.6))
    _furniture(paint)
    for letter, number, colour in (
        ("r", 0, (1.0, 0.85, 0.65)),
        ("b", 1, (0.85, 0.93, 1.0)),
        ("w", 1, (1.0, 0.93, 0.85)),
        ("g", 1, (1.0, 0.82, 0.6)),
    ):
        kit.lamp(f"lamp {letter}", "POINT", 36, (*cells(letter)[number], 0.9), None, colour, shadow_soft_size=0.05)
    camera_height_m = 11.0
    kit.camera((0, 0, camera_height_m), (0, 0, 0), lens_mm=44, clip_start=camera_height_m - HEIGHT_M + 0.01)


def place(row: int, column: int) -> tuple[float, float]:
    """x and y of a character of the plan, in metres; the plan's middle is the origin."""
    return (column - (len(PLAN[0]) - 1) / 2) * STEP_M, ((len(PLAN) - 1) / 2 - row) * STEP_M


def cells(letter: str) -> list[tuple[float, float]]:
    """Where a letter stands, in metres."""
    return [place(row, column) for row, line in enumerate(PLAN) for column, mark in enumerate(line) if mark == letter]


def walls() -> Iterator[Part]:
    """The walls as boxes, one a straight run; runs overlap where they meet, so that no corner is open."""
    for row, line in enumerate(PLAN):
        for run in re.finditer("[-+]{2,}", line):
            (left, y), (right, _) = place(row, run.start()), place(row, run.end() - 1)
            yield (right - left + WALL_M, WALL_M, HEIGHT_M), ((left + right) / 2, y, 0)
    for column, line in enumerate(map("".join, zip(*PLAN, strict=True))):
        for run in re.finditer("[|+]{2,}", line):
            (x, far), (_, near) = place(run.start(), column), place(run.end() - 1, column)
            yield (WALL_M, far - near + WALL_M, HEIGHT_M), (x, (far + near) / 2, 0)


def _furniture(paint: bpy.types.Material) -> None:
    wood = kit.material("wood", (0.45, 0.27, 0.13), roughness=0.4)
    steel = kit.material("steel", (0.7, 0.7, 0.72), roughness=0.25, metallic=1.0)
    for letter, number in (("r", 1), ("b", 2), ("w", 0), ("g", 0)):
        where = (*cells(letter)[number], 0)
        kit.box(f"stool {letter}", (0.5, 0.5, 0.4), where, wood, rotation_deg=(0, 0, 25), bevel_m=0.03)
    for letter, number in (("b", 0), ("w", 2), ("o", 0), ("y", 0)):
        kit.sphere(f"ball {letter}", 0.25, (*cells(letter)[number], 0), steel)
    (left, y), (right, _) = cells(CLOSED_ROOM)
    kit.text("dark", "DARK", 0.6, ((left + right) / 2, y - 0.2, 0.1), paint, rotation_deg=(0, 0, 0))
